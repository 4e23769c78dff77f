"""Bodies that move, shown: the report's clock and words, the viewer's layer, and both pages in headless Chromium."""

from __future__ import annotations

import base64
import importlib.util
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.certificate import Certificate
from panopath.cli.certifying import write_folder
from panopath.formats.structure import known_scene
from panopath.model import Float
from panopath.movers import at_rest
from panopath.paths import PathVerdict
from panopath.report import draw_scene
from panopath.report.page import ReportNotes, write_report
from panopath.viewer import view
from panopath.viewer.content import read_content
from test_movers import paths_of
from test_report_page import HOSTILE, Page, written

from docs.figures_moving import animate, crossing
from docs.figures_view import Page as Browser
from docs.figures_view import find_chromium, opened

needs_viser = pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser (extra view) is absent")
needs_chromium = pytest.mark.skipif(find_chromium() is None, reason="Chromium is absent")


@pytest.fixture(scope="module")
def scene() -> pp.Scene:
    return crossing(21, 60)


# the report


def drawn(part: dict[str, Any]) -> list[Float]:
    """Places of each body, as the page's script has them."""
    moving = part["moving"]
    whole = np.frombuffer(base64.b64decode(moving["places"]), "<u2").reshape(-1, 3)
    places = np.array(moving["low"]) + np.array(moving["step"]) * whole
    return np.split(places, np.cumsum(moving["counts"])[:-1])


def test_report_draws_bodies_where_they_were(tmp_path: Path, scene: pp.Scene) -> None:
    page, data = written(scene, None, tmp_path, notes=ReportNotes(unit="m", is_upright=True))
    (part,) = data["parts"]
    moving, paths = part["moving"], paths_of(scene)
    assert moving["total"] == len(moving["names"]) == 38
    assert moving["span"] == [0.0, 20.0]
    assert len(moving["views"]) == len(part["path"])
    labels = scene.track_labels()
    for name, seen, places in zip(moving["names"], moving["seen"], drawn(part), strict=True):
        track = labels.index(name)
        np.testing.assert_allclose(seen, paths.seen_s[track])
        true = paths.position(track, np.linspace(seen[0], seen[1], len(places)))
        near = np.linalg.norm(true, axis=1) < 100.0
        assert near.any()
        assert np.linalg.norm(true - places, axis=1)[near].max() <= np.linalg.norm(moving["step"])
    # the tracks of a car have one colour, and no two bodies have the same
    of_body = {int(paths.body[labels.index(n)]): c for n, c in zip(moving["names"], moving["colours"], strict=True)}
    assert len(set(moving["colours"])) == 4 + 6
    assert [of_body[body] for body in range(4)] == [0, 1, 2, 3]
    # points at rest alone are points
    assert part["total"] == 60
    assert "260" not in page.text
    assert " 60 points 38 tracks that move " in page.text


def test_report_says_what_was_found(tmp_path: Path, scene: pp.Scene) -> None:
    hostile = replace(scene, paths=replace(paths_of(scene), assumption=HOSTILE, freedoms=("the scale", HOSTILE)))
    page, _ = written(hostile, None, tmp_path, notes=ReportNotes(unit="m"))
    assert page.text.count(HOSTILE) == 2
    for text in (
        "60 at rest",
        "38 moving, path found",
        "1 refused: the camera moved in the form",
        "1 refused: before or behind",
        "1 not determined",
        "Left free: the scale; ",
        "spline of 2 pieces",
        "1 harmonic, 8 s a turn",
    ):
        assert text in page.text, text
    assert re.search(r"body 0 10 straight and steady 0 to 12 84 m (6\.9|7\.0)\d* ± 0\.\d+ m/s", page.text)
    assert [tag for tag, _ in page.elements].count("input") == 1


def test_report_of_scenes_without_movers(tmp_path: Path, scene: pp.Scene) -> None:
    page, data = written(replace(scene, paths=None), None, tmp_path)
    assert data["parts"][0]["moving"] is None
    assert "Bodies that move" not in page.text
    assert "input" not in [tag for tag, _ in page.elements]
    paths = paths_of(scene)
    still = replace(paths, verdicts=(PathVerdict.STATIC,) * len(paths))
    page, data = written(replace(scene, paths=still), None, tmp_path)
    assert data["parts"][0]["moving"] is None
    assert "101 at rest" in page.text
    assert "input" not in [tag for tag, _ in page.elements]


