"""Trials: small random worlds, seen with the paper's errors, solved by several solvers and compared with the truth.

A trial is one world of the kind ``box``: views and points uniform in ``[-1, 1]^d``, every view sees every point, and
azimuth and elevation of each sighting are off by errors uniform in ``[-eps, eps]``. Any of them can be made again::

    panopath.simulate("box", n_views=m, n_points=n, seed=seed, dimension=d, angle_error_rad=eps)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.model import Float, PositionOptions, read_only

Int64 = npt.NDArray[np.int64]

#: The paper's algorithm as printed (the plane has one stage); the same equations, all coordinates at once, under a
#: gauge that prefers no point; and the default.
SOLVERS: Mapping[str, PositionOptions] = MappingProxyType(
    {
        "printed": PositionOptions(method="linear", linear_form="two_stage", linear_gauge="paper"),
        "linear": PositionOptions(method="linear"),
        "robust": PositionOptions(),
    }
)
#: How each is called in statements and pictures.
SOLVER_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "printed": "linear as printed (two stages, x2 = 1)",
        "linear": "linear, joint, no point preferred",
        "robust": "robust (angular optimum)",
    }
)


@dataclass(frozen=True, eq=False)
class Trials:
    """What came out of trials, a row a trial."""

    dimension: int
    #: (T,) numbers of views and points, seeds, and errors of the angles.
    n_views: Int64
    n_points: Int64
    seed: Int64
    angle_error_rad: Float
    solvers: tuple[str, ...]
    #: (T, solvers) each: ``status``, ``n_missing``, ``all_max`` and so on. The first word is the frame: ``all`` is a
    #: fit by shift and scale over all views and points, ``views`` over the views alone, ``paper`` has the first point
    #: at the origin and the second at x = 1. The rest is ``max``, ``mean_abs``, ``mean``, ``rms``, ``camera_rms``,
    #: ``point_rms``, ``point_coordinate_max``; of the scene filmed again ``refilm_max_rad``, ``refilm_rms_rad`` to the
    #: true bearings, and ``refilm_residual_max_rad``, ``refilm_residual_rms_rad`` to the measured ones.
    columns: Mapping[str, npt.NDArray[Any]]

    def __len__(self) -> int:
        return len(self.seed)

    def of(self, solver: str, column: str) -> npt.NDArray[Any]:
        """Give a column (T,) of one solver."""
        return np.asarray(self.columns[column][:, self.solvers.index(solver)])

    def rows(self, columns: Sequence[str]) -> dict[str, list[Any]]:
        """Give columns of a table with a row a trial, those of the solvers side by side."""
        table: dict[str, list[Any]] = {
            "dimension": [self.dimension] * len(self),
            "views": self.n_views.tolist(),
            "points": self.n_points.tolist(),
            "angle_error_rad": self.angle_error_rad.tolist(),
            "seed": self.seed.tolist(),
        }
        for solver in self.solvers:
            for column in columns:
                table[f"{solver}_{column}"] = self.of(solver, column).tolist()
        return table


def median(values: npt.ArrayLike) -> float:
    """Median of what is finite; NaN of nothing."""
    finite = _finite(values)
    return float(np.median(finite)) if len(finite) else float("nan")


def mean(values: npt.ArrayLike) -> float:
    """Mean of what is finite; NaN of nothing."""
    finite = _finite(values)
    return float(finite.mean()) if len(finite) else float("nan")


def rms(values: npt.ArrayLike) -> float:
    """Root mean square of what is finite; NaN of nothing."""
    return float(np.sqrt(mean(np.square(np.asarray(values, dtype=np.float64)))))


def largest(values: npt.ArrayLike) -> float:
    """Largest of what is finite; NaN of nothing."""
    finite = _finite(values)
    return float(finite.max()) if len(finite) else float("nan")


def _finite(values: npt.ArrayLike) -> Float:
    array = np.asarray(values, dtype=np.float64)
    return np.asarray(array[np.isfinite(array)])


def trial_seeds(seed: int, key: Sequence[int], count: int) -> Int64:
    """Draw seeds (count,) for the trials that a key names; more of them begin with the same ones."""
    return np.random.SeedSequence([seed, *key]).generate_state(count).astype(np.int64)


def run_trials(
    dimension: int,
    n_views: npt.ArrayLike,
    n_points: npt.ArrayLike,
    seed: npt.ArrayLike,
    angle_error_rad: npt.ArrayLike,
    *,
    solvers: Sequence[str] = tuple(SOLVERS),
    threads: int = 0,
) -> Trials:
    """Run trials in one call of the core.

    Parameters
    ----------
    dimension
        2 or 3.
    n_views, n_points, seed, angle_error_rad
        (T,) each, or one number for all.
    solvers
        Names of ``SOLVERS``.
    threads
        0: one a core. The answers are the same on any number.

    Raises
    ------
    InputError
        Naming the argument that cannot be used, or the trial.
    """
    if unknown := [name for name in solvers if name not in SOLVERS]:
        raise InputError(f"solvers names {unknown[0]!r}, expected {', '.join(SOLVERS)}")
    if threads < 0:
        raise InputError(f"threads is {threads!r}, expected 0 (one a core) or more")
    counts = [np.asarray(values) for values in (n_views, n_points, seed)]
    for name, values in zip(("n_views", "n_points", "seed"), counts, strict=True):
        if values.dtype.kind not in "iu":
            raise InputError(f"{name} has type {values.dtype}, expected whole numbers")
    try:
        broadcast = np.broadcast_arrays(*counts, np.asarray(angle_error_rad, dtype=np.float64))
    except ValueError as error:
        raise InputError(f"n_views, n_points, seed and angle_error_rad do not fit together ({error})") from None
    views, points, seeds = (np.array(np.atleast_1d(values), dtype=np.int64) for values in broadcast[:3])
    errors = np.array(np.atleast_1d(broadcast[3]), dtype=np.float64)
    if not len(seeds):
        raise InputError("seed is empty, expected at least one trial")
    if errors.ndim != 1:
        raise InputError(f"n_views, n_points, seed and angle_error_rad have {errors.ndim} axes, expected one")
    try:
        found = _core.run_trials(
            dimension, (views, points, seeds, errors), [_method(name) for name in solvers], threads or None
        )
    except ValueError as error:
        raise InputError(str(error)) from None
    columns = {name: np.asarray(values).reshape(len(seeds), len(solvers)) for name, values in found.items()}
    return Trials(
        dimension=dimension,
        n_views=read_only(views),
        n_points=read_only(points),
        seed=read_only(seeds),
        angle_error_rad=read_only(errors),
        solvers=tuple(solvers),
        columns=MappingProxyType(columns),
    )


def _method(solver: str) -> dict[str, Any]:
    options = SOLVERS[solver]
    return {name: getattr(options, name) for name in ("method", "linear_form", "vertical_axis", "linear_gauge")}
