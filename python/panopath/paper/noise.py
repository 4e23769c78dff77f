"""Section 8, figure 1: the error of the reconstruction against the error of the angles.

Three sets of scenes for three solvers, ``SOLVERS`` of :mod:`panopath.paper.trials`. The paper's own: for each of 30
errors ``eps`` from 0 to 0.1 a number of new worlds. Worlds that stay the same while all their errors grow in
proportion, from 1e-4 to 0.1: what then grows otherwise than ``eps`` is not linear. Worlds seen again and again with new
errors: what stays of the mean is bias.

The paper calls distances what it then takes the absolute value of, and the mean of with its sign. Here the error of a
view or point is the length of its displacement, and the signed mean is the length of the mean displacement; in a frame
fitted to all of them that is zero, so it is told in the paper's frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from panopath.model import Float, read_only
from panopath.paper.bounds import angle_bound
from panopath.paper.experiment import Experiment, Outcome, Picture, Progress, Settings, Table
from panopath.paper.noise_bias import Bias, measure_bias
from panopath.paper.noise_findings import Key, Runs, noise_statements
from panopath.paper.noise_pictures import draw_measures, draw_noise
from panopath.paper.trials import SOLVERS, Int64, run_trials, trial_seeds
from panopath.synthetic import simulate

#: Dimension, views and points: the paper's three panels, in space and in the plane.
KEYS: tuple[Key, ...] = tuple((d, m, n) for d in (3, 2) for m, n in ((10, 50), (50, 10), (50, 50)))
#: The paper's errors, 30 from 0 to 0.1, and worlds for each.
LEVELS_RAD = np.linspace(0.0, 0.1, 30)
WORLDS = 10
#: Errors of worlds that stay the same.
GROWTH_RAD = np.geomspace(1e-4, 0.1, 10)
#: Errors and worlds for the bias, and how often each is seen; with fewer trials asked for, fewer.
BIAS_RAD = (0.01, 0.03, 0.1)
BIAS_WORLDS = 4
BIAS_REPEATS = 20

_PICTURE_SIZE = (11.0, 10.0)
_COLUMNS = (
    "status",
    "n_missing",
    "all_max",
    "all_mean_abs",
    "all_rms",
    "all_camera_rms",
    "all_point_rms",
    "paper_max",
    "paper_mean_abs",
    "paper_mean",
    "paper_rms",
    "paper_point_coordinate_max",
    "refilm_max_rad",
    "refilm_rms_rad",
    "refilm_residual_rms_rad",
)


def _run(settings: Settings, progress: Progress) -> Outcome:
    worlds = settings.trials_or(WORLDS)
    bias_worlds, repeats = min(BIAS_WORLDS, worlds), min(BIAS_REPEATS, 2 * worlds)
    sizes = [(m, n) for d, m, n in KEYS if d == 3]
    of_key = worlds * (len(LEVELS_RAD) + len(GROWTH_RAD)) * len(SOLVERS)
    total = of_key * len(KEYS) + bias_worlds * repeats * len(BIAS_RAD) * len(sizes) * len(SOLVERS)
    fresh, growth = {}, {}
    for k, key in enumerate(KEYS):
        seeds = trial_seeds(settings.seed, (0, *key), worlds * len(LEVELS_RAD))
        fresh[key] = _runs(key, seeds, np.repeat(LEVELS_RAD, worlds), settings.threads)
        seeds = np.tile(trial_seeds(settings.seed, (1, *key), worlds), len(GROWTH_RAD))
        growth[key] = _runs(key, seeds, np.repeat(GROWTH_RAD, worlds), settings.threads)
        progress((k + 1) * of_key, total)
    bias = measure_bias(sizes, BIAS_RAD, bias_worlds, repeats, seed=settings.seed, threads=settings.threads)
    progress(total, total)
    return Outcome(
        n_trials=total,
        tables={"trials": _table(fresh), "growth": _table(growth), "bias": _bias_table(bias)},
        statements=noise_statements(fresh, growth, bias),
        pictures=_pictures(fresh, growth, bias),
    )


def _runs(key: Key, seeds: Int64, errors: Float, threads: int) -> Runs:
    d, m, n = key
    trials = run_trials(d, m, n, seeds, errors, threads=threads)
    known = {seed: _bound_and_unit(key, seed) for seed in np.unique(seeds).tolist()}
    bound, unit = np.array([known[seed] for seed in seeds.tolist()]).T
    # a uniform error has the variance eps^2 / 3
    return Runs(trials, read_only(errors / np.sqrt(3.0) * bound), read_only(unit.copy()))


def _bound_and_unit(key: Key, seed: int) -> tuple[float, float]:
    """Least rms error, for angles with a standard deviation of one radian; and the unit of the paper's frame."""
    d, m, n = key
    world = simulate("box", n_views=m, n_points=n, seed=seed, dimension=3 if d == 3 else 2)
    variance = angle_bound(world.centers, world.points)
    return float(np.sqrt(variance.mean())), float(abs(world.points[1, 0] - world.points[0, 0]))


def _table(runs: Mapping[Key, Runs]) -> Table:
    columns: dict[str, list[Any]] = {}
    for one in runs.values():
        for name, column in _columns(one).items():
            columns.setdefault(name, []).extend(column)
    return Table(columns)


def _columns(one: Runs) -> dict[str, list[Any]]:
    added = {"bound_all_rms": one.bound_rms.tolist(), "paper_unit": one.paper_unit.tolist()}
    return one.trials.rows(_COLUMNS) | added


def _bias_table(rows: list[Bias]) -> Table:
    return Table(
        {
            "views": [row.n_views for row in rows],
            "points": [row.n_points for row in rows],
            "angle_error_rad": [row.angle_error_rad for row in rows],
            "solver": [row.solver for row in rows],
            "all_rms": [row.rms for row in rows],
            "bias_all_rms": [row.bias_rms for row in rows],
        }
    )


def _pictures(fresh: Mapping[Key, Runs], growth: Mapping[Key, Runs], bias: list[Bias]) -> dict[str, Picture]:
    space, plane = ([key for key in KEYS if key[0] == d] for d in (3, 2))
    about = (
        "Error of the reconstruction against the error of the angles, in {}. Dots are trials, lines medians over "
        "worlds that stay the same; errors after a fit by shift and scale over all views and points."
    )
    measures = (
        "The paper's measures of error in space, in its frame and in that of a fit, and the error of the scene filmed "
        "again; medians over worlds that stay the same."
    )
    return {
        "space": Picture(
            lambda figure: draw_noise(figure, space, fresh, growth, bias), about.format("space"), *_PICTURE_SIZE
        ),
        "plane": Picture(
            lambda figure: draw_noise(figure, plane, fresh, growth, []), about.format("the plane"), *_PICTURE_SIZE
        ),
        "measures": Picture(lambda figure: draw_measures(figure, space, growth), measures, *_PICTURE_SIZE),
    }


NOISE = Experiment("noise", "8", "Error of the reconstruction against the error of the angles", _run)
