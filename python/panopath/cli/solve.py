"""``panopath solve``: positions and points from bearings."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from panopath.certificate import OrientationModel
from panopath.cli.app import EXIT_UNDETERMINED, AsJson, NoPlots, Overwrite, Quiet, Terminal
from panopath.cli.certifying import Drawing, brief, certified, sigma_of, write_folder
from panopath.cli.motion import form_of, motion_of
from panopath.cli.tables import show_scene
from panopath.errors import InputError
from panopath.formats import (
    read_control,
    read_problem,
)
from panopath.formats.csv import read_vectors
from panopath.formats.folder import check_writable
from panopath.formats.paths import paths_dict
from panopath.model import (
    Float,
    Gauge,
    LinearForm,
    LinearGauge,
    LinearSolver,
    Method,
    PositionOptions,
    Problem,
    Scene,
    Tracks,
    summary_dict,
)
from panopath.paths import Motion
from panopath.pipeline import ReconstructOptions, fit_to_control, reconstruct_tracks
from panopath.steps import CertifyOptions, FreedomOptions, RefineOptions, certify_paths, solve_positions


def solve(
    tracks: Annotated[
        Path, typer.Argument(help="Bearings (CSV, Parquet), a BAL file, a COLMAP model folder or a panopath folder.")
    ],
    *,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder to write the scene to.")] = None,
    orientations: Annotated[
        Path | None,
        typer.Option(
            help="CSV view,qw,qx,qy,qz (cam_from_world) or view,heading_deg: the bearings are in the cameras."
        ),
    ] = None,
    method: Annotated[Method, typer.Option(help="robust, or the paper's least squares (linear).")] = "robust",
    gauge: Annotated[Gauge | None, typer.Option(help="Where the scene is put. Default: normalized.")] = None,
    control: Annotated[
        Path | None, typer.Option(help="CSV view,x,y[,z] or track,x,y[,z] of known positions to fit the scene to.")
    ] = None,
    sigma_deg: Annotated[
        float | None, typer.Option(help="Accuracy of a bearing, one standard deviation, where the file gives none.")
    ] = None,
    linear_form: Annotated[LinearForm, typer.Option(help="method=linear in space: how.")] = "joint",
    linear_gauge: Annotated[LinearGauge, typer.Option(help="method=linear: what fixes the scale.")] = "functional",
    linear_solver: Annotated[LinearSolver, typer.Option(help="How the camera system is solved.")] = "auto",
    vertical_axis: Annotated[int, typer.Option(min=0, max=2, help="linear-form=two_stage: the axis of height.")] = 2,
    max_iterations: Annotated[int | None, typer.Option(min=1, help="Most steps of refinement.")] = None,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads to use. Default: all cores.")] = None,
    no_split: Annotated[bool, typer.Option("--no-split", help="Solve as one even where parts share no scale.")] = False,
    unknown_orientation: Annotated[
        bool, typer.Option("--unknown-orientation", help="The bearings are in the cameras; find how these are turned.")
    ] = False,
    refine_orientation: Annotated[
        bool, typer.Option("--refine", help="Orientations are about right only: refine them with all else.")
    ] = False,
    gravity: Annotated[
        Path | None, typer.Option(help="CSV view,x,y,z: the upward vertical in each camera, right to half a degree.")
    ] = None,
    motion: Annotated[
        str | None,
        typer.Option(
            help="Tracks may move: auto, taylor:ORDER, fourier:ORDER[:omega=RAD_S], spline:TIME,TIME,...[:degree=K]."
        ),
    ] = None,
    static: Annotated[
        str | None, typer.Option(help="With --motion: tracks known to be at rest, between commas, or @FILE.")
    ] = None,
    group: Annotated[bool, typer.Option("--group", help="With --motion: find tracks that move as one body.")] = False,
    overwrite: Overwrite = False,
    no_plots: NoPlots = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Find camera positions and points from bearings.

    Bearings are directions in the world unless --orientations, or the file itself, says how each view is turned, or
    --unknown-orientation that nobody knows.
    """
    terminal = Terminal(as_json, quiet)
    if unknown_orientation and (orientations is not None or refine_orientation):
        raise InputError("--unknown-orientation leaves no place for --orientations or --refine")
    if gravity is not None and not (unknown_orientation or refine_orientation):
        raise InputError(
            "--gravity tells nothing new of known orientations, expected --unknown-orientation or --refine"
        )
    _check_motion(motion, static, gravity, group=group, unknown_orientation=unknown_orientation, method=method)
    if out is not None:
        check_writable(out, overwrite)
    options = _position_options(
        method=method,
        gauge=gauge,
        control=control,
        linear_form=linear_form,
        linear_gauge=linear_gauge,
        linear_solver=linear_solver,
        vertical_axis=vertical_axis,
        max_iterations=max_iterations,
        threads=threads,
        split_parts=not no_split,
    )
    with terminal.working("reading"):
        problem = with_sigma(read_problem(tracks, orientations), sigma_deg)
    moves = None
    if motion is not None:
        moves = motion_of(motion, static, group=group, refine_orientations=refine_orientation, tracks=problem.tracks)
    begin = time.perf_counter()
    with terminal.working("solving"):
        if moves is not None:
            scene = solve_moves(problem, options, moves)
        elif unknown_orientation or refine_orientation:
            up = None if gravity is None else read_vectors(gravity, problem.tracks)
            scene = reconstruct(problem, options, up, unknown=unknown_orientation)
        else:
            scene = solve_positions(problem.tracks, problem.cam_from_world, options)
    seconds = time.perf_counter() - begin
    found: OrientationModel = "known"
    if unknown_orientation or refine_orientation:
        found = "free" if gravity is None else "vertical"
    certificate = certified(terminal, scene, CertifyOptions(orientation=found, threads=threads))
    pictures = False
    if out is not None:
        with terminal.working("writing"):
            drawing = None if no_plots else Drawing(terminal)
            pictures = write_folder(scene, certificate, out, options, overwrite, drawing)
    plain = summary_dict(scene.summary) | {
        "certificate": brief(certificate, scene),
        **({} if scene.paths is None else {"paths": paths_dict(scene)}),
        "wall_s": seconds,
        "out": None if out is None else str(out),
    }
    terminal.answer(plain, lambda console: show_scene(console, scene, certificate, seconds, out, pictures))
    if not scene.summary.status.is_determined:
        raise typer.Exit(EXIT_UNDETERMINED)


