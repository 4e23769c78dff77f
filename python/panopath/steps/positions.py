"""Camera positions and points from bearings of known orientation, and the covariance they allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.bodies import grouped
from panopath.errors import InputError
from panopath.model import Control, Float, Int, PositionOptions, Scene, Status, Summary, Tracks, read_only
from panopath.movers import at_rest, resting
from panopath.paths import Motion, PathModel, Paths, PathVerdict, Static, core_model, model_of
from panopath.steps.common import call_core, observations_of, orientations_of
from panopath.steps.freedoms import certify_paths

Start = tuple[npt.ArrayLike, npt.ArrayLike]

_KINDS = ("static", "taylor", "fourier", "spline")
_ASSUMPTIONS = {
    "known_static": "{} {} known to be at rest",
    "most_static": "most tracks are at rest",
    "least_motion": "everything moves together as little as it can",
}


def solve_positions(
    tracks: Tracks,
    cam_from_world: npt.ArrayLike | None = None,
    options: PositionOptions | None = None,
    start: Scene | Start | None = None,
    motion: Motion | None = None,
) -> Scene:
    """Camera positions and points from bearings of known orientation, d = 2 or 3.

    Parameters
    ----------
    tracks
        The observations.
    cam_from_world
        (n_views, 3, 3) rotations, or (n_views,) headings in radians for d = 2. None: bearings are world directions.
    options
        Choices; default ``PositionOptions()``.
    start
        A scene, or ``(centers, points)`` of shapes (n_views, d) and (n_tracks, d), to refine instead of starting
        from nothing; NaN rows are found anew.
    motion
        How tracks may move (``docs/moving.md``); ``tracks.time_s`` is needed then. None: everything is at rest.

    Returns
    -------
    Scene
        In the gauge of ``options.gauge``; ``scene.summary.status`` says how it ended. With ``motion``, ``scene.paths``
        has the path of each track.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    chosen = PositionOptions() if options is None else options
    if not isinstance(tracks, Tracks):
        raise InputError(f"tracks is a {type(tracks).__name__}, expected Tracks (see Tracks.from_arrays)")
    if not isinstance(chosen, PositionOptions):
        raise InputError(f"options is a {type(chosen).__name__}, expected PositionOptions")
    orientations = orientations_of(tracks, cam_from_world)
    if motion is not None:
        return solve_moving(tracks, orientations, chosen, None if start is None else _start(start, tracks), motion)
    found = call_core(
        _core.solve_positions,
        observations_of(tracks),
        orientations,
        _core_options(chosen, tracks),
        None if start is None else _start(start, tracks),
    )
    return scene_of(found, tracks)


def solve_moving(
    tracks: Tracks,
    orientations: Float | None,
    options: PositionOptions,
    start: tuple[Float, Float] | None,
    motion: Motion,
) -> Scene:
    """Cameras, points at rest and paths; :func:`solve_positions` describes the arguments."""
    if not isinstance(motion, Motion):
        raise InputError(f"motion is a {type(motion).__name__}, expected a Motion")
    if tracks.time_s is None:
        raise InputError("tracks.time_s is None, expected the time of every view where tracks may move")
    models, model = forms_of(motion, tracks)
    found = call_core(
        _core.solve_paths,
        observations_of(tracks),
        np.ascontiguousarray(tracks.time_s),
        orientations,
        (
            [core_model(one) for one in models],
            model,
            [core_model(one) for one in motion.candidates],
            motion.common_omega,
            motion.refine_orientations,
            motion.covariance,
        ),
        _core_options(options, tracks),
        start,
    )
    scene = replace(scene_of(found, tracks), paths=paths_of(found["paths"], tracks))
    if motion.group:
        scene = replace(scene, paths=grouped(scene))
    if not found["paths"]["resolved"] or scene.paths is None:
        return scene
    # so little is at rest that everything may share a motion: said whatever was assumed
    words = certify_paths(tracks, scene).words(tracks.view_labels(), tracks.track_labels())
    return replace(scene, paths=replace(scene.paths, freedoms=words))


