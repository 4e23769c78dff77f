"""Certified scenes, and what their certificates say held against the truth: tables of ``real_certificates``."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import panopath as pp
from panopath.certificate import Certificate, Mode, OrientationModel, hold_still
from panopath.certificate_text import percent
from panopath.errors import InputError
from panopath.model import Bool, Float, Int, Scene, Tracks
from panopath.report import draw_certificate

from benchmarks.page import table
from benchmarks.real_data import picture_link
from benchmarks.real_orientation import largest_part
from benchmarks.scoring import align, distances

#: As the certificate has them: views and points held more loosely are called loose.
LOOSE_VIEW, LOOSE_POINT = 0.1, 0.2
#: Times a certificate is made; the median of their durations is told.
REPEATS = 3


@dataclass(frozen=True)
class Case:
    """A solved scene, and where everything is in truth or by a reference."""

    name: str
    tracks: Tracks
    scene: Scene
    orientation: OrientationModel
    seconds: float
    #: Centres and points; None where nothing is known of them.
    truth: tuple[Float, Float] | None = None


@dataclass(frozen=True)
class Certified:
    """A case with its certificate."""

    case: Case
    certificate: Certificate
    seconds: float


def certified(case: Case) -> Certified:
    """Certify a few times over, for the time it takes."""
    options = pp.CertifyOptions(orientation=case.orientation)
    seconds = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        found = pp.certify(case.tracks, case.scene, options)
        seconds.append(time.perf_counter() - began)
    return Certified(case, found, float(np.median(seconds)))


def timed(name: str, tracks: Tracks, orientation: OrientationModel, solve: Callable[[], Scene]) -> Case:
    """Solve and take the time."""
    began = time.perf_counter()
    scene = solve()
    return Case(name, tracks, scene, orientation, time.perf_counter() - began)


def with_truth(case: Case, truth: tuple[Float, Float]) -> Case:
    """Put the truth beside a case."""
    return Case(case.name, case.tracks, case.scene, case.orientation, case.seconds, truth)


# what certificates say

VERDICTS = (
    *("scene", "verdict", "status", "free beyond the gauge", "parts: views, points", "weakest movement"),
    *("loose views", "loose points", "noise", "solve", "certify"),
)


def verdict_row(one: Certified) -> tuple[str, ...]:
    """Tell one certificate in a row."""
    found, scene = one.certificate, one.case.scene
    parts = [f"{len(part.views)}, {len(part.tracks)}" for part in found.components]
    shown = "; ".join(parts[:3]) + (f"; {len(parts) - 3} more" if len(parts) > 3 else "")
    moved = [part.weakest_movement for part in found.components[:1] if part.verdict != "undetermined"]
    return (
        one.case.name,
        found.verdict.value,
        scene.summary.status.value,
        str(max(found.nullity - found.gauge_freedoms, 0)),
        shown or "none",
        percent(moved[0]) if moved else "-",
        f"{(found.view_looseness > LOOSE_VIEW).sum()} of {found.n_views}",
        f"{(found.track_looseness > LOOSE_POINT).sum()} of {found.n_tracks}",
        f"{np.degrees(found.sigma_rad):.2g} deg, {found.sigma_source}",
        f"{one.case.seconds:.2g} s",
        f"{one.seconds:.2g} s",
    )


def verdicts(every: list[Certified]) -> str:
    """Table of certificates, and the sentence of each."""
    sentences = [f'- {one.case.name}: "{one.certificate.sentence()}"' for one in every]
    return "\n\n".join([table(VERDICTS, [verdict_row(one) for one in every]), "\n".join(sentences)])


# whether that is so


def truth_of(one: Certified) -> tuple[Float, Float]:
    if one.case.truth is None:
        raise ValueError(f"{one.case.name}: nothing to compare with")
    return one.case.truth


@dataclass(frozen=True)
class Errors:
    """How far the largest part is off, after a similarity over its views that a few misplaced ones do not tilt.

    Local errors are of the same kind as looseness: against what holds a member, as a share of the distance from it. NaN
    where nothing is known.
    """

    #: (n_views, d) in the unit of the truth, and its length.
    offset: Float
    view: Float
    #: (n_views,) against the points that the view sees, and (n_tracks,) against the middle of the point's views.
    local_view: Float
    local_track: Float


def errors(case: Case, truth: tuple[Float, Float]) -> Errors:
    """Lay the largest part over the truth."""
    members = largest_part(case.scene)
    centers, points = (
        np.where(inside[:, None], place, np.nan)
        for inside, place in zip(members, (case.scene.centers, case.scene.points), strict=True)
    )
    # in the plane, where landmarks are few and near, they count as well
    found, true = (centers, truth[0]) if case.tracks.d == 3 else (np.vstack((centers, points)), np.vstack(truth))
    used: Bool = np.asarray(np.isfinite(found).all(axis=1))
    fit = align(found, true, rotate=True)
    for _ in range(3):
        fit = align(np.where(used[:, None], found, np.nan), true, rotate=True)
        off = distances(fit.apply(found), true)
        used = np.asarray(np.nan_to_num(off, nan=np.inf) < 4.0 * np.nanmedian(off))
    centers, points = fit.apply(centers), fit.apply(points)
    offset = centers - truth[0]
    view, track = case.tracks.view[case.scene.inlier], case.tracks.track[case.scene.inlier]
    segment, true_segment = points[track] - centers[view], truth[1][track] - truth[0][view]
    astray = np.linalg.norm(segment - true_segment, axis=1) / np.linalg.norm(true_segment, axis=1)
    return Errors(
        offset,
        np.linalg.norm(offset, axis=1),
        _medians(view, astray, case.tracks.n_views),
        _of_means(track, segment, true_segment, case.tracks.n_tracks),
    )


def _medians(member: Int, values: Float, count: int) -> Float:
    """Median of the finite values of each member, NaN of none."""
    order = np.lexsort((values, member))
    order = order[np.isfinite(values[order])]
    start = np.searchsorted(member[order], np.arange(count + 1))
    n = np.diff(start)
    middle = np.minimum(start[:-1] + n // 2, max(len(order) - 1, 0))
    return np.where(n > 0, values[order][middle], np.nan) if len(order) else np.full(count, np.nan)


def _of_means(track: Int, found: Float, true: Float, count: int) -> Float:
    """Error of the mean segment of each track, as a share of its length."""
    known = np.isfinite(found).all(axis=1)
    sums = np.zeros((2, count, found.shape[1]))
    np.add.at(sums[0], track[known], found[known])
    np.add.at(sums[1], track[known], true[known])
    length = np.linalg.norm(sums[1], axis=1)
    return np.asarray(np.linalg.norm(sums[0] - sums[1], axis=1) / np.where(length > 0.0, length, np.nan))


def rank_correlation(a: Float, b: Float) -> float:
    """Spearman's, over the rows where both are finite; NaN where these are few."""
    known = np.isfinite(a) & np.isfinite(b)
    if known.sum() < 6:
        return float("nan")
    ranks = [np.argsort(np.argsort(values[known], kind="stable"), kind="stable") for values in (a, b)]
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])


