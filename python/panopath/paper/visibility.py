"""Section 5, fourth remark: how much must be seen, and reconstructing overlapping spans of a film one by one.

Scenes in general position, of which a share ``r`` of all pairs of a view and a point is seen. The count of equations
and unknowns gives the least ``r`` for which a scene may be determined; the certificate says which scenes are. Two ways
of seeing: at random; and evenly, each point in as many views as every other and each view with as many points. With
few pairs of many, what is seen at random leaves some points in one view or none, so that the share of all points that
the largest rigid part holds is told as well.

The second half cuts a walk into spans of views that overlap, solves each with what is seen throughout, and puts the
next span onto those before it by shift and scale.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from panopath.counting import CameraModel, RequiredVisibility
from panopath.evaluate import fit_shift_and_scale
from panopath.model import Bool, Float, PositionOptions, Scene, Tracks
from panopath.paper.experiment import Experiment, Outcome, Picture, Progress, Settings, Statement, Table, Verdict
from panopath.paper.generic_rank import extra_freedoms
from panopath.paper.scenes import dense_freedoms, disturbed, rays, truth_of
from panopath.steps.certificate import CertifyOptions, certify
from panopath.steps.positions import solve_positions

_MODELS = {2: CameraModel.ORIENTED_PLANE, 3: CameraModel.ORIENTED_SPACE}
#: Points and views of the paper's two examples, with the shares that are tried, as multiples of the counting bound.
_SMALL, _LARGE = (10, 10), (1000, 100)
_SMALL_SHARES = tuple(np.round(np.arange(0.7, 2.31, 0.1), 2).tolist())
_LARGE_SHARES = (0.9, 1.0, 1.05, 1.1, 1.2, 1.4, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
_TRIALS = 100
#: Scenes of a thousand points take longer: a share of the trials.
_LARGE_TRIALS = 0.1
#: Exact ranks are taken of this many small scenes of each share.
_MOST_EXACT = 4
#: What the paper quotes, and what it prints.
_QUOTED_SMALL, _QUOTED_LARGE = 0.3, 0.02

_WAYS = ("at random", "evenly")


@dataclass(frozen=True)
class _Case:
    """How many see how many, and how much of it."""

    d: int
    n: int
    m: int
    way: str
    #: Share of pairs seen, over the counting bound.
    multiple: float


@dataclass(frozen=True)
class _Seen(_Case):
    """One scene seen in part."""

    fraction: float
    trial: int
    determined: bool
    #: Share of views and points in the largest rigid part.
    largest_part: float
    #: Freedoms beyond the gauge: by the certificate; by singular values and in exact arithmetic, -1 not looked at.
    certified: int
    dense: int
    exact: int


def _run(settings: Settings, progress: Progress) -> Outcome:
    trials = settings.trials_or(_TRIALS)
    large_trials = max(1, round(_LARGE_TRIALS * trials))
    cases = [(size, d, way) for size in (_SMALL, _LARGE) for d in (2, 3) for way in _WAYS]
    seen: list[_Seen] = []
    for done, (size, d, way) in enumerate(cases):
        rng = np.random.default_rng((settings.seed, done))
        shares, count = (_SMALL_SHARES, trials) if size == _SMALL else (_LARGE_SHARES, large_trials)
        for multiple in shares:
            case = _Case(d, *size, way, multiple)
            seen += [_see(case, rng, trial, settings) for trial in range(count)]
        progress(done + 1, len(cases) + 1)
    spans = _spans(settings, max(1, trials // 20))
    progress(len(cases) + 1, len(cases) + 1)
    return Outcome(
        n_trials=len(seen) + len(spans),
        tables={"visibility": _seen_table(seen), "spans": spans},
        statements=(*_bound_statements(), *_seen_statements(seen), *_span_statements(spans)),
        pictures={
            "visibility": Picture(
                lambda figure: _draw(figure, seen),
                "Scenes that are determined (solid) and the share of views and points in the largest rigid part "
                "(dashed), against the share of pairs that is seen. Vertical lines: the counting bound, and the "
                "paper's formula and number.",
                11.0,
                8.0,
            ),
            "spans": Picture(
                lambda figure: _draw_spans(figure, spans),
                "A walk of 60 views in spans of 12, joined; cameras' error against noise, and against what is shared.",
                9.0,
                4.4,
            ),
        },
    )


# -------------------------------------------------------------------------------------------------- what must be seen


def _required(d: int, size: tuple[int, int]) -> RequiredVisibility:
    return _MODELS[d].required_visibility(*size)


def _bound(d: int, size: tuple[int, int]) -> float:
    """Count of all equations against all unknowns, as a share of all pairs."""
    n, m = size
    return _required(d, size).in_total / (n * m)


def _see(case: _Case, rng: np.random.Generator, trial: int, settings: Settings) -> _Seen:
    d, n, m = case.d, case.n, case.m
    count = min(round(case.multiple * _required(d, (n, m)).in_total), n * m)
    mask = _at_random(rng, m, n, count) if case.way == _WAYS[0] else _evenly(rng, m, n, count)
    centers, points = rng.uniform(-1.0, 1.0, (m, d)), rng.uniform(-1.0, 1.0, (n, d))
    tracks = rays(centers, points, mask)
    found = certify(tracks, truth_of(tracks, centers, points), CertifyOptions(threads=settings.threads or None))
    # members that nothing sees have no equations, and are as free as any
    unseen = d * int((~mask.any(axis=0)).sum() + (~mask.any(axis=1)).sum())
    free = found.nullity - found.gauge_freedoms + unseen
    dense = exact = -1
    if (n, m) == _SMALL and trial < _MOST_EXACT:
        dense = dense_freedoms(tracks)
        exact = extra_freedoms(_MODELS[d], n, m, seen=mask, seed=settings.seed + trial)
    largest = found.components[0] if found.components else None
    members = 0 if largest is None else len(largest.views) + len(largest.tracks)
    share = members / (n + m)
    return _Seen(d, n, m, case.way, case.multiple, count / (n * m), trial, free == 0, share, free, dense, exact)


def _at_random(rng: np.random.Generator, m: int, n: int, count: int) -> Bool:
    """Any ``count`` of all pairs."""
    mask = np.zeros(m * n, dtype=np.bool_)
    mask[rng.permutation(m * n)[:count]] = True
    return mask.reshape(m, n)


def _evenly(rng: np.random.Generator, m: int, n: int, count: int) -> Bool:
    """Pairs such that points, and views, differ by one sighting at most: the least used views take the next point."""
    mask = np.zeros((m, n), dtype=np.bool_)
    wanted = np.full(n, count // n)
    wanted[rng.permutation(n)[: count % n]] += 1
    used = np.zeros(m, dtype=np.int64)
    for j in rng.permutation(n).tolist():
        chosen = np.lexsort((rng.random(m), used))[: wanted[j]]
        mask[chosen, j] = True
        used[chosen] += 1
    return mask


def _seen_table(seen: Sequence[_Seen]) -> Table:
    names = ("dimension", "points", "views", "way", "multiple_of_bound", "fraction", "trial", "determined")
    return Table.of(
        (*names, "largest_part", "certified", "dense", "exact"), [tuple(one.__dict__.values()) for one in seen]
    )


# -------------------------------------------------------------------------------------------------------- statements


def _bound_statements() -> list[Statement]:
    (plane_small, space_small), (plane_large, space_large) = (
        (_bound(2, size), _bound(3, size)) for size in (_SMALL, _LARGE)
    )
    printed_small, printed_large = (2 * (n + m) / (n * m + 3) for n, m in (_SMALL, _LARGE))
    each = _required(3, _LARGE)
    return [
        Statement(
            "5, remark 4",
            "The fraction of pairs needed is r = 2 (n + m) / (n m + 3).",
            f"Equations against unknowns: r = (2 (n + m) - 3) / (n m) in the plane, (3 (n + m) - 4) / (2 n m) in space."
            f" For (n, m) = (10, 10): printed {printed_small:.3f}, plane {plane_small:.3f}, space {space_small:.3f}; "
            f"for (1000, 100): {printed_large:.4f}, {plane_large:.4f}, {space_large:.4f}. The formula is for the "
            "plane, and the section is about space.",
            Verdict.CORRECTED,
        ),
        Statement(
            "5, remark 4",
            "Ten cameras, ten points: 60 / 200 = 0.3.",
            f"{_required(3, _SMALL).in_total} sightings of 100, r = {space_small:.2f}, in space (the gauge takes 4 of "
            f"60); {_required(2, _SMALL).in_total}, r = {plane_small:.2f}, in the plane.",
            Verdict.CORRECTED if abs(space_small - _QUOTED_SMALL) > 1e-9 else Verdict.AGREES,
        ),
        Statement(
            "5, remark 4",
            "100 cameras, 1000 points: less than 2 %.",
            f"All equations together ask for {100 * space_large:.2f} % in space, {100 * plane_large:.2f} % in the "
            f"plane. But each point must be seen by {each.per_point} views by itself, which is "
            f"{100 * each.fraction:.0f} % of all pairs: less than that leaves points out.",
            Verdict.CORRECTED if each.fraction >= _QUOTED_LARGE else Verdict.AGREES,
        ),
    ]


def _seen_statements(seen: Sequence[_Seen]) -> list[Statement]:
    below = [one for one in seen if one.fraction < _bound(one.d, (one.n, one.m)) - 1e-12]
    passed = [one for one in seen if one.exact >= 0]
    alike, certified = (
        sum(one.exact == found for one, found in zip(passed, counts, strict=True))
        for counts in ([one.dense for one in passed], [one.certified for one in passed])
    )
    exact = [one for one in passed if one.fraction >= _bound(one.d, (one.n, one.m)) - 1e-12]
    failing = sum(not one.determined for one in seen) - sum(not one.determined for one in below)
    return [
        Statement(
            "5, remark 4",
            "A system in which that fraction is seen is expected to have a solution.",
            f"Needed: of {len(below):,} scenes below the bound none is determined"
            f"{'' if not any(one.determined for one in below) else ', but for some'}. Not enough: of "
            f"{len(seen) - len(below):,} at the bound or above, {failing:,} are not. {_thresholds(seen)}",
            Verdict.IN_PART if failing and not any(one.determined for one in below) else Verdict.AGREES,
        ),
        Statement(
            "5, remark 4",
            "Whether a scene seen in part is determined depends on the graph of what is seen.",
            f"Singular values of a random scene and the rank in exact arithmetic of another one count the same "
            f"freedoms in {alike:,} of {len(passed):,} graphs of ten and ten, the certificate in {certified:,}. Of the "
            f"{len(exact):,} that pass the count {sum(one.exact == 0 for one in exact):,} are rigid.",
            Verdict.AGREES if alike == len(passed) else Verdict.IN_PART,
        ),
    ]


def _thresholds(seen: Sequence[_Seen]) -> str:
    """Say from which share on nine scenes of ten are determined, case by case."""
    words = []
    for size in (_SMALL, _LARGE):
        for d in (2, 3):
            texts = []
            for way in _WAYS:
                mine = [one for one in seen if (one.d, one.n, one.m, one.way) == (d, *size, way)]
                fraction = _reaching(mine, 0.9)
                texts.append(f"{'more than tried' if fraction is None else _percent(fraction)} {way}")
            place = "plane" if d == 2 else "space"
            words.append(f"{size[0]} points, {size[1]} views, {place}: {' and '.join(texts)}")
    return f"Nine scenes of ten are determined from these shares on: {'; '.join(words)}."


def _reaching(seen: Sequence[_Seen], share: float) -> float | None:
    """Find the smallest fraction from which on at least this share of the scenes is determined."""
    reached = None
    for fraction in sorted({one.fraction for one in seen}, reverse=True):
        mine = [one.determined for one in seen if one.fraction == fraction]
        if sum(mine) < share * len(mine):
            break
        reached = fraction
    return reached


def _percent(fraction: float) -> str:
    return f"{100 * fraction:.0f} %" if fraction >= 0.1 else f"{100 * fraction:.1f} %"


# ------------------------------------------------------------------------------------------------- overlapping spans

#: Views of the walk, of a span, and overlaps of spans that are tried.
_N_VIEWS, _SPAN = 60, 12
_OVERLAPS = (0, 1, 2, 4, 6)
_NOISES_RAD = (0.0, 1e-4, 1e-3)
#: A point is seen by views within this distance, metres; views are one metre apart.
_REACH_M = 15.0
_N_POINTS = 900
#: Joined like this, a walk of exact bearings counts as found.
_FOUND_M = 1e-6


def _spans(settings: Settings, trials: int) -> Table:
    """Errors of walks solved in spans and joined, and solved whole."""
    rows: list[tuple[Any, ...]] = []
    for trial in range(trials):
        rng = np.random.default_rng((settings.seed, 100, trial))
        centers, exact = _walk(rng)
        for noise in _NOISES_RAD:
            tracks = disturbed(exact, noise, rng) if noise else exact
            options = PositionOptions(threads=settings.threads or None)
            whole = solve_positions(tracks, options=options)
            rows.append((trial, noise, "whole", 0, *_errors(whole.centers, centers), 0))
            for overlap in _OVERLAPS:
                for shares_points in (True, False):
                    joined, lost = _joined(tracks, overlap, options, shares_points=shares_points)
                    how = "views and points" if shares_points else "views"
                    rows.append((trial, noise, how, overlap, *_errors(joined, centers), lost))
    names = ("trial", "noise_rad", "joined_by", "overlap_views", "camera_rms_m", "placed_views", "spans_lost")
    return Table.of(names, rows)


def _walk(rng: np.random.Generator) -> tuple[Float, Tracks]:
    """Draw a straight walk that sways, points on both sides, each seen from near."""
    centers = np.column_stack(
        (np.arange(float(_N_VIEWS)), 0.4 * rng.normal(size=_N_VIEWS), 0.2 * rng.normal(size=_N_VIEWS))
    )
    side = np.where(rng.random(_N_POINTS) < 0.5, 1.0, -1.0)
    points = np.column_stack(
        (
            rng.uniform(-5.0, _N_VIEWS + 5.0, _N_POINTS),
            side * rng.uniform(2.0, 10.0, _N_POINTS),
            rng.uniform(-2.0, 6.0, _N_POINTS),
        )
    )
    near = np.linalg.norm(centers[:, None] - points, axis=2) < _REACH_M
    return centers, rays(centers, points, near)


def _joined(tracks: Tracks, overlap: int, options: PositionOptions, *, shares_points: bool) -> tuple[Float, int]:
    """Centres (m, d) from spans solved one by one, each with the points that all its views see; and spans that fail."""
    n, m = tracks.n_tracks, tracks.n_views
    placed, lost = np.full((m + n, tracks.d), np.nan), 0
    first = 0
    while first < m:
        last = min(first + _SPAN, m)
        span = _solve_span(tracks, first, last, options)
        found = np.vstack((span.centers, span.points))
        both = np.isfinite(found).all(axis=1) & np.isfinite(placed).all(axis=1)
        if not shares_points:
            both[m:] = False
        moved = found if first == 0 else _onto(found, placed, both)
        if moved is None:
            lost += 1
        else:
            fresh = np.isnan(placed).any(axis=1)
            placed[fresh] = moved[fresh]
        if last == m:
            break
        first = last - overlap
    return placed[:m], lost


def _solve_span(tracks: Tracks, first: int, last: int, options: PositionOptions) -> Scene:
    inside = (tracks.view >= first) & (tracks.view < last)
    throughout = np.bincount(tracks.track[inside], minlength=tracks.n_tracks) == last - first
    return solve_positions(tracks.select(inside & throughout[tracks.track]), options=options)


def _onto(found: Float, placed: Float, both: Bool) -> Float | None:
    """Shift and scale what was found onto what is placed, by least squares; None with less than two places shared."""
    if both.sum() < 2:
        return None
    scale, shift = fit_shift_and_scale(found[both], placed[both])
    return scale * found + shift


def _errors(centers: Float, truth: Float) -> tuple[float, int]:
    """Rms error of the cameras that have a place, metres, after shift and scale; and how many these are."""
    known: Bool = np.asarray(np.isfinite(centers).all(axis=1))
    moved = _onto(centers, truth, known)
    if moved is None:
        return float("nan"), int(known.sum())
    return float(np.sqrt(((moved - truth)[known] ** 2).sum(axis=1).mean())), int(known.sum())


def _span_statements(spans: Table) -> list[Statement]:
    rows = list(zip(*spans.columns.values(), strict=True))

    def told(noise: float, how: str, overlap: int) -> tuple[float, int, int]:
        mine = [row for row in rows if row[1] == noise and row[2] == how and row[3] == overlap]
        found = [row for row in mine if row[6] == 0]
        return max((row[4] for row in found), default=float("nan")), len(found), len(mine)

    exact = {(how, k): told(0.0, how, k) for how in ("views", "views and points") for k in _OVERLAPS}
    good = [key for key, (error, found, of) in exact.items() if found == of and error < _FOUND_M]
    lost = [key for key, (_, found, _) in exact.items() if found == 0]
    noise = _NOISES_RAD[-1]
    whole = _mean(rows, noise, "whole", 0)
    worse = "; ".join(f"{k} views {_mean(rows, noise, 'views and points', k) / whole:.1f} times" for k in _OVERLAPS[1:])
    return [
        Statement(
            "5, remark 4",
            "Reconstruct overlapping spans of time one by one, each with what is seen throughout.",
            f"Exact bearings: spans of {_SPAN} views of {_N_VIEWS} join exactly by {_overlap_words(good, 'views')} in "
            f"common, and by {_overlap_words(good, 'views and points')} with the points that both see throughout. By "
            f"{_overlap_words(lost, 'views')} alone they do not join: one place fixes the shift and not the scale, two "
            "are needed.",
            Verdict.AGREES if good and lost else Verdict.IN_PART,
        ),
        Statement(
            "5, remark 4",
            "The same with errors.",
            f"With {noise * 180 / np.pi:.3f} degrees of noise the whole walk solved at once has a mean camera error of "
            f"{1000 * whole:.1f} mm. Joined over views and points in common: {worse} as much. Scale errors of "
            "the spans add up, and points that leave a span are lost to it.",
            Verdict.IN_PART,
        ),
    ]


def _overlap_words(keys: Sequence[tuple[str, int]], how: str) -> str:
    counts = [str(k) for one, k in keys if one == how]
    if not counts:
        return "no number of views"
    return f"{counts[0]} views" if len(counts) == 1 else f"{', '.join(counts[:-1])} or {counts[-1]} views"


def _mean(rows: Sequence[tuple[Any, ...]], noise: float, how: str, overlap: int) -> float:
    errors = [row[4] for row in rows if (row[1], row[2], row[3]) == (noise, how, overlap) and row[6] == 0]
    return float(np.mean(errors)) if errors else float("nan")


# ---------------------------------------------------------------------------------------------------------- pictures

_WAY_COLOURS = {"at random": "#1f5fa8", "evenly": "#d9480f"}


def _draw(figure: Any, seen: Sequence[_Seen]) -> None:
    panels = figure.subplots(2, 2)
    for row, size in zip(panels, (_SMALL, _LARGE), strict=True):
        for panel, d in zip(row, (2, 3), strict=True):
            mine = [one for one in seen if (one.d, one.n, one.m) == (d, *size)]
            _draw_case(panel, mine, d, size)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)


def _draw_case(panel: Any, seen: Sequence[_Seen], d: int, size: tuple[int, int]) -> None:
    n, m = size
    means: tuple[tuple[str, str, Callable[[_Seen], float]], ...] = (
        ("-", "determined", lambda one: float(one.determined)),
        ("--", "in the largest part", lambda one: one.largest_part),
    )
    for way, colour in _WAY_COLOURS.items():
        mine = [one for one in seen if one.way == way]
        fractions = sorted({one.fraction for one in mine})
        for style, label, value in means:
            mean = [np.mean([value(one) for one in mine if one.fraction == f]) for f in fractions]
            panel.plot(fractions, mean, style, color=colour, marker=".", markersize=4, label=f"{label}, seen {way}")
    panel.axvline(_bound(d, size), color="#222222", linewidth=1.2, label="counting bound")
    panel.axvline(2 * (n + m) / (n * m + 3), color="#2e8b57", linewidth=1.2, linestyle=":", label="formula printed")
    quoted = _QUOTED_SMALL if size == _SMALL else _QUOTED_LARGE
    panel.axvline(quoted, color="#7a3f98", linewidth=1.2, linestyle="-.", label="number printed")
    panel.set_title(f"{n} points, {m} views, {'plane' if d == 2 else 'space'}", fontsize=10)
    panel.set(xlabel="share of pairs seen", ylabel="share of scenes, of members", ylim=(-0.03, 1.03))
    if size == _LARGE:
        panel.set_xscale("log")
        ticks = (0.01, 0.02, 0.03, 0.05, 0.1, 0.2)
        panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        panel.minorticks_off()
    panel.grid(alpha=0.25, linewidth=0.6)


def _draw_spans(figure: Any, spans: Table) -> None:
    left, right = figure.subplots(1, 2)
    rows = list(zip(*spans.columns.values(), strict=True))
    shown = [k for k in _OVERLAPS if k > 0]
    for noise, style in zip(_NOISES_RAD[1:], ("--", "-"), strict=True):
        for how, colour in (("views", "#d9480f"), ("views and points", "#1f5fa8")):
            errors = [1000.0 * _mean(rows, noise, how, k) for k in shown]
            label = f"joined by {how}, {np.degrees(noise):.3f} degrees"
            left.plot(shown, errors, style, color=colour, marker="o", markersize=4, label=label)
        whole = 1000.0 * _mean(rows, noise, "whole", 0)
        left.axhline(
            whole, color="#222222", linestyle=style, linewidth=1.0, label=f"whole, {np.degrees(noise):.3f} degrees"
        )
    left.set(xlabel="views in common", ylabel="rms error of cameras (mm)", yscale="log", xticks=shown)
    ticks = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
    left.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    left.minorticks_off()
    left.grid(alpha=0.25, linewidth=0.6)
    for how, colour in (("views", "#d9480f"), ("views and points", "#1f5fa8")):
        share = []
        for k in _OVERLAPS:
            mine = [row[5] for row in rows if row[1] == 0.0 and row[2] == how and row[3] == k]
            share.append(float(np.mean(mine)) / _N_VIEWS)
        right.plot(_OVERLAPS, share, color=colour, marker="o", markersize=4, label=f"joined by {how}")
    right.set(xlabel="views in common", ylabel="share of views in the joined scene", ylim=(0.0, 1.05), xticks=_OVERLAPS)
    right.grid(alpha=0.25, linewidth=0.6)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)


VISIBILITY = Experiment("visibility", "5", "How much must be seen, and spans that overlap", _run)
