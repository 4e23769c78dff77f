"""Perspective pictures cut from panoramas, with a COLMAP model of them, for programs that know only pinholes.

A crop is a PINHOLE camera at the centre of its view, ``crop_from_world = crop_from_cam @ cam_from_world``; its pixel of
a bearing ``b`` is ``f (x / z, y / z) + size / 2`` of ``crop_from_cam @ b``, with ``f = size / (2 tan(fov / 2))`` and
pixel centres at +0.5. Pixels are bilinear where the crop is as fine as the panorama; where it is coarser it is rendered
finer by a whole factor and averaged, a filter over each pixel's area. Only one panorama is in memory at a time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.formats.colmap_model import Camera, ModelImages, ModelPoints, write_model
from panopath.formats.colours import ColourSum
from panopath.formats.files import write_bytes
from panopath.formats.nerfstudio import Shot, write_transforms
from panopath.formats.ply import cloud_bytes
from panopath.images import Images, Picture, check_panorama, encoded, image_source, load_opencv
from panopath.model import Float, Scene, Tracks
from panopath.movers import left_out, resting

CropKind = Literal["cube", "perspective"]
#: COLMAP's number of the PINHOLE model: fx, fy, cx, cy.
_PINHOLE_ID = 1
#: OpenCV's remap addresses pixels by 16 bits.
_MOST_PIXELS = 32_000
#: Rays whose z is below this share of their length do not count as in front.
_LEAST_Z = 1e-6
#: Maps of pixels are kept from one panorama to the next where they take no more than so many bytes.
_MOST_MAP_BYTES = 384_000_000

_Map = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]


@dataclass(frozen=True)
class CropOptions:
    """Which crops are cut from each panorama."""

    #: ``cube``: six faces of 90 degrees that cover the sphere. ``perspective``: a ring or more of overlapping crops.
    kind: CropKind = "cube"
    #: Width and height of a crop; None: as fine at its centre as the panorama.
    size_px: int | None = None
    #: Angle of view of ``perspective``, degrees.
    fov_deg: float = 90.0
    #: Crops around, of ``perspective``, evenly spaced from straight ahead.
    n_around: int = 8
    #: Elevation of each ring of ``perspective``, degrees; each has ``n_around`` crops.
    elevations_deg: tuple[float, ...] = (0.0,)
    #: ``.jpg`` or ``.png``.
    suffix: str = ".jpg"
    quality: int = 95

    def __post_init__(self) -> None:
        if self.kind not in get_args(CropKind):
            raise InputError(f"kind is {self.kind!r}, expected 'cube' or 'perspective'")
        if self.size_px is not None and not (isinstance(self.size_px, int) and 8 <= self.size_px <= _MOST_PIXELS):
            raise InputError(f"size_px is {self.size_px!r}, expected a whole number from 8 to {_MOST_PIXELS}")
        if not 10.0 <= self.fov_deg <= 150.0:
            raise InputError(f"fov_deg is {self.fov_deg!r}, expected 10 to 150")
        if not (isinstance(self.n_around, int) and 1 <= self.n_around <= 64):
            raise InputError(f"n_around is {self.n_around!r}, expected a whole number from 1 to 64")
        if not self.elevations_deg or not all(-90.0 <= e <= 90.0 for e in self.elevations_deg):
            raise InputError(f"elevations_deg is {self.elevations_deg!r}, expected angles from -90 to 90")
        if self.suffix not in (".jpg", ".png"):
            raise InputError(f"suffix is {self.suffix!r}, expected '.jpg' or '.png'")

    def directions(self) -> list[tuple[str, Float]]:
        """Name and ``crop_from_cam`` of each crop."""
        if self.kind == "cube":
            names = ("front", "right", "back", "left", "up", "down")
            angles = ((0.0, 0.0), (90.0, 0.0), (180.0, 0.0), (270.0, 0.0), (0.0, 90.0), (0.0, -90.0))
            return [(name, crop_from_cam(*angle)) for name, angle in zip(names, angles, strict=True)]
        return [
            (f"{ring}_{k:02d}" if len(self.elevations_deg) > 1 else f"{k:02d}", crop_from_cam(azimuth, elevation))
            for ring, elevation in enumerate(self.elevations_deg)
            for k, azimuth in enumerate(np.arange(self.n_around) * (360.0 / self.n_around))
        ]

    @property
    def fov_rad(self) -> float:
        """Angle of view of each crop."""
        return float(np.radians(90.0 if self.kind == "cube" else self.fov_deg))

    @property
    def half_width(self) -> float:
        """Half the width of a crop at focal length one: ``tan(fov / 2)``, of a cube's face one to the last digit."""
        return 1.0 if self.kind == "cube" else float(np.tan(0.5 * self.fov_rad))

    def size_for(self, width_px: int) -> int:
        """Width of the crops of a panorama."""
        # pixels of equal angle at the centre: f = w / 2 pi, as the panorama has at its equator; even, for codecs
        fine = 2 * round(width_px / (2.0 * np.pi) * self.half_width)
        return min(max(fine, 8), _MOST_PIXELS) if self.size_px is None else self.size_px


