"""``reconstruct`` on rendered walks: the path, up and size are right, and other programs open what is written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from filmed import Film, compared, copied, digests, finished, path_length, scene_at, stamps, started, truth_from_scene
from panopath.images import encoded, read_image
from panopath.run import Reconstructed, RunOptions, reconstruct
from panopath.walk import render_walk

pytest.importorskip("av", reason="needs the extra video")
cv2 = pytest.importorskip("cv2", reason="needs the extra images")

from docs.figures_view import Page, find_chromium  # noqa: E402

# the path


def check_path(done: Reconstructed, film: Film, share: float) -> None:
    """Every picture is placed, and near its true place: rms as a share of the path's length."""
    assert done.is_determined
    assert done.scene.n_components == 1
    assert (done.scene.view_component == 0).all()
    found = compared(done.scene, film)
    assert found.n_views == len(done.scene.centers)
    assert found.camera_rms < share * film.length_m


def test_a_video_becomes_a_path(made: Reconstructed, film: Film) -> None:
    check_path(made, film, 0.002)
    assert "360 video, 640 x 320" in made.description
    assert made.n_frames == 40
    assert 10 <= made.n_pictures <= 40
    assert f"{made.n_pictures} keyframes of 40 frames, {made.n_pictures} placed" in made.statements
    assert made.unit == ""
    assert any("scale is arbitrary" in one for one in made.statements)
    assert {"motion", "features", "matching", "mapping", "certificate", "writing", "all"} <= set(made.seconds)
    assert all((made.folder / name).exists() for name in made.files)


def test_up_is_what_the_cameras_call_up(made: Reconstructed, film: Film) -> None:
    tilt = np.arccos(truth_from_scene(made.scene, film)[:, 2, 2])
    assert np.degrees(tilt).max() < 2.0
    assert any("up is what the cameras call up" in one for one in made.statements)


def test_the_height_of_the_camera_gives_metres(made: Reconstructed, film: Film, tmp_path: Path) -> None:
    height = float(film.truth.centers[:, 2].mean())
    out = copied(made.folder, tmp_path / "out")
    before = stamps(out)
    done = reconstruct(film.path, out, RunOptions(camera_height_m=height))
    assert stamps(out) == before, "nothing was measured again"
    assert done.unit == "m"
    assert compared(done.scene, film).scale == pytest.approx(1.0, abs=0.02)
    assert f"scale is from the camera's height above the ground, {height:g} m" in done.statements
    # crops of the run before are not those of this scene
    assert not (out / "crops").exists()


def test_a_known_distance_gives_metres(made: Reconstructed, film: Film, tmp_path: Path) -> None:
    names = made.scene.view_labels()
    a, b = (int(names[k][6:12]) for k in (1, -2))
    metres = float(np.linalg.norm(film.truth.centers[a] - film.truth.centers[b]))
    out = copied(made.folder, tmp_path / "out")
    # with the ending and without it
    done = reconstruct(film.path, out, RunOptions(baseline=(names[1], names[-2].removesuffix(".jpg"), metres)))
    assert done.unit == "m"
    assert compared(done.scene, film).scale == pytest.approx(1.0, abs=0.02)
    assert any("scale is from the distance of frame_" in one for one in done.statements)


