"""What counting cannot see: how much a scene in general position leaves free, in exact arithmetic.

The derivative of all observations by all unknowns, at a random scene over the integers modulo a prime. Its rank is that
of almost every scene (it can only be smaller, with a probability of about one in a million), and there is no tolerance
to choose. Nullity less gauge are the freedoms that almost every scene has beyond the gauge: 0 where counting is enough.

A point ``x`` seen from ``c`` moves by ``dx - dc``, in a camera that turns by ``omega`` also by ``omega x (x - c)``; the
rows of ``across(u)`` take away what lies along the ray ``u``. The orientation itself does not change the rank.
Orthographic views have ``u = M x + t`` in the picture, with M the first rows of a rotation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from panopath.counting import CameraCounts, CameraModel, PathBasis, path_vectors

Int64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

#: Sums of 32 products of two residues fit in 63 bits.
PRIME = 2**29 - 3


def extra_freedoms(  # noqa: PLR0917
    model: CameraModel,
    n: int,
    m: int,
    k: int = 0,
    basis: PathBasis = None,
    seen: Bool | None = None,
    n_still: int = 0,
    seed: int = 1,
) -> int:
    """Freedoms beyond the gauge of n points and m views in general position.

    ``seen`` is (m, n), by default everything. The first ``n_still`` points are at rest, which is not known.
    """
    free_of_image = model is CameraModel.PROJECTIVE_SPACE
    rng = np.random.default_rng(seed)
    vectors = path_vectors(k, basis)
    paths = _random(rng, n, vectors, model.counts.d)
    paths[:n_still, 1:] = 0
    functions = _functions(rng, m, vectors, basis)
    # a camera matrix has one unknown more than a camera, its length
    counts = model.counts._replace(f=model.counts.f + int(free_of_image))
    places = (functions @ paths.transpose(1, 0, 2).reshape(vectors, -1) % PRIME).reshape(m, n, -1)
    views = [_VIEWS[model](rng, model) for _ in range(m)]
    sees = np.ones((m, n), dtype=np.bool_) if seen is None else seen
    nullity = _nullity(views, counts, functions, places, sees)
    return nullity - (m if free_of_image else 0) - model.gauge(k, basis)


def extra_freedoms_of_pictures(n: int, m: int, *, scaled: bool, tilted: bool, seed: int = 1) -> int:
    """Freedoms beyond the gauge of n points and m orthographic pictures in which one direction is known.

    The affine limit of cameras that know the vertical (section 7, second remark). Where they know all of it, a picture
    has a turn about the vertical and two offsets; ``tilted``: only the direction in the picture of the projected
    vertical is known, and the tilt is unknown too; ``scaled``: each picture has a scale of its own. The gauge has three
    shifts, the turn about the vertical, and the scale of space where pictures are scaled.
    """
    rng = np.random.default_rng(seed)
    counts = CameraCounts(3, 3 + int(tilted) + int(scaled), 4 + int(scaled), 0)
    functions, points = np.ones((m, 1), dtype=np.int64), _random(rng, n, 3)
    views = [_upright_picture(rng, scaled, tilted) for _ in range(m)]
    places = np.broadcast_to(points, (m, n, 3))
    return _nullity(views, counts, functions, places, np.ones((m, n), dtype=np.bool_)) - counts.g


def _nullity(views: Sequence[_View], counts: CameraCounts, functions: Int64, places: Int64, seen: Bool) -> int:
    """Unknowns less rank of all derivatives; ``places`` (m, n, d) are those of the points at the time of each view."""
    d, f, _, h = counts
    m, n = seen.shape
    vectors = len(functions[0])
    n_of_points = d * vectors * n
    unknowns: int = n_of_points + f * m + h
    rows = [np.zeros((0, unknowns), dtype=np.int64)]
    for i, view in enumerate(views):
        for j in np.flatnonzero(seen[i]).tolist():
            by_point, by_view, by_all = view.derivative(places[i, j])
            row = np.zeros((d - 1, unknowns), dtype=np.int64)
            start = d * vectors * j
            row[:, start : start + d * vectors] = np.kron(functions[i], by_point) % PRIME
            row[:, n_of_points + f * i : n_of_points + f * (i + 1)] = by_view
            row[:, n_of_points + f * m :] = by_all
            rows.append(row)
    return unknowns - rank(np.vstack(rows))


def rank(matrix: Int64) -> int:
    """Rank modulo the prime, by elimination."""
    left = matrix % PRIME
    done = 0
    for column in range(left.shape[1]):
        found = np.flatnonzero(left[done:, column])
        if not len(found):
            continue
        left[[done, done + found[0]]] = left[[done + found[0], done]]
        left[done] = left[done] * pow(int(left[done, column]), -1, PRIME) % PRIME
        below = left[done + 1 :]
        below -= below[:, column, None] * left[done] % PRIME
        below %= PRIME
        done += 1
        if done == len(left):
            break
    return done


class _View(Protocol):
    def derivative(self, point: Int64) -> tuple[Int64, Int64, Int64]:
        """Rows by the point, by the unknowns of the view, by those that all views share."""


@dataclass(frozen=True)
class _Central:
    """A view with a centre, and perhaps turns about given axes, and perhaps a focal length along its optical axis."""

    center: Int64
    #: (t, d, d) generators of the turns that are unknown.
    turns: Int64
    #: (d,) the optical axis; empty where the focal length is known.
    axis: Int64

    def derivative(self, point: Int64) -> tuple[Int64, Int64, Int64]:
        ray = (point - self.center) % PRIME
        across = _across(ray)
        moved = np.column_stack([-np.eye(len(ray), dtype=np.int64), (self.turns @ ray).T % PRIME])
        if not len(self.axis):
            return across, across @ moved % PRIME, np.zeros((len(across), 0), np.int64)
        # a longer focal length is a ray shorter along the axis
        along = int(self.axis @ ray) * pow(int(self.axis @ self.axis), -1, PRIME) % PRIME
        zoom = self.axis[:, None] * along % PRIME
        return across, across @ moved % PRIME, across @ zoom % PRIME


@dataclass(frozen=True)
class _Flat:
    """A view that is an affine map, with the ways in which the map may change."""

    #: (d - 1, d)
    projection: Int64
    #: (t, d - 1, d)
    changes: Int64

    def derivative(self, point: Int64) -> tuple[Int64, Int64, Int64]:
        size = len(self.projection)
        by_view = np.column_stack([(self.changes @ point % PRIME).T, np.eye(size, dtype=np.int64)])
        return self.projection, by_view, np.zeros((size, 0), np.int64)


@dataclass(frozen=True)
class _Projective:
    """A view that is a matrix of shape (3, 4), known up to its length."""

    matrix: Int64

    def derivative(self, point: Int64) -> tuple[Int64, Int64, Int64]:
        whole = np.append(point, 1)
        across = _across(self.matrix @ whole % PRIME)
        return across @ self.matrix[:, :3] % PRIME, np.kron(across, whole) % PRIME, np.zeros((2, 0), np.int64)


#: Generators of the turns about x, y and z, and of the one turn of the plane.
_AXES = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
)
_PLANE = np.array([[[0, -1], [1, 0]]])


def _oriented(rng: np.random.Generator, model: CameraModel) -> _Central:
    return _Central(
        _random(rng, model.counts.d), np.zeros((0, model.counts.d, model.counts.d), np.int64), np.zeros(0, np.int64)
    )


def _turning(rng: np.random.Generator, model: CameraModel) -> _Central:
    turns = _PLANE if model.counts.d == 2 else _AXES
    return _Central(_random(rng, model.counts.d), turns, np.zeros(0, np.int64))


def _upright(rng: np.random.Generator, model: CameraModel) -> _Central:
    return _Central(_random(rng, model.counts.d), _AXES[2:], np.zeros(0, np.int64))


def _zooming(rng: np.random.Generator, model: CameraModel) -> _Central:
    return _Central(_random(rng, model.counts.d), _AXES, _random(rng, model.counts.d))


def _orthographic(rng: np.random.Generator, model: CameraModel) -> _Flat:
    d = model.counts.d
    turns = _PLANE if d == 2 else _AXES
    projection = _rotation(rng, d)[: d - 1]
    changes = projection @ turns % PRIME
    if model is CameraModel.SCALED_ORTHOGRAPHIC_SPACE:
        changes = np.concatenate([changes, projection[None]])
    return _Flat(projection, changes)


def _upright_picture(rng: np.random.Generator, scaled: bool, tilted: bool) -> _Flat:
    """Draw a picture whose first axis is horizontal, so that the vertical is seen along the second one."""
    w, x, y, z = _random(rng, 4).tolist()
    turn, tilt = _of_quaternion(w, 0, 0, z), _of_quaternion(y, x, 0, 0)
    rows = tilt @ turn % PRIME
    changes = [rows[:2] @ _AXES[2] % PRIME]
    if tilted:
        changes.append(np.stack([np.zeros(3, dtype=np.int64), rows[2]]))
    if scaled:
        changes.append(rows[:2])
    return _Flat(rows[:2], np.stack(changes))


def _affine(rng: np.random.Generator, model: CameraModel) -> _Flat:
    changes = np.eye(2 * model.counts.d, dtype=np.int64).reshape(-1, 2, model.counts.d)
    return _Flat(_random(rng, 2, model.counts.d), changes)


def _uncalibrated(rng: np.random.Generator, _: CameraModel) -> _Projective:
    return _Projective(_random(rng, 3, 4))


_VIEWS: dict[CameraModel, Callable[[np.random.Generator, CameraModel], _View]] = {
    CameraModel.ORIENTED_PLANE: _oriented,
    CameraModel.ORIENTED_SPACE: _oriented,
    CameraModel.NON_ORIENTED_PLANE: _turning,
    CameraModel.NON_ORIENTED_SPACE: _turning,
    CameraModel.GRAVITY_SPACE: _upright,
    CameraModel.ORTHOGRAPHIC_PLANE: _orthographic,
    CameraModel.ORTHOGRAPHIC_SPACE: _orthographic,
    CameraModel.SCALED_ORTHOGRAPHIC_SPACE: _orthographic,
    CameraModel.AFFINE_SPACE: _affine,
    CameraModel.SHARED_FOCAL_SPACE: _zooming,
    CameraModel.PROJECTIVE_SPACE: _uncalibrated,
}


def _across(ray: Int64) -> Int64:
    """(d - 1, d) rows that vanish on the ray; its first coordinate is not zero."""
    rows = np.zeros((len(ray) - 1, len(ray)), dtype=np.int64)
    rows[:, 0] = -ray[1:] % PRIME
    rows[:, 1:] = np.eye(len(ray) - 1, dtype=np.int64) * ray[0]
    return rows


def _functions(rng: np.random.Generator, m: int, vectors: int, basis: PathBasis) -> Int64:
    """(m, K) values of the basis at the time of each view; functions that are any are random."""
    if basis is None or basis == "taylor":
        time = _random(rng, m)
        return np.array([[pow(int(t), power, PRIME) for power in range(vectors)] for t in time])
    if basis != "fourier":
        return _random(rng, m, vectors)
    rows = []
    for s in _random(rng, m).tolist():
        # the rational points of the circle, and its powers as complex numbers
        scale = pow(1 + s * s, -1, PRIME)
        cos, sin = (1 - s * s) * scale % PRIME, 2 * s * scale % PRIME
        row, power = [1], (1, 0)
        for _ in range(vectors // 2):
            power = (power[0] * cos - power[1] * sin) % PRIME, (power[0] * sin + power[1] * cos) % PRIME
            row.extend(power)
        rows.append(row)
    return np.array(rows)


def _rotation(rng: np.random.Generator, d: int) -> Int64:
    """Cayley's map from antisymmetric matrices, without its denominator: orthogonal rows of equal length."""
    if d == 2:
        a, b = _random(rng, 2).tolist()
        rows = [[a * a - b * b, -2 * a * b], [2 * a * b, a * a - b * b]]
        return np.array([[entry % PRIME for entry in row] for row in rows])
    return _of_quaternion(*_random(rng, 4).tolist())


def _of_quaternion(w: int, x: int, y: int, z: int) -> Int64:
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.array([[entry % PRIME for entry in row] for row in rows])


def _random(rng: np.random.Generator, *shape: int) -> Int64:
    return rng.integers(1, PRIME, size=shape)
