"""The files of a COLMAP model, written in bulk: cameras, images and points, and rigs and frames where there are any.

A pose is ``x_cam = R x_world + t`` with ``t = -R center``; that of a frame is ``x_rig = R x_world + t``. Numbers are
little-endian, quaternions scalar first.
"""

from __future__ import annotations

import importlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError, MissingExtraError
from panopath.formats.csv import quaternion_from_rotation
from panopath.formats.files import replacing
from panopath.model import Float

Index = npt.NDArray[np.int64]

#: What a feature that belongs to no point has for the id of its point.
NO_POINT = 2**64 - 1
EQUIRECTANGULAR_ID = 17
GREY = (200, 200, 200)
POINT2D = np.dtype([("x", "<f8"), ("y", "<f8"), ("id", "<u8")])
_POINT3D = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("length", "<u8")])


@dataclass(frozen=True)
class Camera:
    """A camera as COLMAP describes it."""

    camera_id: int
    #: COLMAP's number of the camera model, or its name.
    model: int | str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class Sensor:
    """A sensor that a rig carries. ``x_sensor = rotation @ x_rig + translation``, None where it is not known."""

    #: 0 for a camera.
    sensor_type: int
    sensor_id: int
    #: Scalar first, then the translation.
    wxyz_xyz: tuple[float, ...] | None


@dataclass(frozen=True)
class Rig:
    """Sensors that move together."""

    rig_id: int
    #: Type and id of the sensor whose frame is the rig's.
    reference: tuple[int, int]
    #: The others.
    sensors: tuple[Sensor, ...]


@dataclass(frozen=True, eq=False)
class Frames:
    """Poses of rigs."""

    frame_id: Index
    rig_id: Index
    #: (F, 3, 3).
    rig_from_world: Float
    #: (F, 3) origins of the rigs in the world.
    centers: Float
    #: Camera id and image id of each picture that was taken with the frame.
    images: Sequence[Sequence[tuple[int, int]]]


@dataclass(frozen=True, eq=False)
class ModelImages:
    """Images and all their features, flat."""

    image_id: Index
    camera_id: Index
    names: Sequence[str]
    #: (m, 3, 3) and (m, 3).
    cam_from_world: Float
    centers: Float
    #: (m + 1,) where the features of each image begin.
    starts: Index
    #: (K, 2).
    pixels: Float
    #: (K,) id of the point that each feature belongs to, or ``NO_POINT``.
    point_id: npt.NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class ModelPoints:
    """Points and the features that see them, flat."""

    #: (n,) of what is in the file.
    point_id: npt.NDArray[np.uint64]
    #: (n, 3).
    positions: Float
    #: (n, 3), or None for grey.
    color: npt.NDArray[np.uint8] | None
    #: (n,) mean reprojection error.
    error_px: Float
    #: (n + 1,) where the observations of each point begin.
    starts: Index
    #: (N, 2) image id and place of the feature in its image.
    elements: Index


def write_model(
    folder: Path,
    cameras: Sequence[Camera],
    images: ModelImages,
    points: ModelPoints,
    *,
    rigs: Sequence[Rig] = (),
    frames: Frames | None = None,
) -> None:
    """Write a binary model; each file whole or not at all.

    Where there are no rigs, ``rigs.bin`` and ``frames.bin`` of an earlier model are removed, since they would overrule
    the poses of the images.

    Raises
    ------
    InputError
        For a name that the format cannot hold, or a folder that cannot be written.
    """
    files = {
        "cameras.bin": cameras_bytes(cameras),
        "images.bin": _images_bytes(images),
        "points3D.bin": _points_bytes(points),
    }
    if frames is not None:
        files |= {"rigs.bin": _rigs_bytes(rigs), "frames.bin": _frames_bytes(frames)}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for stale in {"rigs.bin", "frames.bin"} - set(files):
            (folder / stale).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
    for name, data in files.items():
        with replacing(folder / name) as staged:
            staged.write_bytes(data)


def cameras_bytes(cameras: Sequence[Camera]) -> bytes:
    """``cameras.bin``; models that are named are written as their numbers."""
    chunks = [struct.pack("<Q", len(cameras))]
    for camera in cameras:
        layout = f"<IiQQ{len(camera.params)}d"
        chunks.append(
            struct.pack(layout, camera.camera_id, _number_of(camera), camera.width, camera.height, *camera.params)
        )
    return b"".join(chunks)


def _number_of(camera: Camera) -> int:
    if isinstance(camera.model, int):
        return camera.model
    if camera.model == "EQUIRECTANGULAR":
        return EQUIRECTANGULAR_ID
    known = load_pycolmap().CameraModelId.__members__
    if camera.model not in known:
        raise InputError(f"camera {camera.camera_id}: {camera.model!r} is no camera model of COLMAP")
    return int(known[camera.model].value)


