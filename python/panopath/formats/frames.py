"""Bearings from a data frame: anything with named columns that numpy can read (pandas, polars, arrow, a dict)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.formats import columns
from panopath.model import Float, Tracks


def is_frame(value: object) -> bool:
    """Whether a value has named columns."""
    return isinstance(value, dict) or any(hasattr(value, name) for name in ("columns", "column_names"))


def read_frame(frame: Any, source: str = "frame") -> Tracks:
    """Read a frame whose columns are those of a bearings file; ids may be whole numbers or text.

    Raises
    ------
    InputError
        Naming row and column.
    """
    given = [str(name) for name in _column_names(frame)]
    header = columns.clean_header(given, source)
    plan = columns.plan_columns(header, source)
    arrays = {
        name: _array(frame, original, source)
        for name, original in zip(header, given, strict=True)
        if plan.role(name) != "skip"
    }
    numbers = {
        name: _numbers(values, name, plan.role(name), source)
        for name, values in arrays.items()
        if plan.role(name) != "name"
    }
    view = _names(arrays["view"], "view", source)
    track = _names(arrays["track"], "track", source)
    return columns.tracks_from_columns(plan, view, track, numbers, columns.Place(source, where))


def where(row: int) -> str:
    """Say where a row is."""
    return f"row {row}"


def _column_names(frame: Any) -> list[object]:
    if isinstance(frame, dict):
        return list(frame)
    return list(frame.column_names if hasattr(frame, "column_names") else frame.columns)


def _array(frame: Any, name: str, source: str) -> npt.NDArray[Any]:
    try:
        column = frame[name]
        array = np.asarray(column)
        if array.dtype.kind == "U" and isinstance(column, list | tuple):
            # numbers among text became text: let each entry speak for itself
            array = np.asarray(column, dtype=object)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{source}: the column {name} cannot be read as an array ({error})") from None
    if array.ndim != 1:
        raise InputError(f"{source}: the column {name} has shape {array.shape}, expected one value a row")
    return array


def _numbers(values: npt.NDArray[Any], name: str, role: str, source: str) -> Float:
    if values.dtype.kind in "iuf":
        numbers = values.astype(np.float64)
    else:
        numbers = np.array([_number(v, row, name, source) for row, v in enumerate(values.tolist())], dtype=np.float64)
    wrong = np.isinf(numbers) if role == "optional" else ~np.isfinite(numbers)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(f"{source}: {where(row)}, column {name}: found {numbers[row]}, expected a finite number")
    return numbers


def _number(value: object, row: int, name: str, source: str) -> float:
    if value is None:
        return float("nan")
    try:
        # text is refused: a frame that holds numbers as text was read wrongly
        if isinstance(value, str):
            raise ValueError
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise InputError(f"{source}: {where(row)}, column {name}: found {value!r}, expected a number") from None


def _names(values: npt.NDArray[Any], name: str, source: str) -> columns.NameColumn:
    """Codes and names of an id column, in natural order as in a file."""
    if values.dtype.kind in "iu":
        unique, codes = np.unique(values, return_inverse=True)
        texts = [str(v) for v in unique.tolist()]
    else:
        code_of: dict[str, int] = {}
        codes = np.empty(len(values), dtype=np.int64)
        for row, value in enumerate(values.tolist()):
            codes[row] = code_of.setdefault(_text(value, row, name, source), len(code_of))
        texts = list(code_of)
    order = _core.natural_order(texts)
    rank = np.empty(len(order), dtype=np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    return rank[codes], [texts[i] for i in order.tolist()]


def _text(value: object, row: int, name: str, source: str) -> str:
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace")
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, str | int) or value == "":
        raise InputError(f"{source}: {where(row)}, column {name}: found {value!r}, expected a name or a whole number")
    return str(value).strip()