def _check_motion(
    motion: str | None,
    static: str | None,
    gravity: Path | None,
    *,
    group: bool,
    unknown_orientation: bool,
    method: Method,
) -> None:
    """Refuse what does not go together, before anything is read."""
    if motion is None:
        for name, given in (("--static", static is not None), ("--group", group)):
            if given:
                raise InputError(f"{name} tells nothing where everything is at rest, expected --motion")
        return
    form_of(motion)
    if unknown_orientation or gravity is not None:
        raise InputError("--motion needs orientations that are known, or about right (--refine)")
    if method != "robust":
        raise InputError(f"--motion goes with --method robust, but --method is {method}")


def solve_moves(problem: Problem, options: PositionOptions, motion: Motion) -> Scene:
    """Cameras, points at rest and paths, and in words what stays free."""
    rotations = problem.cam_from_world
    if motion.refine_orientations and rotations is None:
        rotations = no_turns(problem.tracks)
    scene = solve_positions(problem.tracks, rotations, options, motion=motion)
    if scene.paths is None or scene.paths.freedoms or not scene.summary.status.is_determined:
        return scene
    found = certify_paths(problem.tracks, scene, FreedomOptions(threads=options.threads))
    words = found.words(scene.view_labels(), scene.track_labels())
    return replace(scene, paths=replace(scene.paths, freedoms=words))


def no_turns(tracks: Tracks) -> Float:
    """Orientations of cameras that are not turned."""
    return np.zeros(tracks.n_views) if tracks.d == 2 else np.tile(np.eye(3), (tracks.n_views, 1, 1))


def reconstruct(problem: Problem, options: PositionOptions, up: Float | None, *, unknown: bool) -> Scene:
    """Orientations unknown, or free to move; known positions fit the result, turned too."""
    tracks = problem.tracks
    rotations = None if unknown else problem.cam_from_world
    if not unknown and rotations is None:
        rotations = no_turns(tracks)
    plain = replace(options, gauge="normalized" if options.gauge == "control" else options.gauge, control=None)
    steps = ReconstructOptions(
        positions=plain,
        refine=RefineOptions(
            max_iterations=options.max_iterations, linear_solver=options.linear_solver, threads=options.threads
        ),
    )
    scene = reconstruct_tracks(tracks, rotations, gravity=up, options=steps)
    return scene if options.control is None else fit_to_control(scene, options.control)


def _position_options(*, gauge: Gauge | None, control: Path | None, **choices: Any) -> PositionOptions:
    """Build the options; a control file asks for its gauge by being there."""
    if choices["max_iterations"] is None:
        del choices["max_iterations"]
    if control is None:
        return PositionOptions(gauge=gauge or "normalized", **choices)
    if gauge not in (None, "control"):
        raise InputError(f"--control asks for --gauge control, but --gauge is {gauge}")
    return PositionOptions(gauge="control", control=read_control(control), **choices)


def with_sigma(problem: Problem, sigma_deg: float | None) -> Problem:
    """Give the bearings an accuracy where the file gives none."""
    if sigma_deg is None or problem.tracks.sigma_rad is not None:
        return problem
    sigma_rad = np.full(len(problem.tracks), sigma_of(sigma_deg))
    return replace(problem, tracks=replace(problem.tracks, sigma_rad=sigma_rad), scene=None)
