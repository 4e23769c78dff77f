"""Angular frequencies that nobody gave: found from bodies that come back, cameras known or not."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
import pytest

Float = npt.NDArray[np.float64]

OMEGA = (1.37, 0.62)


def cameras(time_s: Float, dimension: int) -> Float:
    wander = [2.0 * np.cos(0.31 * time_s) + 0.2 * time_s, 1.5 * np.sin(0.47 * time_s), 0.6 * np.sin(0.9 * time_s)]
    return np.stack(wander, axis=1)[:, :dimension]


def ellipse(omega: float, time_s: Float, number: int, dimension: int, order: int = 1) -> Float:
    """A body that goes round, with higher harmonics that fall."""
    random = np.random.default_rng(number)
    path = np.tile(random.normal(scale=3.0, size=3), (len(time_s), 1))
    for harmonic in range(1, order + 1):
        phase = harmonic * omega * time_s[:, None]
        size = 0.3 ** (harmonic - 1)
        path += size * (np.cos(phase) * random.normal(size=3) + np.sin(phase) * random.normal(size=3))
    return path[:, :dimension]


def seen(static: int, bodies: list[Float], time_s: Float, dimension: int) -> pp.Tracks:
    """Exact directions of points at rest, then of bodies, from cameras that wander."""
    centers = cameras(time_s, dimension)
    points = np.random.default_rng(7).normal(scale=4.0, size=(static, dimension))
    places = np.stack([*(np.tile(point, (len(time_s), 1)) for point in points), *bodies])
    direction = places - centers
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    n_tracks, n_views = direction.shape[:2]
    return pp.Tracks.from_arrays(
        np.tile(np.arange(n_views), n_tracks),
        np.repeat(np.arange(n_tracks), n_views),
        direction.reshape(-1, dimension),
        time_s=time_s,
    )


def solved(tracks: pp.Tracks, static: int, forms: list[Any], **options: Any) -> pp.Scene:
    motion = pp.Motion(
        static=tuple(range(static)), tracks={static + k: form for k, form in enumerate(forms)}, **options
    )
    return pp.solve_positions(tracks, motion=motion)


def omegas(scene: pp.Scene, static: int) -> list[float]:
    """Frequencies of the tracks after the first ``static``; NaN where none was found."""
    assert scene.paths is not None
    models = scene.paths.models[static:]
    found = [model.omega_rad_s if isinstance(model, pp.Fourier) else None for model in models]
    return [np.nan if omega is None else omega for omega in found]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("order", [1, 2])
def test_cameras_known_from_points_at_rest(dimension: int, order: int) -> None:
    time_s = np.linspace(0.0, 20.0, 60)
    bodies = [ellipse(omega, time_s, k, dimension, order) for k, omega in enumerate(OMEGA)]
    scene = solved(seen(12, bodies, time_s, dimension), 12, [pp.Fourier(order)] * 2)
    assert scene.summary.status.value == "converged"
    np.testing.assert_allclose(omegas(scene, 12), np.array(OMEGA), rtol=1e-8)


def test_more_harmonics_than_there_are_do_not_halve_the_frequency() -> None:
    time_s = np.linspace(0.0, 20.0, 60)
    scene = solved(seen(12, [ellipse(OMEGA[0], time_s, 0, 3)], time_s, 3), 12, [pp.Fourier(2)])
    np.testing.assert_allclose(omegas(scene, 12), np.array(OMEGA[:1]), rtol=1e-8)


def test_cameras_unknown() -> None:
    """Like the Sun and planets: one point at rest, three bodies that come back."""
    time_s = np.linspace(0.0, 30.0, 90)
    true = (*OMEGA, 2.11)
    bodies = [ellipse(omega, time_s, k, 3) for k, omega in enumerate(true)]
    scene = solved(seen(1, bodies, time_s, 3), 1, [pp.Fourier(1)] * 3)
    assert scene.summary.status.value == "converged"
    np.testing.assert_allclose(omegas(scene, 1), np.array(true), rtol=1e-8)


def kepler(eccentricity: float, mean_anomaly: Float) -> Float:
    """An ellipse of semi-major axis one with a focus at zero, in its plane, (n, 2)."""
    angle = mean_anomaly.copy()
    for _ in range(30):
        angle -= (angle - eccentricity * np.sin(angle) - mean_anomaly) / (1.0 - eccentricity * np.cos(angle))
    return np.stack((np.cos(angle) - eccentricity, np.sqrt(1.0 - eccentricity**2) * np.sin(angle)), axis=1)


#: Semi-major axes, eccentricities and inclinations of bodies about a sun, seen from a body with the axis one.
ORBITS = ((0.42, 0.19, 0.12), (0.71, 0.01, 0.06), (1.55, 0.09, 0.05), (2.3, 0.05, 0.08))


def sun_and_planets(noise_rad: float, *, since_s: float = 0.0, n_views: int = 150) -> tuple[pp.Tracks, Float, Float]:
    """Directions of a sun and its planets at times that come as they come; the frequencies, and the observer's path."""
    random = np.random.default_rng(3)
    time_s = np.sort(random.uniform(0.0, 30.0, n_views))
    omega = np.array([axis**-1.5 for axis, *_ in ORBITS])
    plane = kepler(0.04, time_s + 2.0)
    observer = np.column_stack((plane, np.zeros(n_views)))
    bodies = [np.zeros_like(observer)]
    for (axis, eccentricity, inclination), rate in zip(ORBITS, omega, strict=True):
        x, y = axis * kepler(eccentricity, rate * time_s + random.uniform(0.0, 6.0)).T
        node, flat = random.uniform(0.0, 6.0), y * np.cos(inclination)
        body = (x * np.cos(node) - flat * np.sin(node), x * np.sin(node) + flat * np.cos(node), y * np.sin(inclination))
        bodies.append(np.stack(body, axis=1))
    direction = np.stack(bodies) - observer
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    direction += noise_rad * random.normal(size=direction.shape)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    n_tracks = len(bodies)
    view, track = np.tile(np.arange(n_views), n_tracks), np.repeat(np.arange(n_tracks), n_views)
    tracks = pp.Tracks.from_arrays(view, track, direction.reshape(-1, 3), time_s=since_s + time_s)
    return tracks, omega, observer


