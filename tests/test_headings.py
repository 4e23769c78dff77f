"""Headings of planar views through Python: from bearings to a scene, real landmark logs, errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import panopath as pp
import pytest
from panopath.model import Float, Int

from benchmarks.planar_sets import PlanarSet, read_mrclam, read_roh


def heading_errors_deg(found: pp.Headings, truth: Float, component: int = 0) -> Float:
    """Errors of a component after the best common turn, degrees."""
    member = found.view_component == component
    turn = np.exp(1j * (found.heading_rad[member] - truth[member]))
    return np.asarray(np.degrees(np.abs(np.angle(turn / turn.mean()))))


def planar_tracks(data: PlanarSet) -> pp.Tracks:
    bearing = np.column_stack([np.cos(data.bearing_rad), np.sin(data.bearing_rad)])
    return pp.Tracks.from_arrays(
        data.station, data.landmark, bearing, n_views=len(data.stations), n_tracks=len(data.landmarks)
    )


def test_headings_then_positions_give_the_scene() -> None:
    world = pp.simulate("box", n_views=10, n_points=40, seed=2, dimension=2, orientations="random")
    found = pp.find_headings(world.tracks)
    assert found.status is pp.Status.CONVERGED
    assert not found.heading_rad.flags.writeable
    scene = pp.solve_positions(world.tracks, found.heading_rad)
    assert pp.evaluate(scene, world, "similarity").camera_rms < 1e-6


def test_noise_and_false_bearings_leave_a_start() -> None:
    world = pp.simulate(
        "street",
        n_views=60,
        n_points=900,
        seed=3,
        dimension=2,
        orientations="random",
        noise_rad=np.radians(0.5),
        outlier_fraction=0.1,
    )
    found = pp.find_headings(world.tracks)
    assert found.status is pp.Status.CONVERGED
    assert heading_errors_deg(found, world.cam_from_world).max() < 2.0
    np.testing.assert_array_equal(found.heading_rad, pp.find_headings(world.tracks).heading_rad)


def test_mean_motion_and_triplets_agree_on_what_they_share() -> None:
    # steps small against the distances: both are right, by different means
    world = pp.simulate("street", n_views=20, n_points=600, seed=4, dimension=2, orientations="random", spacing_m=0.3)
    triplets = pp.find_headings(world.tracks).heading_rad
    chained = pp.mean_motion(world.tracks).cam_from_world
    turn = np.exp(1j * (triplets - chained))
    assert np.degrees(np.abs(np.angle(turn / turn.mean()))).max() < 5.0


def test_six_stations_and_four_beacons_are_determined(real_data: Callable[[str], Path]) -> None:
    # 24 angles for 6 x 3 + 4 x 2 - 4 = 22 unknowns; the sensor is off by up to 8 degrees
    beacons = read_roh(real_data("planar_bearings/dataset_roh")).mean()
    found = pp.find_headings(planar_tracks(beacons))
    assert (found.status, found.n_quads) == (pp.Status.CONVERGED, (1, 1))
    assert heading_errors_deg(found, beacons.heading_rad).max() < 10.0


def test_a_robot_among_landmarks_is_oriented(real_data: Callable[[str], Path]) -> None:
    log = read_mrclam(real_data("planar_bearings/dataset_mrclam") / "mrclam4.mat")
    found = pp.find_headings(planar_tracks(log), pp.HeadingOptions(min_points=3))
    assert (found.view_component == 0).mean() > 0.9
    assert np.median(heading_errors_deg(found, log.heading_rad)) < 4.0


def test_undetermined_is_an_answer() -> None:
    view: Int = np.repeat(np.arange(2, dtype=np.int32), 5)
    tracks = pp.Tracks.from_arrays(view, np.tile(np.arange(5), 2), np.tile([[0.6, 0.8]], (10, 1)))
    found = pp.find_headings(tracks)
    assert found.status is pp.Status.UNDETERMINED
    assert np.isnan(found.heading_rad).all()
    assert (found.view_component == -1).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"min_tracks": 5}, "min_tracks is 5, expected a whole number of at least 6"),
        ({"triplets": 0}, "triplets is 0"),
        ({"min_points": 2}, "min_points is 2"),
        ({"seed": -1}, "seed is -1"),
        ({"noise_rad": 0.0}, r"noise_rad is 0\.0"),
        ({"noise_rad": float("nan")}, "noise_rad is nan"),
    ],
)
def test_options_out_of_range_are_named(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        pp.HeadingOptions(**wrong)  # type: ignore[arg-type]


def test_arguments_that_do_not_fit_are_named(turned: pp.SyntheticWorld) -> None:
    with pytest.raises(pp.InputError, match="expected 2: headings belong to the plane"):
        pp.find_headings(turned.tracks)
    with pytest.raises(pp.InputError, match="tracks is a dict"):
        pp.find_headings({})  # type: ignore[arg-type]
    with pytest.raises(pp.InputError, match="options is a dict"):
        pp.find_headings(turned.tracks, {})  # type: ignore[arg-type]
