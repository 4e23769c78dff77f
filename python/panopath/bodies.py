"""Tracks that move as one rigid body: a car has many features.

Two tracks of a body keep their distance: ``|P_a(t) - P_b(t)|`` is constant, so that ``(v_a - v_b) . (P_a - P_b) = 0``;
where the body does not turn, ``v_a = v_b``. Pairs that are near each other and agree so, as far as their covariances
tell, join groups, and groups join where most of the pairs between them agree: two people who pass each other are near
both for a moment, and a crowd is a chain of neighbours, but no body.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from panopath.model import Bool, Float, Scene
from panopath.movers import view_times
from panopath.paths import Int, Paths

Index = npt.NDArray[np.int64]

#: Largest distance of two tracks that join groups, and of two that are compared, as shares of that from the camera.
_NEAR, _COMPARED = 0.25, 0.5
#: Deviations by which a distance may change, and a speed along it differ from nothing.
_DEVIATIONS = 3.0
#: Squared deviations of equal velocities: one in a thousand is larger, in the plane and in space.
_VELOCITY_LIMIT = {2: 13.8, 3: 16.3}
#: A difference of velocities with a deviation beyond this share of the speed tells nothing.
_TOLD = 0.5
#: Times at which two tracks are compared, at most; common times that they need.
_TIMES, _LEAST_TIMES = 5, 3
#: Share of the pairs between two groups that must agree.
_AGREE = 0.5
#: Samples in memory, pairs that are compared at once.
_MOST_SAMPLES, _BLOCK = 2_000_000, 200_000


def grouped(scene: Scene) -> Paths:
    """Find which moving tracks belong to one rigid body.

    Parameters
    ----------
    scene
        With paths that have covariances, and with the times of the views.

    Returns
    -------
    Paths
        Those of the scene with ``body`` set: numbers from 0, in order of the first track; -1 for a track that is at
        rest, moves by itself, or whose motion is not known well enough to tell. No path is changed.
    """
    paths = scene.paths
    if paths is None:
        raise ValueError("the scene has no paths")
    body = np.full(len(paths), -1, dtype=np.int32)
    if paths.covariances is not None:
        groups = [group for part in _parts(scene, paths) for group in _groups(part)]
        for number, group in enumerate(sorted(groups, key=lambda members: int(members[0]))):
            body[group] = number
    return replace(paths, body=body)


@dataclass(frozen=True, eq=False)
class _Samples:
    """Where the movers of one part were at the times of its views, track after track, each at times in a row."""

    #: (m,) their tracks, the first and the last time (index) of each, and where its rows begin.
    tracks: Int
    first: Index
    last: Index
    row: Index
    #: (n, d) and (n, d, d) of the rows.
    position: Float
    velocity: Float
    position_covariance: Float
    velocity_covariance: Float
    #: (n,) distance from the camera at that time.
    distance: Float

    def rows(self, mover: Index, time: Index) -> Index:
        """Rows of movers at times that each was seen at."""
        return np.asarray(self.row[mover] + time - self.first[mover])


def _parts(scene: Scene, paths: Paths) -> Iterator[_Samples]:
    """Movers, part by part; parts share no scale."""
    for component in range(scene.n_components):
        times = view_times(scene, component)
        chosen = np.flatnonzero(paths.moving & (scene.track_component == component))
        first = np.searchsorted(times, paths.seen_s[chosen, 0], side="left")
        last = np.searchsorted(times, paths.seen_s[chosen, 1], side="right") - 1
        stride = 1 + int((last - first + 1).clip(0).sum()) // _MOST_SAMPLES
        if stride > 1:
            # long tracks do not need all of their times; a short one that loses its own is left alone
            times, first, last = times[::stride], -(-first // stride), last // stride
        known = last - first + 1 >= _LEAST_TIMES
        if known.sum() >= 2:
            yield _sampled(scene, paths, component, times, (chosen[known], first[known], last[known]))


def _sampled(scene: Scene, paths: Paths, component: int, times: Float, movers: tuple[Index, Index, Index]) -> _Samples:
    chosen, first, last = movers
    centers = _camera_at(scene, component, times)
    columns: list[list[Float]] = [[], [], [], [], []]
    for track, i, k in zip(chosen.tolist(), first.tolist(), last.tolist(), strict=True):
        now = times[i : k + 1]
        place = paths.position(track, now, outside=True)
        columns[0].append(place)
        columns[1].append(paths.velocity(track, now, outside=True))
        columns[2].append(paths.position_covariance(track, now))
        columns[3].append(paths.velocity_covariance(track, now))
        columns[4].append(np.linalg.norm(place - centers[i : k + 1], axis=1))
    row = np.concatenate(([0], np.cumsum(last - first + 1)[:-1]))
    return _Samples(chosen.astype(np.int32), first, last, row, *(np.concatenate(column) for column in columns))


def _camera_at(scene: Scene, component: int, times: Float) -> Float:
    """Give the camera's place (n, d) at times of its views; of several views of one time the first."""
    views = np.flatnonzero((scene.view_component == component) & np.isfinite(scene.centers).all(axis=1))
    if scene.tracks is None or scene.tracks.time_s is None:
        return np.empty((0, scene.d))
    views = views[np.isfinite(scene.tracks.time_s[views])]
    views = views[np.argsort(scene.tracks.time_s[views], kind="stable")]
    return np.asarray(scene.centers[views[np.searchsorted(scene.tracks.time_s[views], times)]])