@pytest.mark.parametrize("kind", ["plane", "no covariances", "no times", "one moment", "far away", "no views", "lost"])
def test_any_scene_is_reported(tmp_path: Path, kind: str) -> None:
    scene = crossing(21, 30, dimension=2 if kind == "plane" else 3, covariances=kind != "no covariances")
    paths = paths_of(scene)
    if kind == "no times":
        scene = replace(scene, tracks=None)
    elif kind == "one moment":
        scene = replace(scene, paths=replace(paths, seen_s=np.full_like(paths.seen_s, 7.0)))
    elif kind == "far away":
        coefficients = paths.coefficients.copy()
        coefficients[paths.starts[35]] = 1e12
        scene = replace(scene, paths=replace(paths, coefficients=coefficients))
    elif kind == "no views":
        scene = replace(scene, centers=np.full_like(scene.centers, np.nan), view_component=np.full(21, -1))
    elif kind == "lost":
        scene = replace(scene, paths=replace(paths, coefficients=np.full_like(paths.coefficients, np.nan)))
    page, data = written(scene, None, tmp_path)
    assert "nan" not in page.text
    if kind == "lost":
        assert data["parts"][0]["moving"] is None
        return
    assert ("±" in page.text) == (kind != "no covariances")
    if kind == "no views":
        assert data["parts"] == []
        return
    moving = data["parts"][0]["moving"]
    assert (moving["views"] is None) == (kind == "no times")
    assert len(drawn(data["parts"][0])) == len(moving["names"]) == moving["total"] == 38
    assert kind != "one moment" or set(moving["counts"]) == {1}


def test_report_of_many_bodies_stays_small(tmp_path: Path) -> None:
    n = 6000
    rng = np.random.default_rng(0)
    models = tuple(pp.Fourier(2, 50.0) for _ in range(n))
    alone = np.full(n, -1, dtype=np.int32)
    seen_s, verdicts = np.tile((0.0, 14.0), (n, 1)), (PathVerdict.MOVING,) * n
    paths = pp.Paths(models, 5 * np.arange(n + 1), rng.normal(size=(5 * n, 3)), None, seen_s, verdicts, alone, alone)
    tracks = pp.Tracks.from_arrays([0], [0], [(1.0, 0.0, 0.0)], n_views=15, n_tracks=n, time_s=np.arange(15.0))
    plain = known_scene(tracks, None, rng.normal(size=(15, 3)), rng.normal(size=(n, 3)))
    path = write_report(replace(plain, paths=paths), None, tmp_path / "report.html")
    assert path.stat().st_size < 1_500_000
    page = Page(path.read_text(encoding="utf-8"))
    assert "12 of 6,000 bodies." in page.text


@needs_chromium
@pytest.mark.parametrize("width", [1280, 390])
def test_clock_of_the_report_runs(tmp_path: Path, scene: pp.Scene, width: int) -> None:
    path = write_report(scene, None, tmp_path / "report.html", notes=ReportNotes(unit="m"))
    paint = (
        "[...document.querySelector('canvas').toDataURL()].reduce((a, c) => (31 * a + c.charCodeAt(0)) % 1000003, 7)"
    )
    clock, button = "document.getElementById('now').textContent", "document.getElementById('play')"
    with Browser.open(width, 900) as page:
        page.go(path.resolve().as_uri())
        page.wait_for("document.documentElement.dataset.drawn === 'yes'")
        assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
        assert page.evaluate(clock) == "10.00 s, 38 seen"

        def put(value: int) -> None:
            page.evaluate(
                f"(() => {{ const t = document.getElementById('time'); t.value = {value};"
                " t.dispatchEvent(new Event('input')); })()"
            )

        # a browser draws in another way, with other roundings, once it is asked for pixels time and again
        for value in (1000, 500, 1000, 500):
            put(value)
            time.sleep(0.2)
            before = page.evaluate(paint)
        put(1000)
        page.wait_for(f"{paint} !== {before}")
        assert page.evaluate(clock).startswith("20.00 s, ")
        put(500)
        page.wait_for(f"{paint} === {before}")
        page.evaluate(f"{button}.click()")
        page.wait_for("Number(document.getElementById('time').value) > 520")
        assert page.evaluate(f"{button}.textContent") == "Pause"
        page.evaluate(f"{button}.click()")
        assert page.evaluate(f"{button}.textContent") == "Play"
        at = page.evaluate(clock)
        time.sleep(0.2)
        assert page.evaluate(clock) == at
        assert page.errors == []


# the viewer


