"""The whole story on one screen: tracks without orientations in, a refined scene out.

    tracks -> view graph -> relative rotations -> orientations -> positions -> refinement -> second pass -> scene

In the plane, where two views tell nothing of each other, headings are found from triplets of views instead.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.model import (
    Bool,
    Control,
    Float,
    Int,
    PositionOptions,
    Scene,
    Status,
    Summary,
    Tracks,
    check_orientations,
)
from panopath.planar import complete_planar
from panopath.priors import DirectionPriors, Priors, Rig
from panopath.steps import (
    HeadingOptions,
    OrientationOptions,
    RefineOptions,
    TwoViewOptions,
    TwoViews,
    TwoViewStatus,
    ViewGraphOptions,
    average_rotations,
    find_headings,
    refine,
    relative_poses,
    solve_positions,
    view_pairs,
)
from panopath.steps.positions import control_rows
from panopath.steps.refinement import prior_columns, rig_columns

#: Least standard deviation of a relative rotation, radians: what the model of two views leaves out.
_LEAST_EDGE_SIGMA_RAD = 1e-4


@dataclass(frozen=True)
class ReconstructOptions:
    """Choices of :func:`reconstruct_tracks`: those of its steps."""

    view_graph: ViewGraphOptions = field(default_factory=ViewGraphOptions)
    two_view: TwoViewOptions = field(default_factory=TwoViewOptions)
    orientation: OrientationOptions = field(default_factory=OrientationOptions)
    #: In the plane, in the place of the three above.
    headings: HeadingOptions = field(default_factory=HeadingOptions)
    positions: PositionOptions = field(default_factory=PositionOptions)
    refine: RefineOptions = field(default_factory=RefineOptions)


@dataclass(frozen=True, eq=False)
class ViewOrientations:
    """Orientations of views that were found from their bearings."""

    #: (n_views, 3, 3), or (n_views,) headings in radians; NaN where not found.
    cam_from_world: Float
    #: (n_views,) part of each view: orientations of different parts cannot be compared. -1 = none.
    view_component: npt.NDArray[np.int32]


def reconstruct_tracks(  # noqa: PLR0917 (the public names and their order are fixed)
    tracks: Tracks,
    orientations: npt.ArrayLike | None = None,
    priors: Priors | None = None,
    gravity: npt.ArrayLike | None = None,
    options: ReconstructOptions | None = None,
    rig: Rig | None = None,
) -> Scene:
    """Camera path, orientations and points from bearings in the cameras, d = 2 or 3.

    Parameters
    ----------
    tracks
        The observations, bearings in the cameras (with a rig: in the frames of the views, see ``Rig.to_view``).
    orientations
        (n_views, 3, 3) ``cam_from_world``, or (n_views,) headings in radians, that are about right (to some
        degrees); None: unknown.
    priors
        What is known beforehand with its accuracy: some orientations, directions, positions.
    gravity
        (n_views, 3) the upward vertical in each camera, NaN where unknown; taken to be right to half a degree. Give
        ``priors`` with ``DirectionPriors.gravity`` where it is better or worse. The world then has z up.
    options
        Choices of the steps.
    rig
        Where bearings start from, for views with several sensors.

    Returns
    -------
    Scene
        Up to a similarity, or in the frame of the priors. A component is a part of the views that could be oriented
        and placed together.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    chosen = ReconstructOptions() if options is None else options
    _check_given(tracks, priors, chosen, rig)
    known = _with_gravity(Priors() if priors is None else priors, gravity, tracks)
    if orientations is None:
        oriented = orient_views(tracks, known, chosen)
    else:
        rotations = check_orientations(orientations, tracks.n_views, tracks.d)
        oriented = ViewOrientations(rotations, np.zeros(tracks.n_views, dtype=np.int32))
    start = place_views(tracks, oriented, chosen.positions)
    if rig is not None and known.positions is None:
        start = metric_scale(tracks, start, rig)
    scene = refine(tracks, start, replace(chosen.refine, priors=known), rig)
    if tracks.d == 2 and orientations is None and rig is None and known.is_empty:
        scene = complete_planar(tracks, scene, chosen.refine)
    return _forgotten(scene, oriented)


