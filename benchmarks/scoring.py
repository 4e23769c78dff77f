"""Errors after alignment, written apart from the package so that the package does not mark its own work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from panopath.model import Float


@dataclass(frozen=True)
class Alignment:
    """``aligned = scale * rotation @ found + shift``."""

    scale: float
    rotation: Float
    shift: Float

    def apply(self, positions: Float) -> Float:
        """Aligned copies of (n, d) positions."""
        return self.scale * positions @ self.rotation.T + self.shift

    @property
    def turn_rad(self) -> float:
        """Angle of the rotation."""
        d = len(self.rotation)
        cosine = (np.trace(self.rotation) - (d - 2)) / 2
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def align(found: Float, truth: Float, *, rotate: bool) -> Alignment:
    """Least-squares shift, scale and (where ``rotate``) rotation of (n, d) positions; rows with NaN do not count."""
    rows = np.isfinite(found).all(axis=1) & np.isfinite(truth).all(axis=1)
    if rows.sum() < 2:
        raise ValueError(f"{rows.sum()} common positions, expected at least 2")
    a, b = found[rows], truth[rows]
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    a, b = a - mean_a, b - mean_b
    rotation = np.eye(found.shape[1])
    if rotate:
        u, _, vt = np.linalg.svd(b.T @ a)
        flip = np.ones(len(u))
        flip[-1] = np.sign(np.linalg.det(u @ vt))
        rotation = (u * flip) @ vt
    turned = a @ rotation.T
    scale = float((turned * b).sum() / (a * a).sum())
    return Alignment(scale, rotation, mean_b - scale * rotation @ mean_a)


def distances(found: Float, truth: Float) -> Float:
    """Euclidean errors of each row, (n,)."""
    return np.asarray(np.linalg.norm(found - truth, axis=1))


def rms(values: Float) -> float:
    """Root mean square of the finite values."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


def camera_rms(centers: Float, truth: Float) -> float:
    """Rms camera error after the best shift and scale: the freedoms of known orientation; inf where a view is lost."""
    if not np.isfinite(centers).all():
        return float("inf")
    return rms(distances(align(centers, truth, rotate=False).apply(centers), truth))
