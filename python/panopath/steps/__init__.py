"""The solvers, typed: a record in, a record out. The mathematics is in the compiled core."""

from panopath.steps.positions import position_covariance, solve_positions
from panopath.steps.refinement import RefineOptions, SceneCovariance, refine, scene_covariance

__all__ = ["RefineOptions", "SceneCovariance", "position_covariance", "refine", "scene_covariance", "solve_positions"]
