"""Bearings, orientations and control positions as comma-separated text, plain or gzip.

A header is required; its columns say what is meant (``panopath.formats.columns``). Blanks around a name do not count.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from panopath import _core
from panopath.errors import InputError
from panopath.formats import columns
from panopath.formats.files import check_text, read_bytes, write_bytes
from panopath.model import Control, Float, Tracks

Form = Literal["xyz", "degrees", "radians", "compass"]

_QUATERNION = ("qw", "qx", "qy", "qz")
#: What a cell may hold only in quotes.
_SPECIAL = re.compile(r'[",\r\n]')
_HEADINGS = ("heading_deg", "compass_deg")
_FORM_COLUMNS: dict[str, tuple[str, ...]] = {
    "xyz": ("x", "y", "z"),
    "degrees": ("theta_deg", "phi_deg"),
    "radians": ("theta_rad", "phi_rad"),
    "compass": ("azimuth_deg", "elevation_deg"),
}


@dataclass(frozen=True)
class Table:
    """Columns of a file that was read, by name."""

    source: str
    names: dict[str, columns.NameColumn]
    numbers: dict[str, Float]
    lines: np.ndarray[tuple[int], np.dtype[np.int64]]

    def where(self, row: int) -> str:
        """Say where a row begins."""
        return f"line {self.lines[row]}"


def header_of(data: bytes, source: str) -> list[str]:
    """Column names of comma-separated text.

    Raises
    ------
    InputError
        Where the first line is not a header of several columns.
    """
    first = data.lstrip(b"\r\n").split(b"\n", 1)[0].rstrip(b"\r")
    try:
        text = first.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{source}: line 1 is not UTF-8 text, expected a header such as view,track,x,y,z") from None
    fields = next(csv.reader([text]), [])
    if len(fields) < 2:
        for mark, name in ((";", "semicolons"), ("\t", "tabs")):
            if mark in text:
                raise InputError(f"{source}: line 1: the columns are set apart by {name}, expected commas")
        raise InputError(f"{source}: line 1: found {text[:60]!r}, expected a header such as view,track,x,y,z")
    return columns.clean_header(fields, source)


def read_table(data: bytes, source: str, header: Sequence[str], roles: Sequence[str]) -> Table:
    """Read the columns whose role is not ``skip``.

    Raises
    ------
    InputError
        Naming file, line and column.
    """
    try:
        found, lines = _core.read_table(data, source, list(roles))
    except ValueError as error:
        raise InputError(str(error)) from None
    names = {name: column for name, column in zip(header, found, strict=True) if isinstance(column, tuple)}
    numbers = {name: column for name, column in zip(header, found, strict=True) if isinstance(column, np.ndarray)}
    return Table(source, names, numbers, lines)


def read_bearings(data: bytes, source: str) -> Tracks:
    """Read a bearings table; see ``panopath.formats.columns`` for the meaning of its columns.

    Raises
    ------
    InputError
        Naming file, line and column.
    """
    data = check_text(data, source)
    header = header_of(data, source)
    plan = columns.plan_columns(header, source)
    table = read_table(data, source, header, [plan.role(name) for name in header])
    return columns.tracks_from_columns(
        plan, table.names["view"], table.names["track"], table.numbers, columns.Place(source, table.where)
    )


def read_orientations(path: str | PathLike[str], tracks: Tracks) -> Float:
    """Read the orientation of each view of ``tracks``.

    The columns are ``view,qw,qx,qy,qz`` (a unit quaternion, cam_from_world), or ``view,heading_deg`` (anticlockwise,
    world_from_cam), or ``view,compass_deg`` (clockwise, for bearings whose y axis is ahead). A heading turns
    bearings in space about z.

    Returns
    -------
    array
        (n_views, 3, 3), or (n_views,) heading_rad for d = 2. A view without observations may be left out.

    Raises
    ------
    InputError
        Naming file, line and column.
    """
    source = str(path)
    data = check_text(read_bytes(Path(path)), source)
    header = header_of(data, source)
    if "view" not in header:
        raise InputError(f"{source}: the header has no column view (columns: {','.join(header)})")
    headings = [name for name in _HEADINGS if name in header]
    is_quaternion = all(name in header for name in _QUATERNION)
    if is_quaternion + len(headings) != 1:
        raise InputError(f"{source}: expected the columns view,qw,qx,qy,qz or view,heading_deg or view,compass_deg")
    if is_quaternion and tracks.d == 2:
        raise InputError(f"{source}: gives quaternions, but the bearings are planar; expected view,heading_deg")
    wanted = _QUATERNION if is_quaternion else tuple(headings)
    roles = ["name" if n == "view" else "number" if n in wanted else "skip" for n in header]
    table = read_table(data, source, header, roles)
    rows = _row_of_each_view(table, tracks)
    if is_quaternion:
        return _rotations(table, rows)
    sign = -1.0 if headings[0] == "compass_deg" else 1.0
    heading_rad = np.where(rows >= 0, sign * np.radians(table.numbers[headings[0]])[rows], 0.0)
    return heading_rad if tracks.d == 2 else _turned_about_z(heading_rad)


def read_vectors(path: str | PathLike[str], tracks: Tracks) -> Float:
    """Read a unit vector in the camera for each view that has one: columns ``view,x,y,z``, of any length but zero.

    Returns
    -------
    array
        (n_views, 3), NaN for views that the file does not name.

    Raises
    ------
    InputError
        Naming file, line and column.
    """
    source = str(path)
    data = check_text(read_bytes(Path(path)), source)
    header = header_of(data, source)
    wanted = ("x", "y", "z")
    if not {"view", *wanted} <= set(header):
        raise InputError(f"{source}: expected the columns view,x,y,z (columns: {','.join(header)})")
    roles = ["name" if n == "view" else "number" if n in wanted else "skip" for n in header]
    table = read_table(data, source, header, roles)
    codes, names = table.names["view"]
    index_of = {name: index for index, name in enumerate(tracks.view_labels())}
    vectors = np.stack([table.numbers[name] for name in wanted], axis=1)
    length = np.linalg.norm(vectors, axis=1)
    found = np.full((tracks.n_views, 3), np.nan)
    for row, code in enumerate(codes.tolist()):
        view = index_of.get(names[code], -1)
        if not (np.isfinite(length[row]) and length[row] > 0.0):
            raise InputError(f"{source}: {table.where(row)}: x,y,z is not a direction")
        if view >= 0:
            found[view] = vectors[row] / length[row]
    return found


def _row_of_each_view(table: Table, tracks: Tracks) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Row of each view's orientation, -1 for a view without observations that has none."""
    codes, names = table.names["view"]
    index_of = {name: index for index, name in enumerate(tracks.view_labels())}
    view_of_code = np.array([index_of.get(name, -1) for name in names], dtype=np.int64)
    rows = np.full(tracks.n_views, -1, dtype=np.int64)
    for row, view in enumerate(view_of_code[codes]):
        if view >= 0:
            if rows[view] >= 0:
                raise InputError(f"{table.source}: {table.where(row)}, column view: {names[codes[row]]} is given twice")
            rows[view] = row
    seen = np.zeros(tracks.n_views, dtype=bool)
    seen[tracks.view] = True
    missing = np.flatnonzero(seen & (rows < 0))
    if len(missing):
        name = tracks.view_labels()[missing[0]]
        raise InputError(f"{table.source}: has no orientation for view {name} ({len(missing)} views lack one)")
    return rows


