"""Pictures of a certificate: parts in colours, what can slide as arrows, weak modes as ellipses (extra ``plot``)."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.certificate import Cause, Certificate, Mode
from panopath.model import Float, Scene
from panopath.movers import at_rest
from panopath.report.pictures import _axes, _axis_names, _dot_size, _sample, matplotlib_figure

Index = npt.NDArray[np.intp]

#: Parts with a colour of their own, the largest first; the others share the last one.
_PART_COLOURS = ("#1f5fa8", "#2e8b57", "#7a3f98", "#b8860b", "#008b8b", "#707070")
_LOOSE = "#d9480f"
_WEAK = "#e0218a"
_SHAPE = "#444444"
#: Arrows and ellipses drawn; more hide the scene.
_MOST_ARROWS = 50
_MOST_ELLIPSES = 200
#: Rays are drawn where there are no more than this.
_MOST_RAYS = 400
#: So few points are all inside the picture.
_FEW_POINTS = 25
#: Causes whose line or conic is drawn.
_MOST_SHAPES = 6
#: Length of an arrow, and of the largest ellipse, as a share of the picture.
_ARROW_SHARE = 0.09
_ELLIPSE_SHARE = 0.10
#: Of the longest arrow, the share below which one would be all head.
_SHORTEST_ARROW = 0.12
#: Steps by which a movement is made larger so that it can be seen.
_STEPS = (1, 2, 5)
#: A movement below this share of another one is none.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class _Drawn:
    """A scene ready to draw: coordinates right, ahead and up; -1 belongs to no part."""

    scene: Scene
    certificate: Certificate
    axes: Float
    views: Float
    points: Float
    middle: Float
    half: float

    def inside(self, place: Float) -> npt.NDArray[np.bool_]:
        """Tell which places the picture shows; NaN are none."""
        return np.asarray((np.abs(place - self.middle) <= self.half).all(axis=1))

    def turned(self, vectors: Float) -> Float:
        return np.asarray(vectors @ self.axes.T)


def draw_certificate(scene: Scene, certificate: Certificate, folder: str | PathLike[str], unit: str = "") -> list[Path]:
    """Draw ``certificate.png``: the scene from above, and from the side in space, with what its certificate says.

    Rigid parts have a colour each; members of none are orange, with an arrow along the line on which they can slide.
    Where more than single members move, arrows show the first null mode, the largest part standing still. Weak modes
    are ellipses about the views, made larger by the factor that the legend tells. Lines and conics behind the causes
    are dashed.

    Parameters
    ----------
    scene
        What was certified.
    certificate
        What was found.
    folder
        Where to; it exists.
    unit
        Unit of the scene, for the axes.

    Returns
    -------
    list of Path
        The file written.

    Raises
    ------
    MissingExtraError
        Without matplotlib.
    """
    figure_class = matplotlib_figure()
    # the certificate is of what rests
    drawn = _prepared(at_rest(scene), certificate)
    planes = [("from above", 0, 1)] + ([("from the side", 0, 2)] if scene.d == 3 else [])
    figure = figure_class(figsize=(6.6 * len(planes) + 0.4, 7.6), layout="constrained")
    panels = figure.subplots(1, len(planes), squeeze=False)[0]
    for panel, (title, right, up) in zip(panels, planes, strict=True):
        _draw_panel(panel, drawn, (right, up))
        _frame(panel, drawn, (right, up), unit)
        panel.set_title(title[:1].upper() + title[1:], fontsize=12)
    text = certificate.sentence(scene.view_labels(), scene.track_labels())
    # the empty line keeps the sentence off the titles below it
    figure.suptitle("\n".join([*textwrap.wrap(text, 82 * len(planes)), ""]), fontsize=11)
    _legend(figure, panels[0])
    path = Path(folder) / "certificate.png"
    figure.savefig(path, dpi=120, metadata={"Software": None})
    return [path]


def explain(
    certificate: Certificate, scene: Scene, folder: str | PathLike[str] | None = None
) -> tuple[list[str], list[Path]]:
    """Say which conditions fail, by the names of the scene, and draw them where a folder is given.

    Parameters
    ----------
    certificate
        What was found.
    scene
        What was certified.
    folder
        Where pictures go; it exists. None: no pictures.

    Returns
    -------
    tuple
        The lines of ``certificate.explain`` and the pictures written.

    Raises
    ------
    MissingExtraError
        Where pictures are asked for without matplotlib.
    """
    places = (scene.centers, at_rest(scene).points)
    lines = certificate.explain(scene.view_labels(), scene.track_labels(), places)
    return lines, [] if folder is None else draw_certificate(scene, certificate, folder)


def _prepared(scene: Scene, certificate: Certificate) -> _Drawn:
    axes = _axes(scene)
    views, points = scene.centers @ axes.T, scene.points @ axes.T
    middle, half = _extent(views, points)
    return _Drawn(scene, certificate, axes, views, points, middle, half)


def _extent(views: Float, points: Float) -> tuple[Float, float]:
    """Middle and half width of the picture: all views, and the points but for the farthest."""
    path, cloud = (values[np.isfinite(values).all(axis=1)] for values in (views, points))
    seen = path if len(path) else cloud
    if not len(seen):
        return np.zeros(views.shape[1]), 1.0
    low, high = seen.min(axis=0), seen.max(axis=0)
    path_half = 0.5 * float((high - low).max())
    if len(cloud):
        distance = np.abs(cloud - 0.5 * (low + high)).max(axis=1)
        reach = float(distance.max())
        if len(cloud) > _FEW_POINTS:
            reach = min(float(np.percentile(distance, 95.0)), 2.0 * float(np.median(distance)))
        near = cloud[distance <= max(min(reach, 8.0 * path_half if path_half > 0.0 else np.inf), path_half)]
        low, high = np.vstack((near, low)).min(axis=0), np.vstack((near, high)).max(axis=0)
    half = 0.5 * float((high - low).max())
    return 0.5 * (low + high), 1.12 * half if half > 0.0 else 1.0


def _draw_panel(panel: Any, drawn: _Drawn, plane: tuple[int, int]) -> None:
    _draw_rays(panel, drawn, plane)
    for cause in drawn.certificate.causes[:_MOST_SHAPES]:
        _draw_shape(panel, drawn, cause, plane)
    _draw_members(panel, drawn, plane)
    _draw_weak(panel, drawn, plane)
    _draw_slides(panel, drawn, plane)
    _draw_null(panel, drawn, plane)


def _draw_rays(panel: Any, drawn: _Drawn, plane: tuple[int, int]) -> None:
    tracks = drawn.scene.tracks
    if tracks is None or len(tracks) > _MOST_RAYS:
        return
    for i, j in zip(tracks.view.tolist(), tracks.track.tolist(), strict=True):
        ends = np.array([drawn.views[i], drawn.points[j]])[:, plane]
        panel.plot(ends[:, 0], ends[:, 1], "-", color="#9aa5b1", linewidth=0.6, alpha=0.7, zorder=1)


def _draw_shape(panel: Any, drawn: _Drawn, cause: Cause, plane: tuple[int, int]) -> None:
    """Draw the line or conic through the members of a cause; a conic lies in the plane, where axes are the world's."""
    style = {"linestyle": (0, (6, 4)), "color": _SHAPE, "linewidth": 1.1}
    if cause.shape.ndim == 2 and len(cause.shape) >= 2:
        for k in range(0, len(cause.shape) - 1, 2):
            start, along = drawn.turned(cause.shape[k : k + 2])[:, plane]
            if np.linalg.norm(along) > 1e-3:
                panel.axline(start, start + along, zorder=2, **style)
                panel.plot([], [], label="line of a cause", **style)
    elif cause.shape.shape == (6,) and drawn.scene.d == 2:
        x, y = (drawn.middle[k] + drawn.half * np.linspace(-1.0, 1.0, 400) for k in (0, 1))
        monomials = np.array(_monomials(*np.meshgrid(x, y)))
        panel.contour(
            x,
            y,
            np.tensordot(cause.shape, monomials, axes=1),
            levels=[0.0],
            colors=_SHAPE,
            linestyles="--",
            linewidths=1.1,
            zorder=2,
        )
        panel.plot([], [], label=cause.detail or "conic", **style)


