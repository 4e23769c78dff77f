"""Planar views that the search for headings left out: onto the refined points, and parts onto one another.

A view that sees three known points is fixed by them (Rust: ``headings/resect.rs``): with the points ``z`` as complex
numbers, ``q = exp(-i heading)`` and ``p = center q``, each bearing ``u`` gives ``Im[(z q - p) conj(u)] = 0``, linear in
four real numbers up to scale. Parts that share three points differ by a similarity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from panopath.evaluate import fit_similarity
from panopath.model import Bool, Float, Scene, Tracks
from panopath.steps.refinement import RefineOptions, refine

#: Bearings of a resected view may miss by this many standard deviations.
_LIMIT_SIGMAS = 4.0
#: Noise that is believed at the least: few bearings show too little.
_LEAST_NOISE_RAD = float(np.radians(0.1))
_FEWEST_POINTS = 3
_MOST_ROUNDS = 10
#: A joined part must keep this share of its inliers.
_KEPT = 0.9


def complete_planar(tracks: Tracks, scene: Scene, options: RefineOptions | None = None) -> Scene:
    """Place more views of the plane: join parts that share points, resect views, refine; until nothing is added.

    Three points fix a view without a check, so that such a view tells nothing of the points, and only where all its
    bearings agree is it taken.

    Parameters
    ----------
    tracks
        The observations, bearings in the cameras, d = 2.
    scene
        What :func:`panopath.refine` made of the views whose headings were found.
    options
        Choices of the refinement.
    """
    for _ in range(_MOST_ROUNDS):
        joined = _join_parts(tracks, scene, options)
        found = resect_views(tracks, joined)
        if joined is scene and not found.placed.any():
            break
        scene = refine(tracks, found.added_to(joined), options) if found.placed.any() else joined
    return scene


@dataclass(frozen=True, eq=False)
class ResectedViews:
    """Poses of views by known points."""

    #: (n_views,) True where a view outside the largest part was resected onto it.
    placed: Bool
    #: (n_views,) radians, and (n_views, 2).
    heading_rad: Float
    center: Float

    def added_to(self, scene: Scene) -> Scene:
        """Put the views into the largest part."""
        return replace(
            scene,
            centers=np.where(self.placed[:, None], self.center, scene.centers),
            cam_from_world=np.where(self.placed, self.heading_rad, scene.cam_from_world),
            view_component=np.where(self.placed, 0, scene.view_component),
        )


def resect_views(tracks: Tracks, scene: Scene) -> ResectedViews:
    """Resect views outside the largest part onto its points."""
    known = scene.track_component == 0
    rows = np.flatnonzero(known[tracks.track] & (scene.view_component[tracks.view] != 0))
    n, view = tracks.n_views, tracks.view[rows]
    if not len(rows):
        return ResectedViews(np.zeros(n, dtype=np.bool_), np.full(n, np.nan), np.full((n, 2), np.nan))
    middle = scene.points[known].mean(axis=0)
    size = np.abs(scene.points[known] - middle).max()
    z = (scene.points[tracks.track[rows]] - middle) / size @ [1.0, 1.0j]
    u = tracks.bearing[rows] @ [1.0, 1.0j]
    turned = z * u.conj()
    row = np.stack((turned.imag, turned.real, u.imag, -u.real), axis=1)
    squares = np.zeros((n, 4, 4))
    np.add.at(squares, view, row[:, :, None] * row[:, None, :])
    values, vectors = np.linalg.eigh(squares)
    q, p = vectors[:, :2, 0] @ [1.0, 1.0j], vectors[:, 2:, 0] @ [1.0, 1.0j]
    count = np.bincount(view, minlength=n)
    good = (count >= _FEWEST_POINTS) & (values[:, 1] > 1e-12 * values[:, 3]) & (np.abs(q) > 1e-9)
    center = p / np.where(good, q, 1.0)
    heading = -np.angle(q)

    def miss() -> Float:
        return np.asarray(np.angle(u * np.exp(1j * heading[view]) / (z - center[view])))

    with np.errstate(divide="ignore", invalid="ignore"):
        behind = np.bincount(view, np.abs(miss()) > 0.5 * np.pi, n)
        heading += np.where(2 * behind > count, np.pi, 0.0)
        worst = np.zeros(n)
        np.maximum.at(worst, view, np.abs(miss()))
    good &= worst < _LIMIT_SIGMAS * max(scene.summary.sigma_rad, _LEAST_NOISE_RAD)
    return ResectedViews(good, heading, np.stack((center.real, center.imag), axis=1) * size + middle)


def _join_parts(tracks: Tracks, scene: Scene, options: RefineOptions | None) -> Scene:
    """Bring a smaller part that sees three points of the largest into its frame, where a refinement keeps both."""
    for part in range(1, scene.n_components):
        members = scene.view_component == part
        # the part's own opinion of the points that it shares
        seen = members[tracks.view]
        alone = _only(scene, members, scene.track_component == part)
        own = refine(tracks.select(seen), _sliced(alone, seen), options)
        both = np.isfinite(own.points).all(axis=1) & (scene.track_component == 0) & (own.track_component == 0)
        if both.sum() < _FEWEST_POINTS:
            continue
        scale, turn, shift = fit_similarity(own.points[both], scene.points[both])
        only_here = (own.track_component == 0) & (scene.track_component != 0)
        moved = replace(
            scene,
            centers=np.where(members[:, None], scale * own.centers @ turn.T + shift, scene.centers),
            points=np.where(only_here[:, None], scale * own.points @ turn.T + shift, scene.points),
            cam_from_world=np.where(
                members, own.cam_from_world + np.arctan2(turn[1, 0], turn[0, 0]), scene.cam_from_world
            ),
            view_component=np.where(members, 0, scene.view_component),
            track_component=np.where(only_here, 0, scene.track_component),
        )
        joined = refine(tracks, moved, options)
        largest = (scene.view_component == 0)[tracks.view]
        if all(
            joined.inlier[rows].sum() >= _KEPT * before
            for rows, before in ((seen, own.summary.n_inliers), (largest, (scene.inlier & largest).sum()))
        ):
            return joined
    return scene


def _only(scene: Scene, views: Bool, points: Bool) -> Scene:
    return replace(
        scene,
        view_component=np.where(views, 0, -1),
        track_component=np.where(points, 0, -1),
    )


def _sliced(scene: Scene, rows: Bool) -> Scene:
    return replace(scene, inlier=scene.inlier[rows], residual_rad=scene.residual_rad[rows], tracks=None)