def _check_given(tracks: Tracks, priors: Priors | None, options: ReconstructOptions, rig: Rig | None) -> None:
    """Complain before the long work, not after it."""
    wanted: tuple[tuple[str, object, type], ...] = (
        ("tracks", tracks, Tracks),
        ("priors", Priors() if priors is None else priors, Priors),
        ("options", options, ReconstructOptions),
    )
    for name, value, kind in wanted:
        if not isinstance(value, kind):
            raise InputError(f"{name} is a {type(value).__name__}, expected {kind.__name__}")
    if options.positions.gauge != "normalized":
        raise InputError(
            f"options.positions.gauge is {options.positions.gauge!r}, expected 'normalized': a refinement follows, "
            "which keeps no other (see fit_to_control for known positions)"
        )
    if rig is not None:
        if not isinstance(rig, Rig):
            raise InputError(f"rig is a {type(rig).__name__}, expected Rig")
        rig_columns(rig, tracks)
    for name, columns in prior_columns(Priors() if priors is None else priors, tracks.d).items():
        ids, values = columns[0], columns[1]
        if name == "rotation_priors" and (values.ndim == 1) != (tracks.d == 2):
            raise InputError(f"{name} have shape {values.shape}, but the bearings have {tracks.d} coordinates")
        if len(ids) and ids.max() >= tracks.n_views:
            raise InputError(f"{name}: entry {int(ids.argmax())} names view {ids.max()} of {tracks.n_views}")


def orient_views(
    tracks: Tracks, priors: Priors | None = None, options: ReconstructOptions | None = None
) -> ViewOrientations:
    """Orientations of all views from their bearings alone, up to a common turn where no prior fixes it.

    Parameters
    ----------
    tracks
        The observations, bearings in the cameras.
    priors
        Orientations and directions that are known of some views.
    options
        Choices of the steps that take part.
    """
    chosen = ReconstructOptions() if options is None else options
    if tracks.d == 2:
        headings = find_headings(tracks, chosen.headings)
        return ViewOrientations(headings.heading_rad, headings.view_component)
    pairs = view_pairs(tracks, chosen.view_graph)
    matches = pairs.observation
    found = relative_poses(pairs.start, tracks.bearing[matches[:, 0]], tracks.bearing[matches[:, 1]], chosen.two_view)
    return averaged(pairs.pair, found, tracks.n_views, priors, chosen.orientation)


def averaged(
    pair: Int, found: TwoViews, n_views: int, priors: Priors | None, options: OrientationOptions
) -> ViewOrientations:
    """Average the relative rotations of pairs of views, each weighed by its own covariance.

    Parameters
    ----------
    pair
        (n_pairs, 2) views.
    found
        Relative pose of each pair; pairs without an answer take no part.
    n_views
        Number of views.
    priors
        Orientations, directions and headings that are known of some views.
    options
        Choices of :func:`panopath.average_rotations`.
    """
    good = np.array([status is not TwoViewStatus.UNDETERMINED for status in found.status], dtype=np.bool_)
    variance = np.trace(found.rotation_covariance[good], axis1=1, axis2=2) / 3.0
    mean = average_rotations(
        pair[good, 0],
        pair[good, 1],
        found.second_from_first[good],
        n_views=n_views,
        sigma_rad=np.maximum(np.sqrt(variance), _LEAST_EDGE_SIGMA_RAD) if good.any() else None,
        priors=priors,
        options=options,
    )
    return ViewOrientations(mean.cam_from_world, mean.view_component)


def place_views(tracks: Tracks, oriented: ViewOrientations, options: PositionOptions | None = None) -> Scene:
    """Positions and points, each part of the oriented views by itself.

    Parameters
    ----------
    tracks
        The observations, bearings in the cameras.
    oriented
        Orientations, with the part that each view belongs to.
    options
        Choices of :func:`panopath.solve_positions`.
    """
    n_parts = int(oriented.view_component.max(initial=-1)) + 1
    identity = np.zeros(tracks.n_views) if tracks.d == 2 else np.tile(np.eye(3), (tracks.n_views, 1, 1))
    placed: Scene | None = None
    for part in range(n_parts):
        members = oriented.view_component == part
        seen = members[tracks.view]
        if members.sum() < 2 or not seen.any():
            continue
        rotations = np.where(members.reshape(-1, *[1] * (identity.ndim - 1)), oriented.cam_from_world, identity)
        seen &= _with_parallax(tracks, rotations, seen)
        scene = solve_positions(tracks.select(seen), rotations, options)
        placed = _joined(placed, scene, tracks, seen)
    return _nothing(tracks, identity) if placed is None else placed


