"""A crossing with cars, people and a roundabout, for docs/moving.md: the animated picture, the report and the viewer.

``python -m docs.figures_moving`` draws ``docs/img/moving/*``: cameras, points and paths as they are found from bearings
with 0.05 degrees of noise, the form of each path sought but for the car that turns off. Tests of what is written and
shown use the world itself, in which deviations are those of known cameras.
"""

from __future__ import annotations

import importlib
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import panopath as pp
from panopath.formats.structure import known_scene
from panopath.movers import curve_times
from panopath.paths import PathModel, path_functions
from panopath.report import ReportNotes, write_report

from docs.figures_view import Page, find_chromium, opened, save

Float = npt.NDArray[np.float64]

IMAGES = Path(__file__).parent / "img" / "moving"
SIGMA_RAD = float(np.radians(0.05))
DURATION_S = 20.0
#: The roundabout, a turn in eight seconds.
_ROUND_RAD_S = 2.0 * np.pi / 8.0
_CAMERA, _STILL = "#1f3a5f", "#98a2ad"
#: Seconds of a path that are drawn behind a body.
_TRAIL_S = 5.0
COLOURS = ("#d9480f", "#0b7a75", "#7a3f98", "#b8860b", "#c2255c", "#2f9e44")


def main() -> None:
    IMAGES.mkdir(parents=True, exist_ok=True)
    scene = solved(crossing(), report=print)
    animate(scene, IMAGES / "crossing.gif")
    if find_chromium() is not None:
        with tempfile.TemporaryDirectory() as place:
            draw_pages(scene, Path(place))


def crossing(
    n_views: int = 40, n_still: int = 260, *, seed: int = 1, dimension: int = 3, covariances: bool = True
) -> pp.Scene:
    """Make a walk over a crossing: facades at rest, three cars, six people, a roundabout; z up, metres, seconds.

    One track each is hidden, imitates the camera, or was seen too little.
    """
    rng = np.random.default_rng(seed)
    time_s = np.linspace(0.0, DURATION_S, n_views)
    # who walks straight and steadily cannot tell how far off those are who do so too
    x, y = (
        -8.0 + 0.8 * time_s + 0.4 * np.sin(1.7 * time_s),
        -0.5 + 1.3 * np.sin(1.1 * time_s) + 0.4 * np.cos(0.37 * time_s),
    )
    centers = np.column_stack((x, y, 1.7 + 0.05 * np.sin(3.1 * time_s)))
    bodies = [*_still(rng, n_still), *_cars(rng), *_people(rng), *_roundabout(), *_refused()]
    d = dimension
    models = tuple(body[0] for body in bodies)
    coefficients = np.concatenate([np.atleast_2d(body[1]) for body in bodies])[:, :d]
    verdicts = tuple(body[2] for body in bodies)
    seen = np.array([body[4] for body in bodies])
    starts = np.cumsum([0, *(one.n_functions for one in models)])
    hidden_by = np.array([3 if one is pp.PathVerdict.HIDDEN else -1 for one in verdicts])
    paths = pp.Paths(
        models=models,
        starts=starts,
        coefficients=coefficients,
        covariances=None,
        seen_s=seen,
        verdicts=verdicts,
        hidden_by=hidden_by,
        body=np.array([body[3] for body in bodies]),
        assumption="most tracks are at rest",
        freedoms=("a shift of everything", "the scale of everything"),
    )
    return _scene_of(paths, centers[:, :d], time_s, rng, covariances=covariances)


