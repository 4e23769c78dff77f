"""What is drawn of a scene, a layer a kind of thing, each in the nodes ``/parts/K/...`` of the parts it belongs to.

Every layer can be hidden, and can show what there is up to a moment; bodies that move are where they were then.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.formats.csv import quaternion_from_rotation
from panopath.formats.ply import error_colours
from panopath.model import Float
from panopath.movers import curve_times
from panopath.viewer.content import Content
from panopath.viewer.glb import textured
from panopath.viewer.shapes import (
    PALETTE,
    REACH,
    Colours,
    Ids,
    Part,
    ball,
    ellipsoids,
    panorama_sphere,
    round_factor,
    shown_axes,
    spread,
    view_order,
    world_from_cam,
)

Colouring = Literal["pictures", "parts", "error", "track length"]

#: Points that are shown; of more, some evenly over all of them.
MOST_POINTS = 150_000
#: Bodies that are shown, and pieces of the ways they came.
MOST_BODIES = 2_000
MOST_PIECES = 20_000
#: Ellipsoids of points, and of views, that are shown.
MOST_ELLIPSOIDS = 1_500
#: Views whose panorama is shown on its sphere.
MOST_PICTURES = 48
_PICTURE_PX = 512
_MARKER_COLOUR = (230, 0, 140)
#: Longest half-axis of an ellipsoid, as shown.
_LONGEST = 0.2 * REACH
#: Instances are hidden by making them this small; none at all would leave a matrix without inverse.
_GONE = 1e-6


@dataclass(frozen=True, eq=False)
class Drawing:
    """What the layers share."""

    server: Any
    content: Content
    parts: tuple[Part, ...]
    #: Solved views in order, and the place of each view in it (-1: not solved).
    order: Ids
    rank: Ids
    #: Radius of a view's marker, as shown.
    radius: float

    @classmethod
    def of(cls, server: Any, content: Content, parts: Sequence[Part]) -> Drawing:
        """Gather it."""
        order = view_order(content.scene)
        rank = np.full(len(content.scene.centers), -1, dtype=np.intp)
        rank[order] = np.arange(len(order))
        return cls(server, content, tuple(parts), order, rank, _marker_radius(content, parts, order))

    def node(self, part: int, name: str) -> str:
        """Name of a node that goes along with a part."""
        return f"/parts/{part}/{name}"

    def centers(self, part: int) -> Float:
        """(n, 3) centres of the views of a part, as shown within it."""
        return self.parts[part].shown(self.content.scene.centers[self.parts[part].views])

    def part_of(self, view: int) -> int:
        """Which part shows a view."""
        return next(k for k, part in enumerate(self.parts) if view in part.views)

    def shown_center(self, view: int) -> Float:
        """(3,) where the centre of a view is shown."""
        part = self.parts[self.part_of(view)]
        place: Float = part.shown(self.content.scene.centers[[view]])[0]
        return place


class Layer(Protocol):
    """One kind of thing."""

    def show(self, shown: bool) -> None:
        """Show or hide all of it."""

    def show_until(self, last: int) -> None:
        """Show what there is up to the view at place ``last`` of the order."""


class Points:
    """The points of all parts, at most ``MOST_POINTS``."""

    def __init__(self, drawing: Drawing) -> None:
        self._drawing = drawing
        self.total = sum(len(part.points) for part in drawing.parts)
        share = min(1.0, MOST_POINTS / max(self.total, 1))
        # a small part must not vanish beside a large one
        most = [max(int(share * len(part.points)), 20) for part in drawing.parts]
        self._shown = [part.points[spread(len(part.points), m)] for part, m in zip(drawing.parts, most, strict=True)]
        self.count = sum(map(len, self._shown))
        self._nodes = {
            k: drawing.server.scene.add_point_cloud(
                drawing.node(k, "points"),
                part.shown(drawing.content.scene.points[ids]),
                self.colours(self.choices[0], k),
                point_size=self.size,
                point_shape="circle",
                point_shading="flat",
                precision="float32",
            )
            for k, (part, ids) in enumerate(zip(drawing.parts, self._shown, strict=True))
            if len(ids)
        }

    @property
    def choices(self) -> tuple[Colouring, ...]:
        """The ways to colour them, the best one first."""
        scene = self._drawing.content.scene
        plain: tuple[Colouring, ...] = ("parts",) if scene.tracks is None else ("parts", "error", "track length")
        return plain if self._drawing.content.colours is None else ("pictures", *plain)

    @property
    def size(self) -> float:
        """A size at which so many points neither hide one another nor get lost."""
        return float(np.clip(0.012 * (20_000 / max(self.count, 1)) ** (1.0 / 3.0), 0.006, 0.03))

    def colours(self, choice: Colouring, part: int) -> Colours:
        """(n, 3) colours of the shown points of a part."""
        content, ids = self._drawing.content, self._shown[part]
        if choice == "pictures" and content.colours is not None:
            return content.colours[ids]
        statistics = content.scene.point_statistics()
        if choice == "error":
            # graded over all parts, so that a colour means the same everywhere
            return error_colours(np.degrees(statistics.rms_rad))[ids]
        if choice == "track length":
            # two views: the far end of the scale
            length = statistics.n_observations
            return error_colours(np.where(length > 0, 1.0 / np.maximum(length, 1), np.nan))[ids]
        return np.tile(np.array(self._drawing.parts[part].colour, dtype=np.uint8), (len(ids), 1))

    def colour(self, choice: Colouring) -> None:
        """Colour them in another way."""
        for k, node in self._nodes.items():
            node.colors = self.colours(choice, k)

    def resize(self, size: float) -> None:
        """Make them larger or smaller."""
        for node in self._nodes.values():
            node.point_size = size

    def show(self, shown: bool) -> None:
        """Show or hide them."""
        for node in self._nodes.values():
            node.visible = shown

    def show_until(self, last: int) -> None:
        """Points stay: they are known from all views together."""


class Lines:
    """Segments that appear with a view each."""

    def __init__(self, drawing: Drawing, name: str, made: Callable[[int], tuple[Float, Colours, Ids]]) -> None:
        """``made(part)`` gives (n, 2, 3) ends, (n, 3) colours and (n,) the places in the order at which they appear."""
        self._drawing, self._shown, self._last = drawing, True, len(drawing.order) - 1
        self._all = [made(k) for k in range(len(drawing.parts))]
        self._nodes = [
            drawing.server.scene.add_line_segments(
                drawing.node(k, name),
                ends.astype(np.float32) if len(ends) else np.zeros((1, 2, 3), dtype=np.float32),
                np.repeat(colours[:, None], 2, axis=1) if len(ends) else np.zeros((1, 2, 3), dtype=np.uint8),
                thickness=3.0,
                thickness_units="screen",
                visible=len(ends) > 0,
            )
            for k, (ends, colours, _) in enumerate(self._all)
        ]

    def show(self, shown: bool) -> None:
        """Show or hide them."""
        self._shown = shown
        self.show_until(self._last)

    def show_until(self, last: int) -> None:
        """Show those that have appeared."""
        self._last = last
        for node, (ends, colours, since) in zip(self._nodes, self._all, strict=True):
            keep = since <= last
            if keep.any() and len(node.points) != keep.sum():
                with self._drawing.server.atomic():
                    node.points = ends[keep].astype(np.float32)
                    node.colors = np.repeat(colours[keep, None], 2, axis=1)
            node.visible = bool(self._shown and keep.any())


def path(drawing: Drawing) -> Lines:
    """Draw the line from view to view, within each part."""

    def made(k: int) -> tuple[Float, Colours, Ids]:
        part = drawing.parts[k]
        component = drawing.content.scene.view_component
        ordered = part.views[np.argsort(drawing.rank[part.views])]
        together = component[ordered[1:]] == component[ordered[:-1]]
        before, after = ordered[:-1][together], ordered[1:][together]
        centers = drawing.content.scene.centers
        ends = np.stack((part.shown(centers[before]), part.shown(centers[after])), axis=1)
        colours = np.tile(np.array(part.colour, dtype=np.uint8), (len(ends), 1))
        return ends, colours, drawing.rank[after]

    return Lines(drawing, "path", made)


def axes(drawing: Drawing) -> Lines:
    """Draw the axes of each camera: x red, y green, z blue."""

    def made(k: int) -> tuple[Float, Colours, Ids]:
        views = drawing.parts[k].views
        arms = world_from_cam(drawing.content.scene)[views].transpose(0, 2, 1)
        starts = np.repeat(drawing.centers(k), 3, axis=0)
        tips = starts + 4.0 * drawing.radius * arms.reshape(-1, 3)
        colours = np.tile(np.array([(220, 50, 40), (50, 160, 60), (50, 90, 220)], dtype=np.uint8), (len(views), 1))
        known = np.isfinite(tips).all(axis=1)
        return (
            np.stack((starts, tips), axis=1)[known],
            colours[known],
            np.repeat(drawing.rank[views], 3)[known],
        )

    return Lines(drawing, "axes", made)


@dataclass(frozen=True, eq=False)
class _Movers:
    """Bodies of a part that are shown."""

    part: int
    tracks: Ids
    #: (n, 3) colours of the bodies.
    colours: Colours
    #: (m, 2, 3) pieces of the ways they came, as shown; (m,) whose each is, and the second at which it ends.
    pieces: Float
    owner: Ids
    end_s: Float


class Bodies:
    """Bodies that move: a ball a body where it was at the moment, if it was seen then, and the way it came.

    The moment is the time of the view that the slider is at. Where times are not known there are ways alone.
    """

    def __init__(self, drawing: Drawing) -> None:
        self._drawing, self._shown, self._last = drawing, True, len(drawing.order) - 1
        paths = drawing.content.scene.paths
        self._moving = np.zeros(0, dtype=np.intp) if paths is None else np.flatnonzero(paths.moving)
        found = [] if paths is None else [self._of(k) for k in range(len(drawing.parts))]
        self._all = [one for one in found if len(one.tracks)]
        #: How many are shown, and how many move.
        self.count, self.total = sum(len(one.tracks) for one in self._all), len(self._moving)
        mesh = ball(2 if self.count <= 200 else 1)
        #: Radius of a ball: many must not hide one another.
        self.radius = float(np.clip(0.08 * (60.0 / max(self.count, 1)) ** (1.0 / 3.0), 0.025, 0.08))
        self._nodes = []
        for one in self._all:
            balls = drawing.server.scene.add_batched_meshes_simple(
                drawing.node(one.part, "bodies"),
                mesh.vertices * self.radius,
                mesh.faces,
                np.tile([1.0, 0.0, 0.0, 0.0], (len(one.tracks), 1)),
                np.zeros((len(one.tracks), 3)),
                batched_scales=np.ones(len(one.tracks), dtype=np.float32),
                batched_colors=one.colours,
                lod="off",
                cast_shadow=False,
                receive_shadow=False,
            )
            ways = drawing.server.scene.add_line_segments(
                drawing.node(one.part, "ways of bodies"),
                np.zeros((1, 2, 3), dtype=np.float32),
                np.zeros((1, 2, 3), dtype=np.uint8),
                thickness=2.0,
                thickness_units="screen",
                visible=False,
            )
            self._nodes.append((balls, ways))
        self.show_until(self._last)

    def _of(self, part: int) -> _Movers:
        """Choose the bodies of a part, and cut their ways into pieces that are nearly straight."""
        drawing, scene = self._drawing, self._drawing.content.scene
        paths = scene.paths
        assert paths is not None
        components = np.unique(scene.view_component[drawing.parts[part].views])
        mine = self._moving[np.isin(scene.track_component[self._moving], components)]
        mine = mine[np.isfinite(paths.seen_s[mine]).all(axis=1)]
        share = MOST_BODIES / max(len(self._moving), 1)
        tracks = mine[spread(len(mine), max(1, int(share * len(mine))))]
        most = max(2, MOST_PIECES // max(len(tracks), 1))
        pieces, owners, ends = [np.empty((0, 2, 3))], [np.empty(0, dtype=np.intp)], [np.empty(0)]
        for k, track in enumerate(tracks.tolist()):
            first, last = paths.seen_s[track].tolist()
            times = curve_times(paths.models[track], first, last, most)
            places = drawing.parts[part].shown(paths.position(track, times))
            pieces.append(np.stack((places[:-1], places[1:]), axis=1))
            owners.append(np.full(len(times) - 1, k))
            ends.append(times[1:])
        body = paths.body[tracks]
        # bodies of one track have the colours after those of the rigid ones
        rank = np.where(body >= 0, body, np.arange(len(tracks)) + int(paths.body.max(initial=-1)) + 1)
        colours = PALETTE[1 + rank % (len(PALETTE) - 1)]
        return _Movers(part, tracks, colours, np.concatenate(pieces), np.concatenate(owners), np.concatenate(ends))

    def show(self, shown: bool) -> None:
        """Show or hide them."""
        self._shown = shown
        self.show_until(self._last)

    def show_until(self, last: int) -> None:
        """Show them where they were when the view at place ``last`` of the order was taken."""
        self._last = last
        now = self._now(last)
        for one, (balls, ways) in zip(self._all, self._nodes, strict=True):
            places = self._places(one, now)
            seen = np.asarray(np.isfinite(places).all(axis=1))
            came = (one.end_s <= now) & np.isfinite(one.pieces).all(axis=(1, 2))
            pieces, colours = one.pieces[came], one.colours[one.owner[came]]
            pieces, colours = self._to_now(one, now, places, (pieces, colours))
            with self._drawing.server.atomic():
                balls.batched_positions = np.where(seen[:, None], places, 0.0).astype(np.float32)
                balls.batched_scales = np.where(seen, 1.0, _GONE).astype(np.float32)
                balls.visible = self._shown
                if len(pieces):
                    ways.points = pieces.astype(np.float32)
                    ways.colors = np.repeat(colours[:, None], 2, axis=1)
                ways.visible = bool(self._shown and len(pieces))

    def _now(self, last: int) -> float:
        tracks = self._drawing.content.scene.tracks
        if tracks is None or tracks.time_s is None or not len(self._drawing.order):
            return float("inf")
        return float(tracks.time_s[self._drawing.order[last]])

    def _places(self, one: _Movers, now: float) -> Float:
        """(n, 3) where they are shown at a time, NaN where they were not seen."""
        paths = self._drawing.content.scene.paths
        assert paths is not None
        places = np.full((len(one.tracks), paths.d), np.nan)
        inside = (paths.seen_s[one.tracks, 0] <= now) & (now <= paths.seen_s[one.tracks, 1])
        for k in np.flatnonzero(inside).tolist():
            places[k] = paths.position(int(one.tracks[k]), [now])[0]
        return self._drawing.parts[one.part].shown(places)

    @staticmethod
    def _to_now(one: _Movers, now: float, places: Float, came: tuple[Float, Colours]) -> tuple[Float, Colours]:
        """Add to the pieces that lie behind each body the one that it is on."""
        seen = np.asarray(np.isfinite(places).all(axis=1))
        ahead = np.flatnonzero((one.end_s > now) & seen[one.owner])
        # pieces of a body follow one another, so the first that ends later is the one
        owner, first = np.unique(one.owner[ahead], return_index=True)
        begun = np.stack((one.pieces[ahead[first], 0], places[owner]), axis=1)
        return np.concatenate((came[0], begun)), np.concatenate((came[1], one.colours[owner]))


class Views:
    """A small sphere a view; a click on it is told with the view."""

    def __init__(self, drawing: Drawing, clicked: Callable[[Any, int], None]) -> None:
        self._drawing, self._shown, self._last = drawing, True, len(drawing.order) - 1
        self._nodes, self._markers = [], []
        # thousands of round spheres are too much to draw smoothly
        mesh = ball(2 if len(drawing.order) <= 200 else 1 if len(drawing.order) <= 1000 else 0)
        # the sphere of a picture is to be looked into
        has_picture = np.array([path is not None for path in drawing.content.images])
        self._sizes = np.where(has_picture & (drawing.content.scene.d == 3), 0.5, 1.0)
        for k, part in enumerate(drawing.parts):
            if not len(part.views):
                continue
            node = drawing.server.scene.add_batched_meshes_simple(
                drawing.node(k, "views"),
                mesh.vertices * drawing.radius,
                mesh.faces,
                np.tile([1.0, 0.0, 0.0, 0.0], (len(part.views), 1)),
                drawing.centers(k),
                batched_scales=self._sizes[part.views].astype(np.float32),
                batched_colors=np.array(part.colour, dtype=np.uint8),
                lod="off",
                cast_shadow=False,
                receive_shadow=False,
            )
            node.on_click(lambda event, k=k: clicked(event.client, nearest_to_ray(drawing, k, event)))
            self._nodes.append((k, node))
        for k in range(len(drawing.parts)):
            name = drawing.node(k, "moment")
            size = 1.8 * drawing.radius
            self._markers.append(
                drawing.server.scene.add_icosphere(
                    name, size, _MARKER_COLOUR, cast_shadow=False, receive_shadow=False, opacity=0.8, visible=False
                )
            )
        self._put_marker()

    def show(self, shown: bool) -> None:
        """Show or hide them."""
        self._shown = shown
        for _, node in self._nodes:
            node.visible = shown
        self._put_marker()

    def show_until(self, last: int) -> None:
        """Show those that have appeared."""
        self._last = last
        for k, node in self._nodes:
            views = self._drawing.parts[k].views
            seen = self._drawing.rank[views] <= last
            node.batched_scales = np.where(seen, self._sizes[views], _GONE).astype(np.float32)
        self._put_marker()

    def _put_marker(self) -> None:
        """Mark where the camera is at the moment."""
        view = int(self._drawing.order[self._last])
        inside = self._drawing.part_of(view)
        for k, marker in enumerate(self._markers):
            marker.visible = self._shown and k == inside
        self._markers[inside].position = self._drawing.shown_center(view)


def nearest_to_ray(drawing: Drawing, part: int, event: Any) -> int:
    """Find the view of a part whose centre is nearest, as an angle, to the ray of a click."""
    index = event.instance_index
    views = drawing.parts[part].views
    if index is not None and 0 <= index < len(views):
        return int(views[index])
    offset = np.asarray(drawing.server.scene.get_handle_by_name(f"/parts/{part}").position)
    to_view = drawing.centers(part) + offset - np.asarray(event.ray_origin)
    distance = np.maximum(np.linalg.norm(to_view, axis=1), 1e-12)
    return int(views[int(np.argmax(to_view @ np.asarray(event.ray_direction) / distance))])


class Pictures:
    """Panoramas on the insides of spheres about some views; from outside one looks through the near half.

    Reading pictures takes time: a thread does it, and ends when it is done or the viewer is closed.
    """

    def __init__(self, drawing: Drawing, clicked: Callable[[Any, int], None], failed: Callable[[str], None]) -> None:
        self._drawing, self._clicked, self._failed = drawing, clicked, failed
        having = [view for view in drawing.order.tolist() if drawing.content.images[view] is not None]
        self.total = len(having)
        self.views = [having[k] for k in spread(len(having), MOST_PICTURES)] if drawing.content.scene.d == 3 else []
        self._nodes: dict[int, Any] = {}
        self._shown, self._last = True, len(drawing.order) - 1
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._load, name="panopath pictures", daemon=True)
        self._thread.start()

    def name(self, view: int) -> str:
        """Name of the node of a view's picture."""
        return self._drawing.node(self._drawing.part_of(view), f"pictures/{view}")

    def has(self, view: int) -> bool:
        """Whether the view's picture is shown on its sphere."""
        return view in self._nodes

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait until all pictures are there."""
        self._thread.join(timeout_s)

    def close(self) -> None:
        """End the reading."""
        self._stop.set()
        self._thread.join()

    def _load(self) -> None:
        sphere = panorama_sphere(48, 24)
        for view in self.views:
            if self._stop.is_set():
                return
            try:
                jpeg = self._drawing.content.panorama(view, _PICTURE_PX)
            except InputError as error:
                self._failed(str(error))
                continue
            with self._lock:
                node = add_panorama(
                    self._drawing,
                    self._drawing.server.scene,
                    self.name(view),
                    view,
                    textured(sphere, jpeg, is_small=True),
                )
                node.scale = 2.5 * self._drawing.radius
                node.visible = self._visible(view)
                node.on_click(lambda event, view=view: self._clicked(event.client, view))
                self._nodes[view] = node

    def _visible(self, view: int) -> bool:
        return bool(self._shown and self._drawing.rank[view] <= self._last)

    def show(self, shown: bool) -> None:
        """Show or hide them."""
        self._shown = shown
        self.show_until(self._last)

    def show_until(self, last: int) -> None:
        """Show those that have appeared."""
        with self._lock:
            self._last = last
            for view, node in self._nodes.items():
                node.visible = self._visible(view)


def add_panorama(drawing: Drawing, scene: Any, name: str, view: int, glb: bytes) -> Any:
    """Add a view's panorama on a unit sphere about its centre, turned as the camera was."""
    return scene.add_glb(
        name,
        glb,
        wxyz=quaternion_from_rotation(world_from_cam(drawing.content.scene)[[view]])[0],
        position=drawing.shown_center(view),
        cast_shadow=False,
        receive_shadow=False,
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """Ellipsoids of some views or points of a part."""

    part: int
    kind: str
    members: Ids
    #: (n, 3) half-axes as long as the scene is shown, and (n, 4) how they are turned.
    half: Float
    turn: Float


class Ellipsoids:
    """Uncertainty of views and points, found when it is first asked for."""

    def __init__(self, drawing: Drawing) -> None:
        self._drawing, self._shown, self._last = drawing, False, len(drawing.order) - 1
        #: By how much they are enlarged.
        self.factor = 1.0
        #: What a person should know of them; empty before they are found.
        self.note = ""
        self._made: list[tuple[Any, Float, Ids | None]] | None = None
        self._lock = threading.Lock()

    def show(self, shown: bool) -> None:
        """Show or hide them; the first time they are found."""
        with self._lock:
            self._shown = shown
            if shown and self._made is None:
                self._make()
            for node, _, _ in self._made or ():
                node.visible = shown

    def show_until(self, last: int) -> None:
        """Show those that have appeared."""
        with self._lock:
            self._last = last
            self._scale()

    def enlarge(self, factor: float) -> None:
        """Show them this many times as large."""
        with self._lock:
            self.factor = factor
            self._scale()

    def _make(self) -> None:
        self._made = []
        try:
            views, points = self._drawing.content.covariances()
        except InputError as error:
            self.note = f"No uncertainty to show: {error}."
            return
        found = []
        for kind, covariance in (("view", views), ("point", points)):
            for k, part in enumerate(self._drawing.parts):
                members = part.views if kind == "view" else part.points
                known = members[np.isfinite(covariance[members]).all(axis=(1, 2))]
                most = max(1, round(MOST_ELLIPSOIDS * len(known) / max(1, self._total(kind, covariance))))
                chosen = known[spread(len(known), most)]
                if len(chosen):
                    half, turn = ellipsoids(covariance[chosen])
                    found.append(_Found(k, kind, chosen, part.scale * half, turn))
        self._choose_factor([one.half for one in found])
        self._made = [self._add(one) for one in found]
        self._scale()
        self._tell(found, views, points)

    def _total(self, kind: str, covariance: Float) -> int:
        solved = (
            self._drawing.content.scene.view_component
            if kind == "view"
            else self._drawing.content.scene.track_component
        )
        return int((np.isfinite(covariance).all(axis=(1, 2)) & (solved >= 0)).sum())

    def _choose_factor(self, axes: Sequence[Float]) -> None:
        longest = np.concatenate([half.max(axis=1) for half in axes]) if axes else np.ones(1)
        middle = float(np.median(longest))
        self.factor = round_factor(0.01 * REACH / middle) if middle > 0.0 else 1.0

    def _add(self, found: _Found) -> tuple[Any, Float, Ids | None]:
        content, part, mesh = self._drawing.content, self._drawing.parts[found.part], ball(2)
        is_view = found.kind == "view"
        places = content.scene.centers if is_view else content.scene.points
        node = self._drawing.server.scene.add_batched_meshes_simple(
            self._drawing.node(found.part, f"uncertainty of {found.kind}s"),
            mesh.vertices,
            mesh.faces,
            found.turn,
            part.shown(places[found.members]),
            batched_scales=shown_axes(found.half, self.factor, _LONGEST).astype(np.float32),
            batched_colors=np.array((110, 40, 200) if is_view else (225, 110, 0), dtype=np.uint8),
            opacity=0.45,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )
        return node, found.half, self._drawing.rank[found.members] if is_view else None

    def _scale(self) -> None:
        for node, half, since in self._made or ():
            scales = shown_axes(half, self.factor, _LONGEST)
            if since is not None:
                scales[since > self._last] = _GONE
            node.batched_scales = np.maximum(scales, _GONE).astype(np.float32)

    def _tell(self, found: Sequence[_Found], views: Float, points: Float) -> None:
        counts = {kind: sum(len(one.members) for one in found if one.kind == kind) for kind in ("view", "point")}
        totals = {"view": self._total("view", views), "point": self._total("point", points)}
        shown = " and ".join(f"{counts[kind]:,} of {totals[kind]:,} {kind}s" for kind in counts)
        self.note = f"One standard deviation, enlarged; {shown}. None is drawn longer than a fifth of the scene."


def _marker_radius(content: Content, parts: Sequence[Part], order: Ids) -> float:
    """Choose a share of the usual step from view to view, within what can be seen."""
    place = {int(view): part.shown(content.scene.centers[[view]])[0] for part in parts for view in part.views}
    known = [place[int(view)] for view in order]
    steps = np.linalg.norm(np.diff(np.array(known), axis=0), axis=1) if len(known) > 1 else np.zeros(0)
    moving: npt.NDArray[np.float64] = steps[steps > 1e-9]
    return float(np.clip(0.15 * np.median(moving), 0.015, 0.06)) if len(moving) else 0.06
