"""The page of ``benchmarks.end_to_end``, from its results alone."""

from __future__ import annotations

from typing import Any

from benchmarks.page import number, table

Result = dict[str, Any]

#: How a limit is told: what it is of, and its format.
_FIGURES = {
    "speedup": ("faster than the peer", "{:.3g}x"),
    "posed_share": ("share of views posed", "{:.3g}"),
    "rmse_over_allowed": ("rmse / the larger of 0.01 % of the path and 1.5 x the peer's", "{:.2f}"),
    "rmse_over_peer": ("rmse / the peer's", "{:.2f}"),
    "rmse_over_clean": ("rmse / that of the clean film", "{:.2f}"),
    "is_determined": ("determined (1: yes)", "{:.0f}"),
    "end_drift_percent": ("end drift, % of the path", "{:.4f}"),
    "peak_mb": ("peak memory, MB", "{:.0f}"),
    "seconds_a_frame": ("seconds a frame", "{:.3f}"),
}

METHOD = """
## Method

- **Films** are `panopath.walk.render_walk` with the options in the JSON file beside this page, as H.264 (crf 20) of 10
  frames a second. Rendering is not measured. The peer gets 60 frames of the film, evenly spaced, written beforehand
  as JPEG of quality 95; so does ours in the case of images.
- **Ours** is `panopath.reconstruct` with its defaults, from the file to the last byte of the output: decoding, motion,
  features, matching, mapping, certificate, keyframes, models and report.
- **The peer** is pycolmap `extract_features`, `match_sequential` (overlap 10) and `global_mapping` on the processor,
  equirectangular cameras whose parameters are given and held, all else default; reading its own pictures is in its
  time, making them is not. Both cases with a peer show it the same pictures, so it runs once for both.
- **Time** is wall time, **cpu** that of all threads; **memory** the peak of the whole process, libraries included.
  Every run is a fresh process.
- **rmse** is of the positions of the posed views after the best similarity to the truth, **worst** the largest error.
- **End drift** is the error of the way from the first to the last view after that alignment, over the length of the
  path. **Loop pairs** are pairs of views more than half the sequence apart that share at least 15 points in use that
  are nearer than a tenth of the path.
""".strip()


def render(results: dict[str, Result], titles: dict[str, str], listed: dict[str, list[Result]]) -> str:
    """Write the page."""
    parts = ["# Benchmarks end to end", "Written by `python -m benchmarks.end_to_end`; do not edit."]
    if not results:
        return "\n\n".join([*parts, "Nothing has been measured yet."]) + "\n"
    parts += [_machines(results), "## What was promised", _promises(results, titles, listed)]
    parts += ["## Runs", _runs(results, titles), "## Where the time goes, seconds", _stages(results), METHOD]
    return "\n\n".join(parts) + "\n"


def _machines(results: dict[str, Result]) -> str:
    groups: dict[str, list[str]] = {}
    for name, result in results.items():
        machine, found = result["machine"], result["versions"]
        text = f"{machine['cpu']}, {machine['cores']} cores, {machine['system']}; " + ", ".join(
            f"{package} {version}" for package, version in found.items() if version != "absent"
        )
        loads = [run["load_before"] for run in (result["ours"], result["peer"]) if run and "load_before" in run]
        load = " and ".join(f"{load:.1f}" for load in loads)
        groups.setdefault(text, []).append(f"{name} ({result['date']}, load average before {load})")
    return "\n".join(f"- {text}: {', '.join(names)}" for text, names in groups.items())


def _size(result: Result) -> str:
    width = result["film"]["width_px"]
    return f"{width}x{width // 2}, {result['n_frames']} frames, {result['path_m']:.0f} m"


def _promises(results: dict[str, Result], titles: dict[str, str], listed: dict[str, list[Result]]) -> str:
    rows = []
    for name, result in results.items():
        for one in listed[name]:
            text, shape = _FIGURES[one["figure"]]
            value, limit = one["value"], one["limit"]
            met = value is not None and (value >= limit if one["at_least"] else value <= limit)
            rows.append((
                titles[name],
                _size(result),
                text,
                f"{'>=' if one['at_least'] else '<='} {shape.format(limit)}",
                "-" if value is None else shape.format(value),
                "not measured" if value is None else "met" if met else "**not met**",
            ))  # fmt: skip
    return table(("case", "size", "figure", "promised", "measured", ""), rows)


def _runs(results: dict[str, Result], titles: dict[str, str]) -> str:
    rows = []
    for name, result in results.items():
        for tool in ("ours", "peer"):
            run = result[tool]
            if run is not None:
                who = "panopath" if tool == "ours" else "pycolmap"
                rows.append((titles[name], who, *_run(run, result["film"].get("path") == "loop")))
    header = ("case", "tool", "time", "cpu", "memory", "posed", "points", "rmse", "of path", "worst", "loop pairs")
    return table(header, rows)


def _run(run: Result, is_loop: bool) -> tuple[str, ...]:
    if "error" in run:
        return (run["error"], *("-",) * 8)
    return (
        f"{run['seconds']:.1f} s",
        f"{run['cpu_s']:.1f} s",
        f"{run['peak_mb']:.0f} MB",
        f"{run['n_posed']} of {run['n_views']}",
        f"{run['n_points']:,}",
        number(_scaled(run.get("rmse_m"), 1e3), "{:.2f} mm"),
        number(run.get("rmse_percent"), "{:.4f} %"),
        number(_scaled(run.get("largest_m"), 1e3), "{:.2f} mm"),
        number(run.get("n_loop_pairs") if is_loop else None, "{}"),
    )


def _scaled(value: float | None, by: float) -> float | None:
    return None if value is None else by * value


def _stages(results: dict[str, Result]) -> str:
    lines = []
    for name, result in results.items():
        for tool in ("ours", "peer"):
            stages = (result[tool] or {}).get("stages", {})
            if stages:
                told = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in stages.items())
                lines.append(f"- {name}, {'panopath' if tool == 'ours' else 'pycolmap'}: {told}")
    return "\n".join(lines)
