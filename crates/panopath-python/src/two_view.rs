//! `relative_poses`: flat arrays of matches in, arrays with one entry a pair out.

use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use panopath::Rotation;
use panopath::geometry::Matrix;
use panopath::two_view::{
    KnownPose, TwoView, TwoViewOptions, TwoViewStatus, matches_that_agree as agreeing, relative_poses as solve,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{value_error, vectors};

/// Relative poses of many pairs (`panopath.steps.relative_poses` describes the arguments).
#[pyfunction]
fn relative_poses<'py>(
    py: Python<'py>,
    pair_start: PyReadonlyArray1<'py, i64>,
    first: PyReadonlyArray2<'py, f64>,
    second: PyReadonlyArray2<'py, f64>,
    second_from_first: Option<PyReadonlyArray3<'py, f64>>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    let options = read_options(options)?;
    let start = offsets(&pair_start)?;
    let (first, second) = (vectors::<3>(&first, "first")?, vectors::<3>(&second, "second")?);
    let known = second_from_first.map(|r| rotations(&r)).transpose()?;
    let views = py.detach(|| solve(&start, &first, &second, known.as_deref(), &options)).map_err(value_error)?;
    fill(py, &views)
}

/// Matches that agree with known poses (`panopath.steps.matches_that_agree` describes the arguments).
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn matches_that_agree<'py>(
    py: Python<'py>,
    pair_start: PyReadonlyArray1<'py, i64>,
    matches: PyReadonlyArray2<'py, i64>,
    bearing: PyReadonlyArray2<'py, f64>,
    tolerance_rad: PyReadonlyArray1<'py, f64>,
    second_from_first: PyReadonlyArray3<'py, f64>,
    baseline: PyReadonlyArray2<'py, f64>,
    limit_rad: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<bool>>> {
    let (start, turns) = (offsets(&pair_start)?, rotations(&second_from_first)?);
    let baselines = vectors::<3>(&baseline, "baseline")?;
    let limits = limit_rad.as_array().to_vec();
    let n = turns.len();
    if (baselines.len(), limits.len(), start.len()) != (n, n, n + 1) || start.windows(2).any(|w| w[0] > w[1]) {
        return Err(PyValueError::new_err(format!("expected pair_start, baseline and limit_rad of {n} pairs")));
    }
    let poses: Vec<KnownPose> = (turns.into_iter().zip(baselines).zip(limits))
        .map(|((second_from_first, baseline), limit_rad)| KnownPose { second_from_first, baseline, limit_rad })
        .collect();
    let table = matches.as_array();
    let pairs: Vec<[u32; 2]> = table.rows().into_iter().map(|r| [r[0] as u32, r[1] as u32]).collect();
    let (bearing, tolerance) = (vectors::<3>(&bearing, "bearing")?, tolerance_rad.as_array().to_vec());
    let found = py.detach(|| agreeing(&poses, &start, &pairs, &bearing, &tolerance));
    Ok(found.into_pyarray(py))
}

fn offsets(pair_start: &PyReadonlyArray1<'_, i64>) -> PyResult<Vec<usize>> {
    let convert = |(p, &row): (usize, &i64)| {
        usize::try_from(row).map_err(|_| PyValueError::new_err(format!("pair_start[{p}] is {row}, expected 0 or more")))
    };
    pair_start.as_array().iter().enumerate().map(convert).collect()
}

fn rotations(matrices: &PyReadonlyArray3<'_, f64>) -> PyResult<Vec<Rotation<3>>> {
    let matrices = matrices.as_array();
    if matrices.shape()[1..] != [3, 3] {
        return Err(PyValueError::new_err(format!(
            "second_from_first has shape {:?}, expected (n_pairs, 3, 3)",
            matrices.shape()
        )));
    }
    let read = |(p, m): (usize, numpy::ndarray::ArrayView2<'_, f64>)| {
        Rotation::from_matrix(std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)])))
            .ok_or_else(|| PyValueError::new_err(format!("second_from_first[{p}] is not a rotation matrix")))
    };
    matrices.outer_iter().enumerate().map(read).collect()
}

fn fill<'py>(py: Python<'py>, views: &[TwoView]) -> PyResult<Bound<'py, PyDict>> {
    let n = views.len();
    let unknown = [[f64::NAN; 3]; 3];
    let matrices = |of: &dyn Fn(&TwoView) -> Matrix<3>| {
        let all: Vec<Matrix<3>> = views.iter().map(of).collect();
        Array3::from_shape_fn((n, 3, 3), |(p, r, c)| all[p][r][c]).into_pyarray(py)
    };
    let rows =
        |of: &dyn Fn(&TwoView) -> [f64; 3]| Array2::from_shape_fn((n, 3), |(p, c)| of(&views[p])[c]).into_pyarray(py);
    let dict = PyDict::new(py);
    dict.set_item(
        "second_from_first",
        matrices(&|v| match v.status {
            TwoViewStatus::Undetermined => unknown,
            _ => *v.second_from_first.matrix(),
        }),
    )?;
    dict.set_item("direction", rows(&|v| v.direction))?;
    dict.set_item("rotation_covariance", matrices(&|v| v.rotation_covariance))?;
    dict.set_item("direction_covariance", matrices(&|v| v.direction_covariance))?;
    dict.set_item(
        "other_second_from_first",
        matrices(&|v| v.alternative.map_or(unknown, |(rotation, _)| *rotation.matrix())),
    )?;
    dict.set_item("other_direction", rows(&|v| v.alternative.map_or([f64::NAN; 3], |(_, direction)| direction)))?;
    dict.set_item("status", views.iter().map(|v| v.status.name()).collect::<Vec<_>>())?;
    dict.set_item("sigma_rad", views.iter().map(|v| v.sigma_rad).collect::<Vec<_>>().into_pyarray(py))?;
    dict.set_item(
        "n_inliers",
        views.iter().map(|v| i32::try_from(v.n_inliers).unwrap_or(i32::MAX)).collect::<Vec<_>>().into_pyarray(py),
    )?;
    let inlier: Vec<bool> = views.iter().flat_map(|v| v.inlier.iter().copied()).collect();
    dict.set_item("inlier", inlier.into_pyarray(py))?;
    Ok(dict)
}

/// Reads the options by name; every name that is not known is an error.
fn read_options(options: &Bound<'_, PyDict>) -> PyResult<TwoViewOptions> {
    let mut parsed = TwoViewOptions::default();
    for (name, value) in options {
        match name.extract::<String>()?.as_str() {
            "max_error_rad" => parsed.max_error_rad = value.extract()?,
            "confidence" => parsed.confidence = value.extract()?,
            "max_iterations" => parsed.max_iterations = value.extract()?,
            "seed" => parsed.seed = value.extract()?,
            "min_inliers" => parsed.min_inliers = value.extract()?,
            other => return Err(PyValueError::new_err(format!("options has no entry {other:?}"))),
        }
    }
    Ok(parsed)
}

/// Adds the function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(matches_that_agree, module)?)?;
    module.add_function(wrap_pyfunction!(relative_poses, module)?)
}
