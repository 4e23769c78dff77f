"""The job: recognise, measure, map, certify, place, write.

    source -> pictures -> features -> matches -> orientations -> positions -> refinement -> certificate -> OUT

Each stage leaves a checkpoint in ``OUT/.work``; a run that was stopped goes on there, one on other input begins again.
"""

from __future__ import annotations

import errno
import re
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np

from panopath.certificate import Certificate
from panopath.checkpoints import Checkpoints
from panopath.errors import InputError, UndeterminedError
from panopath.formats.folder import is_scene_folder
from panopath.frontend import Measured, Source, SourceKind, check_masks, measure, recognise, why_not_whole
from panopath.frontend.images import positions_of
from panopath.frontend.stored import Store
from panopath.model import Float, Scene
from panopath.run.mapped import Mapped, mapped
from panopath.run.options import RunOptions
from panopath.run.outputs import Answer, ImageKeeper, write_outputs
from panopath.run.place import Placed, gravity_of, picture_named, place_on_earth, with_times
from panopath.steps import certify

Report = Callable[[str, int, int], None]

_WORK = ".work"
#: What a disk without room says, or one with a quota.
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
#: A video that has so much fewer frames than it announces has lost some.
_LOST_SHARE = 0.02


@dataclass(frozen=True, eq=False)
class Reconstructed:
    """What became of a source."""

    folder: Path
    #: What the source was recognised as.
    description: str
    scene: Scene
    #: None of rigs whose cameras stand apart.
    certificate: Certificate | None
    #: ``m``, or empty where the scale is arbitrary.
    unit: str
    #: Where up and scale come from, what was masked and left out.
    statements: tuple[str, ...]
    #: Number of pictures that were measured, and of the frames that a video has (of a folder the same).
    n_pictures: int
    n_frames: int
    #: Seconds of each stage, and files written, path from the folder, with what they are.
    seconds: dict[str, float]
    files: dict[str, str]

    @property
    def is_determined(self) -> bool:
        """Whether the scene can be believed: solved, determined, and not at odds with its bearings."""
        sound = self.scene.summary.status.is_determined
        return sound and (self.certificate is None or self.certificate.is_determined)


def reconstruct(
    source: str | PathLike[str],
    out: str | PathLike[str],
    options: RunOptions | None = None,
    *,
    report: Report | None = None,
    force: bool = False,
    overwrite: bool = False,
) -> Reconstructed:
    """Camera path, points and certificate from a 360 video or a folder of pictures, written for other programs.

    Parameters
    ----------
    source
        See :func:`panopath.frontend.recognise`.
    out
        Folder for the answers; made where it is absent. See ``docs/outputs.md`` for what is in it.
    options
        Choices; default ``RunOptions()``.
    report
        Called with a stage, how many of its steps are done and how many there are (0: not known).
    force
        Do everything again, whatever an earlier run has left.
    overwrite
        Write into a folder that holds other files than panopath's; they stay.

    Returns
    -------
    Reconstructed
        Whether it can be believed is ``is_determined``: a model that is not is written too, with the reasons.

    Raises
    ------
    InputError
        Where the source cannot be used, or ``out`` cannot be written. What was done stays, as after any interruption.
    UndeterminedError
        Where nothing can be found in the source: it says why.
    MissingExtraError
        Where what reads pictures or video is not installed.
    """
    chosen, folder = RunOptions() if options is None else options, Path(out)
    say = report or (lambda _stage, _done, _of: None)
    seconds: dict[str, float] = {}
    with _timed(seconds, "all"), _one_line(folder):
        recognised = recognise(source, rig=chosen.rig)
        check_folder(folder, overwrite)
        check_masks(recognised, chosen.masks)
        if recognised.kind in {SourceKind.PANORAMAS, SourceKind.PERSPECTIVE}:
            _check_baseline(recognised.names, chosen)
        if Checkpoints.is_at(folder / _WORK):
            _sweep(folder)
        store = Checkpoints(folder / _WORK)
        if force:
            store.clear()
        keeper = ImageKeeper(recognised, folder, chosen)
        with _explained(recognised):
            measured = measure(
                recognised, chosen.front_end, masks=chosen.masks, store=store, report=say, each=keeper.keep, color=True
            )
        seconds |= measured.seconds
        if recognised.kind is SourceKind.VIDEO:
            _check_baseline(measured.database.image_names, chosen)
        with _timed(seconds, "mapping"):
            say("mapping", 0, 0)
            found = mapped(measured, chosen, Store(store, measured.key))
        with _explained(recognised):
            _check_found(recognised, found.scene)
        with _timed(seconds, "certificate"):
            say("certificate", 0, 0)
            certificate = _certified(recognised, found.scene, chosen)
        with _timed(seconds, "writing"):
            say("writing", 0, 0)
            placed = _placed(measured, found, chosen)
            statements = (*_statements(measured, found), *placed.statements, *_doubts(recognised, found, certificate))
            answer = Answer(
                recognised, measured, found.observations, placed, certificate, statements, dict(seconds), chosen
            )
            files = write_outputs(answer, folder, keeper, say)
    return Reconstructed(
        folder,
        recognised.description,
        placed.scene,
        certificate,
        placed.unit,
        statements,
        len(measured.time_s),
        len(measured.time_s) if measured.motion is None else len(measured.motion),
        seconds,
        files,
    )


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    begin = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - begin


@contextmanager
def _one_line(folder: Path) -> Iterator[None]:
    """Turn what the disk refuses into one line that says what to do."""
    try:
        yield
    except InputError as error:
        # a writer has said which file it was
        cause = error.__context__
        if isinstance(cause, OSError) and cause.errno in _FULL:
            raise InputError(f"{error}; make room and give the same command again: it goes on from here") from None
        raise
    except OSError as error:
        place = error.filename or folder
        raise InputError(f"{place}: cannot be read or written ({error.strerror or error})") from None


