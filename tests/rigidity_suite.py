"""More than a thousand configurations of views and points whose ambiguity is known exactly.

Positions are fractions, so the truth (nullity, rigid components) is found without rounding; see ``exact_rigidity``.
Only then does a configuration get a random pose, a random size and floating-point numbers. A family says what its
construction must lead to, which checks the theory: a member that turns out otherwise by chance is drawn again, a family
that does so always is an error.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, partial
from itertools import combinations, product
from random import Random

import numpy as np
import panopath as pp
from exact_rigidity import Members, Position, Ray, exact_rigidity, gauge_freedoms, turn_generators
from panopath.certificate import CauseKind, Certificate, OrientationModel, Verdict
from panopath.formats.structure import known_scene
from panopath.model import Float, Int

#: A singular value of the float matrix below this share of the largest, yet not zero, is no fair question.
LEAST_SINGULAR = 1e-7
#: Draws of one member before its family is in doubt.
MOST_DRAWS = 60


@dataclass(frozen=True, eq=False)
class Configuration:
    """Views and points in some pose, who sees whom, and the exact truth."""

    name: str
    family: str
    d: int
    orientation: OrientationModel
    #: (m, d) and (n, d).
    centers: Float
    points: Float
    #: (m, 3, 3), (m,) headings in the plane, or None where bearings are world directions.
    cam_from_world: Float | None
    #: (N,) each.
    view: Int
    track: Int
    nullity: int
    gauge_freedoms: int
    #: Views and points of each rigid component of two observations or more.
    components: tuple[Members, ...]
    #: One of these is to be named; empty where the construction has no single name.
    causes: frozenset[CauseKind]

    @property
    def ambiguous(self) -> bool:
        """Whether other scenes, not similar to this one, have the same bearings to first order."""
        return self.nullity > self.gauge_freedoms

    def directions(self) -> Float:
        """(N, d) unit vectors from views to points, in the world."""
        ray = self.points[self.track] - self.centers[self.view]
        unit: Float = ray / np.linalg.norm(ray, axis=1, keepdims=True)
        return unit


class RedrawError(Exception):
    """This draw is not what the family is about."""


class Drawing:
    """A configuration under construction."""

    def __init__(self) -> None:
        self.views: list[Position] = []
        self.points: list[Position] = []
        self.rays: list[Ray] = []
        #: Whether it must come out ambiguous; None: whatever comes out.
        self.ambiguous: bool | None = None
        #: Freedoms beyond the gauge that it must come out with; None: whatever comes out.
        self.extra: int | None = None
        self.causes: set[CauseKind] = set()

    def add_views(self, positions: list[Position]) -> list[int]:
        self.views += positions
        return list(range(len(self.views) - len(positions), len(self.views)))

    def add_points(self, positions: list[Position]) -> list[int]:
        self.points += positions
        return list(range(len(self.points) - len(positions), len(self.points)))

    def see(self, rays: Iterator[Ray] | list[Ray]) -> None:
        """Add observations; those that are there already stay single."""
        known = set(self.rays)
        for i, j in rays:
            if self.views[i] == self.points[j]:
                raise RedrawError
            if (i, j) not in known:
                known.add((i, j))
                self.rays.append((i, j))

    def see_all(self) -> Drawing:
        self.see(product(range(len(self.views)), range(len(self.points))))
        return self

    def expect(self, extra: int | None, *causes: CauseKind) -> Drawing:
        self.extra, self.causes = extra, set(causes)
        self.ambiguous = None if extra is None else extra > 0
        return self

    def expect_ambiguous(self, *causes: CauseKind) -> Drawing:
        self.ambiguous, self.causes = True, set(causes)
        return self

    def exchanged(self) -> Drawing:
        """Views as points and points as views: the same equations where orientations are known."""
        other = Drawing()
        other.views, other.points, other.rays = self.points, self.views, [(j, i) for i, j in self.rays]
        other.extra, other.ambiguous, other.causes = self.extra, self.ambiguous, self.causes
        return other


Build = Callable[[Random, int, OrientationModel], Drawing]

# --- positions


def anywhere(rng: Random, d: int, count: int, size: int = 20) -> list[Position]:
    """Different whole-numbered positions."""
    found: list[Position] = []
    while len(found) < count:
        position = tuple(Fraction(rng.randint(-size, size)) for _ in range(d))
        if position not in found:
            found.append(position)
    return found


def numbers(rng: Random, count: int, size: int = 12, without: tuple[int, ...] = ()) -> list[Fraction]:
    """Different whole numbers."""
    return [Fraction(x) for x in rng.sample([x for x in range(-size, size + 1) if x not in without], count)]


def parameters(rng: Random, count: int) -> list[Fraction]:
    """Different fractions that are neither zero nor large, for curves that are rational."""
    pool = sorted({Fraction(s * a, b) for s in (-1, 1) for a in range(1, 6) for b in range(1, 6)})
    return rng.sample(pool, count)


def mapped(rng: Random, d: int, planar: list[Position], similar: bool = False) -> list[Position]:
    """A random affine image of planar positions: in the plane (a similar one if asked for), or in a plane of space."""
    origin, a, b = anywhere(rng, d, 3, size=5)
    if similar:
        b = (-a[1], a[0])
    if all(a[i] * b[k] == a[k] * b[i] for i, k in combinations(range(d), 2)):
        raise RedrawError
    return [tuple(o + x * p + y * q for o, p, q in zip(origin, a, b, strict=True)) for x, y in planar]


def along(a: Position, b: Position, t: Fraction) -> Position:
    """The position a + t (b - a)."""
    return tuple(x + t * (y - x) for x, y in zip(a, b, strict=True))


CURVES: dict[str, Callable[[Fraction], Position]] = {
    "circle": lambda t: ((1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)),
    "ellipse": lambda t: ((1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)),
    "parabola": lambda t: (t, t * t),
    "hyperbola": lambda t: (t, 1 / t),
}


def on_conic(rng: Random, d: int, curve: str, count: int) -> list[Position]:
    return mapped(rng, d, [CURVES[curve](t) for t in parameters(rng, count)], similar=curve == "circle")


# --- visibility


def least_observations(m: int, n: int, d: int, orientation: OrientationModel) -> int:
    """The counting bound: the fewest observations with as many equations as unknowns less gauge."""
    unknowns = d * (m + n) + m * len(turn_generators(d, orientation)) - gauge_freedoms(d, orientation)
    return -(-unknowns // (d - 1))


def connected(rng: Random, m: int, n: int, count: int) -> list[Ray]:
    """A random connected choice of observations, every view and point in it."""
    joined, waiting = (
        [("view", 0), ("point", 0)],
        [("view", i) for i in range(1, m)] + [("point", j) for j in range(1, n)],
    )
    rays = {(0, 0)}
    rng.shuffle(waiting)
    for kind, index in waiting:
        other = rng.choice([member for other, member in joined if other != kind])
        rays.add((index, other) if kind == "view" else (other, index))
        joined.append((kind, index))
    rest = [ray for ray in product(range(m), range(n)) if ray not in rays]
    return sorted(rays) + rng.sample(rest, max(0, min(count - len(rays), len(rest))))


#: Views and points of a small full configuration that is determined.
BLOCK: dict[tuple[int, OrientationModel], tuple[int, int]] = {
    (2, "known"): (3, 3),
    (3, "known"): (2, 2),
    (2, "free"): (4, 4),
    (3, "free"): (3, 4),
    (3, "vertical"): (3, 3),
}


def add_block(
    drawing: Drawing,
    rng: Random,
    d: int,
    orientation: OrientationModel,
    *,
    views: tuple[int, ...] = (),
    points: tuple[int, ...] = (),
) -> tuple[list[int], list[int]]:
    """Add a determined part, some of whose members are there already."""
    m, n = BLOCK[d, orientation]
    own_views = [*views, *drawing.add_views(anywhere(rng, d, m - len(views)))]
    own_points = [*points, *drawing.add_points(anywhere(rng, d, n - len(points)))]
    drawing.see(product(own_views, own_points))
    return own_views, own_points


# --- families: whatever comes out


def generic_full(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    m, n = rng.randint(2, 12), rng.randint(2, 12)
    drawing = Drawing()
    drawing.add_views(anywhere(rng, d, m))
    drawing.add_points(anywhere(rng, d, n))
    missing = least_observations(m, n, d, orientation) - m * n
    if d == 2 and min(m, n) == 2:
        drawing.causes = {CauseKind.TWO_CAMERAS} if n > 2 else {CauseKind.TWO_CAMERAS, CauseKind.TWO_POINTS}
        drawing.causes = {CauseKind.TWO_POINTS} if m > 2 else drawing.causes
    if orientation != "known":
        drawing.causes |= {CauseKind.TOO_FEW_EQUATIONS}
    if missing > 0:
        drawing.ambiguous = True
    return drawing.see_all()


def generic_partial(rng: Random, d: int, orientation: OrientationModel, beyond: tuple[int, int]) -> Drawing:
    """Random observations, as many as the counting bound plus a number from ``beyond``."""
    m, n = rng.randint(3, 12), rng.randint(3, 12)
    count = least_observations(m, n, d, orientation) + rng.randint(*beyond)
    if not m + n - 1 <= count < m * n:
        raise RedrawError
    drawing = Drawing()
    drawing.add_views(anywhere(rng, d, m))
    drawing.add_points(anywhere(rng, d, n))
    drawing.see(connected(rng, m, n, count))
    if beyond[1] < 0:
        drawing.ambiguous = True
    return drawing


def small_grid(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """Positions on so small a grid that many are collinear or coplanar, in pairs even the same."""
    m, n = rng.randint(2, 7), rng.randint(2, 7)
    drawing = Drawing()
    pick = [Fraction(x) for x in range(4 if d == 2 else 3)]
    drawing.add_views([tuple(rng.choice(pick) for _ in range(d)) for _ in range(m)])
    drawing.add_points([tuple(rng.choice(pick) for _ in range(d)) for _ in range(n)])
    share = rng.choice((0.6, 0.8, 1.0))
    rays = [
        (i, j) for i, j in product(range(m), range(n)) if drawing.views[i] != drawing.points[j] and rng.random() < share
    ]
    if {i for i, _ in rays} != set(range(m)) or {j for _, j in rays} != set(range(n)):
        raise RedrawError
    drawing.see(rays)
    return drawing


def same_place(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """Some views, and some points, stand at the same place."""
    m, n = rng.randint(2, 5), rng.randint(2, 5)
    drawing = Drawing()
    views, points = anywhere(rng, d, m), anywhere(rng, d, n)
    drawing.add_views(views + rng.choices(views, k=rng.randint(1, 3)))
    drawing.add_points(points + rng.choices(points, k=rng.randint(0, 2)))
    return drawing.see_all()


# --- families: too few views or points


def one_camera(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    drawing = Drawing()
    drawing.add_views(anywhere(rng, d, 1))
    drawing.add_points(anywhere(rng, d, rng.randint(2, 12)))
    return drawing.see_all().expect_ambiguous(CauseKind.ONE_CAMERA)


def two_cameras(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """In the plane: one view may go anywhere, and each point to where its two rays meet then."""
    drawing = Drawing()
    n = rng.randint(3, 12)
    drawing.add_views(anywhere(rng, d, 2))
    drawing.add_points(anywhere(rng, d, n))
    extra = 1 if orientation == "known" else None
    drawing.see_all().expect(extra, CauseKind.TWO_CAMERAS)
    drawing.ambiguous = True
    return drawing


def two_points(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    if orientation == "known":
        drawing = two_cameras(rng, d, orientation).exchanged()
        return drawing.expect(drawing.extra, CauseKind.TWO_POINTS)
    drawing = Drawing()
    drawing.add_views(anywhere(rng, d, rng.randint(3, 12)))
    drawing.add_points(anywhere(rng, d, 2))
    return drawing.see_all().expect_ambiguous(CauseKind.TWO_POINTS, CauseKind.TOO_FEW_EQUATIONS)


def ring(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """Views and points in turn around a ring, each seen from its two neighbours only."""
    k = rng.randint(3, 8)
    drawing = Drawing()
    drawing.add_views(anywhere(rng, d, k))
    drawing.add_points(anywhere(rng, d, k))
    drawing.see([(i, j % k) for i in range(k) for j in (i, i + 1)])
    return drawing.expect(2 * k - 3 if d == 2 else 2 * k - 4, CauseKind.TOO_FEW_EQUATIONS)


def coplanar_two_by_two(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    drawing = Drawing()
    positions = mapped(rng, 3, anywhere(rng, 2, 4))
    drawing.add_views(positions[:2])
    drawing.add_points(positions[2:])
    return drawing.see_all().expect(1, CauseKind.COPLANAR_TWO_BY_TWO)


def coplanar_two_by_many(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    drawing = Drawing()
    positions = mapped(rng, 3, anywhere(rng, 2, 2 + rng.randint(3, 8)))
    drawing.add_views(positions[:2])
    drawing.add_points(positions[2:])
    drawing.see_all().expect(1, CauseKind.TWO_CAMERAS, CauseKind.COPLANAR_TWO_BY_TWO)
    if rng.random() < 0.5:
        return drawing
    return drawing.exchanged().expect(1, CauseKind.TWO_POINTS, CauseKind.COPLANAR_TWO_BY_TWO)


def two_by_two(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    drawing = Drawing()
    drawing.add_views(anywhere(rng, 3, 2))
    drawing.add_points(anywhere(rng, 3, 2))
    return drawing.see_all().expect(0)


# --- families: lines


def camera_collinear(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """All views on one line, and one point or two on it as well."""
    drawing, sliding = Drawing(), rng.randint(1, 2)
    a, b = anywhere(rng, d, 2)
    least = 3 if orientation == "known" else 5
    on_line = [along(a, b, t / 4) for t in numbers(rng, rng.randint(least, 6) + sliding)]
    drawing.add_points(on_line[:sliding] + anywhere(rng, d, rng.randint(least, 6)))
    drawing.add_views(on_line[sliding:])
    return drawing.see_all().expect(sliding, CauseKind.CAMERA_COLLINEAR)


def camera_collinear_track(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """A point that is seen only from views on one line with it."""
    drawing = Drawing()
    views, _ = add_block(drawing, rng, d, orientation)
    drawing.see(product(views, drawing.add_points(anywhere(rng, d, rng.randint(0, 4)))))
    i, k = rng.sample(views, 2)
    t = rng.choice((Fraction(-1), Fraction(1, 3), Fraction(1, 2), Fraction(5, 2)))
    sliding = drawing.add_points([along(drawing.views[i], drawing.views[k], t)])
    drawing.see(product((i, k), sliding))
    return drawing.expect(1, CauseKind.CAMERA_COLLINEAR)


def point_collinear(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """All points on one line, and one view or two on it as well."""
    drawing = camera_collinear(rng, d, orientation).exchanged()
    return drawing.expect(drawing.extra if orientation == "known" else None, CauseKind.POINT_COLLINEAR)


def point_collinear_view(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """A view that sees only points on one line with it."""
    drawing = Drawing()
    _, points = add_block(drawing, rng, d, orientation)
    drawing.see(product(drawing.add_views(anywhere(rng, d, rng.randint(0, 4))), points))
    i, k = rng.sample(points, 2)
    t = rng.choice((Fraction(-1), Fraction(1, 3), Fraction(1, 2), Fraction(5, 2)))
    sliding = drawing.add_views([along(drawing.points[i], drawing.points[k], t)])
    drawing.see(product(sliding, (i, k)))
    # in space an unknown orientation may also turn about the line
    return drawing.expect(2 if d == 3 and orientation == "free" else 1, CauseKind.POINT_COLLINEAR)


def two_lines(rng: Random, first: tuple[int, int], second: tuple[int, int], d: int = 2) -> Drawing:
    """So many views and points on one line, so many on another, which it crosses or is parallel to."""
    drawing = Drawing()
    s, t = numbers(rng, sum(first), without=(0,)), numbers(rng, sum(second), without=(0,))
    lower = [(x, Fraction(0)) for x in s]
    upper = [(Fraction(0), x) for x in t] if rng.random() < 0.6 else [(x, Fraction(6)) for x in t]
    positions = mapped(rng, d, [(x / 6, y / 6) for x, y in lower + upper])
    upper_views = sum(first) + second[0]
    drawing.add_views(positions[: first[0]] + positions[sum(first) : upper_views])
    drawing.add_points(positions[first[0] : sum(first)] + positions[upper_views:])
    return drawing.see_all()


def two_lines_1(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """All views on one line, all points on another."""
    drawing = two_lines(rng, (rng.randint(3, 8), 0), (0, rng.randint(3, 8)), d)
    return drawing.expect_ambiguous(CauseKind.TWO_LINES_1)


def two_lines_2(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """Views and points on both lines."""
    counts = [rng.randint(1, 5) for _ in range(4)]
    if counts[0] + counts[2] < 3 or counts[1] + counts[3] < 3:
        raise RedrawError
    drawing = two_lines(rng, (counts[0], counts[1]), (counts[2], counts[3]), d)
    return drawing.expect(1, CauseKind.TWO_LINES_2)


def skew_lines(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """All views on one line and all points on another, the two not in one plane: determined."""
    a, b, c, e = anywhere(rng, 3, 4)
    drawing = Drawing()
    drawing.add_views([along(a, b, t / 6) for t in numbers(rng, rng.randint(2, 6))])
    drawing.add_points([along(c, e, t / 6) for t in numbers(rng, rng.randint(2, 6))])
    return drawing.see_all().expect(0)


def all_on_one_line(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    a, b = anywhere(rng, d, 2)
    m, n = rng.randint(2, 6), rng.randint(2, 6)
    positions = [along(a, b, t / 6) for t in numbers(rng, m + n)]
    drawing = Drawing()
    drawing.add_views(positions[:m])
    drawing.add_points(positions[m:])
    drawing.see_all().expect_ambiguous(CauseKind.CAMERA_COLLINEAR, CauseKind.POINT_COLLINEAR)
    if orientation == "known":
        # all slide, and what lies across is common to all
        drawing.extra = m + n - 2
    return drawing


# --- families: conics


def conic(
    rng: Random, d: int, orientation: OrientationModel, curve: str, size: tuple[int, int] | None = None
) -> Drawing:
    """All views and all points on one conic."""
    m, n = (rng.randint(3, 10), rng.randint(3, 10)) if size is None else size
    positions = on_conic(rng, d, curve, m + n)
    drawing = Drawing()
    drawing.add_views(positions[:m])
    drawing.add_points(positions[m:])
    drawing.see_all()
    # free orientations have conditions of their own
    return drawing.expect(1, CauseKind.CONIC) if orientation == "known" else drawing


def conic_partial(rng: Random, d: int, orientation: OrientationModel, curve: str) -> Drawing:
    """On a conic, and some rays hidden: what could be drawn again still can be."""
    drawing = conic(rng, d, orientation, curve, (rng.randint(4, 7), rng.randint(4, 7)))
    for ray in rng.sample(drawing.rays, rng.randint(1, 4)):
        drawing.rays.remove(ray)
    drawing.extra = None
    return drawing.expect_ambiguous()


def conic_near_miss(rng: Random, d: int, orientation: OrientationModel, curve: str) -> Drawing:
    """All on a conic but for one view or point."""
    m, n = rng.randint(3, 7), rng.randint(3, 7)
    positions = on_conic(rng, d, curve, m + n)
    (off,) = anywhere(rng, d, 1)
    positions[rng.randrange(m + n)] = along(positions[0], off, Fraction(1, 2))
    drawing = Drawing()
    drawing.add_views(positions[:m])
    drawing.add_points(positions[m:])
    return drawing.see_all().expect(0)


def conic_within(rng: Random, d: int, orientation: OrientationModel, curve: str) -> Drawing:
    """Three views and three points on a conic, more of both elsewhere, all seen: determined."""
    positions = on_conic(rng, d, curve, 6)
    drawing = Drawing()
    drawing.add_views(positions[:3] + anywhere(rng, d, rng.randint(1, 4), size=12))
    drawing.add_points(positions[3:] + anywhere(rng, d, rng.randint(1, 4), size=12))
    return drawing.see_all().expect(0)


def moving_off(rng: Random, d: int, orientation: OrientationModel, step: Fraction) -> Drawing:
    """Four by four on an ellipse, and one point a given part of the way to a position elsewhere."""
    positions = on_conic(rng, d, "ellipse", 8)
    positions[-1] = along(positions[-1], anywhere(rng, d, 1)[0], step)
    drawing = Drawing()
    drawing.add_views(positions[:4])
    drawing.add_points(positions[4:])
    return drawing.see_all().expect(0) if step else drawing.see_all().expect(1, CauseKind.CONIC)


def cylinder(rng: Random, d: int, orientation: OrientationModel, curve: str) -> Drawing:
    """Above a conic at heights of their own: seen from above ambiguous, in space determined."""
    m, n = rng.randint(3, 8), rng.randint(3, 8)
    below = on_conic(rng, 2, curve, m + n)
    positions = [(*position, Fraction(rng.randint(-8, 8))) for position in below]
    drawing = Drawing()
    drawing.add_views(positions[:m])
    drawing.add_points(positions[m:])
    return drawing.see_all().expect(0)


def coplanar(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """In one plane of space, otherwise anywhere: determined."""
    m, n = rng.randint(3, 7), rng.randint(3, 7)
    positions = mapped(rng, 3, anywhere(rng, 2, m + n))
    drawing = Drawing()
    drawing.add_views(positions[:m])
    drawing.add_points(positions[m:])
    return drawing.see_all().expect(0)


# --- families: members that hang loose


def hidden_point(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """A point that one view sees, with or without other points that all see."""
    drawing = Drawing()
    views, _ = add_block(drawing, rng, d, orientation)
    drawing.see(product(views, drawing.add_points(anywhere(rng, d, rng.randint(0, 4)))))
    hidden = drawing.add_points(anywhere(rng, d, rng.randint(1, 3)))
    drawing.see([(rng.choice(views), j) for j in hidden])
    return drawing.expect(len(hidden), CauseKind.HIDDEN_POINT)


def hidden_view(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """A view that sees one point."""
    drawing = Drawing()
    _, points = add_block(drawing, rng, d, orientation)
    drawing.see(product(drawing.add_views(anywhere(rng, d, rng.randint(0, 4))), points))
    (hidden,) = drawing.add_views(anywhere(rng, d, 1))
    drawing.see([(hidden, rng.choice(points))])
    turns = len(turn_generators(d, orientation))
    return drawing.expect(1 + turns, CauseKind.HIDDEN_POINT)


def minimal_views(rng: Random, d: int, orientation: OrientationModel, missing: int = 0) -> Drawing:
    """A determined part, views that see just enough of its points (one of them one too few), points of two views."""
    drawing = Drawing()
    views, points = add_block(drawing, rng, d, orientation)
    points += drawing.add_points(anywhere(rng, d, 3))
    drawing.see(product(views, points))
    needed = {(2, "free"): 3, (3, "free"): 3}.get((d, orientation), 2)
    for i in drawing.add_views(anywhere(rng, d, rng.randint(1, 4))):
        drawing.see([(i, j) for j in rng.sample(points, needed)])
    for j in drawing.add_points(anywhere(rng, d, rng.randint(0, 3))):
        drawing.see([(i, j) for i in rng.sample(views, 2)])
    if not missing:
        return drawing.expect(0)
    (few,) = drawing.add_views(anywhere(rng, d, 1))
    drawing.see([(few, j) for j in rng.sample(points, needed - 1)])
    equations = (d - 1) * (needed - 1)
    causes = {CauseKind.HIDDEN_POINT} if needed == 2 else {CauseKind.TOO_FEW_EQUATIONS, CauseKind.WEAK_JOIN}
    return drawing.expect(d + len(turn_generators(d, orientation)) - equations, *causes)


def danger_circle(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """A view of unknown orientation that sees three points from their circle, or from the cylinder above it."""
    drawing = Drawing()
    four = on_conic(rng, 2, "circle", 4)
    if d == 3:
        four = [(*position, Fraction(0)) for position in four]
        four[0] = (*four[0][:2], Fraction(rng.choice((-5, -3, 2, 4))))
    seen = drawing.add_points(four[1:])
    add_block(drawing, rng, d, orientation, points=tuple(seen))
    drawing.see(product(drawing.add_views(four[:1]), seen))
    return drawing.expect(1)


# --- families: parts


def disconnected(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    drawing = Drawing()
    parts = rng.randint(2, 3 if 3 * BLOCK[d, orientation][0] <= 9 else 2)
    for _ in range(parts):
        add_block(drawing, rng, d, orientation)
    return drawing.expect((parts - 1) * gauge_freedoms(d, orientation), CauseKind.DISCONNECTED)


def hinge_at_view(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    drawing = Drawing()
    views, _ = add_block(drawing, rng, d, orientation)
    drawing.see(product(views, drawing.add_points(anywhere(rng, d, rng.randint(0, 2)))))
    add_block(drawing, rng, d, orientation, views=(rng.choice(views),))
    return drawing.expect(1, CauseKind.WEAK_JOIN)


def hinge_at_point(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    drawing = Drawing()
    _, points = add_block(drawing, rng, d, orientation)
    drawing.see(product(drawing.add_views(anywhere(rng, d, rng.randint(0, 2))), points))
    add_block(drawing, rng, d, orientation, points=(rng.choice(points),))
    return drawing.expect(1 + len(turn_generators(d, orientation)), CauseKind.WEAK_JOIN)


def windows(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """A sequence whose tracks all end, and others start, at the same view, again and again."""
    drawing = Drawing()
    views, _ = add_block(drawing, rng, d, orientation)
    count = rng.randint(2, 12 // BLOCK[d, orientation][1])
    for _ in range(count - 1):
        views, _ = add_block(drawing, rng, d, orientation, views=(views[-1],))
    return drawing.expect(count - 1, CauseKind.WEAK_JOIN)


def joined(rng: Random, d: int, orientation: OrientationModel, tracks: int, rays: int) -> Drawing:
    """Two determined parts, and what holds them: tracks that one view of each sees, rays from one part to the other.

    Whatever is known of orientations, a track is one equation in space and none in the plane, a ray is d - 1.
    """
    drawing = Drawing()
    parts = [add_block(drawing, rng, d, orientation) for _ in range(2)]
    pairs = list(product(parts[0][0], parts[1][0]))
    rng.shuffle(pairs)
    for k, j in enumerate(drawing.add_points(anywhere(rng, d, tracks))):
        drawing.see([(i, j) for i in pairs[k % len(pairs)]])
    for k in range(rays):
        views, points = parts[k % 2][0], parts[1 - k % 2][1]
        drawing.see([(views[k // 2 % len(views)], points[k // 2 % len(points)])])
    missing = gauge_freedoms(d, orientation) - (d - 2) * tracks - (d - 1) * rays
    return drawing.expect(max(0, missing), CauseKind.WEAK_JOIN)


def desargues(rng: Random, d: int, orientation: OrientationModel, miss: bool = False) -> Drawing:
    """Two parts joined by rays enough, which all pass through one position: one part may grow about it (or may not)."""
    drawing = Drawing()
    (middle,) = anywhere(rng, d, 1)
    views, _ = add_block(drawing, rng, d, orientation)
    rays = 3 if d == 2 else 2
    ends = [along(drawing.views[i], middle, Fraction(rng.choice((2, 3)), rng.choice((1, 2, 4)))) for i in views[:rays]]
    if any(end == middle for end in ends):
        raise RedrawError
    if miss:
        ends[0] = along(ends[0], anywhere(rng, d, 1)[0], Fraction(1, 2))
    far = drawing.add_points(ends)
    add_block(drawing, rng, d, orientation, points=tuple(far))
    drawing.see(list(zip(views[:rays], far, strict=True)))
    return drawing.expect(0) if miss else drawing.expect(1, CauseKind.WEAK_JOIN, CauseKind.OTHER)


def sliding_joint(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """Two parts held by points on the line between a view of each: the parts are one, though the points slide.

    No ray of one part ends in the other, and the points between belong to neither.
    """
    drawing = Drawing()
    first, _ = add_block(drawing, rng, d, orientation)
    second, _ = add_block(drawing, rng, d, orientation)
    joints = 3 if d == 2 else 2
    for i, k in zip(first[:joints], second[:joints], strict=True):
        t = Fraction(rng.choice((-2, 1, 2, 3, 5)), 4)
        drawing.see(product((i, k), drawing.add_points([along(drawing.views[i], drawing.views[k], t)])))
    return drawing.expect(joints, CauseKind.CAMERA_COLLINEAR)


def critical_quadric(rng: Random, d: int, orientation: OrientationModel) -> Drawing:
    """Two views of unknown orientation, all points on a quadric through both: (b x X) . (v + w x (X - b)) = 0.

    The second view, at b, moves by v and turns by w; each point stays on its ray from the first view, at 0, and on the
    turned ray of the second.
    """
    b, v, w = anywhere(rng, 3, 3, size=6)
    if orientation == "vertical":
        w = (Fraction(0), Fraction(0), w[2] or Fraction(1))
    drawing = Drawing()
    drawing.add_views([(Fraction(0),) * 3, b])
    for ray in anywhere(rng, 3, rng.randint(7, 12), size=6):
        normal = cross(b, ray)
        below, above = inner(normal, cross(w, ray)), inner(normal, cross(w, b)) - inner(normal, v)
        if below == 0 or above == 0 or abs(above / below) > 5 or abs(above / below) < Fraction(1, 5):
            continue
        drawing.add_points([tuple(above / below * x for x in ray)])
    if len(drawing.points) < (5 if orientation == "free" else 3):
        raise RedrawError
    return drawing.see_all().expect(1)


def cross(a: Position, b: Position) -> Position:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def inner(a: Position, b: Position) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


# --- the suite

Model = tuple[int, OrientationModel]
PLANE: Model = (2, "known")
SPACE: Model = (3, "known")
FREE_PLANE: Model = (2, "free")
FREE_SPACE: Model = (3, "free")
VERTICAL: Model = (3, "vertical")
KNOWN = (PLANE, SPACE)
ALL = (*KNOWN, FREE_PLANE, FREE_SPACE, VERTICAL)


def families() -> Iterator[tuple[str, Build, tuple[Model, ...], int]]:
    """Name, construction, models, and how many of each model."""
    yield "generic full", generic_full, ALL, 20
    yield "generic partial, below the bound", partial(generic_partial, beyond=(-4, -1)), ALL, 10
    yield "generic partial, at the bound", partial(generic_partial, beyond=(0, 0)), ALL, 14
    yield "generic partial, above the bound", partial(generic_partial, beyond=(1, 8)), ALL, 14
    yield "small grid", small_grid, ALL, 24
    yield "same place", same_place, ALL, 6
    yield "one camera", one_camera, ALL, 3
    yield "two cameras", two_cameras, (PLANE, FREE_PLANE), 8
    yield "two points", two_points, (PLANE, FREE_PLANE), 8
    yield "ring", ring, KNOWN, 6
    yield "coplanar two by two", coplanar_two_by_two, (SPACE,), 12
    yield "coplanar two by many", coplanar_two_by_many, (SPACE,), 8
    yield "two by two in space", two_by_two, (SPACE,), 10
    yield "camera collinear", camera_collinear, KNOWN, 10
    yield "camera collinear track", camera_collinear_track, ALL, 6
    yield "point collinear", point_collinear, KNOWN, 10
    yield "point collinear view", point_collinear_view, ALL, 6
    yield "two lines I", two_lines_1, KNOWN, 12
    yield "two lines II", two_lines_2, KNOWN, 12
    yield "skew lines", skew_lines, (SPACE,), 8
    yield "all on one line", all_on_one_line, ALL, 5
    for curve in CURVES:
        for size in (3, 4, 10):
            yield f"{curve} {size}x{size}", partial(conic, curve=curve, size=(size, size)), (PLANE,), 4
        yield curve, partial(conic, curve=curve), (PLANE,), 6
        if curve != "circle":
            yield f"{curve} in a plane of space", partial(conic, curve=curve), (SPACE,), 5
        yield f"{curve}, unknown orientation", partial(conic, curve=curve), (FREE_PLANE,), 3
        yield f"{curve}, partly seen", partial(conic_partial, curve=curve), (PLANE,), 5
        yield f"{curve}, one member off", partial(conic_near_miss, curve=curve), (PLANE,), 6
        yield f"{curve} within", partial(conic_within, curve=curve), (PLANE,), 4
        yield f"{curve}, cylinder", partial(cylinder, curve=curve), (SPACE,), 6
    for step in (Fraction(0), Fraction(1, 16), Fraction(1, 8), Fraction(1, 4), Fraction(1, 2), Fraction(1)):
        yield f"moving off an ellipse, {step}", partial(moving_off, step=step), (PLANE,), 3
    yield "coplanar in space", coplanar, (SPACE,), 8
    yield "hidden point", hidden_point, ALL, 6
    yield "hidden view", hidden_view, ALL, 5
    yield "minimal views", minimal_views, ALL, 6
    yield "one view below the minimum", partial(minimal_views, missing=1), ALL, 5
    yield "danger circle", danger_circle, (FREE_PLANE, FREE_SPACE), 8
    yield "critical quadric", critical_quadric, (FREE_SPACE, VERTICAL), 8
    yield "disconnected", disconnected, ALL, 4
    yield "hinge at a view", hinge_at_view, ALL, 6
    yield "hinge at a point", hinge_at_point, ALL, 6
    yield "windows", windows, ALL, 6
    for model, tracks, rays in (
        *((SPACE, tracks, 0) for tracks in (1, 2, 3, 4, 5)),
        *((VERTICAL, tracks, 0) for tracks in (2, 4, 5, 6)),
        *((FREE_SPACE, tracks, 0) for tracks in (2, 4)),
        *((model, 0, rays) for model in ALL for rays in (1, 2, 3, 4)),
        *((SPACE, tracks, 1) for tracks in (1, 2)),
        *((FREE_SPACE, tracks, rays) for tracks, rays in ((4, 1), (3, 2), (4, 2))),
    ):
        yield f"joined by {tracks} tracks and {rays} rays", partial(joined, tracks=tracks, rays=rays), (model,), 3
    yield "desargues", desargues, KNOWN, 8
    yield "desargues missed", partial(desargues, miss=True), KNOWN, 5
    yield "sliding joint", sliding_joint, KNOWN, 4


@cache
def configurations() -> tuple[Configuration, ...]:
    """All of them, the same on every call and in every run."""
    made = [
        draw(family, build, model, number)
        for family, build, models, count in families()
        for model in models
        for number in range(count)
    ]
    return tuple(made)


def draw(family: str, build: Build, model: Model, number: int) -> Configuration:
    d, orientation = model
    name = f"{family}, d = {d}, {orientation}, {number}"
    rng = Random(zlib.crc32(name.encode()))
    for _ in range(MOST_DRAWS):
        try:
            return _finished(name, family, build(rng, d, orientation), orientation, rng)
        except RedrawError:
            continue
    raise RuntimeError(f"{name}: {MOST_DRAWS} draws, and none came out as its family must")


def _finished(name: str, family: str, drawing: Drawing, orientation: OrientationModel, rng: Random) -> Configuration:
    """The truth of a drawing, then its pose."""
    truth = exact_rigidity(drawing.views, drawing.points, drawing.rays, orientation)
    d = len(drawing.views[0])
    gauge = gauge_freedoms(d, orientation)
    extra = truth.nullity - gauge
    if drawing.extra not in (None, extra) or drawing.ambiguous not in (None, extra > 0):
        raise RedrawError
    centers, points, cam_from_world = _posed(drawing, orientation, rng)
    view, track = np.array(drawing.rays, dtype=np.int32).T
    made = Configuration(
        name=name,
        family=family,
        d=d,
        orientation=orientation,
        centers=centers,
        points=points,
        cam_from_world=cam_from_world,
        view=view,
        track=track,
        nullity=truth.nullity,
        gauge_freedoms=gauge,
        components=truth.components,
        causes=frozenset(drawing.causes if extra > 0 else ()),
    )
    rank = d * (len(centers) + len(points)) + len(centers) * (gauge - d - 1) - truth.nullity
    values = np.linalg.svd(rigidity_matrix(made), compute_uv=False)
    if values[rank - 1] < LEAST_SINGULAR * values[0]:
        raise RedrawError
    return made


def _posed(drawing: Drawing, orientation: OrientationModel, rng: Random) -> tuple[Float, Float, Float | None]:
    """Centres, points and orientations in a random frame, of random size."""
    exact = drawing.views + drawing.points
    # the centroid exactly, so that nothing is lost where positions are far from the origin
    middle = [sum(column) / len(exact) for column in zip(*exact, strict=True)]
    positions = np.array([[float(x - y) for x, y in zip(position, middle, strict=True)] for position in exact])
    numpy_rng = np.random.default_rng(rng.getrandbits(32))
    d, m = positions.shape[1], len(drawing.views)
    world = _random_rotation(numpy_rng, d, about_z=orientation == "vertical")
    size = np.exp(numpy_rng.normal()) / np.sqrt(np.mean(np.sum(positions**2, axis=1)))
    positions = size * (positions @ world.T) + numpy_rng.normal(size=d)
    if orientation == "known" and numpy_rng.random() < 0.5:
        return positions[:m], positions[m:], None
    if d == 2:
        return positions[:m], positions[m:], numpy_rng.uniform(-np.pi, np.pi, m)
    return positions[:m], positions[m:], np.stack([_random_rotation(numpy_rng, 3) for _ in range(m)])


def _random_rotation(rng: np.random.Generator, d: int, about_z: bool = False) -> Float:
    if d == 2 or about_z:
        c, s = (function(rng.uniform(-np.pi, np.pi)) for function in (np.cos, np.sin))
        c, s = c / np.hypot(c, s), s / np.hypot(c, s)
        rotation = np.eye(d)
        rotation[:2, :2] = [[c, -s], [s, c]]
        return rotation
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q * np.linalg.det(q))


# --- in floating point


def rigidity_matrix(configuration: Configuration) -> Float:
    """((d - 1) N, unknowns) change of each bearing, in radians, with positions (in the scene's size) and turns.

    Columns: all centres, all points, all turns. Rows: each ray's tangent directions.
    """
    c, d = configuration, configuration.d
    directions, positions = c.directions(), _normalized(c)
    m, generators = len(c.centers), turn_generators(d, c.orientation).astype(np.float64)
    t = len(generators)
    length = np.linalg.norm(positions[m + c.track] - positions[c.view], axis=1)
    matrix = np.zeros((len(directions), d - 1, d * len(positions) + m * t))
    for o, (i, j) in enumerate(zip(c.view, m + c.track, strict=True)):
        tangents = np.linalg.svd(directions[o, None])[2][1:]
        matrix[o, :, d * i : d * i + d] = -tangents / length[o]
        matrix[o, :, d * j : d * j + d] = tangents / length[o]
        turns = d * len(positions) + t * i
        matrix[o, :, turns : turns + t] = -tangents @ (generators @ directions[o]).T
    return matrix.reshape(-1, matrix.shape[2])


def similarities(configuration: Configuration, motions: Float) -> Float:
    """(N, 1 + t + d, k) stretch, turn and shift of each observation in each of k motions, columns as in the matrix."""
    c, d = configuration, configuration.d
    positions = _normalized(c)
    m, generators = len(c.centers), turn_generators(d, c.orientation).astype(np.float64)
    shifts = motions[: positions.size].reshape(len(positions), d, motions.shape[1])
    turns = motions[positions.size :].reshape(m, len(generators), motions.shape[1])[c.view]
    ray = positions[m + c.track] - positions[c.view]
    moved = shifts[m + c.track] - shifts[c.view]
    stretch = np.einsum("nd,ndk->nk", ray, moved) / np.sum(ray**2, axis=1, keepdims=True)
    at_center = np.einsum("tab,nb,ntk->nak", generators, positions[c.view], turns)
    shift = shifts[c.view] - positions[c.view][:, :, None] * stretch[:, None] - at_center
    return np.concatenate((stretch[:, None], turns, shift), axis=1)


def _normalized(c: Configuration) -> Float:
    """Centres, then points, about their centroid, in units of their rms distance from it."""
    positions = np.concatenate((c.centers, c.points))
    positions = positions - positions.mean(axis=0)
    return np.asarray(positions / np.sqrt(np.mean(np.sum(positions**2, axis=1))))


def exact_case(configuration: Configuration) -> tuple[pp.Tracks, pp.Scene]:
    """Bearings without noise, and the true scene."""
    return _case(configuration, configuration.directions())


def noisy_case(configuration: Configuration, sigma_rad: float, seed: int = 0) -> tuple[pp.Tracks, pp.Scene]:
    """Noisy bearings and the scene solved from them: from nothing where orientations are known, else from the truth."""
    c = configuration
    rng = np.random.default_rng([zlib.crc32(c.name.encode()), seed])
    # the part along the ray changes nothing once the length is one again
    directions = c.directions() + rng.normal(size=(len(c.view), c.d)) * sigma_rad
    tracks, truth = _case(c, directions / np.linalg.norm(directions, axis=1, keepdims=True))
    if c.orientation == "known":
        return tracks, pp.solve_positions(tracks, c.cam_from_world, pp.PositionOptions(threads=1))
    priors = pp.Priors()
    if c.orientation == "vertical":
        up = truth.cam_from_world[:, :, 2]
        priors = pp.Priors(directions=pp.DirectionPriors.gravity(np.arange(len(up)), up, 1e-6))
    return tracks, pp.refine(tracks, truth, pp.RefineOptions(priors=priors, threads=1))


def is_whole(scene: pp.Scene) -> bool:
    """Whether a solver claims to have solved all of it."""
    every = np.concatenate((scene.centers, scene.points))
    return scene.summary.status == pp.Status.CONVERGED and bool(np.isfinite(every).all())


def _case(c: Configuration, directions: Float) -> tuple[pp.Tracks, pp.Scene]:
    bearings = directions
    if c.cam_from_world is not None and c.d == 2:
        x, y = directions.T
        cos, sin = np.cos(c.cam_from_world[c.view]), np.sin(c.cam_from_world[c.view])
        bearings = np.stack((cos * x + sin * y, cos * y - sin * x), axis=1)
    elif c.cam_from_world is not None:
        bearings = np.einsum("nij,nj->ni", c.cam_from_world[c.view], directions)
    tracks = pp.Tracks.from_arrays(c.view, c.track, bearings, len(c.centers), len(c.points))
    return tracks, known_scene(tracks, c.cam_from_world, c.centers, c.points)


# --- judging a certificate


def faults(configuration: Configuration, certificate: Certificate) -> list[str]:
    """What a certificate of the exact case has wrong; empty where it is right."""
    c, found = configuration, certificate
    wrong = []
    for name, value, truth in (
        ("nullity", found.nullity, c.nullity),
        ("gauge_freedoms", found.gauge_freedoms, c.gauge_freedoms),
        ("determined", found.verdict == Verdict.DETERMINED, not c.ambiguous),
        ("undetermined", found.verdict == Verdict.UNDETERMINED, c.ambiguous),
        ("causes are named", any(cause.is_exact for cause in found.causes), c.ambiguous),
    ):
        if value != truth:
            wrong.append(f"{c.name}: {name} is {value}, expected {truth}")
    components = {
        (frozenset(map(int, part.views)), frozenset(map(int, part.tracks)))
        for part in found.components
        if part.n_observations > 1
    }
    if components != set(c.components):
        wrong.append(f"{c.name}: components {_sizes(components)} (views, points), expected {_sizes(set(c.components))}")
    kinds = {cause.kind for cause in found.causes}
    if c.causes and not kinds & c.causes:
        wrong.append(f"{c.name}: causes {sorted(kinds)}, expected one of {sorted(c.causes)}")
    return wrong


def noisy_faults(configuration: Configuration, scene: pp.Scene, certificate: Certificate) -> list[str]:
    """Verdicts that noise does not excuse: sure of what is ambiguous, or certain that what is determined is not."""
    c, found = configuration, certificate
    if c.ambiguous and found.verdict == Verdict.DETERMINED:
        return [f"{c.name}: determined, but its nullity is {c.nullity}"]
    if not c.ambiguous and found.verdict == Verdict.UNDETERMINED and is_whole(scene):
        return [f"{c.name}: undetermined, but its exact geometry is determined"]
    return []


def _sizes(components: set[Members]) -> list[tuple[int, int]]:
    return sorted(((len(views), len(points)) for views, points in components), reverse=True)
