"""The promised figures: ``python -m benchmarks.run [--quick] [--case NAME] [--render] [-o docs/benchmarks.md]``.

Each case is measured apart and kept in a JSON file beside the page, so that a long run can be done in pieces; the page
is written anew from that file every time.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks.cases import CASES, Case
from benchmarks.job import Spec, in_fresh_process
from benchmarks.page import render

QUICK_SCALE = 0.2
TIME_LIMIT_S = 1200.0
PACKAGES = ("panopath", "numpy", "scipy", "pycolmap", "pytheia", "gtsam")

Result = dict[str, Any]


def run_case(case: Case, time_limit_s: float) -> Result:
    """All measurements of one case, each in a process of its own."""
    started = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    first = Spec.of(case, case.seeds[0])
    ours: list[Result] = []
    pycolmap: list[Result] = []
    for _ in range(max(case.pairs, case.repeats)):
        ours.append(_measure("ours", first, time_limit_s))
        if len(pycolmap) < case.pairs:
            pycolmap.append(_measure("pycolmap", first, time_limit_s))
    peers = {name: [_measure(name, first, time_limit_s)] for name in case.peers}
    if pycolmap:
        peers = {"pycolmap": pycolmap, **peers}
    seeds = [_accuracy(case, seed, ours[0], time_limit_s) for seed in case.seeds]
    _check_same_observations(case.name, [*ours, *(run for runs in peers.values() for run in runs)])
    return {
        "title": case.title,
        "world": case.world,
        "options": case.options,
        "promises": case.promises(),
        "date": started,
        "machine": machine(),
        "versions": versions(),
        "ours": ours,
        "peers": peers,
        "seeds": seeds,
    }


def _accuracy(case: Case, seed: int, first_run: Result, time_limit_s: float) -> Result:
    """Ours, the optimum started from the truth, and the Cramer-Rao bound on one scene."""
    spec = Spec.of(case, seed)
    ours = first_run if seed == case.seeds[0] else _measure("ours", spec, time_limit_s)
    return {
        "seed": seed,
        "ours": ours,
        "optimum": _measure("optimum", spec, time_limit_s),
        "bound": _measure("bound", spec, time_limit_s),
    }


def _measure(what: str, spec: Spec, time_limit_s: float) -> Result:
    print(f"  {what}, seed {spec.seed} ... ", end="", flush=True)
    result = in_fresh_process(what, spec, time_limit_s)
    if "error" in result:
        print(result["error"])
    else:
        print(f"{result.get('seconds', float('nan')):.3f} s, rms {result['rms']:.3g}")
    return result


def _check_same_observations(name: str, runs: list[Result]) -> None:
    """All runs of a case that ended must have seen the same bytes."""
    prints = {run["fingerprint"] for run in runs if "fingerprint" in run}
    if len(prints) > 1:
        raise RuntimeError(f"{name}: solvers saw different observations: {sorted(prints)}")


def machine() -> dict[str, Any]:
    """Describe what the figures depend on besides the code."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = cpuinfo.read_text(encoding="ascii", errors="replace").splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    return {"cpu": model, "cores": os.cpu_count(), "system": f"{platform.system()} {platform.machine()}"}


def versions() -> dict[str, str]:
    """Versions of Python and of every package that was measured."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "absent"
    return found


def load(path: Path) -> dict[str, Result]:
    """Results so far, or none."""
    if not path.exists():
        return {}
    results: dict[str, Result] = json.loads(path.read_text(encoding="utf-8"))
    return results


def save(path: Path, results: dict[str, Result]) -> None:
    """Results in the order of the cases; written beside and moved, so that a broken run loses nothing."""
    ordered = {name: results[name] for name in CASES if name in results}
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".json.part")
    draft.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)


def parse(arguments: list[str]) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.run", description=__doc__)
    parser.add_argument("--case", action="append", choices=list(CASES), help="only this case (may be repeated)")
    parser.add_argument("--quick", action="store_true", help=f"all sizes times {QUICK_SCALE}: proves the plumbing")
    parser.add_argument("--render", action="store_true", help="write the page from the results so far; measure nothing")
    parser.add_argument("--time-limit", type=float, default=TIME_LIMIT_S, metavar="SECONDS", help="for each solve")
    parser.add_argument("-o", "--output", type=Path, help="page to write; results go beside it as .json")
    chosen = parser.parse_args(arguments)
    if chosen.output is None:
        chosen.output = Path("out/benchmarks-quick.md" if chosen.quick else "docs/benchmarks.md")
    return chosen


def main(arguments: list[str] | None = None) -> None:
    """Measure what was asked for, merge it into the results, write the page."""
    chosen = parse(sys.argv[1:] if arguments is None else arguments)
    store = chosen.output.with_suffix(".json")
    results = load(store)
    if not chosen.render:
        for name in chosen.case or CASES:
            case = CASES[name].scaled(QUICK_SCALE) if chosen.quick else CASES[name]
            print(f"{name}: {case.title}")
            results[name] = run_case(case, chosen.time_limit)
            save(store, results)
    chosen.output.parent.mkdir(parents=True, exist_ok=True)
    chosen.output.write_text(render(results), encoding="utf-8")
    print(f"wrote {chosen.output}")


if __name__ == "__main__":
    main()
