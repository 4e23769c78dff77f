"""``panopath map`` against COLMAP's global mapper: ``python -m benchmarks.mapping [--cases NAME ...] [--repeats R]``.

Both start from the same database of verified matches and end with models on disk; both are scored by the same
function. Each run is a fresh process that times its own work: ours ``read_database``, ``map_database`` and
``write_models``, the peer ``pycolmap.global_mapping``. Loading the libraries is not counted in either. Intrinsics are
held in both: ours takes them as they are, so the peer's refinement of them is switched off.

A few slow bends of the path rule the error of a walk, so that single worlds say little: two estimators that are equally
good differ by a third on one of them. ``--seeds`` measures several worlds of each case and compares their means.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from statistics import mean, median
from typing import Any

from panopath.formats import read_database, write_models
from panopath.mapping import map_database

from benchmarks.databases import Score, Spec, describe, make_database, run_peer, score_models

CASES: dict[str, Spec] = {
    "panoramas 100": Spec("EQUIRECTANGULAR", 100, 20000),
    "panoramas 100, 10% wrong": Spec("EQUIRECTANGULAR", 100, 20000, wrong_verified=0.1),
    "panoramas 100, 30% wrong": Spec("EQUIRECTANGULAR", 100, 20000, wrong_verified=0.3),
    "panoramas 300, 10% wrong": Spec("EQUIRECTANGULAR", 300, 60000, wrong_verified=0.1),
    "panoramas 500, 10% wrong": Spec("EQUIRECTANGULAR", 500, 100000, wrong_verified=0.1),
    "pinhole 100": Spec("PINHOLE", 100, 60000),
    "pinhole 300, 20% wrong": Spec("PINHOLE", 300, 180000, wrong_verified=0.2),
    "rig of 4, 50 places": Spec("rig", 50, 15000),
}
TIME_LIMIT_S = 1800.0


@dataclass(frozen=True)
class Row:
    """Both mappers on one database."""

    case: str
    seed: int
    #: Features, matches and pairs.
    sizes: str
    #: None where a mapper gave no model; the reason is in ``note``.
    ours: Score | None
    peer: Score | None
    #: Medians over the repeats; NaN where there is no answer.
    ours_s: float
    peer_s: float
    note: str = ""

    @property
    def speedup(self) -> float:
        """How many times as long the peer took."""
        return self.peer_s / self.ours_s

    @property
    def error_ratio(self) -> float:
        """Our median error of a centre over the peer's."""
        return math.nan if self.ours is None or self.peer is None else self.ours.median_m / self.peer.median_m


def map_once(database: Path, folder: Path) -> float:
    """Read, map and write in this process; the seconds it took."""
    began = time.perf_counter()
    found = read_database(database)
    mapped = map_database(found)
    write_models(found, mapped.reconstruction, folder)
    return time.perf_counter() - began


def run_ours(database: Path, folder: Path, time_limit_s: float = TIME_LIMIT_S) -> dict[str, Any]:
    """Run :func:`map_once` in a fresh process: ``{"seconds": ...}``, or ``{"error": text}``."""
    command = [sys.executable, "-m", "benchmarks.mapping", "--ours", str(database), str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=time_limit_s, check=False)
    except subprocess.TimeoutExpired:
        return {"error": f"stopped after {time_limit_s:.0f} s"}
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return {"error": f"exit code {done.returncode}: {last[:200]}"}
    return dict(json.loads(done.stdout))


def measure(names: Sequence[str] | None = None, repeats: int = 3, seeds: int = 1) -> Iterator[Row]:
    """Run both on each case in turn, one after the other in every repeat.

    Parameters
    ----------
    names
        Keys of ``CASES``; default: all.
    repeats
        Runs of each mapper; times are medians, models are scored once, since they do not differ.
    seeds
        Worlds of each case; every one is a row.
    """
    for name, seed in product(CASES if names is None else names, range(seeds)):
        with tempfile.TemporaryDirectory() as scratch:
            database = Path(scratch) / "database.db"
            truth = make_database(replace(CASES[name], seed=seed), database)
            folders = [(Path(scratch) / f"ours{r}", Path(scratch) / f"peer{r}") for r in range(repeats)]
            answers = [(run_ours(database, ours), run_peer(database, peer, TIME_LIMIT_S)) for ours, peer in folders]
            scores, seconds, notes = [], [], []
            for side, who in enumerate(("ours", "peer")):
                errors = [str(pair[side]["error"]) for pair in answers if "error" in pair[side]]
                notes += [f"{who}: {errors[0]}"] if errors else []
                scores.append(None if errors else score_models(folders[0][side], truth))
                seconds.append(math.nan if errors else median(float(pair[side]["seconds"]) for pair in answers))
            yield Row(name, seed, describe(database), scores[0], scores[1], seconds[0], seconds[1], "; ".join(notes))


HEADER = (
    f"{'case':26} {'':5} {'registered':>12} {'points':>7} {'track':>6} {'median m':>9} {'rms m':>9} {'deg':>8} "
    f"{'px':>6} {'seconds':>8} {'ratio':>6}"
)


def lines(row: Row) -> Iterator[str]:
    """One line for each mapper; the ratio of ours is of the errors, that of the peer of the times."""
    for who, score, seconds, ratio in (
        ("ours", row.ours, row.ours_s, row.error_ratio),
        ("peer", row.peer, row.peer_s, row.speedup),
    ):
        if score is None:
            yield f"{row.case:26} {who:5} no answer ({row.note})"
            continue
        yield (
            f"{row.case:26} {who:5} {score.n_registered:5d} of {score.n_images:3d} {score.n_points:7d} "
            f"{score.mean_track_length:6.2f} {score.median_m:9.5f} {score.rms_m:9.5f} {score.rotation_deg:8.5f} "
            f"{score.reprojection_px:6.3f} {seconds:8.2f} {ratio:6.2f}"
        )


def means(rows: Sequence[Row]) -> str:
    """Rms errors over the worlds of a case, and their ratio; worlds that either mapper lost do not count."""
    both = [(row.ours.rms_m, row.peer.rms_m) for row in rows if row.ours is not None and row.peer is not None]
    if not both:
        return "no world that both mapped"
    ours, peer = (math.sqrt(mean(error**2 for error in errors)) for errors in zip(*both, strict=True))
    return f"{len(both)} worlds: rms {ours:.5f} m, peer {peer:.5f} m, ratio {ours / peer:.2f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--cases", nargs="+", choices=tuple(CASES), help="default: all")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=1, help="worlds of each case")
    parser.add_argument("--ours", nargs=2, type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.ours:
        sys.stdout.write(json.dumps({"seconds": map_once(*arguments.ours)}))
        return
    print("ratio: of the median errors in our line, of the times in the peer's; intrinsics held in both")
    print(HEADER)
    rows: dict[str, list[Row]] = {}
    for row in measure(arguments.cases, arguments.repeats, arguments.seeds):
        rows.setdefault(row.case, []).append(row)
        for line in lines(row):
            print(line, flush=True)
        print(f"{'':26} seed {row.seed}: {row.sizes}", flush=True)
        if len(rows[row.case]) == arguments.seeds > 1:
            print(f"{row.case:26} {means(rows[row.case])}", flush=True)


if __name__ == "__main__":
    main()
