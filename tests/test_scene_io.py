"""The folder of an answer: exact round trips, honest tables, and nothing of anybody else's lost."""

from __future__ import annotations

import csv
import json
import struct
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from conftest import scene_of
from panopath.formats.csv import rotation_from_quaternion
from panopath.formats.folder import check_writable

FILES = {"cameras.csv", "points.csv", "scene.json", "scene.npz", "scene.ply", "trajectory.tum"}


def same(a: pp.Scene, b: pp.Scene) -> None:
    for field in fields(pp.Scene):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if isinstance(x, np.ndarray):
            np.testing.assert_array_equal(x, y)
            assert x.dtype == y.dtype
        elif not isinstance(x, pp.Tracks):
            assert repr(x) == repr(y)
    assert (a.tracks is None) == (b.tracks is None)
    if a.tracks is not None and b.tracks is not None:
        for name in ("view", "track", "bearing", "sigma_rad", "time_s"):
            np.testing.assert_array_equal(getattr(a.tracks, name), getattr(b.tracks, name))
        assert (a.tracks.view_names, a.tracks.track_names) == (b.tracks.view_names, b.tracks.track_names)


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("kind", ["turned", "planar", "street"])
def test_round_trip(tmp_path: Path, kind: str, request: pytest.FixtureRequest) -> None:
    scene = scene_of(request.getfixturevalue(kind))
    assert pp.write_scene(scene, tmp_path / "a" / "out") == tmp_path / "a" / "out"
    back = pp.read_scene(tmp_path / "a" / "out")
    same(scene, back)
    problem = pp.read_problem(tmp_path / "a" / "out")
    np.testing.assert_array_equal(problem.tracks.bearing, back.tracks.bearing if back.tracks else 0)
    assert set(tree(tmp_path / "a" / "out")) >= FILES
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["out"]


def test_same_scene_same_bytes(tmp_path: Path, turned: pp.SyntheticWorld) -> None:
    scene = scene_of(turned)
    pp.write_scene(scene, tmp_path / "a")
    pp.write_scene(scene, tmp_path / "b")
    assert tree(tmp_path / "a") == tree(tmp_path / "b")


def test_tables_say_what_the_scene_says(tmp_path: Path, turned: pp.SyntheticWorld) -> None:
    scene = scene_of(turned)
    tracks = scene.tracks
    assert tracks is not None
    pp.write_scene(scene, tmp_path / "out")
    cameras, points = rows(tmp_path / "out" / "cameras.csv"), rows(tmp_path / "out" / "points.csv")
    assert [row["view"] for row in cameras] == list(scene.view_labels())
    assert [row["track"] for row in points] == list(scene.track_labels())
    assert (cameras[1]["x"], cameras[1]["component"]) == ("", "-1")
    for i in (0, 2, 5):
        assert [float(cameras[i][c]) for c in "xyz"] == scene.centers[i].tolist()
        wxyz = np.array([[float(cameras[i][c]) for c in ("qw", "qx", "qy", "qz")]])
        np.testing.assert_allclose(rotation_from_quaternion(wxyz)[0], scene.cam_from_world[i], atol=1e-14)
        mine = tracks.view == i
        assert int(cameras[i]["n_observations"]) == mine.sum()
        rms = np.sqrt(np.mean(scene.residual_rad[mine & scene.inlier] ** 2))
        assert float(cameras[i]["angular_rms_deg"]) == pytest.approx(np.degrees(rms))
    for j in (0, 3, 77):
        mine = tracks.track == j
        assert [float(points[j][c]) for c in "xyz"] == scene.points[j].tolist()
        assert int(points[j]["track_length"]) == mine.sum()
        n_inliers = int((mine & scene.inlier).sum())
        assert int(points[j]["n_inliers"]) == n_inliers
        assert ("outliers" in points[j]["flags"]) == (n_inliers < mine.sum())
        assert ("two_views" in points[j]["flags"]) == (n_inliers <= 2)
    assert points[2]["flags"] == "undetermined"


def test_planar_tables(tmp_path: Path, planar: pp.SyntheticWorld) -> None:
    scene = scene_of(planar)
    pp.write_scene(scene, tmp_path / "out")
    row = rows(tmp_path / "out" / "cameras.csv")[0]
    assert "z" not in row
    assert float(row["heading_deg"]) == pytest.approx(np.degrees(scene.cam_from_world[0]))


