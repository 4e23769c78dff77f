"""Errors after alignment: exact on scenes moved by a known similarity, honest where the fit is not unique."""

from __future__ import annotations

from typing import Any

import numpy as np
import panopath as pp
import pytest
from conftest import scene_of
from hypothesis import given, settings
from hypothesis import strategies as st
from panopath.evaluate import _fit
from panopath.formats.structure import known_scene
from scipy.optimize import minimize  # type: ignore[import-untyped]
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]


def rotation_of(d: int, angle_rad: float, axis: Any = (1.0, 2.0, -1.0)) -> np.ndarray[Any, Any]:
    if d == 2:
        c, s = np.cos(angle_rad), np.sin(angle_rad)
        return np.array([[c, -s], [s, c]])
    unit = np.array(axis) / np.linalg.norm(axis)
    return np.asarray(Rotation.from_rotvec(angle_rad * unit).as_matrix())


def moved(scene: pp.Scene, scale: float, rotation: Any, shift: Any) -> tuple[Any, Any]:
    """The truth that a scene would be, had the scene been moved."""
    return scale * scene.centers @ rotation.T + shift, scale * scene.points @ rotation.T + shift


@pytest.mark.parametrize("kind", ["turned", "planar"])
@pytest.mark.parametrize("angle_deg", [0.0, 40.0, 180.0])
def test_a_similarity_is_taken_out(kind: str, angle_deg: float, request: pytest.FixtureRequest) -> None:
    scene = scene_of(request.getfixturevalue(kind))
    truth = moved(scene, 7.5, rotation_of(scene.d, np.radians(angle_deg)), np.arange(scene.d) * 100.0)
    found = pp.evaluate(scene, truth)
    assert found.camera_max < 1e-11
    assert found.point_rms < 1e-11
    assert found.scale == pytest.approx(7.5)
    assert np.degrees(found.rotation_rad) == pytest.approx(angle_deg, abs=1e-6)
    assert (found.n_views, found.n_points) == (len(scene.centers) - 1, len(scene.points) - 1)
    assert np.isnan(found.camera_error[1])
    np.testing.assert_allclose(found.aligned_centers, truth[0], atol=1e-10)


def test_without_rotation(turned: pp.SyntheticWorld) -> None:
    scene = scene_of(turned)
    truth = moved(scene, 2.0, np.eye(3), (1.0, 2.0, 3.0))
    assert pp.evaluate(scene, truth, "translation_scale").camera_max < 1e-12
    twisted = moved(scene, 2.0, rotation_of(3, 0.1), (0.0, 0.0, 0.0))
    found = pp.evaluate(scene, twisted, "translation_scale")
    assert found.camera_rms > 0.01
    assert found.rotation_rad == 0.0


@pytest.mark.parametrize("d", [2, 3])
def test_never_a_reflection(d: int) -> None:
    rng = np.random.default_rng(2)
    source = rng.normal(size=(9, d))
    mirrored = source * np.array([-1.0, *[1.0] * (d - 1)])
    scale, rotation, shift = _fit(source, mirrored, "similarity")
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert np.linalg.norm(scale * source @ rotation.T + shift - mirrored) > 0.1
    # a scene turned inside out fits nothing
    scale, rotation, _ = _fit(source, -source, "translation_scale")
    assert scale == 0.0


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("mirror", [False, True])
def test_the_fit_is_the_least_squares_one(d: int, mirror: bool) -> None:
    """Against a general minimiser over scale, rotation and shift."""
    rng = np.random.default_rng(8)
    source = rng.normal(size=(12, d))
    target = 3.0 * source @ rotation_of(d, 1.0).T + rng.normal(0.0, 0.4, (12, d))
    if mirror:
        target[:, 0] *= -1.0

    def cost(parameters: Any) -> float:
        turn = parameters[1 : 1 + (1 if d == 2 else 3)]
        rotation = rotation_of(2, turn[0]) if d == 2 else np.asarray(Rotation.from_rotvec(turn).as_matrix())
        return float(np.sum((np.exp(parameters[0]) * source @ rotation.T + parameters[1 + len(turn) :] - target) ** 2))

    starts = [np.concatenate(([1.0], rng.normal(0.0, 2.0, 1 if d == 2 else 3), np.zeros(d))) for _ in range(12)]
    best = min(float(minimize(cost, start, method="BFGS").fun) for start in starts)
    scale, rotation, shift = _fit(source, target, "similarity")
    assert np.sum((scale * source @ rotation.T + shift - target) ** 2) == pytest.approx(best, rel=1e-6)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 1000), st.floats(-8.0, 8.0), st.floats(-9.0, 9.0))
def test_errors_scale_with_the_truth_and_not_with_the_scene(seed: int, log_scale: float, log_unit: float) -> None:
    rng = np.random.default_rng(seed)
    centers, noise = rng.normal(size=(8, 3)), rng.normal(0.0, 0.01, (8, 3))
    scene = bare(centers)
    truth = (centers + noise) * 10.0**log_unit
    reference = pp.evaluate(scene, centers + noise).camera_rms
    changed = bare(10.0**log_scale * centers @ rotation_of(3, 2.0).T + 3.0)
    assert pp.evaluate(changed, truth).camera_rms == pytest.approx(reference * 10.0**log_unit, rel=1e-5)


def bare(centers: Any, points: Any = None, view_component: Any = None, track_component: Any = None) -> pp.Scene:
    centers = np.asarray(centers, dtype=float)
    points = np.zeros((0, centers.shape[1])) if points is None else np.asarray(points, dtype=float)
    n, m, d = len(centers), len(points), centers.shape[1]
    return pp.Scene(
        centers=centers,
        points=points,
        view_component=np.zeros(n, dtype=np.int32)
        if view_component is None
        else np.asarray(view_component, dtype=np.int32),
        track_component=np.zeros(m, dtype=np.int32)
        if track_component is None
        else np.asarray(track_component, dtype=np.int32),
        inlier=np.ones(0, dtype=bool),
        residual_rad=np.zeros(0),
        cam_from_world=np.zeros(n) if d == 2 else np.tile(np.eye(3), (n, 1, 1)),
        summary=pp.Summary(pp.Status.CONVERGED, 0, 0.0),
    )


