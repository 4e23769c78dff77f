"""Study of mean motion: error of the orientation against baseline over depth, and against the number of steps.

``python -m docs.figures_motion`` prints the table of docs/method/mean-motion.md and draws its picture.
"""

from __future__ import annotations

import importlib
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
from matplotlib.figure import Figure

Float = npt.NDArray[np.float64]

NOISE_RAD = np.radians(0.05)
N_POINTS, N_STEPS, REPEATS = 300, 64, 5
RATIOS = (1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.3)
FIELDS = {"all round": np.pi, "one side": np.radians(45.0)}
METHODS = {
    "printed: mean (theta, phi) flow": pp.MotionOptions(flow="horizon", weighting="mean"),
    "sphere, mean": pp.MotionOptions(weighting="mean"),
    "sphere, slowest quarter": pp.MotionOptions(weighting="slowest", share=0.25),
    "sphere, robust": pp.MotionOptions(weighting="robust"),
}
COLORS = ("#999999", "#1f5fa8", "#f0a020", "#d62728")


def main() -> None:
    ratio_errors = {
        field: np.array([[mean_errors(ratio, half, options)[0] for ratio in RATIOS] for options in METHODS.values()])
        for field, half in FIELDS.items()
    }
    drift = {
        field: np.array([mean_errors(0.01, half, options)[1] for options in METHODS.values()])
        for field, half in FIELDS.items()
    }
    print_table(ratio_errors, drift)
    print_peer()
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for field, style in zip(FIELDS, ("-", "--"), strict=True):
        for k, (name, color) in enumerate(zip(METHODS, COLORS, strict=True)):
            label = name if style == "-" else None
            left.loglog(RATIOS, ratio_errors[field][k], style, color=color, marker="o", markersize=3, label=label)
            right.loglog(np.arange(1, N_STEPS + 1), drift[field][k], style, color=color)
    left.set(xlabel="baseline of a step / nearest depth", ylabel="rms error of one turn (degrees)")
    left.set_title("Points all round (solid), in a quarter of the circle (dashed)")
    left.legend(fontsize=8)
    right.set(xlabel="steps", ylabel="rms error of the orientation (degrees)", title="Baseline / nearest depth = 0.01")
    path = Path(__file__).parent / "img" / "mean-motion.png"
    figure.savefig(path, dpi=110, metadata={"Software": None})


def mean_errors(ratio: float, half_field: float, options: pp.MotionOptions) -> tuple[float, Float]:
    """Rms error of a turn and of the orientation after each number of steps, degrees, over the repeats."""
    turns, orientations = [], []
    for seed in range(REPEATS):
        tracks, truth = walk(ratio, half_field, seed)
        motion = pp.mean_motion(tracks, options)
        turns.append(angle(motion.turn @ (truth[1:] @ truth[:-1].transpose(0, 2, 1)).transpose(0, 2, 1)))
        world_from_map = truth[0].T @ motion.cam_from_world[0]
        orientations.append(angle(motion.cam_from_world @ (truth @ world_from_map).transpose(0, 2, 1))[1:])
    return rms(np.array(turns).ravel()), np.degrees(np.sqrt((np.array(orientations) ** 2).mean(axis=0)))


