"""What of a scene is determined, what is not, why, and how well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from panopath import _core
from panopath.certificate import (
    Cause,
    CauseKind,
    Certificate,
    Gap,
    Hinge,
    Mode,
    OrientationModel,
    RigidComponent,
    Verdict,
)
from panopath.errors import InputError
from panopath.model import Int, Scene, Tracks, read_only
from panopath.steps.common import call_core, known_views, resting_observations
from panopath.steps.consistency import ConsistencyOptions, check_consistency
from panopath.steps.refinement import check_scene


@dataclass(frozen=True)
class CertifyOptions:
    """Choices of :func:`certify`; the defaults are meant to be right."""

    #: What is known of orientations: all of it, nothing, or the vertical (the third axis of the world).
    orientation: OrientationModel = "known"
    #: Angular standard deviation of a bearing, radians; of median sigma where the tracks carry sigmas. None: that of
    #: the tracks, else what the residuals tell; 0.1 degrees where these tell nothing.
    sigma_rad: float | None = None
    #: A movement at one standard deviation beyond this share of a component's size is weak.
    weak_movement: float = 0.05
    #: Threads to use; None: all cores. The answer does not depend on it.
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.orientation not in get_args(OrientationModel):
            raise InputError(f"orientation is {self.orientation!r}, expected one of {get_args(OrientationModel)}")
        if self.sigma_rad is not None and not (np.isfinite(self.sigma_rad) and self.sigma_rad > 0.0):
            raise InputError(f"sigma_rad is {self.sigma_rad!r}, expected a positive number")
        if not (np.isfinite(self.weak_movement) and self.weak_movement > 0.0):
            raise InputError(f"weak_movement is {self.weak_movement!r}, expected a positive number")


def certify(tracks: Tracks, scene: Scene, options: CertifyOptions | None = None) -> Certificate:
    """Say what of a scene its observations determine.

    Parameters
    ----------
    tracks
        The observations; which view saw which track counts, and their ``sigma_rad``.
    scene
        Where all are: what a solver found, or the truth. Its inliers count; every part of it is looked at by itself.
        With ``paths``, of cameras and tracks at rest alone; :func:`panopath.certify_paths` tells of the rest.
    options
        Choices; default ``CertifyOptions()``.

    Returns
    -------
    Certificate
        Rigid components from the stretch rates of the segments in the null space of the bearing-rigidity matrix
        (Knill & Ramirez-Herran 2007, section 4, for partial visibility and for space), and what noise moves.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    chosen = CertifyOptions() if options is None else options
    check_scene(scene, tracks)
    if tracks.d == 2 and chosen.orientation == "vertical":
        raise InputError("orientation is 'vertical', which tells nothing in the plane, expected 'known' or 'free'")
    if len(scene.inlier) != len(tracks):
        raise InputError(f"scene.inlier has {len(scene.inlier)} entries, but there are {len(tracks)} observations")
    orientations, centers = known_views(scene)
    still, observations, rows = resting_observations(tracks, scene)
    found = call_core(
        _core.certify,
        observations,
        orientations,
        (centers, still.points, still.view_component, still.track_component),
        (np.ascontiguousarray(scene.inlier[rows]), np.ascontiguousarray(scene.residual_rad[rows])),
        {
            "orientation": chosen.orientation,
            "sigma_rad": chosen.sigma_rad,
            "weak_movement": float(chosen.weak_movement),
            "threads": chosen.threads,
        },
    )
    components = tuple(_component(plain) for plain in found["components"])
    consistency = check_consistency(tracks, scene, ConsistencyOptions(threads=chosen.threads))
    verdict = Verdict(found["verdict"])
    if verdict == Verdict.DETERMINED and not consistency.passed:
        verdict = Verdict.WEAK
    return Certificate(
        verdict=verdict,
        nullity=found["nullity"],
        gauge_freedoms=found["gauge_freedoms"],
        gap=Gap(*found["gap"]),
        components=components,
        hinges=_hinges(components),
        modes=tuple(_mode(plain) for plain in found["modes"]),
        causes=tuple(cause_of(plain, tracks.d) for plain in found["causes"]),
        consistency=consistency,
        orientation=chosen.orientation,
        sigma_rad=found["sigma_rad"],
        sigma_source=found["sigma_source"],
        weak_movement=chosen.weak_movement,
        n_views=len(np.unique(tracks.view)),
        n_tracks=len(np.unique(observations[1])),
        view_component=_largest([c.views for c in components], tracks.n_views),
        track_component=_largest([c.tracks for c in components], tracks.n_tracks),
        view_line=found["view_line"],
        track_line=found["track_line"],
        view_looseness=found["view_looseness"],
        track_looseness=found["track_looseness"],
    )


def _component(plain: dict[str, Any]) -> RigidComponent:
    return RigidComponent(
        views=read_only(plain["views"]),
        tracks=read_only(plain["tracks"]),
        n_observations=plain["n_observations"],
        verdict=Verdict(plain["verdict"]),
        weakest_movement=plain["weakest_movement"],
    )


def _mode(plain: dict[str, Any]) -> Mode:
    arrays = {name: read_only(plain.pop(name)) for name in ("view_displacement", "track_displacement", "view_turn_rad")}
    return Mode(**plain, **arrays)


def cause_of(plain: dict[str, Any], d: int) -> Cause:
    """Make a record of a cause that the core names."""
    kind = CauseKind(plain["kind"])
    # lines are a point and a direction each
    shape = plain["shape"] if kind == CauseKind.CONIC else plain["shape"].reshape(-1, d)
    return Cause(
        kind=kind,
        views=read_only(plain["views"]),
        tracks=read_only(plain["tracks"]),
        components=tuple(plain["components"]),
        detail=plain["detail"],
        shape=read_only(shape),
        is_exact=plain["is_exact"],
    )


def _largest(members: list[Int], count: int) -> Int:
    """Find the first set that each index is a member of; sets come largest first."""
    component = np.full(count, -1, dtype=np.int32)
    for number, ids in reversed(list(enumerate(members))):
        component[ids] = number
    return component


def _hinges(components: tuple[RigidComponent, ...]) -> tuple[Hinge, ...]:
    shared: dict[tuple[int, int], tuple[list[int], list[int]]] = {}
    for kind in (0, 1):
        homes: dict[int, list[int]] = {}
        for number, component in enumerate(components):
            for member in (component.views, component.tracks)[kind].tolist():
                homes.setdefault(member, []).append(number)
        for member, numbers in homes.items():
            for i, a in enumerate(numbers):
                for b in numbers[i + 1 :]:
                    shared.setdefault((a, b), ([], []))[kind].append(member)
    return tuple(
        Hinge(pair, read_only(np.array(views, dtype=np.int32)), read_only(np.array(tracks, dtype=np.int32)))
        for pair, (views, tracks) in sorted(shared.items())
    )