#: A track tells of positions where its directions spread by more than so many standard deviations.
_PARALLAX_SIGMAS = 8.0
#: Where a view would keep fewer observations than this, it keeps all.
_ENOUGH_IN_VIEW = 30


def _with_parallax(tracks: Tracks, cam_from_world: Float, seen: Bool) -> Bool:
    """Find the observations of tracks whose directions spread by more than noise.

    Points without parallax fit wherever the cameras are. With wrong matches among them they pull views together or let
    them run away, so a start is sought without them; the refinement that follows has them all.
    """
    if tracks.sigma_rad is None or tracks.d == 2:
        return np.ones(len(tracks), dtype=np.bool_)
    direction = tracks.to_world(cam_from_world).bearing
    counted = np.where(seen[:, None], direction, 0.0)
    sums = [np.bincount(tracks.track, weights=counted[:, c], minlength=tracks.n_tracks) for c in range(tracks.d)]
    mean: Float = np.stack(sums, axis=1)
    mean = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    off = np.linalg.norm(direction - mean[tracks.track], axis=1) / tracks.sigma_rad
    spread = np.zeros(tracks.n_tracks)
    np.maximum.at(spread, tracks.track[seen], off[seen])
    turned = spread[tracks.track] > _PARALLAX_SIGMAS
    left = np.bincount(tracks.view[turned & seen], minlength=tracks.n_views)
    return np.asarray(turned | (left[tracks.view] < _ENOUGH_IN_VIEW))


def _joined(first: Scene | None, second: Scene, tracks: Tracks, seen: Bool) -> Scene:
    """Put the scene of a further part, made from the observations ``seen``, beside those of the parts before it."""
    base = _nothing(tracks, second.cam_from_world) if first is None else first
    n_before = base.n_components
    views = (second.view_component >= 0) & (base.view_component < 0)
    points = (second.track_component >= 0) & (base.track_component < 0)
    inlier, residual = base.inlier.copy(), base.residual_rad.copy()
    taken = points[tracks.track[seen]]
    rows = np.flatnonzero(seen)[taken]
    inlier[rows], residual[rows] = second.inlier[taken], second.residual_rad[taken]
    turned = views.reshape(-1, *[1] * (second.cam_from_world.ndim - 1))
    return replace(
        base,
        centers=np.where(views[:, None], second.centers, base.centers),
        points=np.where(points[:, None], second.points, base.points),
        view_component=np.where(views, second.view_component + n_before, base.view_component),
        track_component=np.where(points, second.track_component + n_before, base.track_component),
        inlier=inlier,
        residual_rad=residual,
        cam_from_world=np.where(turned, second.cam_from_world, base.cam_from_world),
        summary=second.summary if first is None else _summary_of_both(base.summary, second.summary),
    )


def _summary_of_both(first: Summary, second: Summary) -> Summary:
    """Summary of two parts that share no observation; the noise is that of the part that used more of them."""
    counted = {
        name: getattr(first, name) + getattr(second, name)
        for name in ("n_inliers", "n_solved_views", "n_solved_points", "n_components", "iterations")
    }
    solved = [s for s in (first, second) if s.n_components]
    if any(s.status is Status.AMBIGUOUS for s in solved):
        status = Status.AMBIGUOUS
    elif len(solved) == 2:
        status = Status.DISCONNECTED
    else:
        status = (solved or [first])[0].status
    main = max(first, second, key=lambda s: s.n_inliers)
    return replace(first, status=status, sigma_rad=main.sigma_rad, **counted)


def _forgotten(scene: Scene, oriented: ViewOrientations) -> Scene:
    """Say nothing of how views are turned that could not be oriented: steps had a stand-in for them."""
    unknown = (oriented.view_component < 0) & (scene.view_component < 0)
    rotation = np.array(scene.cam_from_world)
    rotation[unknown] = np.nan
    return replace(scene, cam_from_world=rotation)


