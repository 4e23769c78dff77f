//! Between numpy's arrays and the core's vectors.

use numpy::PyReadonlyArray2;
use panopath::Rotation;
use panopath::geometry::Vector;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Any of the core's errors as Python's `ValueError`.
pub fn value_error(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Rows of an `(n, D)` array.
pub fn vectors<const D: usize>(array: &PyReadonlyArray2<'_, f64>, name: &str) -> PyResult<Vec<Vector<D>>> {
    let array = array.as_array();
    if array.ncols() != D {
        return Err(PyValueError::new_err(format!("{name} has {} columns, expected {D}", array.ncols())));
    }
    Ok(match array.as_slice() {
        Some(flat) => flat.as_chunks::<D>().0.to_vec(),
        None => array.rows().into_iter().map(|row| std::array::from_fn(|c| row[c])).collect(),
    })
}

/// Heading of a planar view: `world_from_cam` is the rotation by it.
pub fn heading(cam_from_world: &Rotation<2>) -> f64 {
    let [[cos, sin], _] = *cam_from_world.matrix();
    sin.atan2(cos)
}
