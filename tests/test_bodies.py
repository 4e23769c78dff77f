"""Rigid bodies of many tracks, and steps that know only rest where some tracks move."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.bodies import grouped
from panopath.movers import at_rest, resting
from panopath.paths import Paths

SIGMA_RAD = np.radians(0.02)


@pytest.fixture(scope="module")
def world() -> pp.SyntheticWorld:
    return pp.simulate(
        "street", n_views=60, n_points=1200, seed=3, noise_rad=SIGMA_RAD, mover_fraction=0.3, n_bodies=12, wobble_m=0.3
    )


@pytest.fixture(scope="module")
def scene(world: pp.SyntheticWorld) -> pp.Scene:
    return pp.solve_positions(world.tracks, motion=pp.Motion(group=True))


def paths_of(scene: pp.Scene) -> Paths:
    assert scene.paths is not None
    return scene.paths


def pair_scores(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Share of the pairs found that are right, and of the right ones that were found."""
    together = (found[:, None] == found[None, :]) & (found >= 0)[:, None]
    true = truth[:, None] == truth[None, :]
    upper = np.triu(np.ones_like(true), 1)
    both = (together & true & upper).sum()
    return both / max((together & upper).sum(), 1), both / max((true & upper).sum(), 1)


def test_tracks_of_a_car_are_one_body(world: pp.SyntheticWorld, scene: pp.Scene) -> None:
    paths = paths_of(scene)
    moving = np.flatnonzero(paths.moving & (world.body >= 0))
    precision, recall = pair_scores(paths.body[moving], world.body[moving])
    assert precision > 0.97
    assert recall > 0.7
    assert (paths.body[~paths.moving] == -1).all()
    sizes = np.bincount(paths.body[paths.body >= 0])
    assert (sizes >= 2).all()


