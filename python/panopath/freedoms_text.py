"""What is free in a scene whose points may move, in plain words: one sentence for each freedom and each track.

Every sentence that a person reads about the freedoms of moving models is made here, in the manner of
``certificate_text``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from panopath.certificate_text import Names, percent

if TYPE_CHECKING:
    from panopath.freedoms import Freedom, PathCertificate

#: Tracks that are told of one by one.
_MOST_TRACKS = 8
_POWERS = {1: "linear", 2: "quadratic", 3: "cubic"}


def sentence(certificate: PathCertificate) -> str:
    """Tell the verdict in one sentence."""
    counted = f"{_count(certificate.nullity, 'free movement')}, of which the gauge has {certificate.gauge_freedoms}"
    exact = [freedom for freedom in certificate.freedoms if freedom.is_exact]
    nearly = len(certificate.freedoms) - len(exact)
    if exact:
        more = f" (and {_count(len(certificate.freedoms) - 1, 'more')})" if len(certificate.freedoms) > 1 else ""
        return f"undetermined: {counted}; {freedom_sentence(exact[0])}{more}"
    if nearly:
        return f"weak: {counted}; {freedom_sentence(certificate.freedoms[0])}"
    return f"determined: {counted}: no further one"


def explain(certificate: PathCertificate, names: Names | None = None) -> list[str]:
    """Tell all there is to say, a line each, the verdict first."""
    told = [sentence(certificate)]
    told.append(f"equations: {certificate.equations:,} for {certificate.unknowns:,} unknowns, gauge included")
    told += [f"free: {freedom_sentence(freedom, names)}" for freedom in certificate.freedoms]
    refused = np.flatnonzero(certificate.refused).tolist()
    told += [f"refused: {track_sentence(certificate, track, names)}" for track in refused[:_MOST_TRACKS]]
    if len(refused) > _MOST_TRACKS:
        told.append(f"... and {_count(len(refused) - _MOST_TRACKS, 'more track')}")
    return told


def freedom_sentence(freedom: Freedom, names: Names | None = None) -> str:
    """Tell who may move how, and why, with the number of freedoms."""
    return f"{_TELL[freedom.kind.value](freedom, names or Names())} ({_freedoms(freedom)})"


def track_sentence(certificate: PathCertificate, track: int, names: Names | None = None) -> str:
    """Tell what the rays of a track tell of its path, and why no more."""
    called = names or Names()
    who = called.of_points([track])
    reach = certificate.reaches[track].value
    if reach == "determined":
        return f"{who} is determined: noise moves its path by {percent(certificate.movement[track])} of its distance"
    told = {
        "not_seen": "no observation of it counts",
        "too_few": "it has fewer observations, or times, than its path has unknowns",
        "imitated": f"the camera moves in the form of its path{_departs(certificate, track)}",
        "hidden": f"it is in one direction with {called.of_points([certificate.hidden_by[track]])} whenever it is seen",
        "in_line": "all its views lie on one line with it",
        "loose": "its rays fit other paths of its form too",
    }
    nearly = "" if certificate.is_exact[track] else "as far as noise tells, "
    return f"{who} is not determined because {nearly}{told[reach]}"


def _departs(certificate: PathCertificate, track: int) -> str:
    """Compare what of the camera's way the path cannot express with the noise."""
    if certificate.is_exact[track]:
        return ""
    departs, noise = certificate.camera_part[track], certificate.noise_part[track]
    return f" (its way departs from that form by {departs:.2g}, and noise of one ray is {noise:.2g} there)"


def _disconnected(_freedom: Freedom, _names: Names) -> str:
    return "parts that no observation ties to each other may shift and change size against each other"


def _common(freedom: Freedom, _names: Names) -> str:
    why = "no track is known to be without it"
    return f"everything, cameras and all, may share a motion {_in_time(freedom)} because {why}"


def _scale(freedom: Freedom, names: Names) -> str:
    about = f" about {names.of_points(freedom.tracks)}" if len(freedom.tracks) else ""
    why = "no motion of a track speaks against it"
    return f"everything may be multiplied by a scale {_in_time(freedom)}{about} because {why}"


def _imitated(freedom: Freedom, names: Names) -> str:
    each = "" if len(freedom.tracks) == 1 else "each "
    its = "its path" if len(freedom.tracks) == 1 else "their paths"
    return (
        f"{names.of_points(freedom.tracks)} may {each}be drawn towards the camera or away from it because the camera "
        f"moves in the form of {its}"
    )


def _hidden(freedom: Freedom, names: Names) -> str:
    who, is_one = names.of_points(freedom.tracks), len(freedom.tracks) == 1
    return (
        f"{who} may move along {'its' if is_one else 'their'} rays because {'it is' if is_one else 'they are'} in one "
        f"direction with another one whenever {'it is' if is_one else 'they are'} seen"
    )


def _in_line(freedom: Freedom, names: Names) -> str:
    is_one = len(freedom.tracks) == 1
    views = "its views lie on one line with it" if is_one else "the views of each lie on one line with it"
    return f"{names.of_points(freedom.tracks)} may slide along {'its' if is_one else 'their'} rays because {views}"


def _too_few(freedom: Freedom, names: Names) -> str:
    is_one = len(freedom.tracks) == 1
    has = "its path has" if is_one else "their paths have"
    return (
        f"{names.of_points(freedom.tracks)} may move along {'its' if is_one else 'their'} rays because {has} more "
        "unknowns than observations"
    )


def _loose_track(freedom: Freedom, names: Names) -> str:
    of = "its form" if len(freedom.tracks) == 1 else "their forms"
    return f"{names.of_points(freedom.tracks)} may move along the rays because these fit other paths of {of} too"


def _loose_view(freedom: Freedom, names: Names) -> str:
    sees = "it sees is on one line with it" if len(freedom.views) == 1 else "each sees is on one line with it"
    return f"{names.of_views(freedom.views)} may slide because all that {sees}"


def _loose_set(freedom: Freedom, names: Names) -> str:
    who = names.of_both(freedom.views, freedom.tracks) or "some of it"
    why = "too little ties them to it" if freedom.is_exact else "noise hides what ties them to it"
    return f"{who} may move against the rest because {why}"


_TELL = {
    "disconnected": _disconnected,
    "common_motion": _common,
    "scale_in_time": _scale,
    "imitated": _imitated,
    "hidden": _hidden,
    "in_line": _in_line,
    "too_few": _too_few,
    "loose_track": _loose_track,
    "loose_view": _loose_view,
    "loose_set": _loose_set,
}


def _in_time(freedom: Freedom) -> str:
    if np.isfinite(freedom.omega_rad_s):
        period = f"period {2.0 * np.pi / freedom.omega_rad_s:.4g} s"
        return f"in time along harmonic {freedom.order} of {period}" if freedom.order > 1 else f"in time of {period}"
    if freedom.order:
        return f"{_POWERS.get(freedom.order, f'of order {freedom.order}')} in time"
    return "in time along the splines of the paths" if freedom.spline_of >= 0 else "in time"


def _freedoms(freedom: Freedom) -> str:
    nearly = "" if freedom.is_exact else ", as far as noise tells"
    return f"{_count(freedom.dimension, 'freedom')}{nearly}"


def _count(count: int, kind: str) -> str:
    return f"{count:,} {kind}" if count == 1 or kind == "more" else f"{count:,} {kind}s"
