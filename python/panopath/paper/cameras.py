"""Section 3: one scene through a spherical, a cylindrical and a perspective camera, and through limited fields of view.

Each camera turns directions into its own coordinates and back (:mod:`panopath.cameras`). Twice: with errors of the
directions that are the same for all cameras, so that cameras that see the same must answer the same; and with errors of
one pixel in the coordinates of the picture, which are other angles in each camera. Orientations are known; positions
are in metres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from panopath.cameras import (
    bearings_from_cylindrical,
    bearings_from_perspective,
    bearings_from_spherical,
    cylindrical_from_bearings,
    perspective_from_bearings,
    spherical_from_bearings,
    vertical_field_of_view_mask,
)
from panopath.evaluate import evaluate
from panopath.model import Bool, Float, PositionOptions, Scene, Tracks
from panopath.paper.experiment import Experiment, Outcome, Picture, Progress, Settings, Statement, Table, Verdict
from panopath.paper.scenes import disturbed, rays, with_bearings
from panopath.steps.positions import solve_positions

_TRIALS = 40
_N_VIEWS, _N_POINTS = 20, 400
#: Error of a direction along each tangent, of the runs in which it is equal for all: a pixel of the panorama.
_SIGMA_RAD = 2.0 * np.pi / 6000.0
#: Pixels round the horizon of the panorama and of the cylinder.
_WIDTH_PX = 6000.0
#: The perspective camera: 90 degrees wide and high, 1500 pixels, looking along y.
_SIZE_PX, _FOCAL_PX = 1500.0, 750.0
_CENTER_PX = (750.0, 750.0)
#: Rows are the axes of the perspective camera in the world: x right, y down, z forward.
_CAMERA_FROM_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
#: The cylinder ends at these heights, in radii: 63 degrees up and down.
_HEIGHT = 2.0
#: Two answers that differ by less, metres, are the same.
_SAME_M = 1e-7


@dataclass(frozen=True)
class _Camera:
    """What a camera sees, and its picture."""

    name: str
    sees: Callable[[Float], Bool]
    to_picture: Callable[[Float], Float]
    to_bearing: Callable[[Float], Float]
    #: Units of the two coordinates of the picture for one pixel.
    pixel: tuple[float, float]


def _everything(bearing: Float) -> Bool:
    return np.ones(len(bearing), dtype=np.bool_)


def _band(low_deg: float, high_deg: float) -> Callable[[Float], Bool]:
    """Limit the vertical field of view."""
    low, high = np.radians(low_deg), np.radians(high_deg)
    return lambda bearing: vertical_field_of_view_mask(bearing, low, high, axes="world")


def _on_cylinder(bearing: Float) -> Bool:
    return np.asarray(np.abs(cylindrical_from_bearings(bearing)[:, 1]) < _HEIGHT)


def _in_patch(bearing: Float) -> Bool:
    pixel = _perspective(bearing)
    return np.asarray(((pixel >= 0.0) & (pixel <= _SIZE_PX)).all(axis=1))


def _perspective(bearing: Float) -> Float:
    return perspective_from_bearings(bearing @ _CAMERA_FROM_WORLD.T, (_FOCAL_PX, _FOCAL_PX), _CENTER_PX)


def _from_perspective(pixel: Float) -> Float:
    seen = bearings_from_perspective(pixel, (_FOCAL_PX, _FOCAL_PX), _CENTER_PX)
    return np.asarray(seen @ _CAMERA_FROM_WORLD)


_ANGLE = 2.0 * np.pi / _WIDTH_PX
_SPHERE = (spherical_from_bearings, bearings_from_spherical, (_ANGLE, _ANGLE))
_CAMERAS = (
    _Camera("spherical", _everything, *_SPHERE),
    _Camera("cylindrical", _on_cylinder, cylindrical_from_bearings, bearings_from_cylindrical, (_ANGLE, _ANGLE)),
    _Camera("-62.5 to 52.5 degrees", _band(-62.5, 52.5), *_SPHERE),
    _Camera("-17 to 70 degrees", _band(-17.0, 70.0), *_SPHERE),
    _Camera("perspective", _in_patch, _perspective, _from_perspective, (1.0, 1.0)),
)


def _run(settings: Settings, progress: Progress) -> Outcome:
    trials = settings.trials_or(_TRIALS)
    rows: list[tuple[Any, ...]] = []
    for trial in range(trials):
        rows += _trial(np.random.default_rng((settings.seed, trial)), trial, settings.threads)
        progress(trial + 1, trials)
    table = Table.of(_COLUMNS, rows)
    printed = _printed_table(settings)
    return Outcome(
        n_trials=len(rows) + len(printed),
        tables={"cameras": table, "printed": printed},
        statements=(*_agreement_statements(table), *_field_statements(table), _printed_statement(printed)),
        pictures={
            "cameras": Picture(
                lambda figure: _draw(figure, table, settings.seed),
                "Left: what each camera sees of one place, by direction. Right: error of the cameras' positions, all "
                "trials, and its median.",
                12.5,
                5.4,
            )
        },
    )


def _place(rng: np.random.Generator) -> tuple[Float, Float]:
    """Draw a walk along x and points all round and above it, metres."""
    along = np.linspace(-5.0, 5.0, _N_VIEWS)
    centers = np.column_stack((along, 0.5 * rng.normal(size=_N_VIEWS), 0.2 * rng.normal(size=_N_VIEWS)))
    azimuth, height = rng.uniform(-np.pi, np.pi, _N_POINTS), rng.uniform(-8.0, 12.0, _N_POINTS)
    distance = rng.uniform(2.0, 20.0, _N_POINTS)
    points = np.column_stack(
        (rng.uniform(-5.0, 5.0, _N_POINTS) + distance * np.cos(azimuth), distance * np.sin(azimuth), height)
    )
    return centers, points


_COUNTS = ("seen_share", "points_seen", "points_solved", "views_solved")
_COLUMNS = ("camera", "trial", "errors", *_COUNTS, "camera_rms_m", "point_median_m", "apart_m")


def _trial(rng: np.random.Generator, trial: int, threads: int) -> list[tuple[Any, ...]]:
    """Put one scene through every camera, with equal errors of the directions and with errors of a pixel."""
    places = _place(rng)
    exact = rays(*places)
    noisy = disturbed(exact, _SIGMA_RAD, rng)
    pixels = rng.normal(size=(len(exact), 2))
    rows = []
    for camera in _CAMERAS:
        seen = camera.sees(exact.bearing) & camera.sees(noisy.bearing)
        for errors, tracks in (
            ("directions", _through(noisy.select(seen), camera)),
            ("pixels", _through(exact.select(seen), camera, pixels[seen])),
        ):
            scene = _solved(tracks, threads)
            found = evaluate(scene, places, "translation_scale")
            apart = np.nan
            if errors == "directions":
                # the same directions without a picture
                direct = evaluate(_solved(noisy.select(seen), threads), places, "translation_scale")
                apart = float(np.nanmax(np.abs(direct.aligned_centers - found.aligned_centers)))
            n_solved = (scene.summary.n_solved_points, scene.summary.n_solved_views)
            counts = (len(tracks) / len(exact), len(np.unique(tracks.track)), *n_solved)
            rows.append((camera.name, trial, errors, *counts, found.camera_rms, found.point_median, apart))
    return rows


def _through(tracks: Tracks, camera: _Camera, pixels: Float | None = None) -> Tracks:
    """Bearings as they come back from the picture, where they were moved by so many pixels."""
    picture = camera.to_picture(tracks.bearing)
    if pixels is not None:
        picture = picture + pixels * camera.pixel
    return with_bearings(tracks, camera.to_bearing(picture))


def _solved(tracks: Tracks, threads: int) -> Scene:
    return solve_positions(tracks, options=PositionOptions(threads=threads or None))


# -------------------------------------------------------------------------------------------------------- statements


def _median(table: Table, camera: str, errors: str, column: str) -> float:
    rows = zip(table.columns["camera"], table.columns["errors"], table.columns[column], strict=True)
    return float(np.median([value for name, kind, value in rows if (name, kind) == (camera, errors)]))


def _agreement_statements(table: Table) -> list[Statement]:
    apart = max(value for value in table.columns["apart_m"] if np.isfinite(value))
    sphere, cylinder, *_ = _CAMERAS
    pixels = {camera.name: 1000.0 * _median(table, camera.name, "pixels", "camera_rms_m") for camera in _CAMERAS}
    return [
        Statement(
            "3",
            "Cylindrical and spherical cameras are closely related: a simple change of coordinates matches them. A "
            "perspective picture is a patch of the sphere.",
            f"The same directions through each picture and back give the same positions, to {_upper(apart)} m, in "
            f"all trials of all {len(_CAMERAS)} cameras.",
            Verdict.AGREES if apart < _SAME_M else Verdict.IN_PART,
        ),
        Statement(
            "3",
            "The same with errors of a pixel: pictures on a sphere, a cylinder or a plane are alike.",
            f"A pixel is another angle in each: {np.degrees(_ANGLE):.2f} degrees on the horizon of sphere and "
            f"cylinder of {_WIDTH_PX:.0f} pixels round, finer towards the poles; {np.degrees(1.0 / _FOCAL_PX):.3f} in "
            f"the middle of the perspective picture. Error of the cameras' positions for one pixel, median: "
            + ", ".join(f"{name} {error:.1f} mm" for name, error in pixels.items())
            + ".",
            Verdict.IN_PART if pixels[sphere.name] != pixels[cylinder.name] else Verdict.AGREES,
        ),
    ]


def _upper(value: float) -> str:
    """Give the next power of ten above: rounding errors differ between machines."""
    return f"{10.0 ** np.ceil(np.log10(max(value, 1e-15))):.0e}"


def _field_statements(table: Table) -> list[Statement]:
    words = []
    for camera in _CAMERAS:
        share, seen, solved, error = (
            _median(table, camera.name, "directions", column)
            for column in ("seen_share", "points_seen", "points_solved", "camera_rms_m")
        )
        words.append(
            f"{camera.name}: {100 * share:.0f} % of all pairs, {seen:.0f} points of {_N_POINTS}, {solved:.0f} placed, "
            f"{1000 * error:.1f} mm"
        )
    views = min(table.columns["views_solved"])
    return [
        Statement(
            "3",
            "Panoramic cameras of limited vertical field (-17 to 70, -62.5 to 52.5 degrees) do the same work.",
            f"With the same error of all directions, {np.degrees(_SIGMA_RAD):.2f} degrees; median over the trials: "
            f"{'; '.join(words)}. What a camera does not see is missing from the scene, and its own path is known less "
            "well.",
            Verdict.AGREES if views == _N_VIEWS else Verdict.IN_PART,
        )
    ]


def _printed_table(settings: Settings) -> Table:
    """Cylinder pictures read by the printed height, r sin(phi), against r tan(phi)."""
    rng = np.random.default_rng((settings.seed, 10_000))
    places = _place(rng)
    exact = rays(*places)
    low = exact.select(np.abs(cylindrical_from_bearings(exact.bearing)[:, 1]) < 1.0)
    rows = []
    for limit_deg in (5.0, 10.0, 20.0, 30.0, 45.0):
        angles = spherical_from_bearings(low.bearing)
        inside = low.select(np.abs(angles[:, 1]) < np.radians(limit_deg))
        picture = cylindrical_from_bearings(inside.bearing)
        # the printed formula takes the height on the cylinder for that on a sphere
        elevation = np.arcsin(np.clip(picture[:, 1], -1.0, 1.0))
        misread = with_bearings(inside, bearings_from_spherical(np.column_stack((picture[:, 0], elevation))))
        turned = np.degrees(np.abs(elevation - np.arctan(picture[:, 1]))).max()
        error = evaluate(_solved(misread, settings.threads), places, "translation_scale").camera_rms
        rows.append((limit_deg, turned, error))
    return Table.of(("elevation_limit_deg", "largest_error_deg", "camera_rms_m"), rows)


def _printed_statement(table: Table) -> Statement:
    told = "; ".join(
        f"up to {limit:.0f} degrees of elevation {turned:.2g} degrees, {100 * error:.2g} cm"
        for limit, turned, error in zip(*table.columns.values(), strict=True)
    )
    return Statement(
        "3",
        "The height on a cylinder of radius r is z = r sin(phi).",
        f"It is r tan(phi). Directions and positions, without noise, of cylinder pictures that are read with the sine: "
        f"{told}.",
        Verdict.CORRECTED,
    )


# ---------------------------------------------------------------------------------------------------------- pictures

_COLOURS = dict(
    zip((camera.name for camera in _CAMERAS), ("#1f5fa8", "#2e8b57", "#7a3f98", "#b8860b", "#d9480f"), strict=True)
)


def _draw(figure: Any, table: Table, seed: int) -> None:
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    _draw_fields(left, seed)
    for row, camera in enumerate(_CAMERAS):
        for offset, (errors, marker) in enumerate((("directions", "o"), ("pixels", "^"))):
            rows = zip(table.columns["camera"], table.columns["errors"], table.columns["camera_rms_m"], strict=True)
            found = [1000.0 * value for name, kind, value in rows if (name, kind) == (camera.name, errors)]
            height = row - 0.15 + 0.3 * offset
            right.plot(found, np.full(len(found), height), marker, color=_COLOURS[camera.name], markersize=4, alpha=0.4)
            right.plot(np.median(found), height, "|", color="#111111", markersize=16, markeredgewidth=2.0)
    right.plot([], [], "o", color="#666666", label=f"{np.degrees(_SIGMA_RAD):.2f} degrees in all directions")
    right.plot([], [], "^", color="#666666", label="one pixel")
    right.plot([], [], "|", color="#111111", markersize=12, markeredgewidth=2.0, label="median")
    right.set_yticks(range(len(_CAMERAS)), [camera.name for camera in _CAMERAS])
    right.invert_yaxis()
    right.set(xlabel="rms error of the cameras (mm)", xlim=(0.0, None))
    right.grid(alpha=0.25, linewidth=0.6, axis="x")
    right.legend(fontsize=8, loc="upper right")


def _draw_fields(panel: Any, seed: int) -> None:
    """Draw directions of one view, and the borders of what each camera sees."""
    centers, points = _place(np.random.default_rng((seed, 0)))
    bearing = rays(centers[:1], points).bearing
    angles = np.degrees(spherical_from_bearings(bearing))
    panel.plot(*angles.T, ".", color="#9aa5b1", markersize=4)
    for camera in _CAMERAS[1:]:
        border = _border(camera)
        for line in border:
            panel.plot(*line.T, color=_COLOURS[camera.name], linewidth=1.8)
        panel.plot([], [], color=_COLOURS[camera.name], label=camera.name)
    panel.plot([], [], ".", color="#9aa5b1", label="points, seen from the first place")
    panel.set(xlabel="azimuth (degrees)", ylabel="elevation (degrees)", xlim=(-180, 180), ylim=(-90, 90))
    panel.set_xticks(range(-180, 181, 60))
    panel.set_yticks(range(-90, 91, 30))
    panel.legend(fontsize=8, loc="lower center", ncols=2)
    panel.set_title("The sphere sees everything", fontsize=10)


def _border(camera: _Camera) -> Sequence[Float]:
    """Lines of azimuth and elevation, degrees, between what a camera sees and what it does not."""
    if camera.name == "perspective":
        side = np.linspace(0.0, _SIZE_PX, 50)
        low, high = np.zeros(50), np.full(50, _SIZE_PX)
        around = np.vstack(
            [np.column_stack(pair) for pair in ((side, low), (high, side), (side[::-1], high), (low, side[::-1]))]
        )
        return [np.degrees(spherical_from_bearings(_from_perspective(around)))]
    azimuth = np.radians(np.linspace(-179.9, 179.9, 3))
    elevation = np.radians(np.linspace(-89.95, 89.95, 1800))
    column = np.column_stack((np.zeros(1800), elevation))
    inside = elevation[camera.sees(bearings_from_spherical(column))]
    return [np.degrees(np.column_stack((azimuth, np.full(3, end)))) for end in (inside[0], inside[-1])]


CAMERAS = Experiment("cameras", "3", "The same scene through different cameras", _run)