def forms_of(motion: Motion, tracks: Tracks) -> tuple[list[PathModel], Int]:
    """List the forms of path that are named, and which of them each track has: -1 where it is to be found."""
    named: list[PathModel | Literal["auto"]] = [motion.default]
    model = np.zeros(tracks.n_tracks, dtype=np.int32)
    if motion.tracks:
        model[resolve("motion", "track", motion.tracks, tracks.track_names, tracks.n_tracks)] = np.arange(
            1, len(motion.tracks) + 1
        )
        named += motion.tracks.values()
    if motion.static:
        at_rest = dict.fromkeys(motion.static)
        model[resolve("motion", "track", at_rest, tracks.track_names, tracks.n_tracks)] = len(named)
        named.append(Static())
    forms: list[PathModel] = []
    index = np.full(len(named), -1, dtype=np.int32)
    for k, one in enumerate(named):
        if one != "auto":
            index[k] = len(forms)
            forms.append(one)
    return forms, np.ascontiguousarray(index[model])


def paths_of(found: Mapping[str, Any], tracks: Tracks) -> Paths:
    """Make the record of what the core found."""
    numbers, ends = found["numbers"].tolist(), found["number_starts"].tolist()
    rest = Static()
    kinds = zip(found["kind"].tolist(), found["order"].tolist(), ends[:-1], ends[1:], strict=True)
    models = tuple(
        rest if kind == 0 else model_of(_KINDS[kind], order, numbers[begin:end]) for kind, order, begin, end in kinds
    )
    starts, d = found["starts"], tracks.d
    covariances = None
    if len(found["covariance_sizes"]):
        blocks = np.split(found["covariances"], np.cumsum(found["covariance_sizes"])[:-1])
        sizes = (np.diff(starts) * d).tolist()
        covariances = tuple(
            read_only(block.reshape(n, n) if len(block) else np.full((n, n), np.nan))
            for n, block in zip(sizes, blocks, strict=True)
        )
    kind, known = found["assumption"]
    verdict = {one.value: one for one in PathVerdict}
    return Paths(
        models=models,
        starts=starts,
        coefficients=found["coefficients"],
        covariances=covariances,
        seen_s=found["seen_s"],
        verdicts=tuple(verdict[one] for one in found["verdicts"]),
        hidden_by=found["hidden_by"],
        body=np.full(len(models), -1, dtype=np.int32),
        assumption=_ASSUMPTIONS[kind].format(known, "track is" if known == 1 else "tracks are"),
    )


