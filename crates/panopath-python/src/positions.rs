//! `solve_positions` and `position_covariance`: flat arrays in, a dict of arrays out.

use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use panopath::Rotation;
use panopath::geometry::{Matrix, Vector};
use panopath::positions::{
    Control, Gauge, LinearForm, LinearGauge, LinearSolver, Method, PositionOptions,
    position_covariance as covariance_of, solve_positions as solve,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{FromHeadingOrMatrix, Input, Observations, choose, fill, on_threads, value_error, vectors};

pub type Start<'py> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>);

/// Solves for positions (`panopath.steps.solve_positions` describes the arguments).
#[pyfunction]
fn solve_positions<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    cam_from_world: Option<Bound<'py, PyAny>>,
    options: &Bound<'py, PyDict>,
    start: Option<Start<'py>>,
) -> PyResult<Bound<'py, PyDict>> {
    let input = Input::new(observations, cam_from_world);
    match input.dimension()? {
        2 => solve_in::<2>(py, &input, options, start),
        _ => solve_in::<3>(py, &input, options, start),
    }
}

fn solve_in<'py, const D: usize>(
    py: Python<'py>,
    input: &Input<'py>,
    options: &Bound<'py, PyDict>,
    start: Option<Start<'py>>,
) -> PyResult<Bound<'py, PyDict>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let tracks = input.tracks::<D>()?;
    let rotations = input.rotations::<D>()?;
    let (parsed, threads) = read_started_options::<D>(options, start)?;
    let found = py.detach(|| on_threads(threads, || solve(&tracks, rotations.as_deref(), &parsed)))?;
    fill(py, found.map_err(value_error)?)
}

/// Covariance of the centres (`panopath.steps.position_covariance` describes the arguments).
#[pyfunction]
fn position_covariance<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    cam_from_world: Option<Bound<'py, PyAny>>,
    centers: PyReadonlyArray2<'py, f64>,
    points: PyReadonlyArray2<'py, f64>,
    inlier: Option<PyReadonlyArray1<'py, bool>>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let input = Input::new(observations, cam_from_world);
    match input.dimension()? {
        2 => covariance_in::<2>(py, &input, centers, points, inlier),
        _ => covariance_in::<3>(py, &input, centers, points, inlier),
    }
}

fn covariance_in<'py, const D: usize>(
    py: Python<'py>,
    input: &Input<'py>,
    centers: PyReadonlyArray2<'py, f64>,
    points: PyReadonlyArray2<'py, f64>,
    inlier: Option<PyReadonlyArray1<'py, bool>>,
) -> PyResult<Bound<'py, PyArray3<f64>>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let tracks = input.tracks::<D>()?;
    let rotations = input.rotations::<D>()?;
    let (centers, points) = (vectors::<D>(&centers, "centers")?, vectors::<D>(&points, "points")?);
    let keep = inlier.map(|k| k.as_array().to_vec());
    if let Some(k) = &keep
        && k.len() != tracks.len()
    {
        return Err(PyValueError::new_err(format!(
            "inlier has {} entries, but there are {} observations",
            k.len(),
            tracks.len()
        )));
    }
    let blocks: Vec<Matrix<D>> = py
        .detach(|| covariance_of(&tracks, rotations.as_deref(), &centers, &points, 1.0, keep.as_deref()))
        .map_err(value_error)?;
    Ok(Array3::from_shape_fn((blocks.len(), D, D), |(i, r, c)| blocks[i][r][c]).into_pyarray(py))
}

/// Reads the options, and where to start from.
pub fn read_started_options<const D: usize>(
    options: &Bound<'_, PyDict>,
    start: Option<Start<'_>>,
) -> PyResult<(PositionOptions<D>, Option<usize>)> {
    let (mut parsed, threads) = read_options(options)?;
    parsed.start = start.map(|(c, p)| Ok::<_, PyErr>((vectors(&c, "centers")?, vectors(&p, "points")?))).transpose()?;
    Ok((parsed, threads))
}

