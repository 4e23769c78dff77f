"""``panopath reconstruct``: a 360 video or a folder of pictures, to the end."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from panopath.cli.app import EXIT_INTERRUPTED, EXIT_UNDETERMINED, AsJson, Overwrite, Quiet, Terminal
from panopath.cli.certifying import brief
from panopath.cli.tables import parts_table, show_sentence
from panopath.formats.crops import CropOptions
from panopath.frontend import FeatureOptions, FrontEndOptions, VideoOptions, recognise
from panopath.mapping import MapOptions
from panopath.model import summary_dict
from panopath.run import Reconstructed, RunOptions, reconstruct
from panopath.run.job import Report


def reconstruct_command(
    source: Annotated[
        Path,
        typer.Argument(
            help="360 video; folder of panoramas; folder of a rig's pictures with its calibration; or folder of "
            "pictures of one camera with its intrinsics."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the answers; OUT/report.html shows them.")],
    *,
    rig: Annotated[Path | None, typer.Option(help="Calibration of a rig (COLMAP's JSON).")] = None,
    masks: Annotated[
        Path | None, typer.Option(help="Mask for all pictures, or folder of masks named like them; black is left out.")
    ] = None,
    camera_height: Annotated[
        float | None, typer.Option(help="Height of the camera above the ground, metres: gives the scale.")
    ] = None,
    baseline: Annotated[
        tuple[str, str, float] | None,
        typer.Option(metavar="A B METRES", help="Distance of two pictures: gives the scale."),
    ] = None,
    no_gps: Annotated[bool, typer.Option("--no-gps", help="Pass over places that the pictures know.")] = False,
    direction_locked: Annotated[
        bool | None,
        typer.Option("--direction-locked/--direction-free", help="Does the camera keep its direction? Default: found."),
    ] = None,
    horizon_locked: Annotated[
        bool, typer.Option("--horizon-locked", help="The horizon was levelled: the picture's up is the world's.")
    ] = False,
    views: Annotated[
        Literal["panorama", "cube", "perspective"],
        typer.Option(help="Cut crops for programs that know pinholes only, into OUT/crops."),
    ] = "panorama",
    crop_size: Annotated[int | None, typer.Option(help="Width of a crop; default: as fine as the panorama.")] = None,
    width: Annotated[int, typer.Option(min=128, help="Wider pictures are shrunk before features are sought.")] = (
        FrontEndOptions().width
    ),
    max_features: Annotated[int, typer.Option(min=1, help="Features of a picture.")] = FeatureOptions().max_features,
    keyframe_parallax: Annotated[
        float, typer.Option(help="Parallax from one keyframe of a video to the next, degrees.")
    ] = float(np.degrees(VideoOptions().parallax_rad)),
    unordered: Annotated[
        bool, typer.Option("--unordered", help="Pictures of a folder were not taken in the order of their names.")
    ] = False,
    no_images: Annotated[bool, typer.Option("--no-images", help="Write no keyframes.")] = False,
    random_seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    force: Annotated[bool, typer.Option("--force", help="Do everything again, whatever an earlier run left.")] = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Find the camera path and the points of a 360 video or a folder of pictures.

    A run that was stopped goes on where it was when it is called again.
    """
    terminal = Terminal(as_json, quiet)
    options = RunOptions(
        rig=rig,
        masks=masks,
        direction_locked=direction_locked,
        horizon_locked=horizon_locked,
        use_gps=not no_gps,
        camera_height_m=camera_height,
        baseline=baseline,
        keep_images=not no_images,
        crops=None if views == "panorama" else CropOptions(views, size_px=crop_size),
        front_end=FrontEndOptions(
            width=width,
            features=FeatureOptions(max_features=max_features),
            video=VideoOptions(parallax_rad=float(np.radians(keyframe_parallax))),
            in_sequence=not unordered,
        ),
        mapping=MapOptions(seed=random_seed),
    )
    done = run(terminal, source, out, options, force=force, overwrite=overwrite)
    terminal.answer(plain(done), lambda console: show(console, done))
    if not done.is_determined:
        raise typer.Exit(EXIT_UNDETERMINED)


def run(
    terminal: Terminal, source: Path, out: Path, options: RunOptions, *, force: bool, overwrite: bool
) -> Reconstructed:
    """Run the job, telling how far it is; an interruption keeps what was done."""
    try:
        with progress(terminal) as report:
            terminal.note(f"{source}: {recognise(source, rig=options.rig).description}")
            return reconstruct(source, out, options, report=report, force=force, overwrite=overwrite)
    except KeyboardInterrupt:
        terminal.warn(f"stopped; what was done is in {out}: the same command goes on from there")
        sys.exit(EXIT_INTERRUPTED)


@contextlib.contextmanager
def progress(terminal: Terminal, *, transient: bool = False) -> Iterator[Report]:
    """Show a bar for each stage, taken away at the end where ``transient``; on a stream that is no terminal nothing."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    if terminal.quiet or terminal.as_json or not console.is_terminal:
        yield lambda _stage, _done, _of: None
        return
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=transient) as bars:
        tasks: dict[str, TaskID] = {}

        def finish() -> None:
            for task in tasks.values():
                total = bars.tasks[task].total or 1
                bars.update(task, total=total, completed=total)

        def report(stage: str, done: int, of: int) -> None:
            if stage not in tasks:
                finish()
                tasks[stage] = bars.add_task(stage, total=of or None)
            bars.update(tasks[stage], completed=done, total=of or None)

        yield report
        finish()


def plain(done: Reconstructed) -> dict[str, Any]:
    """Give what a program reads."""
    return summary_dict(done.scene.summary) | {
        "source": done.description,
        "n_pictures": done.n_pictures,
        "n_frames": done.n_frames,
        "is_determined": done.is_determined,
        "certificate": None if done.certificate is None else brief(done.certificate, done.scene),
        "unit": done.unit,
        "statements": list(done.statements),
        "files": done.files,
        "stage_seconds": {name: round(value, 3) for name, value in done.seconds.items()},
    }


def show(console: Console, done: Reconstructed) -> None:
    """Print what a person reads."""
    console.print(parts_table(done.scene))
    for statement in done.statements:
        console.print(statement, markup=False)
    if done.certificate is not None:
        show_sentence(console, done.certificate, done.scene)
    stages = ", ".join(f"{name} {value:.1f} s" for name, value in done.seconds.items())
    console.print(stages, markup=False)
    console.print(f"report: {done.folder / 'report.html'}", markup=False)
