"""BAL: the camera model undone exactly, the structure that comes with it, and the real set."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import panopath as pp
import pytest
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]


def bal_text(rng: np.random.Generator, n_views: int, n_points: int) -> tuple[str, np.ndarray, np.ndarray, np.ndarray]:
    """A file made by the forward model of the format, independent of the reader."""
    rotation_vectors = rng.normal(0.0, 1.0, (n_views, 3))
    rotation_vectors[0] = 0.0
    rotations = Rotation.from_rotvec(rotation_vectors).as_matrix()
    centers = rng.normal(0.0, 0.3, (n_views, 3))
    points = rng.normal(0.0, 3.0, (n_points, 3))
    f, k1, k2 = 500.0, -0.12, 0.03
    lines, cameras = [], []
    for i in range(n_views):
        for j in range(n_points):
            p = rotations[i] @ (points[j] - centers[i])
            flat = -p[:2] / p[2]
            s = flat @ flat
            if p[2] < -0.5 and s < 1.0:
                pixel = f * (1.0 + k1 * s + k2 * s * s) * flat
                lines.append(f"{i} {j}     {float(pixel[0])!r} {float(pixel[1])!r}")
        cameras += [*rotation_vectors[i], *(-rotations[i] @ centers[i]), f, k1, k2]
    numbers = "\n".join(repr(float(v)) for v in [*cameras, *points.ravel()])
    return f"{n_views} {n_points} {len(lines)}\n" + "\n".join(lines) + "\n" + numbers + "\n", rotations, centers, points


def test_exact_world(tmp_path: Path) -> None:
    text, rotations, centers, points = bal_text(np.random.default_rng(4), 6, 80)
    (tmp_path / "f").write_text(text)
    problem = pp.read_problem(tmp_path / "f")
    assert problem.scene is not None
    assert problem.cam_from_world is not None
    assert len(problem.tracks) > 30
    np.testing.assert_allclose(problem.scene.centers, centers, atol=1e-14)
    np.testing.assert_array_equal(problem.scene.points, points)
    assert problem.scene.residual_rad.max() < 1e-12
    # x right, y down, z forward: what is seen lies ahead
    np.testing.assert_allclose(problem.cam_from_world, np.diag([1.0, -1.0, -1.0]) @ rotations, atol=1e-14)
    assert problem.tracks.bearing[:, 2].min() > 0.0
    world = pp.read_tracks(tmp_path / "f")
    ray = points[world.track] - centers[world.view]
    np.testing.assert_allclose(world.bearing, ray / np.linalg.norm(ray, axis=1, keepdims=True), atol=1e-12)


def test_gzip_and_windows_line_ends(tmp_path: Path) -> None:
    text, *_ = bal_text(np.random.default_rng(4), 3, 30)
    (tmp_path / "f.txt").write_bytes(text.replace("\n", "\r\n").encode())
    (tmp_path / "g.txt").write_text(text)
    np.testing.assert_array_equal(
        pp.read_tracks(tmp_path / "f.txt").bearing, pp.read_tracks(tmp_path / "g.txt").bearing
    )


def test_ladybug(real_data: Callable[[str], Path]) -> None:
    problem = pp.read_problem(real_data("bal_ladybug49/problem-49-7776-pre.txt"))
    assert (len(problem.tracks), problem.tracks.n_views, problem.tracks.n_tracks) == (31843, 49, 7776)
    assert problem.scene is not None
    # the source reports a median of 1.48 px at f = 403: a fifth of a degree
    assert np.degrees(np.median(problem.scene.residual_rad)) == pytest.approx(0.19, abs=0.04)
