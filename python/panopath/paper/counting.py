"""Sections 2, 3, 4 and 7: equations against unknowns, for every kind of cameras, and whether enough of them are enough.

The count is :mod:`panopath.counting`; whether almost every scene of that size is unique is the rank of its equations
over a finite field (:mod:`panopath.paper.generic_rank`), where there is no tolerance to choose. Bodies that move are in
:mod:`panopath.paper.moving`, partial visibility is in :mod:`panopath.paper.visibility`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from panopath.counting import CameraModel, inequality_table
from panopath.paper.experiment import Experiment, Outcome, Picture, Progress, Settings, Statement, Table, Verdict
from panopath.paper.generic_rank import extra_freedoms, extra_freedoms_of_pictures
from panopath.report.regions import Region, draw_region_panels, region_figure_size

#: Points and views of each kind of cameras go up to this number.
_LARGEST = 8
#: Border cases, where equations and unknowns are as many, are sought up to here.
_FAR = 60
#: The cameras of the paper's pictures, and that of its remark in section 7.
_PAPER_CAMERAS = (
    CameraModel.ORIENTED_PLANE,
    CameraModel.ORIENTED_SPACE,
    CameraModel.NON_ORIENTED_PLANE,
    CameraModel.NON_ORIENTED_SPACE,
    CameraModel.GRAVITY_SPACE,
)
#: Orthographic pictures in which one direction is known: (scaled, tilted), and what to call them.
_PICTURES = {
    (False, False): "one scale, vertical known",
    (False, True): "one scale, tilt unknown",
    (True, False): "scale of each picture unknown, vertical known",
    (True, True): "scale and tilt unknown",
}

_Row = tuple[str, int, int, int, int, bool, int]
_Pair = tuple[int, int]


@dataclass(frozen=True)
class _PaperRow:
    """A row of the table in section 4, as it is printed."""

    label: str
    m: int
    points: Sequence[int]
    equations: Callable[[int], int]
    unknowns: Callable[[int], int]
    unique: bool


_PAPER_TABLE = (
    _PaperRow("m = 1", 1, range(1, 9), lambda n: n, lambda n: 2 * n - 1, False),
    _PaperRow("m = 2", 2, range(1, 9), lambda n: 2 * n, lambda n: 2 * n + 1, False),
    _PaperRow("m = 3, n = 2", 3, (2,), lambda _: 6, lambda _: 7, False),
    _PaperRow("m = 3, n >= 3", 3, range(3, 9), lambda n: 3 * n, lambda n: 2 * n + 3, True),
    _PaperRow("m = 4, n >= 3", 4, range(3, 9), lambda n: 4 * n, lambda n: 2 * n + 5, True),
)


def _run(settings: Settings, progress: Progress) -> Outcome:
    counts = range(1, _LARGEST + 1)
    pairs = [(n, m) for n, m in product(counts, counts)]
    total = len(CameraModel) + len(_PICTURES)
    rows: list[_Row] = []
    for done, model in enumerate(CameraModel):
        rows += _table(model, pairs, settings.seed)
        progress(done + 1, total)
    pictures: dict[str, dict[_Pair, int]] = {}
    for (scaled, tilted), name in _PICTURES.items():
        pictures[name] = {
            (n, m): extra_freedoms_of_pictures(n, m, scaled=scaled, tilted=tilted, seed=settings.seed) for n, m in pairs
        }
        progress(len(CameraModel) + len(pictures), total)
    paper = _paper_table(settings.seed)
    return Outcome(
        n_trials=len(rows) + len(paper) + len(_PICTURES) * len(pairs),
        tables={"section-4": paper, "cameras": _as_table(rows), "affine-limit": _picture_table(pictures)},
        statements=(
            *_table_statements(paper),
            *_plane_statements(rows),
            *_camera_statements(rows),
            *_turning_statements(rows),
            _vertical_statement(rows, pictures),
        ),
        pictures=_pictures(),
    )


# ------------------------------------------------------------------------------------------------------------ tables


def _table(model: CameraModel, pairs: Sequence[_Pair], seed: int) -> list[_Row]:
    counted = inequality_table(*model.counts, pairs)
    return [
        (model.value, c.n, c.m, c.equations, c.unknowns, c.holds, extra_freedoms(model, c.n, c.m, seed=seed))
        for c in counted
    ]


def _as_table(rows: Sequence[_Row]) -> Table:
    names = ("camera", "points", "views", "equations", "unknowns", "enough", "extra_freedoms", "unique")
    return Table.of(names, [(*row, row[-1] <= 0) for row in rows])


def _paper_table(seed: int) -> Table:
    """Compute the table of section 4 row for row, each with the numbers of points that it speaks of."""
    rows: list[tuple[Any, ...]] = []
    for printed in _PAPER_TABLE:
        for _, n, *rest, extra in _table(CameraModel.ORIENTED_PLANE, [(n, printed.m) for n in printed.points], seed):
            claimed = (printed.equations(n), printed.unknowns(n), printed.unique)
            rows.append((printed.label, n, *rest, extra, extra <= 0, *claimed))
    names = ("row", "points", "views", "equations", "unknowns", "enough", "extra_freedoms", "unique")
    return Table.of((*names, "printed_equations", "printed_unknowns", "printed_unique"), rows)


def _picture_table(pictures: dict[str, dict[_Pair, int]]) -> Table:
    rows = [(name, n, m, extra) for name, found in pictures.items() for (n, m), extra in found.items()]
    return Table.of(("pictures", "points", "views", "extra_freedoms"), rows)


# -------------------------------------------------------------------------------------------------------- statements


def _table_statements(table: Table) -> list[Statement]:
    """Put each row of the paper's table beside what was computed."""
    statements = []
    rows = list(zip(*table.columns.values(), strict=True))
    for printed in _PAPER_TABLE:
        mine = [row for row in rows if row[0] == printed.label]
        counts_agree = all((row[3], row[4]) == (row[8], row[9]) for row in mine)
        unlike = [(n, m) for _, n, m, *_, unique, _, _, claimed in mine if unique != claimed]
        extras = sorted({row[6] for row in mine})
        numbers = f"n = {mine[0][1]}" if len(mine) == 1 else f"n = {mine[0][1]} to {mine[-1][1]}"
        spared = sorted(row[3] - row[4] for row in mine)
        found = (
            f"{numbers}: equations and unknowns {'are these' if counts_agree else 'differ'}; equations less unknowns "
            f"{_span(spared)}; freedoms left in general position {_span(extras)}."
        )
        if unlike:
            found += f" The exception is (n, m) = {_listed(unlike)}: a single ray, whose ends are the gauge."
        claim = f"{printed.label}: {_formula(printed)}, {'unique if no ambiguity' if printed.unique else 'not unique'}."
        verdict = Verdict.CORRECTED if not counts_agree else Verdict.IN_PART if unlike else Verdict.AGREES
        statements.append(Statement("4, table", claim, found, verdict))
    return statements


