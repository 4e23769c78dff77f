"""The conditions of full visibility, from the geometry alone, against exact arithmetic and the numeric certificate."""

from __future__ import annotations

import warnings
from dataclasses import FrozenInstanceError, replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
import pytest
from panopath.certificate import CauseKind
from rigidity_suite import Configuration, configurations, exact_case, rigidity_matrix

#: Generic: three views and three points of the plane, two and two of space.
PLANE = (np.array([(0.0, 0.0), (4.0, 0.0), (1.0, 5.0)]), np.array([(7.0, 3.0), (2.0, -6.0), (-3.0, 1.0)]))
SPACE = (np.array([(0.0, 0.0, 0.0), (4.0, 0.0, 1.0)]), np.array([(7.0, 3.0, -2.0), (2.0, -6.0, 3.0)]))


@cache
def fully_visible() -> tuple[Configuration, ...]:
    """Configurations of the suite with known orientations whose views all see all points."""
    return tuple(
        c for c in configurations() if c.orientation == "known" and len(c.view) == len(c.centers) * len(c.points)
    )


def dense_nullity(c: Configuration) -> tuple[int, float]:
    """Nullity from singular values, and how clear it is: the ratio of the values on either side of it."""
    matrix = rigidity_matrix(c)
    values = np.linalg.svd(matrix, compute_uv=False)
    rank = int((values > 1e-9 * values[0]).sum())
    last = values[rank] if rank < len(values) else 0.0
    return matrix.shape[1] - rank, float(values[rank - 1] / max(last, 1e-16 * values[0]))


def test_the_suite_has_hundreds_of_them() -> None:
    found = fully_visible()
    ambiguous = sum(c.ambiguous for c in found)
    assert len(found) > 300
    assert 100 < ambiguous < len(found) - 50


def test_nullity_is_the_exact_one_and_that_of_the_certificate() -> None:
    wrong = []
    for c in fully_visible():
        found = pp.full_visibility(c.centers, c.points)
        certificate = pp.certify(*exact_case(c), pp.CertifyOptions(sigma_rad=1e-9))
        if not found.nullity == c.nullity == certificate.nullity:
            wrong.append(f"{c.name}: {found.nullity}, numerically {certificate.nullity}, exactly {c.nullity}")
        assert found.gauge_freedoms == c.gauge_freedoms
        assert found.is_determined == (not c.ambiguous) == (not found.causes), c.name
    assert not wrong, "\n".join(wrong)


def test_causes_are_those_of_the_construction() -> None:
    wrong = []
    for c in fully_visible():
        kinds = {cause.kind for cause in pp.full_visibility(c.centers, c.points).causes}
        if c.causes and not kinds & c.causes:
            wrong.append(f"{c.name}: {sorted(kinds)}, expected one of {sorted(c.causes)}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("off", [1e-6, 1e-5])
def test_near_misses_are_generic_and_within_a_tolerance_they_are_not(off: float) -> None:
    """All positions a little off: the dense null space of these, and within a wider tolerance the exact case."""
    rng = np.random.default_rng(4)
    wrong, compared = [], 0
    for c in fully_visible():
        everything = np.concatenate((c.centers, c.points))
        size = np.linalg.norm(everything - everything.mean(axis=0), axis=1).max()
        centers, points = (x + off * size * rng.normal(size=x.shape) for x in (c.centers, c.points))
        near = replace(c, centers=centers, points=points)
        numeric, clear = dense_nullity(near)
        found = pp.full_visibility(centers, points)
        if clear > 1e3:
            compared += 1
            if found.nullity != numeric:
                wrong.append(f"{c.name}: {found.nullity}, numerically {numeric}")
        if c.ambiguous and pp.full_visibility(centers, points, 30 * off).nullity != c.nullity:
            wrong.append(f"{c.name}: {found.nullity} within {30 * off:g}, exactly {c.nullity}")
    assert compared > 300
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    ("off", "kinds"), [(0.0, [CauseKind.CONIC]), (1e-11, [CauseKind.CONIC]), (1e-7, []), (1e-3, [])]
)
def test_one_member_moves_off_an_ellipse(off: float, kinds: list[CauseKind]) -> None:
    angle = np.radians([12, 50, 98, 140, 170, 215, 285, 325])
    on_it = np.column_stack((2.0 * np.cos(angle), np.sin(angle)))
    on_it[0] *= 1.0 + off
    found = pp.full_visibility(on_it[::2], on_it[1::2])
    assert (found.nullity, [cause.kind for cause in found.causes]) == (3 + len(kinds), kinds)


