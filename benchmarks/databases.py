"""COLMAP databases with exact truth, COLMAP's global mapper on them, and one score for any mapper's models.

``python -m benchmarks.databases`` makes databases, runs the peer in a process of its own and prints the table.

The world is the street of ``panopath.simulate``: a walk round a block, each point seen from near by. (pycolmap's own
``synthesize_dataset`` was tried first. It matches every point in all images whatever its track length: with 50 images
each point has 1,225 matches, and with 30 % of raw matches wrong the mapper was left with no track and failed.)
Pictures are panoramas (``EQUIRECTANGULAR``), narrow pictures along the path (``PINHOLE``), or ``rig``: four pinhole
cameras on one rig.

Matches are wrong in two ways. ``wrong_raw`` of the raw matches are random; COLMAP's own geometric verification runs on
all of them and removes nearly all of these, as it would for a user. ``wrong_verified`` of the matches that passed are
then redirected to another feature within 4 px of the epipolar line, since those are what verification cannot see.
"""

from __future__ import annotations

import json
import sqlite3
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import panopath as pp
from panopath.model import Float

from benchmarks.job import answer_of
from benchmarks.optional import load
from benchmarks.scoring import align, distances, rms

Ids = npt.NDArray[np.int64]

_BAND_PX = 4.0
_LEAST_COMMON = 20


@dataclass(frozen=True)
class Spec:
    """Which database."""

    camera: Literal["EQUIRECTANGULAR", "PINHOLE", "rig"] = "EQUIRECTANGULAR"
    #: Places; images too, but for ``rig``, which takes four at a place.
    n_places: int = 100
    n_points: int = 20000
    noise_px: float = 1.0
    #: Chance that a point two images see is matched.
    found: float = 0.7
    wrong_raw: float = 0.2
    wrong_verified: float = 0.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Truth:
    """Poses of the images of a database."""

    names: tuple[str, ...]
    cam_from_world: Float
    centers: Float


@dataclass(frozen=True, eq=False)
class _Pictures:
    """What every image saw."""

    #: (I,) camera of each image, from 0, and its frame.
    camera: Ids
    frame: Ids
    cam_from_world: Float
    centers: Float
    #: Of each image: (k, 2) noisy pixels and (k,) their points, ascending.
    pixels: list[Float]
    points: list[Ids]


def make_database(spec: Spec, path: Path) -> Truth:
    """Write a database whose matches have been verified by COLMAP."""
    pycolmap = load("pycolmap")
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(spec.seed)
    rng = np.random.default_rng(spec.seed)
    cameras, sensor_from_rig = _cameras(spec)
    pictures = _take_pictures(spec, cameras, sensor_from_rig, rng)
    path.unlink(missing_ok=True)
    names = tuple(f"camera{c + 1}/place{f:06d}.jpg" for c, f in zip(pictures.camera, pictures.frame, strict=True))
    database = pycolmap.Database.open(str(path))
    _write_sensors(database, cameras, sensor_from_rig)
    _write_images(database, cameras, pictures, names)
    for first in range(len(names)):
        for second in range(first + 1, len(names)):
            matches = _raw_matches(spec, pictures, first, second, rng)
            if matches is not None:
                database.write_matches(first + 1, second + 1, matches)
    database.close()
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = spec.seed
    pycolmap.geometric_verification(str(path), two_view_geometry_options=options)
    if spec.wrong_verified > 0.0:
        _redirect(spec, path, cameras, pictures, rng)
    return Truth(names, pictures.cam_from_world, pictures.centers)


def _cameras(spec: Spec) -> tuple[list[Any], list[tuple[Float, Float]]]:
    """Cameras, and orientation and centre of each in the rig."""
    pycolmap = load("pycolmap")
    if spec.camera == "EQUIRECTANGULAR":
        cameras = [pycolmap.Camera(model="EQUIRECTANGULAR", width=3840, height=1920, params=[3840.0, 1920.0])]
    else:
        n = 4 if spec.camera == "rig" else 1
        cameras = [
            pycolmap.Camera(model="PINHOLE", width=1600, height=1200, params=[800.0, 800.0, 800.0, 600.0])
            for _ in range(n)
        ]
    for c, camera in enumerate(cameras):
        camera.camera_id, camera.has_prior_focal_length = c + 1, True
    places = []
    for c in range(len(cameras)):
        angle = 0.5 * np.pi * c
        turn = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
        places.append((turn, np.zeros(3) if c == 0 else turn[2] * 0.05))
    return cameras, places


