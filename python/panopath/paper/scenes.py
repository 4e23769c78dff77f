"""Exact scenes for the experiments: bearings of given positions, noise, and the dense rank of their equations.

A sighting of ``x`` from ``c`` along the unit vector ``u`` is the equation ``(I - u u^T)(x - c) = 0`` (the paper's
sections 4 and 5, in any dimension). The null space of all of them, computed here with nothing but numpy, is what the
certificate is held against.
"""

from __future__ import annotations

import numpy as np

from panopath.certificate import Certificate
from panopath.formats.structure import known_scene
from panopath.model import Bool, Float, Scene, Tracks
from panopath.steps.certificate import CertifyOptions, certify

#: Singular values below this share of the largest are zero.
_ZERO = 1e-9


def rays(centers: Float, points: Float, seen: Bool | None = None, time_s: Float | None = None) -> Tracks:
    """See points (n, d) from views (m, d) exactly; ``seen`` is (m, n), by default everything."""
    shape = (len(centers), len(points))
    view, track = np.nonzero(np.ones(shape, dtype=np.bool_) if seen is None else seen)
    ray = points[track] - centers[view]
    return Tracks.from_arrays(view, track, unit(ray), *shape, time_s=time_s)


def unit(ray: Float) -> Float:
    """Vectors (N, d) of length one."""
    return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True))


def disturbed(tracks: Tracks, sigma_rad: float, rng: np.random.Generator) -> Tracks:
    """Turn each bearing at random: normal errors of this deviation along each tangent direction."""
    noise = rng.normal(size=tracks.bearing.shape) * sigma_rad
    noise -= (noise * tracks.bearing).sum(axis=1, keepdims=True) * tracks.bearing
    return with_bearings(tracks, unit(tracks.bearing + noise))


def with_bearings(tracks: Tracks, bearing: Float) -> Tracks:
    """Exchange the bearings."""
    counts = (tracks.n_views, tracks.n_tracks)
    return Tracks.from_arrays(tracks.view, tracks.track, bearing, *counts, time_s=tracks.time_s)


def truth_of(tracks: Tracks, centers: Float, points: Float) -> Scene:
    """Make the true scene of bearings that are world directions."""
    return known_scene(tracks, None, centers, points)


def certified_freedoms(tracks: Tracks, centers: Float, points: Float, threads: int = 0) -> int:
    """Freedoms beyond shift and scale, as the certificate counts them."""
    found = certify(tracks, truth_of(tracks, centers, points), CertifyOptions(threads=threads or None))
    return found.nullity - found.gauge_freedoms


def dense_freedoms(tracks: Tracks) -> int:
    """Freedoms beyond shift and scale: the null space of all equations, by singular values."""
    d, m = tracks.d, tracks.n_views
    across = np.eye(d) - tracks.bearing[:, :, None] * tracks.bearing[:, None, :]
    rows = np.zeros((len(tracks), d, m + tracks.n_tracks, d))
    each = np.arange(len(tracks))
    rows[each, :, m + tracks.track], rows[each, :, tracks.view] = across, -across
    return nullity(rows.reshape(len(tracks) * d, -1)) - (d + 1)


def null_vector(certificate: Certificate) -> tuple[Float, Float]:
    """Displacements of views (m, d) and points (n, d) that keep all bearings, of an undetermined scene.

    The first null mode; else the first member that slides by itself, which is no mode of the rest.
    """
    for mode in certificate.modes:
        if mode.is_null:
            return mode.view_displacement, mode.track_displacement
    views, points = np.zeros_like(certificate.view_line), np.zeros_like(certificate.track_line)
    for line, moved in ((certificate.track_line, points), (certificate.view_line, views)):
        sliding = np.flatnonzero(np.isfinite(line).all(axis=1))
        if len(sliding):
            moved[sliding[0]] = line[sliding[0]]
            break
    return views, points


def nullity(matrix: Float) -> int:
    """Columns less rank, by singular values."""
    # the triangular factor has the same singular values, and far fewer rows
    values = np.linalg.svd(np.linalg.qr(matrix, mode="r"), compute_uv=False)
    return int(matrix.shape[1] - (values > _ZERO * values[0]).sum())


def slope(x: Float, y: Float) -> float:
    """Exponent of a power law through positive values: the slope between logarithms, by least squares."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