def _groups(samples: _Samples) -> list[Int]:
    """Find groups of two tracks or more, each in order."""
    found = [_compared(samples, a, b) for a, b in _pairs(samples)]
    if not found:
        return []
    a, b, agree, gap = (np.concatenate(column) for column in zip(*found, strict=True))
    label = _joined(len(samples.tracks), a, b, agree, gap)
    order = np.argsort(label, kind="stable")
    each = np.split(samples.tracks[order], np.flatnonzero(np.diff(label[order])) + 1)
    return [np.sort(members) for members in each if len(members) > 1]


def _pairs(samples: _Samples) -> Iterator[tuple[Index, Index]]:
    """Pairs with common times that are near enough to be compared, each once, in blocks.

    A pair is met where the later one of it begins: there, along the axis along which places differ most, only a window
    of the others can be near.
    """
    begin = samples.first
    for now in np.unique(begin).tolist():
        later = np.flatnonzero(begin == now)
        there = np.flatnonzero((begin <= now) & (samples.last >= now + _LEAST_TIMES - 1))
        if len(there) < 2:
            continue
        rows = samples.rows(there, np.full(len(there), now))
        place = samples.position[rows]
        axis = int(np.argmax(np.ptp(place, axis=0)))
        there = there[np.argsort(place[:, axis], kind="stable")]
        along = np.sort(place[:, axis])
        mine = samples.rows(later, np.full(len(later), now))
        reach = _COMPARED * samples.distance[mine]
        lower = np.searchsorted(along, samples.position[mine, axis] - reach)
        upper = np.searchsorted(along, samples.position[mine, axis] + reach, side="right")
        yield from _windows(samples, now, later, there, lower, upper)


def _windows(  # noqa: PLR0917 (the windows of one time)
    samples: _Samples, now: int, later: Index, there: Index, lower: Index, upper: Index
) -> Iterator[tuple[Index, Index]]:
    """Pairs of each later one with those in its window, near in all coordinates."""
    sizes = upper - lower
    ends = np.cumsum(sizes)
    start = 0
    while start < len(later):
        stop = max(start + 1, int(np.searchsorted(ends, (ends[start - 1] if start else 0) + _BLOCK, side="right")))
        count = sizes[start:stop]
        a = np.repeat(later[start:stop], count)
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        b = there[np.repeat(lower[start:stop], count) + within]
        start = stop
        # of two that begin together the first meets the second
        a, b = (each[(samples.first[b] < now) | (a < b)] for each in (a, b))
        ra, rb = (samples.rows(each, np.full(len(each), now)) for each in (a, b))
        apart = np.linalg.norm(samples.position[ra] - samples.position[rb], axis=1)
        near = apart <= _COMPARED * np.minimum(samples.distance[ra], samples.distance[rb])
        if near.any():
            yield a[near], b[near]


