"""What the trials of :mod:`panopath.paper.noise` say about the statements of the paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.model import Float
from panopath.paper.experiment import Statement, Verdict
from panopath.paper.noise_bias import Bias
from panopath.paper.trials import SOLVER_NAMES, SOLVERS, Trials, largest, median

#: Dimension, number of views, number of points.
Key = tuple[int, int, int]
_Runs = Mapping[Key, "Runs"]

#: An error is in proportion to the noise as long as it is this near to what the smallest noise says.
LINEAR_WITHIN = 0.1
#: Errors that the paper's exponents are fitted to.
_FIT_FROM_RAD = 0.01
#: A bias below this share of the error is lost in it.
_SMALL_SHARE = 0.3
#: Rms angle by which bearings are off, in units of eps: each angle has the variance eps^2 / 3, and an azimuth counts
#: cos^2 of the elevation, 2/3 on average over the sphere.
_NOISE_RMS = ((1.0 + 2.0 / 3.0) / 3.0) ** 0.5


@dataclass(frozen=True, eq=False)
class Runs:
    """Trials of one dimension and size, errors ascending."""

    trials: Trials
    #: (T,) least rms error that the noise allows.
    bound_rms: Float
    #: (T,) difference in x between the first two points, which the paper's frame makes one.
    paper_unit: Float

    @property
    def levels_rad(self) -> Float:
        """The errors of the angles (L,), each once."""
        return np.unique(self.trials.angle_error_rad)

    def by_level(self, values: npt.NDArray[Any]) -> Float:
        """Rows (L, worlds) of values (T,)."""
        return np.asarray(values, dtype=np.float64).reshape(len(self.levels_rad), -1)

    def curve(self, solver: str, column: str) -> Float:
        """Median (L,) over worlds."""
        return np.array([median(row) for row in self.by_level(self.trials.of(solver, column))])

    def bound_curve(self) -> Float:
        """Median (L,) over worlds of the bound."""
        return np.array([median(row) for row in self.by_level(self.bound_rms)])

    def slopes(self, solver: str, column: str) -> Float:
        """Exponents (L - 1,) between neighbouring errors, medians over worlds that stay the same."""
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.diff(np.log(self.by_level(self.trials.of(solver, column))), axis=0)
        return np.array([median(row) for row in steps]) / np.diff(np.log(self.levels_rad))

    def linear_until_rad(self, solver: str, column: str) -> float:
        """Largest error up to which a column stays in proportion to it, median over worlds; NaN: nowhere."""
        rate = self.by_level(self.trials.of(solver, column)) / self.levels_rad[:, None]
        relative = np.array([median(row / rate[0]) for row in rate])
        wrong = np.flatnonzero(~(np.abs(relative - 1.0) <= LINEAR_WITHIN))
        last = (wrong[0] if len(wrong) else len(relative)) - 1
        return float(self.levels_rad[last]) if last >= 0 else float("nan")

    def exponent(self, solver: str, column: str) -> float:
        """Exponent of a straight line through the medians in log-log, from 0.01 on."""
        levels, curve = self.levels_rad, self.curve(solver, column)
        use = (levels >= _FIT_FROM_RAD) & np.isfinite(curve) & (curve > 0.0)
        return float(np.polyfit(np.log(levels[use]), np.log(curve[use]), 1)[0]) if use.sum() > 1 else float("nan")

    def rates(self, solver: str, column: str) -> Float:
        """Give a column over the error of the angles, where there is one."""
        noisy = self.trials.angle_error_rad > 0.0
        return np.asarray(self.trials.of(solver, column)[noisy] / self.trials.angle_error_rad[noisy])

    def unit_correlation(self, solver: str) -> float:
        """Rank correlation of the maximal error over eps with the unit of the paper's frame, from 0.01 on."""
        rate = self.trials.of(solver, "all_max") / np.maximum(self.trials.angle_error_rad, _FIT_FROM_RAD)
        use = (self.trials.angle_error_rad >= _FIT_FROM_RAD) & np.isfinite(rate)
        if use.sum() < 3:
            return float("nan")
        ranks = [np.argsort(np.argsort(values[use], kind="stable")) for values in (rate, self.paper_unit)]
        return float(np.asarray(np.corrcoef(ranks))[0, 1])

    def over_bound(self, solver: str) -> float:
        """Rms error over the least that the noise allows, median over noisy trials."""
        noisy = self.trials.angle_error_rad > 0.0
        return median(self.trials.of(solver, "all_rms")[noisy] / self.bound_rms[noisy])


