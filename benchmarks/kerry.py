"""Kerry Park: databases by COLMAP from the two fisheyes of each frame, or from their stitched panoramas.

Features, matches and geometric verification are COLMAP's; both mappers then read the same database.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
from panopath.formats.structure import known_scene
from panopath.mapping import map_database
from panopath.model import Float, Scene

from benchmarks.databases import global_mapping
from benchmarks.optional import load
from benchmarks.scoring import distances, rms

FISHEYES = ("fisheye_left", "fisheye_right")
PANORAMAS = "equirectangular"
N_FRAMES = 24


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
    pycolmap.extract_features(database, folder, names, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader)


def _match(database: Path) -> None:
    """Match all pairs and verify them."""
    pycolmap = _pycolmap()
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = 0
    pycolmap.match_exhaustive(database, verification_options=verification)


@dataclass(frozen=True)
class Mapped:
    """A mapper's largest model, by frames."""

    mapper: str
    seconds: float
    #: (24, 3) positions of the frames (left eyes), NaN where there are none.
    centers: Float
    n_points: int
    n_observations: int
    #: (n,) angles between observations and points, radians.
    error_rad: Float
    #: (n, 3)
    points: Float


def map_with_colmap(database: Path, folder: Path, mapper: str) -> Mapped:
    """Run COLMAP's global or incremental mapper, intrinsics and rig held as ours holds them."""
    pycolmap = _pycolmap()
    folder.mkdir(parents=True, exist_ok=True)
    if mapper == "global":
        seconds = global_mapping(database, folder)
    else:
        options = pycolmap.IncrementalPipelineOptions()
        options.ba_refine_focal_length = options.ba_refine_extra_params = options.ba_refine_sensor_from_rig = False
        options.random_seed = 0
        began = time.perf_counter()
        pycolmap.incremental_mapping(database, folder, folder, options)
        seconds = time.perf_counter() - began
    return read_largest(folder, f"COLMAP, {mapper}", seconds)


def map_with_panopath(database: Path, folder: Path) -> tuple[Mapped, Scene]:
    """Run our mapper; the time includes reading and writing."""
    began = time.perf_counter()
    read = pp.read_database(database)
    mapped = map_database(read)
    pp.write_models(read, mapped.reconstruction, folder)
    return read_largest(folder, "panopath", time.perf_counter() - began), mapped.scene


def read_largest(folder: Path, mapper: str, seconds: float) -> Mapped:
    """Read the model with most images of those in ``folder/0``, ``folder/1`` ..."""
    pycolmap = _pycolmap()
    models = [pycolmap.Reconstruction(str(path.parent)) for path in sorted(folder.glob("*/images.bin"))]
    if not models:
        return Mapped(mapper, seconds, np.full((N_FRAMES, 3), np.nan), 0, 0, np.empty(0), np.empty((0, 3)))
    model = max(models, key=lambda m: int(m.num_reg_images()))
    centers = np.full((N_FRAMES, 3), np.nan)
    for image in model.images.values():
        if image.has_pose and not image.name.startswith(FISHEYES[1]):
            centers[frame_of(image.name)] = image.projection_center()
    return Mapped(
        mapper,
        seconds,
        centers,
        int(model.num_points3D()),
        int(model.compute_num_observations()),
        ray_errors(model),
        np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3),
    )


def ray_errors(model: Any) -> Float:
    """Angles between the rays of all observations and their points: pixels would not do behind a fisheye's edge."""
    angles = [np.empty(0)]
    for image in model.images.values():
        seen = image.get_observation_points2D() if image.has_pose else []
        if len(seen):
            ray = np.asarray(model.cameras[image.camera_id].cam_ray_from_img(np.array([p.xy for p in seen])))
            point = np.array([model.points3D[p.point3D_id].xyz for p in seen])
            there = (point - image.projection_center()) @ image.cam_from_world().rotation.matrix().T
            there /= np.linalg.norm(there, axis=1, keepdims=True)
            angles.append(
                2.0
                * np.arcsin(np.minimum(0.5 * distances(ray / np.linalg.norm(ray, axis=1, keepdims=True), there), 1.0))
            )
    return np.concatenate(angles)


def frame_of(name: str) -> int:
    """Frame of an image, from 0: fisheyes count from ``frame_01``, panoramas from ``000000``."""
    digits = "".join(c for c in Path(name).stem if c.isdigit())
    return int(digits) - (0 if name.startswith(PANORAMAS) else 1)


def size_and_deviation(database: Path) -> tuple[float, float]:
    """Rms distance of the frames from their middle in metres, and its relative standard deviation.

    The rig's baseline alone knows of metres. The deviation is that of the distance of the farthest frame from the
    first, to first order, by the covariance with the rig.
    """
    read = pp.read_database(database)
    found = map_database(read)
    kept = found.reconstruction
    at = kept.feature + read.feature_starts[kept.image]
    camera = read.image_camera[kept.image]
    bearing = np.einsum("nji,nj->ni", read.sensor_from_rig[camera], read.bearings[at])
    tracks = pp.Tracks.from_arrays(
        read.image_frame[kept.image],
        kept.point,
        bearing,
        read.n_frames,
        len(kept.points),
        sigma_rad=read.pixel_rad[at],
    )
    rig = pp.Rig.of(camera, read.sensor_from_rig, read.center_in_rig)
    rotation, center = found.scene.cam_from_world, found.scene.centers
    scene = pp.refine(tracks, known_scene(tracks, rotation, center, kept.points), rig=rig)
    size = rms(distances(scene.centers, scene.centers.mean(axis=0)))
    away = scene.centers - scene.centers[0]
    far = int(np.linalg.norm(away, axis=1).argmax())
    unit = away[far] / np.linalg.norm(away[far])
    covariance = pp.scene_covariance(tracks, scene, rig=rig, relative_to=0).cameras[far, 3:, 3:]
    return size, float(np.sqrt(unit @ covariance @ unit) / np.linalg.norm(away[far]))
