//! `freedoms_of_paths`: a scene whose points move in, a dict of what is free out.

use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyReadonlyArray1, PyReadonlyArray2};
use panopath::geometry::Vector;
use panopath::paths::{
    Form, Freedom, FreedomOptions, MovingScene, NullVector, PathCertificate, TimeFunction, TrackReach,
    freedoms_of_paths as freedoms,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::convert::{on_threads, value_error, vectors};
use crate::paths::{FormArguments, form};

/// View and track of each observation that counts, and its standard deviation.
type Counted<'py> = (PyReadonlyArray1<'py, i32>, PyReadonlyArray1<'py, i32>, Option<PyReadonlyArray1<'py, f64>>);
/// Centres and times of the views; forms and coefficients of the tracks.
type Moving<'py> =
    (PyReadonlyArray2<'py, f64>, PyReadonlyArray1<'py, f64>, Vec<FormArguments>, PyReadonlyArray2<'py, f64>);

/// Says what the observations of a scene whose points move leave free (`panopath.steps.certify_paths` describes the arguments).
#[pyfunction]
fn freedoms_of_paths<'py>(
    py: Python<'py>,
    observations: Counted<'py>,
    scene: Moving<'py>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    match scene.0.as_array().ncols() {
        2 => freedoms_in::<2>(py, &observations, &scene, options),
        3 => freedoms_in::<3>(py, &observations, &scene, options),
        other => Err(PyValueError::new_err(format!("centers has {other} columns, expected 2 or 3"))),
    }
}

fn freedoms_in<'py, const D: usize>(
    py: Python<'py>,
    (view, track, sigma): &Counted<'py>,
    (centers, time_s, models, coefficients): &Moving<'py>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    let ids = |array: &PyReadonlyArray1<'py, i32>, name: &str| -> PyResult<Vec<u32>> {
        let convert = |(k, &id): (usize, &i32)| {
            u32::try_from(id).map_err(|_| PyValueError::new_err(format!("{name}[{k}] is {id}, expected 0 or more")))
        };
        array.as_array().iter().enumerate().map(convert).collect()
    };
    let (view, track) = (ids(view, "view")?, ids(track, "track")?);
    let sigma = sigma.as_ref().map_or(Vec::new(), |s| s.as_array().to_vec());
    let (centers, coefficients) = (vectors::<D>(centers, "centers")?, vectors::<D>(coefficients, "coefficients")?);
    let time_s = time_s.as_array().to_vec();
    let forms = models.iter().map(form).collect::<PyResult<Vec<Form>>>()?;
    let (parsed, threads) = read_options(options)?;
    let scene = MovingScene {
        view: &view,
        track: &track,
        sigma_rad: &sigma,
        centers: &centers,
        time_s: &time_s,
        forms: &forms,
        coefficients: &coefficients,
    };
    let found = py.detach(|| on_threads(threads, || freedoms(&scene, &parsed)))?.map_err(value_error)?;
    write(py, found)
}

fn read_options(options: &Bound<'_, PyDict>) -> PyResult<(FreedomOptions, Option<usize>)> {
    let (mut parsed, mut threads) = (FreedomOptions::default(), None);
    for (name, value) in options {
        match name.extract::<String>()?.as_str() {
            "sigma_rad" => parsed.sigma_rad = value.extract()?,
            "null_below" => parsed.null_below = value.extract()?,
            "refuse_movement" => parsed.refuse_movement = value.extract()?,
            "most_vectors" => parsed.most_vectors = value.extract()?,
            "threads" => threads = value.extract()?,
            other => return Err(PyValueError::new_err(format!("options has no entry {other:?}"))),
        }
    }
    Ok((parsed, threads))
}

fn write<'py, const D: usize>(py: Python<'py>, found: PathCertificate<D>) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("nullity", found.nullity)?;
    dict.set_item("gauge_freedoms", found.gauge_freedoms)?;
    dict.set_item("gap", found.gap)?;
    dict.set_item("weakest_movement", found.weakest_movement)?;
    dict.set_item("equations", found.equations)?;
    dict.set_item("unknowns", found.unknowns)?;
    let freedoms = found.freedoms.into_iter().map(|one| freedom(py, one)).collect::<PyResult<Vec<_>>>()?;
    dict.set_item("freedoms", PyList::new(py, freedoms)?)?;
    let tracks = &found.tracks;
    dict.set_item("reason", tracks.iter().map(|t| t.reason.name()).collect::<Vec<&str>>())?;
    dict.set_item("is_exact", tracks.iter().map(|t| t.is_exact).collect::<Vec<bool>>().into_pyarray(py))?;
    dict.set_item("dimension", tracks.iter().map(|t| t.dimension as i32).collect::<Vec<i32>>().into_pyarray(py))?;
    dict.set_item("hidden_by", tracks.iter().map(|t| t.hidden_by).collect::<Vec<i32>>().into_pyarray(py))?;
    let numbers = |of: fn(&TrackReach<D>) -> f64| tracks.iter().map(of).collect::<Vec<f64>>().into_pyarray(py);
    dict.set_item("movement", numbers(|t| t.movement))?;
    dict.set_item("camera_part", numbers(|t| t.camera_part))?;
    dict.set_item("noise_part", numbers(|t| t.noise_part))?;
    let loose = PyDict::new(py);
    for (id, reach) in tracks.iter().enumerate().filter(|(_, reach)| !reach.null.is_empty()) {
        let shape = (reach.null.len(), reach.null[0].len(), D);
        loose.set_item(id, Array3::from_shape_fn(shape, |(a, l, c)| reach.null[a][l][c]).into_pyarray(py))?;
    }
    dict.set_item("null", loose)?;
    Ok(dict)
}

fn freedom<const D: usize>(py: Python<'_>, found: Freedom<D>) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("kind", found.kind.name())?;
    let (order, omega, spline) = match found.function {
        TimeFunction::Any => (0, f64::NAN, -1),
        TimeFunction::Power(order) => (order, f64::NAN, -1),
        TimeFunction::Harmonic(order, omega) => (order, omega, -1),
        TimeFunction::SplineOf(track) => (0, f64::NAN, track as i32),
    };
    dict.set_item("order", order)?;
    dict.set_item("omega_rad_s", omega)?;
    dict.set_item("spline_of", spline)?;
    dict.set_item("dimension", found.dimension)?;
    dict.set_item("is_exact", found.is_exact)?;
    dict.set_item("part", found.part)?;
    let indices = |ids: Vec<u32>| ids.into_iter().map(|id| id as i32).collect::<Vec<i32>>().into_pyarray(py);
    dict.set_item("views", indices(found.views))?;
    dict.set_item("tracks", indices(found.tracks))?;
    let vectors = found.vectors.into_iter().map(|one| null_vector(py, one)).collect::<PyResult<Vec<_>>>()?;
    dict.set_item("vectors", PyList::new(py, vectors)?)?;
    Ok(dict)
}

fn null_vector<const D: usize>(py: Python<'_>, found: NullVector<D>) -> PyResult<Bound<'_, PyDict>> {
    let rows =
        |vectors: &[Vector<D>]| Array2::from_shape_fn((vectors.len(), D), |(r, c)| vectors[r][c]).into_pyarray(py);
    let dict = PyDict::new(py);
    dict.set_item("centers", rows(&found.centers))?;
    dict.set_item("coefficients", rows(&found.coefficients))?;
    dict.set_item("stretch", found.stretch.into_pyarray(py))?;
    dict.set_item("value", found.value)?;
    dict.set_item("movement", found.movement)?;
    Ok(dict)
}

/// Adds the function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(freedoms_of_paths, module)?)
}
