"""Recognises what a file holds by its content, and reads it."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

from panopath.errors import InputError
from panopath.formats import bal, colmap, csv, frames, parquet
from panopath.formats.files import read_bytes
from panopath.formats.folder import is_scene_folder, read_scene
from panopath.model import Problem, Tracks, check_orientations

_KNOWN = "a bearings table (CSV, Parquet, data frame), a BAL file, a COLMAP model folder or a panopath folder"


def read_tracks(source: Any, orientations: Any = None) -> Tracks:
    """Read observations whose bearings are world directions.

    Parameters
    ----------
    source
        A path: bearings as CSV (plain or gzip) or Parquet, a BAL file, a COLMAP model folder, a folder that
        panopath wrote. Or a data frame (pandas, polars, arrow, a dict of columns). Recognised by content.
    orientations
        Where bearings are in the cameras: a path to an orientations file, or an array ``cam_from_world``
        (n_views, 3, 3), or headings in radians (n_views,) for d = 2. None: the file's own, where it has them (BAL,
        COLMAP); else the bearings are world directions already.

    Returns
    -------
    Tracks
        Bearings turned to the world wherever orientations are known; :func:`read_problem` keeps the parts apart.

    Raises
    ------
    InputError
        Naming the file, line and column, and what was expected.
    """
    return read_problem(source, orientations).world_tracks()


def read_problem(source: Any, orientations: Any = None) -> Problem:
    """Read observations as they stand, with the orientations and the structure that come with them.

    Parameters and errors are those of :func:`read_tracks`.

    Returns
    -------
    Problem
        ``tracks`` (in the cameras where ``cam_from_world`` is given), ``cam_from_world`` or None, and the file's own
        ``scene`` or None.
    """
    problem = _read(source)
    if orientations is None:
        return problem
    if isinstance(orientations, str | PathLike):
        found = csv.read_orientations(orientations, problem.tracks)
    else:
        found = check_orientations(orientations, problem.tracks.n_views, problem.tracks.d)
    return Problem(problem.tracks, check_orientations(found, problem.tracks.n_views, problem.tracks.d))


def _read(source: Any) -> Problem:
    if isinstance(source, Tracks):
        return Problem(source)
    if not isinstance(source, str | PathLike):
        if frames.is_frame(source):
            return Problem(frames.read_frame(source))
        raise InputError(f"cannot read tracks from a {type(source).__name__}, expected a path or a data frame")
    path, name = Path(source), str(source)
    if path.is_dir():
        return _read_folder(path)
    data = read_bytes(path)
    if data.startswith(parquet.MAGIC):
        return Problem(parquet.read_parquet(data, name))
    if bal.is_bal(data):
        return bal.read_bal(data, name)
    return Problem(csv.read_bearings(data, name))


def _read_folder(path: Path) -> Problem:
    if is_scene_folder(path):
        scene = read_scene(path)
        if scene.tracks is None:
            raise InputError(f"{path}: is a panopath folder without observations")
        return Problem(scene.tracks, scene.cam_from_world, scene)
    if colmap.find_model(path) is not None:
        return colmap.read_colmap(path)
    raise InputError(f"{path}: is a folder without a COLMAP model, expected {_KNOWN}")
