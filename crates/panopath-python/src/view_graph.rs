//! `view_pairs`: which pairs of views to orient against each other.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2};
use panopath::view_graph::{ViewGraphOptions, view_pairs as pairs_of};
use pyo3::prelude::*;

use crate::convert::{Input, Observations};

type Pairs<'py> = (Bound<'py, PyArray2<i32>>, Bound<'py, PyArray1<i64>>, Bound<'py, PyArray2<i32>>);

/// Pairs of views with their matches (`panopath.steps.view_graph` describes the arguments).
#[pyfunction]
fn view_pairs<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    min_shared: usize,
    max_partners: usize,
    max_matches: usize,
) -> PyResult<Pairs<'py>> {
    let input = Input::new(observations, None);
    let tracks = input.tracks::<3>()?;
    let options = ViewGraphOptions { min_shared, max_partners, max_matches };
    let found = py.detach(|| pairs_of(&tracks, &options));
    let rows = |table: Vec<[u32; 2]>| Array2::from_shape_fn((table.len(), 2), |(i, k)| table[i][k] as i32);
    let start: Vec<i64> = found.start.iter().map(|&s| i64::from(s)).collect();
    Ok((rows(found.pair).into_pyarray(py), start.into_pyarray(py), rows(found.observation).into_pyarray(py)))
}

/// Adds the function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(view_pairs, module)?)
}
