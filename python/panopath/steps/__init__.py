"""The solvers, typed: a record in, a record out. The mathematics is in the compiled core."""

from panopath.steps.correspondence import CorrespondenceOptions, FeatureTracks, tracks_from_matches
from panopath.steps.positions import position_covariance, solve_positions

__all__ = [
    "CorrespondenceOptions",
    "FeatureTracks",
    "position_covariance",
    "solve_positions",
    "tracks_from_matches",
]
