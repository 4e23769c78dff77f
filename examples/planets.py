"""The solar system from directions alone: the Earth is the camera, and the planets are bodies that move.

Over 30 years the directions of the Sun, Mercury, Venus, Mars, Jupiter and Saturn among the fixed stars are taken 400
times. The Sun stands still, and each planet comes back after its own period: Fourier paths. Nothing is said of the
Earth. What comes out are the paths of the planets and of the Earth, up to one scale: the ratios that Copernicus found.

Directions are those of the theories in ERFA (the Earth: Bretagnon and Francou 1988 as in ``epv00``; the planets: Simon
et al. 1994), where the bodies stand, without the time that light takes. With ``--noise`` each one is off by an arc
minute, about as much as Tycho Brahe's were. With ``--find-periods`` the periods come from the directions too.

Run: ``python examples/planets.py [--noise] [--find-periods] [--views N] [PICTURE]``, with the extras ``astro``
and, for a picture, ``plot``.
"""

from __future__ import annotations

import argparse
import importlib
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import panopath as pp

Float = npt.NDArray[np.float64]

DAY_S, YEAR_D = 86400.0, 365.25
N_VIEWS, YEARS = 400, 30.0
#: 1990 January 1, as a Julian date.
FIRST_DAY = 2447892.5
NOISE_RAD = np.radians(1.0 / 60.0)


@dataclass(frozen=True)
class Planet:
    """What is known of a planet, to compare with."""

    #: Its number in ``plan94``.
    number: int
    #: Sidereal period in days, and semi-major axis in that of the Earth (mean elements of Simon et al. 1994).
    period_d: float
    axis: float
    #: Harmonics that its ellipse takes: the rounder the fewer.
    order: int
    color: str


PLANETS = {
    "Mercury": Planet(1, 87.9691, 0.387098, 6, "#8c6d31"),
    "Venus": Planet(2, 224.7008, 0.723330, 3, "#d6a300"),
    "Mars": Planet(4, 686.9796, 1.523679, 4, "#c0392b"),
    "Jupiter": Planet(5, 4332.589, 5.202603, 3, "#b5651d"),
    "Saturn": Planet(6, 10759.23, 9.554909, 3, "#7f8c5a"),
}


def observe(noise_rad: float, *, n_views: int = N_VIEWS, seed: int = 0) -> tuple[pp.Tracks, Float]:
    """Directions of the Sun and the planets, x to the vernal equinox, z to the pole of the ecliptic; the true Earth."""
    erfa: Any = importlib.import_module("erfa")
    # nights come as they come: at equal steps, fast periods could not be told from slow ones
    days = np.sort(np.random.default_rng(0).uniform(0.0, YEARS * YEAR_D, n_views))
    ecliptic = erfa.ecm06(2451545.0, 0.0)
    earth = erfa.epv00(FIRST_DAY, days)[0]["p"] @ ecliptic.T
    bodies = [np.zeros_like(earth)]
    bodies += [erfa.plan94(FIRST_DAY, days, planet.number)["p"] @ ecliptic.T for planet in PLANETS.values()]
    direction = np.stack(bodies, axis=1) - earth[:, None]
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    direction += noise_rad * np.random.default_rng(seed).normal(size=direction.shape)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    n_bodies = len(bodies)
    tracks = pp.Tracks.from_arrays(
        np.repeat(np.arange(n_views), n_bodies),
        np.tile(np.arange(n_bodies), n_views),
        direction.reshape(-1, 3),
        time_s=days * DAY_S,
        track_names=("Sun", *PLANETS),
    )
    return tracks, earth


def solve(tracks: pp.Tracks, *, periods_known: bool) -> pp.Scene:
    """Paths of the Earth (the views) and of the planets, the Sun at rest."""
    forms: dict[str | int, pp.PathModel | Literal["auto"]] = {
        name: pp.Fourier(planet.order, 2.0 * np.pi / (planet.period_d * DAY_S) if periods_known else None)
        for name, planet in PLANETS.items()
    }
    return pp.solve_positions(tracks, motion=pp.Motion(tracks=forms, static=("Sun",)))


def semi_major(path: Float) -> float:
    """Semi-major axis of the ellipse about the Sun (at zero) that places (n, 3) lie on, by least absolute errors.

    With a focus at zero an ellipse is linear: ``1 / r = (1 + e cos(angle)) / p``. The extremes of the distance would be
    those of the worst views.
    """
    path = path[np.isfinite(path).all(axis=1)]
    distance = np.linalg.norm(path, axis=1)
    plane = np.linalg.svd(path, full_matrices=False)[2][:2]
    design = np.column_stack((np.ones_like(distance), path @ plane.T / distance[:, None]))
    weight = np.ones_like(distance)
    for _ in range(20):
        conic = np.linalg.lstsq(design * weight[:, None], weight / distance, rcond=None)[0]
        off = np.abs(design @ conic - 1.0 / distance)
        weight = 1.0 / np.sqrt(np.maximum(off, np.median(off) + np.finfo(float).tiny))
    return float(conic[0] / (conic[0] ** 2 - conic[1] ** 2 - conic[2] ** 2))


