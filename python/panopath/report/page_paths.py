"""Bodies that move, on the report page: their paths for the maps, and in words and figures what was found of them."""

from __future__ import annotations

import base64
from collections import Counter
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.model import Float, Scene
from panopath.movers import curve_times, form_text, speed, view_times
from panopath.paths import Fourier, PathModel, Paths, PathVerdict, Spline, Taylor

#: Bodies that are drawn, and places of all of them together.
_MOST_BODIES, _MOST_PLACES = 2_000, 120_000
#: Rows of the table, and how many of the fastest are looked at for it.
_MOST_ROWS, _LOOKED_AT = 12, 200
#: Coordinates are kept as whole numbers up to this.
_STEPS = 65_535

_Ids = npt.NDArray[np.intp]

_MEANING = {
    PathVerdict.STATIC: "at rest",
    PathVerdict.MOVING: "moving, path found",
    PathVerdict.IMITATED: (
        "refused: the camera moved in the form of the path itself, so that path and camera could be drawn together "
        "with no bearing changing"
    ),
    PathVerdict.HIDDEN: "refused: before or behind another track in every view",
    PathVerdict.UNDETERMINED: "not determined: seen too little, or nothing fits",
}


@dataclass(frozen=True, eq=False)
class Bodies:
    """Moving tracks of a part as they are drawn: each at times that are evenly spread over those it was seen in."""

    tracks: _Ids
    #: How many move in all.
    total: int
    #: (n, 2) seconds.
    seen_s: Float
    #: (n,) how many places each has, and (sum of these, 3) the places: right, ahead and up.
    counts: _Ids
    places: Float
    #: (n,) which colour, the same for the tracks of a rigid body.
    colours: _Ids


