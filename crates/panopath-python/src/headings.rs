//! `start_headings`: flat arrays in, a dict of arrays out.

use numpy::IntoPyArray;
use panopath::headings::{HeadingOptions, start_headings as solve};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{Input, Observations, value_error};

/// Headings of planar views (`panopath.steps.find_headings` describes the arguments).
#[pyfunction]
fn start_headings<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    let input = Input::new(observations, None);
    let (tracks, options) = (input.tracks::<2>()?, read_options(options)?);
    let found = py.detach(|| solve(&tracks, &options)).map_err(value_error)?;
    let dict = PyDict::new(py);
    dict.set_item("heading_rad", found.heading_rad.into_pyarray(py))?;
    dict.set_item("view_component", found.view_component.into_pyarray(py))?;
    dict.set_item("resected", found.resected.into_pyarray(py))?;
    dict.set_item("n_triplets", found.n_triplets)?;
    dict.set_item("n_quads", found.n_quads)?;
    dict.set_item("status", found.status.name())?;
    Ok(dict)
}

/// Reads the options by name; every name that is not known is an error.
fn read_options(options: &Bound<'_, PyDict>) -> PyResult<HeadingOptions> {
    let mut parsed = HeadingOptions::default();
    for (name, value) in options {
        match name.extract::<String>()?.as_str() {
            "noise_rad" => parsed.noise_rad = value.extract()?,
            "min_tracks" => parsed.min_tracks = value.extract()?,
            "triplets" => parsed.triplets = value.extract()?,
            "min_points" => parsed.min_points = value.extract()?,
            "seed" => parsed.seed = value.extract()?,
            other => return Err(PyValueError::new_err(format!("options has no entry {other:?}"))),
        }
    }
    Ok(parsed)
}

/// Adds the function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(start_headings, module)?)
}
