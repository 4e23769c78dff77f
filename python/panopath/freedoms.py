"""What the bearings of bodies that move leave free: records, and how one moves along what is free.

:func:`panopath.steps.certify_paths` makes them, ``freedoms_text`` puts them into words. Indices of views and tracks are
those of the scene.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from panopath.certificate import Gap
from panopath.certificate_text import Names
from panopath.freedoms_text import explain, freedom_sentence, sentence, track_sentence
from panopath.model import Bool, Float, Int, read_only
from panopath.paths import PathVerdict


class FreedomKind(StrEnum):
    """Why something is free."""

    #: Parts that no observation ties to each other: each has a gauge of its own.
    DISCONNECTED = "disconnected"
    #: Everything may share a motion.
    COMMON_MOTION = "common_motion"
    #: Every position may be multiplied by a function of time about a point, which may move: lambda(t).
    SCALE_IN_TIME = "scale_in_time"
    #: The camera moves in the form of these tracks: each may be drawn towards it.
    IMITATED = "imitated"
    #: These tracks are in one direction with another one, whenever they are seen.
    HIDDEN = "hidden"
    #: All views of these points at rest lie on one line with them.
    IN_LINE = "in_line"
    #: Fewer observations, or times, than the path has unknowns.
    TOO_FEW = "too_few"
    #: These tracks have other paths too, for a reason without a name.
    LOOSE_TRACK = "loose_track"
    #: All that these views see is on one line with them.
    LOOSE_VIEW = "loose_view"
    #: These views and tracks move against the others, which may stand still.
    LOOSE_SET = "loose_set"


class Reach(StrEnum):
    """What the rays of a track tell of its path, the cameras held."""

    #: Where it was, each time that it was seen.
    DETERMINED = "determined"
    #: Nothing: it has no observation that counts.
    NOT_SEEN = "not_seen"
    #: Fewer observations, or times, than unknowns.
    TOO_FEW = "too_few"
    #: The camera moves in the form of the path.
    IMITATED = "imitated"
    #: It is in one direction with another track, whenever it is seen.
    HIDDEN = "hidden"
    #: A point at rest whose views are on one line with it.
    IN_LINE = "in_line"
    #: There are other paths, for a reason without a name.
    LOOSE = "loose"


@dataclass(frozen=True, eq=False)
class NullVector:
    """A displacement that keeps all bearings, of rms one over both ends of all segments, in units of the scene."""

    #: (n_views, d); zero beyond the part that moves.
    centers: Float
    #: (sum of n_functions, d) of all coefficients, as in ``Paths.coefficients``.
    coefficients: Float
    #: (n_views,) mean relative stretch of the segments of each view, lambda(t_i) - 1 for a step of one; NaN elsewhere.
    stretch: Float
    #: Angle by which rays turn, over the relative movement: rounding, where it is exact.
    value: float
    #: What one standard deviation makes of it, as a share of the typical distance; inf where it is exact.
    movement: float

    def moved(self, centers: Float, coefficients: Float, by: float) -> tuple[Float, Float]:
        """Move a scene along it.

        The equations are linear in the scene too, so that an exact vector keeps the bearings for any step, as long as
        all that is seen stays in front of its views.
        """
        return np.asarray(centers + by * self.centers), np.asarray(coefficients + by * self.coefficients)


@dataclass(frozen=True, eq=False)
class Freedom:
    """Something that is free beyond shifts and scale."""

    kind: FreedomKind
    #: Power of time, or number of the harmonic, along which it changes; 0: neither.
    order: int
    #: Angular frequency of the harmonic; NaN: it is none.
    omega_rad_s: float
    #: Track whose spline it changes along, -1 = none.
    spline_of: int
    #: How many null vectors it adds to the gauge and to what stands before it.
    dimension: int
    #: Free exactly, rather than as far as noise tells.
    is_exact: bool
    #: Connected part it belongs to, the largest first; -1: all.
    part: int
    #: Views and tracks that it is about, ascending; empty: all of the part. Of a scale in time: the points at rest.
    views: Int
    tracks: Int
    #: Null vectors, not all where there are many; those of single tracks are in :attr:`PathCertificate.null`.
    vectors: tuple[NullVector, ...]

    def sentence(self, names: Names | None = None) -> str:
        """Tell in words what may move how, and why."""
        return freedom_sentence(self, names)


@dataclass(frozen=True, eq=False)
class PathCertificate:
    """What is free in a scene whose points may move; the arrays are read-only."""

    #: Dimension of the null space, gauge included, over all views and tracks that have observations.
    nullity: int
    #: Shifts and scale: d + 1.
    gauge_freedoms: int
    #: Beyond the gauge: dimensions of the exact ones add up to ``extra``.
    freedoms: tuple[Freedom, ...]
    gap: Gap
    #: How far one standard deviation moves the weakest of the modes that are not null, as a share of the distance.
    weakest_movement: float
    #: (d - 1) for each observation, and coordinates of views and coefficients.
    equations: int
    unknowns: int
    #: Angular standard deviation that it is for; 0: only what is exact was looked for.
    sigma_rad: float
    #: What the rays of each track tell, the cameras held.
    reaches: tuple[Reach, ...]
    #: (n_tracks,) that holds exactly, rather than as far as noise tells.
    is_exact: Bool
    #: (n_tracks,) null vectors of each track, or modes that noise moves too far.
    dimension: Int
    #: (n_tracks,) track that each hides behind, -1 = none.
    hidden_by: Int
    #: (n_tracks,) rms movement of each path at one standard deviation along its weakest mode, over its distance.
    movement: Float
    #: (n_tracks,) rms of the part of the camera's way, across the rays, that the functions cannot express.
    camera_part: Float
    #: (n_tracks,) what noise is at the distance of the track.
    noise_part: Float
    #: Displacements (dimension, n_functions, d) of the coefficients of each track that is not determined.
    null: Mapping[int, Float]

    def __post_init__(self) -> None:
        for name in ("is_exact", "dimension", "hidden_by", "movement", "camera_part", "noise_part"):
            object.__setattr__(self, name, read_only(np.array(getattr(self, name))))
        plain = {track: read_only(np.array(vectors)) for track, vectors in self.null.items()}
        object.__setattr__(self, "null", MappingProxyType(plain))

    def __repr__(self) -> str:
        return f"PathCertificate(nullity {self.nullity}, gauge {self.gauge_freedoms})"

    def __str__(self) -> str:
        """Tell the verdict in one sentence."""
        return sentence(self)

    @property
    def extra(self) -> int:
        """Freedoms beyond the gauge; 0 too where no observation counts."""
        return max(self.nullity - self.gauge_freedoms, 0)

    @property
    def is_determined(self) -> bool:
        """Whether nothing is free beyond the gauge, exactly or as far as noise tells."""
        return not self.freedoms

    @property
    def refused(self) -> Bool:
        """(n_tracks,) tracks whose path is not determined by their rays."""
        return np.array([reach is not Reach.DETERMINED for reach in self.reaches], dtype=np.bool_)

    def verdict(self, track: int, *, moves: bool) -> PathVerdict:
        """Tell what a solver that found a path should say of it."""
        reach = self.reaches[track]
        if reach is Reach.DETERMINED:
            return PathVerdict.MOVING if moves else PathVerdict.STATIC
        named = {Reach.IMITATED: PathVerdict.IMITATED, Reach.HIDDEN: PathVerdict.HIDDEN}
        return named.get(reach, PathVerdict.UNDETERMINED)

    def words(
        self, view_labels: Sequence[str] | None = None, track_labels: Sequence[str] | None = None
    ) -> tuple[str, ...]:
        """Tell each freedom in one sentence: what ``Paths.freedoms`` holds."""
        names = Names(view_labels, track_labels)
        return tuple(freedom_sentence(freedom, names) for freedom in self.freedoms)

    def track_words(self, track: int, track_labels: Sequence[str] | None = None) -> str:
        """Tell in one sentence what the rays of a track tell."""
        return track_sentence(self, track, Names(None, track_labels))

    def explain(self, view_labels: Sequence[str] | None = None, track_labels: Sequence[str] | None = None) -> list[str]:
        """Tell all there is to say, a line each, the verdict first."""
        return explain(self, Names(view_labels, track_labels))
