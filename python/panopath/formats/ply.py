"""PLY: points in the colours of the pictures or by their angular error, and the cameras as a path of edges.

Bodies that move are no points; a comment in the header says how many were left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.model import Float, Scene
from panopath.movers import left_out, resting

_VERTEX = np.dtype(
    [
        ("x", "<f8"),
        ("y", "<f8"),
        ("z", "<f8"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("error_deg", "<f4"),
        ("component", "<i4"),
        ("is_camera", "u1"),
    ]
)
_CLOUD = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
_EDGE = np.dtype([("vertex1", "<i4"), ("vertex2", "<i4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
_PLY_TYPES = {"<f8": "double", "<f4": "float", "<i4": "int", "|u1": "uchar"}
_CAMERA_COLOUR = (255, 0, 160)
#: Small error to large: blue, green, yellow, red.
_SCALE = np.array([(40, 80, 200), (40, 170, 110), (240, 200, 40), (220, 40, 30)], dtype=np.float64)


def error_colours(error: Float) -> npt.NDArray[np.uint8]:
    """(n, 3) colours of (n,) errors, the 95th percentile at the far end; grey where the error is not known."""
    known = np.isfinite(error)
    colours = np.full((len(error), 3), 128, dtype=np.uint8)
    if known.any():
        top = max(float(np.percentile(error[known], 95.0)), 1e-300)
        along = np.clip(error[known] / top, 0.0, 1.0) * (len(_SCALE) - 1)
        channels = [np.interp(along, np.arange(len(_SCALE)), _SCALE[:, c]) for c in range(3)]
        colours[known] = np.stack(channels, axis=1).round().astype(np.uint8)
    return colours


def path_edges(scene: Scene) -> npt.NDArray[np.int64]:
    """(m, 2) pairs of views that follow one another: by time where all times are known, else by index."""
    solved = np.flatnonzero(np.isfinite(scene.centers).all(axis=1))
    time_s = None if scene.tracks is None else scene.tracks.time_s
    if time_s is not None and np.isfinite(time_s[solved]).all():
        solved = solved[np.argsort(time_s[solved], kind="stable")]
    together = scene.view_component[solved[1:]] == scene.view_component[solved[:-1]]
    return np.stack((solved[:-1][together], solved[1:][together]), axis=1)


def ply_bytes(scene: Scene, colours: npt.NDArray[np.uint8] | None = None) -> bytes:
    """Binary little-endian PLY of a scene; a planar one lies in z = 0.

    Parameters
    ----------
    scene
        What to write.
    colours
        (n_tracks, 3) red, green and blue of the points, as the pictures show them; default: by their error.

    Raises
    ------
    InputError
        For colours of another shape or type.
    """
    points = shown_points(scene)
    views = np.flatnonzero(np.isfinite(scene.centers).all(axis=1))
    error_deg = np.degrees(scene.point_statistics().rms_rad[points])
    vertices = np.zeros(len(points) + len(views), dtype=_VERTEX)
    both = np.concatenate((scene.points[points], scene.centers[views]))
    for axis, name in zip(range(scene.d), ("x", "y", "z"), strict=False):
        vertices[name] = both[:, axis]
    shown = error_colours(error_deg) if colours is None else check_colours(colours, scene)[points]
    painted = np.concatenate((shown, np.tile(np.array(_CAMERA_COLOUR, dtype=np.uint8), (len(views), 1))))
    edges = path_edges(scene)
    vertex_of_view = np.zeros(len(scene.centers), dtype=np.int64)
    vertex_of_view[views] = len(points) + np.arange(len(views))
    lines = np.zeros(len(edges), dtype=_EDGE)
    lines["vertex1"], lines["vertex2"] = vertex_of_view[edges[:, 0]], vertex_of_view[edges[:, 1]]
    for c, name in enumerate(("red", "green", "blue")):
        vertices[name] = painted[:, c]
        lines[name] = _CAMERA_COLOUR[c]
    vertices["error_deg"] = np.concatenate((error_deg, np.full(len(views), np.nan)))
    vertices["component"] = np.concatenate((scene.track_component[points], scene.view_component[views]))
    vertices["is_camera"][len(points) :] = 1
    return _file((("vertex", vertices), ("edge", lines)), left_out(scene))


def shown_points(scene: Scene) -> npt.NDArray[np.intp]:
    """Tracks that a file of points shows: those that are determined, and at rest."""
    return np.flatnonzero(np.isfinite(scene.points).all(axis=1) & resting(scene))


def cloud_bytes(scene: Scene, colours: npt.NDArray[np.uint8], component: int | None = None) -> bytes:
    """Binary PLY of the points alone, with what every reader of point clouds knows: x, y, z, red, green, blue.

    Parameters
    ----------
    scene, colours
        As for :func:`ply_bytes`.
    component
        Which part; default: all.

    Raises
    ------
    InputError
        For colours of another shape or type.
    """
    points = shown_points(scene)
    points = points if component is None else points[scene.track_component[points] == component]
    vertices = np.zeros(len(points), dtype=_CLOUD)
    for axis, name in zip(range(scene.d), ("x", "y", "z"), strict=False):
        vertices[name] = scene.points[points, axis]
    for c, name in enumerate(("red", "green", "blue")):
        vertices[name] = check_colours(colours, scene)[points, c]
    return _file((("vertex", vertices),), left_out(scene, component))


def check_colours(colours: npt.NDArray[np.uint8], scene: Scene) -> npt.NDArray[np.uint8]:
    """Hand back colours that fit the scene.

    Raises
    ------
    InputError
        Where they do not.
    """
    if colours.shape != (len(scene.points), 3) or colours.dtype != np.uint8:
        raise InputError(
            f"colours has type {colours.dtype} and shape {colours.shape}, expected uint8 ({len(scene.points)}, 3)"
        )
    return colours


def _file(tables: Sequence[tuple[str, npt.NDArray[Any]]], n_left_out: int) -> bytes:
    header = ["ply", "format binary_little_endian 1.0", "comment panopath"]
    if n_left_out:
        header.append(f"comment {n_left_out} tracks not known to rest are left out")
    for name, table in tables:
        header.append(f"element {name} {len(table)}")
        header += [f"property {_PLY_TYPES[table.dtype[field].str]} {field}" for field in table.dtype.names or ()]
    head = "\n".join([*header, "end_header"]) + "\n"
    return head.encode("ascii") + b"".join(table.tobytes() for _, table in tables)
