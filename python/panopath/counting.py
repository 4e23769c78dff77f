"""Counting: whether n points and m views have as many equations as unknowns.

The structure-from-motion inequality (Knill and Ramirez-Herran 2007, section 3, with the corrections of
``docs/method/counting.md``; its general form is theirs too, arXiv 0708.2432):

    d K n + f m + h  <=  (d - 1) N + g

    d   dimension: 2 in the plane, 3 in space          K   vectors a point has: 1 at rest, more where it moves
    n   points                                         N   observations, n m where every view sees every point
    m   views                                          f   unknowns of a view
    h   unknowns that all views share                  g   gauge freedoms, which no observation can fix

Each observation gives d - 1 equations. With a = d - 1, b = d K, c = g - h and everything seen, this is

    (a m - b) (a n - f)  >=  b f - a c,

so the pairs that have too few equations are bounded by a hyperbola.

**Necessary, never sufficient.** Where the inequality fails, no algorithm finds the scene. Where it holds, the scene may
still be ambiguous (points and views on one conic, two orthographic views, parts that share too little): the certificate
of the scene decides, not the count.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import inf, isqrt
from typing import Literal, NamedTuple, SupportsIndex

from panopath.errors import InputError

#: How a point moves: powers of time up to k, harmonics up to k, or that many functions of any kind (splines).
PathBasis = Literal["taylor", "fourier"] | int | None

#: Pairs that :func:`smallest` lists at most; no camera comes near.
_MOST_PAIRS = 100_000


class CameraCounts(NamedTuple):
    """What the inequality asks of a kind of cameras: the first arguments of the functions here."""

    #: Dimension.
    d: int
    #: Unknowns of a view.
    f: int
    #: Gauge freedoms of points at rest.
    g: int
    #: Unknowns that all views share.
    h: int


class PathGroup(NamedTuple):
    """Points whose paths have one form: at rest, or as :func:`path_vectors` counts them."""

    #: How many.
    n: int
    #: Order of their paths.
    k: int = 0
    basis: PathBasis = None


class PointsAndViews(NamedTuple):
    """A number of points and a number of views."""

    n: int
    m: int


@dataclass(frozen=True)
class StructureFromMotionInequality:
    """Both sides of the inequality for one number of points and views. Necessary, never sufficient."""

    d: int
    f: int
    g: int
    h: int
    n: int
    m: int
    #: Vectors that describe the path of a point: 1 at rest.
    vectors: int
    #: Pairs of a view and a point that it sees.
    n_observations: int

    @property
    def equations(self) -> int:
        """Of all observations: d - 1 each."""
        return (self.d - 1) * self.n_observations

    @property
    def unknowns(self) -> int:
        """Left when the gauge is fixed; not positive where the gauge is all there is."""
        return self.d * self.vectors * self.n + self.f * self.m + self.h - self.g

    @property
    def slack(self) -> int:
        """Equations less unknowns: 0 is a border case, and less than 0 cannot be solved."""
        return self.equations - self.unknowns

    @property
    def holds(self) -> bool:
        """Whether there are enough equations: true of all that can be solved, and of much that cannot."""
        return self.slack >= 0

    @property
    def is_settled(self) -> bool:
        """Whether it holds, and still does with more points or views that see everything.

        A single ray passes the count, since the gauge takes all its unknowns; with a second point it fails. Such pairs
        hold without being settled.
        """
        a = self.d - 1
        return self.holds and a * self.m >= self.d * self.vectors and a * self.n >= self.f

    def __str__(self) -> str:
        """One line."""
        verdict = "too few equations" if not self.holds else "as many" if self.slack == 0 else f"{self.slack} to spare"
        counted = f"{_plural(self.n, 'point')}, {_plural(self.m, 'view')}: {_plural(self.equations, 'equation')}"
        return f"{counted}, {_plural(self.unknowns, 'unknown')}; {verdict}"


@dataclass(frozen=True)
class MixedInequality(StructureFromMotionInequality):
    """The same where points move in different ways; ``vectors`` is then the largest number."""

    #: Vectors of all points together.
    n_vectors: int = 0

    @property
    def unknowns(self) -> int:
        """Left when the gauge is fixed."""
        return self.d * self.n_vectors + self.f * self.m + self.h - self.g


@dataclass(frozen=True)
class RequiredVisibility:
    """How many observations a scene needs at least. Necessary, never sufficient: they must hang together too."""

    n: int
    m: int
    #: Observations that all unknowns together ask for.
    in_total: int
    #: Observations of each point, and by each view: with fewer, it moves for itself. 0 where counting cannot tell.
    per_point: int
    per_view: int

    @property
    def n_observations(self) -> int:
        """The largest of the three bounds, over the whole scene."""
        return max(self.in_total, self.per_point * self.n, self.per_view * self.m)

    @property
    def fraction(self) -> float:
        """Share of all pairs of a view and a point; beyond 1 not even full visibility is enough."""
        return _share(self.n_observations, self.n * self.m)

    @property
    def is_possible(self) -> bool:
        """Whether there are that many pairs at all."""
        return self.n_observations <= self.n * self.m


def structure_from_motion_inequality(  # noqa: PLR0917 (the public names and their order are fixed)
    d: int,
    f: int,
    g: int,
    h: int,
    n: int,
    m: int,
    k: int = 0,
    basis: PathBasis = None,
    *,
    n_observations: int | None = None,
) -> StructureFromMotionInequality:
    """Compare equations with unknowns. Necessary, never sufficient: the certificate of a scene decides.

    Parameters
    ----------
    d
        Dimension, at least 2.
    f
        Unknowns of a view.
    g
        Gauge freedoms. Of moving points there are more than of points at rest: see :func:`moving_gauge`. It is taken as
        given, so that the paper's own count can be had as well.
    h
        Unknowns that all views share, such as one focal length.
    n, m
        Numbers of points and of views, at least 1.
    k
        Order of the path of each point: 0 at rest, 1 with a velocity, ...
    basis
        ``"taylor"`` (the same as None): ``k + 1`` vectors a point. ``"fourier"``: ``2 k + 1``. A number: that many
        functions a point, splines for instance; ``k`` is then 0.
    n_observations
        Pairs of a view and a point that it sees; default: all ``n m``.

    Returns
    -------
    StructureFromMotionInequality

    Raises
    ------
    InputError
        Naming the argument.

    Notes
    -----
    Section 3 of the paper; its section 6 for moving points, where a Fourier path has ``2 k + 1`` vectors, not ``2 k``.
    """
    d, f, g, h = _camera(d, f, g, h)
    n, m = _whole("n", n, 1), _whole("m", m, 1)
    vectors = path_vectors(k, basis)
    seen = n * m if n_observations is None else _whole("n_observations", n_observations, 0)
    if seen > n * m:
        raise InputError(f"n_observations is {seen}, expected at most n m = {n * m}")
    return StructureFromMotionInequality(d, f, g, h, n, m, vectors, seen)


def path_vectors(k: int = 0, basis: PathBasis = None) -> int:
    """Vectors that describe the path of a point of order ``k``: those of position, velocity, ... or of each harmonic.

    Raises
    ------
    InputError
        Where ``k`` or ``basis`` cannot be used.
    """
    order = _whole("k", k, 0)
    if basis is None or basis == "taylor":
        return order + 1
    if basis == "fourier":
        return 2 * order + 1
    if isinstance(basis, str):
        raise InputError(f"basis is {basis!r}, expected 'taylor', 'fourier' or a number of functions")
    if order != 0:
        raise InputError(f"k is {order}, expected 0 where basis is a number of functions")
    return _whole("basis", basis, 1)


def moving_gauge(d: int, g: int, k: int = 0, basis: PathBasis = None) -> int:
    """Gauge freedoms where points move: all points and views may share any motion along the basis.

    A common translation has d unknowns for each function of the basis, not d in all; scale and turn stay constant. With
    points at rest it is ``g``. One point known to be at rest takes the difference away, and its d (K - 1) unknowns too,
    so that the count is the same. A scene whose points are all at rest, solved as if they moved, has freedoms beyond
    these: its scale may change with time.

    Returns
    -------
    int
        ``g + d (K - 1)``: exact where ``g`` counts translations, turns and scale, or affine maps.

    Raises
    ------
    InputError
        Naming the argument.
    """
    return _whole("g", g, 0) + _whole("d", d, 2) * (path_vectors(k, basis) - 1)


def shared_functions(groups: Sequence[PathGroup]) -> int:
    """Functions of time that all groups can express: what a motion that everything shares may consist of.

    Powers of time share those of the lowest order, harmonics (of one period) those of the fewest. Numbers of functions
    stand for the same ones where they are equal. What is different shares the constant alone, and so does all that goes
    with a point at rest.

    Raises
    ------
    InputError
        Where a group cannot be used.
    """
    kinds = {("own", group.basis) if isinstance(group.basis, int) else (group.basis or "taylor",) for group in groups}
    if not kinds:
        raise InputError("groups is empty, expected at least one group of points")
    fewest = min(path_vectors(group.k, group.basis) for group in groups)
    return fewest if len(kinds) == 1 else 1


def mixed_inequality(  # noqa: PLR0917 (as structure_from_motion_inequality)
    d: int, f: int, g: int, h: int, groups: Sequence[PathGroup], m: int, *, n_observations: int | None = None
) -> MixedInequality:
    """Compare equations with unknowns where some points are at rest and others move, each group in its own way.

        d sum_j K_j + f m + h  <=  (d - 1) N + g + d (S - 1)

    with ``K_j`` vectors of point j and ``S`` functions of time that all groups share (:func:`shared_functions`): only
    along these may everything move together. Necessary, never sufficient.

    Parameters
    ----------
    d, f, h, m, n_observations
        As in :func:`structure_from_motion_inequality`.
    g
        Gauge freedoms of points at rest.
    groups
        Points of one form of path each.

    Returns
    -------
    MixedInequality
        With the gauge of all groups together as its ``g``.

    Raises
    ------
    InputError
        Naming the argument.
    """
    d, f, g, h = _camera(d, f, g, h)
    chosen = [PathGroup(*group) for group in groups]
    shared = shared_functions(chosen)
    counts = [path_vectors(group.k, group.basis) for group in chosen]
    n, m = sum(_whole("n", group.n, 1) for group in chosen), _whole("m", m, 1)
    seen = n * m if n_observations is None else _whole("n_observations", n_observations, 0)
    if seen > n * m:
        raise InputError(f"n_observations is {seen}, expected at most n m = {n * m}")
    total = sum(group.n * count for group, count in zip(chosen, counts, strict=True))
    return MixedInequality(d, f, g + d * (shared - 1), h, n, m, max(counts), seen, total)


def smallest(  # noqa: PLR0917 (as structure_from_motion_inequality)
    d: int, f: int, g: int, h: int = 0, k: int = 0, basis: PathBasis = None
) -> tuple[PointsAndViews, ...]:
    """Find the fewest points and views, everything seen: none of these pairs can do with fewer points or fewer views.

    Only settled pairs, from which more points or views cannot lead back to too few equations; so not the single ray
    that passes the count because the gauge takes all its unknowns. Necessary, never sufficient.

    Parameters
    ----------
    d, f, g, h, k, basis
        As in :func:`structure_from_motion_inequality`.

    Returns
    -------
    tuple of PointsAndViews
        In order of views: points fall as views rise.

    Raises
    ------
    InputError
        Naming the argument; also where there are more than a hundred thousand pairs.
    """
    d, f, g, h = _camera(d, f, g, h)
    a, b = d - 1, d * path_vectors(k, basis)
    # the inequality is (a m - b) (a n - f) >= gap, and both factors count from zero up
    gap = b * f - a * (g - h)
    if isqrt(max(gap, 0)) > _MOST_PAIRS * a // 2:
        raise InputError(f"f, g, h and k leave more than {_MOST_PAIRS:,} smallest pairs")
    fewest_points, fewest_views = _at_least(f, gap, a), _at_least(b, gap, a)
    pairs = []
    m = fewest_views
    while True:
        n = _partner(f, gap, a * m - b, a)
        pairs.append(PointsAndViews(n, m))
        if n <= fewest_points:
            return tuple(pairs)
        # the fewest views for which one point less is enough
        m = _partner(b, gap, a * (n - 1) - f, a)


def required_visibility(  # noqa: PLR0917 (as structure_from_motion_inequality)
    d: int, f: int, g: int, h: int, n: int, m: int, k: int = 0, basis: PathBasis = None
) -> RequiredVisibility:
    """Count the observations that n points and m views need at least. Necessary, never sufficient.

    Three bounds: of all unknowns together; of each point, which needs as many equations as it has unknowns; of each
    view likewise. With many points and views the second or third is the largest: in space a point has 3 unknowns and a
    ray 2 equations, so that each is needed in two views, though counting all together asks for one and a half.

    Parameters
    ----------
    d, f, g, h, n, m, k, basis
        As in :func:`structure_from_motion_inequality`.

    Returns
    -------
    RequiredVisibility

    Raises
    ------
    InputError
        Naming the argument.
    """
    full = structure_from_motion_inequality(d, f, g, h, n, m, k, basis)
    a, b = full.d - 1, full.d * full.vectors
    in_total = max(_ceil(full.unknowns, a), 0)
    # one that moves alone breaks the scene only where the others hold the gauge
    per_point = _ceil(b, a) if full.f * full.m >= full.g else 0
    per_view = _ceil(full.f, a) if b * full.n + full.f * (full.m - 1) >= full.g else 0
    return RequiredVisibility(full.n, full.m, in_total, per_point, per_view)


def required_visible_fraction(  # noqa: PLR0917 (as structure_from_motion_inequality)
    d: int, f: int, g: int, h: int, n: int, m: int, k: int = 0, basis: PathBasis = None
) -> float:
    """Share of all pairs that must be seen for as many equations as unknowns. Necessary, never sufficient.

    The paper's count (section 5), corrected: ``(d K n + f m + h - g) / ((d - 1) n m)``. With known orientations that is
    ``(2 (n + m) - 3) / (n m)`` in the plane and ``(3 (n + m) - 4) / (2 n m)`` in space. :func:`required_visibility`
    knows stricter bounds.

    Parameters
    ----------
    d, f, g, h, n, m, k, basis
        As in :func:`structure_from_motion_inequality`.

    Returns
    -------
    float
        At least 0; beyond 1 not even full visibility is enough.

    Raises
    ------
    InputError
        Naming the argument.
    """
    full = structure_from_motion_inequality(d, f, g, h, n, m, k, basis)
    return _share(max(full.unknowns, 0), full.equations)


class CameraModel(StrEnum):
    """Kinds of cameras, with what the inequality asks of them. The first five are those of this package.

    Where points move, the methods take the gauge of moving points (:func:`moving_gauge`).
    """

    #: Centre unknown, heading known (section 4).
    ORIENTED_PLANE = "oriented_plane"
    #: Centre unknown, orientation known (section 5).
    ORIENTED_SPACE = "oriented_space"
    #: Centre and heading (section 7).
    NON_ORIENTED_PLANE = "non_oriented_plane"
    #: Centre and orientation (section 7); any calibrated central camera.
    NON_ORIENTED_SPACE = "non_oriented_space"
    #: Centre and the turn about a known vertical (section 7, remark 2).
    GRAVITY_SPACE = "gravity_space"
    #: Orthogonal projection onto a line at unknown angle: a turn and an offset; the gauge has no scale (section 2).
    ORTHOGRAPHIC_PLANE = "orthographic_plane"
    #: Orthogonal projection onto a plane: three turns and two offsets; the gauge has no scale (section 2).
    ORTHOGRAPHIC_SPACE = "orthographic_space"
    #: The same with a scale of each view: what spherical cameras become far away.
    SCALED_ORTHOGRAPHIC_SPACE = "scaled_orthographic_space"
    #: Any affine map from space to the picture; the gauge is an affine map of space.
    AFFINE_SPACE = "affine_space"
    #: Perspective views that share one unknown focal length.
    SHARED_FOCAL_SPACE = "shared_focal_space"
    #: Perspective views of which nothing is known; the gauge is a projective map of space.
    PROJECTIVE_SPACE = "projective_space"

    @property
    def counts(self) -> CameraCounts:
        """What the inequality asks, points at rest: ``structure_from_motion_inequality(*model.counts, n, m)``."""
        return _KINDS[self][0]

    @property
    def description(self) -> str:
        """For people."""
        return _KINDS[self][1]

    def gauge(self, k: int = 0, basis: PathBasis = None) -> int:
        """Gauge freedoms where points move along a basis: :func:`moving_gauge`."""
        # a projective map takes a path out of the basis, an affine one does not
        d, _, g, _ = self.counts
        bends = self is CameraModel.PROJECTIVE_SPACE and path_vectors(k, basis) > 1
        return moving_gauge(d, d * (d + 1) if bends else g, k, basis)

    def moving_counts(self, k: int = 0, basis: PathBasis = None) -> CameraCounts:
        """d, f, g and h where points move along a basis."""
        return self.counts._replace(g=self.gauge(k, basis))

    def inequality(
        self, n: int, m: int, k: int = 0, basis: PathBasis = None, *, n_observations: int | None = None
    ) -> StructureFromMotionInequality:
        """Compare equations with unknowns: :func:`structure_from_motion_inequality`. Necessary, never sufficient."""
        counts = self.moving_counts(k, basis)
        return structure_from_motion_inequality(*counts, n, m, k, basis, n_observations=n_observations)

    def mixed(self, groups: Sequence[PathGroup], m: int, *, n_observations: int | None = None) -> MixedInequality:
        """Compare equations with unknowns where points move in different ways: :func:`mixed_inequality`."""
        d, f, g, h = self.counts
        bends = self is CameraModel.PROJECTIVE_SPACE and any(path_vectors(k, basis) > 1 for _, k, basis in groups)
        return mixed_inequality(d, f, d * (d + 1) if bends else g, h, groups, m, n_observations=n_observations)

    def smallest(self, k: int = 0, basis: PathBasis = None) -> tuple[PointsAndViews, ...]:
        """Fewest points and views: :func:`smallest`. Necessary, never sufficient."""
        return smallest(*self.moving_counts(k, basis), k, basis)

    def required_visibility(self, n: int, m: int, k: int = 0, basis: PathBasis = None) -> RequiredVisibility:
        """Fewest observations: :func:`required_visibility`. Necessary, never sufficient."""
        return required_visibility(*self.moving_counts(k, basis), n, m, k, basis)


_KINDS = {
    CameraModel.ORIENTED_PLANE: (CameraCounts(2, 2, 3, 0), "plane, orientation known"),
    CameraModel.ORIENTED_SPACE: (CameraCounts(3, 3, 4, 0), "space, orientation known"),
    CameraModel.NON_ORIENTED_PLANE: (CameraCounts(2, 3, 4, 0), "plane, orientation unknown"),
    CameraModel.NON_ORIENTED_SPACE: (CameraCounts(3, 6, 7, 0), "space, orientation unknown"),
    CameraModel.GRAVITY_SPACE: (CameraCounts(3, 4, 5, 0), "space, vertical known"),
    CameraModel.ORTHOGRAPHIC_PLANE: (CameraCounts(2, 2, 3, 0), "plane, orthographic"),
    CameraModel.ORTHOGRAPHIC_SPACE: (CameraCounts(3, 5, 6, 0), "space, orthographic"),
    CameraModel.SCALED_ORTHOGRAPHIC_SPACE: (CameraCounts(3, 6, 7, 0), "space, scaled orthographic"),
    CameraModel.AFFINE_SPACE: (CameraCounts(3, 8, 12, 0), "space, affine"),
    CameraModel.SHARED_FOCAL_SPACE: (CameraCounts(3, 6, 7, 1), "space, one unknown focal length"),
    CameraModel.PROJECTIVE_SPACE: (CameraCounts(3, 11, 15, 0), "space, uncalibrated"),
}


def inequality_table(  # noqa: PLR0917 (as structure_from_motion_inequality)
    d: int,
    f: int,
    g: int,
    h: int,
    pairs: Iterable[tuple[int, int]],
    k: int = 0,
    basis: PathBasis = None,
) -> tuple[StructureFromMotionInequality, ...]:
    """Evaluate the inequality for each pair ``(n, m)``: the table of section 4, for any camera.

    Parameters
    ----------
    d, f, g, h, k, basis
        As in :func:`structure_from_motion_inequality`.
    pairs
        Numbers of points and of views, in the order wanted.

    Returns
    -------
    tuple of StructureFromMotionInequality

    Raises
    ------
    InputError
        Naming the argument.
    """
    return tuple(structure_from_motion_inequality(d, f, g, h, n, m, k, basis) for n, m in pairs)


def table_text(rows: Sequence[StructureFromMotionInequality]) -> str:
    """Lay out a table of inequalities in Markdown, one row each."""
    head = ("views m", "points n", "equations", "unknowns", "slack", "enough?")
    cells = [
        (str(r.m), str(r.n), str(r.equations), str(r.unknowns), str(r.slack), "yes" if r.holds else "no") for r in rows
    ]
    return _markdown(head, cells)


def models_text(models: Iterable[CameraModel] = CameraModel, k: int = 0, basis: PathBasis = None) -> str:
    """Lay out kinds of cameras in Markdown: what they count, and the fewest points and views."""
    head = ("camera", "d", "f", "g", "h", "fewest (points, views)")
    cells = []
    for model in models:
        pairs = ", ".join(f"({n}, {m})" for n, m in model.smallest(k, basis))
        cells.append((model.description, *(str(count) for count in model.moving_counts(k, basis)), pairs))
    return _markdown(head, cells)


def _camera(d: int, f: int, g: int, h: int) -> tuple[int, int, int, int]:
    # on a line (d = 1) bearings say nothing
    return _whole("d", d, 2), _whole("f", f, 0), _whole("g", g, 0), _whole("h", h, 0)


def _whole(name: str, value: SupportsIndex, least: int) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        raise InputError(f"{name} is {value!r}, expected a whole number") from None
    if isinstance(value, bool):
        raise InputError(f"{name} is {value!r}, expected a whole number")
    if number < least:
        raise InputError(f"{name} is {number}, expected at least {least}")
    return number


def _at_least(offset: int, gap: int, a: int) -> int:
    """Smallest count >= 1 whose factor ``a count - offset`` is not negative, and positive where ``gap`` is."""
    return max(1, _ceil(offset + (1 if gap > 0 else 0), a))


def _partner(offset: int, gap: int, factor: int, a: int) -> int:
    """Smallest count >= 1 with ``factor (a count - offset) >= gap``, ``a count >= offset``."""
    needed = _ceil(gap, factor) if gap > 0 else 0
    return max(1, _ceil(offset + needed, a))


def _ceil(numerator: int, denominator: int) -> int:
    return -(-numerator // denominator)


def _share(part: int, whole: int) -> float:
    try:
        return part / whole
    except OverflowError:
        return inf


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(cells) + " |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])
