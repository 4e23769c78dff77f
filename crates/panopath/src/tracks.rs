//! Observations of points by views, as flat arrays.
//!
//! Observation `o` says: view `view[o]` saw the point of track `track[o]` along the unit vector `bearing[o]`, with an
//! angular standard deviation of `sigma_rad[o]` in each tangent direction.

use crate::geometry::{Vector, dot};

/// How far from one the length of a bearing may be; bearings are stored with unit length.
pub const UNIT_TOLERANCE: f64 = 1e-6;

/// What is wrong with arrays that were to become [`Tracks`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TracksError {
    /// Arrays of different lengths.
    #[error("{name} has {found} entries, but there are {expected} observations")]
    Length {
        /// Which array.
        name: &'static str,
        /// Its length.
        found: usize,
        /// The number of observations.
        expected: usize,
    },
    /// An index beyond the declared number of views or tracks.
    #[error("{name}[{observation}] is {found}, expected an index below {limit}")]
    Index {
        /// `view` or `track`.
        name: &'static str,
        /// Which observation.
        observation: usize,
        /// The index found.
        found: u32,
        /// The declared number.
        limit: usize,
    },
    /// A bearing that is not finite or not of unit length.
    #[error("bearing[{observation}] has length {length}, expected a finite unit vector")]
    NotUnit {
        /// Which observation.
        observation: usize,
        /// Its length.
        length: f64,
    },
    /// A standard deviation that is not positive and finite.
    #[error("sigma_rad[{observation}] is {found}, expected a positive finite number")]
    Sigma {
        /// Which observation.
        observation: usize,
        /// The value found.
        found: f64,
    },
}

/// Observations of points by views; see the module's text. `D` is 2 in the plane and 3 in space.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracks<const D: usize = 3> {
    view: Vec<u32>,
    track: Vec<u32>,
    bearing: Vec<Vector<D>>,
    sigma_rad: Option<Vec<f64>>,
    n_views: usize,
    n_tracks: usize,
}

impl<const D: usize> Tracks<D> {
    /// Checks the arrays and takes them. Bearings within [`UNIT_TOLERANCE`] of unit length are normalised.
    ///
    /// # Errors
    /// [`TracksError`] naming the first entry that is wrong.
    pub fn new(
        view: Vec<u32>,
        track: Vec<u32>,
        mut bearing: Vec<Vector<D>>,
        sigma_rad: Option<Vec<f64>>,
        n_views: usize,
        n_tracks: usize,
    ) -> Result<Self, TracksError> {
        let expected = view.len();
        let sigma_len = sigma_rad.as_ref().map_or(expected, Vec::len);
        for (name, found) in [("track", track.len()), ("bearing", bearing.len()), ("sigma_rad", sigma_len)] {
            if found != expected {
                return Err(TracksError::Length { name, found, expected });
            }
        }
        for (name, ids, limit) in [("view", &view, n_views), ("track", &track, n_tracks)] {
            if let Some(observation) = ids.iter().position(|&id| id as usize >= limit) {
                return Err(TracksError::Index { name, observation, found: ids[observation], limit });
            }
        }
        for (observation, b) in bearing.iter_mut().enumerate() {
            let length = dot(b, b).sqrt();
            if length.is_nan() || (length - 1.0).abs() > UNIT_TOLERANCE {
                return Err(TracksError::NotUnit { observation, length });
            }
            for c in b.iter_mut() {
                *c /= length;
            }
        }
        if let Some(sigma) = &sigma_rad
            && let Some(observation) = sigma.iter().position(|s| !(s.is_finite() && *s > 0.0))
        {
            return Err(TracksError::Sigma { observation, found: sigma[observation] });
        }
        Ok(Self { view, track, bearing, sigma_rad, n_views, n_tracks })
    }

    /// Number of observations.
    pub fn len(&self) -> usize {
        self.view.len()
    }

    /// True where nothing was observed.
    pub fn is_empty(&self) -> bool {
        self.view.is_empty()
    }

    /// Number of views, those without observations included.
    pub fn n_views(&self) -> usize {
        self.n_views
    }

    /// Number of tracks, those without observations included.
    pub fn n_tracks(&self) -> usize {
        self.n_tracks
    }

    /// View of each observation.
    pub fn view(&self) -> &[u32] {
        &self.view
    }

    /// Track of each observation.
    pub fn track(&self) -> &[u32] {
        &self.track
    }

    /// Bearing of each observation, unit length.
    pub fn bearing(&self) -> &[Vector<D>] {
        &self.bearing
    }

    /// Angular standard deviation of each observation, where given.
    pub fn sigma_rad(&self) -> Option<&[f64]> {
        self.sigma_rad.as_deref()
    }
}
