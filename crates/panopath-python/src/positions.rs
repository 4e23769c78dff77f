//! `solve_positions` and `position_covariance`: flat arrays in, a dict of arrays out.

use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{IntoPyArray, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use panopath::geometry::{Matrix, Vector};
use panopath::positions::{
    Control, Gauge, LinearForm, LinearGauge, LinearSolver, Method, PositionOptions, Structure,
    position_covariance as covariance_of, solve_positions as solve,
};
use panopath::{Rotation, Tracks};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{heading, value_error, vectors};

type Start<'py> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>);

/// Solves for positions (`panopath.steps.solve_positions` describes the arguments).
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn solve_positions<'py>(
    py: Python<'py>,
    view: PyReadonlyArray1<'py, i32>,
    track: PyReadonlyArray1<'py, i32>,
    bearing: PyReadonlyArray2<'py, f64>,
    n_views: usize,
    n_tracks: usize,
    sigma_rad: Option<PyReadonlyArray1<'py, f64>>,
    cam_from_world: Option<Bound<'py, PyAny>>,
    options: &Bound<'py, PyDict>,
    start: Option<Start<'py>>,
) -> PyResult<Bound<'py, PyDict>> {
    let input = Input { view, track, bearing, n_views, n_tracks, sigma_rad, cam_from_world };
    match input.dimension()? {
        2 => solve_in::<2>(py, &input, options, start, |r| {
            Ok(Array1::from_iter(r.iter().map(heading)).into_pyarray(py).into_any())
        }),
        _ => solve_in::<3>(py, &input, options, start, |r| {
            Ok(Array3::from_shape_fn((r.len(), 3, 3), |(i, a, b)| r[i].matrix()[a][b]).into_pyarray(py).into_any())
        }),
    }
}

fn solve_in<'py, const D: usize>(
    py: Python<'py>,
    input: &Input<'py>,
    options: &Bound<'py, PyDict>,
    start: Option<Start<'py>>,
    orientations: impl Fn(&[Rotation<D>]) -> PyResult<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let tracks = input.tracks::<D>()?;
    let rotations = input.rotations::<D>()?;
    let (mut parsed, threads) = read_options::<D>(options)?;
    parsed.start = start.map(|(c, p)| Ok::<_, PyErr>((vectors(&c, "centers")?, vectors(&p, "points")?))).transpose()?;
    let found = py.detach(|| on_threads(threads, || solve(&tracks, rotations.as_deref(), &parsed)))?;
    let structure = found.map_err(value_error)?;
    let dict = PyDict::new(py);
    dict.set_item("cam_from_world", orientations(&structure.cam_from_world)?)?;
    fill(&dict, structure)?;
    Ok(dict)
}

/// Runs on the caller's threads, or on a pool of the given size.
pub(crate) fn on_threads<R: Send>(threads: Option<usize>, task: impl FnOnce() -> R + Send) -> PyResult<R> {
    match threads {
        None => Ok(task()),
        Some(n) => {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build();
            Ok(pool.map_err(|e| PyValueError::new_err(format!("threads: {e}")))?.install(task))
        }
    }
}

fn fill<const D: usize>(dict: &Bound<'_, PyDict>, found: Structure<D>) -> PyResult<()> {
    let py = dict.py();
    let rows = |x: Vec<Vector<D>>| {
        let n = x.len();
        Array2::from_shape_vec((n, D), x.into_flattened()).map(|a| a.into_pyarray(py)).map_err(value_error)
    };
    dict.set_item("centers", rows(found.centers)?)?;
    dict.set_item("points", rows(found.points)?)?;
    dict.set_item("view_component", found.view_component.into_pyarray(py))?;
    dict.set_item("track_component", found.track_component.into_pyarray(py))?;
    dict.set_item("inlier", found.inlier.into_pyarray(py))?;
    dict.set_item("residual_rad", found.residual_rad.into_pyarray(py))?;
    let summary = found.summary;
    dict.set_item("status", summary.status.name())?;
    dict.set_item("iterations", summary.iterations)?;
    dict.set_item("sigma_rad", summary.sigma_rad)?;
    dict.set_item("n_components", summary.n_components)?;
    let seconds = PyDict::new(py);
    let t = summary.timings;
    for (stage, value) in [
        ("layout", t.layout_s),
        ("analyse", t.analyse_s),
        ("start", t.start_s),
        ("descent", t.descent_s),
        ("finish", t.finish_s),
        ("total", t.layout_s + t.analyse_s + t.start_s + t.descent_s + t.finish_s),
    ] {
        seconds.set_item(stage, value)?;
    }
    dict.set_item("seconds", seconds)
}

