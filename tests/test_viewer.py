"""The viewer: its shapes by numbers, what it reads, the server, and the page in headless Chromium if there is one."""

from __future__ import annotations

import importlib.util
import itertools
import json
import socket
import struct
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
import pytest
from conftest import scene_of
from panopath.cameras import bearings_from_equirectangular, equirectangular_from_bearings
from panopath.cli import main
from panopath.formats.colours import sampled
from panopath.formats.csv import quaternion_from_rotation, rotation_from_quaternion
from panopath.images import encoded, read_image
from panopath.viewer import Viewer, view
from panopath.viewer.content import read_content
from panopath.viewer.glb import textured
from panopath.viewer.layers import Drawing
from panopath.viewer.panel import verdict_html
from panopath.viewer.shapes import (
    MOST_PARTS,
    REACH,
    Mesh,
    across,
    ball,
    ellipsoids,
    panorama_sphere,
    parts_of,
    round_factor,
    shown_axes,
    spread,
    view_order,
    world_from_cam,
)
from panopath.viewer.shapes import in_space as in_three

from docs.figures_view import Page, find_chromium, opened, write_walk

Float = npt.NDArray[np.float64]

needs_viser = pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser (extra view) is absent")
needs_opencv = pytest.mark.skipif(importlib.util.find_spec("cv2") is None, reason="OpenCV (extra images) is absent")
needs_chromium = pytest.mark.skipif(find_chromium() is None, reason="Chromium is absent")


