"""Files that cannot be read: each gives one clear line, in Python and on the command line, and changes nothing."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from pathlib import Path

import panopath as pp
import pytest
from panopath.cli import main

H = "view,track,theta_deg,phi_deg\n"
GOOD = H + "a,p,0,0\nb,p,1,1\n"
Q = "view,qw,qx,qy,qz\n"


def bal(first: str = "1 1 1", observation: str = "0 0 1 1", camera: str = "0 0 0 0 0 0 500 0 0") -> str:
    return f"{first}\n{observation}\n" + "\n".join(camera.split()) + "\n1\n2\n3\n"


def colmap(cameras: str | None = None, images: str | None = None, points: str | None = None) -> dict[str, str | bytes]:
    return {
        "cameras.txt": cameras if cameras is not None else "1 PINHOLE 100 100 50 50 50 50\n",
        "images.txt": images if images is not None else "1 1 0 0 0 0 0 0 1 a.jpg\n10 10 7\n",
        "points3D.txt": points if points is not None else "7 0 0 1 9 9 9 0.1 1 0\n",
    }


#: What is read, and what the message must say; a dict is a folder of files.
TRACKS: dict[str, tuple[str | bytes | dict[str, str | bytes], list[str]]] = {
    "empty": ("", ["f.csv", "is empty"]),
    "only blanks": (" \n\n ", ["is empty"]),
    "header alone": (H, ["has a header but no observation"]),
    "no header": ("a,p,0,0\nb,p,1,1\n", ["line 1", "header line is missing"]),
    "prose": ("these are my bearings\n", ["line 1", "expected a header"]),
    "no view": ("cam,track,theta_deg\na,p,0\n", ["no column view"]),
    "no track": ("view,point,theta_deg\na,p,0\n", ["no column track"]),
    "no direction": ("view,track,depth\na,p,0\n", ["no direction", "theta_deg,phi_deg"]),
    "two directions": ("view,track,theta_deg,x,y\na,p,0,1,0\n", ["twice", "theta_deg", "x"]),
    "mixed units": ("view,track,theta_deg,phi_rad\na,p,0,0\n", ["twice", "theta_deg", "theta_rad"]),
    "half a direction": ("view,track,phi_deg\na,p,0\n", ["no column theta_deg"]),
    "x without y": ("view,track,x,z\na,p,0,1\n", ["no column y"]),
    "column twice": ("view,view,track,theta_deg\na,a,p,0\n", ["column view stands in the header twice"]),
    "misspelt column": ("view,track,theta_deg,sigma_degs\na,p,0,1\n", ["sigma_degs", "did you mean sigma_deg"]),
    "two sigmas": ("view,track,theta_deg,sigma_deg,sigma_rad\na,p,0,1,1\n", ["both sigma_deg and sigma_rad"]),
    "semicolons": (GOOD.replace(",", ";"), ["line 1", "semicolons"]),
    "tabs": (GOOD.replace(",", "\t"), ["line 1", "tabs"]),
    "missing field": (GOOD + "c,p,1\n", ["line 4", "3 fields", "column phi_deg is missing"]),
    "extra field": (GOOD + "c,p,1,2,3\n", ["line 4", "5 fields", "expected 4"]),
    "text for a number": (GOOD + "c,p,north,0\n", ["line 4, column theta_deg", '"north"', "finite number"]),
    "decimal comma": (GOOD + 'c,p,"1,5",0\n', ["line 4, column theta_deg", '"1,5"']),
    "empty number": (GOOD + "\n\nc,p,,0\n", ["line 6, column theta_deg", "empty"]),
    "nan": (GOOD + "c,p,nan,0\n", ["line 4, column theta_deg", '"nan"']),
    "infinite": (GOOD + "c,p,0,-inf\n", ["line 4, column phi_deg", '"-inf"']),
    "too large for a number": (GOOD + "c,p,1e999,0\n", ["line 4, column theta_deg", "1e999"]),
    "empty name": (GOOD + "  ,p,0,0\n", ["line 4, column view", "expected a name"]),
    "above the pole": (GOOD + "c,p,0,90.5\n", ["line 4, column phi_deg", "90.5", "-90 to 90"]),
    "beyond a turn": (GOOD + "c,p,361,0\n", ["line 4, column theta_deg", "361", "-360 to 360"]),
    "degrees called radians": ("view,track,theta_rad\na,p,45\n", ["line 2, column theta_rad", "radians"]),
    "no length": ("view,track,x,y,z\na,p,0,0,0\n", ["line 2, columns x,y,z", "length is 0"]),
    "too long": ("view,track,x,y\na,p,1e200,1e200\n", ["line 2", "x,y"]),
    "sigma zero": ("view,track,theta_deg,sigma_deg\na,p,0,1\na,q,0,0\n", ["line 3, column sigma_deg", "positive"]),
    "sigma empty": ("view,track,theta_deg,sigma_deg\na,p,0,\n", ["line 2, column sigma_deg", "empty"]),
    "two times": ("view,track,theta_deg,time_s\na,p,0,1\na,q,0,2\n", ["line 2, column time_s", "view a"]),
    "time text": ("view,track,theta_deg,time_s\na,p,0,noon\n", ["line 2, column time_s", '"noon"']),
    "utf-16": (GOOD.encode("utf-16"), ["UTF-16", "UTF-8"]),
    "not utf-8": (GOOD.encode() + b"\xff\xfe,p,0,0\n", ["line 4, column view", "UTF-8"]),
    "header not utf-8": (b"view,track,th\xff\na,p,0\n", ["line 1", "UTF-8"]),
    "binary": (b"\x89PNG\r\n\x1a\n" + bytes(200), ["binary"]),
    "open quote": (GOOD + 'c,"p,0,0\nd,p,0,0\n', ["line 4", "2 fields"]),
    "gzip cut": (gzip.compress(GOOD.encode() * 50)[:40], ["gzip", "cut short"]),
    "gzip damaged": (gzip.compress(GOOD.encode())[:-6] + b"123456", ["gzip", "damaged"]),
    "gzip of nothing": (gzip.compress(b""), ["is empty"]),
    "parquet cut": (b"PAR1" + bytes(20), ["Parquet"]),
    "bal cut": (bal()[:-3], ["has 15 numbers", "expected 16"]),
    "bal text": (bal(camera="0 0 0 0 x 0 500 0 0"), ["line 7, field 1", '"x"']),
    "bal camera unknown": (bal(observation="1 0 1 1"), ["observation 0 (line 2)", "camera is 1", "below 1"]),
    "bal point fractional": (bal(observation="0 0.5 1 1"), ["point is 0.5"]),
    "bal focal length": (bal(camera="0 0 0 0 0 0 0 0 0"), ["observation 0", "focal length 0"]),
    "bal distortion": (bal(observation="0 0 5000 0", camera="0 0 0 0 0 0 500 -0.5 0"), ["observation 0", "distortion"]),
    "folder of nothing": ({"readme.txt": "hello"}, ["without a COLMAP model"]),
    "colmap camera line": (colmap(cameras="1 PINHOLE 100\n"), ["cameras.txt", "line 1"]),
    "colmap camera model": (colmap(cameras="1 PINHALE 100 100 50 50 50 50\n"), ["cameras.txt", "camera 1", "PINHALE"]),
    "colmap camera parameters": (colmap(cameras="1 PINHOLE 100 100 50\n"), ["cameras.txt", "1 parameters"]),
    "colmap camera absent": (colmap(images="1 1 0 0 0 0 0 0 2 a.jpg\n10 10 7\n"), ["images.txt", "camera 2"]),
    "colmap image line": (colmap(images="# c\n1 1 0 0 zero 0 0 0 1 a.jpg\n10 10 7\n"), ["images.txt", "line 2"]),
    "colmap features": (colmap(images="1 1 0 0 0 0 0 0 1 a.jpg\n10 10\n"), ["images.txt", "line 2", "POINTS2D"]),
    "colmap quaternion": (colmap(images="1 3 0 0 0 0 0 0 1 a.jpg\n10 10 7\n"), ["images.txt", "a.jpg", "unit length"]),
    "colmap point absent": (colmap(images="1 1 0 0 0 0 0 0 1 a.jpg\n10 10 8\n"), ["images.txt", "the point 8"]),
    "colmap point line": (colmap(points="7 0 0\n"), ["points3D.txt", "line 1"]),
    "colmap sees nothing": (colmap(images="1 1 0 0 0 0 0 0 1 a.jpg\n\n"), ["no image sees a point"]),
    "colmap binary cut": (
        {
            "cameras.bin": struct.pack("<QIiQQ3d", 1, 1, 0, 9, 9, 1, 2, 3),
            "images.bin": b"12345678",
            "points3D.bin": b"1234",
        },
        ["images.bin", "cut short"],
    ),
    "colmap binary model": (
        {"cameras.bin": struct.pack("<QIiQQ", 1, 1, 999, 9, 9), "images.bin": b"1", "points3D.bin": b"1"},
        ["cameras.bin"],
    ),
    "panopath folder damaged": (
        {"scene.json": '{"panopath": {"layout": 1}, "summary": {}}', "scene.npz": "no"},
        ["scene.npz", "damaged"],
    ),
    "panopath folder of another layout": ({"scene.json": '{"panopath": {"layout": 99}}'}, ["scene.json", "layout 99"]),
}

ORIENTATIONS: dict[str, tuple[str, list[str]]] = {
    "no view": ("name,heading_deg\na,0\n", ["o.csv", "no column view"]),
    "no columns": ("view,yaw\na,0\n", ["o.csv", "view,qw,qx,qy,qz or view,heading_deg"]),
    "both": ("view,heading_deg,compass_deg\na,0,0\n", ["o.csv", "or view,compass_deg"]),
    "view missing": (Q + "a,1,0,0,0\n", ["o.csv", "no orientation for view b"]),
    "view twice": (Q + "a,1,0,0,0\nb,1,0,0,0\na,1,0,0,0\n", ["o.csv", "line 4, column view", "a is given twice"]),
    "not unit": (Q + "a,1,0,0,0\nb,1,1,0,0\n", ["o.csv", "line 3", "length is 1.414"]),
    "text": (Q + "a,1,0,0,0\nb,1,0,up,0\n", ["o.csv", "line 3, column qy", '"up"']),
    "absent": ("", ["o.csv", "is empty"]),
}

CONTROL: dict[str, tuple[str, list[str]]] = {
    "no columns": ("name,x,y,z\na,0,0,0\n", ["c.csv", "view,x,y[,z]"]),
    "half a position": ("view,x,y,z\na,0,,0\n", ["c.csv", "line 2, column y"]),
    "twice": ("view,x,y,z\na,0,0,0\na,0,0,1\n", ["c.csv", "line 3, column view", "a is given twice"]),
    "both": ("view,track,x,y,z\na,p,0,0,0\n", ["c.csv", "line 2", "names 2 of view and track"]),
    "nothing": ("view,x,y,z\n", ["c.csv", "no position"]),
    "unknown view": ("view,x,y,z\nnowhere,0,0,0\nb,1,0,0\n", ["'nowhere'", "not among the 2 views"]),
    "planar": ("view,x,y\na,0,0\nb,1,0\n", ["2 coordinates", "the bearings have 3"]),
}


def lay(folder: Path, content: str | bytes | dict[str, str | bytes], name: str) -> Path:
    path = folder / name
    if isinstance(content, dict):
        path.mkdir()
        for part, text in content.items():
            lay(path, text, part)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
    return path


def tree(folder: Path) -> dict[str, bytes | None]:
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


def check(
    error: Callable[[], object],
    arguments: list[str],
    parts: list[str],
    folder: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = tree(folder)
    with pytest.raises(pp.InputError) as raised:
        error()
    with pytest.raises(SystemExit) as ended:
        main(["solve", *arguments, "-o", str(folder / "out")])
    printed = capsys.readouterr()
    assert ended.value.code == 2
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1
    assert "Traceback" not in printed.err
    for message in (str(raised.value), printed.err):
        for part in parts:
            assert part in message
    assert "\n" not in str(raised.value)
    assert tree(folder) == before


@pytest.mark.parametrize("case", TRACKS)
def test_tracks(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, parts = TRACKS[case]
    path = lay(tmp_path, content, "f.csv")
    check(lambda: pp.read_tracks(path), [str(path)], ["f.csv", *parts], tmp_path, capsys)


@pytest.mark.parametrize("case", ORIENTATIONS)
def test_orientations(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, parts = ORIENTATIONS[case]
    path, other = lay(tmp_path, GOOD, "f.csv"), lay(tmp_path, content, "o.csv")
    check(lambda: pp.read_tracks(path, other), [str(path), "--orientations", str(other)], parts, tmp_path, capsys)


def test_quaternions_for_planar_bearings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = lay(tmp_path, "view,track,theta_deg\na,p,0\n", "f.csv")
    other = lay(tmp_path, Q + "a,1,0,0,0\n", "o.csv")
    arguments = [str(path), "--orientations", str(other)]
    check(lambda: pp.read_tracks(path, other), arguments, ["o.csv", "planar"], tmp_path, capsys)


@pytest.mark.parametrize("case", CONTROL)
def test_control(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, parts = CONTROL[case]
    path, other = lay(tmp_path, GOOD, "f.csv"), lay(tmp_path, content, "c.csv")

    def run() -> object:
        options = pp.PositionOptions(gauge="control", control=pp.read_control(other))
        return pp.solve_positions(pp.read_tracks(path), options=options)

    check(run, [str(path), "--control", str(other)], parts, tmp_path, capsys)


def test_absent_file_and_wrong_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "none.csv"
    check(lambda: pp.read_tracks(path), [str(path)], ["none.csv", "no such file"], tmp_path, capsys)
    with pytest.raises(pp.InputError, match="cannot read tracks from a int"):
        pp.read_tracks(3)


def test_there_are_enough_kinds() -> None:
    assert len(TRACKS) + len(ORIENTATIONS) + len(CONTROL) >= 30
