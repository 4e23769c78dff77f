//! Functions of time, and bodies that move.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray1};
use panopath::paths::Form;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A form of path as Python tells it: name, order, numbers.
pub type FormArguments = (String, usize, Vec<f64>);

/// Reads a form of path.
pub fn form((kind, order, numbers): &FormArguments) -> PyResult<Form> {
    let number = |k: usize| numbers.get(k).copied().unwrap_or(f64::NAN);
    match kind.as_str() {
        "static" => Ok(Form::Static),
        "taylor" => Ok(Form::Taylor { order: *order, origin_s: number(0), unit_s: number(1) }),
        "fourier" => Ok(Form::Fourier { order: *order, omega_rad_s: number(0) }),
        "spline" if numbers.len() >= 2 => Ok(Form::Spline { degree: *order, breaks_s: numbers.clone() }),
        other => Err(PyValueError::new_err(format!("{other:?} is no form of path"))),
    }
}

/// Values of the functions of a form of path at some times, or their derivatives.
#[pyfunction]
fn path_functions<'py>(
    py: Python<'py>,
    model: FormArguments,
    time_s: PyReadonlyArray1<'py, f64>,
    derivative: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    if derivative > 1 {
        return Err(PyValueError::new_err(format!("derivative is {derivative}, expected 0 or 1")));
    }
    let form = form(&model)?;
    let times = time_s.as_array();
    let mut values = Array2::zeros((times.len(), form.len()));
    let mut row = vec![0.0; form.len()];
    for (k, &time) in times.iter().enumerate() {
        form.values(time, derivative, &mut row);
        values.row_mut(k).iter_mut().zip(&row).for_each(|(to, from)| *to = *from);
    }
    Ok(values.into_pyarray(py))
}

/// Adds the functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(path_functions, module)?)
}