def deviation(case: Case) -> Float:
    """(n_views,) standard deviation of each view by the covariance, up to a factor; NaN where there is none."""
    try:
        if case.orientation == "known":
            covariance = pp.position_covariance(case.tracks, case.scene)
        else:
            covariance = pp.scene_covariance(case.tracks, case.scene).cameras[:, -case.tracks.d :, -case.tracks.d :]
    except InputError:
        return np.full(case.tracks.n_views, np.nan)
    return np.asarray(np.sqrt(np.trace(covariance, axis1=1, axis2=2)))


def share_along_modes(one: Certified, off: Errors) -> float:
    """Share of the squared error of the views that lies along the weak modes of the largest part; NaN without modes.

    Shifts, scale and turns are taken off both first.
    """
    modes = [mode for mode in one.certificate.modes if not mode.is_null and mode.component == 0]
    known = np.isfinite(off.offset).all(axis=1)
    if not modes or not one.certificate.components:
        return float("nan")
    known &= one.certificate.view_component == 0
    place = one.case.scene.centers[known]
    place = place - place.mean(axis=0)
    # the error in the frame of the scene, any scale
    fit = align(place, one.case.truth[0][known], rotate=True) if one.case.truth is not None else None
    error = off.offset[known] @ fit.rotation if fit is not None else off.offset[known]
    d = place.shape[1]
    turns = [place[:, ::-1] * (-1.0, 1.0)] if d == 2 else [np.cross(axis, place) for axis in np.eye(3)]
    gauge = np.array([*(np.tile(axis, (len(place), 1)) for axis in np.eye(d)), place, *turns]).reshape(
        d + 1 + len(turns), -1
    )
    along = np.array([mode.view_displacement[known].ravel() for mode in modes])
    before = _left_over(gauge, error.ravel())
    return 1.0 - _left_over(np.vstack((gauge, along)), error.ravel()) / before if before > 0.0 else float("nan")


