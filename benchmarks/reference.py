"""The optimum of a BAL problem by COLMAP's bundle adjustment, on pixels: a reference that shares no code with ours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from panopath.model import Float, Int

from benchmarks.optional import load

#: BAL looks along -z with y up, COLMAP along +z with y down.
COLMAP_FROM_BAL = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Bundle:
    """A bundle-adjusted problem: what was seen, as bearings of the adjusted cameras, and where everything is."""

    view: Int
    track: Int
    #: (N, 3) unit vectors in the camera.
    bearing: Float
    #: (n_views, 3, 3), (n_views, 3), (n_tracks, 3)
    cam_from_world: Float
    centers: Float
    points: Float
    #: Observations that COLMAP dropped because their point lay behind the camera.
    n_dropped: int
    #: Rms reprojection error in pixels before and after.
    rms_before_px: float
    rms_after_px: float


@dataclass(frozen=True)
class _BalProblem:
    view: Int
    track: Int
    pixel: Float
    #: (n_views, 9): rotation vector, translation, f, k1, k2
    cameras: Float
    points: Float


def _read_bal(path: Path) -> _BalProblem:
    """Read the numbers of a BAL file, nothing interpreted."""
    numbers = np.fromstring(path.read_text(encoding="ascii"), sep=" ")
    n_views, n_tracks, n = (int(x) for x in numbers[:3])
    seen = numbers[3 : 3 + 4 * n].reshape(n, 4)
    rest = numbers[3 + 4 * n :]
    if len(rest) != 9 * n_views + 3 * n_tracks:
        raise ValueError(f"{path}: {len(rest)} parameters, expected {9 * n_views + 3 * n_tracks}")
    return _BalProblem(
        seen[:, 0].astype(np.int32),
        seen[:, 1].astype(np.int32),
        seen[:, 2:],
        rest[: 9 * n_views].reshape(n_views, 9),
        rest[9 * n_views :].reshape(n_tracks, 3),
    )


def bundle_adjust_bal(path: Path, *, fixed_rotations: bool) -> Bundle:
    """Adjust a BAL file to the least sum of squared pixel errors.

    Everything is free (poses, points, focal lengths, k1, k2), or, with ``fixed_rotations``, only positions and points:
    the problem that known orientations leave.
    """
    pycolmap = load("pycolmap")
    pycolmap.logging.minloglevel = 2
    problem = _read_bal(path)
    reconstruction = _reconstruction(problem)
    before = _rms_px(reconstruction)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = not fixed_rotations
    options.constant_rig_from_world_rotation = fixed_rotations
    options.print_summary = False
    options.ceres.solver_options.max_num_iterations = 300
    options.ceres.solver_options.function_tolerance = 1e-12
    pycolmap.bundle_adjustment(reconstruction, options)
    images = [reconstruction.image(view + 1) for view in range(len(problem.cameras))]
    points = np.full((len(problem.points), 3), np.nan)
    for point_id, point in reconstruction.points3D.items():
        points[point_id - 1] = point.xyz
    seen, tracks, bearings = [], [], []
    for view, image in enumerate(images):
        held = image.get_observation_points2D()
        plane = reconstruction.camera(view + 1).cam_from_img(np.array([point.xy for point in held]))
        seen.append(np.full(len(held), view, dtype=np.int32))
        tracks.append(np.array([point.point3D_id - 1 for point in held], dtype=np.int32))
        bearings.append(np.column_stack([plane, np.ones(len(plane))]))
    bearing = np.vstack(bearings)
    return Bundle(
        view=np.concatenate(seen),
        track=np.concatenate(tracks),
        bearing=bearing / np.linalg.norm(bearing, axis=1, keepdims=True),
        cam_from_world=np.array([image.cam_from_world().rotation.matrix() for image in images]),
        centers=np.array([image.projection_center() for image in images]),
        points=points,
        n_dropped=len(problem.view) - len(bearing),
        rms_before_px=before,
        rms_after_px=_rms_px(reconstruction),
    )


def _reconstruction(problem: _BalProblem) -> Any:
    """One RADIAL camera an image, as BAL has it: a focal length and two distortion terms, centre at zero."""
    pycolmap = load("pycolmap")
    rotation = load("scipy.spatial.transform").Rotation
    reconstruction = pycolmap.Reconstruction()
    slot = np.empty(len(problem.view), dtype=np.int64)
    for view, camera in enumerate(problem.cameras):
        model = pycolmap.Camera(
            camera_id=view + 1, model="RADIAL", width=1, height=1, params=[camera[6], 0.0, 0.0, camera[7], camera[8]]
        )
        reconstruction.add_camera_with_trivial_rig(model)
        rows = np.flatnonzero(problem.view == view)
        slot[rows] = np.arange(len(rows))
        image = pycolmap.Image(
            name=f"{view:03d}",
            keypoints=problem.pixel[rows] * [1.0, -1.0],
            camera_id=view + 1,
            image_id=view + 1,
        )
        cam_from_world = COLMAP_FROM_BAL @ rotation.from_rotvec(camera[:3]).as_matrix()
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(cam_from_world), COLMAP_FROM_BAL @ camera[3:6])
        reconstruction.add_image_with_trivial_frame(image, pose)
    for track, point in enumerate(problem.points):
        elements = pycolmap.Track()
        for o in np.flatnonzero(problem.track == track):
            elements.add_element(int(problem.view[o]) + 1, int(slot[o]))
        reconstruction.add_point3D(point, elements)
    return reconstruction


def _rms_px(reconstruction: Any) -> float:
    """Root mean square length of the reprojection errors."""
    total, count = 0.0, 0
    for image in reconstruction.images.values():
        for point in image.get_observation_points2D():
            seen = image.project_point(reconstruction.point3D(point.point3D_id).xyz)
            if seen is not None:
                total += float(((seen - point.xy) ** 2).sum())
                count += 1
    return float(np.sqrt(total / count))
