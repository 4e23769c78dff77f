"""Which way is up: gravity before the cameras' axes, these before the plane of the path, and nothing made up."""

from __future__ import annotations

import numpy as np
import panopath as pp
import pytest
from panopath.formats.structure import known_scene
from panopath.model import Float
from panopath.moves import moved_scene
from panopath.upright import UpSource, find_up, make_upright, rotation_to_z

#: Camera axes of an upright camera that looks along x: x right, y down, z forward.
UPRIGHT = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def turn(vector: Float) -> Float:
    angle = float(np.linalg.norm(vector))
    k = np.cross(np.eye(3), vector / max(angle, 1e-300))
    return np.asarray(np.eye(3) - np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k)


def scene_of(tilt_rad: float, centers: Float, seed: int = 0) -> pp.Scene:
    """Upright cameras of any heading, each tilted at random, in a world turned upside down and askew."""
    rng = np.random.default_rng(seed)
    n = len(centers)
    points = rng.normal(0.0, 5.0, (30, 3))
    view, track = np.repeat(np.arange(n), 30), np.tile(np.arange(30), n)
    rotation = np.array(
        [turn(rng.normal(0.0, tilt_rad, 3)) @ UPRIGHT @ turn(np.array([0, 0, rng.uniform(0, 6)])) for _ in range(n)]
    )
    ray = points[track] - centers[view]
    bearing = np.einsum("nkc,nc->nk", rotation[view], ray / np.linalg.norm(ray, axis=1, keepdims=True))
    scene = known_scene(pp.Tracks.from_arrays(view, track, bearing), rotation, centers, points)
    return moved_scene(scene, turn(np.array([2.8, 0.4, 0.2])), 1.0, (1.0, 2.0, 3.0))


def path(n: int = 40, height: float = 0.05) -> Float:
    t = np.linspace(0.0, 3.0, n)
    return np.column_stack((5.0 * np.cos(t), 5.0 * np.sin(t), height * np.sin(7.0 * t)))


WORLD_UP = turn(np.array([2.8, 0.4, 0.2]))[:, 2]


def angle_to_truth(direction: Float) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(direction, WORLD_UP)), direction @ WORLD_UP)))


def test_camera_axes() -> None:
    scene = scene_of(0.1, path())
    (up,) = find_up(scene)
    assert up.source is UpSource.CAMERA_AXES
    assert angle_to_truth(up.direction) < 3.0
    assert 0.02 < up.spread_rad < 0.3
    assert "cameras call up" in up.sentence()


def test_cameras_that_hang_askew_do_not_move_it() -> None:
    scene = scene_of(0.01, path())
    rotation = scene.cam_from_world.copy()
    rotation[::5] = turn(np.array([1.4, 0.0, 0.3])) @ rotation[::5]
    askew = moved_scene(pp.Scene(**{**scene.__dict__, "cam_from_world": rotation}))
    assert angle_to_truth(find_up(askew)[0].direction) < 1.0


def test_gravity_comes_first() -> None:
    scene = scene_of(0.4, path())
    gravity = scene.cam_from_world @ WORLD_UP
    gravity[7:] = np.nan
    gravity[0] *= 9.81
    (up,) = find_up(scene, gravity)
    assert (up.source, up.n_views) == (UpSource.GRAVITY, 7)
    assert angle_to_truth(up.direction) < 1e-5


def test_the_plane_of_motion_where_cameras_are_turned_every_way() -> None:
    scene = scene_of(3.0, path())
    (up,) = find_up(scene)
    assert up.source is UpSource.MOTION_PLANE
    assert min(angle_to_truth(up.direction), angle_to_truth(-up.direction)) < 2.0


def test_nothing_is_made_up() -> None:
    """Cameras turned every way on a straight path, or one that goes everywhere."""
    straight = np.column_stack((np.linspace(0, 9, 30), np.zeros(30), np.zeros(30)))
    everywhere = np.random.default_rng(0).normal(0.0, 1.0, (30, 3))
    for centers in (straight, everywhere, np.zeros((30, 3))):
        scene = scene_of(3.0, centers, seed=4)
        (up,) = find_up(scene)
        assert up.source is UpSource.UNKNOWN
        assert np.array_equal(make_upright(scene, (up,)).centers, scene.centers)


def test_make_upright() -> None:
    scene = scene_of(0.02, path())
    level = make_upright(scene, find_up(scene))
    assert np.ptp(level.centers[:, 2]) < 0.3
    assert np.allclose(level.centers.mean(axis=0), scene.centers.mean(axis=0))
    assert find_up(level)[0].direction[2] > 1.0 - 1e-12
    # what the cameras see is untouched
    before = np.einsum("nkc,nc->nk", scene.cam_from_world, scene.points[0] - scene.centers)
    after = np.einsum("nkc,nc->nk", level.cam_from_world, level.points[0] - level.centers)
    assert np.allclose(before, after)


@pytest.mark.parametrize(
    "direction", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (1e-9, 0, -1), (1e-200, 0, -1), (3, -4, -1e-3)]
)
def test_rotation_to_z(direction: tuple[float, float, float]) -> None:
    found = rotation_to_z(direction)
    assert np.allclose(found @ found.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found) == pytest.approx(1.0)
    assert np.allclose(found @ direction / np.linalg.norm(direction), (0, 0, 1), atol=1e-12)


def test_refuses(planar: pp.SyntheticWorld) -> None:
    with pytest.raises(pp.InputError, match="direction"):
        rotation_to_z((0.0, 0.0, 0.0))
    with pytest.raises(pp.InputError, match="planar"):
        find_up(known_scene(planar.tracks, planar.cam_from_world, planar.centers, planar.points))
    scene = scene_of(0.1, path())
    with pytest.raises(pp.InputError, match="gravity has shape"):
        find_up(scene, np.zeros((3, 3)))
    with pytest.raises(pp.InputError, match=r"gravity\[2\]"):
        find_up(scene, np.where(np.arange(40)[:, None] == 2, 0.0, 1.0) * np.ones(3))
    with pytest.raises(pp.InputError, match="scale"):
        moved_scene(scene, scale=0.0)


def test_views_without_a_pose_take_no_part() -> None:
    scene = scene_of(0.1, path())
    rotation, component, centers = scene.cam_from_world.copy(), scene.view_component.copy(), scene.centers.copy()
    rotation[3], component[3], centers[3] = np.nan, -1, np.nan
    holed = pp.Scene(**{**scene.__dict__, "cam_from_world": rotation, "view_component": component, "centers": centers})
    (up,) = find_up(holed)
    assert up.n_views == 39
    assert np.isnan(make_upright(holed, (up,)).cam_from_world[3]).all()
