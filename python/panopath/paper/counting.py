"""Sections 3, 4 and 7: equations against unknowns, for every kind of cameras, and whether enough of them are enough.

The count is :mod:`panopath.counting`; whether almost every scene of that size is unique is the rank of its equations
over a finite field (:mod:`panopath.paper.generic_rank`), where there is no tolerance to choose.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from panopath.counting import CameraModel, inequality_table
from panopath.paper.experiment import Experiment, Outcome, Picture, Progress, Settings, Statement, Table, Verdict
from panopath.paper.generic_rank import extra_freedoms
from panopath.report.regions import Region, draw_region_panels, region_figure_size

#: Points and views of the paper's table in section 4.
_PAPER_PAIRS = ((4, 1), (4, 2), (100, 2), (2, 3), (3, 3), (4, 3), (3, 4), (4, 4))
#: Points and views of each kind of cameras go up to this number.
_LARGEST = 8

_Row = tuple[str, int, int, int, int, bool, int]


def _run(settings: Settings, progress: Progress) -> Outcome:
    counts = range(1, _LARGEST + 1)
    pairs = [(n, m) for n, m in product(counts, counts)]
    plane = _table(CameraModel.ORIENTED_PLANE, _PAPER_PAIRS, settings.seed)
    cases = len(CameraModel) * len(pairs)
    rows: list[_Row] = []
    for model in CameraModel:
        rows += _table(model, pairs, settings.seed)
        progress(len(rows), cases)
    regions = [Region.of(model) for model in CameraModel]
    width, height = region_figure_size(regions)
    picture = Picture(
        lambda figure: draw_region_panels(figure, regions, 12),
        "Numbers of points and views with too few equations, for each kind of cameras.",
        width,
        height,
    )
    return Outcome(
        n_trials=len(rows) + len(plane),
        tables={"plane": _as_table(plane), "cameras": _as_table(rows)},
        statements=(*_plane_statements(plane), *_camera_statements(rows)),
        pictures={"regions": picture},
    )


def _table(model: CameraModel, pairs: Sequence[tuple[int, int]], seed: int) -> list[_Row]:
    counted = inequality_table(*model.counts, pairs)
    return [
        (model.value, c.n, c.m, c.equations, c.unknowns, c.holds, extra_freedoms(model, c.n, c.m, seed=seed))
        for c in counted
    ]


def _as_table(rows: list[_Row]) -> Table:
    names = ("camera", "points", "views", "equations", "unknowns", "enough", "extra_freedoms")
    columns = dict(zip(names, zip(*rows, strict=True), strict=True))
    return Table(columns | {"unique": [extra <= 0 for extra in columns["extra_freedoms"]]})


def _plane_statements(rows: list[_Row]) -> list[Statement]:
    unique = [f"({n}, {m})" for _, n, m, *_, extra in rows if extra <= 0]
    wrong = [f"({n}, {m})" for _, n, m, _, _, enough, extra in rows if enough and extra > 0]
    least = min((n, m) for _, n, m, *_, extra in rows if extra <= 0)
    return [
        Statement(
            "4, table",
            "In the plane 2 (n + m) - 3 unknowns face n m equations; three points, three cameras are the border case.",
            f"Unique in general position, of the paper's pairs (n, m): {', '.join(unique)}; the smallest is {least}. "
            f"Pairs with enough equations that are not unique: {', '.join(wrong) or 'none'}.",
            Verdict.AGREES if least == (3, 3) and not wrong else Verdict.CORRECTED,
        )
    ]


def _camera_statements(rows: list[_Row]) -> list[Statement]:
    statements = []
    for model, claim in (
        (CameraModel.ORIENTED_SPACE, "Two oriented cameras and two points are enough in space."),
        (
            CameraModel.NON_ORIENTED_SPACE,
            "Non-oriented cameras in space: which numbers suffice.",
        ),
        (CameraModel.GRAVITY_SPACE, "Cameras that know the vertical: three pictures and six points, or fewer."),
    ):
        mine = [row for row in rows if row[0] == model.value]
        failing = [(n, m) for _, n, m, _, _, enough, extra in mine if enough and extra > 0 and min(n, m) > 1]
        fewest = ", ".join(f"({n}, {m})" for n, m in model.smallest())
        generic = _fewest_unique(mine)
        agrees = set(generic) == {(n, m) for n, m in model.smallest() if max(n, m) <= _LARGEST}
        statements.append(
            Statement(
                "3, 7",
                claim,
                f"Fewest (points, views) by counting: {fewest}; unique in general position: "
                f"{', '.join(map(str, generic))}. Counts that pass and are ambiguous: "
                f"{', '.join(map(str, failing)) or 'none'}.",
                Verdict.AGREES if agrees else Verdict.IN_PART,
            )
        )
    return statements


def _fewest_unique(rows: list[_Row]) -> list[tuple[int, int]]:
    unique = {(n, m) for _, n, m, *_, extra in rows if extra <= 0 and n > 1}
    return sorted(p for p in unique if not {(p[0] - 1, p[1]), (p[0], p[1] - 1)} & unique)


COUNTING = Experiment("counting", "3, 4, 7", "Equations, unknowns, and what is unique", _run)
