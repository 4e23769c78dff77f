"""How far a scene is from the truth, after the freedoms that nothing can determine are taken out.

A scene from bearings is known up to its gauge, and each part up to a gauge of its own, so each component is aligned by
itself: ``truth = scale * world_from_scene @ position + shift``, least squares over the cameras (over the points too,
where the cameras alone do not fix it).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.model import Bool, Float, Scene, read_only
from panopath.movers import resting, view_times
from panopath.paths import Paths

Alignment = Literal["similarity", "translation_scale", "paper"]

#: Times at which paths are compared, where those of the views are not known.
_PATH_TIMES = 16
#: Below this share of the largest spread, positions count as lying on a line (in a point).
_FLAT = 1e-9


@dataclass(frozen=True, eq=False)
class ComponentAlignment:
    """The fit of one component: ``truth = scale * world_from_scene @ position + shift``."""

    component: int
    scale: float
    #: (d, d).
    world_from_scene: Float
    #: (d,).
    shift: Float
    #: Number of camera positions compared.
    n_views: int
    #: Number of points compared.
    n_points: int
    #: Whether the positions fix the fit; where they lie on a line (in one point), some rotation (the scale) is free.
    is_unique: bool


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors in the units of the truth, after each component is aligned; NaN where there is nothing to compare."""

    #: Root mean square, median and largest error of the camera positions.
    camera_rms: float
    camera_median: float
    camera_max: float
    #: Root mean square and median error of the points. A few far points rule the first; the second says more. The error
    #: of a track that moves is the rms distance of its path from the true one, where both have paths.
    point_rms: float
    point_median: float
    #: Median over the points of error / distance to the nearest camera.
    point_relative_median: float
    #: Angle of the rotation found in the fit of the largest component, radians; 0 where none is fitted.
    rotation_rad: float
    #: Scale found in the fit of the largest component.
    scale: float
    #: Positions compared.
    n_views: int
    n_points: int
    alignments: tuple[ComponentAlignment, ...]
    #: (n_views,) error of each camera, NaN where not compared.
    camera_error: Float
    #: (n_tracks,) error of each point, NaN where not compared.
    point_error: Float
    #: (n_views, d) and (n_tracks, d): the scene in the world of the truth.
    aligned_centers: Float
    aligned_points: Float

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, for JSON; what is not finite becomes None."""
        names = (
            "camera_rms",
            "camera_median",
            "camera_max",
            "point_rms",
            "point_median",
            "point_relative_median",
            "rotation_rad",
            "scale",
            "n_views",
            "n_points",
        )
        plain = {name: getattr(self, name) for name in names}
        plain["n_components"] = len(self.alignments)
        return {name: value if np.isfinite(value) else None for name, value in plain.items()}


def evaluate(
    scene: Scene,
    truth: Any,
    alignment: Alignment = "similarity",
    trim: float | None = None,
) -> Evaluation:
    """Compare a scene with the truth.

    Parameters
    ----------
    scene
        What was found.
    truth
        Anything with ``centers`` and ``points``, maybe ``paths`` (a scene, a synthetic world, ``read_truth``), or
        ``(centers, points)``, or centers alone, in the order of the scene; NaN rows where not known.
    alignment
        ``similarity``: shift, rotation and scale (never a reflection). ``translation_scale``: shift and scale, for
        scenes whose orientation is given. ``paper``: the first point both know goes to the origin and the first other
        one to x = 1 (where their x differ), in both; errors are then in that unit.
    trim
        Largest share of each component's cameras (0 to below 1) that the fit may leave out, the worst ones, refitting
        until it settles; the errors still count all.

    Returns
    -------
    Evaluation

    Raises
    ------
    InputError
        Where shapes do not fit, an option is unknown, or there is nothing to compare.
    """
    if alignment not in get_args(Alignment):
        raise InputError(f"alignment is {alignment!r}, expected one of {', '.join(map(repr, get_args(Alignment)))}")
    if trim is not None and not 0.0 <= trim < 1.0:
        raise InputError(f"trim is {trim!r}, expected a share from 0 to below 1")
    centers, points = _truth(truth, scene)
    if alignment == "paper":
        points, centers = _paper_gauge(points, centers)
    true_paths = _true_paths(truth, scene, alignment)
    known = _Pairs.of(scene, centers, points, true_paths)
    fits, aligned_centers, aligned_points = [], np.full_like(centers, np.nan), np.full_like(points, np.nan)
    for component in range(scene.n_components):
        fit = _align_component(known, component, alignment, trim or 0.0)
        if fit is None:
            continue
        fits.append(fit)
        for source, owner, target in (
            (scene.centers, scene.view_component, aligned_centers),
            (scene.points, scene.track_component, aligned_points),
        ):
            rows = owner == component
            target[rows] = fit.scale * source[rows] @ fit.world_from_scene.T + fit.shift
    if not fits:
        raise InputError(
            "there is nothing to compare: the scene and the truth share no known camera and no known point"
        )
    along = None if true_paths is None else _path_errors(scene, true_paths, fits)
    return _evaluation(known, fits, (aligned_centers, aligned_points), along)


def _path_errors(scene: Scene, truth: Paths, fits: Sequence[ComponentAlignment]) -> Float:
    """Root mean square distances (n_tracks,) between paths, over the times of the views; NaN of what rests in both."""
    found, errors = scene.paths, np.full(len(scene.points), np.nan)
    if found is None:
        return errors
    fit_of = {fit.component: fit for fit in fits}
    times = view_times(scene)
    for track in np.flatnonzero(found.moving | truth.moving).tolist():
        fit = fit_of.get(int(scene.track_component[track]))
        first, last = found.seen_s[track]
        if fit is None or not np.isfinite(first + last):
            continue
        now = times[(times >= first) & (times <= last)] if len(times) else np.linspace(first, last, _PATH_TIMES)
        place = fit.scale * found.position(track, now) @ fit.world_from_scene.T + fit.shift
        square = ((place - truth.position(track, now, outside=True)) ** 2).sum(axis=1)
        errors[track] = np.sqrt(square.mean()) if len(square) else np.nan
    return errors


def _evaluation(
    known: _Pairs, fits: Sequence[ComponentAlignment], aligned: tuple[Float, Float], along: Float | None
) -> Evaluation:
    aligned_centers, aligned_points = aligned
    camera_error = np.linalg.norm(aligned_centers - known.true_centers, axis=1)
    point_error = np.linalg.norm(aligned_points - known.true_points, axis=1)
    if along is not None:
        point_error = np.where(known.moving, along, point_error)
    cameras, points = camera_error[np.isfinite(camera_error)], point_error[np.isfinite(point_error)]
    relative = point_error / _nearest_distance(known.true_points, known.true_centers)
    relative = relative[np.isfinite(relative)]
    main = max(fits, key=lambda fit: fit.n_views + fit.n_points)
    return Evaluation(
        camera_rms=_rms(cameras),
        camera_median=_median(cameras),
        camera_max=float(cameras.max()) if len(cameras) else float("nan"),
        point_rms=_rms(points),
        point_median=_median(points),
        point_relative_median=_median(relative),
        rotation_rad=_rotation_angle(main.world_from_scene),
        scale=main.scale,
        n_views=len(cameras),
        n_points=len(points),
        alignments=tuple(fits),
        camera_error=read_only(camera_error),
        point_error=read_only(point_error),
        aligned_centers=read_only(aligned_centers),
        aligned_points=read_only(aligned_points),
    )


@dataclass(frozen=True)
class _Pairs:
    """A scene and its truth, and what both know."""

    scene: Scene
    true_centers: Float
    true_points: Float
    views: Bool
    points: Bool
    #: Tracks that move, in one of both: they are compared along their paths, and fix no frame.
    moving: Bool

    @classmethod
    def of(cls, scene: Scene, centers: Float, points: Float, paths: Paths | None) -> _Pairs:
        views = np.isfinite(centers).all(axis=1) & np.isfinite(scene.centers).all(axis=1)
        both = np.isfinite(points).all(axis=1) & np.isfinite(scene.points).all(axis=1)
        moving = ~resting(scene) if paths is None else ~resting(scene) | paths.moving
        return cls(scene, centers, points, np.asarray(views), np.asarray(both & ~moving), np.asarray(moving))


def _true_paths(truth: Any, scene: Scene, alignment: str) -> Paths | None:
    """Give the true paths, where both have some; the paper's gauge knows points alone."""
    if scene.paths is None or alignment == "paper":
        return None
    paths = getattr(truth, "paths", None)
    if not isinstance(paths, Paths):
        return None
    if len(paths) != len(scene.paths) or paths.d != scene.d:
        raise InputError(f"the paths of truth are {paths!r}, but those of the scene {scene.paths!r}")
    return paths


