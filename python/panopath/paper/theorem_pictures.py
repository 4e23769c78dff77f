"""A panel for each ambiguity of the paper, and for the conics that it misses, with a null mode drawn as arrows."""

from __future__ import annotations

from typing import Any

import numpy as np

from panopath.certificate import Certificate
from panopath.model import Float
from panopath.paper.experiment import Picture
from panopath.paper.scenes import null_vector, rays, truth_of
from panopath.paper.theorem_scenes import KINDS, Kind, Places
from panopath.steps.certificate import certify

#: Kinds that are drawn: those of the plane that are ambiguous.
_DRAWN = (
    "camera collinearity",
    "point collinearity",
    "two lines I",
    "two lines II",
    "one camera",
    "two cameras",
    "two points",
    "Theorem II, cameras in line",
    "Theorem II, conic",
    "ellipse",
    "hyperbola",
    "parabola",
)
_COLUMNS = 4
#: Scenes to choose from, for each panel.
_DRAWS = 60
_STILL, _MOVING, _RAY = "#1f5fa8", "#d9480f", "#b8c0c8"
#: Length of the longest arrow, as a share of the half width of the panel.
_ARROW = 0.35
#: Of the fastest, the share below which a member stands still.
_SLOW = 1e-6


def mode_picture(seed: int) -> Picture:
    """Draw a scene of each kind; the same seed gives the same picture."""

    def draw(figure: Any) -> None:
        panels = figure.subplots(len(_DRAWN) // _COLUMNS, _COLUMNS)
        by_name = {kind.name: kind for kind in KINDS}
        for number, (panel, name) in enumerate(zip(panels.flat, _DRAWN, strict=True)):
            _draw_mode(panel, _clearest(by_name[name], np.random.default_rng((seed, number))))
            panel.set_title(name, fontsize=10)
        for panel in panels[-1]:
            panel.set_xlabel("x (units of the scene)", fontsize=8)
        for panel in panels[:, 0]:
            panel.set_ylabel("y (units of the scene)", fontsize=8)
        handles, labels = _legend(panels.flat[0])
        figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False, fontsize=9)

    caption = (
        "Ambiguous scenes of the plane, each with a null vector of its equations: moved along the arrows, "
        "by any step, they keep every bearing. The last four satisfy the words of Theorem I or II."
    )
    return Picture(draw, caption, 13.0, 10.4)


def _clearest(kind: Kind, rng: np.random.Generator) -> Places:
    """Draw some scenes, and take the one whose members keep farthest apart for its size."""

    def clearance(places: Places) -> float:
        everything = np.vstack(places)
        apart = np.linalg.norm(everything[:, None] - everything, axis=2)
        return float(apart[np.triu_indices(len(everything), 1)].min() / apart.max())

    return max((kind.draw(rng) for _ in range(_DRAWS)), key=clearance)


def _draw_mode(panel: Any, places: Places) -> None:
    centers, points = places
    tracks = rays(centers, points)
    scene = truth_of(tracks, centers, points)
    moved = _displacement(certify(tracks, scene), places)
    everything = np.vstack((centers, points))
    low, high = everything.min(axis=0), everything.max(axis=0)
    middle, half = 0.5 * (low + high), 0.72 * float((high - low).max())
    speed = np.linalg.norm(moved, axis=1)
    moves = speed > _SLOW * speed.max()
    tips = everything + moved * (_ARROW * half / speed.max())
    if (np.abs(tips - middle) > half).any():
        # a null vector has no sign: the side on which there is room
        moved = -moved
    for view, track in zip(tracks.view, tracks.track, strict=True):
        panel.plot(*np.array((centers[view], points[track])).T, color=_RAY, linewidth=0.5, zorder=1)
    for place, step in zip(everything[moves], moved[moves] * (_ARROW * half / speed.max()), strict=True):
        arrow = {
            "arrowstyle": "-|>",
            "color": _MOVING,
            "linewidth": 1.3,
            "mutation_scale": 9,
            "shrinkA": 0,
            "shrinkB": 0,
        }
        panel.annotate("", xy=place + step, xytext=place, zorder=5, arrowprops=arrow)
    for marker, members in (("s", slice(0, len(centers))), ("o", slice(len(centers), None))):
        for colour, mask in ((_STILL, ~moves[members]), (_MOVING, moves[members])):
            panel.plot(
                *everything[members][mask].T, marker, color=colour, markersize=6, markeredgecolor="white", zorder=4
            )
    panel.set(xlim=middle[0] + half * np.array((-1, 1)), ylim=middle[1] + half * np.array((-1, 1)), aspect="equal")
    panel.tick_params(labelsize=7, length=2)
    panel.locator_params(nbins=5)


def _displacement(certificate: Certificate, places: Places) -> Float:
    """Give the first null vector with as much as possible standing still."""
    moved = np.vstack(null_vector(certificate))
    return moved - _stillest(np.vstack(places), moved)


def _stillest(places: Float, moved: Float) -> Float:
    """Find the shift and growth of everything, through two of its members, that leaves the most of them at rest."""
    best, fewest = np.zeros_like(moved), (len(moved) + 1, np.inf)
    for i in range(len(places)):
        for j in range(i):
            between = places[i] - places[j]
            scale = float((moved[i] - moved[j]) @ between / (between @ between))
            common = moved[j] + scale * (places - places[j])
            left = np.linalg.norm(moved - common, axis=1)
            cost = (int((left > _SLOW * np.abs(moved).max()).sum()), float(left.sum()))
            if cost < fewest:
                best, fewest = common, cost
    return best


def _legend(panel: Any) -> tuple[list[Any], list[str]]:
    named = (
        ("s", _STILL, "camera at rest"),
        ("s", _MOVING, "camera that moves"),
        ("o", _STILL, "point at rest"),
        ("o", _MOVING, "point that moves"),
    )
    handles = [panel.plot([], [], marker, color=colour, markersize=6)[0] for marker, colour, _ in named]
    return handles, [label for *_, label in named]
