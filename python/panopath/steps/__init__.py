"""The solvers, typed: a record in, a record out. The mathematics is in the compiled core."""

from panopath.steps.positions import position_covariance, solve_positions
from panopath.steps.refinement import RefineOptions, refine

__all__ = ["RefineOptions", "position_covariance", "refine", "solve_positions"]
