"""The paper's section 8 in small: trials in the core, the bound, and the experiments ``noise`` and ``surface``."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.paper import Settings, Verdict, noise, noise_bias, run_experiment, surface
from panopath.paper.bounds import angle_bound
from panopath.paper.noise_findings import Runs
from panopath.paper.surface_findings import Surface, exponent, exponents, surface_statements
from panopath.paper.trials import SOLVERS, Trials, largest, mean, median, rms, run_trials, trial_seeds


def world_of(trials: Trials, k: int) -> pp.SyntheticWorld:
    return pp.simulate(
        "box",
        n_views=int(trials.n_views[k]),
        n_points=int(trials.n_points[k]),
        seed=int(trials.seed[k]),
        dimension=3 if trials.dimension == 3 else 2,
        angle_error_rad=float(trials.angle_error_rad[k]),
    )


def turns(one: pp.SyntheticWorld, other: pp.SyntheticWorld) -> np.ndarray:
    """Angles between the bearings of planar worlds."""
    a, b = one.tracks.bearing, other.tracks.bearing
    return np.arcsin(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


# ---- the errors of the angles


def test_angles_are_off_uniformly_and_independently() -> None:
    exact = pp.simulate("box", n_views=40, n_points=100, seed=3)
    off = pp.simulate("box", n_views=40, n_points=100, seed=3, angle_error_rad=0.05)
    assert np.array_equal(exact.points, off.points)
    angles = [pp.cameras.spherical_from_bearings(world.tracks.bearing) for world in (exact, off)]
    error = np.asarray(angles[1] - angles[0])
    error[:, 0] = (error[:, 0] + np.pi) % (2.0 * np.pi) - np.pi
    # near the poles a displaced elevation goes over the top
    error = np.compress(np.abs(angles[0][:, 1]) < 1.4, error, axis=0)
    assert np.abs(error).max() <= 0.05 * (1 + 1e-9)
    assert np.allclose((error**2).mean(axis=0), 0.05**2 / 3.0, rtol=0.06)
    assert abs(np.asarray(np.corrcoef(error.T))[0, 1]) < 0.05
    assert np.abs(error.mean(axis=0)).max() < 0.002
    flat = [pp.simulate("box", n_views=9, n_points=30, seed=3, dimension=2, angle_error_rad=e) for e in (0.0, 0.05)]
    turned = turns(*flat)
    assert 0.04 < turned.max() <= 0.05 + 1e-12
    again = pp.simulate("box", n_views=40, n_points=100, seed=3, angle_error_rad=0.05)
    assert np.array_equal(off.tracks.bearing, again.tracks.bearing)
    half = pp.simulate("box", n_views=9, n_points=30, seed=3, dimension=2, angle_error_rad=0.025)
    assert np.allclose(2.0 * turns(flat[0], half), turned, atol=1e-9), "the same errors, half as large"


@pytest.mark.parametrize("error", [-0.1, float("nan"), float("inf")])
def test_errors_out_of_range_are_refused(error: float) -> None:
    with pytest.raises(pp.InputError, match="angle_error_rad is"):
        pp.simulate("box", n_views=3, n_points=3, angle_error_rad=error)
    with pytest.raises(pp.InputError, match="trial 1: angle_error_rad is"):
        run_trials(3, 3, 3, 1, [0.0, error])


# ---- trials


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_trial_is_what_the_steps_answer(dimension: int) -> None:
    trials = run_trials(dimension, [6, 9, 4], [8, 5, 20], trial_seeds(1, (7,), 3), 0.01)
    for k in range(3):
        world = world_of(trials, k)
        for solver, options in SOLVERS.items():
            scene = pp.solve_positions(world.tracks, options=options)
            views = pp.evaluate(scene, world, "translation_scale")
            assert trials.of(solver, "status")[k] == scene.summary.status.value
            assert trials.of(solver, "n_missing")[k] == 0
            assert trials.of(solver, "views_camera_rms")[k] == pytest.approx(views.camera_rms, rel=1e-6)
            assert trials.of(solver, "views_point_rms")[k] == pytest.approx(views.point_rms, rel=1e-6)
            errors = np.concatenate((views.camera_error, views.point_error))
            assert trials.of(solver, "views_max")[k] == pytest.approx(errors.max(), rel=1e-6)
            assert trials.of(solver, "views_mean_abs")[k] == pytest.approx(errors.mean(), rel=1e-6)
            paper = pp.evaluate(scene, world, "paper")
            assert trials.of(solver, "paper_camera_rms")[k] == pytest.approx(paper.camera_rms, rel=1e-6)
            assert trials.of(solver, "paper_point_rms")[k] == pytest.approx(paper.point_rms, rel=1e-6)
            assert trials.of(solver, "refilm_residual_max_rad")[k] == pytest.approx(scene.residual_rad.max(), rel=1e-6)


def test_exact_data_come_back_exactly() -> None:
    for dimension in (2, 3):
        trials = run_trials(dimension, [5, 12], [12, 5], [1, 2], 0.0)
        for column in ("all_max", "views_max", "paper_max", "refilm_max_rad"):
            assert trials.columns[column].max() < 1e-8, column


def test_too_few_have_no_errors() -> None:
    trials = run_trials(3, [1, 1, 20, 2], [1, 20, 1, 2], 5, 0.01)
    assert np.isnan(trials.columns["all_max"][:3]).all()
    assert (trials.columns["n_missing"][:3] == (trials.n_views + trials.n_points)[:3, None]).all()
    assert np.isfinite(trials.of("robust", "all_max")[3]), "two and two are enough in space"
    assert np.isnan(run_trials(2, 2, 20, 1, 0.01).columns["all_max"]).all()


def test_threads_and_company_change_nothing() -> None:
    seeds = trial_seeds(4, (1, 2), 12)
    one = run_trials(3, 5, 9, seeds, 0.02, threads=1)
    two = run_trials(3, 5, 9, seeds, 0.02, threads=2)
    alone = run_trials(3, 5, 9, seeds[7], 0.02, solvers=("robust",))
    for name in one.columns:
        np.testing.assert_array_equal(one.columns[name], two.columns[name], name)
        np.testing.assert_array_equal(alone.of("robust", name)[0], one.of("robust", name)[7], name)
    assert np.array_equal(trial_seeds(4, (1, 2), 5), seeds[:5])
    assert not np.array_equal(trial_seeds(4, (2, 1), 12), seeds)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((3, 0, 3, 1, 0.0), "trial 0: n_views is 0"),
        ((3, 3, -1, 1, 0.0), r"n_points\[0\] is -1"),
        ((4, 3, 3, 1, 0.0), "dimension is 4, expected 2 or 3"),
        ((3, 3.5, 3, 1, 0.0), "n_views has type float64"),
        ((3, [3, 4], [3, 4, 5], 1, 0.0), "do not fit together"),
        ((3, 3, 3, np.ones((2, 2), int), 0.0), "2 axes"),
        ((3, 3, 3, np.ones(0, int), 0.0), "seed is empty"),
    ],
)
def test_bad_arguments_are_named(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(pp.InputError, match=message):
        run_trials(*arguments)


def test_bad_settings_are_named() -> None:
    with pytest.raises(pp.InputError, match="solvers names 'best'"):
        run_trials(3, 3, 3, 1, 0.0, solvers=("best",))
    with pytest.raises(pp.InputError, match="threads is -1"):
        run_trials(3, 3, 3, 1, 0.0, threads=-1)
    with pytest.raises(pp.InputError, match="trials is 0"):
        Settings(trials=0)


# ---- the bound


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_bound_is_the_pseudo_inverse(dimension: int) -> None:
    world = pp.simulate("box", n_views=4, n_points=7, seed=1, dimension=2 if dimension == 2 else 3)
    places, step = np.concatenate((world.centers, world.points)), 1e-6
    columns = []
    for k in range(places.size):
        ends = []
        for sign in (1.0, -1.0):
            moved = places.copy()
            moved.flat[k] += sign * step
            rays = (moved[4:, None] - moved[None, :4]).reshape(-1, dimension)
            flat = np.hypot(rays[:, 0], rays[:, 1])
            angles = [np.arctan2(rays[:, 1], rays[:, 0])] + ([np.arctan2(rays[:, 2], flat)] if dimension == 3 else [])
            ends.append(np.concatenate(angles))
        difference = (ends[0] - ends[1] + np.pi) % (2.0 * np.pi) - np.pi
        columns.append(difference / (2.0 * step))
    jacobian = np.array(columns).T
    variance = np.diag(np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-8)).reshape(-1, dimension).sum(axis=1)
    assert np.allclose(angle_bound(world.centers, world.points), variance, rtol=1e-4)


def test_what_is_not_determined_has_no_bound() -> None:
    assert np.isnan(angle_bound(np.zeros((1, 3)), np.eye(3))).all()
    circle = pp.simulate("ellipse", n_views=5, n_points=6, seed=1)
    assert np.isnan(angle_bound(circle.centers, circle.points)).all()


def test_our_solver_reaches_the_bound_in_the_plane() -> None:
    seeds = trial_seeds(11, (0,), 60)
    trials = run_trials(2, 12, 20, seeds, 1e-3)
    worlds = [world_of(trials, k) for k in range(60)]
    bound = np.array([np.sqrt(angle_bound(w.centers, w.points).sum()) for w in worlds]) * 1e-3 / np.sqrt(3.0)
    ratios = {s: rms(trials.of(s, "all_rms") * np.sqrt(32) / bound) for s in SOLVERS}
    assert ratios["robust"] == pytest.approx(1.0, abs=0.05)
    assert ratios["linear"] > 1.1
    assert ratios["printed"] > 1.1


# ---- findings


def test_exponents_of_known_curves() -> None:
    errors = np.repeat([0.01, 0.02, 0.04], 2)
    rates = np.tile([1.0, 3.0], 3)
    values = np.array([errors * rates, errors**2 * rates, np.full(6, np.nan)]).T
    columns = {"all_max": values, "all_rms": values}
    ones = np.ones(6, int)
    runs = Runs(
        Trials(3, ones, ones, ones, errors, ("printed", "linear", "robust"), columns), errors, np.array([3.0, 1.0] * 3)
    )
    assert np.allclose(runs.slopes("printed", "all_max"), 1.0)
    assert np.allclose(runs.slopes("linear", "all_max"), 2.0)
    assert runs.linear_until_rad("printed", "all_max") == 0.04
    assert runs.linear_until_rad("linear", "all_max") == 0.01
    assert np.isnan(runs.linear_until_rad("robust", "all_max"))
    assert runs.exponent("linear", "all_max") == pytest.approx(2.0)
    assert np.isnan(runs.exponent("robust", "all_max"))
    assert np.isnan(runs.unit_correlation("robust"))
    assert runs.over_bound("printed") == pytest.approx(2.0)
    counts = np.arange(1.0, 31.0)
    assert exponent(counts**-0.5) == pytest.approx(-0.5)
    assert np.isnan(exponent(np.ones(5)))
    in_points, in_views, both = exponents(counts[:, None] ** -1.0 * counts[None] ** 0.25)
    assert (in_points, in_views, both) == pytest.approx((0.25, -1.0, -0.75))


def test_error_that_falls_with_the_unit() -> None:
    unit, ones = np.array([0.1, 2.0, 0.7, 1.3]), np.ones(4, int)
    trials = Trials(3, ones, ones, ones, np.full(4, 0.02), ("printed",), {"all_max": (0.01 / unit)[:, None]})
    assert Runs(trials, unit, unit).unit_correlation("printed") == pytest.approx(-1.0)
    assert Runs(trials, unit, -unit).unit_correlation("printed") == pytest.approx(1.0)


def test_statistics_pass_over_what_is_not_there() -> None:
    values = [1.0, np.nan, 3.0, np.inf]
    assert (median(values), mean(values), largest(values)) == (2.0, 2.0, 3.0)
    assert rms(values) == pytest.approx(5.0**0.5)
    assert all(np.isnan(f([])) and np.isnan(f([np.nan])) for f in (median, mean, largest, rms))


def test_statements_follow_the_surface() -> None:
    """A surface that does what the paper says, and one that does not."""
    m, n = np.indices((20, 20)) + 1.0
    rng = np.random.default_rng(0)
    noise_of = 1.0 + 0.02 * rng.standard_normal((20, 20, 3))
    decay = 1.0 + 30.0 * ((m < 3) | (n < 3))

    def made(cells: np.ndarray) -> Surface:
        values = 0.01 * cells[..., None] * noise_of
        return Surface(values, values / n[..., None], values, np.full_like(values, 0.01), np.ones(values.shape, bool))

    agreeing = surface_statements({"printed": made(decay * m**0.5)}, 0.01)
    assert [one.verdict for one in agreeing] == [Verdict.AGREES] * 6
    other = surface_statements({"printed": made(np.ones_like(m))}, 0.01)
    verdicts = {one.claim.split(",")[0]: one.verdict for one in other}
    assert verdicts["A sharp decay for small n and m"] is Verdict.CORRECTED
    assert verdicts["Beyond the decay the error grows"] is Verdict.CORRECTED


def test_the_printed_gauge_is_biased() -> None:
    found = noise_bias.measure_bias([(8, 20)], [0.1], 3, 8, seed=1, threads=1)
    share = {one.solver: one.share for one in found}
    assert share["printed"] > 0.5
    assert share["robust"] < 0.3
    assert all(one.rms > 0.0 for one in found)


# ---- the experiments


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(noise, "KEYS", ((3, 3, 5), (3, 6, 4), (2, 5, 6)))
    monkeypatch.setattr(noise, "LEVELS_RAD", np.linspace(0.0, 0.1, 4))
    monkeypatch.setattr(noise, "GROWTH_RAD", np.geomspace(1e-3, 0.1, 3))
    monkeypatch.setattr(noise, "BIAS_RAD", (0.1,))
    monkeypatch.setattr(surface, "LARGEST", 4)


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("experiment", [noise.NOISE, surface.SURFACE])
def test_same_bytes_on_any_number_of_threads(experiment: pp.paper.Experiment, tmp_path: Path) -> None:
    records = [
        run_experiment(experiment, tmp_path / str(threads), Settings(trials=2, threads=threads), draws=False)
        for threads in (1, 2)
    ]
    assert records[0].statements == records[1].statements
    for table in records[0].tables:
        assert (tmp_path / "1" / table).read_bytes() == (tmp_path / "2" / table).read_bytes(), table
    assert records[0].n_trials > 0


@pytest.mark.usefixtures("small")
def test_noise_has_a_row_a_trial(tmp_path: Path) -> None:
    done: list[tuple[int, int]] = []
    settings = Settings(trials=2, threads=1)
    record = run_experiment(noise.NOISE, tmp_path, settings, lambda *at: done.append(at), draws=False)
    rows = rows_of(tmp_path / "noise.csv")
    assert len(rows) == 3 * 4 * 2
    exact = [row for row in rows if float(row["angle_error_rad"]) == 0.0]
    assert len(exact) == 6
    assert all(float(row[f"{s}_all_max"]) < 1e-8 for row in exact for s in ("linear", "robust"))
    assert done[-1] == (record.n_trials, record.n_trials)
    assert [one for one, _ in done] == sorted(one for one, _ in done)
    # a row says how its world is made again
    row = rows[-1]
    trial = run_trials(
        int(row["dimension"]), int(row["views"]), int(row["points"]), int(row["seed"]), float(row["angle_error_rad"])
    )
    assert float(row["robust_all_max"]) == pytest.approx(trial.of("robust", "all_max")[0], rel=1e-6)


@pytest.mark.usefixtures("small")
def test_surface_counts_what_has_no_answer(tmp_path: Path) -> None:
    run_experiment(surface.SURFACE, tmp_path, Settings(trials=3), draws=False)
    rows = rows_of(tmp_path / "surface.csv")
    assert len(rows) == 4 * 4 * 3
    sizes = rows_of(tmp_path / "surface-sizes.csv")
    assert len(sizes) == 4 * 4 * len(SOLVERS)
    for size in sizes:
        single = "1" in (size["views"], size["points"])
        assert (size["max_mean"] == "nan") == single
        # in two stages two views, or two points, have no plan: an answer is one of many, or none
        if single or size["solver"] != "printed":
            assert int(size["with_answer"]) == (0 if single else 3), size


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("experiment", [noise.NOISE, surface.SURFACE])
def test_pictures_are_drawn(experiment: pp.paper.Experiment, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra plot is absent")
    record = run_experiment(experiment, tmp_path, Settings(trials=1, threads=1))
    assert len(record.pictures) == 3
    for name in record.pictures:
        assert (tmp_path / name).stat().st_size > 10_000, name


def test_a_world_without_points_to_compare_is_no_error() -> None:
    none = np.full((2, 2, 1), np.nan)
    surfaces = {"robust": Surface(none, none, none, none, np.zeros((2, 2, 1), bool))}
    assert len(surface_statements(surfaces, 0.01)) == 6
    assert replace(Settings(), trials=3).trials_or(7) == 3