def _rotations(table: Table, rows: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Float:
    quaternions = np.stack([table.numbers[name] for name in _QUATERNION], axis=1)
    length = np.linalg.norm(quaternions, axis=1)
    wrong = ~(np.abs(length - 1.0) < 1e-2)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{table.source}: {table.where(row)}, columns qw,qx,qy,qz: the length is {length[row]:.4g}, expected 1"
        )
    rotations = rotation_from_quaternion(quaternions / length[:, None])
    return np.where((rows >= 0)[:, None, None], rotations[rows], np.eye(3))


def rotation_from_quaternion(wxyz: Float) -> Float:
    """(n, 4) unit quaternions, scalar first, to (n, 3, 3) matrices."""
    w, x, y, z = wxyz.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def quaternion_from_rotation(rotation: Float) -> Float:
    """(n, 3, 3) matrices to (n, 4) unit quaternions, scalar first and not negative.

    Each is the longest column of ``4 q q^T``, which is never short: there is no case of lost digits.
    """
    m = rotation
    t = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    outer = np.empty((len(m), 4, 4))
    outer[:, 0, 0] = 1.0 + t
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        outer[:, i + 1, i + 1] = 1.0 + 2.0 * m[:, i, i] - t
        outer[:, 0, i + 1] = outer[:, i + 1, 0] = m[:, k, j] - m[:, j, k]
        outer[:, j + 1, k + 1] = outer[:, k + 1, j + 1] = m[:, j, k] + m[:, k, j]
    best = np.argmax(np.einsum("nii->ni", outer), axis=1)
    q: Float = outer[np.arange(len(m)), best]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(q[:, :1] < 0.0, -q, q)


