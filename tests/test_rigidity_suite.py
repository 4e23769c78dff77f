"""The certificate against configurations whose ambiguity is known exactly: no misses, no false alarms."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import panopath as pp
import pytest
from exact_rigidity import Position, components_of, exact_rigidity, gauge_freedoms
from panopath.certificate import CauseKind, Verdict
from rigidity_suite import (
    ALL,
    Configuration,
    configurations,
    draw,
    exact_case,
    families,
    faults,
    is_whole,
    noisy_case,
    noisy_faults,
    rigidity_matrix,
    similarities,
)

FAMILIES = sorted({name for name, *_ in families()})


@cache
def by_family() -> dict[str, list[Configuration]]:
    found: dict[str, list[Configuration]] = {name: [] for name in FAMILIES}
    for configuration in configurations():
        found[configuration.family].append(configuration)
    return found


# --- the truth


def of_integers(*rows: tuple[int, ...]) -> list[Position]:
    return [tuple(map(Fraction, row)) for row in rows]


def test_exact_rank_of_cases_that_can_be_counted_by_hand() -> None:
    views, points = of_integers((0, 0), (4, 0), (1, 5)), of_integers((7, 3), (2, -6), (-3, 1))
    everything = list(product(range(3), range(3)))
    everyone = (frozenset(range(3)), frozenset(range(3)))
    generic = exact_rigidity(views, points, everything, "known")
    assert (generic.nullity, generic.components) == (3, (everyone,))
    # one ray fewer: 8 equations for 12 unknowns
    assert exact_rigidity(views, points, everything[1:], "known").nullity == 4
    # 9 equations for 15 unknowns
    assert exact_rigidity(views, points, everything, "free").nullity == 6
    # 18 equations for 18 positions, and in one plane
    in_space = [[(*position, Fraction(0)) for position in group] for group in (views, points)]
    assert exact_rigidity(in_space[0], in_space[1], everything, "known").nullity == 4
    assert exact_rigidity(views, of_integers((8, 0), (2, -6), (-3, 1)), everything, "known").nullity == 3


@pytest.mark.parametrize("size", [3, 4, 10])
def test_the_ellipse_that_the_paper_misses(size: int) -> None:
    t = [Fraction(k, 7) for k in range(-size, size)]
    ellipse = [(3 * (1 - x * x) / (1 + x * x), 2 * 2 * x / (1 + x * x)) for x in t]
    everything = list(product(range(size), range(size)))
    on_it = exact_rigidity(ellipse[:size], ellipse[size:], everything, "known")
    assert (on_it.nullity, on_it.components) == (4, ())
    above = [(*position, Fraction(k * k % 11)) for k, position in enumerate(ellipse)]
    assert exact_rigidity(above[:size], above[size:], everything, "known").nullity == 4
    off = [*ellipse[:-1], (Fraction(1, 5), Fraction(1, 9))]
    assert exact_rigidity(off[:size], off[size:], everything, "known").nullity == 3


def test_a_view_at_a_point_is_refused() -> None:
    with pytest.raises(ArithmeticError, match="stands at a point"):
        exact_rigidity(of_integers((1, 2)), of_integers((1, 2)), [(0, 0)], "known")


# --- the suite


def test_more_than_a_thousand_configurations_of_every_kind() -> None:
    suite = configurations()
    assert len(suite) >= 1000
    assert len({c.name for c in suite}) == len(suite)
    assert {(c.d, c.orientation) for c in suite} == set(ALL)
    assert max(len(c.centers) for c in suite) == max(len(c.points) for c in suite) == 12
    assert {kind for c in suite for kind in c.causes} == set(CauseKind)
    determined = sum(not c.ambiguous for c in suite)
    assert 300 < determined < len(suite) - 300


def test_a_configuration_depends_on_its_name_alone() -> None:
    before = {c.name: c for c in configurations()}
    for name, build, models, count in families():
        again = draw(name, build, models[-1], count - 1)
        first = before[again.name]
        assert (again.nullity, again.components, again.causes) == (first.nullity, first.components, first.causes)
        for field in ("centers", "points", "view", "track"):
            assert getattr(again, field).tobytes() == getattr(first, field).tobytes()


@pytest.mark.parametrize("family", FAMILIES)
def test_floating_point_agrees_with_exact_arithmetic(family: str) -> None:
    for c in by_family()[family]:
        matrix = rigidity_matrix(c)
        values, right = np.linalg.svd(matrix)[1:]
        rank = int((values > 1e-9 * values[0]).sum())
        assert matrix.shape[1] - rank == c.nullity, c.name
        assert c.gauge_freedoms == gauge_freedoms(c.d, c.orientation)
        key = similarities(c, right[rank:].T).reshape(len(c.view), -1)
        distance = np.linalg.norm(key[:, None] - key[None], axis=2)
        nearest = [str(int(row.argmax())).encode() for row in distance < 1e-7]
        rays = list(zip(c.view.tolist(), c.track.tolist(), strict=True))
        assert set(components_of(rays, nearest)) == set(c.components), c.name


@pytest.mark.parametrize("family", FAMILIES)
def test_exact_cases_have_residuals_of_rounding(family: str) -> None:
    for c in by_family()[family]:
        tracks, scene = exact_case(c)
        assert scene.residual_rad.max() < 1e-13, c.name
        assert (len(tracks), scene.centers.shape, scene.points.shape) == (len(c.view), c.centers.shape, c.points.shape)


def claimed(c: Configuration, **changes: Any) -> Any:
    """A certificate that says the truth, but for some fields."""
    parts = [
        SimpleNamespace(views=np.array(sorted(views)), tracks=np.array(sorted(points)), n_observations=2)
        for views, points in c.components
    ]
    fields = {
        "nullity": c.nullity,
        "gauge_freedoms": c.gauge_freedoms,
        "verdict": Verdict.UNDETERMINED if c.ambiguous else Verdict.DETERMINED,
        "components": tuple(parts),
        "causes": [SimpleNamespace(kind=kind, is_exact=True) for kind in sorted(c.causes)[:1]],
    }
    return SimpleNamespace(**{**fields, **changes})


def test_each_fault_is_seen() -> None:
    c = by_family()["windows"][0]
    assert faults(c, claimed(c)) == []
    lone = SimpleNamespace(views=np.array([0]), tracks=np.array([0]), n_observations=1)
    assert faults(c, claimed(c, components=(*claimed(c).components, lone))) == []
    other = [SimpleNamespace(kind=CauseKind.CONIC, is_exact=True)]
    changed: list[dict[str, Any]] = [
        {"nullity": c.nullity - 1},
        {"gauge_freedoms": c.gauge_freedoms + 1},
        {"verdict": Verdict.WEAK},
        {"verdict": Verdict.DETERMINED},
        {"components": claimed(c).components[1:]},
        {"causes": other},
        {"causes": []},
    ]
    for changes in changed:
        assert faults(c, claimed(c, **changes)), changes
    firm = by_family()["skew lines"][0]
    assert faults(firm, claimed(firm)) == []
    assert faults(firm, claimed(firm, causes=other))
    assert faults(firm, claimed(firm, verdict=Verdict.WEAK))


def test_noise_excuses_weak_only() -> None:
    loose, firm = by_family()["windows"][0], by_family()["skew lines"][0]
    for c, verdict, wrong in (
        (loose, Verdict.DETERMINED, 1),
        (loose, Verdict.WEAK, 0),
        (firm, Verdict.UNDETERMINED, 1),
        (firm, Verdict.WEAK, 0),
        (firm, Verdict.DETERMINED, 0),
    ):
        assert len(noisy_faults(c, exact_case(c)[1], claimed(c, verdict=verdict))) == wrong


# --- the certificate


@pytest.mark.parametrize("family", FAMILIES)
def test_no_misses_and_no_false_alarms(family: str) -> None:
    wrong = []
    for c in by_family()[family]:
        options = pp.CertifyOptions(orientation=c.orientation, sigma_rad=1e-9)
        wrong += faults(c, pp.certify(*exact_case(c), options))
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("noise_deg", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("family", FAMILIES)
def test_with_noise_it_errs_towards_weak_only(family: str, noise_deg: float) -> None:
    wrong = []
    for c in by_family()[family]:
        tracks, scene = noisy_case(c, np.radians(noise_deg))
        options = pp.CertifyOptions(orientation=c.orientation, sigma_rad=np.radians(noise_deg))
        wrong += noisy_faults(c, scene, pp.certify(tracks, scene, options))
    assert not wrong, "\n".join(wrong)


def test_weak_is_the_exception() -> None:
    sigma_rad = np.radians(0.02)
    verdicts = []
    for c in configurations():
        if not c.ambiguous:
            tracks, scene = noisy_case(c, sigma_rad)
            if is_whole(scene):
                options = pp.CertifyOptions(orientation=c.orientation, sigma_rad=sigma_rad)
                verdicts.append(pp.certify(tracks, scene, options).verdict)
    assert len(verdicts) > 300
    assert verdicts.count(Verdict.DETERMINED) > 0.85 * len(verdicts)
