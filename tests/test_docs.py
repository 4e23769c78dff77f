"""The pages: their code runs, their links lead somewhere, and what they list is what there is."""

from __future__ import annotations

import os
import re
import runpy
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import panopath as pp
import pytest
import typer
from filmed import Film
from panopath.cli import app

from docs.figures_moving import crossing

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
RUNNING = (
    "README.md",
    "docs/tutorial-first-solve.md",
    "docs/tutorial-unknown-orientation.md",
    "docs/tutorial-certificate.md",
    "docs/tutorial-video.md",
    "docs/tutorial-coast.md",
    "docs/tutorial-robot.md",
    "docs/tutorial-colmap.md",
    "docs/paper.md",
    "docs/moving.md",
    "docs/index.md",
    "docs/reference/errors.md",
)
#: Pages whose indented commands run too.
SHOWING = sorted({*RUNNING, "docs/reconstruct.md", "docs/index.md", "docs/view.md", "docs/planets.md"})


def fenced(page: str) -> list[tuple[str, int, str]]:
    """Blocks of a page: language, the line it begins at, and text."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = re.finditer(r"^```(\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [(match.group(1), text.count("\n", 0, match.start(2)), match.group(2)) for match in found]


@pytest.mark.parametrize("page", RUNNING)
def test_code_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = fenced(page)
    assert any(language == "python" for language, _, _ in blocks)
    namespace: dict[str, object] = {}
    environment = os.environ | {"COLUMNS": "120"}
    for language, line, block in blocks:
        if language == "python":
            # as many empty lines as stand before it: a failure then names the line of the page
            exec(compile("\n" * line + block, page, "exec"), namespace)
        elif language == "console":
            for command in re.findall(r"^\$ (.*)$", block, re.MULTILINE):
                words = shlex.split(command)
                assert words[0] == "panopath"
                run = [sys.executable, "-m", "panopath.cli", *words[1:]]
                done = subprocess.run(run, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
                assert done.returncode == 0, f"{page}: {command}\n{done.stdout}{done.stderr}"


def commands(page: str) -> list[str]:
    """Commands that a page shows without a prompt, in indented blocks."""
    text = re.sub(r"^```.*?^```$", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return [line.split("  #")[0].strip() for line in re.findall(r"^    (panopath .*)$", text, re.MULTILINE)]


@pytest.fixture
def inputs(tmp_path: Path, film: Film) -> Path:
    """A folder with the files that the pages' commands take."""
    (tmp_path / "walk.mp4").symlink_to(film.path)
    film.walk.write_images(tmp_path / "photos", every=3)
    pytest.importorskip("pycolmap", reason="needs the extra colmap")
    runpy.run_path(str(ROOT / "examples" / "colmap_map.py"))["make_database"](tmp_path / "database.db")
    (tmp_path / "known.txt").write_text("house 0\nhouse 1\n", encoding="utf-8")
    return tmp_path


def write_bearings(page: str, path: Path) -> None:
    """Write the bearings that a page speaks of."""
    if page == "docs/moving.md":
        blocks = [block for language, _, block in fenced(page) if language == "python"]
        namespace: dict[str, object] = {}
        exec(blocks[0], namespace)
        tracks = namespace["tracks"]
        assert isinstance(tracks, pp.Tracks)
    else:
        tracks = pp.simulate("street", n_views=12, n_points=200, seed=3, orientations="random").tracks
    pp.write_tracks(tracks, path)


@pytest.mark.parametrize("page", [page for page in SHOWING if commands(page)])
def test_commands_run(page: str, inputs: Path) -> None:
    """Every command that README and the pages for newcomers show, in its order."""
    write_bearings(page, inputs / "bearings.csv")
    for command in commands(page):
        words = shlex.split(command)
        run = [sys.executable, "-m", "panopath.cli", *words[1:]]
        if words[1] == "view":
            watched(run, inputs)
            continue
        done = subprocess.run(run, cwd=inputs, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{page}: {command}\n{done.stdout}{done.stderr}"


def watched(run: list[str], folder: Path) -> None:
    """Start a viewer, and end it by Ctrl+C when it says where it serves."""
    pytest.importorskip("viser", reason="needs the extra view")
    more = ["--port", "0", "--no-browser"]
    with subprocess.Popen([*run, *more], cwd=folder, stdout=subprocess.PIPE, text=True) as viewer:
        assert viewer.stdout is not None
        assert "http://" in viewer.stdout.readline()
        viewer.send_signal(signal.SIGINT)
        assert viewer.wait(timeout=60.0) in {0, 130}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    targets = re.findall(r"\]\(([^)#\s]+)", text)
    missing = [t for t in targets if "://" not in t and not (page.parent / t).exists()]
    assert not missing


def command_options() -> dict[str, set[str]]:
    """Long and short options of every command."""
    group = typer.main.get_command(app)
    commands = getattr(group, "commands")  # noqa: B009 (typer's own class, of no public type)
    return {
        name: {
            option
            for parameter in command.params
            for option in (*parameter.opts, *parameter.secondary_opts)
            if option.startswith("-")
        }
        for name, command in commands.items()
    }


def command_parameters() -> dict[str, dict[str, object]]:
    """Long options of every command with their defaults."""
    group = typer.main.get_command(app)
    commands = getattr(group, "commands")  # noqa: B009 (typer's own class, of no public type)
    return {
        name: {
            option: parameter.default
            for parameter in command.params
            for option in (*parameter.opts, *parameter.secondary_opts)
            if option.startswith("--")
        }
        for name, command in commands.items()
    }


def test_command_line_page_lists_every_option_and_no_other() -> None:
    text = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)) - {"--help"}
    real = {o for options in command_options().values() for o in options if o.startswith("--")} - {"--help"}
    assert listed == real
    for command in command_options():
        assert f"panopath {command}" in text


