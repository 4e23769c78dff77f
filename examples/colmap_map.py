"""From a COLMAP database to a COLMAP model: make one of panoramas, map it, compare with the truth.

Run: ``python examples/colmap_map.py [FOLDER]``. The folder (default ``out/colmap_map``) gets the database and the
models. Your own database: ``panopath map database.db -o FOLDER``. Needs pycolmap.
"""

from __future__ import annotations

import importlib
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
from panopath.evaluate import fit_similarity

N_IMAGES, N_POINTS, NOISE_PX = 25, 400, 1.0


def make_database(path: Path) -> dict[str, Any]:
    """Write features and matches of a made-up scene; the true centres of the images."""
    pycolmap = importlib.import_module("pycolmap")
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(1)
    what = pycolmap.SyntheticDatasetOptions()
    what.camera_model_id = pycolmap.CameraModelId.EQUIRECTANGULAR
    what.camera_width, what.camera_height, what.camera_params = 3840, 1920, [3840.0, 1920.0]
    what.num_rigs, what.num_frames_per_rig, what.num_points3D = 1, N_IMAGES, N_POINTS
    path.unlink(missing_ok=True)
    database = pycolmap.Database.open(str(path))
    truth = pycolmap.synthesize_dataset(what, database)
    noise = pycolmap.SyntheticNoiseOptions()
    noise.point2D_stddev = NOISE_PX
    pycolmap.synthesize_noise(noise, truth, database)
    database.close()
    return {image.name: image.projection_center() for image in truth.images.values()}


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/colmap_map")
    folder.mkdir(parents=True, exist_ok=True)
    truth = make_database(folder / "database.db")

    begin = time.perf_counter()
    database = pp.read_database(folder / "database.db")
    mapped = pp.map_database(database, report=lambda stage: print(f"  {stage}"))
    written = pp.write_models(database, mapped.reconstruction, folder)
    print(f"{database!r}")
    print(f"{mapped.scene.summary.status.value} in {time.perf_counter() - begin:.2f} s")

    centers = np.array([truth[name] for name in database.image_names])
    placed = mapped.reconstruction.component == 0
    scale, turn, shift = fit_similarity(mapped.reconstruction.centers[placed], centers[placed])
    error = scale * mapped.reconstruction.centers[placed] @ turn.T + shift - centers[placed]
    extent = np.sqrt(((centers - centers.mean(axis=0)) ** 2).sum(axis=1).mean())
    relative = np.sqrt((error**2).sum(axis=1).mean()) / extent
    print(f"{placed.sum()} of {len(placed)} images; camera error {100.0 * relative:.4f} % of the size of the scene")

    model = importlib.import_module("pycolmap").Reconstruction(written[0])
    print(
        f"pycolmap opens it: {model.num_reg_images()} images, {model.num_points3D()} points, "
        f"mean reprojection error {model.compute_mean_reprojection_error():.2f} px"
    )


if __name__ == "__main__":
    main()