@dataclass(frozen=True)
class Crops:
    """What was written."""

    folder: Path
    n_images: int
    size_px: int
    focal_px: float
    #: Points that a crop sees.
    n_points: int
    n_observations: int
    #: Tracks that were left out because they move, or are not known to rest.
    n_left_out: int = 0


def crop_from_cam(azimuth_deg: float, elevation_deg: float) -> Float:
    """(3, 3) rotation into a crop that looks to the right by an azimuth and up by an elevation, its horizon level."""
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    turn = np.array([[np.cos(a), 0.0, -np.sin(a)], [0.0, 1.0, 0.0], [np.sin(a), 0.0, np.cos(a)]])
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(e), np.sin(e)], [0.0, -np.sin(e), np.cos(e)]])
    return np.asarray(tilt @ turn)


def write_crops(
    scene: Scene,
    images: Images,
    folder: str | PathLike[str],
    options: CropOptions | None = None,
    *,
    component: int = 0,
    masks: Images | None = None,
    report: Callable[[int, int], None] | None = None,
) -> Crops:
    """Cut each panorama into crops, and write them with a COLMAP model and a ``transforms.json``.

    ``folder/images/`` holds the crops, ``folder/sparse/0/`` the model (cameras, images, points3D), which Gaussian
    splatting programs open as they are; ``folder/transforms.json`` and ``folder/points.ply`` say the same to
    nerfstudio. A crop has those observations as features that were used and that fall into it. Bodies that move are
    left out of all of them, though pictures still show them: masks can keep them from a trainer.

    Parameters
    ----------
    scene
        In space, with its tracks.
    images
        Panoramas of the views: files, or a function of the view's index. Views without one are left out.
    folder
        Where to; it is made where it is absent, and crops of the same names are replaced.
    options
        Which crops.
    component
        Which part of the scene.
    masks
        Masks of the panoramas, white where they count; cut alike and written to ``folder/masks/NAME.png``.
    report
        Called with the number of views done and of all.

    Returns
    -------
    Crops

    Raises
    ------
    InputError
        Where nothing is solved, a picture is not a panorama or of another size than the first, or writing fails.
    MissingExtraError
        Without OpenCV.
    """
    chosen = CropOptions() if options is None else options
    if scene.tracks is None or scene.d != 3:
        raise InputError("crops need a scene in space that knows its tracks")
    views = np.flatnonzero((scene.view_component == component) & np.isfinite(scene.centers).all(axis=1))
    if not len(views):
        raise InputError(f"component {component} has no solved view, so there is nothing to cut crops from")
    place, source = Path(folder), image_source(images, len(scene.centers))
    mask_source = None if masks is None else image_source(masks, len(scene.centers))
    for name in ("images",) if masks is None else ("images", "masks"):
        _make_folder(place / name)
    colours, stems = ColourSum(scene), _stems(scene, views)
    shown = (scene.track_component == component) & resting(scene)
    cutter: _Cutter | None = None
    crops: list[_Crop] = []
    for done, view in enumerate(views.tolist()):
        picture, label = source(view), scene.view_labels()[view]
        if picture is not None:
            check_panorama(picture, label)
            cutter = cutter or _Cutter(chosen, picture.shape[1], picture.shape[0])
            cutter.check_size(picture, label)
            colours.add(view, picture)
            rows = colours.observations(view)
            rows = rows[shown[scene.tracks.track[rows]]]
            made = _cut_view(cutter, picture, place, stems[view], scene=scene, view=view, rows=rows)
            mask = None if mask_source is None else mask_source(view)
            crops += made if mask is None else _with_masks(made, cutter, mask, place, label)
        if report is not None:
            report(done + 1, len(views))
    if cutter is None:
        raise InputError("images has no picture of a solved view")
    painted = colours.colours()
    n_points, n_observations = _write_model(place / "sparse" / "0", scene, crops, painted, cutter)
    write_bytes(place / "points.ply", cloud_bytes(scene, painted, component))
    shots = [Shot(f"images/{c.file}", c.crop_from_world, scene.centers[c.view], c.mask) for c in crops]
    size, focal = cutter.size, cutter.focal
    write_transforms(
        place / "transforms.json", shots, "PINHOLE", width_px=size, height_px=size, focal_px=focal, ply="points.ply"
    )
    return Crops(place, len(crops), size, focal, n_points, n_observations, left_out(scene, component))


