"""A robot with a compass and a ring of pixels: its path, and a map of the landmarks, in the plane.

The robot drives a figure of eight in a hall, knows its heading (a compass, good to 0.2 degrees), and sees landmarks in
its own frame as angles from straight ahead (0.3 degrees). Landmarks that it takes for one another spoil one bearing in
ten.

Run: ``python examples/robot_landmarks.py``
"""

from __future__ import annotations

import numpy as np
import panopath as pp
from panopath.cameras import bearings_from_circular

BEARING_NOISE_DEG = 0.3
HEADING_NOISE_DEG = 0.2
RANGE_M = 9.0


def main() -> None:
    rng = np.random.default_rng(3)
    turn = np.linspace(0.0, 2.0 * np.pi, 80, endpoint=False)
    path_m = np.stack((8.0 * np.sin(turn), 4.0 * np.sin(2.0 * turn)), axis=1)
    heading_rad = np.arctan2(8.0 * np.cos(2.0 * turn), 8.0 * np.cos(turn))
    landmarks_m = rng.uniform((-12.0, -8.0), (12.0, 8.0), (60, 2))

    between = landmarks_m[None, :, :] - path_m[:, None, :]
    view, track = np.nonzero(np.linalg.norm(between, axis=2) < RANGE_M)
    east, north = between[view, track].T
    seen_rad = np.arctan2(north, east) - heading_rad[view] + rng.normal(0.0, np.radians(BEARING_NOISE_DEG), len(view))
    confused = rng.random(len(view)) < 0.1
    seen_rad[confused] = rng.uniform(-np.pi, np.pi, int(confused.sum()))

    tracks = pp.Tracks.from_arrays(view, track, bearings_from_circular(seen_rad))
    compass_rad = heading_rad + rng.normal(0.0, np.radians(HEADING_NOISE_DEG), len(heading_rad))
    scene = pp.solve_positions(tracks, cam_from_world=compass_rad)
    result = pp.evaluate(scene, (path_m, landmarks_m), alignment="translation_scale")

    print(f"{tracks!r}: {scene.summary.status.value}")
    print(f"confused bearings: {int(confused.sum())}, of which {int((confused & ~scene.inlier).sum())} were found")
    print(f"path: {1e3 * result.camera_rms:.0f} mm rms over a course of 16 m by 8 m")
    print(f"landmarks: median error {1e3 * np.median(result.point_error[np.isfinite(result.point_error)]):.0f} mm")
    print("  robot found at    was at")
    for i in range(0, 80, 16):
        (x, y), (true_x, true_y) = result.aligned_centers[i], path_m[i]
        print(f"  {x:7.3f} {y:7.3f}   {true_x:7.3f} {true_y:7.3f}")


if __name__ == "__main__":
    main()
