"""The command line: parse, call, print. Degrees here, radians inside.

Answers go to standard output, progress and complaints to standard error.
"""

from __future__ import annotations

import contextlib
import inspect
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from panopath import _core
from panopath.certificate import Certificate, OrientationModel, Verdict
from panopath.certificate_text import (
    Names,
    cause_lines,
    consistency_lines,
    hinge_lines,
    looseness_lines,
    mode_lines,
    percent,
    spectrum_lines,
)
from panopath.evaluate import Alignment, Evaluation, evaluate
from panopath.formats import (
    Database,
    read_certificate,
    read_control,
    read_database,
    read_problem,
    read_scene,
    read_truth,
    write_certificate,
    write_models,
    write_scene,
    write_tracks,
)
from panopath.formats.colmap import find_model
from panopath.formats.csv import Form, read_vectors, write_orientations
from panopath.formats.folder import check_certificate_writable, check_writable, is_scene_folder
from panopath.formats.models import check_model_folder
from panopath.formats.parquet import write_parquet
from panopath.formats.structure import known_scene
from panopath.mapping import MapOptions, map_database
from panopath.model import (
    Float,
    Gauge,
    InputError,
    LinearForm,
    LinearGauge,
    LinearSolver,
    Method,
    MissingExtraError,
    PanopathError,
    PositionOptions,
    Problem,
    Scene,
    Status,
    Tracks,
    summary_dict,
)
from panopath.pipeline import ReconstructOptions, fit_to_control, reconstruct_tracks
from panopath.report import draw_certificate, draw_scene
from panopath.steps import CertifyOptions, RefineOptions, certify, position_covariance, solve_positions
from panopath.synthetic import SyntheticWorld, WorldName, simulate

EXIT_INPUT = 2
EXIT_UNDETERMINED = 3
_EXIT_HELP = "Exit codes: 0 success; 2 unusable input or command; 3 the input does not determine the scene."
_MOST_ROWS = 12
#: What --set may not set, as an option of its own does.
_OWN_OPTIONS = {
    "world": "WORLD",
    "n_views": "--views",
    "n_points": "--points",
    "seed": "--seed",
    "dimension": "--dimension",
    "noise_rad": "--noise-deg",
    "outlier_fraction": "--outliers",
    "orientation_error_rad": "--orientation-error-deg",
    "orientations": "--camera-frame",
}
_STATUS_TEXT = {
    Status.CONVERGED: "converged",
    Status.MAX_ITERATIONS: "stopped at the limit of iterations; the scene may still move",
    Status.AMBIGUOUS: "ambiguous: the bearings leave more free than shift and scale",
    Status.DISCONNECTED: "solved in parts that share no scale: positions of different parts cannot be compared",
    Status.UNDETERMINED: "undetermined: the bearings fix no part of the scene",
}

app = typer.Typer(
    name="panopath",
    help="From the bearings of an omni-directional camera to its path and the space around it.",
    epilog=_EXIT_HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Tell all: parts, hinges, causes, modes, noise.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but complaints.")]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Write over what is there though panopath did not make it.")
]
NoPlots = Annotated[bool, typer.Option("--no-plots", help="Draw no pictures.")]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; ends by ``SystemExit`` with one of the exit codes.

    What a user got wrong becomes one line; an error of ours keeps its traceback.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        app(given, prog_name="panopath")
    except PanopathError as error:
        line = " ".join(str(error).split())
        if "--json" in given:
            sys.stdout.write(json.dumps({"error": line}) + "\n")
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"panopath: {line}", markup=False)
        sys.exit(EXIT_INPUT)
    except BrokenPipeError:
        # whoever read our output has seen enough; keep the interpreter from complaining when it closes the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False) -> None:
    if version:
        typer.echo(f"panopath {_core.__version__}")
        raise typer.Exit


@dataclass(frozen=True)
class _Terminal:
    """Where a command speaks: its answer to standard output, everything else to standard error."""

    as_json: bool
    quiet: bool

    @contextlib.contextmanager
    def working(self, what: str) -> Iterator[None]:
        """Show that something long is under way, and how long it took."""
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        if self.quiet or self.as_json or not console.is_terminal:
            yield
            return
        begin = time.perf_counter()
        with console.status(f"{what} ..."):
            yield
        console.print(f"[dim]{what}: {time.perf_counter() - begin:.2f} s[/dim]")

    def warn(self, text: str) -> None:
        """Say something that a person should know, on standard error."""
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"panopath: {text}", markup=False)

    def answer(self, plain: dict[str, Any], show: Callable[[Console], None]) -> None:
        """Give the answer: as JSON, or as ``show`` prints it, or not at all."""
        if self.as_json:
            sys.stdout.write(json.dumps(plain) + "\n")
        elif not self.quiet:
            show(Console(highlight=False, soft_wrap=True))


