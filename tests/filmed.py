"""Rendered walks, runs of ``reconstruct`` on them, and the command line; for ``test_reconstruct*``."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from panopath.cli import main
from panopath.evaluate import Evaluation, evaluate
from panopath.formats.folder import read_scene
from panopath.model import Float, Scene
from panopath.walk import Walk, WalkTruth

#: Files of a run that tell times, and so differ from run to run.
TIMED = {"run.json", "report.html"}


@dataclass(frozen=True)
class Film:
    """A walk on disk."""

    walk: Walk
    path: Path

    @property
    def truth(self) -> WalkTruth:
        return self.walk.truth

    @property
    def length_m(self) -> float:
        return float(np.linalg.norm(np.diff(self.truth.centers, axis=0), axis=1).sum())


def frames_of(scene: Scene) -> list[int]:
    """Frame that each view was taken from."""
    return [int("".join(c for c in name if c.isdigit())) for name in scene.view_labels()]


def compared(scene: Scene, film: Film) -> Evaluation:
    """Compare with where the camera was."""
    return evaluate(scene, film.truth.centers[frames_of(scene)])


def truth_from_scene(scene: Scene, film: Film) -> Float:
    """(n, 3, 3) turn from the world of the scene to the true one, as each view has it."""
    true = film.truth.cam_from_world[frames_of(scene)]
    return np.asarray(true.transpose(0, 2, 1) @ scene.cam_from_world)


def path_length(centers: Float) -> float:
    """Length of the path through some places."""
    return float(np.linalg.norm(np.diff(centers, axis=0), axis=1).sum())


@dataclass(frozen=True)
class Said:
    """What a command said, and how it ended."""

    code: int
    out: str
    err: str

    @property
    def complaints(self) -> list[str]:
        """Lines that complain; there is never a traceback."""
        assert "Traceback" not in self.err + self.out, self.err
        return [line for line in self.err.splitlines() if line.startswith("panopath: ")]


def command(source: Path, out: Path, *more: Any) -> list[str]:
    """Arguments of ``panopath``."""
    return ["reconstruct", str(source), "-o", str(out), *map(str, more)]


def said(capsys: Any, source: Path, out: Path, *more: Any) -> Said:
    """Run ``panopath reconstruct`` in this process."""
    capsys.readouterr()
    code: Any = 0
    try:
        main(command(source, out, *more))
    except SystemExit as ended:
        code = ended.code
    told = capsys.readouterr()
    return Said(int(code or 0), told.out, told.err)


def started(source: Path, out: Path, *more: Any, **settings: Any) -> subprocess.Popen[str]:
    """Start ``panopath reconstruct`` as a process of its own."""
    environment = os.environ | {name: str(value) for name, value in settings.items()}
    return subprocess.Popen(
        [sys.executable, "-m", "panopath.cli", *command(source, out, *more)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,
    )


def finished(process: subprocess.Popen[str]) -> Said:
    """Wait for the end of a process."""
    out, err = process.communicate(timeout=300.0)
    return Said(process.returncode, out, err)


def digests(out: Path) -> dict[str, str]:
    """What the files of a run hold, without times and without checkpoints."""
    names = [path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()]
    found = {name: _digest(out / name) for name in sorted(names) if name not in TIMED and not name.startswith(".work/")}
    assert "scene.npz" in found
    return found


def _digest(path: Path) -> str:
    data = path.read_bytes()
    if path.name == "scene.json":
        content = json.loads(data)
        del content["summary"]["seconds"]
        data = json.dumps(content).encode()
    return hashlib.sha256(data).hexdigest()


def stamps(out: Path) -> dict[str, int]:
    """When each checkpoint was written."""
    work = out / ".work"
    return {path.relative_to(work).as_posix(): path.stat().st_mtime_ns for path in sorted(work.rglob("*.npz"))}


def copied(out: Path, to: Path) -> Path:
    """Copy a run, so that another one may go on from it."""
    shutil.copytree(out, to)
    return to


def scene_at(out: Path) -> Scene:
    """Scene of a run."""
    return read_scene(out)


def write_film(path: Path, frames: Any, rate_hz: int = 6) -> Path:
    """Encode (h, w, 3) frames."""
    import av  # noqa: PLC0415 an extra

    with av.open(str(path), "w") as container:
        stream: Any = None
        for frame in frames:
            if stream is None:
                stream = container.add_stream("libx264", rate=rate_hz)
                stream.height, stream.width = frame.shape[:2]
                stream.pix_fmt, stream.options = "yuv420p", {"crf": "23", "preset": "veryfast"}
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")))
        container.mux(stream.encode(None))
    return path


def noisy(frame: npt.NDArray[np.uint8], seed: int, gray: float = 3.0) -> npt.NDArray[np.uint8]:
    """Add the noise of a sensor."""
    noise = np.random.default_rng(seed).normal(0.0, gray, frame.shape)
    return np.clip(frame + noise, 0, 255).astype(np.uint8)
