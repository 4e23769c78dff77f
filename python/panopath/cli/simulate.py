"""``panopath simulate``: bearings of a synthetic world."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from panopath.cli.app import AsJson, Overwrite, Quiet, Terminal
from panopath.errors import InputError
from panopath.formats import (
    write_scene,
    write_tracks,
)
from panopath.formats.csv import Form, write_orientations
from panopath.formats.folder import check_writable
from panopath.formats.parquet import write_parquet
from panopath.formats.structure import known_scene
from panopath.model import Tracks
from panopath.synthetic import WorldName, simulate

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
    terminal = Terminal(as_json, quiet)
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
        paths = made.paths if made.moving.any() and not made.outlier[made.moving[made.tracks.track]].any() else None
        truth = known_scene(made.tracks, made.cam_from_world, made.centers, made.points, ~made.outlier, paths=paths)
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
