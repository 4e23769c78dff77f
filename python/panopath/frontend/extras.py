"""Libraries that read pictures and video: imported where they are used, absent in one line."""

from __future__ import annotations

import importlib
from typing import Any

from panopath.errors import MissingExtraError


def opencv() -> Any:
    """OpenCV."""
    return _imported("cv2", "OpenCV", "images")


def pillow() -> Any:
    """Pillow's ``Image``."""
    return _imported("PIL.Image", "Pillow", "images")


def pyav() -> Any:
    """PyAV."""
    return _imported("av", "PyAV", "video")


def _imported(module: str, name: str, extra: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingExtraError(f"reading pictures needs {name}: pip install 'panopath[{extra}]'") from None
