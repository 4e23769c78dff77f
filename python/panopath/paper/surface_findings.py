"""What the trials of :mod:`panopath.paper.surface` say about the statements of the paper."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from panopath.model import Bool, Float
from panopath.paper.experiment import Statement, Verdict
from panopath.paper.trials import SOLVER_NAMES, largest, median

#: Exponents are fitted from here on, past the decay.
FIT_FROM = 10
#: Exponents nearer to each other than this are equal, and nearer to zero than this none.
_EXPONENT_NOISE = 0.1


@dataclass(frozen=True, eq=False)
class Surface:
    """What one solver made of all sizes.

    Arrays (views, points, worlds), the numbers counted from 1; NaN where there is no answer.
    """

    max: Float
    mean_abs: Float
    paper_max: Float
    refilm_max_rad: Float
    #: The solver itself says that the world is determined.
    certain: Bool

    @property
    def shape(self) -> tuple[int, int]:
        """Largest numbers of views and points."""
        return self.max.shape[0], self.max.shape[1]

    def n_answers(self) -> Float:
        """Worlds (views, points) that have an answer."""
        return np.asarray(np.isfinite(self.max).sum(axis=2))

    def is_doubtful(self) -> Bool:
        """Sizes (views, points) with answers that the solver itself calls ambiguous, most of them."""
        return np.asarray((self.n_answers() > 0) & (2 * self.certain.sum(axis=2) < self.n_answers()))

    def mean(self, name: str) -> Float:
        """Average (views, points) over worlds, of those that have an answer."""
        return self._over_worlds(np.nanmean, name)

    def median(self, name: str) -> Float:
        """Median (views, points) over worlds."""
        return self._over_worlds(np.nanmedian, name)

    def _over_worlds(self, reduce: Callable[..., Float], name: str) -> Float:
        values: Float = getattr(self, name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of sizes without any answer
            return np.asarray(reduce(values, axis=2))


def exponent(values: Float, start: int = FIT_FROM) -> float:
    """Exponent of values (K,) that belong to 1, 2, ... K, from ``start`` on; NaN of too few."""
    counts = np.arange(1, len(values) + 1)
    use = (counts >= start) & np.isfinite(values) & (values > 0.0)
    return float(np.polyfit(np.log(counts[use]), np.log(values[use]), 1)[0]) if use.sum() > 1 else float("nan")


def exponents(cells: Float) -> tuple[float, float, float]:
    """Exponents of cells (views, points) in the points, in the views, and in both together; medians past the decay."""
    in_points = median([exponent(row) for row in cells[FIT_FROM - 1 :]])
    in_views = median([exponent(column) for column in cells.T[FIT_FROM - 1 :]])
    return in_points, in_views, exponent(np.diagonal(cells))


def surface_statements(surfaces: Mapping[str, Surface], angle_error_rad: float) -> tuple[Statement, ...]:
    """Compare what the paper says of the numbers of views and points with the trials."""
    return (
        _decay(surfaces, angle_error_rad),
        _averages(surfaces),
        _growth(surfaces),
        _views_against_points(surfaces),
        _average_error(surfaces),
        _refilmed(surfaces, angle_error_rad),
    )


def _each(surfaces: Mapping[str, Surface], tell: Callable[[Surface], str]) -> str:
    return "; ".join(f"{SOLVER_NAMES[solver]}: {tell(surface)}" for solver, surface in surfaces.items()) + "."


def _verdict(agrees: list[bool]) -> Verdict:
    if all(agrees):
        return Verdict.AGREES
    return Verdict.IN_PART if any(agrees) else Verdict.CORRECTED


def _decay(surfaces: Mapping[str, Surface], angle_error_rad: float) -> Statement:
    sizes = [k for k in (2, 3, 4, 6, 10, 20, 50) if k <= min(next(iter(surfaces.values())).shape)]

    def tell(surface: Surface) -> str:
        cells = surface.median("max")
        errors = ", ".join(f"{cells[k - 1, k - 1] / angle_error_rad:.3g} ({k} x {k})" for k in sizes)
        without, doubtful = int((surface.n_answers() == 0).sum()), int(surface.is_doubtful().sum())
        return f"{errors}; {without} sizes without any answer, {doubtful} mostly ambiguous"

    decays = []
    for surface in surfaces.values():
        cells = surface.median("max")
        smallest = np.concatenate((cells[1:2].ravel(), cells[2:, 1:2].ravel()))
        decays.append(bool(median(smallest) > 2.0 * median(cells[FIT_FROM - 1 :, FIT_FROM - 1 :])))
    return Statement(
        "8, figure 2",
        "A sharp decay for small n and m, where there are ambiguities.",
        "Median over worlds of the maximal error / eps, views x points, " + _each(surfaces, tell),
        _verdict(decays),
    )


def _averages(surfaces: Mapping[str, Surface]) -> Statement:
    def ratio(surface: Surface) -> Float:
        with np.errstate(invalid="ignore"):
            return np.asarray(surface.mean("max") / surface.median("max"))[FIT_FROM - 1 :, FIT_FROM - 1 :]

    return Statement(
        "8, figure 2",
        "The average over 30 worlds shows the error for each size.",
        f"Average over median of the worlds of a size, sizes from {FIT_FROM} x {FIT_FROM}, median and largest, "
        + _each(surfaces, lambda surface: f"{median(ratio(surface)):.2f} and {largest(ratio(surface)):.3g}")
        + " Where it is far above one the average shows a few worlds: those whose first two points hardly differ in x.",
        _verdict([median(ratio(surface)) < 1.2 for surface in surfaces.values()]),
    )


def _growth(surfaces: Mapping[str, Surface]) -> Statement:
    def tell(surface: Surface) -> str:
        return " | ".join(_three(surface.mean("max"), surface.median("max")))

    highest = [max(exponents(surface.mean("max"))) for surface in surfaces.values()]
    grows = highest[0] > _EXPONENT_NOISE
    return Statement(
        "8, figure 2",
        "Beyond the decay the error grows, linearly at most.",
        f"Exponent of the maximal error from {FIT_FROM} on, average (median) over worlds, with more points | with more "
        f"views | with more of both, {_each(surfaces, tell)} "
        + (
            "As printed it grows, linearly at most; without a preferred point it does not grow at all."
            if grows and max(highest[1:], default=0.0) <= _EXPONENT_NOISE
            else "Above 0 it grows."
        ),
        _verdict([_EXPONENT_NOISE < value <= 1.0 + _EXPONENT_NOISE for value in highest]),
    )


def _three(mean: Float, middle: Float) -> list[str]:
    return [f"{a:+.2f} ({b:+.2f})" for a, b in zip(exponents(mean), exponents(middle), strict=True)]


def _views_against_points(surfaces: Mapping[str, Surface]) -> Statement:
    def asymmetry(surface: Surface, name: str) -> float:
        """Error with more views than points, over that with the numbers exchanged."""
        cells = surface.median(name)
        rows, columns = np.tril_indices(min(cells.shape), -1)
        use = columns >= FIT_FROM - 1
        with np.errstate(invalid="ignore", divide="ignore"):
            return median(cells[rows[use], columns[use]] / cells[columns[use], rows[use]])

    def tell(surface: Surface) -> str:
        in_points, in_views, _ = exponents(surface.median("max"))
        paper_points, paper_views, _ = exponents(surface.median("paper_max"))
        return (
            f"{in_points:+.2f} and {in_views:+.2f}, ratio {asymmetry(surface, 'max'):.2f} | {paper_points:+.2f} and "
            f"{paper_views:+.2f}, ratio {asymmetry(surface, 'paper_max'):.2f}"
        )

    agrees = []
    for name in ("max", "paper_max"):
        for surface in surfaces.values():
            in_points, in_views, _ = exponents(surface.median(name))
            agrees.append(abs(in_views) > abs(in_points) + _EXPONENT_NOISE)
    return Statement(
        "8, figure 2",
        "The error changes more with more cameras than with more points.",
        "Oriented cameras and points may be exchanged: their equations are the same but for a sign. Only a gauge tied "
        "to points tells them apart. Exponents of the median maximal error in the points and in the views, and its "
        "ratio between m x n and n x m with more views than points, after a fit | in the paper's frame, "
        + _each(surfaces, tell),
        _verdict(agrees),
    )


def _average_error(surfaces: Mapping[str, Surface]) -> Statement:
    def tell(surface: Surface) -> str:
        average = ", ".join(f"{value:+.2f}" for value in exponents(surface.median("mean_abs")))
        most = ", ".join(f"{value:+.2f}" for value in exponents(surface.median("max")))
        return f"{average} | {most}"

    agrees = []
    for surface in surfaces.values():
        in_points, _, together = exponents(surface.median("mean_abs"))
        agrees.append(abs(in_points + 1.0) < 0.2 or abs(together + 1.0) < 0.2)
    return Statement(
        "8, remark 1",
        "The average error decreases like 1/n, because the maximal error is essentially independent of n.",
        "Exponent of the mean absolute error, with more points, more views, more of both | the same of the maximal "
        f"error; medians over worlds, from {FIT_FROM} on, {_each(surfaces, tell)} However many points there are, each "
        "is seen by the same cameras: only with more of both do all errors fall, like the root of either number.",
        _verdict(agrees),
    )


def _refilmed(surfaces: Mapping[str, Surface], angle_error_rad: float) -> Statement:
    def cells(surface: Surface) -> Float:
        return np.asarray(surface.median("refilm_max_rad")[FIT_FROM - 1 :, FIT_FROM - 1 :] / angle_error_rad)

    def tell(surface: Surface) -> str:
        rates = cells(surface)
        return f"{median(rates):.2f} and {largest(rates):.3g}"

    return Statement(
        "8, remark 2",
        "Filmed again, the scene shows errors of the order of the actual errors.",
        f"Largest angle to a true bearing / eps, median over worlds; of the sizes from {FIT_FROM} x {FIT_FROM} the "
        "median and the largest, " + _each(surfaces, tell),
        _verdict([largest(cells(surface)) < 10.0 for surface in surfaces.values()]),
    )
