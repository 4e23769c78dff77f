"""Counting: the paper's tables with their slips mended, laws, and scenes in general position in exact arithmetic."""

from __future__ import annotations

import dataclasses
import re
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from hypothesis import given
from hypothesis import strategies as st
from panopath.counting import (
    PointsAndViews,
    inequality_table,
    models_text,
    moving_gauge,
    path_vectors,
    smallest,
    table_text,
)
from panopath.paper.generic_rank import extra_freedoms
from panopath.report import Region, draw_forbidden_regions

from docs import figures_counting as figures

PAGE = Path(__file__).parent.parent / "docs" / "method" / "counting.md"

Model = pp.CameraModel
Camera = tuple[int, int, int, int]
inequality = pp.structure_from_motion_inequality

#: Fewest points and views. Beside those of the paper, counts that have long been known: 5 points of two calibrated
#: views, 6 of two that share a focal length, 7 of two uncalibrated ones and 6 of three, 4 of two affine ones (Hartley
#: and Zisserman 2004; Stewenius, Nister, Kahl and Schaffalitzky 2005).
FEWEST = {
    Model.ORIENTED_PLANE: [(3, 3)],
    Model.ORIENTED_SPACE: [(2, 2)],
    Model.NON_ORIENTED_PLANE: [(5, 3), (4, 4)],
    Model.NON_ORIENTED_SPACE: [(5, 2), (4, 3)],
    Model.GRAVITY_SPACE: [(3, 2)],
    Model.ORTHOGRAPHIC_PLANE: [(3, 3)],
    Model.ORTHOGRAPHIC_SPACE: [(4, 2), (3, 3)],
    Model.SCALED_ORTHOGRAPHIC_SPACE: [(5, 2), (4, 3)],
    Model.AFFINE_SPACE: [(4, 2)],
    Model.SHARED_FOCAL_SPACE: [(6, 2), (4, 3)],
    Model.PROJECTIVE_SPACE: [(7, 2), (6, 3)],
}
#: Two views of these are ambiguous however many points there are, though counting has nothing against it.
TWO_VIEWS_FAIL = (Model.ORTHOGRAPHIC_SPACE, Model.SCALED_ORTHOGRAPHIC_SPACE)
OWN = list(Model)[:5]

few = st.integers(1, 30)
dimensions = st.integers(2, 4)
unknowns = st.integers(0, 15)
cameras = st.tuples(dimensions, unknowns, unknowns, unknowns)
orders = st.integers(0, 3)
paths = st.one_of(
    st.tuples(orders, st.sampled_from([None, "taylor", "fourier"])), st.tuples(st.just(0), st.integers(1, 6))
)


def test_table_of_the_plane() -> None:
    """Section 4: n m equations for 2 (n + m) - 3 unknowns, and what each row of the table says."""
    for n, m in product(range(1, 20), repeat=2):
        row = inequality(2, 2, 3, 0, n, m)
        assert (row.equations, row.unknowns) == (n * m, 2 * (n + m) - 3)
        assert row.holds == (n * m - 2 * m - 2 * n + 3 >= 0) == (row.slack >= 0)
    assert not any(inequality(2, 2, 3, 0, n, m).holds for m in (1, 2) for n in range(2, 50))
    assert not inequality(2, 2, 3, 0, 2, 3).holds
    assert all(inequality(2, 2, 3, 0, n, m).holds for m in (3, 4) for n in range(3, 50))
    border = [(n, m) for n, m in product(range(1, 30), repeat=2) if inequality(2, 2, 3, 0, n, m).slack == 0]
    assert border == [(1, 1), (3, 3)]


def test_space_has_its_border_at_two_and_two() -> None:
    for n, m in product(range(1, 20), repeat=2):
        assert inequality(3, 3, 4, 0, n, m).slack == 2 * n * m - 3 * (n + m) + 4
    assert inequality(3, 3, 4, 0, 2, 2).slack == 0
    assert not inequality(3, 3, 4, 0, 2, 1).holds


