"""Shared by the tests: synthetic scenes, and the real data where it is there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import panopath as pp
import pytest
from filmed import Film
from hypothesis import settings
from panopath.formats.crops import CropOptions
from panopath.formats.structure import known_scene
from panopath.run import Reconstructed, RunOptions, reconstruct
from panopath.walk import render_walk

# property tests draw the same cases on every run: a check that fails by chance is no check
settings.register_profile("steady", derandomize=True)
settings.load_profile("steady")

REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """Path of a real data set; the test is skipped where it is absent."""

    def find(name: str) -> Path:
        path = REAL_DATA / name
        if not path.exists():
            pytest.skip(f"../shared/data/{name} is absent")
        return path

    return find


@pytest.fixture(scope="session")
def street() -> pp.SyntheticWorld:
    """A short noisy street walk with wrong bearings, world directions."""
    return pp.simulate("street", n_views=20, n_points=300, seed=3, noise_rad=1e-3, outlier_fraction=0.1)


@pytest.fixture(scope="session")
def turned() -> pp.SyntheticWorld:
    """A room seen by cameras turned at random."""
    return pp.simulate("room", n_views=12, n_points=150, seed=5, noise_rad=1e-3, orientations="random")


@pytest.fixture(scope="session")
def planar() -> pp.SyntheticWorld:
    """A planar box seen by cameras turned at random."""
    return pp.simulate("box", n_views=6, n_points=20, seed=7, dimension=2, noise_rad=1e-3, orientations="random")


def scene_of(world: pp.SyntheticWorld) -> pp.Scene:
    """The truth of a world as a scene, its tracks named and weighted, one view and one track not determined."""
    tracks = world.tracks
    named = pp.Tracks.from_arrays(
        tracks.view,
        tracks.track,
        tracks.bearing,
        sigma_rad=np.linspace(1e-3, 2e-3, len(tracks)),
        time_s=np.arange(tracks.n_views)[::-1] * 0.5,
        view_names=[f"pano é,{i}.jpg" for i in range(tracks.n_views)],
        track_names=[f't"{i}' for i in range(tracks.n_tracks)],
    )
    centers, points = world.centers.copy(), world.points.copy()
    centers[1], points[2] = np.nan, np.nan
    residuals = known_scene(named, world.cam_from_world, centers, points)
    return known_scene(
        named, world.cam_from_world, centers, points, np.isfinite(residuals.residual_rad) & ~world.outlier
    )


# walks that are filmed and reconstructed once for all tests; see filmed.py


@pytest.fixture(scope="session")
def film(tmp_path_factory: pytest.TempPathFactory) -> Film:
    """A walk of 14 m, swaying, as a video."""
    pytest.importorskip("av", reason="needs the extra video")
    pytest.importorskip("cv2", reason="needs the extra images")
    walk = render_walk(width_px=640, n_frames=40, frame_rate_hz=4.0, seed=2)
    return Film(walk, walk.write_video(tmp_path_factory.mktemp("film") / "walk.mp4"))


@pytest.fixture(scope="session")
def made(film: Film, tmp_path_factory: pytest.TempPathFactory) -> Reconstructed:
    """The undisturbed run on it, with crops."""
    out = tmp_path_factory.mktemp("made") / "out"
    return reconstruct(film.path, out, RunOptions(crops=CropOptions("cube")))
