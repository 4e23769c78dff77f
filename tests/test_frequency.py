"""Angular frequencies that nobody gave: found from bodies that come back, cameras known or not."""

from __future__ import annotations

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