@pytest.mark.parametrize("command", sorted(command_parameters()))
def test_command_line_page_tables_are_those_of_the_commands(command: str) -> None:
    """In each command's section: all of its options, no others, and their defaults where the table gives a value."""
    text = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    section = re.split(r"^## ", text[text.index(f"\n## panopath {command}\n") + 1 :], flags=re.MULTILINE)[1]
    for_all = {"--json", "--quiet", "--overwrite"}
    real = command_parameters()[command]
    told: set[str] = set()
    for row in re.findall(r"^\| (`-.*) \|$", section, re.MULTILINE):
        cells = re.split(r"(?<!\\)\s*\|\s*", row)
        names = re.findall(r"(?<![\w-])--[a-z][a-z-]+", cells[0])
        told |= set(names)
        values = [value.strip("` ") for value in cells[2].split(", ")]
        if len(values) == len(names):
            for name, value in zip(names, values, strict=True):
                default, first = real.get(name), value.split(":")[0]
                # None: the step's own; False: not given
                if default is not None and default is not False:
                    assert first == str(default) or float(first) == default, (command, name)
    assert told == set(real) - for_all
    overwrites = re.search(r"^(`reconstruct`, .*?) also take `--overwrite`", text, re.MULTILINE | re.DOTALL)
    assert overwrites is not None
    assert ("--overwrite" in real) == (f"`{command}`" in overwrites.group(1))


def test_formats_page_names_every_column_and_file(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    for dimension in (2, 3):
        folder = pp.write_scene(crossing(10, 12, dimension=dimension, covariances=False), tmp_path / str(dimension))
        for name in ("cameras.csv", "points.csv", "paths.csv"):
            section = text[text.index(f"`{name}`: ") :].split("\n\n")[0]
            columns = (folder / name).read_text(encoding="utf-8").splitlines()[0].split(",")
            named = set(re.findall(r"[a-z_]+", " ".join(re.findall(r"`([^`]*)`", section))))
            assert set(columns) <= named
        for path in folder.iterdir():
            assert f"`{path.name}" in text


def test_conventions_name_every_status_and_gauge() -> None:
    text = (ROOT / "CONVENTIONS.md").read_text(encoding="utf-8")
    for status in pp.Status:
        code = 0 if status.is_determined else 3
        assert re.search(rf"^\| `{status.value}` \|.*\| {code} \|$", text, re.MULTILINE)
    for gauge in ("normalized", "paper", "paper_distance", "control"):
        assert f"| `{gauge}`" in text


def test_paper_gauge_keeps_points_in_front() -> None:
    """As CONVENTIONS.md says: where the second point lies to the left of the first, it gets x = -1."""
    found = set()
    for seed in range(8):
        world = pp.simulate("box", n_views=5, n_points=12, dimension=2, seed=seed)
        scene = pp.solve_positions(world.tracks, options=pp.PositionOptions(gauge="paper"))
        np.testing.assert_allclose(scene.points[0], 0.0, atol=1e-12)
        side = np.sign(world.points[1, 0] - world.points[0, 0])
        np.testing.assert_allclose(scene.points[1, 0], side, atol=1e-9)
        found.add(int(side))
    assert found == {-1, 1}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_paragraph_breaks_into_a_list(page: Path) -> None:
    """A line of a sentence that begins with a dash is read as the first item of a list."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    broken = []
    for block in text.split("\n\n"):
        lines = block.strip("\n").splitlines()
        # below an item or another line that is set in, a list goes on
        starts = [i for i, line in enumerate(lines) if re.match(r"([-+*]|1[.)]) ", line)]
        if starts and starts[0] > 0 and not lines[0].startswith((" ", "#", "<!--")):
            broken.append(lines[starts[0]])
    assert not broken


def test_no_page_names_a_machine_or_leaves_a_gap() -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"/(?:home|root|work|Users)/|TODO|TBD|[A-Z]+_TABLE", text), page
