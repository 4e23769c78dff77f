"""Clouds drift: in pictures some seconds apart they move by degrees, as one body, and are easily found again.

In pairs taken farther apart most matches may then be of the sky, and the motion that most agree with is that against
the clouds. It is told from the camera's by what does *not* agree with it: the ground shows a parallax of its own,
larger, since nothing is as far away as the sky, and all around, unlike that of a car or a person.

    matches with parallax that miss the motion found -> the direction that most of them agree with, the rotation held
    -> they are many, nearer, and spread over the sphere: the motion found was the drift of what agreed with it alone
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from panopath.model import Bool, Float
from panopath.steps import TwoViewOptions, TwoViews, relative_poses

Index = npt.NDArray[np.int64]

#: A second motion rests on at least so many matches, and on this share of those that miss the first.
_FEWEST, _SHARE = 12, 0.4
#: Its median parallax is larger than that of the first by this factor.
_NEARER = 1.5
#: Length of the mean of its bearings at most, and of those of the first at least: 1 for what lies in one direction, 0
#: for what is all around. The sky is on one side.
_SPREAD, _ONE_SIDE = 0.8, 0.4
#: Two directions of motion that differ by less are one: radians.
_SAME_RAD = float(np.radians(15.0))
#: Drifting features are followed over so many matches.
_HOPS = 3
#: Around drifting features, radians, there are others; a pair of which more than this share lies there moves with them.
_AROUND_RAD, _MOST = float(np.radians(10.0)), 0.7
#: Features so near to one that drifts count as drifting: radians.
_BESIDE_RAD = float(np.radians(5.0))
#: A match agrees with a direction within so many standard deviations.
_AGREES = 3.0


def drifting_matches(  # noqa: PLR0917
    first: Float, second: Float, found: TwoViews, is_near: Bool, sigma: Float, seed: int = 0
) -> Bool:
    """Tell which matches are of something that drifts as a whole behind a nearer scene.

    Parameters
    ----------
    first, second
        (N, 3) bearings of the matches, of all pairs one after another.
    found
        Motions of the P pairs.
    is_near
        (N,) matches with parallax, by the rotation found.
    sigma
        (P,) angular noise of a match, radians.
    seed
        Of everything random.

    Returns
    -------
    array
        (N,) matches that agree with the motion found, where that is the drift, and not with that of the nearer scene.
    """
    row = np.repeat(np.arange(len(found)), np.diff(found.pair_start))
    turned = np.einsum("nij,nj->ni", found.second_from_first[row], first)
    one, missed = is_near & found.inlier, is_near & ~found.inlier
    n_missed = np.bincount(row[missed], minlength=len(found))
    asked = np.flatnonzero(n_missed >= _FEWEST)
    drifting = np.zeros(len(row), dtype=np.bool_)
    if not len(asked):
        return drifting
    rows = np.flatnonzero(missed & (n_missed >= _FEWEST)[row])
    start = np.concatenate(([0], np.cumsum(n_missed[asked]))).astype(np.int64)
    still = np.tile(np.eye(3), (len(asked), 1, 1))
    other = relative_poses(start, turned[rows], second[rows], TwoViewOptions(seed=seed), still)
    for k, p in enumerate(asked.tolist()):
        own = slice(int(found.pair_start[p]), int(found.pair_start[p + 1]))
        two = rows[start[k] : start[k + 1]][other.inlier[start[k] : start[k + 1]]]
        first_ones = np.flatnonzero(one[own]) + own.start
        if _is_nearer_scene(two, n_missed[p], first_ones, turned, second, (found.direction[p], other.direction[k])):
            misses = _off(turned[first_ones], second[first_ones], other.direction[k]) > _AGREES * sigma[p]
            drifting[first_ones[misses]] = True
    return drifting


def drifting_features(
    starts: Index, bearings: Float, feature: Index, row: Index, of_matches: tuple[Bool, Bool, Bool]
) -> Bool:
    """Tell which features drift: those of drifting matches, what they are matched with, and what goes with them.

    Parameters
    ----------
    starts
        (M + 1,) where the features of each image begin.
    bearings
        (K, 3) those of all features.
    feature, row
        (N, 2) features of the matches, counted over all images, and (N,) their pairs.
    of_matches
        (N,) each: those that drift, that show parallax, and that agree with the motion of their pair.

    Returns
    -------
    array
        (K,) features that drift.
    """
    drifting, is_near, agrees = of_matches
    drifts: Bool = np.zeros(len(bearings), dtype=np.bool_)
    drifts[feature[drifting]] = True
    for _ in range(_HOPS):
        drifts[feature[agrees & drifts[feature].any(axis=1)]] = True
    around = features_beside(starts, bearings, drifts, _AROUND_RAD)
    # a pair that moves with the sky alone has no nearer scene to be told from
    moves = is_near & agrees
    n = int(row.max(initial=-1)) + 1
    share = np.bincount(row[moves & around[feature].all(axis=1)], minlength=n) / np.maximum(
        np.bincount(row[moves], minlength=n), 1
    )
    drifts[feature[moves & (share > _MOST)[row]]] = True
    return drifts


def features_beside(starts: Index, bearings: Float, drifts: Bool, within_rad: float = _BESIDE_RAD) -> Bool:
    """(K,) features that drift, or lie within an angle of one of the same image that does."""
    beside = np.array(drifts)
    for begin, end in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        sure = bearings[begin:end][drifts[begin:end]]
        if len(sure):
            beside[begin:end] |= (bearings[begin:end] @ sure.T).max(axis=1) > np.cos(within_rad)
    return beside


def _is_nearer_scene(  # noqa: PLR0917
    two: Index, n_missed: int, one: Index, turned: Float, second: Float, direction: tuple[Float, Float]
) -> bool:
    """Whether the second of two directions of motion is that against a nearer scene."""
    if len(two) < max(_FEWEST, _SHARE * n_missed) or not len(one) or not np.isfinite(direction).all():
        return False
    if direction[0] @ direction[1] > np.cos(_SAME_RAD):
        return False
    near, far = (float(np.median(np.linalg.norm(turned[rows] - second[rows], axis=1))) for rows in (two, one))
    spread = [float(np.linalg.norm(second[rows].mean(axis=0))) for rows in (two, one)]
    return near > _NEARER * far and spread[0] < _SPREAD and spread[1] > _ONE_SIDE


def _off(turned: Float, second: Float, direction: Float) -> Float:
    """Angle of each match to the plane of its epipolar circle."""
    normal = np.cross(turned, direction)
    length = np.linalg.norm(normal, axis=1)
    return np.asarray(np.abs(np.einsum("ni,ni->n", normal, second)) / np.maximum(length, 1e-12))
