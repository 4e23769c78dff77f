"""``panopath reconstruct`` on what cannot be used, what shows no scene, and runs that are cut off.

Each ends with one line that says what is wrong, and with 2 (cannot be used) or 3 (does not determine a scene).
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from filmed import (
    Film,
    Said,
    command,
    compared,
    copied,
    digests,
    finished,
    noisy,
    said,
    scene_at,
    stamps,
    started,
    write_film,
)
from panopath.cameras import bearings_from_equirectangular, equirectangular_from_bearings
from panopath.errors import InputError, UndeterminedError
from panopath.evaluate import evaluate
from panopath.formats.crops import CropOptions
from panopath.frontend import read_frames
from panopath.images import encoded
from panopath.mapping import MapOptions
from panopath.run import Reconstructed, RunOptions, place, reconstruct
from panopath.walk import render_walk

av = pytest.importorskip("av", reason="needs the extra video")
cv2 = pytest.importorskip("cv2", reason="needs the extra images")

Frame = npt.NDArray[np.uint8]


def one_line(capsys: Any, source: Path, out: Path, *more: Any, code: int) -> str:
    """Run, and give the one line that complains."""
    told = said(capsys, source, out, *more)
    assert told.code == code, told
    assert len(told.complaints) == 1, told.err
    assert told.out == ""
    assert not (out / "scene.json").exists()
    return told.complaints[0].removeprefix("panopath: ")


# what cannot be used


def picture(path: Path, width: int = 128, height: int = 64) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    noise = np.random.default_rng(len(path.name)).integers(0, 255, (height, width, 3), dtype=np.uint8)
    path.write_bytes(encoded(noise, path.suffix))
    return path


def empty_folder(place: Path) -> Path:
    place.mkdir()
    return place


def one_picture(place: Path) -> Path:
    return picture(place / "a.png").parent


def two_sizes(place: Path) -> Path:
    picture(place / "a.png")
    return picture(place / "b.png", 64, 32).parent


def perspective_pictures(place: Path) -> Path:
    picture(place / "a.png", 128, 96)
    return picture(place / "b.png", 128, 96).parent


def damaged_picture(place: Path) -> Path:
    picture(place / "a.png")
    (place / "b.png").write_bytes(b"\x89PNG no more")
    return place


def perspective_video(place: Path) -> Path:
    return write_film(place.with_suffix(".mp4"), (noisy(np.full((96, 128, 3), 99, np.uint8), k) for k in range(3)))


def one_frame(place: Path) -> Path:
    return write_film(place.with_suffix(".mp4"), [np.full((64, 128, 3), 99, np.uint8)])


def text(place: Path) -> Path:
    place.with_suffix(".mp4").write_text("no video")
    return place.with_suffix(".mp4")


def empty_file(place: Path) -> Path:
    place.with_suffix(".mp4").touch()
    return place.with_suffix(".mp4")


def no_file(place: Path) -> Path:
    return place


def damaged_calibration(place: Path) -> Path:
    picture(place / "left/1.png")
    (place / "rig_config.json").write_text('[{"cameras": [')
    return place


def calibration_without_focal(place: Path) -> Path:
    picture(place / "left/1.png")
    picture(place / "left/2.png")
    camera = {"image_prefix": "left/", "camera_model_name": "PINHOLE", "camera_params": [0, 0, 64, 32]}
    (place / "rig.json").write_text(json.dumps([{"cameras": [camera | {"ref_sensor": True}]}]))
    return place


def rig_without_pictures(place: Path) -> Path:
    picture(place / "left/1.png")
    camera = {"image_prefix": "right/", "camera_model_name": "OPENCV_FISHEYE", "camera_params": [1] * 8}
    (place / "rig.json").write_text(json.dumps([{"cameras": [camera | {"ref_sensor": True}]}]))
    return place


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (empty_folder, "has no pictures (jpg, png, tif, webp), and no rig with its calibration"),
        (one_picture, "has one picture (a.png), expected at least two"),
        (two_sizes, "a.png is 128 x 64 and b.png 64 x 32, expected one size"),
        (perspective_pictures, "the pictures are 128 x 96, expected panoramas, twice as wide as high; or,"),
        (damaged_picture, "b.png: cannot be read as a picture"),
        (perspective_video, "is 128 x 96, expected a 360 video (equirectangular), which is twice as wide as high"),
        (one_frame, "has one frame, expected a video or a folder of several pictures"),
        (text, "cannot be read as a video"),
        (empty_file, "cannot be read as a video"),
        (no_file, "there is no such file or folder"),
        (damaged_calibration, "rig_config.json: cannot be read as a calibration (JSON)"),
        (calibration_without_focal, "rig.json: camera 0: with the parameters [0.0, 0.0, 64.0, 32.0] the camera sees"),
        (rig_without_pictures, "has no pictures below right/, which rig.json names"),
    ],
)
def test_sources_that_cannot_be_used(capsys: Any, tmp_path: Path, make: Any, message: str) -> None:
    source = make(tmp_path / "source")
    assert message in one_line(capsys, source, tmp_path / "out", code=2)
    assert not (tmp_path / "out").exists(), "nothing was begun"


def test_a_calibration_that_is_not_there(capsys: Any, tmp_path: Path) -> None:
    source = two_sizes(tmp_path / "source")
    line = one_line(capsys, source, tmp_path / "out", "--rig", tmp_path / "no.json", code=2)
    assert "no.json: cannot be read" in line


def test_a_recording_without_its_end_has_no_index(capsys: Any, film: Film, tmp_path: Path) -> None:
    """Cameras write the index of an MP4 last."""
    whole = film.path.read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    line = one_line(capsys, tmp_path / "cut.mp4", tmp_path / "out", code=2)
    assert "cut.mp4: cannot be read as a video (it was cut short and has no index)" in line


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--masks", "{}/no.png"), "no.png: there is no such file or folder, expected a mask or a folder of them"),
        (("--masks", "{}/text.png"), "text.png: cannot be decoded, it is damaged or no picture"),
        (("--masks", "{}"), "is a folder, expected one mask for all frames of a video"),
        (("--camera-height", "-1"), "camera_height_m is -1.0, expected a positive number of metres"),
        (("--camera-height", "nan"), "camera_height_m is nan, expected a positive number of metres"),
        (("--baseline", "a", "a", "2"), "baseline is from 'a' to itself, expected two pictures"),
        (("--baseline", "a", "b", "0"), "baseline is 0.0 metres, expected a positive number"),
        (("--baseline", "a", "b", "1", "--camera-height", "2"), "both give the scale, expected one of them"),
        (("--views", "cube", "--no-images"), "crops are cut from kept images, expected keep_images with them"),
        (("--keyframe-parallax", "0"), "parallax_rad is 0.0, expected a positive number"),
    ],
)
def test_options_that_cannot_be_used(
    capsys: Any, film: Film, tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    (tmp_path / "text.png").write_text("no picture")
    given = [option.format(tmp_path) for option in options]
    begin = time.perf_counter()
    assert message in one_line(capsys, film.path, tmp_path / "out", *given, code=2)
    assert time.perf_counter() - begin < 60.0
    assert not (tmp_path / "out").exists(), "nothing was begun"


def test_masks_of_other_pictures(capsys: Any, tmp_path: Path) -> None:
    picture(tmp_path / "source/a.png")
    picture(tmp_path / "source/b.png")
    picture(tmp_path / "masks/c.png")
    line = one_line(capsys, tmp_path / "source", tmp_path / "out", "--masks", tmp_path / "masks", code=2)
    assert "masks: has no mask named like an image, such as a.png" in line


def test_names_of_a_baseline_that_are_not_there(capsys: Any, film: Film, made: Reconstructed, tmp_path: Path) -> None:
    """Of a folder it is said at once; of a video when its keyframes are known, and nothing that was done is lost."""
    picture(tmp_path / "source/a.png")
    picture(tmp_path / "source/b.png")
    line = one_line(capsys, tmp_path / "source", tmp_path / "out", "--baseline", "a.png", "c.png", 2, code=2)
    assert "baseline: there is no picture 'c.png' among those used, expected a name such as a.png, b.png" in line
    assert not (tmp_path / "out").exists()
    out = copied(made.folder, tmp_path / "film")
    before, files = stamps(out), digests(out)
    told = said(capsys, film.path, out, "--baseline", "frame_000000.jpg", "nowhere.jpg", 2)
    assert told.code == 2
    assert "there is no picture 'nowhere.jpg' among those used" in told.complaints[0]
    assert (stamps(out), digests(out)) == (before, files)


# places that cannot be written


def test_out_is_a_file_or_inside_one(capsys: Any, film: Film, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    assert "is a file, expected a folder to write to" in one_line(capsys, film.path, tmp_path / "file", code=2)
    assert "cannot be written (Not a directory)" in one_line(capsys, film.path, tmp_path / "file/out", code=2)
    assert (tmp_path / "file").read_text() == "mine"


def test_out_holds_other_files(capsys: Any, film: Film, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/thesis.txt").write_text("mine")
    line = one_line(capsys, film.path, tmp_path / "out", code=2)
    assert "holds files that are not panopath's; name another folder or ask for overwriting" in line
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["thesis.txt"]


def test_a_file_in_the_place_of_a_folder(capsys: Any, film: Film, made: Reconstructed, tmp_path: Path) -> None:
    """It stands for what cannot be written, since root may write everywhere."""
    for name in ("images", ".work/features", "crops", "colmap"):
        out = copied(made.folder, tmp_path / name.replace("/", "_"))
        shutil.rmtree(out / name)
        (out / name).write_text("mine")
        told = said(capsys, film.path, out, "--views", "cube")
        assert told.code == 2
        (line,) = told.complaints
        assert str(out) in line
        assert re.search("cannot be (read or )?written", line)
        assert (out / name).read_text() == "mine"


def test_out_is_read_only(capsys: Any, film: Film, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    out.chmod(0o555)
    if os.access(out, os.W_OK):
        pytest.skip("root may write everywhere")
    assert f"{out / '.work'}: cannot be written (Permission denied)" in one_line(capsys, film.path, out, code=2)


@pytest.mark.parametrize("stage", ["write", "images", "scene", "report"])
def test_the_disk_is_full(
    film: Film, made: Reconstructed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    """One line, what was done is kept, and the same command goes on when there is room."""
    out = copied(made.folder, tmp_path / "out")
    files = digests(out)
    options = RunOptions(crops=CropOptions("cube"))
    if stage == "write":
        shutil.rmtree(out / ".work")
    elif stage == "images":
        shutil.rmtree(out / "images")

    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        if stage == "write":
            patch.setattr(np, "savez", full)
        elif stage == "images":
            patch.setattr(Path, "write_bytes", full)
        elif stage == "scene":
            patch.setattr(np, "savez_compressed", full)
            patch.setattr(np, "savez", full)
        else:
            patch.setattr(Path, "write_text", full)
        with pytest.raises(InputError, match=r"No space left on device.*make room and give the same command again"):
            reconstruct(film.path, out, options)
    assert list(out.rglob("*.part")) == []
    assert [path for path in out.iterdir() if path.name.startswith(".") and path.name != ".work"] == []
    reconstruct(film.path, out, options)
    assert digests(out) == files


@pytest.mark.skipif(sys.platform == "win32", reason="there are no limits on the size of files")
def test_a_file_cannot_grow(film: Film, tmp_path: Path) -> None:
    """As a disk without room does, here by the system's own refusal: in the middle of a process of its own."""
    script = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (90_000, 90_000)); "
        "from panopath.cli import main; main(sys.argv[1:])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, *command(film.path, tmp_path / "out")],
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    told = Said(done.returncode, done.stdout, done.stderr)
    assert told.code == 2
    (line,) = told.complaints
    assert "cannot be written (File too large); make room and give the same command again: it goes on from here" in line
    assert list((tmp_path / "out").rglob("*.part")) == []


