"""What a scene's certificate says: which members are determined up to one similarity, which are not, why, and how well.

Records only; :func:`panopath.certify` makes them, ``certificate_text`` puts them into words. Indices of views and
tracks are those of the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Literal

import numpy as np

from panopath.certificate_text import Names, cause_sentence, explain, sentence
from panopath.model import Float, Int, read_only

#: What is known of the orientations: all of it; nothing; the vertical.
OrientationModel = Literal["known", "free", "vertical"]


class Verdict(StrEnum):
    """How far a component, or a whole scene, can be believed."""

    #: Unique up to the gauge, and small against its size what noise makes of it.
    DETERMINED = "determined"
    #: Unique, but noise moves it far, or hides whether it is unique.
    WEAK = "weak"
    #: Other scenes fit the same bearings exactly, and are not similar to this one.
    UNDETERMINED = "undetermined"


class CauseKind(StrEnum):
    """Why something is not determined: the names of the paper (section 4), and what it does not name."""

    #: A single view: its points have no depth.
    ONE_CAMERA = "one_camera"
    #: Two views in the plane, however many points.
    TWO_CAMERAS = "two_cameras"
    #: Two points in the plane, however many views.
    TWO_POINTS = "two_points"
    #: All views of a point lie on one line with it.
    CAMERA_COLLINEAR = "camera_collinear"
    #: All points that a view sees lie on one line with it.
    POINT_COLLINEAR = "point_collinear"
    #: All views on one line and all points on another.
    TWO_LINES_1 = "two_lines_1"
    #: Views and points spread over two lines in any other way.
    TWO_LINES_2 = "two_lines_2"
    #: Views and points on one conic: circle, ellipse, parabola or hyperbola.
    CONIC = "conic"
    #: Two views and two points in space that lie in one plane.
    COPLANAR_TWO_BY_TWO = "coplanar_two_by_two"
    #: A point hidden from all views but one (or seen in one direction only), or a view that sees one point only.
    HIDDEN_POINT = "hidden_point"
    #: Fewer equations than unknowns.
    TOO_FEW_EQUATIONS = "too_few_equations"
    #: No observation ties these parts to each other.
    DISCONNECTED = "disconnected"
    #: Rigid parts that hold each other by too little to share one scale.
    WEAK_JOIN = "weak_join"
    #: None of these; the null vector is the evidence.
    OTHER = "other"


@dataclass(frozen=True)
class Gap:
    """Values of modes on either side of the nullity: rms angle by which rays turn where views move by their size."""

    #: The largest that counts as zero; 0 where none beyond the gauge does.
    last_null: float
    #: The smallest that does not; NaN where there is none.
    first_other: float


@dataclass(frozen=True, eq=False)
class RigidComponent:
    """A maximal set of views and points that is determined up to one common similarity."""

    #: Members, ascending. A hinge is a member of more than one component.
    views: Int
    tracks: Int
    n_observations: int
    verdict: Verdict
    #: Rms movement of the views along the weakest mode at one standard deviation, as a share of the component's size.
    weakest_movement: float


@dataclass(frozen=True, eq=False)
class Hinge:
    """Two components that share members, and may still change size (or turn) against each other."""

    components: tuple[int, int]
    views: Int
    tracks: Int


@dataclass(frozen=True, eq=False)
class Mode:
    """A way the scene can move: for nothing (null), or for little (weak)."""

    #: Rms angle by which rays turn where the views move by their size, radians.
    value: float
    #: Whether the bearings do not resist at all.
    is_null: bool
    #: Rms movement of the views at one standard deviation of the bearings, as a share of their size; inf where null.
    movement: float
    #: The component that moves in itself; for a null mode, the one that stands still.
    component: int | None
    #: (n_views, d) displacement of each view at one standard deviation; of the rms of the scene's size for a null mode.
    view_displacement: Float
    #: (n_tracks, d) the same for points.
    track_displacement: Float
    #: (n_views, 3) turn of each view in the world along the mode, zero where orientations are known; in the plane the
    #: first entry counts.
    view_turn_rad: Float


@dataclass(frozen=True, eq=False)
class Cause:
    """Why something is not determined, or not well."""

    kind: CauseKind
    #: Members it concerns, ascending.
    views: Int
    tracks: Int
    #: Components it keeps apart, or the one that it leaves loose; indices into ``Certificate.components``.
    components: tuple[int, ...]
    #: More words: "ellipse", "3 of 4 constraints".
    detail: str
    #: Shape for drawing. Lines: a point and a direction each, (2, d) or (4, d). A conic: a, b, c, d, e, f of
    #: a x^2 + b x y + c y^2 + d x + e y + f = 0, (6,). Empty where there is none.
    shape: Float
    #: Whether it holds exactly, or only within the noise.
    is_exact: bool


@dataclass(frozen=True)
class Consistency:
    """The consistency gate: whether the converged scene looks like a right one."""

    passed: bool
    #: One clear sentence for each test that failed.
    reasons: tuple[str, ...]
    #: Figures by name, each with its limit: value, limit.
    statistics: dict[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is determined in a scene, what is not, and how well."""

    verdict: Verdict
    #: Dimension of the null space of the bearing-rigidity matrix at the scene.
    nullity: int
    #: What a determined scene would have: translations, scale, and the turns that the model leaves free.
    gauge_freedoms: int
    gap: Gap
    #: Largest first. Members that hang loose by themselves belong to none.
    components: tuple[RigidComponent, ...]
    hinges: tuple[Hinge, ...]
    #: Null modes beyond the gauge, then weak ones, weakest first; not all where there are very many.
    modes: tuple[Mode, ...]
    causes: tuple[Cause, ...]
    consistency: Consistency
    #: Whether orientations were taken as known, free, or free about the vertical.
    orientation: OrientationModel
    #: Angular standard deviation the verdict is for, and where it comes from.
    sigma_rad: float
    sigma_source: Literal["given", "tracks", "residuals", "assumed"]
    #: A movement beyond this share of the component's size is weak.
    weak_movement: float
    #: Views and tracks with at least one observation, whether the scene has them or not; no tracks that move.
    n_views: int
    n_tracks: int
    #: (all views,) component of each view, the largest where it is a hinge; -1 none.
    view_component: Int
    #: (all tracks,) the same for points.
    track_component: Int
    #: (all views, d) unit direction along which a view may move alone, NaN where it may not: the deformation line.
    view_line: Float
    #: (all tracks, d) the same for points.
    track_line: Float
    #: (all views,) standard deviation of each view's position against the views it shares most with, as a share of its
    #: distance from them; NaN where nothing determines it.
    view_looseness: Float
    #: (all tracks,) standard deviation of each point, its views held, as a share of its distance; inf where no ray
    #: fixes it.
    track_looseness: Float

    def __post_init__(self) -> None:
        for name in ("view_line", "track_line", "view_looseness", "track_looseness"):
            object.__setattr__(self, name, read_only(np.ascontiguousarray(getattr(self, name), dtype=np.float64)))
        for name in ("view_component", "track_component"):
            object.__setattr__(self, name, read_only(np.ascontiguousarray(getattr(self, name), dtype=np.int32)))

    @property
    def is_determined(self) -> bool:
        """Whether the scene is unique, well held, and agrees with its bearings: what exit code 0 of ``check`` means."""
        return self.verdict is Verdict.DETERMINED and self.consistency.passed

    def sentence(self, view_labels: Sequence[str] | None = None, track_labels: Sequence[str] | None = None) -> str:
        """Tell the verdict in one sentence of plain words; the word before the colon is the verdict.

        Parameters
        ----------
        view_labels, track_labels
            Names of all views and tracks, as ``scene.view_labels()`` gives them; default: their indices.
        """
        return sentence(self, Names(view_labels, track_labels))

    def explain(
        self,
        view_labels: Sequence[str] | None = None,
        track_labels: Sequence[str] | None = None,
        positions: tuple[Float, Float] | None = None,
    ) -> list[str]:
        """Tell everything, a line each: the verdict, contradictions, spectrum, parts, hinges, causes, modes.

        Parameters
        ----------
        view_labels, track_labels
            As in :meth:`sentence`.
        positions
            Centres and points of the scene; with them a mode names only what moves against the largest part.
        """
        return explain(self, Names(view_labels, track_labels), positions)

    def settled(self, mode: Mode, centers: Float, points: Float) -> Mode:
        """Give the same mode with the largest part standing still: only what moves against it moves.

        Parameters
        ----------
        mode
            One of ``modes``.
        centers, points
            (n_views, d) and (n_tracks, d) positions of the scene; NaN rows where not known.
        """
        place = np.concatenate((centers, points))
        moved = np.concatenate((mode.view_displacement, mode.track_displacement))
        known = np.isfinite(place).all(axis=1) & np.isfinite(moved).all(axis=1)
        held = np.zeros(len(place), dtype=np.bool_)
        if self.components:
            held[self.components[0].views] = True
            held[len(centers) + self.components[0].tracks] = True
        still = np.flatnonzero(known & (held if (held & known).sum() > 1 else known)).astype(np.int32)
        return hold_still(mode, centers, points, still, self.orientation)

    def to_dict(
        self, view_labels: Sequence[str] | None = None, track_labels: Sequence[str] | None = None
    ) -> dict[str, Any]:
        """Plain values for JSON, keys always in the same order; what is not finite becomes None.

        Views are told in full. Tracks are told by their number and at most ``MOST_TRACKS`` indices, the first ones; of
        a mode, those that move the most.

        Parameters
        ----------
        view_labels, track_labels
            Names for the sentences; members are indices all the same.
        """
        names = Names(view_labels, track_labels)
        loose = np.flatnonzero(self.track_component < 0)
        return {
            "verdict": self.verdict.value,
            "is_determined": self.is_determined,
            "sentence": sentence(self, names),
            "nullity": int(self.nullity),
            "gauge_freedoms": int(self.gauge_freedoms),
            "gap": {"last_null": _plain(self.gap.last_null), "first_other": _plain(self.gap.first_other)},
            "orientation": self.orientation,
            "sigma_rad": _plain(self.sigma_rad),
            "sigma_source": self.sigma_source,
            "weak_movement": _plain(self.weak_movement),
            "n_views": int(self.n_views),
            "n_tracks": int(self.n_tracks),
            "components": [_component_dict(part) for part in self.components],
            "hinges": [
                {"components": _plain(hinge.components), "views": _plain(hinge.views), "tracks": _some(hinge.tracks)}
                for hinge in self.hinges
            ],
            "causes": [_cause_dict(cause, cause_sentence(cause, self, names)) for cause in self.causes],
            "modes": [_mode_dict(mode) for mode in self.modes],
            "consistency": {
                "passed": bool(self.consistency.passed),
                "reasons": list(self.consistency.reasons),
                "statistics": {
                    name: {"value": _plain(value), "limit": _plain(limit)}
                    for name, (value, limit) in sorted(self.consistency.statistics.items())
                },
            },
            "view_component": _plain(self.view_component),
            "view_line": _plain(self.view_line),
            "view_looseness": _plain(self.view_looseness),
            "loose_tracks": _some(loose) | {"line": _plain(self.track_line[loose[:MOST_TRACKS]])},
        }