def _monomials(x: Float, y: Float) -> tuple[Float, ...]:
    return x * x, x * y, y * y, x, y, np.ones_like(x)


def _draw_members(panel: Any, drawn: _Drawn, plane: tuple[int, int]) -> None:
    """Draw points as dots and views as squares, parts in their colours, members of none hollow."""
    certificate = drawn.certificate
    view_part, track_part = (
        np.minimum(owner, len(_PART_COLOURS) - 1) for owner in (certificate.view_component, certificate.track_component)
    )
    shown = _sample(len(drawn.points))
    size = _dot_size(len(shown))
    for part in range(-1, len(_PART_COLOURS)):
        dots, squares = drawn.points[shown[track_part[shown] == part]], drawn.views[view_part == part]
        dots, squares = (rows[drawn.inside(rows)][:, plane] for rows in (dots, squares))
        if not len(dots) and not len(squares):
            continue
        colour, label = (_LOOSE, "in no part") if part < 0 else (_PART_COLOURS[part], _part_label(certificate, part))
        panel.plot(
            dots[:, 0],
            dots[:, 1],
            "o",
            markersize=size,
            color=colour,
            alpha=0.75,
            markeredgewidth=0,
            zorder=4,
            rasterized=True,
        )
        few = len(drawn.views) <= 150
        panel.plot(
            squares[:, 0],
            squares[:, 1],
            "s",
            markersize=7.0 if few else 3.5,
            color=colour,
            markeredgecolor="white",
            markeredgewidth=1.0 if few else 0.3,
            zorder=5,
        )
        panel.plot([], [], "s", color=colour, markersize=7.0, label=label)
    hinges = certificate.hinges[:_MOST_ARROWS]
    rows = np.array(
        [drawn.views[v] for h in hinges for v in h.views] + [drawn.points[t] for h in hinges for t in h.tracks]
    )
    if len(rows):
        panel.plot(
            rows[:, plane[0]],
            rows[:, plane[1]],
            "o",
            markersize=12.0,
            markerfacecolor="none",
            markeredgecolor="black",
            markeredgewidth=1.3,
            zorder=6,
            label="hinge",
        )