def _formula(printed: _PaperRow) -> str:
    """Equations and unknowns of a row in words: both are linear in n."""
    if len(printed.points) == 1:
        n = printed.points[0]
        return f"{printed.equations(n)} equations, {printed.unknowns(n)} unknowns"
    slope, constant = printed.unknowns(1) - printed.unknowns(0), printed.unknowns(0)
    factor = printed.equations(1)
    times, sign = "" if factor == 1 else str(factor), "+" if constant > 0 else "-"
    return f"{times}n equations, {slope}n {sign} {abs(constant)} unknowns"


def _plane_statements(rows: Sequence[_Row]) -> list[Statement]:
    plane = _unique(rows, CameraModel.ORIENTED_PLANE)
    passing = {(n, m) for n, m in plane if n * m - 2 * m - 2 * n - 3 >= 0}
    from_three = {(n, m) for n, m in product(range(3, _LARGEST + 1), repeat=2)}
    mended = {(n, m) for n, m in product(range(1, _LARGEST + 1), repeat=2) if n * m - 2 * m - 2 * n + 3 >= 0}
    every = [(n, m) for n, m in product(range(1, _FAR + 1), repeat=2)]
    border = [(c.n, c.m) for c in inequality_table(*CameraModel.ORIENTED_PLANE.counts, every) if c.slack == 0]
    return [
        Statement(
            "4",
            "From the dimension formula, n m - 2 m - 2 n - 3 >= 0 is needed to have enough equations.",
            f"It is + 3: with it the formula holds for just the {len(mended)} of {_LARGEST**2} pairs that are unique "
            f"in general position, up to {_LARGEST} points and views. With the sign that is printed "
            f"{len(plane - passing)} of these are lost, (3, 3) among them.",
            Verdict.CORRECTED if mended == plane and (3, 3) not in passing else Verdict.IN_PART,
        ),
        Statement(
            "4, figure",
            "m n - 2 m - 2 n + 3 < 0 is the region of reconstruction.",
            f"It is the forbidden region: none of the pairs in it is unique, up to {_LARGEST} points and views.",
            Verdict.CORRECTED if not plane - mended else Verdict.IN_PART,
        ),
        Statement(
            "4, figure",
            "(3, 3) is the only border case; in all other cases n, m >= 3 equations are at least as many as unknowns.",
            f"As many equations as unknowns, up to {_FAR} of each: (n, m) = {_listed(border)}, of which (1, 1) is a "
            f"single ray. All {len(from_three)} pairs from (3, 3) to ({_LARGEST}, {_LARGEST}) are unique in general "
            "position.",
            Verdict.AGREES if border == [(1, 1), (3, 3)] and from_three <= plane else Verdict.CORRECTED,
        ),
        Statement(
            "4",
            "Three points and three cameras are 2 n + 3 m = 12 unknowns, before the similarity is taken away.",
            f"12 is 2 n + 2 m; 2 n + 3 m is {2 * 3 + 3 * 3}.",
            Verdict.CORRECTED,
        ),
    ]


