"""Matches of many images: which pairs to try, what they share, and then all that their motion allows.

    candidates -> matches of the features that stand out most -> relative poses -> matches of all features near the path
    that each must take

Comparing every feature with every other costs the square of their number, so this is done with the first few hundred
alone; they tell how a pair has turned and moved, and to about what depth the scene comes near. All others are then
sought along their great circle only.

Candidates are neighbours in the sequence, all pairs where images are few, images taken at near places, and images that
look alike: each is told in one vector of how its descriptors differ from the nearest of a few words (VLAD; Jegou et
al., CVPR 2010). It knows nothing of where on the sphere things are, so it does not change when the camera turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.frontend.drift import drifting_features, drifting_matches, features_beside
from panopath.frontend.features import Features
from panopath.model import Bool, Float, Int, read_only
from panopath.steps import (
    FeatureMatches,
    MatchOptions,
    MotionGuides,
    TwoViewOptions,
    TwoViews,
    TwoViewStatus,
    match_features,
    relative_poses,
)

Index = npt.NDArray[np.int64]

#: Words of the vectors that say which images look alike, features of an image that they are made of, and rounds.
_WORDS, _TOLD_BY, _ROUNDS = 32, 500, 8
#: Widest band about a great circle, pixels.
_WIDEST_PX = 8.0
#: Matches of the features that stand out most that a pose may rest on.
_FEWEST = 12
#: A direction of motion rests on at least so many matches with parallax, and on this share of all that have some. What
#: is far away, clouds and hills, agrees with any direction, and along any direction a few wrong matches lie by chance.
_FEWEST_NEAR, _SHARE_NEAR = 12, 0.3
#: Standard deviations, and those assumed at least, in pixels, beyond which a match is no longer of something far away.
_FAR_SIGMAS, _LEAST_SIGMA_PX = 4.0, 0.3
#: What drifts is sought so many times, since motions found without it show more of it.
_DRIFT_ROUNDS = 3
#: The parallax allowed is so many times that of nearly all matches that are known, and between these, radians.
_REACH, _LEAST_REACH_RAD, _MOST_REACH_RAD = 1.5, float(np.radians(3.0)), float(np.radians(75.0))


@dataclass(frozen=True)
class MatchingOptions:
    """Choices of :func:`match_images`."""

    #: Images that follow one another are tried with so many of the next.
    neighbours: int = 8
    #: Up to so many images, every pair is tried.
    exhaustive_images: int = 40
    #: Images that look alike and are no neighbours, tried for each image.
    look_alikes: int = 6
    #: Images at known places are tried with so many of the nearest.
    nearest: int = 10
    #: Features of an image that find the motion.
    leading_features: int = 900
    #: Pairs with fewer matches are left out.
    min_matches: int = 15
    #: Angle of a match to the great circle of its motion that is always allowed, pixels; more where the pair shows more
    #: noise. Wide bands let in look-alikes beside the path, of which a tiled pavement has many that agree.
    band_px: float = 1.0
    #: Whether to leave out what drifts behind the scene as clouds do.
    leave_out_drift: bool = True
    #: Of everything random.
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (
            ("neighbours", 1),
            ("exhaustive_images", 0),
            ("look_alikes", 0),
            ("nearest", 0),
            ("leading_features", 8),
            ("min_matches", 1),
            ("seed", 0),
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise InputError(f"{name} is {value!r}, expected a whole number of at least {least}")
        if not (np.isfinite(self.band_px) and self.band_px > 0.0):
            raise InputError(f"band_px is {self.band_px!r}, expected a positive number")


@dataclass(frozen=True, eq=False)
class ImageMatches:
    """Matches of all pairs of images that show the same things, flat."""

    #: (P, 2) images, the smaller first, in ascending order.
    pairs: Int
    #: (P + 1,) where the matches of each pair begin.
    starts: Index
    #: (N, 2) feature of the first and of the second image, counted within their images.
    matches: Int
    #: (P, 3, 3) takes bearings of the first image to the second, as the leading features found it.
    second_from_first: Float
    #: Pairs that were tried.
    n_tried: int

    def __post_init__(self) -> None:
        for name in ("pairs", "starts", "matches", "second_from_first"):
            read_only(getattr(self, name))

    @property
    def counts(self) -> Index:
        """(P,) matches of each pair."""
        return np.diff(self.starts)


def match_images(
    features: Sequence[Features],
    bearings: Sequence[npt.ArrayLike],
    pixel_rad: float,
    options: MatchingOptions | None = None,
    *,
    in_sequence: bool = True,
    positions_m: npt.ArrayLike | None = None,
    pairs: npt.ArrayLike | None = None,
    all_around: bool = True,
) -> ImageMatches:
    """Match all images that show the same things.

    Parameters
    ----------
    features
        Those of M images.
    bearings
        M arrays (n, 3), the unit vectors of the features in the cameras.
    pixel_rad
        The angle that a pixel spans.
    options
        Choices; default ``MatchingOptions()``.
    in_sequence
        Whether images were taken in their order.
    positions_m
        (M, 3) places where they were taken, as far as is known, else NaN.
    pairs
        (P, 2) candidates; default: see the module's text.
    all_around
        Whether the images show the whole sphere: clouds that drift are told by what is on their other side.

    Returns
    -------
    ImageMatches
        Pairs without a motion that their features agree with are not there.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    chosen = MatchingOptions() if options is None else options
    if len(features) != len(bearings):
        raise InputError(f"bearings has {len(bearings)} entries, expected {len(features)}, one for each image")
    table = _Table.of(features, bearings)
    tried = candidate_pairs(features, chosen, in_sequence, positions_m) if pairs is None else _sorted(pairs)
    found, matches = _leading(table, tried, chosen)
    drifts: Bool = np.zeros(int(table.starts[-1]), dtype=np.bool_)
    if all_around and chosen.leave_out_drift:
        found, matches, drifts = _without_drift(table, tried, found, matches, pixel_rad, chosen)
    known = _determined(found)
    if in_sequence:
        # the chain must not break where few of the leading features are seen again
        again = np.flatnonzero(~known & (tried[:, 1] - tried[:, 0] == 1))
        retry, more = _leading(table, tried[again], chosen, at_most=None)
    else:
        again, (retry, more) = np.empty(0, dtype=np.int64), _leading(table, tried[:0], chosen)
    return _all_matches(
        table,
        [(tried, found, matches, known), (tried[again], retry, more, _determined(retry))],
        pixel_rad,
        chosen,
        len(tried),
        drifts,
        # what is far away looks alike from everywhere: of places far apart it tells nothing, and its tracks over the
        # whole path tear the map
        most_apart=chosen.neighbours if in_sequence else None,
    )


