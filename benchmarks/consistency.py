"""The consistency gate on 200 reconstructions, half of them broken on purpose: ``python -m benchmarks.consistency``.

Every reconstruction is panopath's own, on a world with known truth. It counts as broken only where its cameras err by
more than five times what the solver reaches from the truth on the same noise. Where a solver resisted the sabotage, or
failed without any, the scene is listed apart. Seeds from 3000 on were never looked at while limits were chosen.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import radians
from statistics import median
from typing import Any

import numpy as np
import panopath as pp
from panopath.errors import InputError
from panopath.formats.structure import known_scene
from panopath.model import Float, Int, Method, Scene, Tracks
from panopath.synthetic import SyntheticWorld

#: A camera error beyond this many times the optimum is a broken scene.
BROKEN_RATIO = 5.0
#: First seed of the set that is reported.
FRESH_SEED = 3000


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A scene with what it was made from, and how far it is from the truth."""

    name: str
    tracks: Tracks
    scene: Scene
    #: Camera error over that of the optimum: of rms and maximum the larger ratio.
    ratio: float

    @property
    def is_broken(self) -> bool:
        """Whether the scene is really wrong."""
        return not self.ratio <= BROKEN_RATIO


def rotations_of(rng: np.random.Generator, angle_rad: float) -> Float:
    """Draw a rotation by this angle about a random axis."""
    axis = rng.normal(size=3)
    x, y, z = axis / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle_rad) * k + (1 - np.cos(angle_rad)) * k @ k)


def turned(cam_from_world: Float, rng: np.random.Generator, angle_rad: float) -> Float:
    """Turn orientations, in the world, by one random rotation of this angle: rotations, or headings in the plane."""
    if cam_from_world.ndim == 1:
        return np.asarray(cam_from_world + rng.choice([-1.0, 1.0]) * angle_rad)
    return np.asarray(cam_from_world @ rotations_of(rng, angle_rad))


# ---------------------------------------------------------------------------------------------------- right scenes

WORLDS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("street", {"n_views": 80, "n_points": 3000}),
    ("street", {"n_views": 150, "n_points": 4000}),
    ("room", {"n_views": 80, "n_points": 2000}),
    ("chain", {"n_views": 100, "n_points": 3000}),
    ("chain", {"n_views": 250, "n_points": 6000}),
    ("corridor", {"n_views": 60, "n_points": 2000}),
    ("line", {"n_views": 60, "n_points": 2000}),
    ("stop_and_go", {"n_views": 90, "n_points": 3000}),
    ("box", {"n_views": 12, "n_points": 60}),
    ("street", {"n_views": 80, "n_points": 3000, "infinity_fraction": 0.6}),
    ("street", {"n_views": 100, "n_points": 3000, "dimension": 2}),
    ("street", {"n_views": 80, "n_points": 2500, "mover_fraction": 0.08}),
    ("chain", {"n_views": 100, "n_points": 3000, "operator_fraction": 0.05}),
)


def draw_world(rng: np.random.Generator, seed: int, **more: Any) -> tuple[SyntheticWorld, str]:
    """Draw one of the worlds, its noise and its share of false bearings."""
    name, options = WORLDS[rng.integers(len(WORLDS))]
    settings: dict[str, Any] = {
        "noise_rad": radians(float(np.exp(rng.uniform(np.log(0.02), np.log(0.2))))),
        "outlier_fraction": float(rng.choice([0.0, 0.05, 0.2, 0.35])),
        "orientations": "random",
        **options,
        **more,
    }
    return pp.simulate(name, seed=seed, **settings), name


def optimum(tracks: Tracks, world: SyntheticWorld, *, free: bool) -> tuple[float, float]:
    """Camera errors of the solve that starts from the truth, with true observations only."""
    if free:
        start = known_scene(tracks, world.cam_from_world, world.centers, world.points)
        scene = pp.refine(tracks, start)
    else:
        scene = pp.solve_positions(tracks, world.cam_from_world, start=(world.centers, world.points))
    return camera_errors(scene, world, free=free)


def camera_errors(scene: Scene, world: SyntheticWorld, *, free: bool) -> tuple[float, float]:
    """Rms and largest camera error; inf where nothing was solved."""
    try:
        found = pp.evaluate(scene, world, "similarity" if free else "translation_scale")
    except InputError:
        return float("inf"), float("inf")
    return found.camera_rms, found.camera_max


