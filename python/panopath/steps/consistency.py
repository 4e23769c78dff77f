"""The consistency gate: whether a scene that converged looks like a right one."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import radians

import numpy as np

from panopath import _core
from panopath.certificate import Consistency
from panopath.errors import InputError
from panopath.model import Bool, Float, Int, Scene, Tracks
from panopath.steps.common import call_core, known_views, resting_observations
from panopath.steps.refinement import check_scene


@dataclass(frozen=True)
class ConsistencyOptions:
    """Limits of :func:`panopath.check_consistency`; each is the most that passes."""

    #: Noise that a camera is believed to have, radians in each tangent direction.
    max_noise_rad: float = radians(5.0)
    #: Noise as a multiple of the ``sigma_rad`` of the tracks, where they have any.
    max_noise_ratio: float = 1.5
    #: Share of the accepted observations beyond ten times the noise.
    max_misfit_share: float = 0.05
    #: Share of tracks, of those seen five times or more, of which the scene uses less than a third.
    max_lost_share: float = 0.25
    #: Share of the accepted observations whose point lies behind them.
    max_behind_share: float = 0.001
    #: Share of views without a position, though they see twenty points of the scene or more.
    max_unplaced_share: float = 0.05
    #: Chance, over all pairs of views, below which a pair is believed to disagree.
    pair_chance: float = 1e-4
    #: Noise in the scene as a multiple of the noise among ten neighbouring views, over what it grew from four to ten.
    max_tension: float = 1.11
    #: Gain of four neighbouring views left to themselves, a freedom, in units of noise.
    max_near_strain: float = 6.0
    #: The same of ten views.
    max_far_strain: float = 4.0
    #: Threads to use; None: all cores. The answer does not depend on it.
    threads: int | None = None

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if name != "threads" and not value > 0.0:
                raise InputError(f"{name} is {value}, expected a number above 0")
        if self.threads is not None and (not isinstance(self.threads, int) or self.threads < 1):
            raise InputError(f"threads is {self.threads!r}, expected a whole number of at least 1")


def check_consistency(tracks: Tracks, scene: Scene, options: ConsistencyOptions | None = None) -> Consistency:
    """Look for what a scene shows only if it is wrong, though its solver converged; d = 2 or 3.

    A wrong scene cannot fit everything: it shows in which observations were rejected, and in how the others miss.
    Residuals are computed here, so the scene may come from any solver; its ``inlier`` says what that solver used.

    Parameters
    ----------
    tracks
        The observations, bearings in the cameras, or in the world where the scene's orientations are the identity.
        Their ``sigma_rad``, where given, are held against the residuals.
    scene
        Views and points without a position are left out, and with ``paths`` all tracks but those at rest. A scene
        without any passes: it claims nothing.
    options
        Limits; default ``ConsistencyOptions()``.

    Returns
    -------
    Consistency
        ``statistics`` holds value and limit of ``noise_rad``, ``noise_over_given`` (with ``sigma_rad`` only),
        ``misfit_share``, ``behind_share``, ``lost_share``, ``unplaced_share``, ``untied_views``, ``torn_places``,
        ``tension``, ``near_strain`` and ``far_strain``, each of the worst component; NaN where there is too
        little to measure.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    chosen = ConsistencyOptions() if options is None else options
    if not isinstance(tracks, Tracks):
        raise InputError(f"tracks is a {type(tracks).__name__}, expected Tracks (see Tracks.from_arrays)")
    if not isinstance(chosen, ConsistencyOptions):
        raise InputError(f"options is a {type(chosen).__name__}, expected ConsistencyOptions")
    check_scene(scene, tracks)
    if len(scene.inlier) != len(tracks):
        raise InputError(f"scene.inlier has {len(scene.inlier)} entries, but there are {len(tracks)} observations")
    orientations, centers = known_views(scene)
    still, observations, rows = resting_observations(tracks, scene)
    reasons, statistics = call_core(
        _core.check_consistency,
        observations,
        orientations,
        (_tied(centers, still, observations[0], rows), still.points, still.view_component, still.track_component),
        np.ascontiguousarray(scene.inlier[rows]),
        asdict(chosen),
    )
    figures = {name: (float(value), float(limit)) for name, value, limit in statistics}
    return Consistency(passed=not reasons, reasons=tuple(reasons), statistics=figures)


def _tied(centers: Float, still: Scene, view: Int, rows: slice | Bool) -> Float:
    """Centres of the views that what rests can tell of; one that sees only what moves is held by that."""
    if isinstance(rows, slice):
        return centers
    used = np.bincount(view[still.inlier[rows]], minlength=len(centers)) > 0
    return np.ascontiguousarray(np.where(used[:, None], centers, np.nan))
