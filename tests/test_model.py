"""Records refuse what cannot be, and say which entry."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import panopath as pp
import polars as pl
import pytest
from panopath.model import check_orientations

GOOD: dict[str, Any] = {
    "view": [0, 1, 1],
    "track": [0, 0, 1],
    "bearing": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.6, 0.8]],
}
NAN = float("nan")


def test_from_arrays_keeps_values_and_is_read_only() -> None:
    tracks = pp.Tracks.from_arrays(**GOOD, sigma_rad=0.5, time_s=[1.0, NAN], n_tracks=4)
    assert (len(tracks), tracks.d, tracks.n_views, tracks.n_tracks) == (3, 3, 2, 4)
    assert tracks.view.dtype == np.int32
    assert tracks.bearing.flags.c_contiguous
    assert tracks.sigma_rad is not None
    np.testing.assert_array_equal(tracks.sigma_rad, [0.5] * 3)
    for array in (tracks.view, tracks.track, tracks.bearing, tracks.sigma_rad, tracks.time_s):
        assert array is not None
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    assert list(tracks.view_labels()) == ["0", "1"]


def test_from_arrays_copies() -> None:
    bearing = np.array(GOOD["bearing"])
    tracks = pp.Tracks.from_arrays(GOOD["view"], GOOD["track"], bearing)
    bearing[0] = 9.0
    assert tracks.bearing[0, 0] == 1.0


@pytest.mark.parametrize("make", [list, tuple, np.array, pd.Series, pl.Series, lambda v: np.array(v, dtype=np.uint64)])
def test_from_arrays_reads_anything_array_like(make: Any) -> None:
    tracks = pp.Tracks.from_arrays(make(GOOD["view"]), make(GOOD["track"]), GOOD["bearing"])
    np.testing.assert_array_equal(tracks.view, GOOD["view"])
    assert tracks.view.dtype == np.int32


def test_strided_and_float_input() -> None:
    wide = np.zeros((3, 6))
    wide[:, ::2] = GOOD["bearing"]
    tracks = pp.Tracks.from_arrays(np.array([0.0, 1.0, 1.0]), np.array([9, 0, 0, 1])[1:], wide[:, ::2])
    np.testing.assert_array_equal(tracks.bearing, GOOD["bearing"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"view": [0, -1, 1]}, r"view\[1\] is -1"),
        ({"view": [0, 0.5, 1]}, r"view\[1\] is 0.5, expected a whole number"),
        ({"view": [0, NAN, 1]}, r"view\[1\] is nan"),
        ({"view": [0, 2**40, 1]}, r"view\[1\] is 1099511627776"),
        ({"view": ["a", "b", "c"]}, "view holds .* values, expected whole numbers"),
        ({"view": [True, False, True]}, "view holds bool"),
        ({"view": [[0, 1, 1]]}, r"view has shape \(1, 3\)"),
        ({"view": [[0], [1, 2], [3]]}, "view cannot be read"),
        ({"view": pd.Series([0, None, 1], dtype="Int64")}, r"view"),
        ({"track": [0, 0]}, "track has 2 entries, but there are 3 observations"),
        ({"view": [], "track": [], "bearing": np.empty((0, 3))}, "view is empty"),
        ({"bearing": [[1.0, 0.0, 0.0]]}, "bearing has 1 entries"),
        ({"bearing": np.zeros((3, 4))}, r"bearing has shape \(3, 4\)"),
        ({"bearing": [1.0, 0.0, 0.0]}, r"bearing has shape \(3,\)"),
        ({"bearing": [[1, 0, 0], [0, NAN, 0], [0, 1, 0]]}, r"bearing\[1\] is not finite"),
        ({"bearing": [[1, 0, 0], [0, np.inf, 0], [0, 1, 0]]}, r"bearing\[1\] is not finite"),
        ({"bearing": [[1, 0, 0], [0, 1e200, 0], [0, 1, 0]]}, r"bearing\[1\] has length"),
        ({"bearing": [[1, 0, 0], [0, 1.001, 0], [0, 1, 0]]}, r"bearing\[1\] has length 1.001"),
        ({"bearing": [[1, 0, 0], [0, 0, 0], [0, 1, 0]]}, r"bearing\[1\] has length 0"),
        ({"bearing": [["x", 0, 0], [0, 0, 0], [0, 1, 0]]}, "bearing cannot be read"),
        ({"n_views": 1}, r"view\[1\] is beyond the 1 views"),
        ({"n_views": 0}, "n_views is 0"),
        ({"n_views": 2.5}, "n_views is 2.5"),
        ({"n_tracks": True}, "n_tracks is True"),
        ({"sigma_rad": 0.0}, r"sigma_rad\[0\] is 0.0"),
        ({"sigma_rad": [1.0, NAN, 1.0]}, r"sigma_rad\[1\] is nan"),
        ({"sigma_rad": [1.0, 1.0]}, r"sigma_rad has shape \(2,\)"),
        ({"time_s": [1.0]}, r"time_s has shape \(1,\)"),
        ({"time_s": [1.0, np.inf]}, r"time_s\[1\] is infinite"),
        ({"view_names": ["a", "a"]}, r"view_names\[1\] is 'a' again"),
        ({"view_names": ["a", 3]}, r"view_names\[1\] is a int"),
        ({"view_names": "ab"}, "view_names is one text"),
        ({"view_names": ["a"]}, r"view\[1\] is beyond"),
        ({"view_names": ["a", "b"], "n_views": 3}, "view_names has 2 entries, but n_views is 3"),
    ],
)
def test_from_arrays_names_what_is_wrong(change: dict[str, Any], message: str) -> None:
    with pytest.raises(pp.InputError, match=message) as error:
        pp.Tracks.from_arrays(**{**GOOD, **change})
    assert "\n" not in str(error.value)


def test_select_and_to_world() -> None:
    tracks = pp.Tracks.from_arrays(**GOOD, sigma_rad=[1.0, 2.0, 3.0], view_names=["a", "b"])
    kept = tracks.select([True, False, True])
    assert (len(kept), kept.n_views, kept.n_tracks, kept.view_names) == (2, 2, 2, ("a", "b"))
    assert kept.sigma_rad is not None
    np.testing.assert_array_equal(kept.sigma_rad, [1.0, 3.0])
    with pytest.raises(pp.InputError, match="keep has type int64"):
        tracks.select([1, 0, 1])
    # a quarter turn about z takes x to y
    cam_from_world = np.tile([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], (2, 1, 1))
    np.testing.assert_allclose(tracks.to_world(cam_from_world).bearing[0], [0.0, 1.0, 0.0])


def test_planar_heading_turns_anticlockwise() -> None:
    angle = np.radians([10.0, 200.0])
    tracks = pp.Tracks.from_arrays([0, 1], [0, 0], np.stack((np.cos(angle), np.sin(angle)), axis=1))
    world = tracks.to_world(np.radians([30.0, 100.0]))
    np.testing.assert_allclose(np.degrees(np.arctan2(world.bearing[:, 1], world.bearing[:, 0])), [40.0, -60.0])


@pytest.mark.parametrize(
    ("orientations", "d", "message"),
    [
        (np.eye(3), 3, "has shape"),
        (np.stack([np.eye(3), -np.eye(3)]), 3, r"cam_from_world\[1\] has determinant -1"),
        (np.stack([np.eye(3), 1.1 * np.eye(3)]), 3, r"cam_from_world\[1\] is 0.21 off orthonormal"),
        (np.stack([np.eye(3), np.full((3, 3), NAN)]), 3, r"cam_from_world\[1\] is not finite"),
        ([0.0, NAN], 2, r"cam_from_world\[1\] is not finite"),
        (np.zeros((2, 3, 3)), 2, "one heading_rad a view"),
    ],
)
def test_orientations_are_checked(orientations: Any, d: int, message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        check_orientations(orientations, 2, d)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"method": "fast"}, "method is 'fast'"),
        ({"gauge": "none"}, "gauge is 'none'"),
        ({"vertical_axis": 3}, "vertical_axis is 3"),
        ({"vertical_axis": True}, "vertical_axis is True"),
        ({"split_parts": 1}, "split_parts is 1"),
        ({"max_iterations": 0}, "max_iterations is 0"),
        ({"threads": 1.5}, "threads is 1.5"),
        ({"gauge": "control"}, "control is None"),
        ({"control": pp.Control(views={0: (0.0, 0.0)})}, 'gauge is "normalized"'),
        ({"control": {"views": {}}, "gauge": "control"}, "control is a dict"),
    ],
)
def test_options_are_checked(choice: dict[str, Any], message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        pp.PositionOptions(**choice)


@pytest.mark.parametrize(
    ("control", "message"),
    [
        ({}, "names no view and no point"),
        ({"views": {0: (0.0, 0.0)}, "points": {0: (0.0, 0.0, 0.0)}}, "2 and of 3"),
        ({"views": {1.5: (0.0, 0.0)}}, "key 1.5"),
        ({"views": {0: (0.0, NAN)}}, r"control.views\[0\]"),
        ({"points": {"p": (0.0,)}}, r"control.points\['p'\]"),
    ],
)
def test_control_is_checked(control: dict[str, Any], message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        pp.Control(**control)


def test_scene_checks_shapes(street: pp.SyntheticWorld) -> None:
    summary = pp.Summary(pp.Status.CONVERGED, 1, 0.1)
    n, m = 3, 2
    fields: dict[str, Any] = {
        "centers": np.zeros((n, 3)),
        "points": np.zeros((m, 3)),
        "view_component": np.zeros(n),
        "track_component": np.zeros(m),
        "inlier": np.ones(4, bool),
        "residual_rad": np.zeros(4),
        "cam_from_world": np.tile(np.eye(3), (n, 1, 1)),
        "summary": summary,
    }
    assert pp.Scene(**fields).n_components == 1
    for name, wrong in {
        "points": np.zeros((m, 2)),
        "view_component": np.zeros(n + 1),
        "residual_rad": np.zeros(5),
    }.items():
        with pytest.raises(pp.InputError, match=name):
            pp.Scene(**{**fields, name: wrong})
    with pytest.raises(pp.InputError, match="was not made from"):
        pp.Scene(**fields, tracks=street.tracks)


def test_every_error_is_one_root() -> None:
    assert issubclass(pp.InputError, pp.PanopathError)
    assert issubclass(pp.InputError, ValueError)
    assert issubclass(pp.MissingExtraError, pp.InputError)
