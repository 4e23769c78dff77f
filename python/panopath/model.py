"""The records that flow between the steps: frozen values of flat arrays, checked when they are made.

Conventions (``CONVENTIONS.md``): ``d`` is 2 in the plane and 3 in space; ``cam_from_world`` maps world directions to
camera directions, ``direction_cam = cam_from_world[view] @ direction_world``; a centre is a position in the world;
angles are radians. Views and tracks are int32 indices; their names, where there are any, are for people and files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.paths import Paths

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int32]
Bool = npt.NDArray[np.bool_]
Array = TypeVar("Array", bound=npt.NDArray[Any])

Method = Literal["robust", "linear"]
Gauge = Literal["normalized", "paper", "paper_distance", "control"]
LinearForm = Literal["joint", "two_stage"]
LinearGauge = Literal["functional", "paper", "paper_distance"]
LinearSolver = Literal["auto", "direct", "iterative"]

#: How far from one the length of a bearing may be.
UNIT_TOLERANCE = 1e-6
#: How far from orthonormal a matrix may be and still be read as a rotation.
ROTATION_TOLERANCE = 1e-6
#: Views and tracks are int32 indices.
MAX_COUNT = 2**31 - 1

_NO_NUMBERS: Mapping[str, float] = MappingProxyType({})


class Status(StrEnum):
    """How a solver ended. A status is an answer, not an exception."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "max_iterations"
    #: The geometry leaves freedoms beyond the gauge (or so nearly that noise cannot tell).
    AMBIGUOUS = "ambiguous"
    #: Solved, but in more than one part, each with a scale of its own.
    DISCONNECTED = "disconnected"
    #: No part of the input determines anything.
    UNDETERMINED = "undetermined"

    @property
    def is_determined(self) -> bool:
        """Whether the scene that comes with this status says something about every part it contains."""
        return self not in (Status.AMBIGUOUS, Status.UNDETERMINED)


