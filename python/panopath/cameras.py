"""What a camera reports, as bearings (unit vectors) and back, over whole arrays.

Two families of axes occur, and nothing here converts between them (that is an orientation). Angles are measured about a
vertical z axis: ``bearing = (cos phi cos theta, cos phi sin theta, sin phi)``. Pixels belong to camera axes, x right,
y down, z forward, with pixel centres at +0.5.

``..._from_bearings`` take vectors of any positive length. A pole has azimuth 0; straight behind is ``+pi``, the right
border of a panorama.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.model import Bool, Float


def bearings_from_spherical(angle_rad: npt.ArrayLike) -> Float:
    """Bearings of a spherical camera.

    Parameters
    ----------
    angle_rad
        (N, 2): azimuth theta from the x axis towards y, and elevation phi above the horizon, radians.

    Returns
    -------
    Float
        (N, 3) unit vectors, z up.

    Raises
    ------
    InputError
        For another shape or an entry that is not finite.
    """
    return _core.bearings_from_spherical(_rows("angle_rad", angle_rad, 2))


def spherical_from_bearings(bearing: npt.ArrayLike) -> Float:
    """Azimuth and elevation: inverse of :func:`bearings_from_spherical`.

    Parameters
    ----------
    bearing
        (N, 3), z up.

    Returns
    -------
    Float
        (N, 2): theta in (-pi, pi], phi in [-pi/2, pi/2], radians.

    Raises
    ------
    InputError
        For another shape, an entry that is not finite, or a vector of length zero.
    """
    return _core.spherical_from_bearings(_directions(bearing, 3))


def bearings_from_circular(theta_rad: npt.ArrayLike) -> Float:
    """Bearings of a planar, circular camera.

    Parameters
    ----------
    theta_rad
        (N,) angles from the x axis towards y, radians.

    Returns
    -------
    Float
        (N, 2) unit vectors.

    Raises
    ------
    InputError
        For another shape or an entry that is not finite.
    """
    return _core.bearings_from_circular(_column("theta_rad", theta_rad))


def circular_from_bearings(bearing: npt.ArrayLike) -> Float:
    """Angles of planar bearings: inverse of :func:`bearings_from_circular`.

    Parameters
    ----------
    bearing
        (N, 2).

    Returns
    -------
    Float
        (N,) angles in (-pi, pi], radians.

    Raises
    ------
    InputError
        For another shape, an entry that is not finite, or a vector of length zero.
    """
    return _core.circular_from_bearings(_directions(bearing, 2))[:, 0]


def bearings_from_compass(angle_rad: npt.ArrayLike) -> Float:
    """Bearings from compass readings, clockwise from north; x is east, y north, z up.

    Parameters
    ----------
    angle_rad
        (N, 2): azimuth and elevation; or (N,) azimuths of a planar survey. Radians.

    Returns
    -------
    Float
        (N, 3) unit vectors; (N, 2) for (N,) azimuths.

    Raises
    ------
    InputError
        For another shape or an entry that is not finite.
    """
    if np.ndim(angle_rad) == 1:
        return _core.bearings_from_planar_compass(_column("angle_rad", angle_rad))
    return _core.bearings_from_compass(_rows("angle_rad", angle_rad, 2))


def compass_from_bearings(bearing: npt.ArrayLike) -> Float:
    """Compass readings: inverse of :func:`bearings_from_compass`.

    Parameters
    ----------
    bearing
        (N, 3) or, of a planar survey, (N, 2); x is east, y north, z up.

    Returns
    -------
    Float
        (N, 2): azimuth in [0, 2 pi) and elevation in [-pi/2, pi/2]; (N,) azimuths of planar bearings. Radians.

    Raises
    ------
    InputError
        For another shape, an entry that is not finite, or a vector of length zero.
    """
    if np.ndim(bearing) == 2 and np.shape(bearing)[1] == 2:
        return _core.planar_compass_from_bearings(_directions(bearing, 2))[:, 0]
    return _core.compass_from_bearings(_directions(bearing, 3))


def bearings_from_cylindrical(theta_height: npt.ArrayLike, radius: float = 1.0) -> Float:
    """Bearings of a camera that projects from its centre onto a vertical cylinder.

    The ray at elevation phi meets the cylinder at height ``radius * tan(phi)``. Knill & Ramirez-Herran (2007) print
    ``r sin(phi)``, which is the height on a sphere instead and never leaves ``[-r, r]``.

    Parameters
    ----------
    theta_height
        (N, 2): azimuth theta in radians, and height on the cylinder in the unit of the radius; infinite at a pole.
    radius
        Radius of the cylinder.

    Returns
    -------
    Float
        (N, 3) unit vectors, z up.

    Raises
    ------
    InputError
        For another shape, a NaN, an infinite angle, or a radius that is not positive and finite.
    """
    rows = _array("theta_height", theta_height, 2)
    _refuse("theta_height", rows, np.isfinite(rows[:, 0]) & ~np.isnan(rows[:, 1]), "a finite angle and a height")
    return _core.bearings_from_cylindrical(rows, _positive("radius", radius))


def cylindrical_from_bearings(bearing: npt.ArrayLike, radius: float = 1.0) -> Float:
    """Azimuth and height on a cylinder: inverse of :func:`bearings_from_cylindrical`.

    Parameters
    ----------
    bearing
        (N, 3), z up.
    radius
        Radius of the cylinder.

    Returns
    -------
    Float
        (N, 2): azimuth in (-pi, pi] in radians, and height in the unit of the radius, infinite at a pole.

    Raises
    ------
    InputError
        For another shape, an entry that is not finite, a vector of length zero, or a radius that is not positive.
    """
    return _core.cylindrical_from_bearings(_directions(bearing, 3), _positive("radius", radius))


def bearings_from_perspective(
    pixel: npt.ArrayLike, focal_px: tuple[float, float], principal_px: tuple[float, float]
) -> Float:
    """Bearings of a perspective camera, which is a patch of the sphere.

    Parameters
    ----------
    pixel
        (N, 2), x right and y down.
    focal_px
        ``(fx, fy)``.
    principal_px
        ``(cx, cy)``.

    Returns
    -------
    Float
        (N, 3) unit vectors in camera axes.

    Raises
    ------
    InputError
        For another shape, an entry that is not finite, or a focal length that is not positive.
    """
    return _core.bearings_from_perspective(_rows("pixel", pixel, 2), *_pinhole(focal_px, principal_px))


def perspective_from_bearings(
    bearing: npt.ArrayLike, focal_px: tuple[float, float], principal_px: tuple[float, float]
) -> Float:
    """Pixels of a perspective camera: inverse of :func:`bearings_from_perspective`.

    Parameters
    ----------
    bearing
        (N, 3), camera axes.
    focal_px
        ``(fx, fy)``.
    principal_px
        ``(cx, cy)``.

    Returns
    -------
    Float
        (N, 2); NaN where the bearing is not in front of the camera (z <= 0).

    Raises
    ------
    InputError
        For another shape, an entry that is not finite, a vector of length zero, or a focal length that is not positive.
    """
    return _core.perspective_from_bearings(_directions(bearing, 3), *_pinhole(focal_px, principal_px))


def bearings_from_equirectangular(pixel: npt.ArrayLike, width_px: float, height_px: float) -> Float:
    """Bearings of a panorama, exactly as COLMAP's EQUIRECTANGULAR camera.

    ``theta = 2 pi (x / w - 1/2)``, ``phi = pi (1/2 - y / h)``,
    ``bearing = (cos phi sin theta, -sin phi, cos phi cos theta)``.

    Parameters
    ----------
    pixel
        (N, 2); the centre of the first pixel is (0.5, 0.5). An x beyond the border goes on around.
    width_px, height_px
        Size of the full sphere.

    Returns
    -------
    Float
        (N, 3) unit vectors in camera axes.

    Raises
    ------
    InputError
        For another shape, an entry that is not finite, or a size that is not positive.
    """
    return _core.bearings_from_equirectangular(_rows("pixel", pixel, 2), *_size(width_px, height_px))


def equirectangular_from_bearings(bearing: npt.ArrayLike, width_px: float, height_px: float) -> Float:
    """Pixels of a panorama: inverse of :func:`bearings_from_equirectangular`.

    Parameters
    ----------
    bearing
        (N, 3), camera axes.
    width_px, height_px
        Size of the full sphere.

    Returns
    -------
    Float
        (N, 2); x in (0, w], y in [0, h]. Straight behind is x = w; a pole is in the middle column.

    Raises
    ------
    InputError
        For another shape, an entry that is not finite, a vector of length zero, or a size that is not positive.
    """
    return _core.equirectangular_from_bearings(_directions(bearing, 3), *_size(width_px, height_px))


def bearings_from_pixels(camera: Any, pixels: npt.ArrayLike) -> Float:
    """Bearings of any camera that pycolmap knows (extra ``panopath[colmap]``).

    Parameters
    ----------
    camera
        A ``pycolmap.Camera``, or a mapping with its ``model`` (a name such as ``"OPENCV_FISHEYE"``), ``width``,
        ``height`` and ``params``.
    pixels
        (N, 2), x right and y down, pixel centres at +0.5.

    Returns
    -------
    Float
        (N, 3) unit vectors in camera axes; NaN where the model cannot be inverted.

    Raises
    ------
    InputError
        For a missing pycolmap, another camera, another shape or an entry that is not finite.
    """
    colmap_camera = _colmap_camera(camera)
    pixels = _rows("pixels", pixels, 2)
    if len(pixels) == 0:
        return np.empty((0, 3))
    return _nan_unless_finite(colmap_camera.cam_ray_from_img(pixels))


def pixels_from_bearings(camera: Any, bearings: npt.ArrayLike) -> Float:
    """Pixels of any camera that pycolmap knows: inverse of :func:`bearings_from_pixels`.

    Parameters
    ----------
    camera
        As for :func:`bearings_from_pixels`.
    bearings
        (N, 3), camera axes.

    Returns
    -------
    Float
        (N, 2); NaN where the camera does not see the bearing.

    Raises
    ------
    InputError
        For a missing pycolmap, another camera, another shape, an entry that is not finite or a vector of length zero.
    """
    colmap_camera = _colmap_camera(camera)
    bearings = _directions(bearings, 3, "bearings")
    if len(bearings) == 0:
        return np.empty((0, 2))
    return _nan_unless_finite(colmap_camera.img_from_cam(bearings))


def vertical_field_of_view_mask(
    bearing: npt.ArrayLike, low_rad: float, high_rad: float, axes: Literal["camera", "world"] = "camera"
) -> Bool:
    """Which bearings lie in a limited vertical field of view.

    Parameters
    ----------
    bearing
        (N, 3).
    low_rad, high_rad
        Lowest and highest elevation above the horizon, both included, in [-pi/2, pi/2].
    axes
        Which way is up. ``"camera"``: y points down, elevation is ``asin(-y)``. ``"world"``: z points up, ``asin(z)``.

    Returns
    -------
    Bool
        (N,).

    Raises
    ------
    InputError
        For another shape, an entry that is not finite, a vector of length zero, unordered bounds or unknown axes.
    """
    if not -math.pi / 2 <= low_rad <= high_rad <= math.pi / 2:
        expected = "-pi/2 <= low_rad <= high_rad <= pi/2"
        raise InputError(f"low_rad is {low_rad} and high_rad is {high_rad}, expected {expected}")
    if axes not in ("camera", "world"):
        raise InputError(f'axes is {axes!r}, expected "camera" or "world"')
    inside = _core.vertical_field_of_view(_directions(bearing, 3), low_rad, high_rad, axes == "camera")
    return inside[:, 0] > 0.0


# ---- checks ----------------------------------------------------------------------------------------------------------


def _array(name: str, value: npt.ArrayLike, columns: int) -> Float:
    try:
        rows = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} is no array of numbers, expected shape (N, {columns})") from None
    if np.ndim(value) != 2 or rows.shape[1] != columns:
        raise InputError(f"{name} has shape {np.shape(value)}, expected (N, {columns})")
    return rows


def _refuse(name: str, rows: Float, good: Bool | np.bool_, expected: str) -> None:
    if not good.all():
        first = int(np.argmin(good))
        raise InputError(f"{name}[{first}] is {rows[first].tolist()}, expected {expected}")


def _rows(name: str, value: npt.ArrayLike, columns: int) -> Float:
    rows = _array(name, value, columns)
    _refuse(name, rows, np.isfinite(rows).all(axis=1), "finite numbers")
    return rows


def _column(name: str, value: npt.ArrayLike) -> Float:
    try:
        column = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} is no array of numbers, expected shape (N,)") from None
    if np.ndim(value) != 1:
        raise InputError(f"{name} has shape {np.shape(value)}, expected (N,)")
    return _rows(name, column[:, None], 1)


def _directions(value: npt.ArrayLike, columns: int, name: str = "bearing") -> Float:
    rows = _rows(name, value, columns)
    _refuse(name, rows, rows.any(axis=1), "a vector of positive length")
    return rows


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} is {value}, expected a positive finite number")
    return float(value)


def _size(width_px: float, height_px: float) -> tuple[float, float]:
    return _positive("width_px", width_px), _positive("height_px", height_px)


def _pinhole(
    focal_px: tuple[float, float], principal_px: tuple[float, float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    fx, fy = (_positive("focal_px", focal) for focal in focal_px)
    cx, cy = (float(principal) for principal in principal_px)
    if not (math.isfinite(cx) and math.isfinite(cy)):
        raise InputError(f"principal_px is {principal_px}, expected two finite numbers")
    return (fx, fy), (cx, cy)


def _colmap_camera(camera: Any) -> Any:
    try:
        pycolmap = importlib.import_module("pycolmap")
    except ImportError:
        raise InputError("camera models of COLMAP need pycolmap: install panopath[colmap]") from None
    if isinstance(camera, pycolmap.Camera):
        return camera
    fields = ("model", "width", "height", "params")
    if not (isinstance(camera, Mapping) and all(field in camera for field in fields)):
        raise InputError(f"camera is {camera!r}, expected a pycolmap.Camera or a mapping with {', '.join(fields)}")
    # named first, because pycolmap's own message for an unknown name does not say which there are
    models = pycolmap.CameraModelId.__members__
    if camera["model"] not in models or camera["model"] == "INVALID":
        names = ", ".join(name for name in models if name != "INVALID")
        raise InputError(f"camera model is {camera['model']!r}, expected one of {names}")
    made = pycolmap.Camera(**{field: camera[field] for field in fields})
    if not made.verify_params():
        n_params = len(camera["params"])
        raise InputError(f"camera model {camera['model']} has {n_params} params, expected {made.params_info}")
    return made


def _nan_unless_finite(rows: npt.ArrayLike) -> Float:
    rows = np.array(rows, dtype=np.float64)
    rows[~np.isfinite(rows).all(axis=1)] = np.nan
    return rows