def exact(starts: np.ndarray, velocities: np.ndarray, deviation: float = 1e-3) -> pp.Scene:
    """A camera that sways, and tracks that go straight, known as they are with a small deviation."""
    n, n_views = len(starts), 20
    time_s = np.linspace(0.0, 10.0, n_views)
    centers = np.column_stack((0.3 * time_s, np.sin(time_s), np.cos(1.3 * time_s)))
    places = starts[:, None] + time_s[:, None] * velocities[:, None]
    track, view = (index.ravel() for index in np.indices(places.shape[:2]))
    ray = places[track, view] - centers[view]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    tracks = pp.Tracks.from_arrays(view, track, ray, time_s=time_s)
    scene = pp.solve_positions(tracks, motion=pp.Motion(default=pp.Taylor(1)))
    paths = Paths(
        models=(pp.Taylor(1, 0.0, 1.0),) * n,
        starts=np.arange(0, 2 * n + 1, 2),
        coefficients=np.stack((starts, velocities), axis=1).reshape(-1, 3),
        covariances=tuple(deviation**2 * np.eye(6) for _ in range(n)),
        seen_s=np.tile((0.0, 10.0), (n, 1)),
        verdicts=(pp.PathVerdict.MOVING,) * n,
        hidden_by=np.full(n, -1),
        body=np.full(n, -1),
    )
    return replace(
        scene,
        centers=centers,
        points=places[:, n_views // 2],
        view_component=np.zeros(n_views, dtype=np.int32),
        track_component=np.zeros(n, dtype=np.int32),
        paths=paths,
    )


def test_two_cars_and_a_walker() -> None:
    """Two cars side by side at different speeds, a walker between them: three motions, however near."""
    car = np.array([[10.0, 0.0, 0.0], [11.0, 0.5, 0.3], [10.5, -0.4, 0.6]])
    starts = np.concatenate((car, car + np.array((0.0, 1.5, 0.0)), [[10.2, 0.7, 0.0]]))
    velocities = np.repeat([[1.0, 0.2, 0.0], [1.1, 0.2, 0.0], [0.1, 0.9, 0.0]], [3, 3, 1], axis=0)
    scene = exact(starts, velocities)
    assert grouped(scene).body.tolist() == [0, 0, 0, 1, 1, 1, -1]
    # in another order the same bodies, numbered by their first tracks
    order = np.array([6, 3, 0, 1, 4, 5, 2])
    assert grouped(exact(starts[order], velocities[order])).body.tolist() == [-1, 0, 1, 1, 0, 0, 1]


def test_a_crowd_is_no_body() -> None:
    """Each one goes as its neighbours do, nearly; those at the ends do not go alike."""
    n = 30
    starts = np.column_stack((10.0 + 0.5 * np.arange(n), np.zeros(n), np.zeros(n)))
    # along the line: across it a line that turns would be a body
    velocities = np.column_stack((1.0 + 0.0008 * np.arange(n), np.zeros(n), np.zeros(n)))
    body = grouped(exact(starts, velocities)).body
    _, counts = np.unique(body[body >= 0], return_counts=True)
    assert counts.max() < n // 2


def test_what_is_not_known_well_is_left_alone() -> None:
    starts = np.array([[10.0, 0.0, 0.0], [10.5, 0.0, 0.0]])
    velocities = np.tile((1.0, 0.0, 0.0), (2, 1))
    assert grouped(exact(starts, velocities)).body.tolist() == [0, 0]
    assert grouped(exact(starts, velocities, deviation=1.0)).body.tolist() == [-1, -1]
    far = starts + np.array([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    assert grouped(exact(far, velocities)).body.tolist() == [-1, -1]
    scene = exact(starts, velocities)
    bare = replace(scene, paths=replace(paths_of(scene), covariances=None))
    assert grouped(bare).body.tolist() == [-1, -1]
    timeless = replace(scene, tracks=None)
    assert grouped(timeless).body.tolist() == [-1, -1]


def test_movers_never_bend_cameras_of_steps_that_know_only_rest(world: pp.SyntheticWorld, scene: pp.Scene) -> None:
    still = resting(scene)
    rows = still[world.tracks.track]
    fewer = pp.Tracks.from_arrays(
        world.tracks.view[rows],
        world.tracks.track[rows],
        world.tracks.bearing[rows],
        n_views=world.tracks.n_views,
        n_tracks=world.tracks.n_tracks,
        time_s=world.time_s,
    )
    without = replace(at_rest(scene), tracks=fewer, inlier=scene.inlier[rows], residual_rad=scene.residual_rad[rows])
    refined, alone = pp.refine(world.tracks, scene), pp.refine(fewer, without)
    assert refined.paths is None
    np.testing.assert_array_equal(refined.centers, alone.centers)
    assert not refined.inlier[~rows].any()
    assert np.isnan(refined.points[~still]).all()
    for name in ("cameras", "points"):
        found = getattr(pp.scene_covariance(world.tracks, scene), name)
        np.testing.assert_array_equal(found, getattr(pp.scene_covariance(fewer, without), name))
    np.testing.assert_array_equal(
        pp.position_covariance(world.tracks, scene), pp.position_covariance(fewer, without, inlier=without.inlier)
    )
    given = (scene.centers, without.points)
    np.testing.assert_array_equal(
        pp.fit_rotations(world.tracks, scene), pp.fit_rotations(world.tracks, given, scene.cam_from_world)
    )
    certificate = pp.certify(world.tracks, scene)
    expected = pp.certify(fewer, without)
    assert certificate.sentence() == expected.sentence()
    np.testing.assert_array_equal(certificate.track_component, expected.track_component)
    assert certificate.consistency == pp.check_consistency(fewer, without)
    assert certificate.verdict is pp.Verdict.DETERMINED


def test_evaluate_compares_along_paths(world: pp.SyntheticWorld, scene: pp.Scene) -> None:
    found = pp.evaluate(scene, world, "translation_scale")
    moving = paths_of(scene).moving & (world.body >= 0)
    track = int(np.flatnonzero(moving)[0])
    fit = found.alignments[0]
    first, last = paths_of(scene).seen_s[track]
    now = world.time_s[(world.time_s >= first) & (world.time_s <= last)]
    place = fit.scale * paths_of(scene).position(track, now) + fit.shift
    true = world.paths.position(track, now, outside=True)
    expected = np.sqrt(((place - true) ** 2).sum(axis=1).mean())
    assert found.point_error[track] == pytest.approx(expected, rel=1e-9)
    # where the truth knows no paths, points are what is compared
    bare = pp.evaluate(scene, (world.centers, world.points), "translation_scale")
    assert bare.camera_rms == found.camera_rms
    assert bare.point_error[track] != found.point_error[track]
    short = replace(world.tracks, time_s=None)
    assert np.isfinite(pp.evaluate(replace(scene, tracks=short), world).point_error[track])


def test_orientations_half_a_degree_off_are_refined_with_paths() -> None:
    world: dict[str, Any] = {
        "n_views": 60,
        "n_points": 1200,
        "seed": 5,
        "noise_rad": SIGMA_RAD,
        "mover_fraction": 0.2,
        "n_bodies": 12,
        "wobble_m": 0.3,
        "orientations": "random",
    }
    true = pp.simulate("street", **world)
    off = pp.simulate("street", **world, orientation_error_rad=np.radians(0.5))
    held = pp.solve_positions(off.tracks, off.cam_from_world, motion=pp.Motion())
    found = pp.solve_positions(off.tracks, off.cam_from_world, motion=pp.Motion(refine_orientations=True))
    error = pp.evaluate(found, off).camera_rms
    assert error < 0.1 * pp.evaluate(held, off).camera_rms
    assert (paths_of(found).moving == off.moving).mean() > 0.99
    # up to the one turn that bearings leave free
    fit = pp.evaluate(found, off).alignments[0].world_from_scene
    turn = found.cam_from_world @ fit.T @ true.cam_from_world.transpose(0, 2, 1)
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0))
    assert np.median(angle) < np.radians(0.05)
