"""When views that all see all points determine them: the conditions, from the geometry alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.certificate import Cause
from panopath.errors import InputError
from panopath.model import Float
from panopath.steps.certificate import cause_of
from panopath.steps.common import call_core


@dataclass(frozen=True, eq=False)
class FullVisibility:
    """What is determined where every view sees every point, orientations known."""

    #: Dimension of the null space of the bearing-rigidity matrix.
    nullity: int
    #: What a determined configuration has: shifts and scale, 3 in the plane and 4 in space.
    gauge_freedoms: int
    #: The conditions that fail; members are rows of the arguments.
    causes: tuple[Cause, ...]

    @property
    def is_determined(self) -> bool:
        """Whether no other configuration has the same bearings, but for shift and scale."""
        return self.nullity == self.gauge_freedoms


def full_visibility(centers: npt.ArrayLike, points: npt.ArrayLike, tolerance: float = 1e-9) -> FullVisibility:
    """Say what bearings of known orientation determine where every view sees every point.

    No null space is computed: the answer follows from lines, planes and conics that pass through the positions.

    Parameters
    ----------
    centers
        (m, d) positions of the views, in any unit; d is 2 or 3.
    points
        (n, d) positions of the points, in the same unit.
    tolerance
        A position within this distance of a line, a plane or a conic lies on it; relative to the largest distance of
        a position from the centroid of all.

    Returns
    -------
    FullVisibility
        Its causes are empty where, and only where, the configuration is determined. Theorems I and II of Knill &
        Ramirez-Herran (2007), completed by the conics of Bolker & Roth (1980); see ``docs/method/conditions.md``.

    Raises
    ------
    InputError
        Naming the argument that cannot be used, or a view that stands at a point: it sees it in no direction.
    """
    views = _positions("centers", centers)
    seen = _positions("points", points)
    d = views.shape[1]
    if seen.shape[1] != d:
        raise InputError(f"points has positions of {seen.shape[1]} coordinates, but centers of {d}")
    if not 0.0 <= tolerance < 1.0:
        raise InputError(f"tolerance is {tolerance!r}, expected at least 0 and less than 1")
    found = call_core(_core.full_visibility, views, seen, float(tolerance))
    if found is None:
        i, j = _nearest(views, seen)
        raise InputError(f"centers[{i}] and points[{j}] are at one place, expected a direction from each to each")
    nullity, causes = found
    return FullVisibility(nullity=nullity, gauge_freedoms=d + 1, causes=tuple(cause_of(plain, d) for plain in causes))


def _positions(name: str, values: npt.ArrayLike) -> Float:
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} is not an array of numbers, expected (n, 2) or (n, 3)") from None
    if array.ndim != 2 or array.shape[1] not in (2, 3) or len(array) == 0:
        raise InputError(f"{name} has shape {array.shape}, expected (n, 2) or (n, 3) with at least one row")
    unusable = ~np.isfinite(array).all(axis=1)
    if unusable.any():
        row = int(np.flatnonzero(unusable)[0])
        raise InputError(f"{name}[{row}] is {array[row].tolist()}, expected finite coordinates")
    return array


def _nearest(views: Float, points: Float) -> tuple[int, int]:
    distances = [np.linalg.norm(points - view, axis=1) for view in views]
    i = int(np.argmin([distance.min() for distance in distances]))
    return i, int(distances[i].argmin())
