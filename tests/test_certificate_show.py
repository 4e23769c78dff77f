"""How certificates are shown: sentences, JSON, pictures, moving pictures, and what the command line says of them."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import matplotlib.image
import numpy as np
import numpy.typing as npt
import panopath as pp
import pytest
from dense_rigidity import cause, certificate_of, scene_of_positions
from panopath.certificate import Cause, CauseKind, Certificate, Consistency, Hinge, RigidComponent, Verdict, hold_still
from panopath.certificate_text import Names
from panopath.formats.folder import check_certificate_writable
from panopath.formats.structure import known_scene
from panopath.report import animate_mode, draw_certificate, explain
from panopath.report.animation import conic_curves, guide_curves, mode_frames
from test_cli import Run, run

__all__ = ["run"]

LINE = [(0.0, 0.0), (1.0, 0.0), (3.0, 0.0)]
OFF = [(1.0, 1.0), (0.0, 2.0), (3.0, 1.4)]
ANGLES = np.radians([12, 50, 98, 140, 170, 215, 285, 325])
ELLIPSE = np.column_stack((2.0 * np.cos(ANGLES), np.sin(ANGLES)))


def on_a_line() -> pp.Scene:
    """Three views on a line with point 0, which a fourth view does not see."""
    pairs = [(i, j) for i in range(4) for j in range(4) if (i, j) != (3, 0)]
    return scene_of_positions([*LINE, (1.0, 2.0)], [(2.0, 0.0), *OFF], pairs)


def line_cause() -> Cause:
    return cause(CauseKind.CAMERA_COLLINEAR, range(3), [0], shape=np.array([(0.0, 0.0), (1.0, 0.0)]))


def ellipse_scene() -> pp.Scene:
    return scene_of_positions(ELLIPSE[::2], ELLIPSE[1::2])


def two_parts() -> pp.Scene:
    """Two rigid parts that share point 0."""
    views = [(-3.2, -0.9), (-2.2, 1.5), (-1.0, -1.6), (1.1, 1.5), (2.4, -1.5), (3.3, 0.8)]
    points = [(0.0, 0.0), (-3.3, 0.7), (-1.5, 0.35), (1.3, -0.7), (3.1, -0.4)]
    pairs = [(i, j) for i in (0, 1, 2) for j in (0, 1, 2)] + [(i, j) for i in (3, 4, 5) for j in (0, 3, 4)]
    return scene_of_positions(views, points, pairs)


def ids(first: int, end: int) -> npt.NDArray[np.int32]:
    return np.arange(first, end, dtype=np.int32)


def with_causes(*causes: Cause, **fields: Any) -> Certificate:
    return replace(certificate_of(two_parts(), causes), **fields)


# Sentences


def test_sentence_of_a_determined_scene() -> None:
    world = pp.simulate("box", n_views=5, n_points=12, seed=1)
    scene = known_scene(world.tracks, None, world.centers, world.points)
    certificate = certificate_of(scene, sigma_rad=math.radians(0.1))
    said = certificate.sentence()
    assert said.startswith("determined: all 5 views, all 12 points; noise of 0.1 degrees moves views by ")
    assert certificate.is_determined


def test_sentence_of_the_issue() -> None:
    """The verdict before the colon, the counts, the further parts, who can move how and why."""
    part = RigidComponent(ids(0, 97), ids(0, 4812), 40_000, Verdict.DETERMINED, 0.01)
    second = RigidComponent(ids(97, 100), ids(4812, 4900), 200, Verdict.DETERMINED, 0.01)
    third = replace(second, views=np.array([5]), tracks=np.array([5019, 5018]))
    slides = cause(
        CauseKind.CAMERA_COLLINEAR,
        [97, 98, 99],
        [4812],
        components=(1,),
        shape=np.array([np.zeros(3), (0.0, 1.0, 0.0)]),
    )
    certificate = with_causes(
        slides,
        components=(part, second, third),
        verdict=Verdict.DETERMINED,
        n_views=100,
        n_tracks=5020,
        view_line=np.full((100, 3), np.nan),
        track_line=np.full((5020, 3), np.nan),
    )
    said = certificate.sentence()
    assert said.startswith("determined: 97 of 100 views, 4,812 of 5,020 points; 2 further parts; ")
    assert said.endswith("part 2 can slide along (0.00, 1.00, 0.00) because its 3 views lie on one line with it")


def test_sentence_names_who_is_loose() -> None:
    certificate = certificate_of(on_a_line(), [line_cause()])
    assert certificate.sentence(track_labels=["door", "a", "b", "c"]) == (
        "undetermined: the largest rigid part has all 4 views, 3 of 4 points; 1 point in no part; "
        "point door can slide along (1.00, 0.00) because its 3 views lie on one line with it"
    )
    certificate = certificate_of(ellipse_scene(), [cause(CauseKind.CONIC, range(4), range(4), detail="ellipse")])
    assert certificate.sentence() == (
        "undetermined: no part of its 4 views and 4 points is rigid; views 0 to 3 and points 0 to 3 can change shape "
        "because they lie on one ellipse"
    )


EXPECTED = {
    CauseKind.ONE_CAMERA: "points 1, 2 and 4 can slide along their rays because view 0 alone sees them",
    CauseKind.TWO_CAMERAS: "view 0 and points 1, 2 and 4 can change shape because two views in the plane fix no shape",
    CauseKind.TWO_POINTS: "can change shape because two points in the plane fix no shape, however many views see them",
    CauseKind.CAMERA_COLLINEAR: "points 1, 2 and 4 can slide, each along a line of its own because the views of each",
    CauseKind.POINT_COLLINEAR: "view 0 can slide along a line because its 3 points lie on one line with it",
    CauseKind.TWO_LINES_1: "because the views lie on one line and the points on another",
    CauseKind.TWO_LINES_2: "because they lie on two lines",
    CauseKind.CONIC: "because they lie on one parabola",
    CauseKind.COPLANAR_TWO_BY_TWO: "because these views and points lie in one plane",
    CauseKind.HIDDEN_POINT: "points 1, 2 and 4 can slide, each along a line of its own because each is seen in one",
    CauseKind.TOO_FEW_EQUATIONS: "because there are fewer equations than unknowns (parabola)",
    CauseKind.DISCONNECTED: "parts 1 and 2 can move and change size against each other because no observation ties",
    CauseKind.WEAK_JOIN: "parts 1 and 2 can change size against each other because too little joins them (parabola)",
    CauseKind.OTHER: "because the bearings allow it, for a reason that has no name (parabola)",
}


@pytest.mark.parametrize("kind", list(CauseKind))
def test_every_cause_has_a_sentence(kind: CauseKind) -> None:
    apart = kind in (CauseKind.DISCONNECTED, CauseKind.WEAK_JOIN)
    exact = cause(kind, [0], [1, 2, 4], detail="parabola", components=(0, 1) if apart else ())
    said = with_causes(exact).sentence()
    assert EXPECTED[kind] in said
    nearly = with_causes(replace(exact, is_exact=False)).sentence()
    always = (CauseKind.ONE_CAMERA, CauseKind.DISCONNECTED)
    assert (nearly == said) == (kind in always)


def test_hidden_tells_a_view_from_a_point() -> None:
    seen = certificate_of(
        scene_of_positions([*LINE, (1.0, 2.0)], OFF, [(i, j) for i in range(3) for j in range(3)] + [(3, 0)])
    )
    hidden = cause(CauseKind.HIDDEN_POINT, [3], [0])
    said = replace(seen, causes=(hidden,)).sentence()
    assert (
        said.endswith("view 3 can slide along (0.00, 1.00) because it sees one point only")
        or "view 3 can slide" in said
    )
    assert "it sees one point only" in said


def test_weak_and_inconsistent_say_so() -> None:
    world = pp.simulate("box", n_views=5, n_points=12, seed=1)
    scene = known_scene(world.tracks, None, world.centers, world.points)
    weak = certificate_of(scene, sigma_rad=2.0)
    assert weak.sentence().startswith("weak: all 5 views, all 12 points, but noise of 115 degrees moves views by ")
    assert not weak.is_determined
    gate = Consistency(False, ("views 3 to 4: half of their observations are rejected.",), {})
    bent = certificate_of(scene, consistency=gate)
    assert bent.verdict is Verdict.DETERMINED
    assert not bent.is_determined
    told = "; but the scene contradicts its bearings: views 3 to 4: half of their observations are rejected."
    assert bent.sentence().endswith(told)
    wrong = replace(bent, verdict=Verdict.WEAK)
    assert wrong.sentence() == f"weak: all 5 views, all 12 points{told}"
    few = replace(certificate_of(scene), verdict=Verdict.WEAK, n_views=9)
    assert few.sentence().startswith("weak: 5 of 9 views, all 12 points, too few of those that were observed; ")
    assert bent.explain()[1] == "inconsistent: views 3 to 4: half of their observations are rejected."


@pytest.mark.parametrize(
    ("members", "names", "said"),
    [
        ([3], None, "view 3"),
        ([3, 7], None, "views 3 and 7"),
        ([3, 4, 5], None, "views 3 to 5"),
        ([3, 7, 9, 12], None, "views 3, 7, 9 and 12"),
        (range(0, 88, 2), None, "views 0, 2, 4 and 41 more"),
        ([0, 1, 2], ["a", "b", "c"], "views a, b and c"),
        ([], None, "no view"),
    ],
)
def test_lists_of_members(members: Sequence[int], names: list[str] | None, said: str) -> None:
    assert Names(views=names).of_views(members) == said


def test_explain_tells_all_and_stays_short() -> None:
    certificate = certificate_of(two_parts(), [cause(CauseKind.WEAK_JOIN, (), [0], components=(0, 1), detail="a")])
    lines = certificate.explain()
    assert lines[0] == certificate.sentence()
    assert "free movements: 4, of which the gauge has 3 (orientations known): 1 more" in lines
    assert any(line.startswith("part 2: determined, 3 views, 3 points") for line in lines)
    assert "hinge: parts 1 and 2 share point 0" in lines
    assert any(line.startswith("weakly held: view 5, to 20 %") for line in lines)
    many = replace(certificate, hinges=tuple(Hinge((0, 1), np.array([0]), np.empty(0, int)) for _ in range(500)))
    assert "... and 492 more hinges" in many.explain()
    assert len(many.explain()) < 40


def test_explain_names_only_what_moves_against_the_largest_part() -> None:
    scene = on_a_line()
    certificate = certificate_of(scene, [line_cause()])
    assert any(line.endswith("moves part 1 and point 0") for line in certificate.explain())
    lines, paths = explain(certificate, scene)
    assert any(line.endswith("moves point 0") for line in lines)
    assert paths == []


@pytest.mark.parametrize("orientation", ["known", "free", "vertical"])
@pytest.mark.parametrize("d", [2, 3])
def test_the_whole_scene_moving_is_no_mode(d: int, orientation: Any) -> None:
    """Shift, growth and the turns that are free are taken away, whatever their amount; other turns are not."""
    if d == 2 and orientation == "vertical":
        return
    rng = np.random.default_rng(3)
    centers, points = rng.normal(size=(4, d)), rng.normal(size=(5, d))
    place = np.vstack((centers, points))
    moved = 0.3 * place + rng.normal(size=d)
    spin = np.zeros((d, d))
    spin[0, 1], spin[1, 0] = -0.7, 0.7
    turned = moved + place @ spin.T
    first = certificate_of(scene_of_positions(ELLIPSE[::2], ELLIPSE[1::2])).modes[0]
    for movement, is_gauge in ((moved, True), (turned, orientation != "known")):
        mode = replace(first, view_displacement=movement[:4], track_displacement=movement[4:])
        rest = hold_still(mode, centers, points, np.arange(9, dtype=np.int32), orientation)
        assert (np.abs(np.vstack((rest.view_displacement, rest.track_displacement))).max() < 1e-8) == is_gauge


# Plain values


def test_json_is_plain_stable_and_bounded() -> None:
    certificate = certificate_of(on_a_line(), [line_cause()])
    plain = certificate.to_dict()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert list(plain) == list(certificate_of(ellipse_scene()).to_dict())
    assert plain["modes"][0]["movement"] is None
    assert plain["view_line"][0] is None
    assert plain["loose_tracks"] == {"count": 1, "indices": [0], "line": [[1.0, 0.0]]}
    assert plain["components"][0]["tracks"] == {"count": 3, "indices": [1, 2, 3]}
    assert plain["causes"][0]["sentence"].startswith("point 0 can slide")
    many = replace(
        certificate.components[0], views=np.arange(4000, dtype=np.int32), tracks=np.arange(5000, dtype=np.int32)
    )
    told = replace(certificate, components=(many,), n_views=4000, n_tracks=5000).to_dict()["components"][0]
    assert len(told["views"]) == 4000
    assert told["tracks"]["count"] == 5000
    assert told["tracks"]["indices"] == list(range(1000))


def test_scene_folder_keeps_its_certificate(tmp_path: Path) -> None:
    scene = on_a_line()
    certificate = certificate_of(scene, [line_cause()])
    pp.write_scene(scene, tmp_path / "out", certificate=certificate)
    assert pp.read_certificate(tmp_path / "out") == certificate.to_dict()
    # rows of numbers stand on one line
    assert len((tmp_path / "out" / "scene.json").read_text().splitlines()) < 250
    pp.write_scene(scene, tmp_path / "out")
    with pytest.raises(pp.InputError, match="holds no certificate"):
        pp.read_certificate(tmp_path / "out")


def test_certificate_beside_other_files(tmp_path: Path) -> None:
    scene = on_a_line()
    certificate = certificate_of(scene, [line_cause()])
    path = pp.write_certificate(certificate, scene, tmp_path / "models")
    assert path.name == "certificate.json"
    assert pp.read_certificate(tmp_path / "models") == certificate.to_dict()
    pp.write_certificate(certificate, scene, tmp_path / "models")
    path.write_text('{"certificate": "of birth"}')
    with pytest.raises(pp.InputError, match="is not panopath's"):
        pp.write_certificate(certificate, scene, tmp_path / "models")
    with pytest.raises(pp.InputError, match="is a file"):
        check_certificate_writable(path)
    assert sorted(found.name for found in (tmp_path / "models").iterdir()) == ["certificate.json"]


# Pictures


def pictured(tmp_path: Path, scene: pp.Scene, certificate: Certificate) -> Any:
    (path,) = draw_certificate(scene, certificate, tmp_path)
    assert path.name == "certificate.png"
    image = matplotlib.image.imread(path)[..., :3]
    assert min(image.shape[:2]) > 500
    return (255.0 * image).round()


def share_of(image: Any, colour: str) -> float:
    wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return float((np.abs(image - wanted).max(axis=2) < 3).mean())


def test_picture_shows_parts_and_what_slides(tmp_path: Path) -> None:
    scene = on_a_line()
    held = pictured(tmp_path, two_parts(), certificate_of(two_parts()))
    slides = pictured(tmp_path, scene, certificate_of(scene, [line_cause()]))
    first, second, loose = "#1f5fa8", "#2e8b57", "#d9480f"
    assert share_of(held, second) > 1e-4
    assert share_of(held, loose) < 1e-6
    assert share_of(slides, first) > 1e-4
    assert share_of(slides, second) < 1e-6
    assert share_of(slides, loose) > 1e-4


def test_picture_of_weak_modes_in_space_and_of_a_conic(tmp_path: Path) -> None:
    world = pp.simulate("box", n_views=6, n_points=15, seed=1)
    scene = known_scene(world.tracks, None, world.centers, world.points)
    image = pictured(tmp_path, scene, certificate_of(scene, sigma_rad=1.0))
    # two panels, from above and from the side
    assert image.shape[1] > 1.6 * image.shape[0]
    oval = cause(CauseKind.CONIC, range(4), range(4), shape=np.array((0.25, 0.0, 1.0, 0.0, 0.0, -1.0)))
    with_curve = pictured(tmp_path, ellipse_scene(), certificate_of(ellipse_scene(), [oval]))
    without = pictured(tmp_path, ellipse_scene(), certificate_of(ellipse_scene()))
    assert share_of(with_curve, "#444444") > share_of(without, "#444444") + 1e-4


def test_picture_of_nothing_and_the_same_bytes_twice(tmp_path: Path) -> None:
    scene = on_a_line()
    certificate = certificate_of(scene, [line_cause()])
    bytes_before = draw_certificate(scene, certificate, tmp_path)[0].read_bytes()
    assert draw_certificate(scene, certificate, tmp_path)[0].read_bytes() == bytes_before
    nothing = replace(
        scene,
        centers=np.full((4, 2), np.nan),
        points=np.full((4, 2), np.nan),
        view_component=np.full(4, -1),
        track_component=np.full(4, -1),
    )
    empty = replace(
        certificate, components=(), hinges=(), view_component=np.full(4, -1), track_component=np.full(4, -1)
    )
    pictured(tmp_path, nothing, empty)


# Moving pictures


@pytest.mark.parametrize("scene", [on_a_line(), ellipse_scene(), two_parts()], ids=["line", "ellipse", "parts"])
def test_no_bearing_changes_while_the_scene_moves(scene: pp.Scene) -> None:
    assert scene.tracks is not None
    frames = mode_frames(scene, certificate_of(scene))
    np.testing.assert_allclose(frames.views[0], scene.centers, atol=1e-12)
    assert np.ptp(frames.times) > 0.0
    for views, points in zip(frames.views, frames.points, strict=True):
        ray = points[scene.tracks.track] - views[scene.tracks.view]
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        np.testing.assert_allclose(ray, scene.tracks.bearing, atol=1e-9)
    extent = np.ptp(np.vstack((scene.centers, scene.points)), axis=0).max()
    moved = max(np.abs(frames.points - frames.points[0]).max(), np.abs(frames.views - frames.views[0]).max())
    assert 0.05 * extent < moved < 0.5 * extent


def test_members_stay_on_their_conic_which_moves() -> None:
    oval = cause(CauseKind.CONIC, range(4), range(4))
    certificate = certificate_of(ellipse_scene(), [oval])
    frames = mode_frames(ellipse_scene(), certificate)
    first, later = (guide_curves(certificate, frames.views[k], frames.points[k], 3.0)[0] for k in (0, 8))
    assert np.abs(first - later).max() > 0.01
    members = np.vstack((frames.views[8], frames.points[8]))
    gap = np.linalg.norm(members[:, None] - later[None], axis=2).min(axis=1)
    assert gap.max() < 0.2
    u = np.array((-1.2, -0.3, 0.9))
    arms = np.vstack([np.column_stack((side * np.cosh(u), np.sinh(u))) for side in (1.0, -1.0)])
    middle = np.array((5.0, 2.0))
    assert len(conic_curves(arms + middle, 3.0)) == 4
    for curve in conic_curves(arms + middle, 3.0):
        x, y = (curve - middle).T
        np.testing.assert_allclose(x * x - y * y, 1.0, atol=1e-9)


def test_two_lines_open_into_a_hyperbola_and_no_sample_jumps() -> None:
    """On both sides of the degenerate conic, members stay on the curve; from frame to frame it moves a little only."""
    views = [(-3.0, -0.9), (-1.4, -0.42), (1.1, 0.33), (2.8, 0.84)]
    scene = scene_of_positions(views, [(-0.9, 1.8), (-0.5, 1.0), (0.4, -0.8), (0.85, -1.7)])
    certificate = certificate_of(scene, [cause(CauseKind.TWO_LINES_1, range(4), range(4))])
    frames = mode_frames(scene, certificate)
    steps = [guide_curves(certificate, *places, 8.0) for places in zip(frames.views, frames.points, strict=True)]
    for curves, views_now, points_now in zip(steps, frames.views, frames.points, strict=True):
        assert [len(curve) for curve in curves] == [len(curve) for curve in steps[0]]
        fine = np.vstack([np.linspace(curve[:-1], curve[1:], 40).reshape(-1, 2) for curve in curves])
        gap = np.linalg.norm(np.vstack((views_now, points_now))[:, None] - fine[None], axis=2).min(axis=1)
        assert gap.max() < 0.06
    for before, after in zip(steps, [*steps[1:], steps[0]], strict=True):
        assert max(np.abs(b - a)[:10].max() for b, a in zip(before, after, strict=True)) < 0.5
    parallel = np.array([(0.0, 0.0), (1.0, 0.0), (3.0, 0.0), (0.5, 2.0), (2.0, 2.0), (4.0, 2.0)])
    lines = conic_curves(parallel, 3.0)
    assert sorted(float(np.ptp(line[:, 1])) for line in lines) == pytest.approx([0.0, 0.0], abs=1e-9)
    assert conic_curves(parallel[:3], 3.0) == []


def test_svg_is_well_formed_and_moves_only_what_moves(tmp_path: Path) -> None:
    scene = on_a_line()
    path = animate_mode(scene, certificate_of(scene, [line_cause()]), tmp_path / "line.svg")
    root = ElementTree.parse(path).getroot()
    name = "{http://www.w3.org/2000/svg}"
    moving = [circle for circle in root.iter(f"{name}circle") if circle.find(f"{name}animate") is not None]
    assert len(moving) == 1
    assert not [square for square in root.iter(f"{name}rect") if square.find(f"{name}animate") is not None]
    first, *values = moving[0].findall(f"{name}animate")[0].attrib["values"].split(";")
    assert first == values[-1] == moving[0].attrib["cx"]
    assert path.stat().st_size < 20_000
    assert "<script" not in path.read_text()


def test_nothing_to_move_is_said(tmp_path: Path) -> None:
    world = pp.simulate("box", n_views=5, n_points=12, seed=1)
    scene = known_scene(world.tracks, None, world.centers, world.points)
    with pytest.raises(pp.InputError, match="no null mode"):
        animate_mode(scene, certificate_of(scene), tmp_path / "still.svg")
    assert not (tmp_path / "still.svg").exists()


# Command line


def write_bearings(scene: pp.Scene, path: Path) -> None:
    assert scene.tracks is not None
    pp.write_tracks(scene.tracks, path)


def test_check_a_determined_scene(run: Run, tmp_path: Path) -> None:
    run("simulate", "street", "-o", "s.csv", "--views", "12", "--points", "200", "--seed", "4", "--noise-deg", "0.05")
    solved = run("solve", "s.csv", "-o", "out", "--no-plots")
    (line,) = [text for text in solved.out.splitlines() if text.startswith("certificate: ")]
    assert line.startswith("certificate: determined: all 12 views, ")
    kept = pp.read_certificate("out")
    assert line == f"certificate: {kept['sentence']}"
    told = run("check", "out")
    assert (told.code, told.err) == (0, "")
    assert told.out.strip() == kept["sentence"]
    again = run("check", "s.csv", "--json").json
    assert again["sentence"] == kept["sentence"]
    assert run("solve", "s.csv", "--json").json["certificate"]["verdict"] == "determined"
    assert run("check", "out", "--orientation", "free", "--json").json["gauge_freedoms"] == 7
    assert run("check", "out", "--orientation", "vertical", "--json").json["gauge_freedoms"] == 5
    assert run("check", "s.csv", "--orientation", "free", "--json").json["gauge_freedoms"] == 7
    assert run("check", "out", "-q").out == ""


def test_check_writes_what_it_found(run: Run, tmp_path: Path) -> None:
    run("simulate", "box", "-o", "b.csv", "--views", "6", "--points", "20")
    assert run("check", "b.csv", "-o", "found").code == 0
    assert sorted(path.name for path in (tmp_path / "found").iterdir()) == ["certificate.json", "certificate.png"]
    assert pp.read_certificate("found")["verdict"] == "determined"
    run("check", "b.csv", "-o", "bare", "--no-plots")
    assert [path.name for path in (tmp_path / "bare").iterdir()] == ["certificate.json"]


def test_check_knows_how_a_folder_was_solved(run: Run) -> None:
    run("simulate", "room", "-o", "r.csv", "--views", "10", "--points", "150", "--camera-frame")
    run("solve", "r.csv", "--unknown-orientation", "-o", "out", "--no-plots")
    assert pp.read_certificate("out")["orientation"] == "free"
    assert run("check", "out", "--json").json["orientation"] == "free"
    with_turns = run("check", "r.csv", "--orientations", "r.orientations.csv", "--json").json
    assert with_turns["orientation"] == "known"


def test_check_says_what_is_loose(run: Run, tmp_path: Path) -> None:
    write_bearings(ellipse_scene(), tmp_path / "oval.csv")
    told = run("check", "oval.csv", "-v")
    assert told.code == 3
    assert told.out.startswith("undetermined: no part of its 4 views and 4 points is rigid")
    for text in ("free movements: 4, of which the gauge has 3", "mode 1 (null", "noise: "):
        assert text in told.out
    plain = run("check", "oval.csv", "--json")
    assert (plain.code, plain.json["nullity"], plain.json["is_determined"]) == (3, 4, False)
    assert plain.json["lines"][0] == plain.json["sentence"]


def test_check_of_parts_that_share_a_member_tells_both(run: Run, tmp_path: Path) -> None:
    """Split, the shared point would have a place in one part only."""
    write_bearings(two_parts(), tmp_path / "parts.csv")
    plain = run("check", "parts.csv", "--json").json
    assert [len(part["views"]) for part in plain["components"]] == [3, 3]
    assert plain["hinges"] == [{"components": [0, 1], "views": [], "tracks": {"count": 1, "indices": [0]}}]


def test_check_of_a_colmap_model_leaves_orientations_free(run: Run) -> None:
    pytest.importorskip("pycolmap", reason="the extra colmap is not installed")
    run("simulate", "room", "-o", "r.csv", "--views", "8", "--points", "100", "--noise-deg", "0.05")
    run("solve", "r.csv", "-o", "out", "--no-plots")
    told = run("check", "out/colmap/0", "--json").json
    assert (told["orientation"], told["gauge_freedoms"], told["verdict"]) == ("free", 7, "determined")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("check", "none.csv"), "none.csv: there is no such file"),
        (("check", "b.csv", "--sigma-deg", "0"), "--sigma-deg is 0.0"),
        (("check", "b.truth", "--sigma-deg", "nan"), "--sigma-deg is nan"),
        (("check", "b.csv", "--orientation", "vertical"), "asks for space"),
        (("check", "b.csv", "--orientation", "sideways"), "sideways"),
        (("check", "b.csv", "-o", "b.csv"), "is a file"),
        (("check", "b.csv", "-o", "mine"), "is not panopath's"),
        (("check", "mine"), "mine"),
    ],
)
def test_mistakes(run: Run, tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    run("simulate", "box", "-o", "b.csv", "--views", "4", "--points", "10", "--dimension", "2")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "certificate.json").write_text("precious")
    ran = run(*arguments)
    assert (ran.code, ran.out) == (2, "")
    assert message in " ".join(ran.err.split())
    assert (tmp_path / "mine" / "certificate.json").read_text() == "precious"


def test_check_without_matplotlib(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(*_: Any) -> None:
        raise pp.MissingExtraError("pictures need matplotlib")

    monkeypatch.setattr("panopath.cli.certifying.draw_certificate", absent)
    run("simulate", "box", "-o", "b.csv", "--views", "6", "--points", "20")
    told = run("check", "b.csv", "-o", "found")
    assert (told.code, told.err.strip()) == (0, "panopath: pictures need matplotlib")
    assert pp.read_certificate("found")["verdict"] == "determined"
