"""``panopath evaluate``: a scene against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from panopath.cli.app import AsJson, Quiet, Terminal
from panopath.errors import InputError
from panopath.evaluate import Alignment, Evaluation, evaluate
from panopath.formats import (
    read_problem,
    read_scene,
    read_truth,
)
from panopath.formats.colmap import find_model
from panopath.formats.folder import is_scene_folder
from panopath.model import Scene


def evaluate_command(
    out: Annotated[Path, typer.Argument(help="Folder that panopath solve wrote, or a COLMAP model.")],
    truth: Annotated[
        Path,
        typer.Argument(help="Truth: a panopath folder, COLMAP model, BAL file, or CSV view,x,y[,z] | track,x,y[,z]."),
    ],
    *,
    alignment: Annotated[Alignment, typer.Option(help="What is fitted before comparing.")] = "similarity",
    trim: Annotated[float | None, typer.Option(min=0.0, help="Largest share of cameras the fit may leave out.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Compare a scene with the truth, in the units of the truth."""
    terminal = Terminal(as_json, quiet)
    scene = judged(out)
    result = evaluate(scene, read_truth(truth, scene), alignment, trim)
    terminal.answer(result.to_dict(), lambda console: _show_evaluation(console, result))


def judged(folder: Path) -> Scene:
    """Read the scene of a folder that panopath wrote, or of a COLMAP model such as `panopath map` writes."""
    if is_scene_folder(folder) or not folder.is_dir() or find_model(folder) is None:
        return read_scene(folder)
    scene = read_problem(folder).scene
    if scene is None:
        raise InputError(f"{folder}: the model has no points")
    return scene


def _show_evaluation(console: Console, result: Evaluation) -> None:
    table = Table(header_style="bold")
    for name in ("", "compared", "rms", "median", "largest"):
        table.add_column(name, justify="right")
    table.add_row(
        "cameras", f"{result.n_views:,}", *map(_length, (result.camera_rms, result.camera_median, result.camera_max))
    )
    table.add_row("points", f"{result.n_points:,}", *map(_length, (result.point_rms, result.point_median)), "")
    console.print(table)
    if np.isfinite(result.point_relative_median):
        console.print(f"median error of a point: {100.0 * result.point_relative_median:.3g} % of its distance")
    console.print(f"fitted: scale {result.scale:.6g}, rotation {np.degrees(result.rotation_rad):.4g} degrees")
    if len(result.alignments) > 1:
        console.print(f"{len(result.alignments)} parts, each fitted by itself")
    if any(not fit.is_unique for fit in result.alignments):
        console.print("too few positions, or all on a line: the fit is not unique, the errors are lower bounds")


def _length(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "-"