@dataclass(frozen=True, eq=False)
class Tracks:
    """What the cameras saw: observation ``o`` says that view ``view[o]`` saw track ``track[o]`` along ``bearing[o]``.

    Make one with :meth:`from_arrays`, which checks everything; the arrays of a ``Tracks`` are read-only.
    """

    #: (N,) int32, index of the view of each observation.
    view: Int
    #: (N,) int32, index of the track of each observation.
    track: Int
    #: (N, d) float64, unit vectors: in the camera, or in the world where orientations are not given apart.
    bearing: Float
    #: Number of views, those without observations included.
    n_views: int
    #: Number of tracks, those without observations included.
    n_tracks: int
    #: (N,) angular standard deviation in each tangent direction, or None where unknown.
    sigma_rad: Float | None = None
    #: (n_views,) time of each view in seconds, NaN where unknown, or None.
    time_s: Float | None = None
    #: Names of the views; None means that the indices are the names.
    view_names: tuple[str, ...] | None = None
    #: Names of the tracks; None means that the indices are the names.
    track_names: tuple[str, ...] | None = None

    @classmethod
    def from_arrays(  # noqa: PLR0917 (the public names and their order are fixed)
        cls,
        view: npt.ArrayLike,
        track: npt.ArrayLike,
        bearing: npt.ArrayLike,
        n_views: int | None = None,
        n_tracks: int | None = None,
        sigma_rad: npt.ArrayLike | None = None,
        time_s: npt.ArrayLike | None = None,
        view_names: Sequence[str] | None = None,
        track_names: Sequence[str] | None = None,
    ) -> Tracks:
        """Check the arrays, copy them, and make the record.

        Parameters
        ----------
        view, track
            (N,) whole numbers >= 0: anything that numpy can read (lists, arrays, columns of a data frame).
        bearing
            (N, 2) or (N, 3) unit vectors, to within ``UNIT_TOLERANCE``.
        n_views, n_tracks
            Numbers of views and tracks; default: the number of names, or else the largest index plus one.
        sigma_rad
            Angular standard deviation in radians, one number or (N,), positive.
        time_s
            (n_views,) time of each view in seconds; NaN where unknown.
        view_names, track_names
            Names, each one different; default: the indices.

        Returns
        -------
        Tracks

        Raises
        ------
        InputError
            Naming the argument and the first entry that is wrong.
        """
        view_ids = _indices("view", view)
        n = len(view_ids)
        if n == 0:
            raise InputError("view is empty, expected at least one observation")
        track_ids = _indices("track", track, n)
        bearings = _unit_vectors(bearing, n)
        view_labels = _names("view_names", view_names)
        track_labels = _names("track_names", track_names)
        views = _count("n_views", "view", n_views, view_ids, view_labels)
        tracks = _count("n_tracks", "track", n_tracks, track_ids, track_labels)
        return cls(
            view=read_only(view_ids),
            track=read_only(track_ids),
            bearing=read_only(bearings),
            n_views=views,
            n_tracks=tracks,
            sigma_rad=None if sigma_rad is None else read_only(_sigmas(sigma_rad, n)),
            time_s=None if time_s is None else read_only(_times(time_s, views)),
            view_names=view_labels,
            track_names=track_labels,
        )

    def __len__(self) -> int:
        return len(self.view)

    def __repr__(self) -> str:
        return f"Tracks({len(self)} observations of {self.n_tracks} tracks by {self.n_views} views, d = {self.d})"

    @property
    def d(self) -> int:
        """2 in the plane, 3 in space."""
        return int(self.bearing.shape[1])

    def view_labels(self) -> Sequence[str]:
        """Names of all views, the indices where there are no names."""
        return labels(self.view_names, self.n_views)

    def track_labels(self) -> Sequence[str]:
        """Names of all tracks, the indices where there are no names."""
        return labels(self.track_names, self.n_tracks)

    def select(self, keep: npt.ArrayLike) -> Tracks:
        """Observations where ``keep`` is true; views and tracks keep their indices and names.

        Parameters
        ----------
        keep
            (N,) bool.

        Raises
        ------
        InputError
            Where ``keep`` has another shape or type, or keeps nothing.
        """
        mask = np.asarray(keep)
        if mask.dtype != np.bool_ or mask.shape != self.view.shape:
            raise InputError(f"keep has type {mask.dtype} and shape {mask.shape}, expected bool {self.view.shape}")
        return Tracks.from_arrays(
            self.view[mask],
            self.track[mask],
            self.bearing[mask],
            self.n_views,
            self.n_tracks,
            None if self.sigma_rad is None else self.sigma_rad[mask],
            self.time_s,
            self.view_names,
            self.track_names,
        )

    def to_world(self, cam_from_world: npt.ArrayLike) -> Tracks:
        """Turn bearings in the cameras to directions in the world.

        Parameters
        ----------
        cam_from_world
            (n_views, 3, 3) rotations, or (n_views,) headings in radians for d = 2.

        Returns
        -------
        Tracks
            The same observations, each bearing now ``cam_from_world[view].T @ bearing``.

        Raises
        ------
        InputError
            Where the orientations are not rotations or their number is not ``n_views``.
        """
        orientations = check_orientations(cam_from_world, self.n_views, self.d)
        return Tracks(
            self.view,
            self.track,
            read_only(_world_directions(self.view, self.bearing, orientations)),
            self.n_views,
            self.n_tracks,
            self.sigma_rad,
            self.time_s,
            self.view_names,
            self.track_names,
        )


@dataclass(frozen=True)
class Summary:
    """How a solve went, in numbers a person asks for."""

    status: Status
    #: Linear and Gauss-Newton steps together.
    iterations: int
    #: Angular noise estimated from the residuals, radians; NaN where nothing was determined.
    sigma_rad: float
    #: Wall time of each stage, seconds.
    seconds: Mapping[str, float] = field(default_factory=lambda: _NO_NUMBERS)
    n_views: int = 0
    n_tracks: int = 0
    n_observations: int = 0
    n_inliers: int = 0
    n_solved_views: int = 0
    n_solved_points: int = 0
    #: Parts that share no scale with one another.
    n_components: int = 0