def solved(world: pp.Scene, report: Callable[[str], None] | None = None) -> pp.Scene:
    """Find cameras and paths from the bearings, in the frame of the world; say how far off they are.

    Which tracks are a body's is taken from the world.
    """
    true = world.paths
    assert true is not None
    assert world.tracks is not None
    names = world.track_labels()
    turning: dict[str | int, PathModel | Literal["auto"]]
    turning = {names[t]: one for t, one in enumerate(true.models) if isinstance(one, pp.Spline)}
    forms = (pp.Taylor(1), pp.Taylor(2), pp.Taylor(3), pp.Fourier(1, _ROUND_RAD_S))
    control = pp.Control(views=dict(enumerate(world.centers)), rotation=False)
    options = pp.PositionOptions(gauge="control", control=control)
    scene = pp.solve_positions(world.tracks, options=options, motion=pp.Motion(tracks=turning, candidates=forms))
    found = scene.paths
    assert found is not None
    if report is not None:
        off = np.sqrt(((scene.centers - world.centers) ** 2).sum(axis=1).mean())
        both = np.flatnonzero(true.moving & found.moving).tolist()
        ratios = [_miss(true, found, track) for track in both]
        wrong = int((found.moving & ~true.moving).sum())
        report(f"cameras {off:.4f} m rms; {len(both)} of {true.moving.sum()} movers found, {wrong} that are none")
        report(f"error over deviation: median {np.median(ratios):.2f}, largest {max(ratios):.2f}")
    return replace(scene, paths=replace(found, body=np.where(found.moving, true.body, -1)))


def _miss(true: pp.Paths, found: pp.Paths, track: int) -> float:
    """Rms error of a path over its rms deviation."""
    first, last = found.seen_s[track].tolist()
    times = np.linspace(first, last, 50)
    error = found.position(track, times) - true.position(track, times, outside=True)
    variance = np.trace(found.position_covariance(track, times), axis1=1, axis2=2).mean()
    return float(np.sqrt((error**2).sum(axis=1).mean() / variance))


Body = tuple[PathModel, Float, pp.PathVerdict, int, tuple[float, float]]
_ALWAYS = (0.0, DURATION_S)


