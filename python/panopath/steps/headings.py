"""Headings of planar views from bearings alone: a start for a refinement of everything at once.

Sources: the constraint between three calibrated views of a line camera and its twofold ambiguity, Astrom and Oskarsson,
*Solutions and ambiguities of the structure and motion problem for 1D retinal vision* (2000).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from panopath import _core
from panopath.errors import InputError
from panopath.model import Bool, Float, Int, Status, Tracks, read_only
from panopath.steps.common import call_core, observations_of


@dataclass(frozen=True)
class HeadingOptions:
    """How headings are sought."""

    #: Standard deviation of a bearing in radians; None: the median of ``tracks.sigma_rad``, or half a degree.
    noise_rad: float | None = None
    #: Fewest tracks that three views must share to be a triplet; 5 fix it, the others are the check.
    min_tracks: int = 7
    #: Triplets sought for each view.
    triplets: int = 12
    #: Fewest known points onto which a view is resected; 3 fix it, without a check.
    min_points: int = 4
    #: Seed of the samples.
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("min_tracks", 6), ("triplets", 1), ("min_points", 3), ("seed", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise InputError(f"{name} is {value!r}, expected a whole number of at least {least}")
        if self.noise_rad is not None and not 0.0 < self.noise_rad < 0.5:
            raise InputError(f"noise_rad is {self.noise_rad!r}, expected a number above 0, below 0.5")


@dataclass(frozen=True, eq=False)
class Headings:
    """Headings of planar views, those of a component up to one turn."""

    #: (n_views,) radians, ``world_from_cam`` being the rotation by the heading; NaN where not determined.
    heading_rad: Float
    #: (n_views,) component of each view, 0 the largest, -1 none.
    view_component: Int
    #: (n_views,) True where a view was resected onto points that the others fixed.
    resected: Bool
    #: Triplets that were tried, and those that had an answer.
    n_triplets: tuple[int, int]
    #: The same of sets of four tracks, which views that see few of them share.
    n_quads: tuple[int, int]
    #: ``converged``: all views in one component. ``disconnected``: not all, or in several. ``undetermined``: none.
    status: Status


def find_headings(tracks: Tracks, options: HeadingOptions | None = None) -> Headings:
    """Headings of planar views from bearings relative to them, each component up to a common turn.

    Triplets of views that share tracks are solved in closed form, their differences of heading averaged, and views that
    no triplet reached are resected onto the points found so. The answer is a start: good to about the noise of a
    bearing where triplets share many tracks all round, to be refined together with positions.

    Parameters
    ----------
    tracks
        The observations, d = 2, bearings relative to the heading of each view.
    options
        Choices; default ``HeadingOptions()``.

    Returns
    -------
    Headings

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    chosen = HeadingOptions() if options is None else options
    if not isinstance(tracks, Tracks):
        raise InputError(f"tracks is a {type(tracks).__name__}, expected Tracks (see Tracks.from_arrays)")
    if not isinstance(chosen, HeadingOptions):
        raise InputError(f"options is a {type(chosen).__name__}, expected HeadingOptions")
    if tracks.d != 2:
        raise InputError(f"tracks have bearings of {tracks.d} coordinates, expected 2: headings belong to the plane")
    found = call_core(
        _core.start_headings,
        observations_of(tracks),
        dict(chosen.__dict__),
    )
    return Headings(
        heading_rad=read_only(np.asarray(found["heading_rad"], dtype=np.float64)),
        view_component=read_only(np.asarray(found["view_component"], dtype=np.int32)),
        resected=read_only(np.asarray(found["resected"], dtype=np.bool_)),
        n_triplets=tuple(found["n_triplets"]),
        n_quads=tuple(found["n_quads"]),
        status=Status(found["status"]),
    )
