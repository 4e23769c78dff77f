"""Pictures: they show what is there, far points do not squash them, and their absence is explained."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import panopath as pp
import pytest
from conftest import scene_of
from panopath.formats.structure import known_scene
from panopath.report import draw_scene
from panopath.report.pictures import _axes, _limits, _parts


@pytest.mark.parametrize("kind", ["turned", "planar", "street"])
def test_draws(tmp_path: Path, kind: str, request: pytest.FixtureRequest) -> None:
    scene = scene_of(request.getfixturevalue(kind))
    paths = draw_scene(scene, tmp_path, truth=scene.centers, unit="m")
    assert [path.name for path in paths] == ["views.png", "errors.png"]
    for path in paths:
        image = matplotlib.image.imread(path)
        assert min(image.shape[:2]) > 500
        # something is drawn: many colours, on mostly white paper
        assert len(np.unique(image.reshape(-1, image.shape[2]), axis=0)) > 100
        assert np.mean(image[..., :3].min(axis=2) > 0.99) > 0.5


def test_same_scene_same_picture(tmp_path: Path, street: pp.SyntheticWorld) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        draw_scene(scene_of(street), tmp_path / name)
    assert (tmp_path / "a" / "views.png").read_bytes() == (tmp_path / "b" / "views.png").read_bytes()


def test_far_points_do_not_squash_the_path() -> None:
    world = pp.simulate("street", n_views=30, n_points=500, seed=2, infinity_fraction=0.8)
    scene = known_scene(world.tracks, None, world.centers, world.points)
    (part,) = _parts(scene, world.centers)
    middle, half = _limits(part)
    extent = np.abs(world.centers - middle).max()
    assert 0.1 * half < extent <= half


def test_a_scene_far_from_its_cameras_is_shown() -> None:
    """Two cameras close together, points some way off: the points are inside the picture."""
    rng = np.random.default_rng(1)
    points = rng.normal((0.0, 12.0, 0.0), 1.0, (50, 3))
    centers = np.array([(-2.0, 0.0, 0.0), (2.0, 0.0, 0.0)])
    view, track = np.repeat([0, 1], 50), np.tile(np.arange(50), 2)
    ray = points[track] - centers[view]
    tracks = pp.Tracks.from_arrays(view, track, ray / np.linalg.norm(ray, axis=1, keepdims=True))
    (part,) = _parts(known_scene(tracks, None, centers, points), centers)
    middle, half = _limits(part)
    assert np.mean(np.abs(points - middle).max(axis=1) <= half) > 0.9


def test_up_is_up(turned: pp.SyntheticWorld, street: pp.SyntheticWorld) -> None:
    np.testing.assert_array_equal(_axes(scene_of(street)), np.eye(3))
    # level cameras of a world whose y points down
    level = pp.Scene(
        **{
            **{name: getattr(scene_of(street), name) for name in ("centers", "points", "view_component", "summary")},
            **{name: getattr(scene_of(street), name) for name in ("track_component", "inlier", "residual_rad")},
            "cam_from_world": np.tile([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], (20, 1, 1)),
        }
    )
    np.testing.assert_allclose(_axes(level)[2], (0.0, -1.0, 0.0))
    assert np.linalg.det(_axes(level)) == pytest.approx(1.0)
    np.testing.assert_array_equal(_axes(scene_of(turned)), np.eye(3))


def test_parts_and_nothing(tmp_path: Path, street: pp.SyntheticWorld) -> None:
    scene = scene_of(street)
    fields: dict[str, Any] = {name: getattr(scene, name) for name in scene.__dataclass_fields__}
    n, m = len(scene.centers), len(scene.points)
    split = pp.Scene(**{**fields, "view_component": np.arange(n) % 6, "track_component": np.arange(m) % 6})
    draw_scene(split, tmp_path)
    nothing = {
        "centers": np.full((n, 3), np.nan),
        "points": np.full((m, 3), np.nan),
        "view_component": np.full(n, -1),
        "track_component": np.full(m, -1),
        "residual_rad": np.full(len(scene.inlier), np.nan),
    }
    assert len(draw_scene(pp.Scene(**{**fields, **nothing}), tmp_path)) == 2


def test_without_matplotlib(tmp_path: Path, street: pp.SyntheticWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.import_module

    def absent(name: str, package: str | None = None) -> Any:
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(pp.MissingExtraError, match=r'pip install "panopath\[plot\]"'):
        draw_scene(scene_of(street), tmp_path)
