"""A 360 video: how the camera moved from frame to frame, roughly, and which frames to measure in.

Points are followed on a small image (Lucas and Kanade 1981, pyramids of Bouguet 2001) from a frame of reference on. The
rotation that carries their bearings nearest to where they began is taken off; the angle left of the near ones is
parallax. Where it has grown enough, the next reference begins. This drifts, and is never used to measure: it says where
new keyframes are worth their time, and what kind of video this is.

The video is decoded twice, first small and whole, then the keyframes at the working resolution; one frame is in memory.
The second pass leaves out what is not asked for and no other frame needs, where the codec says so; a short video needs
none, since its frames stay in memory until the keyframes are chosen.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from panopath.cameras import bearings_from_equirectangular
from panopath.errors import InputError
from panopath.frontend.extras import opencv, pyav
from panopath.frontend.images import Gray
from panopath.model import Bool, Float, Tracks, read_only
from panopath.steps import fit_rotations

Index = npt.NDArray[np.int64]
_Item = TypeVar("_Item")

#: Points followed, and fewest that say how the camera moved.
_POINTS, _FEWEST = 400, 25
#: Parallax at which the next frame of reference begins, radians: well above what following errs by.
_REFERENCE_RAD = float(np.radians(0.8))
#: Share of the points that show less parallax than what counts: much of a panorama may be sky.
_PARALLAX_QUANTILE = 0.8
#: What stays below these, radians, is no motion.
_STILL_RAD, _NO_TURN_RAD = float(np.radians(0.25)), float(np.radians(1.5))
#: Mean brightness of a dark frame.
_DARK = 16.0
#: Pixels by which the small image runs on over its seam.
_PAD = 48
#: Elevation up to which points are followed: nearer the poles the image is stretched too much.
_MOST_ELEVATION_RAD = float(np.radians(60.0))
#: Formats of frames whose first plane is the brightness, a byte a pixel; FFmpeg's number of the full range of it.
_BRIGHTNESS_FIRST = {"yuv420p", "yuv422p", "yuv444p", "yuvj420p", "yuvj422p", "yuvj444p", "nv12", "gray"}
_FULL_RANGE = 2
#: Small frames made before they are asked for: some take longer to decode than others.
_AHEAD = 6
#: Bytes of decoded frames that may stay in memory.
_MOST_KEPT = 400_000_000
#: Codecs in which a frame that is marked as no reference is needed by no other, whatever the encoder. (HEVC is none of
#: them: there the mark is about frames of the same temporal layer.)
_TELLS_REFERENCES = {"h264", "mpeg2video", "mpeg4"}
_FULL_FROM_LIMITED = np.clip(np.rint((np.arange(256) - 16.0) * (255.0 / 219.0)), 0.0, 255.0).astype(np.uint8)


class VideoKind(StrEnum):
    """What the motion turned out to be."""

    MOVING = "moving"
    #: Neither motion nor rotation.
    STILL = "still"
    #: Rotation alone: there is no parallax to see depth by.
    PURE_ROTATION = "pure_rotation"
    #: Too dark to follow anything.
    DARK = "dark"
    #: Light enough, but with nothing to follow.
    TEXTURELESS = "textureless"


@dataclass(frozen=True)
class VideoOptions:
    """Choices of :func:`video_motion` and :func:`choose_keyframes`."""

    #: Width of the image on which points are followed.
    motion_width: int = 640
    #: Parallax from one keyframe to the next, radians.
    parallax_rad: float = float(np.radians(20.0))
    #: A video with less parallax than this many keyframes need has them closer together.
    least_keyframes: int = 16
    #: Frames further apart than this, in seconds, are no neighbours worth relying on: a keyframe comes in between.
    most_apart_s: float = 10.0

    def __post_init__(self) -> None:
        if not 64 <= self.motion_width <= 8192:
            raise InputError(f"motion_width is {self.motion_width!r}, expected 64 to 8192")
        for name in ("parallax_rad", "most_apart_s"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"{name} is {value!r}, expected a positive number")
        if self.least_keyframes < 2:
            raise InputError(f"least_keyframes is {self.least_keyframes!r}, expected at least 2")


@dataclass(frozen=True)
class VideoHeader:
    """What the container says."""

    path: Path
    width: int
    height: int
    #: Frames a second, and how many frames the container announces (0: it does not).
    rate_hz: float
    n_frames: int
    codec: str


@dataclass(frozen=True, eq=False)
class VideoMotion:
    """The rough motion over all F frames that could be decoded."""

    #: (F,) seconds.
    time_s: Float
    #: (F, 3, 3) rotation of each camera from the first, chained; it drifts.
    cam_from_first: Float
    #: (F,) parallax that has gone by, radians; never less than before.
    travelled_rad: Float
    #: (F,) variance of the Laplacian: low where blurred.
    sharpness: Float
    #: (F,) mean brightness, 0 to 255.
    brightness: Float
    #: (F,) frames where too few points could be followed from the one before.
    lost: Bool
    #: Packets or frames that could not be decoded.
    n_corrupt: int
    kind: VideoKind
    #: (F,) time stamps in units of the file, ascending; None where they are not, or not all frames could be decoded.
    pts: Index | None = None

    def __post_init__(self) -> None:
        for name in ("time_s", "cam_from_first", "travelled_rad", "sharpness", "brightness", "lost"):
            read_only(getattr(self, name))
        if self.pts is not None:
            read_only(self.pts)

    def __len__(self) -> int:
        return len(self.time_s)


def read_video_header(path: Path) -> VideoHeader:
    """Read what the container says of its first video stream.

    Raises
    ------
    InputError
        Naming a file without video.
    """
    with _open(path) as (_, stream):
        context = stream.codec_context
        return VideoHeader(
            path,
            int(context.width),
            int(context.height),
            float(stream.average_rate or 0.0),
            int(stream.frames),
            str(context.name),
        )


class _open:  # noqa: N801 a function to its callers
    """Container and first video stream; what FFmpeg says of the file becomes one line."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> tuple[Any, Any]:
        av = pyav()
        if not self._path.is_file():
            raise InputError(f"{self._path}: there is no such file")
        try:
            self._container = av.open(str(self._path))
        except (av.error.FFmpegError, OSError) as error:
            why = "it was cut short and has no index" if _has_no_index(self._path) else error.strerror or str(error)
            raise InputError(f"{self._path}: cannot be read as a video ({why})") from None
        if not self._container.streams.video or not self._container.streams.video[0].codec_context.width:
            self._container.close()
            raise InputError(f"{self._path}: has no video stream")
        stream = self._container.streams.video[0]
        stream.thread_type = "AUTO"
        return self._container, stream

    def __exit__(self, *_: object) -> None:
        self._container.close()


