"""What a source is: a 360 video, panoramas, fisheye pictures of a rig, or pictures of a camera with known intrinsics.

Told by content, not by name: by what the decoder finds, by sizes and headers, by the calibration file of a rig.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from panopath.cameras import bearings_from_pixels
from panopath.errors import InputError, MissingExtraError
from panopath.formats.colmap_model import EQUIRECTANGULAR_ID, Camera
from panopath.formats.csv import rotation_from_quaternion
from panopath.frontend.images import ImageHeader, image_files, read_header
from panopath.frontend.video import VideoHeader, read_video_header
from panopath.model import Float, Int, read_only

#: Pictures this much off twice as wide as high are panoramas whose last row or column was lost.
_ASPECT_TOLERANCE = 0.005
_CAMERAS_TXT = "cameras.txt"


class SourceKind(StrEnum):
    """What was recognised."""

    VIDEO = "video"
    PANORAMAS = "panoramas"
    RIG = "rig"
    PERSPECTIVE = "perspective"


@dataclass(frozen=True, eq=False)
class Source:
    """A source of pictures, as it was recognised."""

    kind: SourceKind
    path: Path
    #: One line for a person.
    description: str
    #: M pictures and their headers; of a video there are none.
    images: tuple[Path, ...] = ()
    headers: tuple[ImageHeader, ...] = ()
    video: VideoHeader | None = None
    #: C cameras, at the full size of the pictures; of a rig also (M,) the camera and the frame of each picture.
    cameras: tuple[Camera, ...] = ()
    image_camera: Int = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    image_frame: Int = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    #: (C, 3, 3) and (C, 3) places of the cameras in the rig.
    sensor_from_rig: Float = field(default_factory=lambda: np.empty((0, 3, 3)))
    center_in_rig: Float = field(default_factory=lambda: np.empty((0, 3)))

    def __post_init__(self) -> None:
        for name in ("image_camera", "image_frame", "sensor_from_rig", "center_in_rig"):
            read_only(getattr(self, name))

    @property
    def is_panoramic(self) -> bool:
        """Whether the pictures are equirectangular."""
        return self.kind in {SourceKind.VIDEO, SourceKind.PANORAMAS}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the pictures, below the folder of the source."""
        return tuple(path.relative_to(self.path).as_posix() for path in self.images)


def recognise(path: str | PathLike[str], *, rig: str | PathLike[str] | None = None) -> Source:
    """Find out what a file or folder is.

    Parameters
    ----------
    path
        A video file; a folder of panoramas; a folder whose folders have the pictures of a rig's cameras, with the
        calibration (COLMAP's rig JSON) beside them; a folder of pictures of one camera, with its intrinsics in
        ``cameras.txt`` (COLMAP) or a focal length in every header.
    rig
        The calibration file, where it is elsewhere.

    Raises
    ------
    InputError
        Naming what is there and what was expected.
    MissingExtraError
        Where what reads pictures or video is not installed.
    """
    source = Path(path)
    if source.is_dir():
        calibration = Path(rig) if rig is not None else _rig_file(source)
        return _rig(source, calibration) if calibration is not None else _folder(source)
    if not source.exists():
        raise InputError(f"{source}: there is no such file or folder")
    return _video(source)


def _video(path: Path) -> Source:
    try:
        header = read_video_header(path)
    except InputError as error:
        raise InputError(f"{error}; expected a 360 video or a folder of pictures") from None
    if not _is_panorama(header.width, header.height):
        raise InputError(
            f"{path}: is {header.width} x {header.height}, expected a 360 video (equirectangular), which is twice as "
            "wide as high; raw footage of a 360 camera has to be stitched first"
        )
    if header.n_frames == 1:
        raise InputError(f"{path}: has one frame, expected a video or a folder of several pictures")
    length = f"{header.n_frames} frames" if header.n_frames else "unknown length"
    text = f"360 video, {header.width} x {header.height}, {header.codec}, {header.rate_hz:.4g} frames/s, {length}"
    return Source(SourceKind.VIDEO, path, text, video=header, cameras=(_panorama(header.width, header.height),))


def _is_panorama(width: int, height: int) -> bool:
    return height > 0 and abs(width / height - 2.0) <= 2.0 * _ASPECT_TOLERANCE


def _panorama(width: int, height: int) -> Camera:
    return Camera(1, EQUIRECTANGULAR_ID, width, height, (float(width), float(height)))


