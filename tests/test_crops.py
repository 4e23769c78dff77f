"""Crops and what goes with them: right pixels, right poses, models that other programs read, little memory."""

from __future__ import annotations

import json
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from conftest import scene_of
from panopath.cameras import bearings_from_equirectangular, equirectangular_from_bearings
from panopath.formats.colours import point_colours
from panopath.formats.crops import CropOptions, _Cutter, crop_from_cam, write_crops
from panopath.formats.folder import write_scene
from panopath.formats.nerfstudio import read_transforms, write_nerfstudio
from panopath.images import Picture, encoded, image_source, read_image
from panopath.model import Float

cv2 = pytest.importorskip("cv2", reason="the extra images is absent")

WIDTH = 512


def directions(width: int = WIDTH) -> Float:
    """(h, w, 3) bearing of each pixel of a panorama."""
    height = width // 2
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return bearings_from_equirectangular(np.stack((x, y), axis=-1).reshape(-1, 2), width, height).reshape(
        height, width, 3
    )


def colour_of(direction: Float) -> Float:
    """Waves of 26 pixels over the sphere, without seam or pole: half a pixel amiss is five counts off."""
    return np.asarray(127.5 + 45.0 * np.sin(20.0 * direction + (0.3, 1.1, 2.0)))


def panorama(rotation: Float, width: int = WIDTH) -> Picture:
    """What a camera turned by ``cam_from_world`` sees at infinity."""
    return colour_of(directions(width) @ rotation).round().astype(np.uint8)


@pytest.fixture(scope="module")
def scene(turned: pp.SyntheticWorld) -> pp.Scene:
    return scene_of(turned)


def look(scene: pp.Scene) -> Any:
    return lambda view: panorama(scene.cam_from_world[view])


@pytest.mark.parametrize("options", [
    CropOptions(suffix=".png"),
    CropOptions("perspective", 64, 75.0, 5, (-40.0, 0.0, 60.0), ".png"),
    CropOptions("cube", 150, suffix=".png"),
])  # fmt: skip
def test_crops_show_what_the_model_says(tmp_path: Path, scene: pp.Scene, options: CropOptions) -> None:
    """Each pixel of each crop has the colour of the direction that pycolmap's camera and pose give it."""
    pycolmap = pytest.importorskip("pycolmap", reason="the extra colmap is absent")
    made = write_crops(scene, look(scene), tmp_path, options)
    model = pycolmap.Reconstruction(tmp_path / "sparse" / "0")
    solved = int((scene.view_component == 0).sum())
    assert model.num_images() == made.n_images == solved * len(options.directions())
    (camera,) = model.cameras.values()
    assert camera.model.name == "PINHOLE"
    size = camera.width
    x, y = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    pixels = np.stack((x, y), axis=-1).reshape(-1, 2)
    ray = np.asarray(camera.cam_ray_from_img(pixels))
    ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    for image in model.images.values():
        crop = read_image(tmp_path / "images" / image.name)
        assert crop.shape == (size, size, 3)
        world = ray @ image.cam_from_world().rotation.matrix()
        off = np.abs(crop.reshape(-1, 3) - colour_of(world))
        # a count by the rounding of the panorama and of the crop, the rest by what bilinear pixels flatten
        assert off.max() < 3.5, image.name
        assert off.mean() < 1.0


def test_points_reproject(tmp_path: Path, scene: pp.Scene) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="the extra colmap is absent")
    made = write_crops(scene, look(scene), tmp_path)
    model = pycolmap.Reconstruction(tmp_path / "sparse" / "0")
    assert model.num_points3D() == made.n_points == len(np.unique(scene.tracks.track[scene.inlier]))  # type: ignore[union-attr]
    seen = 0
    for point_id, point in model.points3D.items():
        errors = []
        for element in point.track.elements:
            image = model.images[element.image_id]
            feature = image.points2D[element.point2D_idx]
            assert feature.point3D_id == point_id
            predicted = image.project_point(point.xyz)
            errors.append(np.linalg.norm(predicted - feature.xy))
            seen += 1
        # noise of a milliradian is a third of a pixel at a cube's edge
        assert max(errors) < 1.5
        assert point.error == pytest.approx(np.mean(errors), abs=1e-6)
        assert np.array_equal(point.xyz, scene.points[point_id - 1])
        assert np.abs(point.color - colour_of_track(scene, point_id - 1)).max() < 4.0
    # the faces of a cube cover the sphere, each direction once
    assert seen == made.n_observations == scene.inlier.sum()