def candidate_pairs(
    features: Sequence[Features],
    options: MatchingOptions | None = None,
    in_sequence: bool = True,
    positions_m: npt.ArrayLike | None = None,
) -> Int:
    """Pairs of images worth trying: (P, 2), the smaller first, ascending. See :func:`match_images`."""
    chosen, n = MatchingOptions() if options is None else options, len(features)
    if n <= chosen.exhaustive_images:
        return _sorted(np.stack(np.triu_indices(n, 1), axis=1))
    listed = [np.empty((0, 2), dtype=np.int64)]
    near = chosen.neighbours if in_sequence else 0
    for step in range(1, near + 1):
        first = np.arange(n - step)
        listed.append(np.stack((first, first + step), axis=1))
    if positions_m is not None:
        listed.append(_nearest_pairs(np.asarray(positions_m, dtype=np.float64), chosen.nearest))
    look_alikes = chosen.look_alikes if in_sequence else 2 * chosen.look_alikes + chosen.neighbours
    listed.append(_look_alikes(features, look_alikes, near))
    return _sorted(np.concatenate(listed))


def _sorted(pairs: npt.ArrayLike) -> Int:
    rows = np.sort(np.asarray(pairs, dtype=np.int64).reshape(-1, 2), axis=1)
    return np.unique(rows[rows[:, 0] != rows[:, 1]], axis=0).astype(np.int32)


def _nearest_pairs(positions: Float, most: int) -> Index:
    """Pair every known place with the nearest others."""
    known = np.flatnonzero(np.isfinite(positions).all(axis=1))
    listed = [np.empty((0, 2), dtype=np.int64)]
    for i in known.tolist():
        distance = np.linalg.norm(positions[known] - positions[i], axis=1)
        near = known[np.argsort(distance, kind="stable")[: most + 1]]
        listed.append(np.stack((np.full(len(near), i), near), axis=1))
    return np.concatenate(listed)


