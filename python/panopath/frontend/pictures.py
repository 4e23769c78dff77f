"""From a source to features and matches, in the form in which the mapper takes them.

    video:   motion -> keyframes -> features -> matches
    folder:            pictures  -> features -> matches

As many pictures are in memory as are worked on at once; features stay.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.cameras import bearings_from_equirectangular, bearings_from_pixels
from panopath.checkpoints import Checkpoints, key_of
from panopath.errors import InputError, UndeterminedError
from panopath.formats.colmap_model import EQUIRECTANGULAR_ID, Camera
from panopath.formats.database import Database, database_of_features
from panopath.frontend.extras import opencv
from panopath.frontend.features import FeatureFinder, FeatureOptions, Features
from panopath.frontend.fixed import FixedContent, FixedOptions, find_fixed, without_fixed
from panopath.frontend.images import Gray, at_width, masks_of, positions_of, read_image, read_mask
from panopath.frontend.matching import ImageMatches, MatchingOptions, match_images
from panopath.frontend.moments import SMALL_RIG_M, match_moments
from panopath.frontend.sources import Source, SourceKind
from panopath.frontend.stored import Looked, Store, key_of_masks, key_of_source
from panopath.frontend.video import (
    DecodedFrames,
    VideoKind,
    VideoMotion,
    VideoOptions,
    choose_keyframes,
    read_frames,
    video_motion,
)
from panopath.model import Bool, Float, Int

Index = npt.NDArray[np.int64]

_NOT_DETERMINED = {
    VideoKind.STILL: "the camera stands still: there is no path to find; move it by some metres",
    VideoKind.PURE_ROTATION: "the camera only turns: without a change of place nothing can be seen in depth",
    VideoKind.DARK: "the video is too dark to follow anything: film with more light",
    VideoKind.TEXTURELESS: "there is nothing to follow, no texture; expected a place with things to see",
}
#: Pictures in work at once, at most: each takes some 40 times its bytes.
_MOST_AT_ONCE = 4
#: Fewest features that say anything of a picture.
_FEWEST = 30


@dataclass(frozen=True)
class FrontEndOptions:
    """Choices of :func:`measure`."""

    #: Pictures wider than this are shrunk before features are sought.
    width: int = 1600
    features: FeatureOptions = field(default_factory=FeatureOptions)
    matching: MatchingOptions = field(default_factory=MatchingOptions)
    video: VideoOptions = field(default_factory=VideoOptions)
    #: Whether the pictures of a folder were taken in the order of their names.
    in_sequence: bool = True
    #: Whether to look for what is fixed to the camera, such as who carries it, and to leave it out.
    find_fixed: bool = True

    def __post_init__(self) -> None:
        if isinstance(self.width, bool) or not isinstance(self.width, int) or self.width < 128:
            raise InputError(f"width is {self.width!r}, expected a whole number of at least 128")


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture that is measured, as it passes by."""

    index: int
    name: str
    #: (height, width) at the working resolution.
    gray: Gray
    #: (height, width, 3) red, green, blue at full size, where asked for.
    color: Gray | None
    #: Seconds: of a video, from its start; of pictures, of the camera's clock; NaN where unknown.
    time_s: float


@dataclass(frozen=True, eq=False)
class Measured:
    """What the front end found."""

    source: Source
    #: For :func:`panopath.mapping.map_database`.
    database: Database
    features: tuple[Features, ...]
    matches: ImageMatches
    #: (M,) seconds, NaN where unknown; and of a video the (M,) numbers of the frames.
    time_s: Float
    frame_index: Int | None
    motion: VideoMotion | None
    #: Of each camera what goes with it; empty where that was not sought.
    fixed: tuple[FixedContent, ...]
    #: Names of pictures with too few features to say anything.
    empty: tuple[str, ...]
    #: Seconds of each stage.
    seconds: dict[str, float]
    #: Of what this was made from, for checkpoints of what is made of it.
    key: str


