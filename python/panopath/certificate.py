"""What a scene's certificate says: which members are determined up to one similarity, which are not, why, and how well.

Records only; :func:`panopath.certify` makes them. Indices of views and tracks are those of the scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal

import numpy as np

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
    """Values of modes on either side of the nullity: rms angle by which rays turn where the views move by their size."""

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
    #: Shape for drawing. A line: point and direction, (2, d). A conic: a, b, c, d, e, f of
    #: a x^2 + b x y + c y^2 + d x + e y + f = 0, (6,). Empty where there is none.
    shape: Float
    #: Whether it holds exactly, or only within the noise.
    is_exact: bool


@dataclass(frozen=True)
class Consistency:
    """The consistency gate: does the converged scene look like a right one?"""

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
    #: Views and tracks with at least one observation, whether the scene has them or not.
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
    #: (all tracks,) standard deviation of each point, its views held, as a share of its distance; inf where no ray fixes it.
    track_looseness: Float

    def __post_init__(self) -> None:
        for name in ("view_line", "track_line", "view_looseness", "track_looseness"):
            object.__setattr__(self, name, read_only(np.ascontiguousarray(getattr(self, name), dtype=np.float64)))
        for name in ("view_component", "track_component"):
            object.__setattr__(self, name, read_only(np.ascontiguousarray(getattr(self, name), dtype=np.int32)))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; a number that is not finite becomes None."""
        raise NotImplementedError