@dataclass(frozen=True, eq=False)
class _Crop:
    """One crop, and what it sees."""

    view: int
    file: str
    crop_from_world: Float
    #: (n,) tracks and (n, 2) their pixels, and (n,) distance of the prediction from them.
    track: npt.NDArray[np.int32]
    pixel: Float
    error_px: Float
    mask: str | None = None


class _Cutter:
    """Cuts the crops of one size of panoramas; the maps of pixels are made once."""

    def __init__(self, options: CropOptions, width: int, height: int) -> None:
        if max(width, height) > _MOST_PIXELS:
            raise InputError(f"a panorama is {width} x {height} pixels, expected at most {_MOST_PIXELS} on a side")
        self.panorama_shape = (height, width)
        self.options = options
        self.size = options.size_for(width)
        self.focal = 0.5 * self.size / options.half_width
        self._cv2 = load_opencv()
        # how many pixels of the panorama lie along one of the crop, at its centre
        self._finer = min(max(1, round(width / (2.0 * np.pi) / self.focal)), max(1, _MOST_PIXELS // self.size))
        self._directions = options.directions()
        self._maps: dict[tuple[str, int], _Map] = {}

    def check_size(self, picture: Picture, name: str) -> None:
        """Refuse a picture of another size than the first."""
        (high, wide), (height, width) = picture.shape[:2], self.panorama_shape
        if (high, wide) != (height, width):
            raise InputError(f"{name}: is {wide} x {high} pixels, expected {width} x {height} as the first")

    def cut(self, picture: Picture) -> Iterator[tuple[str, Float, Picture]]:
        """Name, ``crop_from_cam`` and pixels of each crop."""
        padded = _padded(picture)
        size, fine = self.size, self.size * self._finer
        for name, rotation in self._directions:
            crop = np.empty((fine, fine, 3), dtype=np.uint8)
            # a strip at a time, so that what is not kept stays small whatever the size
            step = max(1, (1 << 19) // fine)
            for begin in range(0, fine, step):
                x, y = self._kept(name, rotation, begin, min(begin + step, fine))
                crop[begin : begin + step] = self._cv2.remap(padded, x, y, self._cv2.INTER_LINEAR)
            if self._finer > 1:
                crop = self._cv2.resize(crop, (size, size), interpolation=self._cv2.INTER_AREA)
            yield name, rotation, crop

    def _kept(self, name: str, rotation: Float, begin: int, end: int) -> _Map:
        """Give a strip of a map, made anew only where all of them would not fit."""
        key, fine = (name, begin), self.size * self._finer
        if key in self._maps:
            return self._maps[key]
        made = self._map(rotation, begin, end)
        if 8 * fine * fine * len(self._directions) <= _MOST_MAP_BYTES:
            self._maps[key] = made
        return made

    def _map(self, rotation: Float, begin: int, end: int) -> _Map:
        """Where rows ``begin`` to ``end`` of the fine crop lie in the padded panorama."""
        height, width = self.panorama_shape
        fine = self.size * self._finer
        x = (np.arange(fine) + 0.5 - 0.5 * fine) / (self.focal * self._finer)
        y = (np.arange(begin, end) + 0.5 - 0.5 * fine) / (self.focal * self._finer)
        # single precision is a thousandth of a pixel of the widest panorama, and twice as fast
        right, down, ahead = (
            (x[None, :] * rotation[0, c] + y[:, None] * rotation[1, c] + rotation[2, c]).astype(np.float32)
            for c in range(3)
        )
        theta = np.arctan2(right, ahead)
        phi = np.arctan2(-down, np.hypot(right, ahead))
        # one pixel of padding, and OpenCV has pixel centres at whole numbers
        column = width * (theta / (2.0 * np.pi) + 0.5) + 0.5
        row = height * (0.5 - phi / np.pi) + 0.5
        return column.astype(np.float32), row.astype(np.float32)


def _cut_view(
    cutter: _Cutter,
    picture: Picture,
    folder: Path,
    stem: str,
    *,
    scene: Scene,
    view: int,
    rows: npt.NDArray[np.intp],
) -> list[_Crop]:
    """Write the crops of one view."""
    suffix, quality = cutter.options.suffix, cutter.options.quality
    made = []
    for name, crop_from_cam, pixels in cutter.cut(picture):
        file = f"{stem}_{name}{suffix}"
        write_bytes(folder / "images" / file, encoded(pixels, suffix, quality))
        made.append(_seen(cutter, crop_from_cam, file, scene=scene, view=view, rows=rows))
    return made


def _with_masks(crops: list[_Crop], cutter: _Cutter, mask: Picture, folder: Path, label: str) -> list[_Crop]:
    """Write the masks of one view's crops, in the order of these."""
    cutter.check_size(mask, f"the mask of {label}")
    whole = np.repeat(mask[:, :, None], 3, axis=2) if mask.ndim == 2 else mask
    found = []
    for crop, (_, _, pixels) in zip(crops, cutter.cut(whole), strict=True):
        name = f"masks/{crop.file}.png"
        write_bytes(folder / name, encoded(np.where(pixels[:, :, 0] >= 128, 255, 0).astype(np.uint8), ".png"))
        found.append(replace(crop, mask=name))
    return found


def _padded(picture: Picture) -> Picture:
    """One pixel more on every side: columns wrap round, and beyond a pole the other side begins."""
    height, width = picture.shape[:2]
    padded = np.empty((height + 2, width + 2, 3), dtype=np.uint8)
    padded[1:-1, 1:-1] = picture
    padded[0, 1:-1] = np.roll(picture[0], width // 2, axis=0)
    padded[-1, 1:-1] = np.roll(picture[-1], width // 2, axis=0)
    padded[:, 0], padded[:, -1] = padded[:, -2], padded[:, 1]
    return padded


def _seen(
    cutter: _Cutter, crop_from_cam: Float, file: str, *, scene: Scene, view: int, rows: npt.NDArray[np.intp]
) -> _Crop:
    """Find the observations of a view that fall into one of its crops."""
    tracks = cast(Tracks, scene.tracks)
    crop_from_world = crop_from_cam @ scene.cam_from_world[view]
    ray = tracks.bearing[rows] @ crop_from_cam.T
    found = (scene.points[tracks.track[rows]] - scene.centers[view]) @ crop_from_world.T
    front = (ray[:, 2] > _LEAST_Z) & (found[:, 2] > _LEAST_Z * np.linalg.norm(found, axis=1))
    rows, ray, found = rows[front], ray[front], found[front]
    pixel = cutter.focal * ray[:, :2] / ray[:, 2:] + 0.5 * cutter.size
    predicted = cutter.focal * found[:, :2] / found[:, 2:] + 0.5 * cutter.size
    inside = ((pixel >= 0.0) & (pixel < cutter.size)).all(axis=1)
    error = np.linalg.norm(predicted - pixel, axis=1)
    return _Crop(view, file, crop_from_world, tracks.track[rows[inside]], pixel[inside], error[inside])


def _write_model(
    folder: Path, scene: Scene, parts: list[_Crop], colours: npt.NDArray[np.uint8], cutter: _Cutter
) -> tuple[int, int]:
    size, focal = cutter.size, cutter.focal
    lengths = np.array([len(part.track) for part in parts])
    track = np.concatenate([part.track for part in parts]).astype(np.int64)
    image = np.repeat(np.arange(len(parts)), lengths)
    starts = np.concatenate(([0], np.cumsum(lengths)))
    images = ModelImages(
        image_id=np.arange(1, len(parts) + 1),
        camera_id=np.ones(len(parts), dtype=np.int64),
        names=[part.file for part in parts],
        cam_from_world=np.array([part.crop_from_world for part in parts]),
        centers=scene.centers[[part.view for part in parts]],
        starts=starts,
        pixels=np.concatenate([part.pixel for part in parts]),
        point_id=track.astype(np.uint64) + np.uint64(1),
    )
    by_track = np.argsort(track, kind="stable")
    ids, begins, counts = np.unique(track[by_track], return_index=True, return_counts=True)
    error = np.concatenate([part.error_px for part in parts])[by_track]
    points = ModelPoints(
        point_id=ids.astype(np.uint64) + np.uint64(1),
        positions=scene.points[ids],
        color=colours[ids],
        error_px=np.add.reduceat(error, begins) / counts if len(ids) else error,
        starts=np.append(begins, len(by_track)),
        elements=np.stack((image[by_track] + 1, by_track - starts[image[by_track]]), axis=1),
    )
    camera = Camera(1, _PINHOLE_ID, size, size, (focal, focal, 0.5 * size, 0.5 * size))
    write_model(folder, [camera], images, points)
    return len(ids), len(track)


def _stems(scene: Scene, views: npt.NDArray[np.intp]) -> dict[int, str]:
    """File names of the views: theirs without folder and suffix where these differ, else with their index."""
    labels = scene.view_labels()
    plain = {view: re.sub(r"[^\w.-]+", "_", re.split(r"[\\/]", labels[view])[-1]) for view in views.tolist()}
    short = {view: name.rsplit(".", 1)[0] or name for view, name in plain.items()}
    stems = {view: f"view_{name}" if name.isdecimal() else name for view, name in short.items()}
    if len({stem.lower() for stem in stems.values()}) < len(stems):
        return {view: f"{view:06d}_{stem}" for view, stem in stems.items()}
    return stems


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
