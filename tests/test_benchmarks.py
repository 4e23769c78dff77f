"""The plumbing of the benchmarks: alignment, pairwise directions, readers, pages, fresh processes."""

import json
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.model import Float

from benchmarks import job, page, run
from benchmarks.cases import CASES, Case
from benchmarks.directions import pairwise_directions
from benchmarks.peers import PEERS, Bearings, _check_pycolmap_input, _pycolmap_reconstruction
from benchmarks.planar_sets import PlanarSet, read_mrclam, read_roh, read_victoria_park
from benchmarks.real_data import SECTIONS, section, sections_of
from benchmarks.real_data import page as real_page
from benchmarks.scoring import align, camera_rms, distances

REPOSITORY = Path(__file__).resolve().parents[1]
DATA = REPOSITORY.parent / "shared" / "data"


def _world(**options: Any) -> pp.SyntheticWorld:
    given: dict[str, Any] = {
        "n_views": 24,
        "n_points": 600,
        "orientations": "random",
        "noise_rad": radians(0.01),
        "seed": 3,
    }
    return pp.simulate("street", **(given | options))


def _bearings(world: pp.SyntheticWorld) -> Bearings:
    tracks = world.tracks
    return Bearings(
        tracks.view,
        tracks.track,
        tracks.bearing,
        world.cam_from_world,
        tracks.n_views,
        tracks.n_tracks,
        world.noise_rad,
    )


@pytest.mark.parametrize("d", [2, 3])
def test_alignment_undoes_a_similarity_and_never_mirrors(d: int) -> None:
    rng = np.random.default_rng(d)
    truth = rng.normal(size=(9, d))
    rotation = np.linalg.qr(rng.normal(size=(d, d)))[0]
    rotation[:, 0] *= np.sign(np.linalg.det(rotation))
    moved = 0.3 * truth @ rotation.T + rng.normal(size=d)
    found = align(moved, truth, rotate=True)
    assert distances(found.apply(moved), truth).max() < 1e-12
    assert abs(found.scale - 1 / 0.3) < 1e-9
    mirrored = align(moved * np.r_[-1.0, np.ones(d - 1)], truth, rotate=True)
    assert np.linalg.det(mirrored.rotation) > 0.99


def test_a_lost_view_counts_as_infinite_error() -> None:
    truth = np.random.default_rng(0).normal(size=(5, 3))
    assert camera_rms(2.0 * truth + 1.0, truth) < 1e-12
    lost = truth.copy()
    lost[2] = np.nan
    assert camera_rms(lost, truth) == float("inf")


@pytest.mark.parametrize(("outliers", "limit_deg"), [(0.0, 0.15), (0.3, 0.5)])
def test_pairwise_directions_point_from_view_to_view(outliers: float, limit_deg: float) -> None:
    world = _world(outlier_fraction=outliers)
    pairs = pairwise_directions(
        world.tracks.view, world.tracks.track, _bearings(world).world_directions(), world.noise_rad
    )
    true = world.centers[pairs.second] - world.centers[pairs.first]
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((true * pairs.direction).sum(axis=1), -1.0, 1.0)))
    assert len(angle) >= 3 * 24
    assert np.quantile(angle, 0.9) < limit_deg
    assert (pairs.n_shared >= 8).all()
    if outliers == 0.0:
        scaled = np.radians(angle) / pairs.sigma_rad
        assert 0.5 < np.median(scaled) < 2.0


def test_pycolmap_input_is_checked_bearing_by_bearing() -> None:
    pytest.importorskip("pycolmap")
    world = _world()
    problem = _bearings(world)
    reconstruction = _pycolmap_reconstruction(problem)
    assert _check_pycolmap_input(reconstruction, problem) == len(world.tracks)
    wrong = problem.bearing.copy()
    wrong[5] = np.roll(wrong[5], 1)
    changed = Bearings(**{**problem.__dict__, "bearing": wrong})
    with pytest.raises(RuntimeError, match="differ from ours"):
        _check_pycolmap_input(reconstruction, changed)


@pytest.mark.parametrize(("name", "package"), [("gtsam", "gtsam"), ("pytheia_lud", "pytheia")])
def test_pairwise_peers_recover_a_street(name: str, package: str) -> None:
    pytest.importorskip(package)
    world = _world()
    result = PEERS[name](_bearings(world), 0)
    assert result.points is None
    assert camera_rms(result.centers, world.centers) < 0.05


