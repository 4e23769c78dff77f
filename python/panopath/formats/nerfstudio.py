"""nerfstudio's ``transforms.json``: intrinsics once, and a pose for each picture.

Its cameras have OpenGL axes, x right, y up, z back, so ``transform_matrix`` is

    world_from_gl = [ world_from_cam diag(1, -1, -1) | center ]

and its world has z up, as ours. A panorama is the camera model EQUIRECTANGULAR with ``fl_x = fl_y = h = w / 2``: its
rays are ``theta = pi (x - cx) / fl_x`` and ``phi = pi (1/2 - (cy - y) / fl_y)`` there.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.formats.files import read_bytes, write_bytes
from panopath.formats.ply import cloud_bytes
from panopath.model import Float, Scene, read_only

CameraModel = Literal["EQUIRECTANGULAR", "PINHOLE"]
#: Camera axes from those of OpenGL, and back.
_FLIP = np.diag((1.0, -1.0, -1.0))


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture and where it was taken."""

    #: Path of the picture, from the folder of the json.
    file: str
    #: (3, 3) and (3,).
    cam_from_world: Float
    center: Float
    #: Mask of the picture (white counts), or None.
    mask: str | None = None


@dataclass(frozen=True, eq=False)
class Transforms:
    """What a ``transforms.json`` says, in our axes."""

    camera_model: str
    width: int
    height: int
    #: fx, fy, cx, cy.
    intrinsics: tuple[float, float, float, float]
    files: tuple[str, ...]
    #: (n, 3, 3) and (n, 3).
    cam_from_world: Float
    centers: Float
    ply: str | None


def write_nerfstudio(
    scene: Scene,
    files: Sequence[str | None],
    folder: str | PathLike[str],
    size_px: tuple[int, int],
    *,
    colours: npt.NDArray[np.uint8] | None = None,
    masks: Sequence[str | None] | None = None,
    component: int = 0,
) -> Path:
    """Write ``transforms.json`` of panoramas and, where there are ``colours``, ``points.ply`` beside it.

    Parameters
    ----------
    scene
        In space.
    files
        Panorama of each view as a path from ``folder``; None: left out.
    folder
        Where to; it exists.
    size_px
        Width and height of the panoramas.
    colours
        (n_tracks, 3) uint8, for the points; None: no points are written.
    masks
        Masks of the views, paths from ``folder``.
    component
        Which part of the scene.

    Returns
    -------
    Path
        The json.

    Raises
    ------
    InputError
        For a planar scene, other numbers of files, or nothing to write.
    """
    if scene.d != 3:
        raise InputError("transforms.json needs a scene in space, but this one is planar")
    for name, given in (("files", files), ("masks", files if masks is None else masks)):
        if len(given) != len(scene.centers):
            raise InputError(f"{name} has {len(given)} entries, expected one a view, {len(scene.centers)}")
    solved = np.flatnonzero((scene.view_component == component) & np.isfinite(scene.centers).all(axis=1)).tolist()
    shots = []
    for view in solved:
        file = files[view]
        if file is not None:
            mask = None if masks is None else masks[view]
            shots.append(Shot(file, scene.cam_from_world[view], scene.centers[view], mask))
    place = Path(folder)
    if colours is not None:
        write_bytes(place / "points.ply", cloud_bytes(scene, colours, component))
    path = place / "transforms.json"
    ply = None if colours is None else "points.ply"
    width_px, height_px = size_px
    half = 0.5 * width_px
    write_transforms(path, shots, "EQUIRECTANGULAR", width_px=width_px, height_px=height_px, focal_px=half, ply=ply)
    return path


def write_transforms(
    path: Path,
    shots: Sequence[Shot],
    camera_model: CameraModel,
    *,
    width_px: int,
    height_px: int,
    focal_px: float,
    ply: str | None = None,
) -> None:
    """Write the json of pictures that share one camera.

    Parameters
    ----------
    path
        The file.
    shots
        The pictures, one or more.
    camera_model
        As nerfstudio names it.
    width_px, height_px, focal_px
        The camera; its principal point is the middle. A panorama has the focal length w / 2.
    ply
        Points to start from, a path from the json's folder.

    Raises
    ------
    InputError
        Where there is no picture, or the file cannot be written.
    """
    if not shots:
        raise InputError("there is no picture of a solved view, so no transforms.json to write")
    fl_y = float(height_px) if camera_model == "EQUIRECTANGULAR" else focal_px
    content: dict[str, Any] = {
        "camera_model": camera_model,
        "w": int(width_px),
        "h": int(height_px),
        "fl_x": float(focal_px),
        "fl_y": fl_y,
        "cx": 0.5 * width_px,
        "cy": 0.5 * height_px,
    }
    if camera_model == "PINHOLE":
        content |= dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
    # the world is as nerfstudio wants it, so nothing was applied
    content["applied_transform"] = np.eye(4)[:3].tolist()
    if ply is not None:
        content["ply_file_path"] = ply
    head = "{\n" + ",\n".join(f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in content.items())
    frames = ",\n".join("    " + json.dumps(_frame(shot), ensure_ascii=False, allow_nan=False) for shot in shots)
    write_bytes(path, f'{head},\n  "frames": [\n{frames}\n  ]\n}}\n'.encode())


def read_transforms(path: str | PathLike[str]) -> Transforms:
    """Read a ``transforms.json`` whose pictures share one camera.

    Raises
    ------
    InputError
        Where it is not one.
    """
    source = Path(path)
    try:
        content = json.loads(read_bytes(source).decode("utf-8"))
        matrix = np.array([frame["transform_matrix"] for frame in content["frames"]], dtype=np.float64)
        if matrix.ndim != 3 or matrix.shape[1:] not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
            raise ValueError
        fx, fy, cx, cy = (float(content[name]) for name in ("fl_x", "fl_y", "cx", "cy"))
        files = tuple(str(frame["file_path"]) for frame in content["frames"])
        camera, size = str(content["camera_model"]), (int(content["w"]), int(content["h"]))
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{source}: is not a transforms.json of one camera") from None
    rotation = _FLIP @ matrix[:, :3, :3].transpose(0, 2, 1)
    ply = content.get("ply_file_path")
    return Transforms(
        camera, *size, (fx, fy, cx, cy), files, read_only(rotation), read_only(matrix[:, :3, 3].copy()), ply
    )


def _frame(shot: Shot) -> dict[str, Any]:
    pose = np.eye(4)
    pose[:3, :3] = shot.cam_from_world.T @ _FLIP
    pose[:3, 3] = shot.center
    # -0.0 + 0.0 is 0.0: the same pose is the same text
    told: dict[str, Any] = {"file_path": shot.file, "transform_matrix": (pose + 0.0).tolist()}
    if shot.mask is not None:
        told["mask_path"] = shot.mask
    return told
