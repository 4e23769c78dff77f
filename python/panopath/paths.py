"""Bodies that move: what paths may look like, and the paths that were found.

The path of a track is ``P(t) = sum_l B_l(t) p_l`` with functions of time ``B_l`` that are chosen, and vectors ``p_l``
that are found (Knill and Ramirez-Herran 2007, section 6). Times are those of the views, in seconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int32]
Bool = npt.NDArray[np.bool_]

#: Most functions of one path.
MAX_FUNCTIONS = 32


@dataclass(frozen=True)
class Static:
    """A point at rest."""

    @property
    def n_functions(self) -> int:
        """Vectors that describe it."""
        return 1


@dataclass(frozen=True)
class Taylor:
    """A polynomial: ``B_l(t) = ((t - origin_s) / unit_s)^l``, l = 0 to order."""

    order: int
    #: Time zero and unit of the powers; None: the middle and half of the time that the track was seen.
    origin_s: float | None = None
    unit_s: float | None = None

    def __post_init__(self) -> None:
        _order("taylor", self.order, 0)
        if self.unit_s is not None and not (np.isfinite(self.unit_s) and self.unit_s > 0.0):
            raise InputError(f"unit_s is {self.unit_s!r}, expected a positive number of seconds")
        if self.origin_s is not None and not np.isfinite(self.origin_s):
            raise InputError(f"origin_s is {self.origin_s!r}, expected a finite time")

    @property
    def n_functions(self) -> int:
        """Vectors that describe a path."""
        return self.order + 1


@dataclass(frozen=True)
class Fourier:
    """Harmonics: 1, ``cos(l omega t)``, ``sin(l omega t)``, l = 1 to order."""

    order: int
    #: Angular frequency, radians a second; None: it is found.
    omega_rad_s: float | None = None

    def __post_init__(self) -> None:
        _order("fourier", self.order, 1)
        if self.omega_rad_s is not None and not (np.isfinite(self.omega_rad_s) and self.omega_rad_s > 0.0):
            raise InputError(f"omega_rad_s is {self.omega_rad_s!r}, expected a positive number of radians a second")

    @property
    def n_functions(self) -> int:
        """Vectors that describe a path."""
        return 2 * self.order + 1


@dataclass(frozen=True)
class Spline:
    """A B-spline (de Boor 1978, chapter IX) whose pieces end at ``knots_s``, the outer ones included."""

    knots_s: tuple[float, ...]
    degree: int = 3

    def __post_init__(self) -> None:
        _order("degree of a spline", self.degree, 1)
        knots = tuple(float(t) for t in self.knots_s)
        if len(knots) < 2 or not np.isfinite(knots).all() or not (np.diff(knots) > 0.0).all():
            raise InputError(f"knots_s is {self.knots_s!r}, expected at least two finite times that ascend")
        if len(knots) - 1 + self.degree > MAX_FUNCTIONS:
            raise InputError(f"knots_s has {len(knots)} entries, expected at most {MAX_FUNCTIONS - self.degree + 1}")
        object.__setattr__(self, "knots_s", knots)

    @property
    def n_functions(self) -> int:
        """Vectors that describe a path."""
        return len(self.knots_s) - 1 + self.degree


PathModel = Static | Taylor | Fourier | Spline


def _order(name: str, order: object, least: int) -> None:
    most = MAX_FUNCTIONS // 2 - 1
    if isinstance(order, bool) or not isinstance(order, int) or not least <= order <= most:
        raise InputError(f"the order of {name} is {order!r}, expected a whole number from {least} to {most}")


@dataclass(frozen=True)
class Motion:
    """How tracks may move, for :func:`panopath.solve_positions`."""

    #: The form of all paths that are not named: one for all, or ``auto``: each track gets the simplest that it fits.
    default: PathModel | Literal["auto"] = "auto"
    #: Forms of single tracks, by name or index.
    tracks: Mapping[str | int, PathModel | Literal["auto"]] = field(default_factory=dict)
    #: Tracks that are known to be at rest, by name or index.
    static: Sequence[str | int] = ()
    #: Forms that ``auto`` chooses from, beside rest.
    candidates: tuple[PathModel, ...] = (Taylor(1), Taylor(2), Taylor(3))
    #: Whether all tracks whose angular frequency is to be found share it.
    common_omega: bool = False
    #: Whether to find tracks that move as one rigid body.
    group: bool = False
    #: Whether to seek orientations too, from those given on.
    refine_orientations: bool = False
    #: Whether to find how well each path is known.
    covariance: bool = True

    def __post_init__(self) -> None:
        for name, value in (("default", self.default), *((f"tracks[{k!r}]", v) for k, v in self.tracks.items())):
            if value != "auto" and not isinstance(value, PathModel):
                raise InputError(f'motion.{name} is {value!r}, expected "auto" or a form of path such as Taylor(1)')
        if not self.candidates or not all(isinstance(one, PathModel) for one in self.candidates):
            raise InputError(f"motion.candidates is {self.candidates!r}, expected forms of path such as Taylor(1)")
        if isinstance(self.static, str):
            raise InputError("motion.static is one text, expected a sequence of names or indices")
        object.__setattr__(self, "tracks", MappingProxyType(dict(self.tracks)))
        object.__setattr__(self, "static", tuple(self.static))


class PathVerdict(StrEnum):
    """What was found of a track."""

    STATIC = "static"
    MOVING = "moving"
    #: The camera moved in the form of the path itself: path and camera can be drawn together with no bearing changing.
    IMITATED = "imitated"
    #: It stood before or behind another track in every view.
    HIDDEN = "hidden"
    #: Too little was seen of it, or nothing that fits any form.
    UNDETERMINED = "undetermined"


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths of all tracks of a scene, flat. What is not determined is NaN; the arrays are read-only."""

    #: The form of each track's path, every time and frequency filled in.
    models: tuple[PathModel, ...]
    #: (n_tracks + 1,) where the coefficients of each track begin.
    starts: npt.NDArray[np.int64]
    #: (sum of n_functions, d) vectors ``p_l``.
    coefficients: Float
    #: One (K d, K d) covariance for each track, coefficient by coefficient, in the gauge of the scene; None: not asked.
    covariances: tuple[Float, ...] | None
    #: (n_tracks, 2) times of the first and last observation in use, seconds.
    seen_s: Float
    #: What was found of each track.
    verdicts: tuple[PathVerdict, ...]
    #: (n_tracks,) int32, the track that each one hides behind, -1 = none.
    hidden_by: Int
    #: (n_tracks,) int32, the rigid body that each track belongs to, -1 = none.
    body: Int
    #: What keeps the common motion of everything from being free, in words.
    assumption: str = ""
    #: Freedoms that no observation and no assumption takes away, in words.
    freedoms: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, kind in (("starts", np.int64), ("coefficients", np.float64), ("seen_s", np.float64)):
            object.__setattr__(self, name, _read_only(np.ascontiguousarray(getattr(self, name), dtype=kind)))
        for name in ("hidden_by", "body"):
            object.__setattr__(self, name, _read_only(np.ascontiguousarray(getattr(self, name), dtype=np.int32)))
        n = len(self.models)
        wanted = {"starts": (n + 1,), "seen_s": (n, 2), "hidden_by": (n,), "body": (n,)}
        for name, shape in wanted.items():
            found = getattr(self, name).shape
            if found != shape:
                raise InputError(f"{name} has shape {found}, expected {shape}")
        if len(self.verdicts) != n:
            raise InputError(f"verdicts has {len(self.verdicts)} entries, expected {n}")
        counts = [one.n_functions for one in self.models]
        if np.diff(self.starts).tolist() != counts or (n and self.starts[0] != 0):
            raise InputError("starts does not agree with the numbers of functions of the models")
        if self.coefficients.ndim != 2 or self.coefficients.shape[0] != self.starts[-1]:
            raise InputError(f"coefficients has shape {self.coefficients.shape}, expected ({self.starts[-1]}, d)")
        if self.covariances is not None and len(self.covariances) != n:
            raise InputError(f"covariances has {len(self.covariances)} entries, expected {n}")

    def __len__(self) -> int:
        return len(self.models)

    def __repr__(self) -> str:
        return f"Paths({int(self.moving.sum())} of {len(self)} tracks moving, d = {self.d})"

    @property
    def d(self) -> int:
        """2 in the plane, 3 in space."""
        return int(self.coefficients.shape[1])

    @property
    def moving(self) -> Bool:
        """(n_tracks,) whether each track was found to move."""
        return np.array([one is PathVerdict.MOVING for one in self.verdicts], dtype=np.bool_)

    def position(self, track: int, time_s: npt.ArrayLike, *, outside: bool = False) -> Float:
        """Positions (n, d) of a track at times (n,); NaN before and after it was seen, unless ``outside``."""
        return self._combined(track, time_s, 0, outside)

    def velocity(self, track: int, time_s: npt.ArrayLike, *, outside: bool = False) -> Float:
        """Velocities (n, d) of a track at times (n,), in units of the scene a second."""
        return self._combined(track, time_s, 1, outside)

    def position_covariance(self, track: int, time_s: npt.ArrayLike) -> Float:
        """Covariances (n, d, d) of the positions of a track at times (n,)."""
        return self._covariance(track, time_s, 0)

    def velocity_covariance(self, track: int, time_s: npt.ArrayLike) -> Float:
        """Covariances (n, d, d) of the velocities of a track at times (n,)."""
        return self._covariance(track, time_s, 1)

    def at(self, time_s: float) -> Float:
        """Positions (n_tracks, d) of all tracks at one time: NaN where a mover was not being seen; rest is for ever."""
        found = np.full((len(self), self.d), np.nan)
        still = np.array([isinstance(one, Static) for one in self.models], dtype=np.bool_)
        found[still] = self.coefficients[self.starts[:-1][still]]
        inside = (self.seen_s[:, 0] <= time_s) & (time_s <= self.seen_s[:, 1])
        for track in np.flatnonzero(~still & inside).tolist():
            found[track] = self.position(track, [time_s])[0]
        return found

    def transformed(
        self, scale: float, rotation: npt.ArrayLike, shift: npt.ArrayLike, where: npt.ArrayLike | None = None
    ) -> Paths:
        """Paths in another frame, ``x -> scale * rotation @ x + shift``; only those ``where`` (n_tracks,) holds."""
        turn, move = np.asarray(rotation, dtype=np.float64), np.asarray(shift, dtype=np.float64)
        chosen = np.ones(len(self), dtype=np.bool_) if where is None else np.asarray(where, dtype=np.bool_)
        moved = self.coefficients.copy()
        covariances = None if self.covariances is None else list(self.covariances)
        for track in np.flatnonzero(chosen).tolist():
            rows = slice(int(self.starts[track]), int(self.starts[track + 1]))
            moved[rows] = scale * moved[rows] @ turn.T
            # every form can hold a constant: its functions add up to one, or begin with one
            last = rows.stop if isinstance(self.models[track], Spline) else rows.start + 1
            moved[rows.start : last] += move
            if covariances is not None:
                covariances[track] = _turned(covariances[track], scale * turn)
        return replace(self, coefficients=moved, covariances=None if covariances is None else tuple(covariances))

    def _combined(self, track: int, time_s: npt.ArrayLike, derivative: int, outside: bool) -> Float:
        times = np.asarray(time_s, dtype=np.float64).reshape(-1)
        rows = self.coefficients[self.starts[track] : self.starts[track + 1]]
        found = path_functions(self.models[track], times, derivative) @ rows
        if not outside and not isinstance(self.models[track], Static):
            first, last = self.seen_s[track]
            found[~((times >= first) & (times <= last))] = np.nan
        return np.asarray(found)

    def _covariance(self, track: int, time_s: npt.ArrayLike, derivative: int) -> Float:
        if self.covariances is None:
            raise InputError("these paths were made without covariances")
        times = np.asarray(time_s, dtype=np.float64).reshape(-1)
        functions, d = path_functions(self.models[track], times, derivative), self.d
        k = functions.shape[1]
        blocks = self.covariances[track].reshape(k, d, k, d)
        return np.asarray(np.einsum("na,aibj,nb->nij", functions, blocks, functions))


