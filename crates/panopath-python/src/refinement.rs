//! `refine`: flat arrays in, a dict of arrays out.

use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use panopath::geometry::Matrix;
use panopath::refinement::{
    CovarianceGauge, DirectionPrior, PositionPrior, RefineOptions, Rig, RotationPrior, covariance,
    refine as refine_structure,
};
use panopath::structure::{Status, Structure, Summary, Timings};
use panopath::{LinearSolver, Rotation};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{FromHeadingOrMatrix, Input, Observations, choose, fill, on_threads, value_error, vectors};

/// Where a refinement starts: centres, points, and the component of each view and track.
pub type Start<'py> =
    (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>, PyReadonlyArray1<'py, i32>, PyReadonlyArray1<'py, i32>);

/// Refines orientations, centres and points (`panopath.steps.refine` describes the arguments).
#[pyfunction]
fn refine<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    cam_from_world: Option<Bound<'py, PyAny>>,
    start: Start<'py>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    let input = Input::new(observations, cam_from_world);
    match input.dimension()? {
        2 => refine_in::<2, 3>(py, &input, &start, options),
        _ => refine_in::<3, 6>(py, &input, &start, options),
    }
}

fn refine_in<'py, const D: usize, const V: usize>(
    py: Python<'py>,
    input: &Input<'py>,
    start: &Start<'py>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let tracks = input.tracks::<D>()?;
    let structure = read_structure::<D>(input, start)?;
    let (parsed, threads) = read_options::<D>(options)?;
    let found = py.detach(|| on_threads(threads, || refine_structure::<D, V>(&tracks, &structure, &parsed)))?;
    fill(py, found.map_err(value_error)?)
}

/// Covariances of cameras and points (`panopath.steps.scene_covariance` describes the arguments).
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn scene_covariance<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    cam_from_world: Option<Bound<'py, PyAny>>,
    start: Start<'py>,
    inlier: Option<PyReadonlyArray1<'py, bool>>,
    reference: Option<u32>,
    sigma: f64,
    options: &Bound<'py, PyDict>,
) -> PyResult<Blocks<'py>> {
    let input = Input::new(observations, cam_from_world);
    let keep = inlier.map(|k| k.as_array().to_vec()).unwrap_or_default();
    let gauge = reference.map_or(CovarianceGauge::Cameras, CovarianceGauge::View);
    match input.dimension()? {
        2 => covariance_in::<2, 3>(py, &input, &start, keep, gauge, sigma, options),
        _ => covariance_in::<3, 6>(py, &input, &start, keep, gauge, sigma, options),
    }
}

/// Covariances of the cameras and of the points.
type Blocks<'py> = (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>);

fn covariance_in<'py, const D: usize, const V: usize>(
    py: Python<'py>,
    input: &Input<'py>,
    start: &Start<'py>,
    keep: Vec<bool>,
    gauge: CovarianceGauge,
    sigma: f64,
    options: &Bound<'py, PyDict>,
) -> PyResult<Blocks<'py>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let tracks = input.tracks::<D>()?;
    let structure = Structure { inlier: keep, ..read_structure::<D>(input, start)? };
    let (parsed, threads) = read_options::<D>(options)?;
    let run = || covariance::<D, V>(&tracks, &structure, &parsed, gauge, sigma);
    let found = py.detach(|| on_threads(threads, run))?.map_err(value_error)?;
    let cameras = Array3::from_shape_fn((found.cameras.len(), V, V), |(i, r, c)| found.cameras[i][r][c]);
    let points = Array3::from_shape_fn((found.points.len(), D, D), |(i, r, c)| found.points[i][r][c]);
    Ok((cameras.into_pyarray(py), points.into_pyarray(py)))
}

/// The structure that a step starts from.
pub fn read_structure<const D: usize>(input: &Input<'_>, start: &Start<'_>) -> PyResult<Structure<D>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let (centers, points, view_component, track_component) = start;
    let rotations = input.rotations::<D>()?;
    Ok(Structure {
        centers: vectors(centers, "centers")?,
        points: vectors(points, "points")?,
        view_component: view_component.as_array().to_vec(),
        track_component: track_component.as_array().to_vec(),
        inlier: Vec::new(),
        residual_rad: Vec::new(),
        cam_from_world: rotations.unwrap_or_else(|| vec![Rotation::identity(); input.n_views]),
        summary: Summary {
            status: Status::Converged,
            iterations: 0,
            sigma_rad: f64::NAN,
            n_components: 0,
            timings: Timings::default(),
        },
    })
}

