"""The rendered walk through Python: contract, video and images, and features that agree with the true geometry."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath import cameras
from panopath.errors import InputError, MissingExtraError
from panopath.walk import LAP_M, Walk, render_walk


@pytest.fixture(scope="module")
def short() -> Walk:
    return render_walk(width_px=256, n_frames=12, frame_rate_hz=5.0, seed=2)


def test_the_record_keeps_its_contract(short: Walk) -> None:
    truth = short.truth
    assert len(short) == 12
    assert short.size_px == (256, 128)
    assert truth.centers.shape == (12, 3)
    assert truth.cam_from_world.shape == (12, 3, 3)
    np.testing.assert_allclose(truth.time_s, np.arange(12) / 5.0)
    product = truth.cam_from_world @ truth.cam_from_world.transpose(0, 2, 1)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), (12, 3, 3)), atol=1e-12)
    assert not any(a.flags.writeable for a in (truth.centers, truth.cam_from_world, truth.time_s))
    frame = short.frame(3)
    assert frame.shape == (128, 256, 3)
    assert frame.dtype == np.uint8
    assert frame.std() > 20
    assert short.ranges(3).shape == (128, 256)
    assert short.ranges(3).dtype == np.float32
    frames = list(short.frames())
    assert len(frames) == 12
    np.testing.assert_array_equal(frames[3], frame)


def test_ranges_of_the_ground_are_exact(short: Walk) -> None:
    y, x = np.mgrid[0:128, 0:256]
    pixel = np.column_stack([x.ravel(), y.ravel()]) + 0.5
    along = cameras.bearings_from_equirectangular(pixel, 256, 128) @ short.truth.cam_from_world[5]
    point = short.truth.centers[5] + along * np.minimum(short.ranges(5).ravel(), 1e3)[:, None]
    below = along[:, 2] < -0.1
    assert (np.abs(point[below, 2]) < 1e-3).mean() > 0.5
    assert point[below, 2].min() > -1e-3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"width_px": 65}, "width_px is 65"),
        ({"width_px": -2}, "width_px is -2"),
        ({"n_frames": 0}, "n_frames is 0"),
        ({"path": "circle"}, 'path is "circle", expected one of straight, corner, loop'),
        ({"rotation": 3}, "rotation is 3, expected a string"),
        ({"operator_share": 0.7}, "operator_share is 0.7"),
        ({"noise_gray": float("nan")}, "noise_gray is NaN"),
        ({"seed": -1}, "seed is -1"),
        ({"n_movers": 2.5}, "n_movers is 2.5"),
    ],
)
def test_arguments_out_of_range_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}"):
        render_walk(**arguments)


@pytest.mark.parametrize("index", [-1, 12])
def test_frames_that_are_not_there(short: Walk, index: int) -> None:
    with pytest.raises(InputError, match=f"index is {index}, expected a number from 0 to 11"):
        short.frame(index)
    with pytest.raises(InputError, match="index is"):
        short.ranges(index)


def test_a_lap_ends_where_it_began() -> None:
    walk = render_walk(width_px=64, path="loop", n_frames=2, frame_rate_hz=0.1, speed_m_s=0.1 * LAP_M)
    assert np.linalg.norm(walk.truth.centers[1] - walk.truth.centers[0]) < 0.8


def test_video_round_trip(short: Walk, tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="PyAV (extra video) is not installed")
    path = short.write_video(tmp_path / "walk.mp4", crf=12)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert float(stream.average_rate) == 5.0
        decoded = [(frame.time, frame.to_ndarray(format="rgb24")) for frame in container.decode(stream)]
    assert len(decoded) == 12
    for (time_s, image), truth_s, frame in zip(decoded, short.truth.time_s, short.frames(), strict=True):
        assert time_s == pytest.approx(truth_s, abs=1e-4)
        error = image.astype(float) - frame
        assert 10 * np.log10(255**2 / np.mean(error**2)) > 27


def test_images_round_trip(short: Walk, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image", reason="Pillow (extra images) is not installed")
    exact = short.write_images(tmp_path / "png", every=5, quality=None)
    assert [path.name for path in exact] == ["frame_00000.png", "frame_00005.png", "frame_00010.png"]
    with image.open(exact[1]) as opened:
        np.testing.assert_array_equal(np.asarray(opened), short.frame(5))
    (near,) = short.write_images(tmp_path / "jpg", every=12)
    with image.open(near) as opened:
        assert np.abs(np.asarray(opened).astype(float) - short.frame(0)).mean() < 4


def test_what_cannot_be_written_is_one_line(short: Walk, tmp_path: Path) -> None:
    pytest.importorskip("av", reason="PyAV (extra video) is not installed")
    with pytest.raises(InputError, match="crf is 99"):
        short.write_video(tmp_path / "walk.mp4", crf=99)
    with pytest.raises(InputError, match="cannot be written"):
        short.write_video(tmp_path / "nowhere" / "walk.mp4")
    with pytest.raises(InputError, match="every is 0"):
        short.write_images(tmp_path, every=0)
    with pytest.raises(InputError, match="quality is 96"):
        short.write_images(tmp_path, quality=96)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        short.write_images(tmp_path / "file")


def test_a_missing_extra_is_named(short: Walk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingExtraError, match=r"panopath\[video\]"):
        short.write_video(tmp_path / "walk.mp4")


@pytest.mark.parametrize("rotation", ["sway", "tumble"])
def test_features_match_and_agree_with_the_truth(rotation: Any) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV (extra images) is not installed")
    walk = render_walk(rotation=rotation, n_frames=3, frame_rate_hz=1.4 / 0.6)
    first, second = _matched_bearings(cv2, walk, 1, 2)
    centers, cam_from_world = walk.truth.centers, walk.truth.cam_from_world
    base = cam_from_world[1] @ (centers[2] - centers[1])
    base /= np.linalg.norm(base)
    second_from_first = cam_from_world[2] @ cam_from_world[1].T
    normal = np.cross(first, base)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    error_deg = np.degrees(np.abs(np.arcsin(np.sum(normal * (second @ second_from_first), axis=1))))
    assert np.sum(error_deg < 0.2) >= 1500
    assert np.median(error_deg) < 0.05

    found = pp.relative_pose(first, second)
    assert found.status is pp.TwoViewStatus.GENERAL
    turn = found.second_from_first @ second_from_first.T
    assert np.degrees(np.arccos(min(1.0, (np.trace(turn) - 1) / 2))) < 0.02
    assert np.degrees(np.arccos(min(1.0, found.direction @ base))) < 0.15


def _matched_bearings(cv2: Any, walk: Walk, k: int, l: int) -> tuple[Any, Any]:  # noqa: E741
    """Match SIFT features both ways, with the ratio test."""
    width, height = walk.size_px
    # without the precise enlargement OpenCV's key points are a quarter of a pixel off
    sift = cv2.SIFT_create(nfeatures=20_000, contrastThreshold=0.02, enable_precise_upscale=True)
    pixels, descriptors = [], []
    for index in (k, l):
        points, descriptor = sift.detectAndCompute(cv2.cvtColor(walk.frame(index), cv2.COLOR_RGB2GRAY), None)
        pixels.append(np.array([point.pt for point in points], dtype=float) + 0.5)
        descriptors.append(np.sqrt(descriptor / descriptor.sum(axis=1, keepdims=True)))
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = {match.queryIdx: match.trainIdx for match in matcher.match(descriptors[1], descriptors[0])}
    pairs = [
        (best.queryIdx, best.trainIdx)
        for best, other in matcher.knnMatch(descriptors[0], descriptors[1], 2)
        if best.distance < 0.8 * other.distance and back[best.trainIdx] == best.queryIdx
    ]
    ids = np.array(pairs)
    bearings = [cameras.bearings_from_equirectangular(pixels[side][ids[:, side]], width, height) for side in range(2)]
    return bearings[0], bearings[1]