def _nothing(tracks: Tracks, cam_from_world: Float) -> Scene:
    """Make a scene in which nothing is determined."""
    return Scene(
        centers=np.full((tracks.n_views, tracks.d), np.nan),
        points=np.full((tracks.n_tracks, tracks.d), np.nan),
        view_component=np.full(tracks.n_views, -1),
        track_component=np.full(tracks.n_tracks, -1),
        inlier=np.zeros(len(tracks), dtype=np.bool_),
        residual_rad=np.full(len(tracks), np.nan),
        cam_from_world=cam_from_world,
        summary=Summary(Status.UNDETERMINED, 0, np.nan),
        tracks=tracks,
        view_names=tracks.view_names,
        track_names=tracks.track_names,
    )


#: How well the upward vertical is taken to be known where nothing is said of it.
_GRAVITY_SIGMA_RAD = float(np.radians(0.5))


def _with_gravity(priors: Priors, gravity: npt.ArrayLike | None, tracks: Tracks) -> Priors:
    if gravity is None:
        return priors
    try:
        up = np.asarray(gravity, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("gravity does not hold numbers") from None
    if tracks.d != 3 or up.shape != (tracks.n_views, 3):
        raise InputError(f"gravity has shape {up.shape}, expected ({tracks.n_views}, 3) for views in space")
    if priors.directions is not None:
        raise InputError("gravity and priors.directions are both given, expected one of them")
    known = np.flatnonzero(np.isfinite(up).all(axis=1))
    length = np.linalg.norm(up[known], axis=1, keepdims=True)
    if not length.all():
        raise InputError(f"gravity[{known[int(np.argmin(length))]}] has length 0, expected a direction")
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    return replace(priors, directions=DirectionPriors.gravity(known, up[known], _GRAVITY_SIGMA_RAD))


#: What the present turn of a scene weighs against one kind of prior: it decides where they leave a turn free.
_PRESENT_TURN = 1e-6


def _turn_by(evidence: Float) -> Float:
    """Rotation that maximises ``trace(R^T evidence)``; what that leaves free stays as it is."""
    left, _, right = np.linalg.svd(evidence + _PRESENT_TURN * np.eye(len(evidence)))
    left[:, -1] *= np.sign(np.linalg.det(left @ right))
    return np.asarray(left @ right)


def _correlation(source: Float, target: Float) -> Float:
    """Sum of ``(target - mean) (source - mean)^T``, both brought to length one; zero where one is a single place."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return np.asarray(b.T @ a / length) if length > 0.0 else np.zeros((source.shape[1], source.shape[1]))


#: Sizes of the scene that are tried, against that of the rig: factors of two.
_SIZES = 2.0 ** np.arange(-4, 14)
#: Observations that the trial looks at, about.
_ENOUGH_OBSERVATIONS = 6_000


def metric_scale(tracks: Tracks, scene: Scene, rig: Rig) -> Scene:
    """Bring each component of unknown size near the size at which the rig's own baselines fit best.

    Cameras are held and points intersected anew at the present size and at sizes a factor of two apart; a refinement
    finds the rest.

    Parameters
    ----------
    tracks, rig
        As for :func:`panopath.refine`.
    scene
        Right but for its size.
    """
    arm = np.linalg.norm(rig.center - rig.center.mean(axis=0), axis=1).max()
    extent = np.array([_extent(scene.centers[scene.view_component == part]) for part in range(scene.n_components)])
    if not (arm > 0.0 and extent.any()):
        return scene
    options = RefineOptions(hold_rotations=True, hold_centers=True, reject_outliers=False, max_iterations=8)
    some = tracks.track % (1 + len(tracks) // _ENOUGH_OBSERVATIONS) == 0
    sample = tracks.select(some)
    sensors = replace(rig, sensor=rig.sensor[some])
    trial = replace(scene, tracks=None, inlier=scene.inlier[some], residual_rad=scene.residual_rad[some])
    unit = np.where(extent > 0.0, arm / np.maximum(extent, np.finfo(float).tiny), 1.0)
    owner = scene.view_component[sample.view]
    # the present size is tried too: a scene that has its size keeps it
    factors = np.concatenate((_SIZES[:, None] * unit, np.ones((1, len(unit)))))
    misfit = np.full(factors.shape, np.inf)
    for factor, row in zip(factors, misfit, strict=True):
        residual = refine(sample, _sized(trial, factor), options, sensors).residual_rad
        squared = np.minimum(residual, 5.0 * scene.summary.sigma_rad) ** 2
        for part in range(len(unit)):
            counted = (owner == part) & np.isfinite(squared)
            row[part] = squared[counted].mean() if counted.any() else np.inf
    best = np.take_along_axis(factors, misfit.argmin(axis=0)[None], axis=0)[0]
    return _sized(scene, np.where(extent > 0.0, best, 1.0))


def _extent(centers: Float) -> float:
    """Largest distance from the mean."""
    return float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max()) if len(centers) else 0.0


def _sized(scene: Scene, factor: Float) -> Scene:
    """Scale each component by its own factor."""
    of_view = np.append(factor, 1.0)[scene.view_component]
    of_track = np.append(factor, 1.0)[scene.track_component]
    paths = scene.paths
    for part, scale in enumerate(factor.tolist()) if paths is not None else ():
        paths = paths and paths.transformed(scale, np.eye(scene.d), np.zeros(scene.d), scene.track_component == part)
    centers, points = of_view[:, None] * scene.centers, of_track[:, None] * scene.points
    return replace(scene, centers=centers, points=points, paths=paths)


def fit_to_control(scene: Scene, control: Control) -> Scene:
    """Shift, scale and (where ``control.rotation``) turn each component to known positions, by least squares.

    Positions on a line leave a turn about it free, which then stays as it was. Components with fewer than two known
    positions stay where they are.

    Raises
    ------
    InputError
        Where fewer than two known positions belong to one component.
    """
    if scene.tracks is None:
        raise InputError("the scene does not know its tracks, so control cannot be looked up")
    views, view_positions, points, point_positions = control_rows(control, scene.tracks)
    centers, places = np.full_like(scene.centers, np.nan), np.full_like(scene.points, np.nan)
    centers[views], places[points] = view_positions, point_positions
    rotation, known = np.array(scene.cam_from_world), False
    center, point, paths = np.array(scene.centers), np.array(scene.points), scene.paths
    for part in range(scene.n_components):
        in_views, in_points = scene.view_component == part, scene.track_component == part
        found = np.concatenate((scene.centers[in_views], scene.points[in_points]))
        truth = np.concatenate((centers[in_views], places[in_points]))
        given = np.isfinite(truth).all(axis=1)
        if given.sum() < 2:
            continue
        known = True
        scale, turn, shift = _similarity(found[given], truth[given], turns=control.rotation)
        center[in_views] = scale * scene.centers[in_views] @ turn.T + shift
        point[in_points] = scale * scene.points[in_points] @ turn.T + shift
        paths = None if paths is None else paths.transformed(scale, turn, shift, in_points)
        if scene.d == 2:
            rotation[in_views] += np.arctan2(turn[1, 0], turn[0, 0])
        else:
            rotation[in_views] = scene.cam_from_world[in_views] @ turn.T
    if not known:
        raise InputError(
            "control: fewer than two of the known positions belong to one solved part, expected at least two"
        )
    return replace(scene, centers=center, points=point, cam_from_world=rotation, paths=paths)


def _similarity(source: Float, target: Float, *, turns: bool) -> tuple[float, Float, Float]:
    """Scale, rotation and shift of the best ``target = scale * rotation @ source + shift`` (Umeyama 1991)."""
    correlation = _correlation(source, target)
    turn = _turn_by(correlation) if turns and correlation.any() else np.eye(source.shape[1])
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    scale = 1.0
    if correlation.any():
        # a negative scale would turn the scene inside out
        gain = max(float(np.sum(turn * correlation)), 0.0)
        scale = gain * float(np.linalg.norm(b) / np.linalg.norm(a))
    return scale, turn, target.mean(axis=0) - scale * turn @ source.mean(axis=0)
