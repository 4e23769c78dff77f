"""Pictures of counting: numbers of points and views that have too few equations (extra ``plot``).

The forbidden regions of the 2007 paper (sections 4 and 7), for any camera. Necessary, never sufficient: outside the
region a scene may still be ambiguous, and its certificate decides.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from panopath.counting import (
    CameraCounts,
    CameraModel,
    PathBasis,
    StructureFromMotionInequality,
    required_visibility,
    smallest,
    structure_from_motion_inequality,
)
from panopath.errors import InputError
from panopath.model import Float
from panopath.report.pictures import matplotlib_figure

#: Panels side by side.
_COLUMNS = 4
#: Points and views drawn at most: beyond, cells are too small to see.
_LARGEST = 60
#: Smallest pairs named in a title.
_MOST_PAIRS = 5
#: Lines between cells up to here; more would only grey the picture.
_MOST_LINES = 24
_FORBIDDEN_COLOUR = "#5b5f66"
_SINGLE_COLOUR = "#d9d5cc"
_SMALLEST_COLOUR = "#d9480f"
#: From all pairs seen to few of them.
_SHADES = ("#eef4fa", "#1f5fa8")


@dataclass(frozen=True)
class Region:
    """A panel: what is counted, and what to call it."""

    title: str
    #: With the gauge of moving points where they move: ``model.moving_counts(k, basis)``.
    counts: CameraCounts
    k: int = 0
    basis: PathBasis = None

    @classmethod
    def of(cls, model: CameraModel, k: int = 0, basis: PathBasis = None) -> Region:
        """Take the counts of a kind of cameras."""
        return cls(_capital(model.description), model.moving_counts(k, basis), k, basis)


def draw_forbidden_regions(
    path: str | PathLike[str], regions: Sequence[Region] | None = None, largest: int = 12
) -> Path:
    """Draw a panel for each kind of cameras: which numbers of points (right) and views (up) have too few equations.

    Parameters
    ----------
    path
        The file to write; its ending chooses the format (png, svg, pdf).
    regions
        What to draw; default: every :class:`CameraModel`, points at rest.
    largest
        Points and views go from 1 to this number.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InputError
        Naming the argument.
    MissingExtraError
        Without matplotlib.
    """
    figure_class = matplotlib_figure()
    panels = [Region.of(model) for model in CameraModel] if regions is None else list(regions)
    if not panels:
        raise InputError("regions is empty, expected at least one")
    if largest not in range(2, _LARGEST + 1):
        raise InputError(f"largest is {largest!r}, expected a whole number from 2 to {_LARGEST}")
    figure = figure_class(figsize=region_figure_size(panels), layout="constrained")
    draw_region_panels(figure, panels, largest)
    written = Path(path)
    metadata = {"Software": None} if written.suffix == ".png" else None
    figure.savefig(written, dpi=130, metadata=metadata)
    return written


def region_figure_size(regions: Sequence[Region]) -> tuple[float, float]:
    """Width and height in inches that the panels need."""
    columns, rows = _columns_and_rows(regions)
    title_lines = max(region.title.count("\n") for region in regions) + 3
    below = 0.3 if columns * rows > len(regions) else 0.6 + 0.38 * math.ceil(5 / min(columns, 3))
    return 2.9 * columns + 1.0, (2.75 + 0.19 * title_lines) * rows + below


def _columns_and_rows(regions: Sequence[Region]) -> tuple[int, int]:
    columns = min(_COLUMNS, len(regions))
    return columns, math.ceil(len(regions) / columns)


def draw_region_panels(figure: Any, regions: Sequence[Region], largest: int) -> None:
    """Draw the panels on an empty figure with constrained layout."""
    columns, rows = _columns_and_rows(regions)
    has_room = columns * rows > len(regions)
    figure.get_layout_engine().set(h_pad=0.05, w_pad=0.06)
    grid = figure.subplots(rows, columns, squeeze=False)
    colours = _colour_map()
    for panel, region in zip(grid.flat, regions, strict=False):
        _draw_region(panel, region, largest, colours)
    empty = list(grid.flat)[len(regions) :]
    for panel in empty:
        panel.set_axis_off()
    # the lowest panel of each column
    for panel in list(grid.flat)[: len(regions)][-columns:]:
        panel.set_xlabel("points n")
    for panel in grid[:, 0]:
        panel.set_ylabel("views m")
    _draw_scale(figure, grid, colours)
    handles = _legend_handles(colours)
    if has_room:
        empty[0].legend(handles=handles, loc="center left", fontsize=9, frameon=False, labelspacing=0.9)
    else:
        figure.legend(handles=handles, loc="outside lower center", ncols=min(columns, 3), fontsize=9, frameon=False)


def _draw_region(panel: Any, region: Region, largest: int, colours: Any) -> None:
    cells = _cells(region, largest)
    settled = np.array([[cell.is_settled for cell in row] for row in cells])
    holds = np.array([[cell.holds for cell in row] for row in cells])
    edges = np.arange(largest + 1) + 0.5
    panel.set_facecolor(_FORBIDDEN_COLOUR)
    single = np.where(holds & ~settled, 1.0, np.nan)
    panel.pcolormesh(edges, edges, single, cmap=_one_colour(_SINGLE_COLOUR), vmin=0.0, vmax=1.0)
    fraction = np.ma.masked_where(~settled, _fractions(region, largest))
    panel.pcolormesh(edges, edges, fraction, cmap=colours, vmin=0.0, vmax=1.0)
    for edge in edges[1:-1] if largest <= _MOST_LINES else ():
        panel.axhline(edge, color="white", linewidth=0.4, alpha=0.35)
        panel.axvline(edge, color="white", linewidth=0.4, alpha=0.35)
    border = [(c.n, c.m) for row in cells for c in row if c.is_settled and c.slack == 0]
    panel.plot(*_columns(border), ".", color="white", markersize=4.0, markeredgewidth=0)
    fewest = smallest(*region.counts, region.k, region.basis)
    shown = [pair for pair in fewest if max(pair) <= largest]
    panel.plot(
        *_columns(shown), "o", color="white", markersize=5.0, markeredgecolor=_SMALLEST_COLOUR, markeredgewidth=1.8
    )
    ticks = [1, *range(_tick(largest), largest + 1, _tick(largest))] if largest > 6 else list(range(1, largest + 1))
    panel.set(xlim=(0.5, largest + 0.5), ylim=(0.5, largest + 0.5), aspect="equal", xticks=ticks, yticks=ticks)
    panel.tick_params(labelsize=8, length=2)
    panel.set_title(_title(region, fewest), fontsize=8.5)


def _title(region: Region, fewest: Sequence[tuple[int, int]]) -> str:
    d, f, g, h = region.counts
    shared = f", h = {h}" if h else ""
    pairs = [f"({n}, {m})" for n, m in fewest]
    listed = " ".join(pairs if len(pairs) <= _MOST_PAIRS else [*pairs[: _MOST_PAIRS - 1], "..."])
    return f"{region.title}\nd = {d}, f = {f}, g = {g}{shared}\nfewest {listed}"


def _draw_scale(figure: Any, grid: Any, colours: Any) -> None:
    artists = _artists()
    scale = artists.ScalarMappable(norm=artists.Normalize(0.0, 1.0), cmap=colours)
    bar = figure.colorbar(scale, ax=list(grid.flat), shrink=0.7, aspect=35, pad=0.02)
    bar.set_label("share of all pairs that\nmust be seen, at least", fontsize=9)
    bar.ax.tick_params(labelsize=8)


def _legend_handles(colours: Any) -> list[Any]:
    artists = _artists()
    dot = {"linestyle": "none", "marker": "o", "color": "white"}
    return [
        artists.Patch(color=_FORBIDDEN_COLOUR, label="too few equations"),
        artists.Patch(color=_SINGLE_COLOUR, label="the gauge takes the unknowns:\nmore points, and it fails"),
        artists.Patch(color=colours(0.7), label="enough equations:\nnecessary, never sufficient"),
        artists.Line2D([], [], **dot, markeredgecolor="#999999", markersize=4, label="not one to spare"),
        artists.Line2D(
            [], [], **dot, markersize=5, markeredgecolor=_SMALLEST_COLOUR, markeredgewidth=1.8, label="fewest (n, m)"
        ),
    ]


def _cells(region: Region, largest: int) -> list[list[StructureFromMotionInequality]]:
    """Rows are views, columns points."""
    counts = range(1, largest + 1)
    return [
        [structure_from_motion_inequality(*region.counts, n, m, region.k, region.basis) for n in counts] for m in counts
    ]


def _fractions(region: Region, largest: int) -> Float:
    counts = range(1, largest + 1)
    return np.array(
        [[required_visibility(*region.counts, n, m, region.k, region.basis).fraction for n in counts] for m in counts]
    )


@dataclass(frozen=True)
class _Artists:
    """Classes of matplotlib, which is an extra: found when a picture is drawn."""

    Line2D: Any
    Patch: Any
    Normalize: Any
    ScalarMappable: Any


def _artists() -> _Artists:
    find = importlib.import_module
    return _Artists(
        find("matplotlib.lines").Line2D,
        find("matplotlib.patches").Patch,
        find("matplotlib.colors").Normalize,
        find("matplotlib.cm").ScalarMappable,
    )


def _colour_map() -> Any:
    return importlib.import_module("matplotlib.colors").LinearSegmentedColormap.from_list("seen", _SHADES)


def _one_colour(colour: str) -> Any:
    return importlib.import_module("matplotlib.colors").ListedColormap([colour])


def _columns(pairs: Sequence[tuple[int, int]]) -> tuple[list[int], list[int]]:
    return [n for n, _ in pairs], [m for _, m in pairs]


def _tick(largest: int) -> int:
    """Distance of the ticks: at most about six."""
    return next(step for step in (1, 2, 3, 5, 10) if largest <= 6 * step)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
