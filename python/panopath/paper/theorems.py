"""Sections 4 and 5: the theorems and the ambiguities, each on many random scenes.

Of every scene three counts of what is free beyond shift and scale are compared: that of the certificate, that of the
geometry (lines, planes and conics, ``docs/method/conditions.md``), and the null space of all equations by singular
values. Scenes that are free are moved along a null vector by a step that is not small, and must keep every bearing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from panopath.evaluate import evaluate
from panopath.model import Float, PositionOptions, Tracks
from panopath.paper.experiment import Experiment, Outcome, Progress, Settings, Statement, Table, Verdict
from panopath.paper.scenes import dense_freedoms, null_vector, rays, truth_of, unit
from panopath.paper.theorem_pictures import mode_picture
from panopath.paper.theorem_scenes import CYLINDER, KINDS, Kind, Places, apart
from panopath.steps.certificate import CertifyOptions, certify
from panopath.steps.conditions import full_visibility
from panopath.steps.positions import solve_positions

_TRIALS = 300
#: Scenes on a cylinder that are solved in both ways, at most.
_MOST_SOLVED = 100
#: Step along a null vector, as a share of the size of the scene.
_STEP = 0.05
#: Bearings that turn by less have not changed; cameras that err by less are exact.
_EXACT = 1e-7


@dataclass(frozen=True)
class _Judged:
    """One scene, by all three counts."""

    kind: str
    trial: int
    d: int
    n_views: int
    n_points: int
    certified: int
    geometric: int
    dense: int
    #: Largest turn of a bearing when the scene moves along its first null vector; NaN where there is none.
    turned_rad: float

    @property
    def agrees(self) -> bool:
        return self.certified == self.geometric == self.dense


def _run(settings: Settings, progress: Progress) -> Outcome:
    trials = settings.trials_or(_TRIALS)
    judged: list[_Judged] = []
    for done, kind in enumerate(KINDS):
        rng = np.random.default_rng((settings.seed, done))
        judged += [_judge(kind.name, trial, kind.draw(rng), settings.threads) for trial in range(trials)]
        progress(done + 1, len(KINDS) + 1)
    cylinder, solved = _cylinder(settings, trials)
    judged += cylinder
    progress(len(KINDS) + 1, len(KINDS) + 1)
    return Outcome(
        n_trials=len(judged),
        tables={"scenes": _scene_table(judged), "cylinder": solved},
        statements=(
            *(_kind_statement(kind, [one for one in judged if one.kind == kind.name]) for kind in KINDS),
            *_cylinder_statements(cylinder, solved),
            *_agreement_statements(judged),
        ),
        pictures={"modes": mode_picture(settings.seed)},
    )


def _judge(kind: str, trial: int, places: Places, threads: int) -> _Judged:
    centers, points = places
    tracks, d = rays(centers, points), centers.shape[1]
    certificate = certify(tracks, truth_of(tracks, centers, points), CertifyOptions(threads=threads or None))
    free = certificate.nullity - certificate.gauge_freedoms
    return _Judged(
        kind,
        trial,
        d,
        len(centers),
        len(points),
        free,
        full_visibility(centers, points).nullity - (d + 1),
        dense_freedoms(tracks),
        _turned(tracks, places, null_vector(certificate)) if free > 0 else float("nan"),
    )


def _turned(tracks: Tracks, places: Places, mode: tuple[Float, Float]) -> float:
    """Largest turn of a ray, as a line, when everything moves along a mode by ``_STEP`` of the size."""
    centers, points = (place + _STEP * moved for place, moved in zip(places, mode, strict=True))
    ray = unit(points[tracks.track] - centers[tracks.view])
    along = (ray * tracks.bearing).sum(axis=1, keepdims=True)
    return float(np.linalg.norm(ray - along * tracks.bearing, axis=1).max())


def _scene_table(judged: Sequence[_Judged]) -> Table:
    names = ("kind", "trial", "dimension", "views", "points", "certified", "geometric", "dense", "turned_rad", "agree")
    return Table.of(names, [(*one.__dict__.values(), one.agrees) for one in judged])


# -------------------------------------------------------------------------------------------------------- statements


def _kind_statement(kind: Kind, judged: Sequence[_Judged]) -> Statement:
    unique = sum(one.dense == 0 for one in judged)
    free = sorted({one.dense for one in judged})
    found = f"{unique:,} of {len(judged):,} are unique"
    if free[-1] > 0:
        found += f"; freedoms beyond the gauge: {free[0]}" + (f" to {free[-1]}" if free[-1] > free[0] else "")
    as_claimed = unique if kind.claimed else len(judged) - unique
    verdict = Verdict.AGREES if as_claimed == len(judged) else Verdict.IN_PART if as_claimed else Verdict.CORRECTED
    reason = f" {kind.reason}" if kind.reason and verdict is not Verdict.AGREES else ""
    return Statement(kind.section, kind.claim, f"{found}.{reason}", verdict)


def _agreement_statements(judged: Sequence[_Judged]) -> list[Statement]:
    exact = sum(one.geometric == one.dense for one in judged)
    certified = sum(one.certified == one.dense for one in judged)
    moved = [one.turned_rad for one in judged if np.isfinite(one.turned_rad)]
    free = sum(one.dense > 0 for one in judged)
    largest = max(moved, default=0.0)
    return [
        Statement(
            "4",
            "A configuration is ambiguous if and only if the matrix A has a null space beyond the gauge.",
            f"What lines, planes and conics through the scene say is what the singular values of A say in {exact:,} of "
            f"{len(judged):,} scenes. The certificate counts the same freedoms in {certified:,}.",
            Verdict.AGREES if exact == len(judged) else Verdict.IN_PART,
        ),
        Statement(
            "4",
            "Ambiguous scenes form a linear space, in which members move on lines.",
            f"{len(moved):,} of the {free:,} ambiguous scenes were moved along a null vector of the certificate by "
            f"{100 * _STEP:.0f} % of their size: no bearing turned by more than {largest:.1e} rad.",
            Verdict.AGREES if largest < _EXACT else Verdict.IN_PART,
        ),
    ]


# ---------------------------------------------------------------------------------------------------------- cylinder


def _cylinder(settings: Settings, trials: int) -> tuple[list[_Judged], Table]:
    """Judge plans and scenes on an elliptic cylinder, and solve some of them through the plane and in one."""
    rng = np.random.default_rng((settings.seed, len(KINDS)))
    judged, rows = [], []
    for trial in range(trials):
        centers, points = apart(CYLINDER, rng)
        judged += [
            _judge("cylinder, plan", trial, (centers[:, :2], points[:, :2]), settings.threads),
            _judge("cylinder, space", trial, (centers, points), settings.threads),
        ]
        if trial < _MOST_SOLVED:
            rows += _solved("cylinder", trial, (centers, points), settings.threads)
            general = rng.uniform(-1.0, 1.0, (4, 3)), rng.uniform(-1.0, 1.0, (5, 3))
            rows += _solved("general", trial, general, settings.threads)
    return judged, Table.of(("scene", "trial", "way", "camera_rms_error"), rows)


def _solved(scene: str, trial: int, places: Places, threads: int) -> list[tuple[str, int, str, float]]:
    """Errors of the paper's linear solution, whole and in two stages about each axis; NaN where none is given."""
    tracks, rows = rays(*places), []
    ways = {"whole": PositionOptions(method="linear", threads=threads or None)}
    for axis, name in enumerate("xyz"):
        ways[f"plane, then {name}"] = PositionOptions(
            method="linear", linear_form="two_stage", vertical_axis=axis, threads=threads or None
        )
    for name, options in ways.items():
        found = solve_positions(tracks, options=options)
        known = bool(np.isfinite(found.centers).all())
        error = evaluate(found, places, "translation_scale").camera_rms if known else float("nan")
        rows.append((scene, trial, name, error))
    return rows