def measure(
    source: Source,
    options: FrontEndOptions | None = None,
    *,
    masks: Path | None = None,
    store: Checkpoints | None = None,
    report: Callable[[str, int, int], None] | None = None,
    each: Callable[[Picture], None] | None = None,
    color: bool = False,
) -> Measured:
    """Find features in the pictures of a source and match them.

    Parameters
    ----------
    source
        See :func:`panopath.frontend.recognise`.
    options
        Choices; default ``FrontEndOptions()``.
    masks
        A mask for all pictures, or a folder of masks named like them: no features where they are black.
    store
        Where to leave what was done, and to find what an earlier run has done.
    report
        Called with a stage, how many of its steps are done and how many there are (0: not known).
    each
        Called with every picture that is measured, while it is in memory; not with those found in ``store``.
    color
        Whether ``each`` gets colours, and features have them.

    Raises
    ------
    InputError
        Where a picture or a mask cannot be used.
    UndeterminedError
        Where the source says why nothing can be found: it stands still, is dark, nothing matches.
    """
    chosen = FrontEndOptions() if options is None else options
    say = report or (lambda _stage, _done, _of: None)
    seconds: dict[str, float] = {}
    key = key_of_source(source)
    motion, keyframes, pts, decoded = None, None, None, DecodedFrames()
    if source.kind is SourceKind.VIDEO:
        begin = time.perf_counter()
        key = key_of(key, chosen.video)
        motion = _moving(source, chosen, Store(store, key), say, decoded)
        keyframes, pts = choose_keyframes(motion, chosen.video), motion.pts
        seconds["motion"] = time.perf_counter() - begin
    begin = time.perf_counter()
    key = key_of(key, chosen.width, chosen.features, key_of_masks(masks), color)
    looked = _look(_Look(source, keyframes, pts, decoded, chosen, masks, color), Store(store, key), say, each)
    seconds["features"] = time.perf_counter() - begin
    features = [one.features for one in looked]
    empty = tuple(one.name for one in looked if len(one.features) < _FEWEST)
    if len(features) - len(empty) < 2:
        raise UndeterminedError(
            f"{source.path}: {len(empty)} of {len(features)} pictures have no features (dark, blurred or "
            "without texture), expected at least two that have some"
        )
    begin = time.perf_counter()
    cameras, full_size, spans = _cameras(source, chosen.width)
    camera_of = _camera_of(source, len(features))
    full = [
        _with_bearings(cameras[c], _scaled(found, full_size[c])) for found, c in zip(features, camera_of, strict=True)
    ]
    rays = [_rays(cameras[c], found) for c, found in zip(camera_of, full, strict=True)]
    pixel_rad = [_pixel_rad(camera) * span for camera, span in zip(cameras, spans.tolist(), strict=True)]
    say("matching", 0, 0)
    fixed: tuple[FixedContent, ...] = ()
    if chosen.find_fixed:
        seed = chosen.matching.seed
        fixed = Store(store, key_of(key, seed)).fixed(lambda: _fixed(full, rays, camera_of, pixel_rad, seed))
        full = [without_fixed(found, ray, fixed[c]) for found, ray, c in zip(full, rays, camera_of, strict=True)]
        rays = [_rays(cameras[c], found) for c, found in zip(camera_of, full, strict=True)]
    key = key_of(key, chosen.matching, chosen.in_sequence, chosen.find_fixed)
    matches = Store(store, key).matches(lambda: _match(source, full, rays, float(np.median(pixel_rad)), chosen))
    seconds["matching"] = time.perf_counter() - begin
    if not len(matches.pairs):
        raise UndeterminedError(
            f"{source.path}: no two pictures match, expected pictures that show the same things from "
            "places not far apart"
        )
    known = positions_of(list(source.headers)) if source.headers else None
    is_rig = source.kind is SourceKind.RIG
    database = database_of_features(
        [one.name for one in looked],
        cameras,
        camera_of,
        [found.pixels for found in full],
        matches.pairs,
        matches.starts,
        matches.matches,
        image_frame=source.image_frame if is_rig else None,
        sensor_from_rig=source.sensor_from_rig if is_rig else None,
        center_in_rig=source.center_in_rig if is_rig else None,
        position_wgs84=known,
        feature_px=spans,
        source=source.path,
    )
    index = None if keyframes is None else keyframes.astype(np.int32)
    times = np.array([one.time_s for one in looked])
    return Measured(source, database, tuple(full), matches, times, index, motion, fixed, empty, seconds, key)


@dataclass(frozen=True, eq=False)
class _Look:
    """What is looked at, and how."""

    source: Source
    keyframes: Index | None
    #: Time stamps of all frames of a video, where they tell them apart.
    pts: Index | None
    decoded: DecodedFrames
    options: FrontEndOptions
    masks: Path | None
    color: bool

    def __len__(self) -> int:
        return len(self.source.images) if self.keyframes is None else len(self.keyframes)