def _look_alikes(features: Sequence[Features], most: int, near: int) -> Index:
    """Pair every image with those that look most like it, of each stretch of the sequence the one that does most."""
    vectors = _vectors(features)
    n, listed = len(features), [np.empty((0, 2), dtype=np.int64)]
    for i in range(n):
        alike = vectors @ vectors[i]
        alike[max(0, i - near) : i + near + 1] = -np.inf
        found = []
        for _ in range(most):
            j = int(np.argmax(alike))
            if not np.isfinite(alike[j]):
                break
            found.append((i, j))
            # neighbours of a look-alike look like it, and say no more (where there is no order, near is 0)
            alike[max(0, j - near // 3) : j + near // 3 + 1] = -np.inf
        listed.append(np.array(found, dtype=np.int64).reshape(-1, 2))
    return np.concatenate(listed)


def _vectors(features: Sequence[Features]) -> npt.NDArray[np.float32]:
    """(M, words x 128): how the descriptors of each image differ from their words, of unit length."""
    leading = [f.descriptors[:_TOLD_BY].astype(np.float32) / 512.0 for f in features]
    every = np.concatenate([np.zeros((1, 128), dtype=np.float32), *leading])
    sample = every[:: max(1, len(every) // 10_000)]
    words = sample[:: max(1, len(sample) // _WORDS)][:_WORDS].copy()
    for _ in range(_ROUNDS):
        nearest = _nearest_word(sample, words)
        for w in range(len(words)):
            if (nearest == w).any():
                words[w] = sample[nearest == w].mean(axis=0)
    vectors = np.zeros((len(features), len(words), 128), dtype=np.float32)
    for i, rows in enumerate(leading):
        nearest = _nearest_word(rows, words)
        np.add.at(vectors[i], nearest, rows - words[nearest])
    vectors /= np.maximum(np.linalg.norm(vectors, axis=2, keepdims=True), 1e-9)
    flat = vectors.reshape(len(features), -1)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9))


def _nearest_word(rows: npt.NDArray[np.float32], words: npt.NDArray[np.float32]) -> Index:
    return np.asarray(np.argmin((words**2).sum(axis=1) - 2.0 * rows @ words.T, axis=1))


@dataclass(frozen=True, eq=False)
class _Table:
    """Features of all images, flat."""

    starts: Index
    descriptors: npt.NDArray[np.uint8]
    bearings: Float

    @classmethod
    def of(cls, features: Sequence[Features], bearings: Sequence[npt.ArrayLike]) -> _Table:
        rays = [np.asarray(rows, dtype=np.float64).reshape(-1, 3) for rows in bearings]
        for i, (image, rows) in enumerate(zip(features, rays, strict=True)):
            if len(image) != len(rows):
                raise InputError(f"bearings[{i}] has {len(rows)} rows, expected {len(image)}, one for each feature")
        return cls(
            np.concatenate(([0], np.cumsum([len(image) for image in features]))).astype(np.int64),
            np.concatenate([np.empty((0, 128), dtype=np.uint8), *(image.descriptors for image in features)]),
            np.concatenate([np.empty((0, 3)), *rays]),
        )

    def match(self, pairs: Int, options: MatchOptions, guides: MotionGuides | None = None) -> FeatureMatches:
        return match_features(self.starts, self.descriptors, self.bearings, pairs, options, guides)

    def rays(self, pairs: Int, matches: FeatureMatches) -> tuple[Float, Float]:
        """Bearings of the matches in the first and in the second images."""
        row = np.repeat(np.arange(len(pairs)), np.diff(matches.starts))
        at = matches.matches + self.starts[pairs[row]]
        return self.bearings[at[:, 0]], self.bearings[at[:, 1]]


def _leading(
    table: _Table, pairs: Int, options: MatchingOptions, *, at_most: int | None = -1
) -> tuple[TwoViews, FeatureMatches]:
    """Relative poses by the features that stand out most."""
    most = options.leading_features if at_most == -1 else at_most
    matches = table.match(pairs, MatchOptions(max_features=most))
    first, second = table.rays(pairs, matches)
    return relative_poses(matches.starts, first, second, TwoViewOptions(seed=options.seed)), matches


def _without_drift(  # noqa: PLR0917
    table: _Table, pairs: Int, found: TwoViews, matches: FeatureMatches, pixel_rad: float, options: MatchingOptions
) -> tuple[TwoViews, FeatureMatches, Bool]:
    """Find the motions again without features that drift as clouds do, in all pairs that they are matched in.

    Also gives which of all features are among those that drift.
    """
    every = np.zeros(int(table.starts[-1]), dtype=np.bool_)
    for _ in range(_DRIFT_ROUNDS):
        row = np.repeat(np.arange(len(pairs)), np.diff(matches.starts))
        sigma = np.maximum(np.nan_to_num(found.sigma_rad), _LEAST_SIGMA_PX * pixel_rad)
        first, second = table.rays(pairs, matches)
        is_near = _parallax(found, row, first, second) > _FAR_SIGMAS * sigma[row]
        drifting = drifting_matches(first, second, found, is_near, sigma, options.seed)
        if not drifting.any():
            break
        feature = matches.matches + table.starts[pairs[row]]
        drifts = drifting_features(table.starts, table.bearings, feature, row, (drifting, is_near, found.inlier))
        every |= drifts
        keep = ~drifts[feature].any(axis=1)
        counts = np.bincount(row[keep], minlength=len(pairs))
        matches = FeatureMatches(np.concatenate(([0], np.cumsum(counts))).astype(np.int64), matches.matches[keep])
        found = relative_poses(matches.starts, first[keep], second[keep], TwoViewOptions(seed=options.seed))
    return found, matches, features_beside(table.starts, table.bearings, every)


def _parallax(found: TwoViews, row: Index, first: Float, second: Float) -> Float:
    """Angles between bearings of matches but for the rotation of their pair."""
    turned = np.einsum("nij,nj->ni", found.second_from_first[row], first)
    return np.asarray(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(turned - second, axis=1), 0.0, 1.0)))


def _determined(found: TwoViews) -> Bool:
    status = np.array([one != TwoViewStatus.UNDETERMINED for one in found.status], dtype=np.bool_)
    return np.asarray(status & (found.n_inliers >= _FEWEST))


def _all_matches(  # noqa: PLR0917
    table: _Table,
    rounds: Sequence[tuple[Int, TwoViews, FeatureMatches, Bool]],
    pixel_rad: float,
    options: MatchingOptions,
    n_tried: int,
    drifts: Bool,
    most_apart: int | None,
) -> ImageMatches:
    """Match all features of the pairs whose motion is known, where it allows."""
    pairs = np.concatenate([tried[known] for tried, _, _, known in rounds])
    parts = [_guides(table, tried, found, by, pixel_rad, options) for tried, found, by, _ in rounds]
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    pairs = pairs[order]
    turn, direction, reach, band = (
        np.concatenate([part[known] for part, (*_, known) in zip(column, rounds, strict=True)])[order]
        for column in zip(*parts, strict=True)
    )
    if most_apart is not None:
        told = np.isfinite(direction).all(axis=1) | (pairs[:, 1] - pairs[:, 0] <= most_apart)
        pairs, turn, direction, reach, band = (rows[told] for rows in (pairs, turn, direction, reach, band))
    found = table.match(pairs, MatchOptions(), MotionGuides(turn, direction, reach, band))
    if drifts.any():
        row = np.repeat(np.arange(len(pairs)), np.diff(found.starts))
        rests = ~drifts[found.matches + table.starts[pairs[row]]].any(axis=1)
        start = np.concatenate(([0], np.cumsum(np.bincount(row[rests], minlength=len(pairs)))))
        found = FeatureMatches(start.astype(np.int64), found.matches[rests])
    counts = np.diff(found.starts)
    keep = counts >= options.min_matches
    return ImageMatches(
        pairs=pairs[keep],
        starts=np.concatenate(([0], np.cumsum(counts[keep]))).astype(np.int64),
        matches=found.matches[np.repeat(keep, counts)],
        second_from_first=turn[keep],
        n_tried=n_tried,
    )


def _guides(  # noqa: PLR0917
    table: _Table, pairs: Int, found: TwoViews, matches: FeatureMatches, pixel_rad: float, options: MatchingOptions
) -> tuple[Float, Float, Float, Float]:
    """Where to look for the other features of each pair: rotation, direction of motion, parallax, width of the band.

    Where nothing but what is far away tells of the motion, only that is looked for.
    """
    first, second = table.rays(pairs, matches)
    row = np.repeat(np.arange(len(pairs)), np.diff(matches.starts))
    parallax = _parallax(found, row, first, second)
    sigma = np.nan_to_num(found.sigma_rad)
    is_near = parallax > _FAR_SIGMAS * np.maximum(sigma, _LEAST_SIGMA_PX * pixel_rad)[row]
    n_near = np.bincount(row[is_near & found.inlier], minlength=len(pairs))
    n_parallax = np.bincount(row[is_near], minlength=len(pairs))
    moved = np.isfinite(found.direction).all(axis=1)
    moved &= (n_near >= _FEWEST_NEAR) & (n_near >= _SHARE_NEAR * n_parallax)
    band = np.clip(4.0 * sigma, options.band_px * pixel_rad, _WIDEST_PX * pixel_rad)
    reach = np.array(band)
    for p in np.flatnonzero(moved).tolist():
        rows = slice(int(matches.starts[p]), int(matches.starts[p + 1]))
        true = parallax[rows][found.inlier[rows]]
        reach[p] = np.clip(_REACH * np.quantile(true, 0.98), _LEAST_REACH_RAD, _MOST_REACH_RAD)
    return found.second_from_first, np.where(moved[:, None], found.direction, np.nan), reach, band