def _poses(rotation: Float, centers: Float) -> Float:
    """(n, 7) quaternion, scalar first, and translation."""
    if not len(centers):
        return np.empty((0, 7))
    translation = -np.einsum("nij,nj->ni", rotation, centers)
    return np.concatenate((quaternion_from_rotation(rotation), translation), axis=1)


def _images_bytes(images: ModelImages) -> bytes:
    features = np.empty(len(images.pixels), dtype=POINT2D)
    features["x"], features["y"] = images.pixels[:, 0], images.pixels[:, 1]
    features["id"] = images.point_id
    poses = _poses(images.cam_from_world, images.centers)
    chunks = [struct.pack("<Q", len(images.names))]
    for i, name in enumerate(images.names):
        text = name.encode("utf-8")
        if b"\x00" in text:
            raise InputError(f"the view name {name!r} holds a NUL, which a COLMAP model cannot")
        begin, end = int(images.starts[i]), int(images.starts[i + 1])
        head = struct.pack("<I7dI", int(images.image_id[i]), *poses[i], int(images.camera_id[i]))
        chunks += [head, text, b"\x00", struct.pack("<Q", end - begin), features[begin:end].tobytes()]
    return b"".join(chunks)


def _points_bytes(points: ModelPoints) -> bytes:
    """Heads of a fixed length and tracks of any length, interleaved by their byte offsets."""
    n = len(points.point_id)
    lengths = np.diff(points.starts)
    heads = np.zeros(n, dtype=_POINT3D)
    heads["id"], heads["xyz"], heads["error"], heads["length"] = (
        points.point_id,
        points.positions,
        points.error_px,
        lengths,
    )
    heads["rgb"] = GREY if points.color is None else points.color
    elements = np.ascontiguousarray(points.elements, dtype="<u4")
    begin = np.arange(n) * _POINT3D.itemsize + points.starts[:-1] * 8
    data = np.empty(n * _POINT3D.itemsize + elements.nbytes, dtype=np.uint8)
    data[begin[:, None] + np.arange(_POINT3D.itemsize)] = heads.view(np.uint8).reshape(n, _POINT3D.itemsize)
    at = np.arange(len(elements)) * 8 + np.repeat(np.arange(1, n + 1), lengths) * _POINT3D.itemsize
    data[at[:, None] + np.arange(8)] = elements.view(np.uint8).reshape(len(elements), 8)
    return struct.pack("<Q", n) + data.tobytes()


def _rigs_bytes(rigs: Sequence[Rig]) -> bytes:
    chunks = [struct.pack("<Q", len(rigs))]
    for rig in rigs:
        chunks.append(struct.pack("<IIiI", rig.rig_id, 1 + len(rig.sensors), *rig.reference))
        for sensor in rig.sensors:
            known = sensor.wxyz_xyz is not None
            chunks.append(struct.pack("<iI?", sensor.sensor_type, sensor.sensor_id, known))
            if sensor.wxyz_xyz is not None:
                chunks.append(struct.pack("<7d", *sensor.wxyz_xyz))
    return b"".join(chunks)


def _frames_bytes(frames: Frames) -> bytes:
    poses = _poses(frames.rig_from_world, frames.centers)
    chunks = [struct.pack("<Q", len(poses))]
    for f, images in enumerate(frames.images):
        chunks.append(struct.pack("<II7dI", int(frames.frame_id[f]), int(frames.rig_id[f]), *poses[f], len(images)))
        chunks += [struct.pack("<iIQ", 0, camera_id, image_id) for camera_id, image_id in images]
    return b"".join(chunks)


def load_pycolmap() -> Any:
    """Import pycolmap.

    Raises
    ------
    MissingExtraError
        Where it is not installed.
    """
    try:
        return importlib.import_module("pycolmap")
    except ImportError:
        raise MissingExtraError(
            'COLMAP cameras need pycolmap: install the extra with pip install "panopath[colmap]"'
        ) from None


def pycolmap_camera(camera: Camera, source: Path) -> Any:
    """Make the camera in pycolmap, which unprojects.

    Raises
    ------
    InputError
        Naming the camera that pycolmap does not know, or whose parameters are not as many as its model has.
    """
    pycolmap = load_pycolmap()
    try:
        model = pycolmap.Camera(
            model=camera.model if isinstance(camera.model, str) else pycolmap.CameraModelId(camera.model).name,
            width=camera.width,
            height=camera.height,
            params=list(camera.params),
        )
        # without this check pycolmap reads beyond the parameters there are
        if not model.verify_params():
            raise ValueError
    except (ValueError, TypeError, RuntimeError, AttributeError):
        raise InputError(
            f"{source}: camera {camera.camera_id}: {camera.model} with {len(camera.params)} parameters is not a "
            "camera model that pycolmap knows"
        ) from None
    return model
