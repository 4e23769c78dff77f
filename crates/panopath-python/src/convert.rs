//! Between numpy's arrays and the core's vectors.

use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{IntoPyArray, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use panopath::geometry::Vector;
use panopath::{Rotation, Structure, Tracks};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Any of the core's errors as Python's `ValueError`.
pub fn value_error(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Rows of an `(n, D)` array.
pub fn vectors<const D: usize>(array: &PyReadonlyArray2<'_, f64>, name: &str) -> PyResult<Vec<Vector<D>>> {
    let array = array.as_array();
    if array.ncols() != D {
        return Err(PyValueError::new_err(format!("{name} has {} columns, expected {D}", array.ncols())));
    }
    Ok(match array.as_slice() {
        Some(flat) => flat.as_chunks::<D>().0.to_vec(),
        None => array.rows().into_iter().map(|row| std::array::from_fn(|c| row[c])).collect(),
    })
}

/// Heading of a planar view: `world_from_cam` is the rotation by it.
pub fn heading(cam_from_world: &Rotation<2>) -> f64 {
    let [[cos, sin], _] = *cam_from_world.matrix();
    sin.atan2(cos)
}

/// Runs on the caller's threads, or on a pool of the given size.
pub fn on_threads<R: Send>(threads: Option<usize>, task: impl FnOnce() -> R + Send) -> PyResult<R> {
    match threads {
        None => Ok(task()),
        Some(n) => {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build();
            Ok(pool.map_err(|e| PyValueError::new_err(format!("threads: {e}")))?.install(task))
        }
    }
}

/// A structure as a dict of arrays.
pub fn fill<'py, const D: usize>(py: Python<'py>, found: Structure<D>) -> PyResult<Bound<'py, PyDict>>
where
    Rotation<D>: FromHeadingOrMatrix,
{
    let dict = PyDict::new(py);
    dict.set_item("cam_from_world", Rotation::<D>::write_all(py, &found.cam_from_world))?;
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
    dict.set_item("seconds", seconds)?;
    Ok(dict)
}

/// The arrays that the steps share.
pub struct Input<'py> {
    pub view: PyReadonlyArray1<'py, i32>,
    pub track: PyReadonlyArray1<'py, i32>,
    pub bearing: PyReadonlyArray2<'py, f64>,
    pub n_views: usize,
    pub n_tracks: usize,
    pub sigma_rad: Option<PyReadonlyArray1<'py, f64>>,
    pub cam_from_world: Option<Bound<'py, PyAny>>,
}

/// Observations as `panopath.steps.common.observations_of` gives them: view, track, bearing, numbers of views and tracks,
/// sigma_rad.
pub type Observations<'py> = (
    PyReadonlyArray1<'py, i32>,
    PyReadonlyArray1<'py, i32>,
    PyReadonlyArray2<'py, f64>,
    usize,
    usize,
    Option<PyReadonlyArray1<'py, f64>>,
);

impl<'py> Input<'py> {
    /// Observations, with the orientations of the views where there are any.
    pub fn new(observations: Observations<'py>, cam_from_world: Option<Bound<'py, PyAny>>) -> Self {
        let (view, track, bearing, n_views, n_tracks, sigma_rad) = observations;
        Self { view, track, bearing, n_views, n_tracks, sigma_rad, cam_from_world }
    }

    /// 2 or 3, from the bearings.
    pub fn dimension(&self) -> PyResult<usize> {
        match self.bearing.as_array().ncols() {
            d @ (2 | 3) => Ok(d),
            other => Err(PyValueError::new_err(format!("bearing has {other} columns, expected 2 or 3"))),
        }
    }

    /// The observations.
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

    /// The orientations, where there are any.
    pub fn rotations<const D: usize>(&self) -> PyResult<Option<Vec<Rotation<D>>>>
    where
        Rotation<D>: FromHeadingOrMatrix,
    {
        self.cam_from_world.as_ref().map(Rotation::<D>::read_all).transpose()
    }
}

/// How orientations are written in Python: headings in the plane, matrices in space.
pub trait FromHeadingOrMatrix: Sized {
    /// An array of them.
    fn read_all(array: &Bound<'_, PyAny>) -> PyResult<Vec<Self>>;
    /// An array from them.
    fn write_all<'py>(py: Python<'py>, all: &[Self]) -> Bound<'py, PyAny>;
}

impl FromHeadingOrMatrix for Rotation<2> {
    fn read_all(array: &Bound<'_, PyAny>) -> PyResult<Vec<Self>> {
        let headings: PyReadonlyArray1<'_, f64> = array.extract()?;
        Ok(headings.as_array().iter().map(|&h| Rotation::from_angle(-h)).collect())
    }

    fn write_all<'py>(py: Python<'py>, all: &[Self]) -> Bound<'py, PyAny> {
        Array1::from_iter(all.iter().map(heading)).into_pyarray(py).into_any()
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

    fn write_all<'py>(py: Python<'py>, all: &[Self]) -> Bound<'py, PyAny> {
        Array3::from_shape_fn((all.len(), 3, 3), |(i, a, b)| all[i].matrix()[a][b]).into_pyarray(py).into_any()
    }
}

/// The choice of this name.
pub fn choose<T: Clone>(what: &str, found: &str, choices: &[(&str, T)]) -> PyResult<T> {
    choices.iter().find(|(name, _)| *name == found).map(|(_, choice)| choice.clone()).ok_or_else(|| {
        let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
        PyValueError::new_err(format!("{what} is {found:?}, expected one of {}", names.join(", ")))
    })
}
