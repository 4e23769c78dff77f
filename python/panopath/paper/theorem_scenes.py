"""Random scenes of each kind that the paper's theorems and ambiguities speak of (sections 4 and 5).

Every view sees every point, orientations known. A kind is a function from a random generator to centres (m, d) and
points (n, d); what the paper says of it stands beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from panopath.model import Float

Places = tuple[Float, Float]
Generator = np.random.Generator

#: No view is nearer to a point than this, of scenes about 2 wide; rounding grows with the inverse square of it.
_NEAREST = 0.02
#: Where there are enough of them, numbers of views and points are drawn up to this.
_MOST = 7


@dataclass(frozen=True)
class Kind:
    """Scenes of one kind, and what the paper says of them."""

    name: str
    section: str
    claim: str
    #: Whether the paper calls them unique.
    claimed: bool
    make: Callable[[Generator], Places]
    #: Where the paper errs: why, in a sentence.
    reason: str = ""

    def draw(self, rng: Generator) -> Places:
        """Draw a scene in which no view stands at a point, or nearly."""
        return apart(self.make, rng)


def apart(make: Callable[[Generator], Places], rng: Generator) -> Places:
    """Draw until no view is near a point: the paper takes all places to be different."""
    while True:
        centers, points = make(rng)
        if np.linalg.norm(centers[:, None] - points, axis=2).min() > _NEAREST:
            return centers, points


def _general(d: int, fewest_views: int, fewest_points: int) -> Callable[[Generator], Places]:
    def draw(rng: Generator) -> Places:
        return _box(rng, _count(rng, fewest_views), d), _box(rng, _count(rng, fewest_points), d)

    return draw


def _numbered(d: int, n_views: int | None, n_points: int | None) -> Callable[[Generator], Places]:
    """Numbers that are given; None: 2 or more."""

    def draw(rng: Generator) -> Places:
        return _box(rng, n_views or _count(rng, 2), d), _box(rng, n_points or _count(rng, 2), d)

    return draw


def _cameras_in_line(rng: Generator, n_on: int = 1, n_off: int = 3) -> Places:
    """Draw views on a line with ``n_on`` points, and ``n_off`` points or more beside it."""
    n_views, n_beside = _count(rng, 3), _count(rng, n_off)
    line = _line(rng, n_views + n_on, 2)
    order = rng.permutation(len(line))
    return line[order[n_on:]], np.vstack((line[order[:n_on]], _box(rng, n_beside, 2)))


def _points_in_line(rng: Generator) -> Places:
    points, centers = _cameras_in_line(rng)
    return centers, points


def _cameras_in_line_alone(rng: Generator) -> Places:
    return _cameras_in_line(rng, n_on=0)


def _two_lines_1(rng: Generator) -> Places:
    """All views on one line, all points on another."""
    return _line(rng, _count(rng, 3), 2), _line(rng, _count(rng, 3), 2)


def _two_lines_2(rng: Generator) -> Places:
    """Both on both of two parallel lines, neither on one alone."""
    turn, gap = _turn(rng), rng.uniform(0.4, 1.0)
    sets = []
    for _ in range(2):
        count = _count(rng, 3)
        upper = int(rng.integers(1, count))
        height = np.where(np.arange(count) < upper, gap, -gap)
        sets.append(np.column_stack((_spread(rng, count), height)) @ turn.T)
    return sets[0], sets[1]


def _conic(curve: str, off: float = 0.0) -> Callable[[Generator], Places]:
    """All on one conic; the last point ``off`` it."""

    def draw(rng: Generator) -> Places:
        n_views, n_points = _count(rng, 3), _count(rng, 3)
        places = _on_conic(rng, curve, n_views + n_points)[rng.permutation(n_views + n_points)]
        places[-1] += off * places[-1] / np.linalg.norm(places[-1])
        places = places @ _turn(rng).T + rng.uniform(-0.3, 0.3, 2)
        return places[:n_views], places[n_views:]

    return draw


def _four_points_on_conic(rng: Generator) -> Places:
    """Four points, no three of them on a line, and three views or more, all on one ellipse."""
    n_views = _count(rng, 3)
    places = _on_conic(rng, "ellipse", n_views + 4)[rng.permutation(n_views + 4)]
    return places[4:], places[:4]


def _on_conic(rng: Generator, curve: str, count: int) -> Float:
    if curve == "parabola":
        x = _spread(rng, count)
        return np.column_stack((x, rng.uniform(0.6, 1.5) * x**2))
    if curve == "hyperbola":
        side = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
        along = 1.2 * _spread(rng, count)
        return np.column_stack((0.5 * side * np.cosh(along), rng.uniform(0.4, 0.8) * np.sinh(along)))
    angle = np.pi * (1.0 + _spread(rng, count))
    return np.column_stack((np.cos(angle), rng.uniform(0.4, 0.8) * np.sin(angle)))


def _raised(draw: Callable[[Generator], Places]) -> Callable[[Generator], Places]:
    """Draw a plan and give it heights at random."""

    def raised(rng: Generator) -> Places:
        centers, points = draw(rng)
        high = (np.column_stack((plan, rng.uniform(-1.0, 1.0, len(plan)))) for plan in (centers, points))
        return tuple(high)  # type: ignore[return-value]

    return raised


def _tilted(draw: Callable[[Generator], Places]) -> Callable[[Generator], Places]:
    """Draw a plan and lay it into space on a plane that is turned at random."""

    def tilted(rng: Generator) -> Places:
        centers, points = draw(rng)
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0][:, :2]
        return centers @ axes.T, points @ axes.T

    return tilted


def _point_behind_two_cameras(rng: Generator) -> Places:
    """Two views, points in general position, and one more point on the line of the views."""
    centers = _box(rng, 2, 3)
    behind = centers[1] + rng.uniform(0.3, 1.0) * (centers[1] - centers[0])
    return centers, np.vstack((_box(rng, _count(rng, 2), 3), behind))


def _box(rng: Generator, count: int, d: int) -> Float:
    return rng.uniform(-1.0, 1.0, (count, d))


def _count(rng: Generator, fewest: int) -> int:
    return int(rng.integers(fewest, _MOST + 1))


def _spread(rng: Generator, count: int) -> Float:
    """Numbers from -1 to 1 that keep apart, ascending."""
    return np.asarray(2.0 * (np.arange(count) + rng.uniform(0.2, 0.8, count)) / count - 1.0)


def _line(rng: Generator, count: int, d: int) -> Float:
    along = rng.normal(size=d)
    return np.asarray(rng.uniform(-0.5, 0.5, d) + _spread(rng, count)[:, None] * along / np.linalg.norm(along))


def _turn(rng: Generator) -> Float:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


_CONICS = "All on one conic is ambiguous however many there are; two lines are its degenerate case (Bolker, Roth 1980)."

#: In the order of the paper.
KINDS = (
    Kind("Theorem I", "4, Theorem I", "Plane: three cameras and three points or more, neither on a line, not all on "
         "two lines: unique.", True, _general(2, 3, 3)),
    *(
        Kind(f"{curve}", "4, Theorem I", f"The same, all on one {curve}: not on two lines, so unique.", True,
             _conic(curve), _CONICS)
        for curve in ("ellipse", "hyperbola", "parabola")
    ),
    Kind("ellipse but for one", "4, Theorem I", "The same, one point off the ellipse: unique.", True,
         _conic("ellipse", 0.3)),
    Kind("Theorem II", "4, Theorem II", "Plane: four points, no three on a line, and three cameras or more: unique.",
         True, _general(2, 3, 4)),
    Kind("Theorem II, conic", "4, Theorem II", "The same, all on one ellipse: unique.", True, _four_points_on_conic,
         _CONICS),
    Kind("Theorem II, cameras in line", "4, Theorem II", "The same, the cameras on one line with one of the points: "
         "the theorem asks nothing of the cameras, so unique.", True, _cameras_in_line,
         "Its proof uses that no three cameras are on a line; the point in line with all of them slides."),
    Kind("camera collinearity", "4, figure", "Cameras and a point on one line: the point can move.", False,
         _cameras_in_line),
    Kind("cameras on a line", "4", "Three cameras on a line and two points or more leave families of solutions (here "
         "three points or more, none on that line).", False, _cameras_in_line_alone,
         "Two points leave them, by counting. From three points on, of which none is in line with the cameras and "
         "which are not in line themselves, a straight street is no ambiguity."),
    Kind("point collinearity", "4, figure", "Points and a camera on one line: the camera can move.", False,
         _points_in_line),
    Kind("two lines I", "4, figure", "Cameras on one line, points on another: ambiguous.", False, _two_lines_1),
    Kind("two lines II", "4, figure", "Both on both of two parallel lines: ambiguous.", False, _two_lines_2),
    Kind("one camera", "4, table", "One camera is ambiguous.", False, _numbered(2, 1, None)),
    Kind("two cameras", "4, figure", "Two cameras in the plane are ambiguous, however many points.", False,
         _numbered(2, 2, None)),
    Kind("two points", "4, figure", "Two points in the plane are ambiguous, however many cameras.", False,
         _numbered(2, None, 2)),
    Kind("space theorem", "5, theorem", "Space: unique where the plan satisfies Theorem I.", True, _general(3, 3, 3)),
    Kind("tetrahedron", "5, remark 1", "Four points of a tetrahedron and three cameras not on a line: unique.", True,
         lambda rng: (_box(rng, 3, 3), _box(rng, 4, 3))),
    Kind("two lines in a plane in space", "5, remark 3", "All in one plane: the ambiguities of the plane apply.", False,
         _tilted(_two_lines_2)),
    Kind("plan on two lines", "5, remark 3", "Not in one plane: the two-line ambiguity disappears (here the plan is on "
         "two lines, and heights are at random).", True, _raised(_two_lines_2)),
    Kind("two by two or more", "5, proposition", "Two cameras and two points or more in space, not in one plane: "
         "unique.", True, _numbered(3, 2, None)),
    Kind("two cameras, coplanar", "5, proposition", "Two cameras and their points in one plane in space: ambiguous.",
         False, _tilted(_numbered(2, 2, None))),
    Kind("two cameras and a point in line", "5, proposition", "Two cameras and three points or more, not in one plane, "
         "one of them in line with the cameras: unique.", True, _point_behind_two_cameras,
         "A point on the line of both cameras slides along it: that not all is in one plane is enough for two points "
         "alone."),
)  # fmt: skip

#: The cylinder of which the paper's way through the plane makes nothing.
CYLINDER = _raised(_conic("ellipse"))
