"""The tables and pictures of docs/method/counting.md, computed.

``python -m docs.figures_counting`` prints the tables and draws the pictures into docs/img.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import panopath as pp
from panopath.counting import PathBasis, inequality_table, table_text
from panopath.paper.generic_rank import extra_freedoms
from panopath.report import Region, draw_forbidden_regions

IMAGES = Path(__file__).parent / "img"

#: The cameras of this package.
OWN = (
    pp.CameraModel.ORIENTED_PLANE,
    pp.CameraModel.ORIENTED_SPACE,
    pp.CameraModel.NON_ORIENTED_PLANE,
    pp.CameraModel.NON_ORIENTED_SPACE,
    pp.CameraModel.GRAVITY_SPACE,
)
#: Points and views of the paper's table in section 4.
PLANE_PAIRS = ((4, 1), (4, 2), (100, 2), (2, 3), (3, 3), (4, 3), (3, 4), (4, 4))
PATHS: tuple[tuple[str, int, PathBasis], ...] = (
    ("at rest", 0, None),
    ("velocity", 1, None),
    ("acceleration, or one harmonic", 2, None),
    ("two harmonics", 2, "fourier"),
)


def main() -> None:
    print("Fewest points and views, and the freedoms that a scene in general position then has beyond the gauge\n")
    print_models()
    print("\nThe plane, orientation known\n")
    print(table_text(inequality_table(*pp.CameraModel.ORIENTED_PLANE.counts, PLANE_PAIRS)))
    print("\nMoving points, orientation known: fewest points and views\n")
    print_paths()
    print("\nShare of all pairs that must be seen\n")
    print_visibility()
    print("\nHow often counting and general position agree, 1 to 8 points and views\n")
    print_agreement()
    draw_forbidden_regions(IMAGES / "counting-cameras.png")
    shown = (pp.CameraModel.ORIENTED_PLANE, pp.CameraModel.ORIENTED_SPACE, pp.CameraModel.NON_ORIENTED_SPACE)
    draw_forbidden_regions(IMAGES / "counting-moving.png", [region(m, *path) for m, path in product(shown, PATHS)], 18)


def region(model: pp.CameraModel, name: str, k: int, basis: PathBasis) -> Region:
    plain = Region.of(model, k, basis)
    return Region(f"{plain.title}\n{name}", plain.counts, k, basis)


def print_models() -> None:
    print("| camera | d | f | g | h | fewest (points, views) | equations to spare | freedoms left |")
    print("|---|---|---|---|---|---|---|---|")
    for model in pp.CameraModel:
        pairs = model.smallest()
        cells = (
            ", ".join(f"({n}, {m})" for n, m in pairs),
            ", ".join(str(model.inequality(n, m).slack) for n, m in pairs),
            ", ".join(str(extra_freedoms(model, n, m)) for n, m in pairs),
        )
        print(f"| {model.description} | {' | '.join(map(str, model.counts))} | {' | '.join(cells)} |")


def print_paths() -> None:
    print("| paths | vectors K | plane: g | fewest | space: g | fewest |")
    print("|---|---|---|---|---|---|")
    for name, k, basis in PATHS:
        cells = []
        for model in (pp.CameraModel.ORIENTED_PLANE, pp.CameraModel.ORIENTED_SPACE):
            cells += [str(model.gauge(k, basis)), ", ".join(f"({n}, {m})" for n, m in model.smallest(k, basis))]
        vectors = model.inequality(1, 1, k, basis).vectors
        print(f"| {name} | {vectors} | {' | '.join(cells)} |")


def print_visibility() -> None:
    print("| camera | points, views | all together | each point in | each view sees | at least |")
    print("|---|---|---|---|---|---|")
    for model, (n, m) in product(OWN, ((10, 10), (1000, 100))):
        needed, share = model.required_visibility(n, m), pp.required_visible_fraction(*model.counts, n, m)
        print(
            f"| {model.description} | {n}, {m} | {share:.4f} | {needed.per_point} | {needed.per_view} "
            f"| {needed.fraction:.4f} |"
        )


def print_agreement() -> None:
    print("| camera | pairs that fail | of these determined | pairs that pass | of these ambiguous |")
    print("|---|---|---|---|---|")
    for model in pp.CameraModel:
        free = {(n, m): extra_freedoms(model, n, m) for n, m in product(range(1, 9), repeat=2)}
        holds = {(n, m): model.inequality(n, m).holds for n, m in free}
        fail, ok = [p for p in free if not holds[p]], [p for p in free if holds[p]]
        determined, ambiguous = sum(free[p] <= 0 for p in fail), sum(free[p] > 0 for p in ok)
        print(f"| {model.description} | {len(fail)} | {determined} | {len(ok)} | {ambiguous} |")


if __name__ == "__main__":
    main()
