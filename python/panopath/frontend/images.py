"""Pictures on disk: their pixels at the working resolution, and what their headers know of place and attitude.

Headers are read by Pillow: EXIF (orientation, GPS, time), and in XMP the panorama tags of Google (GPano).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.frontend.extras import opencv, pillow
from panopath.model import Float

Gray = npt.NDArray[np.uint8]

#: Endings that are tried as pictures.
SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp"})

_GPS, _EXIF, _TIME, _SUBSECOND, _ORIENTATION = 0x8825, 0x8769, 0x9003, 0x9291, 0x0112


@dataclass(frozen=True)
class ImageHeader:
    """What the header of a picture says; None where it does not."""

    path: Path
    width: int
    height: int
    #: Latitude and longitude in degrees, altitude in metres (0 where unknown).
    position_wgs84: tuple[float, float, float] | None = None
    #: Seconds since the epoch, of the camera's own clock.
    time_s: float | None = None
    #: GPano's ProjectionType, lower case.
    projection: str | None = None
    #: GPano's heading, pitch and roll, degrees.
    pose_deg: tuple[float, float, float] | None = None
    #: Focal length in pixels, from the 35 mm equivalent of EXIF.
    focal_px: float | None = None


def image_files(folder: Path) -> list[Path]:
    """Pictures of a folder, in the order of their names with numbers in their order."""
    try:
        found = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror})") from None
    return sorted((path for path in found if not path.name.startswith(".")), key=lambda path: _natural(path.name))


def _natural(name: str) -> list[tuple[int, int, str]]:
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name) if part]


def read_header(path: Path) -> ImageHeader:
    """Read the header of a picture.

    Raises
    ------
    InputError
        Naming a file that is no picture.
    """
    try:
        with pillow().open(path) as picture:
            width, height = picture.size
            exif, xmp = picture.getexif(), _xmp(picture)
            rotated = exif.get(_ORIENTATION, 1) in {5, 6, 7, 8}
            inner = exif.get_ifd(_EXIF)
            position, time = _gps(exif.get_ifd(_GPS)), _time(inner)
    except InputError:
        raise
    except Exception as error:  # Pillow's readers raise anything for damaged files
        raise InputError(
            f"{path}: cannot be read as a picture ({_reason(error)}); copy it again or leave it out"
        ) from None
    if rotated:
        width, height = height, width
    equivalent = _number(inner.get(0xA405))
    focal = None if not equivalent else equivalent / np.hypot(36.0, 24.0) * float(np.hypot(width, height))
    pose = tuple(_number(xmp.get(f"Pose{name}Degrees")) for name in ("Heading", "Pitch", "Roll"))
    return ImageHeader(
        path=path,
        width=width,
        height=height,
        position_wgs84=position,
        time_s=time,
        projection=xmp["ProjectionType"].lower() if "ProjectionType" in xmp else None,
        pose_deg=None if any(x is None for x in pose) else tuple(float(x or 0.0) for x in pose),  # type: ignore[arg-type]
        focal_px=focal,
    )


def _reason(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].replace("\n", " ")[:120]


def _xmp(picture: Any) -> dict[str, str]:
    """GPano's tags, which stand as attributes or as elements."""
    packet = picture.info.get("xmp", b"")
    text = packet.decode("utf-8", "replace") if isinstance(packet, bytes) else str(packet)
    tags = re.findall(r"GPano:(\w+)\s*=\s*[\"']([^\"']*)[\"']", text)
    return dict(tags + re.findall(r"<GPano:(\w+)>([^<]*)</GPano:", text))


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if np.isfinite(number) else None


