"""Tables and lines that several commands print."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from panopath.certificate import Certificate
from panopath.model import (
    Scene,
    Status,
)
from panopath.movers import form_text
from panopath.paths import Paths, PathVerdict

MOST_ROWS = 12


STATUS_TEXT = {
    Status.CONVERGED: "converged",
    Status.MAX_ITERATIONS: "stopped at the limit of iterations; the scene may still move",
    Status.AMBIGUOUS: "ambiguous: the bearings leave more free than shift and scale",
    Status.DISCONNECTED: "solved in parts that share no scale: positions of different parts cannot be compared",
    Status.UNDETERMINED: "undetermined: the bearings fix no part of the scene",
}


VERDICT_TEXT = {
    PathVerdict.STATIC: "at rest",
    PathVerdict.MOVING: "moving",
    PathVerdict.IMITATED: "refused: imitated by the camera",
    PathVerdict.HIDDEN: "refused: hidden",
    PathVerdict.UNDETERMINED: "undetermined: seen too little, or nothing fits",
}


def show_scene(  # noqa: PLR0917 (prints what was found, all of it)
    console: Console, scene: Scene, certificate: Certificate, seconds: float, out: Path | None, pictures: bool
) -> None:
    """Print parts, status, noise and what was written."""
    console.print(parts_table(scene))
    summary = scene.summary
    console.print(f"{STATUS_TEXT[summary.status]}; {summary.iterations} iterations, {seconds:.2f} s", markup=False)
    if np.isfinite(summary.sigma_rad):
        console.print(f"accuracy of a bearing: {np.degrees(summary.sigma_rad):.4g} degrees")
    left = (summary.n_views - summary.n_solved_views, summary.n_tracks - summary.n_solved_points)
    if any(left):
        console.print(f"not determined: {left[0]:,} views and {left[1]:,} points")
    show_paths(console, scene)
    show_sentence(console, certificate, scene)
    if out is None:
        console.print("nothing was written; -o FOLDER writes the scene")
    else:
        console.print(
            f"written to {out}" + (" (look at views.png, errors.png and certificate.png)" if pictures else ""),
            markup=False,
        )


def show_paths(console: Console, scene: Scene) -> None:
    """Count what rests and what moves, say what was assumed and what is free, and name what was refused, and why."""
    paths = scene.paths
    if paths is None:
        return
    count = Counter(paths.verdicts)
    table = Table(header_style="bold")
    table.add_column("tracks", justify="right")
    table.add_column("verdict")
    for verdict in PathVerdict:
        table.add_row(f"{count[verdict]:,}", VERDICT_TEXT[verdict])
    console.print(table)
    moving = np.flatnonzero(paths.moving).tolist()
    forms = sorted(Counter(form_text(paths.models[track]) for track in moving).items())
    if forms:
        console.print("forms: " + ", ".join(f"{n:,} of {form}" for form, n in forms), markup=False)
    if (bodies := int(paths.body.max(initial=-1)) + 1) > 0:
        console.print(f"rigid bodies of several tracks: {bodies:,}, of {int((paths.body >= 0).sum()):,} tracks")
    if paths.assumption:
        console.print(f"assumed: {paths.assumption}", markup=False)
    for freedom in paths.freedoms:
        console.print(f"free: {freedom}", markup=False)
    _show_refused(console, paths, scene.track_labels())


def _show_refused(console: Console, paths: Paths, names: Sequence[str]) -> None:
    why = {
        PathVerdict.IMITATED: "the camera itself moved in the form of its path",
        PathVerdict.HIDDEN: "it stood before or behind {} in every view",
    }
    refused = [track for track, verdict in enumerate(paths.verdicts) if verdict in why]
    for track in refused[:MOST_ROWS]:
        other = int(paths.hidden_by[track])
        reason = why[paths.verdicts[track]].format("another" if other < 0 else f"track {names[other]}")
        console.print(f"refused: track {names[track]}: {reason}", markup=False)
    if len(refused) > MOST_ROWS:
        console.print(f"refused: {len(refused) - MOST_ROWS:,} more")


def show_sentence(console: Console, certificate: Certificate, scene: Scene) -> None:
    """Summarise a certificate in one line, among other answers."""
    told = certificate.sentence(scene.view_labels(), scene.track_labels())
    label = "certificate" if scene.paths is None else "certificate of what rests"
    console.print(f"{label}: {told}", markup=False)


def parts_table(scene: Scene) -> Table:
    """Count views, points, observations and outliers, a row a part."""
    table = Table(header_style="bold")
    for name in ("part", "views", "points", "observations", "outliers", "angular rms"):
        table.add_column(name, justify="right")
    rows = [_part_row(scene, component) for component in range(scene.n_components)]
    order = sorted(range(len(rows)), key=lambda c: (-rows[c][0], c))
    for component in order[:MOST_ROWS]:
        table.add_row(str(component + 1), *_cells(rows[component]))
    if len(rows) > MOST_ROWS:
        table.add_row("...", f"{len(rows) - MOST_ROWS} more", "", "", "", "")
    if len(rows) != 1:
        table.add_section()
        table.add_row("all", *_cells(_part_row(scene, None)))
    return table


def _cells(row: tuple[int, int, int, int, float]) -> list[str]:
    views, points, n, outliers, rms_deg = row
    share = f" ({100.0 * outliers / n:.1f} %)" if n else ""
    rms = f"{rms_deg:.4g} deg" if np.isfinite(rms_deg) else "-"
    return [f"{views:,}", f"{points:,}", f"{n:,}", f"{outliers:,}{share}", rms]


def _part_row(scene: Scene, component: int | None) -> tuple[int, int, int, int, float]:
    """Count views, points, observations and outliers, with the angular rms in degrees; of all parts for None."""
    views = scene.view_component >= 0 if component is None else scene.view_component == component
    points = scene.track_component >= 0 if component is None else scene.track_component == component
    inside = np.isfinite(scene.residual_rad)
    if scene.tracks is not None:
        owner, track = scene.view_component[scene.tracks.view], scene.track_component[scene.tracks.track]
        inside = (owner >= 0 if component is None else owner == component) & (track == owner)
    used = inside & scene.inlier
    rms_rad = float(np.sqrt(np.mean(scene.residual_rad[used] ** 2))) if used.any() else float("nan")
    n, n_used = int(inside.sum()), int(used.sum())
    return int(views.sum()), int(points.sum()), n, n - n_used, float(np.degrees(rms_rad))
