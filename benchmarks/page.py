"""The page of figures, from the results alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite, sqrt
from statistics import fmean, median
from typing import Any

from benchmarks.cases import CASES, NOISE_DEG

Result = dict[str, Any]
PEER_TITLES = {
    "pycolmap": "pycolmap `run_global_positioning`",
    "pytheia_lud": "pyTheia LUD",
    "pytheia_nonlinear": "pyTheia nonlinear",
    "gtsam": "gtsam `TranslationRecovery`",
}

METHOD = f"""
## Method

- **Scenes** come from `panopath.simulate`, {NOISE_DEG} deg of noise in each tangent direction, every camera turned at
  random; the options of each are in the JSON file beside this page. Orientations are given to all solvers.
- **The build** is the one that the README's command makes: one portable binary.
- **Time** is wall time of the one call (`panopath.solve_positions`, `pycolmap.run_global_positioning`,
  `EstimatePositions`, `TranslationRecovery.run`), the first of its process: every figure comes from a fresh process.
  Ours includes everything from checked arrays to the finished record; building a peer's input and reading its answer
  are left out. Runs against pycolmap alternate (ours, pycolmap, ours, ...), and the median of each is compared.
- **The same observations**: each process makes the scene anew and returns a hash of views, tracks, bearings and
  orientations; the run stops where two differ. pycolmap's input is read back from its own reconstruction: number,
  tracks, rotations and bearings (to 1e-9) are compared with ours one by one.
- **rms** is the root mean square camera error after the best shift and scale, the only freedoms there are when
  orientations are known. `inf` means that at least one view was given no position.
- **Bound** is the Cramér-Rao bound of that rms over the true inliers. A few slow modes of the path carry most of the
  error, so that on one scene even the optimum lies anywhere from 0.3 to 1.5 times the bound; over many scenes the root
  mean square of that ratio tends to 1, and this is what "/ bound" gives, over all seeds of a case.
- **Optimum** is our refinement started from the truth, on the true inliers alone: what a perfect start and a perfect
  test for outliers would give on this very noise. "/ optimum" is the worst scene, or what its heading says.
- **Memory** is the peak of the process above what it held with the input (observations and orientations) in place.
- **pycolmap** gets equirectangular cameras 2^24 pixels wide (no rounding), its default options and random start.
- **pyTheia and gtsam** take no spherical camera and no bearings, so they get directions between all views that share
  8 tracks, estimated from the same bearings by `benchmarks/directions.py` (two-point hypotheses, then re-weighted
  smallest eigenvectors). The time of that step is given apart ("directions"); it is plain numpy on one thread. They
  use neither points nor how the error of a direction is shaped; gtsam is given each direction's standard deviation.
