"""``panopath map``: the images of a COLMAP database."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from panopath.certificate import Certificate
from panopath.cli.app import EXIT_UNDETERMINED, AsJson, Quiet, Terminal
from panopath.cli.certifying import brief, certified
from panopath.cli.tables import STATUS_TEXT, parts_table, show_sentence
from panopath.formats import (
    Database,
    read_database,
    write_certificate,
    write_models,
)
from panopath.formats.folder import check_certificate_writable
from panopath.formats.models import check_model_folder
from panopath.mapping import MapOptions, map_database
from panopath.model import (
    Scene,
    summary_dict,
)
from panopath.steps import CertifyOptions


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
    terminal = Terminal(as_json, quiet)
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
        "certificate": None if certificate is None else brief(certificate, scene),
        "wall_s": seconds,
    }
    terminal.answer(
        plain, lambda console: _show_models(console, scene, certificate, registered, found.n_images, models, seconds)
    )
    if not scene.summary.status.is_determined:
        raise typer.Exit(EXIT_UNDETERMINED)


def _certified_map(terminal: Terminal, database: Database, scene: Scene) -> Certificate | None:
    """Certify a mapped scene; bearings of a rig start beside its centre, of which the certificate knows nothing."""
    if database.has_rigs and np.any(database.center_in_rig):
        return None
    return certified(terminal, scene, CertifyOptions(orientation="free"))


def _show_models(  # noqa: PLR0917 (prints what was found, all of it)
    console: Console,
    scene: Scene,
    certificate: Certificate | None,
    registered: int,
    n_images: int,
    models: Sequence[Path],
    seconds: float,
) -> None:
    console.print(parts_table(scene))
    console.print(f"{STATUS_TEXT[scene.summary.status]}; {registered:,} of {n_images:,} images, {seconds:.2f} s")
    if np.isfinite(scene.summary.sigma_rad):
        console.print(f"accuracy of a feature: {np.degrees(scene.summary.sigma_rad):.4g} degrees")
    if certificate is not None:
        show_sentence(console, certificate, scene)
    elif models:
        console.print("no certificate: the bearings of a rig start beside its centre")
    for path in models:
        console.print(f"model: {path}", markup=False)
    if not models:
        console.print("no image could be placed; nothing was written")
