//! What the steps share that place cameras and points: observations laid out by track, points eliminated, Gauss-Newton.
//!
//! A *station* is what a ray starts from: a view, or one sensor of a view with several. Stations belong to *nodes*, the
//! cameras of the reduced system, whose `V` unknowns move them: `D` of a position, and those of a turn where orientations
//! are unknown.

pub(crate) mod courses;
pub(crate) mod determinacy;
pub(crate) mod estimate;
pub(crate) mod full;
pub(crate) mod gauged;
pub(crate) mod levenberg;
pub(crate) mod newton;
pub(crate) mod noise;
pub(crate) mod part;
pub(crate) mod points;
pub(crate) mod reduced;
pub(crate) mod system;
pub(crate) mod turns;
