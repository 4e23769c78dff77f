"""Section 6: bodies that move along Taylor or Fourier paths, what may be found of them, and what stays free.

Exact scenes must come back exactly, by the paper's linear equations and by the solver of this package; errors must grow
in proportion to the noise. What the equations leave free is counted by the certificate of paths
(:func:`panopath.certify_paths`) and by singular values, against the gauge that the paper names and the larger one that
there is (``docs/method/moving.md``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from panopath.counting import CameraModel, PathBasis
from panopath.evaluate import evaluate, fit_shift_and_scale
from panopath.freedoms import Reach
from panopath.model import PositionOptions
from panopath.paper.experiment import Experiment, Outcome, Picture, Progress, Settings, Statement, Table, Verdict
from panopath.paper.generic_rank import extra_freedoms
from panopath.paper.moving_scenes import FORMS, MovingScene, draw_hidden, draw_moving
from panopath.paper.scenes import slope
from panopath.paper.trials import rms
from panopath.paths import Motion, PathModel, Static
from panopath.steps.freedoms import FreedomOptions, certify_paths
from panopath.steps.positions import solve_positions

_TRIALS = 6
#: Views of scenes that are solved.
_N_VIEWS = 30
#: Noise of a bearing along each tangent direction, radians; 0: exact.
_NOISES_RAD = (0.0, 1e-5, 1e-4, 1e-3, 1e-2)
#: Exponents are taken up to this noise: beyond, errors are no longer small.
_SMALL_RAD = 1e-3
#: Points known to be at rest, and bodies, of scenes that are solved.
_MIXES = {"six at rest": (6, 3), "one anchor": (1, 6)}
#: Errors below this are rounding, of scenes 2 wide.
_EXACT = 1e-8
_WAYS = ("linear equations", "solve_positions")
_MODELS = {2: CameraModel.ORIENTED_PLANE, 3: CameraModel.ORIENTED_SPACE}
_PLACE = {2: "the plane", 3: "space"}
#: Points and views are counted up to this number.
_LARGEST = 8


def _run(settings: Settings, progress: Progress) -> Outcome:
    trials = settings.trials_or(_TRIALS)
    parts = 4
    noise = _noise_table(settings, trials)
    progress(1, parts)
    gauge = _gauge_table(settings, trials)
    progress(2, parts)
    counts = _count_table(settings.seed)
    progress(3, parts)
    hidden = _hidden_table(settings, trials)
    progress(4, parts)
    return Outcome(
        n_trials=len(noise) + len(gauge) + len(hidden),
        tables={"noise": noise, "gauge": gauge, "counts": counts, "hidden": hidden},
        statements=(
            *_gauge_statements(gauge),
            *_noise_statements(noise),
            *_count_statements(counts),
            *_hidden_statements(hidden),
        ),
        pictures={
            "noise": Picture(
                lambda figure: _draw_noise(figure, noise),
                "Errors of views and of bodies against the noise, in scenes 2 wide: straight lines of slope one.",
                11.0,
                4.8,
            ),
            "hidden": Picture(
                lambda figure: _draw_hidden(figure, settings.seed),
                "The hidden point: two steady bodies in one direction from every view, and other paths of the far one "
                "that have the same bearings.",
                8.0,
                6.0,
            ),
        },
    )


# -------------------------------------------------------------------------------------------------- error and noise


def _noise_table(settings: Settings, trials: int) -> Table:
    rows = []
    cases = [(d, form, mix) for d in (2, 3) for form in FORMS for mix in _MIXES]
    for number, (d, form, mix) in enumerate(cases):
        for trial in range(trials):
            rng = np.random.default_rng((settings.seed, number, trial))
            n_static, n_moving = _MIXES[mix]
            exact = draw_moving(rng, [Static()] * n_static + [FORMS[form]] * n_moving, d=d, n_views=_N_VIEWS)
            for noise in _NOISES_RAD:
                # the same errors at every size: the same scene seen worse
                errors = np.random.default_rng((settings.seed, number, trial, 1))
                scene = exact.noisy(noise, errors) if noise else exact
                found = (_WAYS[1], *_errors(scene, settings.threads))
                rows.append((d, form, mix, trial, noise, *found))
            found_linearly = exact.linear_centers()
            scale, shift = fit_shift_and_scale(found_linearly, exact.centers)
            linear = rms(np.linalg.norm(scale * found_linearly + shift - exact.centers, axis=1))
            rows.append((d, form, mix, trial, 0.0, _WAYS[0], linear, np.nan))
    return Table.of(("dimension", "form", "mix", "trial", "noise_rad", "way", "view_rms", "body_rms"), rows)


def _errors(scene: MovingScene, threads: int) -> tuple[float, float]:
    """Rms errors of views, and of bodies over all times, as they are solved; NaN where they are not."""
    moving: dict[str | int, Any] = {j: form for j, form in enumerate(scene.models) if j not in scene.static}
    found = solve_positions(
        scene.tracks,
        options=PositionOptions(threads=threads or None),
        motion=Motion(tracks=moving, static=scene.static, covariance=False),
    )
    if not np.isfinite(found.centers).all():
        return np.nan, np.nan
    compared = evaluate(found, scene.truth(), "translation_scale")
    return compared.camera_rms, rms(compared.point_error[len(scene.static) :])


def _noise_statements(table: Table) -> list[Statement]:
    rows = list(zip(*table.columns.values(), strict=True))
    solved = [row for row in rows if row[4] == 0.0 and row[5] == _WAYS[1]]
    exact = sum(row[6] < _EXACT and row[7] < _EXACT for row in solved)
    anchored = [row for row in rows if row[4] == 0.0 and row[5] == _WAYS[0]]
    linear = sum(row[6] < _EXACT for row in anchored)
    slopes = {(d, form): _slope(rows, d, form) for d in (2, 3) for form in FORMS}
    low, high = min(slopes.values()), max(slopes.values())
    return [
        Statement(
            "6",
            "With a Taylor or Fourier expansion of each path the problem remains linear, and exact data give the scene "
            "exactly.",
            f"One null vector of the linear equations gives the views to {_EXACT:.0e} in {linear:,} of "
            f"{len(anchored):,} scenes of {_N_VIEWS} views; "
            f"solve_positions gives views and bodies in {exact:,} of {len(solved):,}.",
            Verdict.AGREES if linear == len(anchored) and exact == len(solved) else Verdict.IN_PART,
        ),
        Statement(
            "6, 8",
            "Errors depend linearly on the error of the angles.",
            f"Exponent of the error of views and bodies against noise up to {_SMALL_RAD:g} rad, over both dimensions "
            f"and all forms: {low:.2f} to {high:.2f}.",
            Verdict.AGREES if low > 0.9 and high < 1.1 else Verdict.IN_PART,
        ),
    ]


def _slope(rows: Sequence[tuple[Any, ...]], d: int, form: str) -> float:
    """Exponent of the median error against noise: bodies among six points at rest."""
    noises = [noise for noise in _NOISES_RAD if 0.0 < noise <= _SMALL_RAD]
    errors = [_median(rows, d, form, noise, 7) for noise in noises]
    return slope(np.array(noises), np.array(errors))


def _median(rows: Sequence[tuple[Any, ...]], d: int, form: str, noise: float, column: int) -> float:
    """Median error among six points at rest."""
    case = (d, form, "six at rest", noise, _WAYS[1])
    return float(np.nanmedian([row[column] for row in rows if (row[0], row[1], row[2], row[4], row[5]) == case]))


# ------------------------------------------------------------------------------------------------------------- gauge


@dataclass(frozen=True)
class _GaugeCase:
    """All tracks of one form, but for those that are known to be at rest."""

    d: int
    form: str
    anchors: int
    at_rest: bool

    @property
    def expected(self) -> int:
        """Nullity that theory gives (``docs/method/moving.md``)."""
        more = FORMS[self.form].n_functions - 1
        common = self.d * more if self.anchors == 0 else 0
        scale = more if self.at_rest and self.anchors < 2 else 0
        return self.d + 1 + common + scale


def _gauge_table(settings: Settings, trials: int) -> Table:
    cases = [
        _GaugeCase(d, form, anchors, at_rest)
        for d in (2, 3)
        for form in FORMS
        for at_rest in (False, True)
        for anchors in (0, 1, 2)
    ]
    rows = []
    for number, case in enumerate(cases):
        models: list[PathModel] = [Static()] * case.anchors + [FORMS[case.form]] * 6
        for trial in range(trials):
            rng = np.random.default_rng((settings.seed, 1000 + number, trial))
            scene = draw_moving(rng, models, d=case.d, n_views=20, at_rest=case.at_rest)
            options = FreedomOptions(sigma_rad=0.0, threads=settings.threads or None)
            certified = certify_paths(scene.tracks, scene.truth(), options).nullity
            rows.append((*case.__dict__.values(), trial, case.expected, certified, scene.dense_nullity()))
    names = ("dimension", "form", "anchors", "at_rest", "trial", "expected", "certified", "dense")
    return Table.of(names, rows)


def _gauge_statements(table: Table) -> list[Statement]:
    rows = list(zip(*table.columns.values(), strict=True))
    alike = sum(row[5] == row[6] == row[7] for row in rows)

    def told(d: int, form: str, anchors: int, at_rest: bool) -> str:
        found = {row[7] for row in rows if row[:4] == (d, form, anchors, at_rest)}
        return " or ".join(str(one) for one in sorted(found))

    def beyond(anchors: int, at_rest: bool) -> list[int]:
        return sorted({row[7] - row[0] - 1 for row in rows if row[2] == anchors and row[3] == at_rest})

    moving, resting = beyond(1, False), beyond(1, True)
    line = "Taylor, k = 1"
    return [
        Statement(
            "6",
            "If no body is fixed, the whole scene and the camera could move at constant speed.",
            f"So they could, and along every function of the paths: in space with k = 1 the equations leave "
            f"{told(3, line, 0, False)} freedoms where 4 are shift and scale. Fourier paths of k = 2 leave "
            f"{told(3, 'Fourier, k = 2', 0, False)}.",
            Verdict.AGREES if min(beyond(0, False)) > 0 else Verdict.CORRECTED,
        ),
        Statement(
            "6",
            "One point of zero velocity removes this ambiguity.",
            f"Where bodies truly move, {_listed(moving)} freedoms are left beyond shift and scale. Where all really "
            f"are at rest, {_listed(resting)}: everything may grow about the anchor as 1 + alpha t (in space, k = 1: "
            f"nullity {told(3, line, 0, True)} without an anchor, {told(3, line, 1, True)} with one, "
            f"{told(3, line, 2, True)} with two). A second point at rest ends it, or one body that moves.",
            Verdict.IN_PART if moving == [0] and resting[0] > 0 else Verdict.AGREES,
        ),
        Statement(
            "6",
            "The symmetry is as large as that of points at rest.",
            f"It has d more freedoms for each further function, and in scenes at rest one more for each: this is the "
            f"nullity by certify_paths and by singular values in {alike:,} of {len(rows):,} scenes.",
            Verdict.CORRECTED if alike == len(rows) else Verdict.IN_PART,
        ),
    ]


def _listed(numbers: Sequence[int]) -> str:
    return "no" if list(numbers) == [0] else ", ".join(str(one) for one in numbers)


# ---------------------------------------------------------------------------------------------------------- counting


def _count_table(seed: int) -> Table:
    """Every pair, each printed inequality beside the right one and the rank in exact arithmetic."""
    rows: list[tuple[Any, ...]] = []
    kinds: tuple[tuple[str, PathBasis, int], ...] = (("Taylor", "taylor", 1), ("Fourier", "fourier", 1))
    for d, model in _MODELS.items():
        _, f, g, _ = model.counts
        for name, basis, k in kinds:
            printed_vectors = k + 1 if name == "Taylor" else 2 * k
            for n in range(2, _LARGEST + 1):
                for m in range(2, 2 * _LARGEST + 1):
                    printed = d * n * printed_vectors + m * f <= n * m * (d - 1) + g
                    right = model.inequality(n, m, k, basis).is_settled
                    unique = extra_freedoms(model, n, m, k, basis, seed=seed) <= 0
                    rows.append((d, name, k, n, m, printed, right, unique))
    return Table.of(("dimension", "paths", "k", "points", "views", "printed", "right", "unique"), rows)


def _count_statements(table: Table) -> list[Statement]:
    rows = list(zip(*table.columns.values(), strict=True))
    statements = []
    for name, claim in (
        ("Taylor", "Taylor paths: d n (k + 1) + m f <= n m (d - 1) + g, with the g of points at rest."),
        ("Fourier", "Fourier paths: d n (2 k) + m f <= n m (d - 1) + g."),
    ):
        mine = [row for row in rows if row[1] == name]
        lost = [row for row in mine if row[7] and not row[5]]
        false = [row for row in mine if row[5] and not row[7]]
        right = sum(row[6] == row[7] for row in mine)
        words = f"{len(lost):,} that are unique are forbidden"
        if lost:
            words += f" ({_pair_words(lost[0])}, k = 1, is the first)"
        words += f", {len(false):,} that are not are allowed"
        mend = "g + d k" if name == "Taylor" else "d n (2 k + 1), the mean position being a vector too, and g + 2 d k"
        statements.append(
            Statement(
                "6",
                claim,
                f"Of {len(mine):,} pairs, k = 1, in plane and space, {words}. With {mend} the count is what the rank "
                f"in exact arithmetic says in {right:,}.",
                Verdict.CORRECTED if lost or false else Verdict.AGREES,
            )
        )
    statements.append(
        Statement(
            "6",
            "A Taylor expansion of order k has 3 n k + 3 m f unknowns.",
            "d n (k + 1) + f m: k + 1 vectors a point, and f, which holds the 3 already, for each view.",
            Verdict.CORRECTED,
        )
    )
    return statements


def _pair_words(row: tuple[Any, ...]) -> str:
    return f"{row[3]} points and {row[4]} views in {_PLACE[row[0]]}"


# ------------------------------------------------------------------------------------------------------ hidden points


def _hidden_table(settings: Settings, trials: int) -> Table:
    """Ask the certificate of bodies that nothing can find, and of one that can be found."""
    rows = []
    line = FORMS["Taylor, k = 1"]
    for d in (2, 3):
        for trial in range(trials):
            rng = np.random.default_rng((settings.seed, 5000 + d, trial))
            forms: list[PathModel] = [*[Static()] * 8, line, line]
            scenes = {
                "hidden": draw_hidden(rng, d=d),
                "imitated": draw_moving(rng, forms, d=d, steady=True),
                "seen": draw_moving(rng, forms, d=d),
            }
            for name, scene in scenes.items():
                options = FreedomOptions(sigma_rad=0.0, threads=settings.threads or None)
                found = certify_paths(scene.tracks, scene.truth(), options)
                motion = Motion(tracks={8: line, 9: line}, static=scene.static, covariance=False)
                threads = PositionOptions(threads=settings.threads or None)
                solved = solve_positions(scene.tracks, options=threads, motion=motion)
                verdict = "none" if solved.paths is None else str(solved.paths.verdicts[9])
                dense = scene.dense_nullity() - d - 1
                rows.append((d, name, trial, dense, found.extra, str(found.reaches[9]), verdict))
    return Table.of(("dimension", "scene", "trial", "dense", "certified", "reach", "solver"), rows)


def _hidden_statements(table: Table) -> list[Statement]:
    rows = list(zip(*table.columns.values(), strict=True))

    def told(scene: str, reach: Reach, verdict: str) -> tuple[int, int, int, list[int]]:
        mine = [row for row in rows if row[1] == scene]
        return (
            sum(row[5] == str(reach) for row in mine),
            sum(row[6] == verdict for row in mine),
            len(mine),
            sorted({row[3] for row in mine}),
        )

    hidden, hidden_solver, n_hidden, free = told("hidden", Reach.HIDDEN, "hidden")
    imitated, imitated_solver, n_imitated, more = told("imitated", Reach.IMITATED, "imitated")
    seen, seen_solver, n_seen, none = told("seen", Reach.DETERMINED, "moving")
    return [
        Statement(
            "6, figure",
            "A body that is always behind another one has no determined distance.",
            f"Two steady bodies in one direction from 30 views that sway, beside eight points at rest: "
            f"{_listed(free)} freedoms are left. certify_paths names the far one hidden in {hidden:,} of {n_hidden:,} "
            f"scenes, and solve_positions refuses it as hidden in {hidden_solver:,}. Elsewhere the same bodies have "
            f"{_listed(none)} freedom: found in {seen:,} and {seen_solver:,} of {n_seen:,}.",
            Verdict.AGREES if hidden == n_hidden and free[0] > 0 and none == [0] else Verdict.IN_PART,
        ),
        Statement(
            "6",
            "With bodies that move there are even more situations in which motion cannot be found.",
            f"Another one: a camera that itself moves steadily. Each steady body may be drawn towards it, however much "
            f"is known to be at rest: {_listed(more)} freedoms for two bodies, named imitated in {imitated:,} of "
            f"{n_imitated:,}, refused by solve_positions in {imitated_solver:,}.",
            Verdict.AGREES if imitated == n_imitated else Verdict.IN_PART,
        ),
    ]


# ---------------------------------------------------------------------------------------------------------- pictures

_FORM_COLOURS = dict(zip(FORMS, ("#1f5fa8", "#2e8b57", "#d9480f", "#7a3f98"), strict=True))


def _draw_noise(figure: Any, table: Table) -> None:
    rows = list(zip(*table.columns.values(), strict=True))
    noises = [noise for noise in _NOISES_RAD if noise > 0.0]
    panels = figure.subplots(1, 2, sharey=True)
    for panel, (title, column) in zip(panels, (("views", 6), ("bodies", 7)), strict=True):
        for form, colour in _FORM_COLOURS.items():
            for d, style in ((2, "--"), (3, "-")):
                errors = [_median(rows, d, form, noise, column) for noise in noises]
                panel.loglog(np.degrees(noises), errors, style, color=colour, marker="o", markersize=3)
        panel.loglog(np.degrees(noises), noises, ":", color="#222222", linewidth=1.0)
        panel.set(xlabel="noise of a bearing (degrees)", title=f"Error of the {title}, median of the scenes")
        panel.grid(alpha=0.25, linewidth=0.6)
    panels[0].set_ylabel("rms error (units of the scene)")
    for form, colour in _FORM_COLOURS.items():
        panels[0].plot([], [], color=colour, label=form)
    for label, style in (("space", "-"), ("plane", "--"), ("noise at distance one", ":")):
        panels[0].plot([], [], style, color="#222222", label=label)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=7, frameon=False, fontsize=9)


def _draw_hidden(figure: Any, seed: int) -> None:
    scene = draw_hidden(np.random.default_rng((seed, 9)), d=2, n_views=9)
    truth = scene.truth().paths
    assert truth is not None
    panel = figure.subplots()
    ahead, behind = (truth.position(j, scene.time_s) for j in (8, 9))
    for view, end in zip(scene.centers, 2.1 * behind - 1.1 * ahead, strict=True):
        panel.plot(*np.array((view, end)).T, color="#b8c0c8", linewidth=0.7, zorder=1)
    for share in (0.5, 1.5, 2.0):
        other = ahead + share * (behind - ahead)
        label = "other paths of the hidden body" if share == 0.5 else None
        panel.plot(*other.T, "--", color="#d9480f", linewidth=1.0, marker=".", markersize=4, alpha=0.6, label=label)
    panel.plot(*behind.T, "o-", color="#d9480f", markersize=5, label="hidden body")
    panel.plot(*ahead.T, "o-", color="#2e8b57", markersize=5, label="body before it")
    panel.plot(*scene.centers.T, "s-", color="#1f5fa8", markersize=5, label="camera")
    panel.set(xlabel="x (units of the scene)", ylabel="y (units of the scene)", aspect="equal")
    panel.grid(alpha=0.25, linewidth=0.6)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=9)


MOVING = Experiment("moving", "6", "Bodies that move: exact recovery, noise, and what stays free", _run)
