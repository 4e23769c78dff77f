"""Certificates as commands make, write and show them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from panopath.certificate import Certificate, Verdict
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
from panopath.cli.app import Terminal
from panopath.cli.tables import MOST_ROWS
from panopath.errors import InputError, MissingExtraError
from panopath.formats import (
    write_certificate,
    write_scene,
)
from panopath.model import Float, PositionOptions, Scene
from panopath.report import ReportNotes, draw_certificate, draw_scene, write_report
from panopath.steps import CertifyOptions, certify


def certified(terminal: Terminal, scene: Scene, options: CertifyOptions) -> Certificate:
    """Certify a scene that holds its observations."""
    if scene.tracks is None:
        raise InputError("the scene holds no observations, expected some to certify it by")
    with terminal.working("certifying"):
        return certify(scene.tracks, scene, options)


def brief(certificate: Certificate, scene: Scene) -> dict[str, Any]:
    """Pick what other answers tell of a certificate."""
    return {
        "verdict": certificate.verdict.value,
        "is_determined": certificate.is_determined,
        "sentence": certificate.sentence(scene.view_labels(), scene.track_labels()),
        "nullity": int(certificate.nullity),
        "gauge_freedoms": int(certificate.gauge_freedoms),
    }


def write_checked(certificate: Certificate, scene: Scene, out: Path, drawing: Drawing | None) -> None:
    """Write what `check` found, with its picture where one can be drawn."""
    write_certificate(certificate, scene, out)
    if drawing is not None:
        try:
            draw_certificate(scene, certificate, out)
        except MissingExtraError as error:
            drawing.terminal.warn(str(error))


def sigma_of(sigma_deg: float) -> float:
    """Read --sigma-deg, in radians."""
    if not (np.isfinite(sigma_deg) and sigma_deg > 0.0):
        raise InputError(f"--sigma-deg is {sigma_deg}, expected a positive number")
    return float(np.radians(sigma_deg))


@dataclass(frozen=True)
class Drawing:
    """What pictures need beside the scene."""

    terminal: Terminal
    truth: Float | None = None
    unit: str = ""


def write_folder(  # noqa: PLR0917 (what is written, and how)
    scene: Scene,
    certificate: Certificate,
    out: Path,
    options: PositionOptions,
    overwrite: bool,
    drawing: Drawing | None,
) -> bool:
    """Write the folder; the pictures belong to it where matplotlib is there. Returns whether they do.

    Where bodies may move there is a report too: pictures do not move.
    """
    drawn = False

    def draw(folder: Path) -> None:
        nonlocal drawn
        if scene.paths is not None:
            unit = "" if drawing is None else drawing.unit
            notes = ReportNotes("Camera path, space and bodies that move", unit=unit)
            write_report(scene, certificate, folder / "report.html", settings=options.to_dict(), notes=notes)
        if drawing is not None:
            try:
                draw_scene(scene, folder, drawing.truth, drawing.unit)
                draw_certificate(scene, certificate, folder, drawing.unit)
                drawn = True
            except MissingExtraError as error:
                drawing.terminal.warn(str(error))

    write_scene(scene, out, options=options, overwrite=overwrite, extra=draw, certificate=certificate)
    return drawn


def show_certificate(console: Console, certificate: Certificate, scene: Scene, names: Names, verbose: bool) -> None:
    """Print the sentence and what contradicts it; all else where it is asked for."""
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
    for number, part in enumerate(certificate.components[:MOST_ROWS], 1):
        counts = (len(part.views), len(part.tracks), part.n_observations)
        moved = "-" if part.verdict is Verdict.UNDETERMINED else percent(part.weakest_movement)
        table.add_row(str(number), part.verdict.value, *(f"{n:,}" for n in counts), moved)
    left = len(certificate.components) - MOST_ROWS
    if left > 0:
        table.add_row("...", "", f"{left:,} more", "", "", "")
    return table