def _has_no_index(path: Path) -> bool:
    """Whether a file is an MP4 without the box that says where its frames are, which cameras write last."""
    kinds: list[bytes] = []
    place = 0
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            while place + 8 <= size and len(kinds) < 64:
                file.seek(place)
                head = file.read(16)
                length = int.from_bytes(head[:4], "big")
                length = int.from_bytes(head[8:], "big") if length == 1 else length
                kinds.append(head[4:8])
                if length < 8:
                    break
                place += length
    except OSError:
        return False
    return kinds[:1] == [b"ftyp"] and b"moov" not in kinds


def _frames(
    path: Path, damaged: Callable[[], None] | None = None, wanted: Collection[int] | None = None
) -> Iterator[Any]:
    """Yield the frames that can be decoded, in their order; of those not ``wanted``, by time stamp, perhaps not all."""
    error_type = pyav().error.FFmpegError
    with _open(path) as (container, stream):
        packets = container.demux(stream)
        context = stream.codec_context
        spares = wanted is not None and context.name in _TELLS_REFERENCES
        while True:
            try:
                packet = next(packets, None)
                if packet is None:
                    return
                if spares and wanted is not None:
                    is_wanted = packet.pts is None or packet.pts in wanted
                    context.skip_frame = "DEFAULT" if is_wanted else "NONREF"
                frames = packet.decode()
            except error_type:
                # a damaged packet costs its frames, not the video
                if damaged is not None:
                    damaged()
                continue
            for frame in frames:
                if frame.is_corrupt:
                    if damaged is not None:
                        damaged()
                else:
                    yield frame


class DecodedFrames:
    """All frames of a short video, so that none is decoded twice; of a longer one none."""

    def __init__(self, most_bytes: int = _MOST_KEPT) -> None:
        self._left = most_bytes
        self._frames: dict[int, Any] = {}

    def keep(self, frame: Any) -> None:
        """Keep the next frame, if there is room for all."""
        self._left -= sum(plane.buffer_size for plane in frame.planes)
        if self._left >= 0:
            self._frames[len(self._frames)] = frame
        else:
            self._frames.clear()

    def pop(self, index: int) -> Any | None:
        """Hand out a frame, and let go of those before it."""
        for k in [k for k in self._frames if k < index]:
            del self._frames[k]
        return self._frames.pop(index, None)


