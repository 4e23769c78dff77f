"""COLMAP model folders: read text and binary with any camera model, write EQUIRECTANGULAR.

Unprojection of a pixel is pycolmap's (extra ``colmap``); the files are read and written here, in bulk. A pose is
``x_cam = R x_world + t``, so the centre is ``-R^T t``; the axes of the camera are ours.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError, MissingExtraError
from panopath.formats.colmap_model import (
    EQUIRECTANGULAR_ID,
    NO_POINT,
    POINT2D,
    Camera,
    ModelImages,
    ModelPoints,
    load_pycolmap,
    pycolmap_camera,
    write_model,
)
from panopath.formats.csv import rotation_from_quaternion
from panopath.formats.files import read_bytes
from panopath.formats.structure import known_scene
from panopath.model import Float, Problem, Scene, Tracks
from panopath.movers import resting

_PARTS = ("cameras", "images", "points3D")
_PLACES = ("", "sparse/0", "sparse", "0")


@dataclass(frozen=True)
class _Image:
    wxyz: list[float]
    translation: list[float]
    camera_id: int
    name: str
    #: (n, 2) pixels of the features that belong to a point.
    pixels: Float
    #: (n,) their points' ids.
    point_ids: npt.NDArray[np.int64]


def find_model(folder: Path) -> tuple[Path, str] | None:
    """Where below ``folder`` a model lies, and its suffix; None where there is none."""
    for place in _PLACES:
        for suffix in (".bin", ".txt"):
            if all((folder / place / f"{part}{suffix}").is_file() for part in _PARTS):
                return folder / place, suffix
    return None


def read_colmap(folder: Path) -> Problem:
    """Read a model as bearings with known orientation, and as a scene of its own centres and points.

    A view's name is its image's, a track's its point's id. Pixels that the camera model cannot unproject are left out.

    Raises
    ------
    InputError
        Naming the file, and the line or the byte where it breaks off; or the extra that is missing.
    """
    found = find_model(folder)
    if found is None:
        raise InputError(f"{folder}: has no COLMAP model (cameras, images and points3D, all .bin or all .txt)")
    place, suffix = found
    paths = {part: place / f"{part}{suffix}" for part in _PARTS}
    if suffix == ".bin":
        cameras = _parse(_cameras_bin, paths["cameras"])
        images = _parse(_images_bin, paths["images"])
        point_ids, points = _parse(_points_bin, paths["points3D"])
    else:
        cameras, images = _cameras_txt(paths["cameras"]), _images_txt(paths["images"])
        point_ids, points = _points_txt(paths["points3D"])
    return _problem(cameras, images, point_ids, points, paths)


def _problem(
    cameras: dict[int, Camera],
    images: dict[int, _Image],
    point_ids: npt.NDArray[np.int64],
    points: Float,
    paths: dict[str, Path],
) -> Problem:
    if not images:
        raise InputError(f"{paths['images']}: has no image")
    order = np.argsort(point_ids)
    sorted_ids, points = point_ids[order], points[order]
    models = {camera_id: pycolmap_camera(camera, paths["cameras"]) for camera_id, camera in cameras.items()}
    views, tracks, bearings = [], [], []
    for index, image in enumerate(images.values()):
        if image.camera_id not in models:
            raise InputError(
                f"{paths['images']}: image {image.name} has the camera {image.camera_id}, "
                f"which {paths['cameras'].name} does not have"
            )
        rows = np.searchsorted(sorted_ids, image.point_ids)
        unknown = (rows == len(sorted_ids)) | (sorted_ids[np.minimum(rows, len(sorted_ids) - 1)] != image.point_ids)
        if unknown.any():
            missing = image.point_ids[np.argmax(unknown)]
            raise InputError(
                f"{paths['images']}: image {image.name} sees the point {missing}, "
                f"which {paths['points3D'].name} does not have"
            )
        rays = np.asarray(models[image.camera_id].cam_ray_from_img(image.pixels)).reshape(-1, 3)
        good = np.isfinite(rays).all(axis=1)
        views.append(np.full(int(good.sum()), index))
        tracks.append(rows[good])
        bearings.append(rays[good] / np.linalg.norm(rays[good], axis=1, keepdims=True))
    wxyz = np.array([image.wxyz for image in images.values()])
    length = np.linalg.norm(wxyz, axis=1, keepdims=True)
    if not np.all(np.abs(length - 1.0) < 1e-2):
        name = list(images.values())[int(np.argmax(~(np.abs(length[:, 0] - 1.0) < 1e-2)))].name
        raise InputError(f"{paths['images']}: image {name}: its quaternion is not of unit length")
    rotation = rotation_from_quaternion(wxyz / length)
    translation = np.array([image.translation for image in images.values()])
    if not sum(map(len, views)):
        raise InputError(f"{paths['images']}: no image sees a point")
    found = Tracks.from_arrays(
        np.concatenate(views),
        np.concatenate(tracks),
        np.concatenate(bearings),
        len(images),
        len(points),
        view_names=[image.name for image in images.values()],
        track_names=[str(i) for i in sorted_ids.tolist()],
    )
    centers = -np.einsum("nkc,nk->nc", rotation, translation)
    return Problem(found, rotation, known_scene(found, rotation, centers, points))


# text


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Lines with their numbers, comments left out; an empty line is one without fields."""
    try:
        text = read_bytes(path).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not UTF-8 text") from None
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.lstrip().startswith("#"):
            yield number, line.split()