def colour_of_track(scene: pp.Scene, track: int) -> Float:
    assert scene.tracks is not None
    rows = (scene.tracks.track == track) & scene.inlier
    world = np.einsum("nkc,nk->nc", scene.cam_from_world[scene.tracks.view[rows]], scene.tracks.bearing[rows])
    return np.asarray(colour_of(world).mean(axis=0))


def test_masks_are_cut_alike(tmp_path: Path, scene: pp.Scene) -> None:
    """A mask that is black where the operator stands, below the camera."""
    below = (255 * (directions()[:, :, 1] < 0.8)).astype(np.uint8)
    write_crops(scene, look(scene), tmp_path, masks=lambda _: below)
    content = json.loads((tmp_path / "transforms.json").read_text())
    black = {}
    for frame in content["frames"]:
        mask = read_image(tmp_path / frame["mask_path"])
        assert frame["mask_path"] == f"masks/{Path(frame['file_path']).name}.png"
        assert set(np.unique(mask)) <= {0, 255}
        black[frame["file_path"].rsplit("_", 1)[1]] = float((mask == 0).mean())
    # the cap of 36.9 degrees is a disc of radius 0.75 on the lower face
    assert black["down.jpg"] == pytest.approx(np.pi * 0.75**2 / 4.0, abs=0.02)
    assert all(share == 0.0 for name, share in black.items() if name != "down.jpg")
    with pytest.raises(pp.InputError, match="mask of"):
        write_crops(scene, look(scene), tmp_path, masks=lambda _: below[:5])


def test_text_and_binary_are_read_back_by_us(tmp_path: Path, scene: pp.Scene) -> None:
    pytest.importorskip("pycolmap", reason="the extra colmap is absent")
    write_crops(scene, look(scene), tmp_path)
    back = pp.read_problem(tmp_path)
    assert back.scene is not None
    assert np.nanmax(back.scene.residual_rad) < 0.01
    assert back.tracks.n_views == 6 * int((scene.view_component == 0).sum())


def test_coarse_crops_average() -> None:
    """Stripes finer than a crop's pixel become even grey, not a moiré."""
    picture = np.zeros((1024, 2048, 3), dtype=np.uint8)
    picture[:, ::2] = 255
    cutter = _Cutter(CropOptions("perspective", 64, 60.0, 1), 2048, 1024)
    ((_, _, crop),) = cutter.cut(picture)
    assert abs(float(crop[28:36, 28:36].mean()) - 127.5) < 3.0
    assert float(crop.std()) < 25.0


