"""The mapper: from a COLMAP database to models, against the truth; what is wrong with databases, told in one line."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest

pycolmap = pytest.importorskip("pycolmap", reason="the extra colmap is not installed")

from panopath.cli import main  # noqa: E402
from panopath.mapping import MapOptions, MappedDatabase, map_database  # noqa: E402
from panopath.model import Float  # noqa: E402

from benchmarks.databases import Score, Spec, Truth, make_database, score_models  # noqa: E402
from benchmarks.mapping import HEADER, Row, lines, means, run_ours  # noqa: E402

DEG = np.pi / 180.0
N = 24
SPECS: dict[str, Spec] = {
    "panoramas": Spec("EQUIRECTANGULAR", N, 1500, wrong_verified=0.2),
    "pinhole": Spec("PINHOLE", N, 5000, wrong_verified=0.2),
    "rig": Spec("rig", 12, 2000, wrong_verified=0.2),
}
_PAIR = 2**31 - 1


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Truth]]:
    """One database of each kind, a fifth of the verified matches wrong."""
    folder = tmp_path_factory.mktemp("databases")
    return {name: (folder / f"{name}.db", make_database(spec, folder / f"{name}.db")) for name, spec in SPECS.items()}


@pytest.fixture
def copy(made: dict[str, tuple[Path, Truth]], tmp_path: Path) -> Path:
    """A database of panoramas that a test may change."""
    return Path(shutil.copy(made["panoramas"][0], tmp_path / "database.db"))


@pytest.fixture
def truth(made: dict[str, tuple[Path, Truth]]) -> Truth:
    return made["panoramas"][1]


def edit(path: Path, *statements: str | tuple[str, tuple[Any, ...]]) -> None:
    connection = sqlite3.connect(path)
    for statement in statements:
        connection.execute(*((statement,) if isinstance(statement, str) else statement))
    connection.commit()
    connection.close()


def pairs_across(path: Path, group: Any, tables: tuple[str, ...] = ("two_view_geometries", "matches")) -> list[Any]:
    """Statements that delete the matches between images of different groups; ``group`` of an image index."""
    with sqlite3.connect(path) as connection:
        found = [row[0] for row in connection.execute("SELECT pair_id FROM matches")]
    connection.close()
    across = [p for p in found if group(p // _PAIR - 1) != group(p % _PAIR - 1)]
    return [(f"DELETE FROM {table} WHERE pair_id = ?", (p,)) for table in tables for p in across]


def mapped(path: Path, **options: Any) -> tuple[pp.Database, MappedDatabase]:
    database = pp.read_database(path)
    return database, map_database(database, MapOptions(**options))


def scored(path: Path, out: Path, truth: Truth, **options: Any) -> Score:
    database, found = mapped(path, **options)
    pp.write_models(database, found.reconstruction, out)
    return score_models(out, truth)


def center_errors(found: MappedDatabase, truth: Truth) -> Float:
    """Of every image, in the frame of the truth as it is; NaN where an image has no pose."""
    return np.asarray(np.linalg.norm(found.reconstruction.centers - truth.centers, axis=1))


# against the truth


@pytest.mark.parametrize(("kind", "median_m"), [("panoramas", 0.006), ("pinhole", 0.02), ("rig", 0.006)])
def test_every_image_is_placed(made: dict[str, tuple[Path, Truth]], kind: str, median_m: float, tmp_path: Path) -> None:
    path, truth = made[kind]
    database, found = mapped(path)
    models = pp.write_models(database, found.reconstruction, tmp_path / "out")
    assert models == [tmp_path / "out" / "0"]
    figures = score_models(tmp_path / "out", truth)
    assert (figures.n_registered, figures.n_models) == (len(truth.names), 1)
    assert figures.median_m < median_m
    assert figures.rotation_deg < 0.05
    assert 0.8 < figures.reprojection_px < 1.15
    # pycolmap reads the very poses that were found, and its own errors are those it was told
    model = pycolmap.Reconstruction(str(models[0]))
    index = {name: i for i, name in enumerate(database.image_names)}
    for image in model.images.values():
        i = index[image.name]
        rotation = image.cam_from_world().rotation.matrix()
        np.testing.assert_allclose(rotation, found.reconstruction.cam_from_world[i], atol=1e-9)
        np.testing.assert_allclose(image.projection_center(), found.reconstruction.centers[i], atol=1e-9)
    told = float(model.compute_mean_reprojection_error())
    model.update_point_3d_errors()
    assert float(model.compute_mean_reprojection_error()) == pytest.approx(told, rel=0.02)


def test_a_rig_has_metric_size_and_one_pose_a_frame(made: dict[str, tuple[Path, Truth]]) -> None:
    path, truth = made["rig"]
    _, found = mapped(path)
    assert found.scene.centers.shape == (12, 3)
    # levers of 5 cm on a walk of 12 m say how large it is, to some percent
    scale = pp.evaluate(found.scene, truth.centers[::4]).scale
    assert scale == pytest.approx(1.0, rel=0.1)
    alone = map_database(pp.read_database(path, use_rigs=False))
    assert alone.scene.centers.shape == (48, 3)
    assert (alone.reconstruction.component >= 0).sum() >= 40


def test_the_second_pass_helps(copy: Path, truth: Truth, tmp_path: Path) -> None:
    once = scored(copy, tmp_path / "once", truth, retriangulate=False)
    twice = scored(copy, tmp_path / "twice", truth)
    assert once.n_registered == twice.n_registered == N
    assert twice.median_m < 1.1 * once.median_m


def test_the_same_bytes_on_any_number_of_threads(copy: Path, tmp_path: Path) -> None:
    models = []
    for threads in ("1", "4"):
        out = tmp_path / threads
        command = [sys.executable, "-m", "panopath.cli", "map", str(copy), "-o", str(out), "--quiet"]
        subprocess.run(command, check=True, env={**os.environ, "RAYON_NUM_THREADS": threads})
        models.append([path.read_bytes() for path in sorted((out / "0").iterdir())])
    assert models[0] == models[1]


def test_raw_matches_alone_will_do(copy: Path, truth: Truth, tmp_path: Path) -> None:
    edit(copy, "DELETE FROM two_view_geometries")
    assert not pp.read_database(copy).is_verified
    figures = scored(copy, tmp_path / "out", truth)
    assert figures.n_registered == N
    assert figures.median_m < 0.006


# priors


def with_priors(path: Path, truth: Truth, *, position: bool = True, gravity: bool = True, sigma: float | None) -> None:
    """Positions east, north and up, 10 mm off, and gravity half a degree off, for all images but each third."""
    rng = np.random.default_rng(4)
    database = pycolmap.Database.open(str(path))
    for i, image in enumerate(database.read_all_images()):
        if i % 3 == 0:
            continue
        prior = pycolmap.PosePrior(pose_prior_id=i + 1, corr_data_id=image.data_id)
        if position:
            prior.position = truth.centers[i] + rng.normal(0.0, 0.01, 3)
            prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
            if sigma is not None:
                prior.position_covariance = np.eye(3) * sigma**2
        if gravity:
            down = -truth.cam_from_world[i, :, 2] + rng.normal(0.0, 0.5 * DEG, 3)
            prior.gravity = down / np.linalg.norm(down)
        database.write_pose_prior(prior, True)
    database.close()


def up_in_model(found: MappedDatabase, truth: Truth) -> Float:
    """Angle between the model's z and the true vertical as each image sees them, radians."""
    cosine = np.einsum("ni,ni->n", found.reconstruction.cam_from_world[:, :, 2], truth.cam_from_world[:, :, 2])
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def test_gravity_puts_z_up(copy: Path, truth: Truth) -> None:
    with_priors(copy, truth, position=False, sigma=None)
    assert up_in_model(mapped(copy)[1], truth).max() < 1.0 * DEG
    assert up_in_model(mapped(copy, use_gravity=False)[1], truth).max() > 5.0 * DEG


