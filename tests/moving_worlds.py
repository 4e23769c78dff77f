"""Small exact worlds whose tracks follow paths of given forms, and what their linear equations leave free.

A view at ``c_i``, at the time ``t_i``, sees track ``j`` along ``P_j(t_i) - c_i``, where ``P_j(t) = sum_l B_l(t) p_jl``.
With directions known, ``(I - u u^T)(P_j(t_i) - c_i) = 0`` is linear in all unknowns (Knill and Ramirez-Herran 2007,
section 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from panopath.model import Tracks
from panopath.paths import Fourier, PathModel, Paths, PathVerdict, Spline, Static, Taylor, path_functions

Float = npt.NDArray[np.float64]

#: Length of the worlds in time, seconds.
DURATION_S = 10.0
OMEGA_RAD_S = 0.9

#: One of each form that theory and tests speak of, over the time of the worlds.
FORMS: dict[str, PathModel] = {
    **{f"taylor:{k}": Taylor(k, 0.5 * DURATION_S, 0.5 * DURATION_S) for k in (1, 2, 3)},
    **{f"fourier:{k}": Fourier(k, OMEGA_RAD_S) for k in (1, 2, 3)},
    "spline, linear": Spline((0.0, 0.3 * DURATION_S, 0.6 * DURATION_S, DURATION_S), 1),
    "spline, cubic": Spline((0.0, 0.4 * DURATION_S, DURATION_S), 3),
}


@dataclass(frozen=True, eq=False)
class MovingWorld:
    """What was seen, and the truth."""

    #: Bearings are world directions; ``time_s`` is set.
    tracks: Tracks
    #: Rotations (n_views, 3, 3) or headings (n_views,): identities.
    cam_from_world: Float
    #: (n_views, d) true positions.
    centers: Float
    #: True paths of all tracks.
    paths: Paths

    @property
    def static(self) -> list[int]:
        """Tracks at rest."""
        return [j for j, model in enumerate(self.paths.models) if isinstance(model, Static)]


def moving_world(
    forms: Sequence[PathModel],
    *,
    d: int = 3,
    n_views: int = 30,
    n_static: int = 6,
    visible: float = 1.0,
    noise_rad: float = 0.0,
    seed: int = 0,
) -> MovingWorld:
    """Draw views and tracks in the box [-1, 1]^d: ``n_static`` at rest, then one for each of ``forms``.

    Views stand anywhere, in no order, so that no path of any form imitates theirs. Times are uneven.
    """
    rng = np.random.default_rng([2007, seed])
    time_s = np.sort(rng.uniform(0.0, DURATION_S, n_views))
    centers = rng.uniform(-1.0, 1.0, (n_views, d))
    models = (*(Static() for _ in range(n_static)), *forms)
    coefficients = [_drawn(model, d, rng) for model in models]
    starts = np.concatenate(([0], np.cumsum([len(rows) for rows in coefficients])))
    sees = rng.random((n_views, len(models))) < visible
    track, view = np.nonzero(sees.T)
    position = np.stack([path_functions(m, time_s) @ rows for m, rows in zip(models, coefficients, strict=True)])
    ray = position[track, view] - centers[view]
    bearing = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    if noise_rad > 0.0:
        bearing = _disturbed(bearing, noise_rad, rng)
    seen_s = np.full((len(models), 2), np.nan)
    for j in np.unique(track):
        seen_s[j] = time_s[view[track == j][[0, -1]]]
    none = np.full(len(models), -1, dtype=np.int32)
    verdicts = tuple(PathVerdict.STATIC if isinstance(m, Static) else PathVerdict.MOVING for m in models)
    paths = Paths(models, starts, np.concatenate(coefficients), None, seen_s, verdicts, none, none, "the truth")
    tracks = Tracks.from_arrays(
        view.astype(np.int32), track.astype(np.int32), bearing, n_views, len(models), time_s=time_s
    )
    identity = np.zeros(n_views) if d == 2 else np.tile(np.eye(3), (n_views, 1, 1))
    return MovingWorld(tracks, identity, centers, paths)


def _drawn(model: PathModel, d: int, rng: np.random.Generator) -> Float:
    """Vectors of a path about a place in the box; later ones are smaller, as those of smooth motions are."""
    rows = 0.6 * rng.normal(size=(model.n_functions, d))
    middle = rng.uniform(-1.0, 1.0, d)
    if isinstance(model, Spline):
        return np.asarray(middle + rows)
    rows[0] = middle
    rows[1:] /= 1.0 + np.arange(len(rows) - 1)[:, None] / (2.0 if isinstance(model, Fourier) else 1.0)
    return np.asarray(rows)


def _disturbed(bearing: Float, noise_rad: float, rng: np.random.Generator) -> Float:
    noise = rng.normal(size=bearing.shape) * noise_rad
    noise -= np.sum(noise * bearing, axis=1, keepdims=True) * bearing
    moved = bearing + noise
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def linear_equations(tracks: Tracks, models: Sequence[PathModel]) -> Float:
    """Dense matrix of ``(I - u u^T)(P_j(t_i) - c_i) = 0``; unknowns are the centres, then all vectors of the paths."""
    assert tracks.time_s is not None
    d, n = tracks.bearing.shape[1], len(tracks)
    starts = np.concatenate(([0], np.cumsum([m.n_functions for m in models])))
    across = np.eye(d) - tracks.bearing[:, :, None] * tracks.bearing[:, None, :]
    matrix = np.zeros((n, d, tracks.n_views + int(starts[-1]), d))
    matrix[np.arange(n), :, tracks.view] = -across
    for j, model in enumerate(models):
        mine = np.flatnonzero(tracks.track == j)
        values = path_functions(model, tracks.time_s[tracks.view[mine]])
        for k in range(model.n_functions):
            matrix[mine, :, tracks.n_views + starts[j] + k] = values[:, k, None, None] * across[mine]
    return np.asarray(matrix.reshape(n * d, -1))


def nullity(world: MovingWorld, models: Sequence[PathModel] | None = None) -> int:
    """Count the freedoms that exact bearings leave when paths are taken to have these forms (None: their own)."""
    matrix = linear_equations(world.tracks, world.paths.models if models is None else models)
    values = np.linalg.svd(matrix, compute_uv=False)
    values = np.concatenate((values, np.zeros(max(0, matrix.shape[1] - len(values)))))
    return int(np.sum(values < 1e-9 * values[0]))


def linear_solution(world: MovingWorld, models: Sequence[PathModel] | None = None) -> tuple[Float, Float]:
    """Solve the equations as they are; centres and vectors of paths, by shift and scale brought to the truth.

    For exact bearings of determined worlds. Paths count with the functions that a shift goes into, see
    ``Paths.transformed``.
    """
    models = world.paths.models if models is None else tuple(models)
    matrix = linear_equations(world.tracks, models)
    d, n = world.centers.shape[1], world.tracks.n_views
    # without the centroid of the cameras, which is zero then, only the scale is left
    fixed = np.concatenate((matrix, np.tile(np.eye(d), n + sum(m.n_functions for m in models))))
    fixed[-d:, n * d :] = 0.0
    found = np.linalg.svd(fixed, full_matrices=False)[2][-1].reshape(-1, d)
    truth = world.centers - world.centers.mean(axis=0)
    scale = float(np.sum(found[:n] * truth) / np.sum(found[:n] ** 2))
    found = found * scale
    shift = world.centers.mean(axis=0)
    rows, at = found[n:].copy(), 0
    for model in models:
        rows[at : at + (model.n_functions if isinstance(model, Spline) else 1)] += shift
        at += model.n_functions
    return np.asarray(found[:n] + shift), rows
