//! Exact synthetic worlds.
