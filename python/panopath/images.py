"""Pictures of the views, one at a time: nothing here holds more than the one that is asked for (extra ``images``).

A picture is (h, w, 3) uint8, red, green, blue. A panorama is equirectangular and covers the whole sphere, w = 2 h; its
pixels mean what ``CONVENTIONS.md`` says, centres at +0.5.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError, MissingExtraError

Picture = npt.NDArray[np.uint8]
#: Gives the picture of a view by its index, None where there is none.
ImageSource = Callable[[int], Picture | None]
#: Pictures of all views: their files in the order of the views (None: no picture), or a function of the index.
Images = Sequence[str | PathLike[str] | None] | ImageSource


def load_opencv() -> Any:
    """Import OpenCV.

    Raises
    ------
    MissingExtraError
        Where it is not installed.
    """
    try:
        return importlib.import_module("cv2")
    except ImportError:
        raise MissingExtraError(
            'pictures of views need OpenCV: install the extra with pip install "panopath[images]"'
        ) from None


def image_source(images: Images, n_views: int) -> ImageSource:
    """Make one way to ask for a picture of either way to give them.

    Raises
    ------
    InputError
        Where the files are not as many as the views.
    """
    if callable(images):
        return images
    files = [None if path is None else Path(path) for path in images]
    if len(files) != n_views:
        raise InputError(f"images has {len(files)} entries, expected one a view, {n_views}")

    def read(view: int) -> Picture | None:
        path = files[view]
        return None if path is None else read_image(path)

    return read


def read_image(path: str | PathLike[str]) -> Picture:
    """Read a picture of any kind that OpenCV reads; deeper ones are brought to 8 bits, the EXIF orientation applied.

    Raises
    ------
    InputError
        Where there is no such file, or it is not a picture.
    """
    cv2 = load_opencv()
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    try:
        found = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
    except cv2.error:
        found = None
    if found is None:
        raise InputError(f"{path}: is not a picture that OpenCV reads, or is damaged")
    return np.asarray(cv2.cvtColor(found, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def encoded(picture: Picture, suffix: str, quality: int = 95) -> bytes:
    """Bytes of a picture file; ``suffix`` such as ``.jpg`` or ``.png`` says which kind.

    Raises
    ------
    InputError
        For a kind that OpenCV does not write.
    """
    cv2 = load_opencv()
    # other kinds have other settings, and complain of this one
    settings = [cv2.IMWRITE_JPEG_QUALITY, quality] if suffix.lower() in {".jpg", ".jpeg"} else []
    try:
        bgr = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        done, data = cv2.imencode(suffix, bgr, settings)
    except cv2.error:
        done, data = False, None
    if not done:
        raise InputError(f"a picture cannot be written as {suffix!r}, expected .jpg or .png")
    return bytes(data.tobytes())


def check_panorama(picture: Picture, name: str) -> Picture:
    """Hand back a picture that can be a whole panorama.

    Raises
    ------
    InputError
        Where it is not (h, w, 3) uint8, or its sides are not as two to one.
    """
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise InputError(f"{name}: has type {picture.dtype} and shape {picture.shape}, expected uint8 (h, w, 3)")
    height, width = picture.shape[:2]
    # a row or column lost to a codec's blocks does no harm
    if abs(width - 2 * height) > max(2, width // 100):
        raise InputError(f"{name}: is {width} x {height} pixels, expected a panorama, twice as wide as high")
    return picture
