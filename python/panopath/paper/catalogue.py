"""The experiments by name, in the order of the paper."""

from __future__ import annotations

from panopath.paper.cameras import CAMERAS
from panopath.paper.counting import COUNTING
from panopath.paper.experiment import Experiment
from panopath.paper.mean_motion import MEAN_MOTION
from panopath.paper.moving import MOVING
from panopath.paper.noise import NOISE
from panopath.paper.surface import SURFACE
from panopath.paper.theorems import THEOREMS
from panopath.paper.visibility import VISIBILITY

EXPERIMENTS: dict[str, Experiment] = {
    one.name: one
    for one in (
        CAMERAS,
        COUNTING,
        THEOREMS,
        VISIBILITY,
        MOVING,
        MEAN_MOTION,
        NOISE,
        SURFACE,
    )
}
