//! `match_features`: flat arrays in, flat arrays out.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use panopath::Rotation;
use panopath::descriptors::{Features, Guide, ImagePair, LENGTH, MatchOptions, match_features as matches_of};
use panopath::geometry::Matrix;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::convert::{value_error, vectors};

/// Where the matches of each pair begin, and two features a match.
type Matches<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray2<i32>>);
/// Rotation, direction, radius and band of each pair; NaN where not known.
type Guides<'py> =
    (PyReadonlyArray3<'py, f64>, PyReadonlyArray2<'py, f64>, PyReadonlyArray1<'py, f64>, PyReadonlyArray1<'py, f64>);

/// Matches features by their descriptors (`panopath.steps.match_features` describes the arguments).
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn match_features<'py>(
    py: Python<'py>,
    feature_starts: PyReadonlyArray1<'py, i64>,
    descriptors: PyReadonlyArray2<'py, u8>,
    bearings: PyReadonlyArray2<'py, f64>,
    pairs: PyReadonlyArray2<'py, i32>,
    guides: Option<Guides<'py>>,
    max_ratio: f64,
    max_distance: f64,
    max_features: Option<usize>,
) -> PyResult<Matches<'py>> {
    let starts = starts(&feature_starts)?;
    let bearings = vectors::<3>(&bearings, "bearings")?;
    let table = descriptors.as_slice().map_err(value_error)?;
    if descriptors.as_array().ncols() != LENGTH {
        let found = descriptors.as_array().ncols();
        return Err(PyValueError::new_err(format!("descriptors has {found} columns, expected {LENGTH}")));
    }
    let features = Features { starts: &starts, descriptors: table.as_chunks::<LENGTH>().0, bearings: &bearings };
    let pairs = image_pairs(&pairs, guides.as_ref())?;
    let options = MatchOptions { max_ratio, max_distance, max_features: max_features.unwrap_or(usize::MAX) };
    let found = py.detach(|| matches_of(&features, &pairs, &options)).map_err(value_error)?;
    let mut starts = vec![0_i64];
    let mut flat = Vec::new();
    for pair in found {
        flat.extend(pair.iter().flatten().map(|&k| k.cast_signed()));
        starts.push((flat.len() / 2) as i64);
    }
    let rows = Array2::from_shape_vec((flat.len() / 2, 2), flat).map_err(value_error)?;
    Ok((starts.into_pyarray(py), rows.into_pyarray(py)))
}

fn starts(array: &PyReadonlyArray1<'_, i64>) -> PyResult<Vec<usize>> {
    let convert = |(k, &n): (usize, &i64)| {
        usize::try_from(n).map_err(|_| PyValueError::new_err(format!("feature_starts[{k}] is {n}, expected 0 or more")))
    };
    array.as_array().iter().enumerate().map(convert).collect()
}

fn image_pairs(pairs: &PyReadonlyArray2<'_, i32>, guides: Option<&Guides<'_>>) -> PyResult<Vec<ImagePair>> {
    let pairs = pairs.as_array();
    let mut found = Vec::with_capacity(pairs.nrows());
    for (row, pair) in pairs.rows().into_iter().enumerate() {
        let image = |side: usize| {
            let i = pair[side];
            usize::try_from(i).map_err(|_| PyValueError::new_err(format!("pairs[{row}] has {i}, expected 0 or more")))
        };
        let guide = guides.map(|guides| guide_of(row, guides)).transpose()?.flatten();
        found.push(ImagePair { first: image(0)?, second: image(1)?, guide });
    }
    Ok(found)
}

fn guide_of(row: usize, guides: &Guides<'_>) -> PyResult<Option<Guide>> {
    let (rotations, directions, radii, bands) = guides;
    let (rotations, directions) = (rotations.as_array(), directions.as_array());
    let matrix: Matrix<3> = std::array::from_fn(|i| std::array::from_fn(|j| rotations[[row, i, j]]));
    if matrix.iter().flatten().any(|x| x.is_nan()) {
        return Ok(None);
    }
    let second_from_first = Rotation::from_matrix(matrix).ok_or_else(|| {
        PyValueError::new_err(format!("second_from_first[{row}] is no rotation, expected a matrix with R^T R = 1"))
    })?;
    let direction: [f64; 3] = std::array::from_fn(|c| directions[[row, c]]);
    let direction = direction.iter().all(|x| !x.is_nan()).then_some(direction);
    let (radius_rad, band_rad) = (radii.as_array()[row], bands.as_array()[row]);
    Ok(Some(Guide { second_from_first, direction, radius_rad, band_rad }))
}

/// Adds this file's functions to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(match_features, module)?)
}