@dataclass(frozen=True, eq=False)
class Statistics:
    """What each view, or each track, has to show for itself."""

    #: (n,) number of observations.
    n_observations: npt.NDArray[np.int64]
    #: (n,) number of those that were used to the end.
    n_inliers: npt.NDArray[np.int64]
    #: (n,) root mean square of the angular residuals of the inliers, NaN where there are none.
    rms_rad: Float


@dataclass(frozen=True, eq=False)
class Scene:
    """Camera path and points. Rows that are not determined are NaN; the arrays are read-only."""

    #: (n_views, d) camera positions.
    centers: Float
    #: (n_tracks, d) points.
    points: Float
    #: (n_views,) int32, the jointly scaled part each view belongs to, -1 = none.
    view_component: Int
    #: (n_tracks,) int32, the part each track belongs to, -1 = none.
    track_component: Int
    #: (N,) whether each observation was used to the end.
    inlier: Bool
    #: (N,) angle between bearing and prediction, NaN where not determined.
    residual_rad: Float
    #: (n_views, 3, 3) rotations, or (n_views,) headings in radians for d = 2.
    cam_from_world: Float
    summary: Summary
    #: The observations this scene was made from, where they are known; bearings as the solver was given them.
    tracks: Tracks | None = None
    #: Names of the views; None means that the indices are the names.
    view_names: tuple[str, ...] | None = None
    #: Names of the tracks; None means that the indices are the names.
    track_names: tuple[str, ...] | None = None
    #: Paths of the tracks, where the scene was solved with bodies that move; ``points`` then holds where each track was
    #: in the middle of the time that it was seen.
    paths: Paths | None = None

    def __post_init__(self) -> None:
        for name in ("centers", "points", "residual_rad", "cam_from_world"):
            object.__setattr__(self, name, read_only(np.ascontiguousarray(getattr(self, name), dtype=np.float64)))
        for name in ("view_component", "track_component"):
            object.__setattr__(self, name, read_only(np.ascontiguousarray(getattr(self, name), dtype=np.int32)))
        object.__setattr__(self, "inlier", read_only(np.ascontiguousarray(self.inlier, dtype=np.bool_)))
        self._check_shapes()

    def _check_shapes(self) -> None:
        n_views, n_tracks = len(self.centers), len(self.points)
        if self.centers.ndim != 2 or self.centers.shape[1] not in (2, 3):
            raise InputError(f"centers has shape {self.centers.shape}, expected (n_views, 2) or (n_views, 3)")
        orientations = (n_views,) if self.d == 2 else (n_views, 3, 3)
        wanted: dict[str, tuple[int, ...]] = {
            "points": (n_tracks, self.d),
            "view_component": (n_views,),
            "track_component": (n_tracks,),
            "cam_from_world": orientations,
            "residual_rad": self.inlier.shape,
        }
        for name, shape in wanted.items():
            found = getattr(self, name).shape
            if found != shape:
                raise InputError(f"{name} has shape {found}, expected {shape}")
        if self.tracks is not None and (
            len(self.tracks) != len(self.inlier) or (self.tracks.n_views, self.tracks.n_tracks) != (n_views, n_tracks)
        ):
            raise InputError(f"the scene was not made from {self.tracks!r}: their numbers differ")
        for name, count in (("view_names", n_views), ("track_names", n_tracks)):
            names = getattr(self, name)
            if names is not None and len(names) != count:
                raise InputError(f"{name} has {len(names)} entries, expected {count}")
        if self.paths is not None and (len(self.paths), self.paths.d) != (n_tracks, self.d):
            raise InputError(f"paths are {self.paths!r}, expected those of {n_tracks} tracks in {self.d} dimensions")

    def __repr__(self) -> str:
        s = self.summary
        return (
            f"Scene({s.status.value}: {s.n_solved_views} of {len(self.centers)} views, "
            f"{s.n_solved_points} of {len(self.points)} points, {s.n_components} part(s), d = {self.d})"
        )

    @property
    def d(self) -> int:
        """2 in the plane, 3 in space."""
        return int(self.centers.shape[1])

    def view_statistics(self) -> Statistics:
        """How many observations each view made, how many were used, and how well they fit."""
        return self._statistics(None if self.tracks is None else self.tracks.view, len(self.centers))

    def point_statistics(self) -> Statistics:
        """How many observations each track has, how many were used, and how well they fit."""
        return self._statistics(None if self.tracks is None else self.tracks.track, len(self.points))

    def _statistics(self, owner: Int | None, count: int) -> Statistics:
        if owner is None:
            none = read_only(np.zeros(count, dtype=np.int64))
            return Statistics(none, none, read_only(np.full(count, np.nan)))
        used = self.inlier & np.isfinite(self.residual_rad)
        squares = np.bincount(owner[used], weights=self.residual_rad[used] ** 2, minlength=count)
        n_used = np.bincount(owner[used], minlength=count)
        rms = np.where(n_used > 0, np.sqrt(squares / np.maximum(n_used, 1)), np.nan)
        return Statistics(read_only(np.bincount(owner, minlength=count)), read_only(n_used), read_only(rms))

    @property
    def n_components(self) -> int:
        """Number of parts, each with a scale of its own."""
        return int(max(self.view_component.max(initial=-1), self.track_component.max(initial=-1))) + 1

    def view_labels(self) -> Sequence[str]:
        """Names of all views, the indices where there are no names."""
        return labels(self.view_names, len(self.centers))

    def track_labels(self) -> Sequence[str]:
        """Names of all tracks, the indices where there are no names."""
        return labels(self.track_names, len(self.points))