def position_covariance(
    tracks: Tracks,
    scene: Scene | Start,
    cam_from_world: npt.ArrayLike | None = None,
    inlier: npt.ArrayLike | None = None,
) -> Float:
    """Covariance of the camera centres at a given scene: the Cramer-Rao bound where that scene is the truth.

    Parameters
    ----------
    tracks
        The observations, with their ``sigma_rad``; without, a standard deviation of one radian is meant.
    scene
        A scene, or ``(centers, points)`` of shapes (n_views, d) and (n_tracks, d). Of a scene with ``paths`` the
        tracks at rest alone count.
    cam_from_world
        As in :func:`solve_positions`.
    inlier
        (N,) bool, the observations that count; default: those of the scene that is given, or all.

    Returns
    -------
    array
        (n_views, d, d), in the units of the scene squared, after alignment of all centres by shift and scale. NaN
        for views that are not determined.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    centers, points = _start(at_rest(scene) if isinstance(scene, Scene) else scene, tracks)
    mask = inlier
    if mask is None and isinstance(scene, Scene) and scene.inlier.shape == tracks.view.shape:
        mask = scene.inlier
    if mask is not None:
        mask = np.ascontiguousarray(mask)
        if mask.dtype != np.bool_ or mask.shape != tracks.view.shape:
            raise InputError(f"inlier has type {mask.dtype} and shape {mask.shape}, expected bool {tracks.view.shape}")
    if isinstance(scene, Scene) and scene.paths is not None:
        still = resting(scene)[tracks.track]
        mask = still if mask is None else mask & still
    covariance = call_core(
        _core.position_covariance,
        observations_of(tracks),
        orientations_of(tracks, cam_from_world),
        centers,
        points,
        mask,
    )
    return np.asarray(covariance, dtype=np.float64)


def _start(start: Scene | Start, tracks: Tracks) -> tuple[Float, Float]:
    """Both arrays of a start, of the shapes that the tracks ask for; NaN rows pass."""
    if isinstance(start, Scene):
        given: Sequence[npt.ArrayLike] = (start.centers, start.points)
    else:
        given = tuple(start)
    if len(given) != 2:
        raise InputError(f"start has {len(given)} entries, expected a Scene or (centers, points)")
    checked = []
    for name, values, count in (("centers", given[0], tracks.n_views), ("points", given[1], tracks.n_tracks)):
        array = np.ascontiguousarray(values, dtype=np.float64)
        if array.shape != (count, tracks.d):
            raise InputError(f"{name} has shape {array.shape}, expected {(count, tracks.d)}")
        if np.isinf(array).any():
            raise InputError(f"{name} holds an infinite coordinate, expected finite ones, or NaN where unknown")
        checked.append(array)
    return checked[0], checked[1]


def _core_options(options: PositionOptions, tracks: Tracks) -> dict[str, Any]:
    plain = {name: value for name, value in options.__dict__.items() if name != "control"}
    views, view_positions, points, point_positions = control_rows(options.control, tracks)
    plain["control_views"] = views
    plain["control_view_positions"] = view_positions
    plain["control_tracks"] = points
    plain["control_track_positions"] = point_positions
    plain["control_rotation"] = options.control is not None and options.control.rotation
    return plain


def control_rows(control: Control | None, tracks: Tracks) -> tuple[Int, Float, Int, Float]:
    """Look up views and tracks: their indices and known positions."""
    if control is None:
        none, nowhere = np.empty(0, dtype=np.int32), np.empty((0, tracks.d))
        return none, nowhere, none, nowhere
    if control.d != tracks.d:
        raise InputError(f"control has positions of {control.d} coordinates, but the bearings have {tracks.d}")
    views = resolve("control", "view", control.views, tracks.view_names, tracks.n_views)
    points = resolve("control", "track", control.points, tracks.track_names, tracks.n_tracks)
    return views, _rows(control.views, tracks.d), points, _rows(control.points, tracks.d)


def _rows(table: Mapping[str | int, Sequence[float]], d: int) -> Float:
    return np.array(list(table.values()), dtype=np.float64).reshape(len(table), d)


def resolve(argument: str, kind: str, table: Mapping[str | int, Any], names: tuple[str, ...] | None, count: int) -> Int:
    """Look keys up: a name where the tracks have names, else the index as text; an ``int`` is an index."""
    index_of = {} if names is None else {name: index for index, name in enumerate(names)}
    indices = []
    for key in table:
        index = key if isinstance(key, int) else index_of.get(key)
        if index is None and names is None and isinstance(key, str) and key.isdecimal():
            index = int(key)
        if index is None or not 0 <= index < count:
            raise InputError(f"{argument} names the {kind} {key!r}, which is not among the {count} {kind}s")
        indices.append(index)
    if len(set(indices)) != len(indices):
        raise InputError(f"{argument} names a {kind} twice, expected each {kind} once")
    return np.array(indices, dtype=np.int32)


def scene_of(found: Mapping[str, Any], tracks: Tracks) -> Scene:
    """Make a scene of what the core found."""
    view_component = np.asarray(found["view_component"], dtype=np.int32)
    track_component = np.asarray(found["track_component"], dtype=np.int32)
    inlier = np.asarray(found["inlier"], dtype=np.bool_)
    summary = Summary(
        status=Status(found["status"]),
        iterations=int(found["iterations"]),
        sigma_rad=float(found["sigma_rad"]),
        seconds=MappingProxyType({str(stage): float(time) for stage, time in found["seconds"].items()}),
        n_views=tracks.n_views,
        n_tracks=tracks.n_tracks,
        n_observations=len(tracks),
        n_inliers=int(inlier.sum()),
        n_solved_views=int((view_component >= 0).sum()),
        n_solved_points=int((track_component >= 0).sum()),
        n_components=int(found["n_components"]),
    )
    return Scene(
        centers=read_only(found["centers"]),
        points=read_only(found["points"]),
        view_component=view_component,
        track_component=track_component,
        inlier=inlier,
        residual_rad=found["residual_rad"],
        cam_from_world=found["cam_from_world"],
        summary=summary,
        tracks=tracks,
        view_names=tracks.view_names,
        track_names=tracks.track_names,
    )
