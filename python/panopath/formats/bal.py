"""Bundle Adjustment in the Large: one text file of observations, cameras and points.

A camera is (rotation vector, translation, f, k1, k2); with P = R X + t it looks along -z and sees the pixel
f (1 + k1 s + k2 s^2) p, p = -P.xy / P.z, s = |p|^2, the origin in the middle of the image. Here its axes are turned to
x right, y down, z forward, so the bearing is (p.x, -p.y, 1) / length.
"""

from __future__ import annotations

import re

import numpy as np

from panopath import _core
from panopath.errors import InputError
from panopath.formats.structure import known_scene
from panopath.model import Float, Int, Problem, Tracks

_FIRST_LINE = re.compile(rb"\s*(\d+)[ \t]+(\d+)[ \t]+(\d+)[ \t]*\r?\n")
_CAMERA_NUMBERS = 9
#: Looking along -z with y up, to looking along +z with y down.
_FORWARD_FROM_BACKWARD = np.diag([1.0, -1.0, -1.0])


def is_bal(data: bytes) -> bool:
    """Whether the first line is three whole numbers and no header."""
    return _FIRST_LINE.match(data) is not None


def read_bal(data: bytes, source: str) -> Problem:
    """Read bearings, orientations, and the file's own structure.

    Raises
    ------
    InputError
        Naming the file and the line, or the observation that its camera's distortion cannot have made.
    """
    match = _FIRST_LINE.match(data)
    if match is None:
        raise InputError(f"{source}: line 1: expected the numbers of cameras, points and observations")
    n_views, n_points, n = (int(field) for field in match.groups())
    try:
        numbers = _core.read_numbers(data, source, match.group().count(b"\n"))
    except ValueError as error:
        raise InputError(str(error)) from None
    expected = 4 * n + _CAMERA_NUMBERS * n_views + 3 * n_points
    if len(numbers) != expected:
        raise InputError(
            f"{source}: has {len(numbers)} numbers below its first line, expected {expected} for {n_views} cameras, "
            f"{n_points} points and {n} observations"
        )
    observations, rest = numbers[: 4 * n].reshape(n, 4), numbers[4 * n :]
    cameras = rest[: _CAMERA_NUMBERS * n_views].reshape(n_views, _CAMERA_NUMBERS)
    points = rest[_CAMERA_NUMBERS * n_views :].reshape(n_points, 3)
    view = _ids(observations[:, 0], n_views, "camera", source)
    track = _ids(observations[:, 1], n_points, "point", source)
    flat = _undistort(observations[:, 2:], cameras[view, 6:], source)
    bearing = np.column_stack((flat[:, 0], -flat[:, 1], np.ones(n)))
    bearing /= np.linalg.norm(bearing, axis=1, keepdims=True)
    tracks = Tracks.from_arrays(view, track, bearing, n_views, n_points)
    cam_from_world_backward = _exp(cameras[:, :3])
    centers = -np.einsum("nkc,nk->nc", cam_from_world_backward, cameras[:, 3:6])
    cam_from_world = _FORWARD_FROM_BACKWARD @ cam_from_world_backward
    return Problem(tracks, cam_from_world, known_scene(tracks, cam_from_world, centers, points))


def _ids(values: Float, limit: int, kind: str, source: str) -> Int:
    wrong = (values != np.floor(values)) | (values < 0) | (values >= limit)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise InputError(
            f"{source}: observation {first} (line {first + 2}): the {kind} is {values[first]:g}, "
            f"expected a whole number below {limit}"
        )
    return values.astype(np.int32)


def _undistort(pixel: Float, intrinsics: Float, source: str) -> Float:
    """Solve (1 + k1 r^2 + k2 r^4) r = |pixel| / f for each r >= 0 by Newton, and scale the pixels to it."""
    f, k1, k2 = intrinsics.T
    if (f <= 0.0).any():
        first = int(np.argmax(f <= 0.0))
        raise InputError(f"{source}: observation {first}: its camera has the focal length {f[first]:g}")
    distorted = np.hypot(pixel[:, 0], pixel[:, 1]) / f
    r = distorted.copy()
    slope = np.ones_like(r)
    with np.errstate(all="ignore"):
        for _ in range(50):
            s = r * r
            slope = 1.0 + 3.0 * k1 * s + 5.0 * k2 * s * s
            step = (r * (1.0 + k1 * s + k2 * s * s) - distorted) / slope
            r = r - step
            if np.all(np.abs(step) <= 1e-15 * (1.0 + r)):
                break
        s = r * r
        off = np.abs(r * (1.0 + k1 * s + k2 * s * s) - distorted)
        wrong = ~((off <= 1e-12 * (1.0 + distorted)) & (slope > 0.0) & (r >= 0.0))
    if wrong.any():
        first = int(np.argmax(wrong))
        raise InputError(
            f"{source}: observation {first} (line {first + 2}): its camera's distortion (k1 {k1[first]:g}, "
            f"k2 {k2[first]:g}) makes no pixel at that place"
        )
    scale = np.where(distorted > 0.0, r / np.where(distorted > 0.0, distorted, 1.0), 1.0) / f
    return np.asarray(pixel * scale[:, None])


def _exp(rotation_vector: Float) -> Float:
    """(n, 3) rotation vectors to (n, 3, 3) matrices, Rodrigues' formula."""
    angle = np.linalg.norm(rotation_vector, axis=1)
    # np.sinc(x / pi) is sin(x) / x, exact at zero; (1 - cos a) / a^2 is half its square at half the angle
    s = np.sinc(angle / np.pi)
    c = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    x, y, z = rotation_vector.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    return np.asarray(np.eye(3) + s[:, None, None] * cross + c[:, None, None] * (cross @ cross))
