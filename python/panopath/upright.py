"""Which way is up: the world's z axis from gravity, else from the cameras' axes, else from the plane of the path.

With ``u_i`` the upward direction that camera ``i`` tells of, in the world (``R_i^T g_i`` of gravity ``g_i`` in the
camera; ``-R_i^T e_y`` of its own axes, as y points down in a camera), the vertical is the direction with the least sum
of distances to them, Weiszfeld's median on the sphere: a few cameras that hang askew do not move it.

Gravity is asked first: it is measured. A person, a car and a stabilised picture keep the camera upright on average, so
its axes come next, as long as they agree. Where they do not, but the path is flat, the ground is taken to be level; the
side that more cameras call up is up. The choice is stated in the answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.model import Float, Int, Scene
from panopath.moves import moved_scene

#: Camera axes count as agreeing where this share of them lies within ``_AGREE_RAD`` of their median.
_AGREE_SHARE = 0.7
_AGREE_RAD = float(np.radians(35.0))
#: A path is flat where its extent along the third axis is below this share of that along the second.
_FLAT = 0.15
#: and where that along the second is above this share of the first: a straight path has no plane.
_SPREAD = 0.05
_MEDIAN_STEPS = 60


class UpSource(StrEnum):
    """Where the vertical comes from."""

    GRAVITY = "gravity"
    CAMERA_AXES = "camera_axes"
    MOTION_PLANE = "motion_plane"
    #: Nothing tells; the frame of the scene stays as it is.
    UNKNOWN = "unknown"


@dataclass(frozen=True, eq=False)
class Up:
    """The upward vertical of one component."""

    component: int
    source: UpSource
    #: (3,) unit vector in the world of the scene; z where the source is unknown.
    direction: Float
    #: Median angle between it and what single views tell (of a plane: the angle of its slope), radians; NaN if unknown.
    spread_rad: float
    n_views: int

    def sentence(self) -> str:
        """Say in plain words what was chosen."""
        degrees = np.degrees(self.spread_rad)
        return {
            UpSource.GRAVITY: f"up is measured gravity ({self.n_views} views, median difference {degrees:.1f} deg)",
            UpSource.CAMERA_AXES: f"up is what the cameras call up, on average ({self.n_views} views, median tilt "
            f"{degrees:.1f} deg)",
            UpSource.MOTION_PLANE: f"up is the normal of the path's plane ({self.n_views} views, slope left "
            f"{degrees:.1f} deg)",
            UpSource.UNKNOWN: "up is not known: the cameras are turned every way and the path has no plane",
        }[self.source]


def find_up(scene: Scene, gravity: npt.ArrayLike | None = None) -> tuple[Up, ...]:
    """Find the upward vertical of each component.

    Parameters
    ----------
    scene
        In space.
    gravity
        (n_views, 3) the upward vertical in each camera, of any length, NaN where unknown.

    Returns
    -------
    tuple of Up
        One a component, in their order.

    Raises
    ------
    InputError
        For a planar scene, or gravity of another shape or of length zero.
    """
    if scene.d != 3:
        raise InputError("the scene is planar: its plane is level as it is")
    told = _gravity(gravity, len(scene.centers))
    posed = np.isfinite(scene.centers).all(axis=1) & np.isfinite(scene.cam_from_world).all(axis=(1, 2))
    return tuple(
        _up_of_part(scene, part, np.flatnonzero(posed & (scene.view_component == part)).astype(np.int32), told)
        for part in range(scene.n_components)
    )


def make_upright(scene: Scene, up: tuple[Up, ...]) -> Scene:
    """Turn each component by the least angle that brings its vertical to z; those of unknown vertical stay.

    Parameters
    ----------
    scene
        In space.
    up
        From :func:`find_up`.
    """
    for found in up:
        if found.source is not UpSource.UNKNOWN:
            turned = rotation_to_z(found.direction)
            middle = scene.centers[scene.view_component == found.component]
            middle = middle[np.isfinite(middle).all(axis=1)].mean(axis=0)
            # about the middle of the path, so that a scene centred at zero stays so
            scene = moved_scene(scene, turned, 1.0, middle - turned @ middle, found.component)
    return scene


def rotation_to_z(direction: npt.ArrayLike) -> Float:
    """(3, 3) rotation by the least angle that takes a direction to z; of straight down, about x.

    Raises
    ------
    InputError
        For a direction that is not finite or has no length.
    """
    v = np.array(direction, dtype=np.float64)
    length = np.linalg.norm(v) if v.shape == (3,) else np.nan
    if not (np.isfinite(length) and length > 0.0):
        raise InputError(f"direction is {v.tolist()}, expected 3 finite numbers, not all zero")
    x, y, z = v / length
    across = x * x + y * y
    if across == 0.0:
        return np.eye(3) if z > 0.0 else np.diag((1.0, -1.0, -1.0))
    # 1 / (1 + z), which loses its digits near straight down, from the horizontal part there
    k = 1.0 / (1.0 + z) if z > 0.0 else (1.0 - z) / across
    return np.array([[1.0 - k * x * x, -k * x * y, -x], [-k * x * y, 1.0 - k * y * y, -y], [x, y, z]])


def _gravity(gravity: npt.ArrayLike | None, n_views: int) -> Float | None:
    if gravity is None:
        return None
    try:
        told = np.array(gravity, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("gravity does not hold numbers") from None
    if told.shape != (n_views, 3):
        raise InputError(f"gravity has shape {told.shape}, expected ({n_views}, 3)")
    length = np.linalg.norm(told, axis=1)
    if (length == 0.0).any():
        raise InputError(f"gravity[{int(np.argmin(length))}] has length 0, expected a direction")
    return np.asarray(told / length[:, None])


def _up_of_part(scene: Scene, part: int, views: Int, gravity: Float | None) -> Up:
    if gravity is not None:
        seen = views[np.isfinite(gravity[views]).all(axis=1)]
        if len(seen):
            direction, angle = _median(np.einsum("nkc,nk->nc", scene.cam_from_world[seen], gravity[seen]))
            return Up(part, UpSource.GRAVITY, direction, float(np.median(angle)), len(seen))
    axes = -scene.cam_from_world[views, 1, :]
    if len(views):
        direction, angle = _median(axes)
        if np.mean(angle <= _AGREE_RAD) >= _AGREE_SHARE:
            return Up(part, UpSource.CAMERA_AXES, direction, float(np.median(angle)), len(views))
    plane = _plane(scene.centers[views])
    if plane is not None:
        normal, slope = plane
        votes = float(np.sign(axes @ normal).sum())
        # where the cameras are split, the side that the scene's z axis is on
        side = votes if votes != 0.0 else normal[2]
        return Up(part, UpSource.MOTION_PLANE, normal if side >= 0.0 else -normal, slope, len(views))
    return Up(part, UpSource.UNKNOWN, np.array([0.0, 0.0, 1.0]), float("nan"), len(views))


def _median(directions: Float) -> tuple[Float, Float]:
    """Direction of least summed chord to all, and (n,) the angle of each to it."""
    # started at the sample that is best itself: the mean of opposite directions has none
    some = directions[:: 1 + len(directions) // 256]
    chord = np.sqrt(np.maximum(2.0 - 2.0 * some @ directions.T, 0.0)).sum(axis=1)
    median = some[int(np.argmin(chord))]
    for _ in range(_MEDIAN_STEPS):
        away = np.linalg.norm(directions - median, axis=1)
        mean = (directions / np.maximum(away, 1e-9)[:, None]).sum(axis=0)
        length = np.linalg.norm(mean)
        if length == 0.0:
            break
        before, median = median, mean / length
        if np.linalg.norm(median - before) < 1e-12:
            break
    cross = np.linalg.norm(np.cross(directions, median), axis=1)
    return median, np.arctan2(cross, directions @ median)


def _plane(centers: Float) -> tuple[Float, float] | None:
    """Find the normal of the plane of a path and the slope that is left, None where it is straight or not flat."""
    if len(centers) < 3:
        return None
    extent, axes = np.linalg.svd(centers - centers.mean(axis=0), full_matrices=False)[1:]
    if not (extent[1] > _SPREAD * extent[0] and extent[2] < _FLAT * extent[1]):
        return None
    return axes[2], float(np.arctan2(extent[2], extent[1]))
