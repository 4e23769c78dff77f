"""``panopath check``: what a scene's bearings determine."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, get_args

import numpy as np
import typer
from rich.console import Console

from panopath.certificate import OrientationModel
from panopath.certificate_text import (
    Names,
)
from panopath.cli.app import EXIT_UNDETERMINED, AsJson, NoPlots, Quiet, Terminal, Verbose
from panopath.cli.certifying import Drawing, certified, show_certificate, sigma_of, write_checked
from panopath.cli.evaluate import judged
from panopath.cli.solve import reconstruct, with_sigma
from panopath.errors import InputError
from panopath.formats import (
    read_certificate,
    read_problem,
)
from panopath.formats.folder import check_certificate_writable, is_scene_folder
from panopath.freedoms import PathCertificate
from panopath.model import Float, PositionOptions, Problem, Scene, Status
from panopath.steps import CertifyOptions, FreedomOptions, certify_paths, solve_positions


def check(
    source: Annotated[
        Path,
        typer.Argument(
            help="A folder that panopath wrote or a COLMAP model: certified as it is. Or bearings: solved first."
        ),
    ],
    *,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for certificate.json and certificate.png.")
    ] = None,
    orientations: Annotated[
        Path | None,
        typer.Option(help="Bearings are in the cameras, turned as this CSV says (see panopath solve)."),
    ] = None,
    orientation: Annotated[
        OrientationModel | None,
        typer.Option(help="What is known of orientations. Default: free for COLMAP models, else known."),
    ] = None,
    sigma_deg: Annotated[
        float | None, typer.Option(help="Accuracy of a bearing, one standard deviation. Default: what the data say.")
    ] = None,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads to use. Default: all cores.")] = None,
    no_plots: NoPlots = False,
    verbose: Verbose = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Say what of a scene is determined, what is not, why, and how well.

    The word before the first colon is the verdict. The exit code is 0 only where everything is determined.
    """
    terminal = Terminal(as_json, quiet)
    if out is not None:
        check_certificate_writable(out)
    sigma_rad = None if sigma_deg is None else sigma_of(sigma_deg)
    scene, model = _scene_to_check(terminal, source, orientations, orientation, sigma_deg, threads)
    begin = time.perf_counter()
    certificate = certified(terminal, scene, CertifyOptions(orientation=model, sigma_rad=sigma_rad, threads=threads))
    seconds = time.perf_counter() - begin
    if out is not None:
        with terminal.working("writing"):
            write_checked(certificate, scene, out, None if no_plots else Drawing(terminal))
    names = Names(scene.view_labels(), scene.track_labels())
    moving = certified_paths(scene, sigma_rad, threads)
    told = [] if moving is None else [f"paths: {line}" for line in moving.explain(names.views, names.tracks)]
    plain = certificate.to_dict(names.views, names.tracks) | {
        "lines": certificate.explain(names.views, names.tracks, (scene.centers, scene.points)),
        **({} if moving is None else {"paths": {"is_determined": moving.is_determined, "lines": told}}),
        "wall_s": seconds,
        "out": None if out is None else str(out),
    }

    def show(console: Console) -> None:
        for line in told if verbose else told[:1]:
            console.print(line, markup=False)
        if moving is not None:
            console.print("of what rests:", end=" ")
        show_certificate(console, certificate, scene, names, verbose)

    terminal.answer(plain, show)
    # what is free of everything together says more than what rests can, which may be a single point
    held = certificate.is_determined if moving is None else moving.is_determined and certificate.consistency.passed
    if not held:
        raise typer.Exit(EXIT_UNDETERMINED)


def certified_paths(scene: Scene, sigma_rad: float | None, threads: int | None) -> PathCertificate | None:
    """Find what stays free where tracks move; None where the scene has no paths, or no times to tell."""
    if scene.paths is None or scene.tracks is None or scene.tracks.time_s is None:
        return None
    return certify_paths(scene.tracks, scene, FreedomOptions(sigma_rad=sigma_rad, threads=threads))


def _scene_to_check(  # noqa: PLR0917 (what the command line says of it, all of it)
    terminal: Terminal,
    source: Path,
    orientations: Path | None,
    orientation: OrientationModel | None,
    sigma_deg: float | None,
    threads: int | None,
) -> tuple[Scene, OrientationModel]:
    """Read the scene, or solve the bearings; and tell what was known of orientations."""
    if source.is_dir() and orientations is None:
        with terminal.working("reading"):
            scene = judged(source)
        return scene, _dimension_fits(orientation or _model_of(source), scene.d)
    with terminal.working("reading"):
        problem = with_sigma(read_problem(source, orientations), sigma_deg)
    model = _dimension_fits(orientation or "known", problem.tracks.d)
    options = PositionOptions(threads=threads)
    with terminal.working("solving"):
        if model == "known":
            return _solved_whole(problem, options), model
        up = _upward(problem) if model == "vertical" else None
        return reconstruct(problem, options, up, unknown=problem.cam_from_world is None), model


def _solved_whole(problem: Problem, options: PositionOptions) -> Scene:
    """Solve with known orientations; as one where parts share no scale, so that what joins them can be certified.

    Split, a view that two parts share has a place in one of them only, and parts that are not rigid have none. As one,
    the scene is one of many that fit, which is what a certificate is about; it counts if it fits as well.
    """
    scene = solve_positions(problem.tracks, problem.cam_from_world, options)
    if scene.summary.status not in (Status.DISCONNECTED, Status.UNDETERMINED):
        return scene
    whole = solve_positions(problem.tracks, problem.cam_from_world, replace(options, split_parts=False))
    return whole if whole.summary.n_inliers >= scene.summary.n_inliers else scene


def _dimension_fits(model: OrientationModel, d: int) -> OrientationModel:
    if model == "vertical" and d == 2:
        raise InputError("--orientation is vertical, which asks for space; in the plane expected known or free")
    return model


def _model_of(folder: Path) -> OrientationModel:
    """Tell what was known of orientations when a folder was written, as its certificate says where it has one."""
    if not is_scene_folder(folder):
        return "free"
    try:
        said = read_certificate(folder).get("orientation")
    except InputError:
        return "known"
    return next((model for model in get_args(OrientationModel) if model == said), "known")


def _upward(problem: Problem) -> Float:
    """(n_views, 3) the vertical in each camera: z where cameras are not turned."""
    if problem.cam_from_world is None:
        return np.tile((0.0, 0.0, 1.0), (problem.tracks.n_views, 1))
    return np.ascontiguousarray(problem.cam_from_world[:, :, 2])