@app.command(epilog=_EXIT_HELP)
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
    overwrite: Overwrite = False,
    no_plots: NoPlots = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Find camera positions and points from bearings.

    Bearings are directions in the world unless --orientations, or the file itself, says how each view is turned, or
    --unknown-orientation that nobody knows.
    """
    terminal = _Terminal(as_json, quiet)
    if unknown_orientation and (orientations is not None or refine_orientation):
        raise InputError("--unknown-orientation leaves no place for --orientations or --refine")
    if gravity is not None and not (unknown_orientation or refine_orientation):
        raise InputError(
            "--gravity tells nothing new of known orientations, expected --unknown-orientation or --refine"
        )
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
        problem = _with_sigma(read_problem(tracks, orientations), sigma_deg)
    begin = time.perf_counter()
    with terminal.working("solving"):
        if unknown_orientation or refine_orientation:
            up = None if gravity is None else read_vectors(gravity, problem.tracks)
            scene = _reconstruct(problem, options, up, unknown=unknown_orientation)
        else:
            scene = solve_positions(problem.tracks, problem.cam_from_world, options)
    seconds = time.perf_counter() - begin
    found: OrientationModel = "known"
    if unknown_orientation or refine_orientation:
        found = "free" if gravity is None else "vertical"
    certificate = _certify(terminal, scene, CertifyOptions(orientation=found, threads=threads))
    pictures = False
    if out is not None:
        with terminal.working("writing"):
            drawing = None if no_plots else _Drawing(terminal)
            pictures = _write(scene, certificate, out, options, overwrite, drawing)
    plain = summary_dict(scene.summary) | {
        "certificate": _brief(certificate, scene),
        "wall_s": seconds,
        "out": None if out is None else str(out),
    }
    terminal.answer(plain, lambda console: _show_scene(console, scene, certificate, seconds, out, pictures))
    if not scene.summary.status.is_determined:
        raise typer.Exit(EXIT_UNDETERMINED)


def _certify(terminal: _Terminal, scene: Scene, options: CertifyOptions) -> Certificate:
    """Certify a scene that holds its observations."""
    if scene.tracks is None:
        raise InputError("the scene holds no observations, expected some to certify it by")
    with terminal.working("certifying"):
        return certify(scene.tracks, scene, options)


def _brief(certificate: Certificate, scene: Scene) -> dict[str, Any]:
    """Pick what other answers tell of a certificate."""
    return {
        "verdict": certificate.verdict.value,
        "is_determined": certificate.is_determined,
        "sentence": certificate.sentence(scene.view_labels(), scene.track_labels()),
        "nullity": int(certificate.nullity),
        "gauge_freedoms": int(certificate.gauge_freedoms),
    }


def _reconstruct(problem: Problem, options: PositionOptions, up: Float | None, *, unknown: bool) -> Scene:
    """Orientations unknown, or free to move; known positions fit the result, turned too."""
    tracks = problem.tracks
    rotations = None if unknown else problem.cam_from_world
    if not unknown and rotations is None:
        rotations = np.zeros(tracks.n_views) if tracks.d == 2 else np.tile(np.eye(3), (tracks.n_views, 1, 1))
    plain = replace(options, gauge="normalized" if options.gauge == "control" else options.gauge, control=None)
    steps = ReconstructOptions(
        positions=plain,
        refine=RefineOptions(
            max_iterations=options.max_iterations, linear_solver=options.linear_solver, threads=options.threads
        ),
    )
    scene = reconstruct_tracks(tracks, rotations, gravity=up, options=steps)
    return scene if options.control is None else fit_to_control(scene, options.control)


@app.command("map", epilog=_EXIT_HELP)
def map_command(
    database: Annotated[Path, typer.Argument(help="COLMAP database with features and matches.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the models: OUT/0 is the largest.")],
    *,
    min_num_matches: Annotated[int, typer.Option(min=1, help="Leave out pairs with fewer matches.")] = 15,
    min_track_length: Annotated[int, typer.Option(min=2, help="Fewest images that see a point.")] = 2,
    max_epipolar_error: Annotated[float, typer.Option(help="Largest angle of a match to its plane, in pixels.")] = 4.0,
    max_partners: Annotated[int, typer.Option(min=1, help="Pairs to orient, for each view.")] = 12,
    random_seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    use_prior_position: Annotated[
        bool, typer.Option("--use-prior-position", help="Put the model where the database's positions say.")
    ] = False,
    no_gravity: Annotated[bool, typer.Option("--no-gravity", help="Pass over directions of gravity.")] = False,
    no_rigs: Annotated[
        bool, typer.Option("--no-rigs", help="Pass over rigs: each image has a pose of its own.")
    ] = False,
    trust_focal_lengths: Annotated[
        bool, typer.Option("--trust-focal-lengths", help="Take guessed focal lengths as if they were known.")
    ] = False,
    no_retriangulation: Annotated[
        bool, typer.Option("--no-retriangulation", help="Leave tracks as they were joined at first.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Write over models that are there.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Orient and place the images of a COLMAP database; write models that COLMAP's tools open.

    Cameras must be calibrated: intrinsics are taken as they are.
    """
    terminal = _Terminal(as_json, quiet)
    check_model_folder(out, overwrite)
    check_certificate_writable(out)
    options = MapOptions(
        min_num_matches=min_num_matches,
        min_track_length=min_track_length,
        max_epipolar_error_px=max_epipolar_error,
        max_partners=max_partners,
        seed=random_seed,
        use_prior_position=use_prior_position,
        use_gravity=not no_gravity,
        retriangulate=not no_retriangulation,
    )
    begin = time.perf_counter()
    with terminal.working("reading"):
        found = read_database(database, trust_focal_lengths=trust_focal_lengths, use_rigs=not no_rigs)
    with terminal.working("mapping"):
        mapped = map_database(found, options)
    scene = mapped.scene
    models: list[Path] = []
    certificate: Certificate | None = None
    if scene.summary.n_solved_views:
        certificate = _certified_map(terminal, found, scene)
        with terminal.working("writing"):
            models = write_models(found, mapped.reconstruction, out)
            if certificate is not None:
                write_certificate(certificate, scene, out)
    seconds = time.perf_counter() - begin
    registered = int((mapped.reconstruction.component >= 0).sum())
    plain = summary_dict(scene.summary) | {
        "n_images": found.n_images,
        "n_registered": registered,
        "models": [str(path) for path in models],
        "certificate": None if certificate is None else _brief(certificate, scene),
        "wall_s": seconds,
    }
    terminal.answer(
        plain, lambda console: _show_models(console, scene, certificate, registered, found.n_images, models, seconds)
    )
    if not scene.summary.status.is_determined:
        raise typer.Exit(EXIT_UNDETERMINED)