/// Reads the options by name; every name that is not known is an error.
pub fn read_options<const D: usize>(options: &Bound<'_, PyDict>) -> PyResult<(PositionOptions<D>, Option<usize>)> {
    let mut parsed = PositionOptions::<D>::default();
    let (mut method, mut form, mut axis, mut linear_gauge) =
        ("robust".to_owned(), "joint".to_owned(), 2usize, "functional".to_owned());
    let (mut gauge, mut control, mut threads) = ("normalized".to_owned(), Control::<D>::default(), None);
    let mut known = Known::default();
    for (name, value) in options {
        match name.extract::<String>()?.as_str() {
            "method" => method = value.extract()?,
            "linear_form" => form = value.extract()?,
            "vertical_axis" => axis = value.extract()?,
            "linear_gauge" => linear_gauge = value.extract()?,
            "gauge" => gauge = value.extract()?,
            "linear_solver" => {
                parsed.linear_solver = choose(
                    "linear_solver",
                    &value.extract::<String>()?,
                    &[
                        ("auto", LinearSolver::Auto),
                        ("direct", LinearSolver::Direct),
                        ("iterative", LinearSolver::Iterative),
                    ],
                )?;
            }
            "split_parts" => parsed.split_parts = value.extract()?,
            "max_iterations" => parsed.max_iterations = value.extract()?,
            "threads" => threads = value.extract()?,
            "control_rotation" => control.rotation = value.extract()?,
            "control_views" => known.views = value.extract()?,
            "control_view_positions" => known.view_positions = Some(value.extract()?),
            "control_tracks" => known.tracks = value.extract()?,
            "control_track_positions" => known.track_positions = Some(value.extract()?),
            other => return Err(PyValueError::new_err(format!("options has no entry {other:?}"))),
        }
    }
    control.views = pair("control_view_positions", &known.views, known.view_positions)?;
    control.tracks = pair("control_track_positions", &known.tracks, known.track_positions)?;
    let form = choose(
        "linear_form",
        &form,
        &[("joint", LinearForm::Joint), ("two_stage", LinearForm::TwoStage { vertical_axis: axis })],
    )?;
    let linear_gauge = choose(
        "linear_gauge",
        &linear_gauge,
        &[
            ("functional", LinearGauge::Functional),
            ("paper", LinearGauge::Paper),
            ("paper_distance", LinearGauge::PaperDistance),
        ],
    )?;
    // the plane has a single form, whatever was asked for
    let form = if D == 2 { LinearForm::Joint } else { form };
    parsed.method = choose(
        "method",
        &method,
        &[("robust", Method::Robust), ("linear", Method::Linear { form, gauge: linear_gauge })],
    )?;
    parsed.gauge = choose(
        "gauge",
        &gauge,
        &[
            ("normalized", Gauge::Normalized),
            ("paper", Gauge::Paper),
            ("paper_distance", Gauge::PaperDistance),
            ("control", Gauge::Control(control)),
        ],
    )?;
    Ok((parsed, threads))
}

/// Control as it comes from Python.
#[derive(Default)]
struct Known<'py> {
    views: Vec<u32>,
    view_positions: Option<PyReadonlyArray2<'py, f64>>,
    tracks: Vec<u32>,
    track_positions: Option<PyReadonlyArray2<'py, f64>>,
}

fn pair<const D: usize>(
    name: &str,
    ids: &[u32],
    positions: Option<PyReadonlyArray2<'_, f64>>,
) -> PyResult<Vec<(u32, Vector<D>)>> {
    let positions = positions.map(|p| vectors::<D>(&p, name)).transpose()?.unwrap_or_default();
    if positions.len() != ids.len() {
        return Err(PyValueError::new_err(format!("{name} has {} rows, expected {}", positions.len(), ids.len())));
    }
    Ok(ids.iter().copied().zip(positions).collect())
}

/// Adds the functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(solve_positions, module)?)?;
    module.add_function(wrap_pyfunction!(position_covariance, module)?)
}
