//! What a caller may choose, what is known beforehand, and what can go wrong.

use crate::geometry::{Matrix, Rotation, Vector};
use crate::least_squares::{LeastSquaresError, LinearSolver};

/// Sensors that are fixed to each view and do not look out from its centre: the two lenses of a raw 360 camera, say.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig<const D: usize = 3> {
    /// Sensor of each observation.
    pub sensor: Vec<u32>,
    /// Centre of each sensor in the frame of the view. Bearings are in that frame too: a sensor that is turned in its rig
    /// has its bearings turned before.
    pub center: Vec<Vector<D>>,
}

/// An orientation that is known beforehand.
#[derive(Debug, Clone, PartialEq)]
pub struct RotationPrior<const D: usize = 3> {
    /// Which view.
    pub view: u32,
    /// Its orientation.
    pub cam_from_world: Rotation<D>,
    /// Covariance of the turn, in the camera, that takes this orientation to the true one, rad^2. In the plane only the
    /// first entry counts.
    pub covariance: Matrix<D>,
}

/// A direction of the world that a view measures: gravity, the sun, a magnetic north.
#[derive(Debug, Clone, PartialEq)]
pub struct DirectionPrior<const D: usize = 3> {
    /// Which view.
    pub view: u32,
    /// The direction in the camera, a unit vector.
    pub bearing: Vector<D>,
    /// The same in the world.
    pub direction: Vector<D>,
    /// Standard deviation along each tangent direction, radians.
    pub sigma_rad: f64,
}

/// A position that is known beforehand.
#[derive(Debug, Clone, PartialEq)]
pub struct PositionPrior<const D: usize = 3> {
    /// Which view.
    pub view: u32,
    /// Where its centre is.
    pub center: Vector<D>,
    /// In the unit of the centre, squared.
    pub covariance: Matrix<D>,
}

/// What is known beforehand.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Priors<const D: usize = 3> {
    /// Orientations: a compass, an inertial unit.
    pub rotations: Vec<RotationPrior<D>>,
    /// Directions: gravity.
    pub directions: Vec<DirectionPrior<D>>,
    /// Positions: satellite navigation, survey marks.
    pub positions: Vec<PositionPrior<D>>,
}

/// What is not refined. Empty lists hold nothing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Held {
    /// Views whose orientation stays.
    pub rotations: Vec<bool>,
    /// Views whose centre stays.
    pub centers: Vec<bool>,
    /// Tracks whose point stays.
    pub points: Vec<bool>,
}

/// Options of [`refine`](super::refine).
#[derive(Debug, Clone, PartialEq)]
pub struct RefineOptions<const D: usize = 3> {
    /// What stays as it is. Default: nothing.
    pub held: Held,
    /// What is known beforehand. Default: nothing.
    pub priors: Priors<D>,
    /// Where bearings start from. Default: every one at the centre of its view.
    pub rig: Option<Rig<D>>,
    /// Huber's threshold in standard deviations; infinite for plain least squares. Default: 3.
    pub huber_sigmas: f64,
    /// Judge anew, between rounds, which observations agree, and look again at points that lost theirs. Otherwise
    /// all observations count. Default: true.
    pub reject_outliers: bool,
    /// Gauss-Newton iterations of one round. Default: 50.
    pub max_iterations: usize,
    /// Default: the one with the lower predicted cost.
    pub linear_solver: LinearSolver,
}

impl<const D: usize> Default for RefineOptions<D> {
    fn default() -> Self {
        Self {
            held: Held::default(),
            priors: Priors::default(),
            rig: None,
            huber_sigmas: crate::bundle::noise::HUBER_SIGMAS,
            reject_outliers: true,
            max_iterations: 50,
            linear_solver: LinearSolver::default(),
        }
    }
}

/// Why a refinement could not be tried at all.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RefineError {
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
    /// A prior that cannot be one.
    #[error("{kind} prior {index}: {problem}")]
    Prior {
        /// Rotation, direction or position.
        kind: &'static str,
        /// Which one.
        index: usize,
        /// What is wrong with it, and what was expected.
        problem: String,
    },
    /// An option out of its range.
    #[error("{0}")]
    Option(String),
    /// The linear algebra failed.
    #[error(transparent)]
    LeastSquares(#[from] LeastSquaresError),
}
