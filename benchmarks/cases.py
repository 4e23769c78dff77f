"""What is measured: the table of figures the project promises, each row a simulated world."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import radians
from typing import Any

NOISE_DEG = 0.05


@dataclass(frozen=True)
class Case:
    """One row: a world, how often it is run, and what is promised of it."""

    name: str
    title: str
    world: str
    #: Keyword arguments of ``panopath.simulate``, seed and noise aside.
    options: dict[str, Any] = field(default_factory=dict)
    #: A row of the table of hard conditions rather than of speed and size.
    hard: bool = False
    #: Each seed is another scene. Time is measured on the first.
    seeds: tuple[int, ...] = (0,)
    #: Ours and pycolmap in turn, this many times on seed 0; 0 leaves pycolmap out.
    pairs: int = 0
    #: Other peers to run on seed 0.
    peers: tuple[str, ...] = ()
    #: Repeats of ours where there are no pairs.
    repeats: int = 1
    min_speedup: float | None = None
    max_seconds: float | None = None
    max_memory_mb: float | None = None
    max_over_bound: float | None = None
    max_over_optimum: float | None = None

    def promises(self) -> dict[str, float | None]:
        """Gather the limits that the measured figures are held to."""
        return {name: value for name, value in self.__dict__.items() if name.startswith(("min_", "max_"))}

    def scaled(self, factor: float) -> Case:
        """Shrink: ``factor`` times the views and points, at most 2 seeds, once, promising nothing."""
        options = dict(self.options)
        for name in ("n_views", "n_points"):
            options[name] = max(20, round(options[name] * factor))
        return Case(
            name=self.name,
            title=f"{self.title}, scaled by {factor:g}",
            world=self.world,
            options=options,
            hard=self.hard,
            seeds=self.seeds[:2],
            pairs=min(self.pairs, 1),
            peers=self.peers,
        )


PAIRWISE = ("pytheia_lud", "pytheia_nonlinear", "gtsam")
SIX = tuple(range(6))


def _size(n_views: int, n_points: int) -> dict[str, Any]:
    return {"n_views": n_views, "n_points": n_points, "orientations": "random"}


def _hard(name: str, title: str, world: str = "street", exact: bool = True, **options: Any) -> Case:
    """Make a robustness row: 6 seeds; 1.2 times the optimum is promised where orientations are exact."""
    limit = 1.2 if exact else None
    return Case(name, title, world, {**_size(100, 10_000), **options}, hard=True, seeds=SIX, max_over_optimum=limit)


CASES: dict[str, Case] = {
    case.name: case
    for case in (
        Case(
            "street_100",
            "street, 100 views, 10k points",
            "street",
            _size(100, 10_000),
            seeds=tuple(range(12)),
            pairs=3,
            peers=PAIRWISE,
            min_speedup=100,
            max_over_bound=1.15,
        ),
        Case(
            "street_1000",
            "street, 1000 views, 100k points",
            "street",
            _size(1000, 100_000),
            pairs=1,
            peers=PAIRWISE,
            min_speedup=120,
            max_memory_mb=200,
            max_over_optimum=1.2,
        ),
        Case(
            "street_3000",
            "street, 3000 views, 500k points",
            "street",
            _size(3000, 500_000),
            repeats=3,
            max_seconds=5,
        ),
        Case("room_1000", "room, 1000 views, 100k points", "room", _size(1000, 100_000), repeats=3, max_seconds=4),
        _hard("outliers_05", "5 % outliers", outlier_fraction=0.05),
        _hard("outliers_20", "20 % outliers", outlier_fraction=0.20),
        _hard("outliers_35", "35 % outliers", outlier_fraction=0.35),
        _hard("orientation_0.2", "orientations off by 0.2 deg", exact=False, orientation_error_rad=radians(0.2)),
        _hard("orientation_1", "orientations off by 1 deg", exact=False, orientation_error_rad=radians(1.0)),
        _hard("infinity_80", "80 % of the points at infinity", infinity_fraction=0.8),
        _hard("straight", "straight path", world="line"),
        _hard("stop_and_go", "stop and go", world="stop_and_go"),
        _hard("three_views", "3-view tracks, 10 % outliers", min_views=3, max_views=3, outlier_fraction=0.10),
    )
}
