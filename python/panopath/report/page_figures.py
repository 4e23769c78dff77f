"""Charts of the report page as plain HTML and SVG: histograms of columns, maps of the sphere, tables, spans of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.model import Bool, Float, Scene

#: Cells of a map of the sphere, around and from pole to pole.
_CELLS = (48, 24)
#: Cells with fewer observations tell nothing of their error.
_ENOUGH = 5
#: Columns of a histogram over views.
_MOST_COLUMNS = 96


def section(title: str, note: str, body: str) -> str:
    """Frame a chart with its title and one line of what it shows."""
    return f"<section><h2>{escape(title)}</h2><p class=quiet>{escape(note)}</p>{body}</section>"


def columns(stacks: Sequence[Sequence[float]], titles: Sequence[str], ticks: Sequence[str], *, each: bool) -> str:
    """Columns of one value or two stacked ones.

    Parameters
    ----------
    stacks
        The values of each column.
    titles
        What a column says when it is pointed at.
    ticks
        Labels below: one a column where ``each``, else spread from the first to the last.
    each
        Whether every column has its label.
    """
    top = max((sum(stack) for stack in stacks), default=0.0) or 1.0
    drawn = []
    for stack, title in zip(stacks, titles, strict=True):
        parts = "".join(f'<u style="height:{100.0 * value / top:.2f}%"></u>' for value in stack)
        drawn.append(f'<i title="{escape(title)}">{parts}</i>')
    labels = "".join(f"<span>{escape(tick)}</span>" for tick in ticks)
    kind = "ticks each" if each else "ticks"
    return f'<div class=columns>{"".join(drawn)}</div><div class="{kind}">{labels}</div>'


def key(entries: Sequence[tuple[str, str]]) -> str:
    """Tell what the colours of stacked columns mean: CSS colour and text of each."""
    told = "".join(f'<span><i style="background:var({c})"></i>{escape(text)}</span>' for c, text in entries)
    return f'<p class="quiet key" style="margin-top:8px">{told}</p>'


def track_lengths(scene: Scene) -> str:
    """How many views each point was seen by."""
    lengths = scene.point_statistics().n_inliers
    lengths = lengths[(scene.track_component >= 0) & (lengths > 0)]
    if not len(lengths):
        return ""
    edges = [2, 3, 4, 5, 6, 8, 11, 16, 23, 32, 46, 64, 91, 128, 256, 512, 1 << 31]
    edges = [low for low in edges if low <= max(2, int(lengths.max()))] + [1 << 31]
    stacks, titles, ticks = [], [], []
    for low, high in pairwise(edges):
        count = int(((lengths >= low) & (lengths < high)).sum()) + (int((lengths < 2).sum()) if low == 2 else 0)
        last = high == 1 << 31
        name = f"{low}+" if last and low > 2 else str(low) if high == low + 1 or last else f"{low}-{high - 1}"
        stacks.append([float(count)])
        titles.append(f"{count:,} points seen by {name} views")
        ticks.append(name)
    note = f"Views that saw each point; the median is {np.median(lengths):g}. Longer tracks hold the path together."
    return section("Track lengths", note, columns(stacks, titles, ticks, each=True))


def residuals(scene: Scene) -> str:
    """How far bearings are from their predictions, used ones and outliers."""
    known = np.isfinite(scene.residual_rad)
    if not known.any():
        return ""
    degrees = np.maximum(np.degrees(scene.residual_rad), 1e-9)
    used, dropped = degrees[known & scene.inlier], degrees[known & ~scene.inlier]
    everything = np.concatenate((used, dropped))
    low, high = float(np.percentile(everything, 0.5)), float(everything.max())
    edges = np.geomspace(0.8 * low, max(1.05 * high, 2.0 * low), 49)
    counts = [np.histogram(np.maximum(values, edges[0]), edges)[0] for values in (used, dropped)]
    stacks = np.stack(counts, axis=1).astype(float).tolist()
    titles = [
        f"{edges[k]:.2g} to {edges[k + 1]:.2g} degrees: {counts[0][k]:,} used, {counts[1][k]:,} outliers"
        for k in range(48)
    ]
    ticks = [f"{rounded(float(edge))}°" for edge in edges[::12]]
    middle = f"{np.median(used):.2g} degrees" if len(used) else "not known"
    note = f"Angle between each bearing and its prediction; the median of those used is {middle}."
    shares = [("--accent", f"used ({len(used):,})"), ("--second", f"outliers ({len(dropped):,})")]
    return section("Angular residuals", note, columns(stacks, titles, ticks, each=False) + key(shares))


def observations_along(scene: Scene, order: npt.NDArray[np.intp]) -> str:
    """Draw how many points each view sees, in the order of the path."""
    count = scene.view_statistics().n_inliers[order]
    if not len(count) or not count.any():
        return ""
    groups = np.array_split(np.arange(len(count)), min(len(count), _MOST_COLUMNS))
    names = [scene.view_labels()[v] for v in order.tolist()]
    stacks, titles = [], []
    for group in groups:
        least = float(count[group].min())
        stacks.append([least])
        span = names[group[0]] if len(group) == 1 else f"{names[group[0]]} to {names[group[-1]]}, least"
        titles.append(f"{span}: {least:,.0f} points")
    weakest = int(np.argmin(count))
    note = f"Points that each view sees and that were used. The fewest: {count[weakest]:,} in {names[weakest]}."
    ticks = ["first view", "last view"]
    return section("Points along the path", note, columns(stacks, titles, ticks, each=False))


@dataclass(frozen=True)
class _Grid:
    """Cells of the sphere, or of the circle, and the observations in each."""

    #: (rows, columns) observations used.
    count: Float
    #: (rows, columns) root mean square of their residuals in degrees, NaN where they are few.
    rms_deg: Float
    #: (rows, 1) share of the sphere that a cell of the row covers.
    area: Float


def _grid(scene: Scene) -> _Grid | None:
    if scene.tracks is None:
        return None
    used: Bool = np.asarray(scene.inlier & np.isfinite(scene.residual_rad))
    if not used.any():
        return None
    bearing, residual = scene.tracks.bearing[used], np.degrees(scene.residual_rad[used])
    wide, high = _CELLS if scene.d == 3 else (72, 1)
    if scene.d == 3 and in_world(scene):
        around = -np.arctan2(bearing[:, 1], bearing[:, 0])
        down = -np.arctan2(bearing[:, 2], np.hypot(bearing[:, 0], bearing[:, 1]))
    elif scene.d == 3:
        around = np.arctan2(bearing[:, 0], bearing[:, 2])
        down = np.arctan2(bearing[:, 1], np.hypot(bearing[:, 0], bearing[:, 2]))
    else:
        around, down = -np.arctan2(bearing[:, 1], bearing[:, 0]), np.zeros(len(bearing))
    column = np.clip(((around / (2.0 * np.pi) + 0.5) * wide).astype(np.int64), 0, wide - 1)
    row = np.clip(((down / np.pi + 0.5) * high).astype(np.int64), 0, high - 1)
    cell = row * wide + column
    count = np.bincount(cell, minlength=wide * high).astype(np.float64)
    square = np.bincount(cell, weights=residual**2, minlength=wide * high)
    rms = np.where(count >= _ENOUGH, np.sqrt(square / np.maximum(count, 1.0)), np.nan)
    edges = np.sin(np.pi * (np.arange(high + 1) / high - 0.5)) if scene.d == 3 else np.array([-1.0, 1.0])
    area = np.diff(edges)[:, None] / (2.0 * wide)
    return _Grid(count.reshape(high, wide), rms.reshape(high, wide), area)


def in_world(scene: Scene) -> bool:
    """Whether the bearings are directions of the world: no camera is turned."""
    turned = scene.cam_from_world - (np.eye(3) if scene.d == 3 else 0.0)
    return not np.abs(turned[np.isfinite(turned)]).max(initial=0.0) > 1e-12


def sphere_maps(scene: Scene) -> str:
    """Where on the sphere the camera saw points, and where they fit badly."""
    grid = _grid(scene)
    if grid is None:
        return ""
    density = grid.count / grid.area / grid.count.sum()
    seen = float((np.broadcast_to(grid.area, grid.count.shape) * (grid.count > 0)).sum())
    coverage = _map(
        density,
        "--accent",
        (0.0, max(2.0, float(np.percentile(density, 98.0)))),
        "{:.2g} x even",
        ("none", "{:.2g} times what an even spread would have"),
    )
    what = "sphere" if scene.d == 3 else "circle"
    middle = "the x axis of the world" if in_world(scene) else "straight ahead"
    note = f"Where points were seen, {middle} in the middle: {100.0 * seen:.0f} % of the {what} was used."
    parts = [section("Coverage", note, coverage)]
    known = grid.rms_deg[np.isfinite(grid.rms_deg)]
    if len(known):
        top = float(np.percentile(known, 97.0)) or 1.0
        residual = _map(grid.rms_deg, "--second", (0.0, top), "{:.2g} deg", ("0", "{:.2g} degrees rms"))
        note = (
            f"Rms of the residuals in each direction, median {np.median(known):.2g} degrees. A patch "
            "that stands out points to stitching, calibration or something fixed to the camera."
        )
        parts.append(section("Residuals over the " + what, note, residual))
    return "".join(parts)


def _map(values: Float, shade: str, span: tuple[float, float], each: str, ends: tuple[str, str]) -> str:
    """Cells shaded by value, in the projection of a panorama; one colour, so that it reads in light and dark."""
    high, wide = values.shape
    low, top = span
    cells = []
    tall = 10 if high > 1 else 60
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value) and value > low:
            opacity = min(1.0, (float(value) - low) / (top - low))
            place = f'x="{10 * column}" y="{tall * row}" width="10" height="{tall}"'
            cells.append(f'<rect {place} fill-opacity="{opacity:.2f}"><title>{each.format(value)}</title></rect>')
    lines = "".join(f'<path d="M{x * 10 * wide:g} 0V{tall * high}"/>' for x in (0.25, 0.5, 0.75)) + (
        f'<path d="M0 {tall * high // 2}H{10 * wide}"/>' if high > 1 else ""
    )
    ramp = f'<div class=ramp style="--shade:var({shade})">{ends[0]}<i></i>{ends[1].format(top)}</div>'
    return (
        f'<svg class=sphere viewBox="0 0 {10 * wide} {tall * high}" role="img" shape-rendering="crispEdges">'
        f'<g style="fill:var({shade})">{"".join(cells)}</g>'
        f'<g style="stroke:var(--quiet);stroke-opacity:.35;stroke-dasharray:3 4;fill:none">{lines}</g></svg>{ramp}'
    )


def timings(seconds: Sequence[tuple[str, float]]) -> str:
    """How long each stage took."""
    total = sum(value for _, value in seconds)
    if not total > 0.0:
        return ""
    longest = max(value for _, value in seconds)
    rows = "".join(
        f"<tr><td class=name>{escape(name)}</td>"
        f'<td class=long><i style="width:{100.0 * value / longest:.1f}%"></i></td>'
        f"<td class=number>{duration(value)}</td></tr>"
        for name, value in seconds
    )
    return section("Time", f"{duration(total)} in total.", f"<table class=spans>{rows}</table>")


def table(rows: Sequence[tuple[str, str]]) -> str:
    """Names and values, both plain text."""
    cells = "".join(f"<tr><td class=name>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in rows)
    return f"<table>{cells}</table>"


def flattened(settings: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Names and values of nested settings, as ``outer.inner``."""
    if isinstance(settings, dict):
        rows: list[tuple[str, str]] = []
        for name, value in settings.items():
            rows += flattened(value, f"{prefix}.{name}" if prefix else str(name))
        return rows
    if isinstance(settings, bool | None):
        return [(prefix, {True: "yes", False: "no", None: "-"}[settings])]
    if isinstance(settings, float):
        return [(prefix, f"{settings:.6g}")]
    if isinstance(settings, list | tuple):
        return [(prefix, ", ".join(text for item in settings for _, text in flattened(item)) or "-")]
    return [(prefix, str(settings))]


def rounded(value: float) -> str:
    """Two digits, without an exponent where a person would write none."""
    return f"{float(f'{value:.2g}'):g}"


def duration(seconds: float) -> str:
    """Say a time as a person would."""
    if seconds < 0.0005:
        return "< 1 ms"
    if seconds < 0.0995:
        return f"{1e3 * seconds:.0f} ms"
    if seconds < 99.5:
        return f"{seconds:.2g} s" if seconds < 9.95 else f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


def size_of(n_bytes: int) -> str:
    """Say the size of a file as a person would."""
    size = float(n_bytes)
    for unit in ("bytes", "kB", "MB"):
        if size < 999.5:
            return f"{size:.3g} {unit}"
        size /= 1000.0
    return f"{size:.3g} GB"