def _folder(folder: Path) -> Source:
    images = image_files(folder)
    if not images:
        raise InputError(f"{folder}: has no pictures (jpg, png, tif, webp), and no rig with its calibration")
    if len(images) == 1:
        raise InputError(f"{folder}: has one picture ({images[0].name}), expected at least two")
    headers = [read_header(image) for image in images]
    width, height = _one_size(folder, headers)
    n = len(images)
    tagged = [header for header in headers if header.projection == "equirectangular"]
    if _is_panorama(width, height):
        place = sum(header.position_wgs84 is not None for header in headers)
        text = f"{n} panoramas, {width} x {height}" + (f", {place} with GPS positions" if place else "")
        return Source(SourceKind.PANORAMAS, folder, text, tuple(images), tuple(headers),
                      cameras=(_panorama(width, height),))  # fmt: skip
    if tagged:
        raise InputError(
            f"{tagged[0].path}: says that it is equirectangular but is {width} x {height}, expected a full panorama, "
            "twice as wide as high"
        )
    camera = _perspective(folder, headers, width, height)
    text = f"{n} pictures of one camera with known intrinsics, {width} x {height}"
    return Source(SourceKind.PERSPECTIVE, folder, text, tuple(images), tuple(headers), cameras=(camera,))


def _one_size(folder: Path, headers: Sequence[ImageHeader]) -> tuple[int, int]:
    first = headers[0]
    for other in headers[1:]:
        if (other.width, other.height) != (first.width, first.height):
            raise InputError(
                f"{folder}: {first.path.name} is {first.width} x {first.height} and {other.path.name} "
                f"{other.width} x {other.height}, expected one size"
            )
    return first.width, first.height


def _perspective(folder: Path, headers: Sequence[ImageHeader], width: int, height: int) -> Camera:
    file = folder / _CAMERAS_TXT
    if file.is_file():
        return _camera_of_text(file, width, height)
    focal = [header.focal_px for header in headers]
    if any(f is None for f in focal):
        raise InputError(
            f"{folder}: the pictures are {width} x {height}, expected panoramas, twice as wide as high; or, of a "
            f"perspective camera, its intrinsics in {file.name} (COLMAP) or a focal length in every header"
        )
    known = float(np.median([f for f in focal if f is not None]))
    return Camera(1, "SIMPLE_PINHOLE", width, height, (known, width / 2, height / 2))


def _camera_of_text(file: Path, width: int, height: int) -> Camera:
    lines = [line.split() for line in _text(file).splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) != 1 or len(lines[0]) < 5:
        raise InputError(f"{file}: has {len(lines)} cameras, expected one line: id, model, width, height, parameters")
    camera_id, model, *numbers = lines[0]
    try:
        full = (int(numbers[0]), int(numbers[1]))
        camera = Camera(int(camera_id), model, *full, tuple(float(x) for x in numbers[2:]))
    except ValueError as error:
        raise InputError(f"{file}: {error}, expected id, model, width, height, parameters") from None
    if full != (width, height):
        raise InputError(f"{file}: the camera is {full[0]} x {full[1]}, but the pictures are {width} x {height}")
    return _checked(str(file), camera)


def _checked(where: str, camera: Camera) -> Camera:
    """Hand back a camera that sees something in the middle of its pictures."""
    if camera.model in {EQUIRECTANGULAR_ID, "EQUIRECTANGULAR"}:
        return camera
    x, y = camera.width / 2, camera.height / 2
    known = {"model": camera.model, "width": camera.width, "height": camera.height, "params": list(camera.params)}
    try:
        with np.errstate(all="ignore"):
            first, second = bearings_from_pixels(known, [[x, y], [x + 1.0, y]])
    except MissingExtraError:
        raise
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    if not np.linalg.norm(second - first) > 0.0:
        raise InputError(
            f"{where}: with the parameters {list(camera.params)} the camera sees nothing, expected its own"
        )
    return camera


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{file}: cannot be read ({error})") from None


# rigs


def _rig_file(folder: Path) -> Path | None:
    """Find a calibration: a JSON file that is a list of rigs."""
    for file in sorted(folder.glob("*.json")):
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, json.JSONDecodeError):
            if "rig" in file.name.lower():
                raise InputError(f"{file}: cannot be read as a calibration (JSON)") from None
            continue
        if isinstance(content, list) and content and isinstance(content[0], dict) and "cameras" in content[0]:
            return file
    return None


@dataclass(frozen=True, eq=False)
class _RigCamera:
    prefix: str
    model: str
    params: tuple[float, ...]
    sensor_from_rig: Float
    center_in_rig: Float


