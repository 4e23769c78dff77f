"""The report page: the verdict first, nothing from outside, the scene's own numbers, and a browser that draws it."""

from __future__ import annotations

import base64
import importlib.util
import json
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from conftest import scene_of
from panopath.certificate import Certificate, Consistency, Verdict
from panopath.formats.structure import known_scene
from panopath.images import Picture
from panopath.model import Status, Summary
from panopath.report.page import ReportNotes, write_report
from panopath.report.page_figures import _grid, duration, flattened, rounded, size_of

HOSTILE = '</script><img src=x onerror="window.hostile=1"><b>&'
VOID = {"meta", "img", "br", "rect", "path", "input"}


class Page(HTMLParser):
    """Elements, their attributes and their text; complains where tags do not match."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & set(self.open):
            self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())


def written(scene: pp.Scene, certificate: Certificate | None, folder: Path, **more: Any) -> tuple[Page, dict[str, Any]]:
    path = write_report(scene, certificate, folder / "report.html", **more)
    text = path.read_text(encoding="utf-8")
    check_alone(text)
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    return Page(text), json.loads(found[1])


def check_alone(text: str) -> None:
    """Nothing on the page asks for anything outside it."""
    page = Page(text)
    for tag, attributes in page.elements:
        assert tag not in ("link", "iframe", "object", "embed", "base")
        for name in ("src", "href", "srcset", "action"):
            value = attributes.get(name)
            assert value is None or value.startswith(("data:image/", "./")), (tag, value)
    assert not re.search(r"https?:|url\(|@import|fetch\(|XMLHttpRequest|WebSocket|import\(", text)
    policy = [
        a["content"] for t, a in page.elements if t == "meta" and a.get("http-equiv") == "Content-Security-Policy"
    ]
    assert len(policy) == 1
    assert str(policy[0]).startswith("default-src 'none'")


def solved(world: pp.SyntheticWorld) -> tuple[pp.Scene, Certificate]:
    scene = pp.solve_positions(world.tracks)
    return scene, pp.certify(world.tracks, scene)


@pytest.fixture(scope="module")
def walk(street: pp.SyntheticWorld) -> tuple[pp.Scene, Certificate]:
    return solved(street)


def picture(view: int) -> Picture:
    return np.full((64, 128, 3), 10 * view, dtype=np.uint8)


def test_the_verdict_comes_first(tmp_path: Path, walk: tuple[pp.Scene, Certificate]) -> None:
    scene, certificate = walk
    page, _ = written(scene, certificate, tmp_path, notes=ReportNotes("A walk", "recognised as a walk"))
    assert page.text.index("A walk") < page.text.index("Determined") < page.text.index("views placed")
    sentence = certificate.sentence(scene.view_labels()).partition(": ")[2]
    assert sentence[1:] in page.text
    for title in ("Path and points", "Coverage", "Residuals over the sphere", "Angular residuals", "Track lengths",
                  "Points along the path", "The certificate in full", "Time", "Settings"):  # fmt: skip
        assert title in page.text, title


@pytest.mark.parametrize(
    ("verdict", "passed", "word", "tone"),
    [
        (Verdict.DETERMINED, True, "Determined", "good"),
        (Verdict.WEAK, True, "Weak", "warn"),
        (Verdict.UNDETERMINED, True, "Not determined", "bad"),
        (Verdict.UNDETERMINED, False, "Not determined", "bad"),
        (Verdict.DETERMINED, False, "Contradicted", "bad"),
        (Verdict.WEAK, False, "Contradicted", "bad"),
    ],
)
def test_each_verdict_has_its_word(
    tmp_path: Path, walk: tuple[pp.Scene, Certificate], *, verdict: Verdict, passed: bool, word: str, tone: str
) -> None:
    scene, certificate = walk
    reasons = () if passed else ("views 3 & 4 are forced into <a shape>",)
    certificate = replace(certificate, verdict=verdict, consistency=Consistency(passed, reasons, {"x": (1.0, 2.0)}))
    page, _ = written(scene, certificate, tmp_path)
    (banner,) = [a for t, a in page.elements if a.get("id") == "verdict"]
    assert banner["class"] == f"banner {tone}"
    assert f" {word} " in page.text
    assert all(reason in page.text for reason in reasons)


def test_points_and_path_are_those_of_the_scene(tmp_path: Path, walk: tuple[pp.Scene, Certificate]) -> None:
    pytest.importorskip("cv2", reason="the extra images is absent")
    scene, certificate = walk
    colours = np.random.default_rng(0).integers(0, 255, (len(scene.points), 3)).astype(np.uint8)
    notes = ReportNotes(unit="m", is_upright=True)
    _, data = written(scene, certificate, tmp_path, images=picture, colours=colours, notes=notes)
    (part,) = data["parts"]
    assert np.allclose(part["path"], scene.centers[part["views"]], rtol=1e-5, atol=1e-5)
    assert part["counts"] == scene.view_statistics().n_inliers[part["views"]].tolist()
    whole = np.frombuffer(base64.b64decode(part["points"]), "<u2").reshape(-1, 3)
    points = np.array(part["low"]) + np.array(part["step"]) * whole
    rgb = np.frombuffer(base64.b64decode(part["rgb"]), np.uint8).reshape(-1, 3)
    assert len(points) == len(rgb) > 0.9 * np.isfinite(scene.points).all(axis=1).sum()
    away = np.linalg.norm(scene.points[None] - points[:, None], axis=2)
    nearest = np.nanargmin(away, axis=1)
    assert np.nanmin(away, axis=1).max() <= np.linalg.norm(part["step"])
    assert np.array_equal(rgb, colours[nearest])
    assert [thumb["view"] for thumb in data["thumbs"]] == list(range(20))
    assert base64.b64decode(data["thumbs"][0]["src"].partition(",")[2]).startswith(b"\xff\xd8")


def test_histograms_count_every_observation(tmp_path: Path, walk: tuple[pp.Scene, Certificate]) -> None:
    scene, certificate = walk
    page, _ = written(scene, certificate, tmp_path)
    titles = [str(a["title"]) for t, a in page.elements if t == "i" and a.get("title")]
    counted = [re.search(r": ([\d,]+) used, ([\d,]+) outliers", title) for title in titles]
    used = sum(int(found[1].replace(",", "")) for found in counted if found)
    known = np.isfinite(scene.residual_rad)
    assert used == (scene.inlier & known).sum()
    points = [re.match(r"([\d,]+) points seen by", title) for title in titles]
    lengths = scene.point_statistics().n_inliers
    assert (
        sum(int(found[1].replace(",", "")) for found in points if found)
        == (lengths[scene.track_component >= 0] > 0).sum()
    )


def test_sphere_maps_hold_what_was_used(turned: pp.SyntheticWorld) -> None:
    """Cells of the camera's sphere: counts of the observations used, their rms, and areas that make up the whole."""
    scene = scene_of(turned)
    assert scene.tracks is not None
    inlier = scene.inlier & (scene.tracks.bearing[:, 1] < 0.5)  # nothing was used far below the cameras
    grid = _grid(replace(scene, inlier=inlier))
    assert grid is not None
    assert grid.count.sum() == inlier.sum()
    assert grid.count[17:].sum() == 0.0  # rows go down: 30 degrees below the horizon lies in row 16
    assert grid.area.sum() * grid.count.shape[1] == pytest.approx(1.0)
    told = np.isfinite(grid.rms_deg)
    rms = np.sqrt((grid.count * np.nan_to_num(grid.rms_deg) ** 2)[told].sum() / grid.count[told].sum())
    assert rms == pytest.approx(np.degrees(np.sqrt(np.mean(scene.residual_rad[inlier] ** 2))), rel=0.2)


