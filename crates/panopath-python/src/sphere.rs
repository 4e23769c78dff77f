//! The conversions of `panopath::sphere`, row by row over arrays. Python has checked that the rows are finite.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2};
use panopath::sphere::{self, Cylindrical, Equirectangular, Perspective};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

type Rows<'py> = PyReadonlyArray2<'py, f64>;
type Result<'py> = PyResult<Bound<'py, PyArray2<f64>>>;

/// Applies a conversion to every row of an array.
fn map<'py, const I: usize, const O: usize>(
    py: Python<'py>,
    rows: &Rows<'py>,
    convert: impl Fn([f64; I]) -> [f64; O] + Sync,
) -> Result<'py> {
    let rows = rows.as_array();
    if rows.ncols() != I {
        return Err(PyValueError::new_err(format!("array has {} columns, expected {I}", rows.ncols())));
    }
    let mut converted = Array2::zeros((rows.nrows(), O));
    py.detach(|| {
        for (row, mut out) in rows.rows().into_iter().zip(converted.rows_mut()) {
            let values = convert(std::array::from_fn(|c| row[c]));
            for (slot, value) in out.iter_mut().zip(values) {
                *slot = value;
            }
        }
    });
    Ok(converted.into_pyarray(py))
}

#[pyfunction]
fn bearings_from_spherical<'py>(py: Python<'py>, angle_rad: Rows<'py>) -> Result<'py> {
    map(py, &angle_rad, sphere::bearing_from_spherical)
}

#[pyfunction]
fn spherical_from_bearings<'py>(py: Python<'py>, bearing: Rows<'py>) -> Result<'py> {
    map(py, &bearing, sphere::spherical_from_bearing)
}

#[pyfunction]
fn bearings_from_circular<'py>(py: Python<'py>, theta_rad: Rows<'py>) -> Result<'py> {
    map(py, &theta_rad, |[theta_rad]| sphere::bearing_from_circular(theta_rad))
}

#[pyfunction]
fn circular_from_bearings<'py>(py: Python<'py>, bearing: Rows<'py>) -> Result<'py> {
    map(py, &bearing, |bearing| [sphere::circular_from_bearing(bearing)])
}

#[pyfunction]
fn bearings_from_compass<'py>(py: Python<'py>, angle_rad: Rows<'py>) -> Result<'py> {
    map(py, &angle_rad, sphere::bearing_from_compass)
}

#[pyfunction]
fn compass_from_bearings<'py>(py: Python<'py>, bearing: Rows<'py>) -> Result<'py> {
    map(py, &bearing, sphere::compass_from_bearing)
}

#[pyfunction]
fn bearings_from_planar_compass<'py>(py: Python<'py>, azimuth_rad: Rows<'py>) -> Result<'py> {
    map(py, &azimuth_rad, |[azimuth_rad]| sphere::bearing_from_planar_compass(azimuth_rad))
}

#[pyfunction]
fn planar_compass_from_bearings<'py>(py: Python<'py>, bearing: Rows<'py>) -> Result<'py> {
    map(py, &bearing, |bearing| [sphere::planar_compass_from_bearing(bearing)])
}

#[pyfunction]
fn bearings_from_cylindrical<'py>(py: Python<'py>, theta_height: Rows<'py>, radius: f64) -> Result<'py> {
    let camera = Cylindrical { radius };
    map(py, &theta_height, |row| camera.bearing(row))
}

#[pyfunction]
fn cylindrical_from_bearings<'py>(py: Python<'py>, bearing: Rows<'py>, radius: f64) -> Result<'py> {
    let camera = Cylindrical { radius };
    map(py, &bearing, |row| camera.angle_and_height(row))
}

#[pyfunction]
fn bearings_from_perspective<'py>(
    py: Python<'py>,
    pixel: Rows<'py>,
    focal_px: [f64; 2],
    principal_px: [f64; 2],
) -> Result<'py> {
    let camera = Perspective { focal_px, principal_px };
    map(py, &pixel, |row| camera.bearing(row))
}

#[pyfunction]
fn perspective_from_bearings<'py>(
    py: Python<'py>,
    bearing: Rows<'py>,
    focal_px: [f64; 2],
    principal_px: [f64; 2],
) -> Result<'py> {
    let camera = Perspective { focal_px, principal_px };
    map(py, &bearing, |row| camera.pixel(row))
}

#[pyfunction]
fn bearings_from_equirectangular<'py>(py: Python<'py>, pixel: Rows<'py>, width_px: f64, height_px: f64) -> Result<'py> {
    let camera = Equirectangular { width_px, height_px };
    map(py, &pixel, |row| camera.bearing(row))
}

#[pyfunction]
fn equirectangular_from_bearings<'py>(
    py: Python<'py>,
    bearing: Rows<'py>,
    width_px: f64,
    height_px: f64,
) -> Result<'py> {
    let camera = Equirectangular { width_px, height_px };
    map(py, &bearing, |row| camera.pixel(row))
}

/// 1 where the elevation of a bearing lies from `low_rad` to `high_rad`, else 0; one column.
#[pyfunction]
fn vertical_field_of_view<'py>(
    py: Python<'py>,
    bearing: Rows<'py>,
    low_rad: f64,
    high_rad: f64,
    y_down: bool,
) -> Result<'py> {
    let elevation = if y_down { sphere::elevation_y_down } else { sphere::elevation_z_up };
    map(py, &bearing, |row| [f64::from(sphere::is_in_vertical_field(elevation(row), low_rad, high_rad))])
}

/// Adds this file's functions to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(bearings_from_spherical, module)?)?;
    module.add_function(wrap_pyfunction!(spherical_from_bearings, module)?)?;
    module.add_function(wrap_pyfunction!(bearings_from_circular, module)?)?;
    module.add_function(wrap_pyfunction!(circular_from_bearings, module)?)?;
    module.add_function(wrap_pyfunction!(bearings_from_compass, module)?)?;
    module.add_function(wrap_pyfunction!(compass_from_bearings, module)?)?;
    module.add_function(wrap_pyfunction!(bearings_from_planar_compass, module)?)?;
    module.add_function(wrap_pyfunction!(planar_compass_from_bearings, module)?)?;
    module.add_function(wrap_pyfunction!(bearings_from_cylindrical, module)?)?;
    module.add_function(wrap_pyfunction!(cylindrical_from_bearings, module)?)?;
    module.add_function(wrap_pyfunction!(bearings_from_perspective, module)?)?;
    module.add_function(wrap_pyfunction!(perspective_from_bearings, module)?)?;
    module.add_function(wrap_pyfunction!(bearings_from_equirectangular, module)?)?;
    module.add_function(wrap_pyfunction!(equirectangular_from_bearings, module)?)?;
    module.add_function(wrap_pyfunction!(vertical_field_of_view, module)?)
}
