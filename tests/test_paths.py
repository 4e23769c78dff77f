"""Cameras and the paths of bodies that move: exact data, a noisy street, what is refused, what cannot be used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import panopath as pp
import pytest
from moving_worlds import FORMS, MovingWorld, moving_world
from panopath.paths import PathModel, PathVerdict, Spline, Static, Taylor, path_functions
from test_determinism import content

Float = npt.NDArray[np.float64]

SIGMA_RAD = float(np.radians(0.05))
MOVES = (PathVerdict.MOVING, PathVerdict.IMITATED, PathVerdict.HIDDEN)


def paths_of(scene: pp.Scene) -> pp.Paths:
    assert scene.paths is not None
    return scene.paths


def fitted(scene: pp.Scene, centers: Float) -> tuple[float, Float]:
    """Scale and shift that bring a scene to known centres."""
    solved = np.isfinite(scene.centers).all(axis=1)
    found, truth = scene.centers[solved], centers[solved]
    off, wanted = found - found.mean(axis=0), truth - truth.mean(axis=0)
    scale = float(np.sum(off * wanted) / np.sum(off**2))
    return scale, truth.mean(axis=0) - scale * found.mean(axis=0)


def seen(centers: Float, positions: Sequence[Float], time_s: Float, noise_rad: float = 0.0, seed: int = 0) -> pp.Tracks:
    """Every view sees every track, which stands at ``positions[j]`` (n_views, d)."""
    n, m, d = len(positions), len(centers), centers.shape[1]
    ray = np.stack(positions) - centers
    ray /= np.linalg.norm(ray, axis=2, keepdims=True)
    ray += noise_rad * np.random.default_rng(seed).normal(size=ray.shape)
    ray /= np.linalg.norm(ray, axis=2, keepdims=True)
    return pp.Tracks.from_arrays(
        np.tile(np.arange(m), n), np.repeat(np.arange(n), m), ray.reshape(-1, d), time_s=time_s
    )


# ---------------------------------------------------------------------------------------------------- exact data


def solved_errors(world: MovingWorld, motion: pp.Motion) -> tuple[float, float]:
    """Largest error of a view and of a track at its sightings, after a fit by shift and scale."""
    scene = pp.solve_positions(world.tracks, motion=motion)
    scale, shift = fitted(scene, world.centers)
    paths, time_s = paths_of(scene), world.tracks.time_s
    assert time_s is not None
    errors = [
        np.abs(scale * paths.position(j, at, outside=True) + shift - world.paths.position(j, at, outside=True)).max()
        for j, at in ((j, time_s[world.tracks.view[world.tracks.track == j]]) for j in range(len(paths)))
    ]
    return float(np.abs(scale * scene.centers + shift - world.centers).max()), float(np.max(errors))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("n_static", "n_moving"), [(6, 6), (2, 10), (1, 12)])
@pytest.mark.parametrize("form", FORMS)
def test_exact_paths_of_known_form_come_out_exactly(form: str, n_static: int, n_moving: int, d: int) -> None:
    world = moving_world([FORMS[form]] * n_moving, d=d, n_static=n_static, n_views=40, seed=1)
    errors = solved_errors(world, pp.Motion(FORMS[form], static=world.static))
    assert max(errors) < 1e-8, errors


@pytest.mark.parametrize("d", [2, 3])
def test_forms_mixed_come_out_exactly(d: int) -> None:
    world = moving_world(list(FORMS.values()), d=d, n_static=8, n_views=40, seed=2)
    moving: dict[str | int, PathModel | Literal["auto"]] = {
        j: model for j, model in enumerate(world.paths.models) if not isinstance(model, Static)
    }
    errors = solved_errors(world, pp.Motion(tracks=moving, static=world.static))
    assert max(errors) < 1e-8, errors


@pytest.mark.parametrize("d", [2, 3])
def test_orders_are_found_of_exact_data(d: int) -> None:
    orders = (1, 1, 1, 2, 2, 3)
    world = moving_world([FORMS[f"taylor:{k}"] for k in orders], d=d, n_static=12, n_views=40, seed=3)
    scene = pp.solve_positions(world.tracks, motion=pp.Motion())
    found = paths_of(scene)
    assert [m.order if isinstance(m, Taylor) else 0 for m in found.models] == [0] * 12 + list(orders)
    assert found.verdicts == world.paths.verdicts
    assert max(solved_errors(world, pp.Motion())) < 1e-8


# ---------------------------------------------------------------------------------------------------- the street


def street_world(seed: int) -> pp.SyntheticWorld:
    return pp.simulate(
        "street",
        n_views=100,
        n_points=2000,
        seed=seed,
        noise_rad=SIGMA_RAD,
        outlier_fraction=0.1,
        mover_fraction=0.3,
        n_bodies=20,
    )


@pytest.fixture(scope="module")
def streets() -> list[tuple[pp.SyntheticWorld, pp.Scene]]:
    worlds = [street_world(seed) for seed in range(3)]
    return [(world, pp.solve_positions(world.tracks, motion=pp.Motion())) for world in worlds]


def camera_rms(scene: pp.Scene, world: pp.SyntheticWorld) -> float:
    scale, shift = fitted(scene, world.centers)
    return float(np.sqrt(np.mean(np.sum((scale * scene.centers + shift - world.centers) ** 2, axis=1))))


def pooled(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_bodies_do_not_bend_the_cameras(streets: list[tuple[pp.SyntheticWorld, pp.Scene]]) -> None:
    best = []
    for world, _ in streets:
        at_rest = world.tracks.select(~world.moving[world.tracks.track])
        best.append(camera_rms(pp.solve_positions(at_rest, start=(world.centers, world.points)), world))
    assert pooled([camera_rms(scene, world) for world, scene in streets]) < 1.1 * pooled(best)


def test_movers_are_found_and_little_else(streets: list[tuple[pp.SyntheticWorld, pp.Scene]]) -> None:
    moves = np.concatenate([np.isin(paths_of(scene).verdicts, MOVES) for _, scene in streets])
    truth = np.concatenate([world.moving for world, _ in streets])
    assert moves[truth].mean() >= 0.95
    assert moves[~truth].mean() <= 0.01


def test_paths_err_as_predicted(streets: list[tuple[pp.SyntheticWorld, pp.Scene]]) -> None:
    ratios = []
    for world, scene in streets:
        scale, shift = fitted(scene, world.centers)
        found = paths_of(scene)
        for track in np.flatnonzero(found.moving & world.moving).tolist():
            first, last = found.seen_s[track].tolist()
            at = np.linspace(first, last, 7)
            off = scale * found.position(track, at) + shift - world.paths.position(track, at, outside=True)
            variance = np.trace(found.position_covariance(track, at), axis1=1, axis2=2).mean()
            ratios.append(np.sqrt(np.mean(np.sum(off**2, axis=1))) / (scale * np.sqrt(variance)))
    assert 0.5 < np.median(ratios) < 1.2
    assert np.quantile(ratios, 0.95) < 3.0


def test_the_same_bytes_on_any_number_of_threads() -> None:
    world = street_world(0)

    def run(threads: int) -> bytes:
        scene = pp.solve_positions(world.tracks, options=pp.PositionOptions(threads=threads), motion=pp.Motion())
        found = paths_of(scene)
        assert found.covariances is not None
        arrays: tuple[npt.NDArray[Any], ...] = (found.coefficients, found.seen_s, found.hidden_by, *found.covariances)
        said = f"{found.models} {[str(one) for one in found.verdicts]}".encode()
        return content(scene) + said + b"".join(a.tobytes() for a in arrays)

    one = run(1)
    assert run(2) == one
    assert run(3) == one


# ---------------------------------------------------------------------------------- what the camera's path hides

TIME_S = np.linspace(0.0, 20.0, 40)
#: A walk that is nearly a parabola.
ARC = np.column_stack((-8.0 + 0.8 * TIME_S, -2.0 + 3.0 * np.sin(0.15 * TIME_S), np.full(40, 1.7)))
STEADY = np.column_stack((-8.0 + 0.8 * TIME_S, 0.1 * TIME_S, np.full(40, 1.7)))


def at_rest(n: int, rng: np.random.Generator) -> list[Float]:
    return [np.tile(rng.uniform((-20.0, -15.0, 0.0), (20.0, 15.0, 8.0)), (len(TIME_S), 1)) for _ in range(n)]


def polynomial(rows: Sequence[npt.ArrayLike]) -> Float:
    """Positions of a body with these vectors, for time in units of ten seconds from the middle."""
    vectors = np.array([np.asarray(row, dtype=np.float64) for row in rows])
    return np.asarray(path_functions(Taylor(len(vectors) - 1, 10.0, 10.0), TIME_S) @ vectors)


def test_a_simpler_path_at_a_wrong_distance_is_not_preferred() -> None:
    # where the camera turns in one direction, bodies that turn in it too look like straight ones elsewhere
    within = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        bodies = [
            polynomial((rng.uniform((-12, -12, 0), (12, 12, 4)), 10 * rng.normal(size=3), (0, 4 * rng.normal(), 0)))
            for _ in range(40)
        ]
        tracks = seen(ARC, [*at_rest(200, rng), *bodies], TIME_S, SIGMA_RAD, seed)
        scene = pp.solve_positions(tracks, motion=pp.Motion())
        scale, shift = fitted(scene, ARC)
        found = paths_of(scene)
        for track in np.flatnonzero(found.moving).tolist():
            off = scale * found.position(track, TIME_S, outside=True) + shift - bodies[track - 200]
            variance = np.trace(found.position_covariance(track, TIME_S), axis1=1, axis2=2).mean()
            within.append(np.sqrt(np.mean(np.sum(off**2, axis=1))) < 6.0 * scale * np.sqrt(variance))
    assert len(within) >= 70
    assert np.mean(within) >= 0.93


@pytest.mark.parametrize("noise_rad", [0.0, SIGMA_RAD])
def test_a_steady_camera_imitates_steady_bodies(noise_rad: float) -> None:
    rng = np.random.default_rng(0)
    bodies = [polynomial(((2.0, 6.0 + k, 1.0), (5.0, -3.0 + k, 0.5))) for k in range(4)]
    tracks = seen(STEADY, [*at_rest(60, rng), *bodies], TIME_S, noise_rad)
    for motion in (pp.Motion(Taylor(1), static=range(60)), pp.Motion(candidates=(Taylor(1),))):
        scene = pp.solve_positions(tracks, motion=motion)
        found = paths_of(scene)
        assert found.verdicts[60:] == (PathVerdict.IMITATED,) * 4
        assert np.isnan(found.coefficients[found.starts[60] :]).all()
        assert np.isnan(scene.points[60:]).all()
        assert np.isfinite(scene.points[:60]).all()
        scale, shift = fitted(scene, STEADY)
        assert np.abs(scale * scene.centers + shift - STEADY).max() < (0.1 if noise_rad else 1e-8)


def test_a_body_behind_a_point_is_hidden_by_it() -> None:
    rng = np.random.default_rng(1)
    still = at_rest(60, rng)
    # P = C + s(t) (X - C) with s polynomial: a path of the richer form on the rays of the point
    camera = polynomial(((0.0, 0.0, 1.7), (8.0, 2.0, 0.0), (0.0, -3.0, 0.0)))
    hidden = camera + 2.0 * (still[7] - camera)
    tracks = seen(camera, [*still, hidden], TIME_S)
    scene = pp.solve_positions(tracks, motion=pp.Motion(tracks={60: Taylor(2)}, static=range(60)))
    found = paths_of(scene)
    assert found.verdicts[60] is PathVerdict.HIDDEN
    assert found.hidden_by[60] == 7
    assert (found.hidden_by[:60] == -1).all()


def test_a_camera_at_rest_tells_nothing() -> None:
    rng = np.random.default_rng(2)
    bodies = [polynomial(((2.0, 6.0 + k, 1.0), (5.0, -3.0 + k, 0.5))) for k in range(6)]
    tracks = seen(np.zeros((40, 3)), [*at_rest(40, rng), *bodies], TIME_S, SIGMA_RAD)
    for motion in (pp.Motion(), pp.Motion(Taylor(1), static=range(40))):
        scene = pp.solve_positions(tracks, motion=motion)
        assert not paths_of(scene).moving.any()


# ------------------------------------------------------------------------------------------------ what is no use


@pytest.fixture(scope="module")
def small() -> MovingWorld:
    return moving_world([Taylor(1, 5.0, 5.0)] * 3, n_static=6, n_views=12)


def timed(tracks: pp.Tracks, time_s: npt.ArrayLike | None) -> pp.Tracks:
    return pp.Tracks.from_arrays(
        tracks.view, tracks.track, tracks.bearing, tracks.n_views, tracks.n_tracks, time_s=time_s
    )


def with_nan(tracks: pp.Tracks) -> pp.Tracks:
    assert tracks.time_s is not None
    return timed(tracks, np.where(np.arange(tracks.n_views) == 3, np.nan, tracks.time_s))


BAD: dict[str, tuple[Callable[[pp.Tracks], pp.Tracks], dict[str, Any], dict[str, Any], str]] = {
    "no times": (lambda tracks: timed(tracks, None), {}, {}, "time_s"),
    "a time that is none": (with_nan, {}, {}, "time_s"),
    "unknown name at rest": (lambda tracks: tracks, {"static": ["door"]}, {}, "door"),
    "index beyond the end": (lambda tracks: tracks, {"static": [9]}, {}, "9"),
    "unknown name of a form": (lambda tracks: tracks, {"tracks": {"car": Taylor(1)}}, {}, "car"),
    "nothing to choose from": (lambda tracks: tracks, {"candidates": ()}, {}, "candidates"),
    "the linear method": (lambda tracks: tracks, {}, {"method": "linear"}, "linear"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_used_is_one_line(small: MovingWorld, case: str) -> None:
    change, of_motion, of_solver, word = BAD[case]
    with pytest.raises(pp.InputError) as raised:
        pp.solve_positions(change(small.tracks), options=pp.PositionOptions(**of_solver), motion=pp.Motion(**of_motion))
    assert word in str(raised.value)
    assert "\n" not in str(raised.value)


def test_tracks_seen_too_seldom_are_undetermined(small: MovingWorld) -> None:
    tracks = small.tracks
    last = np.flatnonzero(tracks.track == 8)
    few = tracks.select(~np.isin(np.arange(len(tracks)), last[2:]))
    for motion in (pp.Motion(), pp.Motion(tracks={8: Taylor(2)}), pp.Motion(tracks={8: Spline((0.0, 5.0, 10.0))})):
        scene = pp.solve_positions(few, motion=motion)
        assert not paths_of(scene).moving[8]
        if 8 in motion.tracks:
            assert paths_of(scene).verdicts[8] is PathVerdict.UNDETERMINED
        assert np.isfinite(scene.centers).all()


def test_a_track_seen_twice_by_a_view(small: MovingWorld) -> None:
    tracks = small.tracks
    rows = np.concatenate((np.arange(len(tracks)), np.arange(0, len(tracks), 5)))
    twice = pp.Tracks.from_arrays(
        tracks.view[rows],
        tracks.track[rows],
        tracks.bearing[rows],
        tracks.n_views,
        tracks.n_tracks,
        time_s=tracks.time_s,
    )
    for motion in (pp.Motion(), pp.Motion(Taylor(1, 5.0, 5.0), static=small.static)):
        scene = pp.solve_positions(twice, motion=motion)
        scale, shift = fitted(scene, small.centers)
        assert np.abs(scale * scene.centers + shift - small.centers).max() < 1e-8
        assert paths_of(scene).verdicts == small.paths.verdicts