# what shows no scene


@pytest.fixture(scope="module")
def street() -> Frame:
    return render_walk(width_px=1024, n_frames=1, seed=2).frame(0)


def seen(frame: Frame, rays: npt.NDArray[np.float64]) -> Frame:
    """What a panorama shows along (h, w, 3) rays."""
    height, width = rays.shape[:2]
    unit = (rays / np.linalg.norm(rays, axis=2, keepdims=True)).reshape(-1, 3)
    pixels = equirectangular_from_bearings(unit, frame.shape[1], frame.shape[0]).astype(np.float32)
    x, y = np.moveaxis(pixels.reshape(height, width, 2), 2, 0)
    padded = np.concatenate((frame[:, -8:], frame, frame[:, :8]), axis=1)
    found = cv2.remap(padded, x + 7.5, y - 0.5, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.uint8)


def pinhole(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(h, w, 3) rays through a plane at distance one."""
    return np.stack((x, y, np.ones_like(x)), axis=-1)


def turned(frame: Frame, rotation: Any, width: int = 512) -> Frame:
    """The same place seen by a camera turned."""
    height = width // 2
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    ray = bearings_from_equirectangular(np.stack((x.ravel(), y.ravel()), axis=1), width, height)
    return seen(frame, (ray @ cv2.Rodrigues(np.array(rotation))[0]).reshape(height, width, 3))


def turns(k: int) -> tuple[float, float, float]:
    return (0.1 * np.sin(k / 5.0), 0.06 * k, 0.05 * np.sin(k / 4.0))


def films_without_a_scene(kind: str, street: Frame) -> list[Frame]:
    small = turned(street, (0.0, 0.0, 0.0))
    return {
        "still": lambda: [noisy(small, k) for k in range(24)],
        "turning": lambda: [noisy(turned(street, turns(k)), k) for k in range(40)],
        "dark": lambda: [noisy((small * 0.02).astype(np.uint8), k, 2.0) for k in range(12)],
        "black": lambda: [np.zeros_like(small) for _ in range(12)],
        "plain": lambda: [noisy(np.full_like(small, 120), k, 2.0) for k in range(12)],
        "gray": lambda: [np.full_like(small, 120) for _ in range(12)],
        "snow": lambda: [noisy(np.full_like(small, 120), k, 60.0) for k in range(12)],
    }[kind]()


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("still", "the camera stands still: there is no path to find; move it by some metres"),
        ("turning", "the camera only turns|shows no parallax; expected a camera that moves"),
        ("dark", "the video is too dark to follow anything: film with more light"),
        ("black", "the video is too dark to follow anything: film with more light"),
        ("plain", "have no features .dark, blurred or without texture.|there is nothing to follow"),
        ("gray", "there is nothing to follow, no texture"),
        ("snow", "no two pictures match|have no features|shows no parallax"),
    ],
)
def test_videos_that_show_no_scene(capsys: Any, tmp_path: Path, street: Frame, kind: str, message: str) -> None:
    source = write_film(tmp_path / "film.mp4", films_without_a_scene(kind, street))
    line = one_line(capsys, source, tmp_path / "out", code=3)
    assert any(part in line for part in message.replace(".dark", "(dark").replace("texture.", "texture)").split("|"))
    assert line.startswith(str(source))
    # said from what is kept when it is asked again, with the same words
    assert one_line(capsys, source, tmp_path / "out", code=3) == line


@pytest.mark.parametrize("kind", ["still", "turning"])
def test_pictures_that_show_no_scene(capsys: Any, tmp_path: Path, street: Frame, kind: str) -> None:
    place = tmp_path / "pictures"
    place.mkdir()
    for k, frame in enumerate(films_without_a_scene(kind, street)[:8]):
        (place / f"{k}.png").write_bytes(encoded(frame, ".png"))
    line = one_line(capsys, place, tmp_path / "out", code=3)
    assert "no two pictures could be placed, since what they share shows no parallax" in line


def test_pictures_of_different_places(capsys: Any, tmp_path: Path, street: Frame) -> None:
    """A street, its mirror image, and noise have nothing in common."""
    place = tmp_path / "pictures"
    place.mkdir()
    small = turned(street, (0.0, 0.0, 0.0))
    for k, frame in enumerate((small, small[:, ::-1], noisy(np.full_like(small, 120), 1, 60.0))):
        (place / f"{k}.png").write_bytes(encoded(np.ascontiguousarray(frame), ".png"))
    assert said(capsys, place, tmp_path / "out").code == 3


def test_raw_fisheyes_are_told(capsys: Any, film: Film, tmp_path: Path) -> None:
    """Unstitched film of a 360 camera has the shape of a panorama: two circles side by side."""
    at = (np.arange(256) + 0.5) / 128.0 - 1.0
    x, y = np.meshgrid(at, at)
    radius = np.maximum(np.hypot(x, y), 1e-9)
    theta = radius * np.radians(97.0)
    front = np.stack((np.sin(theta) * x / radius, np.sin(theta) * y / radius, np.cos(theta)), axis=-1)
    rays = np.concatenate((front, front * (-1.0, 1.0, -1.0)), axis=1)
    inside = np.concatenate((radius < 1.0, radius < 1.0), axis=1)
    frames = (seen(film.walk.frame(k), rays) * inside[..., None] for k in range(0, 40, 2))
    path = write_film(tmp_path / "raw.mp4", frames)
    told = said(capsys, path, tmp_path / "out")
    assert told.code == 3
    assert "two fisheyes side by side: have the camera's program stitch them first" in told.out + told.err


def test_film_of_a_common_camera_is_told(capsys: Any, film: Film, tmp_path: Path) -> None:
    x, y = np.meshgrid(np.arange(512) - 255.5, np.arange(256) - 127.5)
    frames = (seen(film.walk.frame(k), pinhole(x / 180.0, y / 180.0)) for k in range(0, 40, 2))
    path = write_film(tmp_path / "wide.mp4", frames)
    told = said(capsys, path, tmp_path / "out")
    assert told.code == 3
    assert "do not meet at their left and right edges as those of a 360 camera do" in told.out + told.err


@pytest.mark.parametrize(("factor", "code"), [(1.0, 0), (2.0, 3)])
def test_wrong_intrinsics_are_no_success(capsys: Any, film: Film, tmp_path: Path, factor: float, code: int) -> None:
    place = tmp_path / "pictures"
    place.mkdir()
    x, y = np.meshgrid(np.arange(320) - 159.5, np.arange(320) - 159.5)
    turn = cv2.Rodrigues(np.array((0.0, -np.pi / 4.0, 0.0)))[0]
    for k in range(0, 40, 2):
        frame = seen(film.walk.frame(k), pinhole(x / 160.0, y / 160.0) @ turn.T)
        (place / f"{k:02d}.png").write_bytes(encoded(frame, ".png"))
    focal = 160.0 * factor
    (place / "cameras.txt").write_text(f"1 PINHOLE 320 320 {focal} {focal} 160 160\n")
    told = said(capsys, place, tmp_path / "out", "--json")
    answer = json.loads(told.out)
    assert (told.code, answer["is_determined"]) == (code, code == 0), answer["certificate"]


def test_as_json_the_line_is_in_the_object(capsys: Any, tmp_path: Path, street: Frame) -> None:
    source = write_film(tmp_path / "film.mp4", films_without_a_scene("gray", street))
    told = said(capsys, source, tmp_path / "out", "--json")
    assert told.code == 3
    assert json.loads(told.out) == {"error": told.complaints[0].removeprefix("panopath: ")}
    with pytest.raises(UndeterminedError, match="nothing to follow"):
        reconstruct(source, tmp_path / "out")


# films that are damaged


@pytest.mark.parametrize("share", [0.02, 0.3])
def test_frames_in_the_middle_are_damaged(capsys: Any, film: Film, tmp_path: Path, share: float) -> None:
    """They are passed over and counted; what is placed is right, or said not to be determined."""
    data = bytearray(film.path.read_bytes())
    begin, n = int(0.35 * len(data)), int(share * len(data))
    data[begin : begin + n] = np.random.default_rng(1).integers(0, 256, n, dtype=np.uint8).tobytes()
    (tmp_path / "walk.mp4").write_bytes(data)
    told = said(capsys, tmp_path / "walk.mp4", tmp_path / "out", "--json")
    assert told.code in {0, 3}
    assert told.complaints == []
    answer = json.loads(told.out)
    assert answer["is_determined"] == (told.code == 0)
    assert any("frames could not be decoded and were passed over" in one for one in answer["statements"])
    assert answer["n_frames"] < 40
    # names count decoded frames: by time the truth is found
    scene = scene_at(tmp_path / "out")
    assert scene.tracks is not None
    assert scene.tracks.time_s is not None
    if told.code == 0:
        frames = np.round(scene.tracks.time_s * film.walk.frame_rate_hz).astype(int)
        truth = film.truth.centers[frames]
        assert evaluate(scene, truth).camera_rms < 0.01 * film.length_m


def test_a_film_that_ends_early(capsys: Any, film: Film, tmp_path: Path) -> None:
    """With its index in front it is used as far as it goes, and what is absent is told."""
    whole = tmp_path / "whole.mp4"
    with av.open(str(film.path)) as given, av.open(str(whole), "w", options={"movflags": "faststart"}) as written:
        stream = given.streams.video[0]
        copy = written.add_stream_from_template(stream)
        for packet in given.demux(stream):
            if packet.dts is not None:
                packet.stream = copy
                written.mux(packet)
    data = whole.read_bytes()
    (tmp_path / "walk.mp4").write_bytes(data[: int(0.6 * len(data))])
    told = said(capsys, tmp_path / "walk.mp4", tmp_path / "out", "--json")
    assert told.code == 0, told.err
    answer = json.loads(told.out)
    assert 15 < answer["n_frames"] < 35
    assert any("the file announces 40 frames" in one and "cut short" in one for one in answer["statements"])
    assert compared(scene_at(tmp_path / "out"), film).camera_rms < 0.003 * film.length_m


def test_a_film_that_changes_meanwhile(film: Film) -> None:
    with pytest.raises(InputError, match=r"walk.mp4: frame 40 cannot be read any more; was the file changed\?"):
        list(read_frames(film.path, [38, 40], 128))


def test_a_height_without_ground(
    capsys: Any, film: Film, made: Reconstructed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What cannot be sized is not handed out at another size; what was found is kept."""
    out = copied(made.folder, tmp_path / "out")
    before = stamps(out)
    monkeypatch.setattr(place, "_FEWEST_GROUND", 10**9)
    told = said(capsys, film.path, out, "--camera-height", 1.6)
    assert told.code == 2
    (line,) = told.complaints
    assert "points are seen steeply below the cameras, expected at least" in line
    assert line.endswith("all else is done and kept: another scale, or none, is quick")
    assert stamps(out) == before


# runs that are cut off


def wait_for_features(out: Path, process: Any, n: int) -> None:
    """Wait until so many pictures were measured."""
    deadline = time.monotonic() + 120.0
    while len(list((out / ".work/features").glob("*.npz"))) < n:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_ctrl_c_and_on(film: Film, made: Reconstructed, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = started(film.path, out, "--views", "cube")
    wait_for_features(out, process, 3)
    process.send_signal(signal.SIGINT)
    told = finished(process)
    assert told.code == 130
    assert told.complaints == [f"panopath: stopped; what was done is in {out}: the same command goes on from there"]
    assert len(told.err.splitlines()) == 2, "what was recognised, and the complaint"
    assert told.out == ""
    before = stamps(out)
    assert len(before) < made.n_pictures
    told = finished(started(film.path, out, "--views", "cube"))
    assert told.code == 0, told.err
    after = stamps(out)
    assert all(after[name] == when for name, when in before.items()), "what was done is not done again"
    assert digests(out) == digests(made.folder)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_killed_and_on(film: Film, made: Reconstructed, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for n in (1, 6):
        process = started(film.path, out, "--views", "cube")
        wait_for_features(out, process, n)
        process.kill()
        finished(process)
    # as if it had been writing just then
    (out / ".work/features/000002.npz").write_bytes(b"PK\x03\x04 half a file")
    (out / "images/.frame_000001.jpg.123.part").write_bytes(b"half a picture")
    (out / f".{out.name}.a1b2c3d4").mkdir()
    (out / f".{out.name}.a1b2c3d4/scene.npz").write_bytes(b"half a scene")
    reconstruct(film.path, out, RunOptions(crops=CropOptions("cube")))
    assert digests(out) == digests(made.folder)


def test_another_input_of_the_same_name_begins_again(film: Film, made: Reconstructed, tmp_path: Path) -> None:
    other = render_walk(width_px=640, n_frames=24, frame_rate_hz=4.0, seed=5)
    path = other.write_video(tmp_path / "walk.mp4")
    out = copied(made.folder, tmp_path / "out")
    before = stamps(out)
    done = reconstruct(path, out)
    after = stamps(out)
    assert all(after[name] != before[name] for name in after if name in before and not name.startswith("features/"))
    assert done.n_frames == 24
    assert compared(done.scene, Film(other, path)).camera_rms < 0.004 * Film(other, path).length_m
    fresh = reconstruct(path, tmp_path / "fresh")
    assert digests(out) == digests(tmp_path / "fresh"), "nothing of the other film is left"
    assert fresh.n_pictures == done.n_pictures


def test_changed_options_redo_what_depends_on_them(film: Film, made: Reconstructed, tmp_path: Path) -> None:
    out = copied(made.folder, tmp_path / "out")
    before = stamps(out)
    reconstruct(film.path, out, RunOptions(mapping=MapOptions(seed=1), keep_images=False))
    after = stamps(out)
    assert {name for name in after if after[name] != before[name]} == {"mapped.npz"}
    assert not (out / "images").exists(), "images that this run does not keep"
    assert not (out / "transforms.json").exists()
