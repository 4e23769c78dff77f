"""Scenes whose points move along Taylor or Fourier paths (section 6), with their equations as a dense matrix.

A view at ``c_i``, taken at ``t_i``, sees ``P_j(t_i) = sum_l B_l(t_i) p_jl``. With directions known the equations
``(I - u u^T)(P_j(t_i) - c_i) = 0`` are linear in the centres and in all vectors ``p_jl``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from panopath.formats.structure import known_scene
from panopath.model import Float, Scene, Tracks
from panopath.paper.scenes import disturbed, nullity, unit
from panopath.paths import Fourier, PathModel, Paths, PathVerdict, Static, Taylor, path_functions

#: Length of a scene in time, seconds.
DURATION_S = 10.0

#: Forms of path by name; times run from -1 to 1 in a Taylor expansion.
FORMS: dict[str, PathModel] = {
    "Taylor, k = 1": Taylor(1, 0.5 * DURATION_S, 0.5 * DURATION_S),
    "Taylor, k = 2": Taylor(2, 0.5 * DURATION_S, 0.5 * DURATION_S),
    "Fourier, k = 1": Fourier(1, 0.9),
    "Fourier, k = 2": Fourier(2, 0.9),
}


@dataclass(frozen=True, eq=False)
class MovingScene:
    """Views and paths; everything is seen."""

    #: (m, d).
    centers: Float
    #: (m,) seconds, ascending.
    time_s: Float
    models: tuple[PathModel, ...]
    #: (sum of n_functions, d).
    coefficients: Float
    #: Bearings, world directions with the times of the views.
    tracks: Tracks

    @classmethod
    def of(
        cls, centers: Float, time_s: Float, models: Sequence[PathModel], coefficients: Sequence[Float]
    ) -> MovingScene:
        """See every path from every view, exactly."""
        places = [path_functions(model, time_s) @ rows for model, rows in zip(models, coefficients, strict=True)]
        track, view = (index.ravel() for index in np.indices((len(models), len(centers))))
        ray = unit(np.stack(places)[track, view] - centers[view])
        tracks = Tracks.from_arrays(view, track, ray, len(centers), len(models), time_s=time_s)
        return cls(centers, time_s, tuple(models), np.concatenate(coefficients), tracks)

    @property
    def starts(self) -> npt.NDArray[np.int64]:
        """(n + 1,) rows of ``coefficients`` at which each path begins."""
        return np.cumsum([0, *(model.n_functions for model in self.models)])

    @property
    def static(self) -> list[int]:
        """Tracks whose form is rest."""
        return [j for j, model in enumerate(self.models) if isinstance(model, Static)]

    def noisy(self, sigma_rad: float, rng: np.random.Generator) -> MovingScene:
        """See the same with errors."""
        return replace(self, tracks=disturbed(self.tracks, sigma_rad, rng))

    def truth(self) -> Scene:
        """Make the true scene, with its paths."""
        n = len(self.models)
        seen_s = np.tile(self.time_s[[0, -1]], (n, 1))
        none = np.full(n, -1, dtype=np.int32)
        verdicts = tuple(PathVerdict.STATIC if isinstance(m, Static) else PathVerdict.MOVING for m in self.models)
        paths = Paths(self.models, self.starts, self.coefficients, None, seen_s, verdicts, none, none)
        middle = [paths.position(j, [self.time_s[[0, -1]].mean()])[0] for j in range(n)]
        return known_scene(self.tracks, None, self.centers, np.array(middle), paths=paths)

    def equations(self, models: Sequence[PathModel] | None = None) -> Float:
        """Matrix of all equations if paths had these forms; unknowns are the centres, then all vectors."""
        forms, tracks = self.models if models is None else models, self.tracks
        d, m = tracks.d, tracks.n_views
        starts = np.cumsum([0, *(model.n_functions for model in forms)])
        across = _tangents(tracks.bearing)
        rows = np.zeros((len(tracks), d - 1, m + int(starts[-1]), d))
        rows[np.arange(len(tracks)), :, tracks.view] = -across
        for j, model in enumerate(forms):
            mine = np.flatnonzero(tracks.track == j)
            values = path_functions(model, self.time_s[tracks.view[mine]])
            for k in range(model.n_functions):
                rows[mine, :, m + starts[j] + k] = values[:, k, None, None] * across[mine]
        return rows.reshape(len(tracks) * (d - 1), -1)

    def dense_nullity(self) -> int:
        """Freedoms of the equations, gauge included, by singular values."""
        return nullity(self.equations())

    def linear_centers(self) -> Float:
        """Centres (m, d) by the paper's normal equations ``A^T A x = 0``, shifts taken out: the weakest eigenvector."""
        matrix, (m, d) = self.equations(), self.centers.shape
        normal = matrix.T @ matrix
        # with the centroid of the views at zero the scale alone is left
        normal[: m * d, : m * d] += np.kron(np.ones((m, m)), np.eye(d))
        found = np.linalg.eigh(normal)[1][: m * d, 0].reshape(m, d)
        truth = self.centers - self.centers.mean(axis=0)
        return np.asarray(found if (found * truth).sum() > 0.0 else -found)


