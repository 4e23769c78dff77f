"""What the site adds to the pages: navigation, the reference of Python, a way in.

Navigation is not written down twice. The sections of ``docs/index.md`` are its headings and the links in the first
column of their tables its pages; ``docs/method.md`` and ``docs/reference.md`` list their own folders in the same way. A
page that no table names still has its place: tutorials among tutorials, others at the end.

A fenced block ``{api} MODULE`` with one name a line is what the reference is made of: each name becomes its
docstring, in the form that suits it.
"""

from __future__ import annotations

import dataclasses
import enum
import importlib
import inspect
import posixpath
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing
from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.ext.napoleon import Config
from sphinx.ext.napoleon.docstring import NumpyDocstring
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode

from docs.flowchart import draw

HOME = "docs/index"
TUTORIALS = "Tutorials"
MORE = "More"
#: Pages whose tables list the pages of the folder of the same name.
CHAPTERS = ("docs/method", "docs/reference")
#: Letters of a cell that stays on one line.
SHORT_CELL = 12


def first_column_links(text: str, page: str) -> dict[str, str]:
    """Pages that the first column of a page's tables links to, in order, with the words of each link."""
    cells = [line.split(" | ")[0] for line in text.splitlines() if line.startswith("| [")]
    links = [link for cell in cells for link in re.findall(r"\[([^\]]+)\]\(([^)#\s]+)\.md\)", cell)]
    return {posixpath.normpath(posixpath.join(posixpath.dirname(page), target)): title for title, target in links}


def navigation(home: str, found: Iterable[str]) -> dict[str, dict[str, str]]:
    """Pages below each heading of the navigation.

    Parameters
    ----------
    home
        Text of the first page.
    found
        Names of all pages there are.

    Returns
    -------
    dict of str to dict of str to str
        By heading: names of pages with their titles (empty: the page's own), those of chapters left to their chapter.
    """
    tree: dict[str, dict[str, str]] = {}
    for section in re.split(r"^## ", home, flags=re.MULTILINE)[1:]:
        pages = first_column_links(section, HOME)
        if pages:
            tree[section.splitlines()[0].strip()] = pages
    placed = {page for pages in tree.values() for page in pages} | {HOME}
    for page in sorted(set(found) - placed):
        if page.startswith(tuple(f"{chapter}/" for chapter in CHAPTERS)):
            continue
        heading = TUTORIALS if page.startswith("docs/tutorial-") else MORE
        tree.setdefault(heading, {})[page] = ""
    return tree


def chapter(text: str, page: str, found: Iterable[str]) -> dict[str, str]:
    """Pages of a chapter with their titles: in the order of its tables, then those that it does not name."""
    named = {one: title for one, title in first_column_links(text, page).items() if one.startswith(f"{page}/")}
    return named | dict.fromkeys(sorted({one for one in found if one.startswith(f"{page}/")} - set(named)), "")


def toctree(pages: dict[str, str], caption: str | None = None) -> str:
    """Write pages with their titles as a list for the navigation, which is read and not shown."""
    head = ["```{toctree}", ":hidden:", *([f":caption: {caption}"] if caption else [])]
    entries = [f"{title} </{page}>" if title else f"/{page}" for page, title in pages.items()]
    return "\n" + "\n".join([*head, "", *entries, "```"]) + "\n"


def add_navigation(app: Sphinx, page: str, content: list[str]) -> None:
    """Add to a page, when it is read, what lies below it."""
    found = app.env.found_docs
    if page == HOME:
        content[0] += "".join(toctree(pages, caption) for caption, pages in navigation(content[0], found).items())
    elif page in CHAPTERS:
        content[0] += toctree(chapter(content[0], page, found))


class Api(SphinxDirective):
    """``{api} MODULE``: what the module says of each name in the block."""

    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Write the directives of autodoc, and have them read."""
        module = importlib.import_module(self.arguments[0])
        names = [line.strip() for line in self.content if line.strip()]
        lines = ["```{eval-rst}"]
        for name in names:
            member = getattr(module, name)
            lines += [f".. {form(member)}:: {module.__name__}.{name}", *(f"   {o}" for o in options(member)), ""]
        return self.parse_text_to_nodes("\n".join([*lines, "```"]))


class FlowChart(SphinxDirective):
    """A fenced block ``mermaid``, drawn."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Draw it into the page."""
        drawn = draw("\n".join(self.content))
        return [nodes.raw("", f'<div class="flowchart">{drawn}</div>', format="html")]


