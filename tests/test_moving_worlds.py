"""The worlds that tests of moving bodies start from: exact, determined, and free where theory says so."""

from __future__ import annotations

import numpy as np
import pytest
from moving_worlds import FORMS, linear_solution, moving_world, nullity
from panopath.paths import PathVerdict, Static, Taylor


@pytest.mark.parametrize("d", [2, 3])
def test_bearings_are_those_of_the_paths(d: int) -> None:
    world = moving_world(list(FORMS.values()), d=d, visible=0.7, seed=1)
    tracks, time_s = world.tracks, world.tracks.time_s
    assert time_s is not None
    assert len(tracks) == pytest.approx(0.7 * 30 * (6 + len(FORMS)), rel=0.1)
    for j, verdict in enumerate(world.paths.verdicts):
        mine = tracks.track == j
        ray = world.paths.position(j, time_s[tracks.view[mine]]) - world.centers[tracks.view[mine]]
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        np.testing.assert_allclose(tracks.bearing[mine], ray, atol=1e-14)
        assert (verdict is PathVerdict.STATIC) == (j in world.static)


def test_noise_is_across_the_bearing() -> None:
    exact, noisy = (moving_world([], n_views=100, n_static=100, noise_rad=s) for s in (0.0, 1e-3))
    error = np.linalg.norm(exact.tracks.bearing - noisy.tracks.bearing, axis=1)
    assert np.sqrt(np.mean(error**2) / 2) == pytest.approx(1e-3, rel=0.02)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("form", FORMS)
def test_each_form_mixed_with_rest_is_determined_and_found(form: str, d: int) -> None:
    world = moving_world([FORMS[form]] * 3, d=d)
    assert nullity(world) == d + 1
    centers, vectors = linear_solution(world)
    np.testing.assert_allclose(centers, world.centers, atol=1e-10)
    np.testing.assert_allclose(vectors, world.paths.coefficients, atol=1e-9)


def test_all_forms_together() -> None:
    for d in (2, 3):
        world = moving_world(list(FORMS.values()), d=d)
        assert nullity(world) == d + 1
        np.testing.assert_allclose(linear_solution(world)[0], world.centers, atol=1e-10)


@pytest.mark.parametrize("d", [2, 3])
def test_where_everything_may_move_everything_may_drift(d: int) -> None:
    """A shift with any constant velocity; and of a world at rest, with one anchor, a scale that grows in time."""
    line = Taylor(1, 5.0, 5.0)
    moving = moving_world([line] * 8, d=d, n_static=0)
    assert nullity(moving) == 2 * d + 1
    still = moving_world([], d=d, n_static=9)
    assert nullity(still, [line] * 9) == 2 * d + 2
    assert nullity(still, [Static(), *[line] * 8]) == d + 2
    assert nullity(still, [Static(), Static(), *[line] * 7]) == d + 1