def test_planar_scene(tmp_path: Path, planar: pp.SyntheticWorld) -> None:
    scene = known_scene(planar.tracks, planar.cam_from_world, planar.centers, planar.points)
    page, data = written(scene, pp.certify(planar.tracks, scene), tmp_path)
    assert [t for t, _ in page.elements].count("canvas") == 1
    assert "From the side" not in page.text
    assert len(data["parts"][0]["axes"]) == 1
    assert "Residuals over the circle" in page.text


def test_mapped_scene(tmp_path: Path, turned: pp.SyntheticWorld) -> None:
    """Orientations found from the bearings, as ``map`` has them."""
    scene = pp.reconstruct_tracks(turned.tracks)
    page, _ = written(scene, pp.certify(turned.tracks, scene), tmp_path)
    assert "straight ahead in the middle" in page.text


def test_scene_without_anything(tmp_path: Path) -> None:
    """Nothing determined, no tracks, no certificate: the page says so and nothing fails."""
    pytest.importorskip("cv2", reason="the extra images is absent")
    scene = pp.Scene(
        centers=np.full((3, 3), np.nan),
        points=np.full((4, 3), np.nan),
        view_component=np.full(3, -1),
        track_component=np.full(4, -1),
        inlier=np.zeros(5, dtype=bool),
        residual_rad=np.full(5, np.nan),
        cam_from_world=np.full((3, 3, 3), np.nan),
        summary=Summary(Status.UNDETERMINED, 0, float("nan")),
    )
    page, data = written(scene, None, tmp_path, images=picture)
    assert "No answer" in page.text
    assert "0 of 3" in page.text
    assert data["parts"] == []
    assert not [t for t, _ in page.elements if t == "canvas"]


