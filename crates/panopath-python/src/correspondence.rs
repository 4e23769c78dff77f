//! `tracks_from_matches`: flat arrays in, a dict of flat arrays out.

use numpy::{IntoPyArray, PyReadonlyArray1, PyReadonlyArray2};
use panopath::correspondence::{CorrespondenceOptions, Matches, tracks_from_matches as tracks_of};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::value_error;

/// Joins matches to tracks (`panopath.steps.tracks_from_matches` describes the arguments).
#[pyfunction]
fn tracks_from_matches<'py>(
    py: Python<'py>,
    n_features: PyReadonlyArray1<'py, i64>,
    pairs: PyReadonlyArray2<'py, i32>,
    match_starts: PyReadonlyArray1<'py, i64>,
    matches: PyReadonlyArray2<'py, i32>,
    min_images: usize,
    min_linkage: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let n_features = counts(&n_features, "n_features")?;
    let starts = counts(&match_starts, "match_starts")?;
    let (pairs, features) = (index_pairs(&pairs, "pairs")?, index_pairs(&matches, "matches")?);
    let input = Matches { n_features: &n_features, pairs: &pairs, starts: &starts, features: &features };
    let options = CorrespondenceOptions { min_images, min_linkage };
    let found = py.detach(|| tracks_of(&input, &options)).map_err(value_error)?;
    let dict = PyDict::new(py);
    for (name, ids) in [("image", found.image), ("track", found.track), ("feature", found.feature)] {
        let ids: Vec<i32> = ids.into_iter().map(u32::cast_signed).collect();
        dict.set_item(name, ids.into_pyarray(py))?;
    }
    dict.set_item("n_tracks", found.n_tracks)?;
    dict.set_item("n_cut", found.n_cut)?;
    Ok(dict)
}

fn counts(array: &PyReadonlyArray1<'_, i64>, name: &str) -> PyResult<Vec<usize>> {
    let convert = |(k, &n): (usize, &i64)| {
        usize::try_from(n).map_err(|_| PyValueError::new_err(format!("{name}[{k}] is {n}, expected 0 or more")))
    };
    array.as_array().iter().enumerate().map(convert).collect()
}

fn index_pairs(array: &PyReadonlyArray2<'_, i32>, name: &str) -> PyResult<Vec<[u32; 2]>> {
    let array = array.as_array();
    if array.ncols() != 2 {
        return Err(PyValueError::new_err(format!("{name} has {} columns, expected 2", array.ncols())));
    }
    let flat = array.as_slice().ok_or_else(|| PyValueError::new_err(format!("{name} is not in C order")))?;
    let rows = flat.as_chunks::<2>().0;
    if let Some(k) = rows.iter().position(|row| row[0] < 0 || row[1] < 0) {
        return Err(PyValueError::new_err(format!("{name}[{k}] is {:?}, expected 0 or more", rows[k])));
    }
    Ok(rows.iter().map(|row| row.map(i32::cast_unsigned)).collect())
}

/// Adds this file's functions to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(tracks_from_matches, module)?)
}
