//! `run_trials`: sizes, seeds and errors of many small worlds in, columns of a table out.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyReadonlyArray1};
use panopath::positions::Method;
use panopath::trials::{Alignment, Outcome, Trial, TrialError, run_trials as run};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{on_threads, value_error};
use crate::positions::read_options;

/// Runs trials (`panopath.paper.trials` describes the arguments): every column has the shape (trials, methods).
#[pyfunction]
fn run_trials<'py>(
    py: Python<'py>,
    dimension: usize,
    trials: (
        PyReadonlyArray1<'py, i64>,
        PyReadonlyArray1<'py, i64>,
        PyReadonlyArray1<'py, i64>,
        PyReadonlyArray1<'py, f64>,
    ),
    methods: Vec<Bound<'py, PyDict>>,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let trials = read_trials(&trials.0, &trials.1, &trials.2, &trials.3)?;
    let outcomes = match dimension {
        2 => run_in::<2>(py, &trials, &methods, threads)?,
        3 => run_in::<3>(py, &trials, &methods, threads)?,
        _ => return Err(PyValueError::new_err(format!("dimension is {dimension}, expected 2 or 3"))),
    };
    write_columns(py, &outcomes.map_err(value_error)?, methods.len())
}

type Outcomes = Result<Vec<Vec<Outcome>>, TrialError>;

fn run_in<const D: usize>(
    py: Python<'_>,
    trials: &[Trial],
    methods: &[Bound<'_, PyDict>],
    threads: Option<usize>,
) -> PyResult<Outcomes> {
    let methods: Vec<Method> =
        methods.iter().map(|options| Ok(read_options::<D>(options)?.0.method)).collect::<PyResult<_>>()?;
    py.detach(|| on_threads(threads, || run::<D>(trials, &methods)))
}

fn read_trials(
    n_views: &PyReadonlyArray1<'_, i64>,
    n_points: &PyReadonlyArray1<'_, i64>,
    seed: &PyReadonlyArray1<'_, i64>,
    angle_error_rad: &PyReadonlyArray1<'_, f64>,
) -> PyResult<Vec<Trial>> {
    let expected = n_views.as_array().len();
    for (name, found) in [
        ("n_points", n_points.as_array().len()),
        ("seed", seed.as_array().len()),
        ("angle_error_rad", angle_error_rad.as_array().len()),
    ] {
        if found != expected {
            return Err(PyValueError::new_err(format!("{name} has {found} entries, expected {expected}")));
        }
    }
    let count = |name: &str, k: usize, value: i64| {
        u64::try_from(value).map_err(|_| PyValueError::new_err(format!("{name}[{k}] is {value}, expected 0 or more")))
    };
    let (n_views, n_points) = (n_views.as_array(), n_points.as_array());
    let (seed, error) = (seed.as_array(), angle_error_rad.as_array());
    (0..expected)
        .map(|k| {
            Ok(Trial {
                n_views: count("n_views", k, n_views[k])? as usize,
                n_points: count("n_points", k, n_points[k])? as usize,
                seed: count("seed", k, seed[k])?,
                angle_error_rad: error[k],
            })
        })
        .collect()
}

fn write_columns<'py>(py: Python<'py>, outcomes: &[Vec<Outcome>], n_methods: usize) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    let shape = (outcomes.len(), n_methods);
    let status: Vec<Vec<&str>> = outcomes.iter().map(|row| row.iter().map(|o| o.status.name()).collect()).collect();
    dict.set_item("status", status)?;
    let missing = Array2::from_shape_fn(shape, |(t, k)| outcomes[t][k].n_missing as i64);
    dict.set_item("n_missing", missing.into_pyarray(py))?;
    let Some(first) = outcomes.first().and_then(|row| row.first()) else { return Ok(dict) };
    for (a, alignment) in Alignment::EVERY.into_iter().enumerate() {
        for (column, (name, _)) in first.deviations[a].named().into_iter().enumerate() {
            let values = Array2::from_shape_fn(shape, |(t, k)| outcomes[t][k].deviations[a].named()[column].1);
            dict.set_item(format!("{}_{name}", alignment.name()), values.into_pyarray(py))?;
        }
    }
    for (column, (name, _)) in first.refilmed.named().into_iter().enumerate() {
        let values = Array2::from_shape_fn(shape, |(t, k)| outcomes[t][k].refilmed.named()[column].1);
        dict.set_item(format!("refilm_{name}"), values.into_pyarray(py))?;
    }
    Ok(dict)
}

/// Adds the function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(run_trials, module)?)
}
