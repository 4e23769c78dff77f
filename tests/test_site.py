"""The site: it builds without a warning, links and anchors lead somewhere, nothing comes from a network."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import panopath
import pytest
from panopath import errors

pytest.importorskip("furo", reason="needs the extra docs")

from docs.flowchart import draw, read
from docs.site_pages import CHAPTERS, HOME, chapter, first_column_links, navigation

ROOT = Path(__file__).parent.parent
REFERENCE = sorted(ROOT.glob("docs/reference/*.md"))
#: Modules beside the package that the reference has in full.
MODULES = ("cameras", "formats", "frontend", "paths", "report", "run", "upright", "georeference", "viewer", "walk")
#: What these modules use among themselves, and need not be told of.
INNER = {"paths": {"core_model", "model_of"}}
#: Attributes by which a browser loads something with the page.
LOADING = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src", "object": "data"}


@dataclass
class Page(HTMLParser):
    """What a page can be linked at, what it links to and what it loads."""

    anchors: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    loads: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        told = {name: value or "" for name, value in attrs}
        self.anchors |= {told[name] for name in ("id", "name") if name in told}
        if tag == "a" and "href" in told:
            self.links.append(told["href"])
        elif tag == "link" and told.get("rel") not in ("index", "search", "next", "prev", "author", "copyright"):
            self.loads.append(told.get("href", ""))
        elif told.get(LOADING.get(tag, ""), ""):
            self.loads.append(told[LOADING[tag]])
        self.loads += [entry.split()[0] for entry in told.get("srcset", "").split(",") if entry.strip()]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as ``make docs`` builds it."""
    out = tmp_path_factory.mktemp("site")
    options = ["--fail-on-warning", "--keep-going", "--quiet", "--conf-dir", str(ROOT / "docs")]
    run = [sys.executable, "-m", "sphinx", *options, "--doctree-dir", str(out / "trees"), str(ROOT), str(out / "html")]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out / "html"


@pytest.fixture(scope="session")
def pages(site: Path) -> dict[Path, Page]:
    """All pages of the site, read."""
    found = {}
    for path in sorted(site.rglob("*.html")):
        found[path] = Page()
        found[path].feed(path.read_text(encoding="utf-8"))
    return found


def written(site: Path) -> set[Path]:
    """Where the pages of the repository stand on the site."""
    sources = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
    return {site / source.relative_to(ROOT).with_suffix(".html") for source in sources}


def test_every_page_of_the_repository_is_there(pages: dict[Path, Page], site: Path) -> None:
    assert written(site) <= set(pages)


def test_links_and_anchors_lead_somewhere(pages: dict[Path, Page]) -> None:
    broken = []
    for path, page in pages.items():
        for link in page.links + page.loads:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                broken.append(f"{path.name}: {link}")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                broken.append(f"{path.name}: {link} (no such anchor)")
    assert not broken


def test_nothing_comes_from_a_network(pages: dict[Path, Page], site: Path) -> None:
    outside = [f"{p.name}: {one}" for p, page in pages.items() for one in page.loads if "//" in one]
    for style in site.rglob("*.css"):
        text = style.read_text(encoding="utf-8")
        outside += re.findall(r"(?:url\(|@import)\s*['\"]?(?:https?:)?//[^)'\"]*", text)
    assert not outside


def test_home_leads_to_every_page(pages: dict[Path, Page], site: Path) -> None:
    home = site / f"{HOME}.html"
    reached = {(home.parent / unquote(urlsplit(link).path)).resolve() for link in pages[home].links}
    assert written(site) <= reached | {home}
    assert 'url=docs/index.html"' in (site / "index.html").read_text(encoding="utf-8")


def test_navigation_follows_the_tables_of_home() -> None:
    home = "# H\n\n## Tutorials\n\n| page |\n|---|\n| [a](a.md), [b](../B.md) | [no](c.md) |\n\n## Empty\n\ntext\n"
    found = [HOME, "docs/a", "B", "docs/tutorial-z", "docs/late", "docs/method", "docs/method/x"]
    tree = navigation(home, found)
    assert tree == {
        "Tutorials": {"docs/a": "a", "B": "b", "docs/tutorial-z": ""},
        "More": {"docs/late": "", "docs/method": ""},
    }
    text = "| page |\n|---|\n| [y](method/y.md) | |\n"
    below = chapter(text, "docs/method", ["docs/method/x", "docs/method/y"])
    assert list(below.items()) == [("docs/method/y", "y"), ("docs/method/x", "")]
    for page in CHAPTERS:
        listed = first_column_links((ROOT / f"{page}.md").read_text(encoding="utf-8"), page)
        assert {f"{page}/{one.stem}" for one in (ROOT / page).glob("*.md")} == set(listed)


