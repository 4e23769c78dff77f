"""Relative orientation of two views through Python: records, errors, determinism, and a real pair of panoramas."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.model import Float

NOISE = 2e-3


def rotation(phi: Float) -> Float:
    angle = float(np.linalg.norm(phi))
    x, y, z = phi / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def unit(rows: Float) -> Float:
    return np.asarray(rows / np.linalg.norm(rows, axis=-1, keepdims=True))


def pair(n: int = 120, seed: int = 0, noise: float = NOISE, false: float = 0.2) -> tuple[Float, Float, Float, Float]:
    """First, second, rotation and direction."""
    rng = np.random.default_rng(seed)
    turn, center = rotation(2.0 * unit(rng.normal(size=3))), unit(rng.normal(size=3))
    points = unit(rng.normal(size=(n, 3))) * rng.uniform(2.0, 12.0, size=(n, 1))
    second = unit(points - center) @ turn.T
    second[: round(false * n)] = unit(rng.normal(size=(round(false * n), 3)))
    first, second = (unit(b + noise * rng.normal(size=(n, 3))) for b in (unit(points), second))
    return first, second, turn, center


def angle_of(turn: Float) -> float:
    return float(2.0 * np.arcsin(min(np.linalg.norm(turn - np.eye(3)) / np.sqrt(8.0), 1.0)))


def test_a_pair_is_solved() -> None:
    first, second, turn, center = pair()
    found = pp.relative_pose(first, second)
    assert found.status is pp.TwoViewStatus.GENERAL
    assert angle_of(found.second_from_first @ turn.T) < 3e-3
    assert np.arccos(found.direction @ center) < 1e-2
    assert found.n_inliers == found.inlier.sum() >= 95
    assert not found.inlier[:24].sum() > 2
    assert found.sigma_rad == pytest.approx(NOISE, rel=0.25)
    assert found.alternative is None
    for covariance in (found.rotation_covariance, found.direction_covariance):
        assert covariance.shape == (3, 3)
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
        assert 1e-8 < np.trace(covariance) < 1e-4


def test_records_are_frozen() -> None:
    first, second, _, _ = pair()
    start = np.array([0, len(first)])
    found = pp.relative_poses(start, first, second)
    with pytest.raises(ValueError, match="read-only"):
        found[0].direction[0] = 1.0
    with pytest.raises(AttributeError):
        found[0].sigma_rad = 1.0
    start[0] = 0  # what the caller gave stays the caller's
    assert first.flags.writeable


def test_a_known_rotation_is_kept() -> None:
    first, second, turn, center = pair(false=0.5)
    found = pp.relative_pose(first, second, second_from_first=turn)
    np.testing.assert_allclose(found.second_from_first, turn, atol=1e-12)
    assert np.arccos(found.direction @ center) < 1e-2
    assert not found.rotation_covariance.any()


def test_views_from_one_place_and_false_matches_have_no_direction() -> None:
    first, _, turn, _ = pair()
    still = pp.relative_pose(first, first @ turn.T)
    assert still.status is pp.TwoViewStatus.PURE_ROTATION
    assert np.isnan(still.direction).all()
    assert angle_of(still.second_from_first @ turn.T) < 1e-9
    false = pp.relative_pose(first, unit(np.random.default_rng(1).normal(size=first.shape)))
    assert false.status is pp.TwoViewStatus.UNDETERMINED
    assert np.isnan(false.second_from_first).all()
    assert np.isnan(false.sigma_rad)
    assert false.n_inliers == 0


def test_a_wall_ahead_has_two_poses() -> None:
    rng = np.random.default_rng(3)
    first = unit(np.column_stack([rng.uniform(-0.7, 0.7, size=(100, 2)), np.ones(100)]))
    points = first / (first @ np.array([0.05, 0.1, 0.3]))[:, None]
    center = unit(np.array([0.3, 0.2, 1.0]))
    found = pp.relative_pose(first, unit(points - center))
    assert found.status is pp.TwoViewStatus.PLANAR
    assert found.alternative is not None
    poses = [(found.second_from_first, found.direction), found.alternative]
    assert min(angle_of(turn) + float(np.linalg.norm(direction - center)) for turn, direction in poses) < 1e-6


def flat(n_pairs: int) -> tuple[Any, Float, Float]:
    pairs = [pair(40 + 5 * p, seed=p)[:2] for p in range(n_pairs)]
    start = np.concatenate([[0], np.cumsum([len(a) for a, _ in pairs])])
    return start, np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])


def test_many_pairs_are_a_sequence() -> None:
    start, first, second = flat(6)
    found = pp.relative_poses(start, first, second)
    assert len(found) == 6
    assert found.inlier.shape == (len(first),)
    assert [len(view.inlier) for view in found] == list(np.diff(start))
    assert found[-1].n_inliers == found.n_inliers[5]
    assert len(found[1:3]) == 2
    with pytest.raises(IndexError):
        found[6]
    alone = pp.relative_pose(first[: start[1]], second[: start[1]])
    assert alone.direction.tobytes() == found[0].direction.tobytes()
    assert len(pp.relative_poses([0], np.empty((0, 3)), np.empty((0, 3)))) == 0
    assert pp.relative_pose([], []).status is pp.TwoViewStatus.UNDETERMINED


SCRIPT = """
import hashlib, sys
sys.path.insert(0, {folder!r})
import panopath as pp
from test_two_view import flat
found = pp.relative_poses(*flat(8))
arrays = (found.direction, found.rotation_covariance, found.inlier)
print(hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest())
"""


def test_the_same_bytes_on_any_number_of_threads() -> None:
    code = SCRIPT.format(folder=os.path.dirname(__file__))
    digests = {
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"RAYON_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "4")
    }
    assert len(digests) == 1


GOOD = pair(20)[:2]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"second": GOOD[1][:19]}, "second has 19 rows, expected 20"),
        ({"first": GOOD[0][:, :2]}, r"first has shape \(20, 2\)"),
        ({"first": 2.0 * GOOD[0]}, r"first\[0\] has length 1.99"),
        ({"second": np.where(np.arange(60).reshape(20, 3) == 4, np.nan, GOOD[1])}, r"second\[1\] has length NaN"),
        ({"first": [["a", "b", "c"]]}, "first cannot be read"),
        ({"second_from_first": np.eye(2)}, r"second_from_first has shape \(2, 2\)"),
        ({"second_from_first": np.ones((3, 3))}, r"second_from_first\[0\] is not a rotation"),
        ({"options": {"seed": 1}}, "options is a dict"),
        ({"options": pp.TwoViewOptions(max_error_rad=-1.0)}, "max_error_rad is -1"),
        ({"options": pp.TwoViewOptions(confidence=1.5)}, "confidence is 1.5"),
        ({"options": pp.TwoViewOptions(seed=-1)}, "seed is -1"),
        ({"options": pp.TwoViewOptions(min_inliers=3)}, "min_inliers is 3"),
        ({"options": pp.TwoViewOptions(max_iterations=True)}, "max_iterations is True"),
    ],
)
def test_what_cannot_be_used_is_named(change: dict[str, Any], said: str) -> None:
    with pytest.raises(pp.InputError, match=said):
        pp.relative_pose(**({"first": GOOD[0], "second": GOOD[1]} | change))


@pytest.mark.parametrize(
    ("start", "said"),
    [
        ([], "pair_start has"),
        ([0.0, 20.0], "pair_start has type float64"),
        ([0, -3, 20], r"pair_start\[1\] is -3"),
        ([0, 12, 9, 20], r"pair_start\[2\] is 9"),
        ([0, 21], r"pair_start\[1\] is 21, expected 20"),
    ],
)
def test_offsets_that_cut_wrongly_are_named(start: list[float], said: str) -> None:
    with pytest.raises(pp.InputError, match=said):
        pp.relative_poses(start, *GOOD)


def test_matches_are_judged_by_known_poses() -> None:
    rng = np.random.default_rng(5)
    points = rng.normal(size=(60, 3)) * 4.0
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    center = np.array([0.5, -0.2, 0.1])
    first = points / np.linalg.norm(points, axis=1, keepdims=True)
    second = (points - center) @ turn.T
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    bearing = np.concatenate((first, second, [[np.nan] * 3]))
    right = np.stack((np.arange(60), 60 + np.arange(60)), axis=1)
    wrong = np.stack((np.arange(60), 60 + (np.arange(60) + 7) % 60), axis=1)
    nothing = [[0, 120], [0, 500]]
    matches = np.concatenate((right, wrong, nothing, right))
    start = [0, 122, 182]
    limit = np.radians(0.05)
    turns, baselines = np.stack((turn, turn)), np.stack((turn @ center, -turn @ center))
    agree = pp.steps.matches_that_agree(start, matches, bearing, np.full(121, limit), turns, baselines, np.zeros(2))
    assert agree[:60].all()
    assert agree[60:120].sum() <= 2
    assert not agree[120:122].any()
    # the opposite baseline has the same epipolar planes, and all points behind
    assert not agree[122:].any()
    still = pp.steps.matches_that_agree(
        [0, 60],
        np.stack((np.arange(60), np.arange(60)), axis=1),
        first,
        np.full(60, limit),
        np.eye(3)[None],
        np.full((1, 3), np.nan),
        np.zeros(1),
    )
    assert still.all()
    with pytest.raises(pp.InputError, match="of 1 pairs"):
        pp.steps.matches_that_agree([0], right, bearing, np.zeros(121), turns[:1], baselines[:1], [0.0])
