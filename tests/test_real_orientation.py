"""Measured data with orientations unknown; skipped where ``../shared/data`` or pycolmap is absent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import panopath as pp
import pytest
from panopath.formats.structure import known_scene
from panopath.pipeline import reconstruct_tracks
from panopath.planar import complete_planar, resect_views

from benchmarks.planar_sets import read_mrclam
from benchmarks.real_data import planar_tracks
from benchmarks.real_orientation import aligned, found_headings, perturbed, planar_fit
from benchmarks.scoring import distances, rms

Find = Callable[[str], Path]


def test_ladybug_is_the_same_from_nothing_and_from_rotations_that_are_off(real_data: Find) -> None:
    problem = pp.read_problem(real_data("bal_ladybug49") / "problem-49-7776-pre.txt")
    assert problem.cam_from_world is not None
    unknown = reconstruct_tracks(problem.tracks)
    off = reconstruct_tracks(problem.tracks, perturbed(problem.cam_from_world, np.radians(3.0), seed=1))
    for scene in (unknown, off):
        assert scene.summary.n_solved_views == 49
        assert np.degrees(rms(scene.residual_rad[scene.inlier])) < 0.06
    size = rms(distances(off.centers, off.centers.mean(axis=0)))
    apart = distances(aligned(unknown.centers, off.centers), off.centers) / size
    assert np.median(apart) < 0.005


def test_perturbed_rotations_are_rotations() -> None:
    turned = perturbed(np.tile(np.eye(3), (500, 1, 1)), 0.05, seed=0)
    np.testing.assert_allclose(turned @ np.swapaxes(turned, 1, 2), np.tile(np.eye(3), (500, 1, 1)), atol=1e-12)
    angle = np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0))
    assert rms(angle) == pytest.approx(0.05 * np.sqrt(3.0), rel=0.1)


def test_landmark_log_without_headings(real_data: Find) -> None:
    pytest.importorskip("scipy")
    data = read_mrclam(real_data("planar_bearings") / "dataset_mrclam" / "mrclam1.mat")
    tracks = planar_tracks(data.station, data.landmark, data.bearing_rad)
    scene = found_headings(tracks)
    found = planar_fit(data, scene, 0.0)
    assert found.n_stations > 190
    assert np.nanmedian(found.station_error) < 0.1
    whole = planar_fit(data, complete_planar(tracks, scene), 0.0)
    assert whole.n_stations > 850
    assert np.nanmedian(whole.station_error) < 0.25


def test_resection_is_exact_and_takes_no_view_that_disagrees() -> None:
    world = pp.simulate("box", n_views=8, n_points=20, seed=4, dimension=2, orientations="random")
    tracks = world.tracks
    truth = known_scene(tracks, world.cam_from_world, world.centers, world.points)
    known = np.arange(8) < 5
    part = known_scene(
        tracks,
        np.where(known, world.cam_from_world, 0.0),
        np.where(known[:, None], world.centers, np.nan),
        world.points,
    )
    found = resect_views(tracks, part)
    np.testing.assert_array_equal(found.placed, ~known)
    np.testing.assert_allclose(found.center[~known], truth.centers[~known], atol=1e-9)
    turn = np.exp(1j * (found.heading_rad - world.cam_from_world))[~known]
    np.testing.assert_allclose(turn, 1.0, atol=1e-9)
    bearing = tracks.bearing.copy()
    wrong = np.flatnonzero(tracks.view == 6)[0]
    bearing[wrong] = [-bearing[wrong, 1], bearing[wrong, 0]]
    bent = pp.Tracks.from_arrays(tracks.view, tracks.track, bearing, 8, tracks.n_tracks)
    np.testing.assert_array_equal(np.flatnonzero(resect_views(bent, part).placed), [5, 7])


def test_parts_that_share_points_are_joined() -> None:
    world = pp.simulate(
        "box", n_views=12, n_points=30, seed=5, dimension=2, orientations="random", noise_rad=np.radians(0.1)
    )
    second = np.arange(12) >= 6
    # the second part in a frame of its own, with points that the first has not
    rows = ~((world.tracks.track >= 24) & ~second[world.tracks.view])
    tracks = world.tracks.select(rows)
    only_second = np.arange(30) >= 24
    scene = pp.refine(tracks, known_scene(tracks, world.cam_from_world, world.centers, world.points))
    turned = pp.refine(
        tracks,
        pp.Scene(
            centers=np.where(second[:, None], 3.0 * scene.centers @ [[0.0, 1.0], [-1.0, 0.0]], scene.centers),
            points=np.where(only_second[:, None], 3.0 * scene.points @ [[0.0, 1.0], [-1.0, 0.0]], scene.points),
            view_component=second.astype(np.int32),
            track_component=only_second.astype(np.int32),
            inlier=scene.inlier,
            residual_rad=scene.residual_rad,
            cam_from_world=scene.cam_from_world + np.where(second, 0.5 * np.pi, 0.0),
            summary=scene.summary,
            tracks=tracks,
            view_names=None,
            track_names=None,
        ),
    )
    assert turned.n_components == 2
    whole = complete_planar(tracks, turned)
    assert whole.n_components == 1
    assert pp.evaluate(whole, world, "similarity").camera_rms < 0.02


def test_panoramas_of_kerry_park_are_mapped(real_data: Find, tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    from panopath.mapping import map_database  # noqa: PLC0415

    from benchmarks import kerry  # noqa: PLC0415

    folder = real_data("kerry_park")
    few = tmp_path / "few"
    (few / kerry.PANORAMAS).mkdir(parents=True)
    for path in sorted((folder / kerry.PANORAMAS).glob("*.jpg"))[:4]:
        (few / kerry.PANORAMAS / path.name).symlink_to(path)
    database = kerry.make_panorama_database(few, tmp_path / "database.db")
    scene = map_database(pp.read_database(database)).scene
    assert scene.summary.n_solved_views == 4
    assert scene.summary.status is pp.Status.CONVERGED
    assert np.degrees(scene.summary.sigma_rad) < 0.5