@dataclass(frozen=True)
class Problem:
    """What a file holds when it holds more than bearings: the parts, apart."""

    #: Bearings in the cameras where ``cam_from_world`` is given, else world directions.
    tracks: Tracks
    #: (n_views, 3, 3) rotations or (n_views,) headings in radians, or None where bearings are world directions.
    cam_from_world: Float | None = None
    #: The file's own structure, in the order of ``tracks``, where it has one: to start from, or to compare with.
    scene: Scene | None = None

    def world_tracks(self) -> Tracks:
        """Tracks whose bearings are world directions."""
        return self.tracks if self.cam_from_world is None else self.tracks.to_world(self.cam_from_world)


@dataclass(frozen=True)
class Control:
    """Known positions, in the world the answer should be given in.

    A key is a view's (track's) name, or its index as an ``int``.
    """

    #: Known camera centres: name or index -> d coordinates.
    views: Mapping[str | int, Sequence[float]] = field(default_factory=dict)
    #: Known points: name or index of the track -> d coordinates.
    points: Mapping[str | int, Sequence[float]] = field(default_factory=dict)
    #: Whether the fit may turn the scene too (a similarity), or only shift and scale it.
    rotation: bool = True

    def __post_init__(self) -> None:
        if not self.views and not self.points:
            raise InputError("control names no view and no point, expected at least one known position")
        lengths = set()
        for kind in ("views", "points"):
            table: dict[str | int, tuple[float, ...]] = {}
            for key, position in getattr(self, kind).items():
                table[_control_key(kind, key)] = _position(f"control.{kind}[{key!r}]", position)
            lengths |= {len(p) for p in table.values()}
            object.__setattr__(self, kind, MappingProxyType(table))
        if len(lengths) != 1:
            raise InputError("control mixes positions of 2 and of 3 coordinates, expected all alike")
        if not isinstance(self.rotation, bool):
            raise InputError(f"control.rotation is {self.rotation!r}, expected True or False")

    @property
    def d(self) -> int:
        """Number of coordinates of each position."""
        return len(next(iter([*self.views.values(), *self.points.values()])))


