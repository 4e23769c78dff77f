"""A coast drawn from a ship: compass bearings to marks ashore, and nothing else.

Before satellites, a survey ship took the compass bearings of the marks it could see, sailed on, and took them again;
the chart came from the bearings alone. Here 24 stations see 24 marks with a good compass (0.1 degrees), and 2 bearings
are misread. The bearings fix the chart up to its place and scale; two marks that were surveyed on land fix those.

Run: ``python examples/coast_survey.py``
"""

from __future__ import annotations

from collections.abc import Sequence

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


def main() -> None:
    tracks, stations_m, marks_m = survey()
    truth = {name: marks_m[int(name.split()[1]) - 1] for name in tracks.track_labels()}
    known: dict[str | int, Sequence[float]] = {name: truth[name].tolist() for name in ("mark 3", "mark 21")}
    control = pp.Control(points=known, rotation=False)
    scene = pp.solve_positions(tracks, options=pp.PositionOptions(gauge="control", control=control))

    print(f"{tracks!r}: {scene.summary.status.value}")
    print(f"accuracy of a bearing, found from the bearings alone: {np.degrees(scene.summary.sigma_rad):.2f} deg")
    for o in np.flatnonzero(~scene.inlier):
        view, mark = tracks.view_labels()[tracks.view[o]], tracks.track_labels()[tracks.track[o]]
        azimuth_deg = np.degrees(compass_from_bearings(tracks.bearing[o : o + 1])[0])
        print(f"set aside: {view} to {mark}, {azimuth_deg:.1f} deg, off by {np.degrees(scene.residual_rad[o]):.1f} deg")

    error_m = np.linalg.norm(scene.points - np.array([truth[name] for name in tracks.track_labels()]), axis=1)
    print(f"marks: median error {np.median(error_m):.1f} m, largest {error_m.max():.1f} m")
    order = [int(name.split()[1]) - 1 for name in tracks.view_labels()]
    station_error_m = np.linalg.norm(scene.centers - stations_m[order], axis=1)
    print(f"stations: median error {np.median(station_error_m):.1f} m, largest {station_error_m.max():.1f} m")

    chart = pp.solve_positions(tracks, options=pp.PositionOptions(gauge="paper"))
    print("without control, in the paper's gauge (first mark at the origin, second at x = 1 or -1):")
    for label, point in list(zip(tracks.track_labels(), chart.points, strict=True))[:4]:
        print(f"  {label:<8s} {point[0]:9.4f} {point[1]:9.4f}")


if __name__ == "__main__":
    main()
