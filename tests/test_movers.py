"""Bodies that move, written: what comes back, what the table says, and that no file takes them for points at rest."""

from __future__ import annotations

import csv
import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.cli import main
from panopath.formats.colmap import read_colmap
from panopath.formats.crops import write_crops
from panopath.formats.nerfstudio import write_nerfstudio
from panopath.formats.paths import path_arrays, paths_csv, paths_of_arrays
from panopath.formats.ply import cloud_bytes, ply_bytes
from panopath.formats.structure import known_scene
from panopath.movers import at_rest, curve_times, left_out, resting, samples_at_views, speed, view_times
from panopath.paths import PathModel, PathVerdict
from panopath.pipeline import _sized, fit_to_control
from test_scene_io import read_ply, same, tree

from docs.figures_moving import SIGMA_RAD, crossing, solved


@pytest.fixture(scope="module")
def scene() -> pp.Scene:
    return crossing(20, 60)


def paths_of(scene: pp.Scene) -> pp.Paths:
    assert scene.paths is not None
    return scene.paths


def identical(a: pp.Paths, b: pp.Paths) -> None:
    for name in ("models", "verdicts", "assumption", "freedoms"):
        assert getattr(a, name) == getattr(b, name)
    for name in ("starts", "coefficients", "seen_s", "hidden_by", "body"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert not getattr(b, name).flags.writeable
    assert (a.covariances is None) == (b.covariances is None)
    for x, y in zip(a.covariances or (), b.covariances or (), strict=True):
        np.testing.assert_array_equal(x, y)


def one_path(model: PathModel) -> pp.Paths:
    """A path of random coefficients, seen for ten seconds."""
    n = model.n_functions
    alone = np.full(1, -1, dtype=np.int32)
    coefficients = np.random.default_rng(0).normal(size=(n, 3))
    return pp.Paths(
        (model,), np.array([0, n]), coefficients, None, np.array([(0.0, 10.0)]), (PathVerdict.MOVING,), alone, alone
    )


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("covariances", [True, False])
def test_paths_come_back_exactly(tmp_path: Path, dimension: int, *, covariances: bool) -> None:
    scene = crossing(24, 30, dimension=dimension, covariances=covariances)
    folder = pp.write_scene(scene, tmp_path / "out")
    back = pp.read_scene(folder)
    same(scene, back)
    identical(paths_of(scene), paths_of(back))
    assert tree(pp.write_scene(back, tmp_path / "again")) == tree(folder)


def test_odd_paths_come_back_exactly() -> None:
    """None at all; frequencies that are still to be found; words of any language."""
    none = np.zeros(0, dtype=np.int32)
    nothing = pp.Paths((), np.zeros(1, dtype=np.int64), np.zeros((0, 3)), (), np.zeros((0, 2)), (), none, none)
    back = paths_of_arrays(path_arrays(nothing))
    assert back is not None
    identical(nothing, back)
    models = (pp.Taylor(2, 0.1, None), pp.Fourier(3), pp.Spline((0.0, 0.1, 0.30000000000000004), 1), pp.Static())
    starts = np.cumsum([0, *(one.n_functions for one in models)])
    odd = pp.Paths(
        models,
        starts,
        np.full((starts[-1], 2), np.nan),
        None,
        np.full((4, 2), np.nan),
        tuple(PathVerdict)[:4],
        np.arange(4, dtype=np.int32),
        np.arange(4, dtype=np.int32) - 1,
        "die meisten Spuren ruhen – ō",
        ("",),
    )
    back = paths_of_arrays(path_arrays(odd))
    assert back is not None
    identical(odd, back)
    wrong = replace(one_path(pp.Static()), covariances=(np.zeros((2, 2)),))
    with pytest.raises(pp.InputError, match=r"covariances\[0\] has shape \(2, 2\), expected \(3, 3\)"):
        path_arrays(wrong)


def test_older_folders_have_no_paths(tmp_path: Path, scene: pp.Scene) -> None:
    folder = pp.write_scene(replace(scene, paths=None), tmp_path / "out")
    assert not (folder / "paths.csv").exists()
    assert "paths" not in json.loads((folder / "scene.json").read_text())
    assert pp.read_scene(folder).paths is None
    # and a table that belonged to the answer before is taken away
    pp.write_scene(scene, folder)
    assert (folder / "paths.csv").exists()
    pp.write_scene(replace(scene, paths=None), folder)
    assert not (folder / "paths.csv").exists()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("paths_covariances", np.zeros(5)),
        ("paths_verdict", np.array([99], dtype=np.uint8)),
        ("paths_form", np.zeros(3, dtype=np.uint8)),
        ("paths_words", np.zeros(3, dtype=np.uint8)),
        ("paths_coefficients", None),
    ],
)
def test_damage_is_told(tmp_path: Path, scene: pp.Scene, name: str, value: Any) -> None:
    folder = pp.write_scene(scene, tmp_path / "out")
    with np.load(folder / "scene.npz") as archive:
        arrays = {key: archive[key] for key in archive.files}
    arrays[name] = value
    np.savez(folder / "scene.npz", **{key: array for key, array in arrays.items() if array is not None})
    with pytest.raises(pp.InputError, match="is damaged"):
        pp.read_scene(folder)


