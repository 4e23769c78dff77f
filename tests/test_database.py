"""COLMAP databases: what is in them, what is wrong with them, and models of their images."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pycolmap
import pytest
from panopath.formats import models

MODELS: dict[str, list[float]] = {
    "PINHOLE": [800.0, 810.0, 512.0, 384.0],
    "OPENCV_FISHEYE": [300.0, 300.0, 512.0, 384.0, 0.01, -0.002, 0.0, 0.0],
    "EQUIRECTANGULAR": [1024.0, 768.0],
}
GRAVITY = np.array([0.0, 1.0, 0.0])


def make(path: Path, model: str = "PINHOLE", *, n_cameras: int = 1, known_focal: bool = True) -> Any:
    """A database by pycolmap alone, rows of which are wrong in no way; returns the truth."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 2, n_cameras, 3
    options.num_points3D, options.num_points2D_without_point3D = 40, 3
    options.camera_model_id = pycolmap.CameraModelId.__members__[model]
    options.camera_params = MODELS[model]
    options.camera_width, options.camera_height = 1024, 768
    options.camera_has_prior_focal_length = known_focal
    options.inlier_match_ratio = 0.8
    options.prior_position = options.prior_gravity = True
    options.prior_position_coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
    pycolmap.set_random_seed(7)
    database = pycolmap.Database.open(str(path))
    truth = pycolmap.synthesize_dataset(options, database)
    database.close()
    return truth


def edit(path: Path, *statements: str | tuple[str, tuple[Any, ...]]) -> None:
    """Change a database by hand; what COLMAP would not write."""
    connection = sqlite3.connect(path)
    for statement in statements:
        connection.execute(*((statement,) if isinstance(statement, str) else statement))
    connection.commit()
    connection.close()


def poses(database: pp.Database, truth: Any) -> tuple[Any, Any]:
    images = [truth.images[i] for i in database.image_id.tolist()]
    rotations = np.array([image.cam_from_world().rotation.matrix() for image in images])
    return rotations, np.array([image.projection_center() for image in images])


def beside(path: Path) -> list[str]:
    return sorted(other.name for other in path.parent.iterdir())


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    path = tmp_path_factory.mktemp("made") / "pinhole.db"
    return path, make(path)