@contextmanager
def _explained(source: Source) -> Iterator[None]:
    """Where nothing is found, say it if the pictures do not look like what they were taken for."""
    try:
        yield
    except UndeterminedError as error:
        why = why_not_whole(source)
        if why:
            raise UndeterminedError(f"{error}; {why}") from None
        raise


def _doubts(source: Source, found: Mapped, certificate: Certificate | None) -> tuple[str, ...]:
    """Say the same of a scene that cannot be believed."""
    sound = found.scene.summary.status.is_determined and (certificate is None or certificate.is_determined)
    why = "" if sound else why_not_whole(source)
    return (why,) if why else ()


def _sweep(folder: Path) -> None:
    """Take away what a run was writing just when it was killed."""
    for path in folder.rglob(".*.part"):
        path.unlink(missing_ok=True)
    for path in folder.iterdir():
        if re.fullmatch(rf"\.{re.escape(folder.name)}\.\w{{8}}", path.name) and path.is_dir():
            shutil.rmtree(path, ignore_errors=True)


def _check_baseline(names: Sequence[str], options: RunOptions) -> None:
    for name in () if options.baseline is None else options.baseline[:2]:
        picture_named(names, name)


def check_folder(folder: Path, overwrite: bool) -> None:
    """Say now, before long work, whether :func:`reconstruct` would refuse to write here.

    Raises
    ------
    InputError
        Where it would.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file, expected a folder to write to")
    known = overwrite or is_scene_folder(folder) or Checkpoints.is_at(folder / _WORK)
    if folder.is_dir() and any(folder.iterdir()) and not known:
        raise InputError(f"{folder}: holds files that are not panopath's; name another folder or ask for overwriting")


def _check_found(source: Source, scene: Scene) -> None:
    if not scene.summary.n_solved_views:
        raise UndeterminedError(
            f"{source.path}: no two pictures could be placed, since what they share shows no parallax; expected a "
            "camera that moves among things not far away"
        )


def _certified(source: Source, scene: Scene, options: RunOptions) -> Certificate | None:
    """Certify the scene; rays of a rig start beside its centre, of which the certificate knows nothing."""
    if scene.tracks is None or _has_levers(source):
        return None
    # what the features turned out to be worth says more than what they were taken to be worth
    sigma = options.certify.sigma_rad or scene.summary.sigma_rad
    known = sigma if np.isfinite(sigma) and sigma > 0.0 else None
    return certify(scene.tracks, scene, replace(options.certify, sigma_rad=known))


def _has_levers(source: Source) -> bool:
    return source.kind is SourceKind.RIG and bool(np.any(source.center_in_rig))


def _placed(measured: Measured, found: Mapped, options: RunOptions) -> Placed:
    source, database = measured.source, measured.database
    # a frame is where its first image is
    first = np.unique(database.image_frame, return_index=True)[1]
    scene = with_times(found.scene, measured.time_s[first])
    gravity: Float | None = None
    if options.horizon_locked:
        gravity = np.tile([0.0, -1.0, 0.0], (len(scene.centers), 1))
    elif source.kind is SourceKind.PANORAMAS:
        gravity = gravity_of([source.headers[k] for k in first.tolist()])
    position = None
    if options.use_gps and source.headers:
        position = positions_of([source.headers[k] for k in first.tolist()])
    try:
        return place_on_earth(
            scene,
            None if gravity is None or not np.isfinite(gravity).any() else gravity,
            position,
            options.camera_height_m,
            options.baseline,
            _has_levers(source),
        )
    except InputError as error:
        raise InputError(f"{error}; all else is done and kept: another scale, or none, is quick") from None


def _statements(measured: Measured, found: Mapped) -> tuple[str, ...]:
    """Say what was measured and left out."""
    scene, said = found.scene, []
    n_views, n_solved = len(scene.centers), scene.summary.n_solved_views
    if measured.motion is not None:
        said.append(f"{n_views} keyframes of {len(measured.motion)} frames, {n_solved} placed")
        if measured.motion.n_corrupt:
            said.append(f"{measured.motion.n_corrupt} frames could not be decoded and were passed over")
        announced = 0 if measured.source.video is None else measured.source.video.n_frames
        lost = announced - len(measured.motion) - measured.motion.n_corrupt
        if lost > max(1.0, _LOST_SHARE * announced):
            said.append(f"the file announces {announced} frames, {lost} of them are absent: it is damaged or cut short")
        if measured.motion.lost.any():
            said.append(f"the view changed at once {int(measured.motion.lost.sum())} times, as at a cut")
    else:
        said.append(f"{n_solved} of {n_views} {'moments' if measured.database.has_rigs else 'pictures'} placed")
    if found.is_locked:
        said.append("the camera keeps its direction, so that positions were solved at once")
    for content in measured.fixed:
        if content.share > 0.0:
            said.append(f"{100.0 * content.share:.1f} % of the sphere goes with the camera and was left out")
        elif content.refused_share > 0.0:
            said.append(
                f"{100.0 * content.refused_share:.0f} % of the sphere seems to go with the camera: more than is "
                "believed, so nothing was masked"
            )
    if measured.empty:
        names = ", ".join(measured.empty[:5]) + (" ..." if len(measured.empty) > 5 else "")
        said.append(f"{len(measured.empty)} pictures show nothing to measure: {names}")
    summary = scene.summary
    if summary.n_observations:
        left_out = 100.0 * (1.0 - summary.n_inliers / summary.n_observations)
        said.append(f"{left_out:.1f} % of the observations agree with no point at rest and were left out")
    return tuple(said)