def test_three_and_three_are_not_enough_without_orientation() -> None:
    """Section 2 says that they are; there is room for it only with orthographic views."""
    assert inequality(2, 3, 4, 0, 3, 3).slack == -2
    assert inequality(3, 6, 7, 0, 3, 3).slack == -2
    assert extra_freedoms(Model.NON_ORIENTED_PLANE, 3, 3) == 2
    assert extra_freedoms(Model.NON_ORIENTED_SPACE, 3, 3) == 2
    assert inequality(3, 5, 6, 0, 3, 3).slack == 0
    assert extra_freedoms(Model.ORTHOGRAPHIC_SPACE, 3, 3) == 0


def test_vertical_known_does_not_count_as_the_plane_does() -> None:
    """Section 7, remark 2, has the dimensions of the plane; its three views and six points suffice, but fewer do."""
    assert Model.GRAVITY_SPACE.smallest() == ((3, 2),)
    assert Model.NON_ORIENTED_PLANE.smallest() == ((5, 3), (4, 4))
    assert Model.GRAVITY_SPACE.inequality(6, 3).slack == 11
    assert extra_freedoms(Model.GRAVITY_SPACE, 3, 2) == 0


@pytest.mark.parametrize("model", Model)
def test_fewest_points_and_views_of_every_camera(model: Model) -> None:
    assert list(model.smallest()) == FEWEST[model]
    assert model.smallest()[0] == PointsAndViews(*FEWEST[model][0])
    for n, m in model.smallest():
        assert model.inequality(n, m).holds
        assert (extra_freedoms(model, n, m) > 0) == (model in TWO_VIEWS_FAIL and m == 2)
        assert not model.inequality(n - 1, m).is_settled
        assert not model.inequality(n, m - 1).is_settled
    assert model.description in models_text()


@pytest.mark.parametrize("model", Model)
def test_scenes_in_general_position_fail_where_counting_says_so(model: Model) -> None:
    """And elsewhere hold, but for two orthographic views: exact, one random scene for each number."""
    for n, m in product(range(1, 8), repeat=2):
        row, extra = model.inequality(n, m), extra_freedoms(model, n, m)
        assert extra >= -row.slack
        if not row.holds:
            assert extra > 0
        elif row.is_settled:
            assert (extra > 0) == (model in TWO_VIEWS_FAIL and m == 2)


@pytest.mark.parametrize(("k", "basis"), [(1, None), (2, "taylor"), (1, "fourier"), (0, 4)])
@pytest.mark.parametrize("model", OWN)
def test_moving_points_have_the_gauge_that_is_stated(model: Model, k: int, basis: Any) -> None:
    for n, m in model.smallest(k, basis):
        if n * m < 100:
            assert extra_freedoms(model, n, m, k, basis) == 0
            assert extra_freedoms(model, n, m - 1, k, basis) > 0


def test_the_printed_gauge_of_moving_points_forbids_what_is_determined() -> None:
    """Section 6 keeps g; three points with a velocity in seven views of the plane are determined all the same."""
    printed = inequality(2, 2, 3, 0, 3, 7, 1)
    assert printed.slack == -2
    assert not printed.holds
    assert Model.ORIENTED_PLANE.inequality(3, 7, 1).slack == 0
    assert extra_freedoms(Model.ORIENTED_PLANE, 3, 7, 1) == 0


def test_a_scene_at_rest_solved_as_moving_may_change_scale_with_time() -> None:
    for k in (1, 2):
        for n_still, left in ((12, k), (11, 0)):
            assert extra_freedoms(Model.ORIENTED_SPACE, 12, 12, k, n_still=n_still) == left


def test_projective_views_of_moving_points_have_an_affine_gauge() -> None:
    assert Model.PROJECTIVE_SPACE.gauge(0, 1) == 15
    assert Model.PROJECTIVE_SPACE.gauge(1) == 12 + 3
    assert extra_freedoms(Model.PROJECTIVE_SPACE, 10, 5, 1) == 0


