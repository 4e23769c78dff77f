"""Bearing rigidity in exact arithmetic: how much is free, and what moves as one.

View i at C_i sees point j at X_j along u = X_j - C_i. A motion (dC, dX, and a turn of each view, omega = sum w_t G_t
with skew G_t, as far as orientations are unknown) leaves the bearing as it is iff

    dX_j - dC_i - omega_i u = lambda u   for a number lambda, the stretch of the ray,

so a . (dX_j - dC_i - omega_i u) = 0 for the d - 1 vectors a that span what is orthogonal to u. Coordinates are
fractions, so this is a linear system over the rationals. Its rank is taken modulo a prime, where no number is small by
chance and none is rounded; a prime divides a minor that is not zero with a probability near 1/p, and a second prime is
asked too.

Each observation has, for every motion of a basis, the similarity by which it moves: stretch, turn and shift, the latter
tau = dC - lambda C - omega C at either end of the ray. Observations are in one rigid component iff these are equal for
all motions: then, and then only, are all their members determined up to one common similarity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt
from panopath.certificate import OrientationModel

Position = tuple[Fraction, ...]
Ray = tuple[int, int]
Members = tuple[frozenset[int], frozenset[int]]
Residues = npt.NDArray[np.int64]

#: Products of two residues stay below 2^63.
PRIMES = (2**31 - 1, 2**31 - 19)


@dataclass(frozen=True)
class Rigidity:
    """What the exact bearing-rigidity matrix says."""

    nullity: int
    #: Views and points of each component of two observations or more, the one with the most observations first.
    components: tuple[Members, ...]


def gauge_freedoms(d: int, orientation: OrientationModel) -> int:
    """Translations, scale, and the turns that the model leaves free."""
    return d + 1 + len(turn_generators(d, orientation))


def turn_generators(d: int, orientation: OrientationModel) -> Residues:
    """(t, d, d) skew matrices, one for each unknown turn of a view."""
    about_z = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0]], dtype=np.int64)
    if orientation == "known":
        return np.zeros((0, d, d), dtype=np.int64)
    if d == 2:
        return about_z[None, :2, :2]
    if orientation == "vertical":
        return about_z[None]
    return np.stack([about_z, np.roll(about_z, (1, 1), (0, 1)), np.roll(about_z, (2, 2), (0, 1))])


def exact_rigidity(
    views: Sequence[Position], points: Sequence[Position], rays: Sequence[Ray], orientation: OrientationModel
) -> Rigidity:
    """Nullity and rigid components of a configuration; a view must not stand at a point that it sees.

    Raises
    ------
    ArithmeticError
        Where the two primes do not agree.
    """
    first, second = (_modulo(prime, views, points, rays, orientation) for prime in PRIMES)
    if first != second:
        raise ArithmeticError(f"{first} modulo one prime, but {second} modulo another")
    return first


def _modulo(
    p: int, views: Sequence[Position], points: Sequence[Position], rays: Sequence[Ray], orientation: OrientationModel
) -> Rigidity:
    centers, targets = _residues(views, p), _residues(points, p)
    view, track = np.array(rays).T
    u = (targets[track] - centers[view]) % p
    if not u.any(axis=1).all():
        raise ArithmeticError("a view stands at a point that it sees")
    (m, d), generators = centers.shape, turn_generators(centers.shape[1], orientation)
    t = len(generators)
    turned = np.einsum("tab,ob->ota", generators, u) % p

    rows = np.zeros((len(rays), d - 1, m * (d + t) + len(targets) * d), dtype=np.int64)
    normals = _normals(u, p)
    for o, (i, j) in enumerate(rays):
        at_view, at_point = i * (d + t), m * (d + t) + j * d
        rows[o, :, at_view : at_view + d] = -normals[o] % p
        for k in range(t):
            rows[o, :, at_view + d + k] = -_dot(normals[o], turned[o, k], p) % p
        rows[o, :, at_point : at_point + d] = normals[o]
    basis = _null_space(rows.reshape(-1, rows.shape[2]), p)

    poses = basis[: m * (d + t)].reshape(m, d + t, -1)[view]
    shift, omega = poses[:, :d], poses[:, d:]
    end = basis[m * (d + t) :].reshape(len(targets), d, -1)[track]
    moved = (end - shift) % p
    at_center = np.einsum("tab,ob->ota", generators, centers[view]) % p
    for k in range(t):
        moved = (moved - turned[:, k, :, None] * omega[:, k, None, :] % p) % p
        shift = (shift - at_center[:, k, :, None] * omega[:, k, None, :] % p) % p
    pivot, every = (u != 0).argmax(axis=1), np.arange(len(rays))
    inverse = np.array([pow(int(value), -1, p) for value in u[every, pivot]])
    stretch = moved[every, pivot] * inverse[:, None] % p
    shift = (shift - centers[view][:, :, None] * stretch[:, None, :] % p) % p
    similarity = np.concatenate((stretch[:, None], omega, shift), axis=1)
    return Rigidity(basis.shape[1], components_of(rays, [key.tobytes() for key in similarity]))


def components_of(rays: Sequence[Ray], similarity: Sequence[bytes]) -> tuple[Members, ...]:
    """Views and points of the observations that share a key, where these are two or more; largest first."""
    groups: dict[bytes, list[Ray]] = {}
    for ray, key in zip(rays, similarity, strict=True):
        groups.setdefault(key, []).append(ray)
    large = sorted((group for group in groups.values() if len(group) > 1), key=len, reverse=True)
    return tuple((frozenset(i for i, _ in group), frozenset(j for _, j in group)) for group in large)


def _residues(positions: Sequence[Position], p: int) -> Residues:
    return np.array([[x.numerator * pow(x.denominator, -1, p) % p for x in position] for position in positions])


def _dot(rows: Residues, vector: Residues, p: int) -> Residues:
    """Product of rows and a vector, each term reduced before it is added."""
    total: Residues = (rows * vector % p).sum(axis=-1) % p
    return total


def _normals(u: Residues, p: int) -> Residues:
    """(N, d - 1, d) vectors that span what is orthogonal to each u: rows of the cross product but a dependent one."""
    if u.shape[1] == 2:
        return np.stack((-u[:, 1] % p, u[:, 0]), axis=1)[:, None]
    x, y, z = u.T
    zero = np.zeros_like(x)
    cross = np.stack([np.stack(row, axis=1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=1) % p
    kept = [[row for row in range(3) if row != k] for k in (u != 0).argmax(axis=1)]
    normals: Residues = cross[np.arange(len(u))[:, None], np.array(kept)]
    return normals


def _null_space(matrix: Residues, p: int) -> Residues:
    """(columns, nullity) basis of the null space modulo p, by Gauss-Jordan elimination."""
    rest, columns = matrix.copy(), matrix.shape[1]
    pivots: list[int] = []
    for column in range(columns):
        row = len(pivots)
        below = np.flatnonzero(rest[row:, column])
        if not len(below):
            continue
        rest[[row, row + below[0]]] = rest[[row + below[0], row]]
        rest[row] = rest[row] * pow(int(rest[row, column]), -1, p) % p
        others = np.flatnonzero(rest[:, column])
        others = others[others != row]
        rest[others] = (rest[others] - rest[others, column, None] * rest[row] % p) % p
        pivots.append(column)
    free = [column for column in range(columns) if column not in set(pivots)]
    basis = np.zeros((columns, len(free)), dtype=np.int64)
    basis[free, np.arange(len(free))] = 1
    basis[pivots] = -rest[: len(pivots), free] % p
    return basis
