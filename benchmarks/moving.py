"""Bodies that move, with exact truth: ``python -m benchmarks.moving [--only NAME] [-o docs/benchmarks-moving.md]``.

Each section is measured apart and kept in the page as it stands, so that a long run can be done in pieces. Pedestrians
come from ``../shared/data``, planets from the extra ``astro``; where these are absent the section says so.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import nan, radians
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import panopath as pp
from panopath.errors import InputError
from panopath.model import Bool, Float
from panopath.paths import PathVerdict

from benchmarks.page import number, table
from benchmarks.pedestrians import MODELS, PLACES, observer_alone, read_crowd, rms, solve_crowd
from benchmarks.run import machine, versions

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data" / "eth_ucy_pedestrians"
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "examples")]

from moving_worlds import FORMS, moving_world  # noqa: E402

NOISE_RAD = radians(0.05)
SEEDS = range(5)
#: What is promised of the street.
CAMERA_LIMIT, FOUND_LIMIT, MISJUDGED_LIMIT, DEVIATION_LIMIT, SPEED_LIMIT = 1.1, 0.95, 0.01, 2.0, 4.0
#: Repeats of a measurement of time.
REPEATS = 3


# ------------------------------------------------------------------------------------------------------ exact data


def exact() -> str:
    """Error of everything on exact bearings of each form, mixed with points at rest."""
    rows = []
    for name, form in FORMS.items():
        for n_static, n_moving in ((6, 3), (1, 6)):
            errors = []
            for d in (2, 3):
                world = moving_world([form] * n_moving, d=d, n_static=n_static, n_views=40)
                control = pp.Control(views={i: row.tolist() for i, row in enumerate(world.centers)}, rotation=False)
                moving: dict[str | int, Any] = {
                    j: one for j, one in enumerate(world.paths.models) if j not in world.static
                }
                try:
                    scene = pp.solve_positions(
                        world.tracks,
                        options=pp.PositionOptions(gauge="control", control=control),
                        motion=pp.Motion(tracks=moving, static=world.static),
                    )
                except InputError:
                    errors += [nan, nan]
                    continue
                errors.append(float(np.abs(scene.centers - world.centers).max()))
                errors.append(max(_exact_path_errors(scene, world.paths, world.tracks)))
            cells = (number(error if np.isfinite(error) else None, "{:.1e}") for error in errors)
            rows.append((name, f"{n_static}, {n_moving}", *cells))
    text = (
        "Bodies of one form among points that are known to be at rest, 40 views in no order, no noise; the box of the "
        "world is 2 wide. Six points at rest fix the views by themselves, one leaves that to the bodies. The largest "
        "error of any view, and of any body at any sighting; a dash: not solved, or refused. Promised: 1e-8."
    )
    header = ("form", "at rest, moving", "views, plane", "bodies, plane", "views, space", "bodies, space")
    return f"## Exact data\n\n{text}\n\n{table(header, rows)}"


def _exact_path_errors(scene: pp.Scene, truth: pp.Paths, tracks: pp.Tracks) -> list[float]:
    assert scene.paths is not None
    assert tracks.time_s is not None
    errors = [0.0]
    for track in range(tracks.n_tracks):
        time_s = tracks.time_s[tracks.view[tracks.track == track]]
        off = np.abs(scene.paths.position(track, time_s, outside=True) - truth.position(track, time_s))
        errors.append(float("inf") if np.isnan(off).any() else float(off.max()))
    return errors


# ------------------------------------------------------------------------------------------------------- the street


def street_world(seed: int, n_views: int = 150, n_points: int = 6000, n_bodies: int = 40) -> pp.SyntheticWorld:
    """Simulate a street with cars and people: 30 % of the tracks, and a tenth of all bearings false."""
    return pp.simulate(
        "street",
        n_views=n_views,
        n_points=n_points,
        n_bodies=n_bodies,
        mover_fraction=0.3,
        noise_rad=NOISE_RAD,
        outlier_fraction=0.1,
        orientations="random",
        seed=seed,
    )


@dataclass(frozen=True, eq=False)
class Street:
    """What was found of one street."""

    camera_rms_m: float
    optimum_rms_m: float
    #: Of the movers: called moving, called at rest, nothing said.
    found: float
    called_static: float
    #: Of the tracks at rest: called anything that moves.
    misjudged: float
    #: Rms errors of the paths that were found, over their predicted deviations.
    over_predicted: Float
    #: And in metres.
    error_m: Float
    seconds: float


def solve_street(world: pp.SyntheticWorld) -> Street:
    """Solve a street by ``auto`` and compare with the truth, and with what the tracks at rest can give."""
    begin = time.perf_counter()
    scene = pp.solve_positions(world.tracks, world.cam_from_world, motion=pp.Motion())
    seconds = time.perf_counter() - begin
    at_rest = ~world.moving[world.tracks.track] & ~world.outlier
    start = (world.centers, world.points)
    best = pp.solve_positions(world.tracks.select(at_rest), world.cam_from_world, start=start)
    assert scene.paths is not None
    verdicts = np.array([str(one) for one in scene.paths.verdicts])
    moves = np.isin(verdicts, (PathVerdict.MOVING, PathVerdict.IMITATED, PathVerdict.HIDDEN))
    found = pp.evaluate(scene, world, "translation_scale")
    placed = scene.paths
    for one in found.alignments[:1]:
        placed = placed.transformed(one.scale, one.world_from_scene, one.shift)
    error_m, predicted_m = path_errors(placed, world, moves & world.moving)
    return Street(
        camera_rms_m=found.camera_rms,
        optimum_rms_m=pp.evaluate(best, world, "translation_scale").camera_rms,
        found=float(moves[world.moving].mean()),
        called_static=float((verdicts[world.moving] == PathVerdict.STATIC).mean()),
        misjudged=float(moves[~world.moving].mean()),
        over_predicted=error_m / predicted_m,
        error_m=error_m,
        seconds=seconds,
    )


def path_errors(paths: pp.Paths, world: pp.SyntheticWorld, chosen: Bool) -> tuple[Float, Float]:
    """Rms errors and predicted deviations of paths over their sightings; tracks without a path are left out."""
    errors, predicted = [], []
    times, order = world.time_s[world.tracks.view], np.argsort(world.tracks.track, kind="stable")
    ends = np.searchsorted(world.tracks.track[order], np.arange(world.tracks.n_tracks + 1))
    for track in np.flatnonzero(chosen).tolist():
        time_s = times[order[ends[track] : ends[track + 1]]]
        error = rms(paths.position(track, time_s, outside=True) - world.paths.position(track, time_s))
        covariance = nan if paths.covariances is None else paths.position_covariance(track, time_s)
        deviation = float(np.sqrt(np.mean(np.trace(np.asarray(covariance), axis1=1, axis2=2))))
        if np.isfinite(error) and np.isfinite(deviation):
            errors.append(error)
            predicted.append(deviation)
    return np.array(errors), np.array(predicted)


def street() -> str:
    """Cameras, movers and paths on several streets."""
    found = [solve_street(street_world(seed)) for seed in SEEDS]
    rows = []
    for seed, one in zip(SEEDS, found, strict=True):
        rows.append(
            (
                str(seed),
                f"{1000 * one.camera_rms_m:.2f} mm",
                f"{one.camera_rms_m / one.optimum_rms_m:.3f}",
                f"{100 * one.found:.1f} %",
                f"{100 * one.called_static:.1f} %",
                f"{100 * one.misjudged:.2f} %",
                f"{median(one.error_m):.2f} m" if len(one.error_m) else "-",
                f"{np.median(one.over_predicted):.2f}" if len(one.error_m) else "-",
                f"{100 * np.mean(one.over_predicted <= DEVIATION_LIMIT):.1f} %" if len(one.error_m) else "-",
                f"{one.seconds:.2f} s",
            )
        )
    worst = max(one.camera_rms_m / one.optimum_rms_m for one in found)
    verdicts = (
        met(f"cameras <= {CAMERA_LIMIT:g} x optimum", worst <= CAMERA_LIMIT),
        met(f">= {100 * FOUND_LIMIT:g} % of the movers", min(one.found for one in found) >= FOUND_LIMIT),
        met(
            f"<= {100 * MISJUDGED_LIMIT:g} % of the rest misjudged",
            max(one.misjudged for one in found) <= MISJUDGED_LIMIT,
        ),
        met(
            f"median path within {DEVIATION_LIMIT:g} predicted deviations",
            max(float(np.median(one.over_predicted)) if len(one.error_m) else nan for one in found) <= DEVIATION_LIMIT,
        ),
    )
    text = (
        "150 views, 6000 tracks, 30 % of them on 40 cars and people, 0.05 deg of noise, 10 % of all bearings false; "
        "nothing is said of any track (`Motion()`). Optimum: the tracks that are really at rest, true bearings only, "
        "started from the truth. A mover counts as found where its verdict is moving, imitated or hidden. Paths: rms "
        "over the sightings of a track, beside the deviation predicted for it."
    )
    header = (
        "seed",
        "camera rms",
        "/ optimum",
        "movers found",
        "called static",
        "rest misjudged",
        "path error, median",
        "/ predicted, median",
        "within 2",
        "time",
    )
    return f"## Street with cars and people\n\n{text}\n\n{table(header, rows)}\n\n" + "; ".join(verdicts) + "."


def speed() -> str:
    """Time of the largest street, beside the solve that takes everything to be at rest."""
    world = street_world(0, n_views=1000, n_points=100_000, n_bodies=300)
    rows = []
    at_rest = world.tracks.select(~world.moving[world.tracks.track])
    runs: dict[str, Callable[[], pp.Scene]] = {
        "what is at rest, alone": lambda: pp.solve_positions(at_rest, world.cam_from_world),
        "everything at rest": lambda: pp.solve_positions(world.tracks, world.cam_from_world),
        "`auto`": lambda: pp.solve_positions(world.tracks, world.cam_from_world, motion=pp.Motion(covariance=False)),
        "`auto`, with covariances": lambda: pp.solve_positions(world.tracks, world.cam_from_world, motion=pp.Motion()),
    }
    wall: dict[str, list[tuple[float, float]]] = {name: [] for name in runs}
    for _ in range(REPEATS):
        for name, run in runs.items():
            begin = (time.perf_counter(), time.process_time())
            scene = run()
            wall[name].append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
            assert scene.summary.n_solved_views == 1000
    seconds = {name: median(one[0] for one in measured) for name, measured in wall.items()}
    for name, measured in wall.items():
        ratio = seconds[name] / seconds["everything at rest"]
        cpu = median(one[1] for one in measured)
        rows.append((name, f"{seconds[name]:.2f} s", f"{cpu:.2f} s", f"{ratio:.2f}"))
    ratio = seconds["`auto`"] / seconds["everything at rest"]
    text = (
        f"1000 views, 100,000 tracks ({len(world.tracks):,} bearings), 30 % of them on 300 cars and people, noise and "
        f"false bearings as above; median of {REPEATS} runs in turns."
    )
    verdict = met(f"<= {SPEED_LIMIT:g} x the static solve", ratio <= SPEED_LIMIT)
    return f"## Speed\n\n{text}\n\n{table(('solve', 'time', 'processor', 'ratio'), rows)}\n\n{verdict}."


# ------------------------------------------------------------------------------------------------ people and planets


def pedestrians() -> str:
    """Path errors of real pedestrians by model."""
    title = "## Pedestrians"
    if not DATA.is_dir():
        return f"{title}\n\nSkipped: eth_ucy_pedestrians is absent from ../shared/data."
    rows = []
    for place, first in PLACES.items():
        crowd = read_crowd(DATA / f"{place}.txt", first)
        rows.append((place, "landmarks alone", *["-"] * 5, f"{1000 * observer_alone(crowd):.1f} mm"))
        for model in MODELS:
            found = solve_crowd(crowd, model)
            solved = np.isfinite(found.error_m)
            rows.append(
                (
                    place,
                    model,
                    f"{int(solved.sum())} of {len(solved)}",
                    *(number(_quantile(found.error_m, q), "{:.2f} m") for q in (0.5, 0.9)),
                    number(_quantile(found.misfit_m, 0.5), "{:.2f} m"),
                    number(_quantile(found.predicted_m, 0.5), "{:.2f} m"),
                    f"{1000 * found.camera_rms_m:.1f} mm",
                )
            )
    text = (
        "Paths of the ETH and UCY sets, 150 frames (60 s) each, in the plane. An observer goes round the place in "
        "20 s and sways as he goes, about 1.6 m/s, and takes the bearings of everyone, to 0.2 deg, and of 12 landmarks "
        "whose places are known. Error: rms over the sightings of a pedestrian, whoever was seen ten times or more. "
        "Misfit: of the best path of that form to the true places. Predicted: of the noise alone. A bearing tells of "
        "the direction only: each function more in a path fits the steps of a walk better, and is worse known."
    )
    header = ("place", "model", "paths", "error, median", "90 % below", "misfit", "predicted", "observer")
    return f"{title}\n\n{text}\n\n{table(header, rows)}"


def _quantile(values: Float, share: float) -> float | None:
    """Quantile of the values that there are."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if len(known) else None


