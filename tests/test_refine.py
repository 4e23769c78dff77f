"""The typed wrapper of refinement and its priors: what it answers, what it refuses, and that nothing makes it fail."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import panopath as pp
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from panopath.formats.structure import known_scene
from panopath.priors import DirectionPriors, PositionPriors, Priors, Rig, RotationPriors


def truth(world: pp.SyntheticWorld) -> pp.Scene:
    return known_scene(world.tracks, world.cam_from_world, world.centers, world.points)


def test_a_turned_room_is_refined(turned: pp.SyntheticWorld) -> None:
    scene = pp.refine(turned.tracks, truth(turned))
    assert scene.summary.status is pp.Status.CONVERGED
    assert scene.summary.sigma_rad == pytest.approx(1e-3, rel=0.1)
    assert not scene.centers.flags.writeable
    assert not scene.cam_from_world.flags.writeable


def test_headings_are_refined(planar: pp.SyntheticWorld) -> None:
    scene = pp.refine(planar.tracks, truth(planar))
    assert scene.cam_from_world.shape == (6,)
    assert scene.summary.status is pp.Status.CONVERGED
    off = np.angle(np.exp(1j * (scene.cam_from_world - planar.cam_from_world)))
    assert np.abs(off).max() < 0.02


def test_the_answer_does_not_depend_on_threads(turned: pp.SyntheticWorld) -> None:
    one, two = (pp.refine(turned.tracks, truth(turned), pp.RefineOptions(threads=n)) for n in (1, 2))
    for name in ("centers", "points", "cam_from_world", "residual_rad"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes(), name


def test_masks_hold_what_they_name(turned: pp.SyntheticWorld) -> None:
    start = truth(turned)
    mask = np.arange(12) % 2 == 0
    options = pp.RefineOptions(hold_rotations=mask, hold_centers=~mask)
    scene = pp.refine(turned.tracks, start, options)
    np.testing.assert_array_equal(scene.cam_from_world[mask], start.cam_from_world[mask])
    np.testing.assert_array_equal(scene.centers[~mask], start.centers[~mask])
    assert (scene.cam_from_world[~mask] != start.cam_from_world[~mask]).any(axis=(1, 2)).all()
    scene = pp.refine(turned.tracks, start, pp.RefineOptions(hold_points=True))
    np.testing.assert_array_equal(scene.points, start.points)


def test_known_positions_give_the_frame(turned: pp.SyntheticWorld) -> None:
    elsewhere = known_scene(
        turned.tracks,
        turned.cam_from_world,
        3.0 * turned.centers + [5.0, 0.0, 1.0],
        3.0 * turned.points + [5.0, 0.0, 1.0],
    )
    priors = Priors(positions=PositionPriors.of(np.arange(12), turned.centers, sigma=1e-3))
    scene = pp.refine(turned.tracks, elsewhere, pp.RefineOptions(priors=priors))
    assert np.linalg.norm(scene.centers - turned.centers, axis=1).max() < 0.01


def test_gravity_is_the_vertical(turned: pp.SyntheticWorld) -> None:
    up = turned.cam_from_world[:, :, 2]
    priors = Priors(directions=DirectionPriors.gravity(np.arange(12), up, 1e-3))
    scene = pp.refine(turned.tracks, truth(turned), pp.RefineOptions(priors=priors))
    found = np.einsum("nij,ni->nj", scene.cam_from_world, up)
    assert np.linalg.norm(found - [0.0, 0.0, 1.0], axis=1).max() < 0.01


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_rig_turns_bearings_to_the_view(dimension: Literal[2, 3]) -> None:
    world = pp.simulate("box", n_views=5, n_points=20, dimension=dimension, orientations="random")
    n = len(world.tracks)
    sensor = np.arange(n) % 2
    other = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    if dimension == 2:
        rig = Rig.of(sensor, [0.0, 0.5], np.zeros((2, 2)))
        angle = -0.5  # a sensor turned by a heading of 0.5 sees what lies ahead of the rig turned back by it
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    else:
        rig = Rig.of(sensor, [np.eye(3), other], np.zeros((2, 3)))
        turn = other
    in_sensor = np.where(sensor[:, None] == 1, world.tracks.bearing @ turn.T, world.tracks.bearing)
    np.testing.assert_allclose(rig.to_view(in_sensor), world.tracks.bearing, atol=1e-15)
    scene = pp.refine(world.tracks, truth(world), rig=rig)
    assert np.nanmax(scene.residual_rad) < 1e-9


E = np.eye(3)
Z = [[0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RotationPriors.of([0.5], [E], 0.1), r"view has type float64 and shape \(1,\), expected"),
        (lambda: RotationPriors.of([[0]], [E], 0.1), r"view has type int64 and shape \(1, 1\)"),
        (lambda: RotationPriors.of([-1], [E], 0.1), "view holds -1, expected 0 or more"),
        (lambda: RotationPriors.of([2**32], [E], 0.1), "view holds 4294967296, expected at most"),
        (lambda: RotationPriors.of([0], [2.0 * E], 0.1), "cam_from_world"),
        (lambda: RotationPriors.of([0, 1], [E], 0.1), "cam_from_world"),
        (lambda: RotationPriors.of([0], [E]), "expected either sigma_rad or covariance"),
        (lambda: RotationPriors.of([0], [E], 0.1, [E]), "expected either sigma_rad or covariance"),
        (lambda: RotationPriors.of([0], [E], [0.1, 0.2]), r"sigma_rad has shape \(2,\), expected one number or \(1,\)"),
        (lambda: RotationPriors.of([0], [E], -0.1), r"sigma_rad\[0\] is -0.1, expected a positive number"),
        (lambda: RotationPriors.of([0], [E], covariance=[np.eye(2)]), r"covariance has shape \(1, 2, 2\), expected"),
        (lambda: RotationPriors.of([0], [0.1], np.nan), r"sigma_rad\[0\] is nan"),
        (lambda: DirectionPriors.of([0], [[0.0, 0.0, 2.0]], Z, 0.1), r"bearing\[0\] is not a unit vector"),
        (lambda: DirectionPriors.of([0], Z, [[0.0, np.nan, 1.0]], 0.1), r"direction\[0\] is not a unit vector"),
        (lambda: DirectionPriors.of([0, 1], Z, Z, 0.1), r"bearing has shape \(1, 3\), expected \(2, 2\) or \(2, 3\)"),
        (lambda: DirectionPriors.of([0], Z, [0.0, 1.0], 0.1), r"direction has shape \(2,\), expected \(3,\)"),
        (lambda: DirectionPriors.of([0], Z, 1.0, 0.1), r"direction has shape \(\), expected \(3,\)"),
        (lambda: DirectionPriors.of([0], Z, Z, 0.0), r"sigma_rad\[0\] is 0.0"),
        (lambda: DirectionPriors.gravity([0], [[1.0, 0.0]], 0.1), "direction has shape"),
        (lambda: PositionPriors.of([0], [0.0, 0.0, 0.0], 0.1), r"center has shape \(3,\), expected \(1, 2\)"),
        (lambda: PositionPriors.of([0], [[0.0, np.inf, 0.0]], 0.1), r"center\[0\] is not finite"),
        (lambda: PositionPriors.of([0], Z, [[0.1]]), "sigma has shape"),
        (lambda: Priors(rotations=E), "rotations is a ndarray, expected RotationPriors"),  # type: ignore[arg-type]
        (lambda: Rig.of([0], [E], [[np.nan, 0.0, 0.0]]), "center has shape"),
        (lambda: Rig.of([1], [E], Z), "sensor holds 1, but there are 1 sensors"),
        (lambda: Rig.of([-1], [E], Z), "sensor holds -1, expected 0 or more"),
        (lambda: pp.RefineOptions(priors=None), "priors is a NoneType, expected Priors"),  # type: ignore[arg-type]
        (lambda: pp.RefineOptions(huber_sigmas=0.0), "huber_sigmas is 0.0, expected more than 0"),
        (lambda: pp.RefineOptions(huber_sigmas=np.nan), "huber_sigmas is nan"),
        (lambda: pp.RefineOptions(linear_solver="fast"), "linear_solver is 'fast', expected one of"),  # type: ignore[arg-type]
        (lambda: pp.RefineOptions(max_iterations=0), "max_iterations is 0, expected a whole number"),
        (lambda: pp.RefineOptions(threads=1.5), "threads is 1.5, expected a whole number"),  # type: ignore[arg-type]
    ],
)
def test_options_and_priors_that_cannot_be_used_are_named(make: Callable[[], object], message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        make()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"hold_rotations": [True]},
            r"hold_rotations has type bool and shape \(1,\), expected a bool or \(12,\) bools",
        ),
        ({"hold_points": 1}, "hold_points has type int64"),
        ({"priors": Priors(positions=PositionPriors.of([12], Z, 0.1))}, "position prior 0: names the view 12"),
        ({"priors": Priors(positions=PositionPriors.of([0], [[0.0, 0.0]], 0.1))}, "position_priors have 2 coordinates"),
        (
            {"priors": Priors(rotations=RotationPriors.of([0], [E], covariance=[-E]))},
            "rotation prior 0: its covariance is not positive definite",
        ),
        (
            {"priors": Priors(rotations=RotationPriors.of([0], [0.5], 0.1))},
            "rotation_priors have 2 coordinates, but the bearings have 3",
        ),
    ],
)
def test_options_that_do_not_fit_are_named(turned: pp.SyntheticWorld, options: dict[str, Any], message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        pp.refine(turned.tracks, truth(turned), pp.RefineOptions(**options))


def test_arguments_that_do_not_fit_are_named(turned: pp.SyntheticWorld, street: pp.SyntheticWorld) -> None:
    start = truth(turned)
    wrong: Any = "tracks"
    with pytest.raises(pp.InputError, match="tracks is a str, expected Tracks"):
        pp.refine(wrong, start)
    with pytest.raises(pp.InputError, match="scene is a str, expected a Scene"):
        pp.refine(turned.tracks, wrong)
    with pytest.raises(pp.InputError, match="options is a str, expected RefineOptions"):
        pp.refine(turned.tracks, start, wrong)
    with pytest.raises(pp.InputError, match="is not a scene of"):
        pp.refine(street.tracks, start)
    with pytest.raises(pp.InputError, match=r"rig.sensor has 1 entries, but there are"):
        pp.refine(turned.tracks, start, rig=Rig.of([0], [E], Z))
    flat = Rig.of(np.zeros(len(turned.tracks), dtype=int), [0.0], [[0.0, 0.0]])
    with pytest.raises(pp.InputError, match="the rig has centres of 2 coordinates, but the bearings have 3"):
        pp.refine(turned.tracks, start, rig=flat)


@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    seed=st.integers(0, 10_000),
    d=st.sampled_from([2, 3]),
    n_views=st.integers(1, 8),
    n_tracks=st.integers(1, 25),
    share=st.floats(0.1, 1.0),
    garbage=st.floats(0.0, 0.6),
    reject=st.booleans(),
    held=st.sampled_from(["none", "rotations", "centers", "points", "all"]),
)
def test_whatever_comes_in_rows_are_known_or_not(  # noqa: PLR0917 (drawn by hypothesis)
    seed: int, d: int, n_views: int, n_tracks: int, share: float, garbage: float, reject: bool, held: str
) -> None:
    rng = np.random.default_rng(seed)
    centers, points = rng.normal(size=(n_views, d)), 4.0 * rng.normal(size=(n_tracks, d))
    seen = rng.random((n_tracks, n_views)) < share
    seen[0, 0] = True
    track, view = (ids.astype(np.int32) for ids in np.nonzero(seen))
    bearing = points[track] - centers[view] + 1e-3 * rng.normal(size=(len(view), d))
    wrong = rng.random(len(view)) < garbage
    bearing[wrong] = rng.normal(size=(int(wrong.sum()), d))
    bearing /= np.linalg.norm(bearing, axis=1, keepdims=True)
    tracks = pp.Tracks.from_arrays(view, track, bearing, n_views=n_views, n_tracks=n_tracks)
    cam_from_world = np.zeros(n_views) if d == 2 else np.tile(np.eye(3), (n_views, 1, 1))
    off = 10.0 ** rng.uniform(-3, 0)
    start_centers, start_points = centers + off * rng.normal(size=centers.shape), points.copy()
    start_points[rng.random(n_tracks) < 0.2] = np.nan
    start_centers[rng.random(n_views) < 0.1] = np.nan
    start = known_scene(tracks, cam_from_world, start_centers, start_points)
    holds: dict[str, Any] = {f"hold_{k}": held in (k, "all") for k in ("rotations", "centers", "points")}
    scene = pp.refine(tracks, start, pp.RefineOptions(reject_outliers=reject, **holds))
    np.testing.assert_array_equal(np.isfinite(scene.centers).all(axis=1), scene.view_component >= 0)
    np.testing.assert_array_equal(np.isnan(scene.centers).all(axis=1), scene.view_component < 0)
    np.testing.assert_array_equal(np.isfinite(scene.points).all(axis=1), scene.track_component >= 0)
    np.testing.assert_array_equal(np.isnan(scene.points).all(axis=1), scene.track_component < 0)
    assert np.isfinite(scene.cam_from_world).all()
    known = (scene.view_component[view] >= 0) & (scene.track_component[track] >= 0)
    np.testing.assert_array_equal(np.isfinite(scene.residual_rad), known)
    assert not (scene.inlier & ~known).any()
