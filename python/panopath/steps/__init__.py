"""The solvers, typed: a record in, a record out. The mathematics is in the compiled core."""

from panopath.steps.headings import HeadingOptions, Headings, find_headings
from panopath.steps.motion import Motion, MotionOptions, fit_rotations, mean_motion
from panopath.steps.positions import position_covariance, solve_positions

__all__ = [
    "HeadingOptions",
    "Headings",
    "Motion",
    "MotionOptions",
    "find_headings",
    "fit_rotations",
    "mean_motion",
    "position_covariance",
    "solve_positions",
]