@pytest.fixture(scope="module")
def folder(film: Film, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("pictures") / "walk"
    film.walk.write_images(place, every=3)
    return place


def test_a_folder_of_panoramas_with_masks_of_their_own(folder: Path, film: Film, tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    low = np.full((320, 640), 255, dtype=np.uint8)
    low[240:] = 0
    (masks / "frame_00003.png").write_bytes(encoded(low, ".png"))
    done = reconstruct(folder, tmp_path / "out", RunOptions(masks=masks))
    check_path(done, film, 0.003)
    assert done.description == "14 panoramas, 640 x 320"
    assert "14 of 14 pictures placed" in done.statements
    # the view that has a mask has no feature there, others have
    lowest = [below_horizon(done.scene, view).max() for view in range(3)]
    assert lowest[1] < np.pi / 4 + 0.02
    assert min(lowest[0], lowest[2]) > np.pi / 4 + 0.1
    assert (read_image(tmp_path / "out/masks/frame_00003.jpg.png")[250:] == 0).all()
    assert (read_image(tmp_path / "out/masks/frame_00000.jpg.png") == 255).mean() > 0.9
    # pictures stay where they are
    assert not (tmp_path / "out/images").exists()


def below_horizon(scene: pp.Scene, view: int) -> Any:
    assert scene.tracks is not None
    return np.arcsin(scene.tracks.bearing[scene.tracks.view == view, 1])


def test_a_camera_that_keeps_its_direction(tmp_path: Path) -> None:
    walk = render_walk(width_px=640, n_frames=30, frame_rate_hz=4.0, seed=4, rotation="none")
    film = Film(walk, walk.write_video(tmp_path / "locked.mp4"))
    done = reconstruct(film.path, tmp_path / "out")
    check_path(done, film, 0.002)
    assert "the camera keeps its direction, so that positions were solved at once" in done.statements
    assert np.degrees(np.arccos(truth_from_scene(done.scene, film)[:, 2, 2])).max() < 1.0
    # one that is said to turn is not taken for locked, and found as well
    free = reconstruct(film.path, tmp_path / "out", RunOptions(direction_locked=False))
    check_path(free, film, 0.003)
    assert not any("keeps its direction" in one for one in free.statements)


def test_the_operator_is_found_and_masked(tmp_path: Path) -> None:
    walk = render_walk(width_px=640, n_frames=40, frame_rate_hz=4.0, seed=2, operator_share=0.2)
    film = Film(walk, walk.write_video(tmp_path / "walk.mp4"))
    done = reconstruct(film.path, tmp_path / "out")
    check_path(done, film, 0.004)
    assert any("% of the sphere goes with the camera and was left out" in one for one in done.statements)
    mask = read_image(tmp_path / "out/mask.png")[..., 0] == 0
    operator = np.isnan(walk.ranges(0))
    weight = np.cos(np.pi * ((np.arange(320) + 0.5) / 320 - 0.5))[:, None] * np.ones((1, 640))
    assert (weight * (mask & operator)).sum() > 0.6 * (weight * operator).sum()
    assert (weight * (mask & ~operator)).sum() < 0.1 * (weight * ~operator).sum()


def test_a_mask_for_all_frames(film: Film, made: Reconstructed, tmp_path: Path) -> None:
    mask = np.full((160, 320), 255, dtype=np.uint8)
    mask[120:] = 0
    (tmp_path / "mask.png").write_bytes(encoded(mask, ".png"))
    out = copied(made.folder, tmp_path / "out")
    before = stamps(out)
    done = reconstruct(film.path, out, RunOptions(masks=tmp_path / "mask.png"))
    check_path(done, film, 0.003)
    assert all(below_horizon(done.scene, view).max() < np.pi / 4 + 0.02 for view in range(len(done.scene.centers)))
    written = read_image(out / "mask.png")[..., 0]
    assert written.shape == (320, 640)
    assert (written[241:] == 0).all()
    assert (written[:200] == 255).mean() > 0.9
    # how the camera moved does not depend on it, what was seen does
    changed = {name for name, when in stamps(out).items() if before.get(name) != when}
    assert "motion.npz" not in changed
    assert {"matches.npz", "mapped.npz", "features/000000.npz"} <= changed


# what other programs open


def test_colmap_model(made: Reconstructed) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="the extra colmap is absent")
    model = pycolmap.Reconstruction(made.folder / "colmap/0")
    scene = made.scene
    assert model.num_images() == len(scene.centers)
    assert {camera.model.name for camera in model.cameras.values()} == {"EQUIRECTANGULAR"}
    assert {(camera.width, camera.height) for camera in model.cameras.values()} == {(640, 320)}
    index = {name: view for view, name in enumerate(scene.view_labels())}
    for image in model.images.values():
        picture = read_image(made.folder / "images" / image.name)
        assert picture.shape == (320, 640, 3)
        np.testing.assert_allclose(image.projection_center(), scene.centers[index[image.name]], atol=1e-9)
    assert model.num_points3D() == scene.summary.n_solved_points
    assert 0.0 < model.compute_mean_reprojection_error() < 1.0
    colours = np.array([point.color for point in model.points3D.values()])
    assert len(np.unique(colours, axis=0)) > 100


def test_nerfstudio(made: Reconstructed) -> None:
    content = json.loads((made.folder / "transforms.json").read_text())
    assert content["camera_model"] == "EQUIRECTANGULAR"
    index = {name: view for view, name in enumerate(made.scene.view_labels())}
    assert len(content["frames"]) == len(index)
    for frame in content["frames"]:
        assert (made.folder / frame["file_path"]).is_file()
        center = np.array(frame["transform_matrix"])[:3, 3]
        np.testing.assert_allclose(center, made.scene.centers[index[Path(frame["file_path"]).name]], atol=1e-9)
    assert (made.folder / content["ply_file_path"]).is_file()


def test_crops(made: Reconstructed) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="the extra colmap is absent")
    model = pycolmap.Reconstruction(made.folder / "crops/sparse/0")
    assert model.num_images() == 6 * len(made.scene.centers)
    assert {camera.model.name for camera in model.cameras.values()} == {"PINHOLE"}
    errors = []
    for point in model.points3D.values():
        for element in point.track.elements:
            image = model.images[element.image_id]
            predicted = image.project_point(point.xyz)
            assert predicted is not None
            errors.append(np.linalg.norm(predicted - image.points2D[element.point2D_idx].xy))
    assert len(errors) == made.scene.inlier.sum()
    # a crop is as fine as the panorama at the equator, and up to three times as wide at its corners
    assert np.median(errors) < 0.5
    assert np.quantile(errors, 0.99) < 4.0
    names = {image.name for image in model.images.values()}
    assert names == {path.name for path in (made.folder / "crops/images").iterdir()}