def form(member: object) -> str:
    """Directive of autodoc that suits an object."""
    if inspect.isclass(member):
        return "autoexception" if issubclass(member, BaseException) else "autoclass"
    return "autofunction" if inspect.isroutine(member) else "autodata"


def options(member: object) -> list[str]:
    """Options of that directive: what a class has is told with it; of values that are long only the meaning."""
    if not inspect.isclass(member):
        return [] if inspect.isroutine(member) else [":no-value:"]
    if issubclass(member, BaseException):
        return [":show-inheritance:"]
    return [":members:", ":undoc-members:", *([":show-inheritance:"] if issubclass(member, enum.Enum) else [])]


class ArrayOf:
    """Stands for ``numpy.typing.NDArray`` while pages are made: an array type is the name of what it holds."""

    NAMES: ClassVar[dict[object, str]] = {
        np.float64: "Float",
        np.int32: "Int",
        np.int64: "Int64",
        np.intp: "Int64",
        np.bool_: "Bool",
    }

    def __class_getitem__(cls, held: object) -> object:
        return TypeVar(cls.NAMES.get(held, getattr(held, "__name__", "Array").title()))


def name_array_types() -> None:
    """Have signatures say ``Float`` and ``ArrayLike``, which spelt out fill lines and say less.

    To be called before the package is imported: its own names for arrays are made of these.
    """
    setattr(numpy.typing, "NDArray", ArrayOf)  # noqa: B010 (a type, to the type checker)
    setattr(numpy.typing, "ArrayLike", TypeVar("ArrayLike"))  # noqa: B010


def read_sections(  # noqa: PLR0917 (what autodoc calls it with)
    app: Sphinx, what: Any, name: str, member: object, given: object, lines: list[str]
) -> None:
    """Turn the sections of a numpy docstring into fields.

    Napoleon's own hook takes the first colon of a comment on a field for the end of a type; such comments are text.
    """
    if what not in ("attribute", "data", "property"):
        settings: Any = Config(napoleon_google_docstring=False)
        lines[:] = NumpyDocstring(lines, settings, app, what, name, member, given).lines()


def shorten_signature(  # noqa: PLR0917 (what autodoc calls it with)
    app: Sphinx, what: str, name: str, member: object, given: object, arguments: str | None, result: str | None
) -> tuple[str | None, str | None]:
    """Leave out of a signature what stands below it, or is no Python.

    The arguments of a record are its fields, and these are listed with their types, defaults and meaning.
    """
    if inspect.isclass(member) and issubclass(member, enum.Enum):
        return "", None
    if dataclasses.is_dataclass(member):
        return "(...)", None
    return (None if arguments is None else re.sub(r"<[^<>]*>", "...", arguments)), result


def keep_short_cells_whole(app: Sphinx, page: nodes.document, name: str) -> None:
    """Mark cells of tables that are short, such as a number with its unit: they do not break."""
    for cell in page.findall(nodes.entry):
        if len(cell.astext()) <= SHORT_CELL:
            cell["classes"].append("short")


def find_by_last_name(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, shown: nodes.Element
) -> nodes.Element | None:
    """Find a name in the reference that a docstring calls as its own module does."""
    if node.get("refdomain") != "py" or app.builder.name != "html":
        return None
    last = str(node["reftarget"]).rpartition(".")[2]
    known = env.domains.python_domain.objects
    found = [full for full in known if full.startswith("panopath.") and full.rpartition(".")[2] == last]
    if not found:
        return None
    name = min(found, key=len)
    entry = known[name]
    return make_refnode(app.builder, node.get("refdoc", ""), entry.docname, entry.node_id, shown, name)


WAY_IN = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta http-equiv="refresh" content="0; url=docs/index.html">
<title>panopath</title>
<p><a href="docs/index.html">panopath: the documentation</a></p>
</html>
"""


def add_way_in(app: Sphinx, failed: Exception | None) -> None:
    """Write the page that leads from the folder of the site to the first page."""
    if failed is None and app.builder.name == "html":
        (Path(app.outdir) / "index.html").write_text(WAY_IN, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Tell Sphinx of all this."""
    name_array_types()
    app.add_directive("api", Api)
    app.add_directive("mermaid", FlowChart)
    app.connect("source-read", add_navigation)
    app.connect("autodoc-process-docstring", read_sections)
    app.connect("autodoc-process-signature", shorten_signature)
    app.connect("doctree-resolved", keep_short_cells_whole)
    app.connect("missing-reference", find_by_last_name)
    app.connect("build-finished", add_way_in)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
