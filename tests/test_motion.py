"""Mean motion through Python: frames, headings, gravity, time, errors. The core's own tests are in Rust."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import numpy.typing as npt
import panopath as pp
import pytest
from panopath.model import Float


def about_z(angles: npt.ArrayLike) -> Float:
    """Matrices of rotation about z by each angle."""
    angle_rad = np.asarray(angles, dtype=np.float64)
    matrices = np.zeros((len(angle_rad), 3, 3))
    matrices[:, 0, 0] = matrices[:, 1, 1] = np.cos(angle_rad)
    matrices[:, 1, 0] = np.sin(angle_rad)
    matrices[:, 0, 1] = -matrices[:, 1, 0]
    matrices[:, 2, 2] = 1.0
    return matrices


def stars(cam_from_world: Float, seed: int = 0, **extra: object) -> pp.Tracks:
    """Nine fixed directions as every view sees them."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(9, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    bearing = np.einsum("nij,mj->nmi", cam_from_world, direction).reshape(-1, 3)
    n = len(cam_from_world)
    return pp.Tracks.from_arrays(np.repeat(np.arange(n), 9), np.tile(np.arange(9), n), bearing, **extra)  # type: ignore[arg-type]


def test_a_turning_camera_is_followed_exactly() -> None:
    heading = np.linspace(0.0, 5.0, 12)
    truth = about_z(-heading)
    motion = pp.mean_motion(stars(truth))
    assert motion.status is pp.Status.CONVERGED
    np.testing.assert_allclose(motion.cam_from_world, truth, atol=1e-13)
    np.testing.assert_allclose(motion.turn, truth[1:] @ truth[:-1].transpose(0, 2, 1), atol=1e-13)
    np.testing.assert_allclose(motion.turn_rate_rad_s, np.diff(heading), atol=1e-12)
    assert list(motion.step_from) == list(range(11))
    assert list(motion.step_to) == list(range(1, 12))
    assert (motion.n_common == 9).all()
    assert (motion.residual_rad < 1e-12).all()
    for field in fields(motion):
        value = getattr(motion, field.name)
        assert not isinstance(value, np.ndarray) or not value.flags.writeable


def test_headings_of_the_plane_grow_when_the_camera_turns_left() -> None:
    heading = np.array([0.0, 0.3, 3.2, 6.5, 6.0])
    angle = np.linspace(-3.0, 3.0, 20)[None, :] - heading[:, None]
    view, track = np.repeat(np.arange(5), 20), np.tile(np.arange(20), 5)
    tracks = pp.Tracks.from_arrays(view, track, np.column_stack([np.cos(angle.ravel()), np.sin(angle.ravel())]))
    for flow in ("sphere", "horizon"):
        motion = pp.mean_motion(tracks, pp.MotionOptions(flow=flow))
        np.testing.assert_allclose(np.exp(1j * motion.cam_from_world), np.exp(1j * heading), atol=1e-12)
        np.testing.assert_allclose(np.exp(1j * motion.turn), np.exp(1j * np.diff(heading)), atol=1e-12)
    # the same rule as that of a file of headings: the scene comes out unturned
    assert motion.cam_from_world.shape == (5,)


def test_time_orders_the_views_and_gives_the_rate() -> None:
    time_s = np.array([4.0, 0.0, 2.0, np.nan])
    truth = about_z(-0.1 * np.array([4.0, 0.0, 2.0, 9.0]))
    motion = pp.mean_motion(stars(truth, time_s=time_s))
    assert list(motion.step_from) == [1, 2]
    assert list(motion.step_to) == [2, 0]
    np.testing.assert_allclose(motion.turn_rate_rad_s, 0.1, atol=1e-13)
    assert list(motion.view_component) == [0, 0, 0, -1]
    assert np.isnan(motion.cam_from_world[3]).all()
    assert motion.status is pp.Status.DISCONNECTED
    by_index = pp.mean_motion(stars(truth, time_s=time_s), pp.MotionOptions(order="index"))
    assert list(by_index.step_from) == [0, 1, 2]
    assert by_index.status is pp.Status.CONVERGED


