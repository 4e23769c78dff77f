"""Adapters to other solvers of the same problem: each gets the observations in its own form and is timed alone.

Time is that of the peer's own solve; building its input and reading its answer are left out, in the peer's favour.
Options are the peer's defaults unless ``notes`` says otherwise.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from panopath.model import Float, Int

from benchmarks.directions import PairDirections, pairwise_directions
from benchmarks.optional import load

#: Bearings that a peer holds may differ from ours by rounding only.
SAME_BEARING = 1e-9
#: Equirectangular pictures of this width hold a bearing to the last bits of a double.
IMAGE_WIDTH = 2**24


@dataclass(frozen=True)
class Bearings:
    """Observations of known orientation, as every adapter gets them."""

    view: Int
    track: Int
    #: (N, 3) unit vectors in the camera.
    bearing: Float
    #: (n_views, 3, 3)
    cam_from_world: Float
    n_views: int
    n_tracks: int
    noise_rad: float

    def world_directions(self) -> Float:
        """(N, 3) unit vectors in the world."""
        return np.asarray(np.einsum("nji,nj->ni", self.cam_from_world[self.view], self.bearing))


@dataclass(frozen=True)
class PeerResult:
    """What a peer found."""

    #: (n_views, 3), NaN where it gave none.
    centers: Float
    #: (n_tracks, 3), or None where the method has no points.
    points: Float | None
    #: The peer's own solve only.
    seconds: float
    #: What it was given: observations, or directions between views.
    n_inputs: int
    notes: str = ""
    #: Estimating pairwise directions from the bearings (our numpy), for peers that cannot take bearings.
    preparation_seconds: float = 0.0


def pycolmap_global_positioning(problem: Bearings, seed: int = 0) -> PeerResult:
    """COLMAP's global positioning, points and cameras from a random start, equirectangular cameras."""
    pycolmap = load("pycolmap")

    pycolmap.logging.minloglevel = 2
    reconstruction = _pycolmap_reconstruction(problem)
    n_inputs = _check_pycolmap_input(reconstruction, problem)
    options = pycolmap.GlobalPositionerOptions()
    options.random_seed = seed
    began = time.perf_counter()
    success = pycolmap.run_global_positioning(options, pycolmap.PoseGraph(), reconstruction)
    seconds = time.perf_counter() - began
    centers = np.array([reconstruction.image(i + 1).projection_center() for i in range(problem.n_views)])
    points = np.full((problem.n_tracks, 3), np.nan)
    for point_id, point in reconstruction.points3D.items():
        points[point_id - 1] = point.xyz
    notes = f"default options, random start {seed}"
    return PeerResult(centers, points, seconds, n_inputs, notes if success else f"{notes}; it reports failure")


def _pycolmap_reconstruction(problem: Bearings) -> Any:
    """Images of one equirectangular camera, rotations set, positions and points at zero, tracks by point id."""
    pycolmap = load("pycolmap")

    camera = pycolmap.Camera.create_from_model_name(1, "EQUIRECTANGULAR", 1.0, IMAGE_WIDTH, IMAGE_WIDTH // 2)
    pixels = camera.img_from_cam(problem.bearing)
    reconstruction = pycolmap.Reconstruction()
    reconstruction.add_camera_with_trivial_rig(camera)
    by_view = np.argsort(problem.view, kind="stable")
    first = np.searchsorted(problem.view[by_view], np.arange(problem.n_views + 1))
    slot = np.empty(len(by_view), dtype=np.int64)
    slot[by_view] = np.arange(len(by_view)) - first[problem.view[by_view]]
    for view in range(problem.n_views):
        seen = by_view[first[view] : first[view + 1]]
        image = pycolmap.Image(name=f"{view:06d}", keypoints=pixels[seen], camera_id=1, image_id=view + 1)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(problem.cam_from_world[view]), np.zeros(3))
        reconstruction.add_image_with_trivial_frame(image, pose)
    by_track = np.argsort(problem.track, kind="stable")
    first = np.searchsorted(problem.track[by_track], np.arange(problem.n_tracks + 1))
    image_ids, slots = (problem.view[by_track] + 1).tolist(), slot[by_track].tolist()
    for track in range(problem.n_tracks):
        elements = pycolmap.Track()
        for o in range(first[track], first[track + 1]):
            elements.add_element(image_ids[o], slots[o])
        reconstruction.add_point3D(np.zeros(3), elements)
    return reconstruction