def test_scene_and_run_tell_what_was_done(made: Reconstructed) -> None:
    scene = json.loads((made.folder / "scene.json").read_text())
    assert scene["certificate"]["verdict"] == "determined"
    run = json.loads((made.folder / "run.json").read_text())
    assert run["kind"] == "video"
    assert run["images"] == "images"
    assert run["source"] == made.description
    assert run["statements"] == list(made.statements)
    assert run["is_upright"] is True
    assert run["settings"]["crops"]["kind"] == "cube"
    assert scene_at(made.folder).view_labels() == made.scene.view_labels()
    np.testing.assert_array_equal(scene_at(made.folder).centers, made.scene.centers)


@pytest.mark.skipif(find_chromium() is None, reason="Chromium is absent")
def test_the_report_opens(made: Reconstructed) -> None:
    pytest.importorskip("websockets", reason="the extra view is absent")
    with Page.open(1280, 900) as page:
        page.go((made.folder / "report.html").resolve().as_uri())
        page.wait_for("document.documentElement.dataset.drawn === 'yes'")
        text = page.evaluate("document.body.innerText")
        pictures = page.evaluate("[...document.images].filter((p) => p.complete && p.naturalWidth > 0).length")
        assert page.errors == []
        assert [url for url in page.asked if not url.startswith(("file:", "data:", "about:"))] == []
    assert "walk.mp4" in text
    assert "determined" in text.lower()
    assert made.statements[0] in text
    assert pictures >= 10


# the same again


@pytest.mark.parametrize("threads", [1, 2])
def test_the_same_on_any_number_of_threads(made: Reconstructed, film: Film, tmp_path: Path, threads: int) -> None:
    out = tmp_path / "out"
    done = finished(started(film.path, out, "--views", "cube", "--json", RAYON_NUM_THREADS=threads))
    assert done.code == 0, done.err
    assert json.loads(done.out)["is_determined"] is True
    assert digests(out) == digests(made.folder)


def test_nothing_is_done_twice_but_by_force(made: Reconstructed, film: Film, tmp_path: Path) -> None:
    options = RunOptions(crops=pp.formats.CropOptions("cube"))
    out = copied(made.folder, tmp_path / "out")
    before, files = stamps(out), digests(out)
    reconstruct(film.path, out, options)
    assert stamps(out) == before
    assert digests(out) == files
    reconstruct(film.path, out, options, force=True)
    after = stamps(out)
    assert set(after) == set(before)
    assert all(after[name] != before[name] for name in before)
    assert digests(out) == files


def test_a_path_has_its_length(made: Reconstructed, film: Film) -> None:
    found = compared(made.scene, film)
    assert path_length(found.aligned_centers) == pytest.approx(film.length_m, rel=0.05)