def test_each_part_by_itself() -> None:
    rng = np.random.default_rng(3)
    truth = rng.normal(size=(12, 3)) * 5.0
    part = np.arange(12) % 2
    centers = truth.copy()
    centers[part == 1] = 0.01 * truth[part == 1] @ rotation_of(3, 1.0).T - 4.0
    scene = bare(centers, view_component=part)
    found = pp.evaluate(scene, truth)
    assert found.camera_max < 1e-12
    assert [fit.scale for fit in found.alignments] == pytest.approx([1.0, 100.0])
    assert pp.evaluate(bare(centers), truth).camera_rms > 1.0


def test_few_cameras() -> None:
    two = bare([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    truth = np.array([(5.0, 5.0, 5.0), (5.0, 8.0, 5.0)])
    found = pp.evaluate(two, truth)
    assert found.camera_max < 1e-12
    assert found.scale == pytest.approx(3.0)
    assert not found.alignments[0].is_unique
    assert pp.evaluate(two, truth - truth[0] + 1.0, "translation_scale").alignments[0].is_unique
    one = pp.evaluate(bare([(1.0, 2.0)]), [(5.0, 6.0)])
    assert (one.camera_rms, one.n_views, one.alignments[0].is_unique) == (0.0, 1, False)
    same = pp.evaluate(bare([(1.0, 2.0)] * 3), [(5.0, 6.0)] * 3)
    assert same.camera_rms == 0.0


def test_cameras_on_a_line_are_held_by_the_points() -> None:
    rng = np.random.default_rng(5)
    centers = np.outer(np.arange(6.0), (1.0, 2.0, 3.0))
    points = rng.normal(size=(20, 3))
    rotation = rotation_of(3, 1.2)
    found = pp.evaluate(bare(centers, points), (4.0 * centers @ rotation.T, 4.0 * points @ rotation.T))
    assert found.alignments[0].is_unique
    assert found.point_rms < 1e-12
    alone = pp.evaluate(bare(centers, points), 4.0 * centers @ rotation.T)
    assert not alone.alignments[0].is_unique
    assert alone.camera_rms < 1e-12
    assert np.isnan(alone.point_rms)


def test_paper_gauge() -> None:
    rng = np.random.default_rng(6)
    centers, points = rng.normal(size=(5, 2)), rng.normal(size=(7, 2))
    points[0], points[1] = (2.0, 1.0), (4.0, 5.0)
    found = pp.evaluate(bare(3.0 * centers - 1.0, 3.0 * points - 1.0), (centers, points), "paper")
    assert found.camera_max < 1e-13
    np.testing.assert_allclose(found.aligned_points[:2], [(0.0, 0.0), (1.0, 2.0)], atol=1e-14)
    off = points.copy()
    off[3] += (0.0, 0.5)
    assert pp.evaluate(bare(centers, off), (centers, points), "paper").point_error[3] == pytest.approx(0.25)
    with pytest.raises(pp.InputError, match="two known points"):
        pp.evaluate(bare(centers, points), centers, "paper")


def test_trim_leaves_the_worst_out_of_the_fit() -> None:
    rng = np.random.default_rng(7)
    truth = rng.normal(size=(30, 3))
    centers = truth.copy()
    centers[:5] += 3.0 * rng.normal(size=(5, 3))
    assert np.median(pp.evaluate(bare(centers), truth).camera_error) > 0.1
    found = pp.evaluate(bare(centers), truth, trim=0.2)
    assert np.median(found.camera_error) < 1e-12
    assert found.n_views == 30
    assert found.camera_max > 1.0


def test_kinds_of_truth(turned: pp.SyntheticWorld) -> None:
    scene = known_scene(turned.tracks, turned.cam_from_world, turned.centers, turned.points)
    for truth in (turned, scene, (turned.centers, turned.points)):
        found = pp.evaluate(scene, truth)
        assert (found.camera_max < 1e-12, found.n_points) == (True, len(turned.points))
    assert pp.evaluate(scene, turned.centers.tolist()).n_points == 0


def test_point_errors_relative_to_distance() -> None:
    centers = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    points = np.array([(10.0, 0.0), (0.0, 101.0), (1e6, 0.0)])
    found = pp.evaluate(bare(centers, points + np.array([0.0, 0.9])), (centers, points))
    np.testing.assert_allclose(found.point_error, 0.9)
    assert found.point_relative_median == pytest.approx(0.009)
    assert set(found.to_dict()) >= {"camera_rms", "point_median", "n_components"}


@pytest.mark.parametrize(
    ("truth", "options", "message"),
    [
        (np.zeros((3, 2)), {}, r"centers of truth have shape \(3, 2\)"),
        ((np.zeros((4, 3)), np.zeros((1, 3))), {}, "points of truth"),
        ((np.zeros((4, 3)),), {}, "tuple of 1"),
        ("abc", {}, "cannot be read as positions"),
        (np.full((4, 3), np.nan), {}, "nothing to compare"),
        (np.zeros((4, 3)), {"alignment": "affine"}, "alignment is 'affine'"),
        (np.zeros((4, 3)), {"trim": 1.0}, "trim is 1.0"),
    ],
)
def test_errors(truth: Any, options: Any, message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        pp.evaluate(bare(np.random.default_rng(1).normal(size=(4, 3))), truth, **options)
