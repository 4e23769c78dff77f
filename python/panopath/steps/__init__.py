"""The solvers, typed: a record in, a record out. The mathematics is in the compiled core."""

from panopath.steps.motion import Motion, MotionOptions, fit_rotations, mean_motion
from panopath.steps.positions import position_covariance, solve_positions

__all__ = ["Motion", "MotionOptions", "fit_rotations", "mean_motion", "position_covariance", "solve_positions"]
