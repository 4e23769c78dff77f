"""What a folder of an answer holds for the viewer; only the scene must be there."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from panopath.errors import InputError
from panopath.formats.colmap import find_model
from panopath.formats.detect import read_problem
from panopath.formats.folder import is_scene_folder, read_certificate, read_scene
from panopath.formats.ply import error_colours, shown_points
from panopath.images import check_panorama, encoded, load_opencv, read_image
from panopath.model import Float, Scene
from panopath.movers import at_rest
from panopath.paths import PathVerdict
from panopath.steps.refinement import RefineOptions, scene_covariance
from panopath.viewer.shapes import Colours

_PLY_TYPES = {"double": "<f8", "float": "<f4", "int": "<i4", "uchar": "u1"}
_PLACED = (PathVerdict.MOVING, PathVerdict.STATIC)
_SUFFIXES = ("", ".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff")


@dataclass(frozen=True, eq=False)
class Content:
    """A scene and what lies beside it. Made by :func:`read_content`."""

    folder: Path
    scene: Scene
    #: (n_tracks, 3) colours of the points as the pictures show them, None where they are not known.
    colours: Colours | None
    #: The panorama of each view, None where there is none.
    images: tuple[Path | None, ...]
    #: What ``scene.json`` holds of the certificate, None where it holds nothing.
    certificate: Mapping[str, Any] | None
    #: What a person should know of the folder and the scene.
    notes: tuple[str, ...] = ()

    def covariances(self) -> tuple[Float, Float]:
        """(n_views, d, d) of the centres and (n_tracks, d, d) of the points, NaN where not known; nothing of movers.

        Bodies that move add little to what is known of the cameras, and are left out here.

        Raises
        ------
        InputError
            Where they cannot be had: no observations, or a scene that they do not determine.
        """
        scene = self.scene
        if scene.tracks is None:
            raise InputError("the folder holds no observations")
        if not (np.isfinite(scene.summary.sigma_rad) and scene.summary.sigma_rad > 0.0) and (
            scene.tracks.sigma_rad is None
        ):
            raise InputError("the noise of the bearings is not known")
        known = self.certificate is not None and self.certificate.get("orientation") == "known"
        found = scene_covariance(scene.tracks, at_rest(scene), RefineOptions(hold_rotations=known))
        first = found.cameras.shape[1] - scene.d
        return found.cameras[:, first:, first:], found.points

    def panorama(self, view: int, most_px: int) -> bytes:
        """Bytes of a JPEG of a view's panorama, at most ``most_px`` wide.

        Raises
        ------
        InputError
            Where there is none, or it is not a panorama.
        """
        path = self.images[view]
        if path is None:
            raise InputError(f"view {self.scene.view_labels()[view]} has no picture")
        picture = check_panorama(read_image(path), str(path))
        if picture.shape[1] > most_px:
            cv2 = load_opencv()
            size = (most_px, max(1, round(most_px * picture.shape[0] / picture.shape[1])))
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return encoded(picture, ".jpg", 90)


def read_content(folder: str | PathLike[str], images: str | PathLike[str] | None = None) -> Content:
    """Read what there is to show.

    Parameters
    ----------
    folder
        What :func:`panopath.formats.write_scene` or a command wrote, or a COLMAP model.
    images
        Folder of the panoramas; default: the one that ``run.json`` names, or else ``images``.

    Raises
    ------
    InputError
        Where the folder holds no scene, nothing of it is solved, or ``images`` is not a folder.
    """
    place = Path(folder)
    scene = _scene(place)
    if not np.isfinite(scene.centers).all(axis=1).any():
        raise InputError(f"{place}: no view of the scene is solved, there is nothing to show")
    colours, notes = None, []
    try:
        colours = _colours(place / "scene.ply", scene)
    except (OSError, ValueError) as error:
        if (place / "scene.ply").exists():
            notes.append(f"scene.ply cannot be read: {error}")
    try:
        certificate: Mapping[str, Any] | None = read_certificate(place)
    except InputError:
        certificate = None
    if images is not None and not Path(images).is_dir():
        raise InputError(f"{images}: there is no such folder of images")
    pictures = _recorded_images(place) if images is None else Path(images)
    notes += _told_of_paths(scene)
    return Content(place, scene, colours, _images(pictures, scene), certificate, tuple(notes))


def _told_of_paths(scene: Scene) -> list[str]:
    """Say how many bodies move, what was refused, and under which assumption."""
    if scene.paths is None:
        return []
    count = Counter(scene.paths.verdicts)
    told = [f"{count[PathVerdict.MOVING]:,} tracks move"]
    told += [f"{count[one]:,} {one.value}" for one in PathVerdict if count[one] and one not in _PLACED]
    assumed = f"; taken to be so: {scene.paths.assumption}" if scene.paths.assumption else ""
    return [", ".join(told) + assumed]


def _scene(place: Path) -> Scene:
    if is_scene_folder(place) or not place.is_dir() or find_model(place) is None:
        return read_scene(place)
    scene = read_problem(place).scene
    if scene is None:
        raise InputError(f"{place}: the model has no points")
    return scene


def _recorded_images(place: Path) -> Path:
    """Folder of the panoramas as `panopath reconstruct` recorded it, relative to its own."""
    try:
        run = json.loads((place / "run.json").read_text(encoding="utf-8"))
        return place / str(run["images"]) if isinstance(run["images"], str) else place / "images"
    except (OSError, ValueError, KeyError, TypeError):
        return place / "images"


def _images(folder: Path, scene: Scene) -> tuple[Path | None, ...]:
    """Find the picture of each view by its name, with or without a suffix; never one outside of the folder."""
    if not folder.is_dir():
        return (None,) * len(scene.centers)
    root = folder.resolve()
    files = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    by_stem = {name.rpartition(".")[0]: path for name, path in files.items()}
    found: list[Path | None] = []
    for label in scene.view_labels():
        name = str(label)
        names = [name + suffix for suffix in _SUFFIXES]
        path = next((files[name] for name in names if name in files), None)
        # a view named after a picture of another kind: NAME.png, written as NAME.jpg
        path = by_stem.get(name.rpartition(".")[0]) if path is None and "." in name else path
        found.append(path if path is not None and path.resolve().is_relative_to(root) else None)
    return tuple(found)


def _colours(path: Path, scene: Scene) -> Colours | None:
    """Colours of the points, where the file has others than those that ``write_scene`` gives to errors.

    Raises
    ------
    OSError, ValueError
        Where the file cannot be read, or is not of this scene.
    """
    header, _, data = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii", "replace").splitlines()
    if lines[:2] != ["ply", "format binary_little_endian 1.0"] or not data:
        raise ValueError("not a PLY file of panopath")
    words = [line.split() for line in lines]
    elements = [k for k, word in enumerate(words) if word[:1] == ["element"]]
    if not elements or words[elements[0]][1] != "vertex":
        raise ValueError("no vertices come first")
    end = elements[1] if len(elements) > 1 else len(words)
    row = np.dtype([(word[2], _PLY_TYPES.get(word[1], "V1")) for word in words[elements[0] + 1 : end]])
    vertices = np.frombuffer(data, dtype=row, count=int(words[elements[0]][2]))
    points = shown_points(scene)
    if not {"red", "green", "blue", "is_camera"} <= set(row.names or ()):
        raise ValueError("it has no colours")
    if int((vertices["is_camera"] == 0).sum()) != len(points):
        raise ValueError("its points are not those of the scene")
    shown = np.stack([vertices[name][: len(points)] for name in ("red", "green", "blue")], axis=1)
    if np.array_equal(shown, error_colours(np.degrees(scene.point_statistics().rms_rad[points]))):
        return None
    colours = np.full((len(scene.points), 3), 128, dtype=np.uint8)
    colours[points] = shown
    return colours
