"""What goes with the camera, in rendered walks: found where there is someone, and nothing where there is no one."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt
import pytest
from panopath.cameras import bearings_from_equirectangular
from panopath.errors import InputError
from panopath.walk import WalkRotation, render_walk

cv2 = pytest.importorskip("cv2", reason="needs the extra images")

from panopath.frontend.features import FeatureOptions, Features, extract_features  # noqa: E402
from panopath.frontend.fixed import FixedOptions, find_fixed, without_fixed  # noqa: E402

W, H = 512, 256
PIXEL = 2.0 * np.pi / W
Bool = npt.NDArray[np.bool_]


@functools.cache
def filmed(
    rotation: WalkRotation, operator: float, speed: float = 1.4
) -> tuple[list[Features], list[npt.NDArray[np.float64]], Bool]:
    """Features and bearings of 14 frames half a second apart, and where the operator is."""
    walk = render_walk(
        width_px=W, n_frames=70, rotation=rotation, operator_share=operator, speed_m_s=speed, noise_gray=1.0
    )
    options = FeatureOptions(max_features=2000, contrast=0.01)
    features = [
        extract_features(cv2.cvtColor(walk.frame(k), cv2.COLOR_RGB2GRAY), options) for k in range(0, len(walk), 5)
    ]
    bearings = [bearings_from_equirectangular(found.pixels, W, H) for found in features]
    return features, bearings, np.isnan(walk.ranges(0))


def shares(mask: Bool, truth: Bool) -> tuple[float, float]:
    """Share of the operator that is masked, and of the sphere that is masked wrongly."""
    weight = np.cos(((np.arange(H) + 0.5) / H - 0.5) * np.pi)[:, None] * np.ones(W)
    weight /= weight.sum()
    return float(weight[mask & truth].sum() / weight[truth].sum()), float(weight[mask & ~truth].sum())


@pytest.mark.parametrize("rotation", ["none", "sway", "tumble"])
def test_operator_is_found(rotation: WalkRotation) -> None:
    features, bearings, truth = filmed(rotation, 0.2)
    content = find_fixed(features, bearings, PIXEL)
    recall, wrong = shares(content.mask(W, H), truth)
    assert recall > 0.85
    assert wrong < 0.03
    assert content.share == pytest.approx(0.2, abs=0.04)


@pytest.mark.parametrize("rotation", ["none", "sway", "tumble"])
def test_nothing_is_found_where_no_one_is(rotation: WalkRotation) -> None:
    features, bearings, _ = filmed(rotation, 0.0)
    content = find_fixed(features, bearings, PIXEL)
    assert content.share == 0.0
    assert not content.mask(W, H).any()


def test_nothing_is_found_where_nothing_moves() -> None:
    features, bearings, _ = filmed("none", 0.2, 0.001)
    assert find_fixed(features, bearings, PIXEL).share == 0.0


def test_turns_alone_tell() -> None:
    features, bearings, truth = filmed("tumble", 0.2, 0.001)
    recall, wrong = shares(find_fixed(features, bearings, PIXEL).mask(W, H), truth)
    assert recall > 0.8
    assert wrong < 0.03
    features, bearings, _ = filmed("tumble", 0.0, 0.001)
    assert find_fixed(features, bearings, PIXEL).share == 0.0


def test_features_are_left_out() -> None:
    features, bearings, truth = filmed("sway", 0.2)
    content = find_fixed(features, bearings, PIXEL)
    left = without_fixed(features[0], bearings[0], content)
    x, y = left.pixels.astype(np.int64).T
    was_x, was_y = features[0].pixels.astype(np.int64).T
    assert truth[y, x].sum() < 0.15 * truth[was_y, was_x].sum()
    assert (~truth)[y, x].sum() > 0.9 * (~truth)[was_y, was_x].sum()
    # the mask and the bearings say the same
    pixels = np.stack(np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5), axis=2).reshape(-1, 2)
    covered = content.covers(bearings_from_equirectangular(pixels, W, H))
    assert (covered == content.mask(W, H).ravel()).mean() > 0.999


def test_too_much_is_not_believed() -> None:
    features, bearings, _ = filmed("sway", 0.2)
    content = find_fixed(features, bearings, PIXEL, FixedOptions(max_share=0.1))
    assert content.share == 0.0
    assert content.refused_share > 0.15
    assert not content.is_fixed.any()


def test_few_images_and_wrong_ones() -> None:
    features, bearings, _ = filmed("sway", 0.2)
    for n in (0, 1, 2):
        assert find_fixed(features[:n], bearings[:n], PIXEL).share == 0.0
    none = Features(np.empty((0, 2)), np.empty((0, 128), dtype=np.uint8))
    assert find_fixed([none] * 5, [np.empty((0, 3))] * 5, PIXEL).share == 0.0
    content = find_fixed(features, bearings, PIXEL)
    assert not content.covers(np.full((2, 3), np.nan)).any()
    with pytest.raises(InputError, match="bearings has 1 entries, expected 2"):
        find_fixed(features[:2], bearings[:1], PIXEL)
    with pytest.raises(InputError, match=r"bearings\[1\] has 3 rows"):
        find_fixed(features[:2], [bearings[0], bearings[1][:3]], PIXEL)
    with pytest.raises(InputError, match="pixel_rad"):
        find_fixed(features, bearings, 0.0)
    with pytest.raises(InputError, match="moves_px"):
        FixedOptions(stays_px=9.0)


def test_runs_of_a_long_sequence() -> None:
    features, bearings, truth = filmed("sway", 0.2)
    content = find_fixed(features * 6, bearings * 6, PIXEL)
    assert shares(content.mask(W, H), truth)[0] > 0.8