def _compared(samples: _Samples, a: Index, b: Index) -> tuple[Index, Index, Bool, Float]:
    """Whether pairs move as one body would have them, and how far apart they are at most, over the distance."""
    low, high = np.maximum(samples.first[a], samples.first[b]), np.minimum(samples.last[a], samples.last[b])
    share = np.linspace(0.0, 1.0, _TIMES)
    times = np.rint(low[:, None] + (high - low)[:, None] * share).astype(np.int64)
    ra, rb = samples.rows(a[:, None], times), samples.rows(b[:, None], times)
    apart = samples.position[ra] - samples.position[rb]
    length = np.linalg.norm(apart, axis=2)
    along = apart / np.maximum(length, np.finfo(float).tiny)[:, :, None]
    placed = samples.position_covariance[ra] + samples.position_covariance[rb]
    moved = samples.velocity_covariance[ra] + samples.velocity_covariance[rb]
    keeps = _keeps_distance(length, _across(along, placed))
    drift = samples.velocity[ra] - samples.velocity[rb]
    speed = np.linalg.norm(samples.velocity[ra] + samples.velocity[rb], axis=2) / 2.0
    keeps &= _moves_alike(drift, speed, along, moved)
    gap = (length / np.minimum(samples.distance[ra], samples.distance[rb])).max(axis=1)
    return a, b, keeps, gap


def _across(direction: Float, covariance: Float) -> Float:
    """Variances along directions."""
    return np.asarray(np.einsum("nti,ntij,ntj->nt", direction, covariance, direction))


def _keeps_distance(length: Float, variance: Float) -> Bool:
    change = np.abs(length - np.median(length, axis=1, keepdims=True))
    return np.asarray((change**2 <= _DEVIATIONS**2 * variance).all(axis=1))


def _moves_alike(drift: Float, speed: Float, along: Float, covariance: Float) -> Bool:
    """Equal velocities; or of a body that turns, no speed along the distance, and no turn faster than it goes."""
    told = np.trace(covariance, axis1=2, axis2=3) <= (_TOLD * speed) ** 2
    d = drift.shape[2]
    # exact data leave no covariance to speak of; rounding stands in
    floor = (1e-9 * np.maximum(speed, np.finfo(float).tiny))[:, :, None, None] ** 2 * np.eye(d)
    usable = told & np.isfinite(covariance).all(axis=(2, 3))
    safe = np.where(usable[:, :, None, None], covariance, 0.0) + np.where(floor > 0.0, floor, np.eye(d) * 1e-300)
    squared = np.einsum("nti,nti->nt", drift, np.linalg.solve(safe, drift[:, :, :, None])[:, :, :, 0])
    same = squared <= _VELOCITY_LIMIT[d]
    radial = np.einsum("nti,nti->nt", drift, along)
    turns = radial**2 <= _DEVIATIONS**2 * _across(along, safe)
    turns &= np.linalg.norm(drift, axis=2) <= speed
    return np.asarray(usable.all(axis=1) & (same.all(axis=1) | turns.all(axis=1)))


def _joined(n: int, a: Index, b: Index, agree: Bool, gap: Float) -> Index:
    """Label of each mover: groups join, the nearest pairs first, where most of the pairs between them agree."""
    label = list(range(n))
    members: list[list[int]] = [[k] for k in range(n)]
    between: list[dict[int, list[int]]] = [{} for _ in range(n)]
    for i, k, yes in zip(a.tolist(), b.tolist(), agree.tolist(), strict=True):
        between[i][k] = between[k][i] = [int(yes), 1]
    edges = np.flatnonzero(agree & (gap <= _NEAR))
    edges = edges[np.lexsort((b[edges], a[edges], gap[edges]))]
    for i, k in zip(a[edges].tolist(), b[edges].tolist(), strict=True):
        keep, gone = label[i], label[k]
        if keep == gone:
            continue
        yes, all_told = between[keep][gone]
        if yes < _AGREE * all_told:
            continue
        if len(between[keep]) < len(between[gone]):
            keep, gone = gone, keep
        _merge(between, keep, gone)
        for member in members[gone]:
            label[member] = keep
        members[keep] += members[gone]
        members[gone] = []
    return np.array(label, dtype=np.int64)


def _merge(between: list[dict[int, list[int]]], keep: int, gone: int) -> None:
    """Add what is known of pairs of one group to that of another."""
    del between[keep][gone]
    for other, (yes, all_told) in between[gone].items():
        if other == keep:
            continue
        del between[other][gone]
        found = between[keep].setdefault(other, [0, 0])
        found[0] += yes
        found[1] += all_told
        between[other][keep] = found
    between[gone] = {}