def _take_pictures(
    spec: Spec, cameras: Sequence[Any], sensor_from_rig: Sequence[tuple[Float, Float]], rng: np.random.Generator
) -> _Pictures:
    world = pp.simulate("street", n_views=spec.n_places, n_points=spec.n_points, seed=spec.seed)
    by_view = np.argsort(world.tracks.view, kind="stable")
    starts = np.searchsorted(world.tracks.view[by_view], np.arange(spec.n_places + 1))
    ahead = np.roll(world.centers, -1, axis=0) - world.centers
    rows: list[tuple[int, int, Float, Float, Float, Ids]] = []
    for f in range(spec.n_places):
        rig_from_world = _turn(rng.normal(0.0, 0.05, 3)) @ _looking_along(ahead[f])
        seen = np.sort(world.tracks.track[by_view[starts[f] : starts[f + 1]]]).astype(np.int64)
        for c, (camera, (rotation, center)) in enumerate(zip(cameras, sensor_from_rig, strict=True)):
            cam_from_world = rotation @ rig_from_world
            position = world.centers[f] + rig_from_world.T @ center
            ray = (world.points[seen] - position) @ cam_from_world.T
            pixels = np.asarray(camera.img_from_cam(ray), dtype=np.float64).reshape(-1, 2)
            pixels += rng.normal(0.0, spec.noise_px, pixels.shape)
            inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
            inside &= (ray[:, 2] > 0) | camera.is_spherical()
            shuffled = rng.permutation(np.flatnonzero(inside))
            rows.append((c, f, cam_from_world, position, pixels[shuffled], seen[shuffled]))
    camera_of, frame, rotations, centers, pixels_of, points_of = zip(*rows, strict=True)
    return _Pictures(
        np.array(camera_of), np.array(frame), np.array(rotations), np.array(centers), list(pixels_of), list(points_of)
    )


def _looking_along(direction: Float) -> Float:
    """Camera axes (x right, y down, z forward) in a world with z up; the rows of ``cam_from_world``."""
    forward = direction * [1.0, 1.0, 0.0]
    forward /= np.linalg.norm(forward)
    down = np.array([0.0, 0.0, -1.0])
    return np.stack((np.cross(down, forward), down, forward))


def _turn(vector: Float) -> Float:
    return np.asarray(load("pycolmap").Rotation3d(vector).matrix())


def _write_sensors(database: Any, cameras: Sequence[Any], sensor_from_rig: Sequence[tuple[Float, Float]]) -> None:
    pycolmap = load("pycolmap")
    rig = pycolmap.Rig(rig_id=1)
    for c, (camera, (rotation, center)) in enumerate(zip(cameras, sensor_from_rig, strict=True)):
        database.write_camera(camera, True)
        if c == 0:
            rig.add_ref_sensor(camera.sensor_id)
        else:
            rig.add_sensor(camera.sensor_id, pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ center))
    database.write_rig(rig, True)


def _write_images(database: Any, cameras: Sequence[Any], pictures: _Pictures, names: Sequence[str]) -> None:
    pycolmap = load("pycolmap")
    frames: dict[int, Any] = {}
    for i, name in enumerate(names):
        camera = cameras[pictures.camera[i]]
        image = pycolmap.Image(name=name, camera_id=camera.camera_id, image_id=i + 1)
        database.write_image(image, True)
        database.write_keypoints(i + 1, pictures.pixels[i].astype(np.float32))
        frame_id = int(pictures.frame[i]) + 1
        if frame_id not in frames:
            frames[frame_id] = pycolmap.Frame(frame_id=frame_id, rig_id=1)
        frames[frame_id].add_data_id(image.data_id)
    for frame in frames.values():
        database.write_frame(frame, True)


def _raw_matches(
    spec: Spec, pictures: _Pictures, first: int, second: int, rng: np.random.Generator
) -> npt.NDArray[np.uint32] | None:
    """Match a pair, a share of it at random; None where too few points are common."""
    _, a, b = np.intersect1d(pictures.points[first], pictures.points[second], return_indices=True)
    found = rng.random(len(a)) < spec.found
    if found.sum() < _LEAST_COMMON:
        return None
    a, b = a[found], b[found]
    wrong = rng.random(len(a)) < spec.wrong_raw
    b[wrong] = rng.integers(len(pictures.points[second]), size=int(wrong.sum()))
    return np.stack((a, b), axis=1)[rng.permutation(len(a))].astype(np.uint32)


