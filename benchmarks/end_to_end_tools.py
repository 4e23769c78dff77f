"""The two tools of ``benchmarks.end_to_end``, each in a process of its own.

``python -m benchmarks.end_to_end_tools TOOL SOURCE OUT ANSWER.json`` with ``panopath`` (a video or a folder of images)
or ``pycolmap`` (a folder of images). A process times its own work, from the source to the model on disk, and tells its
peak memory and the seconds of processor time that it took. What is imported when it is called for counts; so do all
files that ours writes, the report and the certificate among them.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.databases import global_mapping
from benchmarks.job import answer_of, peak_mb
from benchmarks.optional import load

Answer = dict[str, Any]

#: Points that two views share when they count as a closed loop, and how far they are at most, of the whole path: hills
#: and clouds are seen from everywhere, and close nothing.
_SHARED, _NEAR = 15, 0.1


def in_fresh_process(tool: str, source: Path, out: Path, time_limit_s: float) -> Answer:
    """Run a tool; a failure or timeout comes back as ``{"error": text}``."""
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        command = [sys.executable, "-m", "benchmarks.end_to_end_tools", tool, str(source), str(out), str(answer)]
        return answer_of(command, answer, time_limit_s)


def panopath(source: Path, out: Path) -> Answer:
    """``pp.reconstruct`` with its defaults."""
    import panopath as pp  # noqa: PLC0415 a peer's process must not hold it

    done = pp.reconstruct(source, out)
    scene = done.scene
    return {
        "names": list(scene.view_labels()),
        "centers": scene.centers.tolist(),
        "n_points": len(scene.points),
        "stages": done.seconds,
        "is_determined": done.is_determined,
        "statements": list(done.statements),
        "n_loop_pairs": _loop_pairs(scene),
    }


def _loop_pairs(scene: Any) -> int:
    """Pairs of views more than half the sequence apart that see the same points near by."""
    n, tracks = len(scene.centers), scene.tracks
    length = np.linalg.norm(np.diff(scene.centers[np.isfinite(scene.centers).all(axis=1)], axis=0), axis=1).sum()
    distance = np.linalg.norm(scene.points[tracks.track] - scene.centers[tracks.view], axis=1)
    kept = scene.inlier & (distance < _NEAR * length)
    seen = np.zeros((n, len(scene.points)), dtype=np.float32)
    seen[tracks.view[kept], tracks.track[kept]] = 1.0
    first, second = np.nonzero(seen @ seen.T >= _SHARED)
    return int((second - first > n / 2).sum())


def pycolmap(source: Path, out: Path) -> Answer:
    """Features, matching of neighbours, verification and the global mapper, with COLMAP's defaults."""
    colmap = load("pycolmap")
    colmap.logging.minloglevel = 2
    colmap.set_random_seed(0)
    names = sorted(path.name for path in source.iterdir())
    width, height = colmap.Bitmap.read(str(source / names[0]), as_rgb=False).to_array().shape[::-1]
    database = out / "database.db"
    out.mkdir(parents=True, exist_ok=True)
    reader = colmap.ImageReaderOptions()
    # without parameters this camera model makes the peer crash
    reader.camera_model, reader.camera_params = "EQUIRECTANGULAR", f"{width},{height}"
    stages = {}
    began = time.perf_counter()
    colmap.extract_features(
        database, source, names, camera_mode=colmap.CameraMode.SINGLE, reader_options=reader, device=colmap.Device.cpu
    )
    stages["features"] = time.perf_counter() - began
    began = time.perf_counter()
    pairing = colmap.SequentialPairingOptions()
    pairing.overlap = 10
    colmap.match_sequential(database, pairing_options=pairing, device=colmap.Device.cpu)
    stages["matching"] = time.perf_counter() - began
    stages["mapping"] = global_mapping(database, out / "models")
    models = [colmap.Reconstruction(str(path.parent)) for path in (out / "models").glob("*/images.bin")]
    best = max(models, key=lambda model: int(model.num_reg_images()), default=None)
    posed = {} if best is None else {one.name: one.projection_center() for one in best.images.values() if one.has_pose}
    return {
        "names": names,
        "centers": [np.asarray(posed.get(name, np.full(3, np.nan))).tolist() for name in names],
        "n_points": 0 if best is None else len(best.points3D),
        "stages": stages,
    }


TOOLS: dict[str, Callable[[Path, Path], Answer]] = {"panopath": panopath, "pycolmap": pycolmap}


def main(arguments: list[str]) -> None:
    """Entry of the fresh process."""
    tool, source, out, answer = arguments
    wall, cpu = time.perf_counter(), time.process_time()
    result = TOOLS[tool](Path(source), Path(out))
    result |= {
        "seconds": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        "peak_mb": peak_mb(),
    }
    Path(answer).write_text(json.dumps(result), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
