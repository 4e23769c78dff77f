"""From a COLMAP database to a scene of its images: the global mapper.

    matches of frames -> relative rotations -> orientations -> matches that agree -> tracks -> positions -> refinement
                      -> matches that agree with the refined poses -> tracks -> refinement

A *view* here is a frame: one image, or all that a rig took at one time. Bearings are in the frame of the rig.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.formats.database import Database
from panopath.formats.models import Reconstruction
from panopath.model import Bool, Float, Int, Scene, Tracks
from panopath.pipeline import ReconstructOptions, ViewOrientations, averaged, metric_scale, place_views
from panopath.priors import DirectionPriors, PositionPriors, Priors, Rig
from panopath.steps import (
    CorrespondenceOptions,
    FeatureTracks,
    RefineOptions,
    matches_that_agree,
    refine,
    relative_poses,
    tracks_from_matches,
)

Index = npt.NDArray[np.int64]

#: COLMAP's configuration of pairs whose matches are a watermark, or several motions.
_NOT_A_SCENE = (7, 8)
#: Steps of a solve that another follows.
_ROUGH_ITERATIONS = 4
#: Where a database has positions without covariance: metres, as satellite receivers err.
_POSITION_SIGMA = 3.0


@dataclass(frozen=True)
class MapOptions:
    """Choices of :func:`map_database`."""

    #: Pairs of images with fewer matches are left out.
    min_num_matches: int = 15
    #: Fewest images that see a point.
    min_track_length: int = 2
    #: Largest angle of a match to the epipolar plane, in units of a pixel.
    max_epipolar_error_px: float = 4.0
    #: Standard deviation of a feature, pixels.
    feature_sigma_px: float = 1.0
    #: Use positions that the database knows: the model is then in their coordinates (metres; east, north, up).
    use_prior_position: bool = False
    #: Standard deviation of such positions where the database gives none, in their unit.
    prior_position_sigma: float = _POSITION_SIGMA
    #: Use directions of gravity that the database knows: the model's z axis is then up.
    use_gravity: bool = True
    #: Standard deviation of these, radians.
    gravity_sigma_rad: float = float(np.radians(1.0))
    #: Judge all matches again by the refined poses, join tracks anew and refine once more.
    retriangulate: bool = True
    #: Pairs of views to orient: at most this many partners for each view.
    max_partners: int = 12
    #: Seed of everything random.
    seed: int = 0
    #: Choices of the steps in between.
    steps: ReconstructOptions = field(default_factory=ReconstructOptions)

    def __post_init__(self) -> None:
        for name, least in (("min_num_matches", 1), ("min_track_length", 2), ("max_partners", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InputError(f"{name} is {value!r}, expected a whole number of at least {least}")
        for name in ("max_epipolar_error_px", "feature_sigma_px", "prior_position_sigma", "gravity_sigma_rad"):
            number = getattr(self, name)
            if not (np.isfinite(number) and number > 0.0):
                raise InputError(f"{name} is {number!r}, expected a positive number")


@dataclass(frozen=True, eq=False)
class MappedDatabase:
    """What was found of a database."""

    #: Views are frames, tracks are points.
    scene: Scene
    #: The same by images and features, as models are written.
    reconstruction: Reconstruction


def map_database(
    database: Database,
    options: MapOptions | None = None,
    report: Callable[[str], None] | None = None,
    *,
    oriented: ViewOrientations | None = None,
) -> MappedDatabase:
    """Orient and place all images of a database, and find the points that they see.

    Parameters
    ----------
    database
        See :func:`panopath.read_database`.
    options
        Choices.
    report
        Called with a line of text whenever a stage begins.
    oriented
        Orientations of the frames, about right (to some degrees); default: from the matches.

    Raises
    ------
    InputError
        Where no pair of images has enough matches, or orientations are not those of the frames.
    """
    chosen = MapOptions() if options is None else options
    for name, value, kind in (("database", database, Database), ("options", chosen, MapOptions)):
        if not isinstance(value, kind):
            raise InputError(f"{name} is a {type(value).__name__}, expected {kind.__name__}")
    say = report or (lambda _: None)
    views = _Views.of(database)
    matches = _Matches.of(database, chosen)
    priors = _priors(database, chosen)
    if oriented is None:
        say(f"orienting {database.n_frames} views by {len(matches.pair)} pairs")
        oriented = _orient(database.n_frames, views, matches, priors, chosen)
    elif oriented.cam_from_world.shape != (database.n_frames, 3, 3):
        raise InputError(f"oriented has shape {oriented.cam_from_world.shape}, expected ({database.n_frames}, 3, 3)")
    say("joining matches to tracks")
    judged = matches.select(_agree_with_orientations(views, matches, oriented, chosen))
    features = _join(database, judged, chosen)
    say(f"placing {database.n_frames} views and {features.n_tracks} points")
    tracks, rig = _tracks(database, views, features, chosen)
    positions = chosen.steps.positions
    rough = replace(positions, max_iterations=min(positions.max_iterations, _ROUGH_ITERATIONS))
    start = place_views(tracks, oriented, rough)
    refinement = replace(chosen.steps.refine, priors=priors)
    if rig is not None and priors.positions is None:
        start = metric_scale(tracks, start, rig)
    say("refining")
    first = replace(refinement, max_iterations=min(refinement.max_iterations, _ROUGH_ITERATIONS))
    scene = refine(tracks, start, first if chosen.retriangulate else refinement, rig)
    if chosen.retriangulate:
        say("judging matches again, refining")
        features, scene = _second_pass(database, views, matches, (features, scene), refinement, chosen)
    found = _reconstruction(database, features, scene)
    # a frame is called by its first image
    namesakes = np.unique(database.image_frame, return_index=True)[1].tolist()
    return MappedDatabase(replace(scene, view_names=tuple(database.image_names[i] for i in namesakes)), found)


@dataclass(frozen=True, eq=False)
class _Views:
    """Features as their views see them."""

    #: (K, 3) bearings in the frame of the rig, NaN where there is none, and (K,) the view of each feature.
    bearing: Float
    view: Index
    #: (K, 3) where the ray starts in the frame of the rig.
    lever: Float
    #: (K,) angle of a pixel.
    pixel_rad: Float

    @classmethod
    def of(cls, database: Database) -> _Views:
        image = np.repeat(np.arange(database.n_images), database.n_features)
        camera = database.image_camera[image]
        bearing = database.bearings
        if database.has_rigs:
            bearing = np.einsum("nkc,nk->nc", database.sensor_from_rig[camera], bearing)
        return cls(
            np.ascontiguousarray(bearing),
            database.image_frame[image].astype(np.int64),
            database.center_in_rig[camera],
            database.pixel_rad,
        )


@dataclass(frozen=True, eq=False)
class _Matches:
    """Matches of a database, pair of images by pair of images."""

    #: (P, 2) images and (P + 1,) where the matches of each pair begin.
    pair: Index
    start: Index
    #: (N, 2) features counted over all images, and within their image.
    feature: Index
    local: npt.NDArray[np.int32]
    #: (N,) row of the pair.
    row: Index

    @classmethod
    def of(cls, database: Database, options: MapOptions) -> _Matches:
        """Take the pairs that have enough matches."""
        counts = np.diff(database.match_starts)
        keep = (counts >= options.min_num_matches) & ~np.isin(database.pair_config, _NOT_A_SCENE)
        if not keep.any():
            raise InputError(
                f"{database.path}: no pair of images has {options.min_num_matches} matches, expected some; "
                "see --min-num-matches"
            )
        every = cls._build(
            database, database.pairs.astype(np.int64), database.match_starts.astype(np.int64), database.matches
        )
        return every.select(keep[every.row])

    @classmethod
    def _build(cls, database: Database, pair: Index, start: Index, local: npt.NDArray[np.int32]) -> _Matches:
        row = np.repeat(np.arange(len(pair)), np.diff(start))
        return cls(pair, start, local + database.feature_starts[pair[row]], local, row)

    def select(self, keep: Bool) -> _Matches:
        """Those where ``keep`` holds; pairs without any fall away."""
        counts = np.bincount(self.row[keep], minlength=len(self.pair))
        used = np.flatnonzero(counts)
        start = np.concatenate(([0], np.cumsum(counts[used])))
        row = np.repeat(np.arange(len(used)), counts[used])
        return _Matches(self.pair[used], start, self.feature[keep], self.local[keep], row)


def _priors(database: Database, options: MapOptions) -> Priors:
    """Collect what the database knows of its frames, where it is to be used."""
    positions = directions = None
    if options.use_prior_position:
        known = database.local_positions()
        # receivers err by more than a rig is large
        frame, image = _first_known(database, known)
        if len(image):
            covariance = np.array(database.position_covariance[image])
            # receivers that know nothing of their accuracy leave zeros
            unknown = ~np.isfinite(covariance).all(axis=(1, 2))
            unknown |= np.linalg.eigvalsh(np.where(np.isfinite(covariance), covariance, 0.0))[:, 0] <= 0.0
            covariance[unknown] = np.eye(3) * options.prior_position_sigma**2
            positions = PositionPriors.of(frame, known[image], covariance=covariance)
    if options.use_gravity:
        frame, image = _first_known(database, database.gravity)
        if len(image):
            rig_from_sensor = np.swapaxes(database.sensor_from_rig[database.image_camera[image]], 1, 2)
            up = -np.einsum("nij,nj->ni", rig_from_sensor, database.gravity[image])
            up /= np.linalg.norm(up, axis=1, keepdims=True)
            directions = DirectionPriors.gravity(frame, up, options.gravity_sigma_rad)
    return Priors(positions=positions, directions=directions)


def _first_known(database: Database, values: Float) -> tuple[Int, Index]:
    """Find frames of which something is known; the first image of each that knows it stands for its frame."""
    image = np.flatnonzero(np.isfinite(values).all(axis=1))
    frame, first = np.unique(database.image_frame[image], return_index=True)
    return frame, image[first]


#: Matches of a pair that it is oriented by.
_ORIENTING_MATCHES = 120


def _orient(n_views: int, views: _Views, matches: _Matches, priors: Priors, options: MapOptions) -> ViewOrientations:
    """Relative poses of the views that share most, averaged."""
    ends = views.view[matches.feature]
    # a match within one frame tells of no motion; the smaller view comes first
    swap = ends[:, 0] > ends[:, 1]
    feature = np.where(swap[:, None], matches.feature[:, ::-1], matches.feature)
    ends = np.sort(ends, axis=1)
    key = ends[:, 0] * n_views + ends[:, 1]
    order = np.flatnonzero(ends[:, 0] != ends[:, 1])
    order = order[np.argsort(key[order], kind="stable")]
    pair, begin, count = np.unique(key[order], return_index=True, return_counts=True)
    keep = _partners(pair // n_views, pair % n_views, count, n_views, options.max_partners)
    graph = options.steps.view_graph
    most = min(graph.max_matches, _ORIENTING_MATCHES)
    thin = [_thinned(order[b : b + c], most) for b, c in zip(begin[keep], count[keep], strict=True)]
    start = np.concatenate(([0], np.cumsum([len(rows) for rows in thin])))
    rows = feature[np.concatenate(thin)] if thin else np.empty((0, 2), dtype=np.int64)
    two_view = replace(options.steps.two_view, seed=options.seed)
    found = relative_poses(start, views.bearing[rows[:, 0]], views.bearing[rows[:, 1]], two_view)
    joined = np.stack((pair // n_views, pair % n_views), axis=1)[keep].astype(np.int32)
    return averaged(joined, found, n_views, priors, options.steps.orientation)


def _partners(first: Index, second: Index, count: Index, n_views: int, most: int) -> Bool:
    """Choose pairs that one of their views keeps: half of them those with most matches, half spread over the rest."""
    keep = np.zeros(len(first), dtype=np.bool_)
    view = np.concatenate((first, second))
    row = np.tile(np.arange(len(first)), 2)
    order = np.lexsort((row, -count[row], view))
    bounds = np.searchsorted(view[order], np.arange(n_views + 1))
    for begin, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        ranked = row[order[begin:end]]
        near, others = ranked[: -(-most // 2)], ranked[-(-most // 2) :]
        keep[near] = True
        keep[others[_spread(len(others), most - len(near))]] = True
    return keep


def _spread(n: int, most: int) -> Index:
    """At most ``most`` of ``n`` places, evenly spread."""
    if n <= most:
        return np.arange(n)
    return (np.arange(1, most + 1) * n // most - 1) if most > 0 else np.empty(0, dtype=np.int64)


def _thinned(rows: Index, most: int) -> Index:
    return rows if len(rows) <= most else rows[np.arange(most) * len(rows) // most]


def _agree_with_orientations(views: _Views, matches: _Matches, oriented: ViewOrientations, options: MapOptions) -> Bool:
    """Judge matches by one baseline for each pair, orientations given.

    Orientations err by more than a pixel at first: the limit is the noise that the pair shows.
    """
    component = oriented.view_component
    a, b = _views_of_pairs(views, matches)
    known = (component[a] >= 0) & (component[a] == component[b])
    some = _some_of_each_pair(matches, _JUDGED_MATCHES)
    first, second = matches.feature[some, 0], matches.feature[some, 1]
    # bearings are turned into the world, so that only a direction is left to find
    found = relative_poses(
        np.searchsorted(matches.row[some], np.arange(len(matches.pair) + 1)),
        _filled(_turned_back(oriented.cam_from_world, views.view[first], views.bearing[first])),
        _filled(_turned_back(oriented.cam_from_world, views.view[second], views.bearing[second])),
        replace(options.steps.two_view, seed=options.seed),
        np.tile(np.eye(3), (len(matches.pair), 1, 1)),
    )
    noise = np.where(np.isfinite(found.sigma_rad), found.sigma_rad, 0.0)
    agree = _agree(
        views, matches, oriented.cam_from_world, (a, b), (found.direction, known), options, _NOISE_SIGMAS * noise
    )
    return np.asarray(agree & known[matches.row])


def _agree_with_poses(views: _Views, matches: _Matches, scene: Scene, options: MapOptions) -> Bool:
    """Judge matches by whether their rays meet, poses given."""
    a, b = _views_of_pairs(views, matches)
    known = (scene.view_component[a] >= 0) & (scene.view_component[a] == scene.view_component[b])
    first, second = (matches.feature[matches.start[:-1], side] for side in (0, 1))
    start_a = scene.centers[a] + _turned_back(scene.cam_from_world, a, views.lever[first])
    start_b = scene.centers[b] + _turned_back(scene.cam_from_world, b, views.lever[second])
    baseline = start_b - start_a
    none = np.zeros(len(known))
    agree = _agree(views, matches, scene.cam_from_world, (a, b), (baseline, known), options, none)
    return np.asarray(agree & known[matches.row])


def _agree(  # noqa: PLR0917
    views: _Views,
    matches: _Matches,
    cam_from_world: Float,
    ends: tuple[Index, Index],
    baseline: tuple[Float, Bool],
    options: MapOptions,
    limit: Float,
) -> Bool:
    """Judge all matches of each pair by the orientations of its views and its baseline in the world, where known."""
    a, b = ends
    between, known = baseline
    rotation = np.where(known[:, None, None], cam_from_world[b] @ np.swapaxes(cam_from_world[a], 1, 2), np.eye(3))
    towards = np.einsum("nij,nj->ni", cam_from_world[b], between)
    own = options.max_epipolar_error_px * views.pixel_rad
    return matches_that_agree(matches.start, matches.feature, views.bearing, own, rotation, towards, limit)


#: Matches of a pair that its baseline is sought with; all are judged by it.
_JUDGED_MATCHES = 100
#: Matches may miss the baseline of their pair by so many standard deviations of the noise that the pair shows.
_NOISE_SIGMAS = 4.0


def _views_of_pairs(views: _Views, matches: _Matches) -> tuple[Index, Index]:
    """Look up the views of the first and of the second image of each pair."""
    first = matches.feature[matches.start[:-1]]
    return views.view[first[:, 0]], views.view[first[:, 1]]


def _some_of_each_pair(matches: _Matches, most: int) -> Index:
    """Rows of at most ``most`` matches of each pair, evenly spread."""
    count = np.diff(matches.start)
    within = np.arange(len(matches.row)) - matches.start[matches.row]
    n = count[matches.row]
    # of n rows, those where the count of thirds, quarters ... of the way goes up
    return np.flatnonzero((n <= most) | ((within + 1) * most // n > within * most // n))


def _filled(directions: Float) -> Float:
    """Put unit vectors in the place of unknown ones: the core takes no others, and these pairs do not count."""
    return np.where(np.isfinite(directions), directions, 1.0 / np.sqrt(3.0))


def _turned_back(cam_from_world: Float, view: Index, bearing: Float) -> Float:
    return np.asarray(np.matmul(bearing[:, None, :], cam_from_world[view])[:, 0])


def _join(database: Database, matches: _Matches, options: MapOptions) -> FeatureTracks:
    return tracks_from_matches(
        database.n_features,
        matches.pair.astype(np.int32),
        matches.start,
        matches.local,
        CorrespondenceOptions(min_images=options.min_track_length),
    )


def _tracks(
    database: Database, views: _Views, features: FeatureTracks, options: MapOptions
) -> tuple[Tracks, Rig | None]:
    """Observations of the joined features by the frames, and where their rays start."""
    if not len(features):
        raise InputError(f"{database.path}: no matches agree with each other, so there is nothing to place")
    at = features.feature + database.feature_starts[features.image]
    tracks = Tracks.from_arrays(
        database.image_frame[features.image],
        features.track,
        views.bearing[at],
        database.n_frames,
        features.n_tracks,
        sigma_rad=options.feature_sigma_px * views.pixel_rad[at],
    )
    if not database.has_rigs or not np.any(database.center_in_rig):
        return tracks, None
    return tracks, Rig.of(database.image_camera[features.image], database.sensor_from_rig, database.center_in_rig)


def _second_pass(  # noqa: PLR0917
    database: Database,
    views: _Views,
    matches: _Matches,
    first: tuple[FeatureTracks, Scene],
    refinement: RefineOptions,
    options: MapOptions,
) -> tuple[FeatureTracks, Scene]:
    """Join what agrees with the refined poses, intersect points that are new and refine again."""
    scene = first[1]
    features = _join(database, matches.select(_agree_with_poses(views, matches, scene, options)), options)
    if not len(features):
        return first  # views that only turned: no poses to agree with
    tracks, rig = _tracks(database, views, features, options)
    same = _same_tracks(database, first[0], scene, features)
    start = replace(
        scene,
        points=np.where(same[:, None] >= 0, scene.points[same], np.nan),
        track_component=np.where(same >= 0, scene.track_component[same], -1),
        inlier=np.zeros(len(tracks), dtype=np.bool_),
        residual_rad=np.full(len(tracks), np.nan),
        tracks=tracks,
        track_names=None,
    )
    if rig is not None and refinement.priors.positions is None:
        # a first refinement from a size far off may have stopped on the way
        start = metric_scale(tracks, start, rig)
    return features, refine(tracks, start, refinement, rig)


def _same_tracks(database: Database, before: FeatureTracks, scene: Scene, after: FeatureTracks) -> Index:
    """Find an earlier track that shares a feature in use with each track now, -1 where there is none."""
    used = scene.inlier & (scene.track_component[before.track] >= 0)
    of_feature = np.full(int(database.feature_starts[-1]), -1, dtype=np.int64)
    of_feature[before.feature[used] + database.feature_starts[before.image[used]]] = before.track[used]
    same = np.full(after.n_tracks, -1, dtype=np.int64)
    earlier = of_feature[after.feature + database.feature_starts[after.image]]
    same[after.track[earlier >= 0]] = earlier[earlier >= 0]
    return same


def _reconstruction(database: Database, features: FeatureTracks, scene: Scene) -> Reconstruction:
    cam_from_world, centers = database.image_poses(scene.cam_from_world, scene.centers)
    used = scene.inlier & (scene.track_component[features.track] >= 0)
    observations = np.stack((features.image[used], features.feature[used], features.track[used]), axis=1)
    component = scene.view_component[database.image_frame]
    return Reconstruction.from_arrays(
        database, cam_from_world, centers, scene.points, observations.astype(np.int64), component=component
    )
