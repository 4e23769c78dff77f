"""The paper's experiments: what a run leaves behind, mistakes, and what each experiment finds, with few trials."""

from __future__ import annotations

import csv
import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import panopath as pp
import pytest
from panopath.paper import (
    EXPERIMENTS,
    Experiment,
    Outcome,
    Settings,
    Statement,
    Table,
    Verdict,
    counting,
    mean_motion,
    moving,
    run_experiment,
    visibility,
    write_summary,
)
from panopath.paper.experiment import Picture
from panopath.paper.generic_rank import extra_freedoms_of_pictures
from panopath.paper.moving_scenes import FORMS, draw_hidden, draw_moving
from panopath.paper.scenes import certified_freedoms, dense_freedoms, disturbed, null_vector, rays, slope, truth_of
from panopath.paper.theorem_scenes import KINDS
from panopath.paths import Static
from test_cli import Run, run

#: Trials that each experiment runs with here: enough for its verdicts.
TRIALS = {"cameras": 1, "counting": 1, "theorems": 4, "visibility": 2, "moving": 1, "mean-motion": 1}
#: What is expected, a letter a statement: a agrees, p in part, c corrected.
VERDICTS = {
    "cameras": "apac",
    "counting": "paaaacca" + "caaaacccp",
    "theorems": "acccaaccacaaaaaaaaaaaacc" + "paa",
    "visibility": "cccp" + "aap",
    "moving": "apcaacccaa",
    "mean-motion": "ccpcapaapap",
}
LETTER = {Verdict.AGREES: "a", Verdict.IN_PART: "p", Verdict.CORRECTED: "c"}

__all__ = ["run"]


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> Experiment:
    """An experiment that takes no time, in place of all others."""

    def measure(settings: Settings, progress: Callable[[int, int], None]) -> Outcome:
        n = settings.trials_or(3)
        values = np.random.default_rng(settings.seed).normal(size=n)
        progress(n, n)
        return Outcome(
            n,
            {
                "values": Table({"trial": range(n), "value": list(values), "large": list(values > 1.0)}),
                "none": Table({"x": ()}),
            },
            (Statement("8, figure 1", "It is | so.", "It is.", Verdict.AGREES),),
            {"values": Picture(lambda figure: figure.subplots().plot(values), "Values.", 3.0, 2.0)},
        )

    made = Experiment("quick", "8", "Nothing much", measure)
    for name in list(EXPERIMENTS):
        monkeypatch.delitem(EXPERIMENTS, name)
    monkeypatch.setitem(EXPERIMENTS, "quick", made)
    return made


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as lines:
        return list(csv.DictReader(lines))


# ---------------------------------------------------------------------------------------------------------- the frame


def test_what_a_run_leaves_behind(quick: Experiment, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra plot")
    out = tmp_path / "made" / "here"
    record = run_experiment(quick, out, Settings(seed=5))
    page = write_summary([record], out)
    assert sorted(path.name for path in out.iterdir()) == [
        "paper.md",
        "quick-none.csv",
        "quick.csv",
        "quick.json",
        "quick.png",
    ]
    rows = read(out / "quick.csv")
    assert [row["trial"] for row in rows] == ["0", "1", "2"]
    assert {row["large"] for row in rows} <= {"true", "false"}
    assert (out / "quick-none.csv").read_text() == "x\n"
    kept = json.loads((out / "quick.json").read_text())
    assert (kept["seed"], kept["n_trials"], kept["version"]) == (5, 3, pp.__version__)
    assert kept["statements"][0]["verdict"] == "agrees"
    assert (out / "quick.png").read_bytes().startswith(b"\x89PNG")
    text = page.read_text()
    assert "| 8, figure 1 | It is \\| so. | It is. | **agrees** |" in text
    assert "![Values.](quick.png)" in text
    assert "panopath paper quick --seed 5" in text


def test_files_of_others_stay_and_own_ones_are_replaced(quick: Experiment, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("kept")
    run_experiment(quick, tmp_path, Settings(trials=2), draws=False)
    run_experiment(quick, tmp_path, Settings(trials=4), draws=False)
    assert (tmp_path / "mine.txt").read_text() == "kept"
    assert len(read(tmp_path / "quick.csv")) == 4
    assert not (tmp_path / "quick.png").exists()


def test_a_file_is_no_folder(quick: Experiment, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file")
    with pytest.raises(pp.InputError, match="taken: is a file, expected a folder to write to"):
        run_experiment(quick, taken, draws=False)
    with pytest.raises(pp.InputError, match="cannot be made"):
        run_experiment(quick, taken / "below", draws=False)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"seed": -1}, "seed is -1"), ({"trials": 0}, "trials is 0, expected at least 1"), ({"threads": -1}, "threads")],
)
def test_settings_check_themselves(wrong: dict[str, int], said: str) -> None:
    with pytest.raises(pp.InputError, match=said):
        Settings(**wrong)


