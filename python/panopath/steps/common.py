"""What the steps share on the way to the compiled core."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.model import Bool, Float, Int, Scene, Tracks, check_orientations
from panopath.movers import at_rest, resting

#: View, track and bearing of each observation, numbers of views and tracks, sigma_rad.
Observations = tuple[Int, Int, Float, int, int, Float | None]


def call_core(function: Any, *arguments: Any) -> Any:
    """Call the core; what it finds wrong with the input becomes an :class:`InputError`."""
    try:
        return function(*arguments)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from None


def observations_of(tracks: Tracks) -> Observations:
    """Observations in the form in which the core takes them."""
    return tracks.view, tracks.track, tracks.bearing, tracks.n_views, tracks.n_tracks, tracks.sigma_rad


def resting_observations(tracks: Tracks, scene: Scene) -> tuple[Scene, Observations, slice | Bool]:
    """Scene and observations without bodies that move, and which rows (N,) these are, for steps that know only rest."""
    if scene.paths is None:
        return scene, observations_of(tracks), slice(None)
    rows: Bool = np.asarray(resting(scene)[tracks.track])
    sigma = None if tracks.sigma_rad is None else np.ascontiguousarray(tracks.sigma_rad[rows])
    view, track = np.ascontiguousarray(tracks.view[rows]), np.ascontiguousarray(tracks.track[rows])
    bearing = np.ascontiguousarray(tracks.bearing[rows])
    return at_rest(scene), (view, track, bearing, tracks.n_views, tracks.n_tracks, sigma), rows


def orientations_of(tracks: Tracks, cam_from_world: npt.ArrayLike | None) -> Float | None:
    """Orientations checked against the tracks; None stays None."""
    return None if cam_from_world is None else check_orientations(cam_from_world, tracks.n_views, tracks.d)


def known_views(scene: Scene) -> tuple[Float, Float]:
    """Orientations and centres; a view without an orientation has no centre, and any orientation."""
    by_view = scene.cam_from_world.reshape(len(scene.centers), -1)
    unknown = ~np.isfinite(by_view).all(axis=1)
    if not unknown.any():
        return scene.cam_from_world, scene.centers
    orientations, centers = np.array(scene.cam_from_world), np.array(scene.centers)
    orientations[unknown] = 0.0 if scene.d == 2 else np.eye(3)
    centers[unknown] = np.nan
    return orientations, centers