def _tangents(bearing: Float) -> Float:
    """Orthonormal rows (N, d - 1, d) across unit vectors (N, d): Householder's reflection onto the last axis."""
    d = bearing.shape[1]
    sign = np.where(bearing[:, -1:] < 0.0, -1.0, 1.0)
    mirror = bearing + sign * np.eye(d)[-1]
    mirror /= np.linalg.norm(mirror, axis=1, keepdims=True)
    return np.asarray((np.eye(d) - 2.0 * mirror[:, :, None] * mirror[:, None, :])[:, :-1])


def draw_moving(
    rng: np.random.Generator,
    models: Sequence[PathModel],
    *,
    d: int,
    n_views: int = 30,
    steady: bool = False,
    at_rest: bool = False,
) -> MovingScene:
    """Draw views and paths in the box [-1, 1]^d.

    Parameters
    ----------
    models
        The form of each path.
    steady
        Whether the views move on a straight line at constant speed, instead of standing anywhere.
    at_rest
        Whether all points really are at rest, whatever their form.
    """
    time_s = np.sort(rng.uniform(0.0, DURATION_S, n_views))
    centers = rng.uniform(-1.0, 1.0, (n_views, d))
    if steady:
        start, velocity = centers[:2]
        centers = start + (2.0 * time_s[:, None] / DURATION_S - 1.0) * velocity / np.linalg.norm(velocity)
    coefficients = []
    for model in models:
        rows = 0.5 * rng.normal(size=(model.n_functions, d)) / (1.0 + np.arange(model.n_functions)[:, None])
        rows[0] = rng.uniform(-1.0, 1.0, d)
        if at_rest:
            rows[1:] = 0.0
        coefficients.append(rows)
    return MovingScene.of(centers, time_s, models, coefficients)


def draw_hidden(rng: np.random.Generator, *, d: int, n_views: int = 30, n_static: int = 8) -> MovingScene:
    """Draw two steady bodies, the last two tracks, that are in one direction from every view; the views sway."""
    time_s = np.sort(rng.uniform(0.0, DURATION_S, n_views))
    models = [*([Static()] * n_static), *([FORMS["Taylor, k = 1"]] * 2)]
    points = [rng.uniform(-3.0, 3.0, (1, d)) for _ in range(n_static)]
    near = np.vstack((rng.uniform(-0.5, 0.5, d), 0.5 * rng.normal(size=d)))
    beyond = near + np.vstack((unit(rng.normal(size=(1, d))), 0.2 * rng.normal(size=(1, d))))
    functions = path_functions(models[-1], time_s)
    # the line through both bodies, at a distance that is no polynomial of time
    reach = 0.8 + 0.5 * np.sin(1.7 * time_s + rng.uniform(0.0, 2.0 * np.pi))
    centers = functions @ near - reach[:, None] * (functions @ (beyond - near))
    return MovingScene.of(centers, time_s, models, [*points, near, beyond])