def _cameras_txt(path: Path) -> dict[int, Camera]:
    cameras = {}
    for number, fields in _lines(path):
        if fields:
            try:
                cameras[int(fields[0])] = Camera(
                    int(fields[0]), fields[1], int(fields[2]), int(fields[3]), tuple(float(f) for f in fields[4:])
                )
            except (ValueError, IndexError):
                raise InputError(f"{path}: line {number}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]") from None
    return cameras


def _images_txt(path: Path) -> dict[int, _Image]:
    images: dict[int, _Image] = {}
    lines = _lines(path)
    for number, fields in lines:
        if not fields:
            continue
        try:
            numbers = [float(field) for field in fields[1:8]]
            image_id, camera_id, name = int(fields[0]), int(fields[8]), " ".join(fields[9:])
            if not name or not np.isfinite(numbers).all():
                raise ValueError
        except (ValueError, IndexError):
            raise InputError(f"{path}: line {number}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME") from None
        second, features = next(lines, (number + 1, []))
        try:
            # ids are whole numbers far below 2^53, so a double holds them
            triples = np.array(features, dtype=np.float64).reshape(-1, 3)
            if not np.isfinite(triples).all():
                raise ValueError
        except ValueError:
            raise InputError(f"{path}: line {second}: expected POINTS2D[] as X Y POINT3D_ID") from None
        seen = triples[:, 2] >= 0.0
        if image_id in images:
            raise InputError(f"{path}: line {number}: the image {image_id} is given twice")
        images[image_id] = _Image(
            numbers[:4], numbers[4:], camera_id, name, triples[seen, :2], triples[seen, 2].astype(np.int64)
        )
    return images


def _points_txt(path: Path) -> tuple[npt.NDArray[np.int64], Float]:
    ids, points = [], []
    for number, fields in _lines(path):
        if fields:
            try:
                ids.append(int(fields[0]))
                points.append([float(field) for field in fields[1:4]])
                if len(points[-1]) != 3 or not np.isfinite(points[-1]).all():
                    raise ValueError
            except ValueError:
                raise InputError(f"{path}: line {number}: expected POINT3D_ID X Y Z R G B ERROR TRACK[]") from None
    return np.array(ids, dtype=np.int64), np.array(points, dtype=np.float64).reshape(-1, 3)


# binary


