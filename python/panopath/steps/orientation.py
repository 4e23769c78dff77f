"""Orientations of views from relative rotations of pairs of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.model import Bool, Float, Int, LinearSolver, Status, read_only
from panopath.priors import Priors
from panopath.steps.common import call_core

#: How far from one the height of a direction may be that counts as vertical.
_VERTICAL = 1e-9
#: Noise of an edge about each axis where nothing is stated, radians; only its ratio to the priors' matters.
DEFAULT_SIGMA_RAD = float(np.deg2rad(1.0))


@dataclass(frozen=True)
class OrientationOptions:
    """Choices of :func:`average_rotations`; the defaults are meant to be right."""

    #: Most re-weighted steps, and most steps of each final fit.
    max_iterations: int = 50
    #: How the sparse system is solved; ``auto`` chooses by predicted cost.
    linear_solver: LinearSolver = "auto"
    #: Work out the covariance of each view: a solve for each.
    covariance: bool = False
    #: Threads to use; None: all cores. The answer does not depend on it.
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.linear_solver not in get_args(LinearSolver):
            raise InputError(f"linear_solver is {self.linear_solver!r}, expected one of {get_args(LinearSolver)}")
        for name in ("max_iterations", "threads"):
            value = getattr(self, name)
            if name == "threads" and value is None:
                continue
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise InputError(f"{name} is {value!r}, expected a whole number from 1")
        if not isinstance(self.covariance, bool):
            raise InputError(f"covariance is {self.covariance!r}, expected True or False")


@dataclass(frozen=True, eq=False)
class Orientations:
    """Orientations of views, and what became of the edges. Views not determined are NaN; the arrays are read-only."""

    #: (n_views, 3, 3) rotations, or (n_views,) headings in radians in the plane. The first view of a part without
    #: priors has the identity; in one with gravity alone it is as near the identity as the vertical lets it.
    cam_from_world: Float
    #: (n_views,) int32, the part each view belongs to, 0 the largest, -1 = none.
    view_component: Int
    #: (n_edges,) whether each edge was used to the end.
    inlier: Bool
    #: (n_edges,) angle between each edge and the answer, NaN between views of different parts.
    residual_rad: Float
    status: Status
    #: Linear systems solved.
    iterations: int
    #: Noise about each axis of an edge of median sigma, from the inliers' loops; NaN without loops.
    sigma_rad: float
    #: (n_views, 3, 3) covariance of the small rotation on the left of each view, against the frame of its part; None
    #: unless asked for. In the plane the entry [2, 2] alone counts.
    covariance_rad2: Float | None = None

    @property
    def n_components(self) -> int:
        """Number of parts whose relative orientation nothing tells."""
        return int(self.view_component.max(initial=-1)) + 1

    def __repr__(self) -> str:
        solved = int((self.view_component >= 0).sum())
        return (
            f"Orientations({self.status.value}: {solved} of {len(self.view_component)} views, "
            f"{int(self.inlier.sum())} of {len(self.inlier)} edges, {self.n_components} part(s))"
        )


def average_rotations(
    first: npt.ArrayLike,
    second: npt.ArrayLike,
    second_from_first: npt.ArrayLike,
    *,
    n_views: int | None = None,
    sigma_rad: npt.ArrayLike | None = None,
    priors: Priors | None = None,
    options: OrientationOptions | None = None,
) -> Orientations:
    """Orientations of all views from relative rotations of pairs, some of which may be wrong.

    Parameters
    ----------
    first, second
        (n_edges,) views that each edge joins; each pair once.
    second_from_first
        (n_edges, 3, 3) rotations, ``cam_from_world[second] = second_from_first @ cam_from_world[first]``. In the plane
        (n_edges,) relative headings in radians: ``heading[second] = heading[first] + second_from_first``, how far the
        second camera is turned anticlockwise against the first.
    n_views
        Number of views; default: the largest index plus one.
    sigma_rad
        Standard deviation of the relative rotations about each axis in radians, one or (n_edges,). None: unknown, the
        same for all; it is then found from the loops.
    priors
        What is known of single views: orientations, the vertical (directions that are z in the world; others are
        passed over), headings. They are weighed by their sigmas and not searched for wrong ones. A view has one of
        each at most.
    options
        Choices; default ``OrientationOptions()``.

    Returns
    -------
    Orientations
        ``status`` says how it ended; ``disconnected`` where edges leave parts whose relative orientation nothing tells.

    Raises
    ------
    InputError
        Naming the argument and the entry that cannot be used.

    Notes
    -----
    Votes of small loops and growth by consensus, re-weighting after Chatterjee and Govindu (ICCV 2013), least squares
    over the edges that agree (``docs/method.md``). Where every view has a gravity ten times tighter than the edges,
    only turns about the vertical are sought. Errors name a row of the edges' arrays as ``edges[row]``, and an entry of
    the priors by its place in all of them, one record after the other.
    """
    chosen = OrientationOptions() if options is None else options
    turns = _numbers("second_from_first", second_from_first)
    if turns.ndim not in (1, 3) or (turns.ndim == 3 and turns.shape[1:] != (3, 3)):
        raise InputError(f"second_from_first has shape {turns.shape}, expected (n_edges, 3, 3) or (n_edges,)")
    n = len(turns)
    ends = [_views(name, values) for name, values in (("first", first), ("second", second))]
    for name, view in zip(("first", "second"), ends, strict=True):
        if len(view) != n:
            raise InputError(f"{name} has {len(view)} rows, expected {n}")
    sigma = _each("sigma_rad", DEFAULT_SIGMA_RAD if sigma_rad is None else sigma_rad, n)
    if priors is not None and not isinstance(priors, Priors):
        raise InputError(f"priors is a {type(priors).__name__}, expected Priors")
    tables = _prior_tables(Priors() if priors is None else priors, is_planar=turns.ndim == 1)
    largest = max((int(view.max()) for view in [*ends, *(table[1] for table in tables)] if len(view)), default=-1)
    found = call_core(
        _core.average_rotations,
        *ends,
        turns,
        _count(n_views, largest),
        sigma,
        tables,
        {**chosen.__dict__, "estimate_noise": sigma_rad is None},
    )
    return _orientations(found, chosen.covariance)


def _orientations(found: dict[str, Any], has_covariance: bool) -> Orientations:
    return Orientations(
        cam_from_world=read_only(found["cam_from_world"]),
        view_component=read_only(found["view_component"]),
        inlier=read_only(found["inlier"]),
        residual_rad=read_only(found["residual_rad"]),
        status=Status(found["status"]),
        iterations=int(found["iterations"]),
        sigma_rad=float(found["sigma_rad"]),
        covariance_rad2=read_only(found["covariance_rad2"]) if has_covariance else None,
    )


def _prior_tables(priors: Priors, *, is_planar: bool) -> list[tuple[Any, ...]]:
    """Kind, views and arrays of each prior that tells of orientation."""
    tables: list[tuple[Any, ...]] = []
    if priors.rotations is not None:
        known = priors.rotations
        if (known.cam_from_world.ndim == 1) != is_planar:
            raise InputError("priors.rotations and second_from_first are not both of the plane, or both of space")
        covariance = known.covariance
        if is_planar:
            covariance = covariance[:, :1, :1] * np.eye(3)
        tables.append(("orientation", known.view.astype(np.uint32), known.cam_from_world, covariance))
    if priors.directions is not None and not is_planar:
        measured = priors.directions
        upward = measured.direction[:, 2] > 1.0 - _VERTICAL
        views = measured.view[upward].astype(np.uint32)
        tables.append(("gravity", views, measured.bearing[upward], measured.sigma_rad[upward]))
    if priors.headings is not None:
        compass = priors.headings
        forward = np.broadcast_to([1.0, 0.0, 0.0], compass.forward.shape) if is_planar else compass.forward
        views = compass.view.astype(np.uint32)
        tables.append(("heading", views, compass.heading_rad, compass.sigma_rad, np.ascontiguousarray(forward)))
    return tables


def _count(n_views: int | None, largest: int) -> int:
    if n_views is None:
        return largest + 1
    if not isinstance(n_views, (int, np.integer)) or isinstance(n_views, bool) or n_views <= largest:
        raise InputError(f"n_views is {n_views!r}, expected a whole number above the largest view, {largest}")
    return int(n_views)


def _numbers(name: str, values: npt.ArrayLike) -> Float:
    try:
        return np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} cannot be read as an array of numbers ({error})") from None


def _shaped(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> Float:
    array = _numbers(name, values)
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}, expected {shape}")
    return array


def _each(name: str, values: npt.ArrayLike, n: int) -> Float:
    """One number for all, or one for each."""
    array = _numbers(name, values)
    return np.full(n, float(array)) if array.ndim == 0 else _shaped(name, array, (n,))


def _views(name: str, values: npt.ArrayLike) -> Int:
    array = _numbers(name, values)
    if array.ndim != 1:
        raise InputError(f"{name} has shape {array.shape}, expected one view a row")
    wrong = ~((array >= 0.0) & (array < 2.0**31 - 1.0) & (array == np.floor(array)))
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(f"{name}[{k}] is {array[k]}, expected a whole number from 0")
    return array.astype(np.int32)
