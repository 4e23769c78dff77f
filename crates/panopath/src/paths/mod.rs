//! Bodies that move while they are filmed.

mod basis;

pub use basis::Form;