class _Cursor:
    """Reads forward through bytes."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, layout: str) -> tuple[Any, ...]:
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += struct.calcsize("<" + layout)
        return values

    def text(self) -> str:
        end = self.data.index(b"\x00", self.at)
        text = self.data[self.at : end].decode("utf-8")
        self.at = end + 1
        return text

    def skip(self, n_bytes: int) -> None:
        if self.at + n_bytes > len(self.data):
            raise ValueError
        self.at += n_bytes

    def array(self, dtype: np.dtype[Any], count: int) -> npt.NDArray[Any]:
        begin = self.at
        self.skip(count * dtype.itemsize)
        return np.frombuffer(self.data, dtype, count, begin)


def _parse(read: Any, path: Path) -> Any:
    cursor = _Cursor(read_bytes(path))
    try:
        result = read(cursor)
        if cursor.at != len(cursor.data):
            raise ValueError
    except MissingExtraError:
        raise
    except (struct.error, ValueError, OverflowError):
        raise InputError(f"{path}: is not a COLMAP file or is cut short (at byte {cursor.at})") from None
    return result


def _cameras_bin(cursor: _Cursor) -> dict[int, Camera]:
    pycolmap = load_pycolmap()
    cameras = {}
    for _ in range(cursor.take("Q")[0]):
        camera_id, model, width, height = cursor.take("IiQQ")
        try:
            n_params = len(pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId(model), 1.0, 2, 2).params)
        except (ValueError, TypeError, RuntimeError):
            raise ValueError from None
        cameras[camera_id] = Camera(camera_id, model, width, height, cursor.take(f"{n_params}d"))
    return cameras


def _images_bin(cursor: _Cursor) -> dict[int, _Image]:
    images = {}
    for _ in range(cursor.take("Q")[0]):
        image_id, *pose, camera_id = cursor.take("I7dI")
        name = cursor.text()
        features = cursor.array(POINT2D, cursor.take("Q")[0])
        features = features[features["id"] != NO_POINT]
        pixels = np.stack((features["x"], features["y"]), axis=1)
        images[image_id] = _Image(pose[:4], pose[4:], camera_id, name, pixels, features["id"].astype(np.int64))
    return images


def _points_bin(cursor: _Cursor) -> tuple[npt.NDArray[np.int64], Float]:
    ids, points = [], []
    for _ in range(cursor.take("Q")[0]):
        point_id, x, y, z, _r, _g, _b, _error, n_track = cursor.take("Q3d3BdQ")
        cursor.skip(8 * n_track)
        ids.append(point_id)
        points.append((x, y, z))
    return np.array(ids, dtype=np.int64), np.array(points, dtype=np.float64).reshape(-1, 3)


# writing


def equirectangular_pixels(bearing: Float, width: int, height: int) -> Float:
    """(N, 3) bearings to (N, 2) pixels: theta = 2 pi (x / w - 1/2), phi = pi (1/2 - y / h)."""
    theta = np.arctan2(bearing[:, 0], bearing[:, 2])
    phi = np.arctan2(-bearing[:, 1], np.hypot(bearing[:, 0], bearing[:, 2]))
    return np.stack((width * (theta / (2.0 * np.pi) + 0.5), height * (0.5 - phi / np.pi)), axis=1)


def write_colmap(
    scene: Scene,
    tracks: Tracks,
    folder: Path,
    component: int = 0,
    width: int = 4096,
    *,
    colours: npt.NDArray[np.uint8] | None = None,
) -> None:
    """Write one component as a binary model with one EQUIRECTANGULAR camera of ``width`` x ``width / 2`` pixels.

    An image is a view; all its observations are features, and those that were used belong to their point. ``colours``
    are (n_tracks, 3) red, green and blue of the points; without them they are grey. Bodies that move are left out.

    Raises
    ------
    InputError
        For a planar scene, or a view's name that the format cannot hold.
    """
    if scene.d != 3:
        raise InputError("a COLMAP model needs a scene in space, but this one is planar")
    views = np.flatnonzero(scene.view_component == component)
    seen = np.isin(tracks.view, views)
    # observations by view, so that a feature's place in its image is its place in this order
    order = np.flatnonzero(seen)[np.argsort(tracks.view[seen], kind="stable")]
    view, track = tracks.view[order], tracks.track[order]
    starts = np.searchsorted(view, np.arange(tracks.n_views + 1))
    # a body that moves has no place in a model: its features belong to no point
    used = scene.inlier[order] & ((scene.track_component == component) & resting(scene))[track]
    labels = scene.view_labels()
    images = ModelImages(
        image_id=views + 1,
        camera_id=np.ones(len(views), dtype=np.int64),
        names=[labels[v] for v in views.tolist()],
        cam_from_world=scene.cam_from_world[views],
        centers=scene.centers[views],
        starts=np.append(starts[views], len(order)),
        pixels=equirectangular_pixels(tracks.bearing[order], width, width // 2),
        point_id=np.where(used, track.astype(np.uint64) + np.uint64(1), np.uint64(NO_POINT)),
    )
    camera = Camera(1, EQUIRECTANGULAR_ID, width, width // 2, (float(width), float(width // 2)))
    by_track = np.flatnonzero(used)[np.argsort(track[used], kind="stable")]
    ids, begins, counts = np.unique(track[by_track], return_index=True, return_counts=True)
    # COLMAP's error on a spherical camera: the angle, in pixels at the equator
    error_px = scene.residual_rad[order][by_track] * (width / (2.0 * np.pi))
    points = ModelPoints(
        point_id=ids.astype(np.uint64) + np.uint64(1),
        positions=scene.points[ids],
        color=None if colours is None else colours[ids],
        error_px=np.add.reduceat(error_px, begins) / counts if len(ids) else error_px,
        starts=np.append(begins, len(by_track)),
        elements=np.stack((view[by_track] + 1, by_track - starts[view[by_track]]), axis=1),
    )
    write_model(folder, [camera], images, points)