def test_tables_check_themselves() -> None:
    with pytest.raises(pp.InputError, match="differ in length"):
        Table({"a": (1, 2), "b": (1,)})
    assert len(Table.of(("a", "b"), [(1, 2), (3, 4)])) == 2
    assert dict(Table.of(("a", "b"), []).columns) == {"a": (), "b": ()}


def test_the_command(quick: Experiment, run: Run, tmp_path: Path) -> None:
    listed = run("paper")
    assert listed.code == 0
    assert "Nothing much" in listed.out
    assert json.loads(run("paper", "--json").out) == {"quick": quick.title}
    ran = run("paper", "quick", "-o", "out", "--no-plots", "--seed", "9", "--trials", "7")
    assert ran.code == 0
    assert "quick: 7 trials" in ran.err
    assert "It is." in ran.out
    assert not (tmp_path / "out" / "quick.png").exists()
    assert len(read(tmp_path / "out" / "quick.csv")) == 7
    every = run("paper", "all", "-o", "every", "--no-plots", "--json")
    assert [one["name"] for one in json.loads(every.out)["experiments"]] == ["quick"]


@pytest.mark.usefixtures("quick")
def test_mistakes_are_one_line(run: Run, tmp_path: Path) -> None:
    unknown = run("paper", "nothing", "-o", "out")
    assert (unknown.code, unknown.out) == (2, "")
    assert unknown.err == "panopath: EXPERIMENT is 'nothing', expected all or one of quick\n"
    assert not (tmp_path / "out").exists()
    (tmp_path / "taken").write_text("a file")
    taken = run("paper", "quick", "-o", "taken", "--no-plots")
    assert (taken.code, taken.err.count("\n")) == (2, 1)
    assert "taken: is a file" in taken.err
    assert run("paper", "quick", "--trials", "0").code == 2
    assert run("paper", "quick", "--threads", "-1").code == 2


def test_without_matplotlib_it_says_so_first(
    quick: Experiment, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = importlib.import_module
    measured: list[int] = []

    def absent(name: str, package: str | None = None) -> Any:
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, package)

    def measure(settings: Settings, progress: Callable[[int, int], None]) -> Outcome:
        measured.append(settings.seed)
        return quick.run(settings, progress)

    monkeypatch.setattr(importlib, "import_module", absent)
    monkeypatch.setitem(EXPERIMENTS, "quick", Experiment("quick", "8", "Nothing much", measure))
    ran = run("paper", "quick", "-o", "out")
    assert ran.code == 2
    assert 'pip install "panopath[plot]"' in ran.err
    assert not measured
    assert not (tmp_path / "out").exists()
    assert run("paper", "quick", "-o", "out", "--no-plots").code == 0
    assert measured


# ---------------------------------------------------------------------------------------------------- what they find


