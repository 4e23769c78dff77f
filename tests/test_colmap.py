"""COLMAP models: text and binary with any camera, and a model that pycolmap confirms."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pycolmap
import pytest
from conftest import scene_of
from panopath.formats.colmap import equirectangular_pixels, find_model, write_colmap

MODELS: dict[str, list[float]] = {
    "PINHOLE": [400.0, 410.0, 320.0, 240.0],
    "SIMPLE_RADIAL": [400.0, 320.0, 240.0, -0.05],
    "OPENCV": [400.0, 410.0, 320.0, 240.0, -0.05, 0.01, 1e-3, -1e-3],
    "OPENCV_FISHEYE": [200.0, 200.0, 320.0, 240.0, 0.01, -0.002, 0.0, 0.0],
    "EQUIRECTANGULAR": [640.0, 480.0],
}


def model_of(name: str, rng: np.random.Generator) -> Any:
    """A small reconstruction built by pycolmap alone."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = 2
    options.num_cameras_per_rig = 1
    options.num_frames_per_rig = 4
    options.num_points3D = 60
    options.camera_model_id = pycolmap.CameraModelId.__members__[name]
    options.camera_params = MODELS[name]
    options.camera_width, options.camera_height = 640, 480
    options.num_points2D_without_point3D = 3
    pycolmap.set_random_seed(int(rng.integers(1000)))
    return pycolmap.synthesize_dataset(options)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("binary", [True, False])
def test_reads_what_pycolmap_writes(tmp_path: Path, model: str, binary: bool) -> None:
    made = model_of(model, np.random.default_rng(1))
    folder = tmp_path / "sparse" / "0"
    folder.mkdir(parents=True)
    (made.write_binary if binary else made.write_text)(str(folder))
    problem = pp.read_problem(tmp_path)
    assert problem.scene is not None
    assert problem.cam_from_world is not None
    assert len(problem.tracks) == made.compute_num_observations()
    assert problem.tracks.n_tracks == made.num_points3D()
    by_name = {image.name: image for image in made.images.values()}
    for view, name in enumerate(problem.tracks.view_labels()):
        pose = by_name[name].cam_from_world()
        np.testing.assert_allclose(problem.cam_from_world[view], pose.rotation.matrix(), atol=1e-12)
        np.testing.assert_allclose(problem.scene.centers[view], by_name[name].projection_center(), atol=1e-12)
    # the synthetic model has no noise: bearings point at the points, but for the digits that text and undistortion keep
    assert problem.scene.residual_rad.max() < 1e-6


def confirm(folder: Path, scene: pp.Scene, component: int) -> None:
    """pycolmap opens the model and finds the reprojection error that the residuals say."""
    tracks = scene.tracks
    assert tracks is not None
    model = pycolmap.Reconstruction(str(folder))
    in_part = (scene.view_component[tracks.view] == component) & (scene.track_component[tracks.track] == component)
    used = scene.inlier & in_part
    assert model.num_images() == (scene.view_component == component).sum()
    assert model.compute_num_observations() == used.sum()
    assert model.num_points3D() == len(np.unique(tracks.track[used]))
    (camera,) = model.cameras.values()
    assert (camera.model, camera.width, camera.height) == (pycolmap.CameraModelId.EQUIRECTANGULAR, 4096, 2048)
    # on a spherical camera COLMAP's error is the angle, in pixels at the equator
    sums = np.bincount(tracks.track[used], weights=scene.residual_rad[used], minlength=tracks.n_tracks)
    ours = {t + 1: sums[t] / n * 4096 / (2 * np.pi) for t, n in enumerate(np.bincount(tracks.track[used])) if n}
    assert {i: point.error for i, point in model.points3D.items()} == pytest.approx(ours, rel=1e-12)
    assert model.compute_mean_reprojection_error() == pytest.approx(np.mean([*ours.values()]), rel=1e-12)
    model.update_point_3d_errors()
    assert {i: point.error for i, point in model.points3D.items()} == pytest.approx(ours, rel=1e-6)


