"""Synthetic worlds through Python: contract of the arrays, errors, and the rigidity each world promises."""

from __future__ import annotations

import inspect
import re
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
import pytest
from panopath import _core
from panopath.errors import InputError
from panopath.model import Tracks
from panopath.paths import PathVerdict, Taylor
from panopath.synthetic import SyntheticWorld, WorldName, simulate

WORLDS = get_args(WorldName)
Float = npt.NDArray[np.float64]


def world_bearings(world: SyntheticWorld) -> Float:
    """Turn the observed bearings to the world frame by the returned orientations."""
    bearing, view = world.tracks.bearing, world.tracks.view
    if bearing.shape[1] == 3:
        turned: Float = np.einsum("nji,nj->ni", world.cam_from_world[view], bearing)
        return turned
    heading = world.cam_from_world[view]
    angle = np.arctan2(bearing[:, 1], bearing[:, 0]) + heading
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def nullity(world: SyntheticWorld, columns: slice = slice(None)) -> int:
    """Count the freedoms that no bearing opposes; ``columns`` projects the scene, as seen from above."""
    view, track = world.tracks.view, world.tracks.track
    ray = (world.points[track] - world.centers[view])[:, columns]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    n, d = ray.shape
    projector = np.eye(d) - ray[:, :, None] * ray[:, None, :]
    matrix = np.zeros((n, d, world.tracks.n_views + world.tracks.n_tracks, d))
    matrix[np.arange(n), :, view] = -projector
    matrix[np.arange(n), :, world.tracks.n_views + track] = projector
    values = np.linalg.svd(matrix.reshape(n * d, -1), compute_uv=False)
    assert values.size == matrix.shape[2] * d
    return int(np.sum(values < 1e-9 * values[0]))


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("orientations", ["identity", "random"])
def test_arrays_keep_the_contract_and_are_exact(name: str, orientations: Any) -> None:
    world = simulate(name, n_views=30, n_points=200, orientations=orientations)
    d = world.centers.shape[1]
    n = len(world.outlier)
    assert isinstance(world.tracks, Tracks)
    assert (world.tracks.n_views, world.tracks.n_tracks) == (30, 200)
    assert world.tracks.view.dtype == world.tracks.track.dtype == np.int32
    assert world.tracks.bearing.shape == (n, d)
    assert world.points.shape == (200, d)
    assert world.cam_from_world.shape == ((30, 3, 3) if d == 3 else (30,))
    assert not world.outlier.any()
    np.testing.assert_array_equal(world.time_s, np.arange(30.0))
    truth = world.points[world.tracks.track] - world.centers[world.tracks.view]
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    np.testing.assert_allclose(world_bearings(world), truth, atol=1e-14)


def test_planar_headings_turn_the_world_into_the_camera() -> None:
    world = simulate("room", dimension=2, n_views=20, n_points=100, orientations="random")
    assert np.ptp(world.cam_from_world) > 1.0
    assert np.abs(world.cam_from_world).max() <= np.pi
    truth = world.points[world.tracks.track] - world.centers[world.tracks.view]
    azimuth = np.arctan2(truth[:, 1], truth[:, 0])
    seen = np.arctan2(world.tracks.bearing[:, 1], world.tracks.bearing[:, 0])
    difference = azimuth - (world.cam_from_world[world.tracks.view] + seen)
    np.testing.assert_allclose(np.exp(1j * difference), 1.0, atol=1e-14)


@pytest.mark.parametrize(("n_views", "n_points", "expected"), [(100, 10_000, 82_000), (1000, 100_000, 820_000)])
def test_street_has_the_number_of_observations_of_the_benchmark(n_views: int, n_points: int, expected: int) -> None:
    world = _core.simulate("street", {"n_views": n_views, "n_points": n_points})
    assert len(world["view"]) == pytest.approx(expected, rel=0.01)


def test_room_has_the_number_of_observations_of_the_benchmark() -> None:
    world = _core.simulate("room", {"n_views": 1000, "n_points": 100_000})
    assert len(world["view"]) == pytest.approx(900_000, rel=0.01)
    # dense: a view shares tracks with a large part of the others
    seen = np.zeros((1000, 100_000), dtype=np.float32)
    seen[world["view"], world["track"]] = 1.0
    shared = (seen @ seen.T > 0).mean()
    assert 0.1 < shared < 0.6


