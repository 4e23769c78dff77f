"""Bundle adjustment on the sphere: orientations, centres and points together."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.model import Bool, Float, LinearSolver, Scene, Tracks, read_only
from panopath.priors import Priors, Rig, RotationPriors
from panopath.steps.common import call_core, resting_observations
from panopath.steps.positions import scene_of


@dataclass(frozen=True, eq=False)
class RefineOptions:
    """Choices of :func:`panopath.refine`; the defaults are meant to be right."""

    #: Hold all orientations (True), or those of a (n_views,) mask.
    hold_rotations: bool | npt.ArrayLike = False
    #: Hold all centres, or those of a (n_views,) mask.
    hold_centers: bool | npt.ArrayLike = False
    #: Hold all points, or those of a (n_tracks,) mask.
    hold_points: bool | npt.ArrayLike = False
    #: What is known beforehand, with its accuracy.
    priors: Priors = field(default_factory=Priors)
    #: Huber's threshold in standard deviations; infinite for plain least squares.
    huber_sigmas: float = 3.0
    #: Judge anew, between rounds, which observations agree, and look again at points that lost theirs.
    reject_outliers: bool = True
    #: Most Gauss-Newton steps of one round.
    max_iterations: int = 50
    #: How the reduced camera system is solved; ``auto`` chooses by predicted cost.
    linear_solver: LinearSolver = "auto"
    #: Threads to use; None: all cores. The answer does not depend on it.
    threads: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.priors, Priors):
            raise InputError(f"priors is a {type(self.priors).__name__}, expected Priors")
        if not self.huber_sigmas > 0.0:
            raise InputError(f"huber_sigmas is {self.huber_sigmas}, expected more than 0")
        if self.linear_solver not in get_args(LinearSolver):
            allowed = ", ".join(get_args(LinearSolver))
            raise InputError(f"linear_solver is {self.linear_solver!r}, expected one of {allowed}")
        for name in ("max_iterations", "threads"):
            value = getattr(self, name)
            if value is not None and (not isinstance(value, int) or value < 1):
                raise InputError(f"{name} is {value!r}, expected a whole number of at least 1")


def refine(tracks: Tracks, scene: Scene, options: RefineOptions | None = None, rig: Rig | None = None) -> Scene:
    """Refine orientations, centres and points together, from a scene that is about right; d = 2 or 3.

    Minimises the robust sum of squared angles between bearings and predictions, in standard deviations, together with
    those of the priors. Each component of the scene is refined by itself. Without priors and with nothing held, a
    component keeps its mean orientation, its centroid and its size.

    Parameters
    ----------
    tracks
        The observations, bearings in the cameras (with a rig: in the frames of the views, see ``Rig.to_view``).
    scene
        Where to start. Views without a position are left out; points without one are intersected anew. With ``paths``
        only tracks at rest take part.
    options
        Choices; default ``RefineOptions()``.
    rig
        Where bearings start from, for views with several sensors; default: at the centre of the view.

    Returns
    -------
    Scene
        ``scene.summary.status`` says how it ended. It has no ``paths``, and no points of what moves: cameras that
        turned would leave them behind. ``Motion(refine_orientations=True)`` of :func:`panopath.solve_positions` refines
        them too.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    chosen = RefineOptions() if options is None else options
    if not isinstance(tracks, Tracks):
        raise InputError(f"tracks is a {type(tracks).__name__}, expected Tracks (see Tracks.from_arrays)")
    if not isinstance(chosen, RefineOptions):
        raise InputError(f"options is a {type(chosen).__name__}, expected RefineOptions")
    check_scene(scene, tracks)
    still, observations, rows = resting_observations(tracks, scene)
    found = call_core(
        _core.refine,
        observations,
        scene.cam_from_world,
        (still.centers, still.points, still.view_component, still.track_component),
        _core_options(chosen, tracks, rig, scene.cam_from_world, rows),
    )
    return scene_of(found if scene.paths is None else _spread(found, rows, len(tracks)), tracks)


def _spread(found: dict[str, Any], rows: slice | Bool, n: int) -> dict[str, Any]:
    """Answers for all observations, where some took no part: these are not in use, and miss by nobody knows what."""
    inlier, residual = np.zeros(n, dtype=np.bool_), np.full(n, np.nan)
    inlier[rows], residual[rows] = found["inlier"], found["residual_rad"]
    return {**found, "inlier": inlier, "residual_rad": residual}


@dataclass(frozen=True, eq=False)
class SceneCovariance:
    """Covariances of a scene; NaN where nothing is determined."""

    #: (n_views, 6, 6): the turn in the camera, on the left (rad), and the centre in the world. (n_views, 3, 3) for
    #: d = 2.
    cameras: Float
    #: (n_tracks, d, d).
    points: Float