def ratio_of(scene: Scene, best: tuple[float, float], world: SyntheticWorld, *, free: bool) -> float:
    """Camera errors over those of the optimum: the larger of the ratios of rms and of maximum."""
    floor = 1e-9 * float(np.linalg.norm(np.ptp(world.centers, axis=0)))
    found = camera_errors(scene, world, free=free)
    return max(error / max(least, floor) for error, least in zip(found, best, strict=True))


def judged(name: str, tracks: Tracks, scene: Scene, world: SyntheticWorld, *, free: bool) -> Reconstruction:
    """Compare a scene with the optimum on the tracks as they should be."""
    best = optimum(world.tracks.select(~world.outlier), world, free=free)
    return Reconstruction(name, tracks, scene, ratio_of(scene, best, world, free=free))


def right(rng: np.random.Generator, seed: int) -> Reconstruction:
    """Solve as a user would: orientations known, about right, or (in space) unknown."""
    told = rng.choice(["known", "near", "unknown"], p=[0.5, 0.3, 0.2])
    if told == "near":
        world, name = draw_world(rng, seed, orientation_error_rad=radians(1.0))
    else:
        world, name = draw_world(rng, seed)
    if told == "known":
        scene = pp.solve_positions(world.tracks, world.cam_from_world)
    elif told == "near":
        scene = pp.reconstruct_tracks(world.tracks, world.cam_from_world)
    else:
        scene = pp.reconstruct_tracks(world.tracks)
    return judged(f"{name}, orientations {told}", world.tracks, scene, world, free=told != "known")


# --------------------------------------------------------------------------------------------------- broken scenes


def look_alike(
    world: SyntheticWorld, rng: np.random.Generator, first: int, second: int, reach: int
) -> tuple[Tracks, Tracks]:
    """Make the place about one view look like that about another: the tracks as they are, and with both merged.

    Copies of points seen about the first view are put about the second, with the same views counted from there.
    """
    tracks, shift = world.tracks, second - first
    offset = world.centers[second] - world.centers[first]
    near = np.abs(tracks.view - first) <= reach
    inside = np.bincount(tracks.track, weights=~near, minlength=tracks.n_tracks) == 0
    seen = (
        near
        & inside[tracks.track]
        & ~world.outlier
        & (tracks.view + shift >= 0)
        & (tracks.view + shift < tracks.n_views)
    )
    view, track = tracks.view[seen] + shift, tracks.track[seen]
    direction = world.points[track] + offset - world.centers[view]
    bearing = noisy(np.einsum("nij,nj->ni", world.cam_from_world[view], direction), world.noise_rad, rng)
    # what the second place has of its own is thinned out: look-alikes are the majority there
    own = np.abs(tracks.view - second) <= reach
    keep = ~own | (rng.random(len(tracks)) < 0.5)

    def joined(ids: Int, n_tracks: int) -> Tracks:
        return Tracks.from_arrays(
            np.concatenate((tracks.view[keep], view)),
            np.concatenate((tracks.track[keep], ids)),
            np.concatenate((tracks.bearing[keep], bearing)),
            tracks.n_views,
            n_tracks,
        )

    apart = joined((track + tracks.n_tracks).astype(np.int32), 2 * tracks.n_tracks)
    return apart, joined(track.astype(np.int32), tracks.n_tracks)


def closed(world: SyntheticWorld, first: int, second: int) -> Float:
    """Bend the path until the second place lies on the first."""
    offset = world.centers[second] - world.centers[first]
    share = np.clip((np.arange(len(world.centers)) - first) / (second - first), 0.0, 1.0)
    return np.asarray(world.centers - share[:, None] * offset)


