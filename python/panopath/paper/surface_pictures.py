"""Pictures of the error over all numbers of views and points."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from panopath.model import Float
from panopath.paper.noise_pictures import COLOURS
from panopath.paper.surface_findings import Surface
from panopath.paper.trials import SOLVER_NAMES

_NO_ANSWER = "#9a9a9a"
_COLOURS = "viridis"
#: Where colours end, and where surfaces do.
_LEAST, _MOST = 2e-3, 0.2
_LOWEST, _HIGHEST = 1e-3, 10.0
_TICKS = (2, 5, 10, 20, 50)


def draw_maps(figure: Any, surfaces: Mapping[str, Surface]) -> None:
    """Draw a map of averages and one of medians for each solver."""
    colours = importlib.import_module("matplotlib.colors")
    norm = colours.LogNorm(_LEAST, _MOST)
    grid = figure.subplots(2, len(surfaces), sharex=True, sharey=True, squeeze=False)
    shown = None
    for column, (solver, surface) in enumerate(surfaces.items()):
        for row, cells in enumerate((surface.mean("max"), surface.median("max"))):
            panel = grid[row][column]
            shown = _draw_map(panel, cells, norm)
            views, points = np.nonzero(surface.is_doubtful())
            panel.plot(points + 1, views + 1, "x", color="#d9480f", markersize=2.2, markeredgewidth=0.6)
        grid[0][column].set_title(SOLVER_NAMES[solver], fontsize=10)
        grid[1][column].set_xlabel("points n")
    for row, label in zip(grid, ("average over worlds", "median over worlds"), strict=True):
        row[0].set_ylabel(f"{label}\nviews m")
    bar = figure.colorbar(shown, ax=list(grid.flat), shrink=0.8, pad=0.02, extend="both")
    bar.set_label("maximal error")


def _draw_map(panel: Any, cells: Float, norm: Any) -> Any:
    m, n = cells.shape
    panel.set_facecolor(_NO_ANSWER)
    shown = panel.pcolormesh(
        np.arange(n + 1) + 0.5, np.arange(m + 1) + 0.5, np.ma.masked_invalid(cells), norm=norm, cmap=_COLOURS
    )
    panel.set(aspect="equal", xlim=(0.5, n + 0.5), ylim=(0.5, m + 0.5))
    return shown


def draw_sides(figure: Any, surfaces: Mapping[str, Surface]) -> None:
    """Draw the surfaces of the first and the last solver from two sides."""
    importlib.import_module("mpl_toolkits.mplot3d")
    solvers = list(surfaces)
    for row, solver in enumerate((solvers[0], solvers[-1])):
        cells = np.clip(surfaces[solver].mean("max"), _LOWEST, _HIGHEST)
        for column, azimuth in enumerate((-55, 125)):
            panel = figure.add_subplot(2, 2, 2 * row + column + 1, projection="3d")
            _draw_side(panel, np.log10(cells), azimuth)
            panel.set_title(SOLVER_NAMES[solver], fontsize=10, y=1.0)


def _draw_side(panel: Any, heights: Float, azimuth_deg: float) -> None:
    m, n = heights.shape
    points, views = np.meshgrid(np.arange(1, n + 1), np.arange(1, m + 1))
    low, high = np.log10(_LOWEST), np.log10(_HIGHEST)
    ends = {"vmin": np.log10(_LEAST), "vmax": np.log10(_MOST)}
    panel.plot_surface(points, views, heights, cmap=_COLOURS, **ends, rcount=60, ccount=60, linewidth=0.1)
    ticks = np.arange(np.ceil(low), np.floor(high) + 1)
    panel.set(xlabel="points n", ylabel="views m", zlabel="average maximal error", zlim=(low, high), zticks=ticks)
    panel.set_zticklabels([f"{10.0**tick:g}" for tick in ticks])
    panel.view_init(elev=28, azim=azimuth_deg)
    panel.set_box_aspect((1.0, 1.0, 0.75), zoom=0.97)


def draw_slices(figure: Any, surfaces: Mapping[str, Surface]) -> None:
    """Draw maximal and mean absolute error along lines of the surface."""
    first = next(iter(surfaces.values()))
    middle = max(1, min(first.shape) // 2)
    lines: tuple[tuple[str, Callable[[Float], Float]], ...] = (
        (f"points n, {middle} views", lambda cells: cells[middle - 1]),
        (f"views m, {middle} points", lambda cells: cells[:, middle - 1]),
        ("points and views, n = m", np.diagonal),
    )
    grid = figure.subplots(2, len(lines), sharex=True, sharey="row")
    for row, (name, label) in zip(grid, (("max", "maximal error"), ("mean_abs", "mean absolute error")), strict=True):
        for panel, (along, cut) in zip(row, lines, strict=True):
            for solver, surface in surfaces.items():
                values = cut(surface.median(name))
                panel.plot(np.arange(1, len(values) + 1), values, color=COLOURS[solver], linewidth=1.5)
            _draw_guides(panel, cut(surfaces[list(surfaces)[-1]].median(name)))
            panel.set(xscale="log", yscale="log", ylim=(1e-3, 1.0))
            panel.grid(which="major", color="#dddddd", linewidth=0.6)
            panel.set_xticks(_TICKS, [str(tick) for tick in _TICKS], minor=False)
            panel.set_xticks([], minor=True)
            panel.set(xlim=(2, max(3, *first.shape)), xlabel=along if name == "mean_abs" else "")
        row[0].set_ylabel(label)
    panel = grid[0][0]
    handles = [panel.plot([], [], color=COLOURS[s], linewidth=2, label=SOLVER_NAMES[s])[0] for s in surfaces]
    handles.append(panel.plot([], [], color="#111111", linestyle="--", linewidth=0.9, label="$n^{-1}$")[0])
    handles.append(panel.plot([], [], color="#111111", linestyle=":", linewidth=1.1, label="$n^{-1/2}$")[0])
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=9, frameon=False)


def _draw_guides(panel: Any, values: Float) -> None:
    """Lines like 1/n and 1/sqrt(n) through the value at ten."""
    if len(values) < 10 or not np.isfinite(values[9]):
        return
    counts = np.arange(10, len(values) + 1)
    for power, style, width in ((-1.0, "--", 0.9), (-0.5, ":", 1.1)):
        panel.plot(counts, values[9] * (counts / 10.0) ** power, color="#111111", linestyle=style, linewidth=width)