def _truth(truth: Any, scene: Scene) -> tuple[Float, Float]:
    if hasattr(truth, "centers") and hasattr(truth, "points"):
        centers, points = truth.centers, truth.points
    elif isinstance(truth, tuple):
        if len(truth) != 2:
            raise InputError(f"truth is a tuple of {len(truth)}, expected (centers, points)")
        centers, points = truth
    else:
        centers, points = truth, None
    return _positions("centers", centers, scene.centers.shape), _positions("points", points, scene.points.shape)


def _positions(name: str, values: npt.ArrayLike | None, shape: tuple[int, ...]) -> Float:
    if values is None:
        return np.full(shape, np.nan)
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"the {name} of truth cannot be read as positions ({error})") from None
    if array.shape != shape:
        raise InputError(f"the {name} of truth have shape {array.shape}, but those of the scene {shape}")
    return array


def _paper_gauge(points: Float, centers: Float) -> tuple[Float, Float]:
    """Shift and scale the truth so that its first known point is the origin and another has x = 1."""
    known = np.flatnonzero(np.isfinite(points).all(axis=1))
    apart = known[np.abs(points[known, 0] - points[known[0], 0]) > 0.0] if len(known) else known
    if not len(apart):
        raise InputError("the paper's gauge needs two known points of the truth that differ in x")
    origin, unit = points[known[0]].copy(), points[apart[0], 0] - points[known[0], 0]
    return (points - origin) / unit, (centers - origin) / unit