def noise_statements(fresh: _Runs, growth: _Runs, bias: Sequence[Bias]) -> tuple[Statement, ...]:
    """Compare what the paper says of noise with the trials."""
    return (
        _exact(fresh),
        _corollary(growth, fresh),
        _figure(fresh),
        _constant(fresh),
        _through_the_data(bias),
        _measures(fresh),
        _refilmed(growth),
    )


def _each_solver(tell: Callable[[str], str]) -> str:
    return "; ".join(f"{SOLVER_NAMES[solver]}: {tell(solver)}" for solver in SOLVERS) + "."


def _range(values: Sequence[float], form: str = ".2f") -> str:
    low, high = f"{min(values):{form}}", f"{max(values):{form}}"
    return low if low == high else f"{low} to {high}"


def _sizes(runs: _Runs) -> str:
    return ", ".join(f"({m}, {n})" for d, m, n in runs if d == 3)


def _verdict(agrees: Mapping[str, bool]) -> Verdict:
    """Every solver, some, or none."""
    if all(agrees.values()):
        return Verdict.AGREES
    return Verdict.IN_PART if any(agrees.values()) else Verdict.CORRECTED


def _exact(fresh: _Runs) -> Statement:
    errors = {
        solver: largest(
            np.concatenate(
                [runs.trials.of(solver, "all_max")[runs.trials.angle_error_rad == 0.0] for runs in fresh.values()]
            )
        )
        for solver in SOLVERS
    }
    return Statement(
        "8, proof",
        "Without error there is a unique solution, the scene itself.",
        "Largest error without noise, " + _each_solver(lambda solver: f"{errors[solver]:.1g}"),
        _verdict({solver: error < 1e-6 for solver, error in errors.items()}),
    )


def _corollary(growth: _Runs, fresh: _Runs) -> Statement:
    held = [runs.unit_correlation("printed") for runs in fresh.values()]
    free = [runs.unit_correlation("robust") for runs in fresh.values()]
    until = {s: [runs.linear_until_rad(s, "all_max") for runs in growth.values()] for s in SOLVERS}
    slopes = {s: np.array([runs.slopes(s, "all_max") for runs in growth.values()]) for s in SOLVERS}
    whole = max(float(runs.levels_rad[-1]) for runs in growth.values())

    def tell(solver: str) -> str:
        first, last = slopes[solver][:, 0].tolist(), slopes[solver][:, -1].tolist()
        return f"{_range(first)} at 1e-4, {_range(last)} at 0.1, a line up to eps = {_range(until[solver], '.2g')}"

    return Statement(
        "8, corollary",
        "The maximal error depends linearly on the error of the angles, for small errors.",
        f"Local exponent over the sizes {_sizes(growth)} in space and plane, and how far the error is within "
        f"{LINEAR_WITHIN:.0%} of a line, {_each_solver(tell)} The gauge makes the difference: with one coordinate of "
        "one point held at 1 noise shrinks all else, the more the smaller that coordinate truly is. Rank correlation "
        f"of the error with it: {_range(held)} as printed, {_range(free)} robust.",
        _verdict({solver: min(ends) >= whole for solver, ends in until.items()}),
    )


def _figure(fresh: _Runs) -> Statement:
    exponents = {s: [runs.exponent(s, "all_max") for runs in fresh.values()] for s in SOLVERS}
    drawn = {s: [runs.exponent(s, "paper_point_coordinate_max") for runs in fresh.values()] for s in SOLVERS}
    return Statement(
        "8, figure 1",
        "For (m, n) = (10, 50), (50, 10), (50, 50), 30 errors up to 0.1, 10 worlds each, the maximal error is linear.",
        "Exponent of the median over worlds, 0.01 to 0.1 rad, space and plane, after a fit | of the largest coordinate "
        "in the paper's frame, which it draws, "
        + _each_solver(lambda solver: f"{_range(exponents[solver])} | {_range(drawn[solver])}"),
        _verdict({s: all(abs(e - 1.0) < LINEAR_WITHIN for e in values) for s, values in exponents.items()}),
    )


