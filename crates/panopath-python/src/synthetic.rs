//! `simulate`: a world's name and a dict of options in, a dict of arrays out.

use std::str::FromStr;

use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{IntoPyArray, PyArray1, PyArray2};
use panopath::synthetic::{Motion, World, WorldError, WorldKind, WorldOptions, simulate as simulate_world};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{heading, value_error};

/// Every option by name, `dimension` aside; the order in which they are documented.
const OPTION_NAMES: [&str; 30] = [
    "n_views",
    "n_points",
    "seed",
    "noise_rad",
    "angle_error_rad",
    "outlier_fraction",
    "mover_fraction",
    "mover_speed_m_s",
    "n_bodies",
    "operator_fraction",
    "infinity_fraction",
    "infinity_distance",
    "orientations",
    "orientation_error_rad",
    "frame_interval_s",
    "min_views",
    "max_views",
    "visible_fraction",
    "depth_min_m",
    "depth_max_m",
    "spacing_m",
    "wobble_m",
    "near_m",
    "go_views",
    "stop_views",
    "n_clusters",
    "n_links",
    "weak_mode",
    "conic",
    "off_conic",
];

/// Simulates a world (`panopath.synthetic.simulate` describes the options).
#[pyfunction]
#[pyo3(signature = (world, options))]
fn simulate<'py>(py: Python<'py>, world: &str, options: &Bound<'py, PyDict>) -> PyResult<Bound<'py, PyDict>> {
    let kind = WorldKind::from_str(world).map_err(value_error)?;
    let mut dimension = kind.dimensions()[0];
    let mut parsed = WorldOptions::default();
    for (name, value) in options {
        let name: String = name.extract()?;
        if name == "dimension" {
            dimension = read(&name, &value, "2 or 3")?;
        } else {
            set_option(&mut parsed, &name, &value)?;
        }
    }
    match dimension {
        2 => {
            let world = py.detach(|| simulate_world::<2>(kind, &parsed)).map_err(value_error)?;
            let heading_rad = Array1::from_iter(world.cam_from_world.iter().map(heading));
            to_dict(py, world, heading_rad.into_pyarray(py).into_any())
        }
        3 => {
            let world = py.detach(|| simulate_world::<3>(kind, &parsed)).map_err(value_error)?;
            let matrices = &world.cam_from_world;
            let stacked = Array3::from_shape_fn((matrices.len(), 3, 3), |(i, r, c)| matrices[i].matrix()[r][c]);
            to_dict(py, world, stacked.into_pyarray(py).into_any())
        }
        _ => Err(PyValueError::new_err(format!("dimension is {dimension}, expected 2 or 3"))),
    }
}

fn set_option(o: &mut WorldOptions, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let count = "a whole number, 0 or more";
    let number = "a number";
    let text = "a string";
    match name {
        "n_views" => o.n_views = read(name, value, count)?,
        "n_points" => o.n_points = read(name, value, count)?,
        "seed" => o.seed = read(name, value, count)?,
        "noise_rad" => o.noise_rad = read(name, value, number)?,
        "angle_error_rad" => o.angle_error_rad = read(name, value, number)?,
        "outlier_fraction" => o.outlier_fraction = read(name, value, number)?,
        "mover_fraction" => o.mover_fraction = read(name, value, number)?,
        "mover_speed_m_s" => o.mover_speed_m_s = read(name, value, number)?,
        "n_bodies" => o.n_bodies = read(name, value, count)?,
        "operator_fraction" => o.operator_fraction = read(name, value, number)?,
        "infinity_fraction" => o.infinity_fraction = read(name, value, number)?,
        "infinity_distance" => o.infinity_distance = read(name, value, "a pair of numbers")?,
        "orientations" => o.orientations = choice(name, value, text)?,
        "orientation_error_rad" => o.orientation_error_rad = read(name, value, number)?,
        "frame_interval_s" => o.frame_interval_s = read(name, value, number)?,
        "min_views" => o.min_views = read(name, value, count)?,
        "max_views" => o.max_views = read(name, value, count)?,
        "visible_fraction" => o.visible_fraction = read(name, value, number)?,
        "depth_min_m" => o.depth_min_m = read(name, value, number)?,
        "depth_max_m" => o.depth_max_m = read(name, value, number)?,
        "spacing_m" => o.spacing_m = read(name, value, number)?,
        "wobble_m" => o.wobble_m = read(name, value, number)?,
        "near_m" => o.near_m = read(name, value, number)?,
        "go_views" => o.go_views = read(name, value, count)?,
        "stop_views" => o.stop_views = read(name, value, count)?,
        "n_clusters" => o.n_clusters = read(name, value, count)?,
        "n_links" => o.n_links = read(name, value, count)?,
        "weak_mode" => o.weak_mode = optional_choice(name, value, text)?,
        "conic" => o.conic = optional_choice(name, value, text)?,
        "off_conic" => o.off_conic = read(name, value, number)?,
        _ => {
            let names = OPTION_NAMES.join(", ");
            return Err(PyValueError::new_err(format!(
                "option \"{name}\" is unknown, expected one of dimension, {names}"
            )));
        }
    }
    Ok(())
}

