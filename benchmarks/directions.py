"""Relative directions between views from the bearings they share, for solvers that know no points.

For views ``i, j`` at ``C_i, C_j`` and world directions ``v_i, v_j`` to the same point, ``n = v_i x v_j`` is
perpendicular to the baseline: ``n . t = 0``, ``t = (C_j - C_i) / |C_j - C_i|``. Each pair of views gets the ``t`` of
the least robust sum of ``rho(n . t / gradient)``, the gradient turning ``n . t`` into an angle. Everything runs over
all pairs at once: a row is one point seen by one pair, rows are sorted by pair, and a pair is summed by ``reduceat``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from panopath.model import Float, Int

#: Random two-point hypotheses per pair; with 35 % false bearings all of them are contaminated once in 10^4.
HYPOTHESES = 48
REFINEMENTS = 10
#: Residuals beyond this many standard deviations weigh little (Geman-McClure).
CUTOFF = 3.0


@dataclass(frozen=True)
class PairDirections:
    """Directions between views, in the world."""

    #: (P,) int32 views, ``first < second``.
    first: Int
    second: Int
    #: (P, 3) unit vectors from the first view to the second.
    direction: Float
    #: (P,) standard deviation of the direction, radians per tangent direction.
    sigma_rad: Float
    #: (P,) points the two views share.
    n_shared: Int


@dataclass(frozen=True)
class _Rows:
    """One row a point a pair, sorted by pair; ``start[p]`` is the first row of pair ``p``."""

    first: Int
    second: Int
    start: npt.NDArray[np.int64]
    pair: npt.NDArray[np.int64]
    from_first: Float
    from_second: Float
    normal: Float


def pairwise_directions(
    view: Int,
    track: Int,
    direction: Float,
    noise_rad: float,
    *,
    min_shared: int = 8,
    seed: int = 0,
) -> PairDirections:
    """Estimate the direction of every pair of views with at least ``min_shared`` common tracks.

    ``direction`` holds (N, 3) world directions; ``noise_rad`` is their standard deviation.
    """
    rows = _shared_rows(view, track, direction, min_shared)
    if not len(rows.start):
        raise ValueError(f"no two views share {min_shared} tracks")
    estimate = _hypothesise(rows, noise_rad, np.random.default_rng(seed))
    weight = np.ones(len(rows.pair))
    information = np.zeros((len(rows.start), 3, 3))
    for _ in range(REFINEMENTS):
        angle, gradient = _residual(rows, estimate)
        weight = _weight(angle, noise_rad)
        scaled = rows.normal * (np.sqrt(weight) / gradient)[:, None]
        information = _sum(rows, scaled[:, :, None] * scaled[:, None, :])
        estimate = np.linalg.eigh(information)[1][:, :, 0]
    middle = np.linalg.eigvalsh(information)[:, 1]
    sigma = noise_rad / np.sqrt(np.maximum(middle, 1e-12))
    counts = np.diff(np.append(rows.start, len(rows.pair))).astype(np.int32)
    return PairDirections(rows.first, rows.second, _point_ahead(rows, estimate, weight), sigma, counts)


def _shared_rows(view: Int, track: Int, direction: Float, min_shared: int) -> _Rows:
    a, b = _pairs_within_tracks(view, track)
    n_views = int(view.max()) + 1
    key = view[a].astype(np.int64) * n_views + view[b]
    order = np.argsort(key, kind="stable")
    key, a, b = key[order], a[order], b[order]
    _, count = np.unique(key, return_counts=True)
    keep = np.repeat(count >= min_shared, count) & (view[a] != view[b])
    key, a, b = key[keep], a[keep], b[keep]
    pairs, start, pair = np.unique(key, return_index=True, return_inverse=True)
    from_first, from_second = direction[a], direction[b]
    return _Rows(
        (pairs // n_views).astype(np.int32),
        (pairs % n_views).astype(np.int32),
        start,
        pair,
        from_first,
        from_second,
        np.cross(from_first, from_second),
    )


def _pairs_within_tracks(view: Int, track: Int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """All pairs of observations of one track, the lower view first."""
    order = np.lexsort((view, track))
    sorted_track = track[order]
    earlier, later = [], []
    for lag in range(1, int(np.bincount(track).max())):
        same = np.flatnonzero(sorted_track[lag:] == sorted_track[:-lag])
        earlier.append(order[same])
        later.append(order[same + lag])
    if not earlier:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    return np.concatenate(earlier), np.concatenate(later)


def _hypothesise(rows: _Rows, noise_rad: float, rng: np.random.Generator) -> Float:
    """Best of many ``t = n_a x n_b`` per pair, by the robust sum."""
    count = np.diff(np.append(rows.start, len(rows.pair)))
    best = np.tile([0.0, 0.0, 1.0], (len(count), 1))
    best_score = np.full(len(count), -np.inf)
    for _ in range(HYPOTHESES):
        a = rows.start + rng.integers(0, count)
        b = rows.start + (a - rows.start + rng.integers(1, count)) % count
        candidate = np.cross(rows.normal[a], rows.normal[b])
        length = np.linalg.norm(candidate, axis=1, keepdims=True)
        candidate = np.where(length > 0, candidate / np.where(length > 0, length, 1.0), best)
        # rows of hardly any parallax agree with everything: weigh by parallax so that they do not decide
        angle, _ = _residual(rows, candidate)
        parallax = np.linalg.norm(rows.normal, axis=1)
        score = _sum(rows, _weight(angle, noise_rad) * parallax / (parallax + 3 * noise_rad))
        better = score > best_score
        best[better], best_score[better] = candidate[better], score[better]
    return best


def _residual(rows: _Rows, estimate: Float) -> tuple[Float, Float]:
    """Angle by which each row misses its epipolar plane, and the gradient ``d(n . t) / d(angle)`` of ``n . t``."""
    t = estimate[rows.pair]
    gradient = np.sqrt(
        (np.cross(t, rows.from_first) ** 2).sum(axis=1) + (np.cross(t, rows.from_second) ** 2).sum(axis=1)
    )
    gradient = np.maximum(gradient, 1e-3)
    return np.einsum("ij,ij->i", rows.normal, t) / gradient, gradient


def _weight(angle: Float, noise_rad: float) -> Float:
    return np.asarray((1.0 + (angle / (CUTOFF * noise_rad)) ** 2) ** -2)


def _sum(rows: _Rows, values: Float) -> Float:
    return np.asarray(np.add.reduceat(values, rows.start, axis=0))


def _point_ahead(rows: _Rows, estimate: Float, weight: Float) -> Float:
    """Choose the sign of each direction by which most points lie in front of both views.

    With ``d_i v_i - d_j v_j = t``, both ``|n|^2 d_i = n . (t x v_j)`` and ``|n|^2 d_j = n . (t x v_i)``.
    """
    t = estimate[rows.pair]
    depth = np.einsum("ij,ij->i", rows.normal, np.cross(t, rows.from_first + rows.from_second))
    vote = _sum(rows, weight * depth)
    return np.asarray(np.where(vote[:, None] < 0, -estimate, estimate))
