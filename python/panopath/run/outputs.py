"""The folder of a run: what is written, and how each file is called."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.certificate import Certificate
from panopath.formats.crops import write_crops
from panopath.formats.files import write_bytes
from panopath.formats.folder import write_scene
from panopath.formats.geo import GeoPath, write_geojson, write_gpx
from panopath.formats.models import Reconstruction, write_models
from panopath.formats.nerfstudio import write_nerfstudio
from panopath.frontend import Measured, Picture, Source, SourceKind
from panopath.frontend.images import masks_of, read_mask
from panopath.frontend.video import read_frames
from panopath.georeference import Georeference
from panopath.images import encoded
from panopath.model import Scene
from panopath.report.page import ReportNotes, write_report
from panopath.run.options import RunOptions
from panopath.run.place import Placed

_RUN, _CROPS = "run.json", "crops"
_GREY = 128


class ImageKeeper:
    """Pictures of the views: keyframes of a video are written, those of a folder stay where they are."""

    def __init__(self, source: Source, out: Path, options: RunOptions) -> None:
        self._source, self._options = source, options
        self.folder = out / "images" if source.kind is SourceKind.VIDEO else source.path

    def keep(self, picture: Picture) -> None:
        """Write a keyframe."""
        if self._source.kind is SourceKind.VIDEO and self._options.keep_images and picture.color is not None:
            self._write(picture.name, picture.color)

    def complete(self, measured: Measured) -> None:
        """Write keyframes that an earlier run measured without writing them, or that were taken away since."""
        if self._source.kind is not SourceKind.VIDEO or not self._options.keep_images or measured.frame_index is None:
            return
        names = measured.database.image_names
        absent = [k for k, name in enumerate(names) if not (self.folder / name).exists()]
        frames = read_frames(self._source.path, measured.frame_index[absent].tolist(), 2, color=True)
        for k, frame in zip(absent, frames, strict=True):
            if frame.color is not None:
                self._write(names[k], frame.color)

    def _write(self, name: str, color: npt.NDArray[np.uint8]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        write_bytes(self.folder / name, encoded(color, ".jpg", self._options.jpeg_quality))

    def written(self, measured: Measured, out: Path) -> set[str]:
        """Files of the keyframes, path from ``out``."""
        if self._source.kind is not SourceKind.VIDEO or not self._options.keep_images:
            return set()
        return {(self.folder / name).relative_to(out).as_posix() for name in measured.database.image_names}

    def files(self, scene: Scene) -> list[Path | None]:
        """Panorama of each view, None where there is none."""
        is_kept = self._source.kind is not SourceKind.VIDEO or self._options.keep_images
        if not (self._source.is_panoramic and is_kept):
            return [None] * len(scene.centers)
        paths = [self.folder / name for name in scene.view_labels()]
        return [path if path.exists() else None for path in paths]


class Masks:
    """What of the pictures counts: what the user gave, without what is fixed to the camera. White counts."""

    def __init__(self, measured: Measured, options: RunOptions) -> None:
        source = measured.source
        self._measured, self._camera = measured, source.cameras[0]
        names = measured.database.image_names
        images = list(source.images) if source.images else [Path(name) for name in names]
        self._given = masks_of(options.masks, images)
        self._is_one = options.masks is None or options.masks.is_file()
        self._fixed = measured.fixed[0] if source.is_panoramic and measured.fixed else None

    @property
    def is_any(self) -> bool:
        """Whether anything is masked."""
        return any(self._given) or (self._fixed is not None and self._fixed.share > 0.0)

    def of(self, view: int) -> npt.NDArray[np.uint8] | None:
        """(height, width) mask of a view."""
        width, height = self._camera.width, self._camera.height
        counts = np.ones((height, width), dtype=np.bool_)
        if self._fixed is not None:
            counts &= ~self._fixed.mask(width, height)
        given = self._given[view]
        if given is not None:
            mask = read_mask(given)
            rows = np.arange(height) * mask.shape[0] // height
            columns = np.arange(width) * mask.shape[1] // width
            counts &= mask[rows[:, None], columns]
        return np.where(counts, 255, 0).astype(np.uint8)

    def write(self, out: Path) -> list[str | None]:
        """Write them; gives the file of each view, path from ``out``."""
        names = self._measured.database.image_names
        if self._is_one:
            mask = self.of(0)
            if mask is not None:
                write_bytes(out / "mask.png", encoded(mask, ".png"))
            return ["mask.png"] * len(names)
        files: list[str | None] = []
        for view, name in enumerate(names):
            mask, file = self.of(view), f"masks/{name}.png"
            if mask is not None:
                (out / file).parent.mkdir(parents=True, exist_ok=True)
                write_bytes(out / file, encoded(mask, ".png"))
            files.append(file)
        return files


@dataclass(frozen=True, eq=False)
class Answer:
    """All that is written down."""

    source: Source
    measured: Measured
    #: (N, 3) image, feature and point of the observations in use.
    observations: npt.NDArray[np.int64]
    placed: Placed
    certificate: Certificate | None
    statements: tuple[str, ...]
    seconds: Mapping[str, float]
    options: RunOptions


def write_outputs(
    answer: Answer, out: Path, keeper: ImageKeeper, report: Callable[[str, int, int], None]
) -> dict[str, str]:
    """Write everything; gives the files, path from ``out``, with what they are.

    Raises
    ------
    InputError
        Where something cannot be written.
    """
    scene, source = answer.placed.scene, answer.source
    before = _made_before(out)
    keeper.complete(answer.measured)
    colours = point_colours(answer.measured, answer.observations, len(scene.points))
    camera = source.cameras[0]

    def own_cameras(staged: Path) -> None:
        """Put models with the cameras of the pictures in the place of panoramic ones."""
        shutil.rmtree(staged / "colmap", ignore_errors=True)
        write_models(answer.measured.database, _reconstruction(answer, scene), staged / "colmap", colours=colours)

    write_scene(
        scene,
        out,
        overwrite=True,
        extra=None if source.is_panoramic else own_cameras,
        certificate=answer.certificate,
        colours=colours,
        panorama_width_px=camera.width,
    )
    files = {
        "scene.json": "scene and certificate",
        "cameras.csv": "positions and orientations",
        "points.csv": "points",
        "trajectory.tum": "the path, TUM format",
        "scene.ply": "points and path",
        "colmap/0/images.bin": "COLMAP model",
    }
    pictures = keeper.files(scene)
    masks = Masks(answer.measured, answer.options)
    mask_files = masks.write(out) if source.is_panoramic and masks.is_any else None
    if mask_files is not None:
        files[mask_files[0] or "mask.png"] = "masks: what is white was measured"
    if any(pictures):
        relative = [None if path is None else Path(os.path.relpath(path, out)).as_posix() for path in pictures]
        write_nerfstudio(scene, relative, out, (camera.width, camera.height), colours=colours, masks=mask_files)
        files |= {"transforms.json": "nerfstudio, panoramas", "points.ply": "its points"}
    files |= _write_path(scene, answer.placed.georeference, out)
    if answer.options.crops is not None and any(pictures):
        report("cutting crops", 0, len(pictures))
        _remove(out, before & {_CROPS})
        done = write_crops(
            scene,
            pictures,
            out / _CROPS,
            answer.options.crops,
            masks=None if mask_files is None else masks.of,
            report=lambda k, n: report("cutting crops", k, n),
        )
        files["crops/transforms.json"] = f"{done.n_images} pinhole crops with COLMAP model and transforms.json"
    made = set(files) | {file for file in mask_files or () if file is not None} | keeper.written(answer.measured, out)
    made |= {_CROPS} if "crops/transforms.json" in files else set()
    _remove(out, before - made)
    _write_run(answer, keeper, out, sorted(made))
    notes = ReportNotes(
        title=source.path.name,
        subtitle=source.description,
        unit=answer.placed.unit,
        is_upright=answer.placed.is_upright,
        statements=answer.statements,
        seconds=dict(answer.seconds),
        outputs=files,
    )
    settings = plain_settings(answer.options)
    write_report(scene, answer.certificate, out / "report.html", pictures, settings, notes=notes, colours=colours)
    return {"report.html": "the report", **files}


def _write_path(scene: Scene, earth: Georeference | None, out: Path) -> dict[str, str]:
    """Write the path for maps, of the parts that stand on the earth."""
    if earth is None:
        return {}
    standing = [fit.component for fit in earth.fits if fit.status.is_fitted]
    on_earth = dataclasses.replace(
        scene, centers=np.where(np.isin(scene.view_component, standing)[:, None], scene.centers, np.nan)
    )
    path = GeoPath.of_scene(on_earth, earth.frame)
    write_geojson(path, out / "path.geojson")
    write_gpx(path, out / "path.gpx")
    return {"path.geojson": "the path for maps", "path.gpx": "the path for navigation devices"}


def point_colours(measured: Measured, observations: npt.NDArray[np.int64], n_points: int) -> npt.NDArray[np.uint8]:
    """(n_points, 3) means of the colours of each point's features; grey where none has any."""
    starts = measured.database.feature_starts
    known = [np.full((len(f), 3), _GREY, dtype=np.uint8) if f.color is None else f.color for f in measured.features]
    every = np.concatenate([np.empty((0, 3), dtype=np.uint8), *known])
    image, feature, point = observations.T
    seen = every[starts[image] + feature].astype(np.float64)
    count = np.bincount(point, minlength=n_points)
    total = np.stack([np.bincount(point, weights=seen[:, c], minlength=n_points) for c in range(3)], axis=1)
    mean = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], _GREY)
    return np.asarray(mean.round(), dtype=np.uint8)


