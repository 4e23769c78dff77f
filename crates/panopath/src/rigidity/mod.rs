//! What bearings determine, what they leave free, and why.

pub mod conditions;