def walk(ratio: float, half_field: float, seed: int) -> tuple[pp.Tracks, Float]:
    """Straight steps of length ``ratio`` past points that keep log-uniform distances of 1 to 100.

    The field of points goes along with the camera, so that every step is alike: each is seen from two views.
    """
    rng = np.random.default_rng(seed)
    truth = wander(rng, N_STEPS + 1)
    view, track, bearing = [], [], []
    for step in range(N_STEPS):
        azimuth = np.pi / 2 + half_field * rng.uniform(-1.0, 1.0, N_POINTS)
        elevation = np.radians(rng.uniform(-30.0, 30.0, N_POINTS))
        cos = np.cos(elevation)
        ray = np.column_stack([cos * np.cos(azimuth), cos * np.sin(azimuth), np.sin(elevation)])
        points = 100.0 ** rng.uniform(0.0, 1.0, N_POINTS)[:, None] * ray
        for k in (0, 1):
            offset = points - np.array([ratio * k, 0.0, 0.0])
            seen = offset @ truth[step + k].T
            seen = seen / np.linalg.norm(seen, axis=1, keepdims=True) + rng.normal(0.0, NOISE_RAD, seen.shape)
            bearing.append(seen / np.linalg.norm(seen, axis=1, keepdims=True))
            view.append(np.full(N_POINTS, step + k))
            track.append(step * N_POINTS + np.arange(N_POINTS))
    return pp.Tracks.from_arrays(np.concatenate(view), np.concatenate(track), np.concatenate(bearing)), truth


def wander(rng: np.random.Generator, n: int) -> Float:
    """Orientations of a camera that turns about the vertical by about 3 degrees a step and sways by 0.3."""
    heading = np.cumsum(np.radians(rng.normal(0.0, 3.0, n)))
    pitch, roll = np.radians(rng.normal(0.0, 0.3, (2, n)))
    return np.stack([about(1, p) @ about(0, r) @ about(2, -h) for h, p, r in zip(heading, pitch, roll, strict=True)])


def about(axis: int, angle_rad: float) -> Float:
    rotation = np.eye(3)
    i, k = (axis + 1) % 3, (axis + 2) % 3
    rotation[i, i] = rotation[k, k] = np.cos(angle_rad)
    rotation[i, k], rotation[k, i] = -np.sin(angle_rad), np.sin(angle_rad)
    return rotation


def angle(rotations: Float) -> Float:
    chord = np.linalg.norm(rotations - np.eye(3), axis=(1, 2)) / np.sqrt(8.0)
    return np.asarray(2.0 * np.arcsin(np.minimum(chord, 1.0)))


def rms(angles_rad: Float) -> float:
    return float(np.degrees(np.sqrt((angles_rad**2).mean())))


def print_table(ratio_errors: dict[str, Any], drift: dict[str, Any]) -> None:
    print("rms error of one turn in degrees, against baseline / nearest depth")
    print("| points | method |" + "".join(f" {ratio:g} |" for ratio in RATIOS) + f" {N_STEPS} steps of 0.01 |")
    print("|---|---|" + "---|" * (len(RATIOS) + 1))
    for field in FIELDS:
        for k, name in enumerate(METHODS):
            cells = "".join(f" {error:.3f} |" for error in ratio_errors[field][k])
            print(f"| {field} | {name} |{cells} {drift[field][k][-1]:.2f} |")


def print_peer() -> None:
    """Compare with scipy: the plain mean on the sphere is Wahba's problem, which it solves too."""
    rotation: Any = importlib.import_module("scipy.spatial.transform").Rotation
    tracks, truth = walk(0.01, np.pi, 0)
    clock = time.perf_counter()
    found = pp.mean_motion(tracks, pp.MotionOptions(weighting="mean")).turn
    ours_s, clock = time.perf_counter() - clock, time.perf_counter()
    theirs = []
    for step in range(N_STEPS):
        rows = np.arange(2 * N_POINTS * step, 2 * N_POINTS * (step + 1))
        before, after = tracks.bearing[rows[:N_POINTS]], tracks.bearing[rows[N_POINTS:]]
        theirs.append(rotation.align_vectors(after, before)[0].as_matrix())
    theirs_s = time.perf_counter() - clock
    apart = angle(found @ np.array(theirs).transpose(0, 2, 1)).max()
    print(f"{len(truth) - 1} turns: mean_motion {1e3 * ours_s:.1f} ms, scipy align_vectors {1e3 * theirs_s:.1f} ms,")
    print(f"largest angle between them {apart:.1e} rad")


if __name__ == "__main__":
    main()