def planets() -> str:
    """Semi-major axes from directions of 30 years."""
    title = "## Planets"
    if importlib.util.find_spec("erfa") is None:
        return f'{title}\n\nSkipped: the ephemeris needs pyerfa (pip install "panopath[astro]").'
    program: Any = importlib.import_module("planets")
    rows = []
    for label, noise_rad in (("exact", 0.0), ("an arc minute off", program.NOISE_RAD)):
        tracks, earth = program.observe(noise_rad)
        unit = program.semi_major(earth)
        for how, known in (("given", True), ("found", False)):
            begin = time.perf_counter()
            try:
                system = program.placed(program.solve(tracks, periods_known=known), tracks)
            except InputError as error:
                rows.append((label, how, *["-"] * 6, str(error)))
                continue
            seconds = time.perf_counter() - begin
            ratios = [100.0 * (system.axis(name) / planet.axis - 1.0) for name, planet in program.PLANETS.items()]
            off = 100.0 * rms(system.earth - earth / unit)
            rows.append((label, how, *(f"{one:+.3f} %" for one in ratios), f"{off:.3f} %", f"{seconds:.1f} s"))
    header = ("directions", "periods", *program.PLANETS, "Earth's path, rms", "time")
    text = (
        "Directions of the Sun and five planets, 400 times in 30 years; see [Planets](planets.md). Errors of the "
        "semi-major axes, in that of the Earth, against the mean elements of Simon et al. (1994)."
    )
    return f"{title}\n\n{text}\n\n{table(header, rows)}"


