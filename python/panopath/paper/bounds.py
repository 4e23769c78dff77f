"""The least error that noise in the angles allows.

With errors of variance ``s^2`` in every azimuth ``theta`` and elevation ``phi``, the information about all positions is
``J^T J / s^2``, where the rows of ``J`` are the derivatives of the angles,

    d theta / d x = (-y, x, 0) / rho^2,   d phi / d x = (-x z / rho, -y z / rho, rho) / r^2,

``(x, y, z)`` from camera to point, ``rho`` its horizontal and ``r`` its whole length. The pseudo-inverse is the bound
of Cramer and Rao for normal errors, in the frame of a fit by shift and scale over all views and points: shift and scale
are the null space of ``J``. Of other errors of the same variance, such as uniform ones, it is the least that an
estimate linear in them can have (Gauss and Markov).
"""

from __future__ import annotations

import numpy as np

from panopath.model import Float

#: Below this share of the largest pivot the positions count as not determined.
_SMALLEST_PIVOT = 1e-7


def angle_bound(centers: Float, points: Float) -> Float:
    """Variance (m + n,) of every view and point, summed over axes, for angles with a standard deviation of one radian.

    Parameters
    ----------
    centers, points
        (m, d) and (n, d), the truth; every view sees every point. NaN comes back where they are not determined.
    """
    d = centers.shape[1]
    information = _information(centers, points)
    nodes = np.concatenate((centers, points))
    count = len(nodes)
    gauge = np.zeros((d + 1, count, d))
    gauge[np.arange(d), :, np.arange(d)] = 1.0
    gauge[d] = nodes - nodes.mean(axis=0)
    null = gauge.reshape(d + 1, -1)
    null = null / np.linalg.norm(null, axis=1, keepdims=True)
    # what is free is given a size of its own, and taken away again
    size = np.trace(information) / len(information)
    try:
        lower = np.linalg.cholesky(information + size * null.T @ null)
    except np.linalg.LinAlgError:
        return np.full(count, np.nan)
    pivots = np.diag(lower)
    if not pivots.min() > _SMALLEST_PIVOT * pivots.max():
        return np.full(count, np.nan)
    variance = (np.linalg.inv(lower) ** 2).sum(axis=0) - (null**2).sum(axis=0) / size
    return np.asarray(variance.reshape(count, d).sum(axis=1))


def _information(centers: Float, points: Float) -> Float:
    """Information of all coordinates, the views first, for angles with a standard deviation of one radian."""
    (m, d), n = centers.shape, len(points)
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = _angle_derivatives(points[None] - centers[:, None])
    blocks = np.einsum("ijkr,ijkc->ijrc", rows, rows)
    whole = np.zeros((m + n, d, m + n, d))
    views, tracks = np.arange(m), np.arange(m, m + n)
    whole[views, :, views, :] = blocks.sum(axis=1)
    whole[tracks, :, tracks, :] = blocks.sum(axis=0)
    whole[:m, :, m:, :] = -blocks.transpose(0, 2, 1, 3)
    whole[m:, :, :m, :] = -blocks.transpose(1, 2, 0, 3)
    return whole.reshape((m + n) * d, (m + n) * d)


def _angle_derivatives(rays: Float) -> Float:
    """Differentiate: (m, n, d - 1, d) of the angles of rays (m, n, d)."""
    x, y = rays[..., 0], rays[..., 1]
    squared = x**2 + y**2
    if rays.shape[-1] == 2:
        return np.stack((-y, x), axis=-1)[..., None, :] / squared[..., None, None]
    z, flat = rays[..., 2], np.sqrt(squared)
    azimuth = np.stack((-y, x, np.zeros_like(x)), axis=-1) / squared[..., None]
    elevation = np.stack((-x * z / flat, -y * z / flat, flat), axis=-1) / (squared + z**2)[..., None]
    return np.stack((azimuth, elevation), axis=-2)
