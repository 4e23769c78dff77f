"""Section 7: the mean motion of the picture, taken for the turn of the camera, against frame rate, noise and distance.

A camera turns, sways and moves among points at rest, and is filmed at different rates. Step by step the mean motion is
taken out, in the paper's form (azimuth and elevation) and on the sphere, with and without near points, and summed up.
What is asked is the paper's adiabatic limit: whether the error of the sum goes to zero as frames follow each other
faster. Then positions are found with these orientations, before and after fine-tuning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from panopath.cameras import spherical_from_bearings
from panopath.evaluate import evaluate
from panopath.model import Float, PositionOptions, Scene, Tracks
from panopath.paper.experiment import Experiment, Outcome, Picture, Progress, Settings, Statement, Table, Verdict
from panopath.paper.scenes import disturbed, rays, slope, with_bearings
from panopath.steps.motion import MotionOptions, fit_rotations, mean_motion
from panopath.steps.positions import solve_positions
from panopath.steps.refinement import RefineOptions, refine

_TRIALS = 3
_RATES_HZ = (1, 2, 4, 8, 16, 32, 64)
#: One of these, with which the highest is compared.
_SLOW_HZ = 4
_NOISES_RAD = (0.0, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
#: How many times farther away all points are.
_STRETCHES = (1.0, 3.0, 10.0, 30.0, 100.0)
_DURATION_S = 8.0
_N_POINTS = 200
#: Rate at which noise and distance are varied, and positions are found.
_RATE_HZ = 8
#: Noise of what is not about noise.
_USUAL_RAD = 1e-3
#: Passes of fine-tuning: orientations and positions in turn.
_PASSES = 10
_METHODS = {
    "azimuth and elevation": MotionOptions(flow="horizon", weighting="mean"),
    "sphere": MotionOptions(weighting="mean"),
    "sphere, slowest half": MotionOptions(weighting="slowest", share=0.5),
    "sphere, robust": MotionOptions(weighting="robust"),
}
_WORLDS = ("turns only", "moves, points all round", "moves, points on one side")


@dataclass(frozen=True, eq=False)
class _Film:
    """What a camera that turns and moves has seen."""

    #: Bearings in the cameras.
    tracks: Tracks
    #: (m, 3, 3) true orientations.
    cam_from_world: Float
    #: (m, 3), metres.
    centers: Float
    #: (n, 3), metres.
    points: Float


def _run(settings: Settings, progress: Progress) -> Outcome:
    trials = settings.trials_or(_TRIALS)
    printed = _printed_table()
    rates = _rate_table(settings, trials)
    progress(1, 4)
    noise = _noise_table(settings, trials)
    progress(2, 4)
    distance = _distance_table(settings, trials)
    progress(3, 4)
    positions = _position_table(settings, trials)
    progress(4, 4)
    return Outcome(
        n_trials=sum(len(table) for table in (printed, rates, noise, distance, positions)),
        tables={"rates": rates, "printed": printed, "noise": noise, "distance": distance, "positions": positions},
        statements=(
            *_printed_statements(printed),
            *_rate_statements(rates),
            _noise_statement(noise),
            *_distance_statements(distance),
            *_position_statements(positions),
        ),
        pictures={
            "rates": Picture(
                lambda figure: _draw_rates(figure, rates),
                "Error of the summed turns over 8 s against frames a second; solid without noise, dashed with 0.06 "
                "degrees.",
                12.5,
                4.6,
            ),
            "noise": Picture(
                lambda figure: _draw_rest(figure, noise, distance, positions),
                "Error of the orientations against noise and against the distance of the points, and of the positions "
                "found with them.",
                13.0,
                4.6,
            ),
        },
    )


# ------------------------------------------------------------------------------------------------------------- films


def _film(rng: np.random.Generator, world: str, rate_hz: float, noise_rad: float, stretch: float = 1.0) -> _Film:
    """Film one world; what is drawn at random does not depend on the rate, and noise comes last."""
    azimuth = np.pi * rng.uniform(-1.0, 1.0, _N_POINTS)
    if world == _WORLDS[2]:
        azimuth = 0.5 * np.pi + 0.25 * azimuth
    elevation = np.radians(rng.uniform(-30.0, 30.0, _N_POINTS))
    distance = stretch * 3.0 * 30.0 ** rng.uniform(0.0, 1.0, _N_POINTS)
    points = distance[:, None] * _spherical(azimuth, elevation)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    time_s = np.arange(round(_DURATION_S * rate_hz) + 1) / rate_hz
    turns = _turns(time_s, phases)
    # two metres along x while it sways, in eight seconds: a slow walk
    along = 2.0 * (time_s / _DURATION_S - 0.5)
    centers = np.column_stack((along, 0.1 * np.sin(1.5 * time_s + phases[0]), 0.05 * np.sin(3.0 * time_s + phases[1])))
    if world == _WORLDS[0]:
        centers = np.zeros_like(centers)
    tracks = rays(centers, points, time_s=time_s)
    seen = with_bearings(tracks, np.einsum("nij,nj->ni", turns[tracks.view], tracks.bearing))
    return _Film(disturbed(seen, noise_rad, rng) if noise_rad else seen, turns, centers, points)


def _turns(time_s: Float, phases: Float) -> Float:
    """Orientations (m, 3, 3): about the vertical by up to 60 degrees a second, and pitch and roll of three degrees."""
    heading = 1.2 * np.sin(0.8 * time_s + phases[0]) + 0.3 * time_s
    pitch, roll = (
        np.radians(3.0) * np.sin(speed * time_s + phase) for speed, phase in zip((1.1, 1.7), phases[1:], strict=True)
    )
    return np.asarray(_about(1, pitch) @ _about(0, roll) @ _about(2, -heading))


def _about(axis: int, angle_rad: Float) -> Float:
    """Rotations (m, 3, 3) about an axis."""
    found = np.tile(np.eye(3), (len(angle_rad), 1, 1))
    i, k = (axis + 1) % 3, (axis + 2) % 3
    found[:, i, i] = found[:, k, k] = np.cos(angle_rad)
    found[:, k, i] = np.sin(angle_rad)
    found[:, i, k] = -found[:, k, i]
    return found


def _spherical(azimuth: Float, elevation: Float) -> Float:
    level = np.cos(elevation)
    return np.column_stack((level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)))


def _orientation_error_deg(found: Float, truth: Float) -> tuple[float, float]:
    """Rms over the film, and last, of the angles between orientations that agree in the first view."""
    apart = found @ found[0].T @ truth[0] @ truth.transpose(0, 2, 1)
    chord = np.linalg.norm(apart - np.eye(3), axis=(1, 2)) / np.sqrt(8.0)
    angle = np.degrees(2.0 * np.arcsin(np.minimum(chord, 1.0)))
    return float(np.sqrt((angle**2).mean())), float(angle[-1])


def _measured(film: _Film, case: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Give a row for each method: the case, the method, and the errors of its orientations, degrees."""
    return [
        (*case, name, *_orientation_error_deg(mean_motion(film.tracks, options).cam_from_world, film.cam_from_world))
        for name, options in _METHODS.items()
    ]