def _ahead(items: Iterator[_Item]) -> Iterator[_Item]:
    """Yield the items, while a thread makes the next ones: decoding and what follows share two processors."""
    end = object()
    with ThreadPoolExecutor(1) as pool:
        following: deque[Future[Any]] = deque(pool.submit(next, items, end) for _ in range(_AHEAD))
        while (item := following.popleft().result()) is not end:
            following.append(pool.submit(next, items, end))
            yield item


def _gray(frame: Any, width: int) -> Gray:
    """Brightness of a frame, ``width // 2`` high: where the codec keeps it apart, colours need not be looked at."""
    height = width // 2
    if frame.format.name not in _BRIGHTNESS_FIRST:
        shrunk = frame.reformat(width=width, height=height, format="gray", interpolation="AREA").to_ndarray()
        return np.ascontiguousarray(shrunk[:height, :width])
    plane, cv2 = frame.planes[0], opencv()
    picture = np.frombuffer(plane, dtype=np.uint8).reshape(-1, plane.line_size)[: frame.height, : frame.width]
    shrunk = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(shrunk if _is_full_range(frame) else cv2.LUT(shrunk, _FULL_FROM_LIMITED), dtype=np.uint8)


def _is_full_range(frame: Any) -> bool:
    """Whether brightness goes from 0 to 255, else from 16 to 235, as it does where nothing is said."""
    return frame.format.name.startswith(("yuvj", "gray")) or int(frame.color_range) == _FULL_RANGE


def video_motion(
    path: Path,
    options: VideoOptions | None = None,
    report: Callable[[int], None] | None = None,
    *,
    decoded: DecodedFrames | None = None,
) -> VideoMotion:
    """Follow points through a 360 video.

    Parameters
    ----------
    path
        The file.
    options
        Choices; default ``VideoOptions()``.
    report
        Called with the number of frames seen so far.
    decoded
        Where to keep the frames, for :func:`read_frames`.

    Raises
    ------
    InputError
        Where no frame can be decoded.
    """
    chosen = VideoOptions() if options is None else options
    counter = {"corrupt": 0}

    def damaged() -> None:
        counter["corrupt"] += 1

    follower, times, stamps = _Follower(chosen.motion_width), [], []

    def small() -> Iterator[tuple[float | None, int | None, _SmallFrame]]:
        for frame in _frames(path, damaged):
            if decoded is not None:
                decoded.keep(frame)
            picture = _gray(frame, chosen.motion_width)
            yield frame.time, frame.pts, _SmallFrame.of(picture, seeks_corners=follower.restarts_often)

    for k, (time, stamp, seen) in enumerate(_ahead(small())):
        times.append(float(k) if time is None else float(time))
        stamps.append(stamp)
        follower.see(seen)
        if report is not None:
            report(k + 1)
    if not times:
        raise InputError(f"{path}: no frame of it can be decoded")
    return replace(
        follower.motion(np.array(times), counter["corrupt"]), pts=None if counter["corrupt"] else _ascending(stamps)
    )


def _ascending(stamps: Sequence[int | None]) -> Index | None:
    """Time stamps as an array, where all are there and ascend, so that each means one frame."""
    known = np.array([stamp for stamp in stamps if stamp is not None], dtype=np.int64)
    return known if len(known) == len(stamps) and bool((np.diff(known) > 0).all()) else None


@dataclass(frozen=True, eq=False)
class _SmallFrame:
    """A frame on which points are followed, with what can be told of it before the one that came earlier is done."""

    picture: Gray
    sharpness: float
    brightness: float
    #: (N, 2) pixels; None where they were not sought yet.
    corners: npt.NDArray[np.float32] | None

    @classmethod
    def of(cls, picture: Gray, *, seeks_corners: bool) -> _SmallFrame:
        cv2 = opencv()
        sharpness = float(cv2.meanStdDev(cv2.Laplacian(picture, cv2.CV_32F))[1].item() ** 2)
        return cls(picture, sharpness, float(picture.mean()), _corners(picture) if seeks_corners else None)