def _redirect(spec: Spec, path: Path, cameras: Sequence[Any], pictures: _Pictures, rng: np.random.Generator) -> None:
    """Point a share of the verified matches at another feature near the epipolar line."""
    bearings = [
        np.asarray(cameras[c].cam_ray_from_img(pixels)).reshape(-1, 3)
        for c, pixels in zip(pictures.camera, pictures.pixels, strict=True)
    ]
    with sqlite3.connect(path) as connection:
        rows = connection.execute("SELECT pair_id, data FROM two_view_geometries WHERE rows > 0 ORDER BY pair_id")
        for pair_id, data in rows.fetchall():
            i, j = (int(x) - 1 for x in divmod(pair_id, 2**31 - 1))
            matches = np.frombuffer(data, "<u4").reshape(-1, 2).copy()
            chosen = np.flatnonzero(rng.random(len(matches)) < spec.wrong_verified)
            second_from_first = pictures.cam_from_world[j] @ pictures.cam_from_world[i].T
            baseline = pictures.cam_from_world[j] @ (pictures.centers[i] - pictures.centers[j])
            normal = np.cross(baseline, bearings[i][matches[chosen, 0]] @ second_from_first.T)
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
            camera = cameras[pictures.camera[j]]
            band = _BAND_PX * (2 * np.pi / camera.width if camera.is_spherical() else 1 / camera.mean_focal_length())
            near = np.abs(normal @ bearings[j].T) < band
            near[np.arange(len(chosen)), matches[chosen, 1]] = False
            score = np.where(near, rng.random(near.shape), -1.0)
            target = score.argmax(axis=1) if len(chosen) else np.empty(0, dtype=np.int64)
            ok = near[np.arange(len(chosen)), target]
            matches[chosen[ok], 1] = target[ok]
            connection.execute(
                "UPDATE two_view_geometries SET data = ? WHERE pair_id = ?", (matches.tobytes(), pair_id)
            )


# the peer


@dataclass(frozen=True)
class PeerOptions:
    """How COLMAP's global mapper is run."""

    #: Our mapper takes intrinsics as given; the peer's default is to refine them.
    refine_intrinsics: bool = False
    random_seed: int = 0


def global_mapping(database: Path, folder: Path, options: PeerOptions | None = None) -> float:
    """Run ``pycolmap.global_mapping`` in this process; the seconds it took."""
    pycolmap = load("pycolmap")
    pycolmap.logging.minloglevel = 2
    chosen = options or PeerOptions()
    pipeline = pycolmap.GlobalPipelineOptions()
    pipeline.random_seed = chosen.random_seed
    adjustment = pipeline.mapper.bundle_adjustment
    adjustment.refine_focal_length = adjustment.refine_extra_params = chosen.refine_intrinsics
    adjustment.refine_sensor_from_rig = False
    pipeline.mapper.refine_sensor_from_rig = False
    folder.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    pycolmap.global_mapping(str(database), str(database.parent), str(folder), pipeline)
    return time.perf_counter() - began


def run_peer(database: Path, folder: Path, time_limit_s: float = 1800.0) -> dict[str, Any]:
    """Run the peer in a fresh process: ``{"seconds": ...}``, or ``{"error": text}``."""
    with tempfile.TemporaryDirectory() as scratch:
        answer = Path(scratch) / "answer.json"
        command = [sys.executable, "-m", "benchmarks.databases", "--peer", str(database), str(folder), str(answer)]
        return answer_of(command, answer, time_limit_s)


@dataclass(frozen=True)
class Score:
    """How near a mapper's models are to the truth."""

    n_models: int
    #: Of the largest model.
    n_registered: int
    n_images: int
    n_points: int
    mean_track_length: float
    #: Centres after the best similarity, in the world's metres.
    median_m: float
    rms_m: float
    #: Median angle between orientations after that similarity.
    rotation_deg: float
    reprojection_px: float


