"""The consistency gate from Python: options, sentences, figures; scenes of other solvers; the benchmark's scenes."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import panopath as pp
import pytest
from panopath.formats.structure import known_scene

from benchmarks import consistency as bench

FIGURES = {
    "noise_rad",
    "misfit_share",
    "behind_share",
    "lost_share",
    "unplaced_share",
    "untied_views",
    "torn_places",
    "tension",
    "near_strain",
    "far_strain",
}


def street(**more: object) -> pp.SyntheticWorld:
    settings: dict[str, object] = {
        "n_views": 50,
        "n_points": 1500,
        "noise_rad": radians(0.05),
        "orientations": "random",
        "outlier_fraction": 0.1,
    }
    return pp.simulate("street", **{**settings, **more})  # type: ignore[arg-type]


def test_a_right_scene_passes() -> None:
    world = street()
    scene = pp.solve_positions(world.tracks, world.cam_from_world)
    found = pp.check_consistency(world.tracks, scene)
    assert found.passed
    assert found.reasons == ()
    assert set(found.statistics) == FIGURES
    assert all(value <= limit for value, limit in found.statistics.values())
    assert found.statistics["noise_rad"][0] == pytest.approx(world.noise_rad, rel=0.05)


def test_a_planar_scene_and_world_directions() -> None:
    world = street(dimension=2, orientations="identity")
    found = pp.check_consistency(world.tracks, pp.solve_positions(world.tracks))
    assert found.passed, found.reasons


def test_a_mirrored_scene_is_told_in_words() -> None:
    world = street(outlier_fraction=0.0)
    scene = known_scene(world.tracks, world.cam_from_world, -world.centers, -world.points)
    found = pp.check_consistency(world.tracks, scene)
    assert not found.passed
    assert any("point away from their points (views 0 to 49)" in reason for reason in found.reasons)


def test_a_turned_run_is_found_and_named() -> None:
    world = street(n_views=80, n_points=3000)
    orientations = np.array(world.cam_from_world)
    turn = bench.rotations_of(np.random.default_rng(0), radians(6.0))
    orientations[30:40] = orientations[30:40] @ turn
    found = pp.check_consistency(world.tracks, pp.solve_positions(world.tracks, orientations))
    assert not found.passed
    value, limit = found.statistics["torn_places"]
    assert value > limit
    assert any("fit both sides" in reason for reason in found.reasons)


def test_sigma_of_the_tracks_is_held_against_the_residuals() -> None:
    world = street(outlier_fraction=0.0)
    told = replace(world.tracks, sigma_rad=np.full(len(world.tracks), world.noise_rad / 3))
    scene = pp.solve_positions(told, world.cam_from_world)
    found = pp.check_consistency(told, scene)
    assert found.statistics["noise_over_given"][0] == pytest.approx(3.0, rel=0.05)
    assert any("times what their sigma says" in reason for reason in found.reasons)


def test_orientations_that_are_not_known_leave_their_views_out() -> None:
    world = street()
    scene = pp.solve_positions(world.tracks, world.cam_from_world)
    orientations = np.array(scene.cam_from_world)
    orientations[3] = np.nan
    found = pp.check_consistency(world.tracks, replace(scene, cam_from_world=orientations))
    assert found.statistics["unplaced_share"][0] == pytest.approx(1 / 50)
    assert found.passed, found.reasons


def test_limits_and_threads() -> None:
    world = street()
    scene = pp.solve_positions(world.tracks, world.cam_from_world)
    found = pp.check_consistency(world.tracks, scene)
    strict = pp.check_consistency(world.tracks, scene, pp.ConsistencyOptions(max_noise_rad=radians(0.01)))
    assert not strict.passed
    assert strict.reasons[0].startswith("the scene: the observations that were used miss by")
    for threads in (1, 2, 4):
        assert pp.check_consistency(world.tracks, scene, pp.ConsistencyOptions(threads=threads)) == found


def test_what_cannot_be_used_is_named() -> None:
    world = street()
    scene = pp.solve_positions(world.tracks, world.cam_from_world)
    with pytest.raises(pp.InputError, match="max_tension is nan, expected a number above 0"):
        pp.ConsistencyOptions(max_tension=float("nan"))
    with pytest.raises(pp.InputError, match="threads is 0"):
        pp.ConsistencyOptions(threads=0)
    with pytest.raises(pp.InputError, match="tracks is a list"):
        pp.check_consistency([], scene)  # type: ignore[arg-type]
    with pytest.raises(pp.InputError, match="options is a dict"):
        pp.check_consistency(world.tracks, scene, {})  # type: ignore[arg-type]
    fewer = world.tracks.select(np.arange(len(world.tracks)) > 0)
    with pytest.raises(pp.InputError, match=r"scene.inlier has \d+ entries"):
        pp.check_consistency(fewer, scene)


@pytest.mark.parametrize("kind", sorted(bench.SABOTAGE))
def test_sabotage_is_flagged(kind: str) -> None:
    for made in bench.draw(kind, 2, first_seed=0):
        if made.is_broken:
            found = pp.check_consistency(made.tracks, made.scene)
            assert not found.passed, made.name


def test_what_is_right_is_not() -> None:
    for made in bench.draw("right", 6, first_seed=0):
        if made.ratio <= bench.RIGHT_RATIO:
            found = pp.check_consistency(made.tracks, made.scene)
            assert found.passed, (made.name, found.reasons)