def test_vectors_of_a_path() -> None:
    assert [path_vectors(k) for k in range(3)] == [1, 2, 3]
    assert [path_vectors(k, "fourier") for k in range(3)] == [1, 3, 5]
    assert path_vectors(0, 7) == path_vectors(basis=7) == 7
    assert inequality(3, 3, 4, 0, 5, 6, 2).unknowns == 3 * 5 * 3 + 3 * 6 - 4
    assert inequality(3, 3, 4, 0, 5, 6, 2, "fourier").unknowns == 3 * 5 * 5 + 3 * 6 - 4
    assert inequality(3, 3, 4, 0, 5, 6, basis=4).unknowns == 3 * 5 * 4 + 3 * 6 - 4
    assert moving_gauge(3, 4, 1) == 7


def test_visible_fraction() -> None:
    """Section 5: the printed formula is of the plane, the quoted numbers of space, and points need two views each."""
    plane, space = Model.ORIENTED_PLANE.counts, Model.ORIENTED_SPACE.counts
    for n, m in ((10, 10), (1000, 100), (7, 23)):
        assert pp.required_visible_fraction(*plane, n, m) == (2 * (n + m) - 3) / (n * m)
        assert pp.required_visible_fraction(*space, n, m) == (3 * (n + m) - 4) / (2 * n * m)
    assert pp.required_visible_fraction(*space, 10, 10) == 0.28
    assert pp.required_visible_fraction(*space, 1000, 100) < 0.02 < pp.required_visible_fraction(*plane, 1000, 100)
    assert pp.required_visible_fraction(*plane, 10, 2) > 1.0
    needed = pp.required_visibility(*space, 1000, 100)
    assert (needed.in_total, needed.per_point, needed.per_view, needed.n_observations) == (1648, 2, 2, 2000)
    assert needed.fraction == 0.02
    assert needed.is_possible
    assert not pp.required_visibility(*plane, 10, 2).is_possible


def test_partial_visibility_counts_what_is_seen() -> None:
    assert inequality(2, 2, 3, 0, 10, 10, n_observations=37).slack == 0
    assert not inequality(2, 2, 3, 0, 10, 10, n_observations=36).holds
    assert inequality(2, 2, 3, 0, 10, 10, n_observations=0).equations == 0


@pytest.mark.parametrize("model", [*OWN, Model.AFFINE_SPACE])
def test_scenes_that_are_determined_have_the_visibility_required(model: Model) -> None:
    """Random masks about the bound: none with less is determined, and some with little more is."""
    rng = np.random.default_rng(5)
    closest = 1000
    for n, m in ((6, 6), (9, 5), (8, 4)):
        needed = model.required_visibility(n, m)
        for _ in range(60):
            count = int(rng.integers(max(needed.n_observations - 3, 1), min(needed.n_observations + 8, n * m) + 1))
            seen = (rng.permutation(n * m) < count).reshape(m, n)
            if extra_freedoms(model, n, m, seen=seen) == 0:
                assert count >= needed.n_observations
                assert seen.sum(axis=0).min() >= needed.per_point
                assert seen.sum(axis=1).min() >= needed.per_view
                closest = min(closest, count - needed.n_observations)
    assert closest <= 2


def test_one_view_and_few_points_ask_for_nothing_of_each() -> None:
    """The gauge takes all there is: a bound for single members would be wrong."""
    for model in Model:
        needed = model.required_visibility(1, 1)
        if model.inequality(1, 1).holds:
            assert needed.n_observations <= 1
    assert Model.AFFINE_SPACE.required_visibility(4, 1).n_observations <= 4


@given(cameras, few, few, paths)
def test_once_settled_more_points_or_views_never_break_it(camera: Camera, n: int, m: int, path: Any) -> None:
    row = inequality(*camera, n, m, *path)
    wider, longer = inequality(*camera, n + 1, m, *path), inequality(*camera, n, m + 1, *path)
    if row.is_settled:
        assert row.holds
        assert wider.is_settled
        assert longer.is_settled
        assert min(wider.slack, longer.slack) >= row.slack
    elif row.holds:
        # along points or along views it fails in the end
        far = 10_000
        assert not (inequality(*camera, far, m, *path).holds and inequality(*camera, n, far, *path).holds)


