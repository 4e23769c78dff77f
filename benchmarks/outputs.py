"""Crops of panoramas beside py360convert, and positions on the earth beside pycolmap: ``python -m benchmarks.outputs``.

The panorama is a pattern that is exact everywhere on the sphere, so that each crop can be compared with what it should
show; errors are in grey values of 255. Peers: py360convert 1.0 (``e2p``, bilinear) and pycolmap's ``GPSTransform``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
import numpy.typing as npt
from panopath.cameras import bearings_from_equirectangular
from panopath.formats.crops import CropOptions, _Cutter
from panopath.formats.geo import ecef_from_wgs84, wgs84_from_ecef
from panopath.model import Float

from benchmarks.optional import load

Picture = npt.NDArray[np.uint8]
#: Name of the crop of ours, and what the peer calls the same: degrees to the right and up.
ANGLES = {"front": (0, 0), "right": (90, 0), "back": (180, 0), "left": (-90, 0), "up": (0, 90), "down": (0, -90)}


def pattern(bearing: Float, waves: float) -> Float:
    """Grey values of directions: waves along three axes, without seam or pole."""
    return np.asarray(127.5 + 40.0 * np.sin(waves * bearing + (0.3, 1.1, 2.0)).sum(axis=-1, keepdims=True))


def panorama(width: int, waves: float) -> Picture:
    """Draw the pattern; each pixel is the mean over its area, 2 x 2 samples."""
    x, y = np.meshgrid((np.arange(2 * width) + 0.5) / 2, (np.arange(width) + 0.5) / 2)
    bearing = bearings_from_equirectangular(np.stack((x.ravel(), y.ravel()), axis=1), width, width / 2)
    fine = pattern(bearing, waves).reshape(width // 2, 2, width, 2).mean(axis=(1, 3))
    return np.repeat(fine[:, :, None], 3, axis=2).round().astype(np.uint8)


def should_be(rotation: Float, size: int, waves: float) -> Float:
    """Draw the same for a crop, 4 x 4 samples a pixel."""
    at = (np.arange(4 * size) + 0.5) / (2.0 * size) - 1.0
    x, y = np.meshgrid(at, at)
    ray = np.stack((x, y, np.ones_like(x)), axis=-1) @ rotation
    grey = pattern(ray / np.linalg.norm(ray, axis=-1, keepdims=True), waves)[..., 0]
    return np.asarray(grey.reshape(size, 4, size, 4).mean(axis=(1, 3)))


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--width", type=int, default=2048, help="of the panorama, pixels")
    parser.add_argument("--repeats", type=int, default=3)
    chosen = parser.parse_args()
    peer = load("py360convert")
    print(f"six faces of a {chosen.width} x {chosen.width // 2} panorama")
    print(f"{'face px':>8} {'':>14} {'rms error':>10} {'largest':>8} {'seconds':>8}")
    for share in (1.0, 0.25):
        size = int(share * CropOptions().size_for(chosen.width))
        # some twenty pixels of the crop a wave
        waves = size / 2.0 * 2.0 * np.pi / 20.0
        picture = panorama(chosen.width, waves)
        cutter = _Cutter(CropOptions(size_px=size), chosen.width, chosen.width // 2)
        truth = {name: should_be(rotation, size, waves) for name, rotation, _ in cutter.cut(picture)}

        def ours(cutter: Any = cutter, picture: Picture = picture) -> dict[str, Picture]:
            return {name: crop for name, _, crop in cutter.cut(picture)}

        def theirs(size: int = size, picture: Picture = picture) -> dict[str, Picture]:
            return {name: peer.e2p(picture, 90, *angle, (size, size)) for name, angle in ANGLES.items()}

        for who, cut in (("panopath", ours), ("py360convert", theirs)):
            seconds, crops = timed(cut, chosen.repeats)
            off = np.abs(np.stack([crops[name][:, :, 0] - truth[name] for name in ANGLES]))
            rms = float(np.sqrt((off**2).mean()))
            print(f"{size:>8} {who:>14} {rms:>10.2f} {off.max():>8.1f} {seconds:>8.3f}")
    places = np.random.default_rng(0).uniform((-90, -180, -1e3), (90, 180, 9e3), (200_000, 3))
    transform = load("pycolmap").GPSTransform()
    print("200,000 places to geocentric metres and back")
    print(f"{'':>14} {'largest return error':>22} {'seconds':>8}")
    for who, there, back in (
        ("panopath", ecef_from_wgs84, wgs84_from_ecef),
        ("pycolmap", transform.ellipsoid_to_ecef, transform.ecef_to_ellipsoid),
    ):

        def round_trip(there: Any = there, back: Any = back) -> Float:
            return np.asarray(back(there(places)))

        seconds, returned = timed(round_trip, chosen.repeats)
        off_m = np.abs(ecef_from_wgs84(returned) - ecef_from_wgs84(places)).max()
        print(f"{who:>14} {off_m:>20.2g} m {seconds:>8.3f}")


def timed(run: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Median time and the last answer."""
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        answer = run()
        seconds.append(time.perf_counter() - begin)
    return median(seconds), answer


if __name__ == "__main__":
    main()
