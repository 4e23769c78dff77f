"""A certificate in plain words: one sentence for the verdict, one for each cause, lines for all else.

Every sentence that a person reads about rigidity is made here. Parts are counted from 1, as in the tables of the
command line; views and points go by their names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from panopath.model import Float

if TYPE_CHECKING:
    from panopath.certificate import Cause, Certificate, Hinge, Mode, RigidComponent

#: A view whose standard deviation is beyond this share of its distance from its neighbours is held loosely.
LOOSE_VIEW = 0.1
#: Members of a list that are named before the rest is only counted.
_MOST_NAMES = 3
#: Rows of a list (modes, hinges, weakly held views) that are told before the rest is only counted.
_MOST_LINES = 8
#: A member moves along a mode where it moves by more than this share of what the fastest one does.
_MOVES = 0.05
#: A part moves as a whole where more than this share of its members does.
_MOST_OF_A_PART = 0.9
_SIGMA_SOURCE = {
    "given": "as given",
    "tracks": "as the tracks say",
    "residuals": "estimated from the residuals",
    "assumed": "assumed",
}
_ORIENTATION = {
    "known": "orientations known",
    "free": "orientations unknown",
    "vertical": "only the vertical known of orientations",
}


@dataclass(frozen=True)
class Names:
    """What views and points are called; their indices where there are no names."""

    views: Sequence[str] | None = None
    tracks: Sequence[str] | None = None

    def of_views(self, members: npt.ArrayLike) -> str:
        """``view 3``, ``views 3, 7 and 12``, ``views 3, 7, 12 and 41 more``."""
        return _listed("view", members, self.views)

    def of_points(self, members: npt.ArrayLike) -> str:
        """Tracks are points to a person."""
        return _listed("point", members, self.tracks)

    def of_both(self, views: npt.ArrayLike, tracks: npt.ArrayLike) -> str:
        """Name views and points, whichever there are."""
        told = [self.of_views(views) if np.size(views) else "", self.of_points(tracks) if np.size(tracks) else ""]
        return " and ".join(text for text in told if text)


def sentence(certificate: Certificate, names: Names | None = None) -> str:
    """Tell the verdict in one sentence; the word before the colon is the verdict."""
    called = names or Names()
    told = [_what_holds(certificate), *_what_is_left(certificate)]
    if certificate.verdict == "determined" and certificate.components:
        told.append(_what_noise_does(certificate))
    told += _first_reason(certificate, called)
    if not certificate.consistency.passed:
        reasons = certificate.consistency.reasons
        more = f" (and {_count(len(reasons) - 1, 'more contradiction')})" if len(reasons) > 1 else ""
        told.append(f"but the scene contradicts its bearings: {reasons[0]}{more}")
    return f"{certificate.verdict}: {'; '.join(told)}"


def explain(
    certificate: Certificate, names: Names | None = None, positions: tuple[Float, Float] | None = None
) -> list[str]:
    """Tell all there is to say, a line each, the verdict first."""
    called = names or Names()
    return [
        sentence(certificate, called),
        *consistency_lines(certificate),
        *spectrum_lines(certificate),
        *part_lines(certificate),
        *hinge_lines(certificate, called),
        *cause_lines(certificate, called),
        *mode_lines(certificate, called, positions),
        *looseness_lines(certificate, called),
    ]


def consistency_lines(certificate: Certificate) -> list[str]:
    """Tell why the scene cannot be a right one, where the gate found so."""
    return [f"inconsistent: {reason}" for reason in certificate.consistency.reasons]


def spectrum_lines(certificate: Certificate) -> list[str]:
    """Tell the nullity, the gap below and above it, and the noise that the verdict is for."""
    beyond = certificate.nullity - certificate.gauge_freedoms
    known = _ORIENTATION[certificate.orientation]
    if beyond < 0:
        told = [f"free movements: none to count, as the scene has no positions ({known})"]
    else:
        more = f"{beyond:,} more" if beyond else "no further one"
        gauge = f"of which the gauge has {certificate.gauge_freedoms} ({known})"
        told = [f"free movements: {certificate.nullity:,}, {gauge}: {more}"]
    first_other = certificate.gap.first_other
    above = f"smallest other {first_other:.2g}" if np.isfinite(first_other) else "no other"
    told.append(
        f"rays turned where views move by their size, radians: largest null {certificate.gap.last_null:.2g}, {above}"
    )
    told.append(
        f"noise: {_degrees(certificate.sigma_rad)} ({_SIGMA_SOURCE[certificate.sigma_source]}); weak is what it moves "
        f"by more than {percent(certificate.weak_movement)} of a part's size"
    )
    return told


def part_lines(certificate: Certificate) -> list[str]:
    """Tell each rigid part: what it has, and how far noise moves it."""
    told = [
        f"part {number}: {part.verdict}, {_count(len(part.views), 'view')}, {_count(len(part.tracks), 'point')}, "
        f"{_count(part.n_observations, 'observation')}{_moved_by(part)}"
        for number, part in enumerate(certificate.components, 1)
    ]
    return _shortened(told, "part")


def hinge_lines(certificate: Certificate, names: Names | None = None) -> list[str]:
    """Tell what parts have in common."""
    called = names or Names()
    return _shortened([_hinge_line(hinge, called) for hinge in certificate.hinges], "hinge")


def cause_lines(certificate: Certificate, names: Names | None = None) -> list[str]:
    """Tell why each thing that is not determined is not."""
    told = [f"cause: {cause_sentence(cause, certificate, names)}" for cause in certificate.causes]
    return _shortened(told, "cause")


def mode_lines(
    certificate: Certificate, names: Names | None = None, positions: tuple[Float, Float] | None = None
) -> list[str]:
    """Tell what moves along each mode; against the largest part, where positions are given."""
    called = names or Names()
    modes = [mode if positions is None else certificate.settled(mode, *positions) for mode in certificate.modes]
    told = [_mode_line(number, mode, certificate, called, positions) for number, mode in enumerate(modes, 1)]
    return _shortened(told, "mode")


def looseness_lines(certificate: Certificate, names: Names | None = None) -> list[str]:
    """Tell which views are held the least by the views around them."""
    called = names or Names()
    held = certificate.view_looseness
    order = np.argsort(np.where(np.isfinite(held), -held, np.inf), kind="stable")
    weak = [view for view in order.tolist() if np.isfinite(held[view]) and held[view] > LOOSE_VIEW]
    told = [
        f"weakly held: {called.of_views([view])}, to {percent(held[view])} of its distance from the views around it"
        for view in weak
    ]
    return _shortened(told, "weakly held view")


def cause_sentence(cause: Cause, certificate: Certificate, names: Names | None = None) -> str:
    """Tell who can move how, and because of what."""
    told = _TELL[cause.kind.value](_Case(cause, certificate, names or Names()))
    return f"{told[0]} because {told[1]}"


def _what_holds(certificate: Certificate) -> str:
    if not certificate.components:
        return (
            f"no part of its {_count(certificate.n_views, 'view')} and {_count(certificate.n_tracks, 'point')} is rigid"
        )
    largest = certificate.components[0]
    told = (
        f"{_share(len(largest.views), certificate.n_views, 'view')}, "
        f"{_share(len(largest.tracks), certificate.n_tracks, 'point')}"
    )
    if certificate.verdict == "weak":
        if any(part.verdict == "weak" for part in certificate.components):
            return f"{told}, but {_what_noise_does(certificate)}"
        return told if not certificate.consistency.passed else f"{told}, too few of those that were observed"
    return told if certificate.verdict == "determined" else f"the largest rigid part has {told}"


def _what_noise_does(certificate: Certificate) -> str:
    """Tell what noise makes of the largest part, or of the weak one behind a weak verdict."""
    number = 0
    if certificate.verdict == "weak":
        number = next((n for n, part in enumerate(certificate.components) if part.verdict == "weak"), 0)
    part, noise = certificate.components[number], f"noise of {_degrees(certificate.sigma_rad)}"
    if part.verdict == "weak" and part.weakest_movement <= certificate.weak_movement:
        if any(mode.component == number and not mode.is_null for mode in certificate.modes):
            return f"{noise} hides whether {f'part {number + 1}' if number else 'it'} is unique"
        return f"at {noise} some of them are loosely held by what is around them"
    whose = f"the views of part {number + 1}" if number else "views"
    return f"{noise} moves {whose} by {percent(part.weakest_movement)} of the size"


def _what_is_left(certificate: Certificate) -> list[str]:
    """Tell of further parts, and of members that belong to none."""
    told = []
    n_parts = len(certificate.components) - 1
    if n_parts > 0:
        told.append(f"{n_parts:,} further {_plural('part', n_parts)}")
    if certificate.components:
        inside = [np.unique(np.concatenate([getattr(p, kind) for p in certificate.components])) for kind in _KINDS]
        loose = [certificate.n_views - len(inside[0]), certificate.n_tracks - len(inside[1])]
        named = [_count(n, kind) for n, kind in zip(loose, ("view", "point"), strict=True) if n > 0]
        if named:
            told.append(f"{' and '.join(named)} in no part")
    return told


_KINDS = ("views", "tracks")


def _first_reason(certificate: Certificate, names: Names) -> list[str]:
    """Give the first exact cause, and how many others there are."""
    all_firm = certificate.verdict != "undetermined" and all(p.verdict == "determined" for p in certificate.components)
    # a few loose points belong to every scene: they are told where something is weak
    causes = [cause for cause in certificate.causes if cause.is_exact or not all_firm]
    if not causes:
        return []
    first = next((cause for cause in causes if cause.is_exact), causes[0])
    others = len(causes) - 1
    more = f" (and {_count(others, 'more cause', 'more causes')})" if others else ""
    return [cause_sentence(first, certificate, names) + more]


@dataclass(frozen=True)
class _Case:
    """One cause in its surroundings, and the phrases that several kinds share."""

    cause: Cause
    certificate: Certificate
    names: Names

    @property
    def nearly(self) -> str:
        return "" if self.cause.is_exact else "nearly "

    def everyone(self) -> str:
        return self.names.of_both(self.cause.views, self.cause.tracks) or self.parts()

    def parts(self) -> str:
        """``part 2``, ``parts 1 and 2``; the members where the parts have no number."""
        numbers = [component + 1 for component in self.cause.components]
        if not numbers:
            return self.names.of_both(self.cause.views, self.cause.tracks) or "the parts"
        return _listed("part", range(len(numbers)), [str(number) for number in numbers])

    def slides(self, kind: str) -> tuple[str, bool]:
        """Tell who slides, and along what; and whether it is one that does."""
        members = self.cause.views if kind == "view" else self.cause.tracks
        if len(self.cause.components) == 1 and self.cause.components[0] > 0:
            who, alone = f"part {self.cause.components[0] + 1}", True
        else:
            who, alone = (self.names.of_views if kind == "view" else self.names.of_points)(members), len(members) == 1
        line = self._line(kind, int(members[0]) if len(members) else None) if alone else ""
        how = f"along {line}" if line else ("along a line" if alone else "each along a line of its own")
        exact, loose = ("can slide", "is loose") if alone else ("can slide,", "are loose,")
        return f"{who} {exact if self.cause.is_exact else loose} {how}", alone

    def changes_shape(self) -> str:
        return f"{self.everyone()} {'can change shape' if self.cause.is_exact else 'hardly keep their shape'}"

    def _line(self, kind: str, member: int | None) -> str:
        if self.cause.shape.ndim == 2 and self.cause.shape.size:
            return _direction(self.cause.shape[1])
        lines = self.certificate.view_line if kind == "view" else self.certificate.track_line
        return _direction(lines[member]) if member is not None and member < len(lines) else ""


def _camera_collinear(case: _Case) -> tuple[str, str]:
    told, alone = case.slides("track")
    whose = f"its {_count(len(case.cause.views), 'view')} lie" if alone else "the views of each lie"
    return told, f"{whose} {case.nearly}on one line with it"


def _point_collinear(case: _Case) -> tuple[str, str]:
    told, alone = case.slides("view")
    whose = f"its {_count(len(case.cause.tracks), 'point')} lie" if alone else "the points that each sees lie"
    return told, f"{whose} {case.nearly}on one line with it"


def _one_camera(case: _Case) -> tuple[str, str]:
    who = case.names.of_points(case.cause.tracks)
    whom = "it" if len(case.cause.tracks) == 1 else "them"
    return f"{who} can slide along {'its ray' if whom == 'it' else 'their rays'}", (
        f"{case.names.of_views(case.cause.views)} alone sees {whom}"
    )


def _two_cameras(case: _Case) -> tuple[str, str]:
    return case.changes_shape(), "two views in the plane fix no shape, however many points they see"


def _two_points(case: _Case) -> tuple[str, str]:
    return case.changes_shape(), "two points in the plane fix no shape, however many views see them"


def _two_lines_1(case: _Case) -> tuple[str, str]:
    return case.changes_shape(), f"the views lie {case.nearly}on one line and the points on another"


def _two_lines_2(case: _Case) -> tuple[str, str]:
    return case.changes_shape(), f"they lie {case.nearly}on two lines"


def _conic(case: _Case) -> tuple[str, str]:
    return case.changes_shape(), f"they lie {case.nearly}on one {case.cause.detail or 'conic'}"


def _coplanar(case: _Case) -> tuple[str, str]:
    return case.changes_shape(), f"these views and points lie {case.nearly}in one plane"


def _hidden(case: _Case) -> tuple[str, str]:
    """Who is hidden is who belongs to no part: a point seen in one direction, or a view that sees one point."""
    loose_point = np.any(case.certificate.track_component[case.cause.tracks] < 0)
    loose_view = np.any(case.certificate.view_component[case.cause.views] < 0)
    if not len(case.cause.tracks) or (loose_view and not loose_point):
        told, alone = case.slides("view")
        return told, "it sees one point only" if alone else "each sees one point only"
    told, alone = case.slides("track")
    return told, f"{'it' if alone else 'each'} is seen in {case.nearly}one direction only"


def _too_few(case: _Case) -> tuple[str, str]:
    return case.changes_shape(), f"there are fewer equations than unknowns{_in_brackets(case.cause.detail)}"


def _disconnected(case: _Case) -> tuple[str, str]:
    return f"{case.parts()} can move and change size against each other", "no observation ties them to each other"


def _weak_join(case: _Case) -> tuple[str, str]:
    turn = "" if case.certificate.orientation == "known" else "turn and "
    how = f"can {turn}change size against each other" if case.cause.is_exact else "hardly share one scale"
    return f"{case.parts()} {how}", f"too little joins them{_in_brackets(case.cause.detail)}"


def _other(case: _Case) -> tuple[str, str]:
    if not case.cause.is_exact:
        if not len(case.cause.tracks):
            return f"{case.names.of_views(case.cause.views)} may be off", "little holds them to the views around them"
        return case.changes_shape(), "noise moves them far, or hides that they can"
    detail = _in_brackets(case.cause.detail)
    return case.changes_shape(), f"the bearings allow it, for a reason that has no name{detail}"


_TELL: dict[str, Callable[[_Case], tuple[str, str]]] = {
    "one_camera": _one_camera,
    "two_cameras": _two_cameras,
    "two_points": _two_points,
    "camera_collinear": _camera_collinear,
    "point_collinear": _point_collinear,
    "two_lines_1": _two_lines_1,
    "two_lines_2": _two_lines_2,
    "conic": _conic,
    "coplanar_two_by_two": _coplanar,
    "hidden_point": _hidden,
    "too_few_equations": _too_few,
    "disconnected": _disconnected,
    "weak_join": _weak_join,
    "other": _other,
}


def _hinge_line(hinge: Hinge, names: Names) -> str:
    first, second = hinge.components
    return f"hinge: parts {first + 1} and {second + 1} share {names.of_both(hinge.views, hinge.tracks)}"


def _mode_line(
    number: int, mode: Mode, certificate: Certificate, names: Names, positions: tuple[Float, Float] | None
) -> str:
    what = "null" if mode.is_null else f"{percent(mode.movement)} of the size"
    who = _movers(mode, certificate, names, positions)
    return f"mode {number} ({what}, rays turn by {mode.value:.2g}): moves {who}"


def _movers(mode: Mode, certificate: Certificate, names: Names, positions: tuple[Float, Float] | None) -> str:
    """Name what moves along a mode: parts that move as a whole, then further views and points.

    A point far away moves farther than all else: where positions are known, movement counts as a share of distance.
    """
    views, points = _speed(mode.view_displacement), _speed(mode.track_displacement)
    if positions is not None:
        views, points = views / _distance(positions[0], positions), points / _distance(positions[1], positions)
    fastest = max(views.max(initial=0.0), points.max(initial=0.0))
    if fastest <= 0.0:
        return "nothing (views turn only)"
    view_moves, point_moves = views > _MOVES * fastest, points > _MOVES * fastest
    parts = []
    for index, part in enumerate(certificate.components):
        moving = np.concatenate((view_moves[part.views], point_moves[part.tracks]))
        if len(moving) and moving.mean() > _MOST_OF_A_PART:
            parts.append(str(index + 1))
            view_moves[part.views], point_moves[part.tracks] = False, False
    told = [_listed("part", range(len(parts)), parts)] if parts else []
    rest = names.of_both(np.flatnonzero(view_moves), np.flatnonzero(point_moves))
    return " and ".join([*told, rest] if rest else told)


def _speed(moved: Float) -> Float:
    speed = np.linalg.norm(moved, axis=1)
    return np.where(np.isfinite(speed), speed, 0.0)


def _distance(place: Float, positions: tuple[Float, Float]) -> Float:
    """(n,) distance from the middle of the views, but no less than their size."""
    known = positions[0][np.isfinite(positions[0]).all(axis=1)]
    if not len(known):
        return np.ones(len(place))
    middle = known.mean(axis=0)
    size = float(np.sqrt(((known - middle) ** 2).sum(axis=1).mean()))
    distance = np.nan_to_num(np.linalg.norm(place - middle, axis=1), nan=size)
    return np.asarray(np.maximum(distance, size or 1.0))


def _moved_by(part: RigidComponent) -> str:
    """Tell how far noise moves a part; of one that moves for nothing that means nothing."""
    return "" if part.verdict == "undetermined" else f", moved by {percent(part.weakest_movement)}"


def _listed(kind: str, members: npt.ArrayLike, names: Sequence[str] | None) -> str:
    """Name a few members: one by one, as a run of indices, or the first of them and how many more there are."""
    ids = np.asarray(members, dtype=np.int64).ravel().tolist()
    told = [str(i) if names is None else names[i] for i in ids]
    if len(told) == 1:
        return f"{kind} {told[0]}"
    if len(told) > 2 and told == [str(i) for i in range(ids[0], ids[0] + len(ids))]:
        return f"{kind}s {told[0]} to {told[-1]}"
    if len(told) > _MOST_NAMES + 1:
        return f"{kind}s {', '.join(told[:_MOST_NAMES])} and {len(told) - _MOST_NAMES:,} more"
    return f"{kind}s {' and '.join([', '.join(told[:-1]), told[-1]])}" if told else f"no {kind}"


def _shortened(lines: list[str], kind: str) -> list[str]:
    left = len(lines) - _MOST_LINES
    return lines if left <= 1 else [*lines[:_MOST_LINES], f"... and {left:,} more {_plural(kind, left)}"]


def _share(count: int, total: int, kind: str) -> str:
    return f"all {total:,} {_plural(kind, total)}" if count == total > 1 else f"{count:,} of {_count(total, kind)}"


def _count(count: int, kind: str, plural: str | None = None) -> str:
    return f"{count:,} {kind if count == 1 else plural or _plural(kind, count)}"


def _plural(kind: str, count: int) -> str:
    return kind if count == 1 else f"{kind}s"


def _in_brackets(detail: str) -> str:
    return f" ({detail})" if detail else ""


def _direction(line: Float) -> str:
    """Give a direction without orientation: its largest coordinate is positive. Nothing where it is not known."""
    if not np.isfinite(line).all():
        return ""
    unit = line * np.sign(line[int(np.argmax(np.abs(line)))])
    return f"({', '.join(f'{value + 0.0:.2f}' for value in np.round(unit, 2))})"


def percent(share: float) -> str:
    """Give a share in percent, two digits of it; one that is not finite is any share."""
    if not np.isfinite(share):
        return "any share"
    percent = 100.0 * share
    return f"{percent:,.0f} %" if percent >= 10.0 else f"{percent:.2g} %"


def _degrees(angle_rad: float) -> str:
    text = f"{np.degrees(angle_rad):.3g}"
    return f"{text} {'degree' if text == '1' else 'degrees'}"
