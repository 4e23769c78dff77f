"""From bearings alone to a refined scene: against the refinement that starts from the truth, with priors, with rigs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.cli import main
from panopath.formats.csv import write_tracks
from panopath.model import Bool, Float
from panopath.pipeline import (
    ReconstructOptions,
    ViewOrientations,
    fit_to_control,
    metric_scale,
    orient_views,
    place_views,
    reconstruct_tracks,
)
from panopath.priors import DirectionPriors, PositionPriors, Priors, Rig, RotationPriors

DEG = np.pi / 180.0
NOISE = 1e-3
N_VIEWS = 20


def world(name: str = "street", d: int = 3, n: int = N_VIEWS, seed: int = 3, **options: Any) -> pp.SyntheticWorld:
    chosen: dict[str, Any] = {"noise_rad": NOISE, "outlier_fraction": 0.2, "orientations": "random", "n_points": 40 * n}
    return pp.simulate(name, n_views=n, seed=seed, dimension=d, **{**chosen, **options})  # type: ignore[arg-type]


def exp(phi: Float) -> Float:
    """Rotations by (n, 3) rotation vectors (Rodrigues)."""
    angle = np.maximum(np.linalg.norm(phi, axis=1), 1e-12)[:, None, None]
    x, y, z = phi.T
    o = np.zeros_like(x)
    cross = np.stack([np.stack(row, axis=1) for row in ([o, -z, y], [z, o, -x], [-y, x, o])], axis=1)
    found = np.eye(3) + np.sin(angle) / angle * cross + (1.0 - np.cos(angle)) / angle**2 * cross @ cross
    return np.asarray(found)


def camera_rms(scene: pp.Scene, truth: Any) -> float:
    return pp.evaluate(scene, truth).camera_rms


def from_truth(seen: pp.SyntheticWorld) -> pp.Scene:
    """The refinement that starts from the truth: the best that can be asked for."""
    start = pp.solve_positions(seen.tracks, seen.cam_from_world)
    good = replace(start, centers=seen.centers, points=seen.points)
    return pp.refine(seen.tracks, good)


def together(*worlds: pp.SyntheticWorld, spare_views: int = 0) -> tuple[pp.Tracks, Float]:
    """Worlds side by side that share nothing, and views that saw nothing; tracks and true centres."""
    view, track, n_views, n_tracks = [], [], 0, 0
    for w in worlds:
        view.append(w.tracks.view + n_views)
        track.append(w.tracks.track + n_tracks)
        n_views, n_tracks = n_views + w.tracks.n_views, n_tracks + w.tracks.n_tracks
    bearing = np.concatenate([w.tracks.bearing for w in worlds])
    nowhere = np.full((spare_views, bearing.shape[1]), np.nan)
    tracks = pp.Tracks.from_arrays(
        np.concatenate(view), np.concatenate(track), bearing, n_views=n_views + spare_views, n_tracks=n_tracks
    )
    return tracks, np.concatenate([*(w.centers for w in worlds), nowhere])


# unknown orientations


@pytest.mark.parametrize("d", [3, 2])
@pytest.mark.parametrize("name", ["street", "room", "box", "corridor"])
def test_as_good_as_from_the_truth(name: str, d: int) -> None:
    seen = world(name, d, **({"n_points": 200} if name == "box" else {}))
    scene = reconstruct_tracks(seen.tracks)
    assert scene.summary.status is pp.Status.CONVERGED
    assert scene.summary.n_solved_views == N_VIEWS
    assert (scene.inlier & seen.outlier).sum() < 0.03 * seen.outlier.sum()
    assert (scene.inlier & ~seen.outlier).sum() > 0.97 * (~seen.outlier).sum()
    assert camera_rms(scene, seen) <= 1.1 * camera_rms(from_truth(seen), seen)
    assert scene.summary.sigma_rad == pytest.approx(NOISE, rel=0.1)


def test_orientations_are_found_up_to_one_turn() -> None:
    seen = world("room")
    scene = reconstruct_tracks(seen.tracks)
    world_from_scene = pp.evaluate(scene, seen).alignments[0].world_from_scene
    off = scene.cam_from_world @ world_from_scene.T - seen.cam_from_world
    assert np.linalg.norm(off, axis=(1, 2)).max() / np.sqrt(2.0) < 0.2 * DEG
    plane = world("room", 2)
    found = reconstruct_tracks(plane.tracks)
    turn = pp.evaluate(found, plane).alignments[0].world_from_scene
    off_rad = found.cam_from_world + np.arctan2(turn[1, 0], turn[0, 0]) - plane.cam_from_world
    assert np.abs(np.angle(np.exp(1j * off_rad))).max() < 0.2 * DEG


@pytest.mark.parametrize("d", [3, 2])
def test_rough_orientations(d: int) -> None:
    seen = world(d=d, orientation_error_rad=3.0 * DEG)
    scene = reconstruct_tracks(seen.tracks, seen.cam_from_world)
    exact = world(d=d)
    assert scene.summary.status is pp.Status.CONVERGED
    assert camera_rms(scene, seen) <= 1.1 * camera_rms(from_truth(exact), exact)
    # what was given errs by 3 degrees in each view, and so does their mean at most
    assert pp.evaluate(scene, seen).rotation_rad < 3.0 * DEG


# priors


def test_gravity_of_some_views_puts_z_up() -> None:
    seen = world()
    rng = np.random.default_rng(0)
    up = np.einsum("nij,nj->ni", exp(0.5 * DEG * rng.normal(size=(N_VIEWS, 3))), seen.cam_from_world[:, :, 2])
    up *= rng.uniform(1.0, 9.81, (N_VIEWS, 1))
    up[::3] = np.nan
    up[1, 0] = np.nan
    for start in (None, seen.cam_from_world):
        scene = reconstruct_tracks(seen.tracks, start, gravity=up)
        assert scene.summary.status is pp.Status.CONVERGED
        assert np.arccos(pp.evaluate(scene, seen).alignments[0].world_from_scene[2, 2]) < 1.0 * DEG
    nothing = reconstruct_tracks(seen.tracks, gravity=np.full((N_VIEWS, 3), np.nan))
    np.testing.assert_allclose(nothing.centers, reconstruct_tracks(seen.tracks).centers, atol=1e-6)


@pytest.mark.parametrize("d", [3, 2])
def test_rotation_priors_turn_the_world(d: int) -> None:
    seen = world(d=d)
    views = np.arange(0, N_VIEWS, 5)
    priors = Priors(rotations=RotationPriors.of(views, seen.cam_from_world[views], sigma_rad=0.2 * DEG))
    scene = reconstruct_tracks(seen.tracks, priors=priors)
    assert scene.summary.status is pp.Status.CONVERGED
    assert pp.evaluate(scene, seen).rotation_rad < 0.5 * DEG


def test_a_direction_in_the_plane_turns_the_world() -> None:
    seen = world(d=2)
    sun = np.array([np.cos(2.0), np.sin(2.0)])
    angle = 2.0 - seen.cam_from_world
    priors = Priors(directions=DirectionPriors.of([3], np.stack([np.cos(angle), np.sin(angle)], 1)[3:4], sun, 0.01))
    scene = reconstruct_tracks(seen.tracks, priors=priors)
    assert pp.evaluate(scene, seen).rotation_rad < 1.0 * DEG


@pytest.mark.parametrize("d", [3, 2])
def test_position_priors_put_the_scene_in_place(d: int) -> None:
    seen = world(d=d)
    rng = np.random.default_rng(1)
    views = np.arange(0, N_VIEWS, 3)
    known = 1000.0 + seen.centers[views] + rng.normal(0.0, 0.02, (len(views), d))
    scene = reconstruct_tracks(seen.tracks, priors=Priors(positions=PositionPriors.of(views, known, sigma=0.02)))
    assert scene.summary.status is pp.Status.CONVERGED
    assert np.linalg.norm(scene.centers - 1000.0 - seen.centers, axis=1).max() < 0.1


def test_positions_and_gravity_together() -> None:
    # gravity alone leaves the heading free: the start must be turned about the vertical, through any angle
    seen = world()
    positions = PositionPriors.of(np.arange(N_VIEWS), seen.centers, sigma=0.01)
    scene = reconstruct_tracks(seen.tracks, priors=Priors(positions=positions), gravity=seen.cam_from_world[:, :, 2])
    assert np.linalg.norm(scene.centers - seen.centers, axis=1).max() < 0.02


def test_positions_on_a_line_and_gravity() -> None:
    # neither fixes the turn alone
    seen = world("line")
    positions = PositionPriors.of(np.arange(N_VIEWS), seen.centers, sigma=0.01)
    scene = reconstruct_tracks(seen.tracks, priors=Priors(positions=positions), gravity=seen.cam_from_world[:, :, 2])
    assert np.linalg.norm(scene.centers - seen.centers, axis=1).max() < 0.02
    off = scene.cam_from_world - seen.cam_from_world
    assert np.linalg.norm(off, axis=(1, 2)).max() / np.sqrt(2.0) < 0.5 * DEG


def test_priors_of_nothing_and_of_views_that_are_lost() -> None:
    seen = world()
    none = np.zeros(0, dtype=int)
    empty = Priors(
        rotations=RotationPriors.of(none, np.zeros((0, 3, 3)), sigma_rad=0.1),
        positions=PositionPriors.of(none, np.zeros((0, 3)), sigma=0.1),
    )
    free = reconstruct_tracks(seen.tracks)
    np.testing.assert_array_equal(reconstruct_tracks(seen.tracks, priors=empty).centers, free.centers)
    lost = Priors(
        rotations=RotationPriors.of([5], seen.cam_from_world[5:6], sigma_rad=0.1),
        positions=PositionPriors.of([5], seen.centers[5:6], sigma=0.1),
    )
    scene = reconstruct_tracks(seen.tracks.select(seen.tracks.view != 5), priors=lost)
    assert np.flatnonzero(scene.view_component < 0).tolist() == [5]
    assert camera_rms(scene, seen) < 2.0 * camera_rms(free, seen)


def test_a_refinement_turns_its_start_to_the_priors_and_leaves_what_is_free() -> None:
    seen = world(outlier_fraction=0.0)
    scene = pp.refine(seen.tracks, pp.solve_positions(seen.tracks, seen.cam_from_world))
    turn = exp(np.array([[0.3, -2.0, 1.0]]))[0]
    turned = replace(scene, centers=scene.centers @ turn.T, cam_from_world=scene.cam_from_world @ turn.T)
    turned = replace(turned, points=scene.points @ turn.T)
    every = np.arange(N_VIEWS)
    whole = Priors(rotations=RotationPriors.of(every, seen.cam_from_world, sigma_rad=0.01))
    places = Priors(positions=PositionPriors.of(every, seen.centers, sigma=0.1))
    for priors in (whole, places, Priors(rotations=whole.rotations, positions=places.positions)):
        back = pp.refine(seen.tracks, turned, pp.RefineOptions(priors=priors))
        np.testing.assert_allclose(back.cam_from_world, seen.cam_from_world, atol=5e-3)
        assert back.summary.status is pp.Status.CONVERGED
        assert back.summary.iterations <= 6
    up = DirectionPriors.gravity(every, seen.cam_from_world[:, :, 2], 0.01)
    level = pp.refine(seen.tracks, scene, pp.RefineOptions(priors=Priors(directions=up)))
    np.testing.assert_allclose(level.cam_from_world, scene.cam_from_world, atol=2e-3)


# rigs


def rig_walk(n: int, seed: int, baseline: float = 0.3) -> tuple[pp.SyntheticWorld, pp.Tracks, Rig]:
    """A street walk in steps of 1 m with two sensors, one turned by a right angle; a tenth of the bearings is wrong."""
    seen = pp.simulate("street", n_views=n, n_points=30 * n, seed=seed, orientations="random", depth_max_m=30)
    rng = np.random.default_rng(seed)
    view, track, rotation = seen.tracks.view, seen.tracks.track, seen.cam_from_world
    sensor = rng.integers(0, 2, len(view))
    center = np.array([[0.0, 0.0, 0.0], [baseline, 0.0, 0.0]])
    ray = seen.points[track] - seen.centers[view] - np.einsum("nji,nj->ni", rotation[view], center[sensor])
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    ray += rng.normal(0.0, NOISE, ray.shape)
    wrong = rng.random(len(ray)) < 0.1
    ray[wrong] = rng.normal(size=(wrong.sum(), 3))
    bearing = np.einsum("nij,nj->ni", rotation[view], ray / np.linalg.norm(ray, axis=1, keepdims=True))
    tracks = pp.Tracks.from_arrays(view, track, bearing, n, seen.tracks.n_tracks)
    turned = exp(np.array([[0.0, 0.0, 0.0], [0.0, np.pi / 2, 0.0]]))
    return seen, tracks, Rig.of(sensor, turned, center)


def test_a_rig_gives_metres() -> None:
    seen, tracks, rig = rig_walk(N_VIEWS, 3)
    scene = reconstruct_tracks(tracks, rig=rig)
    found = pp.evaluate(scene, seen)
    assert scene.summary.status is pp.Status.CONVERGED
    assert found.scale == pytest.approx(1.0, rel=0.02)
    assert found.camera_rms < 0.01


def test_each_part_of_a_rig_walk_is_in_metres() -> None:
    seen, tracks, rig = rig_walk(16, 3)
    other, tracks_2, rig_2 = rig_walk(10, 9, baseline=0.3)
    both, _ = together(replace(seen, tracks=tracks), replace(other, tracks=tracks_2))
    sensors = Rig.of(np.concatenate((rig.sensor, rig_2.sensor)), rig.sensor_from_rig, rig.center)
    # the second part starts eight times too large against the first
    start = place_views(both, orient_views(both))
    factor = np.array([1.0, 8.0])
    uneven = replace(
        start,
        centers=start.centers * factor[start.view_component][:, None],
        points=start.points * factor[start.track_component][:, None],
    )
    scene = pp.refine(both, metric_scale(both, uneven, sensors), rig=sensors)
    truth = np.concatenate((seen.centers, other.centers))
    assert [fit.scale for fit in pp.evaluate(scene, truth).alignments] == pytest.approx([1.0, 1.0], rel=0.03)


def test_a_rig_without_baselines_has_no_size() -> None:
    _, tracks, rig = rig_walk(8, 3)
    oriented = orient_views(tracks)
    start = place_views(tracks, oriented)
    flat = Rig.of(rig.sensor, rig.sensor_from_rig, np.ones((2, 3)))
    assert metric_scale(tracks, start, flat) is start


# what is not determined


@pytest.mark.parametrize("d", [3, 2])
def test_parts_that_share_nothing(d: int) -> None:
    large, small = world("room", d, 16), world("room", d, 10, seed=9)
    tracks, centers = together(small, large, spare_views=2)
    start = place_views(tracks, orient_views(tracks))
    scene = reconstruct_tracks(tracks)
    for found in (start, scene):
        assert found.summary.status is pp.Status.DISCONNECTED
        assert found.view_component.tolist() == [1] * 10 + [0] * 16 + [-1] * 2
        assert (found.summary.n_solved_views, found.n_components, found.summary.n_components) == (26, 2, 2)
    assert camera_rms(scene, centers) < 2.0 * NOISE
    assert np.isnan(scene.centers[-2:]).all()
    assert np.isnan(scene.cam_from_world[-2:]).all()


@pytest.mark.parametrize("d", [3, 2])
def test_views_that_see_too_little_are_left_out(d: int, tmp_path: Path) -> None:
    seen = world(d=d, outlier_fraction=0.0)
    keep: Bool = np.ones(len(seen.tracks), dtype=np.bool_)
    for view, left in ((4, 2), (11, 1), (15, 0)):
        keep[np.flatnonzero(seen.tracks.view == view)[left:]] = False
    scene = reconstruct_tracks(seen.tracks.select(keep))
    lost = [4, 11, 15]
    assert np.flatnonzero(scene.view_component < 0).tolist() == lost
    assert np.isnan(scene.centers[lost]).all()
    assert np.isnan(scene.cam_from_world[lost]).all()
    assert np.isfinite(np.delete(scene.cam_from_world, lost, axis=0)).all()
    # and it can be written and read again
    pp.write_scene(scene, tmp_path / "out")
    again = pp.read_scene(tmp_path / "out")
    np.testing.assert_array_equal(again.centers, scene.centers)
    np.testing.assert_array_equal(again.cam_from_world, scene.cam_from_world)


@pytest.mark.parametrize("d", [3, 2])
@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_pure_rotation_is_never_a_path(d: int, wrong: float) -> None:
    rng = np.random.default_rng(5)
    n, m = 12, 150
    view, track = np.repeat(np.arange(n), m), np.tile(np.arange(m), n)
    far = rng.normal(size=(m, d))
    far /= np.linalg.norm(far, axis=1, keepdims=True)
    if d == 3:
        bearing = np.einsum("nij,nj->ni", exp(rng.normal(size=(n, 3)))[view], far[track])
    else:
        angle = np.arctan2(far[track, 1], far[track, 0]) - rng.uniform(-np.pi, np.pi, n)[view]
        bearing = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    bearing += rng.normal(0.0, NOISE, bearing.shape)
    false = rng.random(len(bearing)) < wrong
    bearing[false] = rng.normal(size=(false.sum(), d))
    bearing /= np.linalg.norm(bearing, axis=1, keepdims=True)
    scene = reconstruct_tracks(pp.Tracks.from_arrays(view, track, bearing))
    assert scene.summary.status in {pp.Status.AMBIGUOUS, pp.Status.UNDETERMINED}


@pytest.mark.parametrize("d", [3, 2])
def test_next_to_nothing_is_undetermined(d: int) -> None:
    unit = np.eye(d)
    for view, track, bearing in (
        ([0], [0], unit[:1]),
        ([0, 1], [0, 0], unit[:2]),
        ([0] * d, range(d), unit),
        ([0, 1], [0, 1], unit[:2]),
    ):
        tracks = pp.Tracks.from_arrays(view, list(track), bearing, n_views=5, n_tracks=7)
        scene = reconstruct_tracks(tracks)
        assert scene.summary.status is pp.Status.UNDETERMINED
        assert scene.n_components == 0
        assert np.isnan(scene.centers).all()
        assert np.isnan(scene.points).all()
        assert np.isnan(scene.cam_from_world).all()


def test_order_and_repetition_of_observations_do_not_matter() -> None:
    seen = world(outlier_fraction=0.0)
    rows = np.random.default_rng(2).permutation(np.append(np.arange(len(seen.tracks)), np.arange(100)))
    tracks = pp.Tracks.from_arrays(seen.tracks.view[rows], seen.tracks.track[rows], seen.tracks.bearing[rows])
    scene = reconstruct_tracks(tracks)
    assert camera_rms(scene, seen) < 1.2 * camera_rms(from_truth(seen), seen)


@pytest.mark.parametrize("d", [3, 2])
def test_the_same_bytes_on_any_number_of_threads(d: int) -> None:
    seen = world(d=d)
    up = seen.cam_from_world[:, :, 2] if d == 3 else None

    def run(threads: int) -> bytes:
        options = ReconstructOptions(
            positions=pp.PositionOptions(threads=threads), refine=pp.RefineOptions(threads=threads)
        )
        scene = reconstruct_tracks(seen.tracks, gravity=up, options=options)
        arrays = (scene.centers, scene.points, scene.cam_from_world, scene.inlier, scene.residual_rad)
        return b"".join(a.tobytes() for a in arrays)

    one = run(1)
    assert run(4) == one
    assert run(1) == one


# control


def test_control_turns_and_sizes_each_part() -> None:
    large, small = world("room", 3, 16), world("room", 3, 10, seed=9)
    tracks, centers = together(small, large)
    scene = reconstruct_tracks(tracks)
    control = pp.Control(views={v: centers[v].tolist() for v in (0, 3, 6, 9, 10, 14, 18, 22)})
    fitted = fit_to_control(scene, control)
    assert np.linalg.norm(fitted.centers - centers, axis=1).max() < 0.05
    off = fitted.cam_from_world - np.concatenate((small.cam_from_world, large.cam_from_world))
    assert np.linalg.norm(off, axis=(1, 2)).max() / np.sqrt(2.0) < 2.0 * DEG
    plane = world("room", 2)
    turned = fit_to_control(
        reconstruct_tracks(plane.tracks), pp.Control(views={v: plane.centers[v].tolist() for v in (1, 7, 19)})
    )
    assert np.abs(np.angle(np.exp(1j * (turned.cam_from_world - plane.cam_from_world)))).max() < 1.0 * DEG


def test_control_on_a_line_and_without_a_turn() -> None:
    seen = world("room", outlier_fraction=0.0)
    scene = pp.solve_positions(seen.tracks, seen.cam_from_world)
    truth = pp.evaluate(scene, seen, alignment="translation_scale").aligned_centers
    yaw = exp(np.array([[0.0, 0.0, 2.0]]))[0]
    # two positions: the turn about their line stays, so that level stays level
    a, b = seen.centers[[0, -1]] * [1.0, 1.0, 0.0] @ yaw.T
    flat = replace(scene, centers=scene.centers * [1.0, 1.0, 0.0])
    ends = fit_to_control(flat, pp.Control(views={0: a.tolist(), N_VIEWS - 1: b.tolist()}))
    np.testing.assert_allclose(ends.centers[:, 2], 0.0, atol=1e-6)
    up = np.einsum("nij,nj->ni", ends.cam_from_world, np.tile([0.0, 0.0, 1.0], (N_VIEWS, 1)))
    np.testing.assert_allclose(up, seen.cam_from_world[:, :, 2], atol=1e-5)
    # shift and scale alone: the turn of the positions is left over
    views: dict[str | int, Any] = {v: (5.0 + 3.0 * truth[v]).tolist() for v in (0, 7, 19)}
    unturned = fit_to_control(scene, pp.Control(views=views, rotation=False))
    np.testing.assert_allclose(unturned.centers, 5.0 + 3.0 * truth, atol=0.1)
    np.testing.assert_array_equal(unturned.cam_from_world, scene.cam_from_world)
    # all in one place: no scale
    same = fit_to_control(scene, pp.Control(views={0: (9.0, 9.0, 9.0), 1: (9.0, 9.0, 9.0)}))
    np.testing.assert_allclose(same.centers[:2].mean(axis=0), 9.0)
    np.testing.assert_allclose(same.centers - same.centers[0], scene.centers - scene.centers[0])


def test_control_and_gravity_at_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    seen = world(n=12)
    write_tracks(seen.tracks, tmp_path / "b.csv")
    rows = [f"{v},{x},{y},{z}" for v, (x, y, z) in enumerate(seen.centers.tolist()) if v % 3 == 0]
    (tmp_path / "control.csv").write_text("\n".join(["view,x,y,z", *rows]) + "\n")
    up = [f"{v},{x},{y},{z}" for v, (x, y, z) in enumerate((9.8 * seen.cam_from_world[:, :, 2]).tolist()) if v != 5]
    (tmp_path / "up.csv").write_text("\n".join(["view,x,y,z", *up]) + "\n")

    def run(*arguments: str) -> int:
        with pytest.raises(SystemExit) as ended:
            main(["solve", str(tmp_path / "b.csv"), "--no-plots", "--quiet", *arguments])
        assert not capsys.readouterr().out
        return int(ended.value.code or 0)

    out = tmp_path / "out"
    assert run("--unknown-orientation", "--control", str(tmp_path / "control.csv"), "-o", str(out)) == 0
    scene = pp.read_scene(out)
    assert np.linalg.norm(scene.centers - seen.centers, axis=1).max() < 0.1
    assert run("--unknown-orientation", "--gravity", str(tmp_path / "up.csv"), "-o", str(out)) == 0
    level = pp.evaluate(pp.read_scene(out), seen).alignments[0].world_from_scene
    assert np.arccos(level[2, 2]) < 1.0 * DEG
    before = sorted(path.name for path in out.iterdir())
    assert run("--gravity", str(tmp_path / "up.csv"), "-o", str(out)) == 2
    assert run("--unknown-orientation", "--refine", "-o", str(out)) == 2
    assert run("--unknown-orientation", "--gravity", str(tmp_path / "none.csv"), "-o", str(tmp_path / "new")) == 2
    (tmp_path / "up.csv").write_text("view,x,y,z\n0,0,0,0\n")
    assert run("--unknown-orientation", "--gravity", str(tmp_path / "up.csv"), "-o", str(tmp_path / "new")) == 2
    assert not (tmp_path / "new").exists()
    assert sorted(path.name for path in out.iterdir()) == before


# errors


def seen_twice() -> pp.SyntheticWorld:
    return world(n=4, n_points=40)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"orientations": np.eye(3)}, r"cam_from_world has shape \(3, 3\), expected \(4, 3, 3\)"),
        ({"orientations": np.full((4, 3, 3), np.nan)}, r"cam_from_world\[0\] is not finite"),
        ({"gravity": np.zeros((3, 3))}, r"gravity has shape \(3, 3\), expected \(4, 3\)"),
        ({"gravity": np.zeros((4, 3))}, r"gravity\[0\] has length 0"),
        ({"gravity": "up"}, "gravity"),
        (
            {
                "gravity": np.tile([0.0, 0.0, 1.0], (4, 1)),
                "priors": Priors(directions=DirectionPriors.gravity([0], [[0.0, 0.0, 1.0]], 0.1)),
            },
            "gravity and priors.directions are both given",
        ),
        (
            {"priors": Priors(positions=PositionPriors.of([1, 4], np.zeros((2, 3)), sigma=1.0))},
            "position_priors: entry 1 names view 4 of 4",
        ),
        (
            {"priors": Priors(rotations=RotationPriors.of([9], np.eye(3)[None], sigma_rad=1.0))},
            "rotation_priors: entry 0 names view 9 of 4",
        ),
        (
            {"priors": Priors(rotations=RotationPriors.of([1], [0.5], sigma_rad=1.0))},
            "rotation_priors have 2 coordinates",
        ),
        ({"priors": Priors(positions=PositionPriors.of([0, 1], np.eye(2), sigma=1.0))}, "2 coordinates"),
        ({"priors": [1.0]}, "priors is a list, expected Priors"),
        ({"options": 3}, "options is a int, expected ReconstructOptions"),
        ({"tracks": 3}, "tracks is a int, expected Tracks"),
        (
            {"options": ReconstructOptions(positions=pp.PositionOptions(gauge="paper"))},
            "options.positions.gauge is 'paper', expected 'normalized'",
        ),
        ({"rig": Rig.of([0], np.eye(3)[None], np.zeros((1, 3)))}, "rig.sensor has 1 entries"),
        ({"rig": 3}, "rig is a int, expected Rig"),
    ],
)
def test_errors_name_the_argument(changes: dict[str, Any], message: str) -> None:
    given = {"tracks": seen_twice().tracks, **changes}
    with pytest.raises(pp.InputError, match=message):
        reconstruct_tracks(**given)


def test_gravity_belongs_to_space() -> None:
    plane = world(d=2, n=4, n_points=40)
    with pytest.raises(pp.InputError, match=r"gravity has shape \(4, 3\).* in space"):
        reconstruct_tracks(plane.tracks, gravity=np.zeros((4, 3)))


def test_control_must_know_something() -> None:
    seen = seen_twice()
    scene = pp.solve_positions(seen.tracks, seen.cam_from_world)
    with pytest.raises(pp.InputError, match="fewer than two"):
        fit_to_control(scene, pp.Control(views={0: (0.0, 0.0, 0.0)}))
    with pytest.raises(pp.InputError, match="does not know its tracks"):
        fit_to_control(replace(scene, tracks=None), pp.Control(views={0: (0.0, 0.0, 0.0), 1: (1.0, 0.0, 0.0)}))


def test_no_part_is_oriented() -> None:
    seen = seen_twice()
    none = ViewOrientations(np.full((4, 3, 3), np.nan), np.full(4, -1, dtype=np.int32))
    scene = place_views(seen.tracks, none)
    assert scene.summary.status is pp.Status.UNDETERMINED
    assert scene.n_components == 0
