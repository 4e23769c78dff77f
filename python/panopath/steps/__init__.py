"""The solvers, typed: a record in, a record out. The mathematics is in the compiled core."""

from panopath.steps.orientation import (
    GravityPriors,
    HeadingPriors,
    OrientationOptions,
    OrientationPriors,
    Orientations,
    average_rotations,
)
from panopath.steps.positions import position_covariance, solve_positions

__all__ = [
    "GravityPriors",
    "HeadingPriors",
    "OrientationOptions",
    "OrientationPriors",
    "Orientations",
    "average_rotations",
    "position_covariance",
    "solve_positions",
]