def _turned_about_z(heading_rad: Float) -> Float:
    """``cam_from_world`` of level cameras turned by a heading."""
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    return np.stack([cos, sin, zero, -sin, cos, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)


def read_control(path: str | PathLike[str], rotation: bool = True) -> Control:
    """Read known positions: the columns ``view`` or ``track`` or both (one of them empty in each row), and ``x,y[,z]``.

    A row whose coordinates are all empty says nothing: ``cameras.csv`` and ``points.csv`` can be read.

    Raises
    ------
    InputError
        Naming file, line and column.
    """
    source = str(path)
    data = check_text(read_bytes(Path(path)), source)
    header = header_of(data, source)
    kinds = [name for name in ("view", "track") if name in header]
    axes = [name for name in ("x", "y", "z") if name in header]
    if not kinds or axes[:2] != ["x", "y"]:
        raise InputError(f"{source}: expected the columns view,x,y[,z] or track,x,y[,z] (columns: {','.join(header)})")
    roles = ["optional_name" if n in kinds else "optional" if n in axes else "skip" for n in header]
    table = read_table(data, source, header, roles)
    known: dict[str, dict[str | int, list[float]]] = {"view": {}, "track": {}}
    for row in range(len(table.lines)):
        given = [(kind, table.names[kind][1][table.names[kind][0][row]]) for kind in kinds]
        given = [(kind, name) for kind, name in given if name]
        if len(given) != 1:
            raise InputError(f"{source}: {table.where(row)}: names {len(given)} of view and track, expected one")
        kind, name = given[0]
        if name in known[kind]:
            raise InputError(f"{source}: {table.where(row)}, column {kind}: {name} is given twice")
        position = [float(table.numbers[axis][row]) for axis in axes]
        empty = [axis for axis, value in zip(axes, position, strict=True) if math.isnan(value)]
        if empty and len(empty) < len(axes):
            raise InputError(f"{source}: {table.where(row)}, column {empty[0]}: empty, expected a finite number")
        if not empty:
            known[kind][name] = position
    if not known["view"] and not known["track"]:
        raise InputError(f"{source}: has a header but no position")
    return Control(views=known["view"], points=known["track"], rotation=rotation)


def write_tracks(tracks: Tracks, path: str | PathLike[str], form: Form = "xyz") -> None:
    """Write a bearings table that :func:`panopath.read_tracks` reads back; gzip where the name ends in ``.gz``.

    Parameters
    ----------
    tracks
        The observations.
    path
        Where to; written whole or not at all.
    form
        How directions are written: ``xyz`` comes back bit for bit, the angles (``degrees``, ``radians``,
        ``compass``) to rounding.

    Raises
    ------
    InputError
        Where a name would not come back, or the file cannot be written.
    """
    if form not in _FORM_COLUMNS:
        raise InputError(f"form is {form!r}, expected one of {', '.join(map(repr, _FORM_COLUMNS))}")
    views, track_labels = tracks.view_labels(), tracks.track_labels()
    for kind, names in (("view", views), ("track", track_labels)):
        odd = next((name for name in names if not name or name != name.strip() or "\0" in name), None)
        if odd is not None:
            raise InputError(
                f"the {kind} name {odd!r} is empty or has blanks around it or a NUL: it would not come back"
            )
    wanted = _FORM_COLUMNS[form]
    values = direction_columns(tracks.bearing, form)
    header = ["view", "track", *(wanted[: len(values)])]
    cells = [[repr(v) for v in column.tolist()] for column in values]
    if tracks.sigma_rad is not None:
        name, sigma = (
            ("sigma_rad", tracks.sigma_rad)
            if form in ("xyz", "radians")
            else (
                "sigma_deg",
                np.degrees(tracks.sigma_rad),
            )
        )
        header.append(name)
        cells.append([repr(v) for v in sigma.tolist()])
    if tracks.time_s is not None:
        header.append("time_s")
        texts = ["" if math.isnan(v) else repr(v) for v in tracks.time_s.tolist()]
        cells.append([texts[i] for i in tracks.view.tolist()])
    view_cells, track_cells = quoted(views), quoted(track_labels)
    rows = zip(
        [view_cells[i] for i in tracks.view.tolist()],
        [track_cells[i] for i in tracks.track.tolist()],
        *cells,
        strict=True,
    )
    write_bytes(Path(path), table_bytes(header, rows))


def quoted(names: Sequence[str]) -> list[str]:
    """Names as cells: in quotes where something in them would end the cell."""
    return ['"' + name.replace('"', '""') + '"' if _SPECIAL.search(name) else name for name in names]


def table_bytes(header: Sequence[str], rows: Iterable[Sequence[str]]) -> bytes:
    """Join cells that are quoted where they need it."""
    return "\n".join([",".join(header), *map(",".join, rows), ""]).encode("utf-8")


def write_orientations(cam_from_world: Float, names: Sequence[str], path: str | PathLike[str]) -> None:
    """Write an orientations file: ``view,qw,qx,qy,qz``, or ``view,heading_deg`` for (n_views,) headings in radians.

    Raises
    ------
    InputError
        Where it cannot be written.
    """
    if cam_from_world.ndim == 1:
        header, values = ["view", "heading_deg"], np.degrees(cam_from_world)[:, None]
    else:
        header, values = ["view", *_QUATERNION], quaternion_from_rotation(cam_from_world)
    cells = zip(quoted(names), *(map(repr, column) for column in values.T.tolist()), strict=True)
    write_bytes(Path(path), table_bytes(header, cells))


def direction_columns(bearing: Float, form: str) -> list[Float]:
    """Columns of ``form`` for (N, d) unit vectors."""
    if form == "xyz":
        return [np.ascontiguousarray(bearing[:, c]) for c in range(bearing.shape[1])]
    x, y = bearing[:, 0], bearing[:, 1]
    around = np.arctan2(x, y) % (2.0 * np.pi) if form == "compass" else np.arctan2(y, x)
    angles = [around]
    if bearing.shape[1] == 3:
        angles.append(np.arctan2(bearing[:, 2], np.hypot(x, y)))
    return angles if form == "radians" else [np.degrees(angle) for angle in angles]