""".strip()


def render(results: dict[str, Result]) -> str:
    """Write the page."""
    if not results:
        return "# Benchmarks\n\nNothing has been measured yet: run `python -m benchmarks.run`.\n"
    parts = ["# Benchmarks", "Written by `python -m benchmarks.run`; do not edit.", _machines(results)]
    parts += [_promises(results), _peers(results), _growth(results), _robustness(results), METHOD]
    return "\n\n".join(part for part in parts if part) + "\n"


def _machines(results: dict[str, Result]) -> str:
    """Machine, versions and dates, once where all cases agree."""
    groups: dict[str, list[str]] = {}
    for name, result in results.items():
        machine, found = result["machine"], result["versions"]
        text = f"{machine['cpu']}, {machine['cores']} cores, {machine['system']}; " + ", ".join(
            f"{package} {version}" for package, version in found.items()
        )
        groups.setdefault(text, []).append(f"{name} ({result['date']})")
    return "\n".join(f"- {text}: {', '.join(names)}" for text, names in groups.items())


def _promises(results: dict[str, Result]) -> str:
    rows = [_promise_row(result) for name, result in results.items() if not CASES[name].hard]
    if not rows:
        return ""
    header = [
        "case",
        "observations",
        "ours",
        "pycolmap",
        "faster by",
        "rms",
        "/ bound",
        "/ optimum",
        "memory",
    ]
    return "## Speed, size and accuracy\n\n" + table((*header, "promised"), rows)


def _promise_row(result: Result) -> Sequence[str]:
    seconds = _seconds(result["ours"])
    peer = _seconds(result["peers"].get("pycolmap", []))
    speedup = peer / seconds if peer and seconds else None
    over_bound, over_optimum = _pooled(result["seeds"], "bound"), _worst(result["seeds"], "optimum")
    memory = max((run["memory_mb"] for run in result["ours"] if "memory_mb" in run), default=None)
    limits = result["promises"]
    promises = (
        (">= {:g}x faster", speedup, limits["min_speedup"]),
        ("<= {:g} s", seconds, limits["max_seconds"]),
        ("<= {:g} MB", memory, limits["max_memory_mb"]),
        ("<= {:g} x bound", over_bound, limits["max_over_bound"]),
        ("<= {:g} x optimum", over_optimum, limits["max_over_optimum"]),
    )
    verdicts = [
        _verdict(text.format(limit), value, limit, at_least=text.startswith(">="))
        for text, value, limit in promises
        if limit is not None
    ]
    n_observations = next((run["n_observations"] for run in result["ours"] if "n_observations" in run), None)
    return (
        result["title"],
        number(n_observations, "{:,}"),
        _time(result["ours"]),
        _time(result["peers"].get("pycolmap", [])),
        number(speedup, "{:.0f}x"),
        _millimetres(result["seeds"][0]["ours"]),
        number(over_bound, "{:.2f}"),
        number(over_optimum, "{:.2f}"),
        number(memory, "{:.0f} MB"),
        "; ".join(verdicts) or "-",
    )


def _verdict(text: str, value: float | None, limit: float, *, at_least: bool = False) -> str:
    if value is None:
        return f"{text}: not measured"
    return f"{text}: {'met' if (value >= limit if at_least else value <= limit) else '**missed**'}"


def _peers(results: dict[str, Result]) -> str:
    parts = []
    for result in results.values():
        if not result["peers"]:
            continue
        optimum = result["seeds"][0]["optimum"].get("rms")
        ours = result["seeds"][0]["ours"]
        rows = [_peer_row("panopath", result["ours"], ours, optimum)]
        for name, runs in result["peers"].items():
            rows.append(_peer_row(PEER_TITLES[name], runs, runs[0], optimum))
        header = ("solver", "time", "directions", "rms", "/ optimum", "notes")
        parts.append(f"### {result['title'].capitalize()}\n\n" + table(header, rows))
    return "## Beside other solvers\n\n" + "\n\n".join(parts) if parts else ""


def _peer_row(title: str, runs: list[Result], shown: Result, optimum: float | None) -> Sequence[str]:
    value = shown.get("rms")
    preparation = shown.get("preparation_seconds")
    return (
        title,
        _time(runs),
        number(preparation, "{:.2f} s") if preparation else "-",
        _millimetres(shown),
        number(value / optimum if value is not None and optimum else None, "{:.2f}"),
        str(shown.get("notes", "")),
    )


def _growth(results: dict[str, Result]) -> str:
    rows = []
    for name, result in results.items():
        runs = [run for run in result["ours"] if "seconds" in run]
        if CASES[name].world == "street" and not CASES[name].hard and runs:
            seconds, count = _seconds(runs), runs[0]["n_observations"]
            if seconds is not None:
                rows.append((result["title"], f"{count:,}", _time(runs), f"{1e6 * seconds / count:.2f} s"))
    if len(rows) < 2:
        return ""
    return "## Growth\n\n" + table(("case", "observations", "time", "a million observations"), rows)


def _robustness(results: dict[str, Result]) -> str:
    rows = [_robustness_row(result) for name, result in results.items() if CASES[name].hard]
    if not rows:
        return ""
    header = ("case", "solved", "rms, median", "rms, worst", "/ bound", "/ optimum", "worst", "time", "promised")
    text = (
        "One scene a seed. Solved: every view has a position and all share one scale. Where orientations are off, the "
        "optimum is off with them: no limit is promised there, and the bound, which takes them as exact, is far away."
    )
    return f"## Robustness\n\n{text}\n\n{table(header, rows)}"


def _robustness_row(result: Result) -> Sequence[str]:
    seeds = result["seeds"]
    solved = sum(is_solved(seed["ours"]) for seed in seeds)
    values = [seed["ours"].get("rms", float("inf")) for seed in seeds]
    worst = _worst(seeds, "optimum")
    verdict = "all solved: " + ("met" if solved == len(seeds) else "**missed**")
    limit = result["promises"]["max_over_optimum"]
    if limit is not None:
        verdict += "; " + _verdict(f"<= {limit:g} x optimum on every scene", worst, limit)
    return (
        result["title"],
        f"{solved} of {len(seeds)}",
        number(1000 * median(values), "{:.2f} mm"),
        number(1000 * max(values), "{:.2f} mm"),
        number(_pooled(seeds, "bound"), "{:.2f}"),
        number(_pooled(seeds, "optimum"), "{:.2f}"),
        number(worst, "{:.2f}"),
        _time([seed["ours"] for seed in seeds]),
        verdict,
    )


def is_solved(run: Result) -> bool:
    """Whether every view got a position in one common scale."""
    return bool(run.get("n_components") == 1 and run["n_solved_views"] == run["n_views"] and isfinite(run["rms"]))


def _seconds(runs: list[Result]) -> float | None:
    ended = [run["seconds"] for run in runs if "seconds" in run]
    return median(ended) if ended else None


def _time(runs: list[Result]) -> str:
    """Median seconds, with the number of runs where there are more; or why there are none."""
    if not runs:
        return "-"
    seconds = _seconds(runs)
    if seconds is None:
        return str(runs[0]["error"])
    return f"{seconds:.3g} s"


def _ratios(seeds: list[Result], reference: str) -> list[float] | None:
    """Our rms over the reference's on each scene, or None where one of them was not measured."""
    pairs = [(seed["ours"].get("rms"), seed[reference].get("rms")) for seed in seeds]
    if any(ours is None or not other for ours, other in pairs):
        return None
    return [ours / other for ours, other in pairs]


def _pooled(seeds: list[Result], reference: str) -> float | None:
    """Root mean square of the ratios: 1 for a solver at the bound, however few modes carry the error."""
    ratios = _ratios(seeds, reference)
    return None if ratios is None else sqrt(fmean(ratio**2 for ratio in ratios))


def _worst(seeds: list[Result], reference: str) -> float | None:
    ratios = _ratios(seeds, reference)
    return None if ratios is None else max(ratios)


def _millimetres(run: Result) -> str:
    return number(1000 * run["rms"] if "rms" in run else None, "{:.3g} mm")


def number(value: float | None, form: str) -> str:
    """``value`` in its form, or a dash."""
    return "-" if value is None else form.format(value)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write a Markdown table."""
    line: Callable[[Sequence[str]], str] = lambda cells: "| " + " | ".join(cells) + " |"  # noqa: E731
    return "\n".join([line(header), line(["---"] * len(header)), *(line(row) for row in rows)])
