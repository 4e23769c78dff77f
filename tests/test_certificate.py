"""The certificate against what happens: counter-examples, restarted tracks, Monte Carlo, covariances, any input."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from panopath import _core
from panopath.certificate import CauseKind, Certificate, Mode, OrientationModel, Verdict
from panopath.formats.structure import known_scene
from panopath.steps.common import observations_of

Float = npt.NDArray[np.float64]
DEG = np.pi / 180.0


def everyone_sees(centers: Float, points: Float) -> tuple[pp.Tracks, pp.Scene]:
    """Exact bearings of all points from all views, in the world, and the truth."""
    view, track = (ids.ravel() for ids in np.meshgrid(range(len(centers)), range(len(points)), indexing="ij"))
    ray = points[track] - centers[view]
    tracks = pp.Tracks.from_arrays(view, track, ray / np.linalg.norm(ray, axis=1, keepdims=True))
    return tracks, known_scene(tracks, None, centers, points)


# --- what the paper misses


def on_ellipse(size: int) -> tuple[Float, Float]:
    """As many views as points, at angles that have nothing in common."""
    angle = np.sort(np.random.default_rng(size).uniform(0.0, 2.0 * np.pi, 2 * size))
    members = np.column_stack((3.0 * np.cos(angle), 2.0 * np.sin(angle)))
    return members[::2], members[1::2]


@pytest.mark.parametrize("size", [3, 4, 10])
def test_an_ellipse_is_ambiguous_however_many_see_however_many(size: int) -> None:
    found = pp.certify(*everyone_sees(*on_ellipse(size)))
    assert (found.verdict, found.nullity, found.gauge_freedoms) == (Verdict.UNDETERMINED, 4, 3)
    assert found.components == ()
    (cause,) = found.causes
    assert (cause.kind, cause.detail, cause.is_exact) == (CauseKind.CONIC, "ellipse", True)
    assert (len(cause.views), len(cause.tracks)) == (size, size)
    assert found.gap.last_null < 1e-10
    assert not found.is_determined


@pytest.mark.parametrize("parallax_rad", [1e-1, 3e-3, 1e-3])
def test_points_of_little_parallax_do_not_hide_a_freedom(parallax_rad: float) -> None:
    """Two views of the plane are ambiguous; points far along their line were held by the floor under their pivots."""
    centers = np.array([(0.0, 0.0), (1.0, 0.0)])
    points = np.array([(5.0, 20.0 * parallax_rad), (6.0, -31.0 * parallax_rad), (-3.0, 13.0 * parallax_rad)])
    found = pp.certify(*everyone_sees(centers, points))
    assert (found.verdict, found.nullity) == (Verdict.UNDETERMINED, 4)
    assert found.gap.last_null < 1e-10


@pytest.mark.parametrize("size", [3, 4, 10])
def test_one_view_off_the_ellipse_is_enough(size: int) -> None:
    centers, points = on_ellipse(size)
    centers[0] = (0.4, 0.3)
    found = pp.certify(*everyone_sees(centers, points), pp.CertifyOptions(sigma_rad=1e-5))
    assert (found.verdict, found.nullity) == (Verdict.DETERMINED, 3)


@pytest.mark.parametrize("size", [3, 4, 10])
def test_a_cylinder_over_the_ellipse_is_ambiguous_seen_from_above_only(size: int) -> None:
    centers, points = on_ellipse(size)
    heights = np.random.default_rng(1).normal(size=(2, size))
    above = pp.certify(*everyone_sees(centers, points))
    lifted = [np.column_stack(pair) for pair in zip((centers, points), heights, strict=True)]
    found = pp.certify(*everyone_sees(*lifted), pp.CertifyOptions(sigma_rad=1e-5))
    assert (above.verdict, above.nullity, above.gauge_freedoms) == (Verdict.UNDETERMINED, 4, 3)
    assert (found.verdict, found.nullity, found.gauge_freedoms) == (Verdict.DETERMINED, 4, 4)


# --- tracks that all end and restart at the same views


def restarted(n_parts: int, shared: int, noise_rad: float) -> tuple[pp.Tracks, Float, Float, Float]:
    """Windows of eight views that share ``shared`` views with the next and no track; turned cameras."""
    rng = np.random.default_rng(17)
    step = 8 - shared
    n_views = step * (n_parts - 1) + 8
    centers: Float = np.column_stack((np.arange(float(n_views)), rng.normal(scale=0.4, size=(n_views, 2))))
    view: list[int] = []
    track: list[int] = []
    points: list[Float] = []
    for first in range(0, step * n_parts, step):
        around = centers[first : first + 8].mean(axis=0) + rng.uniform(-6.0, 6.0, (60, 3))
        for point in around:
            for i in np.sort(rng.choice(8, 5, replace=False)):
                view.append(first + i)
                track.append(len(points))
            points.append(point)
    turn = np.linalg.qr(rng.normal(size=(n_views, 3, 3)))[0]
    cam_from_world: Float = turn * np.linalg.det(turn)[:, None, None]
    ray: Float = np.array(points)[track] - centers[view]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    ray += noise_rad * rng.normal(size=ray.shape)
    bearing = np.einsum("nij,nj->ni", cam_from_world[view], ray / np.linalg.norm(ray, axis=1, keepdims=True))
    bearing /= np.linalg.norm(bearing, axis=1, keepdims=True)
    return pp.Tracks.from_arrays(view, track, bearing), cam_from_world, centers, np.array(points)


@pytest.mark.parametrize("noise_deg", [0.0, 0.05])
@pytest.mark.parametrize(("shared", "kind"), [(1, CauseKind.WEAK_JOIN), (0, CauseKind.DISCONNECTED)])
@pytest.mark.parametrize("orientation", ["known", "free"])
def test_restarted_tracks_are_as_many_components(
    orientation: OrientationModel, shared: int, kind: CauseKind, noise_deg: float
) -> None:
    n_parts, sigma = 5, noise_deg * DEG
    tracks, cam_from_world, centers, points = restarted(n_parts, shared, sigma)
    if orientation == "known":
        scene = pp.solve_positions(tracks, cam_from_world)
    else:
        # the truth in one piece, as a solver that does not ask would have it
        scene = pp.refine(tracks, known_scene(tracks, cam_from_world, centers, points))
    rms = np.sqrt(np.mean(scene.residual_rad[scene.inlier] ** 2) / 2.0)
    assert 0.75 * sigma - 1e-9 < rms < sigma + 1e-9, "residuals tell nothing"
    assert scene.inlier.mean() > 0.98
    found = pp.certify(tracks, scene, pp.CertifyOptions(orientation=orientation))
    assert found.verdict == Verdict.UNDETERMINED
    assert len(found.components) == n_parts
    parts = [(part.views.tolist(), len(part.tracks)) for part in sorted(found.components, key=lambda p: p.views[0])]
    starts = range(0, (8 - shared) * n_parts, 8 - shared)
    assert parts == [(list(range(first, first + 8)), 60) for first in starts]
    assert all(part.verdict == Verdict.DETERMINED for part in found.components)
    assert {cause.kind for cause in found.causes} == {kind}
    assert sum(len(cause.components) for cause in found.causes) >= n_parts
    assert len(found.hinges) == (n_parts - 1 if shared else 0)
    if shared:
        assert found.nullity == found.gauge_freedoms + n_parts - 1


# --- predicted against actual movement


@dataclass(frozen=True)
class Known:
    """A world, its bearings without noise, and what its views do along the weakest modes at one standard deviation."""

    tracks: pp.Tracks
    cam_from_world: Float
    centers: Float
    points: Float
    modes: tuple[Mode, ...]


SIGMA = 2e-4
WORLDS: dict[str, dict[str, Any]] = {
    "street": {"world": "street", "n_views": 20, "n_points": 120, "depth_max_m": 20.0, "min_views": 4},
    "room with few points": {"world": "room", "n_views": 16, "n_points": 40, "near_m": 2.0, "min_views": 4},
    "two parts, five tracks between them": {
        "world": "weak", "n_views": 16, "n_points": 85, "n_clusters": 2, "n_links": 5,
    },
}  # fmt: skip


def world_with_modes(name: str, orientation: OrientationModel) -> Known:
    chosen = WORLDS[name]
    if orientation == "free" and "n_links" in chosen:
        # five tracks leave two turns free
        chosen = {**chosen, "n_links": 8}
    world = pp.simulate(seed=4, orientations="random", **chosen)
    scene = known_scene(world.tracks, world.cam_from_world, world.centers, world.points)
    # all modes, however firm
    options = pp.CertifyOptions(orientation=orientation, sigma_rad=SIGMA, weak_movement=1e-12)
    modes = pp.certify(world.tracks, scene, options).modes
    assert not any(mode.is_null for mode in modes)
    return Known(world.tracks, world.cam_from_world, world.centers, world.points, modes)


def with_noise(tracks: pp.Tracks, seed: int) -> pp.Tracks:
    rng = np.random.default_rng(seed)
    bearing = tracks.bearing + SIGMA * rng.normal(size=tracks.bearing.shape)
    bearing /= np.linalg.norm(bearing, axis=1, keepdims=True)
    return replace(tracks, bearing=bearing)


def turn_of(matrix: Float) -> Float:
    """(n, 3) rotation vectors of small turns."""
    return 0.5 * np.stack([matrix[:, 2, 1] - matrix[:, 1, 2], matrix[:, 0, 2] - matrix[:, 2, 0],
                           matrix[:, 1, 0] - matrix[:, 0, 1]], axis=1)  # fmt: skip


def unknowns(turns: Float | None, shifts: Float, size: float) -> Float:
    """Turns in radians, then shifts in units of the size."""
    parts = [shifts / size] if turns is None else [turns, shifts / size]
    return np.hstack(parts).ravel()


def gauge(known: Known, is_free: bool) -> Float:
    """Orthonormal movements of the whole scene, as the views see them."""
    arms = known.centers - known.centers.mean(axis=0)
    size = size_of(known)
    still = np.zeros_like(arms)
    columns = [(still, np.tile(axis, (len(arms), 1))) for axis in np.eye(3)]
    columns.append((still, arms))
    if is_free:
        columns += [(np.tile(-axis, (len(arms), 1)), np.cross(axis, arms)) for axis in np.eye(3)]
    found = np.array([unknowns(turns if is_free else None, shifts, size) for turns, shifts in columns])
    return np.asarray(np.linalg.qr(found.T)[0])


def size_of(known: Known) -> float:
    arms = known.centers - known.centers.mean(axis=0)
    return float(np.sqrt((arms**2).sum(axis=1).mean()))


def shares_of_modes(known: Known, scene: pp.Scene, is_free: bool) -> Float:
    """How far the error of a solved scene goes along each mode, in predicted standard deviations."""
    size = size_of(known)
    if is_free:
        fit = pp.evaluate(scene, (known.centers, known.points), "similarity").alignments[0]
        assert fit.world_from_scene is not None
        turn = fit.world_from_scene
    else:
        fit = pp.evaluate(scene, (known.centers, known.points), "translation_scale").alignments[0]
        turn = np.eye(3)
    shifts = fit.scale * scene.centers @ turn.T + fit.shift - known.centers
    turns = turn_of(known.cam_from_world.transpose(0, 2, 1) @ scene.cam_from_world @ turn.T) if is_free else None
    error, frame = unknowns(turns, shifts, size), gauge(known, is_free)
    error = error - frame @ (frame.T @ error)
    steps = [unknowns(m.view_turn_rad if is_free else None, m.view_displacement, size) for m in known.modes[:2]]
    return np.array([error @ step / (step @ step) for step in steps])


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("orientation", ["known", "free"])
def test_noise_moves_views_along_the_weakest_modes_as_far_as_said(name: str, orientation: OrientationModel) -> None:
    known, is_free = world_with_modes(name, orientation), orientation == "free"
    shares = []
    for seed in range(300):
        tracks = with_noise(known.tracks, seed)
        if is_free:
            start = known_scene(tracks, known.cam_from_world, known.centers, known.points)
            scene = pp.refine(tracks, start, pp.RefineOptions(reject_outliers=False, huber_sigmas=np.inf))
        else:
            scene = pp.solve_positions(tracks, known.cam_from_world, start=(known.centers, known.points))
        shares.append(shares_of_modes(known, scene, is_free))
    actual = np.sqrt(np.mean(np.square(shares), axis=0))
    np.testing.assert_allclose(actual, 1.0, atol=0.1)


# --- the same from the covariance: where all modes are written out their squares add up to it


def few_views(n_views: int) -> Known:
    world = pp.simulate("box", n_views=n_views, n_points=25, seed=3, orientations="random")
    return Known(world.tracks, world.cam_from_world, world.centers, world.points, ())


def test_all_modes_add_up_to_the_position_covariance() -> None:
    known = few_views(5)
    scene = known_scene(known.tracks, known.cam_from_world, known.centers, known.points)
    found = pp.certify(known.tracks, scene, pp.CertifyOptions(sigma_rad=SIGMA, weak_movement=1e-12))
    assert len(found.modes) == 3 * 5 - 4
    moved = np.array([mode.view_displacement for mode in found.modes])
    expected = SIGMA**2 * pp.position_covariance(known.tracks, scene, known.cam_from_world)
    np.testing.assert_allclose(np.einsum("kni,knj->nij", moved, moved), expected, rtol=1e-6, atol=1e-6 * expected.max())


def test_all_modes_add_up_to_the_scene_covariance() -> None:
    known = few_views(3)
    scene = known_scene(known.tracks, known.cam_from_world, known.centers, known.points)
    options = pp.CertifyOptions(orientation="free", sigma_rad=SIGMA, weak_movement=1e-12)
    found = pp.certify(known.tracks, scene, options)
    assert len(found.modes) == 6 * 3 - 7
    arms = known.centers - known.centers.mean(axis=0)
    axes = np.eye(3)
    shifts = [np.tile(axis, (3, 1)) for axis in axes] + [arms] + [np.cross(axis, arms) for axis in axes]
    turns = [np.zeros((3, 3))] * 4 + [np.tile(-axis, (3, 1)) for axis in axes]
    of_centers = np.array(shifts).reshape(7, -1).T
    total = np.zeros((3, 6, 6))
    for mode in found.modes:
        # the covariance is after a fit over the centres alone
        amount = np.linalg.lstsq(of_centers, mode.view_displacement.ravel(), rcond=None)[0]
        shift = mode.view_displacement - np.tensordot(amount, np.array(shifts), axes=1)
        turn = mode.view_turn_rad - np.tensordot(amount, np.array(turns), axes=1)
        step = np.hstack((np.einsum("nij,nj->ni", known.cam_from_world, turn), shift))
        total += np.einsum("ni,nj->nij", step, step)
    expected = pp.scene_covariance(known.tracks, scene, sigma_rad=SIGMA).cameras
    np.testing.assert_allclose(total, expected, rtol=1e-6, atol=1e-6 * expected.max())


# --- any input at all


@dataclass(frozen=True)
class Anything:
    """Some observations among some members, some of them unknown, in parts or not."""

    tracks: pp.Tracks
    scene: pp.Scene


@st.composite
def anything(draw: st.DrawFn) -> Anything:
    d = draw(st.sampled_from((2, 3)))
    m, n = draw(st.integers(1, 9)), draw(st.integers(1, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    # a coarse grid: members in one place, on lines, in planes
    size = draw(st.sampled_from((1e-6, 1.0, 1e6)))
    make = (
        (lambda k: rng.integers(0, 4, (k, d)).astype(float))
        if draw(st.booleans())
        else (lambda k: rng.normal(size=(k, d)))
    )
    centers, points = size * make(m), size * make(n)
    count = draw(st.integers(1, 60))
    view, track = rng.integers(0, m, count), rng.integers(0, n, count)
    ray = points[track] - centers[view]
    ray[rng.random(count) < draw(st.sampled_from((0.0, 0.3)))] = 1.0
    length = np.linalg.norm(ray, axis=1, keepdims=True)
    bearing = np.where(length > 0.0, ray / np.where(length > 0.0, length, 1.0), np.eye(d)[0])
    centers[rng.random(m) < draw(st.sampled_from((0.0, 0.2, 1.0)))] = np.nan
    points[rng.random(n) < draw(st.sampled_from((0.0, 0.2)))] = np.nan
    sigma = rng.uniform(1e-4, 1e-2, count) if draw(st.booleans()) else None
    tracks = pp.Tracks.from_arrays(view, track, bearing, m, n, sigma_rad=sigma)
    scene = known_scene(tracks, None, centers, points)
    scene = replace(scene, inlier=rng.random(count) < draw(st.sampled_from((0.5, 1.0))))
    if draw(st.booleans()):
        parts = rng.integers(-1, 3, m, dtype=np.int32), rng.integers(-1, 3, n, dtype=np.int32)
        scene = replace(scene, view_component=parts[0], track_component=parts[1])
    return Anything(tracks, scene)


def check(found: Certificate, given: Anything, orientation: OrientationModel) -> None:
    """What holds for every certificate."""
    tracks, scene = given.tracks, given.scene
    d = tracks.d
    turns = {"known": 0, "free": d * (d - 1) // 2, "vertical": 1}[orientation]
    assert found.gauge_freedoms == d + 1 + turns
    assert isinstance(found.verdict, Verdict)
    if found.verdict != Verdict.UNDETERMINED:
        assert found.nullity == found.gauge_freedoms
        assert len(found.components) == 1
    else:
        assert found.nullity > found.gauge_freedoms or len(found.components) != 1
    known_views, known_points = (np.asarray(np.isfinite(x).all(axis=1)) for x in (scene.centers, scene.points))
    for part in found.components:
        assert known_views[part.views].all()
        assert (np.diff(part.views) > 0).all()
        assert (np.diff(part.tracks) > 0).all()
        assert part.n_observations >= max(len(part.views), len(part.tracks))
    for mode in found.modes:
        assert np.isfinite(mode.view_displacement).all()
        assert np.isfinite(mode.track_displacement).all()
        assert np.isinf(mode.movement) == mode.is_null
    for cause in found.causes:
        assert all(0 <= k < len(found.components) for k in cause.components)
        assert ((cause.views >= 0) & (cause.views < tracks.n_views)).all()
        assert ((cause.tracks >= 0) & (cause.tracks < tracks.n_tracks)).all()
    for line in (found.view_line, found.track_line):
        length = np.linalg.norm(line, axis=1)
        assert np.isclose(length[np.isfinite(length)], 1.0).all()
    assert known_points[np.isfinite(found.track_line).all(axis=1)].all()
    assert found.sentence()
    assert found.explain()


@settings(max_examples=400, deadline=None)
@given(anything(), st.sampled_from(("known", "free", "vertical")))
def test_it_never_raises_and_never_contradicts_itself(given: Anything, orientation: OrientationModel) -> None:
    if given.tracks.d == 2 and orientation == "vertical":
        orientation = "free"
    options = pp.CertifyOptions(orientation=orientation)
    found = pp.certify(given.tracks, given.scene, options)
    check(found, given, orientation)
    again = pp.certify(given.tracks, given.scene, replace(options, threads=2))
    assert again.to_dict() == found.to_dict()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from((2, 3)), st.floats(0.3, 0.9))
def test_each_component_alone_is_one_component(seed: int, d: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    tracks, scene = everyone_sees(rng.normal(size=(8, d)), rng.normal(size=(12, d)))
    tracks = tracks.select(rng.random(len(tracks)) < share)
    scene = known_scene(tracks, None, scene.centers, scene.points)
    options = pp.CertifyOptions(sigma_rad=1e-9)
    for part in pp.certify(tracks, scene, options).components:
        inside = np.isin(tracks.view, part.views) & np.isin(tracks.track, part.tracks)
        own = tracks.select(inside)
        if len(own) != part.n_observations:
            continue
        found = pp.certify(own, known_scene(own, None, scene.centers, scene.points), options)
        assert (found.nullity, len(found.components)) == (d + 1, 1)
        assert found.components[0].views.tolist() == part.views.tolist()
        assert found.components[0].tracks.tolist() == part.tracks.tolist()


def test_the_same_bytes_on_any_number_of_threads() -> None:
    world = pp.simulate("street", n_views=80, n_points=1500, seed=2, noise_rad=1e-3, outlier_fraction=0.1)
    scene = pp.solve_positions(world.tracks)
    found = [pp.certify(world.tracks, scene, pp.CertifyOptions(threads=threads)) for threads in (1, 2, 3)]
    for other in found[1:]:
        assert other.to_dict() == found[0].to_dict()
        assert other.track_looseness.tobytes() == found[0].track_looseness.tobytes()
        for a, b in zip(other.modes, found[0].modes, strict=True):
            assert a.track_displacement.tobytes() == b.track_displacement.tobytes()


# --- what cannot be used


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"orientation": "unknown"}, "orientation is 'unknown', expected one of"),
        ({"sigma_rad": 0.0}, "sigma_rad is 0.0, expected a positive number"),
        ({"sigma_rad": np.nan}, "sigma_rad is nan, expected a positive number"),
        ({"weak_movement": -1.0}, "weak_movement is -1.0, expected a positive number"),
        ({"weak_movement": np.inf}, "weak_movement is inf, expected a positive number"),
    ],
)
def test_options_out_of_range_are_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        pp.CertifyOptions(**options)


def test_the_vertical_in_the_plane_and_unknown_options_are_refused() -> None:
    tracks, scene = everyone_sees(*on_ellipse(3))
    with pytest.raises(pp.InputError, match="'vertical', which tells nothing in the plane"):
        pp.certify(tracks, scene, pp.CertifyOptions(orientation="vertical"))
    start = (scene.centers, scene.points, scene.view_component, scene.track_component)
    fit = (scene.inlier, scene.residual_rad)
    with pytest.raises(ValueError, match='options has no entry "sigma"'):
        _core.certify(observations_of(tracks), scene.cam_from_world, start, fit, {"sigma": 1.0})


def test_a_scene_of_other_tracks_is_refused(street: pp.SyntheticWorld) -> None:
    _, scene = everyone_sees(*on_ellipse(3))
    with pytest.raises(pp.InputError, match="is not a scene of"):
        pp.certify(street.tracks, scene)
