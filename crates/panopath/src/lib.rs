//! From what an omni-directional camera saw to its path and the space around it.
#![warn(missing_docs)]

pub mod geometry;
pub mod least_squares;
pub mod positions;
pub mod sphere;
pub mod synthetic;
pub mod tracks;

pub use geometry::Rotation;
pub use tracks::{Tracks, TracksError};
