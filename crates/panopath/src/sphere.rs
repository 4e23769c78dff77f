//! Angles and pixels to bearings and back.
