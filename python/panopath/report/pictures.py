"""Pictures of a scene: path and points from above and from the side, and how well each point fits (extra ``plot``).

Bodies that move are drawn as the ways they went, each from a dot where it was first seen.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.errors import MissingExtraError
from panopath.model import Float, Scene
from panopath.movers import resting
from panopath.report.page_paths import Bodies, bodies_of

#: Parts drawn, the largest first.
_MOST_PARTS = 4
#: Points drawn in a panel; more only darken the paper.
_MOST_POINTS = 30_000
_PART_COLOURS = ("#1f5fa8", "#c2571a", "#2e8b57", "#7a3f98")
_PATH_COLOUR = "#111111"
_TRUTH_COLOUR = "#e0218a"
_BODY_COLOURS = ("#d9480f", "#0b7a75", "#7a3f98", "#b8860b", "#2f9e44", "#1098ad")


@dataclass(frozen=True)
class _Part:
    """One component as it is drawn: coordinates right, ahead and up."""

    index: int
    path: Float
    truth: Float
    points: Float
    error_deg: Float
    bodies: Bodies | None = None


def draw_scene(
    scene: Scene, folder: str | PathLike[str], truth: npt.ArrayLike | None = None, unit: str = ""
) -> list[Path]:
    """Draw ``views.png`` (each part from above and from the side) and ``errors.png`` (how well points and rays fit).

    Parameters
    ----------
    scene
        What to draw.
    folder
        Where to; it exists.
    truth
        (n_views, d) true camera positions in the frame of the scene, drawn over the path.
    unit
        Unit of the scene, for the axes.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    MissingExtraError
        Without matplotlib.
    """
    figure_class = matplotlib_figure()
    true_centers = np.full_like(scene.centers, np.nan) if truth is None else np.array(truth, dtype=np.float64)
    parts = _parts(scene, true_centers)
    written = []
    for name, draw in (("views.png", _draw_views), ("errors.png", _draw_errors)):
        path = Path(folder) / name
        figure = draw(figure_class, scene, parts, unit)
        figure.savefig(path, dpi=130, metadata={"Software": None})
        written.append(path)
    return written


def matplotlib_figure() -> Any:
    """Find the Figure class: without pyplot there is no window, no global state and no backend to choose."""
    try:
        importlib.import_module("matplotlib.backends.backend_agg")
        return importlib.import_module("matplotlib.figure").Figure
    except ImportError:
        raise MissingExtraError(
            'pictures need matplotlib: install the extra with pip install "panopath[plot]"'
        ) from None


def _parts(scene: Scene, true_centers: Float) -> list[_Part]:
    sizes = np.bincount(scene.view_component[scene.view_component >= 0], minlength=scene.n_components)
    error_deg = np.degrees(scene.point_statistics().rms_rad)
    axes = _axes(scene)
    parts = []
    for index in np.argsort(-sizes, kind="stable")[:_MOST_PARTS].tolist():
        views = _in_time_order(
            scene, np.flatnonzero((scene.view_component == index) & np.isfinite(scene.centers).all(axis=1))
        )
        placed = (scene.track_component == index) & np.isfinite(scene.points).all(axis=1) & resting(scene)
        points = np.flatnonzero(placed)
        parts.append(
            _Part(
                index,
                scene.centers[views] @ axes.T,
                true_centers[views] @ axes.T,
                scene.points[points] @ axes.T,
                error_deg[points],
                bodies_of(scene, index, axes),
            )
        )
    return parts


def _in_time_order(scene: Scene, views: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    time_s = None if scene.tracks is None else scene.tracks.time_s
    if time_s is None or not np.isfinite(time_s[views]).all():
        return views
    return views[np.argsort(time_s[views], kind="stable")]


def _axes(scene: Scene) -> Float:
    """(d, d) rows right, ahead and up: the axes of the world, turned so that what the cameras call up is up."""
    if scene.d == 2:
        return np.eye(2)
    rotation = scene.cam_from_world
    keeps_z = np.abs(rotation[:, 2, :] - (0.0, 0.0, 1.0)).max(initial=0.0) < 1e-6
    up = -rotation[:, 1, :].mean(axis=0) if len(rotation) else np.zeros(3)
    if keeps_z or np.linalg.norm(up) < 0.5:
        return np.eye(3)
    up /= np.linalg.norm(up)
    axis = np.eye(3)[int(np.argmin(np.abs(up)))]
    right = axis - up * (axis @ up)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(up, right), up])


def _limits(part: _Part) -> tuple[Float, float]:
    """Middle and half width of the picture: the path and the points around it, far points left outside.

    Twice the median distance shows most points; never less than the path, nor so much that the path is a dot.
    """
    seen = part.path if len(part.path) else part.points
    if not len(seen):
        return np.zeros(part.path.shape[1]), 1.0
    low, high = seen.min(axis=0), seen.max(axis=0)
    path_half = 0.5 * float((high - low).max())
    if len(part.points):
        distance = np.abs(part.points - 0.5 * (low + high)).max(axis=1)
        reach = min(float(np.percentile(distance, 95.0)), 2.0 * float(np.median(distance)))
        reach = float(np.clip(reach, path_half, 8.0 * path_half if path_half > 0.0 else np.inf))
        near = part.points[distance <= reach]
        low, high = np.vstack((near, low)).min(axis=0), np.vstack((near, high)).max(axis=0)
    half = 0.5 * float((high - low).max())
    return 0.5 * (low + high), 1.08 * half if half > 0.0 else 1.0


def _draw_views(figure_class: Any, scene: Scene, parts: list[_Part], unit: str) -> Any:
    views = [("from above", 0, 1)] + ([("from the side", 0, 2)] if scene.d == 3 else [])
    rows = max(1, len(parts))
    figure = figure_class(figsize=(6.4 * len(views) + 0.6, 5.9 * rows + 0.3), layout="constrained")
    panels = figure.subplots(rows, len(views), squeeze=False)
    if not parts:
        _say_nothing_known(panels[0])
    for row, part in enumerate(parts):
        colour = _PART_COLOURS[row % len(_PART_COLOURS)]
        middle, half = _limits(part)
        shown = _sample(len(part.points))
        for panel, (title, right, up) in zip(panels[row], views, strict=True):
            dots = part.points[shown]
            panel.plot(
                dots[:, right],
                dots[:, up],
                ".",
                markersize=_dot_size(len(dots)),
                color=colour,
                alpha=0.5,
                markeredgewidth=0,
                rasterized=True,
                label="points",
            )
            _draw_bodies(panel, part, right, up)
            _draw_path(panel, part, right, up)
            _frame(panel, middle, half, (right, up), _axis_names(scene, unit))
            name = f"part {part.index + 1} {title}" if scene.n_components > 1 else f"{title}"
            panel.set_title(f"{name[:1].upper()}{name[1:]}", fontsize=12)
        outside = int((np.abs(part.points - middle).max(axis=1) > half).sum())
        note = f"{len(part.path):,} views, {len(part.points):,} points"
        note += f" ({outside:,} farther away)" if outside else ""
        note += f", {part.bodies.total:,} tracks that move" if part.bodies is not None else ""
        panels[row][0].text(
            0.015,
            0.015,
            note,
            transform=panels[row][0].transAxes,
            fontsize=9,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 2},
        )
        legend = panels[row][0].legend(loc="upper right", fontsize=9, framealpha=0.85)
        for handle in legend.legend_handles:
            handle.set_alpha(1.0)
            handle.set_markersize(max(5.0, handle.get_markersize()))
    return figure


def _draw_bodies(panel: Any, part: _Part, right: int, up: int) -> None:
    if part.bodies is None:
        return
    ways = np.split(part.bodies.places, np.cumsum(part.bodies.counts)[:-1])
    label: str | None = "bodies that move"
    for way, number in zip(ways, part.bodies.colours.tolist(), strict=True):
        colour = _BODY_COLOURS[number % len(_BODY_COLOURS)]
        panel.plot(way[:, right], way[:, up], "-", color=colour, linewidth=1.1, alpha=0.7, label=label, zorder=2)
        panel.plot(way[:1, right], way[:1, up], "o", color=colour, markersize=3.0, zorder=2)
        label = None


def _draw_path(panel: Any, part: _Part, right: int, up: int) -> None:
    known = np.isfinite(part.truth).all(axis=1)
    if known.any():
        panel.plot(
            part.truth[known, right],
            part.truth[known, up],
            "-",
            color=_TRUTH_COLOUR,
            linewidth=3.2,
            alpha=0.55,
            label="true path",
            zorder=3,
        )
    few = len(part.path) <= 60
    panel.plot(
        part.path[:, right],
        part.path[:, up],
        "o-",
        color=_PATH_COLOUR,
        linewidth=1.1,
        markersize=4.0 if few else 0.0,
        label="camera path",
        zorder=4,
    )
    if len(part.path):
        panel.plot(
            part.path[:1, right],
            part.path[:1, up],
            "o",
            color="white",
            markeredgecolor=_PATH_COLOUR,
            markeredgewidth=1.6,
            markersize=7.5,
            label="first view",
            zorder=5,
        )


def _draw_errors(figure_class: Any, scene: Scene, parts: list[_Part], unit: str) -> Any:
    figure = figure_class(figsize=(13.4, 5.9), layout="constrained")
    above, histogram = figure.subplots(1, 2)
    if not parts:
        _say_nothing_known([above, histogram])
        return figure
    part = parts[0]
    middle, half = _limits(part)
    shown = _sample(len(part.points))
    shown = shown[np.argsort(part.error_deg[shown], kind="stable")]
    known = part.error_deg[np.isfinite(part.error_deg)]
    top = float(np.percentile(known, 97.0)) if len(known) else 1.0
    dots = above.scatter(
        part.points[shown, 0],
        part.points[shown, 1],
        c=part.error_deg[shown],
        cmap="viridis_r",
        s=_dot_size(len(shown)) ** 2,
        vmin=0.0,
        vmax=top or 1.0,
        linewidths=0,
        plotnonfinite=False,
        rasterized=True,
    )
    above.plot(part.path[:, 0], part.path[:, 1], "-", color=_TRUTH_COLOUR, linewidth=1.4)
    _frame(above, middle, half, (0, 1), _axis_names(scene, unit))
    above.set_title(
        "Angular error of each point" + (f", part {part.index + 1}" if scene.n_components > 1 else ""), fontsize=12
    )
    figure.colorbar(dots, ax=above, label="angular rms of the point (degrees)", shrink=0.85, extend="max")
    _draw_histogram(histogram, scene)
    return figure


def _draw_histogram(panel: Any, scene: Scene) -> None:
    known = np.isfinite(scene.residual_rad)
    residual_deg = np.degrees(scene.residual_rad)
    used, dropped = residual_deg[known & scene.inlier], residual_deg[known & ~scene.inlier]
    smallest = 1e-9
    everything = np.maximum(np.concatenate((used, dropped)), smallest)
    panel.set_title("Angle between each bearing and its prediction", fontsize=12)
    panel.set_xlabel("degrees")
    panel.set_ylabel("observations")
    if not len(everything):
        _say_nothing_known([panel])
        return
    low, high = np.percentile(everything, 0.2), everything.max()
    edges = np.geomspace(max(low, smallest) * 0.8, max(high, 2.0 * low) * 1.05, 70)
    panel.set_xscale("log")
    for values, colour, name in ((used, _PART_COLOURS[0], "used"), (dropped, _PART_COLOURS[1], "outliers")):
        if len(values):
            panel.hist(
                np.maximum(values, smallest), bins=edges, color=colour, alpha=0.75, label=f"{name} ({len(values):,})"
            )
    panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panel.legend(fontsize=9)
    panel.grid(alpha=0.25, linewidth=0.6)


def _frame(panel: Any, middle: Float, half: float, axes: tuple[int, int], names: list[str]) -> None:
    right, up = axes
    panel.set_aspect("equal")
    panel.set_xlim(middle[right] - half, middle[right] + half)
    panel.set_ylim(middle[up] - half, middle[up] + half)
    panel.set_xlabel(names[right])
    panel.set_ylabel(names[up])
    panel.grid(alpha=0.25, linewidth=0.6)


def _axis_names(scene: Scene, unit: str) -> list[str]:
    is_world = np.array_equal(_axes(scene), np.eye(scene.d))
    names = ["x", "y", "z"] if is_world else ["right", "ahead", "up"]
    return [f"{name} ({unit})" if unit else name for name in names]


def _say_nothing_known(panels: Any) -> None:
    for panel in panels:
        panel.text(0.5, 0.5, "nothing is determined", ha="center", va="center", transform=panel.transAxes)


def _sample(count: int) -> npt.NDArray[np.intp]:
    """At most ``_MOST_POINTS`` indices, spread evenly: the same picture every time."""
    if count <= _MOST_POINTS:
        return np.arange(count)
    return np.linspace(0, count - 1, _MOST_POINTS).astype(np.intp)


def _dot_size(count: int) -> float:
    """Diameter of a dot, in typographic points: small enough that many do not become one blot."""
    return float(np.clip(150.0 / np.sqrt(max(count, 1)), 1.6, 7.0))