@given(cameras, few, few, paths)
def test_monotone_in_what_is_unknown(camera: Camera, n: int, m: int, path: Any) -> None:
    d, f, g, h = camera
    slack = inequality(*camera, n, m, *path).slack
    assert inequality(d, f + 1, g, h, n, m, *path).slack == slack - m
    assert inequality(d, f, g + 1, h, n, m, *path).slack == slack + 1
    assert inequality(d, f, g, h + 1, n, m, *path).slack == slack - 1
    a, b = d - 1, d * path_vectors(*path)
    assert (a * m - b) * (a * n - f) - (b * f - a * (g - h)) == a * slack


@given(cameras, paths)
def test_smallest_is_what_trying_all_finds(camera: Camera, path: Any) -> None:
    pairs = smallest(*camera, *path)
    assert [m for _, m in pairs] == sorted({m for _, m in pairs})
    assert [n for n, _ in pairs] == sorted({n for n, _ in pairs}, reverse=True)
    for n, m in pairs:
        assert inequality(*camera, n, m, *path).is_settled
        assert n == 1 or not inequality(*camera, n - 1, m, *path).is_settled
        assert m == 1 or not inequality(*camera, n, m - 1, *path).is_settled
    for n, m in product(range(1, 25), repeat=2):
        reached = any(n >= p and m >= q for p, q in pairs)
        assert reached == inequality(*camera, n, m, *path).is_settled


@given(cameras, few, few, paths)
def test_required_visibility_agrees_with_the_inequality(camera: Camera, n: int, m: int, path: Any) -> None:
    needed = pp.required_visibility(*camera, n, m, *path)
    fraction = pp.required_visible_fraction(*camera, n, m, *path)
    assert needed.fraction >= fraction - 1e-12
    if needed.in_total <= n * m:
        assert inequality(*camera, n, m, *path, n_observations=needed.in_total).holds
        if needed.in_total > 0:
            assert not inequality(*camera, n, m, *path, n_observations=needed.in_total - 1).holds
    else:
        assert fraction > 1.0
        assert not inequality(*camera, n, m, *path).holds


def test_huge_numbers_stay_exact() -> None:
    n = 10**40
    assert inequality(3, 3, 4, 0, n, n).slack == 2 * n * n - 6 * n + 4
    assert inequality(2, 2, 3, 0, n, 2).slack == -1
    assert pp.required_visible_fraction(2, 2, 3, 0, n, n) == pytest.approx(4e-40)
    assert pp.required_visible_fraction(2, 10**400, 0, 0, 1, 1) == float("inf")
    assert pp.required_visibility(2, 10**400, 0, 0, 1, 1).fraction == float("inf")
    assert inequality(3, 3, 4, 0, 2, 2, 10**40).vectors == 10**40 + 1
    assert smallest(3, 0, 4, 0, 10**40)[0].m > 10**39
    assert len(smallest(3, 10_000, 4, 0, 10_000)) > 100
    with pytest.raises(pp.InputError, match="more than 100,000 smallest pairs"):
        smallest(3, 10**12, 4)