def _look(
    look: _Look,
    store: Store,
    say: Callable[[str, int, int], None],
    each: Callable[[Picture], None] | None,
) -> list[Looked]:
    """Look at all pictures; those that an earlier run has looked at are not opened."""
    found = [store.look(k) for k in range(len(look))]
    missing = [k for k, one in enumerate(found) if one is None]
    done = len(look) - len(missing)
    say("features", done, len(look))

    find = FeatureFinder(look.options.features, equirectangular=look.source.is_panoramic)

    def extract(picture: Picture, mask: Bool | None) -> Features:
        own = find(picture.gray, mask)
        return own if picture.color is None else replace(own, color=_colors(own, picture.gray, picture.color))

    for picture, features in _in_parallel(_pictures(look, missing), extract):
        if each is not None:
            each(picture)
        looked = found[picture.index] = Looked(picture.name, picture.time_s, features)
        # a picture counts as done when all that is made of it is there
        store.leave_look(picture.index, looked)
        done += 1
        say("features", done, len(look))
    return [one for one in found if one is not None]


def _colors(features: Features, gray: Gray, color: Gray) -> npt.NDArray[np.uint8]:
    height, width = color.shape[:2]
    scale = np.array((width, height)) / np.array(gray.shape[::-1])
    at = np.clip((features.pixels * scale).astype(np.int64), 0, (width - 1, height - 1))
    return np.ascontiguousarray(color[at[:, 1], at[:, 0]])


def _in_parallel(
    pictures: Iterator[tuple[Picture, Bool | None]], task: Callable[[Picture, Bool | None], Features]
) -> Iterator[tuple[Picture, Features]]:
    """Work on as many pictures at once as there are processors, in their order.

    OpenCV's own threads share one picture and wait for one another; a picture each is faster, and one thread each.
    """
    cv2, n = opencv(), min(os.cpu_count() or 1, _MOST_AT_ONCE)
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    waiting: deque[tuple[Picture, Future[Features]]] = deque()
    pool = ThreadPoolExecutor(n)
    try:
        for picture, mask in pictures:
            waiting.append((picture, pool.submit(task, picture, mask)))
            if len(waiting) > n:
                first, found = waiting.popleft()
                yield first, found.result()
        while waiting:
            first, found = waiting.popleft()
            yield first, found.result()
    finally:
        pool.shutdown(cancel_futures=True)
        cv2.setNumThreads(before)


def _moving(
    source: Source,
    options: FrontEndOptions,
    store: Store,
    say: Callable[[str, int, int], None],
    decoded: DecodedFrames,
) -> VideoMotion:
    """How the camera moved, where it did."""
    n = source.video.n_frames if source.video is not None else 0
    motion = store.motion(
        lambda: video_motion(source.path, options.video, lambda done: say("motion", done, n), decoded=decoded)
    )
    if motion.kind is not VideoKind.MOVING:
        raise UndeterminedError(f"{source.path}: {_NOT_DETERMINED[motion.kind]}")
    return motion


def _pictures(look: _Look, wanted: Sequence[int]) -> Iterator[tuple[Picture, Bool | None]]:
    """Yield some of the pictures at the working resolution, with their masks."""
    source, width = look.source, look.options.width
    if look.keyframes is not None:
        own = min(width, source.cameras[0].width) // 2 * 2
        check_masks(source, look.masks)
        mask = None if look.masks is None else read_mask(look.masks)
        frames = read_frames(
            source.path,
            look.keyframes[list(wanted)].tolist(),
            own,
            color=look.color,
            pts=look.pts,
            decoded=look.decoded,
        )
        for k, frame in zip(wanted, frames, strict=True):
            yield Picture(k, f"frame_{frame.index:06d}.jpg", frame.gray, frame.color, frame.time_s), mask
        return
    listed = masks_of(look.masks, list(source.images))
    for k in wanted:
        path, name, header, mask_file = source.images[k], source.names[k], source.headers[k], listed[k]
        rgb = read_image(path, color=True) if look.color else None
        gray = _at_working_size(read_image(path) if rgb is None else _gray(rgb), source, width)
        mask = None if mask_file is None else read_mask(mask_file)
        yield Picture(k, name, gray, rgb, np.nan if header.time_s is None else header.time_s), mask


def check_masks(source: Source, masks: Path | None) -> None:
    """Say now, before long work, whether masks cannot be used.

    Raises
    ------
    InputError
        Where they are not there, are no pictures, or are a folder but the source is a video.
    """
    if masks is None:
        return
    if source.kind is SourceKind.VIDEO and masks.is_dir():
        raise InputError(f"{masks}: is a folder, expected one mask for all frames of a video")
    masks_of(masks, list(source.images))
    if masks.is_file():
        read_mask(masks)


