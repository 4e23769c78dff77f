"""Rotation averaging through Python: shapes, signs of headings, priors, errors, what the record promises."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import panopath as pp
import pytest
from panopath.model import Float, Int

DEG = np.pi / 180.0


def rotations(n: int, rng: np.random.Generator) -> Float:
    q, r = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    q = q * np.sign(np.einsum("nii->ni", r))[:, None, :]
    turned: Float = q * np.linalg.det(q)[:, None, None]
    return turned


def exp(phi: Float) -> Float:
    """Rotation matrices of small rotation vectors, by the series."""
    x, y, z = phi.T
    o = np.zeros_like(x)
    cross = np.stack([np.stack(row, axis=1) for row in ([o, -z, y], [z, o, -x], [-y, x, o])], axis=1)
    term, total = np.broadcast_to(np.eye(3), cross.shape), np.broadcast_to(np.eye(3), cross.shape)
    for k in range(1, 25):
        term = term @ cross / k
        total = total + term
    return np.asarray(total)


def angle(a: Float, b: Float) -> Float:
    chord = np.linalg.norm(np.asarray(a) - np.asarray(b), axis=(-2, -1)) / np.sqrt(8.0)
    found: Float = 2.0 * np.arcsin(np.minimum(chord, 1.0))
    return found


def band(n: int, reach: int) -> tuple[Int, Int]:
    pairs = np.array([(i, j) for i in range(n) for j in range(i + 1, min(i + reach + 1, n))], dtype=np.int32)
    return pairs[:, 0], pairs[:, 1]


def measured(n: int, noise_deg: float, wrong: float, seed: int) -> tuple[Float, Int, Int, Float, Any]:
    rng = np.random.default_rng(seed)
    truth = rotations(n, rng)
    first, second = band(n, 6)
    noise = exp(noise_deg * DEG * rng.normal(size=(len(first), 3)))
    relative = noise @ truth[second] @ truth[first].transpose(0, 2, 1)
    bad = rng.random(len(first)) < wrong
    relative[bad] = rotations(int(bad.sum()), rng)
    return truth, first, second, relative, bad


def in_frame_of_first(truth: Float) -> Float:
    return np.asarray(truth @ truth[0].T)


def test_exact_edges_give_the_exact_answer() -> None:
    truth, first, second, relative, _ = measured(30, 0.0, 0.0, 1)
    found = pp.average_rotations(first, second, relative)
    assert found.status is pp.Status.CONVERGED
    assert found.inlier.all()
    assert (found.view_component == 0).all()
    np.testing.assert_allclose(found.cam_from_world, in_frame_of_first(truth), atol=1e-12)
    np.testing.assert_array_equal(found.cam_from_world[0], np.eye(3))
    assert found.covariance_rad2 is None
    for array in (found.cam_from_world, found.view_component, found.inlier, found.residual_rad):
        assert not array.flags.writeable


def test_noise_and_wrong_edges() -> None:
    truth, first, second, relative, bad = measured(80, 1.0, 0.25, 2)
    found = pp.average_rotations(first, second, relative)
    assert (found.inlier == bad).sum() <= 2
    assert angle(found.cam_from_world, in_frame_of_first(truth)).max() < 5.0 * DEG
    assert found.sigma_rad == pytest.approx(1.0 * DEG, rel=0.15)
    expected = angle(relative, found.cam_from_world[second] @ found.cam_from_world[first].transpose(0, 2, 1))
    np.testing.assert_allclose(found.residual_rad, expected, atol=1e-7)


def test_headings_add_up_as_documented() -> None:
    rng = np.random.default_rng(3)
    heading = rng.uniform(-np.pi, np.pi, size=20)
    first, second = band(20, 3)
    found = pp.average_rotations(first, second, heading[second] - heading[first])
    off = found.cam_from_world - (heading - heading[0])
    np.testing.assert_allclose(np.angle(np.exp(1j * off)), 0.0, atol=1e-12)
    # the same in space, of cameras that stand upright: world_from_cam turns by +h about z
    cos, sin, o = np.cos(heading), np.sin(heading), np.zeros(20)
    rows = ([cos, sin, o], [-sin, cos, o], [o, o, o + 1.0])
    upright = np.stack([np.stack(row, axis=1) for row in rows], axis=1)
    space = pp.average_rotations(first, second, upright[second] @ upright[first].transpose(0, 2, 1))
    turned = np.arctan2(space.cam_from_world[:, 0, 1], space.cam_from_world[:, 0, 0])
    np.testing.assert_allclose(np.angle(np.exp(1j * (turned - found.cam_from_world))), 0.0, atol=1e-9)
    compass = pp.Priors(headings=pp.HeadingPriors.of([4], [heading[4]], 0.01))
    for priors in (compass, pp.Priors(rotations=pp.RotationPriors.of([4], [heading[4]], 0.01))):
        absolute = pp.average_rotations(first, second, heading[second] - heading[first], priors=priors)
        np.testing.assert_allclose(np.angle(np.exp(1j * (absolute.cam_from_world - heading))), 0.0, atol=1e-9)


def test_priors_fix_the_world() -> None:
    truth, first, second, relative, _ = measured(40, 0.5, 0.1, 4)
    views = np.arange(0, 40, 4)
    up = truth[:, :, 2]
    forward = truth[:, 2, :]
    heading = np.arctan2(forward[:, 1], forward[:, 0])
    whole = pp.Priors(rotations=pp.RotationPriors.of(views, truth[views], 0.01))
    covariance = np.tile(np.diag([1e-4, 1e-4, 2e-4]), (len(views), 1, 1))
    blocks = pp.Priors(rotations=pp.RotationPriors.of(views, truth[views], covariance=covariance))
    headings = pp.HeadingPriors.of(views, heading[views], 0.1 * DEG)
    level = pp.Priors(directions=pp.DirectionPriors.gravity(views, up[views], 0.1 * DEG), headings=headings)
    exact = pp.Priors(directions=pp.DirectionPriors.gravity(np.arange(40), up, 1e-6), headings=headings)
    cases: list[Any] = [whole, blocks, level, exact]
    for priors in cases:
        found = pp.average_rotations(first, second, relative, sigma_rad=0.5 * DEG, priors=priors)
        assert angle(found.cam_from_world, truth).max() < 1.5 * DEG
    np.testing.assert_allclose(found.cam_from_world[:, :, 2], up, atol=1e-9)


def test_covariance_tells_the_spread() -> None:
    truth, first, second, relative, _ = measured(12, 0.0, 0.0, 5)
    options = pp.OrientationOptions(covariance=True)
    rng = np.random.default_rng(6)
    ratio = []
    for _ in range(60):
        noisy = exp(1.0 * DEG * rng.normal(size=(len(first), 3))) @ relative
        found = pp.average_rotations(first, second, noisy, sigma_rad=1.0 * DEG, options=options)
        assert found.covariance_rad2 is not None
        off = angle(found.cam_from_world, in_frame_of_first(truth))
        ratio.append((off**2)[1:] / np.trace(found.covariance_rad2, axis1=1, axis2=2)[1:])
        np.testing.assert_allclose(found.covariance_rad2[0], 0.0, atol=1e-9)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.2)


def test_parts_and_nothing() -> None:
    _, first, second, relative, _ = measured(10, 0.0, 0.0, 7)
    apart = (first < 4) == (second < 4)
    found = pp.average_rotations(first[apart], second[apart], relative[apart], n_views=11)
    assert found.status is pp.Status.DISCONNECTED
    assert found.view_component.tolist() == [1] * 4 + [0] * 6 + [-1]
    assert np.isnan(found.cam_from_world[10]).all()
    assert found.n_components == 2
    assert "10 of 11 views" in repr(found)
    for nothing in (np.empty((0, 3, 3)), np.empty(0)):
        empty = pp.average_rotations([], [], nothing, n_views=3)
        assert empty.status is pp.Status.UNDETERMINED
        assert np.isnan(empty.cam_from_world).all()
        assert empty.cam_from_world.shape == (3, *nothing.shape[1:])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"second": [1, 2]}, "second has 2 rows, expected 3"),
        ({"first": [0, 1]}, "first has 2 rows, expected 3"),
        ({"first": [0, 1, -2]}, r"first\[2\] is -2.0, expected a whole number from 0"),
        ({"first": [0, 1, 1.5]}, r"first\[2\] is 1.5"),
        ({"first": [[0, 1, 2]]}, "first has shape"),
        ({"second": [1, 2, 2]}, r"edges\[2\] joins the view 2 with itself"),
        ({"second": [1, 0, 0]}, r"edges\[1\] joins the views 0 and 1 again, as edges\[0\] does"),
        ({"second_from_first": np.full((3, 3, 3), np.nan)}, r"second_from_first\[0\] is not a rotation"),
        ({"second_from_first": np.ones((3, 2))}, r"second_from_first has shape \(3, 2\)"),
        ({"second_from_first": np.array([0.0, np.inf, 0.0])}, r"edges\[1\] has a rotation that is not finite"),
        ({"second_from_first": "abc"}, "second_from_first cannot be read"),
        ({"n_views": 2}, "n_views is 2, expected a whole number above the largest view, 2"),
        ({"sigma_rad": [1.0, 2.0]}, r"sigma_rad has shape \(2,\), expected \(3,\)"),
        ({"sigma_rad": -1.0}, r"edges\[0\] has sigma_rad -1"),
        ({"priors": [3]}, r"priors is a list, expected Priors"),
        ({"priors": pp.Priors(headings=pp.HeadingPriors.of([9], [0.0], 0.1)), "n_views": 3}, "largest view, 9"),
    ],
)
def test_errors_name_the_entry(changes: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {
        "first": [0, 1, 2],
        "second": [1, 2, 0],
        "second_from_first": np.tile(np.eye(3), (3, 1, 1)),
    }
    with pytest.raises(pp.InputError, match=message):
        pp.average_rotations(**{**good, **changes})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: pp.DirectionPriors.gravity([0], [[0.0, 0.0, 2.0]], 0.1), r"bearing\[0\] is not a unit vector"),
        (lambda: pp.DirectionPriors.gravity([0], [[0.0]], 0.1), "bearing has shape"),
        (lambda: pp.DirectionPriors.gravity([0], [[0.0, 0.0, 1.0]], 0.0), r"sigma_rad\[0\] is 0.0"),
        (lambda: pp.HeadingPriors.of([0, 1], [0.0, np.nan], 0.1), r"heading_rad\[1\] is not finite"),
        (lambda: pp.HeadingPriors.of([0, 1], [0.0], 0.1), "heading_rad has shape"),
        (lambda: pp.RotationPriors.of([0], np.eye(3)[None], 0.0), r"sigma_rad\[0\] is 0.0"),
        (lambda: pp.RotationPriors.of([0], 2.0 * np.eye(3)[None], 0.1), r"cam_from_world\[0\] is"),
        (lambda: pp.RotationPriors.of([0], np.eye(3)[None]), "expected either sigma_rad or covariance"),
        (lambda: pp.RotationPriors.of([-1], np.eye(3)[None], 0.1), "view holds -1"),
        (lambda: pp.PositionPriors.of([0], [[0.0, np.inf, 0.0]], 0.1), r"center\[0\] is not finite"),
        (lambda: pp.PositionPriors.of([0], [[0.0, 0.0]], covariance=np.eye(3)[None]), "covariance has shape"),
        (lambda: pp.Priors(headings=cast(Any, 3)), "headings is a int, expected HeadingPriors"),
    ],
)
def test_priors_are_checked(make: Any, message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        make()


def test_a_heading_counts_in_refinement_as_in_averaging() -> None:
    """Under known gravity a compass turns the refined scene about the vertical to where it says."""
    world = pp.simulate("street", n_views=20, n_points=300, noise_rad=1e-4, seed=3)
    start = pp.solve_positions(world.tracks, world.cam_from_world)
    views = np.arange(20)
    gravity = pp.DirectionPriors.gravity(views, world.cam_from_world[:, :, 2], 1e-3)
    ahead = np.einsum("nji,j->ni", world.cam_from_world, [1.0, 0.0, 0.0])
    said = np.arctan2(ahead[:, 1], ahead[:, 0]) + 0.3
    compass = pp.HeadingPriors.of(views, said, 1e-3, forward=(1.0, 0.0, 0.0))
    scene = pp.refine(world.tracks, start, pp.RefineOptions(priors=pp.Priors(directions=gravity, headings=compass)))
    found = np.einsum("nji,j->ni", scene.cam_from_world, [1.0, 0.0, 0.0])
    error = np.angle(np.exp(1j * (np.arctan2(found[:, 1], found[:, 0]) - said)))
    assert np.abs(error).max() < 1e-3
    np.testing.assert_allclose(scene.cam_from_world[:, :, 2], world.cam_from_world[:, :, 2], atol=2e-3)


@pytest.mark.parametrize("wrong", [{"max_iterations": 0}, {"threads": -1}, {"linear_solver": "x"}, {"covariance": 1}])
def test_options_are_checked(wrong: dict[str, Any]) -> None:
    with pytest.raises(pp.InputError, match=next(iter(wrong))):
        pp.OrientationOptions(**wrong)


def test_threads_and_solvers_agree() -> None:
    _, first, second, relative, _ = measured(200, 1.0, 0.2, 8)
    one, two = (pp.average_rotations(first, second, relative, options=pp.OrientationOptions(threads=n)) for n in (1, 2))
    np.testing.assert_array_equal(one.cam_from_world, two.cam_from_world)
    iterative = pp.average_rotations(first, second, relative, options=pp.OrientationOptions(linear_solver="iterative"))
    np.testing.assert_allclose(iterative.cam_from_world, one.cam_from_world, atol=1e-8)
