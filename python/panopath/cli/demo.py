"""``panopath demo``: a walk filmed, reconstructed and compared with the truth; nothing is downloaded."""

from __future__ import annotations

import json
import webbrowser
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.console import Console

from panopath.cli.app import EXIT_UNDETERMINED, AsJson, Overwrite, Quiet, Terminal
from panopath.cli.reconstruct import plain, progress, run, show
from panopath.errors import InputError
from panopath.evaluate import Evaluation, evaluate
from panopath.formats.files import write_bytes
from panopath.model import Float
from panopath.run import Reconstructed, RunOptions
from panopath.run.job import check_folder
from panopath.walk import Walk, render_walk

_FILM, _SETTINGS = "walk.mp4", "walk.json"


def demo(
    *,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write to.")] = Path("panopath-demo"),
    frames: Annotated[int, typer.Option(min=20, help="Frames of the film, 10 a second, 14 cm apart.")] = 240,
    width: Annotated[int, typer.Option(min=256, help="Width of the film.")] = 1280,
    path: Annotated[Literal["straight", "corner", "loop"], typer.Option(help="Where the walk leads.")] = "corner",
    rotation: Annotated[Literal["none", "sway", "tumble"], typer.Option(help="How the camera turns.")] = "sway",
    cars: Annotated[int, typer.Option(min=0, max=100, help="Cars that pass by.")] = 0,
    operator: Annotated[float, typer.Option(min=0.0, max=0.5, help="Share of the sphere that the operator hides.")] = (
        0.0
    ),
    exposure: Annotated[float, typer.Option(min=0.0, max=4.0, help="Drift of the exposure, factors of two.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    show_report: Annotated[bool, typer.Option("--open", help="Open the report in the browser.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Do everything again, whatever an earlier run left.")] = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Film a walk through a street with a 360 camera, reconstruct it, and compare with the truth. Needs no download."""
    terminal = Terminal(as_json, quiet)
    check_folder(out, overwrite)
    settings: dict[str, Any] = {
        "width_px": width,
        "n_frames": frames,
        "path": path,
        "rotation": rotation,
        "n_movers": cars,
        "operator_share": operator,
        "exposure_drift_stops": exposure,
        "seed": seed,
    }
    walk = render_walk(**settings)
    film = _film(terminal, walk, settings, out, force=force)
    height = float(np.median(walk.truth.centers[:, 2]))
    done = run(terminal, film, out, RunOptions(camera_height_m=height), force=force, overwrite=True)
    truth = walk.truth.centers[[_frame_of(name) for name in done.scene.view_labels()]]
    result = evaluate(done.scene, truth, "similarity")
    length = float(np.linalg.norm(np.diff(walk.truth.centers, axis=0), axis=1).sum())
    terminal.answer(
        plain(done) | result.to_dict() | {"path_length_m": length, "out": str(out)},
        lambda console: _show(console, done, result, length, truth),
    )
    if show_report:
        webbrowser.open((out / "report.html").resolve().as_uri())
    if not done.is_determined:
        raise typer.Exit(EXIT_UNDETERMINED)


def _film(terminal: Terminal, walk: Walk, settings: dict[str, Any], out: Path, *, force: bool) -> Path:
    """Render the walk, unless the same film is there already."""
    film, beside = out / _FILM, out / _SETTINGS
    content = (json.dumps(settings, indent=1) + "\n").encode()
    if not force and film.is_file() and beside.is_file() and beside.read_bytes() == content:
        return film
    try:
        out.mkdir(parents=True, exist_ok=True)
        beside.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror})") from None
    with progress(terminal) as report:
        walk.write_video(film, report=lambda done: report("filming", done, len(walk)))
    # only a film that was finished is taken for one
    write_bytes(beside, content)
    return film


def _frame_of(name: str) -> int:
    """Read the number of the frame that a keyframe is called by."""
    return int(name.removeprefix("frame_").split(".")[0])


def _show(console: Console, done: Reconstructed, result: Evaluation, length: float, truth: Float) -> None:
    show(console, done)
    error = result.camera_rms
    console.print(
        f"path of {length:.1f} m, positions against the truth: {1e3 * error:.2f} mm rms, "
        f"{100.0 * error / length:.4f} % of the path ({result.n_views} of {len(truth)} keyframes)"
    )
    console.print(f"metres from the camera's height are {100.0 * abs(result.scale - 1.0):.2f} % off")