def _camera_statements(rows: Sequence[_Row]) -> list[Statement]:
    """Fewest points and views: by counting, and by the rank of a scene in general position."""
    return [
        _camera_statement(rows, *one)
        for one in (
            ("4, figure", "Oriented cameras in the plane: (3, 3) is the border.", CameraModel.ORIENTED_PLANE),
            ("4, figure", "Oriented cameras in space: (2, 2) is the border.", CameraModel.ORIENTED_SPACE),
            ("3", "Without orientation, f = d + d (d - 1) / 2 in the plane.", CameraModel.NON_ORIENTED_PLANE),
            ("3", "Without orientation, f = d + d (d - 1) / 2 in space.", CameraModel.NON_ORIENTED_SPACE),
        )
    ]


def _camera_statement(rows: Sequence[_Row], section: str, claim: str, model: CameraModel) -> Statement:
    fewest, counted = _fewest(_unique(rows, model)), sorted(model.smallest())
    unlike = [(n, m) for name, n, m, _, _, enough, extra in rows if name == model.value and enough and extra > 0]
    return Statement(
        section,
        claim,
        f"d = {model.counts.d}, f = {model.counts.f}, g = {model.counts.g}. Fewest (points, views) by counting: "
        f"{_listed(counted)}; unique in general position: {_listed(fewest)}. Pairs up to {_LARGEST} that pass the "
        f"count and are ambiguous: {_listed(unlike)}.",
        Verdict.AGREES if fewest == counted and not unlike else Verdict.IN_PART,
    )


def _turning_statements(rows: Sequence[_Row]) -> list[Statement]:
    plane, space = (
        next(row for row in rows if row[:3] == (model.value, 3, 3))
        for model in (CameraModel.NON_ORIENTED_PLANE, CameraModel.NON_ORIENTED_SPACE)
    )
    flat = next(row for row in rows if row[:3] == (CameraModel.ORTHOGRAPHIC_SPACE.value, 3, 3))
    counted = {(n, m): unknowns for model, n, m, _, unknowns, *_ in rows if model == plane[0]}
    right = all(unknowns == 2 * n + 3 * m - 4 for (n, m), unknowns in counted.items())
    return [
        Statement(
            "2",
            "Without orientation, three cameras and three points are enough in general.",
            f"In the plane {plane[3]} equations face {plane[4]} unknowns and {plane[6]} freedoms are left, in space "
            f"{space[3]}, {space[4]} and {space[6]}. It is true of orthographic cameras ({flat[3]} and {flat[4]}, "
            f"{flat[6]} left), which the paper calls the limit.",
            Verdict.CORRECTED if plane[6] > 0 and space[6] > 0 else Verdict.AGREES,
        ),
        Statement(
            "7",
            "Cameras in the plane that turn: 2 n + 2 m - 3 + m unknowns remain when P1 and |P1 P2| are fixed.",
            "The turn of the whole scene is free as well, so that 2 n + 3 m - 4 are left beyond the gauge; fixing a "
            "distance does not stop it, fixing both coordinates of P2 does. The fewest (points, views) are "
            f"{_listed(_fewest(_unique(rows, CameraModel.NON_ORIENTED_PLANE)))}.",
            Verdict.CORRECTED if right else Verdict.AGREES,
        ),
        Statement(
            "7, figure",
            "Forbidden regions of cameras that are not oriented.",
            "The pictures printed are those of oriented cameras, (2, 2, 3) and (3, 3, 4), once more. The right ones, "
            "(2, 3, 4) and (3, 6, 7), are in the picture here.",
            Verdict.CORRECTED,
        ),
    ]


