"""Relative orientation of two panoramas from the bearings that they share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.model import Bool, Float, Int, read_only
from panopath.steps.common import call_core


class TwoViewStatus(StrEnum):
    """What two views turned out to be. A status is an answer, not an exception."""

    #: Rotation and direction are determined.
    GENERAL = "general"
    #: No baseline that the noise would not hide: the rotation is good, there is no direction.
    PURE_ROTATION = "pure_rotation"
    #: All true matches agree with one plane; a second pose may explain them as well.
    PLANAR = "planar"
    #: Too few matches, no consensus beyond chance, or matches that leave the pose open.
    UNDETERMINED = "undetermined"


@dataclass(frozen=True)
class TwoViewOptions:
    """How :func:`relative_pose` and :func:`relative_poses` work; the core checks the values."""

    #: Largest error of a match that may be true, in radians. None: the search takes 0.5 degrees, and what is true is
    #: judged by the noise that the matches turn out to have.
    max_error_rad: float | None = None
    #: Probability to draw a sample of true matches only, at the share of true ones found.
    confidence: float = 0.999
    #: Samples drawn at most.
    max_iterations: int = 1000
    #: Of the random numbers; each pair draws from a stream of its own.
    seed: int = 0
    #: Fewer distinct true matches than this are no answer; at least 6.
    min_inliers: int = 8


@dataclass(frozen=True, eq=False)
class TwoView:
    """Relative orientation of two views. What is not determined is NaN."""

    #: (3, 3) takes bearings of the first camera to the second.
    second_from_first: Float
    #: (3,) unit vector from the first centre to the second, in the frame of the first camera.
    direction: Float
    #: (n,) bool, the matches that are true.
    inlier: Bool
    #: What the views turned out to be.
    status: TwoViewStatus
    #: Standard deviation of a bearing along each tangent direction, in radians, as the true matches show it.
    sigma_rad: float
    #: (3, 3) covariance, rad^2, of the rotation vector ``phi`` of ``exp(phi) @ second_from_first``, direction unknown.
    rotation_covariance: Float
    #: (3, 3) covariance, rad^2, of the direction in the frame of the first camera, rotation unknown.
    direction_covariance: Float
    #: The second pose ``(second_from_first, direction)`` that a planar scene may leave, or None.
    alternative: tuple[Float, Float] | None = None

    @property
    def n_inliers(self) -> int:
        """Number of true matches."""
        return int(self.inlier.sum())


@dataclass(frozen=True, eq=False)
class TwoViews(Sequence[TwoView]):
    """Relative orientations of many pairs, as flat arrays; indexing gives the record of one pair."""

    #: (n_pairs + 1,) int64: the matches of pair ``p`` are rows ``pair_start[p]`` to ``pair_start[p + 1]``.
    pair_start: npt.NDArray[np.int64]
    #: (n_pairs, 3, 3), NaN where undetermined.
    second_from_first: Float
    #: (n_pairs, 3), NaN where there is none.
    direction: Float
    #: (n_matches,) bool.
    inlier: Bool
    #: (n_pairs,) int32 number of true matches.
    n_inliers: Int
    #: One status a pair.
    status: tuple[TwoViewStatus, ...]
    #: (n_pairs,) radians.
    sigma_rad: Float
    #: (n_pairs, 3, 3) rad^2.
    rotation_covariance: Float
    #: (n_pairs, 3, 3) rad^2.
    direction_covariance: Float
    #: (n_pairs, 3, 3) rotation of the second pose that a planar scene may leave, NaN where there is none.
    other_second_from_first: Float
    #: (n_pairs, 3) its direction.
    other_direction: Float

    def __len__(self) -> int:
        return len(self.status)

    def __iter__(self) -> Iterator[TwoView]:
        return (self.pair(p) for p in range(len(self)))

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self.pair(p) for p in range(*index.indices(len(self)))]
        return self.pair(range(len(self))[index])

    def pair(self, p: int) -> TwoView:
        """Record of pair ``p``."""
        other = (self.other_second_from_first[p], self.other_direction[p])
        return TwoView(
            second_from_first=self.second_from_first[p],
            direction=self.direction[p],
            inlier=self.inlier[self.pair_start[p] : self.pair_start[p + 1]],
            status=self.status[p],
            sigma_rad=float(self.sigma_rad[p]),
            rotation_covariance=self.rotation_covariance[p],
            direction_covariance=self.direction_covariance[p],
            alternative=None if np.isnan(other[1]).any() else other,
        )


def relative_pose(
    first: npt.ArrayLike,
    second: npt.ArrayLike,
    options: TwoViewOptions | None = None,
    second_from_first: npt.ArrayLike | None = None,
) -> TwoView:
    """Rotation between two views and direction from one to the other, from the bearings of their matches.

    Samples of five matches (Nister 2004) and a consensus among them, then maximum likelihood with the noise and the
    share of true matches estimated. Fields of view from narrow to the full sphere.

    Parameters
    ----------
    first, second
        (n, 3) unit vectors, row ``k`` of both being the bearings of match ``k`` in the frame of each camera.
    options
        Choices; default ``TwoViewOptions()``.
    second_from_first
        (3, 3) rotation, where it is known: only the direction is then sought, from samples of two matches.

    Returns
    -------
    TwoView
        ``status`` says whether there is a baseline, more than one plane, an answer at all.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    rows = _bearings("first", first)
    known = None
    if second_from_first is not None:
        known = _floats("second_from_first", second_from_first)
        if known.shape != (3, 3):
            raise InputError(f"second_from_first has shape {known.shape}, expected (3, 3)")
        known = known[None]
    return relative_poses([0, len(rows)], rows, second, options, known).pair(0)


