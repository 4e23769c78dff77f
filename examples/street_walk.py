"""A walk with a panoramic camera: simulate, solve, compare with the truth and with the best possible, write files.

Run: ``python examples/street_walk.py [FOLDER]``. The folder (default ``out/street_walk``) is for COLMAP, PLY viewers
and spreadsheets.
"""

from __future__ import annotations

import importlib.util
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import panopath as pp


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/street_walk")
    world = pp.simulate(
        "street",
        n_views=60,
        n_points=3000,
        seed=4,
        noise_rad=np.radians(0.05),
        outlier_fraction=0.1,
        orientations="random",
    )
    begin = time.perf_counter()
    scene = pp.solve_positions(world.tracks, world.cam_from_world)
    seconds = time.perf_counter() - begin
    result = pp.evaluate(scene, world, alignment="translation_scale")

    with_sigma = replace(world.tracks, sigma_rad=np.full(len(world.tracks), world.noise_rad))
    truth = (world.centers, world.points)
    covariance = pp.position_covariance(with_sigma, truth, world.cam_from_world, inlier=~world.outlier)
    best_rms_m = float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))

    print(f"{world.tracks!r}")
    print(f"{scene.summary.status.value} in {seconds:.2f} s; {int((~scene.inlier).sum())} bearings set aside")
    print(f"noise: told {np.degrees(world.noise_rad):.3f} deg, found {np.degrees(scene.summary.sigma_rad):.3f} deg")
    print(f"camera error {1e3 * result.camera_rms:.2f} mm rms; the best possible is {1e3 * best_rms_m:.2f} mm")
    print(f"median error of a point: {100.0 * result.point_relative_median:.2f} % of its distance")

    pp.write_scene(scene, folder)
    print(f"written: {', '.join(sorted(path.name for path in folder.iterdir()))} in {folder}")
    if importlib.util.find_spec("pycolmap") is None:
        print('to check the COLMAP model here: pip install "panopath[colmap]"')
        return
    model = importlib.import_module("pycolmap").Reconstruction(folder / "colmap" / "0")
    print(
        f"pycolmap opens it: {model.num_reg_images()} images, {model.num_points3D()} points, "
        f"mean reprojection error {model.compute_mean_reprojection_error():.2f} px"
    )


if __name__ == "__main__":
    main()
