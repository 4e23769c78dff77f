"""From pictures to poses, ours beside the peer, on the same frames: ``python -m benchmarks.frontend [NAME ...]``.

Ours is ``measure`` and ``map_database``; the peer pycolmap: ``extract_features``, matching of all pairs (of neighbours
where there are more than 40 frames) and ``global_mapping``, with equirectangular cameras on the processor. Real frames
have no truth: what is compared is time, frames with a pose, and how far observations miss.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from panopath.frontend import FrontEndOptions, SourceKind, measure, recognise
from panopath.frontend.images import read_image
from panopath.mapping import MapOptions, map_database

from benchmarks.databases import global_mapping
from benchmarks.optional import load

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
CASES = {
    "kerry_park": "kerry_park/equirectangular",
    "kerry_park rig": "kerry_park",
    "odmax_forest": "odmax_forest/forest.mp4",
    "geovisio_gopromax": "geovisio_gopromax",
    "stella_pair": "stella_pair",
}
#: Width at which both take the frames.
WIDTH = 1600
_EXHAUSTIVE = 40


@dataclass(frozen=True)
class Row:
    """One way over one case."""

    case: str
    way: str
    stages: dict[str, float]
    #: Seconds of processor time, which other work on the machine hardly changes.
    cpu_s: float
    registered: int
    of: int
    points: int
    observations: int
    #: Root mean square of the angles that kept observations miss by, along each axis, degrees.
    miss_deg: float


def ours(case: str, path: Path, frames: Path | None) -> Row:
    cv2 = load("cv2")

    def keep(picture: object) -> None:
        if frames is not None:
            cv2.imwrite(str(frames / Path(picture.name).name), picture.gray, [cv2.IMWRITE_JPEG_QUALITY, 95])  # type: ignore[attr-defined]

    cpu = time.process_time()
    source = recognise(path)
    print(f"  {source.description}")
    found = measure(source, FrontEndOptions(width=WIDTH), each=None if source.kind is SourceKind.RIG else keep)
    began = time.perf_counter()
    scene = map_database(found.database, MapOptions()).scene
    stages = {**found.seconds, "mapping": time.perf_counter() - began}
    registered = int((scene.view_component == 0).sum())
    miss = np.degrees(np.sqrt(np.mean(scene.residual_rad[scene.inlier] ** 2) / 2))
    cpu = time.process_time() - cpu
    return Row(case, "ours", stages, cpu, registered, found.database.n_frames, len(scene.points),
               int(scene.inlier.sum()), float(miss))  # fmt: skip


def peer(case: str, frames: Path) -> Row:
    pycolmap = load("pycolmap")
    pycolmap.logging.minloglevel = 2
    names = sorted(path.name for path in frames.iterdir())
    height, width = read_image(frames / names[0]).shape
    stages, cpu = {}, time.process_time()
    with tempfile.TemporaryDirectory() as place:
        database = Path(place) / "database.db"
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model, reader.camera_params = "EQUIRECTANGULAR", f"{width},{height}"
        began = time.perf_counter()
        pycolmap.extract_features(
            database, frames, names, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader,
            device=pycolmap.Device.cpu,
        )  # fmt: skip
        stages["features"] = time.perf_counter() - began
        began = time.perf_counter()
        match = pycolmap.match_exhaustive if len(names) <= _EXHAUSTIVE else pycolmap.match_sequential
        match(database, device=pycolmap.Device.cpu)
        stages["matching"] = time.perf_counter() - began
        stages["mapping"] = global_mapping(database, Path(place) / "out")
        cpu = time.process_time() - cpu
        models = [pycolmap.Reconstruction(str(p.parent)) for p in (Path(place) / "out").glob("*/images.bin")]
    if not models:
        return Row(case, "pycolmap", stages, cpu, 0, len(names), 0, 0, float("nan"))
    best = max(models, key=lambda model: model.num_reg_images())
    error_px = best.compute_mean_reprojection_error()
    return Row(case, "pycolmap", stages, cpu, best.num_reg_images(), len(names), len(best.points3D),
               best.compute_num_observations(), float(error_px * 360.0 / width))  # fmt: skip


def show(row: Row) -> None:
    stages = ", ".join(f"{name} {seconds:.1f}" for name, seconds in row.stages.items())
    print(
        f"  {row.way:9} {sum(row.stages.values()):7.1f} s, {row.cpu_s:7.1f} cpu s ({stages}); "
        f"{row.registered}/{row.of} frames, "
        f"{row.points} points, {row.observations} observations, miss {row.miss_deg:.4f} deg",
        flush=True,
    )


def main(names: list[str] | None = None) -> None:
    for case in names or list(CASES):
        path = DATA / CASES.get(case, case) if case in CASES else Path(case)
        print(case, flush=True)
        if not path.exists():
            print("  absent: skipped")
            continue
        with tempfile.TemporaryDirectory() as place:
            frames = Path(place)
            show(ours(case, path, frames))
            if any(frames.iterdir()):
                show(peer(case, frames))


if __name__ == "__main__":
    main(sys.argv[1:])