def test_json(tmp_path: Path, turned: pp.SyntheticWorld) -> None:
    control = pp.Control(views={"a": (0.0, 0.0, 0.0), 3: (1.0, 2.0, 3.0)}, rotation=False)
    options = pp.PositionOptions(gauge="control", control=control)
    pp.write_scene(scene_of(turned), tmp_path / "out", options=options)
    found = json.loads((tmp_path / "out" / "scene.json").read_text())
    assert found["panopath"] == {"version": pp.__version__, "layout": 1}
    assert found["summary"]["status"] == "converged"
    assert found["options"]["control"]["views"] == {"a": [0.0, 0.0, 0.0], "3": [1.0, 2.0, 3.0]}
    assert set(found["files"]) == set(tree(tmp_path / "out"))
    assert found["components"] == [{"views": 11, "points": 149}]


def test_tum_is_the_path_in_time(tmp_path: Path, turned: pp.SyntheticWorld, planar: pp.SyntheticWorld) -> None:
    for world in (turned, planar):
        scene = scene_of(world)
        assert scene.tracks is not None
        assert scene.tracks.time_s is not None
        pp.write_scene(scene, tmp_path / "out")
        table = np.loadtxt(tmp_path / "out" / "trajectory.tum")
        order = np.argsort(scene.tracks.time_s)
        order = order[np.isfinite(scene.centers[order, 0])]
        np.testing.assert_array_equal(table[:, 0], scene.tracks.time_s[order])
        np.testing.assert_array_equal(table[:, 1 : 1 + scene.d], scene.centers[order])
        world_from_cam = rotation_from_quaternion(table[:, [7, 4, 5, 6]])
        if scene.d == 3:
            np.testing.assert_allclose(world_from_cam, scene.cam_from_world[order].transpose(0, 2, 1), atol=1e-14)
        else:
            np.testing.assert_allclose(world_from_cam[:, 0, 0], np.cos(scene.cam_from_world[order]), atol=1e-14)
            np.testing.assert_allclose(world_from_cam[:, 1, 0], np.sin(scene.cam_from_world[order]), atol=1e-14)