@pytest.mark.parametrize("sigma", [0.01, None])
@pytest.mark.parametrize("gravity", [True, False])
def test_positions_put_the_model_in_place(copy: Path, truth: Truth, gravity: bool, sigma: float | None) -> None:
    with_priors(copy, truth, gravity=gravity, sigma=sigma)
    _, found = mapped(copy, use_prior_position=True)
    if sigma is not None:  # 3 m, which is assumed otherwise, is much on a walk of 8 m, and may be called ambiguous
        assert found.scene.summary.status is pp.Status.CONVERGED
    assert center_errors(found, truth).max() < 0.05
    # not asked for, they are not used
    assert center_errors(mapped(copy)[1], truth).max() > 1.0


def test_covariances_of_zero_are_unknown(copy: Path, truth: Truth) -> None:
    with_priors(copy, truth, sigma=0.01)
    edit(copy, ("UPDATE pose_priors SET position_covariance = ? WHERE pose_prior_id > 6", (bytes(72),)))
    assert center_errors(mapped(copy, use_prior_position=True)[1], truth).max() < 0.05


def test_priors_of_a_rig(made: dict[str, tuple[Path, Truth]], tmp_path: Path) -> None:
    path, truth = made["rig"]
    copy = Path(shutil.copy(path, tmp_path / "rig.db"))
    with_priors(copy, truth, sigma=0.05)
    _, found = mapped(copy, use_prior_position=True)
    assert center_errors(found, truth).max() < 0.15
    assert up_in_model(found, truth).max() < 1.5 * DEG