@pytest.fixture(scope="module")
def made_rig(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    path = tmp_path_factory.mktemp("made") / "rig.db"
    return path, make(path, n_cameras=3)


@pytest.fixture
def copy(made: tuple[Path, Any], tmp_path: Path) -> Path:
    """A database that a test may spoil."""
    return Path(shutil.copy(made[0], tmp_path / "database.db"))


# what is there


@pytest.mark.parametrize("model", MODELS)
def test_reads_what_pycolmap_wrote(tmp_path: Path, model: str) -> None:
    path = tmp_path / "database.db"
    truth = make(path, model)
    found = pp.read_database(path)
    assert (found.n_images, found.n_frames, found.has_rigs, found.is_verified) == (6, 6, False, True)
    database = pycolmap.Database.open(str(path))
    assert found.image_names == tuple(image.name for image in database.read_all_images())
    for i, image_id in enumerate(found.image_id.tolist()):
        rows = slice(found.feature_starts[i], found.feature_starts[i + 1])
        np.testing.assert_array_equal(found.pixels[rows], database.read_keypoints(image_id)[:, :2])
        assert found.cameras[found.image_camera[i]].camera_id == database.read_image(image_id).camera_id
    for p, (a, b) in enumerate(found.image_id[found.pairs].tolist()):
        rows = slice(found.match_starts[p], found.match_starts[p + 1])
        geometry = database.read_two_view_geometry(a, b)
        np.testing.assert_array_equal(found.matches[rows], geometry.inlier_matches)
        assert found.pair_config[p] == int(geometry.config)
    assert len(found.pairs) == 15
    assert len(found.matches) == 15 * 40
    database.close()
    # bearings point at the points that the truth says the features show, to the digits of float32 pixels
    rotation, center = poses(found, truth)
    for i, image_id in enumerate(found.image_id.tolist()):
        for k, point2d in enumerate(truth.images[image_id].points2D):
            if point2d.has_point3D():
                ray = rotation[i] @ (truth.points3D[point2d.point3D_id].xyz - center[i])
                bearing = found.bearings[found.feature_starts[i] + k]
                assert np.linalg.norm(np.cross(bearing, ray)) < 1e-6 * np.linalg.norm(ray)


def test_arrays_are_read_only(made: tuple[Path, Any]) -> None:
    found = pp.read_database(made[0])
    with pytest.raises(ValueError, match="read-only"):
        found.bearings[0] = 0.0
    assert repr(found).startswith("Database(6 images, 6 frames, 2 cameras, ")


def test_angle_of_a_pixel(copy: Path, tmp_path: Path) -> None:
    at = np.array([[512, 384], [1024, 768]], dtype=np.float32)
    edit(copy, ("UPDATE keypoints SET rows = 2, cols = 2, data = ? WHERE image_id = 1", (at.tobytes(),)))
    edit(copy, "DELETE FROM two_view_geometries WHERE pair_id < 2 * 2147483647")
    found = pp.read_database(copy)
    fx, fy = 800.0, 810.0
    # the solid angle of a pixel off axis falls with the cube of the cosine
    cosine = 1.0 / np.sqrt(1.0 + (512 / fx) ** 2 + (384 / fy) ** 2)
    expected = np.array([1.0, cosine**1.5]) / np.sqrt(fx * fy)
    np.testing.assert_allclose(found.pixel_rad[:2], expected, rtol=2e-3)
    make(tmp_path / "panorama.db", "EQUIRECTANGULAR")
    np.testing.assert_allclose(pp.read_database(tmp_path / "panorama.db").pixel_rad, 2 * np.pi / 1024)


def test_priors(made: tuple[Path, Any]) -> None:
    path, truth = made
    found = pp.read_database(path)
    rotation, center = poses(found, truth)
    np.testing.assert_allclose(found.gravity, rotation @ GRAVITY, atol=1e-9)
    np.testing.assert_allclose(found.position, center, atol=1e-9)
    assert set(found.position_system.tolist()) == {1}
    assert np.isnan(found.position_covariance).all()


def test_priors_that_are_not_there(copy: Path) -> None:
    edit(
        copy,
        "UPDATE pose_priors SET position = NULL, gravity = NULL WHERE corr_data_id = 1",
        (
            "UPDATE pose_priors SET position_covariance = ? WHERE corr_data_id = 2",
            (np.diag([1.0, 2.0, 3.0]).tobytes(),),
        ),
        ("UPDATE pose_priors SET gravity = ? WHERE corr_data_id = 3", (np.zeros(3).tobytes(),)),
    )
    found = pp.read_database(copy)
    assert np.isnan(found.position[0]).all()
    assert np.isnan(found.gravity[[0, 2]]).all()
    assert found.position_system[:2].tolist() == [-1, 1]
    np.testing.assert_array_equal(found.position_covariance[1], np.diag([1.0, 2.0, 3.0]))


def test_positions_in_metres(made: tuple[Path, Any], copy: Path) -> None:
    found = pp.read_database(made[0])
    np.testing.assert_array_equal(found.local_positions(), found.position)
    places = np.array([[47.37, 8.54, 450.0], [47.38, 8.53, 470.0], [-33.9, 151.2, 10.0]])
    edit(
        copy,
        "UPDATE pose_priors SET coordinate_system = 0",
        "UPDATE pose_priors SET position = NULL WHERE corr_data_id > 3",
        *(
            ("UPDATE pose_priors SET position = ? WHERE corr_data_id = ?", (place.tobytes(), i + 1))
            for i, place in enumerate(places)
        ),
    )
    local = pp.read_database(copy).local_positions()
    expected = pycolmap.GPSTransform().ellipsoid_to_enu(places, *places[0])
    np.testing.assert_allclose(local[:3], expected, atol=1e-6)
    assert np.isnan(local[3:]).all()
    edit(copy, "UPDATE pose_priors SET coordinate_system = 1 WHERE corr_data_id = 2")
    with pytest.raises(pp.InputError, match="in WGS84 and in other coordinates"):
        pp.read_database(copy).local_positions()


def test_rigs(made_rig: tuple[Path, Any]) -> None:
    path, truth = made_rig
    found = pp.read_database(path)
    assert (found.n_images, found.n_frames, found.has_rigs, len(found.rigs)) == (18, 6, True, 2)
    rotation, center = poses(found, truth)
    rig_from_world, rig_centers = found.frame_poses(rotation, center)
    for f, frame_id in enumerate(found.frame_id.tolist()):
        pose = truth.frames[frame_id].rig_from_world
        np.testing.assert_allclose(rig_from_world[f], pose.rotation.matrix(), atol=1e-12)
        np.testing.assert_allclose(rig_centers[f], pose.inverse().translation, atol=1e-12)
    # every image, not only the one that its frame's pose was taken from
    again = found.image_poses(rig_from_world, rig_centers)
    np.testing.assert_allclose(again[0], rotation, atol=1e-12)
    np.testing.assert_allclose(again[1], center, atol=1e-12)
    alone = pp.read_database(path, use_rigs=False)
    assert (alone.n_frames, alone.has_rigs, alone.rigs) == (18, False, ())
    np.testing.assert_array_equal(alone.image_poses(rotation, center)[1], center)


def test_a_rig_that_is_not_calibrated(made_rig: tuple[Path, Any], tmp_path: Path) -> None:
    path = Path(shutil.copy(made_rig[0], tmp_path / "rig.db"))
    edit(path, "UPDATE rig_sensors SET sensor_from_rig = NULL WHERE sensor_id = 2")
    with pytest.raises(pp.InputError, match="rig 1 does not know where its camera 2 is"):
        pp.read_database(path)
    assert pp.read_database(path, use_rigs=False).n_frames == 18


def test_databases_of_older_versions(made_rig: tuple[Path, Any], tmp_path: Path) -> None:
    path = Path(shutil.copy(made_rig[0], tmp_path / "old.db"))
    priors = "CREATE TABLE pose_priors (image_id INTEGER, position BLOB, coordinate_system INTEGER)"
    row = ("INSERT INTO pose_priors VALUES (2, ?, 0)", (np.array([47.0, 8.0, 400.0]).tobytes(),))
    rigs = ("frame_data", "frames", "rig_sensors", "rigs", "pose_priors")
    edit(path, *(f"DROP TABLE {table}" for table in rigs), priors, row)
    found = pp.read_database(path)
    assert (found.n_frames, found.rigs) == (18, ())
    np.testing.assert_array_equal(found.position[1], [47.0, 8.0, 400.0])
    assert found.position_system[:2].tolist() == [-1, 0]
    edit(path, "DROP TABLE pose_priors")
    assert np.isnan(pp.read_database(path).position).all()


def test_raw_matches_where_none_are_verified(copy: Path) -> None:
    edit(copy, "DELETE FROM two_view_geometries")
    found = pp.read_database(copy)
    assert not found.is_verified
    assert set(found.pair_config.tolist()) == {-1}
    database = pycolmap.Database.open(str(copy))
    assert len(found.matches) == database.num_matches() > 15 * 40
    database.close()
    assert "raw matches" in repr(found)


def test_guessed_focal_lengths(tmp_path: Path) -> None:
    path = tmp_path / "database.db"
    make(path, known_focal=False)
    with pytest.raises(pp.InputError, match=r"camera 1 \(PINHOLE, 1024 x 768\) has no known focal length, 805 px is"):
        pp.read_database(path)
    assert pp.read_database(path, trust_focal_lengths=True).n_images == 6
    make(tmp_path / "panorama.db", "EQUIRECTANGULAR", known_focal=False)
    assert pp.read_database(tmp_path / "panorama.db").n_images == 6


def test_features_without_bearings_have_no_matches(copy: Path) -> None:
    whole = pp.read_database(copy)
    pixels = whole.pixels[:43].astype(np.float32)
    pixels[:5] = [[np.nan, 1], [np.inf, 1], [1, -np.inf], [np.nan, np.nan], [1, np.nan]]
    edit(copy, ("UPDATE keypoints SET cols = 2, data = ? WHERE image_id = 1", (pixels.tobytes(),)))
    found = pp.read_database(copy)
    assert np.isnan(found.bearings[:5]).all()
    assert np.isnan(found.pixel_rad[:5]).all()
    np.testing.assert_array_equal(found.bearings[5:], whole.bearings[5:])
    nodes = found.feature_starts[np.repeat(found.pairs, np.diff(found.match_starts), axis=0)] + found.matches
    assert np.isfinite(found.bearings[nodes]).all()
    assert 0 < len(whole.matches) - len(found.matches) <= 5 * 5
    edit(copy, ("UPDATE keypoints SET data = ?", (np.full((43, 6), np.nan, dtype=np.float32).tobytes(),)))
    with pytest.raises(pp.InputError, match=r"(no match joins|expected 43 x 2)"):
        pp.read_database(copy)


def test_images_without_features_stay(copy: Path) -> None:
    edit(
        copy,
        "DELETE FROM keypoints WHERE image_id = 6",
        "DELETE FROM two_view_geometries WHERE pair_id % 2147483647 = 6",
    )
    found = pp.read_database(copy)
    assert found.n_images == 6
    assert found.n_features[5] == 0
    assert 5 not in found.pairs


# nothing is written


def test_leaves_no_trace(copy: Path) -> None:
    before = copy.read_bytes()
    pp.read_database(copy)
    assert beside(copy) == ["database.db"]
    edit(copy, "PRAGMA journal_mode = DELETE")
    pp.read_database(copy)
    assert beside(copy) == ["database.db"]
    edit(copy, "PRAGMA journal_mode = WAL")
    copy.chmod(0o444)
    copy.parent.chmod(0o555)
    try:
        assert pp.read_database(copy).n_images == 6
    finally:
        copy.parent.chmod(0o755)
    assert len(copy.read_bytes()) == len(before)


def test_reads_the_log_of_a_program_that_has_it_open(copy: Path) -> None:
    writer = sqlite3.connect(copy)
    writer.execute("UPDATE images SET name = 'renamed.jpg' WHERE image_id = 1")
    writer.commit()
    assert beside(copy) == ["database.db", "database.db-shm", "database.db-wal"]
    assert pp.read_database(copy).image_names[0] == "renamed.jpg"
    # a program that was stopped leaves its log; what it had committed is read from a copy
    left = copy.with_name("left.db")
    shutil.copy(copy, left)
    shutil.copy(copy.with_name("database.db-wal"), left.with_name("left.db-wal"))
    before = beside(left)
    assert pp.read_database(left).image_names[0] == "renamed.jpg"
    assert beside(left) == before
    writer.close()


HOLD = """
import sqlite3, sys
connection = sqlite3.connect(sys.argv[1])
connection.execute("BEGIN EXCLUSIVE")
print("held", flush=True)
sys.stdin.read()
"""


def test_locked_by_another_process(copy: Path) -> None:
    edit(copy, "PRAGMA journal_mode = DELETE")
    command = [sys.executable, "-c", HOLD, str(copy)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(pp.InputError, match=r"database\.db: is locked by another program"):
            pp.read_database(copy)
        holder.communicate("")
    assert pp.read_database(copy).n_images == 6


# what cannot be used

BLOB = (b"\x00" * 12,)
SPOILT: dict[str, tuple[list[str | tuple[str, tuple[Any, ...]]], str]] = {
    "no images": (["DELETE FROM images"], "has no image"),
    "no matches": (["DELETE FROM matches", "DELETE FROM two_view_geometries"], "has no matches"),
    "empty matches": (["UPDATE matches SET rows = 0", "UPDATE two_view_geometries SET rows = 0"], "has no matches"),
    "no table": (["DROP TABLE keypoints"], "has no table keypoints"),
    "no column": (["ALTER TABLE matches RENAME COLUMN data TO other"], "the table matches has no column data"),
    "no column of rigs": (
        ["ALTER TABLE frames RENAME COLUMN rig_id TO other"],
        "the table frames has no column rig_id",
    ),
    "short key points": (
        [("UPDATE keypoints SET data = ? WHERE image_id = 2", BLOB)],
        "key points of image 2 are 12 b",
    ),
    "key points of text": (["UPDATE keypoints SET data = 'x' WHERE image_id = 2"], "key points of image 2 are 'x'"),
    "key points NULL": (["UPDATE keypoints SET data = NULL WHERE image_id = 2"], "key points of image 2 are 0 bytes"),
    "key points of one column": (["UPDATE keypoints SET rows = 6 * rows, cols = 1"], "expected 258 x 1 numbers"),
    "key points of no image": (
        ["UPDATE keypoints SET image_id = 99 WHERE image_id = 2"],
        "image 99, which images lacks",
    ),
    "rows that are text": (["UPDATE keypoints SET rows = 'many'"], "a value of the wrong kind"),
    "short matches": (
        [("UPDATE two_view_geometries SET data = ?", BLOB)],
        "the pair 2147483649 12 bytes, expected 40 x 2",
    ),
    "matches of three": (["UPDATE two_view_geometries SET cols = 3"], "expected 40 x 2 numbers"),
    "matches of no image": (
        ["UPDATE two_view_geometries SET pair_id = 2147483647 + 99 WHERE pair_id = 2147483647 + 2"],
        "the images 1 and 99, expected two different ones",
    ),
    "matches of one image": (
        ["UPDATE two_view_geometries SET pair_id = 2147483647 + 1 WHERE pair_id = 2147483647 + 2"],
        "the images 1 and 1, expected two different ones",
    ),
    "matches beyond the features": (
        [("UPDATE two_view_geometries SET rows = 1, data = ?", (np.array([1, 43], dtype="<u4").tobytes(),))],
        "names feature 43 of image camera000001_frame000001.png, which has 43 features",
    ),
    "matches beyond all": (
        [("UPDATE two_view_geometries SET rows = 1, data = ?", (b"\xff" * 8,))],
        "names a feature 4294967295",
    ),
    "unknown camera": (
        ["UPDATE images SET camera_id = 9 WHERE image_id = 2"],
        "has the camera 9, which the table camer",
    ),
    "unknown model": (["UPDATE cameras SET model = 99"], "camera 1: 99 with 4 parameters is not"),
    "camera without parameters": (["UPDATE cameras SET params = NULL"], "camera 1: 1 with 0 parameters is not"),
    "camera of odd bytes": ([("UPDATE cameras SET params = ?", BLOB)], "camera 1: params is 12 bytes"),
    "camera of NaN": (
        [("UPDATE cameras SET params = ?", (np.full(4, np.nan).tobytes(),))],
        r"camera 1 has parameters \(nan",
    ),
    "image in no frame": (["DELETE FROM frame_data WHERE data_id = 2"], "is in no frame, but others are"),
    "frame of no rig": (["UPDATE frames SET rig_id = 77 WHERE frame_id = 2"], "frame 2, which has no rig"),
    "frame of another camera": (["UPDATE frame_data SET sensor_id = 2 WHERE data_id = 2"], "but 2 in its frame 2"),
    "two images at once": (
        ["UPDATE frame_data SET frame_id = 1 WHERE data_id = 2"],
        "the frame 1 has two images of camera 1",
    ),
    "rig without the camera": (["UPDATE frames SET rig_id = 2 WHERE frame_id = 2"], "rig 2, which does not have it"),
    "short prior": ([("UPDATE pose_priors SET position = ?", (b"\x00" * 8,))], "position is 1 numbers, expected 3"),
    "image name of bytes": ([("UPDATE images SET name = ? WHERE image_id = 2", (b"x",))], "name b'x', expected text"),
}


@pytest.mark.parametrize("case", SPOILT)
def test_spoilt(copy: Path, case: str) -> None:
    statements, message = SPOILT[case]
    edit(copy, "PRAGMA foreign_keys = OFF", *statements)
    with pytest.raises(pp.InputError, match=message) as raised:
        pp.read_database(copy)
    assert str(raised.value).startswith(str(copy))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: b"", "is empty"),
        (lambda data: b"view,track\n1,2\n", "is not a SQLite file"),
        (lambda data: data[: len(data) // 2], "is damaged"),
        (lambda data: data[:100], "is damaged"),
        (lambda data: data[:100] + b"\xa5" * (len(data) - 100), "is damaged"),
    ],
)
def test_damaged(copy: Path, damage: Callable[[bytes], bytes], message: str) -> None:
    copy.write_bytes(damage(copy.read_bytes()))
    with pytest.raises(pp.InputError, match=message) as raised:
        pp.read_database(copy)
    assert str(raised.value).startswith(str(copy))
    assert "\n" not in str(raised.value)
    assert beside(copy) == ["database.db"]


def test_not_a_file(tmp_path: Path) -> None:
    with pytest.raises(pp.InputError, match="there is no such file"):
        pp.read_database(tmp_path / "absent.db")
    with pytest.raises(pp.InputError, match="is a folder"):
        pp.read_database(tmp_path)
    assert beside(tmp_path / "absent.db") == []


# models


def observations_of(database: pp.Database, truth: Any) -> tuple[Any, Any]:
    """Points, and (N, 3) image, feature and point."""
    index = {image_id: i for i, image_id in enumerate(database.image_id.tolist())}
    points = list(truth.points3D.values())
    rows = [(index[e.image_id], e.point2D_idx, p) for p, point in enumerate(points) for e in point.track.elements]
    return np.array([point.xyz for point in points]), np.array(rows)


def reconstruction_of(database: pp.Database, truth: Any, **options: Any) -> pp.Reconstruction:
    return pp.Reconstruction.from_arrays(
        database, *poses(database, truth), *observations_of(database, truth), **options
    )


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("n_cameras", [1, 3])
def test_pycolmap_opens_what_is_written(tmp_path: Path, model: str, n_cameras: int) -> None:
    truth = make(tmp_path / "database.db", model, n_cameras=n_cameras)
    database = pp.read_database(tmp_path / "database.db")
    found = reconstruction_of(database, truth)
    (folder,) = pp.write_models(database, found, tmp_path / "out")
    assert folder == tmp_path / "out" / "0"
    opened = pycolmap.Reconstruction(str(folder))
    assert opened.num_reg_images() == database.n_images
    assert (opened.num_rigs(), opened.num_frames(), opened.num_cameras()) == (2, 6, 2 * n_cameras)
    for image_id, image in opened.images.items():
        expected = truth.images[image_id]
        assert (image.name, image.camera_id, image.frame_id) == (expected.name, expected.camera_id, expected.frame_id)
        np.testing.assert_allclose(
            image.cam_from_world().matrix(), expected.cam_from_world().matrix(), rtol=0, atol=1e-9
        )
        i = database.image_id.tolist().index(image_id)
        rows = slice(database.feature_starts[i], database.feature_starts[i + 1])
        np.testing.assert_array_equal([p.xy for p in image.points2D], database.pixels[rows])
    for camera_id, camera in opened.cameras.items():
        assert camera.model == truth.cameras[camera_id].model
        np.testing.assert_array_equal(camera.params, truth.cameras[camera_id].params)
    points = list(truth.points3D.values())
    assert opened.num_points3D() == len(points)
    for point_id, point in opened.points3D.items():
        np.testing.assert_array_equal(point.xyz, points[point_id - 1].xyz)
        tracks = [{(e.image_id, e.point2D_idx) for e in p.track.elements} for p in (point, points[point_id - 1])]
        assert tracks[0] == tracks[1]
    ours = {i: point.error for i, point in opened.points3D.items()}
    opened.update_point_3d_errors()
    assert ours == pytest.approx({i: point.error for i, point in opened.points3D.items()}, rel=1e-4, abs=1e-6)
    # text by pycolmap, and back here
    opened.write_text(str(folder))
    for file in folder.glob("*.bin"):
        file.unlink()
    problem = pp.read_problem(folder)
    assert len(problem.tracks) == len(found.image)


def test_errors_are_pycolmaps(made_rig: tuple[Path, Any], tmp_path: Path) -> None:
    path, truth = made_rig
    database = pp.read_database(path)
    points, rows = observations_of(database, truth)
    points = points + np.random.default_rng(3).normal(0, 0.02, points.shape)
    found = pp.Reconstruction.from_arrays(database, *poses(database, truth), points, rows)
    (folder,) = pp.write_models(database, found, tmp_path)
    opened = pycolmap.Reconstruction(str(folder))
    ours = {i: point.error for i, point in opened.points3D.items()}
    opened.update_point_3d_errors()
    assert min(ours.values()) > 0.1
    assert ours == pytest.approx({i: point.error for i, point in opened.points3D.items()}, rel=1e-9)


def test_one_model_a_component(made: tuple[Path, Any], tmp_path: Path) -> None:
    path, truth = made
    database = pp.read_database(path)
    rotation, center = poses(database, truth)
    points, rows = observations_of(database, truth)
    center[5], points[3] = np.nan, np.nan
    component = np.array([4, 4, 7, 7, 7, 7])
    found = pp.Reconstruction.from_arrays(database, rotation, center, points, rows, component=component)
    assert pp.write_models(database, found, tmp_path) == [tmp_path / "0", tmp_path / "1"]
    large, small = (pycolmap.Reconstruction(str(tmp_path / name)) for name in "01")
    assert sorted(large.images) == [3, 4, 5]
    assert sorted(small.images) == [1, 2]
    # every point has most of its observations in the large one, where the one without a position is left out
    assert large.num_points3D() == len(points) - 1
    assert large.compute_num_observations() == 3 * (len(points) - 1)
    assert small.num_points3D() == 0


def test_an_earlier_rig_does_not_stay(made_rig: tuple[Path, Any], tmp_path: Path) -> None:
    path, truth = made_rig
    database = pp.read_database(path)
    (folder,) = pp.write_models(database, reconstruction_of(database, truth), tmp_path)
    assert (folder / "rigs.bin").exists()
    alone = pp.read_database(path, use_rigs=False)
    rotation, center = poses(alone, truth)
    shift = np.array([1.0, 2.0, 3.0])
    found = pp.Reconstruction.from_arrays(alone, rotation, center + shift, *observations_of(alone, truth))
    (folder,) = pp.write_models(alone, found, tmp_path)
    assert not (folder / "rigs.bin").exists()
    opened = pycolmap.Reconstruction(str(folder))
    np.testing.assert_allclose(opened.images[2].projection_center(), center[1] + shift, atol=1e-9)


def test_nothing_to_write(made: tuple[Path, Any], tmp_path: Path) -> None:
    path, truth = made
    database = pp.read_database(path)
    rotation, center = poses(database, truth)
    found = pp.Reconstruction.from_arrays(
        database, rotation, np.full_like(center, np.nan), np.empty((0, 3)), np.empty((0, 3), dtype=int)
    )
    with pytest.raises(pp.InputError, match="no image is registered"):
        pp.write_models(database, found, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    # poses without points are a model
    found = pp.Reconstruction.from_arrays(database, rotation, center, np.empty((0, 3)), np.empty((0, 3), dtype=int))
    (folder,) = pp.write_models(database, found, tmp_path / "out")
    assert pycolmap.Reconstruction(str(folder)).num_reg_images() == 6


def test_arguments_of_a_reconstruction(made: tuple[Path, Any], tmp_path: Path) -> None:
    path, truth = made
    database = pp.read_database(path)
    rotation, center = poses(database, truth)
    points, rows = observations_of(database, truth)
    good: dict[str, Any] = {"cam_from_world": rotation, "centers": center, "points": points, "observations": rows}
    for change, message in (
        ({"centers": center[:5]}, r"centers has shape \(5, 3\), expected \(6, 3\)"),
        ({"cam_from_world": center}, r"cam_from_world has shape \(6, 3\), expected \(6, 3, 3\)"),
        ({"points": points[:, :2]}, r"points has shape \(40, 2\), expected \(n, 3\)"),
        ({"points": [["a", "b", "c"]]}, "points does not hold numbers"),
        ({"observations": rows * 1.0}, "observations has type float64"),
        ({"observations": rows[:, :2]}, r"shape \(240, 2\)"),
        ({"observations": np.array([[0, 0, 0], [6, 0, 0]])}, r"observations\[1\] names the image 6, expected one .* 6"),
        ({"observations": np.array([[0, 43, 0]])}, r"observations\[0\] names the feature 43, expected .* below 43"),
        ({"observations": np.array([[0, 0, -1]])}, r"observations\[0\] names the point -1"),
        ({"component": np.zeros(5, dtype=int)}, r"component has type int64 and shape \(5,\)"),
    ):
        with pytest.raises(pp.InputError, match=message):
            pp.Reconstruction.from_arrays(database, **{**good, **change})
    twice = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 1, 1]])
    found = pp.Reconstruction.from_arrays(database, **{**good, "observations": twice})
    with pytest.raises(pp.InputError, match=r"feature 0 of image .* to the points 0 and 1, expected one"):
        pp.write_models(database, found, tmp_path)


def test_without_pycolmap(made: tuple[Path, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(pp.MissingExtraError, match=r'pip install "panopath\[colmap\]"'):
        pp.read_database(made[0])


def test_models_of_an_earlier_run_with_more_components_go(tmp_path: Path) -> None:
    for name in ("0", "1", "2", "notes"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "images.bin").write_bytes(b"x")
    (tmp_path / "2" / "mine.txt").write_text("kept", encoding="utf-8")
    models._remove_models_beyond(tmp_path, 1)
    left = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert left == ["0/images.bin", "2/mine.txt", "notes/images.bin"]
