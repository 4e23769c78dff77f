"""What ``--motion`` and ``--static`` say: ``taylor:2``, ``fourier:2:omega=0.5``, ``spline:0,2,4,6``, ``auto``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from panopath.errors import InputError
from panopath.model import Tracks
from panopath.paths import Fourier, Motion, PathModel, Spline, Static, Taylor

_EXPECTED = "expected static, taylor:ORDER, fourier:ORDER[:omega=RAD_S], spline:TIME,TIME,...[:degree=K] or auto"


def motion_of(spec: str, static: str | None, *, group: bool, refine_orientations: bool, tracks: Tracks) -> Motion:
    """Read what the options say of motion.

    Parameters
    ----------
    spec
        The form of all paths, as ``--motion`` takes it.
    static
        Tracks known to be at rest, as ``--static`` takes them; None: nobody said.
    group
        Whether to find rigid bodies.
    refine_orientations
        Whether orientations are about right only.
    tracks
        The observations; views need times.

    Raises
    ------
    InputError
        Naming the option.
    """
    form = form_of(spec)
    if tracks.time_s is None:
        raise InputError("--motion needs the time of every view, but the bearings have no column time_s")
    known = () if static is None else static_tracks(static, tracks)
    return Motion(default=form, static=known, group=group, refine_orientations=refine_orientations)


def form_of(spec: str) -> PathModel | Literal["auto"]:
    """Read a form of path; angular frequencies are radians a second, times seconds."""
    kind, *given = spec.strip().split(":")
    try:
        if kind == "auto" and not given:
            return "auto"
        if kind == "static" and not given:
            return Static()
        if kind == "taylor" and len(given) == 1:
            return Taylor(int(given[0]))
        if kind == "fourier" and len(given) in (1, 2):
            omega = _value("omega", given[1]) if len(given) == 2 else None
            return Fourier(int(given[0]), omega)
        if kind == "spline" and len(given) in (1, 2):
            knots = tuple(float(text) for text in given[0].split(","))
            return Spline(knots, int(_value("degree", given[1]))) if len(given) == 2 else Spline(knots)
    except InputError as error:
        raise InputError(f"--motion {spec}: {error}") from None
    except ValueError:
        pass
    raise InputError(f"--motion is {spec!r}, {_EXPECTED}")


def _value(name: str, text: str) -> float:
    key, _, value = text.partition("=")
    if key != name:
        raise ValueError(text)
    number = float(value)
    if name == "degree" and number != int(number):
        raise ValueError(text)
    return number


def static_tracks(given: str, tracks: Tracks) -> tuple[int, ...]:
    """Read tracks (indices): names, or indices, between commas; or ``@FILE`` with one a line."""
    index_of = {} if tracks.track_names is None else {name: index for index, name in enumerate(tracks.track_names)}
    found: dict[int, None] = {}
    for where, name in _listed(given):
        index = index_of.get(name)
        if index is None and name.isdecimal() and int(name) < tracks.n_tracks:
            index = int(name)
        if index is None:
            raise InputError(f"{where} names the track {name!r}, which is not among the {tracks.n_tracks} tracks")
        found[index] = None
    if not found:
        raise InputError(f"--static {given!r} names no track, expected names or indices between commas, or @FILE")
    return tuple(found)


def _listed(given: str) -> list[tuple[str, str]]:
    """Where each entry stands, and what it is."""
    if not given.startswith("@"):
        return [("--static", name.strip()) for name in given.split(",") if name.strip()]
    path = Path(given[1:])
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text"
        raise InputError(f"--static {given}: cannot be read ({why})") from None
    return [(f"{path}:{number}:", line.strip()) for number, line in enumerate(lines, 1) if line.strip()]
