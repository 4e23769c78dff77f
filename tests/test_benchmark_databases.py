"""The benchmarks' own databases and scores."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import panopath as pp
import pytest

from benchmarks.correspondence import cut, drop_ambiguous, ring, score
from benchmarks.databases import Spec, make_database, score_models


@pytest.mark.parametrize("camera", ["EQUIRECTANGULAR", "PINHOLE", "rig"])
def test_the_truth_has_no_error(tmp_path: Path, camera: str) -> None:
    spec = Spec(camera, 8, {"PINHOLE": 6000}.get(camera, 1500), noise_px=0.5)  # type: ignore[arg-type]
    truth = make_database(spec, tmp_path / "database.db")
    database = pp.read_database(tmp_path / "database.db")
    assert database.image_names == truth.names
    assert database.n_frames == 8
    assert database.has_rigs == (camera == "rig")
    assert database.is_verified
    tracks = pp.tracks_from_matches(
        database.n_features, database.pairs, database.match_starts, database.matches, pp.CorrespondenceOptions(3)
    )
    feature = database.feature_starts[tracks.image] + tracks.feature
    bearings = database.bearings[feature]
    seen = pp.Tracks.from_arrays(tracks.image, tracks.track, bearings, database.n_images, tracks.n_tracks)
    scene = pp.solve_positions(seen, truth.cam_from_world)
    assert scene.inlier.mean() > 0.9
    # where the points are does not matter to the score of the poses
    observations = np.stack((tracks.image, tracks.feature, tracks.track), axis=1)
    found = pp.Reconstruction.from_arrays(
        database, truth.cam_from_world, truth.centers, np.zeros((tracks.n_tracks, 3)), observations
    )
    pp.write_models(database, found, tmp_path / "out")
    figures = score_models(tmp_path / "out", truth)
    assert (figures.n_registered, figures.n_images, figures.n_models) == (len(truth.names), len(truth.names), 1)
    assert figures.rms_m < 1e-9
    assert figures.rotation_deg < 1e-5


def test_wrong_matches_are_as_many_as_said(tmp_path: Path) -> None:
    spec = Spec(n_places=6, n_points=1500)
    make_database(spec, tmp_path / "right.db")
    right = pp.read_database(tmp_path / "right.db")
    make_database(replace(spec, wrong_verified=0.3), tmp_path / "wrong.db")
    wrong = pp.read_database(tmp_path / "wrong.db")
    np.testing.assert_array_equal(right.match_starts, wrong.match_starts)
    changed = (right.matches != wrong.matches).any(axis=1).mean()
    assert 0.2 < changed < 0.35


def test_no_model_is_no_score(tmp_path: Path) -> None:
    truth = make_database(Spec(n_places=4, n_points=300), tmp_path / "database.db")
    assert score_models(tmp_path, truth).n_registered == 0


def test_tracks_against_dropping() -> None:
    matching = ring(30, 600, 12, found=0.8, wrong=0.1)
    ours, peer = (score(matching, *run(matching)) for run in (cut(), drop_ambiguous))
    assert ours["kept"] > 0.95
    assert peer["kept"] < 0.5
    right = ring(30, 600, 12, found=0.9, wrong=0.0)
    assert score(right, *drop_ambiguous(right))["kept"] > 0.999
