"""The page of figures with orientations free: ``python -m benchmarks.free_page [--only NAME] [--render]``.

Each section is the output of one command, run in a process of its own and kept in a JSON file beside the page, so that
a long run can be done in pieces.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.run import machine, versions

PAGE = Path("docs/benchmarks-orientation.md")
TIME_LIMIT_S = 7200.0

#: Name, title, command after ``python -m``, and what the table shows.
SECTIONS: tuple[tuple[str, str, tuple[str, ...], str], ...] = (
    (
        "refine",
        "Bundle adjustment",
        ("benchmarks.refinement",),
        "All free, the same start, against `pycolmap.bundle_adjustment` on EQUIRECTANGULAR cameras with its default "
        "options. Covariances are of all cameras and points. Promised: 8x on the street, 3x in the room, rms no "
        "larger.",
    ),
    (
        "free",
        "Orientations off or unknown, long chains",
        ("benchmarks.free",),
        "Camera error after alignment over that of the optimum, which is started from the truth; one scene a seed.",
    ),
    (
        "averaging",
        "Rotation averaging",
        ("benchmarks.orientations", "--repeats", "3"),
        "Against `pycolmap.run_rotation_averaging`: a path of 30 neighbours a view with loop closures, 20 % of the "
        "edges wrong. Promised: error no larger, 5x less time.",
    ),
    (
        "map",
        "Mapping COLMAP databases",
        ("benchmarks.mapping", "--repeats", "1"),
        "Against `pycolmap.global_mapping` on the same database, intrinsics fixed. Promised: 10x, the same images "
        "registered, median error at most 1.05 x.",
    ),
    (
        "map_worlds",
        "Several worlds of a case",
        ("benchmarks.mapping", "--cases", "panoramas 100, 10% wrong", "pinhole 100", "--repeats", "1", "--seeds", "5"),
        "A few slow bends of the path rule the error, so that single worlds scatter: the means of five.",
    ),
    (
        "two_view",
        "Two views",
        ("benchmarks.two_view", "--repeats", "20"),
        "Against `pycolmap.estimate_calibrated_two_view_geometry` on EQUIRECTANGULAR cameras, which is told four times "
        "the true noise as its limit; panopath is not told the noise.",
    ),
    (
        "tracks",
        "Tracks from matches",
        ("benchmarks.correspondence",),
        "Against union-find that drops every ambiguous component.",
    ),
    ("headings", "Headings of planar views", ("benchmarks.headings",), "Against least squares from random starts."),
)

Result = dict[str, Any]


def run(command: tuple[str, ...]) -> Result:
    """Run one section's command and keep what it prints."""
    done = subprocess.run(
        [sys.executable, "-m", *command], capture_output=True, text=True, timeout=TIME_LIMIT_S, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip().splitlines()[-1:]}")
    return {
        "output": done.stdout.rstrip(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": machine(),
        "versions": versions(),
    }


def render(results: dict[str, Result]) -> str:
    """Write the page."""
    parts = ["# Benchmarks with orientations free", "Written by `python -m benchmarks.free_page`; do not edit."]
    for name, title, command, text in SECTIONS:
        if name not in results:
            continue
        result = results[name]
        hardware = f"{result['machine']['cpu']}, {result['machine']['cores']} cores"
        packages = ", ".join(f"{package} {found}" for package, found in result["versions"].items())
        parts += [
            f"## {title}",
            text,
            f"`python -m {' '.join(command)}`, {result['date']}, {hardware}; {packages}.",
            f"```text\n{result['output']}\n```",
        ]
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Run what was asked for, merge it into the results, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", action="append", choices=[name for name, *_ in SECTIONS])
    parser.add_argument("--render", action="store_true", help="write the page from the results so far")
    chosen = parser.parse_args()
    store = PAGE.with_suffix(".json")
    results: dict[str, Result] = json.loads(store.read_text(encoding="utf-8")) if store.exists() else {}
    for name, _, command, _ in SECTIONS:
        if not chosen.render and name in (chosen.only or [name]):
            print(f"{name} ...", flush=True)
            results[name] = run(command)
            store.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(render(results), encoding="utf-8")
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