/// Reads the options by name; every name that is not known is an error.
fn read_options<const D: usize>(options: &Bound<'_, PyDict>) -> PyResult<(RefineOptions<D>, Option<usize>)>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let mut parsed = RefineOptions::<D>::default();
    let mut threads = None;
    for (name, value) in options {
        match name.extract::<String>()?.as_str() {
            "hold_rotations" => parsed.held.rotations = value.extract()?,
            "hold_centers" => parsed.held.centers = value.extract()?,
            "hold_points" => parsed.held.points = value.extract()?,
            "rotation_priors" => parsed.priors.rotations = rotation_priors(&value)?,
            "direction_priors" => parsed.priors.directions = direction_priors(&value)?,
            "position_priors" => parsed.priors.positions = position_priors(&value)?,
            "rig" => parsed.rig = read_rig(&value)?,
            "huber_sigmas" => parsed.huber_sigmas = value.extract()?,
            "reject_outliers" => parsed.reject_outliers = value.extract()?,
            "max_iterations" => parsed.max_iterations = value.extract()?,
            "linear_solver" => parsed.linear_solver = linear_solver(&value)?,
            "threads" => threads = value.extract()?,
            other => return Err(PyValueError::new_err(format!("options has no entry {other:?}"))),
        }
    }
    Ok((parsed, threads))
}

/// The linear solver of this name.
pub fn linear_solver(value: &Bound<'_, PyAny>) -> PyResult<LinearSolver> {
    choose(
        "linear_solver",
        &value.extract::<String>()?,
        &[("auto", LinearSolver::Auto), ("direct", LinearSolver::Direct), ("iterative", LinearSolver::Iterative)],
    )
}

fn matrices<const D: usize>(array: &PyReadonlyArray3<'_, f64>, name: &str) -> PyResult<Vec<Matrix<D>>> {
    let array = array.as_array();
    if array.shape()[1..] != [D, D] {
        let shape = array.shape();
        return Err(PyValueError::new_err(format!("{name} has shape {shape:?}, expected (n, {D}, {D})")));
    }
    let matrix = |m: numpy::ndarray::ArrayView2<'_, f64>| std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]));
    Ok(array.outer_iter().map(matrix).collect())
}

fn equal_lengths(what: &str, lengths: &[usize]) -> PyResult<()> {
    if lengths.iter().any(|&n| n != lengths[0]) {
        return Err(PyValueError::new_err(format!("{what} have arrays of {lengths:?} rows, expected equal numbers")));
    }
    Ok(())
}

/// `(view, cam_from_world, covariance)`.
fn rotation_priors<const D: usize>(value: &Bound<'_, PyAny>) -> PyResult<Vec<RotationPrior<D>>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let (views, rotations, covariances): (Vec<u32>, Bound<'_, PyAny>, PyReadonlyArray3<'_, f64>) = value.extract()?;
    let rotations = Rotation::<D>::read_all(&rotations)?;
    let covariances = matrices::<D>(&covariances, "covariance")?;
    equal_lengths("rotation_priors", &[views.len(), rotations.len(), covariances.len()])?;
    let rows = views.into_iter().zip(rotations).zip(covariances);
    Ok(rows.map(|((view, cam_from_world), covariance)| RotationPrior { view, cam_from_world, covariance }).collect())
}

/// `(view, bearing, direction, sigma_rad)`.
fn direction_priors<const D: usize>(value: &Bound<'_, PyAny>) -> PyResult<Vec<DirectionPrior<D>>> {
    type Columns<'py> = (Vec<u32>, PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>, PyReadonlyArray1<'py, f64>);
    let (views, bearings, directions, sigmas): Columns<'_> = value.extract()?;
    let (bearings, directions) = (vectors::<D>(&bearings, "bearing")?, vectors::<D>(&directions, "direction")?);
    let sigmas = sigmas.as_array().to_vec();
    equal_lengths("direction_priors", &[views.len(), bearings.len(), directions.len(), sigmas.len()])?;
    let rows = views.into_iter().zip(bearings).zip(directions).zip(sigmas);
    let prior = |(((view, bearing), direction), sigma_rad)| DirectionPrior { view, bearing, direction, sigma_rad };
    Ok(rows.map(prior).collect())
}

/// `(view, center, covariance)`.
fn position_priors<const D: usize>(value: &Bound<'_, PyAny>) -> PyResult<Vec<PositionPrior<D>>> {
    let (views, centers, covariances): (Vec<u32>, PyReadonlyArray2<'_, f64>, PyReadonlyArray3<'_, f64>) =
        value.extract()?;
    let (centers, covariances) = (vectors::<D>(&centers, "center")?, matrices::<D>(&covariances, "covariance")?);
    equal_lengths("position_priors", &[views.len(), centers.len(), covariances.len()])?;
    let rows = views.into_iter().zip(centers).zip(covariances);
    Ok(rows.map(|((view, center), covariance)| PositionPrior { view, center, covariance }).collect())
}

/// `(sensor, center)`, or nothing.
pub fn read_rig<const D: usize>(value: &Bound<'_, PyAny>) -> PyResult<Option<Rig<D>>> {
    type Columns<'py> = (PyReadonlyArray1<'py, i32>, PyReadonlyArray2<'py, f64>);
    let Some((sensor, center)) = value.extract::<Option<Columns<'_>>>()? else { return Ok(None) };
    let index = |&s: &i32| u32::try_from(s).map_err(|_| PyValueError::new_err(format!("sensor {s} is negative")));
    let sensor = sensor.as_array().iter().map(index).collect::<PyResult<Vec<u32>>>()?;
    Ok(Some(Rig { sensor, center: vectors(&center, "sensor centers")? }))
}

/// Adds the functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(refine, module)?)?;
    module.add_function(wrap_pyfunction!(scene_covariance, module)?)
}
