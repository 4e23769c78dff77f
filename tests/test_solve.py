"""Solving through Python: gauges, methods, noise against the bound, degenerate input, errors, what records promise."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import panopath as pp
import pytest
from panopath.model import LinearForm, LinearGauge, LinearSolver
from panopath.synthetic import SyntheticWorld

Float = npt.NDArray[np.float64]
DEG = np.pi / 180.0
NOISE = 0.05 * DEG
EXACT = 1e-9


def solve(world: SyntheticWorld, **options: Any) -> pp.Scene:
    scene = pp.solve_positions(world.tracks, world.cam_from_world, pp.PositionOptions(**options))
    check_promises(scene, world.tracks)
    return scene


def check_promises(scene: pp.Scene, tracks: pp.Tracks) -> None:
    """What holds for every scene, whatever the input."""
    for positions, component in ((scene.centers, scene.view_component), (scene.points, scene.track_component)):
        assert component.dtype == np.int32
        assert component.min(initial=-1) >= -1
        np.testing.assert_array_equal(np.isnan(positions).all(axis=1), component < 0)
        np.testing.assert_array_equal(np.isfinite(positions).all(axis=1), component >= 0)
    view, track = scene.view_component[tracks.view], scene.track_component[tracks.track]
    known = (view >= 0) & (track >= 0)
    assert np.isnan(scene.residual_rad[~known]).all()
    assert not scene.inlier[~known].any()
    one = known & (view == track)
    np.testing.assert_allclose(scene.residual_rad[one], angles(scene, tracks)[one], atol=1e-7)
    summary = scene.summary
    assert (summary.n_views, summary.n_tracks) == (tracks.n_views, tracks.n_tracks)
    assert summary.n_observations == len(tracks)
    assert summary.n_inliers == scene.inlier.sum()
    assert summary.n_solved_views == (scene.view_component >= 0).sum()
    assert summary.n_solved_points == (scene.track_component >= 0).sum()
    assert summary.n_components == scene.n_components
    assert (summary.n_components == 0) == (summary.status is pp.Status.UNDETERMINED)
    assert (summary.status is pp.Status.DISCONNECTED) <= (summary.n_components > 1)
    assert all(seconds >= 0.0 for seconds in summary.seconds.values())
    assert sum(v for k, v in summary.seconds.items() if k != "total") == pytest.approx(summary.seconds["total"])
    for array in (scene.centers, scene.points, scene.residual_rad, scene.inlier):
        assert not array.flags.writeable


def in_camera(scene: pp.Scene, view: npt.NDArray[np.int32], direction: Float) -> Float:
    if scene.d == 3:
        turned: Float = np.einsum("nij,nj->ni", scene.cam_from_world[view], direction)
        return turned
    cos, sin = np.cos(scene.cam_from_world[view]), np.sin(scene.cam_from_world[view])
    x, y = direction.T
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=1)


def angles(scene: pp.Scene, tracks: pp.Tracks) -> Float:
    """Angle between each bearing and its prediction, from nothing but the outputs."""
    ray = scene.points[tracks.track] - scene.centers[tracks.view]
    with np.errstate(invalid="ignore"):
        ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    seen = in_camera(scene, tracks.view, ray)
    apart: Float = 2.0 * np.arctan2(
        np.linalg.norm(seen - tracks.bearing, axis=1), np.linalg.norm(seen + tracks.bearing, axis=1)
    )
    return apart


def assert_exact(scene: pp.Scene, world: SyntheticWorld) -> None:
    assert scene.summary.status is pp.Status.CONVERGED
    assert scene.inlier.all()
    found = pp.evaluate(scene, world, alignment="translation_scale")
    size = np.sqrt(((world.centers - world.centers.mean(axis=0)) ** 2).sum(axis=1).mean())
    far = size + np.linalg.norm(world.points - world.centers.mean(axis=0), axis=1)
    assert found.n_views == world.tracks.n_views
    assert found.n_points == world.tracks.n_tracks
    assert found.camera_max < EXACT * size
    assert (found.point_error < EXACT * far).all()


METHODS: list[dict[str, Any]] = [{"method": "robust"}]
METHODS += [
    {"method": "linear", "linear_form": form, "vertical_axis": axis, "linear_gauge": gauge}
    for form in get_args(LinearForm)
    for axis in ((0, 1, 2) if form == "two_stage" else (2,))
    for gauge in get_args(LinearGauge)
]


@pytest.mark.parametrize("method", METHODS, ids=lambda m: "-".join(str(v) for v in m.values()))
@pytest.mark.parametrize("dimension", [2, 3])
def test_every_method_recovers_an_exact_world_in_every_gauge(dimension: Literal[2, 3], method: dict[str, Any]) -> None:
    world = pp.simulate("box", n_views=7, n_points=25, seed=3, dimension=dimension, orientations="random")
    assert_exact(solve(world, **method), world)

    scene = solve(world, gauge="paper", **method)
    assert_exact(scene, world)
    np.testing.assert_allclose(scene.points[0], 0.0, atol=1e-12)
    assert scene.points[1, 0] == pytest.approx(np.sign(world.points[1, 0] - world.points[0, 0]))

    scene = solve(world, gauge="paper_distance", **method)
    assert_exact(scene, world)
    assert np.linalg.norm(scene.points[1]) == pytest.approx(1.0)

    for rotation in (False, True):
        angle = 2.0 if rotation else 0.0
        turn = np.eye(dimension)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        centers, points = 40.0 * world.centers @ turn.T + 100.0, 40.0 * world.points @ turn.T + 100.0
        for control in (
            pp.Control(views={i: centers[i] for i in (0, 2, 5, 6)}, rotation=rotation),
            pp.Control(points={j: points[j] for j in (3, 20, 7, 11)}, rotation=rotation),
            pp.Control(views={4: centers[4], 1: centers[1]}, points={0: points[0], 9: points[9]}, rotation=rotation),
        ):
            scene = solve(world, gauge="control", control=control, **method)
            np.testing.assert_allclose(scene.centers, centers, atol=1e-9 * 40.0)
            np.testing.assert_allclose(scene.points, points, atol=1e-9 * 40.0)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name", ["street", "room", "corridor", "line", "chain"])
def test_exact_walks_are_recovered(name: str, dimension: Literal[2, 3]) -> None:
    world = pp.simulate(name, n_views=50, n_points=700, seed=2, dimension=dimension, orientations="random")
    for solver in get_args(LinearSolver):
        assert_exact(solve(world, linear_solver=solver), world)


def test_control_by_name() -> None:
    world = pp.simulate("box", n_views=6, n_points=20)
    t = world.tracks
    names = [f"pano {i}" for i in range(6)]
    tracks = pp.Tracks.from_arrays(t.view, t.track, t.bearing, n_views=6, n_tracks=20, view_names=names)
    control = pp.Control(views={names[i]: world.centers[i] for i in range(4)})
    scene = pp.solve_positions(tracks, world.cam_from_world, pp.PositionOptions(gauge="control", control=control))
    np.testing.assert_allclose(scene.centers, world.centers, atol=EXACT)
    assert scene.view_names == tuple(names)
    wrong = pp.Control(views={"pano 9": (0.0, 0.0, 0.0), "pano 1": (1.0, 0.0, 0.0)})
    with pytest.raises(pp.InputError, match="pano 9"):
        pp.solve_positions(tracks, None, pp.PositionOptions(gauge="control", control=wrong))


# ---- the bound ------------------------------------------------------------------------------------------------------


def dense_covariance(world: SyntheticWorld, sigma_rad: Float) -> Float:
    """Covariance of the centres from the full Fisher information by numpy alone."""
    view, track = world.tracks.view, world.tracks.track
    n, m, d = world.tracks.n_views, world.tracks.n_tracks, world.centers.shape[1]
    ray = world.points[track] - world.centers[view]
    length = np.linalg.norm(ray, axis=1)
    unit = ray / length[:, None]
    projector = (np.eye(d) - unit[:, :, None] * unit[:, None, :]) / (length * sigma_rad)[:, None, None]
    jacobian = np.zeros((len(view), d, n + m, d))
    rows = np.arange(len(view))
    jacobian[rows, :, view] = -projector
    jacobian[rows, :, n + track] = projector
    flat = jacobian.reshape(len(view) * d, -1)
    information = flat.T @ flat
    # the gauge leaves the cameras as a whole where they are: shifts and the scale of the cameras alone
    a, b, c = information[: n * d, : n * d], information[: n * d, n * d :], information[n * d :, n * d :]
    reduced = a - b @ np.linalg.solve(c, b.T)
    values, vectors = np.linalg.eigh(reduced)
    assert values[d] < 1e-9 * values[-1]
    assert values[d + 1] > 1e-9 * values[-1]
    pseudo = (vectors[:, d + 1 :] / values[d + 1 :]) @ vectors[:, d + 1 :].T
    return np.array([pseudo[i * d : i * d + d, i * d : i * d + d] for i in range(n)])


@pytest.mark.parametrize(("name", "dimension"), [("box", 2), ("box", 3), ("room", 2), ("room", 3), ("street", 3)])
def test_covariance_equals_the_dense_one(name: str, dimension: Literal[2, 3]) -> None:
    views: dict[str, Any] = {} if name == "box" else {"min_views": 5}
    world = pp.simulate(name, n_views=14, n_points=60, seed=1, dimension=dimension, orientations="random", **views)
    t = world.tracks
    sigma = np.random.default_rng(0).uniform(1e-4, 1e-3, len(t))
    weighted = pp.Tracks.from_arrays(t.view, t.track, t.bearing, t.n_views, t.n_tracks, sigma_rad=sigma)
    found = pp.position_covariance(weighted, (world.centers, world.points), world.cam_from_world)
    wanted = dense_covariance(world, sigma)
    np.testing.assert_allclose(found, wanted, atol=1e-6 * np.abs(wanted).max())
    # without sigma a standard deviation of one radian is meant
    found = pp.position_covariance(t, (world.centers, world.points), world.cam_from_world)
    np.testing.assert_allclose(
        found, dense_covariance(world, np.ones(len(t))), rtol=1e-4, atol=1e-6 * np.abs(found).max()
    )


def test_noise_is_averaged_down_to_the_bound_and_estimated() -> None:
    error, bound, sigma = 0.0, 0.0, []
    for seed in range(8):
        world = pp.simulate("room", n_views=50, n_points=1000, seed=seed, noise_rad=NOISE, orientations="random")
        scene = solve(world)
        assert scene.summary.status is pp.Status.CONVERGED
        found = pp.evaluate(scene, world, alignment="translation_scale")
        truth = (world.centers, world.points)
        covariance = pp.position_covariance(world.tracks, truth, world.cam_from_world) * NOISE**2
        error += found.camera_rms**2
        bound += float(np.trace(covariance, axis1=1, axis2=2).mean())
        sigma.append(scene.summary.sigma_rad / NOISE)
    assert np.sqrt(error / bound) <= 1.15
    assert np.mean(sigma) == pytest.approx(1.0, abs=0.1)


def test_a_scene_is_a_start() -> None:
    world = pp.simulate("street", n_views=40, n_points=800, noise_rad=NOISE, outlier_fraction=0.1)
    first = solve(world)
    again = pp.solve_positions(world.tracks, world.cam_from_world, start=first)
    assert again.summary.status is first.summary.status
    noise = pp.evaluate(first, world, alignment="translation_scale").camera_rms
    size = float(np.sqrt(((world.centers - world.centers.mean(axis=0)) ** 2).sum(axis=1).mean()))
    assert np.linalg.norm(again.centers - first.centers, axis=1).max() < 0.1 * noise / size


# ---- degenerate input -----------------------------------------------------------------------------------------------


def test_no_observations_are_refused_with_a_clear_error() -> None:
    with pytest.raises(pp.InputError, match="view is empty"):
        pp.Tracks.from_arrays([], [], np.empty((0, 3)), n_views=3, n_tracks=4)


@pytest.mark.parametrize("method", ["robust", "linear"])
@pytest.mark.parametrize("split_parts", [True, False])
def test_too_little_is_undetermined(method: str, split_parts: bool) -> None:
    options: dict[str, Any] = {"method": method, "split_parts": split_parts}
    for view, track, bearing in (
        ([0], [0], [[1.0, 0.0, 0.0]]),
        ([0, 0, 0], [0, 1, 2], np.eye(3)),
        ([0, 1, 2], [0, 0, 0], np.eye(3)),
        ([0, 1], [0, 1], np.eye(3)[:2]),
        ([0, 0], [0, 0], np.eye(3)[:2]),
    ):
        tracks = pp.Tracks.from_arrays(view, track, bearing)
        scene = pp.solve_positions(tracks, None, pp.PositionOptions(**options))
        check_promises(scene, tracks)
        assert scene.summary.status in (pp.Status.UNDETERMINED, pp.Status.AMBIGUOUS)
        assert not scene.summary.status.is_determined


def test_huge_indices_cost_no_more_than_their_arrays() -> None:
    world = pp.simulate("box", n_views=6, n_points=20)
    t = world.tracks
    tracks = pp.Tracks.from_arrays(t.view * 9_999, t.track * 90_001, t.bearing, n_views=60_000, n_tracks=2_000_000)
    scene = pp.solve_positions(tracks)
    assert scene.summary.status is pp.Status.CONVERGED
    assert (scene.summary.n_solved_views, scene.summary.n_solved_points) == (6, 20)
    np.testing.assert_allclose(scene.centers[::9_999][:6], solve(world).centers, atol=EXACT)


def test_disconnected_worlds_are_solved_apart() -> None:
    worlds = [pp.simulate("box", n_views=6, n_points=20, seed=s) for s in range(3)]
    view = np.concatenate([w.tracks.view + 6 * k for k, w in enumerate(worlds)])
    track = np.concatenate([w.tracks.track + 20 * k for k, w in enumerate(worlds)])
    tracks = pp.Tracks.from_arrays(view, track, np.concatenate([w.tracks.bearing for w in worlds]))
    scene = pp.solve_positions(tracks)
    check_promises(scene, tracks)
    assert scene.summary.status is pp.Status.DISCONNECTED
    assert scene.summary.n_components == 3
    truth = (np.concatenate([w.centers for w in worlds]), np.concatenate([w.points for w in worlds]))
    assert pp.evaluate(scene, truth, alignment="translation_scale").camera_max < EXACT
    whole = pp.solve_positions(tracks, None, pp.PositionOptions(split_parts=False))
    assert not whole.summary.status.is_determined


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("n_links", range(5))
def test_weak_joins(n_links: int, dimension: Literal[2, 3]) -> None:
    world = pp.simulate("weak", n_views=16, n_points=80, seed=1, n_links=n_links, dimension=dimension)
    scene = solve(world)
    parts = 1 if n_links == 4 and dimension == 3 else 2
    assert scene.summary.n_components == parts
    assert scene.summary.status is (pp.Status.CONVERGED if parts == 1 else pp.Status.DISCONNECTED)
    found = pp.evaluate(scene, world, alignment="translation_scale")
    assert found.camera_max < 1e-7


@pytest.mark.parametrize("noise_rad", [0.0, 1e-5, 1e-3])
@pytest.mark.parametrize("conic", ["ellipse", "circle", "parabola", "hyperbola"])
def test_a_conic_is_never_determined(conic: Any, noise_rad: float) -> None:
    for seed in range(3):
        world = pp.simulate("ellipse", n_views=10, n_points=30, seed=seed, conic=conic, noise_rad=noise_rad)
        assert not solve(world).summary.status.is_determined


def test_a_cylinder_is_unique_in_space_and_flagged_from_above() -> None:
    world = pp.simulate("cylinder", n_views=10, n_points=40)
    assert_exact(solve(world), world)
    assert_exact(solve(world, method="linear"), world)
    above = solve(world, method="linear", linear_form="two_stage", vertical_axis=2)
    assert not above.summary.status.is_determined


def test_missing_rows_of_a_start_are_found_anew() -> None:
    world = pp.simulate("box", n_views=8, n_points=40)
    points = world.points.copy()
    points[::5] = np.nan
    scene = pp.solve_positions(world.tracks, world.cam_from_world, start=(world.centers, points))
    assert_exact(scene, world)
    # the docstring: NaN rows are found anew
    centers = world.centers.copy()
    centers[3] = np.nan
    scene = pp.solve_positions(world.tracks, world.cam_from_world, start=(centers, points))
    assert_exact(scene, world)


# ---- errors ---------------------------------------------------------------------------------------------------------


def test_wrong_arguments_are_named() -> None:
    world = pp.simulate("box", n_views=6, n_points=20)
    t = world.tracks
    good = world.cam_from_world
    mirrored = good.copy()
    mirrored[2] = np.diag([1.0, 1.0, -1.0])
    skewed = good.copy()
    skewed[4, 0, 1] += 1e-3
    unknown = good.copy()
    unknown[1, 1, 1] = np.nan
    for wrong, words in (
        (good[:5], r"cam_from_world has shape \(5, 3, 3\)"),
        (np.zeros(6), "cam_from_world has shape"),
        (mirrored, r"cam_from_world\[2\]"),
        (skewed, r"cam_from_world\[4\]"),
        (unknown, r"cam_from_world\[1\]"),
        ("north", "cam_from_world"),
    ):
        with pytest.raises(pp.InputError, match=words):
            pp.solve_positions(t, wrong)
    centers, points = world.centers, world.points
    for start, words in (
        ((centers[:5], points), "centers has shape"),
        ((centers, points[:, :2]), "points has shape"),
        ((centers,), "start has 1"),
        ((centers * np.inf, points), "infinite"),
    ):
        with np.errstate(invalid="ignore"), pytest.raises(pp.InputError, match=words):
            pp.solve_positions(t, good, start=start)  # type: ignore[arg-type]
    with pytest.raises(pp.InputError, match="tracks is a dict"):
        pp.solve_positions({"view": t.view})  # type: ignore[arg-type]
    with pytest.raises(pp.InputError, match="options is a dict"):
        pp.solve_positions(t, good, {"method": "robust"})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "magic"}, "method"),
        ({"gauge": "north"}, "gauge"),
        ({"linear_form": "three_stage"}, "linear_form"),
        ({"linear_gauge": "none"}, "linear_gauge"),
        ({"linear_solver": "gpu"}, "linear_solver"),
        ({"vertical_axis": 3}, "vertical_axis"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"threads": 0}, "threads"),
        ({"split_parts": "yes"}, "split_parts"),
        ({"gauge": "control"}, "control"),
        ({"control": pp.Control(views={0: (0.0, 0.0, 0.0)})}, "control"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], words: str) -> None:
    with pytest.raises(pp.InputError, match=words):
        pp.PositionOptions(**options)


def test_control_that_fixes_nothing_is_an_error() -> None:
    world = pp.simulate("box", n_views=6, n_points=20)

    def run(control: pp.Control) -> None:
        pp.solve_positions(world.tracks, None, pp.PositionOptions(gauge="control", control=control))

    for control, words in (
        (pp.Control(views={0: (0.0, 0.0, 0.0)}), "two"),
        (pp.Control(views={0: (1.0, 1.0, 1.0), 1: (1.0, 1.0, 1.0)}), "one place"),
        (pp.Control(views={0: (0.0, 0.0), 1: (1.0, 1.0)}), "coordinates"),
        (pp.Control(views={0: (0.0, 0.0, 0.0), 6: (1.0, 1.0, 1.0)}), "view 6"),
    ):
        with pytest.raises(pp.InputError, match=words):
            run(control)


def test_wrong_arrays_are_named() -> None:
    unit = np.eye(3)
    for arguments, words in (
        (([0, 1], [0], unit[:2]), "track has 1"),
        (([0, 1], [0, 0], unit), "bearing has 3"),
        (([0, 1], [0, 0], unit[:2] * 2.0), r"bearing\[0\]"),
        (([0, 1], [0, 0], [[1.0, 0.0, 0.0], [np.nan, 0.0, 0.0]]), r"bearing\[1\]"),
        (([0, -1], [0, 0], unit[:2]), r"view\[1\] is -1"),
        (([0, 0.5], [0, 0], unit[:2]), r"view\[1\] is 0.5"),
        (([0, 1], [0, 2**31], unit[:2]), r"track\[1\]"),
        (([0, 1], [0, 0], np.ones((2, 4)) / 2.0), "bearing has shape"),
    ):
        with pytest.raises(pp.InputError, match=words):
            pp.Tracks.from_arrays(*arguments)
    for sigma in ([1.0], [0.0, 1.0], [np.nan, 1.0], -1.0, [[1.0, 1.0]]):
        with pytest.raises(pp.InputError, match="sigma_rad"):
            pp.Tracks.from_arrays([0, 1], [0, 0], unit[:2], sigma_rad=sigma)
    with pytest.raises(pp.InputError, match="n_views"):
        pp.Tracks.from_arrays([0, 1], [0, 0], unit[:2], n_views=0)
    with pytest.raises(pp.InputError, match="beyond"):
        pp.Tracks.from_arrays([0, 1], [0, 0], unit[:2], n_views=1)


def test_the_input_is_not_touched() -> None:
    world = pp.simulate("box", n_views=6, n_points=20, noise_rad=1e-3, orientations="random")
    t = world.tracks
    before = [a.copy() for a in (t.view, t.track, t.bearing, world.cam_from_world)]
    start = (world.centers.copy(), world.points.copy())
    pp.solve_positions(t, world.cam_from_world, start=start)
    for a, b in zip(before, (t.view, t.track, t.bearing, world.cam_from_world), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(start[0], world.centers)
    np.testing.assert_array_equal(start[1], world.points)