fn read<'py, T: FromPyObjectOwned<'py>>(name: &str, value: &Bound<'py, PyAny>, expected: &str) -> PyResult<T> {
    value.extract().map_err(|_| PyValueError::new_err(format!("{name} is {value}, expected {expected}")))
}

fn choice<T: FromStr<Err = WorldError>>(name: &str, value: &Bound<'_, PyAny>, expected: &str) -> PyResult<T> {
    T::from_str(&read::<String>(name, value, expected)?).map_err(value_error)
}

fn optional_choice<T: FromStr<Err = WorldError>>(
    name: &str,
    value: &Bound<'_, PyAny>,
    expected: &str,
) -> PyResult<Option<T>> {
    if value.is_none() { Ok(None) } else { choice(name, value, expected).map(Some) }
}

fn to_dict<'py, const D: usize>(
    py: Python<'py>,
    world: World<D>,
    cam_from_world: Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("view", ids(py, world.tracks.view()))?;
    dict.set_item("track", ids(py, world.tracks.track()))?;
    dict.set_item("bearing", rows(py, world.tracks.bearing()))?;
    dict.set_item("n_views", world.tracks.n_views())?;
    dict.set_item("n_tracks", world.tracks.n_tracks())?;
    dict.set_item("cam_from_world", cam_from_world)?;
    dict.set_item("centers", rows(py, &world.centers))?;
    dict.set_item("points", rows(py, &world.points))?;
    let moved = |m: &Motion<D>| match *m {
        Motion::Moves { body, velocity, acceleration } => (body as i32, velocity, acceleration),
        _ => (-1, [0.0; D], [0.0; D]),
    };
    let (mut body, mut velocity, mut acceleration) = (Vec::new(), Vec::new(), Vec::new());
    for (b, v, a) in world.motion.iter().map(moved) {
        body.push(b);
        velocity.push(v);
        acceleration.push(a);
    }
    let carried = Array1::from_iter(world.motion.iter().map(|m| matches!(m, Motion::Carried(_))));
    dict.set_item("body", body.into_pyarray(py))?;
    dict.set_item("velocity", rows(py, &velocity))?;
    dict.set_item("acceleration", rows(py, &acceleration))?;
    dict.set_item("carried", carried.into_pyarray(py))?;
    dict.set_item("point_time_s", world.point_time_s.into_pyarray(py))?;
    dict.set_item("outlier", world.outlier.into_pyarray(py))?;
    dict.set_item("time_s", world.time_s.into_pyarray(py))?;
    dict.set_item("noise_rad", world.noise_rad)?;
    Ok(dict)
}

fn ids<'py>(py: Python<'py>, ids: &[u32]) -> Bound<'py, PyArray1<i32>> {
    Array1::from_iter(ids.iter().map(|&id| id as i32)).into_pyarray(py)
}

fn rows<'py, const D: usize>(py: Python<'py>, vectors: &[[f64; D]]) -> Bound<'py, PyArray2<f64>> {
    Array2::from_shape_fn((vectors.len(), D), |(i, c)| vectors[i][c]).into_pyarray(py)
}

/// Adds this file's functions to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(simulate, module)?)
}
