"""What goes with the camera: operator, tripod, helmet, vehicle, the patch of a stitcher.

A feature that is found again along the same bearing, ``b2 = b1``, is fixed to the camera or far away. Which of the two
is told by the motion: a point of the world at the inverse depth ``x`` is seen next along

    b(x) ~ R (b1 - x c),      R = second_from_first, c the second centre in the frame of the first,

so a match counts where ``b(x)`` is clearly away from ``b1``: for ``x = 0``, where the camera has turned; and, where it
has not, below the horizon of a camera that is upright throughout, for the ground, ``x = b1 . down``, with distances in
heights of the camera. Sky and hills that a camera without turns sees along one bearing all the way never count.

    leading features -> motion of neighbours -> path -> features that stay, of many pairs -> cells where most stay

The sphere is divided in cells of about equal size. A cell is fixed where, of the features that would have moved away,
many stayed, in several images; then small holes are closed, islands dropped and the border grown.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.frontend.features import Features
from panopath.model import Bool, Float, read_only
from panopath.steps import (
    MatchOptions,
    MotionGuides,
    TwoViewOptions,
    TwoViewStatus,
    match_features,
    relative_poses,
)

Index = npt.NDArray[np.int64]

#: Inliers that the motion between neighbours may rest on, and points of the ground that its length may rest on.
_FEWEST, _FEWEST_GROUND = 20, 10
#: Descriptors of the same thing at the same place are nearer than this; few of different things are.
_MOST_DISTANCE = 0.5
#: Directions so far below the horizon show the ground or what stands on it; from the first on it is measured, from the
#: second on it is relied on.
_GROUND_SEEN, _GROUND_SURE = float(np.sin(np.radians(10.0))), float(np.sin(np.radians(20.0)))
#: Share of the points of the ground that may be nearer than it, and the inverse depths that must move, times its own.
_GROUND_QUANTILE, _GROUND_SPAN = 0.25, (0.5, 1.0, 2.0)
#: A camera is upright where its vertical wavers by less than this.
_UPRIGHT_RAD = float(np.radians(20.0))
#: Holes smaller than this share of the sphere are filled: cloth has few features.
_HOLE_SHARE = 0.005
#: Images looked at, in runs of this many neighbours where there are more.
_MOST_IMAGES, _RUN = 64, 16


@dataclass(frozen=True)
class FixedOptions:
    """Choices of :func:`find_fixed`."""

    #: Images compared are so many apart.
    steps: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    #: Features that move less than this stay, pixels; an operator sways a little.
    stays_px: float = 2.5
    #: They count where a point of the world would have moved more than this, pixels.
    moves_px: float = 8.0
    #: Size of a cell, radians.
    cell_rad: float = float(np.radians(3.0))
    #: Of the features of a fixed cell that count, at least this share stays ...
    min_stay: float = 0.25
    #: ... in at least so many images.
    min_images: int = 3
    #: Islands smaller than this share of the sphere are dropped.
    min_share: float = 0.001
    #: Content of more than this share of the sphere is not believed.
    max_share: float = 0.5
    #: Features of an image that find the motion.
    leading_features: int = 600
    #: Of everything random.
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.steps or any(isinstance(s, bool) or not isinstance(s, int) or s < 1 for s in self.steps):
            raise InputError(f"steps is {self.steps!r}, expected whole numbers of at least 1")
        for name, most in (
            ("stays_px", np.inf),
            ("moves_px", np.inf),
            ("cell_rad", 0.5),
            ("min_stay", 1.0),
            ("max_share", 1.0),
        ):
            value = getattr(self, name)
            if not (np.isfinite(value) and 0.0 < value <= most):
                raise InputError(f"{name} is {value!r}, expected a number above 0, at most {most}")
        if not self.stays_px < self.moves_px:
            raise InputError(f"moves_px is {self.moves_px!r}, expected more than stays_px, {self.stays_px!r}")
        if not 0.0 <= self.min_share < 1.0:
            raise InputError(f"min_share is {self.min_share!r}, expected a number from 0, below 1")
        for name, least in (("min_images", 1), ("leading_features", 8), ("seed", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise InputError(f"{name} is {value!r}, expected a whole number of at least {least}")


@dataclass(frozen=True, eq=False)
class FixedContent:
    """Directions in the camera along which nothing of the world is seen."""

    #: Size of a cell, radians: with it, all cells are known.
    cell_rad: float
    #: (C,) cells that are fixed.
    is_fixed: Bool
    #: (C,) features that would have moved away with the world, and those of them that stayed.
    n_tried: Index
    n_stayed: Index
    #: Share of the sphere that is fixed.
    share: float
    #: The share that was found, where it is more than is believed and nothing is fixed; else 0.
    refused_share: float

    def __post_init__(self) -> None:
        for name in ("is_fixed", "n_tried", "n_stayed"):
            read_only(getattr(self, name))

    def covers(self, bearings: npt.ArrayLike) -> Bool:
        """Whether each of the (n, 3) bearings is fixed; (n,), False where a bearing is not finite."""
        return self.is_fixed[_cells(self.cell_rad).of(_rows(bearings, "bearings"))] & np.isfinite(
            np.asarray(bearings, dtype=np.float64)
        ).all(axis=-1)

    def mask(self, width: int, height: int) -> Bool:
        """(height, width), True where a panorama of this size shows what is fixed."""
        for name, value in (("width", width), ("height", height)):
            if value < 1:
                raise InputError(f"{name} is {value!r}, expected at least 1")
        cells = _cells(self.cell_rad)
        azimuth = np.mod((np.arange(width) + 0.5) / width + 0.5, 1.0)
        row = ((np.arange(height) + 0.5) / height * len(cells.columns)).astype(np.int64)
        column = (azimuth[None, :] * cells.columns[row][:, None]).astype(np.int64)
        return np.asarray(self.is_fixed[cells.starts[row][:, None] + column])


def without_fixed(features: Features, bearings: npt.ArrayLike, content: FixedContent) -> Features:
    """Leave out the features of an image that are fixed to the camera; see :func:`find_fixed`."""
    covered = content.covers(bearings)
    if len(covered) != len(features):
        raise InputError(f"bearings has {len(covered)} rows, expected {len(features)}, one for each feature")
    return features if not covered.any() else features.select(~covered)


def find_fixed(
    features: Sequence[Features],
    bearings: Sequence[npt.ArrayLike],
    pixel_rad: float,
    options: FixedOptions | None = None,
) -> FixedContent:
    """Find what goes with the camera.

    Parameters
    ----------
    features
        Those of M images of one camera, in the order in which they were taken.
    bearings
        M arrays (n, 3), the unit vectors of the features in the camera, y down where it is held upright.
    pixel_rad
        The angle that a pixel spans.
    options
        Choices; default ``FixedOptions()``.

    Returns
    -------
    FixedContent
        Nothing is fixed where the camera does not move, or the motion is not known. Above the horizon, and with a
        camera that is not upright, only turns of the camera tell.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    chosen = FixedOptions() if options is None else options
    if len(features) != len(bearings):
        raise InputError(f"bearings has {len(bearings)} entries, expected {len(features)}, one for each image")
    if not (np.isfinite(pixel_rad) and pixel_rad > 0.0):
        raise InputError(f"pixel_rad is {pixel_rad!r}, expected a positive number")
    table = _Table.of(features, bearings)
    cells = _cells(chosen.cell_rad)
    path = _path(table, pixel_rad, chosen)
    pairs = _pairs(path, chosen.steps)
    tells = np.array([cells.moving(path, i, j, chosen.moves_px * pixel_rad) for i, j in pairs.tolist()])
    tells = tells.reshape(-1, len(cells.directions)).astype(np.bool_)
    n_tried, n_stayed, n_images = _count(table, cells, pairs, tells, chosen.stays_px * pixel_rad)
    is_fixed = (n_stayed >= chosen.min_stay * np.maximum(n_tried, 1)) & (n_images >= chosen.min_images)
    is_fixed = cells.tidy(is_fixed, chosen.min_share)
    share = float(cells.share[is_fixed].sum())
    believed = share <= chosen.max_share
    return FixedContent(
        cell_rad=chosen.cell_rad,
        is_fixed=is_fixed if believed else np.zeros_like(is_fixed),
        n_tried=n_tried,
        n_stayed=n_stayed,
        share=share if believed else 0.0,
        refused_share=0.0 if believed else share,
    )


