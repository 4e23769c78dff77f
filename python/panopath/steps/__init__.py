"""The solvers, typed: a record in, a record out. The mathematics is in the compiled core."""

from panopath.steps.positions import position_covariance, solve_positions

__all__ = ["position_covariance", "solve_positions"]