def _gray(color: Gray) -> Gray:
    cv2 = opencv()
    return np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def _at_working_size(picture: Gray, source: Source, width: int) -> Gray:
    """Shrink; a panorama that lost a row becomes twice as wide as high."""
    if not source.is_panoramic:
        return at_width(picture, width)
    own = min(width, picture.shape[1]) // 2 * 2
    if picture.shape[:2] == (own // 2, own):
        return picture
    cv2 = opencv()
    return np.asarray(cv2.resize(picture, (own, own // 2), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _camera_of(source: Source, n: int) -> Int:
    return source.image_camera if len(source.image_camera) else np.zeros(n, dtype=np.int32)


def _cameras(source: Source, width: int) -> tuple[tuple[Camera, ...], list[tuple[float, float]], Float]:
    """Cameras of the database; pixels of each for one of the working resolution, in x and y; and how much they span."""
    scales = []
    for camera in source.cameras:
        own = min(width, camera.width)
        if source.is_panoramic:
            own = own // 2 * 2
            scales.append((camera.width / own, camera.height / (own // 2)))
        else:
            scales.append((camera.width / own, camera.height / max(1, round(camera.height * own / camera.width))))
    return source.cameras, scales, np.array([scale[0] for scale in scales])


def _scaled(found: Features, scale: tuple[float, float]) -> Features:
    """Features with their pixels in an image of another size."""
    return found if scale == (1.0, 1.0) else replace(found, pixels=found.pixels * scale)


def _with_bearings(camera: Camera, found: Features) -> Features:
    """Leave out features that the camera cannot unproject, such as those beyond the circle of a fisheye."""
    known = np.isfinite(_rays(camera, found)).all(axis=1)
    return found if bool(known.all()) else found.select(np.asarray(known))


def _fixed(
    features: list[Features], rays: list[Float], camera_of: Int, pixel_rad: list[float], seed: int
) -> tuple[FixedContent, ...]:
    """Find what is fixed to each camera."""
    found = []
    for camera, angle in enumerate(pixel_rad):
        own = np.flatnonzero(camera_of == camera).tolist()
        found.append(find_fixed([features[k] for k in own], [rays[k] for k in own], angle, FixedOptions(seed=seed)))
    return tuple(found)


def _match(
    source: Source, features: list[Features], rays: list[Float], pixel_rad: float, options: FrontEndOptions
) -> ImageMatches:
    pairs = None
    if source.kind is SourceKind.RIG and np.linalg.norm(source.center_in_rig, axis=1).max() <= SMALL_RIG_M:
        rig = (source.image_frame, source.image_camera, source.sensor_from_rig)
        return match_moments(features, rays, rig, pixel_rad, options.matching, in_sequence=options.in_sequence)
    if source.kind is SourceKind.RIG:
        pairs = _pairs_of_frames(source.image_frame, options)
    positions = None
    if source.headers:
        positions = _metres(positions_of(list(source.headers)))
    return match_images(
        features, rays, pixel_rad, options.matching, in_sequence=options.in_sequence and pairs is None,
        positions_m=positions, pairs=pairs, all_around=source.is_panoramic,
    )  # fmt: skip


def _rays(camera: Camera, found: Features) -> Float:
    if camera.model in {EQUIRECTANGULAR_ID, "EQUIRECTANGULAR"}:
        return bearings_from_equirectangular(found.pixels, camera.width, camera.height)
    return bearings_from_pixels(_as_mapping(camera), found.pixels)


def _as_mapping(camera: Camera) -> dict[str, Any]:
    return {"model": camera.model, "width": camera.width, "height": camera.height, "params": list(camera.params)}


def _pixel_rad(camera: Camera) -> float:
    """Angle of a pixel, of cameras with a focal length that in the middle."""
    if camera.model in {EQUIRECTANGULAR_ID, "EQUIRECTANGULAR"}:
        return 2.0 * np.pi / camera.width
    middle = np.array([[camera.width / 2, camera.height / 2], [camera.width / 2 + 1, camera.height / 2]])
    a, b = bearings_from_pixels(_as_mapping(camera), middle)
    return float(np.linalg.norm(a - b))


def _pairs_of_frames(frame: Int, options: FrontEndOptions) -> Int:
    """All pairs of pictures of moments that follow one another, or of all moments where there are few."""
    first, second = np.triu_indices(len(frame), 1)
    apart = np.abs(frame[first] - frame[second])
    n_frames = int(frame.max()) + 1
    near = n_frames if n_frames <= options.matching.exhaustive_images else options.matching.neighbours
    keep = (apart > 0) & (apart <= near)
    return np.stack((first[keep], second[keep]), axis=1).astype(np.int32)


def _metres(wgs84: Float) -> Float:
    """Places good enough to say which are near: metres north, east and up of the first."""
    known = wgs84[np.isfinite(wgs84).all(axis=1)]
    origin = known[0] if len(known) else np.zeros(3)
    degree = 111_320.0
    scale = np.array([degree, degree * np.cos(np.radians(origin[0])), 1.0])
    return np.asarray((wgs84 - origin) * scale)
