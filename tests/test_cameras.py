"""Angles and pixels to bearings and back: round trips, poles and seam, COLMAP's own cameras, and refusals."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from panopath import cameras
from panopath.errors import InputError

Float = npt.NDArray[np.float64]
RNG = np.random.default_rng(1)

AXES = np.vstack([np.eye(3), -np.eye(3), np.array([[-1.0, -0.0, 0.0], [0.0, -0.0, -1.0], [-0.0, 1.0, -0.0]])])


def unit(rows: Float) -> Float:
    scaled: Float = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return scaled


def directions(count: int) -> Float:
    return unit(RNG.normal(size=(count, 3)))


def pycolmap() -> Any:
    return pytest.importorskip("pycolmap", reason="needs the colmap extra")


vectors = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 5), st.just(3)),
    elements=st.one_of(st.floats(-1.0, 1.0), st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-300, 1e-12])),
).filter(lambda rows: bool((np.linalg.norm(rows, axis=1) > 1e-3).all()))

ROUND_TRIPS: list[tuple[Callable[[Any], Float], Callable[[Any], Float]]] = [
    (cameras.bearings_from_spherical, cameras.spherical_from_bearings),
    (cameras.bearings_from_compass, cameras.compass_from_bearings),
    (cameras.bearings_from_cylindrical, cameras.cylindrical_from_bearings),
    (
        lambda pixel: cameras.bearings_from_equirectangular(pixel, 5760, 2880),
        lambda bearing: cameras.equirectangular_from_bearings(bearing, 5760, 2880),
    ),
]


@pytest.mark.parametrize(("forward", "inverse"), ROUND_TRIPS)
@settings(deadline=None)
@given(vectors=vectors)
def test_every_direction_comes_back(
    forward: Callable[[Any], Float], inverse: Callable[[Any], Float], vectors: Float
) -> None:
    np.testing.assert_allclose(forward(inverse(vectors)), unit(vectors), atol=4e-15)
    np.testing.assert_allclose(forward(inverse(AXES)), AXES, atol=4e-15)


@settings(deadline=None)
@given(hnp.arrays(np.float64, st.integers(0, 5), elements=st.floats(-math.pi + 1e-9, math.pi)))
def test_every_planar_angle_comes_back(theta: Float) -> None:
    bearing = cameras.bearings_from_circular(theta)
    assert bearing.shape == (len(theta), 2)
    np.testing.assert_allclose(cameras.circular_from_bearings(bearing), theta, atol=1e-14)
    azimuth = cameras.compass_from_bearings(bearing)
    assert ((azimuth >= 0) & (azimuth < 2 * math.pi)).all()
    np.testing.assert_allclose(cameras.bearings_from_compass(azimuth), bearing, atol=1e-14)


def test_compass_is_clockwise_from_north() -> None:
    east_up = cameras.bearings_from_compass(np.radians([[90.0, 0.0], [0.0, 45.0], [180.0, 0.0]]))
    half = math.sqrt(0.5)
    np.testing.assert_allclose(east_up, np.array([[1.0, 0.0, 0.0], [0.0, half, half], [0.0, -1.0, 0.0]]), atol=1e-15)
    np.testing.assert_allclose(cameras.bearings_from_compass(np.radians([90.0])), [[1.0, 0.0]], atol=1e-15)


def test_cylinder_height_is_radius_times_tangent() -> None:
    theta, phi = RNG.uniform(-3, 3, 50), RNG.uniform(-1.5, 1.5, 50)
    bearing = cameras.bearings_from_spherical(np.stack([theta, phi], axis=1))
    expected = np.stack([theta, 2.5 * np.tan(phi)], axis=1)
    np.testing.assert_allclose(cameras.cylindrical_from_bearings(bearing, 2.5), expected, rtol=1e-12)
    np.testing.assert_allclose(cameras.bearings_from_cylindrical(expected, 2.5), bearing, atol=1e-14)
    assert cameras.cylindrical_from_bearings([[0.0, 0.0, -1.0]]).tolist() == [[0.0, -math.inf]]
    assert cameras.bearings_from_cylindrical([[0.3, math.inf]]).tolist() == [[0.0, 0.0, 1.0]]


def test_perspective_is_a_patch_and_marks_what_is_behind() -> None:
    pixel = RNG.uniform([0, 0], [640, 480], (100, 2))
    bearing = cameras.bearings_from_perspective(pixel, (400, 410), (320, 240))
    np.testing.assert_allclose(bearing[:, 0] / bearing[:, 2], (pixel[:, 0] - 320) / 400, atol=1e-14)
    np.testing.assert_allclose(cameras.perspective_from_bearings(bearing, (400, 410), (320, 240)), pixel, atol=1e-11)
    behind = cameras.perspective_from_bearings(np.vstack([-bearing, [[1.0, 0.0, 0.0]]]), (400, 410), (320, 240))
    assert np.isnan(behind).all()


def test_equirectangular_is_colmaps_to_the_last_digits() -> None:
    colmap = pycolmap()
    width, height = 5760, 2880
    camera = colmap.Camera(model="EQUIRECTANGULAR", width=width, height=height, params=[width, height])
    special = np.array([[0.5, 0.5], [0.0, 1440.0], [5760.0, 1440.0], [2880.0, 0.0], [2880.0, 2880.0], [4320.0, 1440.0]])
    pixel = np.vstack([RNG.uniform([0, 0], [width, height], (2000, 2)), special])
    bearing = cameras.bearings_from_equirectangular(pixel, width, height)
    np.testing.assert_allclose(bearing, camera.cam_ray_from_img(pixel), rtol=0, atol=1e-12)
    np.testing.assert_allclose(cameras.bearings_from_pixels(camera, pixel), bearing, rtol=0, atol=1e-12)
    # at a pole and on the seam COLMAP's column depends on the sign of a zero, ours is that of +0
    bearing = np.vstack([directions(2000), np.eye(3), 0.0 - np.eye(3)])
    ours = cameras.equirectangular_from_bearings(bearing, width, height)
    np.testing.assert_allclose(ours / width, camera.img_from_cam(bearing) / width, rtol=0, atol=1e-12)


def test_perspective_is_colmaps_pinhole() -> None:
    camera = pycolmap().Camera(model="PINHOLE", width=640, height=480, params=[400, 410, 320, 240])
    pixel = RNG.uniform([0, 0], [640, 480], (200, 2))
    ours = cameras.bearings_from_perspective(pixel, (400, 410), (320, 240))
    np.testing.assert_allclose(ours, cameras.bearings_from_pixels(camera, pixel), rtol=0, atol=1e-12)


#: Distortion that stays invertible over the test's pixels, per model.
DISTORTION = {
    "SIMPLE_RADIAL": [0.02],
    "RADIAL": [0.02, -0.005],
    "SIMPLE_RADIAL_FISHEYE": [0.02],
    "RADIAL_FISHEYE": [0.02, -0.005],
    "OPENCV": [0.02, -0.005, 1e-3, -1e-3],
    "OPENCV_FISHEYE": [0.02, -0.005, 1e-3, -1e-3],
    "FULL_OPENCV": [0.02, -0.005, 1e-3, -1e-3, 1e-3, 0.01, 1e-3, 1e-4],
    "FOV": [0.5],
    "THIN_PRISM_FISHEYE": [0.02, -0.005, 1e-3, -1e-3, 1e-3, 1e-4, 1e-3, -1e-3],
    "SIMPLE_DIVISION": [-0.05],
    "DIVISION": [-0.05],
    "EUCM": [0.4, 1.1],
}


def test_every_camera_model_of_colmap_round_trips() -> None:
    colmap = pycolmap()
    names = [name for name in colmap.CameraModelId.__members__ if name != "INVALID"]
    assert len(names) >= 12
    pixel = RNG.uniform([200, 100], [800, 400], (100, 2))
    for name in names:
        template = colmap.Camera.create_from_model_name(0, name, 450.0, 1000, 500)
        params = np.array(template.params)
        if name in DISTORTION:
            params[-len(DISTORTION[name]) :] = DISTORTION[name]
        camera = {"model": name, "width": 1000, "height": 500, "params": params}
        bearing = cameras.bearings_from_pixels(camera, pixel)
        np.testing.assert_allclose(np.linalg.norm(bearing, axis=1), 1.0, atol=1e-12, err_msg=name)
        np.testing.assert_allclose(cameras.pixels_from_bearings(camera, bearing), pixel, atol=1e-6, err_msg=name)
        assert cameras.bearings_from_pixels(camera, np.empty((0, 2))).shape == (0, 3)
        assert cameras.pixels_from_bearings(camera, np.empty((0, 3))).shape == (0, 2)
        # a panorama sees everything, and a division model with k < 0 more than a half sphere
        if name not in ("EQUIRECTANGULAR", "DIVISION", "SIMPLE_DIVISION"):
            assert np.isnan(cameras.pixels_from_bearings(camera, [[0.1, 0.1, -1.0]])).all(), name


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (3, "expected a pycolmap.Camera or a mapping with model, width, height, params"),
        ({"model": "PINHOLE"}, "expected a pycolmap.Camera or a mapping"),
        ({"model": "PINHOL", "width": 1, "height": 1, "params": []}, "'PINHOL', expected one of SIMPLE_PINHOLE"),
        ({"model": "PINHOLE", "width": 9, "height": 9, "params": [1, 2]}, "has 2 params, expected fx, fy, cx, cy"),
    ],
)
def test_other_cameras_are_refused(camera: Any, message: str) -> None:
    pycolmap()
    with pytest.raises(InputError, match=r"^camera") as caught:
        cameras.bearings_from_pixels(camera, [[1.0, 2.0]])
    assert message in str(caught.value)


def test_missing_pycolmap_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(InputError, match=r"panopath\[colmap\]"):
        cameras.bearings_from_pixels({"model": "PINHOLE"}, [[1.0, 2.0]])
    with pytest.raises(InputError, match=r"panopath\[colmap\]"):
        cameras.pixels_from_bearings({"model": "PINHOLE"}, [[0.0, 0.0, 1.0]])


def test_importing_cameras_does_not_import_pycolmap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    importlib.reload(cameras)


def test_vertical_field_of_view_in_camera_and_world_axes() -> None:
    elevation = np.radians([-90.0, -50.0, -10.0, 0.0, 29.0, 31.0, 90.0])
    world = cameras.bearings_from_spherical(np.stack([RNG.uniform(-3, 3, 7), elevation], axis=1))
    camera = np.stack([world[:, 1], -world[:, 2], world[:, 0]], axis=1)
    low, high = math.radians(-50.0001), math.radians(30.0)
    expected = [False, True, True, True, True, False, False]
    assert cameras.vertical_field_of_view_mask(world, low, high, axes="world").tolist() == expected
    assert cameras.vertical_field_of_view_mask(camera, low, high).tolist() == expected
    assert cameras.vertical_field_of_view_mask(camera, low, high).dtype == np.bool_
    assert cameras.vertical_field_of_view_mask(world, -math.pi / 2, math.pi / 2, axes="world").all()
    for arguments in [(0.2, 0.1), (math.nan, 0.1), (-2.0, 0.1)]:
        with pytest.raises(InputError, match="expected -pi/2 <= low_rad"):
            cameras.vertical_field_of_view_mask(world, *arguments)
    with pytest.raises(InputError, match="axes is 'up'"):
        cameras.vertical_field_of_view_mask(world, low, high, axes="up")  # type: ignore[arg-type]


ROWS: list[tuple[str, Callable[[Any], Float], int]] = [
    ("angle_rad", cameras.bearings_from_spherical, 2),
    ("angle_rad", cameras.bearings_from_compass, 2),
    ("theta_height", cameras.bearings_from_cylindrical, 2),
    ("pixel", lambda a: cameras.bearings_from_perspective(a, (1, 1), (0, 0)), 2),
    ("pixel", lambda a: cameras.bearings_from_equirectangular(a, 8, 4), 2),
    ("bearing", cameras.spherical_from_bearings, 3),
    ("bearing", cameras.compass_from_bearings, 3),
    ("bearing", cameras.cylindrical_from_bearings, 3),
    ("bearing", cameras.circular_from_bearings, 2),
    ("bearing", lambda a: cameras.perspective_from_bearings(a, (1, 1), (0, 0)), 3),
    ("bearing", lambda a: cameras.equirectangular_from_bearings(a, 8, 4), 3),
    ("bearing", lambda a: cameras.vertical_field_of_view_mask(a, 0, 1).astype(np.float64), 3),
]


@pytest.mark.parametrize(("name", "convert", "columns"), ROWS)
def test_bad_rows_are_refused_by_name(name: str, convert: Callable[[Any], Float], columns: int) -> None:
    good = np.full((4, columns), 0.5)
    assert len(convert(good)) == 4
    assert len(convert(good[:0])) == 0
    assert len(convert(good.astype(np.float32)[::2])) == 2
    bad = good.copy()
    bad[2, 0] = np.nan
    with pytest.raises(InputError, match=rf"^{name}\[2\] is \[nan, 0.5.*expected"):
        convert(bad)
    for wrong in (0.5, good[None], np.ones((4, columns + 2))):
        with pytest.raises(InputError, match=rf"^{name} has shape .* expected \(N, {columns}\)"):
            convert(wrong)
    with pytest.raises(InputError, match=rf"^{name} is no array of numbers"):
        convert([["a"] * columns])
    if name == "bearing":
        with pytest.raises(InputError, match=r"bearing\[1\] is .*expected a vector of positive length"):
            convert(np.array([[1.0] * columns, [0.0] * columns]))


def test_bad_angles_and_sizes_are_refused() -> None:
    with pytest.raises(InputError, match=r"theta_rad has shape \(1, 1\), expected \(N,\)"):
        cameras.bearings_from_circular([[1.0]])
    with pytest.raises(InputError, match=r"theta_rad\[1\] is \[inf\]"):
        cameras.bearings_from_circular([1.0, math.inf])
    with pytest.raises(InputError, match="radius is 0"):
        cameras.bearings_from_cylindrical([[1.0, 1.0]], radius=0)
    with pytest.raises(InputError, match=r"theta_height\[0\]"):
        cameras.bearings_from_cylindrical([[math.inf, 1.0]])
    with pytest.raises(InputError, match="width_px is -8"):
        cameras.bearings_from_equirectangular([[1.0, 1.0]], -8, 4)
    with pytest.raises(InputError, match="focal_px is nan"):
        cameras.bearings_from_perspective([[1.0, 1.0]], (math.nan, 1), (0, 0))
    with pytest.raises(InputError, match="principal_px is"):
        cameras.perspective_from_bearings([[1.0, 1.0, 1.0]], (1, 1), (0, math.inf))
