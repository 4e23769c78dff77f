"""A certificate by dense linear algebra, for tests of how certificates are shown: small scenes, orientations known.

The rigidity matrix has the rows ``(I - u u^T) (dX_j - dC_i) / |X_j - C_i|``; null vectors beyond the gauge stretch each
observation by ``u . (dX_j - dC_i) / |X_j - C_i|``, and what is stretched alike and hangs together is a rigid part.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import panopath as pp
from panopath.certificate import (
    Cause,
    CauseKind,
    Certificate,
    Consistency,
    Gap,
    Hinge,
    Mode,
    RigidComponent,
    Verdict,
)
from panopath.formats.structure import known_scene

Int = npt.NDArray[np.int32]
Float = npt.NDArray[np.float64]
Pairs = Sequence[tuple[int, int]]

_NULL = 1e-9
_WEAK_MOVEMENT = 0.1


def scene_of_positions(centers: npt.ArrayLike, points: npt.ArrayLike, pairs: Pairs | None = None) -> pp.Scene:
    """A scene of exact bearings; without pairs every view sees every point."""
    c, p = np.array(centers, dtype=np.float64), np.array(points, dtype=np.float64)
    view, track = np.array(pairs or [(i, j) for i in range(len(c)) for j in range(len(p))]).T
    ray = p[track] - c[view]
    bearing = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    return known_scene(pp.Tracks.from_arrays(view, track, bearing, len(c), len(p)), None, c, p)


def certificate_of(
    scene: pp.Scene,
    causes: Sequence[Cause] = (),
    sigma_rad: float = 1e-4,
    consistency: Consistency | None = None,
) -> Certificate:
    assert scene.tracks is not None
    m, n, d = len(scene.centers), len(scene.points), scene.d
    view, track = scene.tracks.view, scene.tracks.track
    ray = scene.points[track] - scene.centers[view]
    length = np.linalg.norm(ray, axis=1)
    unit = ray / length[:, None]
    across = (np.eye(d) - unit[:, :, None] * unit[:, None, :]) / length[:, None, None]
    matrix = np.zeros((len(view), d, m + n, d))
    rows = np.arange(len(view))
    matrix[rows, :, view] = -across
    matrix[rows, :, m + track] = across
    values, vectors = np.linalg.svd(matrix.reshape(len(view) * d, -1))[1:]
    spectrum = np.zeros((m + n) * d)
    spectrum[: len(values)] = values / values[0]
    n_null = int((spectrum < _NULL).sum())
    place = np.vstack((scene.centers, scene.points))
    free, held = vectors[len(spectrum) - n_null :].T, vectors[: len(spectrum) - n_null]
    extra = _beyond_gauge(free, place)
    moving = extra.reshape(m + n, d, -1)
    stretch = np.einsum("od,odp->op", unit / length[:, None], moving[m + track] - moving[view])
    parts = _parts(view, track, stretch)
    size = float(np.sqrt(((scene.centers - scene.centers.mean(axis=0)) ** 2).sum(axis=1).mean()))
    modes = [_mode(0.0, extra[:, k].reshape(-1, d), m, size, null=True) for k in range(extra.shape[1])]
    moved = sigma_rad / (spectrum[len(held) - 1] * values[0]) * held[-1].reshape(-1, d)
    weak = _mode(spectrum[len(held) - 1], moved, m, size, null=False)
    modes += [weak] if weak.movement > _WEAK_MOVEMENT else []
    holds = Verdict.WEAK if weak.movement > _WEAK_MOVEMENT else Verdict.DETERMINED
    verdict = Verdict.UNDETERMINED if extra.shape[1] else holds
    line = np.array([_own_line(across[(view == x) if x < m else (track == x - m)]) for x in range(m + n)])
    owner = np.full(m + n, -1)
    for index, (views, tracks) in reversed(list(enumerate(parts))):
        owner[views], owner[m + tracks] = index, index
    return Certificate(
        verdict=verdict,
        nullity=n_null,
        gauge_freedoms=d + 1,
        gap=Gap(float(spectrum[len(held) :].max(initial=0.0)), float(spectrum[len(held) - 1]) if len(held) else np.nan),
        components=tuple(
            RigidComponent(views, tracks, len(views) * len(tracks), holds, weak.movement) for views, tracks in parts
        ),
        hinges=_hinges(parts),
        modes=tuple(modes),
        causes=tuple(causes),
        consistency=consistency or Consistency(True, (), {"rms": (1.0, 2.0)}),
        orientation="known",
        sigma_rad=sigma_rad,
        sigma_source="given",
        weak_movement=_WEAK_MOVEMENT,
        n_views=m,
        n_tracks=n,
        view_component=owner[:m],
        track_component=owner[m:],
        view_line=line[:m],
        track_line=line[m:],
        view_looseness=np.linspace(0.01, 0.2, m),
        track_looseness=np.full(n, 0.01),
    )


def cause(kind: CauseKind, views: Sequence[int] = (), tracks: Sequence[int] = (), **fields: object) -> Cause:
    told = {"components": (), "detail": "", "shape": np.empty(0), "is_exact": True} | fields
    return Cause(kind, np.array(views, dtype=np.int32), np.array(tracks, dtype=np.int32), **told)  # type: ignore[arg-type]


def _beyond_gauge(free: Float, place: Float) -> Float:
    d = place.shape[1]
    gauge = [np.tile(axis, (len(place), 1)).ravel() for axis in np.eye(d)] + [(place - place.mean(axis=0)).ravel()]
    basis = np.linalg.qr(np.array(gauge).T)[0]
    left, values, _ = np.linalg.svd(free - basis @ (basis.T @ free), full_matrices=False)
    return np.asarray(left[:, values > 0.5])


def _mode(value: float, moved: Float, m: int, size: float, *, null: bool) -> Mode:
    rms = float(np.sqrt((moved[:m] ** 2).sum(axis=1).mean()))
    scale = size / np.sqrt((moved**2).sum(axis=1).mean()) if null else 1.0
    return Mode(value, null, np.inf if null else rms / size, 0, scale * moved[:m], scale * moved[m:], np.zeros((m, 3)))


def _own_line(across: Float) -> Float:
    """Direction in which a member may move while all others stand still."""
    if not len(across):
        return np.full(across.shape[-1], np.nan)
    values, vectors = np.linalg.eigh((across.transpose(0, 2, 1) @ across).sum(axis=0))
    return vectors[:, 0] if values[0] < _NULL * values[-1] else np.full(across.shape[-1], np.nan)


def _parts(view: Int, track: Int, stretch: Float) -> list[tuple[Int, Int]]:
    group = np.arange(len(view))
    alike = (np.abs(stretch[:, None] - stretch[None]) < 1e-6).all(axis=2)
    touch = (view[:, None] == view[None]) | (track[:, None] == track[None])
    for _ in range(len(view)):
        before, group = group, np.where(alike & touch, group[None], len(view)).min(axis=1)
        if np.array_equal(before, group):
            break
    members = [(np.unique(view[group == g]), np.unique(track[group == g])) for g in np.unique(group)]
    return sorted((p for p in members if len(p[0]) + len(p[1]) > 2), key=lambda p: -len(p[0]) - len(p[1]))


def _hinges(parts: list[tuple[Int, Int]]) -> tuple[Hinge, ...]:
    found = []
    for a in range(len(parts)):
        for b in range(a + 1, len(parts)):
            views, tracks = (np.intersect1d(parts[a][k], parts[b][k]) for k in (0, 1))
            if len(views) + len(tracks):
                found.append(Hinge((a, b), views, tracks))
    return tuple(found)