def names_in_reference() -> list[tuple[str, str]]:
    """Module and name of everything that the pages of the reference list."""
    listed = []
    for page in REFERENCE:
        for block in re.finditer(r"^```\{api\} (\S+)\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S):
            listed += [(block.group(1), name) for name in block.group(2).split()]
    return listed


def public_names(module_name: str) -> set[str]:
    """What a module offers: its ``__all__``, or the classes and functions that it defines."""
    module = importlib.import_module(module_name)
    if hasattr(module, "__all__"):
        return set(module.__all__)
    made_here = {n for n, one in vars(module).items() if getattr(one, "__module__", "") == module_name}
    return {name for name in made_here if not name.startswith("_")}


def test_reference_lists_every_public_name_once() -> None:
    listed = names_in_reference()
    members = [getattr(importlib.import_module(module), name) for module, name in listed]
    assert len(set(listed)) == len(listed)
    assert {name for module, name in listed if module == "panopath"} == set(panopath.__all__)
    identities = [id(member) for member in members if not isinstance(member, (str, float))]
    assert len(set(identities)) == len(identities), "told of twice"
    for name in MODULES:
        module = importlib.import_module(f"panopath.{name}")
        missing = {one for one in public_names(module.__name__) if not any(getattr(module, one) is m for m in members)}
        assert missing == INNER.get(name, set()), name


def test_reference_tells_of_every_name(pages: dict[Path, Page]) -> None:
    anchors = set().union(*(page.anchors for page in pages.values()))
    assert {f"{module}.{name}" for module, name in names_in_reference()} <= anchors
    # fields and methods stand with their class
    assert {"panopath.Tracks.from_arrays", "panopath.Scene.centers", "panopath.Status.CONVERGED"} <= anchors


def test_errors_page_names_every_error_and_exit_code() -> None:
    text = (ROOT / "docs" / "reference" / "errors.md").read_text(encoding="utf-8")
    raised = {name for name, one in vars(errors).items() if isinstance(one, type) and issubclass(one, Exception)}
    assert raised == {name for module, name in names_in_reference() if name.endswith("Error") and module == "panopath"}
    cli = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    codes = re.findall(r"^\| (\d+) \|", cli[cli.index("## Exit codes") : cli.index("## For every")], re.MULTILINE)
    assert set(codes) == set(re.findall(r"^\| (\d+) \|", text, re.MULTILINE)) == {"0", "2", "3", "130"}


def test_flow_charts_are_drawn_whole() -> None:
    """Rows go down along arrows, boxes do not overlap, and what is not understood is refused."""
    chart = """flowchart LR
        a["first<br/>line"] --> b["x < y"] --> c
        a -- by another way --> c
        d --> c
        b --> e
    """
    assert [(e.tail, e.head, e.text) for e in read(chart).edges][2] == ("a", "c", "by another way")
    drawn = draw(chart)
    assert drawn.count("<rect") == 5
    assert "x &lt; y" in drawn
    assert "by another way" in drawn
    boxes = [
        [float(n) for n in re.findall(r'(?:x|y|width|height)="([-\d.]+)"', one)] for one in drawn.split("<rect")[1:]
    ]
    for i, (x, y, wide, high) in enumerate(b[:4] for b in boxes):
        for u, v, other, _ in (b[:4] for b in boxes[:i]):
            assert abs(y - v) > high or x + wide <= u or u + other <= x
    heights = dict(zip("abcde", (b[1] for b in boxes), strict=True))
    assert heights["a"] < heights["b"] < heights["c"]
    assert heights["d"] < heights["c"]
    assert read("flowchart TD\n a --> b\n b --> a").edges[1].head == "a"  # a ring is drawn, not followed for ever
    assert draw("flowchart TD\n a --> b\n b --> a").count("<rect") == 2
    with pytest.raises(ValueError, match="is not understood"):
        read("flowchart LR\n a ==> b")