def _still(rng: np.random.Generator, n: int) -> list[Body]:
    """Points on the facades of four blocks, and on the ground between them."""
    places = []
    for k in range(n):
        corner = np.array([(-1) ** k, (-1) ** (k // 2)]) * (9.0, 7.0)
        outward = np.sign(corner)
        along, height = 14.0 * rng.random(), 7.0 * rng.random() ** 2
        wall = np.array([along, 0.0]) if rng.random() < 0.5 else np.array([0.0, along])
        places.append((*(corner + outward * wall), height))
    return [(pp.Static(), np.array([place]), pp.PathVerdict.STATIC, -1, _ALWAYS) for place in places]


def _cars(rng: np.random.Generator) -> list[Body]:
    """Cars with features each, which share their motion: one steady, one that brakes, one that turns off."""
    found: list[Body] = []
    turning = np.array([(-24.0, -5.2), (-8.0, -5.2), (9.0, -6.5), (7.0, 7.0), (7.0, 20.0)])
    cars: list[tuple[PathModel, Float, tuple[float, float], float]] = [
        (pp.Taylor(1, 6.0, 6.0), np.array([(0.0, 4.0), (-42.0, 0.0)]), (0.0, 12.0), 0.0),
        (pp.Taylor(2, 9.0, 7.0), np.array([(-4.5, 9.0), (0.0, -15.0), (0.0, 6.0)]), (2.0, 16.0), np.pi / 2),
        (pp.Spline((6.0, 12.0, 18.0), 3), turning, (6.0, 18.0), 0.0),
    ]
    for body, (model, path, seen, heading) in enumerate(cars):
        for _ in range(10):
            x, y = rng.uniform(-2.0, 2.0), rng.uniform(-0.8, 0.8)
            offset = np.array([x * np.cos(heading) - y * np.sin(heading), x * np.sin(heading) + y * np.cos(heading)])
            vectors = np.zeros((model.n_functions, 3))
            vectors[:, :2] = path
            at = slice(None) if isinstance(model, pp.Spline) else slice(0, 1)
            vectors[at] += (*offset, rng.uniform(0.3, 1.4))
            found.append((model, vectors, pp.PathVerdict.MOVING, body, seen))
    return found


def _people(rng: np.random.Generator) -> list[Body]:
    found: list[Body] = []
    for k in range(6):
        first = DURATION_S * 0.05 * k
        last = first + 12.0
        side = np.array([-7.5 + 3.0 * k, 6.2 if k % 2 else -6.2])
        pace = np.array([(-1.0) ** k * 1.3, 0.25 * (k - 2.5)]) * 6.0
        vectors = np.zeros((3, 3))
        vectors[0], vectors[1, :2], vectors[2, :2] = (*side, 1.5), pace, rng.normal(0.0, 0.8, 2)
        found.append((pp.Taylor(2, first + 6.0, 6.0), vectors, pp.PathVerdict.MOVING, -1, (first, last)))
    return found


def _roundabout() -> list[Body]:
    """Two horses of a roundabout on the square."""
    found: list[Body] = []
    for phase in (0.0, np.pi):
        cos, sin = 2.5 * np.cos(phase), 2.5 * np.sin(phase)
        circle = np.array([(11.0, 0.5, 1.2), (cos, sin, 0.0), (-sin, cos, 0.0)])
        found.append((pp.Fourier(1, _ROUND_RAD_S), circle, pp.PathVerdict.MOVING, 3, _ALWAYS))
    return found


def _refused() -> list[Body]:
    kinds = (pp.PathVerdict.HIDDEN, pp.PathVerdict.IMITATED, pp.PathVerdict.UNDETERMINED)
    return [(pp.Taylor(1, 10.0, 10.0), np.full((2, 3), np.nan), kind, -1, _ALWAYS) for kind in kinds]


def _scene_of(
    paths: pp.Paths, centers: Float, time_s: Float, rng: np.random.Generator, *, covariances: bool
) -> pp.Scene:
    n, d = len(paths), paths.d
    pairs = [(v, t) for t in range(n) for v in np.flatnonzero(_inside(paths, t, time_s)).tolist()]
    view, track = np.array(pairs).T
    place = np.array([paths.position(t, [time_s[v]], outside=True)[0] for v, t in pairs])
    ray = np.where(np.isfinite(place), place, centers[view] + (3.0, 1.0, 0.5)[:d]) - centers[view]
    distance = np.linalg.norm(ray, axis=1)
    noisy = ray / distance[:, None] + rng.normal(0.0, SIGMA_RAD, ray.shape)
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    tracks = pp.Tracks.from_arrays(
        view,
        track,
        noisy,
        n_views=len(centers),
        n_tracks=n,
        time_s=time_s,
        view_names=[f"frame_{k:03d}" for k in range(len(centers))],
        track_names=[f"t{k}" for k in range(n)],
    )
    middle = np.array([paths.position(t, [paths.seen_s[t].mean()], outside=True)[0] for t in range(n)])
    found = tuple(_covariance(paths, t, time_s, centers) for t in range(n)) if covariances else None
    return known_scene(tracks, None, centers, middle, paths=replace(paths, covariances=found))


def _inside(paths: pp.Paths, track: int, time_s: Float) -> npt.NDArray[np.bool_]:
    first, last = paths.seen_s[track]
    return np.asarray((time_s >= first) & (time_s <= last))


def _covariance(paths: pp.Paths, track: int, time_s: Float, centers: Float) -> Float:
    """Covariance of a path seen from known cameras: the inverse of ``sum B_l B_m (1 - u u^T) / (r sigma)^2``."""
    inside, d = _inside(paths, track, time_s), paths.d
    functions = path_functions(paths.models[track], time_s[inside])
    ray = paths.position(track, time_s[inside], outside=True) - centers[inside]
    size = d * functions.shape[1]
    if not np.isfinite(ray).all():
        return np.full((size, size), np.nan)
    distance = np.linalg.norm(ray, axis=1)
    unit = ray / distance[:, None]
    across = (np.eye(d) - unit[:, :, None] * unit[:, None, :]) / (distance * SIGMA_RAD)[:, None, None] ** 2
    information = np.einsum("na,nij,nb->aibj", functions, across, functions).reshape(size, size)
    return np.asarray(np.linalg.inv(information))


def animate(scene: pp.Scene, path: Path, n_frames: int = 50) -> None:
    """Write a GIF of camera and bodies from above."""
    image: Any = importlib.import_module("PIL.Image")
    agg: Any = importlib.import_module("matplotlib.backends.backend_agg")
    figure_class: Any = importlib.import_module("matplotlib.figure").Figure
    frames = []
    for now in np.linspace(0.0, DURATION_S, n_frames):
        figure = figure_class(figsize=(6.4, 4.0), dpi=100)
        canvas = agg.FigureCanvasAgg(figure)
        panel = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        _draw(panel, scene, float(now))
        canvas.draw()
        frames.append(image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3].copy()))
    # one palette for all frames, of what is drawn: colours must not flicker, nor thin lines take those of others
    inks = [tuple(int(ink[k : k + 2], 16) for k in (1, 3, 5)) for ink in (*COLOURS, _CAMERA, _STILL)]
    shades = [255.0 + share * (np.array(ink) - 255.0) for ink in inks for share in (0.15, 0.3, 0.5, 0.75, 1.0)]
    palette = image.new("P", (1, 1))
    palette.putpalette(np.array([(255.0, 255.0, 255.0), *shades]).round().astype(np.uint8).tobytes())
    plain = [frame.quantize(palette=palette, dither=image.Dither.NONE) for frame in frames]
    duration = [90] * (n_frames - 1) + [1500]
    plain[0].save(path, save_all=True, append_images=plain[1:], duration=duration, loop=0, optimize=True)


def _draw(panel: Any, scene: pp.Scene, now: float) -> None:
    paths, tracks = scene.paths, scene.tracks
    assert paths is not None
    assert tracks is not None
    assert tracks.time_s is not None
    still = scene.points[[one is pp.PathVerdict.STATIC for one in paths.verdicts]]
    panel.plot(still[:, 0], still[:, 1], ".", color=_STILL, markersize=3.5, markeredgewidth=0)
    walked = tracks.time_s <= now
    panel.plot(*scene.centers[:, :2].T, color=_CAMERA, linewidth=1, alpha=0.25)
    panel.plot(*scene.centers[walked, :2].T, color=_CAMERA, linewidth=2.2)
    here = [np.interp(now, tracks.time_s, scene.centers[:, k]) for k in (0, 1)]
    for track in np.flatnonzero(paths.moving).tolist():
        first, last = paths.seen_s[track]
        body = int(paths.body[track])
        colour = COLOURS[(body if body >= 0 else 4 + track % 2) % len(COLOURS)]
        begin, end = max(first, now - _TRAIL_S), min(now, last)
        if begin <= end:
            places = paths.position(track, curve_times(paths.models[track], begin, end))
            panel.plot(places[:, 0], places[:, 1], color=colour, linewidth=1.1, alpha=0.5)
        if first <= now <= last:
            place = paths.position(track, [now])[0]
            panel.plot([here[0], place[0]], [here[1], place[1]], color=colour, linewidth=0.4, alpha=0.35)
            panel.plot(*place[:2], "o", color=colour, markersize=5, markeredgecolor="white", markeredgewidth=0.6)
    panel.plot(*here, "s", color=_CAMERA, markersize=9, markeredgecolor="white")
    panel.text(0.015, 0.03, f"{now:4.1f} s", transform=panel.transAxes, fontsize=12, color=_CAMERA, family="monospace")
    panel.set(xlim=(-26.0, 26.0), ylim=(-16.25, 16.25), aspect="equal")
    panel.axis("off")


def draw_pages(scene: pp.Scene, place: Path) -> None:
    """Draw the report's section and the viewer half way through, in headless Chromium."""
    notes = ReportNotes("A walk over a crossing", unit="m", is_upright=True)
    report = write_report(scene, None, place / "report.html", notes=notes)
    with Page.open(1180, 720) as page:
        page.go(report.as_uri())
        page.wait_for("document.documentElement.dataset.drawn === 'yes'")
        page.evaluate("document.getElementById('map').scrollIntoView()")
        time.sleep(1.0)
        (IMAGES / "report.png").write_bytes(page.screenshot())
    with opened(pp.write_scene(scene, place / "scene"), 1180, 640) as (_, page):
        page.wait_for("document.body.innerText.includes('Ellipsoids')")
        time.sleep(2.0)
        page.evaluate("document.querySelector('.mantine-Slider-thumb').focus()")
        for kind in ("keyDown", "keyUp") * (len(scene.centers) // 2):
            page.call("Input.dispatchKeyEvent", type=kind, key="ArrowLeft", code="ArrowLeft", windowsVirtualKeyCode=37)
        save(page, IMAGES / "view.jpg")


if __name__ == "__main__":
    main()
