"""One measurement in a fresh process: ``python -m benchmarks.job WHAT SPEC.json ANSWER.json``.

A process of its own gives each solver a clean start (no warm caches, no memory of the one before), survives a peer
that aborts, and can be stopped when it takes too long.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
from panopath.synthetic import SyntheticWorld

from benchmarks.cases import NOISE_DEG, Case
from benchmarks.peers import PEERS, Bearings
from benchmarks.scoring import camera_rms, rms


@dataclass(frozen=True)
class Spec:
    """Which scene."""

    world: str
    options: dict[str, Any]
    seed: int

    @classmethod
    def of(cls, case: Case, seed: int) -> Spec:
        """Scene ``seed`` of a case."""
        return cls(case.world, case.options, seed)

    def simulate(self) -> SyntheticWorld:
        """Make the scene; the same bytes in every process."""
        return pp.simulate(self.world, seed=self.seed, noise_rad=radians(NOISE_DEG), **self.options)


def in_fresh_process(what: str, spec: Spec, time_limit_s: float) -> dict[str, Any]:
    """Measure ``what`` (see ``MEASUREMENTS``); a failure or timeout comes back as ``{"error": text}``."""
    with tempfile.TemporaryDirectory() as folder:
        question, answer = Path(folder) / "spec.json", Path(folder) / "answer.json"
        question.write_text(json.dumps(spec.__dict__), encoding="utf-8")
        return answer_of(
            [sys.executable, "-m", "benchmarks.job", what, str(question), str(answer)], answer, time_limit_s
        )


def answer_of(command: Sequence[str], answer: Path, time_limit_s: float) -> dict[str, Any]:
    """Run a process that leaves a JSON object; a failure or timeout comes back as ``{"error": text}``."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=time_limit_s, check=False)
    except subprocess.TimeoutExpired:
        return {"error": f"stopped after {time_limit_s:.0f} s", "seconds_at_least": time_limit_s}
    if not answer.exists():
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return {"error": f"exit code {done.returncode}: {last[:200]}"}
    return dict(json.loads(answer.read_text(encoding="utf-8")))


def fingerprint(world: SyntheticWorld) -> str:
    """Hash of the observations and orientations, equal where two solvers saw the same."""
    digest = hashlib.sha256()
    for array in (world.tracks.view, world.tracks.track, world.tracks.bearing, world.cam_from_world):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


def _describe(world: SyntheticWorld) -> dict[str, Any]:
    return {
        "n_views": world.tracks.n_views,
        "n_tracks": world.tracks.n_tracks,
        "n_observations": len(world.tracks),
        "fingerprint": fingerprint(world),
    }


def measure_ours(spec: Spec) -> dict[str, Any]:
    """Time, memory and error of our solve; memory is the peak above a process that already holds the input."""
    world = spec.simulate()
    tracks, cam_from_world, description = world.tracks, world.cam_from_world, _describe(world)
    centers = world.centers
    del world
    _give_back_freed()
    before_mb = _resident_mb()
    _forget_peak()
    began = time.perf_counter()
    scene = pp.solve_positions(tracks, cam_from_world)
    seconds = time.perf_counter() - began
    peak = peak_mb()
    return {
        **description,
        "seconds": seconds,
        "rms": camera_rms(scene.centers, centers),
        "memory_mb": peak - before_mb,
        "status": scene.summary.status.value,
        "iterations": scene.summary.iterations,
        "sigma_deg": float(np.degrees(scene.summary.sigma_rad)),
        "stages": dict(scene.summary.seconds),
        "n_components": scene.summary.n_components,
        "n_solved_views": scene.summary.n_solved_views,
        "inlier_fraction": float(scene.inlier.mean()),
    }


def measure_optimum(spec: Spec) -> dict[str, Any]:
    """Error of the optimum itself: our refinement started from the truth, on the true inliers alone."""
    world = spec.simulate()
    scene = pp.solve_positions(
        world.tracks.select(~world.outlier), world.cam_from_world, start=(world.centers, world.points)
    )
    return {**_describe(world), "rms": camera_rms(scene.centers, world.centers), "status": scene.summary.status.value}


def measure_bound(spec: Spec) -> dict[str, Any]:
    """Cramer-Rao bound of the rms camera error over the true inliers."""
    world = spec.simulate()
    began = time.perf_counter()
    covariance = pp.position_covariance(
        world.tracks, (world.centers, world.points), world.cam_from_world, inlier=~world.outlier
    )
    seconds = time.perf_counter() - began
    deviation = world.noise_rad * np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    return {**_describe(world), "rms": rms(deviation), "seconds": seconds}


def measure_peer(name: str, spec: Spec) -> dict[str, Any]:
    """Time and error of a peer on the same scene."""
    world = spec.simulate()
    tracks = world.tracks
    problem = Bearings(
        tracks.view,
        tracks.track,
        tracks.bearing,
        world.cam_from_world,
        tracks.n_views,
        tracks.n_tracks,
        world.noise_rad,
    )
    result = PEERS[name](problem, spec.seed)
    return {
        **_describe(world),
        "seconds": result.seconds,
        "preparation_seconds": result.preparation_seconds,
        "rms": camera_rms(result.centers, world.centers),
        "n_inputs": result.n_inputs,
        "notes": result.notes,
        "peak_mb": peak_mb(),
    }


def measure(what: str, spec: Spec) -> dict[str, Any]:
    """``ours``, ``optimum``, ``bound`` or the name of a peer."""
    measurements = {"ours": measure_ours, "optimum": measure_optimum, "bound": measure_bound}
    return measurements[what](spec) if what in measurements else measure_peer(what, spec)


def _status_mb(name: str) -> float | None:
    """Read a figure of this process from the Linux kernel's own account, or None on another system."""
    path = Path("/proc/self/status")
    if not path.exists():
        return None
    for line in path.read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith(name + ":"):
            return int(line.split()[1]) / 1024
    return None


def _resident_mb() -> float:
    held = _status_mb("VmRSS")
    return peak_mb() if held is None else held


def peak_mb() -> float:
    """Peak of this process's memory; ``ru_maxrss`` alone would include the process that started it (Linux)."""
    peak = _status_mb("VmHWM")
    if peak is not None:
        return peak
    unit = 1 if platform.system() == "Darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def _forget_peak() -> None:
    """Start the peak anew (Linux), so that making the input does not hide what the solve takes.

    Elsewhere the figure is the growth of the peak, which may be less than what the solve took.
    """
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return


def _give_back_freed() -> None:
    """Hand freed memory back to the system (glibc): kept pages would be counted as input and reused by the solve."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def main(arguments: list[str]) -> None:
    """Entry of the fresh process."""
    what, question, answer = arguments
    spec = Spec(**json.loads(Path(question).read_text(encoding="utf-8")))
    result = measure(what, spec)
    Path(answer).write_text(json.dumps(result), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
