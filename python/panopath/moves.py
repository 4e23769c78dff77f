"""The same scene in another frame of the world: turned, scaled and shifted, seen by the same cameras.

    position_new = scale * new_from_world @ position + shift,    cam_from_new = cam_from_world @ new_from_world^T

Bearings in the cameras and angular residuals are untouched by that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.model import Float, Scene, check_orientations


def moved_scene(
    scene: Scene,
    new_from_world: npt.ArrayLike | None = None,
    scale: float = 1.0,
    shift: npt.ArrayLike | None = None,
    component: int | None = None,
) -> Scene:
    """Turn, scale and shift a scene in space, or one component of it.

    Parameters
    ----------
    scene
        In space.
    new_from_world
        (3, 3) rotation; default: none.
    scale
        Positive.
    shift
        (3,) in the units of the new frame; default: none.
    component
        Which part; default: everything alike.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    if scene.d != 3:
        raise InputError("the scene is planar, expected one in space")
    turn = np.eye(3) if new_from_world is None else check_orientations(np.array(new_from_world)[None], 1, 3)[0]
    move: Float = np.zeros(3) if shift is None else np.array(shift, dtype=np.float64)
    if move.shape != (3,) or not np.isfinite(move).all():
        raise InputError(f"shift is {move.tolist()}, expected 3 finite numbers")
    if not (np.isfinite(scale) and scale > 0.0):
        raise InputError(f"scale is {scale!r}, expected a positive number")
    views = np.ones(len(scene.centers), dtype=np.bool_) if component is None else scene.view_component == component
    points = np.ones(len(scene.points), dtype=np.bool_) if component is None else scene.track_component == component
    rotation = np.where(views[:, None, None], scene.cam_from_world @ turn.T, scene.cam_from_world)
    return replace(
        scene,
        centers=np.where(views[:, None], scale * scene.centers @ turn.T + move, scene.centers),
        points=np.where(points[:, None], scale * scene.points @ turn.T + move, scene.points),
        cam_from_world=rotation,
        paths=None if scene.paths is None else scene.paths.transformed(scale, turn, move, points),
    )