def test_gravity_leaves_one_freedom() -> None:
    rng = np.random.default_rng(1)
    tilt = np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(6)])
    tilt *= np.linalg.det(tilt)[:, None, None]
    truth = tilt @ about_z(0.5 * np.arange(6))
    motion = pp.mean_motion(stars(truth), pp.MotionOptions(vertical=truth[:, :, 2]))
    np.testing.assert_allclose(motion.cam_from_world[:, :, 2], truth[:, :, 2], atol=1e-13)
    world_from_map = truth.transpose(0, 2, 1) @ motion.cam_from_world
    np.testing.assert_allclose(world_from_map, np.broadcast_to(world_from_map[0], (6, 3, 3)), atol=1e-12)
    upright = about_z(0.5 * np.arange(6))
    np.testing.assert_allclose(
        pp.mean_motion(stars(upright), pp.MotionOptions(vertical="upright")).cam_from_world, upright, atol=1e-13
    )


def test_adiabatic_walk_needs_nothing_else() -> None:
    # steps of a thousandth of the nearest distance: the mean motion is as good as a compass
    world = pp.simulate(
        "street", n_views=40, n_points=2000, seed=2, spacing_m=1e-3, orientations="random", noise_rad=1e-4
    )
    motion = pp.mean_motion(world.tracks)
    scene = pp.solve_positions(world.tracks, motion.cam_from_world)
    assert scene.summary.status.is_determined
    world_from_map = world.cam_from_world.transpose(0, 2, 1) @ motion.cam_from_world
    error = np.linalg.norm(world_from_map - world_from_map[0], axis=(1, 2)) / np.sqrt(2.0)
    assert error.max() < np.radians(0.1)


def test_fine_tuning_brings_orientations_nearer() -> None:
    world = pp.simulate("box", n_views=8, n_points=60, seed=3)
    orientations = about_z(np.radians(np.linspace(-2.0, 2.0, 8)))  # wrong by up to two degrees
    for _ in range(30):
        scene = pp.solve_positions(world.tracks, orientations)
        orientations = pp.fit_rotations(world.tracks, scene)
    worst = np.degrees(np.abs(orientations - orientations[0]).max())
    assert worst < 1.0
    np.testing.assert_allclose(
        pp.fit_rotations(world.tracks, (world.centers, world.points), orientations),
        np.broadcast_to(np.eye(3), (8, 3, 3)),
        atol=1e-12,
    )


def test_planar_rotations_are_fitted() -> None:
    world = pp.simulate("box", n_views=5, n_points=30, seed=4, dimension=2, orientations="random")
    found = pp.fit_rotations(world.tracks, (world.centers, world.points), np.zeros(5))
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * world.cam_from_world), atol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"flow": "optical"}, "flow is 'optical', expected one of 'sphere', 'horizon'"),
        ({"weighting": "l1"}, "weighting is 'l1'"),
        ({"order": "name"}, "order is 'name'"),
        ({"share": 0.0}, r"share is 0\.0, expected a number above 0"),
        ({"share": float("nan")}, "share is nan"),
        ({"min_tracks": 0}, "min_tracks is 0"),
        ({"vertical": "down"}, "vertical is 'down'"),
    ],
)
def test_options_out_of_range_are_named(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        pp.MotionOptions(**wrong)  # type: ignore[arg-type]


def test_arguments_that_do_not_fit_are_named(planar: pp.SyntheticWorld) -> None:
    tracks = stars(about_z(np.zeros(3)))
    with pytest.raises(pp.InputError, match=r"vertical has shape \(2, 3\), expected \(3, 3\)"):
        pp.mean_motion(tracks, pp.MotionOptions(vertical=np.ones((2, 3))))
    with pytest.raises(pp.InputError, match=r"up\[1\] has length 0"):
        pp.mean_motion(tracks, pp.MotionOptions(vertical=[[0, 0, 1], [0, 0, 0], [0, 0, 1]]))
    with pytest.raises(pp.InputError, match="there is none in the plane"):
        pp.mean_motion(planar.tracks, pp.MotionOptions(vertical="upright"))
    with pytest.raises(pp.InputError, match="tracks is a list"):
        pp.mean_motion([])  # type: ignore[arg-type]
    with pytest.raises(pp.InputError, match="cam_from_world is None"):
        pp.fit_rotations(tracks, (np.zeros((3, 3)), np.ones((9, 3))))
    with pytest.raises(pp.InputError, match="centers has 2 rows, expected 3"):
        pp.fit_rotations(tracks, (np.zeros((2, 3)), np.ones((9, 3))), about_z(np.zeros(3)))
