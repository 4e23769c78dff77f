"""Bundle adjustment against COLMAP's: ``python -m benchmarks.refinement [--scale S] [--repeats R]``.

Both refine the same start, rotations free: positions solved with orientations that err by 0.2 degrees. COLMAP's
adjustment is given the start as a model of one EQUIRECTANGULAR camera and its default options. Both answers are judged
by the same angles, on the sphere.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from math import radians
from pathlib import Path
from statistics import median

import numpy as np
import panopath as pp
from panopath.formats.colmap import write_colmap
from panopath.model import Float, Scene
from panopath.synthetic import SyntheticWorld

from benchmarks.cases import NOISE_DEG
from benchmarks.optional import load
from benchmarks.scoring import rms

#: Width of the panoramas that COLMAP's pixels are counted in.
IMAGE_WIDTH = 8192
ORIENTATION_ERROR_DEG = 0.2


@dataclass(frozen=True)
class Case:
    """A world to refine, and what is promised of it."""

    name: str
    world: str
    n_views: int
    n_points: int
    min_speedup: float


CASES = (
    Case("street 1000", "street", 1000, 100_000, 8.0),
    Case("room 1000", "room", 1000, 100_000, 3.0),
)


@dataclass(frozen=True)
class Refined:
    """An answer, judged."""

    seconds: float
    #: Root mean square angle between bearing and prediction, radians, all observations.
    residual_rms: float
    #: Of the centres, after a similarity.
    camera_rms: float
    #: Covariances of all cameras and points, apart.
    covariance_seconds: float = float("nan")


def street_or_room(case: Case, scale: float, seed: int) -> tuple[SyntheticWorld, Scene]:
    """Make the world, and the start: positions with orientations that err."""
    world = pp.simulate(
        case.world,
        n_views=max(20, round(case.n_views * scale)),
        n_points=max(100, round(case.n_points * scale)),
        noise_rad=radians(NOISE_DEG),
        orientations="random",
        orientation_error_rad=radians(ORIENTATION_ERROR_DEG),
        seed=seed,
    )
    return world, pp.solve_positions(world.tracks, world.cam_from_world)


def residual_rms(world: SyntheticWorld, cam_from_world: Float, centers: Float, points: Float) -> float:
    """Root mean square angle between bearings and predictions."""
    tracks = world.tracks
    seen = points[tracks.track] - centers[tracks.view]
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    chord = np.linalg.norm(np.einsum("nij,nj->ni", cam_from_world[tracks.view], seen) - tracks.bearing, axis=1)
    return rms(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))


def ours(world: SyntheticWorld, start: Scene) -> Refined:
    """Refine with panopath."""
    began = time.perf_counter()
    scene = pp.refine(world.tracks, start)
    seconds = time.perf_counter() - began
    began = time.perf_counter()
    pp.scene_covariance(world.tracks, scene)
    covariance_seconds = time.perf_counter() - began
    residual = residual_rms(world, scene.cam_from_world, scene.centers, scene.points)
    return Refined(seconds, residual, pp.evaluate(scene, world).camera_rms, covariance_seconds)


def colmap(world: SyntheticWorld, start: Scene) -> Refined:
    """Refine with pycolmap; time is that of its adjustment alone."""
    pycolmap = load("pycolmap")
    pycolmap.logging.minloglevel = 2
    with tempfile.TemporaryDirectory() as folder:
        write_colmap(start, world.tracks, Path(folder), width=IMAGE_WIDTH)
        model = pycolmap.Reconstruction(folder)
    began = time.perf_counter()
    pycolmap.bundle_adjustment(model)
    seconds = time.perf_counter() - began
    by_name = {image.name: image for image in model.images.values()}
    images = [by_name[str(name)] for name in world.tracks.view_labels()]
    poses = [image.cam_from_world() for image in images]
    cam_from_world = np.array([pose.rotation.matrix() for pose in poses])
    centers = np.array([image.projection_center() for image in images])
    points = np.full((world.tracks.n_tracks, 3), np.nan)
    for number, point in model.points3D.items():
        points[number - 1] = point.xyz
    residual = residual_rms(world, cam_from_world, centers, points)
    error = pp.evaluate(_scene_like(start, cam_from_world, centers, points), world).camera_rms
    return Refined(seconds, residual, error)


def _scene_like(start: Scene, cam_from_world: Float, centers: Float, points: Float) -> Scene:
    return Scene(
        centers,
        points,
        start.view_component,
        start.track_component,
        start.inlier,
        start.residual_rad,
        cam_from_world,
        start.summary,
    )


def measure(case: Case, scale: float, repeats: int) -> tuple[Refined, Refined, float]:
    """Run both in turn; the answers, and the median of the ratios of their times."""
    world, start = street_or_room(case, scale, seed=0)
    pairs = [(ours(world, start), colmap(world, start)) for _ in range(repeats)]
    return *pairs[0], median(theirs.seconds / own.seconds for own, theirs in pairs)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--repeats", type=int, default=1)
    arguments = parser.parse_args()
    print(
        "case           ours s  COLMAP s  ratio  residual rms (mrad) ours / COLMAP  camera rms ours / COLMAP (m)"
        "  covariance s"
    )
    for case in CASES:
        own, theirs, ratio = measure(case, arguments.scale, arguments.repeats)
        print(
            f"{case.name:<13} {own.seconds:>7.2f} {theirs.seconds:>9.2f} {ratio:>5.1f}x"
            f"  {1e3 * own.residual_rms:>12.5f} / {1e3 * theirs.residual_rms:.5f}"
            f"  {own.camera_rms:>18.5f} / {theirs.camera_rms:.5f}  {own.covariance_seconds:>18.2f}"
            f"  >= {case.min_speedup:g}x: {'met' if ratio >= case.min_speedup else 'MISSED'}",
            flush=True,
        )


if __name__ == "__main__":
    main()
