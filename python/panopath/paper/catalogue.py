"""The experiments by name, in the order of the paper."""

from __future__ import annotations

from panopath.paper.counting import COUNTING
from panopath.paper.experiment import Experiment
from panopath.paper.noise import NOISE
from panopath.paper.surface import SURFACE

EXPERIMENTS: dict[str, Experiment] = {
    one.name: one
    for one in (
        COUNTING,
        NOISE,
        SURFACE,
    )
}
