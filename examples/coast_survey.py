"""A coast drawn from a ship: compass bearings to marks ashore, and nothing else.

Before satellites, a survey ship took the compass bearings of the marks it could see, sailed on, and took them again;
the chart came from the bearings alone. Here 24 stations see 24 marks with a good compass (0.1 degrees), and 2 bearings
are misread. The bearings fix the chart up to its place and scale; two marks that were surveyed on land fix those. How
well each mark is known is an ellipse, and the errors are what the ellipses say.

Run: ``python examples/coast_survey.py [CHART.png]``; the chart needs matplotlib.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import panopath as pp
from panopath.cameras import compass_from_bearings

NOISE_DEG = 0.1
#: Errors of reading, by station and mark (counted from 0).
MISREAD_DEG = {(1, 4): 14.0, (5, 14): -30.0}


def survey(seed: int = 7) -> tuple[pp.Tracks, npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Bearings of marks from stations, with the true stations and marks in metres (x east, y north)."""
    rng = np.random.default_rng(seed)
    along_m = np.linspace(0.0, 9000.0, 24)
    marks_m = np.stack((along_m, 2500.0 + 900.0 * np.sin(along_m / 1300.0) + rng.normal(0.0, 250.0, 24)), axis=1)
    sailed_m = np.linspace(300.0, 8700.0, 24)
    stations_m = np.stack((sailed_m, 400.0 * np.sin(sailed_m / 900.0)), axis=1)

    between = marks_m[None, :, :] - stations_m[:, None, :]
    station, mark = np.nonzero(np.linalg.norm(between, axis=2) < 6000.0)
    east, north = between[station, mark].T
    compass_deg = np.degrees(np.arctan2(east, north)) + rng.normal(0.0, NOISE_DEG, len(station))
    for (i, j), error_deg in MISREAD_DEG.items():
        compass_deg[(station == i) & (mark == j)] += error_deg
    tracks = pp.read_tracks(
        {
            "view": [f"station {i + 1}" for i in station],
            "track": [f"mark {j + 1}" for j in mark],
            "azimuth_deg": compass_deg % 360.0,
        }
    )
    return tracks, stations_m, marks_m


def chart(tracks: pp.Tracks, known_m: Mapping[str | int, Sequence[float]]) -> tuple[pp.Scene, pp.SceneCovariance]:
    """Solve, put the chart onto the known marks, and adjust it with these held: positions and covariances in metres."""
    control = pp.Control(points=known_m, rotation=False)
    scene = pp.solve_positions(tracks, options=pp.PositionOptions(gauge="control", control=control))
    labels = list(tracks.track_labels())
    held = np.isin(labels, list(known_m))
    points = scene.points.copy()
    points[held] = [known_m[label] for label in labels if label in known_m]
    options = pp.RefineOptions(hold_rotations=True, hold_points=held)  # the compass is right, and so are these marks
    scene = pp.refine(tracks, replace(scene, points=points), options)
    return scene, pp.scene_covariance(tracks, scene, options)


def half_axes(covariance: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Half axes of the ellipse that holds the truth with 95 % (chi-square of two: 5.99), and where they point."""
    variance, axes = np.linalg.eigh(covariance)
    return np.sqrt(5.991 * np.maximum(variance, 0.0)), axes


def main() -> None:
    tracks, stations_m, marks_m = survey()
    marks_m = marks_m[[int(name.split()[1]) - 1 for name in tracks.track_labels()]]
    stations_m = stations_m[[int(name.split()[1]) - 1 for name in tracks.view_labels()]]
    truth = dict(zip(tracks.track_labels(), marks_m, strict=True))
    scene, covariance = chart(tracks, {name: truth[name].tolist() for name in ("mark 3", "mark 21")})

    print(f"{tracks!r}: {scene.summary.status.value}")
    print(f"accuracy of a bearing, found from the bearings alone: {np.degrees(scene.summary.sigma_rad):.2f} deg")
    for o in np.flatnonzero(~scene.inlier):
        view, mark = tracks.view_labels()[tracks.view[o]], tracks.track_labels()[tracks.track[o]]
        azimuth_deg = np.degrees(compass_from_bearings(tracks.bearing[o : o + 1])[0])
        print(f"set aside: {view} to {mark}, {azimuth_deg:.1f} deg, off by {np.degrees(scene.residual_rad[o]):.1f} deg")

    print("mark       error   ellipse (95 %)")
    inside, free = 0, 0
    for name, point, true, ellipse in zip(tracks.track_labels(), scene.points, marks_m, covariance.points, strict=True):
        axes_m, _ = half_axes(ellipse)
        if axes_m[1] == 0.0:
            continue  # held
        error = true - point
        free += 1
        inside += bool(error @ np.linalg.solve(ellipse, error) < 5.991)
        print(f"{name:<8s} {np.linalg.norm(error):5.1f} m   {axes_m[1]:4.1f} by {axes_m[0]:4.1f} m")
    print(f"{inside} of {free} marks lie within their ellipses")
    error_m = np.linalg.norm(scene.points - marks_m, axis=1)
    print(f"marks: median error {np.median(error_m):.1f} m, largest {error_m.max():.1f} m")
    station_error_m = np.linalg.norm(scene.centers - stations_m, axis=1)
    print(f"stations: median error {np.median(station_error_m):.1f} m, largest {station_error_m.max():.1f} m")

    without = pp.solve_positions(tracks, options=pp.PositionOptions(gauge="paper"))
    print("without known marks, in the paper's gauge (first mark at the origin, second at x = 1 or -1):")
    for label, point in list(zip(tracks.track_labels(), without.points, strict=True))[:4]:
        print(f"  {label:<8s} {point[0]:9.4f} {point[1]:9.4f}")
    if len(sys.argv) > 1:
        draw(Path(sys.argv[1]), scene, covariance)


def draw(path: Path, scene: pp.Scene, covariance: pp.SceneCovariance, enlarged: float = 20.0) -> None:
    """Draw stations and marks, each with its ellipse, so many times enlarged."""
    figure = importlib.import_module("matplotlib.figure").Figure(figsize=(9.0, 4.2), layout="constrained")
    ellipses = importlib.import_module("matplotlib.patches").Ellipse
    panel = figure.subplots()
    kinds = (
        ("stations", scene.centers, covariance.cameras[:, 1:, 1:], "#1f5fa8", "s"),
        ("marks", scene.points, covariance.points, "#c2571a", "^"),
    )
    for name, places, covariances, colour, marker in kinds:
        panel.plot(*places.T / 1e3, marker, color=colour, markersize=4, label=name)
        for place, one in zip(places / 1e3, covariances, strict=True):
            (minor, major), axes = half_axes(one)
            turn_deg = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
            size = 2.0 * enlarged * major / 1e3, 2.0 * enlarged * minor / 1e3
            panel.add_patch(ellipses(place, *size, angle=turn_deg, fill=False, edgecolor=colour, linewidth=0.9))
    panel.set(
        xlabel="east, km", ylabel="north, km", aspect="equal", title=f"95 % ellipses, enlarged {enlarged:.0f} times"
    )
    panel.legend(frameon=False)
    figure.savefig(path, dpi=130, metadata={"Software": None})


if __name__ == "__main__":
    main()