def _rows(bearings: npt.ArrayLike, name: str) -> Float:
    rows = np.asarray(bearings, dtype=np.float64)
    if rows.size == 0:
        return np.empty((0, 3))
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"{name} has shape {rows.shape}, expected (n, 3)")
    return rows


@dataclass(frozen=True, eq=False)
class _Table:
    """Features of the images that are looked at, flat."""

    starts: Index
    descriptors: npt.NDArray[np.uint8]
    bearings: Float
    #: (M - 1,) whether an image and the next are neighbours.
    is_next: Bool

    @classmethod
    def of(cls, features: Sequence[Features], bearings: Sequence[npt.ArrayLike]) -> _Table:
        used = _used(len(features))
        rays = [_rows(bearings[i], f"bearings[{i}]") for i in used]
        for i, rows in zip(used, rays, strict=True):
            if len(features[i]) != len(rows):
                raise InputError(f"bearings[{i}] has {len(rows)} rows, expected {len(features[i])}")
        return cls(
            np.concatenate(([0], np.cumsum([len(rows) for rows in rays]))).astype(np.int64),
            np.concatenate([np.empty((0, 128), dtype=np.uint8), *(features[i].descriptors for i in used)]),
            np.concatenate([np.empty((0, 3)), *rays]),
            np.diff(np.array(used, dtype=np.int64)) == 1,
        )

    def __len__(self) -> int:
        return len(self.starts) - 1