def relative_poses(
    pair_start: npt.ArrayLike,
    first: npt.ArrayLike,
    second: npt.ArrayLike,
    options: TwoViewOptions | None = None,
    second_from_first: npt.ArrayLike | None = None,
) -> TwoViews:
    """Relative poses of many pairs of views, in parallel; each as by :func:`relative_pose`.

    The same input and seed give the same bytes on any number of threads, and pair ``p`` does not depend on the others.

    Parameters
    ----------
    pair_start
        (n_pairs + 1,) whole numbers from 0 to n: the matches of pair ``p`` are rows ``pair_start[p]`` to
        ``pair_start[p + 1]``.
    first, second
        (n, 3) unit vectors: bearings in the first and in the second camera of each pair.
    options
        Choices; default ``TwoViewOptions()``.
    second_from_first
        (n_pairs, 3, 3) rotations, where they are known.

    Returns
    -------
    TwoViews
        A sequence with one :class:`TwoView` a pair, held as flat arrays.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    chosen = TwoViewOptions() if options is None else options
    if not isinstance(chosen, TwoViewOptions):
        raise InputError(f"options is a {type(chosen).__name__}, expected TwoViewOptions")
    start = np.asarray(pair_start)
    if start.ndim != 1 or start.dtype.kind not in "iu" or not len(start):
        raise InputError(
            f"pair_start has type {start.dtype} and shape {start.shape}, expected whole numbers (n_pairs + 1,)"
        )
    start = np.array(start, dtype=np.int64)
    known = None
    if second_from_first is not None:
        known = _floats("second_from_first", second_from_first)
        if known.shape != (len(start) - 1, 3, 3):
            raise InputError(f"second_from_first has shape {known.shape}, expected {(len(start) - 1, 3, 3)}")
    found = call_core(
        _core.relative_poses, start, _bearings("first", first), _bearings("second", second), known, _plain(chosen)
    )
    status = tuple(TwoViewStatus(name) for name in found.pop("status"))
    return TwoViews(pair_start=read_only(start), status=status, **{name: read_only(a) for name, a in found.items()})


def matches_that_agree(  # noqa: PLR0917 (the public names and their order are fixed)
    pair_start: npt.ArrayLike,
    matches: npt.ArrayLike,
    bearing: npt.ArrayLike,
    tolerance_rad: npt.ArrayLike,
    second_from_first: npt.ArrayLike,
    baseline: npt.ArrayLike,
    limit_rad: npt.ArrayLike,
) -> Bool:
    """Judge matches by poses that are known, many pairs in parallel.

    A match agrees if both bearings lie within a limit of one epipolar plane and their rays meet in front of both
    cameras, or are parallel as far as the limit can tell.

    Parameters
    ----------
    pair_start
        (n_pairs + 1,) where the matches of each pair begin.
    matches
        (n, 2) rows of ``bearing``: features of the first and of the second image.
    bearing, tolerance_rad
        (k, 3) unit vectors in the cameras, NaN where unknown, and the (k,) angle that each may be off.
    second_from_first, baseline
        (n_pairs, 3, 3) rotations and (n_pairs, 3) vectors from the first centre to the second in the second camera's
        frame, NaN where the two are at one place.
    limit_rad
        (n_pairs,) largest angle to the plane, where it exceeds the features' own.

    Returns
    -------
    array
        (n,) bool.
    """
    return np.asarray(
        call_core(
            _core.matches_that_agree,
            np.ascontiguousarray(pair_start, dtype=np.int64),
            np.ascontiguousarray(matches, dtype=np.int64),
            _bearings("bearing", bearing),
            np.ascontiguousarray(tolerance_rad, dtype=np.float64),
            _floats("second_from_first", second_from_first),
            _bearings("baseline", baseline),
            np.ascontiguousarray(limit_rad, dtype=np.float64),
        ),
        dtype=np.bool_,
    )


def _plain(options: TwoViewOptions) -> dict[str, Any]:
    plain = asdict(options)
    for name, whole in (
        ("max_error_rad", False),
        ("confidence", False),
        ("max_iterations", True),
        ("seed", True),
        ("min_inliers", True),
    ):
        value = plain[name]
        if name == "max_error_rad" and value is None:
            continue
        kinds = (int, np.integer) if whole else (int, float, np.integer, np.floating)
        if isinstance(value, bool) or not isinstance(value, kinds) or (whole and not 0 <= value < 2**63):
            raise InputError(f"{name} is {value!r}, expected {'a whole number of at least 0' if whole else 'a number'}")
    return plain


def _floats(name: str, values: npt.ArrayLike) -> Float:
    try:
        return np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} cannot be read as an array of numbers ({error})") from None


def _bearings(name: str, values: npt.ArrayLike) -> Float:
    bearing = _floats(name, values)
    if bearing.size == 0 and bearing.ndim <= 2:
        return np.empty((0, 3))
    if bearing.ndim != 2 or bearing.shape[1] != 3:
        raise InputError(f"{name} has shape {bearing.shape}, expected (n, 3)")
    return bearing
