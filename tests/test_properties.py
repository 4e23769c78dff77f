"""Laws of the solver, searched by hypothesis: similarity, relabelling, order, and turns through seam and poles."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import panopath as pp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

Float = npt.NDArray[np.float64]
Law = settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
seeds = st.integers(0, 10_000)
dimensions: Any = st.sampled_from([2, 3])
angles = st.floats(-4.0, 4.0) | st.sampled_from([np.pi * k / 2 for k in range(-2, 3)])


def noisy_tracks(seed: int, dimension: Literal[2, 3]) -> pp.Tracks:
    # in the plane any two of three rays agree: which of them is the outlier would be a matter of chance
    outliers = 0.05 if dimension == 3 else 0.0
    world = pp.simulate(
        "room", n_views=15, n_points=150, seed=seed, dimension=dimension, noise_rad=1e-3,
        outlier_fraction=outliers, min_views=5,
    )  # fmt: skip
    return world.tracks


def rotation(phi: tuple[float, float, float], d: int) -> Float:
    def about(axis: int, angle: float) -> Float:
        turn = np.eye(d)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        turn[[i, j, i, j], [i, j, j, i]] = np.cos(angle), np.cos(angle), -np.sin(angle), np.sin(angle)
        return turn

    if d == 2:
        return about(2, phi[0])
    return about(0, phi[0]) @ about(1, phi[1]) @ about(2, phi[2])


def assert_same(
    one: pp.Scene, other: pp.Scene, view: Any = slice(None), track: Any = slice(None), turn: Float | None = None
) -> None:
    """``other``'s rows ``view`` and ``track`` are ``one``'s, turned; to a hundredth of what the noise does."""
    turn = np.eye(one.d) if turn is None else turn
    assert one.summary.status is other.summary.status
    np.testing.assert_array_equal(one.view_component, other.view_component[view])
    np.testing.assert_array_equal(one.track_component, other.track_component[track])
    assert one.summary.n_inliers == other.summary.n_inliers
    np.testing.assert_allclose(other.centers[view], one.centers @ turn.T, atol=1e-5)
    far = 1.0 + np.linalg.norm(one.points, axis=1, keepdims=True)
    off = np.abs(other.points[track] - one.points @ turn.T) / far**2
    assert np.nanmax(off) < 1e-4


@Law
@given(seed=seeds, d=dimensions)
def test_the_order_of_observations_does_not_matter(seed: int, d: Literal[2, 3]) -> None:
    t = noisy_tracks(seed, d)
    order = np.random.default_rng(seed).permutation(len(t))
    shuffled = pp.Tracks.from_arrays(t.view[order], t.track[order], t.bearing[order], t.n_views, t.n_tracks)
    one, other = pp.solve_positions(t), pp.solve_positions(shuffled)
    assert_same(one, other)
    np.testing.assert_array_equal(other.inlier, one.inlier[order])
    np.testing.assert_allclose(other.residual_rad, one.residual_rad[order], atol=1e-4)


@Law
@given(seed=seeds, d=dimensions)
def test_names_do_not_matter(seed: int, d: Literal[2, 3]) -> None:
    t = noisy_tracks(seed, d)
    rng = np.random.default_rng(seed)
    view, track = rng.permutation(t.n_views), rng.permutation(t.n_tracks)
    renamed = pp.Tracks.from_arrays(view[t.view], track[t.track], t.bearing, t.n_views, t.n_tracks)
    assert_same(pp.solve_positions(t), pp.solve_positions(renamed), view, track)


@Law
@given(seed=seeds, d=dimensions, phi=st.tuples(angles, angles, angles))
def test_a_turn_of_the_world_turns_the_answer(seed: int, d: Literal[2, 3], phi: tuple[float, float, float]) -> None:
    t = noisy_tracks(seed, d)
    turn = rotation(phi, d)
    turned = pp.Tracks.from_arrays(t.view, t.track, t.bearing @ turn.T, t.n_views, t.n_tracks)
    one = pp.solve_positions(t)
    assert_same(one, pp.solve_positions(turned), turn=turn)
    # the same said by orientations, which follow a control's rotation back again
    cam_from_world: Float = np.full(t.n_views, phi[0]) if d == 2 else np.tile(turn.T, (t.n_views, 1, 1))
    assert_same(one, pp.solve_positions(t, cam_from_world), turn=turn)


@Law
@given(
    seed=seeds,
    d=dimensions,
    log_scale=st.floats(-6.0, 6.0),
    shift=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    phi=st.tuples(angles, angles, angles),
)
def test_a_similarity_of_an_exact_world_is_recovered(
    seed: int, d: Literal[2, 3], log_scale: float, shift: tuple[float, float, float], phi: tuple[float, float, float]
) -> None:
    world = pp.simulate("box", n_views=7, n_points=30, seed=seed, dimension=d)
    scale = 10.0**log_scale
    turn = rotation(phi, d)
    centers = scale * (world.centers @ turn.T + shift[:d])
    points = scale * (world.points @ turn.T + shift[:d])
    t = world.tracks
    ray = points[t.track] - centers[t.view]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    scene = pp.solve_positions(pp.Tracks.from_arrays(t.view, t.track, ray))
    assert scene.summary.status is pp.Status.CONVERGED
    found = pp.evaluate(scene, (centers, points), alignment="translation_scale")
    assert found.camera_max < 1e-9 * scale
    assert found.point_error.max() < 1e-8 * scale


@Law
@given(seed=seeds, keep=st.floats(0.0, 1.0), d=dimensions)
def test_any_subset_of_observations_is_answered(seed: int, keep: float, d: Literal[2, 3]) -> None:
    """However little is left, the answer keeps its promises and names what is not determined."""
    t = noisy_tracks(seed, d)
    chosen = np.random.default_rng(seed).random(len(t)) < keep**3
    chosen[0] = True
    fewer = pp.Tracks.from_arrays(t.view[chosen], t.track[chosen], t.bearing[chosen], t.n_views, t.n_tracks)
    for method in ("robust", "linear"):
        scene = pp.solve_positions(fewer, None, pp.PositionOptions(method=method))
        np.testing.assert_array_equal(np.isnan(scene.centers).any(axis=1), scene.view_component < 0)
        np.testing.assert_array_equal(np.isnan(scene.points).any(axis=1), scene.track_component < 0)
        assert (scene.summary.n_components == 0) == (scene.summary.status is pp.Status.UNDETERMINED)


@Law
@given(seed=seeds, sigma=st.floats(1e-6, 1e-2))
def test_a_common_sigma_does_not_move_the_answer(seed: int, sigma: float) -> None:
    t = noisy_tracks(seed, 3)
    weighted = pp.Tracks.from_arrays(t.view, t.track, t.bearing, t.n_views, t.n_tracks, sigma_rad=sigma)
    one, other = pp.solve_positions(t), pp.solve_positions(weighted)
    np.testing.assert_allclose(other.centers, one.centers, atol=1e-5)
