"""Bias: what remains of the error when the same world is seen again and again with new errors of its angles.

Of ``R`` displacements ``e_r`` of one node, ``(|sum e_r|^2 - sum |e_r|^2) / (R (R - 1))`` has the squared bias as its
mean: no part of the noise is left in it, but it may come out negative where there is no bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from panopath.cameras import bearings_from_spherical, spherical_from_bearings
from panopath.evaluate import fit_shift_and_scale
from panopath.model import Float, Tracks
from panopath.paper.trials import SOLVERS, Int64, median, rms, trial_seeds
from panopath.steps.positions import solve_positions
from panopath.synthetic import SyntheticWorld, simulate


@dataclass(frozen=True)
class Bias:
    """One solver on worlds of one size in space."""

    n_views: int
    n_points: int
    angle_error_rad: float
    solver: str
    #: Root mean square error, and root mean square bias, over views and points; medians over worlds. 0: none is seen.
    rms: float
    bias_rms: float

    @property
    def share(self) -> float:
        """Bias, as a share of the whole error."""
        return self.bias_rms / self.rms if self.rms > 0.0 else float("nan")


def measure_bias(
    sizes: Sequence[tuple[int, int]],
    angle_error_rad: Sequence[float],
    worlds: int,
    repeats: int,
    *,
    seed: int,
    threads: int = 0,
) -> list[Bias]:
    """See worlds of each size, in space, ``repeats`` times with each error (``repeats`` is 2 or more)."""
    found = []
    for m, n in sizes:
        seeds: Int64 = trial_seeds(seed, (3, m, n), worlds)
        for error in angle_error_rad:
            squares: dict[str, list[tuple[float, float]]] = {solver: [] for solver in SOLVERS}
            for one in seeds.tolist():
                world = simulate("box", n_views=m, n_points=n, seed=one)
                views = [_seen_again(world, error, (seed, one, k)) for k in range(repeats)]
                for solver in SOLVERS:
                    squares[solver].append(_squares(world, views, solver, threads))
            for solver, pairs in squares.items():
                total, common = (median(values) for values in np.sqrt(np.maximum(pairs, 0.0)).T)
                found.append(Bias(m, n, error, solver, total, common))
    return found


def _seen_again(world: SyntheticWorld, error: float, key: tuple[int, ...]) -> Tracks:
    angles = spherical_from_bearings(world.tracks.bearing)
    noise = np.random.default_rng(key).uniform(-error, error, angles.shape)
    return replace(world.tracks, bearing=bearings_from_spherical(angles + noise))


def _squares(world: SyntheticWorld, seen: Sequence[Tracks], solver: str, threads: int) -> tuple[float, float]:
    """Mean square error, and mean square bias, of what is determined each time."""
    truth = np.concatenate((world.centers, world.points))
    options = replace(SOLVERS[solver], threads=threads or None)
    errors = []
    for tracks in seen:
        scene = solve_positions(tracks, options=options)
        errors.append(_displacement(np.concatenate((scene.centers, scene.points)), truth))
    whole = np.array(errors)
    whole = whole[:, np.isfinite(whole).all(axis=(0, 2))]
    repeats = len(whole)
    square = (whole**2).sum(axis=(0, 2))
    common = ((whole.sum(axis=0) ** 2).sum(axis=1) - square) / (repeats * (repeats - 1))
    return rms(np.sqrt(square / repeats)) ** 2, float(common.mean()) if len(common) else float("nan")


def _displacement(found: Float, truth: Float) -> Float:
    """From the truth to what was found, after the fit by shift and scale."""
    known = np.isfinite(found).all(axis=1)
    if not known.any():
        return np.full_like(truth, np.nan)
    scale, shift = fit_shift_and_scale(found[known], truth[known])
    return scale * found + shift - truth
