//! `render_walk`: a dict of options in, a walk out that renders one frame at a time.

use std::str::FromStr;

use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use panopath::synthetic::WorldError;
use panopath::synthetic::render::{Walk, WalkOptions, render_frame, render_ranges, walk};
use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{FromHeadingOrMatrix, value_error};

/// A walk that can be filmed (`panopath.walk.Walk` describes it).
#[pyclass(frozen)]
struct RenderedWalk {
    walk: Walk,
}

#[pymethods]
impl RenderedWalk {
    /// `(n, 3)`: where the camera is.
    #[getter]
    fn centers<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let centers = &self.walk.centers;
        Array2::from_shape_fn((centers.len(), 3), |(k, c)| centers[k][c]).into_pyarray(py)
    }

    /// `(n, 3, 3)`: how it is turned.
    #[getter]
    fn cam_from_world<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        panopath::Rotation::write_all(py, &self.walk.cam_from_world)
    }

    /// `(n,)`: when each frame is taken.
    #[getter]
    fn time_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        Array1::from_vec(self.walk.time_s.clone()).into_pyarray(py)
    }

    /// `(height, width, 3)`: frame `k`.
    fn frame<'py>(&self, py: Python<'py>, k: usize) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let bytes = py.detach(|| render_frame(&self.walk, k)).map_err(value_error)?;
        let shape = (self.walk.height_px(), self.walk.width_px(), 3);
        Ok(Array3::from_shape_vec(shape, bytes).map_err(value_error)?.into_pyarray(py))
    }

    /// `(height, width)`: distance to what each pixel of frame `k` shows.
    fn ranges<'py>(&self, py: Python<'py>, k: usize) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let ranges = py.detach(|| render_ranges(&self.walk, k)).map_err(value_error)?;
        let shape = (self.walk.height_px(), self.walk.width_px());
        Ok(Array2::from_shape_vec(shape, ranges).map_err(value_error)?.into_pyarray(py))
    }
}

/// Builds a walk (`panopath.walk.render_walk` describes the options).
#[pyfunction]
#[pyo3(signature = (options))]
fn render_walk(py: Python<'_>, options: &Bound<'_, PyDict>) -> PyResult<RenderedWalk> {
    let mut parsed = WalkOptions::default();
    for (name, value) in options {
        set_option(&mut parsed, &name.extract::<String>()?, &value)?;
    }
    let walk = py.detach(|| walk(&parsed)).map_err(value_error)?;
    Ok(RenderedWalk { walk })
}

fn set_option(o: &mut WalkOptions, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let (count, number) = ("a whole number, 0 or more", "a number");
    match name {
        "width_px" => o.width_px = read(name, value, count)?,
        "n_frames" => o.n_frames = read(name, value, count)?,
        "frame_rate_hz" => o.frame_rate_hz = read(name, value, number)?,
        "speed_m_s" => o.speed_m_s = read(name, value, number)?,
        "path" => o.path = choice(name, value)?,
        "rotation" => o.rotation = choice(name, value)?,
        "n_movers" => o.n_movers = read(name, value, count)?,
        "operator_share" => o.operator_share = read(name, value, number)?,
        "exposure_drift_stops" => o.exposure_drift_stops = read(name, value, number)?,
        "noise_gray" => o.noise_gray = read(name, value, number)?,
        "seed" => o.seed = read(name, value, count)?,
        _ => return Err(PyValueError::new_err(format!("option \"{name}\" is unknown"))),
    }
    Ok(())
}

fn read<'py, T: FromPyObjectOwned<'py>>(name: &str, value: &Bound<'py, PyAny>, expected: &str) -> PyResult<T> {
    value.extract().map_err(|_| PyValueError::new_err(format!("{name} is {value}, expected {expected}")))
}

fn choice<T: FromStr<Err = WorldError>>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<T> {
    T::from_str(&read::<String>(name, value, "a string")?).map_err(value_error)
}

/// Length of a lap of the closed path.
#[pyfunction]
fn walk_lap_m() -> f64 {
    Walk::lap_m()
}

/// Adds this file's functions to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<RenderedWalk>()?;
    module.add_function(wrap_pyfunction!(walk_lap_m, module)?)?;
    module.add_function(wrap_pyfunction!(render_walk, module)?)
}
