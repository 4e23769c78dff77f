"""The plumbing of ``benchmarks.end_to_end``: scores, limits, the page."""

from typing import Any

import numpy as np
import pytest
from panopath.walk import render_walk

from benchmarks.end_to_end import CASES, _end_drift, figures_of, images_of, middle, path_length, score, verdicts
from benchmarks.end_to_end_page import render


def answer(names: list[str], centers: Any, seconds: float = 10.0) -> dict[str, Any]:
    return {
        "names": names,
        "centers": np.asarray(centers).tolist(),
        "n_points": 5,
        "seconds": seconds,
        "cpu_s": seconds,
        "peak_mb": 100.0,
        "stages": {"all": seconds},
        "is_determined": True,
        "n_loop_pairs": 3,
        "load_before": 0.5,
    }


def test_scores_forget_place_turn_and_scale() -> None:
    walk = render_walk(width_px=64, n_frames=30, path="corner")
    frame = np.arange(0, 30, 3)
    names = [f"frame_{k:06d}.jpg" for k in frame]
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = 3.0 * walk.truth.centers[frame] @ turn.T + 7.0
    exact = score(answer(names, found), walk)
    assert exact["rmse_m"] < 1e-9
    assert (exact["n_posed"], exact["n_views"]) == (10, 10)
    found[4] += 0.3
    found[7] = np.nan
    off = score(answer(names, found), walk)
    assert (off["n_posed"], off["n_views"]) == (9, 10)
    assert 0.02 < off["rmse_m"] < off["largest_m"] < 0.2
    assert off["rmse_percent"] == pytest.approx(100.0 * off["rmse_m"] / path_length(walk.truth.centers))


def test_end_drift_is_that_of_the_way() -> None:
    truth = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
    assert _end_drift(truth + 1.0, truth) == pytest.approx(0.0)
    assert _end_drift(truth + np.array([[0.0], [9.0], [1.0]]), truth) == pytest.approx(np.sqrt(3.0))


def test_the_same_frames_for_both(tmp_path: Any) -> None:
    pytest.importorskip("av", reason="needs the extra video")
    film = render_walk(width_px=64, n_frames=20).write_video(tmp_path / "a.mp4")
    folder = images_of(film, 20, 5)
    expected = [f"frame_{k:06d}.jpg" for k in (0, 5, 10, 14, 19)]
    assert sorted(path.name for path in folder.iterdir()) == expected
    before = (folder / expected[0]).stat().st_mtime_ns
    assert (images_of(film, 20, 5) / expected[0]).stat().st_mtime_ns == before


def test_limits_and_page() -> None:
    def result(name: str, seconds: float, rmse_m: float, peer: dict[str, float] | None = None) -> dict[str, Any]:
        ours = answer([], [], seconds) | {
            "rmse_m": rmse_m,
            "rmse_percent": rmse_m,
            "largest_m": rmse_m,
            "end_drift_percent": 0.2,
            "n_posed": 9,
            "n_views": 10,
        }
        return {
            "film": CASES[name].film,
            "date": "today",
            "machine": {"cpu": "a cpu", "cores": 2, "system": "a system"},
            "versions": {"panopath": "1"},
            "n_frames": 100,
            "path_m": 37.0,
            "repeats": 1,
            "ours": ours,
            "peer": (answer([], []) | {"n_posed": 10, "n_views": 10} | peer) if peer else None,
        }

    results = {
        "street": result("street", 10.0, 0.004, {"seconds": 120.0, "rmse_m": 0.002}),
        "hard": result("hard", 10.0, 0.009),
        "loop": result("loop", 10.0, 0.1),
        "large": result("large", 14.0, 0.1),
    }
    assert figures_of(results["street"], None)["rmse_over_allowed"] == pytest.approx(0.004 / 0.0037)
    listed = verdicts(results)
    page = render(results, {name: case.title for name, case in CASES.items()}, listed)
    rows = [line for line in page.splitlines() if line.endswith(("met |", "**not met** |", "not measured |"))]
    told = [line.rsplit("| ", 1)[1] for line in rows]
    met, missed = "met |", "**not met** |"
    #       speed, posed,  rmse    determined, over clean; determined, drift; memory, throughput
    assert told == [met, missed, missed, met, missed, met, missed, met, met]
    assert "load average before 0.5" in page


def test_a_failed_run_is_told() -> None:
    assert middle([{"seconds": 1.0}, {"error": "no"}]) == {"error": "no"}
    assert middle([{"seconds": 1.0}, {"seconds": 9.0}, {"seconds": 2.0}]) == {"seconds": 2.0}
    assert figures_of({"ours": {"error": "no"}}, None)["is_determined"] == 0.0
