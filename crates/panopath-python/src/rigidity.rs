//! `certify`: a scene in, a dict of what is determined out.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyReadonlyArray1};
use panopath::Rotation;
use panopath::geometry::Vector;
use panopath::rigidity::conditions::Cause;
use panopath::rigidity::{
    Certificate, CertifyOptions, OrientationModel, ReportedMode, RigidComponent, certify as certify_structure,
};
use panopath::structure::Structure;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::convert::{FromHeadingOrMatrix, Input, Observations, choose, on_threads, value_error};
use crate::refinement::{Start, read_structure};

/// Which observations count, and their residuals.
type Fit<'py> = (PyReadonlyArray1<'py, bool>, PyReadonlyArray1<'py, f64>);

/// Says what of a scene is determined (`panopath.steps.certify` describes the arguments).
#[pyfunction]
fn certify<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    cam_from_world: Bound<'py, PyAny>,
    scene: Start<'py>,
    fit: Fit<'py>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    let input = Input::new(observations, Some(cam_from_world));
    match input.dimension()? {
        2 => certify_in::<2, 3>(py, &input, &scene, &fit, options),
        _ => certify_in::<3, 6>(py, &input, &scene, &fit, options),
    }
}

fn certify_in<'py, const D: usize, const V: usize>(
    py: Python<'py>,
    input: &Input<'py>,
    scene: &Start<'py>,
    (inlier, residual): &Fit<'py>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let tracks = input.tracks::<D>()?;
    let structure = Structure {
        inlier: inlier.as_array().to_vec(),
        residual_rad: residual.as_array().to_vec(),
        ..read_structure::<D>(input, scene)?
    };
    let (parsed, threads) = read_options(options)?;
    let run = || certify_structure::<D, V>(&tracks, &structure, &parsed);
    let found = py.detach(|| on_threads(threads, run))?.map_err(value_error)?;
    write(py, found)
}

fn read_options(options: &Bound<'_, PyDict>) -> PyResult<(CertifyOptions, Option<usize>)> {
    let mut parsed = CertifyOptions::default();
    let mut threads = None;
    for (name, value) in options {
        match name.extract::<String>()?.as_str() {
            "orientation" => {
                parsed.orientation = choose(
                    "orientation",
                    &value.extract::<String>()?,
                    &[
                        ("known", OrientationModel::Known),
                        ("free", OrientationModel::Free),
                        ("vertical", OrientationModel::Vertical),
                    ],
                )?;
            }
            "sigma_rad" => parsed.sigma_rad = value.extract()?,
            "weak_movement" => parsed.weak_movement = value.extract()?,
            "threads" => threads = value.extract()?,
            other => return Err(PyValueError::new_err(format!("options has no entry {other:?}"))),
        }
    }
    Ok((parsed, threads))
}

fn write<'py, const D: usize>(py: Python<'py>, found: Certificate<D>) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("verdict", found.verdict.name())?;
    dict.set_item("nullity", found.nullity)?;
    dict.set_item("gauge_freedoms", found.gauge_freedoms)?;
    dict.set_item("gap", (found.last_null, found.first_other))?;
    let components = found.components.into_iter().map(|c| component(py, c)).collect::<PyResult<Vec<_>>>()?;
    dict.set_item("components", PyList::new(py, components)?)?;
    let modes = found.modes.into_iter().map(|m| mode(py, &m)).collect::<PyResult<Vec<_>>>()?;
    dict.set_item("modes", PyList::new(py, modes)?)?;
    dict.set_item("causes", write_causes(py, found.causes)?)?;
    dict.set_item("sigma_rad", found.sigma_rad)?;
    dict.set_item("sigma_source", found.sigma_source.name())?;
    dict.set_item("view_line", rows(&found.view_line).into_pyarray(py))?;
    dict.set_item("track_line", rows(&found.track_line).into_pyarray(py))?;
    dict.set_item("view_looseness", found.view_looseness.into_pyarray(py))?;
    dict.set_item("track_looseness", found.track_looseness.into_pyarray(py))?;
    Ok(dict)
}

fn component(py: Python<'_>, found: RigidComponent) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("views", indices(found.views).into_pyarray(py))?;
    dict.set_item("tracks", indices(found.tracks).into_pyarray(py))?;
    dict.set_item("n_observations", found.n_observations)?;
    dict.set_item("verdict", found.verdict.name())?;
    dict.set_item("weakest_movement", found.weakest_movement)?;
    Ok(dict)
}

fn mode<'py, const D: usize>(py: Python<'py>, found: &ReportedMode<D>) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("value", found.value)?;
    dict.set_item("is_null", found.is_null)?;
    dict.set_item("movement", found.movement)?;
    dict.set_item("component", found.component)?;
    dict.set_item("view_displacement", rows(&found.views).into_pyarray(py))?;
    dict.set_item("track_displacement", rows(&found.points).into_pyarray(py))?;
    dict.set_item("view_turn_rad", rows(&found.turns).into_pyarray(py))?;
    Ok(dict)
}

/// Causes as a list of dicts.
pub fn write_causes(py: Python<'_>, found: Vec<Cause>) -> PyResult<Bound<'_, PyList>> {
    let causes = found.into_iter().map(|c| cause(py, c)).collect::<PyResult<Vec<_>>>()?;
    PyList::new(py, causes)
}

fn cause(py: Python<'_>, found: Cause) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("kind", found.kind.name())?;
    dict.set_item("views", indices(found.views).into_pyarray(py))?;
    dict.set_item("tracks", indices(found.tracks).into_pyarray(py))?;
    dict.set_item("components", found.components)?;
    dict.set_item("detail", found.detail)?;
    dict.set_item("shape", found.shape.into_pyarray(py))?;
    dict.set_item("is_exact", found.is_exact)?;
    Ok(dict)
}

fn indices(ids: Vec<u32>) -> Vec<i32> {
    ids.into_iter().map(|id| id as i32).collect()
}

fn rows<const K: usize>(vectors: &[Vector<K>]) -> Array2<f64> {
    Array2::from_shape_fn((vectors.len(), K), |(r, c)| vectors[r][c])
}

/// Adds the function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(certify, module)?)
}