def test_one_view_one_point(tmp_path: Path) -> None:
    tracks = pp.Tracks.from_arrays([0], [0], [(0.0, 0.0, 1.0)])
    scene = known_scene(tracks, np.eye(3)[None], np.zeros((1, 3)), np.array([(0.0, 0.0, 5.0)]))
    page, data = written(scene, None, tmp_path)
    assert "Not certified" in page.text
    assert np.isfinite(data["parts"][0]["boxes"]).all()


def test_parts_can_be_chosen(tmp_path: Path, walk: tuple[pp.Scene, Certificate]) -> None:
    scene, certificate = walk
    page, data = written(in_two_parts(scene), certificate, tmp_path)
    assert "parts, each with its own scale" in page.text
    assert [len(part["views"]) for part in data["parts"]] == [12, 8]
    assert [t for t, a in page.elements if a.get("id") == "part"] == ["select"]


def in_two_parts(scene: pp.Scene) -> pp.Scene:
    views = np.where(np.arange(len(scene.centers)) < 8, 1, 0)
    tracks = np.where(scene.track_component >= 0, np.arange(len(scene.points)) % 2, -1)
    return replace(scene, view_component=views, track_component=tracks)


def test_far_points_do_not_take_the_digits(tmp_path: Path, walk: tuple[pp.Scene, Certificate]) -> None:
    scene, certificate = walk
    points = scene.points.copy()
    points[5] = 1e12
    _, data = written(replace(scene, points=points), certificate, tmp_path)
    assert max(data["parts"][0]["step"]) < 1e-2


def test_hostile_names_stay_text(tmp_path: Path, walk: tuple[pp.Scene, Certificate]) -> None:
    pytest.importorskip("cv2", reason="the extra images is absent")
    scene, certificate = walk
    names = tuple(f"{HOSTILE}{i}" for i in range(len(scene.centers)))
    notes = ReportNotes(
        HOSTILE, HOSTILE, HOSTILE, statements=(HOSTILE,), seconds={HOSTILE: 1.0}, outputs={HOSTILE: HOSTILE}
    )
    page, data = written(
        replace(scene, view_names=names),
        certificate,
        tmp_path,
        images=picture,
        settings={HOSTILE: HOSTILE},
        notes=notes,
    )
    assert not [a for t, a in page.elements if a.get("src") == "x" or "onerror" in a]
    assert data["parts"][0]["names"][0] == names[0]


def test_outputs_have_links_and_sizes(tmp_path: Path, walk: tuple[pp.Scene, Certificate]) -> None:
    (tmp_path / "a b#é.ply").write_bytes(b"x" * 2345)
    notes = ReportNotes(outputs={"a b#é.ply": "points", "absent.gpx": "a path"})
    page, _ = written(*walk, tmp_path, notes=notes)
    assert [a["href"] for t, a in page.elements if t == "a"] == ["./a%20b%23é.ply"]
    assert "2.35 kB" in page.text or "2.34 kB" in page.text
    assert "absent.gpx" in page.text


def test_same_scene_same_page(tmp_path: Path, walk: tuple[pp.Scene, Certificate]) -> None:
    pytest.importorskip("cv2", reason="the extra images is absent")
    scene, certificate = walk
    still = replace(scene, summary=replace(scene.summary, seconds={"solve": 1.0}))
    pages = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        path = write_report(still, certificate, tmp_path / name / "report.html", picture, {"seed": 1})
        pages.append(path.read_bytes())
    assert pages[0] == pages[1]


