"""Bearings as text: every way to write a direction, names, order, gzip, orientations, control, speed."""

from __future__ import annotations

import gzip
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from panopath.formats.csv import quaternion_from_rotation, rotation_from_quaternion, write_orientations

ROWS = "view,track,{}\na,p,{}\nb,p,{}\nb,q,{}\n"


def write(folder: Path, text: str | bytes, name: str = "f.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return path


@pytest.mark.parametrize(
    ("columns", "cells", "expected"),
    [
        ("theta_deg,phi_deg", ("0,0", "90,0", "0,90"), [(1, 0, 0), (0, 1, 0), (0, 0, 1)]),
        ("phi_deg,theta_deg", ("0,0", "0,90", "90,0"), [(1, 0, 0), (0, 1, 0), (0, 0, 1)]),
        (
            "theta_rad,phi_rad",
            ("0,0", "1.5707963267948966,0", "3.141592653589793,0"),
            [(1, 0, 0), (0, 1, 0), (-1, 0, 0)],
        ),
        ("azimuth_deg,elevation_deg", ("0,0", "90,0", "270,30"), [(0, 1, 0), (1, 0, 0), (-(0.75**0.5), 0, 0.5)]),
        ("x,y,z", ("1,0,0", "0,2,0", "0,0,-3e-3"), [(1, 0, 0), (0, 1, 0), (0, 0, -1)]),
        ("theta_deg", ("0", "90", "-90"), [(1, 0), (0, 1), (0, -1)]),
        ("theta_rad", ("0", "1.5707963267948966", "3.141592653589793"), [(1, 0), (0, 1), (-1, 0)]),
        ("azimuth_deg", ("0", "90", "180"), [(0, 1), (1, 0), (0, -1)]),
        ("x,y", ("1,0", "0,7", "-1,-1"), [(1, 0), (0, 1), (-(0.5**0.5), -(0.5**0.5))]),
    ],
)
def test_every_form_of_direction(tmp_path: Path, columns: str, cells: tuple[str, ...], expected: Any) -> None:
    tracks = pp.read_tracks(write(tmp_path, ROWS.format(columns, *cells)))
    np.testing.assert_allclose(tracks.bearing, expected, atol=1e-15)
    assert tracks.view_names == ("a", "b")
    np.testing.assert_array_equal(tracks.view, [0, 1, 1])
    np.testing.assert_array_equal(tracks.track, [0, 0, 1])


def test_header_and_cells_forgive_blanks_case_marks_and_line_ends(tmp_path: Path) -> None:
    text = b'\xef\xbb\xbf View , TRACK ,Theta_Deg, comment\r\n\r\n a ,"p, 1", 90 ,x\r\nb,"p, 1 ",+1.8e2,"a\nb"\r\n'
    tracks = pp.read_tracks(write(tmp_path, text))
    assert (tracks.view_names, tracks.track_names) == (("a", "b"), ("p, 1",))
    np.testing.assert_allclose(tracks.bearing, [(0, 1), (-1, 0)], atol=1e-15)


def test_extra_columns(tmp_path: Path) -> None:
    text = "time_s,view,track,theta_deg,sigma_deg\n2.5,a,p,0,0.5\n,a,q,0,1\n,b,q,1,2\n"
    tracks = pp.read_tracks(write(tmp_path, text))
    assert tracks.sigma_rad is not None
    assert tracks.time_s is not None
    np.testing.assert_allclose(np.degrees(tracks.sigma_rad), [0.5, 1.0, 2.0])
    np.testing.assert_array_equal(tracks.time_s, [2.5, np.nan])


def test_order_of_rows_does_not_matter(tmp_path: Path) -> None:
    lines = [f"pano{v},{t},{v + 0.1 * t}" for v in (10, 9, 2, 100) for t in (3, 20, 1)]
    first = pp.read_tracks(write(tmp_path, "view,track,theta_deg\n" + "\n".join(lines), "one.csv"))
    last = pp.read_tracks(write(tmp_path, "view,track,theta_deg\n" + "\n".join(reversed(lines)), "two.csv"))
    assert first.view_names == last.view_names == ("pano2", "pano9", "pano10", "pano100")
    assert first.track_names == last.track_names == ("1", "3", "20")
    np.testing.assert_array_equal(first.bearing, last.bearing[::-1])
    np.testing.assert_array_equal(first.view, last.view[::-1])


def test_names_that_are_indices_are_left_out(tmp_path: Path) -> None:
    tracks = pp.read_tracks(write(tmp_path, "view,track,theta_deg\n1,7,0\n0,8,1\n"))
    assert tracks.view_names is None
    np.testing.assert_array_equal(tracks.view, [1, 0])
    assert tracks.track_names == ("7", "8")


def test_content_decides_not_the_suffix(tmp_path: Path) -> None:
    text = ROWS.format("theta_deg", "0", "1", "2").encode()
    for name, data in (("noend", text), ("x.bin", gzip.compress(text)), ("y.txt", text), ("z.parquet", text)):
        assert len(pp.read_tracks(write(tmp_path, data, name))) == 3
    assert len(pp.read_tracks(str(tmp_path / "noend"))) == 3


@pytest.mark.parametrize("form", ["xyz", "degrees", "radians", "compass"])
@pytest.mark.parametrize("name", ["f.csv", "f.csv.gz"])
def test_round_trip(tmp_path: Path, form: Any, name: str, street: pp.SyntheticWorld, planar: pp.SyntheticWorld) -> None:
    for world in (street, planar):
        tracks = world.tracks
        tracks = pp.Tracks.from_arrays(
            tracks.view,
            tracks.track,
            tracks.bearing,
            sigma_rad=np.linspace(1e-3, 0.1, len(tracks)),
            time_s=world.time_s,
        )
        pp.write_tracks(tracks, tmp_path / name, form)
        back = pp.read_tracks(tmp_path / name)
        np.testing.assert_array_equal(back.view, tracks.view)
        np.testing.assert_array_equal(back.track, tracks.track)
        np.testing.assert_array_equal(back.time_s, tracks.time_s)
        tolerance = 0.0 if form == "xyz" else 1e-14
        np.testing.assert_allclose(back.bearing, tracks.bearing, rtol=0.0, atol=tolerance)
        assert back.sigma_rad is not None
        assert tracks.sigma_rad is not None
        np.testing.assert_allclose(back.sigma_rad, tracks.sigma_rad, rtol=tolerance)
    assert sorted(path.name for path in tmp_path.iterdir()) == [name]


NAMES = st.lists(
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=8).filter(
        lambda s: s == s.strip()
    ),
    min_size=2,
    max_size=6,
    unique=True,
)


