//! `mean_motion` and `fit_rotations`: flat arrays in, arrays out.

use numpy::ndarray::{Array1, Array3};
use numpy::{IntoPyArray, PyReadonlyArray1, PyReadonlyArray2};
use panopath::motion::{
    Flow, Motion, MotionOptions, Step, Vertical, Weighting, fit_rotations as fit, mean_motion as solve,
};
use panopath::{Rotation, Tracks};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{FromHeadingOrMatrix, Input, Observations, choose, heading, value_error, vectors};

/// Orientations from the mean motion (`panopath.steps.mean_motion` describes the arguments).
#[pyfunction]
fn mean_motion<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    let input = Input::new(observations, None);
    let parsed = read_options(options)?;
    match input.dimension()? {
        2 => to_dict(py, solved(py, &input.tracks::<2>()?, &parsed)?, headings),
        _ => to_dict(py, solved(py, &input.tracks::<3>()?, &parsed)?, matrices),
    }
}

fn solved<const D: usize>(py: Python<'_>, tracks: &Tracks<D>, options: &MotionOptions) -> PyResult<Motion<D>> {
    py.detach(|| solve(tracks, options)).map_err(value_error)
}

/// Rotations as they are written in Python, NaN where there is none.
type Written<'py, const D: usize> = fn(Python<'py>, &[Option<Rotation<D>>]) -> Bound<'py, PyAny>;

fn headings<'py>(py: Python<'py>, rotations: &[Option<Rotation<2>>]) -> Bound<'py, PyAny> {
    Array1::from_iter(rotations.iter().map(|r| r.as_ref().map_or(f64::NAN, heading))).into_pyarray(py).into_any()
}

fn matrices<'py>(py: Python<'py>, rotations: &[Option<Rotation<3>>]) -> Bound<'py, PyAny> {
    let entry = |(i, r, c): (usize, usize, usize)| rotations[i].map_or(f64::NAN, |rotation| rotation.matrix()[r][c]);
    Array3::from_shape_fn((rotations.len(), 3, 3), entry).into_pyarray(py).into_any()
}

fn to_dict<'py, const D: usize>(
    py: Python<'py>,
    motion: Motion<D>,
    written: Written<'py, D>,
) -> PyResult<Bound<'py, PyDict>> {
    let steps = &motion.steps;
    let numbers = |value: fn(&Step<D>) -> f64| Array1::from_iter(steps.iter().map(value)).into_pyarray(py);
    let counts = |value: fn(&Step<D>) -> i32| Array1::from_iter(steps.iter().map(value)).into_pyarray(py);
    let turns: Vec<Option<Rotation<D>>> = steps.iter().map(|step| step.turn).collect();
    let dict = PyDict::new(py);
    dict.set_item("cam_from_world", written(py, &motion.cam_from_world))?;
    dict.set_item("turn", written(py, &turns))?;
    dict.set_item("step_from", counts(|step| step.from as i32))?;
    dict.set_item("step_to", counts(|step| step.to as i32))?;
    dict.set_item("n_common", counts(|step| step.n_common as i32))?;
    dict.set_item("interval_s", numbers(|step| step.interval_s))?;
    dict.set_item("residual_rad", numbers(|step| step.residual_rad))?;
    dict.set_item("turn_sigma_rad", numbers(|step| step.turn_sigma_rad))?;
    dict.set_item("view_component", motion.view_component.into_pyarray(py))?;
    dict.set_item("status", motion.status.name())?;
    Ok(dict)
}

/// Orientations from known centres and points (`panopath.steps.fit_rotations` describes the arguments).
#[pyfunction]
fn fit_rotations<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    centers: PyReadonlyArray2<'py, f64>,
    points: PyReadonlyArray2<'py, f64>,
    cam_from_world: Bound<'py, PyAny>,
    weighting: &str,
    share: f64,
) -> PyResult<Bound<'py, PyAny>> {
    let weighting = read_weighting(weighting, share)?;
    let cam_from_world = Some(cam_from_world);
    let input = Input::new(observations, cam_from_world);
    match input.dimension()? {
        2 => fit_in::<2>(py, &input, &centers, &points, weighting, headings),
        _ => fit_in::<3>(py, &input, &centers, &points, weighting, matrices),
    }
}

fn fit_in<'py, const D: usize>(
    py: Python<'py>,
    input: &Input<'py>,
    centers: &PyReadonlyArray2<'py, f64>,
    points: &PyReadonlyArray2<'py, f64>,
    weighting: Weighting,
    written: Written<'py, D>,
) -> PyResult<Bound<'py, PyAny>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let (tracks, rotations) = (input.tracks::<D>()?, input.rotations::<D>()?.unwrap_or_default());
    let (centers, points) = (vectors::<D>(centers, "centers")?, vectors::<D>(points, "points")?);
    let found = py.detach(|| fit(&tracks, &centers, &points, &rotations, weighting)).map_err(value_error)?;
    Ok(written(py, &found.into_iter().map(Some).collect::<Vec<_>>()))
}

fn read_weighting(name: &str, share: f64) -> PyResult<Weighting> {
    let choices = [("robust", Weighting::Robust), ("mean", Weighting::Mean), ("slowest", Weighting::Slowest { share })];
    choose("weighting", name, &choices)
}

/// Reads the options by name; every name that is not known is an error.
fn read_options(options: &Bound<'_, PyDict>) -> PyResult<MotionOptions> {
    let mut parsed = MotionOptions::default();
    let (mut weighting, mut share) = ("robust".to_owned(), 0.5);
    for (name, value) in options {
        match name.extract::<String>()?.as_str() {
            "flow" => {
                let choices = [("sphere", Flow::Sphere), ("horizon", Flow::Horizon)];
                parsed.flow = choose("flow", &value.extract::<String>()?, &choices)?;
            }
            "weighting" => weighting = value.extract()?,
            "share" => share = value.extract()?,
            "upright" if value.extract()? => parsed.vertical = Vertical::Upright,
            "upright" => {}
            "up" => parsed.vertical = Vertical::Up(vectors(&value.extract::<PyReadonlyArray2<'_, f64>>()?, "up")?),
            "time_s" => parsed.time_s = Some(value.extract::<PyReadonlyArray1<'_, f64>>()?.as_array().to_vec()),
            "min_tracks" => parsed.min_tracks = value.extract()?,
            other => return Err(PyValueError::new_err(format!("options has no entry {other:?}"))),
        }
    }
    parsed.weighting = read_weighting(&weighting, share)?;
    Ok(parsed)
}

/// Adds the functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(mean_motion, module)?)?;
    module.add_function(wrap_pyfunction!(fit_rotations, module)?)
}
