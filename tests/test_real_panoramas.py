"""Real pictures with positions, from end to end; skipped where ``../shared/data`` or an extra is absent."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2", reason="needs the extra images")
pytest.importorskip("PIL", reason="needs the extra images")

from panopath.formats.geo import LocalFrame
from panopath.frontend import FrontEndOptions, read_header
from panopath.frontend.images import image_files
from panopath.run import RunOptions, reconstruct

Find = Callable[[str], Path]


def test_street_pictures_lie_on_their_positions(real_data: Find, tmp_path: Path) -> None:
    """Most of what these pictures share is clouds that drift; the path is right only without them."""
    folder = real_data("geovisio_gopromax")
    options = RunOptions(keep_images=False, front_end=FrontEndOptions(width=1600))
    done = reconstruct(folder, tmp_path / "out", options)
    assert done.unit == "m"
    assert any("5 of 5 positions agree" in said for said in done.statements)
    known = np.array([read_header(path).position_wgs84 for path in image_files(folder)], dtype=np.float64)
    written = json.loads((done.folder / "path.geojson").read_text(encoding="utf-8"))
    (line,) = (f["geometry"]["coordinates"] for f in written["features"] if f["geometry"]["type"] == "LineString")
    place = np.array([(p[1], p[0], 0.0) for p in line])
    frame = LocalFrame(*known[0])
    off = np.linalg.norm((frame.enu_from_wgs84(place) - frame.enu_from_wgs84(known))[:, :2], axis=1)
    assert off.max() < 0.4


def test_two_pictures_do_not_rest_on_their_positions(real_data: Find, tmp_path: Path) -> None:
    """These positions are 79 m apart, the pictures a step."""
    done = reconstruct(real_data("stella_pair"), tmp_path / "out")
    assert done.scene.summary.n_solved_views == 2
    assert done.unit == ""
    assert any("GPS was not used" in said for said in done.statements)