def solid_angle(mesh: Mesh) -> float:
    """Signed solid angle of all triangles from the centre; positive where they are seen from outside."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    triple = (a * np.cross(b, c)).sum(axis=1)
    below = 1.0 + (a * b).sum(axis=1) + (b * c).sum(axis=1) + (c * a).sum(axis=1)
    return float(2.0 * np.arctan2(triple, below).sum())


def place_of(mesh: Mesh, uv: Float) -> Float:
    """Where a texture coordinate lies on the mesh: interpolated within the triangle that holds it."""
    assert mesh.uv is not None
    a, b, c = (mesh.uv[mesh.faces[:, k]] for k in range(3))
    edges = np.stack((b - a, c - a), axis=2)
    weights = np.linalg.solve(edges, (uv - a)[:, :, None])[:, :, 0]
    inside = np.minimum(weights.min(axis=1), 1.0 - weights.sum(axis=1))
    k = int(np.argmax(inside))
    assert inside[k] > -1e-9
    first, second = weights[k]
    corner = mesh.vertices[mesh.faces[k]]
    place: Float = (1.0 - first - second) * corner[0] + first * corner[1] + second * corner[2]
    return place


def test_panorama_sphere_has_the_axes_of_the_camera() -> None:
    mesh = panorama_sphere(64, 32)
    for uv, bearing in (
        ((0.5, 0.5), (0.0, 0.0, 1.0)),
        ((0.75, 0.5), (1.0, 0.0, 0.0)),
        ((0.25, 0.5), (-1.0, 0.0, 0.0)),
        ((0.0, 0.5), (0.0, 0.0, -1.0)),
        ((1.0, 0.5), (0.0, 0.0, -1.0)),
        ((0.5, 0.0), (0.0, -1.0, 0.0)),
        ((0.5, 1.0), (0.0, 1.0, 0.0)),
    ):
        np.testing.assert_allclose(place_of(mesh, np.array(uv)), bearing, atol=1e-12)


def test_panorama_sphere_shows_each_point_in_its_direction() -> None:
    """A point is projected into the panorama; what the sphere shows there lies in the direction of the point."""
    rng = np.random.default_rng(1)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    cam_from_world = rotation * np.linalg.det(rotation)
    center, points, (width, height) = rng.normal(size=3), 5.0 * rng.normal(size=(40, 3)), (2048, 1024)
    pixel = equirectangular_from_bearings((points - center) @ cam_from_world.T, width, height)
    # as the viewer sends it to the browser: a quaternion that turns the sphere
    wxyz = quaternion_from_rotation(cam_from_world.T[None])
    turned = rotation_from_quaternion(wxyz)[0]
    mesh = panorama_sphere()
    for point, (x, y) in zip(points, pixel, strict=True):
        shown = turned @ place_of(mesh, np.array([x / width, y / height]))
        direction = (point - center) / np.linalg.norm(point - center)
        assert np.arccos(np.clip(shown @ direction / np.linalg.norm(shown), -1.0, 1.0)) < 1e-3
    # at the corners there is nothing between
    assert mesh.uv is not None
    corner = mesh.uv * (width, height)
    np.testing.assert_allclose(mesh.vertices, bearings_from_equirectangular(corner, width, height), atol=1e-12)


def test_spheres_are_whole_and_face_the_right_way() -> None:
    np.testing.assert_allclose(solid_angle(panorama_sphere(32, 16)), -4.0 * np.pi, rtol=1e-12)
    for rounds in (0, 1, 2):
        mesh = ball(rounds)
        np.testing.assert_allclose(solid_angle(mesh), 4.0 * np.pi, rtol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 1.0)
        assert len(mesh.faces) == 8 * 4**rounds
        assert len(mesh.vertices) == len(mesh.faces) // 2 + 2
        assert len(np.unique(mesh.faces)) == len(mesh.vertices)


def test_ellipsoids_give_the_covariance_back() -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(30, 3, 3)) * rng.uniform(1e-4, 10.0, (30, 1, 1))
    covariance = root @ root.transpose(0, 2, 1)
    covariance[3] = np.nan
    covariance[4] = 0.0
    covariance[5] = np.outer((1.0, 2.0, 2.0), (1.0, 2.0, 2.0))
    axes, wxyz = ellipsoids(covariance)
    assert np.isnan(axes[3]).all()
    assert np.isnan(wxyz[3]).all()
    known = np.delete(np.arange(30), 3)
    turn = rotation_from_quaternion(wxyz[known])
    again = (turn * axes[known, None] ** 2) @ turn.transpose(0, 2, 1)
    size = np.abs(covariance[known]).max(axis=(1, 2), keepdims=True)
    assert (np.abs(again - covariance[known]) <= 1e-12 * size + 1e-30).all()
    np.testing.assert_allclose(np.linalg.det(turn), 1.0)
    np.testing.assert_allclose(axes[5].max(), 3.0)
    flat, _ = ellipsoids(np.array([[[4.0, 0.0], [0.0, 9.0]]]))
    np.testing.assert_allclose(np.sort(flat[0]), (0.0, 2.0, 3.0))
    assert ellipsoids(np.zeros((0, 3, 3)))[0].shape == (0, 3)


def test_shown_axes_grow_up_to_a_limit_and_stay_thick_enough() -> None:
    axes = np.array([[1.0, 2.0, 4.0], [0.0, 0.0, 1e-3], [0.0, 0.0, 0.0]])
    shown = shown_axes(axes, 10.0, 20.0)
    np.testing.assert_allclose(shown[0], (5.0, 10.0, 20.0))
    np.testing.assert_allclose(shown[1], (2e-4, 2e-4, 1e-2))
    assert (shown[2] == 0.0).all()


@pytest.mark.parametrize(
    ("value", "expected"), [(0.3, 1), (1.0, 1), (4.9, 2), (5.0, 5), (99.9, 50), (1000.0, 1000), (np.inf, 1)]
)
def test_round_factor(value: float, expected: float) -> None:
    assert round_factor(value) == expected


def test_spread_is_even_and_keeps_the_ends() -> None:
    assert spread(5, 9).tolist() == [0, 1, 2, 3, 4]
    thin = spread(1_000_000, 1000)
    assert len(np.unique(thin)) == 1000
    assert (thin[0], thin[-1]) == (0, 999_999)
    assert np.ptp(np.diff(thin)) <= 1
    assert len(spread(0, 10)) == len(spread(10, 0)) == 0


def in_parts(n_parts: int) -> pp.Scene:
    """Parts of 4 + k views each on a line, all about the origin."""
    component = np.concatenate([np.full(4 + k, k, dtype=np.int32) for k in range(n_parts)])
    n = len(component)
    rng = np.random.default_rng(3)
    return pp.Scene(
        centers=rng.normal(size=(n, 3)),
        points=np.concatenate((rng.normal(size=(n, 3)), np.full((1, 3), np.nan))),
        view_component=component,
        track_component=np.append(component, -1).astype(np.int32),
        inlier=np.zeros(0, dtype=np.bool_),
        residual_rad=np.zeros(0),
        cam_from_world=np.tile(np.eye(3), (n, 1, 1)),
        summary=pp.Summary(pp.Status.DISCONNECTED, 1, float("nan")),
    )


def test_parts_stand_apart_or_where_they_are() -> None:
    scene = in_parts(3)
    apart = parts_of(scene, apart=True)
    assert [part.name for part in apart] == ["part 3", "part 2", "part 1"]
    spans = [part.shown(scene.centers[part.views])[:, 0] + part.offset[0] for part in apart]
    assert all(left.max() < right.min() for left, right in itertools.pairwise(spans))
    together = parts_of(scene, apart=False)
    shown = np.concatenate([part.shown(scene.centers[part.views]) + part.offset for part in together])
    world = np.concatenate([scene.centers[part.views] for part in together])
    np.testing.assert_allclose(np.diff(shown, axis=0), together[0].scale * np.diff(world, axis=0), atol=1e-12)
    assert np.linalg.norm(apart[0].shown(scene.centers[apart[0].views]), axis=1).max() <= REACH * (1.0 + 1e-12)


def test_across_is_along_the_path() -> None:
    along = np.linspace(-1.0, 2.0, 9)[:, None]
    np.testing.assert_allclose(across(along * (-3.0, 4.0, 50.0)), (0.6, -0.8, 0.0), atol=1e-12)
    for few in (along * (0.0, 0.0, 1.0), np.ones((1, 3)), np.zeros((0, 3))):
        np.testing.assert_allclose(across(few), (1.0, 0.0, 0.0))


def test_many_parts_end_as_one() -> None:
    scene = in_parts(MOST_PARTS + 4)
    parts = parts_of(scene, apart=True)
    assert len(parts) == MOST_PARTS + 1
    assert parts[-1].name == "4 smaller parts"
    assert sorted(np.concatenate([part.views for part in parts]).tolist()) == list(range(len(scene.centers)))


def test_plane_lies_in_z_and_turns_about_it(planar: pp.SyntheticWorld) -> None:
    assert planar.cam_from_world.ndim == 1
    scene = pp.solve_positions(planar.tracks, planar.cam_from_world)
    turn = world_from_cam(scene)
    heading = scene.cam_from_world
    np.testing.assert_allclose(turn[:, :, 0], in_three(np.column_stack((np.cos(heading), np.sin(heading)))), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(turn), 1.0)


def test_views_are_in_order_of_time(turned: pp.SyntheticWorld) -> None:
    scene = scene_of(turned)
    order = view_order(scene)
    assert 1 not in order
    assert scene.tracks is not None
    assert scene.tracks.time_s is not None
    assert (np.diff(scene.tracks.time_s[order]) > 0.0).all()


def test_file_of_a_sphere_holds_what_was_put_in() -> None:
    mesh, jpeg = panorama_sphere(8, 4), b"\xff\xd8 not quite a picture"
    assert mesh.uv is not None
    data = textured(mesh, jpeg)
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    content = json.loads(data[20 : 20 + size])
    n_binary, kind = struct.unpack_from("<I4s", data, 20 + size)
    binary = data[28 + size :]
    assert kind == b"BIN\0"
    assert n_binary == len(binary) == content["buffers"][0]["byteLength"]
    assert len(data) % 4 == size % 4 == n_binary % 4 == 0

    def block(k: int) -> bytes:
        given = content["bufferViews"][k]
        assert given["byteOffset"] % 4 == 0
        return binary[given["byteOffset"] : given["byteOffset"] + given["byteLength"]]

    np.testing.assert_allclose(np.frombuffer(block(0), "<f4").reshape(-1, 3), mesh.vertices, atol=1e-7)
    np.testing.assert_allclose(np.frombuffer(block(1), "<f4").reshape(-1, 2), mesh.uv, atol=1e-7)
    assert (np.frombuffer(block(2), "<u4").reshape(-1, 3) == mesh.faces).all()
    assert block(3) == jpeg
    counts = [entry["count"] for entry in content["accessors"]]
    assert counts == [len(mesh.vertices), len(mesh.vertices), mesh.faces.size]


def test_content_of_a_folder(turned: pp.SyntheticWorld, tmp_path: Path) -> None:
    scene = scene_of(turned)
    colours = np.random.default_rng(4).integers(0, 255, (len(scene.points), 3)).astype(np.uint8)
    with_colours = read_content(pp.write_scene(scene, tmp_path / "colours", colours=colours))
    known = np.isfinite(scene.points).all(axis=1)
    assert with_colours.colours is not None
    assert (with_colours.colours[known] == colours[known]).all()
    plain = read_content(pp.write_scene(scene, tmp_path / "plain"))
    assert plain.colours is None
    assert plain.certificate is None
    assert set(plain.images) == {None}
    views, points = plain.covariances()
    assert np.isfinite(views).all(axis=(1, 2)).sum() == len(scene.centers) - 1
    assert np.isfinite(points[known]).all(axis=(1, 2)).mean() > 0.9


def test_covariance_knows_that_orientations_are_known(turned: pp.SyntheticWorld, tmp_path: Path) -> None:
    tracks = replace(turned.tracks, sigma_rad=np.full(len(turned.tracks), 1e-3))
    scene = pp.solve_positions(tracks, turned.cam_from_world)
    known, free = (
        read_content(
            pp.write_scene(
                scene,
                tmp_path / orientation,
                certificate=pp.certify(tracks, scene, pp.CertifyOptions(orientation=orientation)),
            )
        ).covariances()[0]
        for orientation in ("known", "free")
    )
    np.testing.assert_allclose(known, pp.position_covariance(tracks, scene), rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(free, pp.scene_covariance(tracks, scene).cameras[:, 3:, 3:], rtol=1e-9)
    assert not np.allclose(free, known, rtol=1e-2, atol=0.0)


def test_pictures_are_found_by_name_and_only_inside(turned: pp.SyntheticWorld, tmp_path: Path) -> None:
    scene = scene_of(turned)
    names = ["a.jpg", "b", "sub/c.png", "../outside.jpg", "d.png", "linked.jpg"]
    names += [f"absent {k}" for k in range(len(scene.centers) - len(names))]
    assert scene.tracks is not None
    named = replace(scene, view_names=tuple(names), tracks=replace(scene.tracks, view_names=tuple(names)))
    folder = pp.write_scene(named, tmp_path / "out")
    (folder / "images" / "sub").mkdir(parents=True)
    (folder / "outside.jpg").write_bytes(b"")
    (folder / "images" / "linked.jpg").symlink_to(folder / "outside.jpg")
    for name in ("a.jpg", "b.jpg", "sub/c.png", "d.jpg"):
        (folder / "images" / name).write_bytes(b"")
    found = [
        None if path is None else path.relative_to(folder / "images").as_posix() for path in read_content(folder).images
    ]
    assert found == ["a.jpg", "b.jpg", "sub/c.png", None, "d.jpg", None] + [None] * (len(names) - 6)


def test_pictures_may_lie_elsewhere(turned: pp.SyntheticWorld, tmp_path: Path) -> None:
    scene = scene_of(turned)
    folder = pp.write_scene(scene, tmp_path / "out")
    name = scene.view_labels()[3]
    for place in ("out/images", "taken", "other"):
        (tmp_path / place).mkdir()
        (tmp_path / place / name).write_bytes(b"")

    def found(images: Path | None = None) -> Path:
        path = read_content(folder, images).images[3]
        assert path is not None
        return path.resolve()

    assert found() == tmp_path / "out" / "images" / name
    (folder / "run.json").write_text('{"images": "../taken"}')
    assert found() == tmp_path / "taken" / name
    assert found(tmp_path / "other") == tmp_path / "other" / name
    for wrong in ("[]", "{", '{"images": 3}'):
        (folder / "run.json").write_text(wrong)
        assert found() == tmp_path / "out" / "images" / name
    with pytest.raises(pp.InputError, match="no such folder of images"):
        read_content(folder, tmp_path / "absent")


@needs_opencv
def test_panorama_of_a_view(turned: pp.SyntheticWorld, tmp_path: Path) -> None:
    scene = scene_of(turned)
    folder = pp.write_scene(scene, tmp_path / "out")
    labels = scene.view_labels()
    (folder / "images").mkdir()
    picture = np.full((64, 128, 3), (200, 40, 10), dtype=np.uint8)
    (folder / "images" / labels[0]).write_bytes(encoded(picture, ".jpg"))
    (folder / "images" / labels[2]).write_bytes(encoded(picture[:, :64], ".jpg"))
    (folder / "images" / labels[3]).write_bytes(b"no picture")
    content = read_content(folder)
    small = tmp_path / "small.jpg"
    small.write_bytes(content.panorama(0, 32))
    assert read_image(small).shape == (16, 32, 3)
    small.write_bytes(content.panorama(0, 4096))
    assert read_image(small).shape == picture.shape
    assert np.abs(read_image(small).astype(int) - picture).max() < 8
    for wrong, text in ((2, "twice as wide"), (3, "not a picture"), (4, "has no picture")):
        with pytest.raises(pp.InputError, match=text):
            content.panorama(wrong, 4096)


@needs_viser
def test_folders_that_cannot_be_shown(turned: pp.SyntheticWorld, tmp_path: Path) -> None:
    with pytest.raises(pp.InputError, match="there is no such folder"):
        view(tmp_path / "absent", block=False)
    (tmp_path / "empty").mkdir()
    with pytest.raises(pp.InputError, match=r"has no scene\.json"):
        view(tmp_path / "empty", block=False)
    scene = scene_of(turned)
    nothing = replace(scene, centers=np.full_like(scene.centers, np.nan), tracks=None)
    with pytest.raises(pp.InputError, match="no view of the scene is solved"):
        view(pp.write_scene(nothing, tmp_path / "nothing"), block=False)
    folder = pp.write_scene(scene, tmp_path / "good")
    with pytest.raises(pp.InputError, match="port is 70000"):
        view(folder, port=70_000, block=False)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(pp.InputError, match=f"port {port}: is in use"):
            view(folder, port=port, block=False)
    (folder / "scene.ply").write_bytes(b"ply\nrubbish")
    assert "scene.ply cannot be read" in read_content(folder).notes[0]
    (folder / "scene.npz").write_bytes(b"rubbish")
    with pytest.raises(pp.InputError, match="is damaged"):
        view(folder, block=False)


def test_command_says_in_one_line_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["view", str(tmp_path / "absent"), "--no-browser"])
    assert ended.value.code == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_without_viser_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(pp.MissingExtraError, match=r"panopath\[view\]"):
        view(tmp_path)


def test_names_do_not_become_markup(turned: pp.SyntheticWorld, tmp_path: Path) -> None:
    content = read_content(pp.write_scene(scene_of(turned), tmp_path / "out"))
    hostile = "<img src=x onerror=alert(1)>{alert(1)}"
    certificate: dict[str, Any] = {
        "verdict": hostile,
        "sentence": f"weak: {hostile}",
        "causes": [{"sentence": hostile}],
    }
    certificate |= {"consistency": {"passed": False, "reasons": [hostile]}}
    drawing: Any = type("Stub", (), {"content": replace(content, certificate=certificate, notes=(hostile,))})
    text = verdict_html(drawing)
    assert "<img" not in text
    assert text.count("&lt;img") == 5


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rendered walk of six keyframes, turning over, with panoramas."""
    pytest.importorskip("cv2")
    place = tmp_path_factory.mktemp("viewer") / "walk"
    return write_walk(place, n_frames=120, every=20, width_px=512, n_points=600, rotation="tumble")