def test_a_fresh_process_measures_ours_and_reports_failures() -> None:
    case = Case("tiny", "tiny", "street", {"n_views": 20, "n_points": 400, "orientations": "random"})
    spec = job.Spec.of(case, 1)
    ours = job.in_fresh_process("ours", spec, 120.0)
    assert ours["fingerprint"] == job.fingerprint(spec.simulate())
    assert ours["rms"] < 0.02
    assert page.is_solved(ours)
    assert ours["memory_mb"] < 200
    broken = job.in_fresh_process("ours", job.Spec("no_such_world", {}, 0), 120.0)
    assert "no_such_world" in broken["error"]


def _result(case: Case, speedup: float) -> dict[str, Any]:
    ours: dict[str, Any] = {"seconds": 0.1, "rms": 0.002, "memory_mb": 12.0, "n_observations": 1000, "n_views": 5}
    ours |= {"n_solved_views": 5, "n_components": 1, "fingerprint": "a"}
    other = {"rms": 0.002}
    return {
        "title": case.title,
        "options": case.options,
        "promises": case.promises(),
        "date": "today",
        "machine": {"cpu": "c", "cores": 2, "system": "s"},
        "versions": {"python": "3"},
        "ours": [ours],
        "peers": {"pycolmap": [{**ours, "seconds": 0.1 * speedup}]} if case.pairs else {},
        "seeds": [{"seed": seed, "ours": ours, "optimum": other, "bound": other} for seed in case.seeds],
    }


def test_the_page_tells_met_from_missed() -> None:
    met = page.render({name: _result(case, 150.0) for name, case in CASES.items()})
    assert ">= 100x faster: met" in met
    assert "missed" not in met
    quick = CASES["street_100"].scaled(0.2)
    assert ": met" not in page.render({"street_100": _result(quick, 150.0)})
    missed = page.render({"street_100": _result(CASES["street_100"], 99.0)})
    assert ">= 100x faster: **missed**" in missed


def test_runs_on_different_observations_stop_the_benchmark() -> None:
    with pytest.raises(RuntimeError, match="different observations"):
        run._check_same_observations("case", [{"fingerprint": "a"}, {"fingerprint": "b"}])


def test_results_merge_into_the_file(tmp_path: Path) -> None:
    store = tmp_path / "figures.json"
    assert run.load(store) == {}
    run.save(store, {"room_1000": {"x": 1}})
    run.save(store, run.load(store) | {"street_100": {"x": 2}})
    assert list(json.loads(store.read_text())) == ["street_100", "room_1000"]


def test_absent_data_is_skipped_with_a_sentence(tmp_path: Path) -> None:
    for name in SECTIONS:
        assert "Skipped:" in section(name, tmp_path, tmp_path / "img")


def test_sections_survive_the_renewal_of_others(tmp_path: Path) -> None:
    page_path = tmp_path / "real.md"
    page_path.write_text(real_page({"roh": "## Roh\n\ntext", "lund_door": "## Door"}), encoding="utf-8")
    assert sections_of(page_path) == {"roh": "## Roh\n\ntext", "lund_door": "## Door"}


def _residual(data: PlanarSet) -> Float:
    offset = data.landmarks[data.landmark] - data.stations[data.station]
    true = np.arctan2(offset[:, 1], offset[:, 0]) - data.heading_rad[data.station]
    return np.asarray(np.degrees(np.angle(np.exp(1j * (data.bearing_rad - true)))))


def _needs(folder: str) -> Path:
    path = DATA / folder
    if not path.is_dir():
        pytest.skip(f"{folder} is absent from ../shared/data")
    return path


def test_roh_conventions_fit_the_true_positions() -> None:
    data = read_roh(_needs("planar_bearings/dataset_roh"))
    assert data.bearing_rad.shape == (6, 200, 4)
    assert np.abs(_residual(data.mean())).max() < 9.0


def test_mrclam_conventions_fit_the_true_positions() -> None:
    pytest.importorskip("scipy")
    data = read_mrclam(_needs("planar_bearings/dataset_mrclam") / "mrclam1.mat")
    assert np.median(np.abs(_residual(data))) < 0.4
    assert np.bincount(data.station).min() >= 3


def test_victoria_park_is_read_whole() -> None:
    drive = read_victoria_park(_needs("victoria_park") / "victoria_park.txt")
    assert drive.dead_reckoning().shape == (6969, 3)
    assert len(drive.pose) == 3640
    assert drive.n_trees == 151
