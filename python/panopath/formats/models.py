"""COLMAP models of a database's own images: one folder a component, the largest first."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.formats.colmap_model import (
    NO_POINT,
    Frames,
    Index,
    ModelImages,
    ModelPoints,
    pycolmap_camera,
    write_model,
)
from panopath.formats.database import Database
from panopath.model import Bool, Float, read_only


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Poses, points and observations of a database's images. Rows that are not determined are NaN."""

    #: (M, 3, 3) and (M, 3): orientation and centre of each image.
    cam_from_world: Float
    centers: Float
    #: (n, 3).
    points: Float
    #: (N,) image, feature (counted within the image) and point of each observation.
    image: Index
    feature: Index
    point: Index
    #: (M,) the jointly scaled part each image belongs to, -1 = none.
    component: Index

    @classmethod
    def from_arrays(
        cls,
        database: Database,
        cam_from_world: npt.ArrayLike,
        centers: npt.ArrayLike,
        points: npt.ArrayLike,
        observations: npt.ArrayLike,
        *,
        component: npt.ArrayLike | None = None,
    ) -> Reconstruction:
        """Check the arrays against the database, and make the record.

        Parameters
        ----------
        database
            Whose images these are.
        cam_from_world, centers
            (M, 3, 3) rotations and (M, 3) positions of the images; NaN rows: not registered.
        points
            (n, 3), NaN rows where unknown.
        observations
            (N, 3) image, feature within the image, and point.
        component
            (M,) part of each image, -1 for none; default: all registered images in one.

        Raises
        ------
        InputError
            Naming the argument and the first entry that cannot be used.
        """
        m = database.n_images
        rotation, center = _floats("cam_from_world", cam_from_world, (m, 3, 3)), _floats("centers", centers, (m, 3))
        position = _floats("points", points, (None, 3))
        triples = np.ascontiguousarray(observations)
        if triples.ndim != 2 or triples.shape[1] != 3 or triples.dtype.kind not in "iu":
            raise InputError(
                f"observations has type {triples.dtype} and shape {triples.shape}, expected whole numbers (N, 3)"
            )
        image, feature, point = triples.astype(np.int64).T
        for name, ids, limit in (("image", image, m), ("point", point, len(position))):
            _check_below(name, ids, np.full(len(ids), limit))
        _check_below("feature", feature, database.n_features[image])
        part = np.zeros(m, dtype=np.int64) if component is None else np.array(component)
        if part.shape != (m,) or part.dtype.kind not in "iu":
            raise InputError(f"component has type {part.dtype} and shape {part.shape}, expected whole numbers ({m},)")
        registered = np.isfinite(np.concatenate((center, rotation.reshape(m, 9)), axis=1)).all(axis=1)
        part = np.where(registered, part, -1).astype(np.int64)
        arrays = (rotation, center, position, image, feature, point, part)
        return cls(*(read_only(np.ascontiguousarray(array)) for array in arrays))


def write_models(
    database: Database,
    found: Reconstruction,
    folder: str | PathLike[str],
    *,
    colours: npt.NDArray[np.uint8] | None = None,
) -> list[Path]:
    """Write a binary COLMAP model of each component, the one with most images first: ``folder/0``, ``folder/1`` ...

    Cameras, ids, names and pixels are the database's own; every image has all its features. A point is written with the
    component in which most of its observations are, where there are two or more. Its error is the mean reprojection
    error in pixels, on a spherical camera the angle in pixels at the equator. Rigs and frames are written where the
    database has them.

    Parameters
    ----------
    database
        Whose images were reconstructed.
    found
        What was found.
    folder
        Where to write; models in numbered folders are replaced, those of more components than now removed; other
        files stay.
    colours
        (n_points, 3) red, green and blue of the points; default: grey.

    Returns
    -------
    list
        The folders written.

    Raises
    ------
    InputError
        Where nothing is registered, a feature belongs to two points, or the folder cannot be written.
    """
    used, point_component = _used(found)
    _check_features(database, found, used)
    error_px = _errors_px(database, found, used)
    parts, sizes = np.unique(found.component[found.component >= 0], return_counts=True)
    if not len(parts):
        raise InputError("no image is registered, so there is no model to write")
    written = []
    for place, part in enumerate(parts[np.argsort(-sizes, kind="stable")].tolist()):
        images, rows = (
            np.flatnonzero(found.component == part),
            np.flatnonzero(used & (point_component[found.point] == part)),
        )
        path = Path(folder) / str(place)
        _write_part(database, found, path, images, rows, error_px=error_px, colours=colours)
        written.append(path)
    _remove_models_beyond(Path(folder), len(written))
    return written


