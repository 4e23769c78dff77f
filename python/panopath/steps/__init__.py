"""The solvers, typed: a record in, a record out. The mathematics is in the compiled core."""

from panopath.steps.correspondence import CorrespondenceOptions, FeatureTracks, tracks_from_matches
from panopath.steps.positions import position_covariance, solve_positions
from panopath.steps.refinement import RefineOptions, SceneCovariance, refine, scene_covariance

__all__ = [
    "CorrespondenceOptions",
    "FeatureTracks",
    "RefineOptions",
    "SceneCovariance",
    "position_covariance",
    "refine",
    "scene_covariance",
    "solve_positions",
    "tracks_from_matches",
]