def test_size_is_bounded(tmp_path: Path) -> None:
    """A page of many points is no larger than a picture."""
    rng = np.random.default_rng(0)
    n, m = 3_000, 150_000
    view = np.repeat(np.arange(n), 100)
    track = rng.integers(0, m, len(view))
    bearing = rng.normal(size=(len(view), 3))
    tracks = pp.Tracks.from_arrays(view, track, bearing / np.linalg.norm(bearing, axis=1, keepdims=True), n, m)
    centers = np.column_stack((np.arange(n) * 0.1, np.zeros(n), np.zeros(n)))
    scene = known_scene(tracks, np.tile(np.eye(3), (n, 1, 1)), centers, rng.normal(0.0, 20.0, (m, 3)))
    path = write_report(scene, None, tmp_path / "report.html")
    assert path.stat().st_size < 1_200_000


def test_refuses(tmp_path: Path, walk: tuple[pp.Scene, Certificate], planar: pp.SyntheticWorld) -> None:
    scene, certificate = walk
    with pytest.raises(pp.InputError, match="colours"):
        write_report(scene, certificate, tmp_path / "a.html", colours=np.zeros((2, 3), dtype=np.uint8))
    other = known_scene(planar.tracks, planar.cam_from_world, planar.centers, planar.points)
    with pytest.raises(pp.InputError, match="certificate is of"):
        write_report(other, certificate, tmp_path / "a.html")
    (tmp_path / "folder").mkdir()
    with pytest.raises(pp.InputError, match="cannot be written"):
        write_report(scene, certificate, tmp_path / "folder")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder"]


def test_views_come_in_the_order_they_were_taken(tmp_path: Path, street: pp.SyntheticWorld) -> None:
    timed = scene_of(street)  # times run backwards
    _, data = written(timed, None, tmp_path)
    assert data["parts"][0]["views"] == [v for v in range(19, -1, -1) if v != 1]
    names = tuple(f"p{(7 * i) % 20}.jpg" for i in range(20))
    assert timed.tracks is not None
    named = replace(timed, view_names=names, tracks=replace(timed.tracks, time_s=None))
    _, data = written(named, None, tmp_path)
    assert data["parts"][0]["names"] == [f"p{i}.jpg" for i in range(20) if i != 7]


def test_numbers_as_a_person_says_them() -> None:
    assert [duration(s) for s in (1e-5, 0.0123, 1.234, 12.3, 75.0, 600.0, 7500.0)] == [
        "< 1 ms", "12 ms", "1.2 s", "12 s", "75 s", "10 min", "2 h 5 min",
    ]  # fmt: skip
    assert [size_of(n) for n in (12, 1234, 5_600_000, 7_000_000_000)] == ["12 bytes", "1.23 kB", "5.6 MB", "7 GB"]
    assert [rounded(v) for v in (190.0, 0.0123, 3.0)] == ["190", "0.012", "3"]
    assert flattened({"a": {"b": 1, "c": [1.5, None]}, "d": True, "e": []}) == [
        ("a.b", "1"), ("a.c", "1.5, -"), ("d", "yes"), ("e", "-"),
    ]  # fmt: skip


# in a browser


@pytest.mark.parametrize("width", [1280, 390])
def test_in_headless_chromium(tmp_path: Path, walk: tuple[pp.Scene, Certificate], width: int) -> None:
    if importlib.util.find_spec("PyQt6") is None or importlib.util.find_spec("PyQt6.QtWebEngineCore") is None:
        pytest.skip("PyQt6-WebEngine, a headless Chromium, is absent")
    pytest.importorskip("cv2", reason="the extra images is absent")
    scene, certificate = walk
    scene = replace(in_two_parts(scene), view_names=tuple(f"{HOSTILE}{i}" for i in range(20)))
    colours = np.full((len(scene.points), 3), 90, dtype=np.uint8)
    path = write_report(scene, certificate, tmp_path / "report.html", picture, colours=colours)
    script = Path(__file__).parent / "open_page.py"
    done = subprocess.run(
        [sys.executable, script, path, str(width)], capture_output=True, text=True, timeout=90, check=False
    )
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["console"] == []
    assert [url for url in found["asked"] if not url.startswith("file:")] == []
    assert found["drawn"] == "yes"
    assert found["overflow"] <= 0
    assert min(painted for painted, _ in found["before"]) > 500
    # each thing a reader does changes the drawing, and "whole" brings it back
    assert found["coloured"]
    assert found["error"] != found["before"]
    assert found["nearer"] != found["error"]
    assert found["whole"] == found["error"]
    assert found["pressed"] == 1
    assert found["marked"] != found["whole"]
    assert found["other"] != found["marked"]
    assert "points" in found["tip"]
    assert not found["hostile"]