def scene_covariance(  # noqa: PLR0917 (the public names and their order are fixed)
    tracks: Tracks,
    scene: Scene,
    options: RefineOptions | None = None,
    rig: Rig | None = None,
    relative_to: int | None = None,
    sigma_rad: float | None = None,
) -> SceneCovariance:
    """Covariances of all cameras and points, orientations unknown: what the noise leaves undetermined, to first order.

    Parameters
    ----------
    tracks
        The observations, as for :func:`refine`. Their ``sigma_rad`` are standard deviations where they are given.
    scene
        What :func:`refine` found; its inliers count, with ``paths`` those of tracks at rest.
    options, rig
        Those of the refinement: priors and what was held fix what bearings leave free.
    relative_to
        A view (index): errors are meant after this view's pose, and the rms distance of the centres from it, are
        brought to the truth. None: after a fit by similarity over all centres of a component (over the orientations
        too, where the centres lie on a line).
    sigma_rad
        Standard deviation of a bearing along each tangent direction, radians, for tracks without; default: what the
        scene's summary estimates.

    Returns
    -------
    SceneCovariance
        Exact to first order: blocks of the inverse of the Fisher information.

    Raises
    ------
    InputError
        Naming the argument that cannot be used; or where a component is not determined.
    """
    chosen = RefineOptions() if options is None else options
    check_scene(scene, tracks)
    if relative_to is not None and not 0 <= relative_to < tracks.n_views:
        raise InputError(f"relative_to is {relative_to}, but there are {tracks.n_views} views")
    if tracks.sigma_rad is not None:
        sigma = float(np.median(tracks.sigma_rad))
    else:
        sigma = float(scene.summary.sigma_rad if sigma_rad is None else sigma_rad)
    if not (np.isfinite(sigma) and sigma > 0.0):
        raise InputError(f"sigma_rad is {sigma}, expected a positive number")
    still, observations, rows = resting_observations(tracks, scene)
    cameras, points = call_core(
        _core.scene_covariance,
        observations,
        scene.cam_from_world,
        (still.centers, still.points, still.view_component, still.track_component),
        np.ascontiguousarray(scene.inlier[rows]),
        relative_to,
        sigma,
        _core_options(chosen, tracks, rig, scene.cam_from_world, rows),
    )
    return SceneCovariance(read_only(cameras), read_only(points))


def check_scene(scene: Scene, tracks: Tracks) -> None:
    """Complain where a scene is not one of these tracks."""
    if not isinstance(scene, Scene):
        raise InputError(f"scene is a {type(scene).__name__}, expected a Scene")
    if (len(scene.centers), len(scene.points), scene.d) != (tracks.n_views, tracks.n_tracks, tracks.d):
        raise InputError(f"{scene!r} is not a scene of {tracks!r}")


def _core_options(
    options: RefineOptions, tracks: Tracks, rig: Rig | None, cam_from_world: Float, rows: slice | Bool
) -> dict[str, Any]:
    sensors = None if rig is None else rig_columns(rig, tracks)
    return {
        "hold_rotations": _mask("hold_rotations", options.hold_rotations, tracks.n_views),
        "hold_centers": _mask("hold_centers", options.hold_centers, tracks.n_views),
        "hold_points": _mask("hold_points", options.hold_points, tracks.n_tracks),
        "rig": None if sensors is None else (np.ascontiguousarray(sensors[0][rows]), sensors[1]),
        "huber_sigmas": float(options.huber_sigmas),
        "reject_outliers": options.reject_outliers,
        "max_iterations": options.max_iterations,
        "linear_solver": options.linear_solver,
        "threads": options.threads,
        **prior_columns(_without_headings(options.priors, cam_from_world), tracks.d),
    }


def _without_headings(priors: Priors, cam_from_world: Float) -> Priors:
    """Turn headings into priors of orientation, about the orientations at hand."""
    if priors.headings is None:
        return priors
    turned = priors.headings.as_rotations(cam_from_world)
    if priors.rotations is not None:
        known = priors.rotations
        turned = RotationPriors.of(
            np.concatenate((known.view, turned.view)),
            np.concatenate((known.cam_from_world, turned.cam_from_world)),
            covariance=np.concatenate((known.covariance, turned.covariance)),
        )
    return replace(priors, rotations=turned, headings=None)


def rig_columns(rig: Rig, tracks: Tracks) -> tuple[Any, Any]:
    """Sensor of each observation and centres of the sensors."""
    if len(rig.sensor) != len(tracks):
        raise InputError(f"rig.sensor has {len(rig.sensor)} entries, but there are {len(tracks)} observations")
    if rig.center.shape[1] != tracks.d:
        raise InputError(f"the rig has centres of {rig.center.shape[1]} coordinates, but the bearings have {tracks.d}")
    return rig.sensor, rig.center


def prior_columns(priors: Priors, d: int) -> dict[str, Any]:
    """Columns of each kind of prior, by the core's names."""
    columns: dict[str, Any] = {}
    if priors.rotations is not None:
        given = priors.rotations
        columns["rotation_priors"] = (given.view, given.cam_from_world, given.covariance)
    if priors.directions is not None:
        towards = priors.directions
        columns["direction_priors"] = (towards.view, towards.bearing, towards.direction, towards.sigma_rad)
    if priors.positions is not None:
        known = priors.positions
        columns["position_priors"] = (known.view, known.center, known.covariance)
    for name, values in columns.items():
        # headings are of the plane
        found = 2 if values[1].ndim == 1 else values[1].shape[-1]
        if found != d:
            raise InputError(f"{name} have {found} coordinates, but the bearings have {d}")
    return columns


def _mask(name: str, held: bool | npt.ArrayLike, n: int) -> list[bool]:
    mask = np.asarray(held)
    if mask.dtype != np.bool_ or mask.shape not in ((), (n,)):
        raise InputError(f"{name} has type {mask.dtype} and shape {mask.shape}, expected a bool or ({n},) bools")
    full: Bool = np.broadcast_to(mask, (n,))
    return list(map(bool, full)) if full.any() else []
