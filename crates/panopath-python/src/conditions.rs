//! `full_visibility`: positions in, nullity and the conditions that fail out.

use numpy::PyReadonlyArray2;
use panopath::rigidity::conditions::{Cause, failing_conditions, full_visibility_nullity};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::convert::vectors;
use crate::rigidity::write_causes;

/// Nullity and causes, the causes as dicts.
type Conditions<'py> = (usize, Bound<'py, PyAny>);

/// What is ambiguous where every view sees every point (`panopath.steps.conditions` describes the arguments); `None` where
/// a view is at a point.
#[pyfunction]
fn full_visibility<'py>(
    py: Python<'py>,
    centers: PyReadonlyArray2<'py, f64>,
    points: PyReadonlyArray2<'py, f64>,
    tolerance: f64,
) -> PyResult<Option<Conditions<'py>>> {
    let found = match centers.as_array().ncols() {
        2 => conditions::<2>(py, &centers, &points, tolerance)?,
        3 => conditions::<3>(py, &centers, &points, tolerance)?,
        found => return Err(PyValueError::new_err(format!("centers has {found} columns, expected 2 or 3"))),
    };
    found.map(|(nullity, causes)| Ok((nullity, write_causes(py, causes)?.into_any()))).transpose()
}

fn conditions<const D: usize>(
    py: Python<'_>,
    centers: &PyReadonlyArray2<'_, f64>,
    points: &PyReadonlyArray2<'_, f64>,
    tolerance: f64,
) -> PyResult<Option<(usize, Vec<Cause>)>> {
    let (centers, points) = (vectors::<D>(centers, "centers")?, vectors::<D>(points, "points")?);
    Ok(py.detach(|| {
        full_visibility_nullity(&centers, &points, tolerance)
            .map(|nullity| (nullity, failing_conditions(&centers, &points, tolerance)))
    }))
}

/// Adds the function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(full_visibility, module)?)
}