@settings(max_examples=150, deadline=None)
@given(NAMES, NAMES)
def test_names_may_be_any_text(tmp_path_factory: pytest.TempPathFactory, views: list[str], points: list[str]) -> None:
    path = tmp_path_factory.mktemp("names") / "f.csv"
    pairs = [(v, t) for v in range(len(views)) for t in range(len(points))]
    angle = np.arange(len(pairs)) * 0.1
    tracks = pp.Tracks.from_arrays(
        [v for v, _ in pairs],
        [t for _, t in pairs],
        np.stack((np.cos(angle), np.sin(angle)), axis=1),
        view_names=views,
        track_names=points,
    )
    pp.write_tracks(tracks, path)
    back = pp.read_tracks(path)
    assert [back.view_labels()[v] for v in back.view] == [views[v] for v, _ in pairs]
    assert [back.track_labels()[t] for t in back.track] == [points[t] for _, t in pairs]


def test_write_refuses_names_that_would_not_come_back(tmp_path: Path) -> None:
    tracks = pp.Tracks.from_arrays([0], [0], [[1.0, 0.0]], view_names=[" a"])
    for name in (" a", "", "a\0"):
        with pytest.raises(pp.InputError, match="would not come back"):
            pp.write_tracks(replace(tracks, view_names=(name,)), tmp_path / "f.csv")
    with pytest.raises(pp.InputError, match="form is 'polar'"):
        pp.write_tracks(tracks, tmp_path / "f.csv", "polar")  # type: ignore[arg-type]
    with pytest.raises(pp.InputError, match="cannot be written"):
        pp.write_tracks(pp.Tracks.from_arrays([0], [0], [[1.0, 0.0]]), tmp_path / "no" / "f.csv")
    assert not list(tmp_path.iterdir())


def test_gzip_bytes_do_not_depend_on_the_time(tmp_path: Path, planar: pp.SyntheticWorld) -> None:
    pp.write_tracks(planar.tracks, tmp_path / "a.csv.gz")
    first = (tmp_path / "a.csv.gz").read_bytes()
    time.sleep(1.1)
    pp.write_tracks(planar.tracks, tmp_path / "a.csv.gz")
    assert (tmp_path / "a.csv.gz").read_bytes() == first


