"""What the columns of a bearings table mean, whether they come from CSV, Parquet or a data frame.

Directions from angles, theta anticlockwise from x, azimuth clockwise from y (north), z up:
``theta, phi``: (cos phi cos theta, cos phi sin theta, sin phi);
``azimuth, elevation``: (cos elevation sin azimuth, cos elevation cos azimuth, sin elevation).
The plane leaves phi, elevation and z out.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.model import Float, Int, Tracks

#: Codes into a list of names.
NameColumn = tuple[Int, list[str]]

#: Every way to write a direction: the columns of the plane, and the one that space adds.
_FORMS: dict[str, tuple[tuple[str, ...], str]] = {
    "theta_deg": (("theta_deg",), "phi_deg"),
    "theta_rad": (("theta_rad",), "phi_rad"),
    "azimuth_deg": (("azimuth_deg",), "elevation_deg"),
    "x": (("x", "y"), "z"),
}
_EXTRAS = ("view", "track", "sigma_deg", "sigma_rad", "time_s")
_KNOWN = tuple(name for first, second in _FORMS.values() for name in (*first, second)) + _EXTRAS
_FORMS_TEXT = "theta_deg,phi_deg | theta_rad,phi_rad | azimuth_deg,elevation_deg | x,y,z"
_FULL_TURN_RAD = 2.0 * np.pi * (1.0 + 1e-12)
_QUARTER_TURN_RAD = 0.5 * np.pi * (1.0 + 1e-12)


@dataclass(frozen=True)
class Place:
    """Where a table is from, for error messages."""

    source: str
    #: Says where a row is: "line 7" of a file, "row 5" of a frame.
    where: Callable[[int], str]

    def refuse(self, wrong: npt.NDArray[np.bool_], column: str, values: Float, expected: str) -> None:
        """Raise an error about the first value that is wrong, where there is one."""
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"{self.source}: {self.where(row)}, column {column}: found {values[row]:g}, expected {expected}"
            )


@dataclass(frozen=True)
class Plan:
    """Which columns of a table are read, and as what."""

    #: The columns of the direction, in order.
    direction: tuple[str, ...]
    sigma: str | None
    has_time: bool

    def role(self, name: str) -> str:
        """How the table reader should treat a column: name, number, optional or skip."""
        if name in ("view", "track"):
            return "name"
        if name in self.direction or name == self.sigma:
            return "number"
        return "optional" if name == "time_s" else "skip"


def clean_header(fields: Sequence[str], source: str) -> list[str]:
    """Column names without blanks around them and in lower case.

    Raises
    ------
    InputError
        Where a name stands twice, or is a number.
    """
    names = [field.strip().lower() for field in fields]
    if any(_is_number(name) for name in names):
        raise InputError(f"{source}: line 1: found {','.join(names)[:60]!r}, the header line is missing")
    for name in names:
        if name and names.count(name) > 1:
            raise InputError(f"{source}: the column {name} stands in the header twice")
    return names


def plan_columns(names: Sequence[str], source: str) -> Plan:
    """Recognise the columns of a bearings table.

    Raises
    ------
    InputError
        Where a column is missing, stands alone, or is nearly but not quite one that is known.
    """
    for name in ("view", "track"):
        if name not in names:
            raise InputError(f"{source}: the header has no column {name} (columns: {','.join(names)})")
    for name in names:
        near = difflib.get_close_matches(name, _KNOWN, n=1, cutoff=0.85)
        if name not in _KNOWN and near:
            raise InputError(f"{source}: the column {name} is unknown, did you mean {near[0]}?")
    found = [form for form, (first, second) in _FORMS.items() if any(n in names for n in (*first, second))]
    if not found:
        raise InputError(f"{source}: the header has no direction, expected the columns {_FORMS_TEXT}")
    if len(found) > 1:
        raise InputError(f"{source}: directions are given twice, by {found[0]} and by {found[1]}; expected one of them")
    first, second = _FORMS[found[0]]
    for name in first:
        if name not in names:
            raise InputError(f"{source}: the header has no column {name}, expected {','.join((*first, second))}")
    sigmas = [name for name in ("sigma_deg", "sigma_rad") if name in names]
    if len(sigmas) > 1:
        raise InputError(f"{source}: both sigma_deg and sigma_rad are given, expected one of them")
    direction = (*first, second) if second in names else first
    return Plan(direction, sigmas[0] if sigmas else None, "time_s" in names)


def tracks_from_columns(
    plan: Plan,
    view: NameColumn,
    track: NameColumn,
    numbers: dict[str, Float],
    place: Place,
) -> Tracks:
    """Make tracks of columns; ``numbers`` holds the direction, and sigma and ``time_s`` where the plan has them.

    Raises
    ------
    InputError
        Naming the row and the column of the first value that cannot be.
    """
    if len(view[0]) == 0:
        raise InputError(f"{place.source}: has a header but no observation")
    bearing = _directions(plan.direction, [numbers[name] for name in plan.direction], place)
    sigma_rad = None
    if plan.sigma is not None:
        sigma = numbers[plan.sigma]
        place.refuse(~(sigma > 0.0), plan.sigma, sigma, "a positive number")
        sigma_rad = np.radians(sigma) if plan.sigma == "sigma_deg" else sigma
    view_names, track_names = _own_names(view[1]), _own_names(track[1])
    time_s = _view_times(numbers["time_s"], view, place) if plan.has_time else None
    return Tracks.from_arrays(
        view[0], track[0], bearing, len(view[1]), len(track[1]), sigma_rad, time_s, view_names, track_names
    )


def _own_names(names: list[str]) -> list[str] | None:
    """Names, or None where they are the indices themselves."""
    return None if all(name == str(index) for index, name in enumerate(names)) else names


def _directions(columns: tuple[str, ...], values: list[Float], place: Place) -> Float:
    if columns[0] == "x":
        vectors = np.stack(values, axis=1)
        with np.errstate(over="ignore"):
            length = np.linalg.norm(vectors, axis=1)
        wrong = ~((length > 0.0) & np.isfinite(length))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"{place.source}: {place.where(row)}, columns {','.join(columns)}: no direction, its length is "
                f"{length[row]:g}"
            )
        # a vector that is of unit length but for rounding stays as it is: files then come back bit for bit
        length[np.abs(length - 1.0) < 4.5e-16] = 1.0
        return np.asarray(vectors / length[:, None])
    in_degrees = columns[0].endswith("_deg")
    angles = [np.radians(v) if in_degrees else v for v in values]
    unit = "degrees" if in_degrees else "radians"
    turn, quarter = ("360", "90") if in_degrees else ("2 pi", "pi/2")
    full = f"{unit} from -{turn} to {turn}"
    place.refuse(np.abs(angles[0]) > _FULL_TURN_RAD, columns[0], values[0], full)
    cos, sin = np.cos(angles[0]), np.sin(angles[0])
    flat = (sin, cos) if columns[0] == "azimuth_deg" else (cos, sin)
    if len(columns) == 1:
        return np.stack(flat, axis=1)
    half = f"{unit} from -{quarter} to {quarter}"
    place.refuse(np.abs(angles[1]) > _QUARTER_TURN_RAD, columns[1], values[1], half)
    level = np.cos(angles[1])
    return np.stack((level * flat[0], level * flat[1], np.sin(angles[1])), axis=1)


def _view_times(time_s: Float, view: NameColumn, place: Place) -> Float:
    """Time of each view: the rows of a view agree, or say nothing."""
    codes, names = view
    times = np.full(len(names), np.nan)
    known = np.isfinite(time_s)
    times[codes[known]] = time_s[known]
    wrong = known & (time_s != times[codes])
    if wrong.any():
        row = int(np.argmax(wrong))
        name = names[codes[row]]
        raise InputError(
            f"{place.source}: {place.where(row)}, column time_s: view {name} has the times {time_s[row]:g} and "
            f"{times[codes[row]]:g}, expected one time a view"
        )
    return times


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