def _corners(picture: Gray) -> npt.NDArray[np.float32]:
    """Corners worth following, away from the poles."""
    height, width = picture.shape
    mask = np.zeros_like(picture)
    most = int(_MOST_ELEVATION_RAD / np.pi * height)
    mask[height // 2 - most : height // 2 + most] = 255
    points = opencv().goodFeaturesToTrack(picture, _POINTS, 0.003, width / 80, mask=mask, blockSize=5)
    return np.empty((0, 2), np.float32) if points is None else points.reshape(-1, 2).astype(np.float32)


class _Follower:
    """Points followed from a frame of reference on."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._before: Gray | None = None
        self._points = np.empty((0, 2), dtype=np.float32)
        self._began = np.empty((0, 3))
        self._reference_from_first = np.eye(3)
        self._base_rad = 0.0
        self._rotations: list[Float] = []
        self._travelled: list[float] = []
        self._sharpness: list[float] = []
        self._brightness: list[float] = []
        self._lost: list[bool] = []
        self._n_points: list[int] = []
        #: Whether the last frame became a reference: then corners of those to come are worth seeking ahead of time.
        self.restarts_often = True

    def see(self, frame: _SmallFrame) -> None:
        """Take the next frame."""
        small = frame.picture
        padded = np.concatenate((small[:, -_PAD:], small, small[:, :_PAD]), axis=1)
        self._sharpness.append(frame.sharpness)
        self._brightness.append(frame.brightness)
        if self._before is None:
            rotation, parallax, lost = np.eye(3), 0.0, False
        else:
            rotation, parallax, lost = self._follow(padded)
        self._rotations.append(rotation @ self._reference_from_first)
        self._travelled.append(max([self._base_rad + parallax, *self._travelled[-1:]]))
        self._lost.append(lost)
        self._before = padded
        few = len(self._points) < max(_FEWEST, _POINTS // 3)
        self.restarts_often = lost or few or parallax > _REFERENCE_RAD or len(self._rotations) == 1
        if self.restarts_often:
            if parallax > _STILL_RAD / 2:
                self._base_rad += parallax
            self._restart(_corners(small) if frame.corners is None else frame.corners)
        self._n_points.append(len(self._points))

    def _follow(self, padded: Gray) -> tuple[Float, float, bool]:
        """Rotation from the frame of reference, and the angle that it leaves of all but the nearest points."""
        if len(self._points) >= _FEWEST:
            moved, found, _ = opencv().calcOpticalFlowPyrLK(
                self._before,
                padded,
                self._points + np.array((_PAD, 0), dtype=np.float32),
                None,
                winSize=(15, 15),
                maxLevel=4,
            )
            moved = moved - np.array((_PAD, 0), dtype=np.float32)
            elevation = np.abs(0.5 - moved[:, 1] / (self._width / 2)) * np.pi
            keep = (found.ravel() == 1) & (elevation < _MOST_ELEVATION_RAD)
            self._points = np.mod(moved[keep], np.array((self._width, 1e6))).astype(np.float32)
            self._began = self._began[keep]
        if len(self._points) < _FEWEST:
            return np.eye(3), 0.0, True
        now = self._bearings()
        rotation = _rotation(self._began, now)
        off = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(self._began @ rotation.T - now, axis=1), 0.0, 1.0))
        # what went astray is not followed further
        parallax = float(np.quantile(off, _PARALLAX_QUANTILE))
        good = off < max(4.0 * parallax, 0.02)
        self._points, self._began = self._points[good], self._began[good]
        return rotation, parallax, bool(np.median(off) > np.radians(20.0))

    def _restart(self, corners: npt.NDArray[np.float32]) -> None:
        self._reference_from_first = self._rotations[-1]
        self._points = corners
        self._began = self._bearings()

    def _bearings(self) -> Float:
        return bearings_from_equirectangular(self._points.astype(np.float64) + 0.5, self._width, self._width // 2)

    def motion(self, time_s: Float, n_corrupt: int) -> VideoMotion:
        """Sum up."""
        rotations, travelled = np.array(self._rotations), np.array(self._travelled)
        return VideoMotion(
            time_s=time_s,
            cam_from_first=rotations,
            travelled_rad=travelled,
            sharpness=np.array(self._sharpness),
            brightness=np.array(self._brightness),
            lost=np.array(self._lost),
            n_corrupt=n_corrupt,
            kind=self._kind(rotations, travelled),
        )

    def _kind(self, rotations: Float, travelled: Float) -> VideoKind:
        is_dark = float(np.median(self._brightness)) < _DARK
        if float(np.median(self._n_points)) < _FEWEST:
            return VideoKind.DARK if is_dark else VideoKind.TEXTURELESS
        if travelled[-1] >= _STILL_RAD:
            return VideoKind.MOVING
        if is_dark:
            return VideoKind.DARK  # what little is seen stays, as noise of the sensor does
        cosine = 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0)
        turned = float(np.arccos(np.clip(cosine, -1.0, 1.0)).max())
        return VideoKind.PURE_ROTATION if turned > _NO_TURN_RAD else VideoKind.STILL


def _rotation(first: Float, second: Float) -> Float:
    """Rotation that carries bearings nearest to others; near points, which move by themselves, count little."""
    n = len(first)
    tracks = Tracks.from_arrays(np.zeros(n, dtype=np.int32), np.arange(n, dtype=np.int32), second, 1, n)
    return np.asarray(fit_rotations(tracks, (np.zeros((1, 3)), first), np.eye(3)[None])[0])


def choose_keyframes(motion: VideoMotion, options: VideoOptions | None = None) -> Index:
    """Choose frames at equal steps of parallax, the sharpest thereabouts.

    Returns
    -------
    array
        Indices of frames, ascending; the first and the last are about the ends of the video.
    """
    chosen = VideoOptions() if options is None else options
    travelled = np.asarray(motion.travelled_rad)
    total = float(travelled[-1])
    n_steps = max(int(np.ceil(total / chosen.parallax_rad)), min(chosen.least_keyframes, len(motion)) - 1, 1)
    step = max(total / n_steps, 1e-9)
    found = []
    for k in range(n_steps + 1):
        near = np.flatnonzero(np.abs(travelled - k * step) <= step / 3)
        if not len(near):
            near = np.array([int(np.argmin(np.abs(travelled - k * step)))])
        off = np.abs(travelled[near] - k * step) / step
        # places are kept but for sharper frames
        found.append(int(near[np.argmax(motion.sharpness[near] * (1.0 - off))]))
    # both sides of a gap, so that what follows is tied to what there is
    gaps = np.flatnonzero(motion.lost)
    keyframes = np.unique(np.concatenate((found, gaps, np.maximum(gaps - 1, 0)))).astype(np.int64)
    return _no_further_apart(keyframes, motion.time_s, chosen.most_apart_s)


def _no_further_apart(keyframes: Index, time_s: Float, most_s: float) -> Index:
    """Put frames between keyframes that are far apart in time: a camera that stood, or only turned."""
    between = []
    for a, b in zip(keyframes[:-1].tolist(), keyframes[1:].tolist(), strict=True):
        n = int((time_s[b] - time_s[a]) / most_s)
        between += [a + (b - a) * k // (n + 1) for k in range(1, n + 1)]
    return np.unique(np.concatenate((keyframes, np.array(between, dtype=np.int64))))


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """One frame."""

    index: int
    time_s: float
    #: At the working resolution.
    gray: Gray
    #: (height, width, 3) red, green, blue, as large as the video has it, where asked for.
    color: Gray | None


def read_frames(
    path: Path,
    indices: Sequence[int],
    width: int,
    *,
    color: bool = False,
    pts: Index | None = None,
    decoded: DecodedFrames | None = None,
) -> Iterator[VideoFrame]:
    """Yield the frames of ascending ``indices`` (counted over those that can be decoded), ``width // 2`` high.

    Parameters
    ----------
    path
        The file.
    indices
        Which frames.
    width
        Pixels of the brightness.
    color
        Whether frames have colours too.
    pts
        (F,) time stamps of all frames, ascending, where known: then many of the others need not be decoded. The frames
        are the same.
    decoded
        Frames that are in memory.

    Raises
    ------
    InputError
        Where there are not so many.
    """
    left = deque(int(k) for k in indices)

    def seen(frame: Any) -> VideoFrame:
        index = left.popleft()
        rgb = np.ascontiguousarray(frame.reformat(format="rgb24").to_ndarray()) if color else None
        return VideoFrame(index, float(index if frame.time is None else frame.time), _gray(frame, width), rgb)

    while decoded is not None and left and (known := decoded.pop(left[0])) is not None:
        yield seen(known)
    if pts is not None and left and left[-1] < len(pts):
        stamps = dict(zip(pts[list(left)].tolist(), left, strict=True))
        for frame in _frames(path, wanted=stamps):
            if frame.pts not in stamps:
                continue
            if stamps[frame.pts] != left[0]:
                break
            yield seen(frame)
            if not left:
                return
    # by counting, where there are no stamps, or they are not those of the packets
    for k, frame in enumerate(_frames(path) if left else ()):
        if k == left[0]:
            yield seen(frame)
            if not left:
                return
    if left:
        raise InputError(f"{path}: frame {left[0]} cannot be read any more; was the file changed?")