@pytest.mark.parametrize("conic", ["ellipse", "circle", "parabola", "hyperbola"])
@pytest.mark.parametrize("size", [3, 4, 10])
def test_conics_leave_one_freedom_beyond_the_gauge(conic: Any, size: int) -> None:
    assert nullity(simulate("ellipse", n_views=size, n_points=size, conic=conic)) == 4
    assert nullity(simulate("ellipse", n_views=size, n_points=size, conic=conic, off_conic=0.1)) == 3


def test_the_cylinder_is_ambiguous_from_above_and_unique_in_space() -> None:
    world = simulate("cylinder", n_views=6, n_points=8)
    assert nullity(world, slice(0, 2)) == 4  # the gauge has 3
    assert nullity(world) == 4  # the gauge has 4
    assert nullity(simulate("cylinder", n_views=6, n_points=8, off_conic=0.1), slice(0, 2)) == 3


@pytest.mark.parametrize(("links", "beyond"), [(0, 4), (1, 3), (2, 2), (3, 1), (4, 0)])
def test_each_link_of_two_clusters_takes_one_freedom(links: int, beyond: int) -> None:
    world = simulate("weak", n_views=12, n_points=20 + links, n_links=links)
    assert nullity(world) == 4 + beyond


def test_a_chain_of_two_view_tracks_is_loose_at_every_link() -> None:
    world = simulate("weak", weak_mode="chain", n_views=6, n_points=40)
    assert nullity(world) == 3 + 5  # translation, and a scale for each of the five links