# what is not all connected


def test_groups_become_models_the_largest_first(copy: Path, truth: Truth, tmp_path: Path) -> None:
    edit(copy, *pairs_across(copy, lambda i: i < 9))
    database, found = mapped(copy)
    assert found.scene.summary.status is pp.Status.DISCONNECTED
    models = pp.write_models(database, found.reconstruction, tmp_path / "out")
    assert [path.name for path in models] == ["0", "1"]
    opened = [pycolmap.Reconstruction(str(path)) for path in models]
    names = [{image.name for image in model.images.values() if image.has_pose} for model in opened]
    assert names == [set(truth.names[9:]), set(truth.names[:9])]


def test_images_that_see_nothing_are_left_out(copy: Path, truth: Truth, tmp_path: Path) -> None:
    # the last image has no features, one in the middle no matches
    edit(copy, *pairs_across(copy, lambda i: i if i in {7, N - 1} else -1))
    edit(copy, ("UPDATE keypoints SET rows = 0, data = ? WHERE image_id = ?", (b"", N)))
    database, found = mapped(copy)
    assert np.flatnonzero(found.reconstruction.component < 0).tolist() == [7, N - 1]
    assert np.isnan(found.scene.centers[[7, N - 1]]).all()
    pp.write_models(database, found.reconstruction, tmp_path / "out")
    assert score_models(tmp_path / "out", truth).n_registered == N - 2


