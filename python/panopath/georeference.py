"""A scene on the earth: its path fitted to satellite positions, some of which are far off.

    enu_i = scale * R @ center_i + shift        for the views i whose position is right

``R`` turns about the vertical alone where the scene is upright already (the default: receivers err more in height than
a path is tilted), or any way. The search starts from samples of two or three views (least median of squared distances,
Rousseeuw 1984), its noise is the median absolute distance of the best one, and the fit is refined by re-weighting with
Cauchy's function until what counts as an outlier (beyond ``_OUTLIER`` of that noise) settles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.formats.geo import LocalFrame
from panopath.model import Bool, Float, Scene, read_only
from panopath.moves import moved_scene

Vertical = Literal["keep", "fit"]

#: Samples tried; where there are fewer pairs than that, all of them.
_SAMPLES = 600
#: Distance at which a position counts as wrong, in standard deviations of a coordinate.
_OUTLIER = 4.0
#: A receiver is never taken to be better than this: metres.
_LEAST_SIGMA_M = 0.02
#: Share of the positions that must agree.
_LEAST_SHARE = 0.5
_STEPS = 40


class GeoStatus(StrEnum):
    """How the fit of a component ended."""

    FITTED = "fitted"
    #: Fewer than two (three where the vertical is fitted) views with a position.
    TOO_FEW = "too_few"
    #: The positions, or the path, do not spread by more than the noise: no scale and no heading.
    NO_SPREAD = "no_spread"
    #: No half of the positions agrees with the path.
    CONTRADICTION = "contradiction"

    @property
    def is_fitted(self) -> bool:
        """Whether the component stands on the earth now."""
        return self is GeoStatus.FITTED


@dataclass(frozen=True, eq=False)
class GeoFit:
    """Where one component stands: ``enu = scale * enu_from_world @ position + shift``."""

    component: int
    status: GeoStatus
    scale: float
    #: (3, 3).
    enu_from_world: Float
    #: (3,) metres.
    shift: Float
    #: Standard deviation of a horizontal coordinate of the positions that agree, metres; NaN where not fitted.
    sigma_m: float
    #: (n_views,) horizontal distance of each position from the fitted path, metres; NaN where there is none.
    distance_m: Float
    #: (n_views,) positions that were used to the end.
    inlier: Bool
    #: Views of this component that have a position.
    n_views: int

    def sentence(self) -> str:
        """Say in plain words how it went."""
        used = int(self.inlier.sum())
        return {
            GeoStatus.FITTED: f"scale and heading are from GPS: {used} of {self.n_views} positions agree, each to "
            f"{self.sigma_m:.2g} m",
            GeoStatus.TOO_FEW: f"GPS was not used: {self.n_views} positions are too few",
            GeoStatus.NO_SPREAD: "GPS was not used: its positions do not spread by more than their noise",
            GeoStatus.CONTRADICTION: f"GPS was not used: the {self.n_views} positions do not agree with the path",
        }[self.status]


@dataclass(frozen=True, eq=False)
class Georeference:
    """A scene in local axes of the earth: x east, y north, z up, metres."""

    scene: Scene
    frame: LocalFrame
    #: One a component, in their order.
    fits: tuple[GeoFit, ...]

    @property
    def is_fitted(self) -> bool:
        """Whether the largest component stands on the earth."""
        sizes = [int((self.scene.view_component == fit.component).sum()) for fit in self.fits]
        return bool(sizes) and self.fits[int(np.argmax(sizes))].status.is_fitted


def georeference(
    scene: Scene,
    position: npt.ArrayLike,
    sigma_m: npt.ArrayLike | None = None,
    vertical: Vertical = "keep",
    origin: LocalFrame | None = None,
) -> Georeference:
    """Fit each component of a scene to positions on the earth, outliers set aside.

    Parameters
    ----------
    scene
        In space; z up where ``vertical`` is ``keep``.
    position
        (n_views, 3) latitude and longitude in degrees and height in metres, NaN rows where there is none; a height may
        be NaN alone and then takes no part.
    sigma_m
        Horizontal standard deviation of the positions in metres, one or (n_views,): weights. Default: all alike.
    vertical
        ``keep``: turn about z only. ``fit``: turn any way, which needs a path that is not straight.
    origin
        Where the local axes stand; default: the median of the positions (height 0 where there are none).

    Returns
    -------
    Georeference
        Components that could not be fitted stay as they were and say why.

    Raises
    ------
    InputError
        Where shapes do not fit, or there is no position at all.
    """
    if scene.d != 3:
        raise InputError("the scene is planar, expected one in space")
    if vertical not in ("keep", "fit"):
        raise InputError(f"vertical is {vertical!r}, expected 'keep' or 'fit'")
    rows = _positions(position, len(scene.centers))
    sigma = _sigmas(sigma_m, len(rows))
    given = np.isfinite(rows[:, :2]).all(axis=1)
    if not given.any():
        raise InputError("position has no row with latitude and longitude")
    frame = _frame_of(rows[given]) if origin is None else origin
    has_height = given & np.isfinite(rows[:, 2])
    # east and north of a place without height are taken at that of the frame
    height = np.where(has_height, rows[:, 2], frame.height_m)
    enu = frame.enu_from_wgs84(np.column_stack((rows[:, :2], height)))
    enu[~has_height, 2] = np.nan
    fits = []
    for part in range(scene.n_components):
        views = np.flatnonzero((scene.view_component == part) & np.isfinite(scene.centers).all(axis=1) & given)
        fit = _fit_part(scene, part, views, enu, sigma, vertical=vertical)
        fits.append(fit)
        if fit.status.is_fitted:
            scene = moved_scene(scene, fit.enu_from_world, fit.scale, fit.shift, part)
    return Georeference(scene, frame, tuple(fits))


def scale_from_baseline(scene: Scene, first: int, second: int, metres: float) -> float:
    """Factor that makes the distance of two views that of the world.

    Raises
    ------
    InputError
        Where a view is not solved, the two share no component or one place, or ``metres`` is not positive.
    """
    if not (np.isfinite(metres) and metres > 0.0):
        raise InputError(f"metres is {metres!r}, expected a positive number")
    for name, view in (("first", first), ("second", second)):
        if not 0 <= view < len(scene.centers):
            raise InputError(f"{name} is {view}, expected a view from 0 to {len(scene.centers) - 1}")
        if scene.view_component[view] < 0:
            raise InputError(f"{name}: view {scene.view_labels()[view]} is not in the scene")
    if scene.view_component[first] != scene.view_component[second]:
        raise InputError("first and second are in different components, which share no scale")
    distance = float(np.linalg.norm(scene.centers[first] - scene.centers[second]))
    if distance == 0.0:
        raise InputError("first and second stand at the same place")
    return metres / distance


def _fit_part(
    scene: Scene, part: int, views: npt.NDArray[np.intp], enu: Float, sigma: Float, *, vertical: Vertical
) -> GeoFit:
    source, target = scene.centers[views], enu[views]
    if vertical == "fit":
        whole = np.isfinite(target).all(axis=1)
        views, source, target = views[whole], source[whole], target[whole]
    least = 2 if vertical == "keep" else 3
    if len(views) < least:
        return _not_fitted(part, GeoStatus.TOO_FEW, len(enu), len(views))
    weight = 1.0 / sigma[views] ** 2
    fit_once = _fit_level if vertical == "keep" else _fit_free
    start = _best_sample(source, target, sigma[views], least, fit_once)
    if start is None:
        return _not_fitted(part, GeoStatus.NO_SPREAD, len(enu), len(views))
    fit, used, noise = start, np.ones(len(views), dtype=np.bool_), np.nan
    for _ in range(_STEPS):
        off = _distance(fit, source, target, vertical) / sigma[views]
        noise = max(_noise(off, least), _LEAST_SIGMA_M / float(np.median(sigma[views])))
        # Cauchy's weight bends to nothing where a position is wrong, so none is trusted by half
        counted = np.where(off < _OUTLIER * noise, weight / (1.0 + (off / (2.0 * noise)) ** 2), 0.0)
        again = fit_once(source, target, counted)
        if again is None:
            break
        before, fit = fit, again
        settled, used = np.array_equal(used, counted > 0.0), np.asarray(counted > 0.0)
        if settled and np.allclose(before[2], fit[2], rtol=0.0, atol=1e-6) and abs(before[0] - fit[0]) < 1e-9 * fit[0]:
            break
    flat = _distance(fit, source, target, "keep")
    # two coordinates each; the fit has taken four freedoms
    sigma_m = max(float(np.sqrt((flat[used] ** 2).sum() / max(1, 2 * used.sum() - 4))), _LEAST_SIGMA_M)
    spread = fit[0] * float(np.linalg.norm((source - source.mean(axis=0))[:, :2], axis=1).max())
    if used.sum() < max(least, _LEAST_SHARE * len(views)):
        return _not_fitted(part, GeoStatus.CONTRADICTION, len(enu), len(views))
    # scale and heading are known to about noise / (spread * sqrt(n)); at a third they are a guess
    if not spread * np.sqrt(used.sum()) > 3.0 * sigma_m:
        return _not_fitted(part, GeoStatus.NO_SPREAD, len(enu), len(views))
    distance, inlier = np.full(len(enu), np.nan), np.zeros(len(enu), dtype=np.bool_)
    distance[views], inlier[views] = flat, used
    return GeoFit(part, GeoStatus.FITTED, *fit, sigma_m, read_only(distance), read_only(inlier), len(views))


_Fit = tuple[float, Float, Float]
_FitOnce = Callable[[Float, Float, Float], _Fit | None]


def _best_sample(source: Float, target: Float, sigma: Float, size: int, fit_once: _FitOnce) -> _Fit | None:
    """Fit of the sample whose median distance to all positions is least."""
    rng = np.random.default_rng(0)
    n = len(source)
    vertical: Vertical = "keep" if size == 2 else "fit"
    if size == 2 and n * (n - 1) // 2 <= _SAMPLES:
        samples: Sequence[npt.NDArray[np.intp]] = list(np.stack(np.triu_indices(n, 1), axis=1))
    else:
        samples = [rng.choice(n, size, replace=False) for _ in range(_SAMPLES)]
    best, least = None, np.inf
    # the least-squares fit of all competes too: it is the best there is where nothing is wrong
    for rows in [np.arange(n), *samples]:
        fit = fit_once(source[rows], target[rows], 1.0 / sigma[rows] ** 2)
        if fit is None:
            continue
        value = float(np.median(_distance(fit, source, target, vertical) / sigma))
        if value < least:
            best, least = fit, value
    return best


def _fit_level(source: Float, target: Float, weight: Float) -> _Fit | None:
    """Scale, turn about z and shift; the plane as complex numbers: ``target = factor * source + shift``."""
    total = weight.sum()
    if not total > 0.0:
        return None
    a = source[:, 0] + 1j * source[:, 1]
    b = target[:, 0] + 1j * target[:, 1]
    a_mean, b_mean = (weight @ a) / total, (weight @ b) / total
    spread = float(weight @ np.abs(a - a_mean) ** 2)
    if not spread > 1e-18 * total * max(1e-12, float(np.abs(a).max()) ** 2):
        return None
    factor = (weight @ (np.conj(a - a_mean) * (b - b_mean))) / spread
    scale = abs(factor)
    if not scale > 0.0:
        return None
    cos, sin = factor.real / scale, factor.imag / scale
    flat = b_mean - factor * a_mean
    # heights alone fix the height: the median bears with those that are wrong
    above = target[:, 2] - scale * source[:, 2]
    known = np.isfinite(above) & (weight > 0.0)
    up = float(np.median(above[known])) if known.any() else -scale * float(np.median(source[:, 2]))
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return scale, turn, np.array([flat.real, flat.imag, up])


def _fit_free(source: Float, target: Float, weight: Float) -> _Fit | None:
    """Weighted least squares over all similarities (Umeyama 1991)."""
    total = weight.sum()
    if not total > 0.0:
        return None
    a_mean, b_mean = weight @ source / total, weight @ target / total
    a, b = source - a_mean, target - b_mean
    left, singular, right = np.linalg.svd((weight[:, None] * b).T @ a)
    if not singular[1] > 1e-6 * singular[0]:
        return None  # on a line: the turn about it is free
    signs = np.array([1.0, 1.0, 1.0 if np.linalg.det(left) * np.linalg.det(right) > 0.0 else -1.0])
    turn = left @ np.diag(signs) @ right
    scale = float(singular @ signs) / float(weight @ (a**2).sum(axis=1))
    return (scale, turn, b_mean - scale * turn @ a_mean) if scale > 0.0 else None


def _distance(fit: _Fit, source: Float, target: Float, vertical: Vertical) -> Float:
    scale, turn, shift = fit
    off = scale * source @ turn.T + shift - target
    return np.asarray(np.linalg.norm(off[:, :2] if vertical == "keep" else off, axis=1))


def _noise(off: Float, size: int) -> float:
    """Find the standard deviation of a coordinate from the median distance, as if in the plane (median 1.177 sigma).

    Few positions fit too well, since the fit has taken from each; Rousseeuw's factor makes up for that.
    """
    n = len(off)
    return float(np.median(off)) / 1.1774 * (1.0 + 5.0 / max(1, n - size))


def _not_fitted(part: int, status: GeoStatus, n_all: int, n_views: int) -> GeoFit:
    distance, inlier = np.full(n_all, np.nan), np.zeros(n_all, dtype=np.bool_)
    return GeoFit(
        part, status, 1.0, np.eye(3), np.zeros(3), float("nan"), read_only(distance), read_only(inlier), n_views
    )


def _positions(position: npt.ArrayLike, n_views: int) -> Float:
    try:
        rows = np.array(position, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("position does not hold numbers") from None
    if rows.shape != (n_views, 3):
        raise InputError(f"position has shape {rows.shape}, expected ({n_views}, 3)")
    rows[~np.isfinite(rows[:, :2]).all(axis=1)] = np.nan
    return rows


def _sigmas(sigma_m: npt.ArrayLike | None, n_views: int) -> Float:
    sigma = np.ones(n_views) if sigma_m is None else np.broadcast_to(np.array(sigma_m, dtype=np.float64), (n_views,))
    wrong = ~(np.isfinite(sigma) & (sigma > 0.0))
    if wrong.any():
        first = int(np.argmax(wrong))
        raise InputError(f"sigma_m[{first}] is {sigma[first]}, expected a positive number")
    return sigma


def _frame_of(rows: Float) -> LocalFrame:
    """Local axes at the middle; longitudes by their angles, so that the date line does no harm."""
    turn = np.angle(np.exp(1j * np.radians(rows[:, 1])).sum(), deg=True)
    longitude = turn + float(np.median((rows[:, 1] - turn + 180.0) % 360.0 - 180.0))
    heights = rows[np.isfinite(rows[:, 2]), 2]
    return LocalFrame(
        float(np.median(rows[:, 0])),
        float((longitude + 180.0) % 360.0 - 180.0),
        float(np.median(heights)) if len(heights) else 0.0,
    )