@pytest.fixture(scope="module")
def folder(scene: pp.Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pp.write_scene(scene, tmp_path_factory.mktemp("moving") / "out")


@needs_viser
def test_bodies_follow_the_slider(folder: Path, scene: pp.Scene) -> None:
    paths = paths_of(scene)
    moving = np.flatnonzero(paths.moving)
    with view(folder, port=0, open_browser=False, block=False) as viewer:
        node = viewer.server.scene.get_handle_by_name
        balls, ways = node("/parts/0/bodies"), node("/parts/0/ways of bodies")
        assert (viewer.bodies.count, viewer.bodies.total, viewer.points.total) == (38, 38, 60)
        behind = []
        for last in (0, 8, 20, 5):
            for layer in viewer.layers:
                layer.show_until(last)
            now = float(last)
            true = paths.at(now)[moving]
            seen = np.isfinite(true).all(axis=1)
            assert ((balls.batched_scales > 0.1) == seen).all()
            shown = viewer.drawing.parts[0].shown(true[seen])
            np.testing.assert_allclose(balls.batched_positions[seen], shown, rtol=1e-5, atol=1e-5)
            behind.append(len(ways.points) if ways.visible else 0)
            # the way ends at the body
            for place in shown if last else ():
                assert np.linalg.norm(ways.points[:, 1] - place, axis=1).min() < 1e-4
        assert behind[0] <= 20
        assert behind[0] < behind[3] < behind[1] < behind[2]
        viewer.bodies.show(False)
        viewer.bodies.show_until(8)
        assert not balls.visible
        assert not ways.visible
        viewer.bodies.show(True)
        assert balls.visible
        viewer.ellipsoids.show(True)
        assert "60 of 60 points" in viewer.ellipsoids.note


@needs_viser
@pytest.mark.parametrize("kind", ["plane", "no tracks", "nothing moves", "many", "lost"])
def test_any_scene_with_paths_is_drawn(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = crossing(21, 30, dimension=2 if kind == "plane" else 3)
    paths = paths_of(scene)
    if kind == "no tracks":
        scene = replace(scene, tracks=None)
    elif kind == "nothing moves":
        scene = replace(scene, paths=replace(paths, verdicts=(PathVerdict.STATIC,) * len(paths)))
    elif kind == "lost":
        scene = replace(scene, paths=replace(paths, coefficients=np.full_like(paths.coefficients, np.nan)))
    elif kind == "many":
        monkeypatch.setattr("panopath.viewer.layers.MOST_BODIES", 9)
    with view(pp.write_scene(scene, tmp_path / "out"), port=0, open_browser=False, block=False) as viewer:
        assert viewer.bodies.count == {"nothing moves": 0, "many": 9}.get(kind, 38)
        for layer in viewer.layers:
            for last in (0, 20, 10):
                layer.show_until(last)


def test_folder_says_what_moves(folder: Path, scene: pp.Scene) -> None:
    content = read_content(folder)
    assert content.notes == (
        "38 tracks move, 1 imitated, 1 hidden, 1 undetermined; taken to be so: most tracks are at rest",
    )
    # colours of the pictures are found among the points at rest
    colours = np.random.default_rng(0).integers(0, 255, (len(scene.points), 3)).astype(np.uint8)
    found = read_content(pp.write_scene(scene, folder, colours=colours)).colours
    assert found is not None
    np.testing.assert_array_equal(found[:60], colours[:60])


@needs_chromium
@needs_viser
def test_page_shows_bodies(folder: Path, tmp_path: Path) -> None:
    with opened(folder, 900, 600) as (viewer, page):
        page.wait_for("document.body.innerText.includes('Bodies that move (38 tracks)')")
        assert page.errors == []
        page.click_text("Bodies that move (38 tracks)")
        deadline = time.monotonic() + 20.0
        while viewer.server.scene.get_handle_by_name("/parts/0/bodies").visible:
            assert time.monotonic() < deadline
            time.sleep(0.1)


# the picture of the docs


def test_animation_moves_and_is_small(tmp_path: Path, scene: pp.Scene) -> None:
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("matplotlib")
    animate(scene, tmp_path / "a.gif", 6)
    with image.open(tmp_path / "a.gif") as found:
        assert found.n_frames == 6
    shipped = Path(__file__).parent.parent / "docs" / "img" / "moving" / "crossing.gif"
    assert shipped.stat().st_size < 1_000_000


def test_certificate_and_paths_on_one_page(tmp_path: Path, scene: pp.Scene, street: pp.SyntheticWorld) -> None:
    """Words of the certificate stay as they are where bodies move."""
    plain = pp.solve_positions(street.tracks)
    certificate: Certificate = pp.certify(street.tracks, plain)
    n = len(plain.points)
    alone = np.full(n, -1, dtype=np.int32)
    points = np.nan_to_num(plain.points)
    seen_s, verdicts = np.tile((0.0, 1.0), (n, 1)), (PathVerdict.STATIC,) * n
    paths = pp.Paths((pp.Static(),) * n, np.arange(n + 1), points, None, seen_s, verdicts, alone, alone)
    page, _ = written(replace(plain, paths=paths), certificate, tmp_path)
    assert page.text.index("Determined") < page.text.index("Bodies that move") < page.text.index("Track lengths")


@pytest.mark.parametrize("dimension", [2, 3])
def test_pictures_draw_ways(tmp_path: Path, dimension: int) -> None:
    pytest.importorskip("matplotlib")
    scene = crossing(21, 60, dimension=dimension)
    sizes = []
    for k, one in enumerate((scene, replace(scene, paths=None))):
        (tmp_path / str(k)).mkdir()
        sizes.append([path.read_bytes() for path in draw_scene(one, tmp_path / str(k), unit="m")])
    assert sizes[0] != sizes[1]


def test_folder_of_a_command_has_the_report(tmp_path: Path, scene: pp.Scene) -> None:
    assert scene.tracks is not None
    certificate = pp.certify(scene.tracks, at_rest(scene), pp.CertifyOptions(orientation="known"))
    write_folder(scene, certificate, tmp_path / "out", pp.PositionOptions(), False, None)
    assert "Bodies that move" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    write_folder(at_rest(scene), certificate, tmp_path / "out", pp.PositionOptions(), False, None)
    assert not (tmp_path / "out" / "report.html").exists()