def _generator(settings: Settings, trial: int) -> np.random.Generator:
    """Draw the same film in every table, seen at other rates, from other distances, or with more noise."""
    return np.random.default_rng((settings.seed, trial))


_ERRORS = ("method", "rms_error_deg", "last_error_deg")


def _rate_table(settings: Settings, trials: int) -> Table:
    rows = []
    for world in _WORLDS:
        for trial in range(trials):
            for rate_hz in _RATES_HZ:
                for noise in (0.0, _USUAL_RAD):
                    film = _film(_generator(settings, trial), world, rate_hz, noise)
                    rows += _measured(film, (world, trial, rate_hz, noise))
    return Table.of(("world", "trial", "rate_hz", "noise_rad", *_ERRORS), rows)


def _noise_table(settings: Settings, trials: int) -> Table:
    rows = []
    for trial in range(trials):
        for noise in _NOISES_RAD:
            film = _film(_generator(settings, trial), _WORLDS[1], _RATE_HZ, noise)
            rows += _measured(film, (trial, noise))
    return Table.of(("trial", "noise_rad", *_ERRORS), rows)


def _distance_table(settings: Settings, trials: int) -> Table:
    rows = []
    for world in _WORLDS[1:]:
        for trial in range(trials):
            for stretch in _STRETCHES:
                film = _film(_generator(settings, trial), world, _RATE_HZ, 0.0, stretch)
                rows += _measured(film, (world, trial, stretch))
    return Table.of(("world", "trial", "stretch", *_ERRORS), rows)


# -------------------------------------------------------------------------------------------------------- as printed