def _constant(fresh: _Runs) -> Statement:
    rates = {s: [runs.rates(s, "all_max") for runs in fresh.values()] for s in SOLVERS}
    worst = {s: largest(np.concatenate(values)) for s, values in rates.items()}

    def tell(solver: str) -> str:
        plane = [runs.over_bound(solver) for (d, _, _), runs in fresh.items() if d == 2]
        space = [runs.over_bound(solver) for (d, _, _), runs in fresh.items() if d == 3]
        return (
            f"median {_range([median(one) for one in rates[solver]])}, largest {worst[solver]:.3g}, rms error "
            f"{_range(space)} times the bound in space and {_range(plane)} in the plane"
        )

    return Statement(
        "8",
        "The maximal error is of the order of the error of the angles; the constant C between them is quite small.",
        "C = maximal error / eps after a fit, scenes being 2 wide, and rms error against the least that noise of this "
        f"variance allows, {_each_solver(tell)}",
        _verdict({solver: value < 10.0 for solver, value in worst.items()}),
    )


def _through_the_data(bias: Sequence[Bias]) -> Statement:
    errors = sorted({one.angle_error_rad for one in bias})

    def tell(solver: str) -> str:
        shares = ([b.share for b in bias if b.solver == solver and b.angle_error_rad == error] for error in errors)
        return ", ".join(f"{_range(share)} at {error:g}" for share, error in zip(shares, errors, strict=True))

    small = {s: all(b.share < _SMALL_SHARE for b in bias if b.solver == s) for s in SOLVERS}
    return Statement(
        "8, proof",
        "The reconstruction is (A^T A)^-1 A^T b, so that errors of the data pass through a fixed matrix.",
        "The angles are in A, not in b, and what is not linear in them does not average out. Bias, as a share of the "
        f"rms error, in space, {_each_solver(tell)}",
        Verdict.CORRECTED if not small["printed"] else _verdict(small),
    )


def _measures(fresh: _Runs) -> Statement:
    def ratio(solver: str, frame: str, column: str) -> float:
        values = [runs.trials.of(solver, f"{frame}_{column}") for runs in fresh.values()]
        most = [runs.trials.of(solver, f"{frame}_max") for runs in fresh.values()]
        noisy = np.concatenate([runs.trials.angle_error_rad for runs in fresh.values()]) > 0.0
        return median(np.concatenate(values)[noisy] / np.concatenate(most)[noisy])

    def tell(solver: str) -> str:
        paper = ", ".join(f"{ratio(solver, 'paper', column):.2f}" for column in ("mean_abs", "mean", "rms"))
        fitted = ", ".join(f"{ratio(solver, 'all', column):.2f}" for column in ("mean_abs", "rms"))
        return f"{paper} | {fitted}"

    agrees = {s: max(ratio(s, "paper", column) for column in ("mean_abs", "mean", "rms")) < 0.5 for s in SOLVERS}
    return Statement(
        "8",
        "Mean absolute, mean and root mean square errors are much smaller than the maximal error.",
        "As shares of the maximal error, medians: mean absolute, mean, rms in the paper's frame | mean absolute, rms "
        "after a fit, where the mean is zero, " + _each_solver(tell),
        _verdict(agrees),
    )


def _refilmed(growth: _Runs) -> Statement:
    space = [runs for (d, _, _), runs in growth.items() if d == 3]

    def rate(solver: str, column: str, level: int) -> list[float]:
        return [float(runs.curve(solver, column)[level] / runs.levels_rad[level]) for runs in space]

    def tell(solver: str) -> str:
        return "; ".join(
            f"rms {_range(rate(solver, 'refilm_rms_rad', level))} and largest "
            f"{_range(rate(solver, 'refilm_max_rad', level))} at {space[0].levels_rad[level]:.2g}"
            for level in (0, -1)
        )

    # an error of both angles moves a bearing by sqrt(2) eps at most
    agrees = {s: max(*rate(s, "refilm_max_rad", 0), *rate(s, "refilm_max_rad", -1)) <= 2.0**0.5 for s in SOLVERS}
    return Statement(
        "8, remark 2",
        "Filmed again, the scene shows errors no larger than the actual errors.",
        f"Angle to the true bearings in units of eps, in space, where noise has rms {_NOISE_RMS:.2f} and at most 1.41, "
        f"{_each_solver(tell)} Where angles are what is minimised the claim holds; distances across rays let near "
        "points stray.",
        _verdict(agrees),
    )
