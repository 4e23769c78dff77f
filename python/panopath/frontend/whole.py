"""Do pictures that are twice as wide as high show the whole sphere? Raw fisheyes and wide film may have that shape too.

A whole panorama meets itself at its left and right edges, and its topmost row is one point. Two fisheyes side by side
are black outside their circles. Single pictures may break any of this, so several are asked, and it is asked only where
a scene was not found: the answer explains, it refuses nothing.
"""

from __future__ import annotations

import numpy as np

from panopath.errors import InputError
from panopath.frontend.extras import opencv
from panopath.frontend.images import Gray, read_image
from panopath.frontend.sources import Source, SourceKind
from panopath.frontend.video import read_frames
from panopath.model import Float

_WIDTH, _HEIGHT = 256, 128
#: Pictures asked, and frames between those of a video.
_ASKED, _APART = 5, 6
#: The step over the seam is no larger than so many times that of nearly all neighbouring columns (real panoramas: 1.1).
_SEAM = 1.5
#: Standard deviation of the topmost row: at least, and as a share of that of the middle one.
_TOP, _TOP_SHARE = 12.0, 0.3
#: Brightness outside the circles of two fisheyes, and within them.
_OUTSIDE, _WITHIN = 12.0, 24.0


def why_not_whole(source: Source) -> str:
    """Say why the pictures of a panoramic source seem to be none; empty where they do not."""
    if not source.is_panoramic:
        return ""
    try:
        small = [_small(picture) for picture in _some(source)]
    except InputError:
        return ""
    if not small:
        return ""
    if np.median([_is_black_outside(g) for g in small]) > 0.5:
        return "the pictures look like two fisheyes side by side: have the camera's program stitch them first"
    if np.median([_seam(g) for g in small]) > _SEAM and np.median([_top(g) for g in small]) > 1.0:
        return (
            "the pictures do not meet at their left and right edges as those of a 360 camera do: of a common camera, "
            "give a folder of frames with its intrinsics"
        )
    return ""


def _some(source: Source) -> list[Gray]:
    if source.kind is SourceKind.VIDEO:
        n = source.video.n_frames if source.video is not None and source.video.n_frames else _ASKED * _APART
        frames = range(0, min(n, _ASKED * _APART), _APART)
        return [frame.gray for frame in read_frames(source.path, list(frames), _WIDTH)]
    every = max(1, len(source.images) // _ASKED)
    return [read_image(path, _WIDTH) for path in source.images[::every][:_ASKED]]


def _small(picture: Gray) -> Float:
    cv2 = opencv()
    return np.asarray(cv2.resize(picture, (_WIDTH, _HEIGHT), interpolation=cv2.INTER_AREA), dtype=np.float64)


def _seam(g: Float) -> float:
    """Step over the seam, as a share of what steps from column to column are at most."""
    rows = g[_HEIGHT // 5 : -_HEIGHT // 5]
    steps = np.abs(np.roll(rows, -1, axis=1) - rows).mean(axis=0)
    return float(steps[-1] / max(np.quantile(steps[:-1], 0.9), 1.0))


def _top(g: Float) -> float:
    """How much the topmost row varies, as a share of what is too much."""
    return float(g[0].std() / max(_TOP, _TOP_SHARE * g[_HEIGHT // 2].std()))


def _is_black_outside(g: Float) -> bool:
    at = (np.arange(_HEIGHT) + 0.5) * 2.0 / _HEIGHT - 1.0
    outside = np.hypot(at[:, None], at[None, :]) > 1.05
    both = np.stack((g[:, :_HEIGHT], g[:, _HEIGHT:]))
    return bool(np.quantile(both[:, outside], 0.95) < _OUTSIDE and both[:, ~outside].mean() > _WITHIN)
