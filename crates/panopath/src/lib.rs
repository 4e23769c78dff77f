//! From what an omni-directional camera saw to its path and the space around it.
//!
//! The pipeline in words: [`sphere`] turns angles and pixels into bearings; [`correspondence`] joins matches of features to
//! tracks; [`tracks`] holds bearings as observations of points by views. Where orientations are unknown, [`view_graph`]
//! lists pairs of views, [`two_view`] turns them against each other, and [`orientation`] averages that to one orientation
//! for each view; in the plane [`headings`] takes triplets of views instead, and [`motion`] chains slow sequences.
//! [`positions`] finds, from bearings of known orientation, the camera centres and the points, says which observations
//! agree and which parts share a scale; [`refinement`] adjusts orientations, centres and points together and says how
//! well all are known; [`structure`] is what both answer. [`synthetic`] makes worlds with exact truth to test all of it
//! on, and [`trials`] runs many of them. [`geometry`] and [`least_squares`] serve the others; [`machine`] tells what the
//! processor offers.
//!
//! An observation of point `x` by a view with centre `c` and orientation `cam_from_world` is the unit vector
//! `cam_from_world (x - c) / |x - c|`, in the plane (`D = 2`) or in space (`D = 3`). Scenes are known up to translation and
//! scale; frames are in names and cancel by eye; angles are radians. No file and no network is touched here, and threads
//! are rayon's: the same input gives the same bytes on any number of them.
#![warn(missing_docs)]

mod bundle;
pub mod consistency;
pub mod correspondence;
pub mod descriptors;
pub mod geometry;
pub mod headings;
pub mod least_squares;
mod lists;
pub mod machine;
pub mod motion;
pub mod orientation;
pub mod paths;
pub mod positions;
pub mod refinement;
pub mod rigidity;
mod sets;
pub mod sphere;
pub mod structure;
pub mod synthetic;
pub mod tracks;
pub mod trials;
pub mod two_view;
pub mod view_graph;

pub use geometry::{Rotation, Similarity};
pub use least_squares::LinearSolver;
pub use positions::{PositionError, PositionOptions, solve_positions};
pub use refinement::{RefineError, RefineOptions, refine};
pub use structure::Structure;
pub use tracks::{Tracks, TracksError};
