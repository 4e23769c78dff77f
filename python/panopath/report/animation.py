"""A null mode as an animated picture: the scene moves, and no bearing changes.

Places ``X + t N`` along a null vector ``N`` of known orientations keep every direction exactly, for every ``t``: the
movement drawn is not an approximation, but one scene after the other that fits the same bearings. ``t`` follows a sine,
sampled, so that the file needs no script and no style sheet: SVG with SMIL, which pictures in a page may use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
import numpy.typing as npt

from panopath.certificate import Cause, CauseKind, Certificate, Mode, hold_still
from panopath.errors import InputError
from panopath.model import Float, Int, Scene

Bool = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]

#: Steps of one period, and its length in seconds.
_STEPS = 32
_PERIOD_S = 6.0
#: No ray becomes shorter than this share of its length, and no member moves farther than that share of the picture.
_SHORTEST_RAY = 0.36
_LARGEST_MOVE = 0.26
_MARGIN = 0.09
#: Samples of a guide line, of one arm or half an ellipse.
_SAMPLES = 20
#: Below this share of the largest, a singular value or eigenvalue is zero.
_SINGULAR = 1e-9
#: A member this near to a line, as a share of the distance of the two that define it, lies on it.
_ON_LINE = 1e-3
#: What stands still; what moves, by the part that it belongs to, the first for members of none; rays that stand still.
STILL_COLOUR = "#1f3a5f"
MOVING_COLOURS = ("#d9480f", "#d9480f", "#0b7a75", "#7a3f98", "#b8860b")
RAY_COLOUR = "#a9b7c6"
GUIDE_COLOUR = "#7b8ea3"
_PAPER = "#ffffff"


@dataclass(frozen=True)
class Frames:
    """A scene at several times of its movement."""

    #: (s,) how far along the mode.
    times: Float
    #: (s, n_views, d) and (s, n_tracks, d).
    views: Float
    points: Float
    #: Which members move at all.
    view_moves: Bool
    point_moves: Bool
    #: Colour of each.
    view_colours: list[str]
    point_colours: list[str]


def mode_frames(
    scene: Scene,
    certificate: Certificate,
    mode: Mode | None = None,
    still: npt.ArrayLike | None = None,
    n_frames: int = _STEPS,
) -> Frames:
    """Positions of a scene at evenly spaced times of one period along a null mode, the first as it is.

    Parameters
    ----------
    scene
        With its observations; orientations known.
    certificate
        Of the scene.
    mode
        One of its null modes; default: the first.
    still
        Indices of members that shall stand still as far as the gauge can make them: views, then points counted on from
        ``n_views``. Default: the largest rigid part, or all that is left of the mode.
    n_frames
        Frames in a period.

    Returns
    -------
    Frames
        As far to either side as no ray shrinks below a third and nothing moves far out of the picture.

    Raises
    ------
    InputError
        Where there is no null mode to move along, or the scene has no observations.
    """
    found = mode or next(iter(null_modes(scene, certificate)), None)
    if found is None or scene.tracks is None or certificate.orientation != "known":
        raise InputError("certificate has no null mode of known orientations to move a scene along")
    if still is None:
        found = certificate.settled(found, scene.centers, scene.points)
    else:
        held: Int = np.array(still, dtype=np.int32)
        found = hold_still(found, scene.centers, scene.points, held, certificate.orientation)
    views, points = found.view_displacement, found.track_displacement
    reach = _reach(scene, scene.tracks.view, scene.tracks.track, found)
    times = reach * np.sin(2.0 * np.pi * np.arange(n_frames) / n_frames)
    least = 1e-6 * max(np.abs(views).max(initial=0.0), np.abs(points).max(initial=0.0))
    view_moves, point_moves = ((np.abs(step) > least).any(axis=1) for step in (views, points))
    return Frames(
        times,
        scene.centers + times[:, None, None] * views,
        scene.points + times[:, None, None] * points,
        view_moves,
        point_moves,
        *_colours(certificate, view_moves, point_moves),
    )


def null_modes(scene: Scene, certificate: Certificate) -> list[Mode]:
    """Give the null modes of a certificate, and one for each further member that can slide: of these it has the line.

    Parameters
    ----------
    scene, certificate
        As in :func:`mode_frames`.
    """
    sliding = np.vstack((certificate.view_line, certificate.track_line))
    found = [mode for mode in certificate.modes if mode.is_null]
    told = np.zeros(len(sliding), dtype=np.bool_)
    for mode in found:
        still = certificate.settled(mode, scene.centers, scene.points)
        told |= (np.abs(np.vstack((still.view_displacement, still.track_displacement))) > 0.0).any(axis=1)
    for member in np.flatnonzero(np.isfinite(sliding).all(axis=1) & ~told):
        moved = np.zeros_like(sliding)
        moved[member] = sliding[member]
        views, points = np.split(moved, [len(scene.centers)])
        found.append(Mode(0.0, True, np.inf, 0, views, points, np.zeros((len(views), 3))))
    return found


def _colours(certificate: Certificate, view_moves: Bool, point_moves: Bool) -> tuple[list[str], list[str]]:
    """Colour what moves by its part; the first moving part shares its colour with members of none."""
    owners = ((certificate.view_component, view_moves), (certificate.track_component, point_moves))
    parts = np.unique(np.concatenate([part[moves & (part >= 0)] for part, moves in owners])).tolist()
    rank = {index: 1 + k for k, index in enumerate(parts)}
    views, points = (
        [
            MOVING_COLOURS[rank.get(index, 0) % len(MOVING_COLOURS)] if moving else STILL_COLOUR
            for index, moving in zip(part.tolist(), moves.tolist(), strict=True)
        ]
        for part, moves in owners
    )
    return views, points


def _reach(scene: Scene, view: Int, track: Int, mode: Mode) -> float:
    """How far the movement may go: rays stay rays, and members stay in sight."""
    ray = scene.points[track] - scene.centers[view]
    change = mode.track_displacement[track] - mode.view_displacement[view]
    stretch = np.abs((ray * change).sum(axis=1) / (ray * ray).sum(axis=1)).max(initial=0.0)
    place = np.vstack((scene.centers, scene.points))
    size = float((place.max(axis=0) - place.min(axis=0)).max())
    speed = float(np.linalg.norm(np.vstack((mode.view_displacement, mode.track_displacement)), axis=1).max(initial=0.0))
    limits = [
        limit / rate for limit, rate in ((1.0 - _SHORTEST_RAY, stretch), (_LARGEST_MOVE * size, speed)) if rate > 0.0
    ]
    return min(limits, default=0.0)


def animate_mode(
    scene: Scene,
    certificate: Certificate,
    path: str | PathLike[str],
    *,
    mode: Mode | None = None,
    still: npt.ArrayLike | None = None,
    width: int = 420,
    height: int = 300,
) -> Path:
    """Write an animated SVG of a scene that moves along a null mode, from above; its bearings do not change.

    Views are squares, points dots; what moves is orange, with its line dashed and its first place hollow. Where all
    members lie on one conic they do so all the time, and it is drawn too.

    Parameters
    ----------
    scene, certificate, mode, still
        As in :func:`mode_frames`.
    path
        The file to write.
    width, height
        Size of the picture in pixels.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        As :func:`mode_frames`.
    """
    frames = mode_frames(scene, certificate, mode, still)
    assert scene.tracks is not None
    sheet = _Sheet.of(frames, width, height)
    views, points = sheet.put(frames.views), sheet.put(frames.points)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'role="img">',
        f"<title>{_escaped(certificate.sentence(scene.view_labels(), scene.track_labels()))}</title>",
        f'<rect x="0.5" y="0.5" width="{width - 1}" height="{height - 1}" rx="10" fill="{_PAPER}" stroke="#d5dce4"/>',
        *_guides(frames, sheet, certificate),
        *_lines(frames, views, points),
        *_rays(scene.tracks.view, scene.tracks.track, frames, views, points),
        *_ghosts(frames, views, points),
        *_members(frames, views, points),
        "</svg>",
    ]
    place = Path(path)
    place.write_text("\n".join(parts) + "\n", encoding="utf-8")
    return place


@dataclass(frozen=True)
class _Sheet:
    """From the plane to the paper, y upwards."""

    scale: float
    middle: Float
    center: Float
    width: int
    height: int

    @classmethod
    def of(cls, frames: Frames, width: int, height: int) -> _Sheet:
        place = np.concatenate((frames.views, frames.points), axis=1)[..., :2].reshape(-1, 2)
        low, high = place.min(axis=0), place.max(axis=0)
        room = np.array((width, height)) * (1.0 - 2.0 * _MARGIN)
        extent = np.maximum(high - low, 1e-12 * max(float((high - low).max()), 1e-300))
        return cls(float((room / extent).min()), 0.5 * (low + high), 0.5 * np.array((width, height)), width, height)

    def put(self, place: Float) -> Float:
        return np.asarray(self.center + (place[..., :2] - self.middle) * self.scale * (1.0, -1.0))


def _rays(view: Int, track: Int, frames: Frames, views: Float, points: Float) -> list[str]:
    told = []
    for i, j in zip(view.tolist(), track.tolist(), strict=True):
        ends = np.concatenate((views[:, i], points[:, j]), axis=1).T
        moving = frames.point_colours[j] if frames.point_moves[j] else frames.view_colours[i]
        colour, opacity = (RAY_COLOUR, "1") if moving == STILL_COLOUR else (moving, "0.5")
        series = dict(zip(("x1", "y1", "x2", "y2"), ends, strict=True))
        told.append(_element("line", series, f'stroke="{colour}" stroke-opacity="{opacity}" stroke-width="1.1"'))
    return told


def _lines(frames: Frames, views: Float, points: Float) -> list[str]:
    """Deformation lines: where each member that moves can be, as far as it goes here."""
    told = []
    for places, colours in ((views, frames.view_colours), (points, frames.point_colours)):
        for member, colour in enumerate(colours):
            (x1, y1), (x2, y2) = places[[np.argmin(frames.times), np.argmax(frames.times)], member]
            if colour != STILL_COLOUR:
                told.append(
                    f'<line x1="{_n(x1)}" y1="{_n(y1)}" x2="{_n(x2)}" y2="{_n(y2)}" stroke="{colour}" '
                    f'stroke-width="1.5" stroke-dasharray="1.5 4" stroke-linecap="round" opacity="0.8"/>'
                )
    return told


def _ghosts(frames: Frames, views: Float, points: Float) -> list[str]:
    """Hollow marks where what moves was at first."""
    told = []
    for places, colours, mark in ((views, frames.view_colours, _square), (points, frames.point_colours, _dot)):
        told += [
            mark(places[:1, member], f'fill="{_PAPER}" fill-opacity="0.6" stroke="{colour}" stroke-opacity="0.4"')
            for member, colour in enumerate(colours)
            if colour != STILL_COLOUR
        ]
    return told


def _members(frames: Frames, views: Float, points: Float) -> list[str]:
    """Draw what stands still first: what moves passes over it."""
    told = []
    for moving in (False, True):
        for places, colours, mark in ((views, frames.view_colours, _square), (points, frames.point_colours, _dot)):
            told += [
                mark(places[:, member], f'fill="{colour}" stroke="{_PAPER}" stroke-width="1.2"')
                for member, colour in enumerate(colours)
                if (colour != STILL_COLOUR) == moving
            ]
    return told


def _square(place: Float, style: str, half: float = 6.0) -> str:
    corner = {"x": place[:, 0] - half, "y": place[:, 1] - half}
    return _element("rect", corner, f'width="{_n(2 * half)}" height="{_n(2 * half)}" rx="2" {style}')


def _dot(place: Float, style: str, radius: float = 5.6) -> str:
    return _element("circle", {"cx": place[:, 0], "cy": place[:, 1]}, f'r="{radius}" {style}')


def _element(name: str, series: dict[str, Float], style: str) -> str:
    """Write one element; attributes that change in time are animated."""
    first = " ".join(f'{key}="{_n(values[0])}"' for key, values in series.items())
    moving = {key: _series(values) for key, values in series.items()}
    inside = "".join(_animate(key, texts) for key, texts in moving.items() if len(set(texts)) > 1)
    return f"<{name} {first} {style}>{inside}</{name}>" if inside else f"<{name} {first} {style}/>"


def _series(values: Float) -> list[str]:
    return [_n(value) for value in [*values.tolist(), float(values[0])]]


def _animate(attribute: str, texts: Sequence[str]) -> str:
    return (
        f'<animate attributeName="{attribute}" dur="{_PERIOD_S:g}s" repeatCount="indefinite" '
        f'values="{";".join(texts)}"/>'
    )


def _n(value: float) -> str:
    return f"{round(value, 1) + 0.0:.1f}".removesuffix(".0")


def _guides(frames: Frames, sheet: _Sheet, certificate: Certificate) -> list[str]:
    """Draw the conic or the lines of the causes, at each time those that the members then lie on."""
    reach = 0.75 * sheet.width / sheet.scale
    steps = [guide_curves(certificate, *places, reach) for places in zip(frames.views, frames.points, strict=True)]
    texts = [" ".join("M" + "L".join(f"{_n(x)} {_n(y)}" for x, y in sheet.put(c)) for c in curves) for curves in steps]
    if not texts[0]:
        return []
    style = f'fill="none" stroke="{GUIDE_COLOUR}" stroke-width="1.2" stroke-dasharray="6 4"'
    clip = f'<clipPath id="paper"><rect width="{sheet.width}" height="{sheet.height}" rx="10"/></clipPath>'
    steady = len(set(texts)) == 1
    moving = "" if steady else _animate("d", [*texts, texts[0]])
    return [clip, f'<path clip-path="url(#paper)" d="{texts[0]}" {style}>{moving}</path>']


def guide_curves(certificate: Certificate, views: Float, points: Float, reach: float) -> list[Float]:
    """Sample the line, pair of lines or conic behind each cause, through its members where they are now (plane only).

    Parameters
    ----------
    certificate
        Whose causes these are.
    views, points
        (n_views, 2) and (n_tracks, 2) positions now.
    reach
        Half the length of what goes to infinity.

    Returns
    -------
    list of array
        (k, 2) each.
    """
    found: list[Float] = []
    for cause in certificate.causes if views.shape[1] == 2 else ():
        through_views, through_points = views[cause.views], points[cause.tracks]
        if cause.kind in (CauseKind.CAMERA_COLLINEAR, CauseKind.POINT_COLLINEAR) and _one_line(cause):
            found.append(_line_through(np.vstack((through_views, through_points)), reach))
        elif cause.kind in (CauseKind.CONIC, CauseKind.TWO_LINES_1, CauseKind.TWO_LINES_2):
            found += conic_curves(np.vstack((through_views, through_points)), reach)
    return found


def _one_line(cause: Cause) -> bool:
    """Whether the members lie on one line: several loose ones of one kind share a cause, not a line."""
    return (len(cause.tracks) if cause.kind is CauseKind.CAMERA_COLLINEAR else len(cause.views)) == 1


def _line_through(members: Float, reach: float) -> Float:
    middle = members.mean(axis=0)
    along = np.linalg.svd(members - middle)[2][0]
    return np.asarray(middle + 2.0 * reach * np.outer((-1.0, 1.0), along * _sign(along)))


def conic_curves(members: Float, reach: float) -> list[Float]:
    """Sample the conic through five points or more; two lines are one, and may open into a hyperbola as members move.

    The same members moved a little give the same number of samples, each moved a little, as an animation needs.

    Parameters
    ----------
    members
        (k, 2) points on the conic.
    reach
        Half the length to sample where it goes to infinity.

    Returns
    -------
    list of array
        (n, 2) each: an ellipse once round; the four arms of a hyperbola, each from its vertex; two parallel lines.
        Empty where the members lie on more than one conic.
    """
    middle, size = members.mean(axis=0), float(np.abs(members - members.mean(axis=0)).max())
    x, y = ((members - middle) / size).T
    _, spread, rows = np.linalg.svd(np.column_stack((x * x, x * y, y * y, x, y, np.ones_like(x))))
    if len(members) < 5 or spread[4] < _SINGULAR * spread[0]:
        return []
    a, b, c, d, e, f = rows[-1]
    form, slope = np.array(((a, 0.5 * b), (0.5 * b, c))), np.array((d, e))
    values, axes = np.linalg.eigh(form)
    if np.abs(values).min() < _SINGULAR * np.abs(values).max():
        return [_line_through(members[rows], reach) for rows in _two_lines(members)]
    center = np.linalg.solve(form, -0.5 * slope)
    level = -(f + 0.5 * center @ slope)
    curves = _ellipse(values / level, axes) if values.prod() > 0.0 else _hyperbola(values, axes, level, reach / size)
    return [middle + size * (center + curve) for curve in curves]


def _ellipse(inverse_squares: Float, axes: Float) -> list[Float]:
    """Sample by a symmetric root, so that samples do not jump where the axes change places."""
    around = np.linspace(0.0, 2.0 * np.pi, 2 * _SAMPLES)
    root = axes @ np.diag(1.0 / np.sqrt(inverse_squares)) @ axes.T
    return [np.column_stack((np.cos(around), np.sin(around))) @ root]


def _hyperbola(values: Float, axes: Float, level: float, reach: float) -> list[Float]:
    """Sample ``v1 p^2 + v2 q^2 = level`` by arms, one towards each end of an asymptote.

    Where the level passes zero the hyperbola becomes two lines and then opens the other way: each arm's vertex moves
    through the centre, and no arm jumps.
    """
    if abs(axes[0, 0]) < abs(axes[0, 1]):
        values, axes = values[::-1], axes[:, ::-1]
    first, second = (axis * _sign(axis) for axis in axes.T)
    # samples are dense near the vertex, where the curve bends
    along = reach * np.linspace(0.0, 1.0, _SAMPLES) ** 2
    opens_first = level * values[0] >= 0.0
    inside, outside = (values[0], values[1]) if opens_first else (values[1], values[0])
    across = np.sqrt(level / inside - outside / inside * along**2)
    p, q = (across, along) if opens_first else (along, across)
    return [np.outer(s * p, first) + np.outer(t * q, second) for s in (1.0, -1.0) for t in (1.0, -1.0)]


def _two_lines(members: Float) -> list[Index]:
    """Split members that lie on two lines, the first of them off which fewer lie: of three members two share a line."""
    best: tuple[float, list[Index]] = (np.inf, [])
    for a, b in ((0, 1), (0, 2), (1, 2)):
        along = members[b] - members[a]
        off = np.abs((members - members[a]) @ np.array((-along[1], along[0]))) / (along @ along)
        near, rest = np.flatnonzero(off <= _ON_LINE), np.flatnonzero(off > _ON_LINE)
        if len(rest) > 1:
            best = min(
                best,
                (float(np.linalg.svd(members[rest] - members[rest].mean(axis=0))[1][-1]), [near, rest]),
                key=lambda pair: pair[0],
            )
    return best[1]


def _sign(vector: Float) -> float:
    return float(np.sign(vector[int(np.argmax(np.abs(vector)))]))


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
