"""Flow charts of the pages, drawn when the site is built: no script has to be loaded to read them.

A code host draws blocks of the language ``mermaid`` itself. Of that language this reads what the pages use: boxes
``name["label"]``, arrows ``a --> b`` with or without ``-- text -->``, chains of them. Boxes are laid in rows by their
longest way from the top (Sugiyama, Tagawa and Toda 1981: long arrows pass through empty places, rows are sorted by
the mean place of their neighbours), and arrows are curves.
"""

from __future__ import annotations

import html
import re
from dataclasses import dataclass, field
from itertools import pairwise

ROW_PX, GAP_PX, LINE_PX, LETTER_PX, PAD_PX = 88.0, 14.0, 15.0, 6.6, 9.0
SWEEPS = 12


@dataclass(frozen=True)
class Edge:
    """An arrow, and what stands on it."""

    tail: str
    head: str
    text: str


@dataclass
class Chart:
    """Boxes with their labels, and arrows between them."""

    labels: dict[str, list[str]] = field(default_factory=dict)
    edges: list[Edge] = field(default_factory=list)


def read(source: str) -> Chart:
    """Read a flow chart; a line that is not understood is an error, so that none is lost."""
    chart = Chart()
    for line in source.strip().splitlines()[1:]:
        pieces = re.split(r"\s*(?:--\s*([^>-]+?)\s*)?-->\s*", line.strip())
        names = [box(chart, piece, line) for piece in pieces[::2]]
        for tail, head, text in zip(names, names[1:], pieces[1::2], strict=False):
            chart.edges.append(Edge(tail, head, text or ""))
    return chart


def box(chart: Chart, piece: str, line: str) -> str:
    """Take note of a box, and give its name."""
    found = re.fullmatch(r'(\w+)(?:\["([^"]*)"\])?', piece.strip())
    if found is None:
        raise ValueError(f"flow chart: {line.strip()!r} is not understood")
    name, label = found.groups()
    if label is not None or name not in chart.labels:
        chart.labels[name] = re.split(r"<br\s*/?>", label or name)
    return str(name)


def ranks(chart: Chart) -> dict[str, int]:
    """Row of each box: the longest way to it. Arrows that would close a ring are passed over."""
    rank = dict.fromkeys(chart.labels, 0)
    for _ in rank:
        moved = False
        for edge in chart.edges:
            if rank[edge.head] <= rank[edge.tail] < len(rank):
                rank[edge.head], moved = rank[edge.tail] + 1, True
        if not moved:
            break
    # boxes that nothing leads to stand right above what they lead to
    for name in rank:
        if all(edge.head != name for edge in chart.edges):
            rank[name] = min((rank[e.head] - 1 for e in chart.edges if e.tail == name), default=0)
    return rank


@dataclass
class Rows:
    """Boxes and places that long arrows pass through, row by row."""

    rows: list[list[str]]
    ways: dict[Edge, list[str]]
    neighbours: dict[str, list[str]]


def rows_of(chart: Chart) -> Rows:
    """Put boxes into rows, and the places of long arrows between them."""
    rank = ranks(chart)
    rows: list[list[str]] = [[] for _ in range(max(rank.values()) + 1)]
    for name, row in rank.items():
        rows[row].append(name)
    ways: dict[Edge, list[str]] = {}
    for number, edge in enumerate(chart.edges):
        between = [f"{number}/{row}" for row in range(rank[edge.tail] + 1, rank[edge.head])]
        for row, place in enumerate(between, rank[edge.tail] + 1):
            rows[row].append(place)
        ways[edge] = [edge.tail, *between, edge.head]
    neighbours: dict[str, list[str]] = {name: [] for row in rows for name in row}
    for way in ways.values():
        for one, other in pairwise(way):
            neighbours[one].append(other)
            neighbours[other].append(one)
    return Rows(rows, ways, neighbours)


def width(chart: Chart, name: str) -> float:
    """Width of a box, or of the place of an arrow."""
    if name not in chart.labels:
        return GAP_PX
    return max(len(line) for line in chart.labels[name]) * LETTER_PX + 2 * PAD_PX


def places(chart: Chart, laid: Rows) -> dict[str, float]:
    """Middle of each box from left to right: rows are sorted by their neighbours, then pulled below them."""
    x: dict[str, float] = {}
    for row in laid.rows:
        spread(chart, row, {name: float(i) for i, name in enumerate(row)}, x)
    for sweep in range(SWEEPS):
        for row in laid.rows if sweep % 2 == 0 else reversed(laid.rows):
            wanted = {n: sum(x[m] for m in laid.neighbours[n]) / max(1, len(laid.neighbours[n])) for n in row}
            row.sort(key=lambda name: wanted[name])
            spread(chart, row, wanted, x)
    least = min(x[name] - width(chart, name) / 2 for name in x)
    return {name: value - least + PAD_PX for name, value in x.items()}


