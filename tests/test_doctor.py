"""What ``panopath doctor`` finds, and what it says of it."""

from __future__ import annotations

import importlib
import importlib.metadata
import json

import panopath as pp
import pytest
from panopath import doctor
from test_cli import Run, run

__all__ = ["run"]


def test_everything_the_package_asks_for_is_looked_at() -> None:
    found = doctor.diagnose()
    assert {library.name for library in found.base} == {"numpy", "typer", "rich"}
    assert all(library.is_ready for library in found.base)
    asked = {"colmap", "video", "images", "view", "plot", "astro", "parquet", "frames"}
    assert set(found.extras) == asked
    assert {library.name for library in found.extras["images"]} == {"opencv-python-headless", "pillow"}
    assert found.n_threads >= 1
    assert found.version == importlib.metadata.version("panopath")


def test_absent_broken_and_old_libraries_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = ["numpy>=2.0", "rich>=99", "no-such-library>=1 ; extra == 'plot'", 'typer>=0.1; extra == "view"']
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: lines)
    real = importlib.import_module

    def fails(name: str) -> object:
        if name == "typer":
            raise OSError("libGL.so.1: cannot open\nshared object file")
        return real(name)

    monkeypatch.setattr(importlib, "import_module", fails)
    found = doctor.diagnose()
    numpy, rich = found.base
    assert numpy.is_ready
    assert rich.trouble == "too old"
    assert found.extras["plot"][0].version is None
    assert found.extras["view"][0].trouble == "libGL.so.1: cannot open shared object file"
    assert not found.is_healthy


@pytest.mark.parametrize(
    ("version", "wanted", "is_older"),
    [
        ("2.0", ">=2.0.0", False),
        ("2", ">=2.0", False),
        ("1.9.9", ">=2", True),
        ("14.0rc1", ">=13,<15", False),
        ("9.10", ">=9.2", False),
        ("1.0", "", False),
    ],
)
def test_versions(version: str, wanted: str, is_older: bool) -> None:
    assert doctor._is_older(version, wanted) is is_older


def test_command(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    said = run("doctor")
    assert said.code == 0
    assert f"panopath {pp.__version__}" in said.out
    assert "vector instructions" in said.out
    plain = json.loads(run("doctor", "--json").out)
    assert plain["is_healthy"] is True
    assert plain["vector_instructions"] in {"avx512", "avx2", "neon", "none"}

    monkeypatch.setattr(importlib.metadata, "requires", lambda _: ["numpy>=2.0", "absent>=1; extra == 'plot'"])
    said = run("doctor")
    assert said.code == 0
    assert "not installed: plot; pip install 'panopath[plot]'" in said.out
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: ["absent>=1"])
    assert run("doctor").code == 2
