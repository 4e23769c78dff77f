"""Orientations of a moving camera from the mean motion of what it sees, and from points that are known.

Source: Knill and Ramirez-Herran, *Space and camera path reconstruction for omni-directional vision* (2007), section 7.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.model import Float, Int, Scene, Status, Tracks, read_only
from panopath.movers import at_rest
from panopath.steps.common import call_core, observations_of, orientations_of

Flow = Literal["sphere", "horizon"]
Weighting = Literal["robust", "mean", "slowest"]


@dataclass(frozen=True, eq=False)
class MotionOptions:
    """How the turns between views are found."""

    #: ``"sphere"``: the rotation between two sets of bearings. ``"horizon"``: mean flow of azimuth and elevation, as
    #: in the paper, for tracks near the xy plane of the camera.
    flow: Flow = "sphere"
    #: ``"mean"``: all tracks alike. ``"robust"``: the less, the more flow the turn leaves to a track. ``"slowest"``:
    #: only the ``share`` of tracks with the least flow left, so that near points drop out.
    weighting: Weighting = "robust"
    #: Share kept by ``"slowest"``, above 0, at most 1.
    share: float = 0.5
    #: What is known of gravity, for d = 3: None, nothing; ``"upright"``, the z axis of every camera is vertical; or
    #: (n_views, 3) upward directions in the cameras. Known, the camera turns about the vertical alone.
    vertical: Literal["upright"] | npt.ArrayLike | None = None
    #: Views follow each other by their time, where the tracks have times, or by their index.
    order: Literal["time", "index"] = "time"
    #: Fewest common tracks of two views that follow each other.
    min_tracks: int = 3

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("flow", self.flow, ("sphere", "horizon")),
            ("weighting", self.weighting, ("robust", "mean", "slowest")),
            ("order", self.order, ("time", "index")),
        ):
            if value not in allowed:
                raise InputError(f"{name} is {value!r}, expected one of {', '.join(map(repr, allowed))}")
        if not 0.0 < self.share <= 1.0:
            raise InputError(f"share is {self.share!r}, expected a number above 0, at most 1")
        if isinstance(self.min_tracks, bool) or not isinstance(self.min_tracks, int) or self.min_tracks < 1:
            raise InputError(f"min_tracks is {self.min_tracks!r}, expected a whole number of at least 1")
        if isinstance(self.vertical, str) and self.vertical != "upright":
            raise InputError(f'vertical is {self.vertical!r}, expected None, "upright" or upward directions')


@dataclass(frozen=True, eq=False)
class MeanMotion:
    """Orientations up to one rotation for each chain of views, and the steps they are chained from."""

    #: (n_views, 3, 3), or headings (n_views,) in radians for d = 2; NaN where there is none. The first view of a chain
    #: is the identity, or upright where the vertical is known.
    cam_from_world: Float
    #: (n_views,) chain of each view, 0 the longest, -1 for a view without a step.
    view_component: Int
    #: (n_steps,) the earlier and the later view of each step.
    step_from: Int
    step_to: Int
    #: (n_steps,) tracks seen from both.
    n_common: Int
    #: (n_steps, 3, 3) rotations from the earlier camera to the later one, or (n_steps,) changes of the heading in
    #: radians for d = 2; NaN where not determined.
    turn: Float
    #: (n_steps,) seconds; 1 where the views are ordered by index.
    interval_s: Float
    #: (n_steps,) median angle of the flow that the turn leaves.
    residual_rad: Float
    #: (n_steps,) standard deviation of the turn about its least certain axis, as if the flow left were noise. Flow from
    #: translation that all points share is not seen by it.
    turn_sigma_rad: Float
    #: ``converged``: one chain. ``disconnected``: several, or views without any. ``undetermined``: no step at all.
    status: Status

    @property
    def turn_rate_rad_s(self) -> Float:
        """(n_steps,) angular speed: the angle of each turn over its time (signed for d = 2)."""
        if self.turn.ndim == 1:
            angle = self.turn
        else:
            # both halves of the angle, accurate from 0 to pi
            skew = self.turn - self.turn.transpose(0, 2, 1)
            sine = 0.5 * np.sqrt(skew[:, 2, 1] ** 2 + skew[:, 0, 2] ** 2 + skew[:, 1, 0] ** 2)
            angle = np.arctan2(sine, 0.5 * (np.trace(self.turn, axis1=1, axis2=2) - 1.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(angle / self.interval_s)


def mean_motion(tracks: Tracks, options: MotionOptions | None = None) -> MeanMotion:
    """Orientations from the mean motion field between views that follow each other, d = 2 or 3.

    The turn of the camera is the rotation that carries the bearings of one view nearest to those of the next. What
    the camera's translation adds to the flow is taken for noise: right where points are far or all around, a bias
    that adds up where they are near and on one side.

    Parameters
    ----------
    tracks
        The observations, bearings in the cameras. ``tracks.time_s`` orders the views; views of unknown time take no
        part.
    options
        Choices; default ``MotionOptions()``.

    Returns
    -------
    MeanMotion
        ``cam_from_world`` can be handed to :func:`panopath.solve_positions` where no entry is NaN.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.

    Notes
    -----
    Source: Knill and Ramirez-Herran (2007), section 7, steps 1 to 3 and second remark.
    """
    chosen = MotionOptions() if options is None else options
    if not isinstance(tracks, Tracks):
        raise InputError(f"tracks is a {type(tracks).__name__}, expected Tracks (see Tracks.from_arrays)")
    if not isinstance(chosen, MotionOptions):
        raise InputError(f"options is a {type(chosen).__name__}, expected MotionOptions")
    found = call_core(
        _core.mean_motion,
        observations_of(tracks),
        _core_options(chosen, tracks),
    )
    return _motion(found)


def fit_rotations(
    tracks: Tracks,
    scene: Scene | tuple[npt.ArrayLike, npt.ArrayLike],
    cam_from_world: npt.ArrayLike | None = None,
    weighting: Weighting = "robust",
) -> Float:
    """Orientation of each view, given its centre and the points it saw.

    Alternated with :func:`panopath.solve_positions` this is the paper's fine-tuning (section 7, step 4).

    Parameters
    ----------
    tracks
        The observations, bearings in the cameras.
    scene
        A scene, or ``(centers, points)`` of shapes (n_views, d) and (n_tracks, d), NaN where unknown; in the frame of
        ``cam_from_world``. Of a scene with ``paths`` the tracks at rest alone.
    cam_from_world
        Orientations so far, kept by views whose points do not fix one; default: those of the scene.
    weighting
        As in :class:`MotionOptions`.

    Returns
    -------
    array
        (n_views, 3, 3) rotations, or (n_views,) headings in radians for d = 2.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    given = (scene.centers, at_rest(scene).points) if isinstance(scene, Scene) else scene
    centers, points = (np.ascontiguousarray(rows, dtype=np.float64) for rows in given)
    known = scene.cam_from_world if isinstance(scene, Scene) and cam_from_world is None else cam_from_world
    orientations = orientations_of(tracks, known)
    if orientations is None:
        raise InputError("cam_from_world is None, expected the orientations so far")
    found = call_core(
        _core.fit_rotations,
        observations_of(tracks),
        centers,
        points,
        orientations,
        weighting,
        0.5,
    )
    return read_only(np.asarray(found, dtype=np.float64))


def _core_options(options: MotionOptions, tracks: Tracks) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "flow": options.flow,
        "weighting": options.weighting,
        "share": float(options.share),
        "min_tracks": options.min_tracks,
    }
    if isinstance(options.vertical, str):
        plain["upright"] = True
    elif options.vertical is not None:
        plain["up"] = np.ascontiguousarray(options.vertical, dtype=np.float64)
        if plain["up"].shape != (tracks.n_views, 3):
            raise InputError(f"vertical has shape {plain['up'].shape}, expected {(tracks.n_views, 3)}")
    if options.order == "time" and tracks.time_s is not None:
        plain["time_s"] = tracks.time_s
    return plain


def _motion(found: Mapping[str, Any]) -> MeanMotion:
    arrays = {name: read_only(array) for name, array in found.items() if name != "status"}
    return MeanMotion(**arrays, status=Status(found["status"]))
