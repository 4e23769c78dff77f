"""The solvers, typed: a record in, a record out. The mathematics is in the compiled core."""

from panopath.steps.positions import position_covariance, solve_positions
from panopath.steps.two_view import TwoView, TwoViewOptions, TwoViews, TwoViewStatus, relative_pose, relative_poses

__all__ = [
    "TwoView",
    "TwoViewOptions",
    "TwoViewStatus",
    "TwoViews",
    "position_covariance",
    "relative_pose",
    "relative_poses",
    "solve_positions",
]
