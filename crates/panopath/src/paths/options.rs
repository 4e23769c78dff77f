//! What a caller may say of motion, what comes back, and what can go wrong.

use super::basis::Form;
use super::verdict::Verdict;
use crate::positions::PositionError;
use crate::structure::Structure;
use crate::tracks::TracksError;

/// How tracks may move.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Form of each track's path; `None`: the simplest of rest and the candidates that it fits.
    pub forms: Vec<Option<Form>>,
    /// What is chosen from, beside rest.
    pub candidates: Vec<Form>,
    /// Do all frequencies that are sought have one value?
    pub common_frequency: bool,
    /// Are orientations sought too, from those given on?
    pub free_orientations: bool,
    /// Are covariances wanted?
    pub covariance: bool,
}

/// What keeps the motion that everything could share from being free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Assumption {
    /// So many tracks are known to be at rest.
    KnownStatic(usize),
    /// Nothing is known; most tracks turned out to be at rest.
    MostStatic,
    /// Of all motions that everything could share, the one that leaves most tracks at rest was taken away.
    LeastMotion,
}

/// Cameras, points at rest and paths.
#[derive(Debug, Clone, PartialEq)]
pub struct MovingStructure<const D: usize> {
    /// Cameras, and where each track was in the middle of the time that it was seen.
    pub structure: Structure<D>,
    /// Form of each track's path, all numbers filled in.
    pub forms: Vec<Form>,
    /// Where the vectors of each track begin.
    pub start: Vec<usize>,
    /// Vectors of all paths; NaN where not determined.
    pub vectors: Vec<[f64; D]>,
    /// Covariance of the vectors of each track, by rows; empty where none was wanted or possible.
    pub covariance: Vec<Vec<f64>>,
    /// First and last time that each track was seen along its path; NaN where never.
    pub seen_s: Vec<[f64; 2]>,
    /// What was found of each track.
    pub verdict: Vec<Verdict>,
    /// What keeps common motion from being free.
    pub assumption: Assumption,
    /// Was there so little at rest that freedoms of everything were looked for?
    pub resolved: bool,
}

/// Why paths could not be sought at all.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PathError {
    /// A view that saw something has no time.
    #[error("time_s[{view}] is not finite, expected the time of every view that saw a track which may move")]
    Time {
        /// The view.
        view: usize,
    },
    /// Arrays of different lengths.
    #[error("{name} has {found} entries, expected {expected}")]
    Length {
        /// Which array.
        name: &'static str,
        /// Its length.
        found: usize,
        /// The length it should have.
        expected: usize,
    },
    /// An option that does not go with others.
    #[error("{0}")]
    Option(String),
    /// Observations that are none.
    #[error(transparent)]
    Tracks(#[from] TracksError),
    /// Positions could not be sought.
    #[error(transparent)]
    Positions(#[from] PositionError),
}

impl From<crate::least_squares::LeastSquaresError> for PathError {
    fn from(error: crate::least_squares::LeastSquaresError) -> Self {
        Self::Positions(error.into())
    }
}
