"""What of a scene whose points may move its bearings leave free."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from panopath import _core
from panopath.certificate import Gap
from panopath.errors import InputError
from panopath.freedoms import Freedom, FreedomKind, NullVector, PathCertificate, Reach
from panopath.model import Bool, Float, Scene, Tracks, read_only
from panopath.paths import core_model
from panopath.steps.common import call_core


@dataclass(frozen=True)
class FreedomOptions:
    """Choices of :func:`certify_paths`; the defaults are meant to be right."""

    #: Angular standard deviation of a bearing, radians. None: that of the tracks, else what the solver found; 0: only
    #: what is free exactly.
    sigma_rad: float | None = None
    #: Angle of turning rays, over the relative movement, below which a mode is null.
    null_below: float = 1e-7
    #: A track is refused where one standard deviation moves it by more than this share of its distance.
    refuse_movement: float = 0.5
    #: Null vectors that are given for each freedom, at most; all are counted.
    most_vectors: int = 24
    #: Threads to use; None: all cores. The answer does not depend on it.
    threads: int | None = None

    def __post_init__(self) -> None:
        for name in ("sigma_rad", "null_below", "refuse_movement"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} is {value!r}, expected a number that is not negative")
        if self.most_vectors < 0:
            raise InputError(f"most_vectors is {self.most_vectors!r}, expected a number that is not negative")


def certify_paths(tracks: Tracks, scene: Scene, options: FreedomOptions | None = None) -> PathCertificate:
    """Find, count and name what the observations of a scene with moving points leave free.

    Parameters
    ----------
    tracks
        The observations: which view saw which track, their ``sigma_rad``, and the times of the views.
    scene
        Where all are, with its ``paths``: what a solver found, or the truth. Its inliers count.
    options
        Choices; default ``FreedomOptions()``.

    Returns
    -------
    PathCertificate
        The null space of the bearing equations of the model (Knill & Ramirez-Herran 2007, section 6), its gauge, a name
        for each further freedom with the null vectors themselves, and what the rays of each track tell by themselves.

    Raises
    ------
    InputError
        Naming the argument that cannot be used.
    """
    chosen = FreedomOptions() if options is None else options
    if scene.paths is None:
        raise InputError("scene.paths is None: certify tells of scenes whose points are at rest")
    if tracks.time_s is None:
        raise InputError("tracks.time_s is None, expected the times of the views")
    if (len(scene.centers), len(scene.points), scene.d) != (tracks.n_views, tracks.n_tracks, tracks.d):
        raise InputError(f"the scene was not made from {tracks!r}: their numbers differ")
    if scene.inlier.shape != tracks.view.shape:
        raise InputError(f"scene.inlier has {len(scene.inlier)} entries, expected {len(tracks.view)}")
    # a track of which nothing was found takes no part; its form may have gaps
    models = [core_model(model) for model in scene.paths.models]
    lost: Bool = np.asarray(~np.isfinite(scene.paths.coefficients[scene.paths.starts[:-1]]).all(axis=1))
    used = scene.inlier & ~lost[tracks.track]
    each, sigma = _sigmas(tracks, scene, chosen)
    found = call_core(
        _core.freedoms_of_paths,
        (tracks.view[used], tracks.track[used], None if each is None else each[used]),
        (
            scene.centers,
            tracks.time_s,
            [
                (form, order, [1.0 if gone and np.isnan(x) else x for x in numbers])
                for (form, order, numbers), gone in zip(models, lost.tolist(), strict=True)
            ],
            scene.paths.coefficients,
        ),
        {
            "sigma_rad": sigma,
            "null_below": float(chosen.null_below),
            "refuse_movement": float(chosen.refuse_movement),
            "most_vectors": chosen.most_vectors,
            "threads": chosen.threads,
        },
    )
    return PathCertificate(
        nullity=found["nullity"],
        gauge_freedoms=found["gauge_freedoms"],
        freedoms=tuple(_freedom(plain) for plain in found["freedoms"]),
        gap=Gap(*found["gap"]),
        weakest_movement=found["weakest_movement"],
        equations=found["equations"],
        unknowns=found["unknowns"],
        sigma_rad=sigma if each is None else float(np.median(each)),
        reaches=tuple(Reach(reason) for reason in found["reason"]),
        null=found["null"],
        **{name: found[name] for name in _BY_TRACK},
    )


_BY_TRACK = ("is_exact", "dimension", "hidden_by", "movement", "camera_part", "noise_part")


def _sigmas(tracks: Tracks, scene: Scene, options: FreedomOptions) -> tuple[Float | None, float]:
    """Find standard deviations of single observations where there are any, and one for all."""
    if options.sigma_rad is not None:
        return None, float(options.sigma_rad)
    if tracks.sigma_rad is not None:
        return tracks.sigma_rad, 0.0
    found = scene.summary.sigma_rad
    return None, float(found) if found is not None and np.isfinite(found) else 0.0


def _freedom(plain: dict[str, Any]) -> Freedom:
    vectors = tuple(_vector(vector) for vector in plain.pop("vectors"))
    members = {name: read_only(plain.pop(name)) for name in ("views", "tracks")}
    return Freedom(kind=FreedomKind(plain.pop("kind")), vectors=vectors, **members, **plain)


def _vector(plain: dict[str, Any]) -> NullVector:
    arrays = {name: read_only(plain.pop(name)) for name in ("centers", "coefficients", "stretch")}
    return NullVector(**arrays, **plain)