@dataclass(frozen=True)
class PositionOptions:
    """Choices of :func:`panopath.solve_positions`; the defaults are meant to be right."""

    #: ``robust``: re-weighted, outliers found, refined on the sphere. ``linear``: the paper's own least squares.
    method: Method = "robust"
    #: ``normalized``: cameras centred at zero with rms distance 1. ``paper``: first point at the origin, second with
    #: x = 1. ``paper_distance``: first point at the origin, first two a distance of 1 apart. ``control``: fitted to
    #: ``control``.
    gauge: Gauge = "normalized"
    #: Known positions, for ``gauge="control"``.
    control: Control | None = None
    #: For ``method="linear"`` in space: all coordinates at once, or the plane first and the heights after it.
    linear_form: LinearForm = "joint"
    #: The axis (0, 1, 2) that plays the role of the height in ``linear_form="two_stage"``.
    vertical_axis: int = 2
    #: What removes shift and scale from the linear equations of ``method="linear"``.
    linear_gauge: LinearGauge = "functional"
    #: How the reduced camera system is solved; ``auto`` chooses by predicted cost.
    linear_solver: LinearSolver = "auto"
    #: Find parts that share no scale and solve each apart.
    split_parts: bool = True
    #: Most Gauss-Newton steps of one part.
    max_iterations: int = 50
    #: Threads to use; None: all cores. The answer does not depend on it.
    threads: int | None = None

    def __post_init__(self) -> None:
        _choice("method", self.method, get_args(Method))
        _choice("gauge", self.gauge, get_args(Gauge))
        _choice("linear_form", self.linear_form, get_args(LinearForm))
        _choice("linear_gauge", self.linear_gauge, get_args(LinearGauge))
        _choice("linear_solver", self.linear_solver, get_args(LinearSolver))
        _choice("vertical_axis", self.vertical_axis, (0, 1, 2))
        _choice("split_parts", self.split_parts, (True, False))
        _at_least_one("max_iterations", self.max_iterations)
        if self.threads is not None:
            _at_least_one("threads", self.threads)
        if self.control is not None and not isinstance(self.control, Control):
            raise InputError(f"control is a {type(self.control).__name__}, expected a Control")
        if self.gauge == "control" and self.control is None:
            raise InputError('gauge is "control" but control is None, expected a Control with known positions')
        if self.gauge != "control" and self.control is not None:
            raise InputError(f'control is given but gauge is "{self.gauge}", expected gauge="control"')

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as ``scene.json`` records them."""
        plain = {name: value for name, value in self.__dict__.items() if name != "control"}
        plain["control"] = (
            None
            if self.control is None
            else {
                "views": {str(k): list(v) for k, v in self.control.views.items()},
                "points": {str(k): list(v) for k, v in self.control.points.items()},
                "rotation": self.control.rotation,
            }
        )
        return plain


def summary_dict(summary: Summary) -> dict[str, Any]:
    """Plain values of a summary, for JSON; a number that is not finite becomes None."""
    plain = asdict(Summary(**{**summary.__dict__, "seconds": dict(summary.seconds)}))
    plain["status"] = summary.status.value
    plain["sigma_rad"] = summary.sigma_rad if np.isfinite(summary.sigma_rad) else None
    return plain


def labels(names: tuple[str, ...] | None, count: int) -> Sequence[str]:
    """Names, or the indices as text where there are none."""
    return names if names is not None else [str(i) for i in range(count)]


def read_only(array: Array) -> Array:
    """Forbid writing to an array and hand it back."""
    array.setflags(write=False)
    return array


def check_orientations(cam_from_world: npt.ArrayLike, n_views: int, d: int) -> Float:
    """Read orientations: (n_views, 3, 3) rotations, or (n_views,) headings in radians for d = 2.

    Returns
    -------
    array
        float64, C order, read-only.

    Raises
    ------
    InputError
        Naming the first view whose orientation is not one.
    """
    found = _numbers("cam_from_world", cam_from_world)
    shape = (n_views,) if d == 2 else (n_views, 3, 3)
    if found.shape != shape:
        meaning = "one heading_rad a view" if d == 2 else "one 3 x 3 rotation a view"
        raise InputError(f"cam_from_world has shape {found.shape}, expected {shape}, {meaning}")
    finite: Bool = np.asarray(np.isfinite(found).all(axis=tuple(range(1, found.ndim))))
    if not finite.all():
        raise InputError(f"cam_from_world[{_first(~finite)}] is not finite, expected a rotation")
    if d == 3:
        gram = found @ found.transpose(0, 2, 1)
        off = np.abs(gram - np.eye(3)).max(axis=(1, 2), initial=0.0)
        wrong: Bool = np.asarray((off > ROTATION_TOLERANCE) | (np.linalg.det(found) < 0.0))
        if wrong.any():
            first = _first(wrong)
            why = "has determinant -1" if off[first] <= ROTATION_TOLERANCE else f"is {off[first]:.2g} off orthonormal"
            raise InputError(f"cam_from_world[{first}] {why}, expected a rotation")
    return read_only(found)


def _world_directions(view: Int, bearing: Float, cam_from_world: Float) -> Float:
    """``cam_from_world[view].T @ bearing``, a block of rows at a time to keep the temporaries small."""
    turned = np.empty_like(bearing)
    block = 1 << 16
    for begin in range(0, len(view), block):
        rows = slice(begin, begin + block)
        if bearing.shape[1] == 2:
            angle = cam_from_world[view[rows]]
            cos, sin = np.cos(angle), np.sin(angle)
            x, y = bearing[rows, 0], bearing[rows, 1]
            turned[rows, 0], turned[rows, 1] = cos * x - sin * y, sin * x + cos * y
        else:
            turned[rows] = np.einsum("nkc,nk->nc", cam_from_world[view[rows]], bearing[rows])
    return turned


def _numbers(name: str, values: npt.ArrayLike) -> Float:
    """Copy to float64 in C order."""
    try:
        array = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} cannot be read as an array of numbers ({error})") from None
    return array


def _indices(name: str, values: npt.ArrayLike, expected: int | None = None) -> Int:
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} cannot be read as an array of indices ({error})") from None
    if array.ndim != 1:
        raise InputError(f"{name} has shape {array.shape}, expected one index an observation")
    if expected is not None and len(array) != expected:
        raise InputError(f"{name} has {len(array)} entries, but there are {expected} observations")
    if len(array) == 0:
        return np.empty(0, dtype=np.int32)
    if array.dtype.kind == "O":
        # a column with gaps (pandas' nullable integers) arrives as objects: let each entry speak for itself
        array = _numbers(name, array)
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name} holds {array.dtype} values, expected whole numbers (names go to {name}_names)")
    if array.dtype.kind == "f":
        whole = np.isfinite(array) & (array == np.floor(array))
        if not whole.all():
            first = _first(~whole)
            raise InputError(f"{name}[{first}] is {array[first]}, expected a whole number")
    outside = (array < 0) | (array >= MAX_COUNT)
    if outside.any():
        first = _first(outside)
        raise InputError(f"{name}[{first}] is {array[first]}, expected an index from 0 to {MAX_COUNT - 1}")
    return array.astype(np.int32)


def _unit_vectors(values: npt.ArrayLike, expected: int) -> Float:
    bearing = _numbers("bearing", values)
    if bearing.ndim != 2 or bearing.shape[1] not in (2, 3):
        raise InputError(f"bearing has shape {bearing.shape}, expected ({expected}, 2) or ({expected}, 3)")
    if len(bearing) != expected:
        raise InputError(f"bearing has {len(bearing)} entries, but there are {expected} observations")
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.sqrt(np.einsum("nc,nc->n", bearing, bearing))
        wrong = ~(np.abs(length - 1.0) <= UNIT_TOLERANCE)
    if wrong.any():
        first = _first(wrong)
        found = "is not finite" if not np.isfinite(bearing[first]).all() else f"has length {length[first]:.9g}"
        raise InputError(f"bearing[{first}] {found}, expected a unit vector")
    return bearing


def _sigmas(values: npt.ArrayLike, n: int) -> Float:
    sigma = _numbers("sigma_rad", values)
    if sigma.ndim == 0:
        sigma = np.full(n, float(sigma))
    if sigma.shape != (n,):
        raise InputError(f"sigma_rad has shape {sigma.shape}, expected one number or ({n},)")
    wrong = ~(np.isfinite(sigma) & (sigma > 0.0))
    if wrong.any():
        first = _first(wrong)
        raise InputError(f"sigma_rad[{first}] is {sigma[first]}, expected a positive finite number")
    return sigma


def _times(values: npt.ArrayLike, n_views: int) -> Float:
    time_s = _numbers("time_s", values)
    if time_s.shape != (n_views,):
        raise InputError(f"time_s has shape {time_s.shape}, expected one time a view, ({n_views},)")
    if np.isinf(time_s).any():
        raise InputError(
            f"time_s[{_first(np.asarray(np.isinf(time_s)))}] is infinite, expected seconds, or NaN where unknown"
        )
    return time_s


def _names(argument: str, names: Sequence[str] | None) -> tuple[str, ...] | None:
    if names is None:
        return None
    if isinstance(names, str):
        raise InputError(f"{argument} is one text, expected a sequence of names")
    table = tuple(names)
    for position, name in enumerate(table):
        if not isinstance(name, str):
            raise InputError(f"{argument}[{position}] is a {type(name).__name__}, expected text")
    if len(set(table)) != len(table):
        seen: set[str] = set()
        for position, name in enumerate(table):
            if name in seen:
                raise InputError(f"{argument}[{position}] is {name!r} again, expected each name once")
            seen.add(name)
    return table


def _count(argument: str, ids_name: str, wanted: int | None, ids: Int, names: tuple[str, ...] | None) -> int:
    largest = int(ids.max())
    if wanted is None:
        wanted = len(names) if names is not None else largest + 1
    if isinstance(wanted, bool) or not isinstance(wanted, int | np.integer) or not 0 < wanted <= MAX_COUNT:
        raise InputError(f"{argument} is {wanted!r}, expected a whole number from 1 to {MAX_COUNT}")
    if names is not None and len(names) != wanted:
        raise InputError(f"{ids_name}_names has {len(names)} entries, but {argument} is {wanted}")
    if largest >= wanted:
        raise InputError(f"{ids_name}[{_first(ids >= wanted)}] is beyond the {wanted} {ids_name}s there are")
    return int(wanted)


def _first(wrong: npt.NDArray[np.bool_]) -> int:
    return int(np.argmax(wrong))


def _choice(name: str, value: object, allowed: tuple[object, ...]) -> None:
    if not any(value == option and type(value) is type(option) for option in allowed):
        raise InputError(f"{name} is {value!r}, expected one of {', '.join(repr(option) for option in allowed)}")


def _at_least_one(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise InputError(f"{name} is {value!r}, expected a whole number of at least 1")


def _control_key(kind: str, key: object) -> str | int:
    if isinstance(key, str):
        return key
    if isinstance(key, int | np.integer) and not isinstance(key, bool):
        return int(key)
    raise InputError(f"control.{kind} has the key {key!r}, expected a name or an index")


def _position(name: str, values: npt.ArrayLike) -> tuple[float, ...]:
    position = _numbers(name, values)
    if position.shape not in ((2,), (3,)) or not np.isfinite(position).all():
        raise InputError(f"{name} is {np.asarray(values).tolist()!r}, expected 2 or 3 finite coordinates")
    return tuple(position.tolist())
