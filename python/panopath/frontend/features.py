"""Features of a panorama, even over the sphere: SIFT on patches that keep angles.

An equirectangular image stretches what it shows towards its poles and has a seam. SIFT knows scale and turn, not
stretch; so the sphere is taken in three patches that are conformal: a band about the horizon in Mercator's projection,
which runs on over the seam, and two caps in stereographic projection,

    band:  u = theta,  v = ln tan(pi/4 + phi/2)          cap:  (u, v) = 2 tan(alpha / 2) (cos theta, sin theta),

with ``alpha`` the angle from the pole. Together they have fewer pixels than the panorama. SIFT doubles what it is
shown, so patches somewhat coarser than the panorama lose noise rather than places. Descriptors are 128 bytes, the
square roots of SIFT's numbers (Arandjelovic and Zisserman, CVPR 2012).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.cameras import bearings_from_equirectangular, equirectangular_from_bearings
from panopath.errors import InputError
from panopath.frontend.extras import opencv
from panopath.model import Bool, Float, read_only

Gray = npt.NDArray[np.uint8]

#: Elevation where the caps take over from the band.
_CAP_FROM_RAD = float(np.pi / 4)
#: What a patch shows beyond its own part, so that features have surroundings.
_MARGIN_RAD = float(np.radians(6.0))
#: Length of a descriptor: 512 numbers of a square root of one.
_DESCRIPTOR_SCALE = 512.0
#: Number that OpenCV keeps of a feature of the first layer of the doubled picture.
_OF_DOUBLED = (1 << 8) | 255
#: To blur so many pixels of a picture takes as long as to describe a feature.
_BLURRED_PX = 400.0
#: Pixels of the horizon below which patches are as fine as the panorama.
_LEAST_AROUND = 896
#: Rows of cells of equal solid angle over which features are spread.
_CELL_ROWS = 14


@dataclass(frozen=True)
class FeatureOptions:
    """Choices of :func:`extract_features`."""

    #: Features kept of an image, the strongest of every part of the sphere.
    max_features: int = 4000
    #: SIFT's threshold of contrast: the lower, the more features in flat regions.
    contrast: float = 0.02
    #: Pixels of a patch for each pixel of the panorama's horizon, along a line.
    density: float = 0.7

    def __post_init__(self) -> None:
        if isinstance(self.max_features, bool) or not isinstance(self.max_features, int) or self.max_features < 1:
            raise InputError(f"max_features is {self.max_features!r}, expected a whole number of at least 1")
        if not 0.0 < self.contrast < 1.0:
            raise InputError(f"contrast is {self.contrast!r}, expected a number between 0 and 1")
        if not 0.1 <= self.density <= 2.0:
            raise InputError(f"density is {self.density!r}, expected a number from 0.1 to 2")


@dataclass(frozen=True, eq=False)
class Features:
    """Features of one image, those first that stand out most in their part of the image."""

    #: (n, 2) pixels of the image, centres of pixels at 0.5.
    pixels: Float
    #: (n, 128) bytes.
    descriptors: npt.NDArray[np.uint8]
    #: (n, 3) red, green, blue, where they are known.
    color: npt.NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        for array in (self.pixels, self.descriptors, self.color):
            if array is not None:
                read_only(array)

    def __len__(self) -> int:
        return len(self.pixels)

    def select(self, keep: Bool) -> Features:
        """Those where ``keep`` holds."""
        color = None if self.color is None else self.color[keep]
        return Features(self.pixels[keep], self.descriptors[keep], color)


def extract_features(
    image: npt.ArrayLike,
    options: FeatureOptions | None = None,
    *,
    mask: npt.ArrayLike | None = None,
    equirectangular: bool = True,
) -> Features:
    """Find features and describe them.

    Parameters
    ----------
    image
        (height, width) grey image of bytes; of a panorama the width is twice the height.
    options
        Choices; default ``FeatureOptions()``.
    mask
        (h, w) of any size, laid over the image; features are taken where it is not zero. None: everywhere.
    equirectangular
        Whether the image is a panorama; else it is taken as it is, and features are spread over it.

    Raises
    ------
    InputError
        For an image of another type or shape.
    MissingExtraError
        Where OpenCV is not installed.
    """
    return _find(image, FeatureOptions() if options is None else options, mask, equirectangular, at_once=False)[0]


class FeatureFinder:
    """:func:`extract_features` for many pictures of one kind: the same features in less time.

    SIFT blurs a picture twice where features are chosen before they are described, and describes some in vain where
    they are chosen after. Which of the two costs less depends on how many more are found than are kept; the picture
    before tells. Threads may share one.
    """

    def __init__(self, options: FeatureOptions | None = None, *, equirectangular: bool = True) -> None:
        self._options = FeatureOptions() if options is None else options
        self._equirectangular = equirectangular
        self._at_once = False

    def __call__(self, image: npt.ArrayLike, mask: npt.ArrayLike | None = None) -> Features:
        """Find the features of one picture."""
        found, n_found = _find(image, self._options, mask, self._equirectangular, at_once=self._at_once)
        self._at_once = n_found - len(found) < np.asarray(image).size / _BLURRED_PX
        return found


def _find(
    image: npt.ArrayLike, options: FeatureOptions, mask: npt.ArrayLike | None, equirectangular: bool, *, at_once: bool
) -> tuple[Features, int]:
    """Check the arguments; find features, and how many there were before the strongest were chosen."""
    gray = np.asarray(image)
    if gray.ndim != 2 or gray.dtype != np.uint8 or gray.size == 0:
        raise InputError(f"image has shape {gray.shape} and type {gray.dtype}, expected (height, width) bytes")
    height, width = gray.shape
    if equirectangular and width != 2 * height:
        raise InputError(f"image is {width} x {height}, expected a panorama twice as wide as high")
    over = None if mask is None else np.asarray(mask) != 0
    if over is not None and (over.ndim != 2 or over.size == 0):
        raise InputError(f"mask has shape {over.shape}, expected (h, w)")
    if not equirectangular:
        return _features_of_patches(gray, [_whole(width, height)], over, options, at_once)
    return _features_of_patches(gray, list(_patches(width, options.density)), over, options, at_once)


@dataclass(frozen=True, eq=False)
class _Patch:
    """A part of an image in a projection of its own."""

    #: Pixel of the image (centres at 0, as OpenCV counts) that each pixel of the patch shows; None: the image itself.
    from_image: tuple[Any, Any] | None
    #: Where features are wanted, bytes.
    own: Gray
    kind: str
    #: Pixels of the patch per radian, and pixel of its origin (centres at 0).
    scale: float
    origin: tuple[float, float]
    size: tuple[int, int]


def _whole(width: int, height: int) -> _Patch:
    return _Patch(None, np.full((height, width), 255, dtype=np.uint8), "image", 1.0, (0.0, 0.0), (width, height))


@functools.lru_cache(maxsize=4)
def _patches(width: int, density: float) -> tuple[_Patch, ...]:
    # a small picture has nothing to lose
    around = max(round(density * width), min(width, _LEAST_AROUND))
    return (_band(width, around), _cap(width, around, -1.0), _cap(width, around, 1.0))


def _band(width: int, around: int) -> _Patch:
    """Build the horizon, ``around`` pixels long; its ends overlap, so that a feature at the seam is whole in one."""
    scale = around / (2.0 * np.pi)
    pad = round(_MARGIN_RAD * scale)
    half = int(np.ceil(_mercator(_CAP_FROM_RAD + _MARGIN_RAD) * scale))
    u = np.arange(-pad, around + pad)
    v = np.arange(-half, half + 1) / scale
    phi = 2.0 * np.arctan(np.exp(v)) - np.pi / 2  # downwards, as v
    rows = (phi / np.pi + 0.5) * (width / 2) - 0.5
    columns = np.mod(u * (width / around), width)
    map_x = np.broadcast_to(columns.astype(np.float32), (len(rows), len(u)))
    map_y = np.broadcast_to(rows.astype(np.float32)[:, None], map_x.shape)
    own = np.zeros(map_x.shape, dtype=np.uint8)
    own[np.abs(phi) <= _CAP_FROM_RAD, pad : pad + around] = 255
    return _patch((map_x, map_y), own, "band", scale, (float(pad), float(half)))


def _cap(width: int, around: int, side: float) -> _Patch:
    """Build the part about the pole at y = ``side`` of the camera's axes."""
    scale = around / (2.0 * np.pi)
    half = int(np.ceil(2.0 * np.tan(0.5 * (np.pi / 2 - _CAP_FROM_RAD + _MARGIN_RAD)) * scale))
    u, v = np.meshgrid(*(np.arange(-half, half + 1) / scale,) * 2)
    bearing = _cap_bearings(np.stack((u.ravel(), v.ravel()), axis=1), side)
    pixels = equirectangular_from_bearings(bearing, width, width // 2) - 0.5
    map_x, map_y = (pixels[:, k].reshape(u.shape).astype(np.float32) for k in range(2))
    own = np.where(side * bearing[:, 1] > np.sin(_CAP_FROM_RAD), 255, 0).astype(np.uint8).reshape(u.shape)
    return _patch((map_x, map_y), own, "floor" if side > 0 else "ceiling", scale, (float(half), float(half)))


def _patch(maps: tuple[Any, Any], own: Gray, kind: str, scale: float, origin: tuple[float, float]) -> _Patch:
    fixed = opencv().convertMaps(np.ascontiguousarray(maps[0]), np.ascontiguousarray(maps[1]), opencv().CV_16SC2)
    return _Patch((fixed[0], fixed[1]), own, kind, scale, origin, (own.shape[1], own.shape[0]))


def _mercator(phi: float) -> float:
    return float(np.log(np.tan(np.pi / 4 + phi / 2)))


def _cap_bearings(uv: Float, side: float) -> Float:
    """Bearings of stereographic coordinates about the pole at y = ``side``."""
    alpha = 2.0 * np.arctan(0.5 * np.linalg.norm(uv, axis=1))
    azimuth = np.arctan2(uv[:, 1], uv[:, 0])
    # mirrored below, so that both patches show the world as seen from inside
    sine = np.sin(alpha)
    return np.stack((sine * np.cos(azimuth), side * np.cos(alpha), -side * sine * np.sin(azimuth)), axis=1)


def _pixels_of(patch: _Patch, at: Float, width: int) -> Float:
    """Pixels of the image (centres at 0.5) where a patch has features (centres at 0)."""
    if patch.kind == "image":
        return at + 0.5
    uv = (at - patch.origin) / patch.scale
    if patch.kind == "band":
        phi = 2.0 * np.arctan(np.exp(uv[:, 1])) - np.pi / 2
        x = np.mod(uv[:, 0] * (width / (2.0 * np.pi)) + 0.5, width)
        return np.stack((x, (phi / np.pi + 0.5) * (width / 2)), axis=1)
    bearing = _cap_bearings(uv, 1.0 if patch.kind == "floor" else -1.0)
    return equirectangular_from_bearings(bearing, width, width // 2)


def _features_of_patches(
    gray: Gray, patches: list[_Patch], mask: Bool | None, options: FeatureOptions, at_once: bool
) -> tuple[Features, int]:
    """Detect in all patches, choose among all, describe what was chosen, or all ``at_once`` when it is detected."""
    height, width = gray.shape
    panorama = patches[0].kind != "image"
    # otherwise all places are a quarter of a pixel off
    sift = opencv().SIFT_create(contrastThreshold=options.contrast, enable_precise_upscale=True)
    shown = [_shown(gray, patch) for patch in patches]
    found, tables = [], []
    for picture, patch in zip(shown, patches, strict=True):
        keys, table = sift.detectAndCompute(picture, patch.own) if at_once else (sift.detect(picture, patch.own), None)
        found.append(list(keys))
        tables.append(table)
    at = [np.array([key.pt for key in keys], dtype=np.float64).reshape(-1, 2) for keys in found]
    pixels = np.concatenate([_pixels_of(patch, rows, width) for patch, rows in zip(patches, at, strict=True)])
    response = np.array([key.response for keys in found for key in keys])
    begin = np.cumsum([0, *(len(keys) for keys in found)])
    inside = np.ones(len(pixels), dtype=np.bool_) if mask is None else _under(mask, pixels, width, height)
    rows = np.flatnonzero(inside)
    cell = _sphere_cells(pixels[rows], width, height) if panorama else _image_cells(pixels[rows], width, height)
    order = rows[_spread(cell, response[rows], pixels[rows])[: options.max_features]]
    descriptors = np.zeros((len(order), 128), dtype=np.uint8)
    for p, (picture, table) in enumerate(zip(shown, tables, strict=True)):
        places = np.flatnonzero((begin[p] <= order) & (order < begin[p + 1]))
        own = order[places] - begin[p]
        if len(places):
            known = _described(sift, picture, [found[p][k] for k in own.tolist()]) if table is None else table[own]
            descriptors[places] = _root(known)
    return Features(pixels[order], descriptors), len(pixels)


def _described(sift: Any, picture: Gray, keys: list[Any]) -> Any:
    """Describe features in the same blurred images in which they were found."""
    # SIFT begins with the doubled picture only where it is asked for a feature of that
    of_doubled = opencv().KeyPoint(0.0, 0.0, 2.0, 0.0, 0.0, _OF_DOUBLED)
    return sift.compute(picture, [*keys, of_doubled])[1][:-1]


def _shown(gray: Gray, patch: _Patch) -> Gray:
    if patch.from_image is None:
        return gray
    cv2 = opencv()
    picture = cv2.remap(gray, *patch.from_image, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(picture, dtype=np.uint8)


def _under(mask: Bool, pixels: Float, width: int, height: int) -> Bool:
    rows, columns = mask.shape
    x = np.clip((pixels[:, 0] * columns / width).astype(np.int64), 0, columns - 1)
    y = np.clip((pixels[:, 1] * rows / height).astype(np.int64), 0, rows - 1)
    return np.asarray(mask[y, x])


def _sphere_cells(pixels: Float, width: int, height: int) -> npt.NDArray[np.int64]:
    """Cell of each feature, all of about the same solid angle."""
    bearing = bearings_from_equirectangular(pixels, width, height)
    row = np.minimum((0.5 * (bearing[:, 1] + 1.0) * _CELL_ROWS).astype(np.int64), _CELL_ROWS - 1)
    # rows of equal height on the axis have equal areas
    return row * 64 + (pixels[:, 0] / width * 2 * _CELL_ROWS).astype(np.int64)


def _image_cells(pixels: Float, width: int, height: int) -> npt.NDArray[np.int64]:
    side = max(width, height) / 16
    return (pixels[:, 1] / side).astype(np.int64) * 64 + (pixels[:, 0] / side).astype(np.int64)


def _spread(cell: npt.NDArray[np.int64], response: Float, pixels: Float) -> npt.NDArray[np.int64]:
    """Order features so that the strongest of every cell come first, then the second strongest of each, and so on."""
    # place breaks ties, so that the order does not depend on the detector's threads
    order = np.lexsort((pixels[:, 0], pixels[:, 1], -response, cell))
    _, begin, count = np.unique(cell[order], return_index=True, return_counts=True)
    rank = np.arange(len(order)) - np.repeat(begin, count)
    return order[np.lexsort((pixels[order, 0], pixels[order, 1], -response[order], rank))]


def _root(table: Any) -> npt.NDArray[np.uint8]:
    rows = np.asarray(table, dtype=np.float32)
    total = np.maximum(rows.sum(axis=1, keepdims=True), 1e-6)
    root = np.sqrt(np.maximum(rows, 0.0) / total) * _DESCRIPTOR_SCALE
    return np.asarray(np.clip(np.rint(root), 0.0, 255.0).astype(np.uint8))
