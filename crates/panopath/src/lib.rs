//! From what an omni-directional camera saw to its path and the space around it.
//!
//! The pipeline in words: [`sphere`] turns angles and pixels into bearings; [`tracks`] holds bearings as observations of
//! points by views; [`positions`] finds, from bearings of known orientation, the camera centres and the points, says which
//! observations agree, which parts share a scale and whether the answer is determined, and bounds its covariance.
//! [`synthetic`] makes worlds with exact truth to test all of it on. [`geometry`] and [`least_squares`] serve the others.
//!
//! An observation of point `x` by a view with centre `c` and orientation `cam_from_world` is the unit vector
//! `cam_from_world (x - c) / |x - c|`, in the plane (`D = 2`) or in space (`D = 3`). Scenes are known up to translation and
//! scale; frames are in names and cancel by eye; angles are radians. No file and no network is touched here, and threads
//! are rayon's: the same input gives the same bytes on any number of them.
#![warn(missing_docs)]

pub mod geometry;
pub mod headings;
pub mod least_squares;
pub mod motion;
pub mod positions;
pub mod sphere;
pub mod synthetic;
pub mod tracks;

pub use geometry::{Rotation, Similarity};
pub use headings::{HeadingError, HeadingOptions, Headings, start_headings};
pub use motion::{Motion, MotionError, MotionOptions, fit_rotations, mean_motion};
pub use positions::{PositionError, PositionOptions, Structure, solve_positions};
pub use tracks::{Tracks, TracksError};
