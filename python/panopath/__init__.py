"""From omni-directional bearings to the camera path and the space around it, with a statement of what is certain."""

from panopath import _core
from panopath.evaluate import Evaluation, evaluate
from panopath.formats import (
    Database,
    Reconstruction,
    read_control,
    read_database,
    read_problem,
    read_scene,
    read_tracks,
    read_truth,
    write_models,
    write_scene,
    write_tracks,
)
from panopath.model import (
    Control,
    InputError,
    MissingExtraError,
    PanopathError,
    PositionOptions,
    Problem,
    Scene,
    Status,
    Summary,
    Tracks,
)
from panopath.priors import DirectionPriors, PositionPriors, Priors, Rig, RotationPriors
from panopath.steps import (
    CorrespondenceOptions,
    FeatureTracks,
    RefineOptions,
    SceneCovariance,
    position_covariance,
    refine,
    scene_covariance,
    solve_positions,
    tracks_from_matches,
)
from panopath.synthetic import SyntheticWorld, simulate

__version__ = _core.__version__

__all__ = [
    "Control",
    "CorrespondenceOptions",
    "Database",
    "DirectionPriors",
    "Evaluation",
    "FeatureTracks",
    "InputError",
    "MissingExtraError",
    "PanopathError",
    "PositionOptions",
    "PositionPriors",
    "Priors",
    "Problem",
    "Reconstruction",
    "RefineOptions",
    "Rig",
    "RotationPriors",
    "Scene",
    "SceneCovariance",
    "Status",
    "Summary",
    "SyntheticWorld",
    "Tracks",
    "__version__",
    "evaluate",
    "position_covariance",
    "read_control",
    "read_database",
    "read_problem",
    "read_scene",
    "read_tracks",
    "read_truth",
    "refine",
    "scene_covariance",
    "simulate",
    "solve_positions",
    "tracks_from_matches",
    "write_models",
    "write_scene",
    "write_tracks",
]
