"""Bodies that move, for whoever writes or draws a scene: what rests, and where the rest was at which time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, pi

import numpy as np

from panopath.model import Bool, Float, Scene, read_only
from panopath.paths import Fourier, Int, PathModel, Paths, PathVerdict, Spline, Static, Taylor

#: Most times at which one path is looked at.
MOST_TIMES = 4096
#: Straight pieces that a drawing has for one bend of a path.
_PIECES = 8


def resting(scene: Scene) -> Bool:
    """(n_tracks,) whether ``scene.points`` holds a place that is the same at all times; all where there are no paths.

    A body that moves has no such place, and what is neither known to rest nor to move is not given one.
    """
    if scene.paths is None:
        return np.ones(len(scene.points), dtype=np.bool_)
    return np.array([one is PathVerdict.STATIC for one in scene.paths.verdicts], dtype=np.bool_)


def left_out(scene: Scene, component: int | None = None) -> int:
    """How many tracks of a part, or of all, were placed, and yet have no place among points at rest."""
    placed = np.isfinite(scene.points).all(axis=1) & ~resting(scene)
    return int((placed if component is None else placed & (scene.track_component == component)).sum())


def at_rest(scene: Scene) -> Scene:
    """Leave the movers out of a scene: their points are not determined, their observations not in use.

    What takes every point for one at rest, as covariances do, may be given this scene.
    """
    if scene.paths is None:
        return scene
    rests = resting(scene)
    used = scene.inlier if scene.tracks is None else scene.inlier & rests[scene.tracks.track]
    return replace(
        scene,
        points=np.where(rests[:, None], scene.points, np.nan),
        track_component=np.where(rests, scene.track_component, -1),
        inlier=used,
        paths=None,
    )


@dataclass(frozen=True, eq=False)
class PathSamples:
    """Where bodies were, at times of the views; a row a body and time. The arrays are read-only."""

    #: (n,) the body's track.
    track: Int
    #: (n,) seconds.
    time_s: Float
    #: (n, d) units of the scene, and the same a second.
    position: Float
    velocity: Float
    #: (n, d) standard deviations of the positions along the axes; NaN where not known.
    deviation: Float


def samples_at_views(scene: Scene) -> PathSamples:
    """Where each moving body was at the times of the solved views of its part, while it was seen.

    Parameters
    ----------
    scene
        With paths.

    Returns
    -------
    PathSamples
        Track by track, in order of time. Of a scene that does not know its views' times: at the first and last
        observation alone.
    """
    paths = scene.paths
    if paths is None:
        return _samples([], scene.d)
    times_of: dict[int, Float] = {}
    rows = []
    for track in np.flatnonzero(paths.moving).tolist():
        part = int(scene.track_component[track])
        if part not in times_of:
            times_of[part] = view_times(scene, part)
        first, last = paths.seen_s[track]
        times = times_of[part]
        times = times[(times >= first) & (times <= last)] if len(times) else np.unique((first, last))
        deviation = np.full((len(times), scene.d), np.nan)
        if paths.covariances is not None:
            variances = np.diagonal(paths.position_covariance(track, times), axis1=1, axis2=2)
            # rounding may leave a variance of nothing below zero
            deviation = np.sqrt(np.where(variances < 0.0, 0.0, variances))
        rows.append((track, times, paths.position(track, times), paths.velocity(track, times), deviation))
    return _samples(rows, scene.d)


def _samples(rows: list[tuple[int, Float, Float, Float, Float]], d: int) -> PathSamples:
    lengths = [len(times) for _, times, _, _, _ in rows]
    track = np.repeat(np.array([row[0] for row in rows], dtype=np.int32), lengths)
    columns = [np.concatenate([np.empty((0, d)), *(row[k] for row in rows)]) for k in (2, 3, 4)]
    times = np.concatenate([np.empty(0), *(row[1] for row in rows)])
    return PathSamples(read_only(track), read_only(times), *map(read_only, columns))


def view_times(scene: Scene, component: int | None = None) -> Float:
    """(n,) times of the solved views of a part, or of all, each once, in order; none where times are not known."""
    if scene.tracks is None or scene.tracks.time_s is None:
        return np.empty(0)
    solved = np.isfinite(scene.centers).all(axis=1)
    if component is not None:
        solved &= scene.view_component == component
    times = scene.tracks.time_s[solved]
    return np.unique(times[np.isfinite(times)])


def curve_times(model: PathModel, first_s: float, last_s: float, most: int = MOST_TIMES) -> Float:
    """(n,) times, evenly from the first to the last, between which a path of this form is nearly straight."""
    span = last_s - first_s
    if not span > 0.0:
        return np.array([first_s])
    if isinstance(model, Taylor):
        pieces = 1 if model.order <= 1 else _PIECES * model.order
    elif isinstance(model, Fourier):
        turns = model.order * (model.omega_rad_s or 0.0) * span / (2.0 * pi)
        pieces = ceil(3 * _PIECES * max(turns, 0.5))
    elif isinstance(model, Spline):
        within = sum(first_s < knot < last_s for knot in model.knots_s)
        pieces = (within + 1) * (_PIECES if model.degree > 1 else 1)
        # the knots of broken lines lie anywhere
        pieces = max(pieces, 2 * _PIECES)
    else:
        pieces = 1
    return np.linspace(first_s, last_s, min(pieces, most - 1) + 1)


def speed(paths: Paths, track: int, time_s: float) -> tuple[float, float]:
    """Speed of a track at a time, units of the scene a second, and its standard deviation (NaN where not known)."""
    velocity = paths.velocity(track, [time_s], outside=True)[0]
    value = float(np.linalg.norm(velocity))
    if paths.covariances is None or not value > 0.0:
        return value, float("nan")
    along = velocity / value
    variance = float(along @ paths.velocity_covariance(track, [time_s])[0] @ along)
    return value, float(np.sqrt(max(variance, 0.0))) if np.isfinite(variance) else float("nan")


def form_text(model: PathModel) -> str:
    """Say a form as the command line takes it."""
    if isinstance(model, Static):
        return "static"
    if isinstance(model, Taylor):
        return f"taylor:{model.order}"
    if isinstance(model, Fourier):
        return f"fourier:{model.order}"
    return f"spline of degree {model.degree}"
