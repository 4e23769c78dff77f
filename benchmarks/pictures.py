"""Pictures of real scenes: truth in black and grey, found in colour."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from panopath.model import Float

from benchmarks.optional import load
from benchmarks.planar_sets import PlanarSet
from benchmarks.victoria import Reference

COLOURS = {
    "robust": "tab:blue",
    "linear": "tab:orange",
    "from truth": "tab:green",
    "headings found": "tab:blue",
    "completed": "tab:orange",
    "from truth, refined": "tab:green",
}
MARKERS = {
    "robust": "+",
    "linear": "x",
    "from truth": ".",
    "headings found": "+",
    "completed": "x",
    "from truth, refined": ".",
}
Positions = dict[str, tuple[Float, Float]]


def _figure(columns: int, width: float, height: float) -> tuple[Any, Any]:
    load("matplotlib").use("Agg")
    figure, axes = load("matplotlib.pyplot").subplots(1, columns, figsize=(width, height), layout="constrained")
    return figure, np.atleast_1d(axes)


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=110, metadata={"Software": None})
    load("matplotlib.pyplot").close(figure)


def planar(path: Path, title: str, data: PlanarSet, found: Positions) -> None:
    """Stations and landmarks, true and found, one panel a method."""
    figure, axes = _figure(max(len(found), 1), 4.4 * max(len(found), 1), 5.4)
    for axis, (method, (stations, landmarks)) in zip(axes, found.items(), strict=False):
        axis.plot(*data.stations.T, ".", color="0.75", markersize=4, label="stations, true")
        axis.plot(*data.landmarks.T, "k^", markersize=7, label="landmarks, true")
        colour = COLOURS[method]
        axis.plot(*stations.T, MARKERS[method], color=colour, markersize=4, label="stations, found")
        axis.plot(*landmarks.T, "^", color=colour, markerfacecolor="none", markersize=9, label="landmarks, found")
        _frame(axis, np.vstack([data.stations, data.landmarks]), f"{title}: {method}")
        axis.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)
    _save(figure, path)


def _frame(axis: Any, shown: Float, title: str) -> None:
    """Equal axes in metres around what is true, with a margin: a stray point must not shrink the rest."""
    low, high = np.nanmin(shown, axis=0), np.nanmax(shown, axis=0)
    margin = 0.15 * float((high - low).max())
    axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=9)
    axis.set_xlabel("m")


def park(path: Path, reckoned: Float, reference: Reference, truth: tuple[Float, Float], found: Positions) -> None:
    """Dead reckoning and reference map on the left, views and trees from bearings alone on the right."""
    poses, trees = reference.poses, reference.trees
    figure, axes = _figure(2, 11.0, 5.6)
    axes[0].plot(*reckoned[:, :2].T, color="0.7", linewidth=0.8, label="dead reckoning")
    axes[0].plot(*poses[:, :2].T, "k", linewidth=0.8, label="reference path")
    axes[0].plot(*trees.T, "g.", markersize=4, label="reference trees")
    _frame(axes[0], np.vstack([reckoned[:, :2], poses[:, :2]]), "Victoria Park: odometry and reference")
    axes[0].legend(fontsize=7)
    axes[1].plot(*poses[:, :2].T, color="0.8", linewidth=0.6)
    axes[1].plot(*truth[0].T, "k.", markersize=3, label="views, reference")
    axes[1].plot(*truth[1].T, "k^", markersize=4, label="trees, reference")
    for method, (views, points) in found.items():
        axes[1].plot(*views.T, MARKERS[method], color=COLOURS[method], markersize=5, label=f"views, {method}")
        axes[1].plot(*points.T, "^", color=COLOURS[method], markerfacecolor="none", markersize=6)
    _frame(axes[1], np.vstack(truth), "largest part, reference headings, bearings alone")
    axes[1].legend(fontsize=7)
    _save(figure, path)


def space(path: Path, title: str, centers: Float, found: tuple[Float, Float], unit: str) -> None:
    """Path and points along the two longest axes of the path, and along the first and third."""
    middle = centers.mean(axis=0)
    axes_of_path = np.linalg.svd(centers - middle)[2]
    true, views, points = ((p - middle) @ axes_of_path.T for p in (centers, *found))
    near = np.nanquantile(np.linalg.norm(points, axis=1), 0.8)
    points = points[np.linalg.norm(points, axis=1) < near]
    figure, axes = _figure(2, 11.0, 4.8)
    for axis, (a, b) in zip(axes, ((0, 1), (0, 2)), strict=True):
        axis.plot(points[:, a], points[:, b], ",", color="0.6", label="points (nearest 80 %)")
        axis.plot(true[:, a], true[:, b], "ko", markersize=5, markerfacecolor="none", label="views, reference")
        axis.plot(views[:, a], views[:, b], "+-", color="tab:blue", markersize=5, linewidth=0.6, label="views, found")
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_xlabel(unit)
        axis.set_title(f"{title}, axes {a + 1} and {b + 1} of the path", fontsize=9)
    axes[0].legend(fontsize=7)
    _save(figure, path)


def walks(path: Path, title: str, centers: dict[str, Float], points: Float, unit: str) -> None:
    """Paths of several mappers from above and from the side (axes of the first path), with the first one's points."""
    first = next(iter(centers.values()))
    middle = np.nanmean(first, axis=0)
    axes_of_path = np.linalg.svd((first - middle)[np.isfinite(first).all(axis=1)])[2]
    size = float(np.nanmax(np.abs(first - middle)))
    shown = (points - middle) @ axes_of_path.T
    shown = shown[np.abs(shown).max(axis=1) < 4.0 * size]
    figure, axes = _figure(2, 12.0, 6.8)
    for axis, (a, b) in zip(axes, ((0, 1), (0, 2)), strict=True):
        axis.plot(shown[:, a], shown[:, b], ".", color="0.7", markersize=1.5, label="points")
        for (name, walk), marker in zip(centers.items(), "o+x^vs", strict=False):
            turned = (walk - middle) @ axes_of_path.T
            axis.plot(
                turned[:, a], turned[:, b], marker + "-", markersize=6, linewidth=0.6, fillstyle="none", label=name
            )
        axis.set(xlim=(-2.2 * size, 2.2 * size), ylim=(-2.2 * size, 2.2 * size), xlabel=unit)
        axis.set_aspect("equal")
        axis.set_title(f"{title}, axes {a + 1} and {b + 1} of the path", fontsize=9)
    axes[0].legend(fontsize=7)
    _save(figure, path)