def wrong_closure(rng: np.random.Generator, seed: int) -> Reconstruction:
    """Two places that look alike are taken for one."""
    name = rng.choice(["street", "chain", "corridor"])
    n_views = int(rng.choice([60, 100, 160]))
    world = pp.simulate(
        name,
        n_views=n_views,
        n_points=30 * n_views,
        seed=seed,
        noise_rad=radians(float(np.exp(rng.uniform(np.log(0.02), np.log(0.2))))),
        outlier_fraction=float(rng.choice([0.0, 0.1])),
        orientations="random",
    )
    reach = 10
    gap = int(rng.integers(25, n_views - 2 * reach)) if n_views > 60 else 30
    first = int(rng.integers(reach, n_views - reach - gap + 1))
    second = min(first + gap, n_views - 1)
    apart, merged = look_alike(world, rng, first, second, reach)
    free = bool(rng.random() < 0.5)
    centers = closed(world, first, second)
    nowhere = np.full((merged.n_tracks, merged.d), np.nan)
    if free:
        start = pp.solve_positions(merged, world.cam_from_world, start=(centers, nowhere))
        scene = pp.refine(merged, start)
        how = "refined"
    elif rng.random() < 0.5:
        scene, how = pp.solve_positions(merged, world.cam_from_world, start=(centers, nowhere)), "from the closed start"
    else:
        scene, how = pp.solve_positions(merged, world.cam_from_world, pp.PositionOptions(method="linear")), "linear"
    best = pp.solve_positions(
        apart, world.cam_from_world, start=(world.centers, np.concatenate((world.points, nowhere)))
    )
    if free:
        best = pp.refine(apart, best)
    nothing = replace(world, points=nowhere)
    twice = replace(world, points=np.full((apart.n_tracks, apart.d), np.nan))
    ratio = ratio_of(scene, camera_errors(best, twice, free=free), nothing, free=free)
    return Reconstruction(f"wrong closure, {name}, {how}", merged, scene, ratio)


def flipped(rng: np.random.Generator, seed: int) -> Reconstruction:
    """Flip the scale of a part of the scene, or make it another than that of the rest."""
    free = bool(rng.random() < 0.5)
    factor = float(rng.choice([-1.0, -1.0, 0.3, 3.0]))
    if rng.random() < 0.5:
        world = pp.simulate(
            "weak",
            n_views=40,
            n_points=800,
            n_clusters=2,
            n_links=int(rng.integers(8, 25)),
            seed=seed,
            noise_rad=radians(0.05),
            orientations="random",
        )
        name = "weak"
    else:
        name = str(rng.choice(["chain", "street", "corridor"]))
        world = pp.simulate(
            name,
            n_views=80,
            n_points=2400,
            seed=seed,
            noise_rad=radians(float(np.exp(rng.uniform(np.log(0.02), np.log(0.2))))),
            outlier_fraction=float(rng.choice([0.0, 0.1, 0.3])),
            orientations="random",
        )
    n = world.tracks.n_views
    pivot = n // 2 if name == "weak" else int(rng.integers(n // 4, 3 * n // 4))
    flip = np.arange(n) >= pivot
    centers = np.where(
        flip[:, None], world.centers[pivot] + factor * (world.centers - world.centers[pivot]), world.centers
    )
    mostly = np.bincount(
        world.tracks.track, weights=flip[world.tracks.view], minlength=world.tracks.n_tracks
    ) * 2 > np.bincount(world.tracks.track, minlength=world.tracks.n_tracks)
    points = np.where(mostly[:, None], world.points[:] * factor + world.centers[pivot] * (1 - factor), world.points)
    if rng.random() < 0.4:
        scene, how = known_scene(world.tracks, world.cam_from_world, centers, points), "as it is"
        inlier = scene.residual_rad < 5 * world.noise_rad
        scene = known_scene(world.tracks, world.cam_from_world, centers, points, inlier)
    elif free:
        start = known_scene(world.tracks, world.cam_from_world, centers, points)
        scene, how = pp.refine(world.tracks, start), "refined"
    else:
        scene, how = pp.solve_positions(world.tracks, world.cam_from_world, start=(centers, points)), "solved"
    return judged(f"scale of a part times {factor:g}, {name}, {how}", world.tracks, scene, world, free=free)