def threads() -> set[threading.Thread]:
    return set(threading.enumerate())


def settled(before: set[threading.Thread]) -> set[threading.Thread]:
    """Threads that were not there before, once they have had time to end."""
    deadline = time.monotonic() + 10.0
    while threads() - before and time.monotonic() < deadline:
        time.sleep(0.05)
    return threads() - before


@needs_viser
def test_server_answers_and_leaves_nothing_behind(walked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = threads()
    with view(walked, port=0, open_browser=False, block=False) as viewer:
        assert viewer.url.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(viewer.url, timeout=10) as answer:
            assert answer.status == 200
        with pytest.raises(pp.InputError, match="is in use; choose another port"):
            view(walked, port=viewer.server.get_port(), open_browser=False, block=False)
        viewer.pictures.wait(30.0)
        assert sorted(viewer.pictures.views) == list(range(6))
        for k in range(6):
            assert viewer.pictures.has(k)
            node = viewer.server.scene.get_handle_by_name(viewer.pictures.name(k))
            turn = rotation_from_quaternion(np.array([node.wxyz]))[0]
            np.testing.assert_allclose(turn, viewer.content.scene.cam_from_world[k].T, atol=1e-9)
            np.testing.assert_allclose(node.position, viewer.drawing.shown_center(k))
    viewer.close()
    assert not settled(before)
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(viewer.url, timeout=10)
    assert capsys.readouterr().out == ""


@needs_viser
def test_blocking_ends_with_an_interrupt(walked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = threads()

    def interrupted(self: threading.Event, timeout: float | None = None) -> bool:
        raise KeyboardInterrupt

    opened_at: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened_at.append)
    monkeypatch.setattr(Viewer, "wait", lambda self: None)
    viewer = view(walked, port=0)
    assert opened_at == [viewer.url]
    assert not settled(before)


@needs_viser
@pytest.mark.parametrize("kind", ["plane", "parts", "one view", "no tracks", "2 points far"])
def test_any_scene_can_be_drawn(
    kind: str, planar: pp.SyntheticWorld, turned: pp.SyntheticWorld, tmp_path: Path
) -> None:
    scene = scene_of(turned)
    if kind == "plane":
        scene = pp.solve_positions(planar.tracks, planar.cam_from_world)
    elif kind == "parts":
        scene = in_parts(MOST_PARTS + 2)
    elif kind == "one view":
        centers = np.full_like(scene.centers, np.nan)
        centers[3] = 1e6
        scene = replace(scene, centers=centers, points=np.full_like(scene.points, np.nan), tracks=None)
    elif kind == "no tracks":
        scene = replace(scene, tracks=None)
    else:
        points = scene.points.copy()
        points[5:7] = 1e12
        scene = replace(scene, points=points)
    with view(pp.write_scene(scene, tmp_path / "out"), port=0, open_browser=False, block=False) as viewer:
        drawing: Drawing = viewer.drawing
        assert drawing.radius > 0.0
        assert len(drawing.order) == np.isfinite(scene.centers).all(axis=1).sum()
        viewer.ellipsoids.show(True)
        assert viewer.ellipsoids.note
        assert viewer.ellipsoids.note.startswith("One") == (kind in ("plane", "2 points far"))
        for layer in viewer.layers:
            layer.show_until(0)
            layer.show(False)
            layer.show(True)
            layer.show_until(len(drawing.order) - 1)


@needs_viser
def test_time_shows_what_there_was(walked: Path) -> None:
    with view(walked, port=0, open_browser=False, block=False) as viewer:
        viewer.pictures.wait(30.0)
        node = viewer.server.scene.get_handle_by_name
        viewer.ellipsoids.show(True)
        pictures = [node(viewer.pictures.name(view)) for view in range(6)]
        for last in (0, 2, 5, 3):
            for layer in viewer.layers:
                layer.show_until(last)
            assert ((node("/parts/0/views").batched_scales > 0.1) == (np.arange(6) <= last)).all()
            largest = node("/parts/0/uncertainty of views").batched_scales.max(axis=1)
            assert ((largest > 1e-5) == (np.arange(6) <= last)).all()
            assert [picture.visible for picture in pictures] == (np.arange(6) <= last).tolist()
            assert node("/parts/0/path").visible == (last > 0)
            assert last == 0 or len(node("/parts/0/path").points) == last
            center = viewer.drawing.shown_center(int(viewer.drawing.order[last]))
            np.testing.assert_allclose(node("/parts/0/moment").position, center)
        # a layer that is hidden stays so, whatever the moment
        for layer in viewer.layers:
            layer.show(False)
            layer.show_until(5)
        assert not any(picture.visible for picture in pictures)
        names = ("points", "path", "views", "axes", "moment", "uncertainty of views", "uncertainty of points")
        assert not any(node(f"/parts/0/{name}").visible for name in names)


@needs_viser
def test_many_points_are_thinned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panopath.viewer.layers.MOST_POINTS", 50)
    scene = in_parts(4)
    many = replace(
        scene,
        points=np.random.default_rng(5).normal(size=(400, 3)),
        track_component=np.arange(400, dtype=np.int32) // 395,
    )
    with view(pp.write_scene(many, tmp_path / "out"), port=0, open_browser=False, block=False) as viewer:
        assert viewer.points.total == 400
        # a small part keeps its points
        assert 50 <= viewer.points.count <= 75


@pytest.fixture(scope="module")
def shown(walked: Path) -> Iterator[tuple[Viewer, Page]]:
    if find_chromium() is None or importlib.util.find_spec("viser") is None:
        pytest.skip("Chromium or viser is absent")
    with opened(walked, 1000, 700) as (viewer, page):
        viewer.pictures.wait(30.0)
        page.wait_for("document.body.innerText.includes('Ellipsoids')")
        yield viewer, page


def pixels(data: bytes, tmp_path: Path) -> npt.NDArray[np.uint8]:
    (tmp_path / "page.png").write_bytes(data)
    return read_image(tmp_path / "page.png")


@needs_chromium
def test_page_is_drawn_without_a_complaint(shown: tuple[Viewer, Page], tmp_path: Path) -> None:
    viewer, page = shown

    def is_drawn() -> bool:
        seen = pixels(page.screenshot(), tmp_path)
        assert seen.shape == (700, 1000, 3)
        scene_alone = seen[200:, :640].reshape(-1, 3)
        return len(np.unique(scene_alone // 16, axis=0)) > 50 and (scene_alone < 200).any(axis=1).mean() > 0.01

    until(is_drawn)
    text = page.evaluate("document.body.innerText")
    for expected in ("determined", "6 of 6", "Up to view", "Panoramas on spheres", "Ellipsoids"):
        assert expected in text
    assert page.errors == []
    assert all(address.startswith((viewer.url, f"blob:{viewer.url}", "data:")) for address in page.asked)


@needs_chromium
def test_panorama_lies_about_its_centre_as_it_was_taken(shown: tuple[Viewer, Page]) -> None:
    """What the browser shows from the centre is the panorama, looked up along each pixel's ray."""
    viewer, page = shown
    client = next(iter(viewer.server.get_clients().values()))
    chosen = 2
    viewer.enter(client, chosen)
    visit = viewer.visit(client)
    assert visit.view == chosen
    visit.draw_over(False)
    path = viewer.content.images[chosen]
    assert path is not None
    picture = read_image(path)
    center = viewer.drawing.shown_center(chosen)
    size, fov = 160, np.radians(80.0)
    axis = (np.arange(size) + 0.5 - size / 2) / (size / 2) * np.tan(fov / 2)
    ray = np.stack([*np.meshgrid(axis, axis), np.ones((size, size))], axis=-1).reshape(-1, 3)
    world = world_from_cam(viewer.content.scene)[chosen]
    for turn in (np.eye(3), about(1, 90.0), about(1, 200.0), about(0, 70.0), about(2, 50.0) @ about(0, -60.0)):
        wxyz = quaternion_from_rotation((world @ turn)[None])[0]
        expected = sampled(picture, ray @ turn.T).reshape(size, size, 3)

        def is_seen(wxyz: Float = wxyz, expected: Float = expected) -> bool:
            # viser deepens the contrast of all that it draws, so likeness is what can be asked; a shift would lower it
            seen = client.get_render(size, size, wxyz=wxyz, position=center, fov=fov, timeout=60.0)[:, :, :3]
            shifts = ((0, 0), (0, 2), (0, -2), (2, 0), (-2, 0))
            likeness = [alike(np.roll(seen, shift, axis=(0, 1)), expected) for shift in shifts]
            return likeness[0] > 0.97 and max(likeness) == likeness[0]

        # the browser takes its time to unpack a picture
        until(is_seen)
    visit.draw_over(True)
    visit.leave()
    assert page.errors == []


def alike(first: npt.NDArray[Any], second: npt.NDArray[Any]) -> float:
    """Correlation of the inner parts of two pictures."""
    return float(np.corrcoef(first[4:-4, 4:-4].ravel(), second[4:-4, 4:-4].ravel())[0, 1])


def about(axis: int, angle_deg: float) -> Float:
    turn = np.eye(3)
    i, k, angle = (axis + 1) % 3, (axis + 2) % 3, np.radians(angle_deg)
    turn[i, i] = turn[k, k] = np.cos(angle)
    turn[i, k], turn[k, i] = -np.sin(angle), np.sin(angle)
    return turn


@needs_chromium
def test_person_clicks_enters_and_leaves(shown: tuple[Viewer, Page]) -> None:
    viewer, page = shown
    client = next(iter(viewer.server.get_clients().values()))
    camera, visit = client.camera, viewer.visit(client)
    before = np.array(viewer.server.initial_camera.position)

    def is_back() -> bool:
        return bool(np.linalg.norm(camera.position - before) < 1e-2)

    # the test before this one stood in a panorama too
    until(is_back)
    chosen = int(viewer.drawing.order[1])
    # where the view's sphere is on the page
    cam_from_world = rotation_from_quaternion(np.array([camera.wxyz]))[0].T
    ray = cam_from_world @ (viewer.drawing.shown_center(chosen) - camera.position)
    half = 350.0 / np.tan(camera.fov / 2)
    page.click(500.0 + half * ray[0] / ray[2], 350.0 + half * ray[1] / ray[2])
    until(lambda: visit.view == chosen)
    page.wait_for("document.body.innerText.includes('Leave the panorama')")
    assert np.linalg.norm(camera.position - viewer.drawing.shown_center(chosen)) < 0.01
    page.click_text("Next view")
    until(lambda: visit.view == int(viewer.drawing.order[2]))
    page.click_text("Leave the panorama")
    until(lambda: visit.view is None)
    until(is_back)
    page.click_text("Ellipsoids")
    page.wait_for("document.body.innerText.includes('One standard deviation')")
    assert page.errors == []


def until(condition: Any, timeout_s: float = 30.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)