def _reconstruction(answer: Answer, scene: Scene) -> Reconstruction:
    database = answer.measured.database
    rotation, centers = database.image_poses(scene.cam_from_world, scene.centers)
    component = scene.view_component[database.image_frame]
    return Reconstruction.from_arrays(
        database, rotation, centers, scene.points, answer.observations, component=component
    )


def plain_settings(options: RunOptions) -> dict[str, Any]:
    """Choices as plain values, for people and JSON."""
    return {entry.name: _plain(getattr(options, entry.name)) for entry in dataclasses.fields(options)}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {entry.name: _plain(getattr(value, entry.name)) for entry in dataclasses.fields(value)}
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value if isinstance(value, bool | int | float | str | None) else str(value)


def _made_before(out: Path) -> set[str]:
    """Give what an earlier run wrote here, path from ``out``."""
    try:
        made = json.loads((out / _RUN).read_text(encoding="utf-8"))["made"]
    except (OSError, ValueError, TypeError, KeyError):
        return set()
    return {name for name in made if isinstance(name, str)} if isinstance(made, list) else set()


def _remove(out: Path, names: set[str]) -> None:
    """Take away what an earlier run wrote and this one does not, so that all that is there belongs together."""
    for name in sorted(names):
        stale = out / name
        if not stale.parent.resolve().is_relative_to(out.resolve()):
            continue
        if name == _CROPS:
            shutil.rmtree(stale, ignore_errors=True)
            continue
        with contextlib.suppress(OSError):
            stale.unlink(missing_ok=True)
            if stale.parent != out:
                stale.parent.rmdir()


def _write_run(answer: Answer, keeper: ImageKeeper, out: Path, made: list[str]) -> None:
    """Write what other programs, and `panopath view`, want to know of the run."""
    content = {
        "panopath": _core.__version__,
        "source": answer.source.description,
        "kind": answer.source.kind.value,
        "images": Path(os.path.relpath(keeper.folder, out)).as_posix(),
        "unit": answer.placed.unit,
        "is_upright": answer.placed.is_upright,
        "statements": list(answer.statements),
        "seconds": {name: round(value, 3) for name, value in answer.seconds.items()},
        "settings": plain_settings(answer.options),
        "made": made,
    }
    write_bytes(out / _RUN, (json.dumps(content, indent=1) + "\n").encode())
