"""Clouds that drift are told from the scene, and rigs of cameras close together match as panoramas."""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt
import pytest
from panopath.errors import InputError
from panopath.formats.colmap_model import Camera, cameras_bytes
from panopath.frontend.drift import drifting_features, drifting_matches, features_beside
from panopath.frontend.features import Features
from panopath.frontend.matching import MatchingOptions
from panopath.frontend.moments import match_moments
from panopath.steps import TwoViewOptions, TwoViews, relative_poses

Float = npt.NDArray[np.float64]
SIGMA = float(np.radians(0.1))


def unit(rows: Float) -> Float:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def seen(
    rng: np.random.Generator, n_ground: int, n_clouds: int, drift_m: tuple[float, float, float]
) -> tuple[Float, Float]:
    """Bearings of what stands around two cameras 3 m apart, then of clouds that drift meanwhile; y is down."""
    ground = unit(rng.normal(size=(n_ground, 3))) * rng.uniform(5.0, 25.0, (n_ground, 1))
    high = unit(rng.normal(size=(n_clouds, 3)) * (1.0, 0.3, 1.0) + (0.0, -1.2, 0.0)) * 1000.0
    step = np.array([0.0, 0.0, 3.0])
    first, second = np.concatenate((ground, high)), np.concatenate((ground - step, high - step + drift_m))
    noise = rng.normal(0.0, SIGMA, (2, len(first), 3))
    return unit(unit(first) + noise[0]), unit(unit(second) + noise[1])


def judged(first: Float, second: Float) -> tuple[TwoViews, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    found = relative_poses(np.array([0, len(first)]), first, second, TwoViewOptions())
    turned = first @ found.second_from_first[0].T
    is_near = np.linalg.norm(turned - second, axis=1) > 4.0 * SIGMA
    return found, is_near, drifting_matches(first, second, found, is_near, np.array([SIGMA]))


def test_clouds_that_drift_are_told_from_the_ground() -> None:
    first, second = seen(np.random.default_rng(1), 40, 160, (30.0, 0.0, 0.0))
    found, _, drifting = judged(first, second)
    # most matches are of clouds, and so is the motion found
    assert abs(found.direction[0] @ (0.0, 0.0, 1.0)) < 0.5
    assert drifting[40:].mean() > 0.8
    assert drifting[:40].mean() < 0.1
    again = relative_poses(np.array([0, (~drifting).sum()]), first[~drifting], second[~drifting], TwoViewOptions())
    assert np.degrees(np.arccos(abs(again.direction[0, 2]))) < 3.0


@pytest.mark.parametrize(("n_clouds", "drift_m"), [(0, (0.0, 0.0, 0.0)), (100, (0.0, 0.0, 0.0))])
def test_what_stands_still_stays(n_clouds: int, drift_m: tuple[float, float, float]) -> None:
    first, second = seen(np.random.default_rng(2), 100, n_clouds, drift_m)
    wrong = unit(np.random.default_rng(3).normal(size=(30, 3)))
    first, second = np.concatenate((first, wrong)), np.concatenate((second, -wrong[::-1]))
    assert not judged(first, second)[2].any()


def test_a_car_is_not_the_scene() -> None:
    """Near, many, and in one direction: what misses the motion is a mover, not the ground."""
    rng = np.random.default_rng(4)
    first, second = seen(rng, 120, 0, (0.0, 0.0, 0.0))
    car = np.array([4.0, 0.0, 1.0]) + rng.uniform(-0.7, 0.7, (40, 3))
    first = np.concatenate((first, unit(car)))
    second = np.concatenate((second, unit(car + np.array([1.5, 0.0, -3.0]))))
    assert not judged(first, second)[2].any()


def test_features_beside_those_that_drift() -> None:
    angle = np.radians([0.0, 3.0, 20.0, 0.0, 3.0])
    bearings = np.stack((np.cos(angle), np.sin(angle), np.zeros(5)), axis=1)
    drifts = np.array([True, False, False, False, False])
    # the last two are of another image
    assert features_beside(np.array([0, 3, 5]), bearings, drifts, np.radians(5.0)).tolist() == [True, True] + 3 * [
        False
    ]


def test_drift_is_followed_over_matches() -> None:
    starts, bearings = np.arange(4) * 2, unit(np.random.default_rng(0).normal(size=(6, 3)))
    feature, row = np.array([[0, 2], [1, 3], [2, 4]]), np.array([0, 0, 1])
    of_matches = (np.array([True, False, False]), np.zeros(3, dtype=bool), np.ones(3, dtype=bool))
    drifts = drifting_features(starts, bearings, feature, row, of_matches)
    assert drifts.tolist() == [True, False, True, False, True, False]


def test_moments_of_a_rig_match_across_its_cameras() -> None:
    """The rig turns half round between two moments: what one camera saw the other sees now."""
    rng = np.random.default_rng(5)
    n = 300
    points = unit(rng.normal(size=(n, 3))) * rng.uniform(4.0, 20.0, (n, 1))
    words = rng.integers(0, 120, (n, 128)).astype(np.uint8)
    back = np.diag([-1.0, 1.0, -1.0])
    sensor_from_rig = np.stack((np.eye(3), back))
    features, rays, which = [], [], []
    for rig_from_world, center in ((np.eye(3), np.zeros(3)), (back, np.array([0.5, 0.0, 1.0]))):
        for sensor in sensor_from_rig:
            ray = unit((points - center) @ rig_from_world.T @ sensor.T)
            own = np.flatnonzero(ray[:, 2] > 0.0)
            features.append(Features(np.zeros((len(own), 2)), words[own]))
            rays.append(ray[own])
            which.append(own)
    rig = (np.array([0, 0, 1, 1], dtype=np.int32), np.array([0, 1, 0, 1], dtype=np.int32), sensor_from_rig)
    found = match_moments(features, rays, rig, float(np.radians(0.2)), MatchingOptions(), in_sequence=True)
    pairs = {tuple(p): int(c) for p, c in zip(found.pairs.tolist(), found.counts, strict=True)}
    assert pairs[0, 3] > 80
    assert pairs[1, 2] > 80
    row = np.repeat(np.arange(len(found.pairs)), found.counts)
    right = [which[found.pairs[r, 0]][a] == which[found.pairs[r, 1]][b]
             for r, (a, b) in zip(row.tolist(), found.matches.tolist(), strict=True)]  # fmt: skip
    assert np.mean(right) > 0.99
    # in the cameras the turn is none
    turn = found.second_from_first[found.pairs.tolist().index([0, 3])]
    assert np.allclose(turn, np.eye(3), atol=0.01)


def test_named_camera_models_are_written_as_numbers() -> None:
    panorama = cameras_bytes([Camera(1, "EQUIRECTANGULAR", 8, 4, (8.0, 4.0))])
    assert struct.unpack_from("<QIi", panorama)[2] == 17
    pytest.importorskip("pycolmap", reason="needs the extra colmap")
    fisheye = cameras_bytes([Camera(1, "OPENCV_FISHEYE", 8, 4, (1.0,) * 8)])
    assert struct.unpack_from("<QIi", fisheye)[2] == 5
    with pytest.raises(InputError, match="no camera model"):
        cameras_bytes([Camera(1, "SOMETHING", 8, 4, ())])