def _printed_table() -> Table:
    """Follow the three printed steps to the letter, and with one correction after the other.

    A camera at rest turns about the vertical at 30 degrees a second for eight seconds; or tilts by two degrees.
    """
    rows = []
    ring = _spherical(np.linspace(-np.pi, np.pi, 36, endpoint=False) + 0.01, np.zeros(36))
    for rate_hz in _RATES_HZ:
        time_s = np.arange(round(_DURATION_S * rate_hz) + 1) / rate_hz
        truth = np.radians(30.0) * time_s
        seen = [spherical_from_bearings(ring @ turn.T) for turn in _about(2, -truth)]
        azimuth = np.array([angles[:, 0] for angles in seen])
        step = np.diff(azimuth, axis=0)
        wrapped = (step + np.pi) % (2.0 * np.pi) - np.pi
        for name, summed in (
            ("as printed", (step * rate_hz).mean(axis=1)),
            ("times the time step", step.mean(axis=1)),
            ("and wrapped", wrapped.mean(axis=1)),
        ):
            # points go round against the camera
            off = np.degrees(np.abs(-np.cumsum(summed) - truth[1:]))
            rows.append(("turn", rate_hz, name, float(np.sqrt((off**2).mean()))))
        rows += _tilts(ring, rate_hz)
    return Table.of(("film", "rate_hz", "reading", "rms_error_deg"), rows)


def _tilts(ring: Float, rate_hz: int) -> list[tuple[str, int, str, float]]:
    """Tilt about x to two degrees: mean of elevation velocities, against two tilts fitted to them."""
    time_s = np.arange(round(_DURATION_S * rate_hz) + 1) / rate_hz
    truth = np.radians(2.0) * time_s / _DURATION_S
    bearings = np.stack([ring @ turn.T for turn in _about(0, truth)])
    angles = np.stack([spherical_from_bearings(rows) for rows in bearings])
    rates = np.diff(angles, axis=0) * rate_hz
    printed = np.cumsum((np.cos(rates[:, :, 0]) * rates[:, :, 1]).mean(axis=1) / rate_hz)
    view, track = (index.ravel() for index in np.indices(bearings.shape[:2]))
    tracks = Tracks.from_arrays(view, track, bearings.reshape(-1, 3))
    found = mean_motion(tracks, _METHODS["azimuth and elevation"]).cam_from_world
    off = np.degrees(np.abs(printed - truth[1:]))
    fitted, _ = _orientation_error_deg(found, _about(0, truth))
    return [
        ("tilt", rate_hz, "as printed", float(np.sqrt((off**2).mean()))),
        ("tilt", rate_hz, "two tilts fitted", fitted),
    ]


def _printed_statements(table: Table) -> list[Statement]:
    error = {(film, rate, name): off for film, rate, name, off in zip(*table.columns.values(), strict=True)}
    told = ", ".join(f"{error['turn', rate, 'as printed']:,.0f} at {rate} Hz" for rate in _RATES_HZ[::2])
    wrapped = max(error["turn", rate, "and wrapped"] for rate in _RATES_HZ)
    tilt = max(error["tilt", rate, "two tilts fitted"] for rate in _RATES_HZ)
    blind = min(error["tilt", rate, "as printed"] for rate in _RATES_HZ)
    return [
        Statement(
            "7, steps 1 to 3",
            "theta(t_j) is the sum of the mean angular velocities.",
            f"Each velocity must be multiplied by its time step, and differences of azimuth must be wrapped. A camera "
            f"at rest that turns by 240 degrees in 8 s: rms error of the printed sum {told} (degrees). With the time "
            f"step alone {error['turn', _SLOW_HZ, 'times the time step']:,.0f} degrees at {_SLOW_HZ} Hz, "
            f"since some points pass the seam; with both less than {_upper(wrapped)} degrees.",
            Verdict.CORRECTED if wrapped < 1e-6 < error["turn", _SLOW_HZ, "as printed"] else Verdict.AGREES,
        ),
        Statement(
            "7, step 2",
            "eta, the mean of cos(omega) times the elevation velocities, is the tilt.",
            f"A tilt raises one side of the panorama and lowers the other: of a tilt to 2 degrees the printed mean "
            f"sees nothing (rms error {blind:.2f} degrees, as large as the tilt itself). Two tilts fitted to the "
            f"elevation velocities see it, to {_upper(tilt)} degrees.",
            Verdict.CORRECTED if blind > 0.5 and tilt < 0.1 * blind else Verdict.IN_PART,
        ),
    ]


def _upper(value: float) -> str:
    """Give the next power of ten above: rounding errors differ between machines."""
    return f"{10.0 ** np.ceil(np.log10(max(value, 1e-14))):.0e}"


