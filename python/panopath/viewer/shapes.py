"""The shapes that are shown, as plain arrays: balls, panoramas, ellipsoids, and where the parts of a scene are put.

Shown places are ``x_shown = scale * (x_world - middle) + offset`` with one scale for all parts and z up. Corners of a
panorama's sphere lie in the camera's axes: the corner with texture coordinates ``(u, v)`` lies along the bearing of
pixel ``(u w, v h)``, so that the sphere, turned by ``world_from_cam``, shows each thing where it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panopath.cameras import bearings_from_equirectangular
from panopath.formats.csv import quaternion_from_rotation
from panopath.model import Float, Scene
from panopath.movers import resting

Ids = npt.NDArray[np.intp]
Colours = npt.NDArray[np.uint8]

#: Radius of a scene as it is shown; the sizes of markers and the camera's planes are chosen for it.
REACH = 5.0
#: Parts beyond this number are shown as one.
MOST_PARTS = 10
#: Thinnest an ellipsoid is shown, as a share of its longest half-axis: flat ones are seen from the side too.
_THINNEST = 0.02
#: Colours of parts, and of bodies that move.
PALETTE = np.array(
    [
        (31, 95, 168),
        (230, 126, 20),
        (44, 150, 70),
        (200, 40, 45),
        (128, 88, 180),
        (130, 84, 72),
        (215, 100, 180),
        (20, 165, 180),
        (165, 165, 30),
        (90, 90, 90),
    ],
    dtype=np.uint8,
)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles; their corners run anticlockwise as seen from the side that is shown."""

    #: (n, 3).
    vertices: Float
    #: (m, 3) corners of each triangle.
    faces: Ids
    #: (n, 2) texture coordinates from the upper left corner, or None.
    uv: Float | None = None


@dataclass(frozen=True, eq=False)
class Part:
    """A part of the scene and where it is shown."""

    name: str
    #: Solved views and points at rest, as indices.
    views: Ids
    points: Ids
    #: (3,) the place in the world that is shown at ``offset``.
    middle: Float
    offset: Float
    #: Shown length of one unit of the world.
    scale: float
    colour: tuple[int, int, int]

    def shown(self, place: Float) -> Float:
        """(n, 3) places as shown, before ``offset``, of (n, d) places in the world."""
        return self.scale * (in_space(place) - self.middle)


def in_space(place: Float) -> Float:
    """(n, 3) of (n, d): a plane lies in z = 0."""
    return place if place.shape[1] == 3 else np.column_stack((place, np.zeros(len(place))))


def world_from_cam(scene: Scene) -> Float:
    """(n_views, 3, 3) orientations; those of a plane turn about z."""
    if scene.d == 3:
        return scene.cam_from_world.transpose(0, 2, 1)
    cos, sin, zero = np.cos(scene.cam_from_world), np.sin(scene.cam_from_world), np.zeros(len(scene.cam_from_world))
    rows = (cos, -sin, zero), (sin, cos, zero), (zero, zero, zero + 1.0)
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def spread(count: int, most: int) -> Ids:
    """At most ``most`` of the indices below ``count``, evenly over all of them, in order."""
    if count <= most:
        return np.arange(count, dtype=np.intp)
    return np.linspace(0.0, count - 1.0, most).round().astype(np.intp)


def panorama_sphere(n_around: int = 128, n_down: int = 64) -> Mesh:
    """Make a unit sphere in the camera's axes with the panorama on its inside; the seam has two sets of corners.

    Parameters
    ----------
    n_around, n_down
        Numbers of cells along the width and along the height of the panorama.
    """
    u, v = np.meshgrid(np.arange(n_around + 1) / n_around, np.arange(n_down + 1) / n_down)
    uv = np.column_stack((u.ravel(), v.ravel()))
    corner = np.arange(uv.shape[0]).reshape(n_down + 1, n_around + 1)
    upper_left, upper_right = corner[:-1, :-1].ravel(), corner[:-1, 1:].ravel()
    lower_left, lower_right = corner[1:, :-1].ravel(), corner[1:, 1:].ravel()
    # at a pole one of the two triangles of a cell has no area
    first = np.column_stack((upper_left, lower_left, lower_right))[: (n_down - 1) * n_around]
    second = np.column_stack((upper_left, lower_right, upper_right))[n_around:]
    vertices = bearings_from_equirectangular(uv * (n_around, n_down), n_around, n_down)
    return Mesh(vertices, np.concatenate((first, second)), uv)