# --------------------------------------------------------------------------------------------------------- the page

SECTIONS: dict[str, Callable[[], str]] = {
    "exact": exact,
    "street": street,
    "speed": speed,
    "pedestrians": pedestrians,
    "planets": planets,
}


def met(text: str, holds: bool) -> str:
    """Say whether a promise is kept."""
    return f"{text}: {'met' if holds else '**missed**'}"


def page(sections: dict[str, str]) -> str:
    """Put the page together from its sections."""
    about = machine()
    found = ", ".join(f"{package} {version}" for package, version in list(versions().items())[:4])
    head = (
        "# Benchmarks: bodies that move\n\n"
        "Written by `python -m benchmarks.moving`; do not edit.\n\n"
        f"{datetime.now(UTC).strftime('%Y-%m-%d')}, {about['cpu']}, {about['cores']} cores; {found}"
    )
    marked = [f"<!-- {name} -->\n{sections[name]}\n<!-- end -->" for name in SECTIONS if name in sections]
    return "\n\n".join([head, *marked]) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the page; sections that were not asked for are kept as they stand."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.moving", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(SECTIONS), help="renew this section alone")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/benchmarks-moving.md"))
    chosen = parser.parse_args(arguments)
    output: Path = chosen.output
    text = output.read_text(encoding="utf-8") if output.exists() else ""
    standing = dict(re.findall(r"^<!-- (\w+) -->\n(.*?)\n<!-- end -->", text, re.MULTILINE | re.DOTALL))
    for name in chosen.only or SECTIONS:
        print(f"{name} ...", flush=True)
        standing[name] = SECTIONS[name]()
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(page(standing), encoding="utf-8")
    print(f"wrote {output}")


if __name__ == "__main__":
    main()
