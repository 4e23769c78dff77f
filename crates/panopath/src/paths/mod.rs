//! Bodies that move while they are filmed.

mod basis;
mod freedoms;

pub use basis::Form;
pub use freedoms::{
    Freedom, FreedomError, FreedomKind, FreedomOptions, MovingScene, NullVector, PathCertificate, Reach, TimeFunction,
    TrackReach, freedoms_of_paths,
};