def bodies_of(scene: Scene, component: int, axes: Float) -> Bodies | None:
    """Bodies of a part, in the axes (3, d) of a drawing; None where nothing moves.

    Parameters
    ----------
    scene, component
        What is drawn.
    axes
        Right, ahead and up as rows.
    """
    paths = scene.paths
    if paths is None:
        return None
    tracks = np.flatnonzero(paths.moving & (scene.track_component == component) & np.isfinite(paths.seen_s).all(axis=1))
    if not len(tracks):
        return None
    chosen = tracks[_spread(len(tracks), _MOST_BODIES)]
    most = max(2, _MOST_PLACES // len(chosen))
    spans = zip(chosen.tolist(), paths.seen_s[chosen].tolist(), strict=True)
    times = [curve_times(paths.models[track], first, last, most) for track, (first, last) in spans]
    places = [paths.position(track, found) for track, found in zip(chosen.tolist(), times, strict=True)]
    known = np.array([np.isfinite(place).all() for place in places], dtype=np.bool_)
    if not known.any():
        return None
    kept = [place for place, is_known in zip(places, known.tolist(), strict=True) if is_known]
    chosen = chosen[known]
    bodies = paths.body[chosen].astype(np.intp)
    colours = np.where(bodies >= 0, bodies, np.arange(len(chosen)) + int(paths.body.max(initial=-1)) + 1)
    return Bodies(
        tracks=chosen,
        total=len(tracks),
        seen_s=paths.seen_s[chosen],
        counts=np.array([len(place) for place in kept], dtype=np.intp),
        places=np.concatenate([np.empty((0, scene.d)), *kept]) @ axes.T,
        colours=colours,
    )


def bodies_data(scene: Scene, bodies: Bodies, views: _Ids, middle: Float, reach: float) -> dict[str, Any]:
    """Give what the page's script needs to draw them.

    Parameters
    ----------
    scene, bodies
        What is drawn.
    views
        The views of the path, as it is drawn.
    middle, reach
        (3,) and how far from it anything is drawn; what goes farther would take the digits of the rest.
    """
    places = np.clip(bodies.places, middle - 2.0 * reach, middle + 2.0 * reach)
    low = places.min(axis=0, initial=np.inf, where=np.isfinite(places)) if len(places) else np.zeros(3)
    step = (places.max(axis=0) - low) / _STEPS if len(places) else np.ones(3)
    step = np.where(step > 0.0, step, 1.0)
    labels = scene.track_labels()
    time_s = None if scene.tracks is None else scene.tracks.time_s
    timed = time_s is not None and bool(np.isfinite(time_s[views]).all())
    every = np.concatenate((bodies.seen_s.ravel(), view_times(scene, int(scene.view_component[views[0]]))))
    return {
        "total": bodies.total,
        "span": [float(every.min()), float(every.max())] if len(every) else [0.0, 0.0],
        "views": [float(f"{t:.9g}") for t in time_s[views].tolist()] if time_s is not None and timed else None,
        "seen": [[float(f"{t:.9g}") for t in row] for row in bodies.seen_s.tolist()],
        "counts": bodies.counts.tolist(),
        "colours": bodies.colours.tolist(),
        "names": [labels[track] for track in bodies.tracks.tolist()],
        "low": low.tolist(),
        "step": step.tolist(),
        "places": base64.b64encode(((places - low) / step).round().astype("<u2").tobytes()).decode("ascii"),
    }


def paths_section(scene: Scene, unit: str) -> str:
    """Tell how many tracks move, what was assumed, what stays free, and which bodies are largest and fastest."""
    paths = scene.paths
    if paths is None:
        return ""
    return (
        f"<section id=bodies><h2>Bodies that move</h2>{_assumed(paths)}"
        f"<div class=wide>{_counted(paths)}{_table(scene, paths, unit)}</div></section>"
    )


def _assumed(paths: Paths) -> str:
    told = []
    if paths.assumption:
        told.append("Bearings alone do not tell rest from a motion that everything shares. ")
        told[-1] += f"Taken to be so: {paths.assumption}."
    if paths.freedoms:
        told.append(f"Left free: {'; '.join(paths.freedoms)}.")
    return "".join(f"<p>{escape(text)}</p>" for text in told)


def _counted(paths: Paths) -> str:
    count = Counter(paths.verdicts)
    rows = "".join(
        f"<tr><td class=number>{count[verdict]:,}</td><td>{_MEANING[verdict]}</td></tr>"
        for verdict in _MEANING
        if count[verdict]
    )
    return f"<table class=counted>{rows}</table>" if rows else ""


@dataclass(frozen=True)
class _Row:
    """A body of the table: the track of it whose speed is known best stands for all."""

    body: int
    track: int
    n_tracks: int
    speed: float
    deviation: float


def _table(scene: Scene, paths: Paths, unit: str) -> str:
    rows = _rows(paths) if len(paths) else []
    if not rows:
        return ""
    labels = scene.track_labels()
    per_s = f"{unit}/s" if unit else "/s"
    cells = []
    for row in rows[:_MOST_ROWS]:
        first, last = paths.seen_s[row.track].tolist()
        places = paths.position(row.track, curve_times(paths.models[row.track], first, last))
        way = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
        name = f"body {row.body}" if row.body >= 0 else str(labels[row.track])
        cells.append(
            f"<tr><td>{escape(name)}</td><td class=number>{row.n_tracks:,}</td>"
            f"<td>{_form_words(paths.models[row.track])}</td><td class=number>{first:.4g} to {last:.4g}</td>"
            f"<td class=number>{way:.3g}{f' {escape(unit)}' if unit else ''}</td>"
            f"<td class=number>{_measured(row.speed, row.deviation)} {escape(per_s)}</td></tr>"
        )
    named = ("body", "tracks", "its path", "seen (s)", "way", "speed, half way")
    head = "".join(f"<th{' class=number' if k in (1, 3, 4, 5) else ''}>{n}</th>" for k, n in enumerate(named))
    of = f" {_MOST_ROWS} of {len(rows):,} bodies." if len(rows) > _MOST_ROWS else ""
    note = f"The largest first, then the fastest; speeds with one standard deviation.{of}"
    return f"<p class=quiet>{note}</p><table class=bodies><tr>{head}</tr>{''.join(cells)}</table>"


def _rows(paths: Paths) -> list[_Row]:
    """Bodies, the largest first, of equal size the one that surely is fastest."""
    placed = np.isfinite(np.add.reduceat(paths.coefficients, paths.starts[:-1])).all(axis=1)
    moving = np.flatnonzero(paths.moving & placed & np.isfinite(paths.seen_s).all(axis=1))
    alone = moving[paths.body[moving] < 0].tolist()
    quick = sorted(alone, key=lambda track: -_known(float(np.linalg.norm(_velocity(paths, track)))))
    rows = [_Row(-1, track, 1, *_speed(paths, track)) for track in quick[:_LOOKED_AT]]
    rows += [_Row(-1, track, 1, 0.0, np.nan) for track in quick[_LOOKED_AT:]]
    for body in np.unique(paths.body[moving][paths.body[moving] >= 0]).tolist():
        members = moving[paths.body[moving] == body].tolist()
        found = [_Row(body, track, len(members), *_speed(paths, track)) for track in members]
        rows.append(min(found, key=lambda row: row.deviation if np.isfinite(row.deviation) else np.inf))
    return sorted(rows, key=lambda row: (-row.n_tracks, -_known(row.speed) + _known(row.deviation), row.track))


def _measured(value: float, deviation: float) -> str:
    """Write a value to the place that its deviation leaves known."""
    if not (np.isfinite(deviation) and 0.0 < deviation < 1e6):
        return f"{value:.3g}"
    places = min(max(0, -int(np.floor(np.log10(deviation)))), 9)
    return f"{value:.{places}f} ± {deviation:.{places}f}"


def _velocity(paths: Paths, track: int) -> Float:
    velocity: Float = paths.velocity(track, [paths.seen_s[track].mean()])[0]
    return velocity


def _speed(paths: Paths, track: int) -> tuple[float, float]:
    return speed(paths, track, float(paths.seen_s[track].mean()))


def _known(value: float) -> float:
    return value if np.isfinite(value) else 0.0


def _form_words(model: PathModel) -> str:
    if isinstance(model, Taylor):
        return {0: "at rest", 1: "straight and steady"}.get(model.order, f"polynomial of degree {model.order}")
    if isinstance(model, Fourier):
        turn = f", {2.0 * np.pi / model.omega_rad_s:.3g} s a turn" if model.omega_rad_s else ""
        return f"{model.order} harmonic{'s' if model.order > 1 else ''}{turn}"
    if isinstance(model, Spline):
        pieces = len(model.knots_s) - 1
        return f"spline of {pieces} piece{'s' if pieces > 1 else ''}"
    return form_text(model)


def _spread(count: int, most: int) -> _Ids:
    """At most ``most`` indices, evenly spread, first and last among them."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.intp)