def _vertical_statement(rows: Sequence[_Row], pictures: dict[str, dict[_Pair, int]]) -> Statement:
    """Section 7, second remark: the claim follows from the printed count, 2 n + 3 m - 3 <= n m at m = 3."""
    central = _unique(rows, CameraModel.GRAVITY_SPACE)
    plan = _unique(rows, CameraModel.NON_ORIENTED_PLANE)
    unique = {name: {pair for pair, extra in found.items() if extra <= 0} for name, found in pictures.items()}
    printed = min(n for n in range(1, 100) if 2 * n + 3 * 3 - 3 <= 3 * n)
    enough = all((6, 3) in found for found in (central, plan, *unique.values()))
    limit = "; ".join(f"{name}: {_listed(_fewest(found))}" for name, found in unique.items())
    return Statement(
        "7, remark 2",
        "Where one direction is known the count is that of the plane: 3 pictures and 6 points are enough, in the "
        "affine limit too.",
        f"Enough {'everywhere' if enough else 'not everywhere'}, nowhere the fewest. At m = 3 the printed count gives "
        f"n = {printed}, the right one of the plan gives {min(n for n, m in plan if m == 3)}. Fewest (points, views) "
        f"in general position: plan alone {_listed(_fewest(plan))}; cameras in space that know the vertical, heights "
        f"used too, {_listed(_fewest(central))}; affine limit, {limit}.",
        Verdict.IN_PART if enough else Verdict.CORRECTED,
    )


def _unique(rows: Sequence[_Row], model: CameraModel) -> set[_Pair]:
    """Pairs that are unique in general position."""
    return {(n, m) for name, n, m, *_, extra in rows if name == model.value and extra <= 0}


def _fewest(unique: set[_Pair]) -> list[_Pair]:
    """Those with neither fewer points nor fewer views; a single ray or point, which the gauge takes, is none."""
    real = {pair for pair in unique if min(pair) > 1}
    return sorted(p for p in real if not {(p[0] - 1, p[1]), (p[0], p[1] - 1)} & real)


def _listed(pairs: Sequence[_Pair]) -> str:
    return ", ".join(f"({n}, {m})" for n, m in pairs) or "none"


def _span(numbers: Sequence[int]) -> str:
    return f"{numbers[0]}" if numbers[0] == numbers[-1] else f"{numbers[0]} to {numbers[-1]}"


# ---------------------------------------------------------------------------------------------------------- pictures


def _pictures() -> dict[str, Picture]:
    others = [model for model in CameraModel if model not in _PAPER_CAMERAS]
    return {
        "regions": _region_picture(_PAPER_CAMERAS, "the cameras of the paper, the orientation known or not"),
        "others": _region_picture(others, "other cameras, for comparison"),
    }


def _region_picture(models: Sequence[CameraModel], whose: str) -> Picture:
    regions = [Region.of(model) for model in models]
    width, height = region_figure_size(regions)
    caption = f"Numbers of points and views with too few equations: {whose}."
    return Picture(lambda figure: draw_region_panels(figure, regions, 12), caption, width, height)


COUNTING = Experiment("counting", "3, 4, 7", "Equations, unknowns, and what is unique", _run)