def _cylinder_statements(judged: Sequence[_Judged], solved: Table) -> list[Statement]:
    free = {name: [one.dense for one in judged if one.kind == f"cylinder, {name}"] for name in ("plan", "space")}
    plan, space = (sum(extra == 0 for extra in free[name]) for name in ("plan", "space"))
    exact: dict[tuple[str, str], list[bool]] = {}
    for scene, _, way, error in zip(*solved.columns.values(), strict=True):
        exact.setdefault((scene, way), []).append(error < _EXACT)
    share = {key: f"{sum(found):,} of {len(found):,}" for key, found in exact.items()}
    general = all(all(found) for (scene, _), found in exact.items() if scene == "general")
    return [
        Statement(
            "4, 5",
            "Uniqueness in space is decided in the plane.",
            f"On an elliptic cylinder, heights at random, {plan:,} of {len(free['plan']):,} plans are unique and "
            f"{space:,} of {len(free['space']):,} scenes in space. The plan is enough, not needed.",
            Verdict.CORRECTED if plan == 0 and space == len(free["space"]) else Verdict.IN_PART,
        ),
        Statement(
            "5",
            "The plane is solved first and the heights after it; any axis may be the height.",
            f"In general position every axis gives the scene exactly ({share['general', 'plane, then x']}, "
            f"{share['general', 'plane, then y']} and {share['general', 'plane, then z']} with x, y and z). On the "
            f"cylinder about z: {share['cylinder', 'plane, then z']} with z last, "
            f"{share['cylinder', 'plane, then x']} with x last, {share['cylinder', 'whole']} with all coordinates at "
            "once.",
            Verdict.IN_PART if general and not any(exact["cylinder", "plane, then z"]) else Verdict.AGREES,
        ),
    ]


THEOREMS = Experiment("theorems", "4, 5", "Theorems and ambiguities on random scenes", _run)