def hold_still(mode: Mode, centers: Float, points: Float, held: Int, orientation: OrientationModel) -> Mode:
    """Take from a mode the movement of the whole scene (shift, scale, free turns) that moves ``held`` least.

    Parameters
    ----------
    mode
        What moves.
    centers, points
        (n_views, d) and (n_tracks, d) positions of the scene.
    held
        Indices of what shall stand still: views, then points counted on from ``n_views``.
    orientation
        Which turns the whole scene may make.
    """
    place = np.concatenate((centers, points))
    moved = np.concatenate((mode.view_displacement, mode.track_displacement))
    if not len(held):
        return mode
    middle = place[held].mean(axis=0)
    gauge = _gauge_movements(place - middle, orientation)
    amounts = np.linalg.lstsq(gauge[:, held].reshape(len(gauge), -1).T, moved[held].ravel(), rcond=1e-9)[0]
    rest = moved - np.tensordot(amounts, gauge, axes=1)
    size = np.abs(moved[np.isfinite(moved)]).max(initial=0.0)
    rest[np.abs(rest) < 1e-9 * size] = 0.0
    return replace(mode, view_displacement=rest[: len(centers)], track_displacement=rest[len(centers) :])


def _gauge_movements(place: Float, orientation: OrientationModel) -> Float:
    """(g, n, d) velocities of all places: shift along each axis, growth, and each turn that is free."""
    d = place.shape[1]
    shifts = [np.tile(axis, (len(place), 1)) for axis in np.eye(d)]
    if orientation == "known":
        return np.array([*shifts, place])
    if d == 2:
        return np.array([*shifts, place, place[:, ::-1] * (-1.0, 1.0)])
    turns = [np.cross(axis, place) for axis in np.eye(3)]
    return np.array([*shifts, place, *(turns if orientation == "free" else turns[2:])])