def spread(chart: Chart, row: list[str], wanted: dict[str, float], x: dict[str, float]) -> None:
    """Put a row where it is wanted, as near as boxes that do not overlap allow (neighbours that would are joined)."""
    steps = [0.0] + [(width(chart, a) + width(chart, b)) / 2 + GAP_PX for a, b in pairwise(row)]
    at = [sum(steps[: i + 1]) for i in range(len(row))]  # packed as tightly as they go
    groups: list[list[int]] = []
    for i in range(len(row)):
        groups.append([i])
        while len(groups) > 1 and shift(groups[-2], row, wanted, at) > shift(groups[-1], row, wanted, at):
            groups[-2:] = [groups[-2] + groups[-1]]
    for group in groups:
        moved = shift(group, row, wanted, at)
        x.update({row[i]: at[i] + moved for i in group})


def shift(group: list[int], row: list[str], wanted: dict[str, float], at: list[float]) -> float:
    """How far boxes that keep together should move to be where they are wanted, on average."""
    return sum(wanted[row[i]] - at[i] for i in group) / len(group)


def draw(source: str) -> str:
    """Draw a flow chart as SVG in the colours of the text around it."""
    chart = read(source)
    laid = rows_of(chart)
    x = places(chart, laid)
    y = {name: row * ROW_PX + ROW_PX / 2 for row, names in enumerate(laid.rows) for name in names}
    total = max(x[name] + width(chart, name) / 2 for name in x) + PAD_PX
    lines = [
        f'<svg class="flowchart" role="img" viewBox="0 0 {total:.0f} {len(laid.rows) * ROW_PX:.0f}"'
        f' width="{total:.0f}" xmlns="http://www.w3.org/2000/svg" font-size="12">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0,0 8,4 0,8z" fill="currentColor"/></marker></defs>',
    ]
    lines += [arrow(chart, edge, [(x[n], y[n]) for n in way]) for edge, way in laid.ways.items()]
    lines += [drawn_box(chart, name, x[name], y[name]) for name in chart.labels]
    return "\n".join([*lines, "</svg>"])


def half_height(chart: Chart, name: str) -> float:
    """Half of the height of a box."""
    return (len(chart.labels[name]) * LINE_PX + 2 * PAD_PX - 2) / 2


def arrow(chart: Chart, edge: Edge, way: list[tuple[float, float]]) -> str:
    """Draw an arrow along its places, and its text near where it first arrives, apart from its neighbours'."""
    way = [*way]
    way[0] = (way[0][0], way[0][1] + half_height(chart, edge.tail))
    way[-1] = (way[-1][0], way[-1][1] - half_height(chart, edge.head) - 2)
    path = f"M{way[0][0]:.1f},{way[0][1]:.1f}"
    for (x0, y0), (x1, y1) in pairwise(way):
        bend = (y1 - y0) / 2
        path += f" C{x0:.1f},{y0 + bend:.1f} {x1:.1f},{y1 - bend:.1f} {x1:.1f},{y1:.1f}"
    drawn = f'<path d="{path}" fill="none" stroke="currentColor" opacity="0.55" marker-end="url(#tip)"/>'
    if edge.text:
        (_, y0), (x1, y1) = way[0], way[1]
        drawn += (
            f'<text x="{x1:.1f}" y="{y0 + 0.6 * (y1 - y0) + 4:.1f}" class="on-arrow" text-anchor="middle">'
            f"{html.escape(edge.text)}</text>"
        )
    return drawn


def drawn_box(chart: Chart, name: str, x: float, y: float) -> str:
    """Draw a box with its label."""
    half = half_height(chart, name)
    wide = width(chart, name)
    first = y - (len(chart.labels[name]) - 1) * LINE_PX / 2 + 4
    text = "".join(
        f'<text x="{x:.1f}" y="{first + i * LINE_PX:.1f}" text-anchor="middle" fill="currentColor">'
        f"{html.escape(html.unescape(line.strip()))}</text>"
        for i, line in enumerate(chart.labels[name])
    )
    return f'<rect x="{x - wide / 2:.1f}" y="{y - half:.1f}" width="{wide:.1f}" height="{2 * half:.1f}" rx="5"/>{text}'
