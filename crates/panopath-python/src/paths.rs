//! Functions of time, and bodies that move.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray1};
use panopath::Rotation;
use panopath::paths::{Assumption, Form, Motion, MovingStructure, Verdict, solve_paths as solve};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{FromHeadingOrMatrix, Input, Observations, fill, on_threads, value_error};
use crate::positions::{Start, read_started_options};

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

/// What Python says of motion: forms of path, which of them each track has (-1: found), candidates, and three choices.
type MotionArguments<'py> = (Vec<FormArguments>, PyReadonlyArray1<'py, i32>, Vec<FormArguments>, bool, bool, bool);

/// Solves for cameras and paths (`panopath.steps.solve_positions` describes the arguments).
#[pyfunction]
fn solve_paths<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    time_s: PyReadonlyArray1<'py, f64>,
    cam_from_world: Option<Bound<'py, PyAny>>,
    motion: MotionArguments<'py>,
    options: &Bound<'py, PyDict>,
    start: Option<Start<'py>>,
) -> PyResult<Bound<'py, PyDict>> {
    let input = Input::new(observations, cam_from_world);
    match input.dimension()? {
        2 => solve_in::<2, 3>(py, &input, time_s, motion, options, start),
        _ => solve_in::<3, 6>(py, &input, time_s, motion, options, start),
    }
}

fn solve_in<'py, const D: usize, const V: usize>(
    py: Python<'py>,
    input: &Input<'py>,
    time_s: PyReadonlyArray1<'py, f64>,
    motion: MotionArguments<'py>,
    options: &Bound<'py, PyDict>,
    start: Option<Start<'py>>,
) -> PyResult<Bound<'py, PyDict>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let tracks = input.tracks::<D>()?;
    let rotations = input.rotations::<D>()?;
    let (parsed, threads) = read_started_options::<D>(options, start)?;
    let (models, model, candidates, common_frequency, free_orientations, covariance) = motion;
    let models = models.iter().map(form).collect::<PyResult<Vec<Form>>>()?;
    let candidates = candidates.iter().map(form).collect::<PyResult<Vec<Form>>>()?;
    let of = |&index: &i32| match usize::try_from(index) {
        Ok(index) => models
            .get(index)
            .cloned()
            .map(Some)
            .ok_or_else(|| PyValueError::new_err(format!("there is no form of path {index}"))),
        Err(_) => Ok(None),
    };
    let forms = model.as_array().iter().map(of).collect::<PyResult<Vec<Option<Form>>>>()?;
    let time_s = time_s.as_array().to_vec();
    let motion = Motion { forms, candidates, common_frequency, free_orientations, covariance };
    let found =
        py.detach(|| on_threads(threads, || solve::<D, V>(&tracks, &time_s, rotations.as_deref(), &motion, &parsed)))?;
    let scene = found.map_err(value_error)?;
    let paths = paths_of(py, &scene)?;
    let answer = fill(py, scene.structure)?;
    answer.set_item("paths", paths)?;
    Ok(answer)
}

/// Paths as flat arrays.
fn paths_of<'py, const D: usize>(py: Python<'py>, scene: &MovingStructure<D>) -> PyResult<Bound<'py, PyDict>> {
    let n = scene.forms.len();
    let (mut kind, mut order, mut numbers, mut starts) = (Vec::with_capacity(n), Vec::new(), Vec::new(), vec![0i64]);
    for form in &scene.forms {
        let (name, degree, own): (i8, i32, Vec<f64>) = match form {
            Form::Static => (0, 0, Vec::new()),
            Form::Taylor { order, origin_s, unit_s } => (1, *order as i32, vec![*origin_s, *unit_s]),
            Form::Fourier { order, omega_rad_s } => (2, *order as i32, vec![*omega_rad_s]),
            Form::Spline { degree, breaks_s } => (3, *degree as i32, breaks_s.clone()),
        };
        kind.push(name);
        order.push(degree);
        numbers.extend(own);
        starts.push(numbers.len() as i64);
    }
    let paths = PyDict::new(py);
    paths.set_item("kind", kind.into_pyarray(py))?;
    paths.set_item("order", order.into_pyarray(py))?;
    paths.set_item("numbers", numbers.into_pyarray(py))?;
    paths.set_item("number_starts", starts.into_pyarray(py))?;
    let starts: Vec<i64> = scene.start.iter().map(|&s| s as i64).collect();
    paths.set_item("starts", starts.into_pyarray(py))?;
    let rows = scene.vectors.len();
    paths.set_item("coefficients", Array2::from_shape_fn((rows, D), |(r, c)| scene.vectors[r][c]).into_pyarray(py))?;
    paths.set_item("seen_s", Array2::from_shape_fn((n, 2), |(r, c)| scene.seen_s[r][c]).into_pyarray(py))?;
    let verdicts: Vec<&'static str> = scene.verdict.iter().map(|v| v.name()).collect();
    paths.set_item("verdicts", verdicts)?;
    let hidden: Vec<i32> =
        scene.verdict.iter().map(|v| if let Verdict::Hidden { by } = v { *by as i32 } else { -1 }).collect();
    paths.set_item("hidden_by", hidden.into_pyarray(py))?;
    let sizes: Vec<i64> = scene.covariance.iter().map(|block| block.len() as i64).collect();
    paths.set_item("covariance_sizes", sizes.into_pyarray(py))?;
    paths.set_item("covariances", scene.covariance.concat().into_pyarray(py))?;
    let (assumption, known) = match scene.assumption {
        Assumption::KnownStatic(n) => ("known_static", n),
        Assumption::MostStatic => ("most_static", 0),
        Assumption::LeastMotion => ("least_motion", 0),
    };
    paths.set_item("assumption", (assumption, known))?;
    paths.set_item("resolved", scene.resolved)?;
    Ok(paths)
}

/// Adds the functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(path_functions, module)?)?;
    module.add_function(wrap_pyfunction!(solve_paths, module)?)
}
