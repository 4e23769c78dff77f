"""Exact synthetic worlds: where the views stood, where the points lie, what was seen, and what of that is wrong.

``simulate("street")`` is a closed walk with a panoramic camera; the other worlds isolate one difficulty each::

    box          uniform points and views in the square or cube [-1, 1]^d
    street       closed walk, views 1 m apart, points 1 to 200 m away, near points seen by fewer views
    room         random walk in 8 x 6 x 2.6 m, points on the walls, seen again when the walk comes back
    corridor     straight walk between walls 3 m apart
    line         exactly straight path, points off the line
    stop_and_go  the street with pauses in which the camera does not move at all
    chain        long winding walk that never closes
    ellipse      views and points on one conic of the plane: ambiguous although richly seen
    cylinder     views and points on an elliptic cylinder: ambiguous seen from above, unique in space
    weak         clusters joined by a few two-view tracks, or a chain of two-view tracks

Things may move through a world. One body is a disturbance: its sightings are outliers, as in a world taken to be at
rest. With ``n_bodies`` above one, tracks ride on cars and people whose true paths are in ``SyntheticWorld.paths``::

    world = simulate("street", mover_fraction=0.3, n_bodies=20)

Each source of randomness has a stream of its own under the one seed, so that the same seed with more noise is the
same scene seen worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from panopath import _core
from panopath.errors import InputError
from panopath.model import Bool, Float, Int, Tracks
from panopath.paths import PathModel, Paths, PathVerdict, Static, Taylor

WorldName = Literal["box", "street", "room", "corridor", "line", "stop_and_go", "chain", "ellipse", "cylinder", "weak"]


@dataclass(frozen=True, eq=False)
class SyntheticWorld:
    """A simulated scene with its truth.

    Observations are sorted by track, then by view.
    """

    #: What was seen. Bearings are in the camera frame; with ``orientations="identity"`` that is the world frame.
    tracks: Tracks
    #: Orientation of each view as a solver is told it (truth turned by the orientation error): ``(n_views, 3, 3)``,
    #: or headings ``(n_views,)`` in radians in the plane.
    cam_from_world: Float
    #: True positions of the views, ``(n_views, d)``.
    centers: Float
    #: True positions of the points, ``(n_tracks, d)``; of what is carried, and of one body, where its anchor saw it;
    #: of many bodies, in the middle of the time that each track was seen, as in a solved scene.
    points: Float
    #: Observations that are false directions, or sightings of what the camera carries along or, with one body, of that,
    #: ``(N,)``. Sightings of many bodies are right, and not among them.
    outlier: Bool
    #: Standard deviation of the bearings along each tangent direction, radians.
    noise_rad: float
    #: When each view was taken, ``(n_views,)``, seconds.
    time_s: Float
    #: The body that each track rides on, ``(n_tracks,)``; -1: none.
    body: Int
    #: Velocities ``(n_tracks, d)`` at ``point_time_s``, units of the world a second; 0 at rest.
    velocity: Float
    #: Accelerations ``(n_tracks, d)``, which are constant.
    acceleration: Float
    #: When each point was where ``points`` says, ``(n_tracks,)``, seconds.
    point_time_s: Float
    #: Tracks that keep their place in the camera, ``(n_tracks,)``: they have no path of their own in the world.
    carried: Bool

    @property
    def moving(self) -> Bool:
        """Tracks that ride on a body, ``(n_tracks,)``."""
        return np.asarray(self.body >= 0)

    def positions_at(self, time_s: float) -> Float:
        """Give the true positions ``(n_tracks, d)`` at a time, seen or not; NaN of what is carried."""
        since_s = (time_s - self.point_time_s)[:, None]
        found = self.points + since_s * self.velocity + 0.5 * since_s**2 * self.acceleration
        found[self.carried] = np.nan
        return np.asarray(found)

    @cached_property
    def paths(self) -> Paths:
        """True paths of all tracks: rest, or polynomials of order 1 and 2 about ``point_time_s``, in seconds.

        What the camera carries along is not determined. Every track is where it is with certainty: no covariances.
        """
        orders = np.where(self.body < 0, 0, np.where(self.acceleration.any(axis=1), 2, 1))
        starts = np.concatenate(([0], np.cumsum(orders + 1)))
        coefficients = np.empty((starts[-1], self.points.shape[1]))
        coefficients[starts[:-1]] = np.where(self.carried[:, None], np.nan, self.points)
        moves, turns = np.flatnonzero(orders > 0), np.flatnonzero(orders > 1)
        coefficients[starts[moves] + 1] = self.velocity[moves]
        coefficients[starts[turns] + 2] = 0.5 * self.acceleration[turns]
        models: list[PathModel] = [Static()] * len(orders)
        verdicts = [PathVerdict.STATIC] * len(orders)
        for track in moves.tolist():
            models[track] = Taylor(int(orders[track]), float(self.point_time_s[track]), 1.0)
            verdicts[track] = PathVerdict.MOVING
        for track in np.flatnonzero(self.carried).tolist():
            verdicts[track] = PathVerdict.UNDETERMINED
        return Paths(
            tuple(models),
            starts,
            coefficients,
            None,
            self._seen_s(),
            tuple(verdicts),
            np.full(len(orders), -1, dtype=np.int32),
            self.body,
            "the truth",
        )

    def _seen_s(self) -> Float:
        """Find the times ``(n_tracks, 2)`` of the first and the last observation; NaN of a track without one."""
        times, track = self.time_s[self.tracks.view], self.tracks.track
        seen_s = np.full((self.tracks.n_tracks, 2), (np.inf, -np.inf))
        np.minimum.at(seen_s[:, 0], track, times)
        np.maximum.at(seen_s[:, 1], track, times)
        seen_s[~np.isfinite(seen_s)] = np.nan
        return seen_s


def simulate(
    world: WorldName | str,
    *,
    n_views: int = 100,
    n_points: int = 1000,
    seed: int = 0,
    dimension: Literal[2, 3] | None = None,
    noise_rad: float = 0.0,
    angle_error_rad: float = 0.0,
    outlier_fraction: float = 0.0,
    mover_fraction: float = 0.0,
    mover_speed_m_s: float = 1.5,
    n_bodies: int = 1,
    operator_fraction: float = 0.0,
    infinity_fraction: float = 0.0,
    infinity_distance: tuple[float, float] = (1e5, 1e6),
    orientations: Literal["identity", "random"] = "identity",
    orientation_error_rad: float = 0.0,
    frame_interval_s: float = 1.0,
    min_views: int | None = None,
    max_views: int | None = None,
    visible_fraction: float | None = None,
    depth_min_m: float | None = None,
    depth_max_m: float | None = None,
    spacing_m: float | None = None,
    wobble_m: float | None = None,
    near_m: float | None = None,
    go_views: int | None = None,
    stop_views: int | None = None,
    n_clusters: int | None = None,
    n_links: int | None = None,
    weak_mode: Literal["clusters", "chain"] | None = None,
    conic: Literal["ellipse", "circle", "parabola", "hyperbola"] | None = None,
    off_conic: float | None = None,
) -> SyntheticWorld:
    """Simulate a world; the same arguments give the same bytes.

    Arguments that default to ``None`` belong to some worlds only and then mean the world's own default.

    Parameters
    ----------
    world
        Which world; the module's text lists them.
    n_views, n_points
        Number of views and of points (tracks).
    seed
        Seed of everything random.
    dimension
        2 for the plane, 3 for space; ``ellipse`` is planar and ``cylinder`` spatial, the others default to 3.
    noise_rad
        Standard deviation of a bearing along each tangent direction of the sphere.
    angle_error_rad
        Azimuth and elevation of every bearing are each off by an error uniform between this and its negative (in the
        plane the one angle), as in Knill and Ramirez-Herran's experiments.
    outlier_fraction
        Probability with which a bearing is replaced by a uniformly random direction.
    mover_fraction, mover_speed_m_s
        Share of the tracks that ride on bodies; the speed of the body where there is one, which crosses the scene.
    n_bodies
        Number of these bodies (1). More, in street, corridor, line, stop_and_go and chain, are cars (3 to 14 m/s, along
        the path of the views, in either direction) and people (1 to 2 m/s, half of them turning) in equal shares, about
        as many tracks on each, seen by consecutive views while near: from six views at least, if ``max_views`` allows.
    operator_fraction
        Share of the tracks that are fixed in the camera frame, as the person who carries the camera is.
    infinity_fraction, infinity_distance
        Share of the points sent along their ray to a log-uniform distance of this range; from about 1e17 on the rays
        of a small scene are parallel to the last bit.
    orientations
        ``"identity"``: bearings are world directions. ``"random"``: every view is turned at random.
    orientation_error_rad
        Standard deviation, per axis, by which the returned ``cam_from_world`` is off; bearings come from the true one.
    frame_interval_s
        Time from view to view.
    min_views, max_views
        Views of a track: 3 to 15; box, ellipse, cylinder: 2 to all.
    visible_fraction
        Box, ellipse, cylinder: probability that a view sees a point (1).
    depth_min_m, depth_max_m
        Street, line, stop_and_go, chain: log-uniform range of a point's distance (1 to 200); weak chain 1 to 20.
    spacing_m
        Worlds with a path, weak chain: distance between consecutive views (1; room 0.25).
    wobble_m
        Worlds with a path, weak chain: standard deviation of a view about it, per axis (0.05; line, weak chain 0).
    near_m
        Room: how far from a track's anchor view the others may be (1).
    go_views, stop_views
        Stop_and_go: steps between two pauses (10) and views taken in a pause (5).
    n_clusters, n_links, weak_mode
        Weak: number of clusters (2); two-view tracks that join one to the next, which are the last tracks (4); whether
        such clusters are meant, or a chain of views that share only two-view tracks.
    conic, off_conic
        Ellipse: the curve. Ellipse, cylinder: standard deviation by which the points leave it (0: ambiguous).

    Returns
    -------
    SyntheticWorld
        What was seen, with the truth.

    Raises
    ------
    InputError
        For an unknown world, an option out of its range, or one that the world has no use for.
    """
    options: dict[str, Any] = {name: value for name, value in locals().items() if name != "world" and value is not None}
    try:
        arrays = _core.simulate(world, options)
    except ValueError as error:
        raise InputError(str(error)) from None
    return _as_world(arrays)


def _as_world(arrays: dict[str, Any]) -> SyntheticWorld:
    tracks = Tracks.from_arrays(
        arrays["view"],
        arrays["track"],
        arrays["bearing"],
        n_views=arrays["n_views"],
        n_tracks=arrays["n_tracks"],
        time_s=arrays["time_s"],
    )
    return SyntheticWorld(
        tracks=tracks,
        cam_from_world=arrays["cam_from_world"],
        centers=arrays["centers"],
        points=arrays["points"],
        outlier=arrays["outlier"],
        noise_rad=arrays["noise_rad"],
        time_s=arrays["time_s"],
        body=arrays["body"],
        velocity=arrays["velocity"],
        acceleration=arrays["acceleration"],
        point_time_s=arrays["point_time_s"],
        carried=arrays["carried"],
    )
