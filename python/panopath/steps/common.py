"""What the steps share on the way to the compiled core."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from panopath.model import Float, InputError, Tracks, check_orientations


def call_core(function: Any, *arguments: Any) -> Any:
    """Call the core; what it finds wrong with the input becomes an :class:`InputError`."""
    try:
        return function(*arguments)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from None


def orientations_of(tracks: Tracks, cam_from_world: npt.ArrayLike | None) -> Float | None:
    """Orientations checked against the tracks; None stays None."""
    return None if cam_from_world is None else check_orientations(cam_from_world, tracks.n_views, tracks.d)
