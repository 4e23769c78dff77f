//! `average_rotations`: flat arrays in, a dict of arrays out.

use numpy::ndarray::{Array1, Array3};
use numpy::{IntoPyArray, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use panopath::Rotation;
use panopath::geometry::{Matrix, Vector};
use panopath::least_squares::LinearSolver;
use panopath::orientation::{
    OrientationOptions, OrientationPrior, Orientations, PriorKind, RelativeRotation, average_rotations as average,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::convert::{heading, value_error, vectors};

/// Averages rotations (`panopath.steps.average_rotations` describes the arguments). `priors` is a list of
/// `(kind, views, arrays ...)`; the positions of their entries in it, one after the other, are the indices that errors name.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn average_rotations<'py>(
    py: Python<'py>,
    first: PyReadonlyArray1<'py, i32>,
    second: PyReadonlyArray1<'py, i32>,
    second_from_first: &Bound<'py, PyAny>,
    n_views: usize,
    sigma_rad: PyReadonlyArray1<'py, f64>,
    priors: &Bound<'py, PyList>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    let pairs = Pairs { first, second, sigma_rad };
    let (chosen, threads) = read_options(options)?;
    if let Ok(turns) = second_from_first.extract::<PyReadonlyArray1<'py, f64>>() {
        let relative: Vec<Rotation<2>> = turns.as_array().iter().map(|&h| Rotation::from_angle(-h)).collect();
        let priors = read_priors(priors, planar_orientations)?;
        let edges = pairs.edges(&relative)?;
        let found = run(py, threads, || average(n_views, &edges, &priors, &chosen))?;
        let headings = Array1::from_iter(found.cam_from_world.iter().map(heading)).into_pyarray(py).into_any();
        return filled(py, headings, found);
    }
    let relative = rotations(&second_from_first.extract()?, "second_from_first")?;
    let priors = read_priors(priors, |array, name| rotations(&array.extract()?, name))?;
    let edges = pairs.edges(&relative)?;
    let found = run(py, threads, || average(n_views, &edges, &priors, &chosen))?;
    let r = &found.cam_from_world;
    let matrices = Array3::from_shape_fn((r.len(), 3, 3), |(i, a, b)| r[i].matrix()[a][b]).into_pyarray(py).into_any();
    filled(py, matrices, found)
}

struct Pairs<'py> {
    first: PyReadonlyArray1<'py, i32>,
    second: PyReadonlyArray1<'py, i32>,
    sigma_rad: PyReadonlyArray1<'py, f64>,
}

impl Pairs<'_> {
    fn edges<const D: usize>(&self, relative: &[Rotation<D>]) -> PyResult<Vec<RelativeRotation<D>>> {
        let (first, second, sigma) = (self.first.as_array(), self.second.as_array(), self.sigma_rad.as_array());
        let view = |name: &str, k: usize, id: i32| {
            u32::try_from(id).map_err(|_| PyValueError::new_err(format!("{name}[{k}] is {id}, expected 0 or more")))
        };
        for (name, found) in
            [("second", second.len()), ("second_from_first", relative.len()), ("sigma_rad", sigma.len())]
        {
            if found != first.len() {
                return Err(PyValueError::new_err(format!("{name} has {found} rows, expected {}", first.len())));
            }
        }
        (0..first.len())
            .map(|k| {
                Ok(RelativeRotation {
                    first: view("first", k, first[k])?,
                    second: view("second", k, second[k])?,
                    second_from_first: relative[k],
                    sigma_rad: sigma[k],
                })
            })
            .collect()
    }
}

/// Runs without Python's lock, on the caller's threads or on a pool of the given size.
fn run<R: Send, E: std::fmt::Display + Send>(
    py: Python<'_>,
    threads: Option<usize>,
    task: impl FnOnce() -> Result<R, E> + Send,
) -> PyResult<R> {
    let pool = threads.map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build()).transpose();
    let pool = pool.map_err(|e| PyValueError::new_err(format!("threads: {e}")))?;
    let found = py.detach(|| match &pool {
        None => task(),
        Some(pool) => pool.install(task),
    });
    found.map_err(value_error)
}

fn rotations(array: &PyReadonlyArray3<'_, f64>, name: &str) -> PyResult<Vec<Rotation<3>>> {
    let array = array.as_array();
    if array.shape()[1..] != [3, 3] {
        return Err(PyValueError::new_err(format!("{name} has shape {:?}, expected (n, 3, 3)", array.shape())));
    }
    let read = |(k, m): (usize, numpy::ndarray::ArrayView2<'_, f64>)| {
        Rotation::from_matrix(std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)])))
            .ok_or_else(|| PyValueError::new_err(format!("{name}[{k}] is not a rotation matrix")))
    };
    array.outer_iter().enumerate().map(read).collect()
}