def _rig(folder: Path, file: Path) -> Source:
    cameras = _rig_cameras(file)
    listed = [_below(folder, camera.prefix) for camera in cameras]
    for camera, images in zip(cameras, listed, strict=True):
        if not images:
            raise InputError(f"{folder}: has no pictures below {camera.prefix}, which {file.name} names")
    together = sorted(set.union(*(set(images) for images in listed)))
    whole = [name for name in together if all(name in images for images in listed)]
    # pictures of one moment have one name
    if not whole:
        raise InputError(
            f"{folder}: no name is below all of {', '.join(c.prefix for c in cameras)}, expected pictures "
            "of one moment to have one name"
        )
    if len(together) == 1:
        raise InputError(f"{folder}: has pictures of one moment, expected at least two")
    rows = [(frame, c, images[name]) for frame, name in enumerate(together) for c, images in enumerate(listed)
            if name in images]  # fmt: skip
    headers = [read_header(path) for _, _, path in rows]
    made = []
    for c, camera in enumerate(cameras):
        width, height = _one_size(folder, [h for h, row in zip(headers, rows, strict=True) if row[1] == c])
        made.append(_checked(f"{file}: camera {c}", Camera(c + 1, camera.model, width, height, camera.params)))
    sizes = " and ".join(sorted({f"{camera.width} x {camera.height}" for camera in made}))
    return Source(
        SourceKind.RIG,
        folder,
        f"rig of {len(cameras)} cameras ({file.name}), {len(together)} moments, {len(rows)} pictures of {sizes}",
        tuple(path for _, _, path in rows),
        tuple(headers),
        cameras=tuple(made),
        image_camera=np.array([c for _, c, _ in rows], dtype=np.int32),
        image_frame=np.array([frame for frame, _, _ in rows], dtype=np.int32),
        sensor_from_rig=np.array([camera.sensor_from_rig for camera in cameras]),
        center_in_rig=np.array([camera.center_in_rig for camera in cameras]),
    )


def _below(folder: Path, prefix: str) -> dict[str, Path]:
    """Pictures whose path begins with a prefix, by the rest of the path."""
    place = folder / prefix
    if prefix.endswith("/") or place.is_dir():
        return {path.stem: path for path in image_files(place)} if place.is_dir() else {}
    if not place.parent.is_dir():
        return {}
    return {path.stem.removeprefix(place.name): path for path in image_files(place.parent)
            if path.name.startswith(place.name)}  # fmt: skip


def _rig_cameras(file: Path) -> list[_RigCamera]:
    try:
        content = json.loads(_text(file))
    except json.JSONDecodeError as error:
        raise InputError(f"{file}: is no JSON ({error.msg}, line {error.lineno})") from None
    rigs = content if isinstance(content, list) else [content]
    if len(rigs) != 1 or not isinstance(rigs[0], dict) or not isinstance(rigs[0].get("cameras"), list):
        raise InputError(f"{file}: expected a list of one rig with its cameras, as COLMAP writes it")
    return [_rig_camera(file, c, entry) for c, entry in enumerate(rigs[0]["cameras"])]


def _rig_camera(file: Path, c: int, entry: Any) -> _RigCamera:
    where = f"{file}: camera {c}"
    if not isinstance(entry, dict):
        raise InputError(f"{where} is no record")
    for key in ("image_prefix", "camera_model_name", "camera_params"):
        if key not in entry:
            raise InputError(f"{where} has no {key}")
    if entry.get("ref_sensor", False):
        quaternion, translation = [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    else:
        for key in ("cam_from_rig_rotation", "cam_from_rig_translation"):
            if key not in entry:
                raise InputError(f"{where} has no {key}: calibrate the rig")
        quaternion, translation = entry["cam_from_rig_rotation"], entry["cam_from_rig_translation"]
    params, wxyz, t = (_numbers(where, value) for value in (entry["camera_params"], quaternion, translation))
    if wxyz.shape != (4,) or t.shape != (3,) or not np.linalg.norm(wxyz) > 0.0:
        raise InputError(f"{where} has a place that is no quaternion (w, x, y, z) and translation of three numbers")
    rotation = rotation_from_quaternion(wxyz[None] / np.linalg.norm(wxyz))[0]
    return _RigCamera(str(entry["image_prefix"]), str(entry["camera_model_name"]), tuple(params.tolist()), rotation,
                      -rotation.T @ t)  # fmt: skip


def _numbers(where: str, values: Any) -> Float:
    try:
        found = np.array(values, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise InputError(f"{where} has {values!r}, expected numbers") from None
    if not np.isfinite(found).all():
        raise InputError(f"{where} has numbers that are not finite")
    return found
