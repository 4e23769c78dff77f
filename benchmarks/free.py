"""Orientations that err or are unknown, long chains, against the optimum: ``python -m benchmarks.free [--seeds N]``.

The optimum is the refinement started from the truth: what a perfect start would give on the same noise.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from math import radians
from statistics import median
from typing import Any

import panopath as pp
from panopath.evaluate import Alignment
from panopath.formats.structure import known_scene
from panopath.model import Scene
from panopath.synthetic import SyntheticWorld

from benchmarks.cases import NOISE_DEG


@dataclass(frozen=True)
class Case:
    """A world, what is told of its orientations, and what is promised."""

    name: str
    world: str
    options: dict[str, Any]
    #: Error of the orientations told, degrees; None: nothing is told.
    error_deg: float | None
    #: Worst scene over the optimum.
    limit: float
    #: Orientations are exact and stay as they are.
    held: bool = False

    def make(self, seed: int, error_deg: float) -> SyntheticWorld:
        """Make the world with orientations that are off by so much."""
        return pp.simulate(
            self.world,
            noise_rad=radians(NOISE_DEG),
            orientations="random",
            orientation_error_rad=radians(error_deg),
            seed=seed,
            **self.options,
        )


def cases() -> Iterator[Case]:
    """Rows of the table."""
    for world in ("street", "room"):
        options = {"n_views": 100, "n_points": 10_000, "outlier_fraction": 0.2}
        for error in (1.0, 3.0, None):
            told = "unknown" if error is None else f"off by {error:g} deg"
            yield Case(f"{world} 100, 20 % outliers, {told}", world, options, error, 1.1)
    chain = {"n_views": 2000, "n_points": 40_000, "outlier_fraction": 0.1}
    yield Case("chain 2000, 10 % outliers, known", "chain", chain, 0.0, 1.5, held=True)
    yield Case("chain 2000, 10 % outliers, unknown", "chain", chain, None, 1.5)


def solve(case: Case, world: SyntheticWorld) -> Scene:
    """Find the scene as a user would."""
    if case.held:
        return pp.solve_positions(world.tracks, world.cam_from_world)
    return pp.reconstruct_tracks(world.tracks, None if case.error_deg is None else world.cam_from_world)


def optimum(case: Case, world: SyntheticWorld, seed: int) -> Scene:
    """Find the same from the truth."""
    true = case.make(seed, 0.0)
    if case.held:
        return pp.solve_positions(world.tracks, true.cam_from_world, start=(true.centers, true.points))
    return pp.refine(world.tracks, known_scene(world.tracks, true.cam_from_world, true.centers, true.points))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    chosen = parser.parse_args()
    print(f"{'case':<42} {'solved':>8} {'median s':>9} {'rms m':>9} {'optimum m':>10} {'median':>7} {'worst':>6}")
    for case in cases():
        ratios, seconds, errors, best, solved = [], [], [], [], 0
        for seed in range(chosen.seeds):
            world = case.make(seed, case.error_deg or 0.0)
            began = time.perf_counter()
            scene = solve(case, world)
            seconds.append(time.perf_counter() - began)
            alignment: Alignment = "translation_scale" if case.held else "similarity"
            errors.append(pp.evaluate(scene, world, alignment).camera_rms)
            best.append(pp.evaluate(optimum(case, world, seed), world, alignment).camera_rms)
            ratios.append(errors[-1] / best[-1])
            solved += scene.summary.n_solved_views == world.tracks.n_views and scene.n_components == 1
        verdict = "met" if max(ratios) <= case.limit else "MISSED"
        print(
            f"{case.name:<42} {solved:>3} of {chosen.seeds:<2} {median(seconds):>8.2f} {median(errors):>9.5f} "
            f"{median(best):>10.5f} {median(ratios):>7.3f} {max(ratios):>6.3f}  <= {case.limit:g} x: {verdict}",
            flush=True,
        )


if __name__ == "__main__":
    main()