def _left_over(columns: Float, values: Float) -> float:
    """Sum of squares that a fit by these columns leaves."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-300)
    return float(((values - scaled.T @ np.linalg.lstsq(scaled.T, values, rcond=1e-10)[0]) ** 2).sum())


CHECKS = (
    *("scene", "view error: median", "of the loosest tenth", "looseness ranks local errors", "errors"),
    *("covariance ranks errors", "points called loose err by", "others by", "error along the named modes"),
)
LOOSENESS_COLUMN, COVARIANCE_COLUMN = 4, 5


def check_row(one: Certified, unit: str) -> tuple[str, ...]:
    """Hold looseness and modes of a certificate against the errors of the scene."""
    if one.case.truth is None:
        raise ValueError(f"{one.case.name}: nothing to compare with")
    off, found = errors(one.case, one.case.truth), one.certificate
    held, points = np.where(np.isfinite(off.view), found.view_looseness, np.nan), found.track_looseness
    loosest = held >= np.nanquantile(held, 0.9) if np.isfinite(held).any() else np.zeros(len(held), dtype=np.bool_)
    loose, firm = (off.local_track[mask & np.isfinite(off.local_track)] for mask in (points > 0.2, points <= 0.2))
    return (
        one.case.name,
        f"{np.nanmedian(off.view):.3g} {unit}",
        f"{np.nanmedian(off.view[loosest]):.3g} {unit}" if loosest.any() else "-",
        *(
            signed(rank_correlation(a, b))
            for a, b in ((held, off.local_view), (held, off.view), (deviation(one.case), off.view))
        ),
        *(f"{percent(float(np.median(of)))} ({len(of)})" if len(of) else "- (0)" for of in (loose, firm)),
        share(share_along_modes(one, off)),
    )


def signed(value: float) -> str:
    return f"{value:+.2f}" if np.isfinite(value) else "-"


def share(value: float) -> str:
    return f"{100.0 * value:.0f} %" if np.isfinite(value) else "-"


def checks(every: list[Certified], unit: str) -> str:
    """Table that holds certificates against the truth."""
    return table(CHECKS, [check_row(one, unit) for one in every])


def picture(one: Certified, images: Path, name: str, text: str, unit: str = "") -> str:
    """Draw a certificate."""
    with tempfile.TemporaryDirectory() as scratch:
        (drawn,) = draw_certificate(one.case.scene, one.certificate, scratch, unit)
        shutil.move(drawn, images / f"certificate_{name}.png")
    return picture_link(f"certificate_{name}.png", text)


# modes of planar scenes


def settled(one: Certified, mode: Mode) -> Mode:
    """Give a mode of a planar scene with the landmarks of its part standing still, so that few stations move."""
    part = one.certificate.components[mode.component or 0]
    landmarks = (one.case.tracks.n_views + part.tracks).astype(np.int32)
    return hold_still(mode, one.case.scene.centers, one.case.scene.points, landmarks, one.case.orientation)


def movers(one: Certified, mode: Mode) -> Int:
    """Stations that a mode moves by more than a fifth of what it moves most."""
    # views without a place move by NaN
    speed = np.nan_to_num(np.linalg.norm(settled(one, mode).view_displacement, axis=1))
    return np.flatnonzero(speed > 0.2 * speed.max()).astype(np.int32)


NAMED = (
    "log",
    "mode moves",
    "by, of the size",
    "their error",
    "stations that err less",
    "their looseness",
    "rank of it",
)
#: Modes of a log that are told.
MOST_NAMED = 3


def named_rows(one: Certified) -> list[tuple[str, ...]]:
    """Tell which stations the weak modes of the largest part are about, and how far these are off."""
    off, held = errors(one.case, truth_of(one)), one.certificate.view_looseness
    known = off.view[np.isfinite(off.view)]
    rows: list[tuple[str, ...]] = []
    for mode in [mode for mode in one.certificate.modes if not mode.is_null and mode.component == 0][:MOST_NAMED]:
        stations = movers(one, mode)
        few = ", ".join(map(str, stations[:3])) + (f" and {len(stations) - 3} more" if len(stations) > 3 else "")
        error, loose = float(np.nanmedian(off.view[stations])), float(np.nanmedian(held[stations]))
        rows.append(
            (
                one.case.name,
                few,
                percent(mode.movement),
                f"{error:.2f} m",
                f"{100.0 * float(np.mean(known < error)):.1f} %",
                percent(loose),
                f"{1 + int((held > loose).sum())} of {int(np.isfinite(held).sum())}",
            )
        )
    return rows


def named(every: list[Certified]) -> str:
    """Table of the stations that modes name."""
    return table(NAMED, [row for one in every for row in named_rows(one)])
