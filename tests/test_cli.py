"""The command line: what is printed where, exit codes, files, and no traceback for a user's own mistake."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.cli import main


@dataclass(frozen=True)
class Ran:
    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        found = json.loads(self.out)
        assert isinstance(found, dict)
        return found


Run = Callable[..., Ran]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")

    def call(*arguments: str) -> Ran:
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main(list(arguments))
        printed = capsys.readouterr()
        assert "Traceback" not in printed.err
        return Ran(int(ended.value.code or 0), printed.out, printed.err)

    return call


def test_version_and_help(run: Run) -> None:
    assert run("--version").out.strip() == f"panopath {pp.__version__}"
    for command in ((), ("reconstruct",), ("solve",), ("simulate",), ("evaluate",), ("demo",)):
        ran = run(*command, "--help")
        assert ran.code == 0
        text = " ".join(ran.out.split())
        assert "Exit codes: 0 success; 2 unusable input or command; 3 the input does not determine the scene; " in text


def test_simulate_solve_evaluate(run: Run, tmp_path: Path) -> None:
    made = run(
        "simulate", "street", "-o", "s.csv", "--views", "25", "--points", "400", "--seed", "4", "--noise-deg", "0.05"
    )
    assert made.code == 0
    assert "panopath solve s.csv -o OUT" in made.out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.csv", "s.truth"]
    solved = run("solve", "s.csv", "-o", "out")
    assert (solved.code, solved.err) == (0, "")
    for text in ("part", "views", "points", "outliers", "angular rms", "converged", "written to out", "views.png"):
        assert text in solved.out
    assert {"views.png", "errors.png", "cameras.csv"} <= {path.name for path in (tmp_path / "out").iterdir()}
    found = run("evaluate", "out", "s.truth", "--json").json
    assert found["n_views"] == 25
    assert 0.0 < found["camera_rms"] < 0.05
    assert (
        abs(run("evaluate", "out", "s.truth/cameras.csv", "--json").json["camera_rms"] / found["camera_rms"] - 1) < 1e-9
    )
    table = run("evaluate", "out", "s.truth", "--alignment", "translation_scale")
    assert "cameras" in table.out
    assert "rotation 0 degrees" in table.out


def test_cameras_turned_at_random(run: Run, tmp_path: Path) -> None:
    run(
        "simulate", "room", "-o", "r.parquet", "--views", "15", "--points", "200", "--camera-frame", "--set", "near_m=2"
    )
    assert (tmp_path / "r.orientations.csv").exists()
    assert run("solve", "r.parquet", "--orientations", "r.orientations.csv", "-o", "out", "--no-plots").code == 0
    assert not (tmp_path / "out" / "views.png").exists()
    assert run("evaluate", "out", "r.truth", "--json").json["camera_rms"] < 1e-9
    # what was written holds its orientations, so it can be solved again as it is
    assert run("solve", "out", "-o", "again", "--no-plots", "--json").json["status"] == "converged"
    assert run("evaluate", "again", "r.truth", "--json").json["camera_rms"] < 1e-9


def test_json_is_one_object_and_quiet_is_quiet(run: Run) -> None:
    assert run(
        "simulate", "box", "-o", "b.csv", "--views", "5", "--points", "30", "--dimension", "2", "--json"
    ).json == {
        "out": "b.csv",
        "truth": "b.truth",
        "orientations": None,
        "n_views": 5,
        "n_tracks": 30,
        "n_observations": run("solve", "b.csv", "--json").json["n_observations"],
        "n_outliers": 0,
    }
    solved = run("solve", "b.csv", "--json")
    assert solved.err == ""
    assert solved.json["status"] == "converged"
    assert solved.json["n_solved_views"] == 5
    assert set(solved.json) >= {"iterations", "sigma_rad", "seconds", "wall_s", "n_components", "n_inliers", "out"}
    quiet = run("solve", "b.csv", "-o", "out", "--quiet")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")
    assert "nothing was written" in run("solve", "b.csv").out


TRAFFIC = (
    *("simulate", "street", "-o", "s.csv", "--views", "40", "--points", "500", "--noise-deg", "0.03", "--seed", "3"),
    *("--set", "mover_fraction=0.3", "--set", "n_bodies=6", "--set", "wobble_m=0.3"),
)


def test_bodies_that_move(run: Run, tmp_path: Path) -> None:
    assert run(*TRAFFIC).code == 0
    solved = run("solve", "s.csv", "-o", "out", "--motion", "auto", "--group", "--no-plots")
    assert (solved.code, solved.err) == (0, "")
    for text in ("at rest", "moving", "refused: hidden", "forms: ", "of taylor:1", "assumed: most tracks are at rest"):
        assert text in solved.out
    assert {"paths.csv", "scene.json", "report.html"} <= {path.name for path in (tmp_path / "out").iterdir()}
    paths = pp.read_scene("out").paths
    assert paths is not None
    assert f"rigid bodies of several tracks: {paths.body.max() + 1}, of {(paths.body >= 0).sum()} tracks" in solved.out
    told = json.loads((tmp_path / "out" / "scene.json").read_text(encoding="utf-8"))["paths"]
    assert told["verdicts"]["moving"] == paths.moving.sum() > 100
    assert run("solve", "s.csv", "--motion", "auto", "--group", "--json").json["paths"] == told
    # movers are no points that hang loose
    checked = run("check", "out")
    assert checked.code == 0
    assert checked.out.startswith("paths: determined: 4 free movements, of which the gauge has 4")
    assert "\nof what rests: determined: all 40 views, " in checked.out
    assert "in no part" not in checked.out
    assert run("evaluate", "out", "s.truth", "--json").json["camera_rms"] < 0.05


def test_what_is_known_to_rest(run: Run, tmp_path: Path) -> None:
    run(*TRAFFIC)
    still = np.flatnonzero(~pp.simulate("street", **_TRAFFIC).moving)[:3].tolist()
    (tmp_path / "known.txt").write_text("".join(f"{track}\n" for track in still) + "\n")
    for given in (",".join(map(str, still)), "@known.txt"):
        found = run("solve", "s.csv", "--motion", "auto", "--static", given, "--json").json
        assert found["paths"]["assumption"] == "3 tracks are known to be at rest"


_TRAFFIC: dict[str, Any] = {
    "n_views": 40,
    "n_points": 500,
    "seed": 3,
    "noise_rad": np.radians(0.03),
    "mover_fraction": 0.3,
    "n_bodies": 6,
    "wobble_m": 0.3,
}


def test_a_body_that_the_camera_imitates_is_refused_by_name(run: Run) -> None:
    """A camera on rails, and a car that goes as steadily."""
    rng = np.random.default_rng(1)
    time_s = np.linspace(0.0, 5.0, 25)
    camera = np.outer(time_s, (1.0, 0.2, 0.0))
    houses = rng.uniform(-10.0, 10.0, (30, 3))
    car = np.array([2.0, 6.0, 1.0]) + np.outer(time_s, (0.3, 0.5, 0.1))
    places = np.concatenate((np.repeat(houses[:, None], 25, axis=1), car[None]))
    track, view = (index.ravel() for index in np.indices(places.shape[:2]))
    ray = places[track, view] - camera[view]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    names = [*(f"house {k}" for k in range(30)), "car"]
    pp.write_tracks(pp.Tracks.from_arrays(view, track, ray, time_s=time_s, track_names=names), "b.csv")
    solved = run("solve", "b.csv", "--motion", "auto")
    assert "refused: track car: the camera itself moved in the form of its path" in solved.out
    assert run("solve", "b.csv", "--motion", "auto", "--json").json["paths"]["verdicts"]["imitated"] == 1


def test_what_everything_may_share_is_free_and_said(run: Run) -> None:
    """Each track was given a form that moves, so that everything may drift."""
    run(*TRAFFIC)
    solved = run("solve", "s.csv", "-o", "out", "--motion", "taylor:1", "--no-plots")
    assert "free: everything, cameras and all, may share a motion linear in time" in " ".join(solved.out.split())
    checked = run("check", "out")
    assert (checked.code, checked.out.startswith("paths: undetermined: ")) == (3, True)
    assert "contradicts" not in checked.out
    # forms that nothing fits are no failure
    bent = run("solve", "s.csv", "--motion", "spline:0,10,20,30", "--json").json
    assert bent["paths"]["verdicts"]["moving"] < 100


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--motion", "taylor"), "--motion is 'taylor', expected static, taylor:ORDER"),
        (("--motion", "taylor:x"), "--motion is 'taylor:x', expected"),
        (("--motion", "taylor:99"), "--motion taylor:99: the order of taylor is 99"),
        (("--motion", "spline:3,2"), "--motion spline:3,2: knots_s is (3.0, 2.0)"),
        (("--motion", "spline:1,2:degree=1.5"), "--motion is 'spline:1,2:degree=1.5', expected"),
        (("--motion", "fourier:2:omega=-1"), "--motion fourier:2:omega=-1: omega_rad_s is -1.0"),
        (("--motion", "fourier:1:w=2"), "--motion is 'fourier:1:w=2', expected"),
        (("--motion", "auto:1"), "--motion is 'auto:1', expected"),
        (("--motion", ""), "--motion is '', expected"),
        (("--motion", "auto", "--static", "nobody"), "--static names the track 'nobody'"),
        (("--motion", "auto", "--static", ","), "--static ',' names no track"),
        (("--motion", "auto", "--static", "@none.txt"), "--static @none.txt: cannot be read"),
        (("--motion", "auto", "--static", "@some.txt"), "some.txt:2: names the track 'nobody'"),
        (("--static", "1"), "--static tells nothing where everything is at rest, expected --motion"),
        (("--group",), "--group tells nothing where everything is at rest, expected --motion"),
        (("--motion", "auto", "--unknown-orientation"), "--motion needs orientations that are known"),
        (("--motion", "auto", "--method", "linear"), "--motion goes with --method robust"),
    ],
)
def test_bad_motions_are_one_line(run: Run, tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    run("simulate", "box", "-o", "b.csv", "--views", "5", "--points", "20")
    (tmp_path / "some.txt").write_text("1\nnobody\n")
    ran = run("solve", "b.csv", "-o", "out", *options)
    assert ran.code == 2
    assert said in ran.err
    assert ran.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_motion_needs_times(run: Run, tmp_path: Path) -> None:
    (tmp_path / "b.csv").write_text("view,track,theta_deg,phi_deg\na,p,0,0\nb,p,10,0\n")
    ran = run("solve", "b.csv", "--motion", "auto")
    assert (ran.code, ran.err.count("\n")) == (2, 1)
    assert "--motion needs the time of every view" in ran.err


def test_undetermined_has_its_own_exit_code(run: Run, tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("view,track,theta_deg,phi_deg\na,p,0,0\na,q,10,0\n")
    ran = run("solve", "one.csv", "-o", "out", "--json")
    assert (ran.code, ran.json["status"]) == (3, "undetermined")
    # the answer "nothing" is written too
    assert pp.read_scene("out").summary.status is pp.Status.UNDETERMINED
    assert "undetermined" in run("solve", "one.csv").out


def test_control(run: Run, tmp_path: Path) -> None:
    run("simulate", "box", "-o", "b.csv", "--views", "6", "--points", "30")
    truth = pp.read_scene("b.truth")
    rows = [f"{i},{','.join(map(repr, (10.0 * truth.centers[i] + 5.0).tolist()))}" for i in range(4)]
    (tmp_path / "c.csv").write_text("view,x,y,z\n" + "\n".join(rows) + "\n")
    assert run("solve", "b.csv", "-o", "out", "--control", "c.csv", "--no-plots").code == 0
    np.testing.assert_allclose(pp.read_scene("out").centers, 10.0 * truth.centers + 5.0, atol=1e-6)
    assert "--gauge is paper" in run("solve", "b.csv", "--control", "c.csv", "--gauge", "paper").err
    assert run("solve", "b.csv", "--gauge", "control").code == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("solve",), "Missing argument"),
        (("solve", "b.csv", "--method", "magic"), "magic"),
        (("solve", "b.csv", "--threads", "0"), "--threads"),
        (("solve", "none.csv"), "none.csv: there is no such file"),
        (("solve", "b.csv", "--sigma-deg", "-1"), "--sigma-deg is -1.0"),
        (("solve", "b.csv", "-o", "mine"), "not panopath's"),
        (("solve", "b.csv", "-o", "b.csv"), "is a file"),
        (("evaluate", "mine", "b.csv"), "no scene.json"),
        (("evaluate", "b.truth", "b.csv"), "no positions"),
        (("evaluate", "b.truth", "strange.csv"), "names no view"),
        (("evaluate", "b.truth", "b.truth", "--trim", "2"), "trim is 2.0"),
        (("simulate", "moon", "-o", "m.csv"), "moon"),
        (("simulate", "box", "-o", "b.csv"), "is there already"),
        (("simulate", "box", "-o", "m.csv", "--set", "near_m=1"), "near_m"),
        (("simulate", "box", "-o", "m.csv", "--set", "bogus=1"), "no such option"),
        (("simulate", "box", "-o", "m.csv", "--set", "seed=1"), "use --seed"),
        (("simulate", "box", "-o", "m.csv", "--set", "seed"), "expected name=value"),
        (("demo-bearings", "-o", "mine"), "not panopath's"),
        (("fly",), "fly"),
    ],
)
def test_mistakes(run: Run, tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    run("simulate", "box", "-o", "b.csv", "--views", "4", "--points", "10", "--dimension", "2")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("precious")
    (tmp_path / "strange.csv").write_text("view,x,y\nnobody,1,2\n")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    ran = run(*arguments)
    assert ran.code == 2
    assert ran.out == ""
    assert message in " ".join(ran.err.split())
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_mistakes_as_json(run: Run) -> None:
    ran = run("solve", "none.csv", "--json")
    assert (ran.code, ran.json) == (2, {"error": "none.csv: there is no such file"})


def test_overwrite_when_asked(run: Run, tmp_path: Path) -> None:
    run("simulate", "box", "-o", "b.csv", "--views", "4", "--points", "10")
    assert run("simulate", "box", "-o", "b.csv", "--views", "5", "--points", "10", "--overwrite").code == 0
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("precious")
    assert run("solve", "b.csv", "-o", "mine", "--overwrite", "--no-plots").code == 0
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "precious"
    assert run("solve", "b.csv", "-o", "mine").code == 0  # it is panopath's now


def test_demo_of_bearings(run: Run, tmp_path: Path) -> None:
    ran = run("demo-bearings", "--views", "30", "--points", "1500", "--json")
    assert ran.code == 0
    found = ran.json
    assert found["status"] == "converged"
    assert (tmp_path / "panopath-demo" / "views.png").exists()
    # the scene is written in metres, over the truth; one run scatters about the bound
    assert 0.1 * found["expected_camera_rms"] < found["camera_rms"] < 3.0 * found["expected_camera_rms"]
    world = pp.simulate("street", n_views=30, n_points=1500, seed=1, outlier_fraction=0.2, noise_rad=np.radians(0.05))
    written = pp.read_scene("panopath-demo")
    assert np.sqrt(np.mean(np.sum((written.centers - world.centers) ** 2, axis=1))) == pytest.approx(
        found["camera_rms"]
    )
    again = run("demo-bearings", "--views", "30", "--points", "1500", "-o", "panopath-demo", "--no-plots")
    assert again.code == 0
    assert "Cramer-Rao" in again.out
    assert not (tmp_path / "panopath-demo" / "views.png").exists()


def test_without_matplotlib_the_rest_goes_on(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run("simulate", "box", "-o", "b.csv", "--views", "5", "--points", "20")
    real = importlib.import_module

    def absent(name: str, package: str | None = None) -> Any:
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", absent)
    ran = run("solve", "b.csv", "-o", "out")
    assert ran.code == 0
    assert ran.err.strip() == 'panopath: pictures need matplotlib: install the extra with pip install "panopath[plot]"'
    assert pp.read_scene("out").summary.n_solved_views == 5


def test_in_a_process_of_its_own(tmp_path: Path) -> None:
    """The real entry point: exit code, streams, and a reader that goes away early."""
    command = [sys.executable, "-m", "panopath.cli"]
    bad = subprocess.run([*command, "solve", "none.csv"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (bad.returncode, bad.stdout, bad.stderr) == (2, "", "panopath: none.csv: there is no such file\n")
    read_end, write_end = os.pipe()
    os.close(read_end)
    early = subprocess.run([*command, "--help"], stdout=write_end, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write_end)
    assert "Traceback" not in early.stderr


def test_base_install_imports_nothing_heavy() -> None:
    heavy = ("matplotlib", "pandas", "polars", "pyarrow", "pycolmap", "scipy")
    code = f"import panopath, panopath.cli, sys; print([m for m in {heavy!r} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