def mis_oriented(rng: np.random.Generator, seed: int) -> Reconstruction:
    """Turn a run of views, and let the solver believe it."""
    world, name = draw_world(rng, seed)
    n = world.tracks.n_views
    length = int(rng.integers(max(2, n // 20), max(3, n // 4)))
    begin = int(rng.integers(0, n - length))
    angle = radians(float(np.exp(rng.uniform(np.log(0.5), np.log(30.0)))))
    orientations = np.array(world.cam_from_world)
    orientations[begin : begin + length] = turned(orientations[begin : begin + length], rng, angle)
    method: Method = "linear" if rng.random() < 0.25 else "robust"
    scene = pp.solve_positions(world.tracks, orientations, pp.PositionOptions(method=method))
    return judged(
        f"{length} views off by {np.degrees(angle):.1f} deg, {name}, {method}", world.tracks, scene, world, free=False
    )


def structured_outliers(rng: np.random.Generator, seed: int) -> Reconstruction:
    """Two in five observations agree with one another, and not with the scene."""
    kind = str(rng.choice(["mover", "ghost", "operator"]))
    settings: dict[str, Any] = {
        "n_views": 80,
        "n_points": 3000,
        "noise_rad": radians(float(np.exp(rng.uniform(np.log(0.02), np.log(0.2))))),
        "orientations": "random",
    }
    if kind in ("mover", "operator"):
        settings[f"{kind}_fraction"] = 0.4
    if kind == "mover":
        settings["mover_speed_m_s"] = float(rng.choice([0.1, 0.5, 1.5]))
    name = str(rng.choice(["street", "chain"]))
    world = pp.simulate(name, seed=seed, **settings)
    tracks = world.tracks
    if kind == "ghost":
        tracks = ghosted(world, rng)
    how = str(rng.choice(["robust", "linear", "unknown"]))
    if how == "unknown":
        scene = pp.reconstruct_tracks(tracks)
    else:
        method: Method = "linear" if how == "linear" else "robust"
        scene = pp.solve_positions(tracks, world.cam_from_world, pp.PositionOptions(method=method))
    return judged(f"40 % {kind}, {name}, {how}", tracks, scene, world, free=how == "unknown")


def ghosted(world: SyntheticWorld, rng: np.random.Generator) -> Tracks:
    """Let most tracks jump, half-way, to a copy of the scene beside it: a facade of equal windows."""
    tracks = world.tracks
    step = rng.normal(size=tracks.d)
    # observations are sorted by track, then by view
    place = np.arange(len(tracks)) - np.searchsorted(tracks.track, tracks.track)
    length = np.bincount(tracks.track, minlength=tracks.n_tracks)
    jumps_at = np.where(rng.random(tracks.n_tracks) < 0.8, length * rng.random(tracks.n_tracks), np.inf)
    jump = place >= jumps_at[tracks.track]
    direction = world.points[tracks.track] + step - world.centers[tracks.view]
    bearing = noisy(np.einsum("nij,nj->ni", world.cam_from_world[tracks.view], direction), world.noise_rad, rng)
    jumped = np.where(jump[:, None], bearing, tracks.bearing)
    return Tracks.from_arrays(tracks.view, tracks.track, jumped, tracks.n_views, tracks.n_tracks)


def noisy(direction: Float, noise_rad: float, rng: np.random.Generator) -> Float:
    """Make unit vectors of directions, with noise along each tangent."""
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    off = unit + noise_rad * rng.normal(size=unit.shape)
    return np.asarray(off / np.linalg.norm(off, axis=1, keepdims=True))


SABOTAGE: dict[str, Callable[[np.random.Generator, int], Reconstruction]] = {
    "wrong closure": wrong_closure,
    "flipped part": flipped,
    "mis-oriented run": mis_oriented,
    "structured outliers": structured_outliers,
}
#: Beyond this ratio, a scene that is not broken is not right either: its solver was disturbed.
RIGHT_RATIO = 2.0
#: How many scenes are tried for each that is wanted.
MOST_TRIES = 4


def draw(kind: str, n_wanted: int, first_seed: int) -> Iterator[Reconstruction]:
    """Reconstructions of one kind, in the order of their seeds, until enough are right (or broken) as they should be.

    The others come too: what the solver resisted, and what it spoilt by itself. A scene without views claims nothing
    and is passed over.
    """
    wants_right = kind == "right"
    make = right if wants_right else SABOTAGE[kind]
    n_found = 0
    for seed in range(first_seed, first_seed + MOST_TRIES * n_wanted):
        if n_found == n_wanted:
            return
        # each kind draws from a stream of its own
        made = make(np.random.default_rng([seed, ("right", *SABOTAGE).index(kind)]), seed)
        if made.scene.summary.n_solved_views == 0:
            continue
        n_found += made.ratio <= RIGHT_RATIO if wants_right else made.is_broken
        yield made


@dataclass
class Count:
    """How many scenes of a kind were flagged, by the gate and by less."""

    scenes: int = 0
    gate: int = 0
    status: int = 0
    noise: int = 0

    def add(self, made: Reconstruction, found: pp.Consistency) -> None:
        """Count one scene."""
        value, limit = found.statistics["noise_rad"]
        self.scenes += 1
        self.gate += not found.passed
        self.status += not made.scene.summary.status.is_determined
        self.noise += value > limit

    def row(self, name: str) -> str:
        """One line of the table."""
        cells = (f"{n:>4} ({100 * n / max(self.scenes, 1):5.1f} %)" for n in (self.gate, self.status, self.noise))
        return f"{name:<44} {self.scenes:>6} " + " ".join(f"{cell:>16}" for cell in cells)


#: What looks at the residuals of the observations that a scene uses; the others look at what it rejects.
OF_RESIDUALS = ("noise_rad", "noise_over_given", "misfit_share", "behind_share", "tension", "near_strain", "far_strain")


def residuals_look_right(found: pp.Consistency) -> bool:
    """Whether nothing is wrong with the observations that a scene uses."""
    return not any(name in OF_RESIDUALS and value > limit for name, (value, limit) in found.statistics.items())


def judge(n_each: int, first_seed: int) -> tuple[dict[str, Count], Counter[str], list[str]]:
    """Make all scenes and check them: counts by kind, which figures told, and the mistakes."""
    counts: dict[str, Count] = {}
    told: Counter[str] = Counter()
    mistakes = []
    for kind, n_wanted in (("right", 4 * n_each), *((kind, n_each) for kind in SABOTAGE)):
        for made in draw(kind, n_wanted, first_seed):
            found = pp.check_consistency(made.tracks, made.scene)
            counts.setdefault(row_of(kind, made), Count()).add(made, found)
            if made.is_broken and kind != "right":
                if residuals_look_right(found):
                    counts.setdefault("of the broken, residuals at noise level", Count()).add(made, found)
                told.update(name for name, (value, limit) in found.statistics.items() if value > limit)
            if found.passed == made.is_broken and (made.is_broken or kind == "right"):
                why = found.reasons[0] if found.reasons else "nothing found"
                mistakes.append(f"{kind}, {made.name}, {made.ratio:.1f} times the optimum: {why}")
    return counts, told, mistakes


def row_of(kind: str, made: Reconstruction) -> str:
    """Name the row of the table that a scene belongs to."""
    if kind == "right":
        return "right" if made.ratio <= RIGHT_RATIO else "not sabotaged, yet broken or disturbed"
    if made.is_broken:
        return f"broken: {kind}"
    return "sabotage resisted" if made.ratio <= RIGHT_RATIO else "sabotage resisted, but disturbed"


def speed(n_views: int, n_points: int, repeats: int) -> str:
    """Time of the check beside that of the solve, in the same run."""
    world = pp.simulate(
        "street",
        n_views=n_views,
        n_points=n_points,
        noise_rad=radians(0.05),
        outlier_fraction=0.1,
        orientations="random",
    )
    solving, checking = [], []
    for _ in range(repeats):
        began = time.perf_counter()
        scene = pp.solve_positions(world.tracks, world.cam_from_world)
        solving.append(time.perf_counter() - began)
        began = time.perf_counter()
        pp.check_consistency(world.tracks, scene)
        checking.append(time.perf_counter() - began)
    return (
        f"street, {n_views} views, {len(world.tracks)} observations: check {median(checking):.3f} s, "
        f"solve_positions {median(solving):.3f} s (medians of {repeats})"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--each", type=int, default=25, help="broken scenes of each kind; four times as many right ones"
    )
    parser.add_argument("--seed", type=int, default=FRESH_SEED)
    parser.add_argument("--repeats", type=int, default=3, help="of the timing on the large street; 0: none")
    chosen = parser.parse_args()
    counts, told, mistakes = judge(chosen.each, chosen.seed)
    print(f"{'scenes':<44} {'number':>6} {'gate flags':>16} {'status alone':>16} {'noise alone':>16}")
    for name in sorted(counts):
        print(counts[name].row(name))
    broken = Count()
    for name, count in counts.items():
        if name.startswith("broken:"):
            broken = Count(
                *(getattr(broken, key) + getattr(count, key) for key in ("scenes", "gate", "status", "noise"))
            )
    print(broken.row("broken, all kinds"))
    print("figures beyond their limit in broken scenes:", ", ".join(f"{name} {n}" for name, n in told.most_common()))
    for mistake in mistakes:
        print("mistaken:", mistake)
    if chosen.repeats:
        print(speed(1000, 100_000, chosen.repeats))


if __name__ == "__main__":
    main()