@pytest.mark.parametrize("name", ["box", "street", "room", "corridor", "line", "chain"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_ordinary_worlds_are_unique(name: str, dimension: Any) -> None:
    world = simulate(name, n_views=12, n_points=60, dimension=dimension, max_views=8)
    assert nullity(world) == dimension + 1


def test_noise_and_outliers_are_what_was_asked_for() -> None:
    world = simulate("street", n_points=5000, noise_rad=0.002, outlier_fraction=0.2, orientations="random")
    truth = world.points[world.tracks.track] - world.centers[world.tracks.view]
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    error = 2 * np.arcsin(np.linalg.norm(world_bearings(world) - truth, axis=1) / 2)
    assert world.noise_rad == 0.002
    assert np.sqrt(np.mean(error[~world.outlier] ** 2) / 2) == pytest.approx(0.002, rel=0.02)
    assert world.outlier.mean() == pytest.approx(0.2, abs=0.01)
    assert np.median(error[world.outlier]) == pytest.approx(np.pi / 2, abs=0.05)


@pytest.mark.parametrize("dimension", [2, 3])
def test_true_paths_give_every_bearing(dimension: Any) -> None:
    world = simulate(
        "street",
        n_views=60,
        n_points=400,
        mover_fraction=0.4,
        n_bodies=9,
        operator_fraction=0.1,
        dimension=dimension,
        orientations="random",
    )
    paths, tracks, seen = world.paths, world.tracks, world_bearings(world)
    assert paths is world.paths
    assert len(paths) == 400
    np.testing.assert_array_equal(paths.moving, world.moving)
    np.testing.assert_array_equal(paths.body, world.body)
    assert set(world.body.tolist()) == {-1, *range(9)}
    assert world.moving.mean() == pytest.approx(0.4, abs=0.06)
    assert {one.order for one in paths.models if isinstance(one, Taylor)} == {1, 2}
    # the camera's own are the only sightings that do not belong to a path
    np.testing.assert_array_equal(world.outlier, world.carried[tracks.track])
    for track in range(400):
        mine = tracks.track == track
        time_s = world.time_s[tracks.view[mine]]
        if world.carried[track]:
            assert paths.verdicts[track] is PathVerdict.UNDETERMINED
            assert np.isnan(paths.position(track, time_s)).all()
            continue
        ray = paths.position(track, time_s) - world.centers[tracks.view[mine]]
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        np.testing.assert_allclose(seen[mine], ray, atol=1e-13)
        again = np.stack([world.positions_at(time)[track] for time in time_s])
        np.testing.assert_allclose(again, paths.position(track, time_s), atol=1e-10)
    at = paths.at(30.0)
    there = ~np.isnan(at[:, 0])
    assert there[world.moving].any()
    assert not there[world.moving].all()
    np.testing.assert_allclose(at[there], world.positions_at(30.0)[there], atol=1e-10)


def test_a_world_at_rest_has_paths_that_rest() -> None:
    world = simulate("room", n_points=50)
    assert not world.moving.any()
    assert not world.paths.moving.any()
    np.testing.assert_array_equal(world.paths.coefficients, world.points)
    np.testing.assert_array_equal(world.positions_at(1e6), world.points)


def test_the_one_body_is_a_disturbance_as_ever() -> None:
    world = simulate("street", n_points=500, mover_fraction=0.2, mover_speed_m_s=1.2)
    np.testing.assert_array_equal(world.outlier, world.moving[world.tracks.track])
    assert set(world.body.tolist()) == {-1, 0}
    np.testing.assert_allclose(np.linalg.norm(world.velocity[world.moving], axis=1), 1.2)
    assert not world.acceleration.any()


def test_the_seed_decides() -> None:
    first, again, other = (simulate("room", noise_rad=1e-3, seed=seed) for seed in (3, 3, 4))
    assert first.tracks.bearing.tobytes() == again.tracks.bearing.tobytes()
    assert first.centers.tobytes() == again.centers.tobytes()
    assert not np.array_equal(first.centers, other.centers)


@pytest.mark.parametrize(
    ("world", "options", "message"),
    [
        ("strete", {}, '"strete", expected one of box, street, room, corridor'),
        ("street", {"n_wievs": 3}, '"n_wievs" is unknown, expected one of dimension, n_views, n_points'),
        ("street", {"n_views": -1}, "n_views is -1, expected a whole number"),
        ("street", {"n_views": 2.5}, "n_views is 2.5, expected a whole number"),
        ("street", {"n_points": 0}, "n_points is 0"),
        ("street", {"seed": -1}, "seed is -1"),
        ("street", {"noise_rad": "much"}, "noise_rad is much, expected a number"),
        ("street", {"noise_rad": float("nan")}, "noise_rad is NaN"),
        ("street", {"outlier_fraction": 2}, "outlier_fraction is 2, expected a fraction"),
        ("street", {"infinity_distance": 3}, "infinity_distance is 3, expected a pair"),
        ("street", {"infinity_distance": (3, 1)}, "the smaller distance first"),
        ("street", {"orientations": "upright"}, '"upright", expected one of identity, random'),
        ("street", {"dimension": 4}, "dimension is 4, expected 2 or 3"),
        ("street", {"n_bodies": 0}, "n_bodies is 0, expected a number from 1"),
        ("box", {"n_bodies": 3}, 'n_bodies has no meaning in the world "box"; it belongs to street, corridor'),
        ("ellipse", {"dimension": 3}, 'the world "ellipse" exists in dimension 2 only'),
        ("ellipse", {"conic": "square"}, "expected one of ellipse, circle, parabola, hyperbola"),
        ("room", {"depth_min_m": 1.0}, 'depth_min_m has no meaning in the world "room"'),
        ("weak", {"weak_mode": "loose"}, '"loose", expected one of clusters, chain'),
    ],
)
def test_bad_requests_are_refused_in_one_line(world: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        _core.simulate(world, options)
    assert "\n" not in str(caught.value)
    if "n_wievs" not in options:
        with pytest.raises(InputError) as typed:
            simulate(world, **options)
        assert str(typed.value) == str(caught.value)


def test_every_option_of_the_core_is_an_argument() -> None:
    with pytest.raises(ValueError, match="unknown") as caught:
        _core.simulate("box", {"?": 1})
    names = str(caught.value).split("expected one of ")[1].split(", ")
    arguments = inspect.signature(simulate).parameters
    assert sorted(names) == sorted(set(arguments) - {"world"})
    for name in names:
        with pytest.raises(ValueError, match=name):
            _core.simulate("box", {name: object()})
