"""TUM trajectory: ``timestamp tx ty tz qx qy qz qw``, the position of the camera and world_from_cam."""

from __future__ import annotations

import numpy as np

from panopath.formats.csv import quaternion_from_rotation
from panopath.model import Float, Scene


def tum_text(scene: Scene) -> str:
    """Lines of the views that are determined; the index stands for the time where times are not known."""
    solved = np.flatnonzero(np.isfinite(scene.centers).all(axis=1))
    centers = np.zeros((len(solved), 3))
    centers[:, : scene.d] = scene.centers[solved]
    wxyz = _world_from_cam(scene)[solved]
    time_s = None if scene.tracks is None else scene.tracks.time_s
    has_times = time_s is not None and bool(np.isfinite(time_s[solved]).all())
    times = time_s[solved] if time_s is not None and has_times else solved.astype(np.float64)
    rows = np.column_stack((times, centers, wxyz[:, 1:], wxyz[:, :1]))[np.argsort(times, kind="stable")]
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    lines += [" ".join(map(repr, row)) for row in rows.tolist()]
    return "\n".join(lines) + "\n"


def _world_from_cam(scene: Scene) -> Float:
    """(n_views, 4) quaternions, scalar first; a heading is a turn about z."""
    if scene.d == 3:
        return quaternion_from_rotation(scene.cam_from_world.transpose(0, 2, 1))
    half = 0.5 * scene.cam_from_world
    zero = np.zeros_like(half)
    return np.stack((np.cos(half), zero, zero, np.sin(half)), axis=1)