def _check_pycolmap_input(reconstruction: Any, problem: Bearings) -> int:
    """Read the bearings back from what the peer holds and compare them one by one; returns their number."""
    n_held = int(reconstruction.compute_num_observations())
    if n_held != len(problem.view):
        raise RuntimeError(f"pycolmap holds {n_held} observations, expected {len(problem.view)}")
    camera = reconstruction.camera(1)
    by_view = np.argsort(problem.view, kind="stable")
    first = np.searchsorted(problem.view[by_view], np.arange(problem.n_views + 1))
    for view in range(problem.n_views):
        seen = by_view[first[view] : first[view + 1]]
        image = reconstruction.image(view + 1)
        held = image.get_observation_points2D()
        if not np.array_equal([p.point3D_id for p in held], problem.track[seen] + 1):
            raise RuntimeError(f"pycolmap holds other tracks than ours in view {view}")
        rays = camera.cam_ray_from_img(np.array([p.xy for p in held]).reshape(-1, 2))
        difference = np.abs(rays - problem.bearing[seen]).max(initial=0.0)
        turn = np.abs(image.cam_from_world().rotation.matrix() - problem.cam_from_world[view]).max()
        if max(difference, turn) > SAME_BEARING:
            raise RuntimeError(f"pycolmap holds bearings of view {view} that differ from ours by {difference:.1e}")
    return n_held


def pytheia_lud(problem: Bearings, seed: int = 0) -> PeerResult:
    """Theia's least unsquared deviations (Ozyesil and Singer 2015) on pairwise directions."""
    pytheia = load("pytheia")

    options = pytheia.sfm.LeastUnsquaredDeviationPositionEstimatorOptions()
    return _run_theia(pytheia.sfm.LeastUnsquaredDeviationPositionEstimator(options), problem, seed)


def pytheia_nonlinear(problem: Bearings, seed: int = 0) -> PeerResult:
    """Theia's nonlinear position estimator (Wilson and Snavely 2014) on pairwise directions."""
    pytheia = load("pytheia")

    reconstruction = pytheia.sfm.Reconstruction()
    for view in range(problem.n_views):
        reconstruction.AddView(f"{view:06d}", True, float(view))
    options = pytheia.sfm.NonlinearPositionEstimatorOptions()
    return _run_theia(pytheia.sfm.NonlinearPositionEstimator(options, reconstruction), problem, seed)


def _run_theia(estimator: Any, problem: Bearings, seed: int) -> PeerResult:
    """Theia wants ``position_2`` in the frame of the first camera and orientations as rotation vectors."""
    pytheia = load("pytheia")
    as_rotation = load("scipy.spatial.transform").Rotation.from_matrix

    pairs, preparation = _directions(problem, seed)
    rotations = problem.cam_from_world
    in_first = np.einsum("nij,nj->ni", rotations[pairs.first], pairs.direction)
    second_from_first = np.einsum("nij,nkj->nik", rotations[pairs.second], rotations[pairs.first])
    turns = as_rotation(second_from_first).as_rotvec()
    orientation_vectors = as_rotation(rotations).as_rotvec()
    edges = {}
    for p, (i, j) in enumerate(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True)):
        edge = pytheia.sfm.TwoViewInfo()
        edge.position_2, edge.rotation_2 = in_first[p], turns[p]
        edge.num_verified_matches = int(pairs.n_shared[p])
        edges[i, j] = edge
    orientations = {view: orientation_vectors[view] for view in range(problem.n_views)}
    began = time.perf_counter()
    found = estimator.EstimatePositions(edges, orientations)
    seconds = time.perf_counter() - began
    centers = np.full((problem.n_views, 3), np.nan)
    for view, position in found.items():
        centers[view] = np.asarray(position).ravel()
    return PeerResult(centers, None, seconds, len(edges), "pairwise directions, no points", preparation)


def gtsam_translation_recovery(problem: Bearings, seed: int = 0) -> PeerResult:
    """GTSAM's translation recovery on pairwise directions, each with its own standard deviation."""
    gtsam = load("gtsam")

    pairs, preparation = _directions(problem, seed)
    measurements = []
    for i, j, direction, sigma in zip(
        pairs.first.tolist(), pairs.second.tolist(), pairs.direction, pairs.sigma_rad.tolist(), strict=True
    ):
        noise = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
        measurements.append(gtsam.BinaryMeasurementUnit3(i, j, gtsam.Unit3(direction), noise))
    solver = gtsam.TranslationRecovery()
    began = time.perf_counter()
    values = solver.run(measurements, 1.0)
    seconds = time.perf_counter() - began
    centers = np.full((problem.n_views, 3), np.nan)
    for view in values.keys():  # noqa: SIM118 (a gtsam.Values is not a dict)
        centers[view] = values.atPoint3(view)
    notes = "pairwise directions; uses neither points nor the epipolar ellipse of each direction, no robust loss"
    return PeerResult(centers, None, seconds, len(measurements), notes, preparation)


def _directions(problem: Bearings, seed: int) -> tuple[PairDirections, float]:
    """Estimate the directions; also the seconds they took."""
    began = time.perf_counter()
    directions = problem.world_directions()
    pairs = pairwise_directions(problem.view, problem.track, directions, problem.noise_rad, seed=seed)
    return pairs, time.perf_counter() - began


PEERS: dict[str, Callable[[Bearings, int], PeerResult]] = {
    "pycolmap": pycolmap_global_positioning,
    "pytheia_lud": pytheia_lud,
    "pytheia_nonlinear": pytheia_nonlinear,
    "gtsam": gtsam_translation_recovery,
}
