"""``panopath demo-bearings``: a walk simulated, solved and compared."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from panopath.certificate import Certificate
from panopath.cli.app import EXIT_UNDETERMINED, AsJson, NoPlots, Overwrite, Quiet, Terminal
from panopath.cli.certifying import Drawing, brief, certified, write_folder
from panopath.cli.tables import show_scene
from panopath.evaluate import Evaluation, evaluate
from panopath.formats.folder import check_writable
from panopath.model import (
    PositionOptions,
    Scene,
    summary_dict,
)
from panopath.steps import CertifyOptions, position_covariance, solve_positions
from panopath.synthetic import SyntheticWorld, simulate


def demo_bearings(
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
    terminal = Terminal(as_json, quiet)
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
    certificate = certified(terminal, in_metres, CertifyOptions())
    with terminal.working("writing"):
        drawing = None if no_plots else Drawing(terminal, world.centers, "m")
        pictures = write_folder(in_metres, certificate, out, PositionOptions(), overwrite, drawing)
    plain = (
        summary_dict(scene.summary)
        | result.to_dict()
        | {"certificate": brief(certificate, in_metres), "expected_camera_rms": expected}
        | {"wall_s": seconds, "out": str(out)}
    )
    terminal.answer(
        plain,
        lambda console: _show_demo(console, in_metres, certificate, world, result, expected, seconds, out, pictures),
    )
    if not scene.summary.status.is_determined:
        raise typer.Exit(EXIT_UNDETERMINED)


def _expected_rms(world: SyntheticWorld) -> float:
    """Root mean square camera error of the best estimator, told which bearings are wrong (Cramer-Rao)."""
    if world.noise_rad <= 0.0:
        return 0.0
    tracks = replace(world.tracks, sigma_rad=np.full(len(world.tracks), world.noise_rad))
    covariance = position_covariance(tracks, (world.centers, world.points), inlier=~world.outlier)
    return float(np.sqrt(np.nanmean(np.trace(covariance, axis1=1, axis2=2))))


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
    show_scene(console, scene, certificate, seconds, out, pictures)
    found = scene.inlier
    missed = int((found & world.outlier).sum())
    lost = int((~found & ~world.outlier).sum())
    console.print(f"wrong bearings kept: {missed:,} of {int(world.outlier.sum()):,}; good ones dropped: {lost:,}")
    console.print(f"camera error against truth:     {1e3 * result.camera_rms:.4g} mm rms")
    if expected > 0.0:
        console.print(f"expected of the best estimator: {1e3 * expected:.4g} mm rms (Cramer-Rao bound)")
        ratio = result.camera_rms / expected
        console.print(f"ratio: {ratio:.2f} (single runs scatter around 1: a few slow bends of the path rule the error)")
