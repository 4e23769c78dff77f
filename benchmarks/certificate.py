"""What a certificate costs beside its solve: ``python -m benchmarks.certificate [--pairs N] [--case NAME]``.

Solve and certificate are timed in turn in one process, a fresh one for each case; the medians of the pairs are printed.
Memory is the peak of the process while it certifies, less what it held before: tracks and scene are there already.
"""

from __future__ import annotations

import argparse
import ctypes
import multiprocessing
import platform
import resource
import time
from dataclasses import dataclass
from math import radians
from pathlib import Path
from statistics import median
from typing import Any

import panopath as pp
from panopath.formats.structure import known_scene

from benchmarks.cases import NOISE_DEG

#: Of the issue: a street of 1000 views costs no more than twice its solve.
LIMITS = {"street 1000": 2.0}


@dataclass(frozen=True)
class Case:
    """A world, and whether its orientations are refined."""

    name: str
    world: str
    n_views: int
    n_points: int
    free: bool = False


CASES = (
    Case("street 100", "street", 100, 10_000),
    Case("street 1000", "street", 1000, 100_000),
    Case("street 3000", "street", 3000, 500_000),
    Case("room 1000", "room", 1000, 100_000),
    Case("street 100, refined", "street", 100, 10_000, free=True),
    Case("street 1000, refined", "street", 1000, 100_000, free=True),
)


def measure(case: Case, pairs: int) -> dict[str, Any]:
    """Find times, memory and verdict of one case."""
    world = pp.simulate(
        case.world,
        n_views=case.n_views,
        n_points=case.n_points,
        noise_rad=radians(NOISE_DEG),
        orientations="random",
        seed=0,
    )
    start = known_scene(world.tracks, world.cam_from_world, world.centers, world.points)
    options = pp.CertifyOptions(orientation="free" if case.free else "known")
    solving, certifying, memory = [], [], []
    for _ in range(pairs):
        began = time.perf_counter()
        scene = pp.refine(world.tracks, start) if case.free else pp.solve_positions(world.tracks, world.cam_from_world)
        solving.append(time.perf_counter() - began)
        forget_peak()
        held = status_mb("VmRSS")
        began = time.perf_counter()
        found = pp.certify(world.tracks, scene, options)
        certifying.append(time.perf_counter() - began)
        memory.append(status_mb("VmHWM") - held)
    return {
        "n_observations": len(world.tracks),
        "solve": median(solving),
        "certify": median(certifying),
        "ratio": median(c / s for c, s in zip(certifying, solving, strict=True)),
        # later runs find pages that the earlier ones left
        "memory_mb": memory[0],
        "verdict": found.verdict.value,
        "nullity": found.nullity,
        "gauge_freedoms": found.gauge_freedoms,
    }


def status_mb(name: str) -> float:
    """Read a figure of this process: of the Linux kernel's own account, elsewhere the peak for all of them."""
    path = Path("/proc/self/status")
    if not path.exists():
        unit = 1 if platform.system() == "Darwin" else 1024
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
    lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(name + ":"))


def forget_peak() -> None:
    """Hand freed memory back, so that none of the solve is used again, and start the peak anew (Linux)."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--case", action="append", choices=[case.name for case in CASES])
    chosen = parser.parse_args()
    print("| case | observations | solve s | certify s | ratio | memory MB | bytes an observation | verdict |")
    print("|---|---|---|---|---|---|---|---|")
    for case in CASES:
        if chosen.case and case.name not in chosen.case:
            continue
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            r = pool.apply(measure, (case, chosen.pairs))
        limit = LIMITS.get(case.name)
        verdict = "" if limit is None else f" (<= {limit:g}: {'met' if r['ratio'] <= limit else 'MISSED'})"
        each = r["memory_mb"] * 2**20 / r["n_observations"]
        print(
            f"| {case.name} | {r['n_observations']:,} | {r['solve']:.3f} | {r['certify']:.3f} "
            f"| {r['ratio']:.2f}{verdict} | {r['memory_mb']:.0f} | {each:.0f} "
            f"| {r['verdict']}, nullity {r['nullity']} of {r['gauge_freedoms']} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