def _part_label(certificate: Certificate, part: int) -> str:
    if part == len(_PART_COLOURS) - 1 and len(certificate.components) > len(_PART_COLOURS):
        return f"{len(certificate.components) - part} further parts"
    return f"part {part + 1} ({certificate.components[part].verdict})"


def _draw_slides(panel: Any, drawn: _Drawn, plane: tuple[int, int]) -> None:
    """Draw an arrow with two heads along each line on which a single member can slide."""
    certificate = drawn.certificate
    place = np.vstack((drawn.views, drawn.points))
    line = drawn.turned(np.vstack((certificate.view_line, certificate.track_line)))
    sliding = np.flatnonzero(np.isfinite(line).all(axis=1) & drawn.inside(place))
    for member in _spread(sliding, _MOST_ARROWS):
        reach = 2.0 * _ARROW_SHARE * drawn.half * line[member][list(plane)]
        middle = place[member][list(plane)]
        _arrow(panel, middle - reach, middle + reach, "<|-|>", _LOOSE)
    if len(sliding):
        panel.plot([], [], "-", color=_LOOSE, linewidth=1.8, label="can slide along")


def _draw_null(panel: Any, drawn: _Drawn, plane: tuple[int, int]) -> None:
    """Draw the first null mode that is more than single members sliding, what moves most by an arrow's length."""
    certificate = drawn.certificate
    nulls = [mode for mode in certificate.modes if mode.is_null]
    alone = np.isfinite(np.vstack((certificate.view_line, certificate.track_line))).all(axis=1)
    place = np.vstack((drawn.views, drawn.points))
    for mode in nulls:
        moved = drawn.turned(_moved(certificate.settled(mode, drawn.scene.centers, drawn.scene.points)))
        speed = np.where(np.isfinite(moved).all(axis=1), np.linalg.norm(moved, axis=1), 0.0)
        near = drawn.inside(place)
        most = speed[~alone & near].max(initial=0.0)
        if most <= _ROUNDING * max(speed.max(initial=0.0), 1e-300):
            continue
        movers = np.flatnonzero((speed > _SHORTEST_ARROW * most) & ~alone & near)
        n_views = int(np.searchsorted(movers, len(drawn.views)))
        movers = np.array([*_spread(movers[:n_views], _MOST_ARROWS), *_spread(movers[n_views:], _MOST_ARROWS)])
        scale = 2.0 * 1.6 * _ARROW_SHARE * drawn.half / most
        for member in movers:
            start = place[member][list(plane)]
            _arrow(panel, start, start + scale * moved[member][list(plane)], "-|>", "#111111")
        others = f", 1 of {len(nulls):,}" if len(nulls) > 1 else ""
        panel.plot([], [], "-", color="#111111", linewidth=1.4, label=f"moves unseen (null mode{others})")
        return


