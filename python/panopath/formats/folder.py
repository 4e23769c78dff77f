"""The folder of an answer: tables for people, files for other programs, and ``scene.npz`` to come back exactly.

``cameras.csv points.csv scene.json scene.npz scene.ply trajectory.tum colmap/0 colmap/1 ...`` (a model a component),
and ``paths.csv`` where bodies may move. These have no place in the files of points at rest.
``scene.json`` marks the folder as panopath's and lists what belongs to it; nothing else in the folder is touched.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.certificate import Certificate
from panopath.errors import InputError
from panopath.formats.colmap import write_colmap
from panopath.formats.csv import quaternion_from_rotation, quoted, table_bytes
from panopath.formats.paths import path_arrays, paths_csv, paths_dict, paths_of_arrays
from panopath.formats.ply import check_colours, ply_bytes
from panopath.formats.tum import tum_text
from panopath.model import Float, PositionOptions, Scene, Status, Summary, Tracks, summary_dict
from panopath.paths import PathVerdict

_MARK = "scene.json"
_CERTIFICATE = "certificate.json"
_LAYOUT = 1
_SCENE_ARRAYS = ("centers", "points", "view_component", "track_component", "inlier", "residual_rad", "cam_from_world")


def write_scene(
    scene: Scene,
    folder: str | PathLike[str],
    tracks: Tracks | None = None,
    options: PositionOptions | None = None,
    *,
    overwrite: bool = False,
    extra: Callable[[Path], None] | None = None,
    certificate: Certificate | None = None,
    colours: npt.NDArray[np.uint8] | None = None,
    panorama_width_px: int = 4096,
) -> Path:
    """Write a scene in every form: see the module's text for the files.

    Parameters
    ----------
    scene
        What to write.
    folder
        Where to. It is made where it is absent; a folder that panopath wrote is brought up to date.
    tracks
        The observations, where the scene does not hold them (``scene.tracks``).
    options
        Recorded in ``scene.json``.
    overwrite
        Whether to write into a folder that panopath did not make; files of other names stay as they are.
    extra
        Called with a folder that becomes part of the answer, to add files of its own, such as pictures.
    certificate
        What is certain of the scene; becomes part of ``scene.json``.
    colours
        (n_tracks, 3) red, green and blue of the points, uint8; default: by error in the PLY, grey in COLMAP models.
    panorama_width_px
        Of the EQUIRECTANGULAR camera of COLMAP models: that of the pictures, where there are some.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        Where the folder is not panopath's and ``overwrite`` is not set, or it cannot be written. Nothing has changed
        then.
    """
    place = Path(folder)
    if colours is not None:
        check_colours(colours, scene)
    if tracks is not None and tracks is not scene.tracks:
        scene = _with_tracks(scene, tracks)
    check_writable(place, overwrite)
    try:
        # a folder that is there may be a disk of its own, and what holds it closed to us
        where = place if place.is_dir() else place.parent
        where.mkdir(parents=True, exist_ok=True)
        staged = Path(tempfile.mkdtemp(prefix=f".{place.name}.", dir=where))
    except OSError as error:
        raise InputError(f"{place}: cannot be written ({error.strerror})") from None
    try:
        _write_files(scene, staged, colours, panorama_width_px)
        if extra is not None:
            extra(staged)
        names = sorted(str(path.relative_to(staged)) for path in staged.rglob("*") if path.is_file())
        (staged / _MARK).write_text(_scene_json(scene, options, [*names, _MARK], certificate), encoding="utf-8")
        _put_in_place(staged, place)
    except OSError as error:
        raise InputError(f"{place}: cannot be written ({error.strerror})") from None
    finally:
        shutil.rmtree(staged, ignore_errors=True)
    return place


def check_writable(folder: str | PathLike[str], overwrite: bool = False) -> None:
    """Say now, before long work, whether :func:`write_scene` would refuse.

    Raises
    ------
    InputError
        Where it would.
    """
    place = Path(folder)
    if place.exists() and not place.is_dir():
        raise InputError(f"{place}: is a file, expected a folder to write to")
    if place.is_dir() and any(place.iterdir()) and not overwrite and not is_scene_folder(place):
        raise InputError(f"{place}: holds files that are not panopath's; name another folder or ask for overwriting")


def is_scene_folder(folder: Path) -> bool:
    """Whether panopath wrote this folder."""
    return _mark(folder) is not None


def read_scene(folder: str | PathLike[str]) -> Scene:
    """Read a scene back exactly as it was written.

    Raises
    ------
    InputError
        Where the folder is not panopath's, or its files are damaged.
    """
    place = Path(folder)
    if not place.is_dir():
        raise InputError(f"{place}: there is no such folder")
    mark = _mark(place)
    if mark is None:
        raise InputError(f"{place}: has no {_MARK} of panopath")
    if mark["panopath"].get("layout") != _LAYOUT:
        raise InputError(f"{place / _MARK}: has the layout {mark['panopath'].get('layout')}, expected {_LAYOUT}")
    path = place / "scene.npz"
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return scene_of_arrays(arrays, summary_of(mark["summary"]))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except (OSError, ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: is damaged ({error})") from None


def write_certificate(certificate: Certificate, scene: Scene, folder: str | PathLike[str]) -> Path:
    """Write ``certificate.json`` for a scene that has no ``scene.json``, such as a COLMAP model.

    Parameters
    ----------
    certificate
        What was found.
    scene
        What was certified: its names go into the sentences.
    folder
        Where to; it is made where it is absent. Other files stay as they are.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        Where a ``certificate.json`` is there that panopath did not write, or none can be written. Nothing has changed
        then.
    """
    check_certificate_writable(folder)
    path = Path(folder) / _CERTIFICATE
    content = {
        "panopath": {"version": _core.__version__, "layout": _LAYOUT},
        "certificate": _certificate(certificate, scene),
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.stem}.", dir=path.parent) as staged:
            (Path(staged) / path.name).write_text(_json(content), encoding="utf-8")
            os.replace(Path(staged) / path.name, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    return path


def check_certificate_writable(folder: str | PathLike[str]) -> None:
    """Say now, before long work, whether :func:`write_certificate` would refuse.

    Raises
    ------
    InputError
        Where it would.
    """
    place = Path(folder)
    if place.exists() and not place.is_dir():
        raise InputError(f"{place}: is a file, expected a folder to write to")
    if (place / _CERTIFICATE).exists() and _mark(place, _CERTIFICATE) is None:
        raise InputError(f"{place / _CERTIFICATE}: is not panopath's; name another folder")


def read_certificate(folder: str | PathLike[str]) -> dict[str, Any]:
    """Read the certificate that ``scene.json`` holds, or else ``certificate.json``: plain values.

    Raises
    ------
    InputError
        Where there is none.
    """
    place = Path(folder)
    for name in (_MARK, _CERTIFICATE):
        found = (_mark(place, name) or {}).get("certificate")
        if isinstance(found, dict):
            return found
    raise InputError(f"{place}: holds no certificate; panopath check -o writes one")


def _with_tracks(scene: Scene, tracks: Tracks) -> Scene:
    return replace(
        scene,
        tracks=tracks,
        view_names=scene.view_names or tracks.view_names,
        track_names=scene.track_names or tracks.track_names,
    )


def _mark(folder: Path, name: str = _MARK) -> dict[str, Any] | None:
    try:
        found = json.loads((folder / name).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    is_ours = isinstance(found, dict) and isinstance(found.get("panopath"), dict)
    return found if is_ours else None


def _put_in_place(staged: Path, place: Path) -> None:
    """Make the staged files those of ``place``: in one step where it is new, else file by file, the mark last."""
    if not place.exists():
        os.chmod(staged, 0o777 & ~_umask())
        os.rename(staged, place)
        return
    before = _mark(place) or {}
    old = {name for name in before.get("files", []) if isinstance(name, str)}
    new = [str(path.relative_to(staged)) for path in staged.rglob("*") if path.is_file() and path.name != _MARK]
    for name in [*sorted(new), _MARK]:
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(staged / name, place / name)
    for name in sorted(old - set(new) - {_MARK}):
        stale = place / name
        if stale.resolve().is_relative_to(place.resolve()):
            stale.unlink(missing_ok=True)
            with contextlib.suppress(OSError):
                stale.parent.rmdir()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _write_files(scene: Scene, folder: Path, colours: npt.NDArray[np.uint8] | None, width_px: int) -> None:
    np.savez(folder / "scene.npz", allow_pickle=False, **scene_arrays(scene))
    (folder / "cameras.csv").write_bytes(_cameras_csv(scene))
    (folder / "points.csv").write_bytes(_points_csv(scene))
    if scene.paths is not None:
        (folder / "paths.csv").write_bytes(paths_csv(scene))
    (folder / "scene.ply").write_bytes(ply_bytes(scene, colours))
    (folder / "trajectory.tum").write_text(tum_text(scene), encoding="utf-8")
    if scene.d == 3 and scene.tracks is not None:
        for component in range(scene.n_components):
            model = folder / "colmap" / str(component)
            write_colmap(scene, scene.tracks, model, component, width_px, colours=colours)


def scene_arrays(scene: Scene) -> dict[str, npt.NDArray[Any]]:
    """All of a scene but its summary, as named arrays without objects."""
    arrays: dict[str, Any] = {name: getattr(scene, name) for name in _SCENE_ARRAYS}
    for kind in ("view_names", "track_names"):
        names = getattr(scene, kind)
        if names is not None:
            # one text: an array of text would be as wide as its longest name, and drop NULs at its end
            arrays[kind] = np.frombuffer(json.dumps(names).encode("utf-8"), dtype=np.uint8)
    if scene.tracks is not None:
        tracks = scene.tracks
        arrays |= {"tracks_view": tracks.view, "tracks_track": tracks.track, "tracks_bearing": tracks.bearing}
        arrays |= {
            f"tracks_{name}": value
            for name, value in (("sigma_rad", tracks.sigma_rad), ("time_s", tracks.time_s))
            if value is not None
        }
    if scene.paths is not None:
        arrays |= path_arrays(scene.paths)
    return arrays


def scene_of_arrays(arrays: dict[str, Any], summary: Summary) -> Scene:
    """Make a scene again of its arrays.

    Raises
    ------
    LookupError, ValueError
        Where an array is absent, or they do not go together.
    """
    return Scene(
        **{name: arrays[name] for name in _SCENE_ARRAYS},
        summary=summary,
        tracks=_tracks(arrays),
        view_names=_names(arrays, "view_names"),
        track_names=_names(arrays, "track_names"),
        paths=paths_of_arrays(arrays),
    )


def _names(arrays: dict[str, Any], kind: str) -> tuple[str, ...] | None:
    return tuple(json.loads(arrays[kind].tobytes())) if kind in arrays else None


def _tracks(arrays: dict[str, Any]) -> Tracks | None:
    if "tracks_view" not in arrays:
        return None
    return Tracks.from_arrays(
        arrays["tracks_view"],
        arrays["tracks_track"],
        arrays["tracks_bearing"],
        len(arrays["centers"]),
        len(arrays["points"]),
        arrays.get("tracks_sigma_rad"),
        arrays.get("tracks_time_s"),
        _names(arrays, "view_names"),
        _names(arrays, "track_names"),
    )


def summary_of(plain: dict[str, Any]) -> Summary:
    """Make a summary again of the plain values of :func:`panopath.model.summary_dict`."""
    fields = dict(plain)
    fields["status"] = Status(fields["status"])
    fields["sigma_rad"] = float("nan") if fields["sigma_rad"] is None else fields["sigma_rad"]
    fields["seconds"] = MappingProxyType(dict(fields["seconds"]))
    return Summary(**fields)


def _scene_json(
    scene: Scene, options: PositionOptions | None, files: Sequence[str], certificate: Certificate | None
) -> str:
    content = {
        "panopath": {"version": _core.__version__, "layout": _LAYOUT},
        "d": scene.d,
        "summary": summary_dict(scene.summary),
        "components": [
            {"views": int((scene.view_component == c).sum()), "points": int((scene.track_component == c).sum())}
            for c in range(scene.n_components)
        ],
        "options": None if options is None else options.to_dict(),
        "files": sorted(files),
    }
    told = paths_dict(scene)
    if told is not None:
        content["paths"] = told
    if certificate is not None:
        content["certificate"] = _certificate(certificate, scene)
    return _json(content)


def _certificate(certificate: Certificate, scene: Scene) -> dict[str, Any]:
    return certificate.to_dict(scene.view_labels(), scene.track_labels())


def _json(content: dict[str, Any]) -> str:
    """Indented text with each list of numbers on one line. A string cannot hold the line breaks looked for."""
    text = json.dumps(content, indent=2, allow_nan=False)
    return re.sub(r"\[\n([^\[\]{}\"]*)\]", lambda found: f"[{' '.join(found[1].split())}]", text) + "\n"


def _cameras_csv(scene: Scene) -> bytes:
    statistics = scene.view_statistics()
    header = ["view", *_axes(scene.d)]
    cells = [quoted(scene.view_labels()), *_number_cells(scene.centers)]
    if scene.d == 3:
        header += ["qw", "qx", "qy", "qz"]
        cells += _number_cells(quaternion_from_rotation(scene.cam_from_world))
    else:
        header.append("heading_deg")
        cells += _number_cells(np.degrees(scene.cam_from_world)[:, None])
    header += ["component", "n_observations", "n_inliers", "angular_rms_deg"]
    cells += [
        [*map(str, scene.view_component.tolist())],
        [*map(str, statistics.n_observations.tolist())],
        [*map(str, statistics.n_inliers.tolist())],
        *_number_cells(np.degrees(statistics.rms_rad)[:, None]),
    ]
    if scene.tracks is not None and scene.tracks.time_s is not None:
        header.append("time_s")
        cells += _number_cells(scene.tracks.time_s[:, None])
    return table_bytes(header, zip(*cells, strict=True))


def _points_csv(scene: Scene) -> bytes:
    statistics = scene.point_statistics()
    header = ["track", *_axes(scene.d), "component", "track_length", "n_inliers", "angular_rms_deg", "flags"]
    solved = scene.track_component >= 0
    has_outliers = solved & (statistics.n_inliers < statistics.n_observations)
    few = solved & (statistics.n_inliers <= 2) & (statistics.n_observations > 0)
    texts = np.array(["", "outliers", "two_views", "outliers two_views"], dtype=object)
    flags = texts[has_outliers + 2 * few]
    flags[~solved] = "undetermined"
    if scene.paths is not None:
        flags = flags + _path_flags(scene.paths.verdicts, flags)
    cells = [
        quoted(scene.track_labels()),
        *_number_cells(scene.points),
        [*map(str, scene.track_component.tolist())],
        [*map(str, statistics.n_observations.tolist())],
        [*map(str, statistics.n_inliers.tolist())],
        *_number_cells(np.degrees(statistics.rms_rad)[:, None]),
        flags.tolist(),
    ]
    return table_bytes(header, zip(*cells, strict=True))


def _path_flags(verdicts: Sequence[PathVerdict], flags: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Flag tracks that are not at rest; to be put behind other flags."""
    silent = (PathVerdict.STATIC, PathVerdict.UNDETERMINED)
    words = ["" if one in silent else one.value for one in verdicts]
    return np.array([f" {w}" if w and flag else w for w, flag in zip(words, flags, strict=True)], dtype=object)


def _axes(d: int) -> list[str]:
    return ["x", "y", "z"][:d]


def _number_cells(columns: Float) -> list[list[str]]:
    """Texts that come back bit for bit, empty where not known."""
    return [["" if math.isnan(v) else repr(v) for v in columns[:, c].tolist()] for c in range(columns.shape[1])]