def ball(rounds: int) -> Mesh:
    """Make a unit sphere seen from outside: an octahedron whose triangles are cut in four, ``rounds`` times."""
    vertices = np.concatenate((np.eye(3), -np.eye(3)))
    faces = np.array([(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)])
    for _ in range(rounds):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        middle = vertices[unique].mean(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        ab, bc, ca = (which.reshape(-1, 3) + len(vertices)).T
        a, b, c = faces.T
        vertices = np.concatenate((vertices, middle))
        faces = np.concatenate([np.column_stack(f) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return Mesh(vertices, faces)


def ellipsoids(covariance: Float) -> tuple[Float, Float]:
    """Half-axes of one standard deviation and how they are turned.

    Parameters
    ----------
    covariance
        (n, d, d), symmetric; NaN where not known.

    Returns
    -------
    tuple[array, array]
        (n, 3) half-axes, and (n, 4) quaternions ``qw, qx, qy, qz`` of the rotations that turn the axes of x, y, z into
        the principal ones; NaN where not known.
    """
    n, d = covariance.shape[:2]
    full = np.zeros((n, 3, 3))
    full[:, :d, :d] = covariance
    known = np.isfinite(covariance).all(axis=(1, 2))
    axes, turns = np.full((n, 3), np.nan), np.full((n, 4), np.nan)
    if known.any():
        values, vectors = np.linalg.eigh(full[known])
        vectors[:, :, 0] *= np.sign(np.linalg.det(vectors))[:, None]
        # rounding may leave a variance of nothing below zero
        axes[known] = np.sqrt(np.maximum(values, 0.0))
        turns[known] = quaternion_from_rotation(vectors)
    return axes, turns


def shown_axes(axes: Float, factor: float, largest: float) -> Float:
    """(n, 3) half-axes as shown: ``factor`` times as long, none longer than ``largest``, none too thin to see."""
    longest = axes.max(axis=1, keepdims=True)
    limit = np.minimum(1.0, largest / np.maximum(factor * longest, 1e-300))
    shown: Float = np.maximum(axes, _THINNEST * longest) * factor * limit
    return shown


def round_factor(value: float) -> float:
    """Round down to 1, 2, 5, 10, 20, ..., at least 1."""
    if not np.isfinite(value) or value <= 1.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-12)) * power)


def view_order(scene: Scene) -> Ids:
    """Solved views, one after the other: by time where all times are known, else by index."""
    solved = np.flatnonzero(np.isfinite(scene.centers).all(axis=1))
    time_s = None if scene.tracks is None else scene.tracks.time_s
    if time_s is not None and np.isfinite(time_s[solved]).all():
        solved = solved[np.argsort(time_s[solved], kind="stable")]
    return solved


def parts_of(scene: Scene, *, apart: bool) -> list[Part]:
    """List the components of a scene, at most ``MOST_PARTS``, and where each is shown.

    Parameters
    ----------
    scene
        What is shown.
    apart
        Whether the parts are put side by side along x, or stay where their coordinates are.
    """
    groups = _groups(scene)
    reaches = [_reach(scene, views, points) for _, views, points in groups]
    if not groups:
        return []
    scale = REACH / max(reach for _, reach in reaches)
    parts, place = [], 0.0
    for k, (name, views, points) in enumerate(groups):
        middle, reach = reaches[k]
        radius = 1.3 * scale * reach
        place += radius if k else 0.0
        offset = np.array([place, 0.0, 0.0]) if apart else scale * (middle - reaches[0][0])
        place += radius
        colour = tuple(PALETTE[k % len(PALETTE)].tolist())
        parts.append(Part(name, views, points, middle, offset, scale, colour))
    return parts


def across(place: Float) -> Float:
    """Find the level direction (3,) along which places (n, 3) extend the most, its x not negative; x where all do."""
    level = place[:, :2] - place[:, :2].mean(axis=0) if len(place) else place[:, :2]
    values, vectors = np.linalg.eigh(level.T @ level)
    if values[1] <= 0.0:
        return np.array([1.0, 0.0, 0.0])
    x, y = vectors[:, 1] * (1.0 if vectors[0, 1] >= 0.0 else -1.0)
    return np.array([x, y, 0.0])


def _groups(scene: Scene) -> Sequence[tuple[str, Ids, Ids]]:
    """Name, views and points of each part, the largest first; the smallest ones together, as one."""
    # bodies that move are shown by themselves, where they were at a moment
    has_center = np.isfinite(scene.centers).all(axis=1)
    has_point = np.isfinite(scene.points).all(axis=1) & resting(scene)
    found = []
    for component in range(scene.n_components):
        views = np.flatnonzero(has_center & (scene.view_component == component))
        points = np.flatnonzero(has_point & (scene.track_component == component))
        if len(views) + len(points):
            found.append((component, views, points))
    found.sort(key=lambda part: (-len(part[1]), -len(part[2]), part[0]))
    named = [(f"part {component + 1}", views, points) for component, views, points in found[:MOST_PARTS]]
    rest = found[MOST_PARTS:]
    if rest:
        views = np.sort(np.concatenate([views for _, views, _ in rest]))
        points = np.sort(np.concatenate([points for _, _, points in rest]))
        named.append((f"{len(rest)} smaller parts", views, points))
    return named


def _reach(scene: Scene, views: Ids, points: Ids) -> tuple[Float, float]:
    """Middle of a part, and the distance from it within which the path and half of the points lie."""
    centers, places = in_space(scene.centers[views]), in_space(scene.points[points])
    middle = np.median(centers if len(centers) else places, axis=0)
    path = np.linalg.norm(centers - middle, axis=1).max(initial=0.0)
    half = float(np.median(np.linalg.norm(places - middle, axis=1))) if len(places) else 0.0
    # far points must not make the path small
    reach = max(float(path), min(half, 4.0 * float(path)) if path > 0.0 else half)
    return middle, reach if reach > 0.0 else 1.0
