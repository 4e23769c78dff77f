"""Relative pose of two panoramas against pycolmap: rotation, direction and time in the same run.

``python -m benchmarks.two_view [--repeats N] [--real]``. The peer is given EQUIRECTANGULAR cameras of 3600 x 1800
pixels, so ten pixels a degree at the equator, and is called in two ways: the two-view geometry that its mapper uses,
and its relative pose followed by its refinement. Its largest error is four times the noise that the bearings really
have; panopath is not told.
"""

from __future__ import annotations

import argparse
import itertools
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
from panopath.cameras import bearings_from_equirectangular, equirectangular_from_bearings
from panopath.model import Bool, Float

from benchmarks.optional import load

WIDTH, HEIGHT = 3600, 1800
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
#: Half of the narrow field of view.
NARROW = np.tan(np.radians(35.0))


@dataclass(frozen=True)
class Pair:
    """Matches of two views, with the truth."""

    first: Float
    second: Float
    second_from_first: Float
    direction: Float
    outlier: Bool


@dataclass(frozen=True)
class Pose:
    """What a solver answers; None where it gives no pose."""

    second_from_first: Float
    direction: Float


def rotation(phi: Float) -> Float:
    angle = float(np.linalg.norm(phi))
    x, y, z = phi / max(angle, 1e-300)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def unit(rows: Float) -> Float:
    return np.asarray(rows / np.linalg.norm(rows, axis=-1, keepdims=True))


def simulate(kind: str, n: int, noise_rad: float, outliers: float, seed: int) -> Pair:
    """Make a pair of one of the kinds in :data:`KINDS`; depths are in baselines."""
    rng = np.random.default_rng([seed, n])
    turn = rotation(unit(rng.normal(size=3)) * rng.uniform(0.0, np.pi))
    center = unit(rng.normal(size=3))
    ray, depth = unit(rng.normal(size=(n, 3))), rng.uniform(2.0, 12.0, size=n)
    if kind == "forward":
        turn, center = rotation(0.1 * rng.normal(size=3)), np.array([0.0, 0.0, 1.0])
    elif kind == "small parallax":
        depth = rng.uniform(20.0, 100.0, size=n)
    elif kind == "narrow":
        ray = unit(np.column_stack([rng.uniform(-NARROW, NARROW, size=(n, 2)), np.ones(n)]))
        turn, center = rotation(0.1 * rng.normal(size=3)), unit(np.array([1.0, 0.3, 0.3]) * rng.normal(size=3))
    points = ray * depth[:, None]
    second = unit(points - center) @ turn.T
    outlier = np.zeros(n, dtype=np.bool_)
    outlier[rng.permutation(n)[: round(outliers * n)]] = True
    second[outlier] = (
        second[rng.integers(0, n, outlier.sum())] if kind == "narrow" else unit(rng.normal(size=(outlier.sum(), 3)))
    )
    first, second = (unit(b + noise_rad * _tangent(rng.normal(size=(n, 3)), b)) for b in (ray, second))
    return Pair(first, second, turn, center, outlier)


KINDS = ("general", "forward", "small parallax", "narrow")


def _tangent(vectors: Float, at: Float) -> Float:
    return np.asarray(vectors - (vectors * at).sum(axis=1, keepdims=True) * at)


Solver = Callable[[Pair, float, int], Pose | None]


def ours(pair: Pair, _noise_rad: float, seed: int) -> Pose | None:
    found = pp.relative_pose(pair.first, pair.second, pp.TwoViewOptions(seed=seed))
    if np.isnan(found.direction).any():
        return None
    return Pose(found.second_from_first, found.direction)


def peers() -> dict[str, Solver]:
    """Give the peer's two ways the form of :func:`ours`."""
    pycolmap: Any = load("pycolmap")
    camera = pycolmap.Camera(model="EQUIRECTANGULAR", width=WIDTH, height=HEIGHT, params=[WIDTH, HEIGHT])
    per_rad = WIDTH / (2.0 * np.pi)

    def pixels(pair: Pair) -> tuple[Float, Float]:
        first, second = (equirectangular_from_bearings(b, WIDTH, HEIGHT) for b in (pair.first, pair.second))
        return first, second

    def answer(cam2_from_cam1: Any) -> Pose:
        turn = cam2_from_cam1.rotation.matrix()
        return Pose(turn, unit(-turn.T @ cam2_from_cam1.translation))

    def two_view_geometry(pair: Pair, noise_rad: float, seed: int) -> Pose | None:
        options = pycolmap.TwoViewGeometryOptions()
        options.compute_relative_pose = True
        options.ransac.max_error = 4.0 * noise_rad * per_rad
        options.ransac.random_seed = seed
        first, second = pixels(pair)
        index = np.arange(len(first), dtype=np.uint32)
        found = pycolmap.estimate_calibrated_two_view_geometry(
            camera, first, camera, second, np.column_stack([index, index]), options
        )
        if found.cam2_from_cam1 is None or not np.linalg.norm(found.cam2_from_cam1.translation) > 0:
            return None
        return answer(found.cam2_from_cam1)

    def relative_pose(pair: Pair, noise_rad: float, seed: int) -> Pose | None:
        options = pycolmap.RANSACOptions()
        options.max_error = 4.0 * noise_rad * per_rad
        options.random_seed = seed
        first, second = pixels(pair)
        found = pycolmap.estimate_relative_pose(camera, first, camera, second, options)
        if found is None:
            return None
        refined = pycolmap.refine_relative_pose(
            found["cam2_from_cam1"], camera, first, camera, second, found["inlier_mask"]
        )
        return answer((refined or found)["cam2_from_cam1"])

    return {"pycolmap geometry": two_view_geometry, "pycolmap pose": relative_pose}