# ------------------------------------------------------------------------------------------ rates, noise and distance


def _mean(table: Table, case: Sequence[Any], error: str = "rms_error_deg") -> float:
    """Mean over the trials of a case: the values of its columns but for the trial and the errors."""
    names = [name for name in table.columns if name not in ("trial", *_ERRORS[1:], "camera_rms_m", "orientation_deg")]
    rows = zip(*(table.columns[name] for name in names), table.columns[error], strict=True)
    return float(np.mean([row[-1] for row in rows if row[:-1] == tuple(case)]))


def _rate_statements(table: Table) -> list[Statement]:
    slow, fast = _SLOW_HZ, _RATES_HZ[-1]

    def told(world: str, method: str, rate: int, noise: float = 0.0) -> float:
        return _mean(table, (world, rate, noise, method))

    turns, around, aside = _WORLDS
    flow, sphere, slowest, robust = _METHODS
    exact = max(told(turns, sphere, rate) for rate in _RATES_HZ)
    moved = {method: (told(aside, method, slow), told(aside, method, fast)) for method in (sphere, slowest, robust)}
    words = "; ".join(f"{method} {a:.2f} and {b:.2f}" for method, (a, b) in moved.items())
    few, many = told(turns, sphere, slow, _USUAL_RAD), told(turns, sphere, fast, _USUAL_RAD)
    grown = tuple(told(turns, robust, rate, _USUAL_RAD) for rate in (slow, fast))
    lost = tuple(told(aside, robust, rate, _USUAL_RAD) for rate in (slow, fast))
    return [
        Statement(
            "7",
            "Adiabatic camera motion: where frames follow fast enough, the summed mean motion is the orientation.",
            f"Of a camera that only turns and sways, on the sphere: rounding at any rate (below {_upper(exact)} "
            f"degrees), so that nothing has to be adiabatic. The mean of azimuth and elevation keeps an error of "
            f"{told(turns, flow, slow):.2f} degrees at {slow} Hz and {told(turns, flow, fast):.2f} at {fast} Hz: "
            "points off the horizon go round when the camera tilts, however short the step.",
            Verdict.IN_PART if exact < 1e-6 < told(turns, flow, fast) else Verdict.AGREES,
        ),
        Statement(
            "7",
            "The same of a camera that moves too.",
            f"The error does not go to zero as the rate grows: it tends to the summed mean flow of the translation. "
            f"Without noise, {slow} and {fast} Hz, points from 3 to 90 m on one side of a walk of 2 m, degrees: "
            f"{words}. Points all round: {told(around, sphere, slow):.2f} and {told(around, sphere, fast):.2f} on the "
            "sphere.",
            Verdict.CORRECTED if all(b > 0.5 * a for a, b in moved.values()) else Verdict.AGREES,
        ),
        Statement(
            "7, step 3",
            "Mean motions of all steps are summed up.",
            f"Noise does not add up with the steps while the same points are seen: that of a view is in the step "
            f"before it and, with the other sign, in the step after. {np.degrees(_USUAL_RAD):.2f} degrees of noise, "
            f"{_N_POINTS} points, sphere: {few:.3f} degrees at {slow} Hz, {many:.3f} at {fast} Hz.",
            Verdict.AGREES if many < 1.5 * few else Verdict.CORRECTED,
        ),
        Statement(
            "7, remark 2",
            "Leaving out points that move fast, at high rates.",
            f"Weights that change from step to step end that: robust, the same film, {grown[0]:.3f} degrees at {slow} "
            f"Hz and {grown[1]:.3f} at {fast} Hz. And where the flow of one step is less than the noise near points "
            f"are not told from far ones: points on one side, {lost[0]:.2f} degrees at {slow} Hz, {lost[1]:.2f} at "
            f"{fast} Hz, {told(aside, sphere, fast, _USUAL_RAD):.2f} with all points alike.",
            Verdict.IN_PART if lost[1] > 1.5 * lost[0] else Verdict.AGREES,
        ),
    ]


def _noise_statement(table: Table) -> Statement:
    robust = list(_METHODS)[3]
    small, large = _NOISES_RAD[1], _NOISES_RAD[-1]
    floor = _mean(table, (0.0, robust))
    told = ", ".join(f"{_mean(table, (noise, robust)):.2f} at {np.degrees(noise):.2g}" for noise in (0.0, small, large))
    return Statement(
        "7",
        "The mean over all points averages errors of single points out.",
        f"{_N_POINTS} points, {_RATE_HZ} Hz, all round, robust: error of the orientation (degrees) {told} degrees of "
        f"noise. {floor:.2f} degrees are the flow of the translation, without any noise; errors of bearings count "
        "where they are large.",
        Verdict.AGREES if _mean(table, (large, robust)) < 3.0 * np.degrees(large) else Verdict.IN_PART,
    )


