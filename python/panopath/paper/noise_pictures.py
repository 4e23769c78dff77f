"""Pictures of the error against the noise, in logarithmic axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from panopath.paper.noise_bias import Bias
from panopath.paper.noise_findings import Key, Runs
from panopath.paper.trials import SOLVER_NAMES, SOLVERS

COLOURS = {"printed": "#c2571a", "linear": "#7a3f98", "robust": "#1f5fa8"}
_DOT = {"linestyle": "none", "marker": ".", "markersize": 3.5, "markeredgewidth": 0, "alpha": 0.35}
_BOUND = {"color": "#111111", "linestyle": "--", "linewidth": 1.3}
#: Errors far below any noise are not drawn: they are those of exact data.
_LEAST = 1e-7


def draw_noise(
    figure: Any, keys: Sequence[Key], fresh: Mapping[Key, Runs], growth: Mapping[Key, Runs], bias: Sequence[Bias]
) -> None:
    """Draw, for each size, the maximal error, the rms error with its bound and bias, and the local exponent."""
    grid = figure.subplots(3, len(keys), sharex=True, sharey="row", squeeze=False)
    for column, key in enumerate(keys):
        _draw_errors(grid[0][column], fresh[key], growth[key], "all_max")
        _draw_errors(grid[1][column], fresh[key], growth[key], "all_rms")
        _draw_bound(grid[1][column], growth[key], [one for one in bias if (one.n_views, one.n_points) == key[1:]])
        _draw_exponents(grid[2][column], growth[key])
        grid[0][column].set_title(f"{key[1]} views, {key[2]} points", fontsize=10)
        grid[2][column].set_xlabel("error of the angles eps, rad")
    for row, label in zip(grid, ("maximal error", "rms error", "local exponent of the maximal error"), strict=True):
        row[0].set_ylabel(label)
    _add_legend(figure, grid, with_bias=bool(bias))


def _draw_errors(panel: Any, fresh: Runs, growth: Runs, column: str) -> None:
    for solver in SOLVERS:
        errors, values = fresh.trials.angle_error_rad, fresh.trials.of(solver, column)
        shown = (errors > 0.0) & (values > _LEAST)
        panel.plot(errors[shown], values[shown], color=COLOURS[solver], **_DOT)
    for solver in SOLVERS:
        panel.plot(growth.levels_rad, growth.curve(solver, column), color=COLOURS[solver], linewidth=1.6)
    panel.set(xscale="log", yscale="log", ylim=(2e-5, 20.0))
    panel.grid(which="major", color="#dddddd", linewidth=0.6)


def _draw_bound(panel: Any, growth: Runs, bias: Sequence[Bias]) -> None:
    panel.plot(growth.levels_rad, growth.bound_curve(), **_BOUND)
    for solver in SOLVERS:
        mine = [one for one in bias if one.solver == solver and one.bias_rms > 0.0]
        panel.plot(
            [one.angle_error_rad for one in mine],
            [one.bias_rms for one in mine],
            color=COLOURS[solver],
            linestyle=":",
            linewidth=1.2,
            marker="D",
            markersize=5,
            markerfacecolor="white",
        )


def _draw_exponents(panel: Any, growth: Runs) -> None:
    levels = growth.levels_rad
    middle = np.sqrt(levels[1:] * levels[:-1])
    for solver in SOLVERS:
        panel.plot(
            middle, growth.slopes(solver, "all_max"), color=COLOURS[solver], linewidth=1.6, marker="o", markersize=3
        )
    panel.axhline(1.0, color="#888888", linewidth=0.8)
    panel.axhline(2.0, color="#888888", linewidth=0.8, linestyle=":")
    panel.set(xscale="log", ylim=(0.5, 2.6))


def _add_legend(figure: Any, grid: Any, *, with_bias: bool) -> None:
    panel = grid[0][0]
    handles = [panel.plot([], [], color=COLOURS[s], linewidth=2, label=SOLVER_NAMES[s])[0] for s in SOLVERS]
    handles.append(panel.plot([], [], **_BOUND, label="least rms error that the noise allows")[0])
    if with_bias:
        diamond = {"color": "#555555", "linestyle": ":", "marker": "D", "markersize": 5, "markerfacecolor": "white"}
        handles.append(panel.plot([], [], **diamond, label="rms of the bias")[0])
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=9, frameon=False)


#: Rows of the second picture: what is drawn, and how it is called.
_MEASURES = (
    (
        "errors in the paper's frame",
        (
            ("paper_max", "-", "maximal"),
            ("paper_rms", "--", "rms"),
            ("paper_mean_abs", "-.", "mean absolute"),
            ("paper_mean", ":", "mean"),
        ),
    ),
    (
        "errors after a fit",
        (("all_max", "-", "maximal"), ("all_rms", "--", "rms"), ("all_mean_abs", "-.", "mean absolute")),
    ),
    ("filmed again, angle / eps", (("refilm_max_rad", "-", "largest"), ("refilm_rms_rad", "--", "rms"))),
)


def draw_measures(figure: Any, keys: Sequence[Key], growth: Mapping[Key, Runs]) -> None:
    """Draw the paper's measures of error, and the error of the scene filmed again."""
    grid = figure.subplots(len(_MEASURES), len(keys), sharex=True, sharey="row", squeeze=False)
    for row, (label, lines) in zip(grid, _MEASURES, strict=True):
        for panel, key in zip(row, keys, strict=True):
            runs, is_rate = growth[key], label.startswith("filmed")
            for solver in SOLVERS:
                for column, style, _ in lines:
                    values = runs.curve(solver, column) / (runs.levels_rad if is_rate else 1.0)
                    panel.plot(runs.levels_rad, values, color=COLOURS[solver], linestyle=style, linewidth=1.4)
            panel.set(xscale="log", yscale="log")
            panel.grid(which="major", color="#dddddd", linewidth=0.6)
            if is_rate:
                panel.axhline(1.0, color="#888888", linewidth=0.8)
                panel.set_xlabel("error of the angles eps, rad")
        styles = [row[0].plot([], [], color="#555555", linestyle=style, label=name)[0] for _, style, name in lines]
        row[0].legend(handles=styles, fontsize=8, frameon=False)
        row[0].set_ylabel(label)
    for panel, key in zip(grid[0], keys, strict=True):
        panel.set_title(f"{key[1]} views, {key[2]} points", fontsize=10)
    handles = [grid[0][0].plot([], [], color=COLOURS[s], linewidth=2, label=SOLVER_NAMES[s])[0] for s in SOLVERS]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=9, frameon=False)