def errors_deg(pair: Pair, pose: Pose | None) -> tuple[float, float]:
    """Angles of rotation and direction to the truth; 180 where there is no answer."""
    if pose is None:
        return 180.0, 180.0
    chord = np.linalg.norm(pose.second_from_first - pair.second_from_first) / np.sqrt(8.0)
    cosine = float(np.clip(pose.direction @ pair.direction, -1.0, 1.0))
    sine = float(np.linalg.norm(np.cross(pose.direction, pair.direction)))
    return float(np.degrees(2.0 * np.arcsin(min(chord, 1.0)))), float(np.degrees(np.arctan2(sine, cosine)))


def cases() -> Iterator[tuple[str, int, float, float]]:
    for kind in KINDS:
        for n, noise_deg, outliers in (
            (50, 0.1, 0.0),
            (100, 0.1, 0.2),
            (200, 0.05, 0.5),
            (200, 0.2, 0.3),
            (500, 0.1, 0.3),
        ):
            yield kind, n, noise_deg, outliers


def synthetic(repeats: int) -> None:
    solvers: dict[str, Solver] = {"panopath": ours, **peers()}
    print(f"medians of {repeats} pairs; lost: more than 5 degrees off, or no answer")
    print("pair               n noise false  solver              rotation direction  lost      ms")
    for kind, n, noise_deg, outliers in cases():
        noise_rad = float(np.radians(noise_deg))
        pairs = [simulate(kind, n, noise_rad, outliers, seed) for seed in range(repeats)]
        for name, solver in solvers.items():
            solver(pairs[0], noise_rad, 0)
            errors, seconds = [], []
            for seed, pair in enumerate(pairs):
                start = time.perf_counter()
                pose = solver(pair, noise_rad, seed)
                seconds.append(time.perf_counter() - start)
                errors.append(errors_deg(pair, pose))
            turn, direction = np.median(errors, axis=0)
            lost = sum(max(e) > 5.0 for e in errors)
            print(
                f"{kind:15} {n:4d} {noise_deg:5.2f} {outliers:5.1f}  {name:18} {turn:9.4f} {direction:9.3f} {lost:5d} "
                f"{1e3 * np.median(seconds):7.2f}"
            )


def real() -> None:
    """Consecutive panoramas of a walk: matches of SIFT, agreement of the two programs, and time."""
    pycolmap: Any = load("pycolmap")
    folder = DATA / "kerry_park" / "equirectangular"
    if not folder.exists():
        print("../shared/data/kerry_park is absent")
        return
    pillow: Any = load("PIL.Image")
    features = []
    with warnings.catch_warnings():
        # the class that replaces it takes images of its own kind only
        warnings.simplefilter("ignore", DeprecationWarning)
        sift = pycolmap.Sift(pycolmap.FeatureExtractionOptions(), pycolmap.Device.cpu)
    for path in sorted(folder.glob("*.jpg")):
        image = np.asarray(pillow.open(path).convert("L"))
        keypoints, descriptors = sift.extract(image)
        bearing = bearings_from_equirectangular(keypoints[:, :2].astype(np.float64), image.shape[1], image.shape[0])
        features.append((bearing, descriptors.astype(np.float32)))
    theirs = peers()["pycolmap pose"]
    print("pair     matches status          true  sigma      ms pycolmap ms    turn direction")
    for k, ((a, da), (b, db)) in enumerate(itertools.pairwise(features)):
        i, j = _mutual(da, db)
        pair = Pair(a[i], b[j], np.eye(3), np.array([0.0, 0.0, 1.0]), np.zeros(len(i), dtype=np.bool_))
        start = time.perf_counter()
        found = pp.relative_pose(pair.first, pair.second)
        middle = time.perf_counter()
        other = theirs(pair, float(np.radians(0.1)), 0)
        end = time.perf_counter()
        truth = Pair(pair.first, pair.second, found.second_from_first, found.direction, pair.outlier)
        turn, direction = errors_deg(truth, other) if found.status == "general" else (np.nan, np.nan)
        print(
            f"{k:3d}-{k + 1:<4d} {len(i):7d} {found.status:14} {found.n_inliers:5d} {np.degrees(found.sigma_rad):6.3f} "
            f"{1e3 * (middle - start):7.2f} {1e3 * (end - middle):11.2f} {turn:7.3f} {direction:9.3f}"
        )


def _mutual(a: Float, b: Float) -> tuple[Any, Any]:
    """Rows that are each other's nearest and clearly nearer than the second."""
    similarity = (a / np.linalg.norm(a, axis=1, keepdims=True)) @ (b / np.linalg.norm(b, axis=1, keepdims=True)).T
    best = similarity.argmax(axis=1)
    back = similarity.argmax(axis=0)
    two = np.sort(similarity, axis=1)[:, -2:]
    angle = np.arccos(np.clip(two, -1.0, 1.0))
    keep = (back[best] == np.arange(len(a))) & (angle[:, 1] < 0.85 * angle[:, 0])
    i = np.flatnonzero(keep)
    return i, best[i]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=30)
    parser.add_argument("--real", action="store_true", help="the walk in ../shared/data/kerry_park instead")
    arguments = parser.parse_args()
    if arguments.real:
        real()
    else:
        synthetic(arguments.repeats)


if __name__ == "__main__":
    main()
