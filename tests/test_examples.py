"""The programs in examples/ run by themselves and say what they should."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import panopath as pp
import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def run(name: str, cwd: Path, *arguments: str) -> str:
    """Run an example elsewhere, warnings being errors; its output."""
    command = [sys.executable, "-W", "error", str(EXAMPLES / f"{name}.py"), *arguments]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def number(pattern: str, text: str) -> float:
    """The number that a pattern captures in a text."""
    found = re.search(pattern, text)
    assert found is not None, f"{pattern!r} is not in {text!r}"
    return float(found.group(1))


def test_colmap_map(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    said = run("colmap_map", tmp_path, "map")
    assert "converged" in said
    assert "25 of 25 images" in said
    assert number(r"camera error ([\d.]+) %", said) < 0.5
    assert "pycolmap opens it: 25 images, 400 points" in said
    # the noise is one pixel along each axis: its mean length is the root of pi / 2
    assert 1.0 < number(r"reprojection error ([\d.]+) px", said) < 1.4
    assert {path.stem for path in (tmp_path / "map" / "0").iterdir()} >= {"cameras", "images", "points3D"}


def test_coast_survey(tmp_path: Path) -> None:
    said = run("coast_survey", tmp_path)
    assert "converged" in said
    for misread in ("station 2 to mark 5", "station 6 to mark 15"):
        assert misread in said
    assert said.count("set aside:") <= 4
    assert number(r"marks: median error ([\d.]+) m", said) < 15.0
    assert number(r"stations: median error ([\d.]+) m", said) < 15.0
    assert 0.05 < number(r"from the bearings alone: ([\d.]+) deg", said) < 0.15
    assert re.search(r"mark 1 +0\.0000 +0\.0000", said)
    assert re.search(r"mark 2 +1\.0000", said)


def test_robot_landmarks(tmp_path: Path) -> None:
    said = run("robot_landmarks", tmp_path)
    assert "converged" in said
    assert number(r"path: ([\d.]+) mm rms", said) < 40.0
    assert number(r"landmarks: median error ([\d.]+) mm", said) < 40.0
    assert number(r"of which (\d+) were found", said) > 0.95 * number(r"confused bearings: (\d+)", said)


def test_street_walk(tmp_path: Path) -> None:
    said = run("street_walk", tmp_path, "walk")
    assert "converged" in said
    error, best = number(r"camera error ([\d.]+) mm", said), number(r"best possible is ([\d.]+) mm", said)
    assert error < 2.0 * best
    scene = pp.read_scene(tmp_path / "walk")
    assert scene.summary.n_solved_views == 60
    assert {path.stem for path in (tmp_path / "walk" / "colmap" / "0").iterdir()} >= {"cameras", "images", "points3D"}


def test_notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cells run one after the other, and it was stored without what they printed."""
    matplotlib = pytest.importorskip("matplotlib", reason="needs the extra plot")
    matplotlib.use("agg")
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((EXAMPLES / "first_solve.ipynb").read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    namespace: dict[str, object] = {}
    for k, cell in enumerate(notebook["cells"]):
        if cell["cell_type"] == "code":
            assert not cell["outputs"]
            exec(compile("".join(cell["source"]), f"cell {k}", "exec"), namespace)


def test_planets(tmp_path: Path) -> None:
    pytest.importorskip("erfa", reason="the extra astro is absent")
    said = run("planets", tmp_path, "--noise", "--views", "160")
    assert "converged; 1 track is known to be at rest" in said
    for name, axis in (
        ("Mercury", 0.3871),
        ("Venus", 0.7233),
        ("Mars", 1.5237),
        ("Jupiter", 5.2026),
        ("Saturn", 9.5549),
    ):
        assert number(rf"{name} +[\d.]+ +([\d.]+) ", said) == pytest.approx(axis, rel=0.005)
    assert number(r"path of the Earth: ([\d.]+) %", said) < 0.4
