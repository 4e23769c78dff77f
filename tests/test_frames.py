"""Data frames through the array protocol: pandas, polars, arrow, a dict."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import panopath as pp
import polars as pl
import pyarrow as pa  # type: ignore[import-untyped]
import pytest

COLUMNS: dict[str, Any] = {
    "view": ["b10", "b2", "b2"],
    "track": [7, 7, 9],
    "theta_deg": [0.0, 90.0, 180.0],
    "phi_deg": [0, 0, 0],
    "time_s": [1.0, float("nan"), 2.5],
    "comment": ["x", None, "z"],
}
MAKERS: list[Callable[[dict[str, Any]], Any]] = [dict, pd.DataFrame, pl.DataFrame, pa.table]


@pytest.mark.parametrize("make", MAKERS)
def test_every_kind_of_frame(make: Callable[[dict[str, Any]], Any]) -> None:
    tracks = pp.read_tracks(make(COLUMNS))
    assert (tracks.view_names, tracks.track_names) == (("b2", "b10"), ("7", "9"))
    np.testing.assert_array_equal(tracks.view, [1, 0, 0])
    np.testing.assert_array_equal(tracks.track, [0, 0, 1])
    np.testing.assert_allclose(tracks.bearing, [(1, 0, 0), (0, 1, 0), (-1, 0, 0)], atol=1e-15)
    np.testing.assert_array_equal(tracks.time_s, [2.5, 1.0])


def test_same_as_the_file(tmp_path: Path, street: pp.SyntheticWorld) -> None:
    pp.write_tracks(street.tracks, tmp_path / "f.csv")
    from_file, frame = pp.read_tracks(tmp_path / "f.csv"), pd.read_csv(tmp_path / "f.csv")
    from_frame = pp.read_tracks(frame)
    for name in ("view", "track", "time_s"):
        np.testing.assert_array_equal(getattr(from_file, name), getattr(from_frame, name))
    np.testing.assert_allclose(from_file.bearing, from_frame.bearing, rtol=0.0, atol=1e-15)
    assert from_file.view_names is from_frame.view_names is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"theta_deg": [0.0, "x", 1.0]}, "row 1, column theta_deg: found 'x', expected a number"),
        ({"theta_deg": [0.0, float("nan"), 1.0]}, "row 1, column theta_deg: found nan"),
        ({"theta_deg": [0.0, 1.0, 400.0]}, "row 2, column theta_deg: found 400"),
        ({"view": ["a", None, "b"]}, "row 1, column view: found (None|nan), expected a name"),
        ({"view": ["a", "", "b"]}, "row 1, column view"),
        ({"track": [1.0, 1.5, 2.0]}, "row 1, column track: found 1.5"),
        ({"time_s": [1.0, 2.0, 3.0]}, "row 1, column time_s: view b2 has the times 2 and 3"),
    ],
)
@pytest.mark.parametrize("make", [dict, pd.DataFrame])
def test_errors_name_row_and_column(make: Callable[[Any], Any], change: dict[str, Any], message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        pp.read_tracks(make({**COLUMNS, **change}))


def test_columns_of_two_dimensions_are_refused() -> None:
    with pytest.raises(pp.InputError, match="column theta_deg has shape"):
        pp.read_tracks({**COLUMNS, "theta_deg": np.zeros((3, 2))})
