"""Matches between the features of pairs of images, by their descriptors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.model import Float, Int, read_only
from panopath.steps.common import call_core


@dataclass(frozen=True)
class MatchOptions:
    """Choices of :func:`match_features`; the core checks the values."""

    #: The nearest descriptor is nearer than this share of the distance to the second nearest.
    max_ratio: float = 0.8
    #: Largest distance between descriptors, in units of their length.
    max_distance: float = 0.7
    #: Only the first so many features of an image take part; None: all.
    max_features: int | None = None


@dataclass(frozen=True, eq=False)
class MotionGuides:
    """What is known of the motion between the images of each pair, beforehand."""

    #: (P, 3, 3) takes bearings of the first image to the second; NaN: not known, every feature meets every other.
    second_from_first: Float
    #: (P, 3) unit vector from the first centre to the second, in the frame of the first image; NaN: not known.
    direction: Float
    #: (P,) largest parallax, radians.
    radius_rad: Float
    #: (P,) largest angle to the great circle on which the motion moves a point, radians.
    band_rad: Float


@dataclass(frozen=True, eq=False)
class FeatureMatches:
    """Matches of all pairs, flat."""

    #: (P + 1,) where the matches of each pair begin.
    starts: npt.NDArray[np.int64]
    #: (N, 2) feature of the first and of the second image, counted within their images.
    matches: Int

    def __len__(self) -> int:
        return len(self.matches)


def match_features(  # noqa: PLR0917
    feature_starts: npt.ArrayLike,
    descriptors: npt.ArrayLike,
    bearings: npt.ArrayLike,
    pairs: npt.ArrayLike,
    options: MatchOptions | None = None,
    guides: MotionGuides | None = None,
) -> FeatureMatches:
    """Match features that are each other's nearest and distinct from the second nearest, where the motion allows.

    Parameters
    ----------
    feature_starts
        (M + 1,) where the features of each image begin, and where the last ones end.
    descriptors
        (K, 128) bytes, all of about the same length.
    bearings
        (K, 3) unit vectors in the camera; NaN where there is none.
    pairs
        (P, 2) images to match.
    options
        Choices; default ``MatchOptions()``.
    guides
        What is known of the motion of each pair: only features that it allows are compared.

    Returns
    -------
    FeatureMatches
        The same on any number of threads.

    Raises
    ------
    InputError
        Naming the argument and the first entry that cannot be used.

    Notes
    -----
    The test of ratios is Lowe's (IJCV 2004, section 7.1), on both sides.
    """
    chosen = MatchOptions() if options is None else options
    for name, value, kind in (("options", chosen, MatchOptions), ("guides", guides, MotionGuides | None)):
        if not isinstance(value, kind):
            raise InputError(f"{name} is a {type(value).__name__}, expected {kind}")
    table = np.asarray(descriptors)
    if table.dtype != np.uint8 or table.ndim != 2:
        raise InputError(f"descriptors has shape {table.shape} and type {table.dtype}, expected (K, 128) bytes")
    rows = np.asarray(pairs, dtype=np.int32).reshape(-1, 2)
    starts, matches = call_core(
        _core.match_features,
        np.ascontiguousarray(feature_starts, dtype=np.int64),
        np.ascontiguousarray(table),
        np.ascontiguousarray(bearings, dtype=np.float64).reshape(-1, 3),
        np.ascontiguousarray(rows),
        None if guides is None else _guides(guides, len(rows)),
        float(chosen.max_ratio),
        float(chosen.max_distance),
        chosen.max_features,
    )
    return FeatureMatches(read_only(starts), read_only(matches))


def _guides(guides: MotionGuides, n_pairs: int) -> tuple[Any, ...]:
    arrays = []
    for name, shape in (("second_from_first", (3, 3)), ("direction", (3,)), ("radius_rad", ()), ("band_rad", ())):
        array = np.ascontiguousarray(getattr(guides, name), dtype=np.float64)
        if array.shape != (n_pairs, *shape):
            raise InputError(f"{name} has shape {array.shape}, expected {(n_pairs, *shape)}")
        arrays.append(array)
    return tuple(arrays)