def score_models(folder: Path, truth: Truth) -> Score:
    """Score the largest of the models ``folder/0``, ``folder/1`` ..."""
    pycolmap = load("pycolmap")
    models = [pycolmap.Reconstruction(str(path.parent)) for path in sorted(folder.glob("*/images.bin"))]
    if not models:
        return Score(0, 0, len(truth.names), 0, *[float("nan")] * 5)
    model = max(models, key=lambda m: int(m.num_reg_images()))
    index = {name: i for i, name in enumerate(truth.names)}
    centers, turns = np.full_like(truth.centers, np.nan), np.full_like(truth.cam_from_world, np.nan)
    for image in model.images.values():
        if image.has_pose:
            centers[index[image.name]] = image.projection_center()
            turns[index[image.name]] = image.cam_from_world().rotation.matrix()
    fit = align(centers, truth.centers, rotate=True)
    error = distances(fit.apply(centers), truth.centers)
    left = np.einsum("nij,kj,nlk->nil", turns, fit.rotation, truth.cam_from_world)
    cosine = (np.einsum("nii->n", left) - 1.0) / 2.0
    return Score(
        n_models=len(models),
        n_registered=int(model.num_reg_images()),
        n_images=len(truth.names),
        n_points=int(model.num_points3D()),
        mean_track_length=float(model.compute_mean_track_length()),
        median_m=float(np.nanmedian(error)),
        rms_m=rms(error),
        rotation_deg=float(np.degrees(np.nanmedian(np.arccos(np.clip(cosine, -1.0, 1.0))))),
        reprojection_px=float(model.compute_mean_reprojection_error()),
    )


CASES: dict[str, Spec] = {
    "panoramas 100": Spec("EQUIRECTANGULAR", 100, 20000),
    "panoramas 100, 10% wrong": Spec("EQUIRECTANGULAR", 100, 20000, wrong_verified=0.1),
    "panoramas 100, 30% wrong": Spec("EQUIRECTANGULAR", 100, 20000, wrong_verified=0.3),
    "pinhole 100": Spec("PINHOLE", 100, 60000),
    "pinhole 100, 10% wrong": Spec("PINHOLE", 100, 60000, wrong_verified=0.1),
    "rig of 4, 50 places": Spec("rig", 50, 15000),
}


def describe(database: Path) -> str:
    """Sizes of a database."""
    with sqlite3.connect(f"{database.resolve().as_uri()}?mode=ro", uri=True) as connection:
        sizes = connection.execute("SELECT count(*), sum(rows) FROM two_view_geometries WHERE rows > 0").fetchone()
        n_features = connection.execute("SELECT sum(rows) FROM keypoints").fetchone()[0]
    return f"{n_features} features, {sizes[1]} matches in {sizes[0]} pairs"


def main(repeats: int = 1) -> None:
    """Print the table of the peer."""
    print(
        f"{'case':28} {'registered':>12} {'models':>6} {'points':>7} {'track':>6} {'median m':>9} {'rms m':>9} "
        f"{'deg':>7} {'px':>6} {'seconds':>8}"
    )
    with tempfile.TemporaryDirectory() as scratch:
        for name, spec in CASES.items():
            database = Path(scratch) / "database.db"
            truth = make_database(spec, database)
            answers = [run_peer(database, Path(scratch) / f"{name}-{r}") for r in range(repeats)]
            if "error" in answers[0]:
                print(f"{name:28} {answers[0]['error']}  ({describe(database)})", flush=True)
                continue
            s = asdict(score_models(Path(scratch) / f"{name}-0", truth))
            seconds = statistics.median(a["seconds"] for a in answers)
            print(
                f"{name:28} {s['n_registered']:5d} of {s['n_images']:3d} {s['n_models']:6d} {s['n_points']:7d} "
                f"{s['mean_track_length']:6.2f} {s['median_m']:9.5f} {s['rms_m']:9.5f} {s['rotation_deg']:7.4f} "
                f"{s['reprojection_px']:6.2f} {seconds:8.1f}  ({describe(database)})",
                flush=True,
            )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--peer"]:
        database_path, folder_path, answer_path = map(Path, sys.argv[2:5])
        seconds_taken = global_mapping(database_path, folder_path)
        answer_path.write_text(json.dumps({"seconds": seconds_taken}), encoding="utf-8")
    else:
        main()