def test_seam_and_poles_leave_no_trace() -> None:
    for azimuth, elevation in ((180.0, 0.0), (30.0, 90.0), (0.0, -90.0)):
        rotation = crop_from_cam(azimuth, elevation)
        cutter = _Cutter(CropOptions(size_px=201), WIDTH, WIDTH // 2)
        cutter._directions = [("it", rotation)]
        ((_, _, crop),) = cutter.cut(panorama(np.eye(3)))
        at = (np.arange(201) + 0.5) / 100.5 - 1.0  # odd: a pixel on the pole itself
        x, y = np.meshgrid(at, at)
        ray = np.stack((x, y, np.ones_like(x)), axis=-1) @ rotation
        expected = colour_of(ray / np.linalg.norm(ray, axis=-1, keepdims=True))
        assert np.abs(crop - expected).max() < 3.5


def test_crop_looks_where_it_says() -> None:
    assert np.allclose(crop_from_cam(90.0, 0.0) @ (1.0, 0.0, 0.0), (0, 0, 1))
    assert np.allclose(crop_from_cam(0.0, 90.0) @ (0.0, -1.0, 0.0), (0, 0, 1))
    # level: up in the camera stays in the upper half of the crop
    assert (crop_from_cam(33.0, 20.0) @ (0.0, -1.0, 0.0))[1] < 0.0
    assert abs((crop_from_cam(33.0, 20.0) @ (0.0, -1.0, 0.0))[0]) < 1e-12


def test_memory_does_not_grow_with_the_views(tmp_path: Path) -> None:
    world = pp.simulate("street", n_views=24, n_points=50, seed=1)
    scene = scene_of(world)
    peaks = []
    for n in (4, 23):
        some = replace(scene, view_component=np.where(np.arange(24) < n, scene.view_component, -1))
        tracemalloc.start()
        write_crops(some, lambda view: np.full((512, 1024, 3), view, dtype=np.uint8), tmp_path / str(n))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.15 * peaks[0]


def test_refuses(tmp_path: Path, scene: pp.Scene) -> None:
    with pytest.raises(pp.InputError, match="twice as wide"):
        write_crops(scene, lambda _: np.zeros((90, 160, 3), dtype=np.uint8), tmp_path)
    with pytest.raises(pp.InputError, match="no picture"):
        write_crops(scene, lambda _: None, tmp_path)
    with pytest.raises(pp.InputError, match="as the first"):
        write_crops(scene, lambda view: np.zeros((64 + 32 * (view > 3), 128 + 64 * (view > 3), 3), np.uint8), tmp_path)
    with pytest.raises(pp.InputError, match="one a view"):
        write_crops(scene, ["a.jpg"], tmp_path)
    (tmp_path / "a.jpg").write_bytes(b"no picture")
    with pytest.raises(pp.InputError, match=r"a\.jpg"):
        write_crops(scene, [tmp_path / "a.jpg"] * len(scene.centers), tmp_path)
    with pytest.raises(pp.InputError, match="component 7"):
        write_crops(scene, look(scene), tmp_path, component=7)
    for wrong in ({"kind": "fish"}, {"size_px": 3}, {"fov_deg": 200.0}, {"n_around": 0}, {"suffix": ".gif"}):
        with pytest.raises(pp.InputError, match=next(iter(wrong))):
            CropOptions(**wrong)


def test_without_opencv_the_extra_is_named(tmp_path: Path, scene: pp.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.jpg").write_bytes(b"anything")
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(pp.InputError, match=r"panopath\[images\]"):
        read_image(tmp_path / "a.jpg")
    with pytest.raises(pp.InputError, match=r"panopath\[images\]"):
        write_crops(scene, look(scene), tmp_path)


def test_names_stay_apart(tmp_path: Path, scene: pp.Scene) -> None:
    """Views of the same name in different folders do not overwrite each other."""
    names = tuple(f"{'ab'[i % 2]}/{i // 2}.jpg" for i in range(len(scene.centers)))
    made = write_crops(replace(scene, view_names=names), look(scene), tmp_path, CropOptions(size_px=16))
    assert len(list((tmp_path / "images").iterdir())) == made.n_images


def test_files_and_functions_are_the_same(tmp_path: Path, scene: pp.Scene) -> None:
    files: list[Path | None] = []
    for view in range(len(scene.centers)):
        known = bool(np.isfinite(scene.cam_from_world[view]).all())
        files.append(tmp_path / f"é {view}.png" if known else None)
        if known:
            (tmp_path / f"é {view}.png").write_bytes(encoded(look(scene)(view), ".png"))
    source = image_source(files, len(files))
    first = source(0)
    assert first is not None
    assert np.array_equal(first, look(scene)(0))
    assert np.array_equal(point_colours(scene, source), point_colours(scene, look(scene)))


# nerfstudio


def rays_of_nerfstudio(frame: dict[str, Any], content: dict[str, Any], pixel: Float) -> Float:
    """Directions in the world as nerfstudio's documentation and cameras define them."""
    x = (pixel[:, 0] - content["cx"]) / content["fl_x"]
    y = -(pixel[:, 1] - content["cy"]) / content["fl_y"]
    if content["camera_model"] == "EQUIRECTANGULAR":
        theta, phi = np.pi * x, np.pi * (0.5 - y)
        gl = np.stack((np.sin(theta) * np.sin(phi), np.cos(phi), -np.cos(theta) * np.sin(phi)), axis=1)
    else:
        gl = np.stack((x, y, -np.ones_like(x)), axis=1)
    matrix = np.array(frame["transform_matrix"])
    assert np.allclose(matrix[3], (0, 0, 0, 1))
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)
    world = gl @ matrix[:3, :3].T
    return np.asarray(world / np.linalg.norm(world, axis=1, keepdims=True))


def check_schema(content: dict[str, Any]) -> None:
    """The keys of nerfstudio's data format, with their types."""
    assert content["camera_model"] in ("OPENCV", "OPENCV_FISHEYE", "PINHOLE", "EQUIRECTANGULAR")
    for name in ("fl_x", "fl_y", "cx", "cy"):
        assert isinstance(content[name], float)
    for name in ("w", "h"):
        assert isinstance(content[name], int)
    assert np.array(content["applied_transform"]).shape == (3, 4)
    for frame in content["frames"]:
        assert set(frame) <= {"file_path", "transform_matrix", "mask_path"}
        assert np.array(frame["transform_matrix"]).shape == (4, 4)
        assert not Path(frame["file_path"]).is_absolute()


def test_panoramas_for_nerfstudio(tmp_path: Path, scene: pp.Scene) -> None:
    assert scene.tracks is not None
    files = [f"images/{i}.jpg" for i in range(len(scene.centers))]
    colours = point_colours(scene, look(scene))
    write_nerfstudio(scene, files, tmp_path, (WIDTH, WIDTH // 2), colours=colours, masks=["m.png", *[None] * 11])
    content = json.loads((tmp_path / "transforms.json").read_text())
    check_schema(content)
    assert content["fl_x"] == content["fl_y"] == content["h"]
    assert content["frames"][0]["mask_path"] == "m.png"
    for frame in content["frames"]:
        view = files.index(frame["file_path"])
        rows = np.flatnonzero((scene.tracks.view == view) & scene.inlier)
        bearing = scene.tracks.bearing[rows]
        pixel = equirectangular_from_bearings(bearing, WIDTH, WIDTH / 2)
        assert np.allclose(rays_of_nerfstudio(frame, content, pixel), bearing @ scene.cam_from_world[view], atol=1e-9)
        assert np.array_equal(np.array(frame["transform_matrix"])[:3, 3], scene.centers[view])
    back = read_transforms(tmp_path / "transforms.json")
    solved = scene.view_component == 0
    assert np.allclose(back.cam_from_world, scene.cam_from_world[solved])
    assert np.array_equal(back.centers, scene.centers[solved])
    assert (tmp_path / str(back.ply)).read_bytes().startswith(b"ply")


def test_crops_for_nerfstudio(tmp_path: Path, scene: pp.Scene) -> None:
    write_crops(scene, look(scene), tmp_path, CropOptions("perspective", 80, 70.0, 3, suffix=".png"))
    content = json.loads((tmp_path / "transforms.json").read_text())
    check_schema(content)
    x, y = np.meshgrid(np.arange(80) + 0.5, np.arange(80) + 0.5)
    for frame in content["frames"]:
        crop = read_image(tmp_path / frame["file_path"]).reshape(-1, 3)
        world = rays_of_nerfstudio(frame, content, np.stack((x, y), axis=-1).reshape(-1, 2))
        assert np.abs(crop - colour_of(world)).max() < 3.0
    assert content["ply_file_path"] == "points.ply"


@pytest.mark.parametrize("text", ["{", "[]", '{"frames": []}', '{"frames": [{"transform_matrix": [[1]]}]}'])
def test_refuses_what_is_no_transforms_json(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(pp.InputError, match=r"a\.json"):
        read_transforms(tmp_path / "a.json")


# colours


def test_colours_go_into_ply_and_model(tmp_path: Path, scene: pp.Scene) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="the extra colmap is absent")
    colours = point_colours(scene, look(scene))
    write_scene(scene, tmp_path / "out", colours=colours)
    model = pycolmap.Reconstruction(tmp_path / "out" / "colmap" / "0")
    for point_id, point in model.points3D.items():
        assert np.array_equal(point.color, colours[point_id - 1])
    data = (tmp_path / "out" / "scene.ply").read_bytes()
    head, _, body = data.partition(b"end_header\n")
    assert b"property uchar red" in head
    known = np.flatnonzero(np.isfinite(scene.points).all(axis=1))
    row = np.dtype([("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f4"), ("part", "<i4"), ("camera", "u1")])
    assert np.array_equal(np.frombuffer(body, row, len(known))["rgb"], colours[known])
    with pytest.raises(pp.InputError, match="colours"):
        write_scene(scene, tmp_path / "other", colours=colours[1:])
    assert not (tmp_path / "other").exists()


def test_a_point_that_no_picture_shows_is_grey(scene: pp.Scene) -> None:
    assert np.array_equal(point_colours(scene, lambda _: None), np.full((len(scene.points), 3), 128))