def path_functions(model: PathModel, time_s: npt.ArrayLike, derivative: int = 0) -> Float:
    """Values (n, n_functions) of the functions of a form of path at times (n,), or their derivatives in time."""
    times = np.ascontiguousarray(time_s, dtype=np.float64).reshape(-1)
    return np.asarray(_core.path_functions(core_model(model), times, derivative))


def core_model(model: PathModel) -> tuple[str, int, list[float]]:
    """Name, order and numbers of a form of path, as the core takes it; NaN is what is to be filled in."""

    def number(value: float | None) -> float:
        return float("nan") if value is None else float(value)

    if isinstance(model, Taylor):
        return "taylor", model.order, [number(model.origin_s), number(model.unit_s)]
    if isinstance(model, Fourier):
        return "fourier", model.order, [number(model.omega_rad_s)]
    if isinstance(model, Spline):
        return "spline", model.degree, list(model.knots_s)
    return "static", 0, []


def model_of(kind: str, order: int, numbers: Sequence[float]) -> PathModel:
    """Make a form of path of its name, order and numbers; the inverse of :func:`core_model`."""
    if kind == "taylor":
        return Taylor(order, *(None if np.isnan(x) else float(x) for x in numbers))
    if kind == "fourier":
        return Fourier(order, None if np.isnan(numbers[0]) else float(numbers[0]))
    if kind == "spline":
        return Spline(tuple(numbers), order)
    return Static()


def _turned(covariance: Float, matrix: Float) -> Float:
    """Covariance of vectors that are each multiplied by a matrix."""
    k = len(covariance) // len(matrix)
    every = np.kron(np.eye(k), matrix)
    return _read_only(every @ covariance @ every.T)


def _read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array.setflags(write=False)
    return array