#: Tracks that are named one by one in :meth:`Certificate.to_dict`.
MOST_TRACKS = 1000


def _component_dict(part: RigidComponent) -> dict[str, Any]:
    return {
        "verdict": part.verdict.value,
        "weakest_movement": _plain(part.weakest_movement),
        "n_observations": int(part.n_observations),
        "views": _plain(part.views),
        "tracks": _some(part.tracks),
    }


def _cause_dict(cause: Cause, text: str) -> dict[str, Any]:
    return {
        "kind": cause.kind.value,
        "sentence": text,
        "is_exact": bool(cause.is_exact),
        "views": _plain(cause.views),
        "tracks": _some(cause.tracks),
        "components": _plain(cause.components),
        "detail": cause.detail,
        "shape": _plain(cause.shape),
    }


def _mode_dict(mode: Mode) -> dict[str, Any]:
    speed = np.nan_to_num(np.linalg.norm(mode.track_displacement, axis=1))
    fastest = np.sort(np.argsort(-speed, kind="stable")[:MOST_TRACKS])
    fastest = fastest[speed[fastest] > 0.0]
    return {
        "value": _plain(mode.value),
        "is_null": bool(mode.is_null),
        "movement": _plain(mode.movement),
        "component": mode.component,
        "view_displacement": _plain(mode.view_displacement),
        "view_turn_rad": _plain(mode.view_turn_rad),
        "tracks": {"count": int((speed > 0.0).sum()), "indices": _plain(fastest)},
        "track_displacement": _plain(mode.track_displacement[fastest]),
    }


def _some(tracks: Any) -> dict[str, Any]:
    return {"count": len(tracks), "indices": _plain(tracks[:MOST_TRACKS])}


def _plain(values: Any) -> Any:
    """Numbers as JSON has them; None where one is not finite, and for a whole row of such."""
    array = np.asarray(values)
    if array.dtype.kind in "iub":
        return array.tolist()
    if array.ndim == 0:
        return float(array) if np.isfinite(array) else None
    if array.ndim == 2:
        return [None if not np.isfinite(row).any() else _plain(row) for row in array]
    return [float(value) if np.isfinite(value) else None for value in array.tolist()]
