"""A rendered walk through a street: panoramic frames with exact truth, as a video or as images.

The frames are those of COLMAP's ``EQUIRECTANGULAR`` camera, 8-bit RGB, made one at a time. World z is up, the ground is
``z = 0``; metres and seconds. ``render_walk(...)`` builds the street, ``walk.frames()`` films it.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError, MissingExtraError
from panopath.model import Float

Frame = npt.NDArray[np.uint8]
WalkPath = Literal["straight", "corner", "loop"]
WalkRotation = Literal["none", "sway", "tumble"]

#: Length of a lap of the path ``"loop"``, in metres, along the line about which the walk wavers.
LAP_M: float = _core.walk_lap_m()
#: Encoders of H.264 and its forerunner, the better one first.
_ENCODERS = ("libx264", "mpeg4")


@dataclass(frozen=True, eq=False)
class WalkTruth:
    """Where the camera is in each frame, how it is turned, and when; arrays are read-only."""

    #: Centres in the world, ``(n, 3)``, metres.
    centers: Float
    #: Orientations, ``(n, 3, 3)``.
    cam_from_world: Float
    #: Times, ``(n,)``, seconds.
    time_s: Float


@dataclass(frozen=True, eq=False)
class Walk:
    """A walk that can be filmed. Made by :func:`render_walk`."""

    #: Width and height of a frame.
    size_px: tuple[int, int]
    #: Frames in a second.
    frame_rate_hz: float
    #: The truth of all frames.
    truth: WalkTruth
    _rendered: _core.RenderedWalk

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.truth.time_s)

    def frame(self, index: int) -> Frame:
        """Render one frame.

        Parameters
        ----------
        index
            Which frame, from 0.

        Returns
        -------
        Frame
            ``(height, width, 3)``, RGB.

        Raises
        ------
        InputError
            Where there is no such frame.
        """
        return self._rendered.frame(self._check(index))

    def ranges(self, index: int) -> npt.NDArray[np.float32]:
        """Distance from the centre to what the middle of each pixel of a frame shows.

        Parameters
        ----------
        index
            Which frame, from 0.

        Returns
        -------
        ndarray
            ``(height, width)``, metres; infinite for the sky, NaN for the operator.

        Raises
        ------
        InputError
            Where there is no such frame.
        """
        return self._rendered.ranges(self._check(index))

    def frames(self) -> Iterator[Frame]:
        """Render all frames, one after the other; none is kept."""
        return (self.frame(index) for index in range(len(self)))

    def write_video(self, path: str | Path, *, crf: int = 20, report: Callable[[int], None] | None = None) -> Path:
        """Film the walk into a file.

        Parameters
        ----------
        path
            The file; its ending says which container (``.mp4``, ``.mkv``, ...).
        crf
            Quality of H.264, 0 (no loss) to 51; 20 is good. Where PyAV has no encoder for H.264, MPEG-4 is written with
            a quantiser of about the same effect.
        report
            Called with the number of frames done.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            For a ``crf`` out of range or a file that cannot be written.
        MissingExtraError
            Where PyAV is not installed.
        """
        if not 0 <= crf <= 51:
            raise InputError(f"crf is {crf}, expected a number from 0 to 51")
        av = _extra("av", "videos", "PyAV", "video")
        path = Path(path)
        try:
            with av.open(str(path), "w") as container:
                self._encode(av, container, crf, report)
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be written ({error})") from None
        return path

    def _encode(self, av: Any, container: Any, crf: int, report: Callable[[int], None] | None) -> None:
        name = next(name for name in _ENCODERS if name in av.codecs_available)
        stream = container.add_stream(name, rate=Fraction(self.frame_rate_hz).limit_denominator(1000))
        stream.width, stream.height = self.size_px
        stream.pix_fmt = "yuv420p"
        if name == "libx264":
            stream.options = {"crf": str(crf), "preset": "veryfast"}
        else:
            stream.codec_context.qmin = stream.codec_context.qmax = max(1, round(31 * crf / 51 / 3))
        for done, frame in enumerate(self.frames(), 1):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            if report is not None:
                report(done)
        container.mux(stream.encode(None))

    def write_images(self, folder: str | Path, *, every: int = 1, quality: int | None = 95) -> list[Path]:
        """Write frames as images ``frame_00000.jpg``, numbered as the truth is.

        Parameters
        ----------
        folder
            Made if it is not there.
        every
            Each how-manieth frame to write.
        quality
            Of JPEG, 1 to 95; None writes PNG, which loses nothing.

        Returns
        -------
        list[Path]
            The files, in order.

        Raises
        ------
        InputError
            For a number out of range or a folder that cannot be written.
        MissingExtraError
            Where Pillow is not installed.
        """
        if every < 1:
            raise InputError(f"every is {every}, expected a number of 1 or more")
        if quality is not None and not 1 <= quality <= 95:
            raise InputError(f"quality is {quality}, expected a number from 1 to 95, or None")
        image = _extra("PIL.Image", "images", "Pillow", "images")
        folder = Path(folder)
        paths = []
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for index in range(0, len(self), every):
                path = folder / f"frame_{index:05d}.{'png' if quality is None else 'jpg'}"
                options = {} if quality is None else {"quality": quality, "subsampling": 0}
                image.fromarray(self.frame(index)).save(path, **options)
                paths.append(path)
        except OSError as error:
            raise InputError(f"{folder}: cannot be written ({error})") from None
        return paths

    def _check(self, index: int) -> int:
        if not 0 <= index < len(self):
            raise InputError(f"index is {index}, expected a number from 0 to {len(self) - 1}")
        return index


def render_walk(
    *,
    width_px: int = 1280,
    n_frames: int = 264,
    frame_rate_hz: float = 10.0,
    speed_m_s: float = 1.4,
    path: WalkPath = "straight",
    rotation: WalkRotation = "sway",
    n_movers: int = 0,
    operator_share: float = 0.0,
    exposure_drift_stops: float = 0.0,
    noise_gray: float = 0.0,
    seed: int = 0,
) -> Walk:
    """Build a street and a walk through it; the same arguments give the same frames.

    Parameters
    ----------
    width_px
        Width of a frame, an even number; the height is half of it.
    n_frames, frame_rate_hz, speed_m_s
        How long, how often and how fast; the defaults are 37 m.
    path
        ``"straight"`` along a street, ``"corner"`` with a turn to the left half way, ``"loop"`` round a block, a lap in
        :data:`LAP_M` metres.
    rotation
        ``"none"``: upright, forward is the world's x throughout. ``"sway"``: forward along the path, swaying by a few
        degrees. ``"tumble"``: turning over slowly about all axes.
    n_movers
        Cars that pass by.
    operator_share
        Share of the sphere, about the camera's y axis, covered by the one who carries it.
    exposure_drift_stops
        From the darkest frame to the lightest, in factors of two of the light.
    noise_gray
        Standard deviation of the noise in steps of the 8-bit values.
    seed
        Seed of the city, of the wavering of the walk and of the noise.

    Returns
    -------
    Walk
        What can be filmed, with its truth.

    Raises
    ------
    InputError
        For an argument out of its range.
    """
    options: dict[str, Any] = dict(locals())
    try:
        rendered = _core.render_walk(options)
    except ValueError as error:
        raise InputError(str(error)) from None
    arrays = (rendered.centers, rendered.cam_from_world, rendered.time_s)
    for array in arrays:
        array.flags.writeable = False
    return Walk((width_px, width_px // 2), frame_rate_hz, WalkTruth(*arrays), rendered)


def _extra(module: str, what: str, package: str, extra: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingExtraError(
            f'{what} need {package}: install the extra with pip install "panopath[{extra}]"'
        ) from None
