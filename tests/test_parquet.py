"""Parquet there and back, and what is said without pyarrow."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.formats.parquet import write_parquet


@pytest.mark.parametrize("name", ["f.parquet", "no_suffix"])
def test_round_trip(tmp_path: Path, name: str, street: pp.SyntheticWorld, planar: pp.SyntheticWorld) -> None:
    for world in (street, planar):
        tracks = pp.Tracks.from_arrays(
            world.tracks.view,
            world.tracks.track,
            world.tracks.bearing,
            sigma_rad=np.linspace(0.01, 0.02, len(world.tracks)),
            time_s=world.time_s,
            view_names=[f"view {i}" for i in range(world.tracks.n_views)],
        )
        write_parquet(tracks, tmp_path / name)
        back = pp.read_tracks(tmp_path / name)
        for array in ("view", "track", "bearing", "sigma_rad", "time_s"):
            np.testing.assert_array_equal(getattr(back, array), getattr(tracks, array))
        assert (back.view_names, back.track_names) == (tracks.view_names, None)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_without_pyarrow(tmp_path: Path, planar: pp.SyntheticWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    write_parquet(planar.tracks, tmp_path / "f.parquet")
    real = importlib.import_module

    def absent(name: str, package: str | None = None) -> Any:
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(pp.MissingExtraError, match=r'pip install "panopath\[parquet\]"'):
        pp.read_tracks(tmp_path / "f.parquet")
