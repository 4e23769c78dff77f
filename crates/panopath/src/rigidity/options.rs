//! What a caller may choose, and what can go wrong.

use crate::least_squares::LeastSquaresError;

/// What is known of orientations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OrientationModel {
    /// All of it: a scene is determined up to shift and scale.
    #[default]
    Known,
    /// Nothing: up to a similarity.
    Free,
    /// The vertical, the last axis of the world: each view may turn about it.
    Vertical,
}

/// Options of [`certify`](super::certify).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CertifyOptions {
    /// What is known of orientations. Default: all.
    pub orientation: OrientationModel,
    /// Angular standard deviation of an observation; of median sigma where the tracks carry sigmas. Default: that of the
    /// tracks, else that of the residuals.
    pub sigma_rad: Option<f64>,
    /// A movement at one standard deviation beyond this share of the size is weak. Default: 0.05.
    pub weak_movement: f64,
}

impl Default for CertifyOptions {
    fn default() -> Self {
        Self { orientation: OrientationModel::default(), sigma_rad: None, weak_movement: 0.05 }
    }
}

/// Why a scene could not be looked at.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CertifyError {
    /// An array of the wrong length.
    #[error("{name} has {found} entries, expected {expected}")]
    Length {
        /// Which array.
        name: &'static str,
        /// Its length.
        found: usize,
        /// The length that fits.
        expected: usize,
    },
    /// An option out of its range.
    #[error("{0}")]
    Option(String),
    /// The linear algebra failed.
    #[error(transparent)]
    LeastSquares(#[from] LeastSquaresError),
}
