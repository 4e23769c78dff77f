"""The solvers, typed: a record in, a record out. The mathematics is in the compiled core."""

from panopath.steps.certificate import CertifyOptions, certify
from panopath.steps.conditions import FullVisibility, full_visibility
from panopath.steps.consistency import ConsistencyOptions, check_consistency
from panopath.steps.correspondence import CorrespondenceOptions, FeatureTracks, tracks_from_matches
from panopath.steps.descriptors import FeatureMatches, MatchOptions, MotionGuides, match_features
from panopath.steps.freedoms import FreedomOptions, certify_paths
from panopath.steps.headings import HeadingOptions, Headings, find_headings
from panopath.steps.motion import MeanMotion, MotionOptions, fit_rotations, mean_motion
from panopath.steps.orientation import (
    OrientationOptions,
    Orientations,
    average_rotations,
)
from panopath.steps.positions import position_covariance, solve_positions
from panopath.steps.refinement import RefineOptions, SceneCovariance, refine, scene_covariance
from panopath.steps.two_view import (
    TwoView,
    TwoViewOptions,
    TwoViews,
    TwoViewStatus,
    matches_that_agree,
    relative_pose,
    relative_poses,
)
from panopath.steps.view_graph import ViewGraphOptions, ViewPairs, view_pairs

__all__ = [
    "CertifyOptions",
    "ConsistencyOptions",
    "CorrespondenceOptions",
    "FeatureMatches",
    "FeatureTracks",
    "FreedomOptions",
    "FullVisibility",
    "HeadingOptions",
    "Headings",
    "MatchOptions",
    "MeanMotion",
    "MotionGuides",
    "MotionOptions",
    "OrientationOptions",
    "Orientations",
    "RefineOptions",
    "SceneCovariance",
    "TwoView",
    "TwoViewOptions",
    "TwoViewStatus",
    "TwoViews",
    "ViewGraphOptions",
    "ViewPairs",
    "average_rotations",
    "certify",
    "certify_paths",
    "check_consistency",
    "find_headings",
    "fit_rotations",
    "full_visibility",
    "match_features",
    "matches_that_agree",
    "mean_motion",
    "position_covariance",
    "refine",
    "relative_pose",
    "relative_poses",
    "scene_covariance",
    "solve_positions",
    "tracks_from_matches",
    "view_pairs",
]
