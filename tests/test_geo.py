"""Places on the earth: exact both ways, files as the specifications ask, a fit that bears with bad positions."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.formats.geo import (
    GeoPath,
    LocalFrame,
    ecef_from_wgs84,
    read_geojson,
    read_gpx,
    wgs84_from_ecef,
    write_geojson,
    write_gpx,
)
from panopath.formats.structure import known_scene
from panopath.georeference import GeoStatus, georeference, scale_from_baseline
from panopath.model import Float
from panopath.moves import moved_scene
from panopath.run.place import place_on_earth

START = datetime(2024, 5, 6, 7, 8, 9, tzinfo=UTC)


def places(n: int = 500) -> Float:
    rng = np.random.default_rng(1)
    rows = np.column_stack((rng.uniform(-90, 90, n), rng.uniform(-180, 180, n), rng.uniform(-1e4, 1e6, n)))
    rows[:3, 0] = (90.0, -90.0, 0.0)
    return rows


def test_known_places() -> None:
    """On the equator, at a pole, and half way: geocentric coordinates that follow from the two axes alone."""
    polar = 6378137.0 * (1.0 - 1.0 / 298.257223563)
    found = ecef_from_wgs84([(0.0, 0.0, 0.0), (0.0, 90.0, 100.0), (90.0, 0.0, 10.0), (-90.0, 0.0, 0.0)])
    expected = [(6378137.0, 0, 0), (0, 6378237.0, 0), (0, 0, polar + 10.0), (0, 0, -polar)]
    assert np.abs(found - expected).max() < 1e-8


def test_wgs84_goes_there_and_back_to_the_last_digits() -> None:
    position = places()
    back = wgs84_from_ecef(ecef_from_wgs84(position))
    off_pole = np.abs(position[:, 0]) < 90.0
    assert np.abs(back - position)[off_pole, :2].max() < 1e-13
    assert np.abs(back - position)[:, 2].max() < 1e-8


def test_agrees_with_pycolmap() -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="the extra colmap is absent")
    position = places()
    # pycolmap has the polar axis of GRS80, a tenth of a millimetre shorter
    assert np.abs(pycolmap.GPSTransform().ellipsoid_to_ecef(position) - ecef_from_wgs84(position)).max() < 2e-4


def test_local_axes_point_east_north_and_up() -> None:
    frame = LocalFrame(48.2, 16.4, 200.0)
    here = np.array([[48.2, 16.4, 200.0]])
    assert np.abs(frame.enu_from_wgs84(here)).max() < 1e-8
    moved = frame.enu_from_wgs84(here + np.diag((1e-6, 1e-6, 1.0)))
    for row, axis in enumerate((1, 0, 2)):
        assert np.argmax(np.abs(moved[row])) == axis
        assert moved[row, axis] > 0.0
    enu = np.random.default_rng(0).normal(0.0, 5e3, (100, 3))
    assert np.abs(frame.enu_from_wgs84(frame.wgs84_from_enu(enu)) - enu).max() < 1e-8
    assert np.isnan(frame.enu_from_wgs84([(np.nan, 0.0, 0.0)])).all()


@pytest.mark.parametrize(("latitude", "longitude"), [(91.0, 0.0), (np.nan, 0.0), (0.0, np.inf)])
def test_refuses_an_origin_that_is_no_place(latitude: float, longitude: float) -> None:
    with pytest.raises(pp.InputError, match="origin"):
        LocalFrame(latitude, longitude)


def path_of_two_parts() -> GeoPath:
    position = np.column_stack((np.linspace(10, 10.001, 7), np.linspace(20, 20.002, 7), np.linspace(5, 9, 7)))
    position[3] = np.nan
    return GeoPath.from_arrays(
        position, [0, 0, 0, 0, 1, 1, -1], [f"é<{i}>.jpg" for i in range(7)], np.arange(7)[::-1] * 0.5, START
    )


def check_geojson(content: dict[str, Any]) -> None:
    """What RFC 7946 asks of what we write."""
    assert content["type"] == "FeatureCollection"
    assert "crs" not in content  # section 4: WGS84 it is, and nothing else
    for feature in content["features"]:
        assert set(feature) == {"type", "geometry", "properties"}
        assert feature["type"] == "Feature"
        kind, coordinates = feature["geometry"]["type"], feature["geometry"]["coordinates"]
        lines = {"Point": [[coordinates]], "LineString": [coordinates], "MultiLineString": coordinates}[kind]
        for line in lines:
            assert kind == "Point" or len(line) >= 2
            assert kind != "MultiLineString" or np.abs(np.diff([p[0] for p in line])).max() <= 180.0
            for longitude, latitude, height in line:
                assert -180.0 <= longitude <= 180.0
                assert -90.0 <= latitude <= 90.0
                assert np.isfinite(height)


def test_geojson(tmp_path: Path) -> None:
    path = path_of_two_parts()
    write_geojson(path, tmp_path / "a.geojson")
    content = json.loads((tmp_path / "a.geojson").read_text(encoding="utf-8"))
    check_geojson(content)
    kinds = [feature["properties"]["kind"] for feature in content["features"]]
    assert kinds == ["path", "path", "view", "view", "view", "view", "view"]
    line = content["features"][0]["geometry"]["coordinates"]
    assert line[0][:2] == [round(path.position[2, 1], 10), round(path.position[2, 0], 10)]  # the earliest, lon first
    back = read_geojson(tmp_path / "a.geojson")
    rows = np.array([path.names.index(name) for name in back.names])
    assert np.abs(back.position - path.position[rows]).max() < 1e-4
    assert np.abs(back.position - path.position[rows])[:, :2].max() < 1e-10
    assert np.array_equal(back.time_s, path.time_s[rows])
    assert back.start == START
    assert np.array_equal(back.component, path.component[rows])


def test_geojson_is_cut_at_the_date_line(tmp_path: Path) -> None:
    path = GeoPath.from_arrays([(0, 179.0, 0), (1, -179.5, 0), (2, -179.0, 0), (1, 179.5, 3)])
    write_geojson(path, tmp_path / "a.geojson")
    content = json.loads((tmp_path / "a.geojson").read_text())
    check_geojson(content)
    pieces = content["features"][0]["geometry"]["coordinates"]
    assert [len(piece) for piece in pieces] == [2, 4, 2]
    assert pieces[0][-1] == pytest.approx([180.0, 2.0 / 3.0, 0.0])
    assert pieces[1][0] == pytest.approx([-180.0, 2.0 / 3.0, 0.0])
    assert np.array_equal(read_geojson(tmp_path / "a.geojson").position, path.position)


def test_gpx(tmp_path: Path) -> None:
    path = path_of_two_parts()
    write_gpx(path, tmp_path / "a.gpx")
    root = ET.parse(tmp_path / "a.gpx").getroot()
    space = "{http://www.topografix.com/GPX/1/1}"
    assert root.tag == f"{space}gpx"
    assert root.attrib["version"] == "1.1"
    assert root.attrib["creator"]
    assert [child.tag for child in root] == [f"{space}trk"]
    points = list(root.iter(f"{space}trkpt"))
    assert len(points) == 5
    for point in points:
        # the schema's order, and decimals without exponent
        assert [child.tag.removeprefix(space) for child in point] == ["ele", "time", "name"]
        assert set(point.attrib) == {"lat", "lon"}
        assert not {"e", "E"} & set(point.attrib["lat"] + point.attrib["lon"] + (point[0].text or "e"))
        assert -180.0 <= float(point.attrib["lon"]) < 180.0
    back = read_gpx(tmp_path / "a.gpx")
    rows = np.array([path.names.index(name) for name in back.names])
    assert np.abs(back.position - path.position[rows]).max() < 1e-4
    assert np.array_equal(back.component, path.component[rows])
    assert back.start == datetime(2024, 5, 6, 7, 8, 11, tzinfo=UTC)
    assert np.allclose(back.time_s - back.time_s[0], path.time_s[rows] - path.time_s[rows][0], atol=1e-3)


def test_gpx_of_tiny_numbers_has_no_exponent(tmp_path: Path) -> None:
    write_gpx(GeoPath.from_arrays([(1e-12, -1e-9, -1e-7), (3e-8, 179.999999999999, 1e7)]), tmp_path / "a.gpx")
    points = list(ET.parse(tmp_path / "a.gpx").getroot().iter("{http://www.topografix.com/GPX/1/1}trkpt"))
    assert points[0].attrib == {"lat": "0", "lon": "-0.000000001"}
    assert points[1].attrib == {"lat": "0.00000003", "lon": "-180"}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.gpx", "<gpx"),
        ("a.gpx", "<kml></kml>"),
        ("a.gpx", "<gpx></gpx>"),
        ("a.gpx", "<gpx><trk><trkseg><trkpt lat='x' lon='1'/></trkseg></trk></gpx>"),
        ("a.gpx", "<!DOCTYPE gpx [<!ENTITY a 'b'>]><gpx>&a;</gpx>"),
        ("a.gpx", "<gpx><trk><trkseg><trkpt lat='1' lon='1'><time>soon</time></trkpt></trkseg></trk></gpx>"),
        ("a.geojson", "[1]"),
        ("a.geojson", '{"type": "FeatureCollection", "features": []}'),
        ("a.geojson", '{"features": [{"geometry": {"type": "Point", "coordinates": [1]}}]}'),
    ],
)
def test_refuses_what_is_no_path(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(pp.InputError, match=name):
        (read_gpx if name.endswith("gpx") else read_geojson)(tmp_path / name)


# the fit


def walk(n: int = 60, bend: float = 1.5) -> tuple[pp.Scene, Float]:
    """A path in local axes, and the same as a scene in a frame of its own, turned about z."""
    along = np.linspace(0.0, bend, n)
    enu = np.column_stack((80.0 * np.sin(along), 80.0 * (1.0 - np.cos(along)), 2.0 * np.sin(3.0 * along)))
    points = np.random.default_rng(5).normal((40.0, 40.0, 5.0), 30.0, (40, 3))
    view, track = np.repeat(np.arange(n), 40), np.tile(np.arange(40), n)
    ray = points[track] - enu[view]
    tracks = pp.Tracks.from_arrays(view, track, ray / np.linalg.norm(ray, axis=1, keepdims=True))
    truth = known_scene(tracks, np.tile(np.eye(3), (n, 1, 1)), enu, points)
    c, s = np.cos(1.1), np.sin(1.1)
    return moved_scene(truth, [[c, -s, 0], [s, c, 0], [0, 0, 1]], 0.03, (1.0, 2.0, -3.0)), enu


FRAME = LocalFrame(47.0, 11.0, 500.0)


def test_exact_positions_are_found_again() -> None:
    scene, enu = walk()
    found = georeference(scene, FRAME.wgs84_from_enu(enu), origin=FRAME)
    assert found.is_fitted
    assert np.abs(found.scene.centers - enu).max() < 1e-6
    assert found.fits[0].inlier.all()
    assert found.fits[0].scale == pytest.approx(1.0 / 0.03)
    # bearings look where they did: the orientations turned along
    scene_rays = np.einsum("nkc,nc->nk", found.scene.cam_from_world, found.scene.points[0] - found.scene.centers)
    rays = np.einsum("nkc,nc->nk", scene.cam_from_world, scene.points[0] - scene.centers)
    assert np.allclose(scene_rays, rays / 0.03, atol=1e-6)


@pytest.mark.parametrize("vertical", ["keep", "fit"])
def test_wrong_positions_are_set_aside(vertical: Any) -> None:
    scene, enu = walk()
    rng = np.random.default_rng(3)
    given = enu + rng.normal(0.0, (1.0, 1.0, 2.0), enu.shape)
    wrong = rng.choice(len(enu), 20, replace=False)
    given[wrong[:10]] += rng.normal(0.0, 60.0, (10, 3)) + 30.0
    given[wrong[10:]] += (45.0, -20.0, 0.0)  # all of these the same way: a reflection off one building
    found = georeference(scene, FRAME.wgs84_from_enu(given), vertical=vertical, origin=FRAME)
    (fit,) = found.fits
    assert fit.status is GeoStatus.FITTED
    assert not fit.inlier[wrong].any()
    assert fit.inlier.sum() >= 36
    assert 0.7 < fit.sigma_m < 1.4
    assert np.linalg.norm((found.scene.centers - enu)[:, :2], axis=1).max() < 2.0
    assert fit.scale * 0.03 == pytest.approx(1.0, abs=0.02)
    assert "40 of 60" in fit.sentence() or "of 60 positions agree" in fit.sentence()


def test_heights_may_be_absent_or_wrong() -> None:
    scene, enu = walk()
    given = FRAME.wgs84_from_enu(enu)
    given[::2, 2] = np.nan
    given[1, 2] += 500.0
    found = georeference(scene, given, origin=FRAME)
    assert np.abs(found.scene.centers - enu).max() < 1e-3
    given[:, 2] = np.nan
    flat = georeference(scene, given)
    assert flat.frame.height_m == 0.0
    assert flat.is_fitted
    assert abs(float(np.median(flat.scene.centers[:, 2]))) < 1e-6


def test_a_straight_path_keeps_its_vertical() -> None:
    scene, enu = walk(bend=1e-3)
    given = FRAME.wgs84_from_enu(enu * 100.0)
    assert georeference(scene, given, origin=FRAME).is_fitted
    assert georeference(scene, given, vertical="fit").fits[0].status is not GeoStatus.FITTED


@pytest.mark.parametrize(
    ("given", "status"),
    [
        ("one", GeoStatus.TOO_FEW),
        ("same", GeoStatus.NO_SPREAD),
        ("noise", GeoStatus.NO_SPREAD),
    ],
)
def test_says_why_not(given: str, status: GeoStatus) -> None:
    scene, enu = walk()
    rng = np.random.default_rng(0)
    rows = {"one": enu.copy(), "same": np.zeros_like(enu), "noise": rng.normal(0.0, 500.0, enu.shape)}[given]
    position = FRAME.wgs84_from_enu(rows)
    if given == "one":
        position[1:] = np.nan
    found = georeference(scene, position)
    assert found.fits[0].status in (status, GeoStatus.CONTRADICTION if given == "noise" else status)
    assert not found.is_fitted
    assert np.array_equal(found.scene.centers, scene.centers)
    assert "not used" in found.fits[0].sentence()


def test_refuses_unusable_positions() -> None:
    scene, enu = walk()
    with pytest.raises(pp.InputError, match="position has shape"):
        georeference(scene, enu[:3])
    with pytest.raises(pp.InputError, match="no row"):
        georeference(scene, np.full_like(enu, np.nan))
    with pytest.raises(pp.InputError, match=r"sigma_m\[0\]"):
        georeference(scene, FRAME.wgs84_from_enu(enu), sigma_m=-1.0)


def test_a_baseline_gives_the_scale() -> None:
    scene, enu = walk()
    metres = float(np.linalg.norm(enu[3] - enu[30]))
    assert scale_from_baseline(scene, 3, 30, metres) == pytest.approx(1.0 / 0.03)
    for first, second, length in ((0, 0, 1.0), (0, 99, 1.0), (0, 1, -1.0), (0, 1, np.nan)):
        with pytest.raises(pp.InputError):
            scale_from_baseline(scene, first, second, length)


def test_the_date_line_does_no_harm() -> None:
    scene, enu = walk()
    frame = LocalFrame(-17.0, 180.0, 0.0)
    found = georeference(scene, frame.wgs84_from_enu(enu))
    assert found.is_fitted
    assert abs(abs(found.frame.longitude_deg) - 180.0) < 0.01
    assert found.fits[0].distance_m.max() < 1e-3


def test_two_places_give_no_scale() -> None:
    """Two positions fit any path by scale and heading, so that a run does not rest on them."""
    scene, enu = walk()
    given = np.full_like(enu, np.nan)
    given[[0, 30]] = FRAME.wgs84_from_enu(enu[[0, 30]])
    placed = place_on_earth(scene, position_wgs84=given)
    assert placed.unit == ""
    assert placed.georeference is None
    assert any("any 2 positions fit" in said for said in placed.statements)
    given[[10, 50]] = FRAME.wgs84_from_enu(enu[[10, 50]])
    assert place_on_earth(scene, position_wgs84=given).unit == "m"