def _moved(mode: Mode) -> Float:
    return np.vstack((mode.view_displacement, mode.track_displacement))


def _draw_weak(panel: Any, drawn: _Drawn, plane: tuple[int, int]) -> None:
    """Draw an ellipse of one standard deviation about each view: all weak modes together."""
    weak = [mode.view_displacement for mode in drawn.certificate.modes if not mode.is_null]
    if not weak:
        return
    moved = np.array([drawn.turned(rows)[:, plane] for rows in weak])
    covariance = np.einsum("kia,kib->iab", moved, moved)
    known = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)) & np.isfinite(drawn.views).all(axis=1))
    largest = float(np.sqrt(np.linalg.eigvalsh(covariance[known])[:, -1].max(initial=0.0)))
    if largest <= 0.0:
        return
    scale = _round_factor(_ELLIPSE_SHARE * 2.0 * drawn.half / largest)
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    circle = np.column_stack((np.cos(angle), np.sin(angle)))
    for view in _spread(known, _MOST_ELLIPSES):
        values, vectors = np.linalg.eigh(covariance[view])
        curve = drawn.views[view][list(plane)] + scale * (circle * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        panel.fill(curve[:, 0], curve[:, 1], facecolor=_WEAK, edgecolor=_WEAK, alpha=0.22, linewidth=0.8, zorder=3)
    factor = f"{scale:g}" if scale < 1000 else f"{scale:,.0f}"
    panel.plot([], [], "o", color=_WEAK, alpha=0.5, markersize=9, label=f"weak modes, one sigma, drawn {factor} times")


def _round_factor(factor: float) -> float:
    """Give the largest 1, 2 or 5 times a power of ten that is no larger."""
    power = 10.0 ** np.floor(np.log10(factor))
    return float(max(step * power for step in _STEPS if step * power <= factor * (1.0 + 1e-12)))


def _arrow(panel: Any, start: Float, end: Float, style: str, colour: str) -> None:
    if np.linalg.norm(end - start) > 0.0:
        arrow = {"arrowstyle": style, "color": colour, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0}
        drawn = panel.annotate("", xy=end, xytext=start, zorder=7, annotation_clip=False, arrowprops=arrow)
        drawn.arrow_patch.set(mutation_scale=11, clip_box=panel.bbox)


def _spread(members: Index, most: int) -> list[int]:
    """At most so many of them, evenly spread: the same ones every time."""
    if len(members) <= most:
        return [int(member) for member in members]
    return [int(member) for member in members[np.linspace(0, len(members) - 1, most).astype(np.intp)]]


def _frame(panel: Any, drawn: _Drawn, plane: tuple[int, int], unit: str) -> None:
    names = _axis_names(drawn.scene, unit)
    panel.set_aspect("equal")
    for axis, limits, label in (
        (plane[0], panel.set_xlim, panel.set_xlabel),
        (plane[1], panel.set_ylim, panel.set_ylabel),
    ):
        limits(drawn.middle[axis] - drawn.half, drawn.middle[axis] + drawn.half)
        label(names[axis])
    panel.grid(alpha=0.25, linewidth=0.6)


def _legend(figure: Any, panel: Any) -> None:
    handles, names = panel.get_legend_handles_labels()
    told = dict(zip(names, handles, strict=True))
    if told:
        figure.legend(
            told.values(),
            told.keys(),
            loc="outside lower center",
            ncols=min(4 if len(figure.axes) > 1 else 2, len(told)),
            fontsize=9,
            frameon=False,
        )
