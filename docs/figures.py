"""Draw the picture of README: ``make docs-figures``.

On the left what one view of the demo's street saw, on the right what the bearings of all views give.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
from matplotlib.figure import Figure

Float = npt.NDArray[np.float64]

VIEW = 30
POINT, PATH, TRUTH, WRONG = "#1f5fa8", "#111111", "#f0a020", "#d62728"


def main() -> None:
    world = pp.simulate(
        "street", n_views=100, n_points=10_000, seed=1, noise_rad=np.radians(0.05), outlier_fraction=0.2
    )
    scene = pp.solve_positions(world.tracks)
    result = pp.evaluate(scene, world, "translation_scale")
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    panorama, map_from_above = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    draw_panorama(panorama, world.tracks, scene.inlier)
    draw_map(map_from_above, world.centers, result.aligned_centers, result.aligned_points, result.camera_rms)
    path = Path(__file__).parent / "img" / "demo.png"
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def draw_panorama(panel: Any, tracks: pp.Tracks, inlier: npt.NDArray[np.bool_]) -> None:
    seen = tracks.view == VIEW
    x, y, z = tracks.bearing[seen].T
    azimuth_deg, elevation_deg = np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z))
    kept = inlier[seen]
    panel.plot(azimuth_deg[kept], elevation_deg[kept], ".", color=POINT, markersize=4, label="bearing")
    panel.plot(azimuth_deg[~kept], elevation_deg[~kept], "x", color=WRONG, markersize=4, label="found to be wrong")
    panel.set(xlim=(-180, 180), ylim=(-90, 90), xlabel="azimuth (degrees)", ylabel="elevation (degrees)")
    panel.set(xticks=range(-180, 181, 60), yticks=range(-90, 91, 30), aspect="equal")
    panel.set_title(f"In: what each of 100 views saw (here number {VIEW})")
    panel.legend(loc="lower right", fontsize=8)


def draw_map(panel: Any, truth: Float, centers: Float, points: Float, rms_m: float) -> None:
    half = 2.2 * float(np.abs(centers[:, :2] - centers[:, :2].mean(axis=0)).max())
    middle = centers[:, :2].mean(axis=0)
    panel.plot(points[:, 0], points[:, 1], ".", color=POINT, markersize=1.6, markeredgewidth=0, label="points")
    panel.plot(truth[:, 0], truth[:, 1], "-", color=TRUTH, linewidth=4, label="true path")
    panel.plot(centers[:, 0], centers[:, 1], ".-", color=PATH, markersize=3, linewidth=0.8, label="cameras found")
    panel.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half), aspect="equal")
    panel.set(xlabel="x (m)", ylabel="y (m)")
    panel.set_title(f"Out: path and points ({1e3 * rms_m:.0f} mm rms from the truth)")
    legend = panel.legend(loc="lower right", fontsize=8)
    legend.legend_handles[0].set_markersize(5.0)


if __name__ == "__main__":
    main()