def _remove_models_beyond(folder: Path, n_written: int) -> None:
    """Take away models of an earlier run with more components, and no file but theirs."""
    for path in folder.glob("*"):
        if path.is_dir() and path.name.isdecimal() and int(path.name) >= n_written:
            for name in ("cameras", "images", "points3D", "rigs", "frames"):
                (path / f"{name}.bin").unlink(missing_ok=True)
            if not any(path.iterdir()):
                path.rmdir()


def check_model_folder(folder: str | PathLike[str], overwrite: bool = False) -> None:
    """Say now, before long work, whether models may be written here.

    Raises
    ------
    InputError
        Where ``folder`` is a file, or holds a model already and ``overwrite`` is not asked for.
    """
    place = Path(folder)
    if place.exists() and not place.is_dir():
        raise InputError(f"{place}: is a file, expected a folder to write to")
    if not overwrite:
        for path in (place, *(p for p in place.glob("*") if p.is_dir() and p.name.isdecimal())):
            if any((path / f"images.{suffix}").exists() for suffix in ("bin", "txt")):
                raise InputError(f"{path}: holds a model already; name another folder or ask for --overwrite")


def _used(found: Reconstruction) -> tuple[Bool, Index]:
    """Observations that a model can hold, and the component of each point, -1 where no two agree on one."""
    n_parts = int(found.component.max(initial=-1)) + 1
    part = found.component[found.image]
    used: Bool = np.asarray(part >= 0) & np.asarray(np.isfinite(found.points).all(axis=1))[found.point]
    votes, counts = np.unique(found.point[used] * n_parts + part[used], return_counts=True)
    votes = votes[counts >= 2][np.argsort(counts[counts >= 2], kind="stable")]
    point_component = np.full(len(found.points), -1, dtype=np.int64)
    point_component[votes // max(n_parts, 1)] = votes % max(n_parts, 1)  # the last one, which has most votes, stays
    return used & (part == point_component[found.point]), point_component


def _check_features(database: Database, found: Reconstruction, used: Bool) -> None:
    rows = np.flatnonzero(used)
    rows = rows[np.argsort(database.feature_starts[found.image[rows]] + found.feature[rows], kind="stable")]
    image, feature, point = found.image[rows], found.feature[rows], found.point[rows]
    twice = (image[1:] == image[:-1]) & (feature[1:] == feature[:-1])
    if twice.any():
        k = int(np.argmax(twice))
        raise InputError(
            f"observations gives feature {feature[k]} of image {database.image_names[image[k]]} to the points "
            f"{point[k]} and {point[k + 1]}, expected one"
        )


def _errors_px(database: Database, found: Reconstruction, used: Bool) -> Float:
    """(N,) reprojection errors; NaN where not used or where the camera cannot project."""
    error = np.full(len(found.image), np.nan)
    models: dict[int, Any] = {}
    camera_of = database.image_camera[found.image]
    for c in np.unique(camera_of[used]).tolist():
        model = models[c] = pycolmap_camera(database.cameras[c], database.path)
        rows = np.flatnonzero(used & (camera_of == c))
        image, feature = found.image[rows], database.feature_starts[found.image[rows]] + found.feature[rows]
        ray = np.einsum(
            "nij,nj->ni", found.cam_from_world[image], found.points[found.point[rows]] - found.centers[image]
        )
        if model.is_spherical():
            bearing, length = database.bearings[feature], np.linalg.norm(ray, axis=1)
            apart = np.linalg.norm(np.cross(bearing, ray), axis=1)
            error[rows] = np.arctan2(apart, np.einsum("ni,ni->n", bearing, ray)) * (model.width / (2.0 * np.pi))
            error[rows[length == 0.0]] = np.nan
        else:
            projected = np.asarray(model.img_from_cam(ray), dtype=np.float64).reshape(-1, 2)
            error[rows] = np.linalg.norm(projected - database.pixels[feature], axis=1)
            error[rows[ray[:, 2] <= 0.0]] = np.nan
    return error


def _write_part(
    database: Database,
    found: Reconstruction,
    folder: Path,
    images: Index,
    rows: Index,
    *,
    error_px: Float,
    colours: npt.NDArray[np.uint8] | None,
) -> None:
    """Write one component: its images, and the observations ``rows``."""
    rows = rows[np.lexsort((found.image[rows], found.point[rows]))]
    ids, begins, counts = np.unique(found.point[rows], return_index=True, return_counts=True)
    point_of_feature = np.full(len(database.pixels), NO_POINT, dtype=np.uint64)
    point_of_feature[database.feature_starts[found.image[rows]] + found.feature[rows]] = found.point[rows] + 1
    lengths = database.n_features[images]
    features = np.repeat(database.feature_starts[images], lengths) + _within(lengths)
    model_images = ModelImages(
        image_id=database.image_id[images].astype(np.int64),
        camera_id=_camera_ids(database)[database.image_camera[images]],
        names=[database.image_names[i] for i in images.tolist()],
        cam_from_world=found.cam_from_world[images],
        centers=found.centers[images],
        starts=np.concatenate(([0], np.cumsum(lengths))),
        pixels=database.pixels[features],
        point_id=point_of_feature[features],
    )
    points = ModelPoints(
        point_id=ids.astype(np.uint64) + np.uint64(1),
        positions=found.points[ids],
        color=None if colours is None else colours[ids],
        error_px=_means(error_px[rows], np.repeat(np.arange(len(ids)), counts), len(ids)),
        starts=np.append(begins, len(rows)),
        elements=np.stack((database.image_id[found.image[rows]].astype(np.int64), found.feature[rows]), axis=1),
    )
    frames = _frames(database, found, images)
    rig_ids = set() if frames is None else set(frames.rig_id.tolist())
    rigs = [rig for rig in database.rigs if rig.rig_id in rig_ids]
    carried = {sensor_id for rig in rigs for kind, sensor_id in _sensors(rig) if kind == 0}
    taken = set(model_images.camera_id.tolist())
    cameras = [camera for camera in database.cameras if camera.camera_id in taken | carried]
    write_model(folder, cameras, model_images, points, rigs=rigs, frames=frames)


def _frames(database: Database, found: Reconstruction, images: Index) -> Frames | None:
    """Frames of some images, where the database has rigs."""
    if not database.rigs:
        return None
    centers = np.full_like(found.centers, np.nan)
    centers[images] = found.centers[images]
    rig_from_world, rig_centers = database.frame_poses(found.cam_from_world, centers)
    in_order = images[np.argsort(database.image_frame[images], kind="stable")]
    frame, first = np.unique(database.image_frame[in_order], return_index=True)
    camera_ids = _camera_ids(database)[database.image_camera[in_order]]
    taken = list(zip(camera_ids.tolist(), database.image_id[in_order].tolist(), strict=True))
    ends = np.append(first[1:], len(in_order)).tolist()
    return Frames(
        frame_id=database.frame_id[frame].astype(np.int64),
        rig_id=database.frame_rig_id[frame].astype(np.int64),
        rig_from_world=rig_from_world[frame],
        centers=rig_centers[frame],
        images=[taken[begin:end] for begin, end in zip(first.tolist(), ends, strict=True)],
    )


def _sensors(rig: Any) -> list[tuple[int, int]]:
    return [rig.reference, *((sensor.sensor_type, sensor.sensor_id) for sensor in rig.sensors)]


def _camera_ids(database: Database) -> Index:
    return np.array([camera.camera_id for camera in database.cameras], dtype=np.int64)


def _within(lengths: Index) -> Index:
    """0, 1, ... of each group, one group after another."""
    return np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)


def _means(values: Float, group: Index, n_groups: int) -> Float:
    """Mean of the finite values of each group; -1, COLMAP's *unknown*, where there are none."""
    finite = np.isfinite(values)
    count = np.bincount(group[finite], minlength=n_groups)
    total = np.bincount(group[finite], weights=values[finite], minlength=n_groups)
    return np.where(count > 0, total / np.maximum(count, 1), -1.0)


def _floats(name: str, values: npt.ArrayLike, shape: tuple[int | None, ...]) -> Float:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} does not hold numbers") from None
    wanted = (len(array) if shape[0] is None and array.ndim else shape[0], *shape[1:])
    if array.shape != wanted:
        text = ", ".join("n" if n is None else str(n) for n in shape)
        raise InputError(f"{name} has shape {array.shape}, expected ({text})")
    return array


def _check_below(name: str, ids: Index, limit: Index) -> None:
    outside = (ids < 0) | (ids >= limit)
    if outside.any():
        o = int(np.argmax(outside))
        raise InputError(f"observations[{o}] names the {name} {ids[o]}, expected one from 0 to below {limit[o]}")
