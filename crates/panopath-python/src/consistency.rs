//! `check_consistency`: a scene in, sentences and figures out.

use numpy::PyReadonlyArray1;
use panopath::Rotation;
use panopath::consistency::{ConsistencyOptions, check_consistency as check};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{FromHeadingOrMatrix, Input, Observations, on_threads, value_error};
use crate::refinement::{Start, read_structure};

/// One sentence for each test that failed, and every figure with its limit.
type Found = (Vec<String>, Vec<(&'static str, f64, f64)>);

/// Checks a scene (`panopath.steps.consistency` describes the arguments).
#[pyfunction]
fn check_consistency<'py>(
    py: Python<'py>,
    observations: Observations<'py>,
    cam_from_world: Option<Bound<'py, PyAny>>,
    scene: Start<'py>,
    inlier: PyReadonlyArray1<'py, bool>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Found> {
    let input = Input::new(observations, cam_from_world);
    let used = inlier.as_array().to_vec();
    match input.dimension()? {
        2 => check_in::<2, 3>(py, &input, &scene, used, options),
        _ => check_in::<3, 6>(py, &input, &scene, used, options),
    }
}

fn check_in<'py, const D: usize, const V: usize>(
    py: Python<'py>,
    input: &Input<'py>,
    scene: &Start<'py>,
    inlier: Vec<bool>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Found>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let tracks = input.tracks::<D>()?;
    let mut structure = read_structure::<D>(input, scene)?;
    structure.inlier = inlier;
    let (parsed, threads) = read_options(options)?;
    let found = py.detach(|| on_threads(threads, || check::<D, V>(&tracks, &structure, &parsed)))?;
    let found = found.map_err(value_error)?;
    let reasons = found.findings.iter().map(ToString::to_string).collect();
    Ok((reasons, found.statistics.iter().map(|s| (s.name, s.value, s.limit)).collect()))
}

/// Reads the options by name; every name that is not known is an error.
fn read_options(options: &Bound<'_, PyDict>) -> PyResult<(ConsistencyOptions, Option<usize>)> {
    let mut parsed = ConsistencyOptions::default();
    let mut threads = None;
    for (name, value) in options {
        match name.extract::<String>()?.as_str() {
            "max_noise_rad" => parsed.max_noise_rad = value.extract()?,
            "max_noise_ratio" => parsed.max_noise_ratio = value.extract()?,
            "max_misfit_share" => parsed.max_misfit_share = value.extract()?,
            "max_lost_share" => parsed.max_lost_share = value.extract()?,
            "max_behind_share" => parsed.max_behind_share = value.extract()?,
            "max_unplaced_share" => parsed.max_unplaced_share = value.extract()?,
            "pair_chance" => parsed.pair_chance = value.extract()?,
            "max_tension" => parsed.max_tension = value.extract()?,
            "max_near_strain" => parsed.max_near_strain = value.extract()?,
            "max_far_strain" => parsed.max_far_strain = value.extract()?,
            "threads" => threads = value.extract()?,
            other => return Err(PyValueError::new_err(format!("options has no entry {other:?}"))),
        }
    }
    Ok((parsed, threads))
}

/// Adds the function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(check_consistency, module)?)
}