@pytest.fixture
def fewer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer cases in the longest parts of a run."""
    monkeypatch.setattr(counting, "_LARGEST", 6)
    monkeypatch.setattr(mean_motion, "_RATES_HZ", (1, 4, 16))
    monkeypatch.setattr(moving, "_LARGEST", 5)
    monkeypatch.setattr(visibility, "_LARGE_SHARES", (0.9, 1.1, 2.0, 8.0))


@pytest.mark.usefixtures("fewer")
@pytest.mark.parametrize("name", TRIALS)
def test_verdicts_and_files(name: str, tmp_path: Path) -> None:
    """Every statement fares as it is known to; tables and pictures can be written, and the seed decides the bytes."""
    draws = importlib.util.find_spec("matplotlib") is not None
    record = run_experiment(EXPERIMENTS[name], tmp_path, Settings(trials=TRIALS[name], threads=1), draws=draws)
    found = "".join(LETTER[one.verdict] for one in record.statements)
    told = "\n".join(f"{LETTER[one.verdict]} {one.claim} {one.found}" for one in record.statements)
    assert found == VERDICTS[name], told
    assert "nan" not in told.replace("nant", "")
    for table in record.tables:
        assert len(read(tmp_path / table)) > 0
    assert len(record.pictures) == (len(list(tmp_path.glob("*.png"))) if draws else 0)


@pytest.mark.usefixtures("fewer")
@pytest.mark.parametrize("name", ["cameras", "theorems"])
def test_one_thread_or_two(name: str, tmp_path: Path) -> None:
    for threads in (1, 2):
        settings = Settings(trials=1, threads=threads)
        tables = run_experiment(EXPERIMENTS[name], tmp_path / str(threads), settings, draws=False).tables
    for table in tables:
        assert (tmp_path / "1" / table).read_bytes() == (tmp_path / "2" / table).read_bytes()


def test_another_seed_is_another_run(tmp_path: Path) -> None:
    for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
        run_experiment(EXPERIMENTS["cameras"], tmp_path / folder, Settings(seed=seed, trials=1), draws=False)
    a, b, c = ((tmp_path / folder / "cameras.csv").read_bytes() for folder in "abc")
    assert a == b != c


# -------------------------------------------------------------------------------------------------------------- parts


def test_pictures_that_know_the_vertical() -> None:
    """Fewest points and views; three pictures of six points are enough whatever else is unknown."""
    fewest = {(False, False): (2, 2), (False, True): (3, 3), (True, False): (3, 2), (True, True): (4, 3)}
    for (scaled, tilted), (n, m) in fewest.items():
        assert extra_freedoms_of_pictures(n, m, scaled=scaled, tilted=tilted) == 0
        assert extra_freedoms_of_pictures(n, m - 1, scaled=scaled, tilted=tilted) > 0
        assert extra_freedoms_of_pictures(n - 1, m, scaled=scaled, tilted=tilted) > 0
        assert extra_freedoms_of_pictures(6, 3, scaled=scaled, tilted=tilted) == 0


def test_kinds_are_what_their_names_say() -> None:
    """The scenes of an ambiguous kind are ambiguous for its reason, not because they are too small."""
    by_name = {kind.name: kind for kind in KINDS}
    assert len(by_name) == len(KINDS)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        centers, points = by_name["two lines II"].draw(rng)
        for members in (centers, points):
            assert np.linalg.matrix_rank(members - members.mean(axis=0), tol=1e-9) == 2
        for curve in ("ellipse", "hyperbola", "parabola"):
            places = np.vstack(by_name[curve].draw(rng))
            x, y = places.T
            monomials = np.column_stack((x * x, x * y, y * y, x, y, np.ones(len(x))))
            assert np.linalg.svd(monomials)[1][-1] < 1e-9 or len(places) == 6
        centers, points = by_name["Theorem II, cameras in line"].draw(rng)
        assert np.linalg.matrix_rank(centers - centers[0], tol=1e-9) == 1
        assert len(points) >= 4


def test_null_vectors_keep_bearings() -> None:
    by_name = {kind.name: kind for kind in KINDS}
    for name in ("camera collinearity", "one camera", "ellipse"):
        centers, points = by_name[name].draw(np.random.default_rng(3))
        tracks = rays(centers, points)
        assert certified_freedoms(tracks, centers, points) == dense_freedoms(tracks) > 0
        moved_views, moved_points = null_vector(pp.certify(tracks, truth_of(tracks, centers, points)))
        ray = (points + 0.01 * moved_points)[tracks.track] - (centers + 0.01 * moved_views)[tracks.view]
        across = ray - (ray * tracks.bearing).sum(axis=1, keepdims=True) * tracks.bearing
        assert np.abs(across).max() < 1e-9
        assert max(np.abs(moved_views).max(), np.abs(moved_points).max()) > 0.1


def test_noise_has_the_size_that_is_asked_for() -> None:
    tracks = rays(np.zeros((1, 3)), np.random.default_rng(0).normal(size=(4000, 3)))
    noisy = disturbed(tracks, 1e-3, np.random.default_rng(1))
    angle = np.linalg.norm(noisy.bearing - tracks.bearing, axis=1)
    assert np.sqrt((angle**2).mean()) == pytest.approx(np.sqrt(2.0) * 1e-3, rel=0.05)
    assert slope(np.array([1.0, 2.0, 4.0]), np.array([3.0, 12.0, 48.0])) == pytest.approx(2.0)


@pytest.mark.parametrize("d", [2, 3])
def test_moving_scenes(d: int) -> None:
    """Hidden bodies are in one direction, steady cameras go straight, and the dense nullity is that of theory."""
    rng = np.random.default_rng(4)
    hidden = draw_hidden(rng, d=d)
    rows = [hidden.tracks.bearing[hidden.tracks.track == j] for j in (8, 9)]
    np.testing.assert_allclose(rows[0], rows[1], atol=1e-12)
    assert hidden.dense_nullity() == d + 1 + 2
    line = FORMS["Taylor, k = 1"]
    steady = draw_moving(rng, [Static()] * 8 + [line] * 2, d=d, steady=True)
    assert np.linalg.matrix_rank(steady.centers - steady.centers[0], tol=1e-9) == 1
    assert steady.dense_nullity() == d + 1 + 2
    assert draw_moving(rng, [line] * 6, d=d).dense_nullity() == d + 1 + d
    assert draw_moving(rng, [line] * 6, d=d, at_rest=True).dense_nullity() == d + 1 + d + 1