def test_an_ellipse_is_drawn_as_it_is() -> None:
    angle = np.radians([12, 50, 98, 140, 170, 215, 285, 325])
    on_it = np.column_stack((2.0 * np.cos(angle) + 7.0, np.sin(angle) - 3.0))
    (cause,) = pp.full_visibility(on_it[::2], on_it[1::2]).causes
    assert (cause.kind, cause.detail, cause.is_exact) == (CauseKind.CONIC, "ellipse", True)
    assert (cause.views.tolist(), cause.tracks.tolist()) == ([0, 1, 2, 3], [0, 1, 2, 3])
    x, y = on_it.T
    values = np.column_stack((x * x, x * y, y * y, x, y, np.ones(8))) @ cause.shape
    np.testing.assert_allclose(values, 0.0, atol=1e-12)
    assert not cause.shape.flags.writeable


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("shift", [0.0, 1e4])
def test_neither_unit_nor_place_matters(scale: float, shift: float) -> None:
    for views, points in (PLANE, SPACE):
        for moved in (views, np.vstack((views, points[:1] + 0.5 * (points[1] - points[0])))):
            assert pp.full_visibility(scale * (moved + shift), scale * (points + shift)).is_determined == (
                pp.full_visibility(moved, points).is_determined
            )


def test_small_numbers_of_members() -> None:
    one, two = PLANE[0][:1], PLANE[1][:2]
    assert pp.full_visibility(one, two[:1]).nullity == 3
    assert pp.full_visibility(one, two).nullity == 4
    assert [cause.kind for cause in pp.full_visibility(one, two).causes] == [CauseKind.ONE_CAMERA]
    found = pp.full_visibility(*PLANE)
    assert (found.nullity, found.gauge_freedoms, found.is_determined, found.causes) == (3, 3, True, ())
    found = pp.full_visibility(*SPACE)
    assert (found.nullity, found.gauge_freedoms, found.is_determined, found.causes) == (4, 4, True, ())
    with pytest.raises(FrozenInstanceError):
        found.nullity = 3  # type: ignore[misc]


def test_whole_numbers_lists_and_slices_are_read() -> None:
    views, points = PLANE
    expected = pp.full_visibility(views, points).nullity
    assert pp.full_visibility(views.astype(int).tolist(), points.astype(np.float32)).nullity == expected
    assert pp.full_visibility(np.asfortranarray(views), np.repeat(points, 2, axis=0)[::2]).nullity == expected


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"centers": np.zeros((3, 4))}, r"centers has shape \(3, 4\), expected \(n, 2\) or \(n, 3\)"),
        ({"centers": np.zeros(3)}, r"centers has shape \(3,\), expected"),
        ({"centers": np.zeros((0, 2))}, r"centers has shape \(0, 2\), expected .* with at least one row"),
        ({"points": []}, r"points has shape \(0,\), expected"),
        ({"points": SPACE[1]}, "points has positions of 3 coordinates, but centers of 2"),
        ({"centers": "views"}, "centers is not an array of numbers"),
        ({"points": [(1.0, 2.0), (3.0,)]}, "points is not an array of numbers"),
        ({"points": [(1.0, 2.0), (3.0, np.nan)]}, r"points\[1\] is \[3.0, nan\], expected finite coordinates"),
        ({"centers": [(np.inf, 2.0)]}, r"centers\[0\] is \[inf, 2.0\], expected finite coordinates"),
        ({"points": np.vstack((PLANE[1], PLANE[0][2:]))}, r"centers\[2\] and points\[3\] are at one place"),
        ({"tolerance": -1e-9}, "tolerance is -1e-09, expected at least 0 and less than 1"),
        ({"tolerance": 1.0}, "tolerance is 1.0, expected"),
        ({"tolerance": np.nan}, "tolerance is nan, expected"),
    ],
)
def test_what_cannot_be_used_is_named(changes: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {"centers": PLANE[0], "points": PLANE[1], **changes}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(pp.InputError, match=message):
            pp.full_visibility(**arguments)


@pytest.mark.parametrize("seed", range(3))
def test_many_members_are_no_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centers, points = rng.normal(size=(300, 3)), rng.normal(size=(5000, 3))
    line: npt.NDArray[np.float64] = np.outer(np.linspace(-1.0, 1.0, 300), centers[0])
    assert pp.full_visibility(centers, points).is_determined
    found = pp.full_visibility(line, np.vstack((points, 3.0 * centers[:1])))
    assert (found.nullity, [cause.kind for cause in found.causes]) == (5, [CauseKind.CAMERA_COLLINEAR])
    assert found.causes[0].tracks.tolist() == [5000]