def test_pixels_are_pycolmaps(turned: pp.SyntheticWorld) -> None:
    camera = pycolmap.Camera(model="EQUIRECTANGULAR", width=4096, height=2048, params=[4096.0, 2048.0])
    pixels = equirectangular_pixels(turned.tracks.bearing, 4096, 2048)
    np.testing.assert_allclose(np.asarray(camera.cam_ray_from_img(pixels)), turned.tracks.bearing, atol=1e-12)


def test_pycolmap_confirms_the_reprojection_error(tmp_path: Path, turned: pp.SyntheticWorld) -> None:
    scene = scene_of(turned)
    pp.write_scene(scene, tmp_path / "out")
    confirm(tmp_path / "out" / "colmap" / "0", scene, 0)


def test_reads_its_own_model_back(tmp_path: Path, turned: pp.SyntheticWorld) -> None:
    scene = scene_of(turned)
    pp.write_scene(scene, tmp_path / "out")
    assert find_model(tmp_path / "out" / "colmap") == (tmp_path / "out" / "colmap" / "0", ".bin")
    back = pp.read_problem(tmp_path / "out" / "colmap" / "0")
    assert back.scene is not None
    solved = np.isfinite(scene.centers[:, 0])
    assert list(back.tracks.view_labels()) == [n for n, s in zip(scene.view_labels(), solved, strict=True) if s]
    np.testing.assert_allclose(back.scene.centers, scene.centers[solved], atol=1e-13)
    assert back.cam_from_world is not None
    np.testing.assert_allclose(back.cam_from_world, scene.cam_from_world[solved], atol=1e-14)
    # an observation is known by its point and its view; both files are in the order of the points within a view
    assert len(back.tracks) == scene.inlier.sum()
    np.testing.assert_allclose(np.sort(back.scene.residual_rad), np.sort(scene.residual_rad[scene.inlier]), atol=1e-12)


def test_one_model_a_part(tmp_path: Path, turned: pp.SyntheticWorld) -> None:
    scene = scene_of(turned)
    tracks = scene.tracks
    assert tracks is not None
    view_component = np.where(scene.view_component < 0, -1, np.arange(len(scene.centers)) % 2)
    track_component = np.where(scene.track_component < 0, -1, np.arange(len(scene.points)) % 2)
    split = pp.Scene(
        scene.centers,
        scene.points,
        view_component,
        track_component,
        scene.inlier & (view_component[tracks.view] == track_component[tracks.track]),
        scene.residual_rad,
        scene.cam_from_world,
        scene.summary,
        tracks,
        scene.view_names,
        scene.track_names,
    )
    pp.write_scene(split, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out" / "colmap").iterdir()) == ["0", "1"]
    for component in (0, 1):
        confirm(tmp_path / "out" / "colmap" / str(component), split, component)


def test_planar_scene_has_no_model(tmp_path: Path, planar: pp.SyntheticWorld) -> None:
    scene = scene_of(planar)
    assert scene.tracks is not None
    with pytest.raises(pp.InputError, match="planar"):
        write_colmap(scene, scene.tracks, tmp_path)
    pp.write_scene(scene, tmp_path / "out")
    assert not (tmp_path / "out" / "colmap").exists()


def test_without_pycolmap(tmp_path: Path, turned: pp.SyntheticWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.import_module

    def absent(name: str, package: str | None = None) -> Any:
        if name == "pycolmap":
            raise ImportError(name)
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", absent)
    pp.write_scene(scene_of(turned), tmp_path / "out")  # writing needs no pycolmap
    with pytest.raises(pp.MissingExtraError, match=r'pip install "panopath\[colmap\]"'):
        pp.read_tracks(tmp_path / "out" / "colmap" / "0")


def test_lund_door(real_data: Callable[[str], Path]) -> None:
    problem = pp.read_problem(real_data("lund_door_colmap"))
    assert (len(problem.tracks), problem.tracks.n_views, problem.tracks.n_tracks) == (73327, 12, 11384)
    assert problem.scene is not None
    # reprojection errors of half a pixel at f = 2435
    assert np.degrees(np.median(problem.scene.residual_rad)) < 0.02
