"""Bearings as a Parquet file, with the columns of a bearings table (extra ``parquet``)."""

from __future__ import annotations

import importlib
import io
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from panopath.errors import InputError, MissingExtraError
from panopath.formats.csv import direction_columns
from panopath.formats.files import replacing
from panopath.formats.frames import read_frame
from panopath.model import Tracks

MAGIC = b"PAR1"


def _pyarrow() -> Any:
    try:
        importlib.import_module("pyarrow.parquet")
        return importlib.import_module("pyarrow")
    except ImportError:
        raise MissingExtraError(
            'Parquet needs pyarrow: install the extra with pip install "panopath[parquet]"'
        ) from None


def read_parquet(data: bytes, source: str) -> Tracks:
    """Read a bearings table.

    Raises
    ------
    InputError
        Naming file, row and column, or the extra that is missing.
    """
    arrow = _pyarrow()
    try:
        table = arrow.parquet.read_table(io.BytesIO(data))
    except (arrow.ArrowException, OSError) as error:
        raise InputError(f"{source}: is not a Parquet file that can be read ({str(error).splitlines()[0]})") from None
    return read_frame(table, source)


def write_parquet(tracks: Tracks, path: str | PathLike[str]) -> None:
    """Write a bearings table with the columns view, track, x, y[, z], and sigma_rad and time_s where they are known.

    Raises
    ------
    InputError
        Where it cannot be written, or the extra is missing.
    """
    arrow = _pyarrow()
    data: dict[str, Any] = {"view": tracks.view, "track": tracks.track}
    for kind, names in (("view", tracks.view_names), ("track", tracks.track_names)):
        if names is not None:
            data[kind] = arrow.array(np.array(names, dtype=object)[data[kind]])
    data |= dict(zip(("x", "y", "z"), direction_columns(tracks.bearing, "xyz"), strict=False))
    if tracks.sigma_rad is not None:
        data["sigma_rad"] = tracks.sigma_rad
    if tracks.time_s is not None:
        data["time_s"] = tracks.time_s[tracks.view]
    with replacing(Path(path)) as staged:
        arrow.parquet.write_table(arrow.table(data), staged)