def _used(n: int) -> list[int]:
    """All images, or of many a few runs of neighbours."""
    if n <= _MOST_IMAGES:
        return list(range(n))
    begins = np.linspace(0, n - _RUN, _MOST_IMAGES // _RUN).astype(np.int64)
    return sorted({int(b) + k for b in begins for k in range(_RUN)})


@dataclass(frozen=True, eq=False)
class _Path:
    """The rough motion, in stretches over which it is known."""

    #: (M,) stretch of each image.
    stretch: Index
    #: (M, 3, 3) takes bearings of the first image of a stretch to each.
    cam_from_start: Float
    #: (M, 3) centres from the first of the stretch on, in its frame, in heights above the ground; NaN from where they
    #: are not known on.
    center: Float
    is_upright: bool


def _path(table: _Table, pixel_rad: float, options: FixedOptions) -> _Path:
    """Chain the motion of neighbours."""
    n = len(table)
    first = np.flatnonzero(table.is_next)
    pairs = np.stack((first, first + 1), axis=1).astype(np.int32)
    found = match_features(
        table.starts, table.descriptors, table.bearings, pairs, MatchOptions(max_features=options.leading_features)
    )
    at = found.matches + table.starts[np.repeat(first, np.diff(found.starts))[:, None] + np.arange(2)]
    b1, b2 = table.bearings[at[:, 0]], table.bearings[at[:, 1]]
    poses = relative_poses(found.starts, b1, b2, TwoViewOptions(seed=options.seed))
    stretch, rotation, center = np.arange(n), np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    inverse_depths = []
    for p, k in enumerate(first.tolist()):
        if poses.status[p] == TwoViewStatus.UNDETERMINED or poses.n_inliers[p] < _FEWEST:
            continue
        rows = np.arange(found.starts[p], found.starts[p + 1])
        rows = rows[poses.inlier[rows]]
        turn, direction = poses.second_from_first[p], poses.direction[p]
        down, inverse_depth = _inverse_depths(b1[rows], b2[rows], turn, direction, options.stays_px * pixel_rad)
        step = _step_in_heights(down, inverse_depth)
        inverse_depths.append(np.stack((down, inverse_depth), axis=1))
        stretch[k + 1] = stretch[k]
        rotation[k + 1] = turn @ rotation[k]
        center[k + 1] = center[k] + rotation[k].T @ direction * step
    points = np.concatenate([np.empty((0, 2)), *inverse_depths])
    return _Path(stretch, rotation, center, _is_upright(rotation, points))


def _inverse_depths(b1: Float, b2: Float, turn: Float, direction: Float, stays_rad: float) -> tuple[Float, Float]:
    """How far down points are that have parallax and did not stay in the camera, and their inverse depths in steps."""
    if not np.isfinite(direction).all():
        return np.empty(0), np.empty(0)
    turned, ahead = b1 @ turn.T, turn @ direction
    parallax = np.linalg.norm(np.cross(turned, b2), axis=1)
    across = np.linalg.norm(np.cross(b2, ahead), axis=1)
    good = (np.linalg.norm(b2 - b1, axis=1) > stays_rad) & (parallax > stays_rad) & (across > 0.2)
    return b1[good, 1], parallax[good] / across[good]


def _step_in_heights(down: Float, inverse_depth: Float) -> float:
    """Length of a step over the height of the camera: the ground is the farthest that is seen below the horizon."""
    below = down > _GROUND_SEEN
    if below.sum() < _FEWEST_GROUND:
        return float("nan")
    return float(np.quantile(inverse_depth[below] / down[below], _GROUND_QUANTILE))


def _is_upright(rotation: Float, points: Float) -> bool:
    """Whether y points down throughout: the vertical does not waver, and what is near is below."""
    vertical = rotation[:, 1, 1]
    below, above = points[points[:, 0] > _GROUND_SEEN, 1], points[points[:, 0] < -_GROUND_SEEN, 1]
    if not len(below) or float(vertical.min()) < np.cos(_UPRIGHT_RAD):
        return False
    return not len(above) or float(np.median(below)) >= float(np.median(above))


def _pairs(path: _Path, steps: Sequence[int]) -> npt.NDArray[np.int32]:
    """Pairs of images of one stretch."""
    n = len(path.stretch)
    listed = [np.empty((0, 2), dtype=np.int64)]
    for step in sorted({s for s in steps if s < n}):
        k = np.arange(n - step)
        k = k[path.stretch[k] == path.stretch[k + step]]
        listed.append(np.stack((k, k + step), axis=1))
    return np.concatenate(listed).astype(np.int32)


def _count(
    table: _Table, cells: _Cells, pairs: npt.NDArray[np.int32], tells: Bool, stays_rad: float
) -> tuple[Index, Index, Index]:
    """Features of each cell that would have moved away, those that stayed, and images that have some."""
    n_cells, n_pairs, n = len(cells.directions), len(pairs), len(table)
    cell = cells.of(table.bearings)
    image = np.repeat(np.arange(n), np.diff(table.starts))
    in_image = np.bincount(image * n_cells + cell, minlength=n * n_cells).reshape(n, n_cells)
    n_tried = np.zeros(n_cells, dtype=np.int64)
    for (i, _), told in zip(pairs.tolist(), tells, strict=True):
        n_tried += in_image[i] * told
    radius = np.full(n_pairs, stays_rad)
    guides = MotionGuides(np.tile(np.eye(3), (n_pairs, 1, 1)), np.full((n_pairs, 3), np.nan), radius, radius)
    found = match_features(
        table.starts, table.descriptors, table.bearings, pairs, MatchOptions(max_distance=_MOST_DISTANCE), guides
    )
    row = np.repeat(np.arange(n_pairs), np.diff(found.starts))
    stayed = cell[found.matches[:, 0] + table.starts[pairs[row, 0]]]
    counts = tells[row, stayed]
    seen_in = np.unique(stayed[counts] * np.int64(n) + pairs[row[counts], 0])
    return (
        n_tried,
        np.bincount(stayed[counts], minlength=n_cells),
        np.bincount(seen_in // max(n, 1), minlength=n_cells),
    )


@dataclass(frozen=True, eq=False)
class _Cells:
    """Cells of about equal size: rows of equal height in elevation, each divided by its length."""

    #: (rows,) cells of each row, from the one above the camera (y = -1) on; and (rows + 1,) where they begin.
    columns: Index
    starts: Index
    #: (C, 3) their middles, and (C,) shares of the sphere.
    directions: Float
    share: Float
    #: (N,) cells and their neighbours, themselves among them.
    near: tuple[Index, Index]

    def of(self, bearings: Float) -> Index:
        """(n,) the cell of each bearing; that of no finite bearing is the first."""
        b = np.where(np.isfinite(bearings).all(axis=1, keepdims=True), bearings, (0.0, -1.0, 0.0))
        n_rows = len(self.columns)
        down = np.arctan2(b[:, 1], np.hypot(b[:, 0], b[:, 2])) / np.pi + 0.5
        row = np.minimum((down * n_rows).astype(np.int64), n_rows - 1)
        azimuth = np.mod(np.arctan2(b[:, 0], b[:, 2]) / (2.0 * np.pi), 1.0)
        column = np.minimum((azimuth * self.columns[row]).astype(np.int64), self.columns[row] - 1)
        return self.starts[row] + column

    def moving(self, path: _Path, i: int, j: int, moves_rad: float) -> Bool:
        """(C,) where what is seen in image ``i`` would be clearly elsewhere in image ``j``."""
        turn = path.cam_from_start[j] @ path.cam_from_start[i].T
        step = path.cam_from_start[i] @ (path.center[j] - path.center[i])
        least = 2.0 * np.sin(0.5 * min(moves_rad, np.pi))
        turned = self.directions @ turn.T
        moved = np.asarray(np.linalg.norm(turned - self.directions, axis=1) > least)
        if not (path.is_upright and np.isfinite(step).all()):
            return moved
        ground = np.flatnonzero(self.directions[:, 1] > _GROUND_SURE)
        moved[ground] = True
        down, shift = self.directions[ground, 1:2], turn @ step
        for times in _GROUND_SPAN:
            seen = turned[ground] - times * down * shift
            seen /= np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-12)
            moved[ground] &= np.linalg.norm(seen - self.directions[ground], axis=1) > least
        return moved

    def tidy(self, is_fixed: Bool, min_share: float) -> Bool:
        """Close gaps of a cell, drop islands, fill small holes and grow the rest by a cell."""
        closed = is_fixed | ~self._grown(~self._grown(is_fixed))
        kept = closed & (self._island_shares(closed) >= min_share)
        grown = self._grown(kept)
        return grown | (self._island_shares(~grown) < _HOLE_SHARE)

    def _grown(self, flag: Bool) -> Bool:
        cell, near = self.near
        return np.bincount(cell, weights=flag[near], minlength=len(flag)) > 0

    def _island_shares(self, flag: Bool) -> Float:
        """(C,) share of the sphere of the island that each set cell is in; infinite for others."""
        label = self._islands(flag)
        size = np.bincount(label[flag], weights=self.share[flag], minlength=len(flag))
        return np.where(flag, size[label], np.inf)

    def _islands(self, flag: Bool) -> Index:
        """(C,) the smallest cell that each set cell is connected with."""
        cell, near = self.near
        both = flag[cell] & flag[near]
        cell, near = cell[both], near[both]
        label = np.arange(len(flag))
        while True:
            least = label.copy()
            np.minimum.at(least, cell, label[near])
            least = least[least]
            if (least == label).all():
                return label
            label = least


@functools.lru_cache(maxsize=2)
def _cells(cell_rad: float) -> _Cells:
    n_rows = max(2, int(np.ceil(np.pi / cell_rad)))
    edges = -np.pi / 2 + np.arange(n_rows + 1) * np.pi / n_rows
    middle = 0.5 * (edges[1:] + edges[:-1])
    columns = np.maximum(3, np.rint(2.0 * np.pi * np.cos(middle) / cell_rad)).astype(np.int64)
    starts = np.concatenate(([0], np.cumsum(columns)))
    row = np.repeat(np.arange(n_rows), columns)
    azimuth = 2.0 * np.pi * (np.arange(starts[-1]) - starts[row] + 0.5) / columns[row]
    down = middle[row]
    directions = np.stack((np.cos(down) * np.sin(azimuth), np.sin(down), np.cos(down) * np.cos(azimuth)), axis=1)
    share = 0.5 * (np.diff(np.sin(edges)) / columns)[row]
    listed = []
    for r in range(n_rows):
        mine = np.arange(starts[r], starts[r + 1])
        others = np.arange(starts[max(r - 1, 0)], starts[min(r + 2, n_rows)])
        a, b = np.nonzero(directions[mine] @ directions[others].T > np.cos(1.6 * cell_rad))
        listed.append(np.stack((mine[a], others[b])))
    near = np.concatenate(listed, axis=1)
    return _Cells(columns, starts, directions, share, (near[0], near[1]))
