"""Kerry Park: databases by COLMAP from the two fisheyes of each frame, or from their stitched panoramas.

Features, matches and geometric verification are COLMAP's; both mappers then read the same database.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.optional import load

FISHEYES = ("fisheye_left", "fisheye_right")
PANORAMAS = "equirectangular"


def make_fisheye_database(folder: Path, database: Path) -> Path:
    """Write features and verified matches of the 48 fisheye images, calibrated and joined in a rig."""
    pycolmap = _pycolmap()
    database.unlink(missing_ok=True)
    for side, params in zip(FISHEYES, _calibration(folder / "rig_config.json"), strict=True):
        names = sorted(f"{side}/{path.name}" for path in (folder / side).glob("*.jpg"))
        _extract(folder, database, names, "OPENCV_FISHEYE", params)
    with pycolmap.Database.open(str(database)) as opened:
        pycolmap.apply_rig_config(pycolmap.read_rig_config(folder / "rig_config.json"), opened)
    _match(database)
    return database


def make_panorama_database(folder: Path, database: Path) -> Path:
    """Write features and verified matches of the 24 stitched panoramas."""
    database.unlink(missing_ok=True)
    names = sorted(f"{PANORAMAS}/{path.name}" for path in (folder / PANORAMAS).glob("*.jpg"))
    _extract(folder, database, names, "EQUIRECTANGULAR", (1024.0, 512.0))
    _match(database)
    return database


def _pycolmap() -> Any:
    pycolmap = load("pycolmap")
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(0)
    return pycolmap


def _calibration(path: Path) -> list[tuple[float, ...]]:
    """Camera parameters of the two fisheyes."""
    rig = json.loads(path.read_text(encoding="utf-8"))[0]
    return [tuple(camera["camera_params"]) for camera in rig["cameras"]]


def _extract(folder: Path, database: Path, names: list[str], model: str, params: tuple[float, ...]) -> None:
    """Find features; given parameters count as calibrated."""
    pycolmap = _pycolmap()
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model, reader.camera_params = model, ",".join(map(str, params))
    pycolmap.extract_features(
        database, folder, names, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader
    )


def _match(database: Path) -> None:
    """Match all pairs and verify them."""
    pycolmap = _pycolmap()
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = 0
    pycolmap.match_exhaustive(database, verification_options=verification)
