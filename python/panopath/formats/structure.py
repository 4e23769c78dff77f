"""Scenes that were not solved here: a file's own structure, or the truth of a synthetic world."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.model import Bool, Float, Scene, Status, Summary, Tracks, check_orientations
from panopath.paths import Paths


def known_scene(
    tracks: Tracks,
    cam_from_world: npt.ArrayLike | None,
    centers: npt.ArrayLike,
    points: npt.ArrayLike,
    inlier: npt.ArrayLike | None = None,
    *,
    paths: Paths | None = None,
) -> Scene:
    """Make a scene of known centres and points, with the residuals of ``tracks`` in it; all in one component.

    Parameters
    ----------
    tracks
        The observations.
    cam_from_world
        Orientations, or None where bearings are world directions.
    centers, points
        (n_views, d) and (n_tracks, d), NaN rows where unknown.
    inlier
        (N,) bool; default: every observation of a known view and point.
    paths
        Where tracks that move were; residuals are against these. ``points`` holds their places half way.

    Raises
    ------
    InputError
        Where shapes do not fit.
    """
    c, p = np.array(centers, dtype=np.float64), np.array(points, dtype=np.float64)
    for name, array, count in (("centers", c, tracks.n_views), ("points", p, tracks.n_tracks)):
        if array.shape != (count, tracks.d):
            raise InputError(f"{name} has shape {array.shape}, expected {(count, tracks.d)}")
    world = tracks if cam_from_world is None else tracks.to_world(cam_from_world)
    residual_rad = angular_residuals(world, c, p)
    if paths is not None:
        _against_paths(residual_rad, world, c, paths)
    known_views, known_points = np.isfinite(c).all(axis=1), np.isfinite(p).all(axis=1)
    used: Bool = np.isfinite(residual_rad) if inlier is None else np.array(inlier, dtype=np.bool_)
    sigma_rad = float(np.sqrt(np.mean(residual_rad[used] ** 2) / (tracks.d - 1))) if used.any() else float("nan")
    if cam_from_world is None:
        orientations = np.zeros(len(c)) if tracks.d == 2 else np.tile(np.eye(3), (len(c), 1, 1))
    else:
        orientations = check_orientations(cam_from_world, tracks.n_views, tracks.d)
    summary = Summary(
        status=Status.CONVERGED,
        iterations=0,
        sigma_rad=sigma_rad,
        n_views=len(c),
        n_tracks=len(p),
        n_observations=len(tracks),
        n_inliers=int(used.sum()),
        n_solved_views=int(known_views.sum()),
        n_solved_points=int(known_points.sum()),
        n_components=1,
    )
    return Scene(
        centers=c,
        points=p,
        view_component=np.where(known_views, 0, -1),
        track_component=np.where(known_points, 0, -1),
        inlier=used,
        residual_rad=residual_rad,
        cam_from_world=orientations,
        summary=summary,
        tracks=tracks,
        view_names=tracks.view_names,
        track_names=tracks.track_names,
        paths=paths,
    )


def _against_paths(residual_rad: Float, world_tracks: Tracks, centers: Float, paths: Paths) -> None:
    """Put residuals of tracks that move in the place of those against a place at rest."""
    if world_tracks.time_s is None:
        raise InputError("tracks.time_s is None, expected the time of every view where tracks move")
    rows = np.flatnonzero(paths.moving[world_tracks.track])
    rows = rows[np.argsort(world_tracks.track[rows], kind="stable")]
    for mine in np.split(rows, np.flatnonzero(np.diff(world_tracks.track[rows])) + 1) if len(rows) else ():
        view, track = world_tracks.view[mine], int(world_tracks.track[mine[0]])
        places = paths.position(track, world_tracks.time_s[view], outside=True)
        residual_rad[mine] = _angles(world_tracks.bearing[mine], places - centers[view])


def angular_residuals(world_tracks: Tracks, centers: Float, points: Float) -> Float:
    """(N,) angle between each bearing and the direction from its view to its point, NaN where either is unknown."""
    residual = np.empty(len(world_tracks))
    block = 1 << 18
    with np.errstate(invalid="ignore", divide="ignore"):
        for begin in range(0, len(residual), block):
            rows = slice(begin, begin + block)
            ray = points[world_tracks.track[rows]] - centers[world_tracks.view[rows]]
            residual[rows] = _angles(world_tracks.bearing[rows], ray)
    return residual


def _angles(bearing: Float, ray: Float) -> Float:
    """(n,) angle between unit vectors and directions of any length."""
    unit = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    apart, along = np.linalg.norm(bearing - unit, axis=1), np.linalg.norm(bearing + unit, axis=1)
    angle: Float = 2.0 * np.arctan2(apart, along)
    return angle