/// Covariance of the centres (`panopath.steps.position_covariance` describes the arguments).
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn position_covariance<'py>(
    py: Python<'py>,
    view: PyReadonlyArray1<'py, i32>,
    track: PyReadonlyArray1<'py, i32>,
    bearing: PyReadonlyArray2<'py, f64>,
    n_views: usize,
    n_tracks: usize,
    sigma_rad: Option<PyReadonlyArray1<'py, f64>>,
    cam_from_world: Option<Bound<'py, PyAny>>,
    centers: PyReadonlyArray2<'py, f64>,
    points: PyReadonlyArray2<'py, f64>,
    inlier: Option<PyReadonlyArray1<'py, bool>>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let input = Input { view, track, bearing, n_views, n_tracks, sigma_rad, cam_from_world };
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

/// Tracks, and orientations where a function takes them.
pub(crate) struct Input<'py> {
    pub view: PyReadonlyArray1<'py, i32>,
    pub track: PyReadonlyArray1<'py, i32>,
    pub bearing: PyReadonlyArray2<'py, f64>,
    pub n_views: usize,
    pub n_tracks: usize,
    pub sigma_rad: Option<PyReadonlyArray1<'py, f64>>,
    pub cam_from_world: Option<Bound<'py, PyAny>>,
}

impl Input<'_> {
    pub fn dimension(&self) -> PyResult<usize> {
        match self.bearing.as_array().ncols() {
            d @ (2 | 3) => Ok(d),
            other => Err(PyValueError::new_err(format!("bearing has {other} columns, expected 2 or 3"))),
        }
    }

    pub fn tracks<const D: usize>(&self) -> PyResult<Tracks<D>> {
        let ids = |array: &PyReadonlyArray1<'_, i32>, name: &str| -> PyResult<Vec<u32>> {
            let convert = |(k, &id): (usize, &i32)| {
                u32::try_from(id).map_err(|_| PyValueError::new_err(format!("{name}[{k}] is {id}, expected 0 or more")))
            };
            array.as_array().iter().enumerate().map(convert).collect()
        };
        let sigma = self.sigma_rad.as_ref().map(|s| s.as_array().to_vec());
        Tracks::new(
            ids(&self.view, "view")?,
            ids(&self.track, "track")?,
            vectors(&self.bearing, "bearing")?,
            sigma,
            self.n_views,
            self.n_tracks,
        )
        .map_err(value_error)
    }

    pub fn rotations<const D: usize>(&self) -> PyResult<Option<Vec<Rotation<D>>>>
    where
        Rotation<D>: FromHeadingOrMatrix,
    {
        self.cam_from_world.as_ref().map(Rotation::<D>::read_all).transpose()
    }
}

/// How orientations are written in Python: headings in the plane, matrices in space.
pub(crate) trait FromHeadingOrMatrix: Sized {
    fn read_all(array: &Bound<'_, PyAny>) -> PyResult<Vec<Self>>;
}

impl FromHeadingOrMatrix for Rotation<2> {
    fn read_all(array: &Bound<'_, PyAny>) -> PyResult<Vec<Self>> {
        let headings: PyReadonlyArray1<'_, f64> = array.extract()?;
        Ok(headings.as_array().iter().map(|&h| Rotation::from_angle(-h)).collect())
    }
}

impl FromHeadingOrMatrix for Rotation<3> {
    fn read_all(array: &Bound<'_, PyAny>) -> PyResult<Vec<Self>> {
        let matrices: PyReadonlyArray3<'_, f64> = array.extract()?;
        let matrices = matrices.as_array();
        if matrices.shape()[1..] != [3, 3] {
            return Err(PyValueError::new_err(format!(
                "cam_from_world has shape {:?}, expected (n_views, 3, 3)",
                matrices.shape()
            )));
        }
        matrices
            .outer_iter()
            .enumerate()
            .map(|(i, m)| {
                Rotation::from_matrix(std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)])))
                    .ok_or_else(|| PyValueError::new_err(format!("cam_from_world[{i}] is not a rotation matrix")))
            })
            .collect()
    }
}

/// Reads the options by name; every name that is not known is an error.
fn read_options<const D: usize>(options: &Bound<'_, PyDict>) -> PyResult<(PositionOptions<D>, Option<usize>)> {
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

pub(crate) fn choose<T: Clone>(what: &str, found: &str, choices: &[(&str, T)]) -> PyResult<T> {
    choices.iter().find(|(name, _)| *name == found).map(|(_, choice)| choice.clone()).ok_or_else(|| {
        let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
        PyValueError::new_err(format!("{what} is {found:?}, expected one of {}", names.join(", ")))
    })
}

/// Adds the functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(solve_positions, module)?)?;
    module.add_function(wrap_pyfunction!(position_covariance, module)?)
}
