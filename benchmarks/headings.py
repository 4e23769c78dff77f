"""Planar headings from nothing: ``find_headings`` beside mean motion and a least-squares fit from random starts.

``python -m benchmarks.headings`` prints, for simulated worlds and the measured landmark logs, how many views are
oriented (largest component), the errors of their headings after the best common turn, and the seconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
from panopath.model import Float

from benchmarks.optional import load
from benchmarks.planar_sets import PlanarSet, read_mrclam, read_roh

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "planar_bearings"
NOISE_RAD = np.radians(0.5)
REPEATS = 3
WORLDS: dict[str, dict[str, Any]] = {
    "box": {"n_views": 20, "n_points": 60},
    "street": {"n_views": 100, "n_points": 1500},
    "room": {"n_views": 60, "n_points": 600},
    "chain": {"n_views": 100, "n_points": 1500},
    "corridor": {"n_views": 60, "n_points": 600},
}
#: Random starts of the least-squares fit, and worlds small enough for it.
STARTS = 10
SMALL = ("box",)


def main() -> None:
    print("| data | method | views oriented | median (deg) | p90 (deg) | largest (deg) | seconds |")
    print("|---|---|---|---|---|---|---|")
    for name, size in WORLDS.items():
        world = pp.simulate(
            name, dimension=2, orientations="random", seed=1, noise_rad=NOISE_RAD, outlier_fraction=0.1, **size
        )
        what = f"{name}, 0.5 deg, 10 % false"
        report(what, "find_headings", world.tracks, world.cam_from_world, triplets)
        report(what, "mean motion", world.tracks, world.cam_from_world, chained)
        if name in SMALL:
            report(what, f"least squares, {STARTS} random starts", world.tracks, world.cam_from_world, fitted)
    if not DATA.exists():
        print("(../shared/data/planar_bearings is absent)")
        return
    for data, least in [(read_roh(DATA / "dataset_roh").mean(), 4)] + [
        (read_mrclam(DATA / "dataset_mrclam" / f"mrclam{k}.mat"), least) for k in (1, 2, 4, 6, 9) for least in (4, 3)
    ]:
        tracks = planar_tracks(data)
        solve = partial(triplets, options=pp.HeadingOptions(min_points=least))
        report(data.name, f"find_headings, min_points={least}", tracks, data.heading_rad, solve)
        if least == 4:
            report(data.name, "mean motion", tracks, data.heading_rad, chained)


Answer = tuple[Float, Float]


def report(data: str, method: str, tracks: pp.Tracks, truth: Float, solve: Callable[[pp.Tracks], Answer]) -> None:
    seconds = []
    for _ in range(REPEATS):
        clock = time.perf_counter()
        heading, component = solve(tracks)
        seconds.append(time.perf_counter() - clock)
    member = component == 0
    cells = " | | |"
    if member.any():
        turn = np.exp(1j * (heading[member] - truth[member]))
        # the common turn by the median, so that a few wrong headings do not tilt all others
        turn = turn / turn.mean()
        off = np.degrees(np.abs(np.angle(turn * np.exp(-1j * np.median(np.angle(turn))))))
        cells = f" {np.median(off):.2f} | {np.percentile(off, 90):.2f} | {off.max():.1f} |"
    print(f"| {data} | {method} | {member.sum()} of {len(truth)} |{cells} {np.median(seconds):.2f} |", flush=True)


def triplets(tracks: pp.Tracks, options: pp.HeadingOptions | None = None) -> Answer:
    found = pp.find_headings(tracks, options)
    return found.heading_rad, found.view_component.astype(np.float64)


def chained(tracks: pp.Tracks) -> Answer:
    found = pp.mean_motion(tracks)
    return found.cam_from_world, found.view_component.astype(np.float64)


def fitted(tracks: pp.Tracks) -> Answer:
    """Fit headings, centres and points at once by scipy's robust least squares, from random starts; the best of all."""
    optimize = load("scipy.optimize")
    n, m = tracks.n_views, tracks.n_tracks
    angle = np.arctan2(tracks.bearing[:, 1], tracks.bearing[:, 0])

    def miss(x: Float) -> Float:
        center, heading, point = x[: 2 * n].reshape(n, 2), x[2 * n : 3 * n], x[3 * n :].reshape(m, 2)
        away = point[tracks.track] - center[tracks.view]
        return np.asarray(np.angle(np.exp(1j * (np.arctan2(away[:, 1], away[:, 0]) - heading[tracks.view] - angle))))

    sparsity = load("scipy.sparse").lil_matrix((len(tracks), 3 * n + 2 * m), dtype=int)
    rows = np.arange(len(tracks))
    for column in (2 * tracks.view, 2 * tracks.view + 1, 2 * n + tracks.view):
        sparsity[rows, column] = 1
    for column in (3 * n + 2 * tracks.track, 3 * n + 2 * tracks.track + 1):
        sparsity[rows, column] = 1
    rng = np.random.default_rng(0)
    best: Any = None
    for _ in range(STARTS):
        start = np.concatenate([rng.normal(size=2 * n), rng.uniform(-np.pi, np.pi, n), 2.0 * rng.normal(size=2 * m)])
        found = optimize.least_squares(
            miss, start, jac_sparsity=sparsity, loss="soft_l1", f_scale=2.0 * NOISE_RAD, max_nfev=60
        )
        best = found if best is None or found.cost < best.cost else best
    return np.asarray(best.x[2 * n : 3 * n]), np.zeros(n)


def planar_tracks(data: PlanarSet) -> pp.Tracks:
    bearing = np.column_stack([np.cos(data.bearing_rad), np.sin(data.bearing_rad)])
    return pp.Tracks.from_arrays(
        data.station, data.landmark, bearing, n_views=len(data.stations), n_tracks=len(data.landmarks)
    )


if __name__ == "__main__":
    main()