def _align_component(known: _Pairs, component: int, alignment: str, trim: float) -> ComponentAlignment | None:
    scene = known.scene
    views = np.flatnonzero(known.views & (scene.view_component == component))
    points = np.flatnonzero(known.points & (scene.track_component == component))
    if alignment == "paper":
        return _paper_alignment(known, component, views, points)
    source, target = scene.centers[views], known.true_centers[views]
    if _rank(source, target) < min(_needed_rank(alignment, scene.d), max(1, len(views) + len(points) - 1)):
        # too few cameras, or all on a line: let the points help
        source = np.concatenate((source, scene.points[points]))
        target = np.concatenate((target, known.true_points[points]))
    if not len(source):
        return None
    fit = _fit(source, target, alignment)
    keep = np.ones(len(source), dtype=bool)
    n_keep = max(int(np.ceil((1.0 - trim) * len(source))), min(len(source), scene.d + 1))
    for _ in range(50 if n_keep < len(source) else 0):
        error = np.linalg.norm(fit[0] * source @ fit[1].T + fit[2] - target, axis=1)
        best = np.zeros(len(source), dtype=bool)
        best[np.argsort(error, kind="stable")[:n_keep]] = True
        if np.array_equal(best, keep):
            break
        keep = best
        fit = _fit(source[keep], target[keep], alignment)
    unique = _rank(source[keep], target[keep]) >= _needed_rank(alignment, scene.d)
    return ComponentAlignment(component, *fit, len(views), len(points), unique)


def _paper_alignment(
    known: _Pairs, component: int, views: npt.NDArray[np.intp], points: npt.NDArray[np.intp]
) -> ComponentAlignment | None:
    """Two points, no fit: their error is zero, and every other error is relative to them."""
    found, true = known.scene.points[points], known.true_points[points]
    if len(points) < 2:
        return None
    apart = np.flatnonzero((np.abs(found[:, 0] - found[0, 0]) > 0.0) & (np.abs(true[:, 0] - true[0, 0]) > 0.0))
    if not len(apart):
        return None
    second = apart[0]
    scale = float((true[second, 0] - true[0, 0]) / (found[second, 0] - found[0, 0]))
    shift = true[0] - scale * found[0]
    return ComponentAlignment(component, scale, np.eye(known.scene.d), shift, len(views), len(points), True)