def test_orientations_of_space(tmp_path: Path, turned: pp.SyntheticWorld) -> None:
    pp.write_tracks(turned.tracks, tmp_path / "f.csv")
    write_orientations(turned.cam_from_world, turned.tracks.view_labels(), tmp_path / "o.csv")
    problem = pp.read_problem(tmp_path / "f.csv", tmp_path / "o.csv")
    assert problem.cam_from_world is not None
    np.testing.assert_allclose(problem.cam_from_world, turned.cam_from_world, atol=1e-15)
    np.testing.assert_array_equal(problem.tracks.bearing, turned.tracks.bearing)
    world = pp.read_tracks(tmp_path / "f.csv", orientations=tmp_path / "o.csv")
    ray = turned.points[world.track] - turned.centers[world.view]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    assert np.linalg.norm(world.bearing - ray, axis=1).max() < 0.01
    by_array = pp.read_tracks(tmp_path / "f.csv", orientations=turned.cam_from_world)
    np.testing.assert_allclose(by_array.bearing, world.bearing, atol=1e-14)


def test_orientations_of_the_plane(tmp_path: Path, planar: pp.SyntheticWorld) -> None:
    pp.write_tracks(planar.tracks, tmp_path / "f.csv")
    write_orientations(planar.cam_from_world, planar.tracks.view_labels(), tmp_path / "o.csv")
    world = pp.read_tracks(tmp_path / "f.csv", tmp_path / "o.csv")
    ray = planar.points[world.track] - planar.centers[world.view]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    assert np.linalg.norm(world.bearing - ray, axis=1).max() < 0.01


def test_compass_heading(tmp_path: Path) -> None:
    """A ship that heads east sees a beacon 30 degrees to starboard: it is at 120 degrees by the compass."""
    bearings = write(tmp_path, "view,track,azimuth_deg\na,p,30\n")
    orientations = write(tmp_path, "view,compass_deg\na,90\n", "o.csv")
    azimuth = np.radians(120.0)
    np.testing.assert_allclose(pp.read_tracks(bearings, orientations).bearing, [(np.sin(azimuth), np.cos(azimuth))])
    bearings = write(tmp_path, "view,track,azimuth_deg,elevation_deg\na,p,30,0\n")
    found = pp.read_tracks(bearings, orientations).bearing
    np.testing.assert_allclose(found, [(np.sin(azimuth), np.cos(azimuth), 0.0)], atol=1e-15)


def test_orientations_of_views_without_observations_may_be_absent(tmp_path: Path) -> None:
    tracks = pp.Tracks.from_arrays([0, 2], [0, 0], [[1.0, 0.0, 0.0]] * 2, n_views=3)
    path = write(tmp_path, "view,qw,qx,qy,qz\n0,1,0,0,0\n2,0,1,0,0\nother,1,0,0,0\n", "o.csv")
    rotations = pp.read_problem(tracks, path).cam_from_world
    assert rotations is not None
    np.testing.assert_allclose(rotations, [np.eye(3), np.eye(3), np.diag([1.0, -1.0, -1.0])])


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_quaternions_there_and_back(q: list[float]) -> None:
    wxyz = np.array([q]) / np.linalg.norm(q)
    rotation = rotation_from_quaternion(wxyz)
    np.testing.assert_allclose(rotation @ rotation.transpose(0, 2, 1), [np.eye(3)], atol=1e-14)
    back = quaternion_from_rotation(rotation)
    assert back[0, 0] >= 0.0
    np.testing.assert_allclose(np.abs(np.einsum("nk,nk->n", back, wxyz)), 1.0, atol=1e-14)
    np.testing.assert_allclose(rotation_from_quaternion(back), rotation, atol=1e-14)


def test_control(tmp_path: Path) -> None:
    control = pp.read_control(write(tmp_path, "view,track,x,y,z\na,,1,2,3\n,p,4,5,6\nb,,,,\n"), rotation=False)
    assert dict(control.views) == {"a": (1.0, 2.0, 3.0)}
    assert dict(control.points) == {"p": (4.0, 5.0, 6.0)}
    assert control.rotation is False
    assert pp.read_control(write(tmp_path, "track,x,y\np,1,2\n")).d == 2


def test_a_million_rows_in_two_seconds(tmp_path: Path) -> None:
    """The issue's bar; best of three, for a machine that others use too."""
    n = 1_000_000
    rng = np.random.default_rng(1)
    rows = np.stack((rng.integers(0, 1000, n), rng.integers(0, 100_000, n)), axis=1).tolist()
    angles = np.round(rng.uniform((-180.0, -90.0), (180.0, 90.0), (n, 2)), 6).tolist()
    text = "\n".join(f"{v},{t},{a},{b}" for (v, t), (a, b) in zip(rows, angles, strict=True))
    path = write(tmp_path, "view,track,theta_deg,phi_deg\n" + text + "\n")
    seconds = []
    for _ in range(3):
        begin = time.perf_counter()
        tracks = pp.read_tracks(path)
        seconds.append(time.perf_counter() - begin)
    assert len(tracks) == n
    assert min(seconds) < 2.0, f"took {min(seconds):.2f} s"
