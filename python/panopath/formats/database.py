"""COLMAP databases: features, matches, cameras, rigs and priors, read without leaving a trace; and models of them.

A database is a SQLite file. Its arrays are little-endian blobs: key points and matches ``float32`` and ``uint32`` of
``rows`` x ``cols``, everything else ``float64``; quaternions are scalar first. The id of a pair of images is
``image_id1 * (2^31 - 1) + image_id2``. Databases of COLMAP 3.12 and later group cameras in rigs and images in frames
(all that a rig saw at one time); where there are only rigs of one camera, there are none here.
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.formats.colmap_model import EQUIRECTANGULAR_ID, Camera, Rig, Sensor, pycolmap_camera
from panopath.formats.csv import quaternion_from_rotation, rotation_from_quaternion
from panopath.model import Bool, Float, Int, read_only

Index = npt.NDArray[np.int64]

_MAX_IMAGES = 2**31 - 1
_CAMERA = 0
_WGS84 = 0
#: Seconds to wait for another program that is writing.
_PATIENCE_S = 1.0
_NEEDED = {
    "cameras": ("camera_id", "model", "width", "height", "params", "prior_focal_length"),
    "images": ("image_id", "name", "camera_id"),
    "keypoints": ("image_id", "rows", "cols", "data"),
    "matches": ("pair_id", "rows", "cols", "data"),
    "two_view_geometries": ("pair_id", "rows", "cols", "data", "config"),
}
_NEEDED_FOR_RIGS = {
    "rigs": ("rig_id", "ref_sensor_id", "ref_sensor_type"),
    "rig_sensors": ("rig_id", "sensor_id", "sensor_type", "sensor_from_rig"),
    "frames": ("frame_id", "rig_id"),
    "frame_data": ("frame_id", "data_id", "sensor_id", "sensor_type"),
}


@dataclass(frozen=True, eq=False)
class Database:
    """What a COLMAP database holds, as flat arrays; images are indices in the order of their ids.

    A frame is all images that a rig took at one time. It has one pose, ``rig_from_world`` and a centre, and
    ``cam_from_world = sensor_from_rig[camera] @ rig_from_world[frame]``: see :meth:`image_poses`.
    """

    path: Path
    #: (M,) names and COLMAP's ids.
    image_names: tuple[str, ...]
    image_id: Int
    #: (M,) index of the camera and of the frame of each image; without rigs, the frame is the image's own index.
    image_camera: Int
    image_frame: Int
    cameras: tuple[Camera, ...]
    #: (C, 3, 3) and (C, 3): orientation of each camera in its rig, and its centre in the frame of the rig.
    sensor_from_rig: Float
    center_in_rig: Float
    #: (F,) COLMAP's id of each frame, and of its rig.
    frame_id: Int
    frame_rig_id: Int
    #: The database's rigs; empty where it has none, or they were not to be used.
    rigs: tuple[Rig, ...]
    #: (M + 1,) where the features of each image begin.
    feature_starts: Index
    #: (K, 2) pixels of the features, centres of pixels at 0.5.
    pixels: Float
    #: (K, 3) unit vectors in the camera, NaN where the camera cannot unproject the pixel.
    bearings: Float
    #: (K,) the angle that one pixel spans there: the standard deviation of a feature measured to one pixel.
    pixel_rad: Float
    #: (P, 2) images of each pair that has matches.
    pairs: Int
    #: (P,) COLMAP's two-view configuration (2 calibrated, 3 uncalibrated, 4 to 6 planar or panoramic, 7 watermark,
    #: 8 multiple, 9 calibrated rig); -1 for raw matches.
    pair_config: Int
    #: (P + 1,) where the matches of each pair begin.
    match_starts: Index
    #: (N, 2) feature of the first and of the second image, counted within their images; both have bearings.
    matches: Int
    #: Whether matches passed COLMAP's geometric verification; else they are raw, since there were no verified ones.
    is_verified: bool
    #: (M, 3) known positions of the images, NaN where there are none, with their (M, 3, 3) covariances, NaN where
    #: unknown, and (M,) coordinate systems: 0 WGS84 (latitude and longitude in degrees, altitude in metres),
    #: 1 Cartesian, -1 none.
    position: Float
    position_covariance: Float
    position_system: Int
    #: (M, 3) unit vectors towards the ground in the frame of the camera, NaN where unknown.
    gravity: Float

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, np.ndarray):
                read_only(value)

    def __repr__(self) -> str:
        return (
            f"Database({self.n_images} images, {self.n_frames} frames, {len(self.cameras)} cameras, "
            f"{len(self.pixels)} features, {len(self.matches)} {'' if self.is_verified else 'raw '}matches "
            f"in {len(self.pairs)} pairs)"
        )

    @property
    def n_images(self) -> int:
        """Number of images."""
        return len(self.image_id)

    @property
    def n_frames(self) -> int:
        """Number of frames; without rigs, that of the images."""
        return len(self.frame_id)

    @property
    def n_features(self) -> Index:
        """(M,) number of features of each image."""
        return np.diff(self.feature_starts)

    @property
    def has_rigs(self) -> bool:
        """Whether images share frames."""
        return self.n_frames < self.n_images

    def local_positions(self) -> Float:
        """Known positions of the images in metres.

        Returns
        -------
        array
            (M, 3), NaN where there are none. Those in WGS84 become east, north and up of the first of them; others are
            as they are.

        Raises
        ------
        InputError
            Where some are in WGS84 and others are not.
        """
        known = np.isfinite(self.position).all(axis=1)
        geographic = known & (self.position_system == _WGS84)
        if not geographic.any():
            return self.position.copy()
        if (known & ~geographic).any():
            raise InputError(f"{self.path}: has positions in WGS84 and in other coordinates, expected all alike")
        local = np.full_like(self.position, np.nan)
        local[known] = _east_north_up(self.position[known])
        return local

    def image_poses(self, rig_from_world: npt.ArrayLike, centers: npt.ArrayLike) -> tuple[Float, Float]:
        """Poses of the images from those of the frames.

        Parameters
        ----------
        rig_from_world, centers
            (F, 3, 3) rotations and (F, 3) positions of the rigs in the world.

        Returns
        -------
        tuple
            (M, 3, 3) ``cam_from_world`` and (M, 3) centres.
        """
        frame_rotation = np.asarray(rig_from_world, dtype=np.float64)[self.image_frame]
        frame_center = np.asarray(centers, dtype=np.float64)[self.image_frame]
        rotation = self.sensor_from_rig[self.image_camera] @ frame_rotation
        offset = np.einsum("mji,mj->mi", frame_rotation, self.center_in_rig[self.image_camera])
        return rotation, frame_center + offset

    def frame_poses(self, cam_from_world: npt.ArrayLike, centers: npt.ArrayLike) -> tuple[Float, Float]:
        """Poses of the frames, each from its first image whose pose is known.

        Parameters
        ----------
        cam_from_world, centers
            (M, 3, 3) rotations and (M, 3) positions of the images, NaN where unknown.

        Returns
        -------
        tuple
            (F, 3, 3) ``rig_from_world`` and (F, 3) centres, NaN where no image of the frame has a pose.
        """
        image_rotation, image_center = np.asarray(cam_from_world), np.asarray(centers)
        known = np.flatnonzero(np.isfinite(image_center).all(axis=1))
        frame, first = np.unique(self.image_frame[known], return_index=True)
        image = known[first]
        camera = self.image_camera[image]
        rotation, center = np.full((self.n_frames, 3, 3), np.nan), np.full((self.n_frames, 3), np.nan)
        rotation[frame] = np.swapaxes(self.sensor_from_rig[camera], 1, 2) @ image_rotation[image]
        offset = np.einsum("mji,mj->mi", rotation[frame], self.center_in_rig[camera])
        center[frame] = image_center[image] - offset
        return rotation, center


def read_database(path: str | PathLike[str], *, trust_focal_lengths: bool = False, use_rigs: bool = True) -> Database:
    """Read a COLMAP database. Nothing is written, and no file appears beside it.

    Matches are those that passed geometric verification (``two_view_geometries``), or all where there are none. Left
    out are pairs without matches, and matches of features that have no bearing.

    Parameters
    ----------
    path
        The database file.
    trust_focal_lengths
        Take focal lengths that are only COLMAP's guess as if they were known.
    use_rigs
        Read rigs, where there are any; else every image has a pose of its own.

    Raises
    ------
    InputError
        Naming the file, and what in it is absent, damaged, locked or not known.
    MissingExtraError
        Where pycolmap, which unprojects pixels, is not installed.
    """
    source = Path(path)
    with _open(source) as (connection, reader):
        tables = reader.tables()
        _check_schema(source, tables)
        images = reader.images()
        cameras, prior_focal = reader.cameras()
        rigs = reader.rigs() if use_rigs and set(_NEEDED_FOR_RIGS) <= set(tables) else None
        features = reader.keypoints(images)
        matches = reader.matches(images)
        priors = reader.priors(images, tables.get("pose_priors", ()))
        connection.rollback()
    image_camera = _lookup(np.array(list(cameras), dtype=np.int64), images.camera_id)
    if (image_camera < 0).any():
        i = int(np.argmax(image_camera < 0))
        raise InputError(
            f"{source}: image {images.names[i]} has the camera {images.camera_id[i]}, which the table cameras lacks"
        )
    _check_matches(source, images, features.counts, matches)
    listed = tuple(cameras.values())
    models = _models(source, listed, prior_focal, image_camera, trust_focal_lengths)
    bearings, pixel_rad = _unproject(models, image_camera, features)
    matches = _with_bearings(bearings, features.starts, matches)
    if not len(matches.features):
        raise InputError(f"{source}: no match joins two features that their cameras can unproject")
    frames = _frames(source, images, listed, image_camera, rigs)
    return Database(
        path=source,
        image_names=images.names,
        image_id=images.ids.astype(np.int32),
        image_camera=image_camera.astype(np.int32),
        image_frame=frames.of_image,
        cameras=listed,
        sensor_from_rig=frames.sensor_from_rig,
        center_in_rig=frames.center_in_rig,
        frame_id=frames.ids,
        frame_rig_id=frames.rig_id,
        rigs=frames.rigs,
        feature_starts=features.starts,
        pixels=features.pixels,
        bearings=bearings,
        pixel_rad=pixel_rad,
        pairs=matches.pairs.astype(np.int32),
        pair_config=matches.config,
        match_starts=np.concatenate(([0], np.cumsum(matches.counts))),
        matches=matches.features,
        is_verified=matches.table != "matches",
        position=priors.position,
        position_covariance=priors.covariance,
        position_system=priors.system,
        gravity=priors.gravity,
    )


def database_of_features(  # noqa: PLR0917
    names: Sequence[str],
    cameras: Sequence[Camera],
    image_camera: npt.ArrayLike,
    pixels: Sequence[npt.ArrayLike],
    pairs: npt.ArrayLike,
    match_starts: npt.ArrayLike,
    matches: npt.ArrayLike,
    *,
    image_frame: npt.ArrayLike | None = None,
    sensor_from_rig: npt.ArrayLike | None = None,
    center_in_rig: npt.ArrayLike | None = None,
    position_wgs84: npt.ArrayLike | None = None,
    gravity: npt.ArrayLike | None = None,
    feature_px: npt.ArrayLike = 1.0,
    source: str | PathLike[str] = "features",
) -> Database:
    """Make the record of a database from features and matches in memory.

    Parameters
    ----------
    names
        M names of images; their ids are 1 to M.
    cameras
        C cameras.
    image_camera
        (M,) index of the camera of each image.
    pixels
        M arrays (n, 2) of features, centres of pixels at 0.5.
    pairs, match_starts, matches
        (P, 2) images, (P + 1,) and (N, 2) features counted within their images, as in :class:`Database`.
    image_frame
        (M,) which images a rig took at one time, numbered from 0; default: every image by itself.
    sensor_from_rig, center_in_rig
        (C, 3, 3) and (C, 3) places of the cameras in the rig; needed with ``image_frame``.
    position_wgs84
        (M, 3) latitude and longitude in degrees and altitude in metres, NaN where unknown.
    gravity
        (M, 3) unit vectors towards the ground in the camera, NaN where unknown.
    feature_px
        (C,) or one number: pixels of the camera that a pixel spanned in which features were sought, where images were
        shrunk for it. Features are that much less certain.
    source
        What messages name.

    Raises
    ------
    InputError
        Naming the argument that does not fit the others, or where no match is left.
    MissingExtraError
        For cameras that are not equirectangular, where pycolmap is not installed.
    """
    path, n = Path(source), len(names)
    camera_of = np.asarray(image_camera, dtype=np.int64).reshape(-1)
    _expect(
        len(camera_of) == n == len(pixels),
        f"names, image_camera and pixels are {n}, {len(camera_of)} and "
        f"{len(pixels)}, expected one of each for every image",
    )
    _expect(
        bool(((camera_of >= 0) & (camera_of < len(cameras))).all()),
        f"image_camera has entries outside 0 to {len(cameras) - 1}, expected an index of cameras",
    )
    tables = [np.asarray(rows, dtype=np.float64).reshape(-1, 2) for rows in pixels]
    counts = np.array([len(rows) for rows in tables], dtype=np.int64)
    features = _Features(counts, np.concatenate(([0], np.cumsum(counts))), np.concatenate([np.empty((0, 2)), *tables]))
    images = _Images(np.arange(1, n + 1), camera_of, tuple(names))
    ends, rows = np.asarray(pairs, dtype=np.int64).reshape(-1, 2), np.asarray(matches, dtype=np.int32).reshape(-1, 2)
    starts = np.asarray(match_starts, dtype=np.int64).reshape(-1)
    _expect(
        len(starts) == len(ends) + 1 and starts[0] == 0 and starts[-1] == len(rows) and (np.diff(starts) >= 0).all(),
        f"match_starts does not divide {len(rows)} matches among {len(ends)} pairs",
    )
    _expect(
        not len(ends) or (ends.min() >= 0 and ends.max() < n and (ends[:, 0] != ends[:, 1]).all()),
        f"pairs has entries outside 0 to {n - 1}, or an image with itself",
    )
    _expect(not len(rows) or rows.min() >= 0, "matches has negative entries, expected features")
    filled = np.flatnonzero(np.diff(starts))
    found = _Matches(
        "two_view_geometries", ends[filled], np.full(len(filled), 2, dtype=np.int32), np.diff(starts)[filled], rows
    )
    _check_matches(path, images, counts, found)
    bearings, pixel_rad = _bearings_of(path, cameras, camera_of, features)
    spans = np.broadcast_to(np.asarray(feature_px, dtype=np.float64), (len(cameras),))
    pixel_rad = pixel_rad * np.repeat(spans[camera_of], counts)
    if len(rows):
        found = _with_bearings(bearings, features.starts, found)
    _expect(len(found.features) > 0, f"{path}: no two images match")
    frames = _given_frames(cameras, camera_of, image_frame, sensor_from_rig, center_in_rig)
    known = np.full((n, 3), np.nan) if position_wgs84 is None else np.array(position_wgs84, dtype=np.float64)
    down = np.full((n, 3), np.nan) if gravity is None else np.array(gravity, dtype=np.float64)
    _expect(
        known.shape == down.shape == (n, 3),
        f"position_wgs84 and gravity have shapes {known.shape} and {down.shape}, expected {(n, 3)}",
    )
    return Database(
        path=path,
        image_names=images.names,
        image_id=images.ids.astype(np.int32),
        image_camera=camera_of.astype(np.int32),
        image_frame=frames.of_image,
        cameras=tuple(cameras),
        sensor_from_rig=frames.sensor_from_rig,
        center_in_rig=frames.center_in_rig,
        frame_id=frames.ids,
        frame_rig_id=frames.rig_id,
        rigs=frames.rigs,
        feature_starts=features.starts,
        pixels=features.pixels,
        bearings=bearings,
        pixel_rad=pixel_rad,
        pairs=found.pairs.astype(np.int32),
        pair_config=found.config,
        match_starts=np.concatenate(([0], np.cumsum(found.counts))),
        matches=found.features,
        is_verified=True,
        position=known,
        position_covariance=np.full((n, 3, 3), np.nan),
        position_system=np.where(np.isfinite(known).all(axis=1), _WGS84, -1).astype(np.int32),
        gravity=down,
    )


def _expect(holds: bool | np.bool_, otherwise: str) -> None:
    if not holds:
        raise InputError(otherwise)


def _bearings_of(
    source: Path, cameras: Sequence[Camera], image_camera: Index, features: _Features
) -> tuple[Float, Float]:
    """Bearings of all features; panoramas need no pycolmap."""
    if any(camera.model not in (EQUIRECTANGULAR_ID, "EQUIRECTANGULAR") for camera in cameras):
        models = _models(source, cameras, [True] * len(cameras), image_camera, True)
        return _unproject(models, image_camera, features)
    bearings, pixel_rad = np.full((len(features.pixels), 3), np.nan), np.full(len(features.pixels), np.nan)
    camera_of = np.repeat(image_camera, features.counts)
    for c, camera in enumerate(cameras):
        rows = np.flatnonzero((camera_of == c) & np.isfinite(features.pixels).all(axis=1))
        bearings[rows] = _core.bearings_from_equirectangular(
            features.pixels[rows], float(camera.width), float(camera.height)
        )
        pixel_rad[rows] = 2.0 * np.pi / camera.width
    return bearings, pixel_rad


def _given_frames(
    cameras: Sequence[Camera],
    image_camera: Index,
    image_frame: npt.ArrayLike | None,
    sensor_from_rig: npt.ArrayLike | None,
    center_in_rig: npt.ArrayLike | None,
) -> _FrameTable:
    n, n_cameras = len(image_camera), len(cameras)
    rotation, center = np.tile(np.eye(3), (n_cameras, 1, 1)), np.zeros((n_cameras, 3))
    if image_frame is None:
        ids = np.arange(1, n + 1, dtype=np.int32)
        return _FrameTable(ids - 1, ids, np.full(n, -1, dtype=np.int32), (), rotation, center)
    frame = np.asarray(image_frame, dtype=np.int32).reshape(-1)
    _expect(
        sensor_from_rig is not None and center_in_rig is not None,
        "sensor_from_rig or center_in_rig is None, expected the places of the cameras, since image_frame is given",
    )
    rotation, center = np.array(sensor_from_rig, dtype=np.float64), np.array(center_in_rig, dtype=np.float64)
    _expect(
        len(frame) == n and rotation.shape == (n_cameras, 3, 3) and center.shape == (n_cameras, 3),
        f"image_frame, sensor_from_rig and center_in_rig have shapes {frame.shape}, {rotation.shape} and "
        f"{center.shape}, expected {(n,)}, {(n_cameras, 3, 3)} and {(n_cameras, 3)}",
    )
    n_frames = int(frame.max()) + 1
    _expect(
        np.array_equal(np.unique(frame), np.arange(n_frames)), "image_frame leaves out a number, expected 0, 1, ..."
    )
    _expect(
        len(np.unique(frame.astype(np.int64) * n_cameras + image_camera)) == n,
        "image_frame has two images of one camera in one frame",
    )
    # the first camera's frame is the rig's, as COLMAP has it
    rotation, center = rotation @ rotation[0].T, (center - center[0]) @ rotation[0].T
    sensors = []
    for c in range(1, n_cameras):
        pose = (*quaternion_from_rotation(rotation[c : c + 1])[0], *(-rotation[c] @ center[c]))
        sensors.append(Sensor(_CAMERA, cameras[c].camera_id, tuple(float(x) for x in pose)))
    rig = Rig(1, (_CAMERA, cameras[0].camera_id), tuple(sensors))
    ids = np.arange(1, n_frames + 1, dtype=np.int32)
    return _FrameTable(frame, ids, np.ones(n_frames, dtype=np.int32), (rig,), rotation, center)


def _east_north_up(lat_lon_alt: Float) -> Float:
    """Turn degrees and metres on the WGS84 ellipsoid into metres in the tangent plane of the first position."""
    latitude, longitude = np.radians(lat_lon_alt[:, 0]), np.radians(lat_lon_alt[:, 1])
    altitude = lat_lon_alt[:, 2]
    axis, flattening = 6378137.0, 1.0 / 298.257223563
    eccentricity_2 = flattening * (2.0 - flattening)
    normal = axis / np.sqrt(1.0 - eccentricity_2 * np.sin(latitude) ** 2)
    horizontal = (normal + altitude) * np.cos(latitude)
    polar = (normal * (1.0 - eccentricity_2) + altitude) * np.sin(latitude)
    geocentric = np.stack((horizontal * np.cos(longitude), horizontal * np.sin(longitude), polar), axis=1)
    (sin_lat, cos_lat), (sin_lon, cos_lon) = ((np.sin(a[0]), np.cos(a[0])) for a in (latitude, longitude))
    local_from_geocentric = np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )
    return np.asarray((geocentric - geocentric[0]) @ local_from_geocentric.T)


# opening


@contextmanager
def _open(source: Path) -> Iterator[tuple[sqlite3.Connection, _Reader]]:
    """Open for reading alone; what SQLite says of the file becomes one line."""
    try:
        with source.open("rb") as file:
            head = file.read(100)
    except FileNotFoundError:
        raise InputError(f"{source}: there is no such file") from None
    except IsADirectoryError:
        raise InputError(f"{source}: is a folder, expected a COLMAP database") from None
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror})") from None
    if not head:
        raise InputError(f"{source}: is empty, expected a COLMAP database")
    if not head.startswith(b"SQLite format 3\x00"):
        raise InputError(f"{source}: is not a SQLite file, expected a COLMAP database")
    try:
        with _without_trace(source, head) as uri, closing(sqlite3.connect(uri, _PATIENCE_S, uri=True)) as connection:
            connection.execute("PRAGMA query_only = 1")
            yield connection, _Reader(connection, source)
    except sqlite3.Error as error:
        if "locked" in str(error):
            raise InputError(
                f"{source}: is locked by another program that writes to it; try again when it has ended"
            ) from None
        raise InputError(f"{source}: is damaged or not a COLMAP database ({error})") from None
    except (ValueError, TypeError, OverflowError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{source}: holds a value of the wrong kind ({error})") from None


@contextmanager
def _without_trace(source: Path, head: bytes) -> Iterator[str]:
    """Address under which SQLite reads the file and leaves nothing beside it.

    A file in write-ahead mode (COLMAP's) makes readers create ``-wal`` and ``-shm``. With neither there, no program has
    it open and it can be read as immutable. With both there, readers add nothing. With a log alone, a program broke off
    in a write: a copy is read, log included.
    """
    beside = [source.with_name(source.name + suffix) for suffix in ("-wal", "-shm")]
    is_write_ahead = len(head) > 19 and head[19] == 2
    log, index = (path.exists() for path in beside)
    if is_write_ahead and not log:
        yield f"{source.resolve().as_uri()}?immutable=1"
    elif is_write_ahead and not index:
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / "database.db"
            shutil.copyfile(source, copy)
            shutil.copyfile(beside[0], copy.with_name(copy.name + "-wal"))
            yield copy.as_uri()
    else:
        yield f"{source.resolve().as_uri()}?mode=ro"


def _check_schema(source: Path, tables: dict[str, tuple[str, ...]]) -> None:
    needed = dict(_NEEDED)
    if set(_NEEDED_FOR_RIGS) <= set(tables):
        needed |= _NEEDED_FOR_RIGS
    for table, columns in needed.items():
        if table not in tables:
            raise InputError(f"{source}: has no table {table}, expected a COLMAP database")
        absent = [column for column in columns if column not in tables[table]]
        if absent:
            raise InputError(f"{source}: the table {table} has no column {absent[0]}, expected a COLMAP database")


# reading


@dataclass(frozen=True, eq=False)
class _Images:
    ids: Index
    camera_id: Index
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Features:
    counts: Index
    starts: Index
    pixels: Float


@dataclass(frozen=True, eq=False)
class _Matches:
    table: str
    pairs: Index
    config: Int
    counts: Index
    features: Int


@dataclass(frozen=True, eq=False)
class _Priors:
    position: Float
    covariance: Float
    system: Int
    gravity: Float


@dataclass(frozen=True, eq=False)
class _Rigs:
    rigs: dict[int, Rig]
    #: Frame id to rig id.
    frames: dict[int, int]
    #: Frame id, camera id and image id.
    images: list[tuple[int, int, int]]


class _Reader:
    """The tables, one method each."""

    def __init__(self, connection: sqlite3.Connection, source: Path) -> None:
        self._connection, self._source = connection, source

    def _rows(self, query: str) -> list[tuple[Any, ...]]:
        return self._connection.execute(query).fetchall()

    def tables(self) -> dict[str, tuple[str, ...]]:
        names = [name for (name,) in self._rows("SELECT name FROM sqlite_master WHERE type = 'table'")]
        known = [name for name in names if name in {*_NEEDED, *_NEEDED_FOR_RIGS, "pose_priors"}]
        return {name: tuple(row[1] for row in self._rows(f"PRAGMA table_info({name})")) for name in known}

    def images(self) -> _Images:
        rows = self._rows("SELECT image_id, camera_id, name FROM images ORDER BY image_id")
        if not rows:
            raise InputError(f"{self._source}: has no image, expected the answer of feature extraction")
        ids, camera_ids, names = zip(*rows, strict=True)
        for name in names:
            if not isinstance(name, str):
                raise InputError(f"{self._source}: the table images holds the name {name!r}, expected text")
        return _Images(_integers(ids), _integers(camera_ids), tuple(names))

    def cameras(self) -> tuple[dict[int, Camera], list[bool]]:
        query = "SELECT camera_id, model, width, height, params, prior_focal_length FROM cameras ORDER BY camera_id"
        cameras, prior = {}, []
        for camera_id, model, width, height, params, has_prior in self._rows(query):
            values = _numbers(params, f"{self._source}: camera {camera_id}: params")
            cameras[int(camera_id)] = Camera(
                int(camera_id), int(model), int(width), int(height), tuple(values.tolist())
            )
            prior.append(bool(has_prior))
        return cameras, prior

    def keypoints(self, images: _Images) -> _Features:
        """Features of all images, in the order of ``images``; an image without a row has none."""
        counts = np.zeros(len(images.ids), dtype=np.int64)
        chunks = []
        index_of = {image_id: i for i, image_id in enumerate(images.ids.tolist())}
        for image_id, rows, cols, data in self._rows(
            "SELECT image_id, rows, cols, data FROM keypoints ORDER BY image_id"
        ):
            if image_id not in index_of:
                raise InputError(f"{self._source}: the table keypoints has the image {image_id}, which images lacks")
            blob = b"" if data is None else data
            if not isinstance(blob, bytes) or cols < 2 or rows < 0 or len(blob) != 4 * rows * cols:
                raise InputError(
                    f"{self._source}: the key points of image {image_id} are {_size(blob)}, "
                    f"expected {rows} x {cols} numbers of 4 bytes"
                )
            counts[index_of[image_id]] = rows
            chunks.append(np.frombuffer(blob, "<f4").reshape(rows, cols)[:, :2].astype(np.float64))
        pixels = np.concatenate(chunks) if chunks else np.empty((0, 2))
        return _Features(counts, np.concatenate(([0], np.cumsum(counts))), pixels)

    def matches(self, images: _Images) -> _Matches:
        """Read verified matches, or raw ones where there are none."""
        for table, config in (("two_view_geometries", "config"), ("matches", "-1")):
            rows = self._rows(
                f"SELECT pair_id, rows, cols, data, {config} FROM {table} WHERE rows > 0 ORDER BY pair_id"
            )
            if rows:
                break
        else:
            raise InputError(
                f"{self._source}: has no matches, expected the answer of feature matching "
                "(two_view_geometries, or else matches)"
            )
        pair_ids, n_rows, n_cols, blobs, configs = zip(*rows, strict=True)
        ids, counts = _integers(pair_ids), _integers(n_rows)
        pairs = _lookup(images.ids, np.stack((ids // _MAX_IMAGES, ids % _MAX_IMAGES), axis=1))
        for k, (pair, n, cols, blob) in enumerate(zip(ids.tolist(), n_rows, n_cols, blobs, strict=True)):
            if (pairs[k] < 0).any() or pairs[k, 0] == pairs[k, 1]:
                first, second = divmod(pair, _MAX_IMAGES)
                raise InputError(
                    f"{self._source}: the table {table} has the images {first} and {second}, "
                    "expected two different ones of the table images"
                )
            if not isinstance(blob, bytes) or cols != 2 or len(blob) != 8 * n:
                raise InputError(
                    f"{self._source}: the table {table} has for the pair {pair} {_size(blob)}, "
                    f"expected {n} x 2 numbers of 4 bytes"
                )
        matches = np.frombuffer(b"".join(blobs), "<u4").reshape(-1, 2)
        if matches.max(initial=0) > np.iinfo(np.int32).max:
            raise InputError(f"{self._source}: the table {table} names a feature {matches.max()}, which cannot be")
        return _Matches(table, pairs, _integers(configs).astype(np.int32), counts, matches.astype(np.int32))

    def priors(self, images: _Images, columns: Sequence[str]) -> _Priors:
        n = len(images.ids)
        found = _Priors(
            np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.full(n, -1, dtype=np.int32), np.full((n, 3), np.nan)
        )
        if "corr_data_id" in columns:
            image, condition = "corr_data_id", f"WHERE corr_sensor_type = {_CAMERA}"
        elif "image_id" in columns:
            image, condition = "image_id", ""
        else:
            return found
        names = [
            name if name in columns else "NULL"
            for name in ("position", "position_covariance", "gravity", "coordinate_system")
        ]
        index_of = {image_id: i for i, image_id in enumerate(images.ids.tolist())}
        for image_id, position, covariance, gravity, system in self._rows(
            f"SELECT {image}, {', '.join(names)} FROM pose_priors {condition}"
        ):
            if image_id not in index_of:
                continue
            i, where = index_of[image_id], f"{self._source}: pose prior of image {image_id}"
            found.position[i] = _prior(position, 3, f"{where}: position")
            found.covariance[i] = _prior(covariance, 9, f"{where}: position_covariance").reshape(3, 3)
            direction = _prior(gravity, 3, f"{where}: gravity")
            length = float(np.linalg.norm(direction))
            found.gravity[i] = direction / length if length > 0.0 else np.nan
            found.system[i] = -1 if system is None or not np.isfinite(found.position[i]).all() else int(system)
        return found

    def rigs(self) -> _Rigs:
        sensors: dict[int, list[Sensor]] = {}
        for rig_id, sensor_id, sensor_type, pose in self._rows(
            "SELECT rig_id, sensor_id, sensor_type, sensor_from_rig FROM rig_sensors "
            "ORDER BY rig_id, sensor_type, sensor_id"
        ):
            where = f"{self._source}: rig {rig_id}: sensor_from_rig of sensor {sensor_id}"
            values = None if pose is None else _prior(pose, 7, where)
            known = values is not None and bool(np.isfinite(values).all())
            wxyz_xyz = tuple(values.tolist()) if values is not None and known else None
            if wxyz_xyz is not None and abs(float(np.linalg.norm(wxyz_xyz[:4])) - 1.0) > 1e-2:
                raise InputError(f"{where} holds a quaternion that is not of unit length")
            sensors.setdefault(int(rig_id), []).append(Sensor(int(sensor_type), int(sensor_id), wxyz_xyz))
        rigs = {
            int(rig_id): Rig(int(rig_id), (int(kind), int(sensor)), tuple(sensors.get(rig_id, ())))
            for rig_id, kind, sensor in self._rows(
                "SELECT rig_id, ref_sensor_type, ref_sensor_id FROM rigs ORDER BY rig_id"
            )
        }
        frames = {int(f): int(rig) for f, rig in self._rows("SELECT frame_id, rig_id FROM frames ORDER BY frame_id")}
        images = self._rows(
            f"SELECT frame_id, sensor_id, data_id FROM frame_data WHERE sensor_type = {_CAMERA} ORDER BY data_id"
        )
        return _Rigs(rigs, frames, [(int(f), int(camera), int(image)) for f, camera, image in images])


def _integers(values: Sequence[Any]) -> Index:
    """Whole numbers; SQLite keeps anything in any column, so others may be there."""
    if not all(isinstance(value, int) for value in values):
        wrong = next(value for value in values if not isinstance(value, int))
        raise ValueError(f"{wrong!r}, expected a whole number")
    return np.array(values, dtype=np.int64)


def _size(blob: Any) -> str:
    return f"{len(blob)} bytes" if isinstance(blob, bytes) else f"{blob!r}"


def _numbers(blob: Any, where: str) -> Float:
    """Numbers of a blob; none where it is NULL."""
    if blob is None:
        return np.empty(0)
    if not isinstance(blob, bytes) or len(blob) % 8:
        raise InputError(f"{where} is {_size(blob)}, expected numbers of 8 bytes")
    return np.frombuffer(blob, "<f8").astype(np.float64)


def _prior(blob: Any, count: int, where: str) -> Float:
    """``count`` numbers; NaN where the blob is NULL or empty."""
    values = _numbers(blob, where)
    if not len(values):
        return np.full(count, np.nan)
    if len(values) != count:
        raise InputError(f"{where} is {len(values)} numbers, expected {count}")
    return values


def _lookup(ids: Index, wanted: Index) -> Index:
    """Index of each wanted id among ascending ids, -1 where it is not there."""
    if not len(ids):
        return np.full(wanted.shape, -1, dtype=np.int64)
    at = np.minimum(np.searchsorted(ids, wanted), len(ids) - 1)
    return np.where(ids[at] == wanted, at, -1)


# features


def _check_matches(source: Path, images: _Images, n_features: Index, matches: _Matches) -> None:
    beyond = matches.features >= np.repeat(n_features[matches.pairs], matches.counts, axis=0)
    if beyond.any():
        m, side = np.argwhere(beyond)[0]
        pair = int(np.searchsorted(np.cumsum(matches.counts), m, side="right"))
        image = int(matches.pairs[pair, side])
        raise InputError(
            f"{source}: the table {matches.table} names feature {matches.features[m, side]} of image "
            f"{images.names[image]}, which has {n_features[image]} features"
        )


def _models(
    source: Path, cameras: Sequence[Camera], prior_focal: Sequence[bool], image_camera: Index, trust: bool
) -> list[Any]:
    """Make pycolmap's cameras, None for those that took no image; refuse focal lengths that are a guess."""
    used = set(image_camera.tolist())
    models: list[Any] = []
    for c, camera in enumerate(cameras):
        model = pycolmap_camera(camera, source) if c in used else None
        if model is not None and not np.isfinite(camera.params).all():
            raise InputError(f"{source}: camera {camera.camera_id} has parameters {camera.params}, expected numbers")
        if model is not None and list(model.focal_length_idxs()) and not prior_focal[c] and not trust:
            raise InputError(
                f"{source}: camera {camera.camera_id} ({model.model_name}, {camera.width} x {camera.height}) has no "
                f"known focal length, {model.mean_focal_length():g} px is a guess: give COLMAP its calibration "
                "(prior_focal_length = 1 in the table cameras), or trust the guess (trust_focal_lengths)"
            )
        models.append(model)
    return models


def _unproject(models: Sequence[Any], image_camera: Index, features: _Features) -> tuple[Float, Float]:
    """Bearings of all features, and the angle that a pixel spans at each."""
    bearings, pixel_rad = np.full((len(features.pixels), 3), np.nan), np.full(len(features.pixels), np.nan)
    camera_of = np.repeat(image_camera, features.counts)
    for c, model in enumerate(models):
        rows = np.flatnonzero(camera_of == c)
        if len(rows):
            pixels = features.pixels[rows]
            bearings[rows] = _rays(model, pixels)
            pixel_rad[rows] = _pixel_angles(model, pixels, bearings[rows])
    bad = ~np.isfinite(pixel_rad) | (pixel_rad <= 0.0)
    bearings[bad], pixel_rad[bad] = np.nan, np.nan
    return bearings, pixel_rad


def _rays(model: Any, pixels: Float) -> Float:
    """Unproject to unit vectors; whole rows are NaN where the camera cannot."""
    rays = np.asarray(model.cam_ray_from_img(pixels), dtype=np.float64).reshape(-1, 3)
    with np.errstate(invalid="ignore", divide="ignore"):
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    rays[~np.isfinite(rays).all(axis=1) | ~np.isfinite(pixels).all(axis=1)] = np.nan
    return np.asarray(rays)


def _pixel_angles(model: Any, pixels: Float, bearings: Float) -> Float:
    """Measure the side of the square that has the solid angle of a pixel.

    On a spherical camera it is that at the equator everywhere: towards the poles the pixels of a row crowd together,
    but features are found no better for it.
    """
    if model.is_spherical():
        return np.full(len(pixels), 2.0 * np.pi / model.width)
    along_x, along_y = (_rays(model, pixels + step) - bearings for step in ((1.0, 0.0), (0.0, 1.0)))
    return np.asarray(np.sqrt(np.linalg.norm(np.cross(along_x, along_y), axis=1)))


def _with_bearings(bearings: Float, feature_starts: Index, matches: _Matches) -> _Matches:
    """Leave out matches of features without bearings, and then pairs without matches."""
    has_bearing: Bool = np.isfinite(bearings[:, 0])
    both = has_bearing[np.repeat(feature_starts[matches.pairs], matches.counts, axis=0) + matches.features].all(axis=1)
    counts = np.add.reduceat(both, np.cumsum(matches.counts) - matches.counts, dtype=np.int64)
    left = counts > 0
    return _Matches(matches.table, matches.pairs[left], matches.config[left], counts[left], matches.features[both])


# rigs


@dataclass(frozen=True, eq=False)
class _FrameTable:
    of_image: Int
    ids: Int
    rig_id: Int
    rigs: tuple[Rig, ...]
    sensor_from_rig: Float
    center_in_rig: Float


def _frames(
    source: Path, images: _Images, cameras: Sequence[Camera], image_camera: Index, found: _Rigs | None
) -> _FrameTable:
    """Frame of each image and the place of each camera in its rig; each image by itself where there are no rigs."""
    n = len(images.ids)
    rotation, center = np.tile(np.eye(3), (len(cameras), 1, 1)), np.zeros((len(cameras), 3))
    if found is None or not found.images:
        own = np.arange(n, dtype=np.int32)
        return _FrameTable(own, images.ids.astype(np.int32), np.full(n, -1, dtype=np.int32), (), rotation, center)
    frame_of = _frame_of_images(source, images, found)
    for c in np.unique(image_camera).tolist():
        camera_id = cameras[c].camera_id
        for rig in {found.frames[int(f)] for f in np.unique(frame_of[image_camera == c])}:
            rotation[c], center[c] = _place(source, found.rigs[rig], camera_id)
    ids, of_image = np.unique(frame_of, return_inverse=True)
    if len(ids) == n:
        ids, of_image = frame_of, np.arange(n)  # frames in the order of their images
    rig_id = np.array([found.frames[f] for f in ids.tolist()], dtype=np.int32)
    rigs = tuple(rig for rig in found.rigs.values() if rig.rig_id in set(rig_id.tolist()))
    return _FrameTable(of_image.astype(np.int32), ids.astype(np.int32), rig_id, rigs, rotation, center)


def _frame_of_images(source: Path, images: _Images, found: _Rigs) -> Index:
    """(M,) id of the frame of each image."""
    frame_of = np.full(len(images.ids), -1, dtype=np.int64)
    taken: set[tuple[int, int]] = set()
    index_of = {image_id: i for i, image_id in enumerate(images.ids.tolist())}
    for frame_id, camera_id, image_id in found.images:
        i = index_of.get(image_id)
        if i is None:
            continue
        name = images.names[i]
        if found.frames.get(frame_id) not in found.rigs:
            raise InputError(f"{source}: image {name} is in the frame {frame_id}, which has no rig")
        if camera_id != images.camera_id[i]:
            raise InputError(
                f"{source}: image {name} has the camera {images.camera_id[i]}, but {camera_id} in its frame {frame_id}"
            )
        if (frame_id, camera_id) in taken:
            raise InputError(f"{source}: the frame {frame_id} has two images of camera {camera_id}, expected one")
        taken.add((frame_id, camera_id))
        frame_of[i] = frame_id
    if (frame_of < 0).any():
        name = images.names[int(np.argmax(frame_of < 0))]
        raise InputError(f"{source}: image {name} is in no frame, but others are")
    return frame_of


def _place(source: Path, rig: Rig, camera_id: int) -> tuple[Float, Float]:
    """Orientation of a camera in its rig, and its centre there."""
    if rig.reference == (_CAMERA, camera_id):
        return np.eye(3), np.zeros(3)
    for sensor in rig.sensors:
        if (sensor.sensor_type, sensor.sensor_id) == (_CAMERA, camera_id):
            if sensor.wxyz_xyz is None:
                raise InputError(
                    f"{source}: rig {rig.rig_id} does not know where its camera {camera_id} is (sensor_from_rig): "
                    "calibrate the rig, or read every image by itself (use_rigs=False)"
                )
            wxyz, translation = np.array(sensor.wxyz_xyz[:4]), np.array(sensor.wxyz_xyz[4:])
            rotation = rotation_from_quaternion(wxyz[None] / np.linalg.norm(wxyz))[0]
            return rotation, -rotation.T @ translation
    raise InputError(f"{source}: camera {camera_id} took images of rig {rig.rig_id}, which does not have it")