def test_observations_given_later_keep_the_paths(tmp_path: Path, scene: pp.Scene) -> None:
    folder = pp.write_scene(replace(scene, tracks=None), tmp_path / "out", tracks=scene.tracks)
    identical(paths_of(scene), paths_of(pp.read_scene(folder)))


def test_json_says_it_in_few_words(tmp_path: Path, scene: pp.Scene) -> None:
    folder = pp.write_scene(scene, tmp_path / "out")
    told = json.loads((folder / "scene.json").read_text())["paths"]
    assert told["verdicts"] == {"static": 60, "moving": 38, "imitated": 1, "hidden": 1, "undetermined": 1}
    assert told["forms"] == {"fourier:1": 2, "spline of degree 3": 10, "taylor:1": 10, "taylor:2": 16}
    assert (told["bodies"], told["not_among_points"]) == (4, 38)
    assert told["assumption"] == paths_of(scene).assumption
    assert told["freedoms"] == list(paths_of(scene).freedoms)


def test_table_says_where_bodies_were(tmp_path: Path, scene: pp.Scene) -> None:
    folder = pp.write_scene(scene, tmp_path / "out")
    with (folder / "paths.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    paths, labels, times = paths_of(scene), scene.track_labels(), view_times(scene)
    assert {row["track"] for row in rows} == {labels[t] for t in np.flatnonzero(paths.moving).tolist()}
    for row in rows[::7]:
        track, now = labels.index(row["track"]), float(row["time_s"])
        assert now in times
        assert paths.seen_s[track, 0] <= now <= paths.seen_s[track, 1]
        assert int(row["body"]) == paths.body[track]
        found = [[float(row[kind + axis]) for axis in "xyz"] for kind in ("", "v", "s")]
        np.testing.assert_allclose(found[0], paths.position(track, [now])[0], rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(found[1], paths.velocity(track, [now])[0], rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(found[2], np.sqrt(np.diag(paths.position_covariance(track, [now])[0])), rtol=1e-3)
    for track in np.flatnonzero(paths.moving).tolist():
        within = (times >= paths.seen_s[track, 0]) & (times <= paths.seen_s[track, 1])
        assert sum(row["track"] == labels[track] for row in rows) == within.sum()


def test_table_without_deviations_or_times() -> None:
    scene = crossing(12, 10, dimension=2, covariances=False)
    text = paths_csv(scene).decode().splitlines()
    assert text[0] == "time_s,track,body,x,y,vx,vy,sx,sy"
    assert all(line.endswith(",,") for line in text[1:])
    samples = samples_at_views(replace(scene, tracks=None))
    paths = paths_of(scene)
    assert sorted(set(samples.time_s.tolist())) == sorted(set(paths.seen_s[paths.moving].ravel().tolist()))
    assert len(samples_at_views(replace(scene, paths=None)).track) == 0
    assert paths_csv(replace(scene, paths=None)).count(b"\n") == 1


def test_points_table_flags_what_moves(tmp_path: Path, scene: pp.Scene) -> None:
    folder = pp.write_scene(scene, tmp_path / "out")
    with (folder / "points.csv").open(newline="", encoding="utf-8") as file:
        flags = [row["flags"].split() for row in csv.DictReader(file)]
    for found, verdict in zip(flags, paths_of(scene).verdicts, strict=True):
        named = {word for word in found if word in ("moving", "hidden", "imitated")}
        assert named == ({verdict.value} - {"static", "undetermined"})
        assert ("undetermined" in found) == (verdict not in (PathVerdict.STATIC, PathVerdict.MOVING))


def test_movers_are_no_points_in_other_programs(tmp_path: Path, scene: pp.Scene) -> None:
    pp.write_scene(scene, tmp_path / "out")
    rests = resting(scene)
    assert (rests.sum(), left_out(scene)) == (60, 38)
    vertices, _ = read_ply(tmp_path / "out" / "scene.ply")
    shown = np.array([row[:3] for row in vertices if not row[-1]])
    np.testing.assert_array_equal(shown, scene.points[rests])
    assert b"comment 38 tracks not known to rest are left out\n" in ply_bytes(scene)
    colours = np.zeros((len(scene.points), 3), dtype=np.uint8)
    assert b"element vertex 60\n" in cloud_bytes(scene, colours)
    assert b"element vertex 98\n" in cloud_bytes(replace(scene, paths=None), colours)
    model = read_colmap(tmp_path / "out" / "colmap" / "0")
    assert model.scene is not None
    assert len(model.scene.points) == 60
    np.testing.assert_allclose(model.scene.points, scene.points[rests])
    size = struct.unpack("<Q", (tmp_path / "out" / "colmap" / "0" / "points3D.bin").read_bytes()[:8])[0]
    assert size == 60
    write_nerfstudio(scene, [f"{k}.jpg" for k in range(20)], tmp_path, (64, 32), colours=colours)
    assert b"element vertex 60\n" in (tmp_path / "points.ply").read_bytes()


def test_crops_see_no_movers(tmp_path: Path, scene: pp.Scene) -> None:
    pytest.importorskip("cv2", reason="the extra images is absent")
    made = write_crops(scene, lambda _: np.zeros((32, 64, 3), dtype=np.uint8), tmp_path)
    assert (made.n_points, made.n_left_out) == (60, 38)


def test_what_rests_alone(scene: pp.Scene) -> None:
    still = at_rest(scene)
    rests = resting(scene)
    assert still.paths is None
    assert scene.tracks is not None
    assert np.isnan(still.points[~rests]).all()
    np.testing.assert_array_equal(still.points[rests], scene.points[rests])
    np.testing.assert_array_equal(still.inlier, scene.inlier & rests[scene.tracks.track])
    assert at_rest(still) is still
    assert resting(still).all()


@pytest.mark.parametrize(
    "model",
    [
        pp.Static(),
        pp.Taylor(1, 5.0, 5.0),
        pp.Taylor(3, 5.0, 5.0),
        pp.Fourier(2, 3.0),
        pp.Spline((0.0, 4.0, 7.0, 10.0)),
        pp.Spline((0.0, 10.0), 1),
    ],
    ids=repr,
)
def test_drawn_pieces_are_nearly_straight(model: PathModel) -> None:
    """Halfway between two times the path is within a fiftieth of its size of the straight piece."""
    paths = one_path(model)
    times = curve_times(model, 0.0, 10.0)
    assert (times[0], times[-1]) == (0.0, 10.0)
    places = paths.position(0, times)
    halfway = paths.position(0, (times[1:] + times[:-1]) / 2)
    off = np.linalg.norm(halfway - (places[1:] + places[:-1]) / 2, axis=1).max()
    assert off <= 0.02 * max(np.ptp(places, axis=0).max(), 1e-12)
    assert len(curve_times(pp.Fourier(1, 1e9), 0.0, 10.0)) == 4096
    assert curve_times(model, 3.0, 3.0).tolist() == [3.0]


def test_speed_and_its_deviation(scene: pp.Scene) -> None:
    """As many times as the covariance would have it drawn, the speed spreads by its deviation."""
    paths = paths_of(scene)
    track = int(np.flatnonzero(paths.moving)[0])
    value, deviation = speed(paths, track, 6.0)
    assert value == pytest.approx(7.0)
    assert paths.covariances is not None
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal(np.zeros(6), paths.covariances[track], 4000).reshape(-1, 2, 3)
    velocity = (paths.coefficients[paths.starts[track] + 1] + drawn[:, 1]) / 6.0
    assert np.std(np.linalg.norm(velocity, axis=1)) == pytest.approx(deviation, rel=0.05)
    assert np.isnan(speed(replace(paths, covariances=None), track, 6.0)[1])
    assert speed(paths, 0, 6.0)[0] == 0.0


def test_many_movers_stay_small(tmp_path: Path) -> None:
    """The words do not grow with the number of bodies, and a row of the table stays a row."""
    n = 3000
    models = tuple(pp.Taylor(2, 7.0, 7.0) for _ in range(n))
    rng = np.random.default_rng(0)
    alone = np.full(n, -1, dtype=np.int32)
    coefficients, seen_s = rng.normal(size=(3 * n, 3)), np.tile((0.0, 14.0), (n, 1))
    covariances = tuple(np.tile(np.eye(9), (n, 1, 1)))
    verdicts = (PathVerdict.MOVING,) * n
    paths = pp.Paths(models, 3 * np.arange(n + 1), coefficients, covariances, seen_s, verdicts, alone, alone)
    tracks = pp.Tracks.from_arrays([0], [0], [(1.0, 0.0, 0.0)], n_views=15, n_tracks=n, time_s=np.arange(15.0))
    scene = known_scene(tracks, None, rng.normal(size=(15, 3)), rng.normal(size=(n, 3)))
    folder = pp.write_scene(replace(scene, paths=paths), tmp_path / "out")
    assert (folder / "scene.json").stat().st_size < 3000
    assert (folder / "paths.csv").stat().st_size < 130 * 15 * n
    identical(paths, paths_of(pp.read_scene(folder)))


def test_residuals_are_against_the_paths(scene: pp.Scene) -> None:
    """Bearings of the world are as noisy for what moves as for what rests."""
    paths, tracks = paths_of(scene), scene.tracks
    assert tracks is not None
    moves = paths.moving[tracks.track]
    rests = resting(scene)[tracks.track]
    for rows in (moves, rests):
        assert np.sqrt(np.mean(scene.residual_rad[rows] ** 2) / 2) == pytest.approx(SIGMA_RAD, rel=0.1)
    with pytest.raises(pp.InputError, match="time_s is None"):
        known_scene(replace(tracks, time_s=None), None, scene.centers, scene.points, paths=paths)


def test_paths_go_along_to_control(scene: pp.Scene) -> None:
    """Known positions of the cameras in another frame bring the bodies there too."""
    turn = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
    there: dict[str | int, list[float]]
    there = dict(enumerate((3.0 * scene.centers @ turn.T + (1.0, 2.0, 3.0)).tolist()))
    moved, before = fit_to_control(scene, pp.Control(views=there)), paths_of(scene)
    after = paths_of(moved)
    for track in np.flatnonzero(before.moving).tolist():
        times = np.linspace(before.seen_s[track, 0], before.seen_s[track, 1], 7)
        expected = 3.0 * before.position(track, times) @ turn.T + (1.0, 2.0, 3.0)
        np.testing.assert_allclose(after.position(track, times), expected, atol=1e-3)
        half_way = after.position(track, [before.seen_s[track].mean()])[0]
        np.testing.assert_allclose(moved.points[track], half_way, atol=1e-9)
    sized = paths_of(_sized(scene, np.array([2.0])))
    np.testing.assert_allclose(sized.position(70, [8.0]), 2.0 * before.position(70, [8.0]))


def test_solved_scene_comes_back_and_is_right(tmp_path: Path) -> None:
    """Found from bearings, written and read: what moves, and where it was within its deviation."""
    world = crossing(40, 120)
    told: list[str] = []
    scene = solved(world, told.append)
    assert told[0].endswith("38 of 38 movers found, 0 that are none")
    back = pp.read_scene(pp.write_scene(scene, tmp_path / "out"))
    identical(paths_of(scene), paths_of(back))
    true, found = paths_of(world), paths_of(back)
    ratios = []
    for track in np.flatnonzero(true.moving).tolist():
        times = samples_at_views(back).time_s[samples_at_views(back).track == track]
        error = found.position(track, times) - true.position(track, times, outside=True)
        variance = np.trace(found.position_covariance(track, times), axis1=1, axis2=2)
        ratios.append(np.sqrt((error**2).sum(axis=1).mean() / variance.mean()))
    assert np.median(ratios) < 2.0
    assert max(ratios) < 4.0


def test_simulated_truth_has_its_paths(tmp_path: Path) -> None:
    arguments = ["simulate", "street", "-o", str(tmp_path / "b.csv"), "--views", "20", "--points", "60", "--quiet"]
    with pytest.raises(SystemExit) as ended:
        main([*arguments, "--set", "mover_fraction=0.3", "--set", "n_bodies=6"])
    assert ended.value.code == 0
    (folder,) = [path for path in tmp_path.iterdir() if path.is_dir()]
    truth = pp.read_scene(folder)
    assert paths_of(truth).moving.sum() > 5
    assert np.nanmax(truth.residual_rad) < 1e-6