def _gps(tags: dict[int, Any]) -> tuple[float, float, float] | None:
    """Latitude, longitude and altitude; a receiver without a fix writes zeros or nothing."""
    found = []
    for value, side, negative in ((2, 1, "S"), (4, 3, "W")):
        parts = tags.get(value)
        numbers = [_number(part) for part in parts] if isinstance(parts, tuple | list) else []
        if len(numbers) != 3 or any(x is None for x in numbers):
            return None
        degrees = sum(float(x or 0.0) / 60.0**k for k, x in enumerate(numbers))
        found.append(-degrees if str(tags.get(side, "")).strip("\x00 ").upper() == negative else degrees)
    latitude, longitude = found
    if abs(latitude) > 90.0 or abs(longitude) > 180.0 or (latitude == 0.0 and longitude == 0.0):
        return None
    altitude = _number(tags.get(6)) or 0.0
    below = tags.get(5) in {1, b"\x01"}
    return latitude, longitude, -altitude if below else altitude


def _time(tags: dict[int, Any]) -> float | None:
    found = re.fullmatch(r"(\d{4}):(\d\d):(\d\d) (\d\d):(\d\d):(\d\d).*", str(tags.get(_TIME, "")))
    if found is None:
        return None
    year, month, day, hour, minute, second = found.groups()
    try:
        moment = np.datetime64(f"{year}-{month}-{day}T{hour}:{minute}:{second}")
    except ValueError:
        return None
    fraction = str(tags.get(_SUBSECOND, "")).strip()
    return float(moment.astype("datetime64[s]").astype(np.int64)) + (
        float(f"0.{fraction}") if fraction.isdigit() else 0
    )


def read_image(path: Path, width: int | None = None, *, color: bool = False) -> Gray:
    """Read a picture, turned as its header says, no wider than ``width``.

    Returns
    -------
    array
        (height, width) bytes; with ``color``, (height, width, 3) red, green, blue.

    Raises
    ------
    InputError
        Naming a file that cannot be decoded.
    """
    cv2 = opencv()
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    picture = None
    if len(data):
        try:
            # wide pictures are decoded at a smaller size, which JPEG does cheaply
            picture = cv2.imdecode(data, cv2.IMREAD_COLOR if color else cv2.IMREAD_GRAYSCALE)
        except cv2.error:
            picture = None
    if picture is None:
        raise InputError(f"{path}: cannot be decoded, it is damaged or no picture; copy it again or leave it out")
    picture = at_width(picture, width)
    return np.ascontiguousarray(picture[..., ::-1]) if color else picture


def at_width(picture: Gray, width: int | None) -> Gray:
    """Shrink a picture to a width; none is enlarged."""
    height, full = picture.shape[:2]
    if width is None or width >= full:
        return picture
    size = (width, max(1, round(height * width / full)))
    return np.asarray(opencv().resize(picture, size, interpolation=opencv().INTER_AREA), dtype=np.uint8)


def read_mask(path: Path) -> npt.NDArray[np.bool_]:
    """Read a mask: features are taken where it is not black."""
    return np.asarray(read_image(path) != 0)


def masks_of(masks: Path | None, images: list[Path]) -> list[Path | None]:
    """Find the mask of each image: one file for all, or of a folder those named like the images.

    Raises
    ------
    InputError
        Where there is no such file, or a folder has a mask for none of the images.
    """
    if masks is None:
        return [None] * len(images)
    if masks.is_file():
        return [masks] * len(images)
    if not masks.is_dir():
        raise InputError(f"{masks}: there is no such file or folder, expected a mask or a folder of them")
    names = {path.name: path for path in image_files(masks)}
    by_stem = {path.stem: path for path in names.values()}
    found = [names.get(image.name) or names.get(f"{image.name}.png") or by_stem.get(image.stem) for image in images]
    if not any(found):
        raise InputError(f"{masks}: has no mask named like an image, such as {images[0].stem}.png")
    return found


def positions_of(headers: list[ImageHeader]) -> Float:
    """(M, 3) latitude, longitude, altitude; NaN where unknown."""
    unknown = (np.nan,) * 3
    return np.array([header.position_wgs84 or unknown for header in headers], dtype=np.float64).reshape(-1, 3)
