"""Victoria Park: a reference map from everything the vehicle measured, and views for bearings alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from panopath.model import Float, Int

from benchmarks.optional import load
from benchmarks.planar_sets import VictoriaPark, turn

#: Standard deviations of the laser's sightings of a tree, as the reference takes them (a trunk is not a point).
BEARING_SIGMA_RAD = np.radians(2.0)
RANGE_SIGMA_M = 0.5
#: Poses between two updates of the reference.
UPDATE_EVERY = 10


@dataclass(frozen=True)
class Reference:
    """Poses and trees from odometry, bearings and ranges together."""

    #: (n_poses, 3) x, y, heading.
    poses: Float
    #: (n_trees, 2)
    trees: Float


@dataclass(frozen=True)
class Windows:
    """Stretches of the drive taken as one view each, standing at the pose in their middle."""

    view: Int
    tree: Int
    bearing_rad: Float
    #: (n_views,) pose at which each view stands.
    pose: Int
    #: Median angle by which moving a sighting to that pose changed its bearing.
    median_change_rad: float


def solve_reference(drive: VictoriaPark) -> Reference:
    """Map the park with GTSAM: incremental from the first pose on, then all at once, Huber loss on sightings."""
    gtsam = load("gtsam")
    pose_key = [gtsam.symbol("x", i) for i in range(len(drive.odometry) + 1)]
    tree_key = [gtsam.symbol("l", j) for j in range(drive.n_trees)]
    whole, values = _incremental(gtsam, drive, pose_key, tree_key)
    values = gtsam.LevenbergMarquardtOptimizer(whole, values).optimize()
    poses = [values.atPose2(key) for key in pose_key]
    return Reference(
        np.array([[pose.x(), pose.y(), pose.theta()] for pose in poses]),
        np.array([values.atPoint2(key) for key in tree_key]),
    )


def _incremental(gtsam: Any, drive: VictoriaPark, pose_key: list[int], tree_key: list[int]) -> tuple[Any, Any]:
    """Feed pose after pose; dead reckoning is off by a full turn and more, so no batch start exists."""
    noise = gtsam.noiseModel
    sighting_noise = noise.Robust.Create(
        noise.mEstimator.Huber.Create(1.345), noise.Diagonal.Sigmas(np.array([BEARING_SIGMA_RAD, RANGE_SIGMA_M]))
    )
    solver = gtsam.ISAM2(gtsam.ISAM2Params())
    whole, fresh, values = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph(), gtsam.Values()
    first = np.searchsorted(drive.pose, np.arange(len(pose_key) + 1))
    known: set[int] = set()
    pose = gtsam.Pose2(0.0, 0.0, 0.0)
    fresh.add(gtsam.PriorFactorPose2(pose_key[0], pose, noise.Isotropic.Sigma(3, 1e-6)))
    for i, key in enumerate(pose_key):
        if i > 0:
            step = gtsam.Pose2(*drive.odometry[i - 1])
            sigmas = noise.Diagonal.Sigmas(drive.odometry_sigma[i - 1].copy())
            fresh.add(gtsam.BetweenFactorPose2(pose_key[i - 1], key, step, sigmas))
            pose = pose.compose(step)
        values.insert(key, pose)
        for o in range(first[i], first[i + 1]):
            tree, (forward, left) = int(drive.tree[o]), drive.offset_m[o]
            bearing = gtsam.Rot2(float(np.arctan2(left, forward)))
            fresh.add(
                gtsam.BearingRangeFactor2D(key, tree_key[tree], bearing, float(np.hypot(forward, left)), sighting_noise)
            )
            if tree not in known:
                known.add(tree)
                values.insert(tree_key[tree], pose.transformFrom(np.array([forward, left])))
        if i % UPDATE_EVERY == 0 or i == len(pose_key) - 1:
            solver.update(fresh, values)
            whole.push_back(fresh)
            fresh, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            pose = solver.calculateEstimatePose2(key)
    return whole, solver.calculateEstimate()


def windows(drive: VictoriaPark, length_m: float) -> Windows:
    """Gather the sightings of each ``length_m`` of the drive in one view.

    A sighting is moved to the pose in the middle of its stretch with the odometry between the two poses and the
    laser's range. Views and trees seen fewer than three times over are left out again and again until none is.
    """
    reckoned = drive.dead_reckoning()
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(drive.odometry[:, 0], drive.odometry[:, 1]))])
    _, window = np.unique((travelled / length_m).astype(np.int64), return_inverse=True)
    middle = np.array([np.median(np.flatnonzero(window == w)).astype(int) for w in range(window.max() + 1)])
    at = middle[window[drive.pose]]
    tree_position = reckoned[drive.pose, :2] + turn(drive.offset_m, reckoned[drive.pose, 2])
    offset = turn(tree_position - reckoned[at, :2], -reckoned[at, 2])
    bearing = np.arctan2(offset[:, 1], offset[:, 0])
    change = np.angle(np.exp(1j * (bearing - np.arctan2(drive.offset_m[:, 1], drive.offset_m[:, 0]))))
    # several sightings of a tree in one stretch are one bearing: their mean on the circle
    pairs, row = np.unique(np.column_stack([window[drive.pose], drive.tree]), axis=0, return_inverse=True)
    mean = np.zeros(len(pairs), dtype=np.complex128)
    np.add.at(mean, row, np.exp(1j * bearing))
    keep = _core_of_graph(pairs[:, 0], pairs[:, 1], 3)
    kept_windows, view = np.unique(pairs[keep, 0], return_inverse=True)
    return Windows(
        view=view.astype(np.int32),
        tree=pairs[keep, 1].astype(np.int32),
        bearing_rad=np.angle(mean[keep]),
        pose=middle[kept_windows].astype(np.int32),
        median_change_rad=float(np.median(np.abs(change))),
    )


def _core_of_graph(a: npt.NDArray[np.int64], b: npt.NDArray[np.int64], degree: int) -> npt.NDArray[np.bool_]:
    """Edges that remain when nodes of lower degree are removed until none is left."""
    keep = np.ones(len(a), dtype=np.bool_)
    while True:
        count_a = np.bincount(a[keep], minlength=int(a.max()) + 1)
        count_b = np.bincount(b[keep], minlength=int(b.max()) + 1)
        smaller = keep & (count_a[a] >= degree) & (count_b[b] >= degree)
        if smaller.sum() == keep.sum():
            return keep
        keep = smaller
