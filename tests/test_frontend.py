"""The front end on small synthetic pictures: what sources are, features, matches, video."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from panopath.cameras import bearings_from_equirectangular, equirectangular_from_bearings
from panopath.checkpoints import Checkpoints
from panopath.errors import InputError
from panopath.mapping import MapOptions, map_database

cv2 = pytest.importorskip("cv2", reason="needs the extra images")
pytest.importorskip("PIL", reason="needs the extra images")

from panopath.frontend import (  # noqa: E402
    FeatureOptions,
    Features,
    FrontEndOptions,
    MatchingOptions,
    SourceKind,
    VideoFrame,
    VideoKind,
    VideoOptions,
    candidate_pairs,
    choose_keyframes,
    extract_features,
    match_images,
    measure,
    read_frames,
    read_header,
    recognise,
    video_motion,
)
from panopath.frontend.features import FeatureFinder  # noqa: E402
from panopath.frontend.video import DecodedFrames, _ahead, _frames, _gray  # noqa: E402

Gray = npt.NDArray[np.uint8]
W = 512


def rotation(x: float, y: float, z: float) -> npt.NDArray[np.float64]:
    return np.asarray(cv2.Rodrigues(np.array([x, y, z]))[0])


def texture(seed: int, size: int = 256) -> Gray:
    """Blobs of several sizes, periodic."""
    rng = np.random.default_rng(seed)
    total = np.zeros((size, size))
    for cells in (8, 24, 64, 128):
        noise = rng.normal(size=(cells, cells)).astype(np.float32)
        total += cv2.resize(np.tile(noise, (3, 3)), (3 * size, 3 * size), interpolation=cv2.INTER_CUBIC)[
            size : 2 * size, size : 2 * size
        ]
    return np.asarray(np.clip(128 + 45 * total, 0, 255), dtype=np.uint8)


@functools.cache
def walls() -> Gray:
    return np.concatenate([texture(k) for k in range(6)])


def room(center: npt.ArrayLike, cam_from_world: npt.NDArray[np.float64], width: int = W) -> Gray:
    """A panorama in a box of 8 x 6 x 4 with textured walls."""
    x, y = np.meshgrid(np.arange(2 * width) + 0.5, np.arange(width) + 0.5)
    pixels = np.stack((x.ravel(), y.ravel()), axis=1)
    ray = bearings_from_equirectangular(pixels, 2 * width, width) @ cam_from_world
    at, half = np.asarray(center, dtype=np.float64), np.array([4.0, 3.0, 2.0])
    with np.errstate(divide="ignore"):
        distance = np.where(ray > 0, (half - at) / ray, (-half - at) / ray)
    wall = np.argmin(distance, axis=1)
    hit = at + ray * distance[np.arange(len(ray)), wall][:, None]
    side = np.take_along_axis(ray, wall[:, None], axis=1)[:, 0] > 0
    u, v = np.where(wall == 0, hit[:, 1], hit[:, 0]), np.where(wall == 2, hit[:, 1], hit[:, 2])
    # the textures of the walls stand one above the other
    map_x, map_y = (u * 30.0) % 255.0, (v * 30.0) % 255.0 + 256.0 * (2 * wall + side)
    maps = [part.astype(np.float32).reshape(width, 2 * width) for part in (map_x, map_y)]
    full = cv2.remap(walls(), *maps, cv2.INTER_LINEAR)
    return np.asarray(cv2.resize(full, (width, width // 2), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def walk(n: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    t = np.arange(n) / max(n - 1, 1)
    centers = np.stack((-1.5 + 3.0 * t, 0.8 * np.sin(3.0 * t), 0.2 * np.cos(5.0 * t)), axis=1)
    return centers, np.array([rotation(0.3 * s, 0.8 * s, -0.5 * s) for s in t])


@pytest.fixture(scope="module")
def frames() -> list[Gray]:
    return [room(c, r) for c, r in zip(*walk(24), strict=True)]


@pytest.fixture(scope="module")
def pictures(frames: list[Gray]) -> list[Gray]:
    return frames[::3]


@pytest.fixture
def folder(pictures: list[Gray], tmp_path: Path) -> Path:
    for k, picture in enumerate(pictures):
        cv2.imwrite(str(tmp_path / f"{k}.png"), picture)
    return tmp_path


def video(
    path: Path, frames: list[Gray], rate: int = 10, codec: str = "mpeg4", options: dict[str, str] | None = None
) -> Path:
    av = pytest.importorskip("av", reason="needs the extra video")
    if codec not in av.codecs_available:
        pytest.skip(f"this FFmpeg has no {codec}")
    with av.open(str(path), "w") as out:
        stream = out.add_stream(codec, rate=rate, options=options or {})
        stream.height, stream.width = frames[0].shape
        stream.bit_rate, stream.pix_fmt = 8_000_000, "yuv420p"
        for picture in frames:
            shown = av.VideoFrame.from_ndarray(np.repeat(picture[..., None], 3, axis=2), format="rgb24")
            out.mux(stream.encode(shown))
        out.mux(stream.encode())
    return path


# features


def test_features_are_where_the_world_is() -> None:
    turn = rotation(0.5, 1.9, -0.8)
    first, second = (room([0.3, 0.2, 0.1], r, 768) for r in (np.eye(3), turn))
    found = [extract_features(p, FeatureOptions(max_features=1500)) for p in (first, second)]
    rays = [bearings_from_equirectangular(f.pixels, 768, 384) for f in found]
    matches = match_images(found, rays, 2 * np.pi / 768)
    a, b = (rays[side][matches.matches[:, side]] for side in range(2))
    off = np.linalg.norm(a @ turn.T - b, axis=1) * 768 / (2 * np.pi)
    assert len(off) > 500
    assert np.mean(off < 1.5) > 0.98
    assert np.median(off) < 0.25  # a quarter of a pixel in x and in y would be 0.35


def test_features_are_everywhere_on_the_sphere(pictures: list[Gray]) -> None:
    found = extract_features(pictures[0], FeatureOptions(max_features=600))
    assert len(found) == 600
    rays = bearings_from_equirectangular(found.pixels, W, W // 2)
    for axis in range(3):
        for side in (-1, 1):
            assert np.sum(side * rays[:, axis] > np.cos(np.radians(45))) > 30, (axis, side)
    # the seam has as many as the middle
    near_seam = np.minimum(found.pixels[:, 0], W - found.pixels[:, 0]) < 20
    assert near_seam.sum() > 0.4 * np.sum(np.abs(found.pixels[:, 0] - W / 2) < 20)
    assert ((found.pixels >= 0) & (found.pixels <= [W, W // 2])).all()


def test_features_are_the_same_again(pictures: list[Gray]) -> None:
    first, again = (extract_features(pictures[1]) for _ in range(2))
    np.testing.assert_array_equal(first.pixels, again.pixels)
    np.testing.assert_array_equal(first.descriptors, again.descriptors)


@pytest.mark.parametrize("most", [60, 4000])
@pytest.mark.parametrize("blur", [0.0, 5.0])
def test_features_described_at_once_are_the_same(pictures: list[Gray], most: int, blur: float) -> None:
    # of a blurred picture none is found in the doubled one
    shown = [np.asarray(cv2.GaussianBlur(p, (0, 0), blur), dtype=np.uint8) if blur else p for p in pictures[:3]]
    options = FeatureOptions(max_features=most)
    find = FeatureFinder(options)
    for picture in shown:
        own, expected = find(picture), extract_features(picture, options)
        np.testing.assert_array_equal(own.pixels, expected.pixels)
        np.testing.assert_array_equal(own.descriptors, expected.descriptors)
    assert len(find(shown[0])) > 20
    find._at_once = True
    np.testing.assert_array_equal(find(shown[0]).descriptors, extract_features(shown[0], options).descriptors)


def test_masks_are_kept_clear(pictures: list[Gray]) -> None:
    mask = np.ones((16, 32), dtype=np.uint8)
    mask[10:] = 0
    found = extract_features(pictures[0], mask=mask)
    assert len(found) > 100
    assert found.pixels[:, 1].max() < 10 / 16 * (W // 2)


@pytest.mark.parametrize("value", [0, 128, 255])
def test_nothing_to_see(value: int) -> None:
    assert len(extract_features(np.full((64, 128), value, dtype=np.uint8))) == 0


def test_features_refuse() -> None:
    with pytest.raises(InputError, match="100 x 64, expected a panorama twice as wide as high"):
        extract_features(np.zeros((64, 100), dtype=np.uint8))
    with pytest.raises(InputError, match="expected \\(height, width\\) bytes"):
        extract_features(np.zeros((64, 128)))
    with pytest.raises(InputError, match="max_features is 0"):
        FeatureOptions(max_features=0)


# sources


def test_a_folder_of_panoramas(folder: Path) -> None:
    source = recognise(folder)
    assert source.kind is SourceKind.PANORAMAS
    assert source.names == tuple(f"{k}.png" for k in range(8))
    assert source.description == f"8 panoramas, {W} x {W // 2}"


def test_numbers_are_in_their_order(tmp_path: Path) -> None:
    for k in (10, 9, 100, 1):
        cv2.imwrite(str(tmp_path / f"a{k}.jpg"), np.zeros((8, 16), dtype=np.uint8))
    assert recognise(tmp_path).names == ("a1.jpg", "a9.jpg", "a10.jpg", "a100.jpg")


def test_bad_folders(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no pictures"):
        recognise(tmp_path)
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((64, 128), dtype=np.uint8))
    with pytest.raises(InputError, match=r"has one picture \(a.png\), expected at least two"):
        recognise(tmp_path)
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((32, 64), dtype=np.uint8))
    with pytest.raises(InputError, match=r"a.png is 128 x 64 and b.png 64 x 32, expected one size"):
        recognise(tmp_path)
    (tmp_path / "b.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"b.png: cannot be read as a picture"):
        recognise(tmp_path)
    with pytest.raises(InputError, match="there is no such file or folder"):
        recognise(tmp_path / "absent")


def test_perspective_pictures_need_intrinsics(tmp_path: Path) -> None:
    for name in "ab":
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((48, 64), dtype=np.uint8))
    with pytest.raises(InputError, match="expected panoramas, twice as wide as high; or"):
        recognise(tmp_path)
    (tmp_path / "cameras.txt").write_text("# a camera\n1 PINHOLE 64 48 50 50 32 24\n", encoding="utf-8")
    source = recognise(tmp_path)
    assert source.kind is SourceKind.PERSPECTIVE
    assert source.cameras[0].params == (50.0, 50.0, 32.0, 24.0)
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 64 64 50 50 32 24\n", encoding="utf-8")
    with pytest.raises(InputError, match="the camera is 64 x 64, but the pictures are 64 x 48"):
        recognise(tmp_path)


def rig_folder(folder: Path, change: dict[str, Any] | None = None) -> Path:
    for side in ("left", "right"):
        (folder / side).mkdir(exist_ok=True)
        for k in range(3):
            cv2.imwrite(str(folder / side / f"{k}.png"), np.zeros((32, 32), dtype=np.uint8))
    lens = {"camera_model_name": "OPENCV_FISHEYE", "camera_params": [10, 10, 16, 16, 0, 0, 0, 0]}
    right = {"image_prefix": "right/", "cam_from_rig_rotation": [0, 0, 1, 0], "cam_from_rig_translation": [0, 0, -0.03]}
    cameras = [{"image_prefix": "left/", "ref_sensor": True, **lens}, {**right, **lens, **(change or {})}]
    (folder / "rig.json").write_text(json.dumps([{"cameras": cameras}]), encoding="utf-8")
    return folder


def test_a_rig(tmp_path: Path) -> None:
    source = recognise(rig_folder(tmp_path))
    assert source.kind is SourceKind.RIG
    assert source.image_frame.tolist() == [0, 0, 1, 1, 2, 2]
    assert source.image_camera.tolist() == [0, 1, 0, 1, 0, 1]
    np.testing.assert_allclose(source.sensor_from_rig[1], np.diag([-1.0, 1.0, -1.0]), atol=1e-12)
    np.testing.assert_allclose(source.center_in_rig[1], [0, 0, -0.03], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_params": "wide"}, "expected numbers"),
        ({"cam_from_rig_rotation": [0, 0, 0, 0]}, "no quaternion"),
        ({"image_prefix": "middle/"}, "has no pictures below middle/"),
    ],
)
def test_bad_rigs(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        recognise(rig_folder(tmp_path, change))


def test_an_unreadable_calibration(tmp_path: Path) -> None:
    (rig_folder(tmp_path) / "rig.json").write_text("[{", encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read as a calibration"):
        recognise(tmp_path)


def test_headers(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    picture, exif = image.new("L", (64, 32)), image.Exif()
    gps = exif.get_ifd(0x8825)
    gps.update({1: "S", 2: (48.0, 30.0, 36.0), 3: "W", 4: (2.0, 15.0, 0.0), 5: b"\x01", 6: 12.5})
    exif.get_ifd(0x8769).update({0x9003: "2021:07:29 11:16:42", 0x9291: "25"})
    xmp = b'<x xmlns:GPano="g" GPano:ProjectionType="equirectangular"/>'
    picture.save(tmp_path / "a.jpg", exif=exif, xmp=xmp)
    header = read_header(tmp_path / "a.jpg")
    assert header.position_wgs84 == pytest.approx((-48.51, -2.25, -12.5))
    assert header.projection == "equirectangular"
    assert header.time_s == pytest.approx(1627557402.25)


# matching


def test_a_few_images_are_matched_with_all(pictures: list[Gray]) -> None:
    found = [extract_features(p, FeatureOptions(max_features=300)) for p in pictures]
    assert len(candidate_pairs(found)) == 28
    few = candidate_pairs(found, MatchingOptions(exhaustive_images=2, neighbours=2, look_alikes=0))
    assert len(few) == 7 + 6
    assert (few[:, 0] < few[:, 1]).all()


def test_returning_places_look_alike(pictures: list[Gray]) -> None:
    # there and back: what follows the turn looks like what came before it, though the camera has turned over
    centers, turns = (rows[::3] for rows in walk(24))
    back = [room(c, rotation(0.0, 2.5, 0.0) @ r) for c, r in zip(centers, turns, strict=True)][::-1]
    found = [extract_features(p, FeatureOptions(max_features=500)) for p in pictures + back]
    options = MatchingOptions(exhaustive_images=2, neighbours=2, look_alikes=2)
    pairs = {tuple(p) for p in candidate_pairs(found, options).tolist()}
    assert sum(any((i, j) in pairs for j in (14 - i, 15 - i, 16 - i)) for i in range(6)) >= 5


def test_known_places_pair_the_nearest(pictures: list[Gray]) -> None:
    found = [extract_features(p, FeatureOptions(max_features=50)) for p in pictures]
    places = np.array([[10.0 * (k % 4), 0.0, 0.0] for k in range(8)])
    places[7] = np.nan
    options = MatchingOptions(exhaustive_images=2, look_alikes=0, nearest=1, neighbours=1)
    pairs = {tuple(p) for p in candidate_pairs(found, options, False, places).tolist()}
    assert pairs >= {(0, 4), (1, 5), (2, 6)}


# from end to end


def test_look_alikes_that_share_the_sky_alone_are_not_matched() -> None:
    # hills seen from both sides of a loop: tracks over the whole path would tear it
    rng = np.random.default_rng(0)
    ray = rng.normal(size=(150, 3))
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    descriptors = rng.integers(0, 90, (150, 128)).astype(np.uint8)
    pixels = equirectangular_from_bearings(ray, W, W // 2)
    images = [Features(pixels, descriptors)] * 7
    options = MatchingOptions(neighbours=2)
    for in_sequence, expected in ((True, [[0, 1], [0, 2]]), (False, [[0, 1], [0, 2], [0, 3], [0, 6]])):
        found = match_images(
            images,
            [ray] * 7,
            2.0 * np.pi / W,
            options,
            in_sequence=in_sequence,
            pairs=[[0, 1], [0, 2], [0, 3], [0, 6]],
        )
        assert found.pairs.tolist() == expected


def rmse(centers: npt.NDArray[np.float64], truth: npt.NDArray[np.float64]) -> float:
    """Root mean square after the best similarity, over the rms distance from the middle (Umeyama 1991)."""
    a, b = centers - centers.mean(axis=0), truth - truth.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    fitted = a @ (u @ sign @ vt).T * (s @ np.diag(sign)) / (a**2).sum()
    return float(np.sqrt(((fitted - b) ** 2).sum() / (b**2).sum()))


def test_a_folder_becomes_a_scene(folder: Path) -> None:
    seen: list[str] = []
    found = measure(recognise(folder), each=lambda picture: seen.append(picture.name))
    assert seen == [f"{k}.png" for k in range(8)]
    scene = map_database(found.database, MapOptions()).scene
    assert (scene.view_component == 0).all()
    assert rmse(scene.centers, walk(24)[0][::3]) < 5e-3


def test_pixels_are_those_of_the_full_picture(folder: Path) -> None:
    found = measure(recognise(folder), FrontEndOptions(width=W // 2))
    assert found.database.cameras[0].width == W
    assert found.features[0].pixels[:, 0].max() > 0.9 * W
    np.testing.assert_allclose(found.database.pixel_rad, 2 * 2 * np.pi / W)


def test_what_goes_with_the_camera_is_found_once(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, source = Checkpoints(tmp_path_factory.mktemp("work")), recognise(folder)
    first = measure(source, store=store)
    monkeypatch.setattr("panopath.frontend.pictures.find_fixed", lambda *_: pytest.fail("found again"))
    again = measure(source, store=store)
    assert len(first.fixed) == len(again.fixed) == 1
    for name in ("cell_rad", "is_fixed", "n_tried", "n_stayed", "share", "refused_share"):
        np.testing.assert_array_equal(getattr(again.fixed[0], name), getattr(first.fixed[0], name))
    assert first.fixed[0].n_tried.any()


def test_masks_of_pictures(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    masks = tmp_path_factory.mktemp("masks")
    mask = np.full((32, 64), 255, dtype=np.uint8)
    mask[20:] = 0
    cv2.imwrite(str(masks / "2.png"), mask)
    found = measure(recognise(folder), masks=masks)
    lowest = [f.pixels[:, 1].max() / (W // 2) for f in found.features]
    assert lowest[2] < 20 / 32 < min(lowest[:2] + lowest[3:])
    every = measure(recognise(folder), masks=masks / "2.png")
    assert max(f.pixels[:, 1].max() for f in every.features) < 20 / 32 * (W // 2)
    (masks / "2.png").rename(masks / "other.png")
    with pytest.raises(InputError, match=r"has no mask named like an image, such as 0.png"):
        measure(recognise(folder), masks=masks)


def test_pictures_without_features_are_named(folder: Path) -> None:
    cv2.imwrite(str(folder / "3.png"), np.zeros((W // 2, W), dtype=np.uint8))
    assert measure(recognise(folder)).empty == ("3.png",)
    for k in range(8):
        cv2.imwrite(str(folder / f"{k}.png"), np.full((W // 2, W), 3, dtype=np.uint8))
    with pytest.raises(InputError, match="8 of 8 pictures have no features"):
        measure(recognise(folder))


def test_pictures_of_different_places_do_not_match(tmp_path: Path) -> None:
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"{k}.png"), cv2.resize(texture(50 + k, 512), (W, W // 2)))
    with pytest.raises(InputError, match="no two pictures match"):
        measure(recognise(tmp_path))


# video


def test_a_video_becomes_a_scene(frames: list[Gray], tmp_path: Path) -> None:
    centers, turns = walk(24)
    path = video(tmp_path / "walk.mp4", frames)
    options = FrontEndOptions(video=VideoOptions(motion_width=256, least_keyframes=8))
    found = measure(recognise(path), options)
    assert found.motion is not None
    assert found.motion.kind is VideoKind.MOVING
    assert found.frame_index is not None
    assert 8 <= len(found.frame_index) <= 24
    scene = map_database(found.database, MapOptions()).scene
    assert (scene.view_component == 0).all()
    assert rmse(scene.centers, centers[found.frame_index]) < 2e-2
    # rotations chained from frame to frame are rough, not wrong
    last = found.motion.cam_from_first[-1] @ (turns[-1] @ turns[0].T).T
    assert np.degrees(np.arccos(np.clip(0.5 * (np.trace(last) - 1.0), -1.0, 1.0))) < 6.0


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (VideoKind.STILL, "stands still"),
        (VideoKind.PURE_ROTATION, "only turns"),
        (VideoKind.DARK, "too dark"),
        (VideoKind.TEXTURELESS, "no texture"),
    ],
)
def test_videos_without_a_path(tmp_path: Path, kind: VideoKind, message: str) -> None:
    if kind is VideoKind.DARK or kind is VideoKind.TEXTURELESS:
        shade = 2 if kind is VideoKind.DARK else 150
        made = [np.full((128, 256), shade, dtype=np.uint8)] * 8
    else:
        turn = 0.0 if kind is VideoKind.STILL else 0.03
        made = [room([0, 0, 0], rotation(0.0, turn * k, 0.3 * turn * k), 256) for k in range(8)]
    path = video(tmp_path / "a.mp4", made)
    assert video_motion(path, VideoOptions(motion_width=256)).kind is kind
    with pytest.raises(InputError, match=message):
        measure(recognise(path), FrontEndOptions(video=VideoOptions(motion_width=256)))


def test_keyframes_avoid_blur(frames: list[Gray], tmp_path: Path) -> None:
    frames = list(frames)
    blurred = set(range(0, 24, 2))
    for k in blurred:
        frames[k] = np.asarray(cv2.GaussianBlur(frames[k], (0, 0), 2.5), dtype=np.uint8)
    options = VideoOptions(motion_width=256, least_keyframes=5, parallax_rad=1.0)
    motion = video_motion(video(tmp_path / "a.mp4", frames), options)
    chosen = choose_keyframes(motion, options)
    # the ends have one frame each to choose from on one side
    assert not blurred & set(chosen[1:-1].tolist())


def test_damaged_frames_are_passed_over(frames: list[Gray], tmp_path: Path) -> None:
    path = video(tmp_path / "a.mp4", frames[:16])
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(0)
    begin = data.find(b"mdat")
    for at in rng.integers(begin + len(data) // 3, begin + len(data) // 2, 300).tolist():
        data[min(at, len(data) - 2000)] = 255
    path.write_bytes(bytes(data))
    motion = video_motion(path, VideoOptions(motion_width=256))
    assert len(motion) + motion.n_corrupt >= 15
    assert [frame.index for frame in read_frames(path, [0, 2], 256)] == [0, 2]


def same_frames(path: Path, indices: list[int], **known: Any) -> bool:
    """Whether frames are those found by counting."""
    one, other = (list(read_frames(path, indices, 256, color=True, **given)) for given in (known, {}))

    def bytes_of(frame: VideoFrame) -> tuple[bytes, bytes]:
        assert frame.color is not None
        return frame.gray.tobytes(), frame.color.tobytes()

    return [frame.index for frame in one] == indices and all(
        a.time_s == b.time_s and bytes_of(a) == bytes_of(b) for a, b in zip(one, other, strict=True)
    )


@pytest.mark.parametrize(
    ("codec", "options", "spares"),
    [
        ("libx264", {"bf": "3", "x264-params": "scenecut=0:b-adapt=0"}, True),
        ("mpeg4", {"bf": "2"}, True),
        ("mpeg4", {"bf": "0"}, False),
        ("libx265", {"x265-params": "log-level=none:bframes=3:b-adapt=0"}, False),
    ],
)
def test_frames_that_no_other_needs_are_left_out(
    frames: list[Gray], tmp_path: Path, codec: str, options: dict[str, str], spares: bool
) -> None:
    path = video(tmp_path / "a.mp4", frames, codec=codec, options=options)
    motion = video_motion(path, VideoOptions(motion_width=256))
    assert motion.pts is not None
    assert len(motion.pts) == len(frames)
    for indices in ([0, 7, 8, 20], [1, 2, 3], [23], [5, 23]):
        assert same_frames(path, indices, pts=motion.pts)
    n_decoded = sum(1 for _ in _frames(path, wanted=motion.pts[[5]].tolist()))
    assert n_decoded < 0.7 * len(frames) if spares else n_decoded == len(frames)


def test_time_stamps_that_tell_nothing(frames: list[Gray], tmp_path: Path) -> None:
    # a bare stream has none, or they are not those of the packets
    bare = video(tmp_path / "a.264", frames, codec="libx264", options={"bf": "3"})
    assert video_motion(bare, VideoOptions(motion_width=256)).pts is None
    path = video(tmp_path / "a.mp4", frames, options={"bf": "2"})
    assert same_frames(path, [3, 9, 20], pts=np.arange(24) * 7 + 1)
    motion = video_motion(path, VideoOptions(motion_width=256))
    assert motion.pts is not None
    swapped = motion.pts[[0, 1, 2, 9, 4, 5, 6, 7, 8, 3, *range(10, 24)]]
    assert same_frames(path, [3, 9, 20], pts=swapped)
    with pytest.raises(InputError, match="frame 24 cannot be read any more"):
        list(read_frames(path, [2, 24], 256, pts=motion.pts))


def test_damaged_videos_are_counted_through(frames: list[Gray], tmp_path: Path) -> None:
    path = video(tmp_path / "a.mp4", frames, codec="libx264", options={"bf": "3", "g": "8"})
    data = bytearray(path.read_bytes())
    begin = data.find(b"mdat")
    data[begin + len(data) // 2 : begin + len(data) // 2 + 3000] = bytes(3000)
    path.write_bytes(bytes(data))
    motion = video_motion(path, VideoOptions(motion_width=256))
    assert motion.n_corrupt
    assert motion.pts is None


def test_short_videos_are_decoded_once(frames: list[Gray], tmp_path: Path) -> None:
    path = video(tmp_path / "a.mp4", frames)
    options = VideoOptions(motion_width=256)
    for most in (10_000, 10_000_000):
        decoded = DecodedFrames(most)
        assert len(video_motion(path, options, decoded=decoded)) == len(frames)
        assert same_frames(path, [2, 3, 17], decoded=decoded)
    decoded = DecodedFrames()
    video_motion(path, options, decoded=decoded)
    path.unlink()
    assert [frame.index for frame in read_frames(path, [2, 3, 17], 256, decoded=decoded)] == [2, 3, 17]
    with pytest.raises(InputError, match="there is no such file"):
        list(read_frames(path, [2], 256, decoded=decoded))


def test_bad_videos(tmp_path: Path) -> None:
    flat = video(tmp_path / "flat.mp4", [np.zeros((96, 128), dtype=np.uint8)] * 3)
    with pytest.raises(InputError, match="is 128 x 96, expected a 360 video"):
        recognise(flat)
    (tmp_path / "no.mp4").write_bytes(b"nothing of the kind")
    with pytest.raises(InputError, match=r"no.mp4: cannot be read as a video"):
        recognise(tmp_path / "no.mp4")


def test_equirectangular_pixels_of_patches_round_trip() -> None:
    pixels = np.array([[0.5, 0.5], [W - 0.5, 100.0], [W / 2, W / 2 - 0.5]])
    rays = bearings_from_equirectangular(pixels, W, W // 2)
    np.testing.assert_allclose(equirectangular_from_bearings(rays, W, W // 2), pixels, atol=1e-9)


@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuvj420p", "yuv444p", "gray", "rgb24", "yuv420p10le"])
def test_brightness_is_that_of_ffmpeg(pixel_format: str) -> None:
    av = pytest.importorskip("av", reason="needs the extra video")
    rng = np.random.default_rng(0)
    # odd widths have rows with something behind them
    color = np.repeat(np.repeat(rng.integers(0, 256, (13, 26, 3), dtype=np.uint8), 10, axis=0), 10, axis=1)
    frame = av.VideoFrame.from_ndarray(color, format="rgb24").reformat(format=pixel_format)
    expected = frame.reformat(format="gray").to_ndarray()[:130, :260].astype(np.int64)
    assert np.abs(_gray(frame, 260) - expected).max() <= 1
    half = _gray(frame, 130).astype(np.int64)
    assert half.shape == (65, 130)
    assert np.abs(half - expected.reshape(65, 2, 130, 2).mean(axis=(1, 3))).max() <= 2


def test_what_is_made_ahead_comes_in_its_order() -> None:
    def items() -> Iterator[int]:
        yield from range(5)
        raise InputError("here")

    made = _ahead(items())
    assert [next(made) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(InputError, match="here"):
        next(made)
    assert list(_ahead(iter(()))) == []