@dataclass(frozen=True, eq=False)
class SolarSystem:
    """A scene with the Sun at zero and the Earth's semi-major axis as the unit."""

    earth: Float
    #: Paths over one period each, (n, 3), and the periods in days.
    planets: dict[str, Float]
    periods_d: dict[str, float]

    def axis(self, name: str) -> float:
        """Semi-major axis of a planet."""
        return semi_major(self.planets[name])


def placed(scene: pp.Scene, tracks: pp.Tracks) -> SolarSystem:
    """Bring a scene to the Sun and to the unit of the Earth."""
    paths = scene.paths
    assert paths is not None
    sun = scene.points[0]
    unit = semi_major(scene.centers - sun)
    planets, periods = {}, {}
    for name in PLANETS:
        track = tracks.track_labels().index(name)
        form = paths.models[track]
        if not isinstance(form, pp.Fourier) or form.omega_rad_s is None:
            raise pp.InputError(f"the period of {name} was not found")
        period_s = 2.0 * np.pi / form.omega_rad_s
        around = paths.position(track, np.linspace(0.0, period_s, 721), outside=True)
        planets[name], periods[name] = (around - sun) / unit, period_s / DAY_S
    return SolarSystem((scene.centers - sun) / unit, planets, periods)


def table(system: SolarSystem, *, periods_known: bool) -> str:
    """Semi-major axes beside the known ones, and periods where they were found."""
    lines = [f"{'':8s}{'axis known':>12s}{'found':>10s}{'error':>10s}{'period known':>15s}{'found':>12s}"]
    for name, planet in PLANETS.items():
        axis, period_d = system.axis(name), system.periods_d[name]
        error = 100.0 * (axis / planet.axis - 1.0)
        found = "given" if periods_known else f"{period_d:.2f} d"
        lines.append(f"{name:8s}{planet.axis:12.4f}{axis:10.4f}{error:8.2f} %{planet.period_d:13.2f} d{found:>12s}")
    return "\n".join(lines)


def draw(system: SolarSystem, path: str) -> None:
    """Draw the orbits seen from the north of the ecliptic, near and far, and Kepler's third law."""
    figure: Any = importlib.import_module("matplotlib.figure").Figure(figsize=(12.0, 4.3), layout="constrained")
    near, far, law = figure.subplots(1, 3)
    for axes, names, reach in ((near, ("Mercury", "Venus", "Mars"), 2.2), (far, ("Mars", "Jupiter", "Saturn"), 13.0)):
        axes.plot(0.0, 0.0, "o", color="#f5b700", markersize=9)
        axes.plot(*system.earth[:, :2].T, ".", color="#1f5fa8", markersize=2, label="Earth: the camera")
        for name in names:
            axes.plot(*system.planets[name][:, :2].T, "-", color=PLANETS[name].color, label=name)
        axes.set(aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach), xlabel="semi-major axes of the Earth")
        axes.legend(loc="upper left", fontsize=7, frameon=False)
    axis = np.array([system.axis(name) for name in PLANETS])
    period = np.array([system.periods_d[name] / YEAR_D for name in PLANETS])
    line = np.array([0.3, 12.0])
    law.loglog(line, line**1.5, "-", color="#999999", label="period$^2$ = axis$^3$ (Kepler)")
    law.loglog(axis, period, "o", color="#1f5fa8", label="found")
    law.loglog(1.0, 1.0, "o", color="#999999", label="Earth: the unit")
    for name, x, y in zip(PLANETS, axis, period, strict=True):
        law.annotate(name, (x, y), (6, -9), textcoords="offset points", fontsize=8)
    law.set(xlabel="semi-major axis", ylabel="period, years")
    law.legend(loc="upper left", fontsize=8, frameon=False)
    for axes, title in zip((near, far, law), ("inner planets", "outer planets", "third law"), strict=True):
        axes.set_title(title, fontsize=10)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("picture", nargs="?", help="where to write the picture")
    parser.add_argument("--noise", action="store_true", help="directions are off by an arc minute")
    parser.add_argument("--find-periods", action="store_true", help="find the periods too, from the directions")
    parser.add_argument("--views", type=int, default=N_VIEWS, help="how often the directions are taken")
    arguments = parser.parse_args()
    try:
        tracks, earth = observe(NOISE_RAD if arguments.noise else 0.0, n_views=arguments.views)
    except ModuleNotFoundError:
        raise SystemExit('the ephemeris needs pyerfa: pip install "panopath[astro]"') from None
    known = not arguments.find_periods
    try:
        scene = solve(tracks, periods_known=known)
        system = placed(scene, tracks)
    except pp.InputError as problem:
        raise SystemExit(f"not solved: {problem}") from None
    assert scene.paths is not None
    print(f"{tracks!r}: {scene.summary.status.value}; {scene.paths.assumption}")
    print(table(system, periods_known=known))
    error = 100.0 * np.linalg.norm(system.earth - earth / semi_major(earth), axis=1)
    rms, median = np.sqrt(np.mean(error**2)), np.median(error)
    print(f"path of the Earth: {rms:.3f} % of its semi-major axis, rms; median {median:.3f} %")
    if arguments.picture:
        draw(system, arguments.picture)


if __name__ == "__main__":
    main()
