"""From omni-directional bearings to the camera path and the space around it, with a statement of what is certain."""

from panopath import _core
from panopath.evaluate import Evaluation, evaluate
from panopath.formats import (
    read_control,
    read_problem,
    read_scene,
    read_tracks,
    read_truth,
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
from panopath.steps import (
    HeadingOptions,
    Headings,
    Motion,
    MotionOptions,
    find_headings,
    fit_rotations,
    mean_motion,
    position_covariance,
    solve_positions,
)
from panopath.synthetic import SyntheticWorld, simulate

__version__ = _core.__version__

__all__ = [
    "Control",
    "Evaluation",
    "HeadingOptions",
    "Headings",
    "InputError",
    "MissingExtraError",
    "Motion",
    "MotionOptions",
    "PanopathError",
    "PositionOptions",
    "Problem",
    "Scene",
    "Status",
    "Summary",
    "SyntheticWorld",
    "Tracks",
    "__version__",
    "evaluate",
    "find_headings",
    "fit_rotations",
    "mean_motion",
    "position_covariance",
    "read_control",
    "read_problem",
    "read_scene",
    "read_tracks",
    "read_truth",
    "simulate",
    "solve_positions",
    "write_scene",
    "write_tracks",
]