def _distance_statements(table: Table) -> list[Statement]:
    sphere, slowest, robust = list(_METHODS)[1:]
    aside = _WORLDS[2]
    error = {(method, s): _mean(table, (aside, s, method)) for method in _METHODS for s in _STRETCHES}
    exponent = slope(np.array(_STRETCHES), np.array([error[sphere, s] for s in _STRETCHES]))
    far = _STRETCHES[-1]
    return [
        Statement(
            "7, step 4",
            "Fine-tuning can be avoided if points are sufficiently far away.",
            f"The error falls with the distance to the power {exponent:.2f}: on one side, {error[sphere, 1.0]:.2f} "
            f"degrees for points at 3 to 90 m, {error[sphere, far]:.3f} at {3 * far:,.0f} to {90 * far:,.0f} m.",
            Verdict.AGREES if -1.1 < exponent < -0.9 else Verdict.IN_PART,
        ),
        Statement(
            "7, remark 2",
            "Leaving out points that move fast refines the algorithm.",
            f"Fast must be what is left when the turn is taken out, since all points of a turning camera move fast. "
            f"Points on one side: all {error[sphere, 1.0]:.2f} degrees, slowest half {error[slowest, 1.0]:.2f}, robust "
            f"{error[robust, 1.0]:.2f}. It helps, and does not end the drift.",
            Verdict.IN_PART if error[slowest, 1.0] < error[sphere, 1.0] else Verdict.CORRECTED,
        ),
    ]


# --------------------------------------------------------------------------------------------------------- positions


#: Films whose positions are found: the world, and how far its points are.
_PLACED = ((_WORLDS[1], 1.0), (_WORLDS[1], 10.0), (_WORLDS[2], 1.0), (_WORLDS[2], 10.0))
_WAYS = ("true orientations", "mean motion", "fine-tuned", "refined together")


def _position_table(settings: Settings, trials: int) -> Table:
    """Find positions with true orientations, with summed ones, after fine-tuning, and all refined together."""
    rows: list[tuple[Any, ...]] = []
    for trial in range(trials):
        for world, stretch in _PLACED:
            film = _film(_generator(settings, trial), world, _RATE_HZ, _USUAL_RAD, stretch)
            for way, scene in _placed(film, settings.threads).items():
                error = evaluate(scene, (film.centers, film.points)).camera_rms
                turned, _ = _orientation_error_deg(scene.cam_from_world, film.cam_from_world)
                rows.append((world, trial, stretch, way, error, turned))
    return Table.of(("world", "trial", "stretch", "way", "camera_rms_m", "orientation_deg"), rows)


def _placed(film: _Film, threads: int) -> dict[str, Scene]:
    options = PositionOptions(threads=threads or None)
    summed = mean_motion(film.tracks, _METHODS["sphere, robust"]).cam_from_world
    first = solve_positions(film.tracks, summed, options)
    tuned = first
    for _ in range(_PASSES):
        # the paper's step 4: orientations for the positions so far, positions for these
        tuned = solve_positions(film.tracks, fit_rotations(film.tracks, tuned), options)
    together = refine(film.tracks, first, RefineOptions(threads=threads or None))
    true = solve_positions(film.tracks, film.cam_from_world, options)
    return dict(zip(_WAYS, (true, first, tuned, together), strict=True))


def _position_statements(table: Table) -> list[Statement]:
    return [_position_statement(table, world) for world in _WORLDS[1:]]


def _position_statement(table: Table, world: str) -> Statement:
    near = {way: 1000.0 * _mean(table, (world, 1.0, way), "camera_rms_m") for way in _WAYS}
    turned = {way: _mean(table, (world, 1.0, way), "orientation_deg") for way in _WAYS}
    words = ", ".join(f"{way} {near[way]:.1f} mm ({turned[way]:.2f} degrees)" for way in _WAYS)
    true, first, tuned, together = (near[way] for way in _WAYS)
    verdict = Verdict.AGREES if tuned < 1.5 * true else Verdict.IN_PART if tuned < first else Verdict.CORRECTED
    place = world.split(", ")[1]
    return Statement(
        "7, step 4",
        f"Fine-tune the orientations to minimise the least squares ({place}).",
        f"A walk of 2 m, points from 3 to 90 m, {np.degrees(_USUAL_RAD):.2f} degrees of noise; error of the positions, "
        f"and of the orientations: {words}. Fine-tuning is {_PASSES} passes of orientations and positions in turn: "
        f"each takes off a part of the error. Refining both at once takes {first / together:.1f} times off.",
        verdict,
    )


