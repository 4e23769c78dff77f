"""Covariances tell the size of the errors that refinement makes: normalised squared errors are one a freedom."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
import pytest
from panopath.formats.structure import known_scene

Float = npt.NDArray[np.float64]
NOISE = 1e-3


def log(rotations: Float) -> Float:
    """Rotation vectors of small turns."""
    off = rotations - rotations.transpose(0, 2, 1)
    axis = 0.5 * np.stack([off[:, 2, 1], off[:, 0, 2], off[:, 1, 0]], axis=1)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    return np.asarray(axis * np.arcsin(sine) / np.where(sine > 0, sine, 1.0))


def with_camera_turned(world: pp.SyntheticWorld, new_from_old: Float) -> pp.SyntheticWorld:
    """The same world, with the axes of every camera turned."""
    t = world.tracks
    bearing = t.bearing @ new_from_old.T
    tracks = pp.Tracks.from_arrays(t.view, t.track, bearing, n_views=t.n_views, n_tracks=t.n_tracks)
    return replace(world, tracks=tracks, cam_from_world=new_from_old @ world.cam_from_world)


def nees(world: pp.SyntheticWorld, view: int | None) -> tuple[float, float]:
    """Mean normalised squared error a freedom, of cameras and of points, after the fit that the gauge names."""
    start = known_scene(world.tracks, world.cam_from_world, world.centers, world.points)
    options = pp.RefineOptions(reject_outliers=False, huber_sigmas=np.inf)
    scene = pp.refine(world.tracks, start, options)
    found = pp.scene_covariance(world.tracks, scene, sigma_rad=NOISE, relative_to=view)
    if view is None:
        fit = pp.evaluate(scene, world).alignments[0]
        turn, scale, shift = fit.world_from_scene, fit.scale, fit.shift
    else:
        turn = world.cam_from_world[view].T @ scene.cam_from_world[view]
        arms, true_arms = (scene.centers - scene.centers[view]) @ turn.T, world.centers - world.centers[view]
        scale = (arms * true_arms).sum() / (arms * arms).sum()
        shift = world.centers[view] - scale * turn @ scene.centers[view]
    assert turn is not None
    centers, points = (scale * x @ turn.T + shift for x in (scene.centers, scene.points))
    turns = log(scene.cam_from_world @ turn.T @ world.cam_from_world.transpose(0, 2, 1))
    to_truth = np.zeros((6, 6))
    to_truth[:3, :3], to_truth[3:, 3:] = np.eye(3), scale * turn
    of_cameras = to_truth @ found.cameras @ to_truth.T
    of_points = scale * turn @ found.points @ (scale * turn).T
    others = np.arange(len(centers)) != (-1 if view is None else view)
    off = np.hstack([turns, centers - world.centers])[others]
    cameras = np.einsum("ni,nij,nj->n", off, np.linalg.inv(of_cameras[others]), off) / 6
    off = points - world.points
    return float(cameras.mean()), float((np.einsum("ni,nij,nj->n", off, np.linalg.inv(of_points), off) / 3).mean())


def towards(direction: Float, axis: Float) -> Float:
    """A rotation that takes one unit vector to another (Rodrigues)."""
    cross, cosine = np.cross(direction, axis), direction @ axis
    k = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
    return np.asarray(np.eye(3) + k + k @ k / (1.0 + cosine))


@pytest.mark.parametrize("view", [None, 3])
def test_errors_in_a_box_are_as_large_as_said(view: int | None) -> None:
    seen = [
        nees(pp.simulate("box", n_views=10, n_points=60, noise_rad=NOISE, seed=s, orientations="random"), view)
        for s in range(100)
    ]
    cameras, points = np.mean(seen, axis=0)
    assert 0.9 < cameras < 1.1
    assert 0.9 < points < 1.1


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (-1.0, 1e-3, 0.0)], ids=["at the pole", "across the seam"])
def test_errors_in_a_street_along_pole_and_seam_are_as_large_as_said(axis: tuple[float, float, float]) -> None:
    seen = []
    for seed in range(30):
        world = pp.simulate(
            "street", n_views=30, n_points=600, noise_rad=NOISE, seed=seed, depth_max_m=20.0, min_views=4
        )
        path = world.centers[-1] - world.centers[0]
        unit = np.array(axis) / np.linalg.norm(axis)
        turned = with_camera_turned(world, towards(path / np.linalg.norm(path), unit))
        # bearings crowd about the axis
        assert np.quantile(np.abs(turned.tracks.bearing @ unit), 0.5) > 0.5
        seen.append(nees(turned, None))
    cameras, points = np.mean(seen, axis=0)
    assert 0.9 < cameras < 1.1
    assert 0.9 < points < 1.1


def test_planar_covariances_have_planar_shapes(planar: pp.SyntheticWorld) -> None:
    scene = known_scene(planar.tracks, planar.cam_from_world, planar.centers, planar.points)
    found = pp.scene_covariance(planar.tracks, scene, sigma_rad=1e-3)
    assert found.cameras.shape == (6, 3, 3)
    assert found.points.shape == (20, 2, 2)
    assert (np.linalg.eigvalsh(found.points) > 0).all()
    np.testing.assert_allclose(found.cameras, found.cameras.transpose(0, 2, 1), atol=1e-18)
    assert not found.cameras.flags.writeable
    assert not found.points.flags.writeable


def test_covariances_grow_with_the_square_of_sigma(turned: pp.SyntheticWorld) -> None:
    scene = known_scene(turned.tracks, turned.cam_from_world, turned.centers, turned.points)
    one, two = (pp.scene_covariance(turned.tracks, scene, sigma_rad=s) for s in (1e-3, 2e-3))
    np.testing.assert_allclose(two.cameras, 4.0 * one.cameras, rtol=1e-9)
    np.testing.assert_allclose(two.points, 4.0 * one.points, rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"relative_to": 12}, "relative_to is 12, but there are 12 views"),
        ({"relative_to": -1}, "relative_to is -1, but there are 12 views"),
        ({"sigma_rad": 0.0}, "sigma_rad is 0.0, expected a positive number"),
        ({"sigma_rad": np.nan}, "sigma_rad is nan, expected a positive number"),
    ],
)
def test_what_cannot_be_used_is_named(turned: pp.SyntheticWorld, arguments: dict[str, Any], message: str) -> None:
    scene = known_scene(turned.tracks, turned.cam_from_world, turned.centers, turned.points)
    with pytest.raises(pp.InputError, match=message):
        pp.scene_covariance(turned.tracks, scene, **arguments)


def test_a_scene_of_other_tracks_is_refused(turned: pp.SyntheticWorld, street: pp.SyntheticWorld) -> None:
    scene = known_scene(turned.tracks, turned.cam_from_world, turned.centers, turned.points)
    with pytest.raises(pp.InputError, match="is not a scene of"):
        pp.scene_covariance(street.tracks, scene, sigma_rad=1e-3)