def test_a_frame_whose_images_match_only_each_other(made: dict[str, tuple[Path, Truth]], tmp_path: Path) -> None:
    copy = Path(shutil.copy(made["rig"][0], tmp_path / "rig.db"))
    edit(copy, *pairs_across(copy, lambda i: i // 4 if i // 4 == 5 else -1))
    _, found = mapped(copy)
    assert np.flatnonzero(found.scene.view_component < 0).tolist() == [5]
    assert np.flatnonzero(found.reconstruction.component < 0).tolist() == [20, 21, 22, 23]


def test_watermarks_are_passed_over(copy: Path) -> None:
    with sqlite3.connect(copy) as connection:
        ids = [row[0] for row in connection.execute("SELECT pair_id FROM two_view_geometries")]
    connection.close()
    of_image = [p for p in ids if 6 in divmod(p, _PAIR)]
    edit(copy, *[("UPDATE two_view_geometries SET config = 7 WHERE pair_id = ?", (p,)) for p in of_image])
    _, found = mapped(copy)
    assert np.flatnonzero(found.reconstruction.component < 0).tolist() == [5]


def test_pairs_need_enough_matches(copy: Path) -> None:
    database = pp.read_database(copy)
    counts = np.diff(database.match_starts)
    with pytest.raises(pp.InputError, match="no pair of images has 100000 matches"):
        map_database(database, MapOptions(min_num_matches=100_000))
    most = int(np.sort(counts)[-3])
    strict = map_database(database, MapOptions(min_num_matches=most))
    assert (strict.reconstruction.component >= 0).sum() <= 6


def turned_on_the_spot(path: Path) -> None:
    """Panoramas of a far-off world, all from one place."""
    rng = np.random.default_rng(0)
    far = rng.normal(size=(300, 3))
    database = pycolmap.Database.open(str(path))
    camera = pycolmap.Camera(model="EQUIRECTANGULAR", width=3840, height=1920, params=[3840.0, 1920.0], camera_id=1)
    camera.has_prior_focal_length = True
    database.write_camera(camera, True)
    for i in range(6):
        database.write_image(pycolmap.Image(name=f"{i}.jpg", camera_id=1, image_id=i + 1), True)
        ray = far @ pycolmap.Rotation3d(rng.normal(size=3)).matrix().T
        pixels = np.asarray(camera.img_from_cam(ray)) + rng.normal(0.0, 1.0, (300, 2))
        database.write_keypoints(i + 1, pixels.astype(np.float32))
    every = np.tile(np.arange(300, dtype=np.uint32)[:, None], (1, 2))
    for i in range(6):
        for j in range(i + 1, 6):
            database.write_matches(i + 1, j + 1, every)
    database.close()


def test_the_order_of_images_in_a_pair_does_not_matter(copy: Path, truth: Truth, tmp_path: Path) -> None:
    # COLMAP puts the smaller id first; others may not, and may hold both orders
    with sqlite3.connect(copy) as connection:
        rows = connection.execute("SELECT pair_id, rows, data FROM two_view_geometries WHERE rows > 0").fetchall()
    connection.close()
    changes: list[tuple[str, tuple[Any, ...]]] = []
    for k, (pair, n, data) in enumerate(rows):
        first, second = divmod(pair, _PAIR)
        turned = np.ascontiguousarray(np.frombuffer(data, "<u4").reshape(n, 2)[:, ::-1]).tobytes()
        values = (second * _PAIR + first, n, turned)
        if k % 4 < 2:
            changes.append(
                ("INSERT INTO two_view_geometries (pair_id, rows, cols, data, config) VALUES (?, ?, 2, ?, 2)", values)
            )
        if k % 4 == 0:
            changes.append(("DELETE FROM two_view_geometries WHERE pair_id = ?", (pair,)))
    edit(copy, *changes)
    figures = scored(copy, tmp_path / "out", truth)
    assert figures.n_registered == N
    assert figures.median_m < 0.006


def test_turning_on_the_spot_is_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    turned_on_the_spot(tmp_path / "database.db")
    code, said = run(capsys, str(tmp_path / "database.db"), "-o", str(tmp_path / "out"), "--json")
    assert code == 3
    assert json.loads(said.out)["status"] in {"ambiguous", "undetermined"}


# the command line


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, Any]:
    with pytest.raises(SystemExit) as ended:
        main(["map", *arguments])
    return int(ended.value.code or 0), capsys.readouterr()


def refused(capsys: pytest.CaptureFixture[str], path: Path, *arguments: str) -> str:
    """Exit code 2, one line on standard error, and nothing written; the line."""
    before = sorted(path.parent.rglob("*"))
    code, said = run(capsys, str(path), "-o", str(path.parent / "new"), *arguments)
    assert code == 2
    assert not said.out
    assert said.err.count("\n") == 1
    assert said.err.startswith("panopath: ")
    assert sorted(path.parent.rglob("*")) == before
    return str(said.err)


def test_map_writes_models(copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    code, said = run(capsys, str(copy), "-o", str(out), "--json")
    assert code == 0
    plain = json.loads(said.out)
    assert (plain["status"], plain["n_images"], plain["n_registered"]) == ("converged", N, N)
    assert plain["models"] == [str(out / "0")]
    assert not said.err
    certificate = pp.read_certificate(out)
    assert (certificate["orientation"], certificate["gauge_freedoms"]) == ("free", 7)
    assert plain["certificate"]["sentence"] == certificate["sentence"]
    first = (out / "0" / "images.bin").read_bytes()
    # there already: not without --overwrite
    code, said = run(capsys, str(copy), "-o", str(out))
    assert (code, said.err.count("\n")) == (2, 1)
    code, said = run(capsys, str(copy), "-o", str(out), "--overwrite", "--no-retriangulation")
    assert code == 0
    assert f"{N} of {N} images" in said.out
    assert (out / "0" / "images.bin").read_bytes() != first
    code, said = run(capsys, str(copy), "-o", str(out), "--overwrite", "--quiet")
    assert (code, said.out, said.err) == (0, "", "")
    assert (out / "0" / "images.bin").read_bytes() == first


def test_unusable_databases_are_one_line(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = copy.read_bytes()
    copy.write_bytes(b"")
    assert "is empty" in refused(capsys, copy)
    copy.write_bytes(b"not a database at all")
    assert "not a SQLite file" in refused(capsys, copy)
    copy.write_bytes(whole[: len(whole) // 2])
    assert "database.db" in refused(capsys, copy)
    copy.write_bytes(whole)
    edit(copy, "DELETE FROM two_view_geometries", "DELETE FROM matches")
    assert "has no matches" in refused(capsys, copy)
    copy.unlink()
    assert "no such file" in refused(capsys, copy)


def test_a_locked_database_is_one_line(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit(copy, "PRAGMA journal_mode = DELETE")
    writer = sqlite3.connect(copy)
    writer.execute("BEGIN EXCLUSIVE")
    try:
        assert "locked" in refused(capsys, copy)
    finally:
        writer.close()


def test_options_are_refused_by_name(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "max_epipolar_error_px is -1.0" in refused(capsys, copy, "--max-epipolar-error", "-1")
    assert "--min-num-matches" in refused(capsys, copy, "--min-num-matches", "100000")
    for name in ("min_num_matches", "min_track_length", "max_partners", "max_epipolar_error_px", "feature_sigma_px"):
        with pytest.raises(pp.InputError, match=name):
            MapOptions(**{name: 0})  # type: ignore[arg-type]
    with pytest.raises(pp.InputError, match=r"database is a \w+Path, expected Database"):
        map_database(copy)  # type: ignore[arg-type]
    for name in ("prior_position_sigma", "gravity_sigma_rad"):
        with pytest.raises(pp.InputError, match=name):
            MapOptions(**{name: float("nan")})  # type: ignore[arg-type]


def test_guessed_focal_lengths_are_refused(
    made: dict[str, tuple[Path, Truth]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = Path(shutil.copy(made["pinhole"][0], tmp_path / "database.db"))
    edit(copy, "UPDATE cameras SET prior_focal_length = 0")
    said = refused(capsys, copy)
    assert "camera 1 (PINHOLE" in said
    assert "focal length" in said
    code, _ = run(capsys, str(copy), "-o", str(tmp_path / "out"), "--trust-focal-lengths", "--quiet")
    assert code == 0


# the benchmark


def test_the_benchmark_prints_both_mappers(made: dict[str, tuple[Path, Truth]], tmp_path: Path) -> None:
    path, truth = made["panoramas"]
    assert run_ours(path, tmp_path / "out")["seconds"] > 0.0
    assert "no such file" in run_ours(tmp_path / "none.db", tmp_path / "out")["error"]
    found = score_models(tmp_path / "out", truth)
    row = Row("case", 0, "sizes", found, found, 2.0, 5.0)
    assert (row.speedup, row.error_ratio) == (2.5, 1.0)
    assert [len(line) for line in lines(row)] == [len(HEADER)] * 2
    lost = Row("case", 1, "sizes", found, None, 2.0, float("nan"), "peer: stopped")
    assert "no answer (peer: stopped)" in list(lines(lost))[1]
    assert means([row, lost]).startswith("1 worlds: rms")
    assert means([lost]) == "no world that both mapped"