# ---------------------------------------------------------------------------------------------------------- pictures

_COLOURS = dict(zip(_METHODS, ("#888888", "#1f5fa8", "#d9a020", "#d9480f"), strict=True))
#: Below this, degrees, an error is rounding and is not drawn.
_LEAST_DEG = 1e-5


def _draw_rates(figure: Any, table: Table) -> None:
    panels = figure.subplots(1, len(_WORLDS), sharey=True)
    for panel, world in zip(panels, _WORLDS, strict=True):
        for method, colour in _COLOURS.items():
            for noise, style in ((0.0, "-"), (_USUAL_RAD, "--")):
                errors = np.array([_mean(table, (world, rate, noise, method)) for rate in _RATES_HZ])
                errors[errors < _LEAST_DEG] = np.nan
                panel.loglog(_RATES_HZ, errors, style, color=colour, marker="o", markersize=3)
        panel.set(xlabel="frames a second (Hz)", title=f"The camera {world}" if world == _WORLDS[0] else f"It {world}")
        panel.set_xticks(_RATES_HZ, [str(rate) for rate in _RATES_HZ])
        panel.minorticks_off()
        panel.grid(alpha=0.25, linewidth=0.6)
    panels[0].set_ylabel("rms error of the orientation (degrees)")
    panels[0].text(0.04, 0.94, "sphere without noise: rounding", transform=panels[0].transAxes, fontsize=8)
    for label, style in (("no noise", "-"), (f"{np.degrees(_USUAL_RAD):.2f} degrees", "--")):
        panels[0].plot([], [], style, color="#222222", label=label)
    _legend(figure, panels[0])


def _legend(figure: Any, panel: Any) -> None:
    for method, colour in _COLOURS.items():
        panel.plot([], [], color=colour, label=method)
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)


def _draw_rest(figure: Any, noise: Table, distance: Table, positions: Table) -> None:
    left, middle, right = figure.subplots(1, 3)
    for method, colour in _COLOURS.items():
        noisy = [value for value in _NOISES_RAD if value > 0.0]
        errors = [_mean(noise, (value, method)) for value in noisy]
        left.semilogx(np.degrees(noisy), errors, color=colour, marker="o", markersize=3)
        for world, style in zip(_WORLDS[1:], ("-", "--"), strict=True):
            errors = [_mean(distance, (world, stretch, method)) for stretch in _STRETCHES]
            middle.loglog(3.0 * np.array(_STRETCHES), errors, style, color=colour, marker="o", markersize=3)
    left.set(xlabel="noise of a bearing (degrees)", ylabel="rms error of the orientation (degrees)")
    left.set_title(f"Points all round, {_RATE_HZ} Hz", fontsize=10)
    middle.set(xlabel="distance of the nearest points (m)", ylabel="rms error of the orientation (degrees)")
    middle.set_title("All round (solid), on one side (dashed)", fontsize=10)
    place = np.arange(len(_WAYS))
    for number, (world, stretch) in enumerate(_PLACED):
        errors = [1000.0 * _mean(positions, (world, stretch, way), "camera_rms_m") for way in _WAYS]
        label = f"{world.split(', points ')[1]}, from {3 * stretch:.0f} m"
        right.bar(place + 0.2 * (number - 1.5), errors, 0.18, label=label, color=_BARS[number])
    right.set(ylabel="rms error of the cameras (mm)", yscale="log")
    right.set_xticks(place, [way.replace(" ", "\n") for way in _WAYS], fontsize=8)
    right.set_title("Positions of a walk of 2 m", fontsize=10)
    low, high = right.get_ylim()
    right.set_ylim(low, 12.0 * high)
    right.legend(fontsize=8, frameon=False, ncols=2)
    for panel in (left, middle, right):
        panel.grid(alpha=0.25, linewidth=0.6)
    _legend(figure, left)


_BARS = ("#1f5fa8", "#8fb4dd", "#d9480f", "#f0b090")

MEAN_MOTION = Experiment("mean-motion", "7", "Cameras that turn: mean motion, and positions found with it", _run)