@pytest.mark.parametrize("noise_rad", [0.0, 3e-4])
@pytest.mark.parametrize("since_s", [0.0, 1.7e9])
def test_periods_about_a_sun(noise_rad: float, since_s: float) -> None:
    """Ellipses need several harmonics; no period is twice or half as long, whatever time is counted from."""
    tracks, omega, observer = sun_and_planets(noise_rad, since_s=since_s)
    scene = solved(tracks, 1, [pp.Fourier(order) for order in (6, 2, 4, 3)])
    assert scene.summary.status.value == "converged"
    np.testing.assert_allclose(omegas(scene, 1), omega, rtol=1e-3)
    centers = scene.centers - scene.points[0]
    scale = np.median(np.linalg.norm(observer, axis=1) / np.linalg.norm(centers, axis=1))
    off = np.linalg.norm(scale * centers - observer, axis=1)
    assert np.median(off) < 5e-3


def test_periods_of_the_planets() -> None:
    """A real ephemeris, to an arc minute: 160 nights in 30 years, fewer than Mercury has periods and a half."""
    pytest.importorskip("erfa", reason="the extra astro is absent")
    path = Path(__file__).resolve().parents[1] / "examples" / "planets.py"
    spec = importlib.util.spec_from_file_location("planets", path)
    assert spec is not None
    assert spec.loader is not None
    example: Any = importlib.util.module_from_spec(spec)
    sys.modules["planets"] = example
    spec.loader.exec_module(example)
    tracks, earth = example.observe(example.NOISE_RAD, n_views=160)
    scene = example.solve(tracks, periods_known=False)
    assert scene.summary.status.value == "converged"
    system = example.placed(scene, tracks)
    for name, planet in example.PLANETS.items():
        assert system.periods_d[name] == pytest.approx(planet.period_d, rel=1e-3), name
        assert system.axis(name) == pytest.approx(planet.axis, rel=2e-3), name
    assert np.median(np.linalg.norm(system.earth - earth / example.semi_major(earth), axis=1)) < 1e-3


@pytest.mark.parametrize("dimension", [2, 3])
def test_one_frequency_for_all(dimension: int) -> None:
    time_s = np.linspace(0.0, 20.0, 60)
    bodies = [ellipse(OMEGA[0], time_s, k, dimension) for k in range(3)]
    scene = solved(seen(12, bodies, time_s, dimension), 12, [pp.Fourier(1)] * 3, common_omega=True)
    found = omegas(scene, 12)
    assert len(set(found)) == 1
    np.testing.assert_allclose(found, OMEGA[0], rtol=1e-8)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_point_at_rest_has_none(dimension: int) -> None:
    time_s = np.linspace(0.0, 20.0, 40)
    still = np.tile([3.0, 2.0, 1.0][:dimension], (40, 1))
    scene = solved(seen(12, [still], time_s, dimension), 12, [pp.Fourier(1)])
    assert scene.summary.status.value == "converged"
    assert scene.paths is not None
    assert np.isnan(omegas(scene, 12)).all()
    assert scene.paths.verdicts[12] is pp.PathVerdict.UNDETERMINED
    assert np.isnan(scene.points[12]).all()


def test_nothing_tells_the_frequency() -> None:
    """One body and nothing at rest, in the plane: a status, not an error."""
    time_s = np.linspace(0.0, 20.0, 40)
    scene = solved(seen(0, [ellipse(OMEGA[0], time_s, 0, 2)], time_s, 2), 0, [pp.Fourier(1)])
    assert scene.summary.status.value == "undetermined"
    assert np.isnan(omegas(scene, 0)).all()
