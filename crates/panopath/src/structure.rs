//! What the solvers answer: camera centres, orientations and points, and how the solve went.

use crate::geometry::{Rotation, Vector};

/// How a solver ended. A status is an answer, not an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Status {
    /// One part, solved.
    Converged,
    /// Solved, but in more than one part, each with a scale of its own.
    Disconnected,
    /// The iterations ran out first.
    MaxIterations,
    /// The geometry leaves freedoms beyond the gauge, or so nearly that noise hides the difference.
    Ambiguous,
    /// Nothing is determined.
    Undetermined,
}

impl Status {
    /// The name used in files and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Disconnected => "disconnected",
            Self::MaxIterations => "max_iterations",
            Self::Ambiguous => "ambiguous",
            Self::Undetermined => "undetermined",
        }
    }
}

/// Wall-clock seconds of each stage.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Timings {
    /// World directions, parts and memory layout.
    pub layout_s: f64,
    /// Pattern of the reduced system and its order of elimination.
    pub analyse_s: f64,
    /// Linear steps and re-weighting.
    pub start_s: f64,
    /// Gauss-Newton and masks.
    pub descent_s: f64,
    /// Second split, gauge and residuals.
    pub finish_s: f64,
}

/// What a solve did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// How it ended.
    pub status: Status,
    /// Linear and Gauss-Newton steps, over all parts.
    pub iterations: usize,
    /// Noise estimate from the inliers of the largest part, radians in each tangent direction; with `sigma_rad` given,
    /// that of an observation of median sigma.
    pub sigma_rad: f64,
    /// Number of jointly scaled parts.
    pub n_components: usize,
    /// Seconds of each stage.
    pub timings: Timings,
}

/// Camera centres and points, in the gauge asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure<const D: usize = 3> {
    /// Camera centres; NaN where not determined.
    pub centers: Vec<Vector<D>>,
    /// Points; NaN where not determined.
    pub points: Vec<Vector<D>>,
    /// Part of each view, 0 the largest, -1 none.
    pub view_component: Vec<i32>,
    /// Part of each track, -1 none.
    pub track_component: Vec<i32>,
    /// Does the observation agree with the answer?
    pub inlier: Vec<bool>,
    /// Angle between each bearing and its prediction; NaN where there is none.
    pub residual_rad: Vec<f64>,
    /// Orientations in the output frame.
    pub cam_from_world: Vec<Rotation<D>>,
    /// How the solve went.
    pub summary: Summary,
}