def read_ply(path: Path) -> tuple[list[tuple[Any, ...]], list[tuple[Any, ...]]]:
    """An independent reader of binary PLY."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    kinds = {"double": "d", "float": "f", "int": "i", "uchar": "B"}
    elements: list[tuple[int, str]] = []
    for line in head.decode("ascii").splitlines():
        words = line.split()
        if words[0] == "element":
            elements.append((int(words[2]), "<"))
        elif words[0] == "property":
            elements[-1] = (elements[-1][0], elements[-1][1] + kinds[words[1]])
    tables = []
    for count, layout in elements:
        size = struct.calcsize(layout)
        tables.append([struct.unpack_from(layout, body, size * i) for i in range(count)])
        body = body[size * count :]
    assert not body
    return tables[0], tables[1]


def test_ply(tmp_path: Path, turned: pp.SyntheticWorld) -> None:
    scene = scene_of(turned)
    pp.write_scene(scene, tmp_path / "out")
    vertices, edges = read_ply(tmp_path / "out" / "scene.ply")
    points = np.flatnonzero(np.isfinite(scene.points[:, 0]))
    views = np.flatnonzero(np.isfinite(scene.centers[:, 0]))
    positions = np.array([vertex[:3] for vertex in vertices])
    np.testing.assert_array_equal(positions, np.concatenate((scene.points[points], scene.centers[views])))
    assert [vertex[8] for vertex in vertices] == [0] * len(points) + [1] * len(views)
    error_deg = np.array([vertex[6] for vertex in vertices[: len(points)]])
    np.testing.assert_allclose(error_deg, np.degrees(scene.point_statistics().rms_rad[points]), rtol=1e-6)
    # blue where the error is small, red where it is large
    assert vertices[int(np.nanargmin(error_deg))][5] > vertices[int(np.nanargmax(error_deg))][5]
    assert vertices[int(np.nanargmin(error_deg))][3] < vertices[int(np.nanargmax(error_deg))][3]
    # time runs backwards in this scene, so the path starts at the last view and leaves the unknown one out
    assert [edge[:2] for edge in edges] == [
        (len(points) + i + 1, len(points) + i) for i in range(len(views) - 2, -1, -1)
    ]


def test_scene_without_tracks(tmp_path: Path, turned: pp.SyntheticWorld) -> None:
    scene = scene_of(turned)
    bare = pp.Scene(**{f.name: getattr(scene, f.name) for f in fields(pp.Scene) if f.name != "tracks"})
    pp.write_scene(bare, tmp_path / "bare")
    same(bare, pp.read_scene(tmp_path / "bare"))
    assert not (tmp_path / "bare" / "colmap").exists()
    with pytest.raises(pp.InputError, match="without observations"):
        pp.read_tracks(tmp_path / "bare")
    pp.write_scene(bare, tmp_path / "given", tracks=scene.tracks)
    same(scene, pp.read_scene(tmp_path / "given"))
    with pytest.raises(pp.InputError, match="was not made from"):
        pp.write_scene(bare, tmp_path / "given", tracks=pp.Tracks.from_arrays([0], [0], [[1.0, 0.0, 0.0]]))


def test_writing_again(tmp_path: Path, turned: pp.SyntheticWorld, planar: pp.SyntheticWorld) -> None:
    out = tmp_path / "out"

    def draw(folder: Path) -> None:
        (folder / "picture.png").write_bytes(b"old")

    pp.write_scene(scene_of(turned), out, extra=draw)
    assert (out / "picture.png").read_bytes() == b"old"
    (out / "notes.txt").write_text("mine")
    (out / "colmap" / "notes.txt").write_text("mine too")
    pp.write_scene(scene_of(planar), out)
    same(scene_of(planar), pp.read_scene(out))
    # what the first answer had and the second has not is gone; what a person put there is not
    assert set(tree(out)) == FILES | {"notes.txt", "colmap/notes.txt"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_somebody_elses_folder_is_left_alone(tmp_path: Path, planar: pp.SyntheticWorld) -> None:
    out = tmp_path / "out"
    out.mkdir()
    check_writable(out)
    (out / "cameras.csv").write_text("precious")
    before = tree(tmp_path)
    for name in (out, out / "cameras.csv"):
        with pytest.raises(pp.InputError, match=r"not panopath's|is a file"):
            pp.write_scene(scene_of(planar), name)
    assert tree(tmp_path) == before
    (out / "scene.json").write_text('{"other": 1}')
    with pytest.raises(pp.InputError, match="not panopath's"):
        check_writable(out)
    (out / "other.txt").write_text("stays")
    pp.write_scene(scene_of(planar), out, overwrite=True)
    same(scene_of(planar), pp.read_scene(out))
    assert (out / "other.txt").read_text() == "stays"


def test_a_failure_changes_nothing(tmp_path: Path, planar: pp.SyntheticWorld) -> None:
    out = tmp_path / "out"
    pp.write_scene(scene_of(planar), out)
    before = tree(tmp_path)

    def fail(folder: Path) -> None:
        (folder / "half.png").write_bytes(b"1")
        raise RuntimeError("no paper")

    for place in (out, tmp_path / "new"):
        with pytest.raises(RuntimeError, match="no paper"):
            pp.write_scene(scene_of(planar), place, extra=fail)
    assert tree(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_stale_files_outside_the_folder_are_not_touched(tmp_path: Path, planar: pp.SyntheticWorld) -> None:
    """A scene.json that somebody edited must not make us delete elsewhere."""
    out, other = tmp_path / "out", tmp_path / "other.txt"
    pp.write_scene(scene_of(planar), out)
    other.write_text("precious")
    mark = json.loads((out / "scene.json").read_text())
    mark["files"].append("../other.txt")
    (out / "scene.json").write_text(json.dumps(mark))
    pp.write_scene(scene_of(planar), out)
    assert other.read_text() == "precious"


def test_read_scene_errors(tmp_path: Path, planar: pp.SyntheticWorld) -> None:
    with pytest.raises(pp.InputError, match="no such folder"):
        pp.read_scene(tmp_path / "none")
    with pytest.raises(pp.InputError, match=r"no scene\.json"):
        pp.read_scene(tmp_path)
    out = pp.write_scene(scene_of(planar), tmp_path / "out")
    data = (out / "scene.npz").read_bytes()
    (out / "scene.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(pp.InputError, match=r"scene\.npz: is damaged"):
        pp.read_scene(out)
    (out / "scene.npz").unlink()
    with pytest.raises(pp.InputError, match="no such file"):
        pp.read_scene(out)
