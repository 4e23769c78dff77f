"""The same input gives the same bytes: on one thread or many, and again and again."""

from __future__ import annotations

from typing import Any

import numpy as np
import panopath as pp
import pytest

NOISE = 1e-3

CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "street": ({"world": "street", "n_views": 150, "n_points": 8000, "outlier_fraction": 0.2}, {}),
    "dense room": ({"world": "room", "n_views": 250, "n_points": 8000, "spacing_m": 0.05}, {}),
    "dense room, direct": (
        {"world": "room", "n_views": 250, "n_points": 8000, "spacing_m": 0.05},
        {"linear_solver": "direct"},
    ),
    "dense room, iterative": (
        {"world": "room", "n_views": 250, "n_points": 8000, "spacing_m": 0.05},
        {"linear_solver": "iterative"},
    ),
    "street, iterative": ({"world": "street", "n_views": 150, "n_points": 8000}, {"linear_solver": "iterative"}),
    "linear": ({"world": "room", "n_views": 60, "n_points": 1500}, {"method": "linear"}),
    "linear, two stages": (
        {"world": "room", "n_views": 60, "n_points": 1500},
        {"method": "linear", "linear_form": "two_stage", "vertical_axis": 1, "linear_gauge": "paper_distance"},
    ),
    "plane": ({"world": "room", "n_views": 100, "n_points": 4000, "dimension": 2}, {}),
    "parts": ({"world": "weak", "n_views": 60, "n_points": 3000, "n_clusters": 3, "n_links": 3}, {}),
}


def content(scene: pp.Scene) -> bytes:
    summary = scene.summary
    arrays = (
        scene.centers,
        scene.points,
        scene.view_component,
        scene.track_component,
        scene.inlier,
        scene.residual_rad,
        scene.cam_from_world,
        np.array([summary.sigma_rad]),
    )
    said = f"{summary.status} {summary.iterations} {summary.n_components}"
    return b"".join(a.tobytes() for a in arrays) + said.encode()


@pytest.mark.parametrize("case", CASES)
def test_the_same_bytes_on_any_number_of_threads_and_every_time(case: str) -> None:
    of_world, of_solver = CASES[case]
    world = pp.simulate(noise_rad=NOISE, seed=5, orientations="random", **of_world)

    def run(threads: int | None) -> bytes:
        options = pp.PositionOptions(threads=threads, **of_solver)
        return content(pp.solve_positions(world.tracks, world.cam_from_world, options))

    one = run(1)
    for threads in (1, 2, 3, None, None):
        assert run(threads) == one, f"{case} on {threads} threads"


def test_the_covariance_has_the_same_bytes_every_time() -> None:
    world = pp.simulate("street", n_views=150, n_points=4000)
    truth = (world.centers, world.points)
    first = pp.position_covariance(world.tracks, truth)
    assert first.tobytes() == pp.position_covariance(world.tracks, truth).tobytes()


def test_both_linear_solvers_find_the_same_minimum() -> None:
    world = pp.simulate("room", n_views=120, n_points=4000, spacing_m=0.1, noise_rad=NOISE, orientations="random")
    scenes = [
        pp.solve_positions(world.tracks, world.cam_from_world, pp.PositionOptions(linear_solver=solver))
        for solver in ("direct", "iterative")
    ]  # fmt: skip
    noise = pp.evaluate(scenes[0], world, alignment="translation_scale").camera_rms
    size = float(np.sqrt(((world.centers - world.centers.mean(axis=0)) ** 2).sum(axis=1).mean()))
    assert scenes[0].summary.status is scenes[1].summary.status is pp.Status.CONVERGED
    assert np.linalg.norm(scenes[0].centers - scenes[1].centers, axis=1).max() < 0.1 * noise / size