def test_numpy_numbers_are_numbers() -> None:
    row = inequality(*np.array([2, 2, 3, 0, 3, 3], dtype=np.int32))
    assert row == inequality(2, 2, 3, 0, 3, 3)
    assert type(row.slack) is int


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"d": 1}, "d is 1, expected at least 2"),
        ({"f": -1}, "f is -1, expected at least 0"),
        ({"g": -3}, "g is -3, expected at least 0"),
        ({"h": -1}, "h is -1, expected at least 0"),
        ({"n": 0}, "n is 0, expected at least 1"),
        ({"m": -2}, "m is -2, expected at least 1"),
        ({"n": 3.0}, "n is 3.0, expected a whole number"),
        ({"m": float("nan")}, "m is nan, expected a whole number"),
        ({"n": "3"}, "n is '3', expected a whole number"),
        ({"g": None}, "g is None, expected a whole number"),
        ({"m": True}, "m is True, expected a whole number"),
        ({"k": -1}, "k is -1, expected at least 0"),
        ({"k": 1.5}, "k is 1.5, expected a whole number"),
        ({"basis": "wavelet"}, "basis is 'wavelet', expected 'taylor', 'fourier' or a number of functions"),
        ({"basis": 0}, "basis is 0, expected at least 1"),
        ({"basis": 2.5}, "basis is 2.5, expected a whole number"),
        ({"basis": 3, "k": 1}, "k is 1, expected 0 where basis is a number of functions"),
        ({"n_observations": 10}, "n_observations is 10, expected at most n m = 9"),
        ({"n_observations": -1}, "n_observations is -1, expected at least 0"),
    ],
)
def test_bad_input_is_named(change: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {"d": 2, "f": 2, "g": 3, "h": 0, "n": 3, "m": 3}
    with pytest.raises(pp.InputError) as error:
        inequality(**(good | change))
    assert str(error.value) == message
    if "n_observations" not in change:
        with pytest.raises(pp.InputError) as error:
            pp.required_visible_fraction(**(good | change))
        assert str(error.value) == message


def test_records_are_frozen_and_speak() -> None:
    row = inequality(2, 2, 3, 0, 3, 3)
    with pytest.raises(dataclasses.FrozenInstanceError):
        row.n = 4  # type: ignore[misc]
    assert str(row) == "3 points, 3 views: 9 equations, 9 unknowns; as many"
    assert str(inequality(2, 2, 3, 0, 1, 1)) == "1 point, 1 view: 1 equation, 1 unknown; as many"
    assert str(inequality(2, 2, 3, 0, 3, 2)).endswith("too few equations")
    assert str(inequality(2, 2, 3, 0, 4, 4)).endswith("3 to spare")
    assert inequality(*Model.ORIENTED_PLANE.counts, 3, 3) == row
    assert Model("gravity_space") is Model.GRAVITY_SPACE


def test_tables() -> None:
    rows = inequality_table(2, 2, 3, 0, [(2, 3), (3, 3)])
    assert [row.slack for row in rows] == [-1, 0]
    assert table_text(rows).splitlines() == [
        "| views m | points n | equations | unknowns | slack | enough? |",
        "|---|---|---|---|---|---|",
        "| 3 | 2 | 6 | 7 | -1 | no |",
        "| 3 | 3 | 9 | 9 | 0 | yes |",
    ]
    assert "| space, vertical known | 3 | 4 | 8 | 0 | (4, 4), (3, 5) |" in models_text(OWN, 1).splitlines()
    assert table_text([]).count("\n") == 1


def test_every_table_of_the_page_is_what_is_computed(capsys: pytest.CaptureFixture[str]) -> None:
    page = PAGE.read_text(encoding="utf-8").splitlines()
    figures.print_models()
    figures.print_paths()
    figures.print_visibility()
    figures.print_agreement()
    computed = capsys.readouterr().out.splitlines()
    computed += table_text(inequality_table(*Model.ORIENTED_PLANE.counts, figures.PLANE_PAIRS)).splitlines()
    assert len(computed) > 40
    assert [line for line in computed if line not in page] == []


def test_code_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib", reason="the extra 'plot' is absent")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    namespace: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, PAGE.name, "exec"), namespace)
    assert len(blocks) == 2
    assert (tmp_path / "gravity.png").exists()


def test_pictures(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra 'plot' is absent")
    assert draw_forbidden_regions(tmp_path / "all.png", largest=4).stat().st_size > 10_000
    two = [Region.of(Model.ORIENTED_SPACE), Region.of(Model.GRAVITY_SPACE, 1)]
    first, again = (draw_forbidden_regions(tmp_path / name, two) for name in ("first.png", "again.png"))
    assert first.read_bytes() == again.read_bytes()
    one = draw_forbidden_regions(tmp_path / "one.svg", [Region.of(Model.ORIENTED_PLANE, 2, "fourier")])
    text = one.read_text(encoding="utf-8")
    assert "necessary, never sufficient" in text
    with pytest.raises(pp.InputError, match="regions is empty"):
        draw_forbidden_regions(tmp_path / "none.png", [])
    for largest in (1, 61, 4.5, float("nan"), None):
        with pytest.raises(pp.InputError, match=f"largest is {largest}, expected a whole number from 2 to 60"):
            draw_forbidden_regions(tmp_path / "none.png", largest=largest)  # type: ignore[arg-type]
    assert not (tmp_path / "none.png").exists()
