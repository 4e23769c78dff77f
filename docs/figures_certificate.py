"""The gallery of ambiguities: ``python -m docs.figures_certificate`` draws docs/img/gallery again.

Each picture is of a scene with exact bearings. It is certified, and moves along the null mode that its certificate
gives; nothing else is told to the drawing. ``sheet.png`` has all of them with both ends of the movement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
from matplotlib.figure import Figure
from panopath.certificate import Certificate, Mode
from panopath.formats.structure import known_scene
from panopath.report.animation import (
    GUIDE_COLOUR,
    RAY_COLOUR,
    STILL_COLOUR,
    Frames,
    animate_mode,
    guide_curves,
    mode_frames,
    null_modes,
)
from panopath.steps import CertifyOptions, certify

Float = npt.NDArray[np.float64]
Positions = Sequence[tuple[float, float]]

FOLDER = Path(__file__).parent / "img" / "gallery"
#: The bearings are exact; this is what noise is taken to be, radians.
SIGMA_RAD = 1e-6


@dataclass(frozen=True)
class Exhibit:
    """One scene: who is where, and who sees whom."""

    name: str
    title: str
    views: Positions
    points: Positions
    #: Pairs (view, point) that are not seen.
    hidden: Sequence[tuple[int, int]] = ()
    #: Pairs that are seen; None: all but the hidden ones.
    seen: Sequence[tuple[int, int]] | None = None
    #: Members to hold still (views, then points): a choice of gauge. None: the largest rigid part.
    still: Sequence[int] | None = field(default=None)

    def scene(self) -> pp.Scene:
        """Make the scene, its bearings exact."""
        pairs = self.seen or [
            (i, j) for i in range(len(self.views)) for j in range(len(self.points)) if (i, j) not in self.hidden
        ]
        view, track = np.array(pairs).T
        centers, points = np.array(self.views, dtype=np.float64), np.array(self.points, dtype=np.float64)
        ray = points[track] - centers[view]
        bearing = ray / np.linalg.norm(ray, axis=1, keepdims=True)
        tracks = pp.Tracks.from_arrays(view, track, bearing, len(centers), len(points))
        return known_scene(tracks, None, centers, points)


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    shown = []
    for exhibit in EXHIBITS:
        scene = exhibit.scene()
        assert scene.tracks is not None
        certificate = certify(scene.tracks, scene, CertifyOptions(sigma_rad=SIGMA_RAD))
        mode = balanced_mode(scene, certificate, exhibit.still)
        animate_mode(scene, certificate, FOLDER / f"{exhibit.name}.svg", mode=mode, still=exhibit.still)
        shown.append((exhibit, scene, certificate, mode))
        print(f"{exhibit.title}: {certificate.sentence()}")
    draw_sheet(shown).savefig(FOLDER / "sheet.png", dpi=100, metadata={"Software": None})


def balanced_mode(scene: pp.Scene, certificate: Certificate, still: Sequence[int] | None) -> Mode:
    """Choose, where there are two null modes, the mixture along which the laziest part moves the most.

    Any mixture of null modes is a null mode; which ones a certificate gives is an accident.
    """
    first, *others = null_modes(scene, certificate)
    if len(others) != 1:
        return first
    angles = np.linspace(0.0, np.pi, 24, endpoint=False)
    mixtures = [
        replace(
            first,
            view_displacement=np.cos(a) * first.view_displacement + np.sin(a) * others[0].view_displacement,
            track_displacement=np.cos(a) * first.track_displacement + np.sin(a) * others[0].track_displacement,
        )
        for a in angles
    ]

    def laziest(mode: Mode) -> float:
        frames = mode_frames(scene, certificate, mode, still, n_frames=4)
        moved = np.linalg.norm(frames.points[1] - frames.points[0], axis=1)
        return min(float(moved[part.tracks].max()) for part in certificate.components if moved[part.tracks].any())

    return max(mixtures, key=laziest)


def draw_sheet(shown: Sequence[tuple[Exhibit, pp.Scene, Certificate, Mode]]) -> Figure:
    """Draw all exhibits on one sheet: as they are, and faintly where else they could be."""
    columns = 3
    figure = Figure(figsize=(4.4 * columns, 3.5 * math.ceil(len(shown) / columns)), layout="constrained")
    panels = figure.subplots(math.ceil(len(shown) / columns), columns).ravel()
    for panel, (exhibit, scene, certificate, mode) in zip(panels, shown, strict=False):
        frames = mode_frames(scene, certificate, mode, exhibit.still, n_frames=8)
        for curve in guide_curves(certificate, scene.centers, scene.points, 4.0):
            panel.plot(curve[:, 0], curve[:, 1], "--", color=GUIDE_COLOUR, linewidth=0.9, zorder=1)
        for step, alpha in ((2, 0.3), (6, 0.3), (0, 1.0)):
            draw_frame(panel, scene, frames, step, alpha)
        place = np.concatenate((frames.views, frames.points), axis=1).reshape(-1, 2)
        low, high = place.min(axis=0), place.max(axis=0)
        margin = 0.08 * float((high - low).max())
        panel.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal")
        panel.set_title(exhibit.title, fontsize=11)
        panel.axis("off")
    for panel in panels[len(shown) :]:
        panel.axis("off")
    return figure


def draw_frame(panel: Any, scene: pp.Scene, frames: Frames, step: int, alpha: float) -> None:
    assert scene.tracks is not None
    views, points = frames.views[step], frames.points[step]
    for i, j in zip(scene.tracks.view.tolist(), scene.tracks.track.tolist(), strict=True):
        if alpha == 1.0 or frames.view_moves[i] or frames.point_moves[j]:
            panel.plot(*np.array((views[i], points[j])).T, "-", color=RAY_COLOUR, linewidth=0.8, alpha=alpha, zorder=2)
    for places, colours, marker in ((views, frames.view_colours, "s"), (points, frames.point_colours, "o")):
        for place, colour in zip(places, colours, strict=True):
            if alpha == 1.0 or colour != STILL_COLOUR:
                panel.plot(*place, marker, color=colour, alpha=alpha, markersize=7, mec="white", zorder=4)


def on_ellipse(*degrees: float) -> Positions:
    return [(2.0 * math.cos(math.radians(a)), 1.15 * math.sin(math.radians(a))) for a in degrees]


def on_hyperbola(*arms: tuple[int, float]) -> Positions:
    return [(side * 1.2 * math.cosh(u), 1.15 * math.sinh(u)) for side, u in arms]


def windows() -> tuple[Positions, Positions, Sequence[tuple[int, int]]]:
    """Make a walk in three windows: all tracks end and restart at views 2 and 4."""
    views = [(-4.4, 0.1), (-3.1, -0.45), (-1.5, 0.25), (0.0, -0.3), (1.5, 0.3), (2.9, -0.4), (4.3, 0.05)]
    points = [
        *((-3.9, 2.1), (-2.3, 2.5), (-3.3, -2.5), (-2.2, -1.9)),
        *((-0.9, 1.9), (0.6, 2.6), (-0.7, -2.6), (0.8, -2.1)),
        *((2.2, 2.5), (3.7, 1.9), (2.1, -1.9), (3.6, -2.6)),
    ]
    return views, points, [(2 * w + i, 4 * w + k) for w in range(3) for i in range(3) for k in range(4)]


def desargues() -> tuple[Positions, Positions, Sequence[tuple[int, int]]]:
    """Make two rigid parts, and three rays between them that meet in one point: they stay in perspective from it."""
    views = [(-1.6, 0.2), (-1.0, 1.3), (-1.2, -1.0)]
    points = [(-2.6, 1.2), (-2.5, -1.1), (-2.1, 0.45)]
    through = [(-1.45 * x, -1.45 * y) for x, y in views]
    more_views = [(3.3, 1.2), (3.1, -1.3), (2.7, 0.3)]
    own = [(i, j) for i in range(3) for j in range(3)]
    other = [(3 + i, 3 + j) for i in range(3) for j in range(3)]
    return views + more_views, points + through, [*own, *other, *((i, 3 + i) for i in range(3))]


def hinge() -> tuple[Positions, Positions, Sequence[tuple[int, int]]]:
    """Make two rigid parts that share one point."""
    views = [(-3.2, -0.9), (-2.2, 1.5), (-1.0, -1.6), (1.1, 1.5), (2.4, -1.5), (3.3, 0.8)]
    points = [(0.0, 0.0), (-3.3, 0.7), (-1.5, 0.35), (1.3, -0.7), (3.1, -0.4)]
    left, right = (0, 1, 2), (3, 4, 5)
    return views, points, [(i, j) for i in left for j in (0, 1, 2)] + [(i, j) for i in right for j in (0, 3, 4)]


EXHIBITS = (
    Exhibit(
        "camera-collinearity",
        "Camera collinearity",
        [(-3.0, 0.0), (-1.6, 0.0), (-0.4, 0.0), (2.9, 0.0)],
        [(1.2, 0.0), (-2.2, 1.6), (0.6, -1.7), (2.3, 1.9)],
    ),
    Exhibit(
        "point-collinearity",
        "Point collinearity",
        [(1.2, 0.0), (-2.2, 1.6), (0.6, -1.7), (2.3, 1.9)],
        [(-3.0, 0.0), (-1.6, 0.0), (-0.4, 0.0), (2.9, 0.0)],
    ),
    Exhibit(
        "two-lines-1",
        "Two lines I",
        [(-3.0, -0.9), (-1.4, -0.42), (1.1, 0.33), (2.8, 0.84)],
        [(-0.9, 1.8), (-0.5, 1.0), (0.4, -0.8), (0.85, -1.7)],
        still=(0, 3),
    ),
    Exhibit(
        "two-lines-2",
        "Two lines II",
        [(-0.9, 0.0), (0.8, 0.0), (-2.9, 2.7), (2.8, 2.7)],
        [(-1.6, 2.7), (0.9, 2.7), (-3.0, 0.0), (2.7, 0.0)],
        still=(2, 3, 6, 7),
    ),
    Exhibit(
        "two-cameras",
        "Two cameras",
        [(-2.4, -0.3), (1.6, -1.0)],
        [(0.6, 2.2), (1.1, 0.6), (-1.0, 1.2), (-0.4, -1.6), (2.3, 0.9)],
        still=(0, 2, 3),
    ),
    Exhibit(
        "two-points",
        "Two points",
        [(0.6, 2.2), (1.1, 0.6), (-1.0, 1.2), (-0.4, -1.6), (2.3, 0.9)],
        [(-2.4, -0.3), (1.6, -1.0)],
        still=(0, 1, 5),
    ),
    Exhibit(
        "hidden-point",
        "Hidden point",
        [(-2.6, -0.7), (-1.0, -1.7), (1.2, -1.6), (2.7, -0.6)],
        [(-1.2, 0.2), (0.2, 1.5), (1.4, 0.6), (-1.9, 1.4), (0.55, 1.325)],
        hidden=[(1, 4), (2, 4), (3, 4)],
    ),
    Exhibit("desargues", "Desargues", *desargues()[:2], seen=desargues()[2]),
    Exhibit("ellipse", "Ellipse", on_ellipse(12, 98, 170, 285), on_ellipse(50, 140, 215, 325)),
    Exhibit(
        "hyperbola",
        "Hyperbola",
        on_hyperbola((1, -0.95), (1, 0.75), (-1, -0.1)),
        on_hyperbola((1, -0.15), (-1, 1.1), (-1, -1.15)),
    ),
    Exhibit("windows", "Windows", *windows()[:2], seen=windows()[2], still=(2, 3, 4, 11, 12, 13, 14)),
    Exhibit("hinge", "Hinge", *hinge()[:2], seen=hinge()[2]),
)


if __name__ == "__main__":
    main()
