"""The benchmark of moving bodies: pedestrians read and filmed as they walked, and the page kept in pieces."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import panopath as pp
import pytest

from benchmarks import moving
from benchmarks.pedestrians import (
    FEWEST_SIGHTINGS,
    MODELS,
    N_LANDMARKS,
    NOISE_RAD,
    PLACES,
    form_of,
    read_crowd,
    solve_crowd,
)


@pytest.fixture
def walked(tmp_path: Path) -> Path:
    """Two people who walk straight, one who stands, one who is seen too seldom; 60 frames."""
    rows = []
    for k in range(60):
        rows += [(10 * k, 1, 1.0 + 0.12 * k, 3.0), (10 * k, 7, 8.0 - 0.1 * k, 2.0 + 0.05 * k), (10 * k, 9, 4.0, 8.0)]
        rows += [(10 * k, 12, 5.0, 5.0)] * (k < FEWEST_SIGHTINGS - 1)
    path = tmp_path / "people.txt"
    np.savetxt(path, np.array(rows), fmt="%g", delimiter="\t")
    return path


def test_bearings_are_those_of_the_file(walked: Path) -> None:
    crowd = read_crowd(walked, 0, 50)
    tracks = crowd.tracks
    assert tracks.track_labels()[N_LANDMARKS:] == ("person 1", "person 7", "person 9")
    assert tracks.time_s is not None
    np.testing.assert_allclose(np.diff(tracks.time_s), 0.4)
    time_s, position = crowd.seen(N_LANDMARKS)
    np.testing.assert_allclose(position[:, 0], 1.0 + 0.3 * time_s)
    ray = crowd.position - crowd.centers[tracks.view]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    off = ray[:, 0] * tracks.bearing[:, 1] - ray[:, 1] * tracks.bearing[:, 0]
    assert np.sqrt(np.mean(off**2)) == pytest.approx(NOISE_RAD, rel=0.1)


def test_people_who_walk_straight_are_found(walked: Path) -> None:
    found = solve_crowd(read_crowd(walked, 0, 50), "taylor:1")
    assert found.camera_rms_m < 0.05
    assert (found.misfit_m < 1e-9).all()
    assert (found.error_m < 0.3).all()


def test_every_model_is_a_form_of_path() -> None:
    time_s = np.arange(0.0, 12.0, 0.4)
    names = {name: form_of(name, time_s) for name in MODELS}
    assert names.pop("auto") == "auto"
    assert {type(form) for form in names.values()} == {pp.Taylor, pp.Fourier, pp.Spline}


@pytest.mark.parametrize("place", PLACES)
def test_the_sets_are_there(place: str) -> None:
    path = moving.DATA / f"{place}.txt"
    if not path.exists():
        pytest.skip("../shared/data/eth_ucy_pedestrians is absent")
    crowd = read_crowd(path, PLACES[place])
    assert crowd.tracks.n_views == 150
    assert len(crowd.pedestrians) > 30


def test_a_section_is_renewed_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    for text in ("first", "second"):
        for name in moving.SECTIONS:
            monkeypatch.setitem(moving.SECTIONS, name, partial("## {}, {}".format, name, text))
        moving.main(["-o", str(page), *(["--only", "speed"] if text == "second" else [])])
    said = page.read_text(encoding="utf-8")
    assert "## speed, second" in said
    assert "## speed, first" not in said
    assert said.count(", first") == len(moving.SECTIONS) - 1