def _certified_map(terminal: _Terminal, database: Database, scene: Scene) -> Certificate | None:
    """Certify a mapped scene; bearings of a rig start beside its centre, of which the certificate knows nothing."""
    if database.has_rigs and np.any(database.center_in_rig):
        return None
    return _certify(terminal, scene, CertifyOptions(orientation="free"))


@app.command("simulate", epilog=_EXIT_HELP)
def simulate_command(
    world: Annotated[WorldName, typer.Argument(help="Which world.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Bearings to write: .csv, .csv.gz or .parquet.")],
    *,
    views: Annotated[int, typer.Option(min=1, help="Number of views.")] = 100,
    points: Annotated[int, typer.Option(min=1, help="Number of points.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    dimension: Annotated[int | None, typer.Option(min=2, max=3, help="2: in the plane, 3: in space.")] = None,
    noise_deg: Annotated[float, typer.Option(min=0.0, help="Angular noise, one standard deviation.")] = 0.0,
    outliers: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of bearings that are wrong.")] = 0.0,
    orientation_error_deg: Annotated[float, typer.Option(min=0.0, help="Error of the orientations told.")] = 0.0,
    camera_frame: Annotated[
        bool,
        typer.Option("--camera-frame", help="Turn the cameras at random; write bearings in them, and orientations."),
    ] = False,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="Any other option of panopath.simulate, as name=value; repeat.")
    ] = None,
    form: Annotated[Form, typer.Option(help="How CSV writes directions.")] = "xyz",
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Make the bearings of a synthetic world, and beside them its truth.

    For F.csv the truth is the folder F.truth, which `panopath evaluate` takes; --camera-frame adds F.orientations.csv.
    """
    terminal = _Terminal(as_json, quiet)
    stem = out.name.removesuffix(".gz").removesuffix(".csv").removesuffix(".parquet")
    truth_folder = out.with_name(f"{stem}.truth")
    orientations = out.with_name(f"{stem}.orientations.csv")
    for path in (out, orientations) if camera_frame else (out,):
        if path.exists() and not overwrite:
            raise InputError(f"{path}: is there already; name another file or ask for --overwrite")
    check_writable(truth_folder, overwrite)
    options = _settings(setting or [])
    if dimension is not None:
        options["dimension"] = dimension
    with terminal.working("simulating"):
        made = simulate(
            world,
            n_views=views,
            n_points=points,
            seed=seed,
            noise_rad=float(np.radians(noise_deg)),
            outlier_fraction=outliers,
            orientation_error_rad=float(np.radians(orientation_error_deg)),
            orientations="random" if camera_frame else "identity",
            **options,
        )
    with terminal.working("writing"):
        out.parent.mkdir(parents=True, exist_ok=True)
        if camera_frame:
            write_orientations(made.cam_from_world, made.tracks.view_labels(), orientations)
        told = made.tracks if camera_frame else made.tracks.to_world(made.cam_from_world)
        _write_bearings(told, out, form)
        truth = known_scene(made.tracks, made.cam_from_world, made.centers, made.points, ~made.outlier)
        write_scene(truth, truth_folder, overwrite=overwrite)
    plain = {
        "out": str(out),
        "truth": str(truth_folder),
        "orientations": str(orientations) if camera_frame else None,
        "n_views": told.n_views,
        "n_tracks": told.n_tracks,
        "n_observations": len(told),
        "n_outliers": int(made.outlier.sum()),
    }
    terminal.answer(plain, lambda console: _show_files(console, plain))


@app.command(epilog=_EXIT_HELP)
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
    terminal = _Terminal(as_json, quiet)
    if out is not None:
        check_certificate_writable(out)
    sigma_rad = None if sigma_deg is None else _sigma_rad(sigma_deg)
    scene, model = _scene_to_check(terminal, source, orientations, orientation, sigma_deg, threads)
    begin = time.perf_counter()
    certificate = _certify(terminal, scene, CertifyOptions(orientation=model, sigma_rad=sigma_rad, threads=threads))
    seconds = time.perf_counter() - begin
    if out is not None:
        with terminal.working("writing"):
            _write_certificate(certificate, scene, out, None if no_plots else _Drawing(terminal))
    names = Names(scene.view_labels(), scene.track_labels())
    plain = certificate.to_dict(names.views, names.tracks) | {
        "lines": certificate.explain(names.views, names.tracks, (scene.centers, scene.points)),
        "wall_s": seconds,
        "out": None if out is None else str(out),
    }
    terminal.answer(plain, lambda console: _show_certificate(console, certificate, scene, names, verbose))
    if not certificate.is_determined:
        raise typer.Exit(EXIT_UNDETERMINED)


def _scene_to_check(  # noqa: PLR0917 (what the command line says of it, all of it)
    terminal: _Terminal,
    source: Path,
    orientations: Path | None,
    orientation: OrientationModel | None,
    sigma_deg: float | None,
    threads: int | None,
) -> tuple[Scene, OrientationModel]:
    """Read the scene, or solve the bearings; and tell what was known of orientations."""
    if source.is_dir() and orientations is None:
        with terminal.working("reading"):
            scene = _judged(source)
        return scene, _dimension_fits(orientation or _model_of(source), scene.d)
    with terminal.working("reading"):
        problem = _with_sigma(read_problem(source, orientations), sigma_deg)
    model = _dimension_fits(orientation or "known", problem.tracks.d)
    options = PositionOptions(threads=threads)
    with terminal.working("solving"):
        if model == "known":
            return _solved_whole(problem, options), model
        up = _upward(problem) if model == "vertical" else None
        return _reconstruct(problem, options, up, unknown=problem.cam_from_world is None), model


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


def _write_certificate(certificate: Certificate, scene: Scene, out: Path, drawing: _Drawing | None) -> None:
    write_certificate(certificate, scene, out)
    if drawing is not None:
        try:
            draw_certificate(scene, certificate, out)
        except MissingExtraError as error:
            drawing.terminal.warn(str(error))


@app.command("evaluate", epilog=_EXIT_HELP)
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
    terminal = _Terminal(as_json, quiet)
    scene = _judged(out)
    result = evaluate(scene, read_truth(truth, scene), alignment, trim)
    terminal.answer(result.to_dict(), lambda console: _show_evaluation(console, result))


def _judged(folder: Path) -> Scene:
    """Read the scene of a folder that panopath wrote, or of a COLMAP model such as `panopath map` writes."""
    if is_scene_folder(folder) or not folder.is_dir() or find_model(folder) is None:
        return read_scene(folder)
    scene = read_problem(folder).scene
    if scene is None:
        raise InputError(f"{folder}: the model has no points")
    return scene


@app.command(epilog=_EXIT_HELP)
def demo(
    *,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write to.")] = Path("panopath-demo"),
    views: Annotated[int, typer.Option(min=3, help="Number of views, 1 m apart.")] = 100,
    points: Annotated[int, typer.Option(min=10, help="Number of points.")] = 10_000,
    noise_deg: Annotated[float, typer.Option(min=0.0, help="Angular noise, one standard deviation.")] = 0.05,
    outliers: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of bearings that are wrong.")] = 0.2,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 1,
    overwrite: Overwrite = False,
    no_plots: NoPlots = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a street walk with noise and outliers, solve it, and compare with the truth. Needs no download."""
    terminal = _Terminal(as_json, quiet)
    check_writable(out, overwrite)
    with terminal.working("simulating"):
        world = simulate(
            "street",
            n_views=views,
            n_points=points,
            seed=seed,
            outlier_fraction=outliers,
            noise_rad=float(np.radians(noise_deg)),
        )
    begin = time.perf_counter()
    with terminal.working("solving"):
        scene = solve_positions(world.tracks)
    seconds = time.perf_counter() - begin
    result = evaluate(scene, world, "translation_scale")
    with terminal.working("finding the best that is possible"):
        expected = _expected_rms(world)
    in_metres = replace(scene, centers=result.aligned_centers, points=result.aligned_points)
    certificate = _certify(terminal, in_metres, CertifyOptions())
    with terminal.working("writing"):
        drawing = None if no_plots else _Drawing(terminal, world.centers, "m")
        pictures = _write(in_metres, certificate, out, PositionOptions(), overwrite, drawing)
    plain = (
        summary_dict(scene.summary)
        | result.to_dict()
        | {"certificate": _brief(certificate, in_metres), "expected_camera_rms": expected}
        | {"wall_s": seconds, "out": str(out)}
    )
    terminal.answer(
        plain,
        lambda console: _show_demo(console, in_metres, certificate, world, result, expected, seconds, out, pictures),
    )
    if not scene.summary.status.is_determined:
        raise typer.Exit(EXIT_UNDETERMINED)


def _position_options(*, gauge: Gauge | None, control: Path | None, **choices: Any) -> PositionOptions:
    """Build the options; a control file asks for its gauge by being there."""
    if choices["max_iterations"] is None:
        del choices["max_iterations"]
    if control is None:
        return PositionOptions(gauge=gauge or "normalized", **choices)
    if gauge not in (None, "control"):
        raise InputError(f"--control asks for --gauge control, but --gauge is {gauge}")
    return PositionOptions(gauge="control", control=read_control(control), **choices)


def _with_sigma(problem: Problem, sigma_deg: float | None) -> Problem:
    if sigma_deg is None or problem.tracks.sigma_rad is not None:
        return problem
    sigma_rad = np.full(len(problem.tracks), _sigma_rad(sigma_deg))
    return replace(problem, tracks=replace(problem.tracks, sigma_rad=sigma_rad), scene=None)


def _sigma_rad(sigma_deg: float) -> float:
    if not (np.isfinite(sigma_deg) and sigma_deg > 0.0):
        raise InputError(f"--sigma-deg is {sigma_deg}, expected a positive number")
    return float(np.radians(sigma_deg))


@dataclass(frozen=True)
class _Drawing:
    """What pictures need beside the scene."""

    terminal: _Terminal
    truth: Float | None = None
    unit: str = ""


def _write(  # noqa: PLR0917 (what is written, and how)
    scene: Scene,
    certificate: Certificate,
    out: Path,
    options: PositionOptions,
    overwrite: bool,
    drawing: _Drawing | None,
) -> bool:
    """Write the folder; the pictures belong to it where matplotlib is there. Returns whether they do."""
    drawn = False

    def draw(folder: Path) -> None:
        nonlocal drawn
        if drawing is not None:
            try:
                draw_scene(scene, folder, drawing.truth, drawing.unit)
                draw_certificate(scene, certificate, folder, drawing.unit)
                drawn = True
            except MissingExtraError as error:
                drawing.terminal.warn(str(error))

    write_scene(scene, out, options=options, overwrite=overwrite, extra=draw, certificate=certificate)
    return drawn


def _write_bearings(tracks: Tracks, path: Path, form: Form) -> None:
    if path.suffix == ".parquet":
        write_parquet(tracks, path)
    else:
        write_tracks(tracks, path, form)


def _settings(texts: Sequence[str]) -> dict[str, Any]:
    """Read ``name=value`` pairs: numbers as numbers, ``a,b`` as a pair, the rest as text."""
    found: dict[str, Any] = {}
    for text in texts:
        name, mark, value = text.partition("=")
        if not mark:
            raise InputError(f"--set {text!r}: expected name=value")
        if name in _OWN_OPTIONS:
            raise InputError(f"--set {name}: use {_OWN_OPTIONS[name]}")
        if name not in inspect.signature(simulate).parameters:
            raise InputError(f"--set {name}: panopath.simulate has no such option")
        parts = [_number_or_text(part) for part in value.split(",")]
        found[name] = parts[0] if len(parts) == 1 else tuple(parts)
    return found


def _number_or_text(text: str) -> Any:
    for read in (int, float):
        with contextlib.suppress(ValueError):
            return read(text)
    return text


def _expected_rms(world: SyntheticWorld) -> float:
    """Root mean square camera error of the best estimator, told which bearings are wrong (Cramer-Rao)."""
    if world.noise_rad <= 0.0:
        return 0.0
    tracks = replace(world.tracks, sigma_rad=np.full(len(world.tracks), world.noise_rad))
    covariance = position_covariance(tracks, (world.centers, world.points), inlier=~world.outlier)
    return float(np.sqrt(np.nanmean(np.trace(covariance, axis1=1, axis2=2))))


def _show_scene(  # noqa: PLR0917 (prints what was found, all of it)
    console: Console, scene: Scene, certificate: Certificate, seconds: float, out: Path | None, pictures: bool
) -> None:
    console.print(_parts_table(scene))
    summary = scene.summary
    console.print(f"{_STATUS_TEXT[summary.status]}; {summary.iterations} iterations, {seconds:.2f} s", markup=False)
    if np.isfinite(summary.sigma_rad):
        console.print(f"accuracy of a bearing: {np.degrees(summary.sigma_rad):.4g} degrees")
    left = (summary.n_views - summary.n_solved_views, summary.n_tracks - summary.n_solved_points)
    if any(left):
        console.print(f"not determined: {left[0]:,} views and {left[1]:,} points")
    _show_sentence(console, certificate, scene)
    if out is None:
        console.print("nothing was written; -o FOLDER writes the scene")
    else:
        console.print(
            f"written to {out}" + (" (look at views.png, errors.png and certificate.png)" if pictures else ""),
            markup=False,
        )


def _show_sentence(console: Console, certificate: Certificate, scene: Scene) -> None:
    """Summarise a certificate in one line, among other answers."""
    told = certificate.sentence(scene.view_labels(), scene.track_labels())
    console.print(f"certificate: {told}", markup=False)


def _show_certificate(console: Console, certificate: Certificate, scene: Scene, names: Names, verbose: bool) -> None:
    console.print(certificate.sentence(names.views, names.tracks), markup=False)
    for line in consistency_lines(certificate):
        console.print(line, markup=False)
    if not verbose:
        return
    if certificate.components:
        console.print(_certified_parts(certificate))
    details = [
        *spectrum_lines(certificate),
        *hinge_lines(certificate, names),
        *cause_lines(certificate, names),
        *mode_lines(certificate, names, (scene.centers, scene.points)),
        *looseness_lines(certificate, names),
    ]
    for line in details:
        console.print(line, markup=False)


def _certified_parts(certificate: Certificate) -> Table:
    table = Table(header_style="bold")
    for name in ("part", "verdict", "views", "points", "observations", "moved by noise"):
        table.add_column(name, justify="left" if name == "verdict" else "right")
    for number, part in enumerate(certificate.components[:_MOST_ROWS], 1):
        counts = (len(part.views), len(part.tracks), part.n_observations)
        moved = "-" if part.verdict is Verdict.UNDETERMINED else percent(part.weakest_movement)
        table.add_row(str(number), part.verdict.value, *(f"{n:,}" for n in counts), moved)
    left = len(certificate.components) - _MOST_ROWS
    if left > 0:
        table.add_row("...", "", f"{left:,} more", "", "", "")
    return table


def _show_models(  # noqa: PLR0917 (prints what was found, all of it)
    console: Console,
    scene: Scene,
    certificate: Certificate | None,
    registered: int,
    n_images: int,
    models: Sequence[Path],
    seconds: float,
) -> None:
    console.print(_parts_table(scene))
    console.print(f"{_STATUS_TEXT[scene.summary.status]}; {registered:,} of {n_images:,} images, {seconds:.2f} s")
    if np.isfinite(scene.summary.sigma_rad):
        console.print(f"accuracy of a feature: {np.degrees(scene.summary.sigma_rad):.4g} degrees")
    if certificate is not None:
        _show_sentence(console, certificate, scene)
    elif models:
        console.print("no certificate: the bearings of a rig start beside its centre")
    for path in models:
        console.print(f"model: {path}", markup=False)
    if not models:
        console.print("no image could be placed; nothing was written")


def _parts_table(scene: Scene) -> Table:
    table = Table(header_style="bold")
    for name in ("part", "views", "points", "observations", "outliers", "angular rms"):
        table.add_column(name, justify="right")
    rows = [_part_row(scene, component) for component in range(scene.n_components)]
    order = sorted(range(len(rows)), key=lambda c: (-rows[c][0], c))
    for component in order[:_MOST_ROWS]:
        table.add_row(str(component + 1), *_cells(rows[component]))
    if len(rows) > _MOST_ROWS:
        table.add_row("...", f"{len(rows) - _MOST_ROWS} more", "", "", "", "")
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


def _show_files(console: Console, plain: dict[str, Any]) -> None:
    console.print(
        f"{plain['n_observations']:,} observations of {plain['n_tracks']:,} points by {plain['n_views']:,} views, "
        f"{plain['n_outliers']:,} of them wrong"
    )
    for name in ("out", "orientations", "truth"):
        if plain[name] is not None:
            console.print(f"{'bearings' if name == 'out' else name}: {plain[name]}", markup=False)
    told = f" --orientations {plain['orientations']}" if plain["orientations"] else ""
    console.print(
        f"next: panopath solve {plain['out']}{told} -o OUT && panopath evaluate OUT {plain['truth']}", markup=False
    )


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


def _show_demo(  # noqa: PLR0917 (prints what was found, all of it)
    console: Console,
    scene: Scene,
    certificate: Certificate,
    world: SyntheticWorld,
    result: Evaluation,
    expected: float,
    seconds: float,
    out: Path,
    pictures: bool,
) -> None:
    console.print(
        f"A street walk: {world.tracks.n_views:,} views 1 m apart, {world.tracks.n_tracks:,} points, noise "
        f"{np.degrees(world.noise_rad):g} degrees, {100.0 * float(world.outlier.mean()):.1f} % of the bearings wrong."
    )
    _show_scene(console, scene, certificate, seconds, out, pictures)
    found = scene.inlier
    missed = int((found & world.outlier).sum())
    lost = int((~found & ~world.outlier).sum())
    console.print(f"wrong bearings kept: {missed:,} of {int(world.outlier.sum()):,}; good ones dropped: {lost:,}")
    console.print(f"camera error against truth:     {1e3 * result.camera_rms:.4g} mm rms")
    if expected > 0.0:
        console.print(f"expected of the best estimator: {1e3 * expected:.4g} mm rms (Cramer-Rao bound)")
        ratio = result.camera_rms / expected
        console.print(f"ratio: {ratio:.2f} (single runs scatter around 1: a few slow bends of the path rule the error)")


if __name__ == "__main__":
    main()