def _needed_rank(alignment: str, d: int) -> int:
    """Dimensions that positions must span: two points fix a scale, a rotation in space needs a third off their line."""
    return d - 1 if alignment == "similarity" else 1


def _rank(source: Float, target: Float) -> int:
    """Dimensions that both spans have."""
    ranks = []
    for positions in (source, target):
        if len(positions) < 2:
            return 0
        spread = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
        ranks.append(int((spread > _FLAT * max(float(spread[0]), 1e-300)).sum()) if spread[0] > 0.0 else 0)
    return min(ranks)


def fit_similarity(source: Float, target: Float) -> tuple[float, Float, Float]:
    """Scale, rotation (d, d) and shift of the best ``target = scale * rotation @ source + shift``, never a reflection.

    Parameters
    ----------
    source, target
        (n, d) positions.
    """
    return _fit(source, target, "similarity")


def fit_shift_and_scale(source: Float, target: Float) -> tuple[float, Float]:
    """Scale and shift (d,) of the best ``target = scale * source + shift``, never a negative scale.

    Parameters
    ----------
    source, target
        (n, d) positions.
    """
    scale, _, shift = _fit(source, target, "translation_scale")
    return scale, shift


def _fit(source: Float, target: Float, alignment: str) -> tuple[float, Float, Float]:
    """Least squares scale, rotation and shift (Umeyama 1991); without rotation for ``translation_scale``."""
    d = source.shape[1]
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    # by the largest coordinate first, so that squares neither vanish nor overflow
    a_unit, b_unit = float(np.abs(a).max()), float(np.abs(b).max())
    if a_unit == 0.0 or b_unit == 0.0:
        return 1.0, np.eye(d), target_mean - source_mean
    a, b = a / a_unit, b / b_unit
    variance = float((a * a).sum())
    if alignment == "translation_scale":
        rotation, gain = np.eye(d), float((a * b).sum())
    else:
        left, singular, right = np.linalg.svd(b.T @ a)
        signs = np.ones(d)
        # the best rotation, never a reflection
        signs[-1] = 1.0 if np.linalg.det(left) * np.linalg.det(right) > 0.0 else -1.0
        rotation, gain = left @ np.diag(signs) @ right, float(singular @ signs)
    # a negative scale would turn the scene inside out; the best fit that does not is then a single point
    scale = max(gain, 0.0) / variance * b_unit / a_unit
    return scale, rotation, target_mean - scale * rotation @ source_mean


def _rotation_angle(rotation: Float) -> float:
    """Angle of a rotation, accurate from 0 to pi: its skew part holds the sine, its trace the cosine."""
    sine = float(np.linalg.norm(rotation - rotation.T)) / (2.0 * np.sqrt(2.0))
    cosine = 0.5 * (float(np.trace(rotation)) - (len(rotation) - 2))
    return float(np.arctan2(sine, cosine))


def _nearest_distance(points: Float, centers: Float) -> Float:
    """Distance from each point to the nearest known centre, a block at a time; NaN where there is none."""
    known = centers[np.isfinite(centers).all(axis=1)]
    nearest = np.full(len(points), np.nan)
    if not len(known):
        return nearest
    rows = np.flatnonzero(np.isfinite(points).all(axis=1))
    block = max(1, (1 << 21) // len(known))
    for begin in range(0, len(rows), block):
        some = rows[begin : begin + block]
        # a difference a coordinate, not |a|^2 + |b|^2 - 2 ab, which loses the digits of near pairs
        squared = np.zeros((len(some), len(known)))
        for c in range(points.shape[1]):
            squared += (points[some, c, None] - known[None, :, c]) ** 2
        nearest[some] = np.sqrt(squared.min(axis=1))
    nearest[nearest == 0.0] = np.nan
    return nearest


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _median(values: Float) -> float:
    return float(np.median(values)) if len(values) else float("nan")