fn planar_orientations(array: &Bound<'_, PyAny>, _: &str) -> PyResult<Vec<Rotation<2>>> {
    let headings: PyReadonlyArray1<'_, f64> = array.extract()?;
    Ok(headings.as_array().iter().map(|&h| Rotation::from_angle(-h)).collect())
}

/// Reads the priors; the arrays of one entry have been brought to one length before.
fn read_priors<const D: usize>(
    list: &Bound<'_, PyList>,
    orientations: impl Fn(&Bound<'_, PyAny>, &str) -> PyResult<Vec<Rotation<D>>>,
) -> PyResult<Vec<OrientationPrior<D>>> {
    let mut priors = Vec::new();
    for entry in list {
        let kind: String = entry.get_item(0)?.extract()?;
        let views: PyReadonlyArray1<'_, u32> = entry.get_item(1)?.extract()?;
        let array = |k: usize| entry.get_item(k);
        let kinds: Vec<PriorKind<D>> = match kind.as_str() {
            "orientation" => {
                let covariance: PyReadonlyArray3<'_, f64> = array(3)?.extract()?;
                let blocks = covariance.as_array();
                let block =
                    |k: usize| -> Matrix<3> { std::array::from_fn(|r| std::array::from_fn(|c| blocks[(k, r, c)])) };
                let known = orientations(&array(2)?, "cam_from_world")?;
                known
                    .iter()
                    .enumerate()
                    .map(|(k, r)| PriorKind::Orientation { cam_from_world: *r, covariance_rad2: block(k) })
                    .collect()
            }
            "gravity" => {
                let ups: Vec<Vector<3>> = vectors(&array(2)?.extract::<PyReadonlyArray2<'_, f64>>()?, "up_in_cam")?;
                let sigma: PyReadonlyArray1<'_, f64> = array(3)?.extract()?;
                let sigma = sigma.as_array();
                ups.iter().zip(sigma).map(|(&up, &s)| PriorKind::Gravity { up_in_cam: up, sigma_rad: s }).collect()
            }
            _ => {
                let (headings, sigma): (PyReadonlyArray1<'_, f64>, PyReadonlyArray1<'_, f64>) =
                    (array(2)?.extract()?, array(3)?.extract()?);
                let forward: Vec<Vector<3>> = vectors(&array(4)?.extract::<PyReadonlyArray2<'_, f64>>()?, "forward")?;
                let (headings, sigma) = (headings.as_array(), sigma.as_array());
                let kind = |k: usize| PriorKind::Heading {
                    heading_rad: headings[k],
                    sigma_rad: sigma[k],
                    forward: forward[k],
                };
                (0..forward.len()).map(kind).collect()
            }
        };
        priors.extend(views.as_array().iter().zip(kinds).map(|(&view, kind)| OrientationPrior { view, kind }));
    }
    Ok(priors)
}

fn read_options(options: &Bound<'_, PyDict>) -> PyResult<(OrientationOptions, Option<usize>)> {
    let (mut chosen, mut threads) = (OrientationOptions::default(), None);
    for (name, value) in options {
        match name.extract::<String>()?.as_str() {
            "max_iterations" => chosen.max_iterations = value.extract()?,
            "estimate_noise" => chosen.estimate_noise = value.extract()?,
            "covariance" => chosen.covariance = value.extract()?,
            "threads" => threads = value.extract()?,
            "linear_solver" => {
                chosen.linear_solver = match value.extract::<String>()?.as_str() {
                    "direct" => LinearSolver::Direct,
                    "iterative" => LinearSolver::Iterative,
                    _ => LinearSolver::Auto,
                };
            }
            other => return Err(PyValueError::new_err(format!("options has no entry {other:?}"))),
        }
    }
    Ok((chosen, threads))
}

fn filled<'py, const D: usize>(
    py: Python<'py>,
    cam_from_world: Bound<'py, PyAny>,
    found: Orientations<D>,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("cam_from_world", cam_from_world)?;
    dict.set_item("view_component", found.view_component.into_pyarray(py))?;
    dict.set_item("inlier", found.edge_inlier.into_pyarray(py))?;
    dict.set_item("residual_rad", found.residual_rad.into_pyarray(py))?;
    dict.set_item("status", found.status.name())?;
    dict.set_item("iterations", found.iterations)?;
    dict.set_item("sigma_rad", found.sigma_rad)?;
    let blocks = found.covariance_rad2;
    let covariance = Array3::from_shape_fn((blocks.len(), 3, 3), |(i, r, c)| blocks[i][r][c]);
    dict.set_item("covariance_rad2", covariance.into_pyarray(py))?;
    Ok(dict)
}

/// Adds the function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(average_rotations, module)?)
}
