//! What a caller may choose, and what can go wrong.

use crate::geometry::Vector;
use crate::least_squares::{LeastSquaresError, LinearSolver};

/// The condition that takes away translation and scale while the paper's least squares are solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LinearGauge {
    /// `sum v^T (x - c) = 1`, one view pinned.
    #[default]
    Functional,
    /// First point at the origin, second with first coordinate one (section 4).
    Paper,
    /// First point at the origin, second at distance one (section 4).
    PaperDistance,
}

/// Which of the paper's linear systems to solve in space.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinearForm {
    /// All coordinates at once: two equations for each observation.
    Joint,
    /// First the plane across `vertical_axis`, then the heights along it (section 5).
    TwoStage {
        /// 0, 1 or 2: which axis takes the role of z.
        vertical_axis: usize,
    },
}

/// How positions are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// Linear start, robust re-weighting, Gauss-Newton on the sphere.
    #[default]
    Robust,
    /// The paper's own least squares, every observation with the weight of its equation.
    Linear {
        /// The system solved; planar input has only one.
        form: LinearForm,
        /// The condition it is solved under.
        gauge: LinearGauge,
    },
}

/// Positions known beforehand, to which a solution is fitted by a similarity.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Control<const D: usize> {
    /// Known camera centres, by view.
    pub views: Vec<(u32, Vector<D>)>,
    /// Known points, by track.
    pub tracks: Vec<(u32, Vector<D>)>,
    /// Fit a rotation too; otherwise the orientations are taken to be right and only shift and scale are fitted.
    pub rotation: bool,
}

/// The frame in which a solution is given.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Gauge<const D: usize> {
    /// Centroid of the centres at zero, their rms distance one; each part for itself.
    #[default]
    Normalized,
    /// First solved point of a part at the origin, the second with first coordinate one, or minus one where
    /// only that leaves the points in front of their cameras.
    Paper,
    /// First solved point of a part at the origin, the second at distance one.
    PaperDistance,
    /// Fitted to known positions.
    Control(Control<D>),
}

/// Options of [`solve_positions`](super::solve_positions).
#[derive(Debug, Clone, PartialEq)]
pub struct PositionOptions<const D: usize> {
    /// Default: robust.
    pub method: Method,
    /// Default: normalized.
    pub gauge: Gauge<D>,
    /// Default: the one with the lower predicted cost.
    pub linear_solver: LinearSolver,
    /// Find parts that share no scale and solve them apart. Default: true.
    pub split_parts: bool,
    /// Gauss-Newton iterations of one round. Default: 50.
    pub max_iterations: usize,
    /// Do near points weigh no more in the start than those in the middle? A body that comes towards the camera looks near,
    /// and would have the first word. Default: no.
    pub even_start: bool,
    /// Centres and points to start from, in place of the linear start. Default: none.
    pub start: Option<(Vec<Vector<D>>, Vec<Vector<D>>)>,
}

impl<const D: usize> Default for PositionOptions<D> {
    fn default() -> Self {
        Self {
            method: Method::default(),
            gauge: Gauge::default(),
            linear_solver: LinearSolver::default(),
            split_parts: true,
            max_iterations: 50,
            even_start: false,
            start: None,
        }
    }
}

/// Why positions could not be sought at all. What the input does not determine is a status, not an error.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PositionError {
    /// Not one orientation for each view.
    #[error("cam_from_world has {found} rotations, expected one for each of the {expected} views")]
    Orientations {
        /// Number given.
        found: usize,
        /// Number of views.
        expected: usize,
    },
    /// A start of the wrong size or with positions that are not finite.
    #[error("start: {0}")]
    Start(String),
    /// An option out of its range.
    #[error("{0}")]
    Option(String),
    /// Control positions that fix no similarity.
    #[error("control: {0}")]
    Control(String),
    /// The linear algebra failed.
    #[error(transparent)]
    LeastSquares(#[from] LeastSquaresError),
}
