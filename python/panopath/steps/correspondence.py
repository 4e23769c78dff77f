"""Tracks from matches between pairs of images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.model import Int, read_only
from panopath.steps.common import call_core


@dataclass(frozen=True)
class CorrespondenceOptions:
    """Choices of :func:`tracks_from_matches`; the defaults are meant to be right."""

    #: Tracks seen in fewer images are left out; at least 2.
    min_images: int = 2
    #: Least share of the possible matches between two tracks that must be there to join them, from 0 to 1.
    min_linkage: float = 0.2


@dataclass(frozen=True, eq=False)
class FeatureTracks:
    """Which features show the same point; in no track does an image have two features.

    Observation ``o`` says that feature ``feature[o]`` of image ``image[o]`` belongs to track ``track[o]``. Tracks are
    in the order of their first feature, observations of a track in the order of their images.
    """

    #: (N,) int32.
    image: Int
    #: (N,) int32, ascending from 0.
    track: Int
    #: (N,) int32, counted within the image.
    feature: Int
    n_tracks: int
    #: Matches whose two features did not end in one track.
    n_cut: int

    def __len__(self) -> int:
        return len(self.image)


def tracks_from_matches(
    n_features: npt.ArrayLike,
    pairs: npt.ArrayLike,
    match_starts: npt.ArrayLike,
    matches: npt.ArrayLike,
    options: CorrespondenceOptions | None = None,
) -> FeatureTracks:
    """Join matched features to tracks, and cut where wrong matches would give an image two features of one point.

    Tracks grow from the match that most other features confirm to the one that fewest do. Two are not joined where they
    hold features of the same image, or where too few of the matches that there could be between them are there.

    Parameters
    ----------
    n_features
        (n_images,) number of features of each image.
    pairs
        (P, 2) images that were matched.
    match_starts
        (P + 1,) where the matches of each pair begin, and where the last ones end.
    matches
        (N, 2) a feature of the first image of the pair and one of the second, each counted within its image.
    options
        Choices; default ``CorrespondenceOptions()``.

    Returns
    -------
    FeatureTracks

    Raises
    ------
    InputError
        Naming the argument and the first entry that cannot be used.

    Notes
    -----
    Union-find with one feature an image: Moulon and Monasse, "Unordered feature tracking made fast and easy", CVMP
    2012. The order and the condition on joins are described in the documentation of ``correspondence.rs``.
    """
    chosen = CorrespondenceOptions() if options is None else options
    if not isinstance(chosen, CorrespondenceOptions):
        raise InputError(f"options is a {type(chosen).__name__}, expected CorrespondenceOptions")
    if isinstance(chosen.min_images, bool) or not isinstance(chosen.min_images, int) or chosen.min_images < 2:
        raise InputError(f"min_images is {chosen.min_images!r}, expected a whole number, 2 or more")
    found = call_core(
        _core.tracks_from_matches,
        _whole("n_features", n_features, np.int64, 1),
        _whole("pairs", pairs, np.int32, 2),
        _whole("match_starts", match_starts, np.int64, 1),
        _whole("matches", matches, np.int32, 2),
        chosen.min_images,
        float(chosen.min_linkage),
    )
    return FeatureTracks(
        image=read_only(found["image"]),
        track=read_only(found["track"]),
        feature=read_only(found["feature"]),
        n_tracks=int(found["n_tracks"]),
        n_cut=int(found["n_cut"]),
    )


def _whole(name: str, values: npt.ArrayLike, dtype: type[np.signedinteger[Any]], n_axes: int) -> npt.NDArray[Any]:
    """Whole numbers in C order; an empty list is an empty array."""
    array = np.asarray(values)
    if array.size == 0:
        return np.empty((0,) if n_axes == 1 else (0, 2), dtype=dtype)
    if array.ndim != n_axes or (n_axes == 2 and array.shape[1] != 2):
        raise InputError(f"{name} has shape {array.shape}, expected {'(n,)' if n_axes == 1 else '(n, 2)'}")
    if array.dtype.kind not in "iu":
        raise InputError(f"{name} has type {array.dtype}, expected whole numbers")
    limits = np.iinfo(dtype)
    if array.dtype != dtype and not limits.min <= int(array.min()) <= int(array.max()) <= limits.max:
        raise InputError(f"{name} holds {array.max()}, expected numbers below {limits.max + 1}")
    return np.ascontiguousarray(array, dtype=dtype)
