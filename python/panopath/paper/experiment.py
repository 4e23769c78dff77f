"""What an experiment takes and gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from panopath.errors import InputError

#: Called with trials done and trials in all.
Progress = Callable[[int, int], None]
#: A column of raw results: numbers, truths or words, one a row.
Column = Sequence[Any]
#: Draws on an empty ``matplotlib.figure.Figure``.
Draw = Callable[[Any], None]


class Verdict(StrEnum):
    """How a statement of the paper fared."""

    #: What was measured is what the paper says.
    AGREES = "agrees"
    #: True in part, or to first order: ``found`` says where it ends.
    IN_PART = "in part"
    #: Not true as printed; ``found`` is what holds instead.
    CORRECTED = "corrected"


@dataclass(frozen=True)
class Statement:
    """One statement of the paper, and what was found."""

    #: Where the paper says it: "8, figure 1".
    section: str
    #: What it says, in our words.
    claim: str
    #: What was measured or computed, with its figures.
    found: str
    verdict: Verdict


@dataclass(frozen=True)
class Settings:
    """What all experiments share."""

    seed: int = 2007
    #: Trials of each kind; None: as many as the paper has, or as the experiment says.
    trials: int | None = None
    #: Threads; 0: one a core. The results are the same on any number.
    threads: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**32:
            raise InputError(f"seed is {self.seed!r}, expected 0 to {2**32 - 1}")
        if self.trials is not None and self.trials < 1:
            raise InputError(f"trials is {self.trials!r}, expected at least 1")
        if self.threads < 0:
            raise InputError(f"threads is {self.threads!r}, expected 0 (one a core) or more")

    def trials_or(self, usual: int) -> int:
        """Trials asked for, else the usual number."""
        return usual if self.trials is None else self.trials


@dataclass(frozen=True, eq=False)
class Table:
    """Raw results, a row a trial or a case."""

    columns: Mapping[str, Column]

    @classmethod
    def of(cls, names: Sequence[str], rows: Sequence[Sequence[Any]]) -> Table:
        """Make a table of rows; without rows the columns are empty."""
        columns = zip(*rows, strict=True) if rows else ((),) * len(names)
        return cls(dict(zip(names, columns, strict=True)))

    def __post_init__(self) -> None:
        lengths = {name: len(column) for name, column in self.columns.items()}
        if len(set(lengths.values())) > 1:
            raise InputError(f"the columns of a table differ in length: {lengths}")

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came out of an experiment."""

    #: Trials in all: scenes reconstructed or judged.
    n_trials: int
    #: Raw results by name; the first is the main one.
    tables: Mapping[str, Table]
    statements: tuple[Statement, ...]
    #: Pictures by name, each with its size in inches.
    pictures: Mapping[str, Picture] = field(default_factory=dict)


@dataclass(frozen=True)
class Picture:
    """A picture to be drawn, and what it shows."""

    draw: Draw
    caption: str
    width_in: float = 8.0
    height_in: float = 5.0


@dataclass(frozen=True)
class Experiment:
    """One entry of the catalogue."""

    name: str
    #: Section of the paper.
    section: str
    #: What is done, in a line.
    title: str
    run: Callable[[Settings, Progress], Outcome]
