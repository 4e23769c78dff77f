"""Run an experiment and keep what came out: ``NAME.csv``, ``NAME.png``, ``NAME.json``, and a page over all of them."""

from __future__ import annotations

import csv
import io
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from panopath import _core
from panopath.errors import InputError
from panopath.formats.files import replacing, write_bytes
from panopath.paper.experiment import Experiment, Outcome, Picture, Progress, Settings, Statement, Table
from panopath.report.pictures import matplotlib_figure

#: Significant digits of numbers in tables: more than any of them means.
_DIGITS = 9
SUMMARY = "paper.md"


@dataclass(frozen=True)
class Record:
    """What a run left behind, as ``NAME.json`` has it too."""

    name: str
    section: str
    title: str
    seed: int
    n_trials: int
    wall_s: float
    n_cores: int
    version: str
    statements: tuple[Statement, ...]
    #: Names of files in the folder, with what pictures show.
    tables: tuple[str, ...]
    pictures: Mapping[str, str]

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"pictures": dict(self.pictures)}


def run_experiment(
    experiment: Experiment,
    out: str | PathLike[str],
    settings: Settings | None = None,
    progress: Progress | None = None,
    *,
    draws: bool = True,
) -> Record:
    """Run an experiment and write what came out.

    Parameters
    ----------
    experiment
        One of ``EXPERIMENTS``.
    out
        Folder; made where it is absent. Files of the same names are replaced, others stay.
    settings
        Seed, trials, threads.
    progress
        Called with trials done and trials in all.
    draws
        Whether to draw pictures.

    Raises
    ------
    InputError
        Where the folder cannot be written.
    MissingExtraError
        Where pictures are to be drawn without matplotlib: before anything is computed.
    """
    chosen = Settings() if settings is None else settings
    figures = matplotlib_figure() if draws else None
    folder = _made(Path(out))
    begin = time.perf_counter()
    outcome = experiment.run(chosen, progress or (lambda done, total: None))
    seconds = time.perf_counter() - begin
    record = Record(
        experiment.name,
        experiment.section,
        experiment.title,
        chosen.seed,
        outcome.n_trials,
        round(seconds, 3),
        os.cpu_count() or 1,
        _core.__version__,
        outcome.statements,
        _write_tables(folder, experiment.name, outcome),
        {} if figures is None else _draw(folder, experiment.name, outcome.pictures, figures),
    )
    write_bytes(folder / f"{experiment.name}.json", (json.dumps(record.to_dict(), indent=2) + "\n").encode())
    return record


def _made(folder: Path) -> Path:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file, expected a folder to write to")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror})") from None
    return folder


def _file_name(experiment: str, part: str, ending: str, *, is_first: bool) -> str:
    """Name a table or picture; the main one after its experiment alone."""
    return f"{experiment}.{ending}" if is_first else f"{experiment}-{part}.{ending}"


def _write_tables(folder: Path, name: str, outcome: Outcome) -> tuple[str, ...]:
    written = []
    for k, (part, table) in enumerate(outcome.tables.items()):
        written.append(_file_name(name, part, "csv", is_first=k == 0))
        write_bytes(folder / written[-1], _csv(table))
    return tuple(written)


def _csv(table: Table) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows(zip(*([_plain(value) for value in column] for column in table.columns.values()), strict=True))
    return text.getvalue().encode()


def _plain(value: Any) -> Any:
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, float | np.floating):
        return f"{float(value):.{_DIGITS}g}"
    return value


def _draw(folder: Path, name: str, pictures: Mapping[str, Picture], figures: Any) -> dict[str, str]:
    written = {}
    for k, (part, picture) in enumerate(pictures.items()):
        file = _file_name(name, part, "png", is_first=k == 0)
        figure = figures(figsize=(picture.width_in, picture.height_in), layout="constrained")
        picture.draw(figure)
        with replacing(folder / file) as staged:
            figure.savefig(staged, dpi=130, format="png", metadata={"Software": None})
        written[file] = picture.caption
    return written


def write_summary(records: Sequence[Record], out: str | PathLike[str]) -> Path:
    """Write ``paper.md``: every statement with what was found, and every picture.

    Raises
    ------
    InputError
        Where it cannot be written.
    """
    path = Path(out) / SUMMARY
    write_bytes(path, summary_text(records).encode())
    return path


def summary_text(records: Sequence[Record], folder: str = "") -> str:
    """Compose the page; ``folder`` is the way from it to the files, such as ``img/paper/``."""
    lines = ["# The paper's experiments, run again", ""]
    for record in records:
        lines += _experiment_lines(record, folder)
    return "\n".join(lines) + "\n"


def _experiment_lines(record: Record, folder: str) -> list[str]:
    plural = "" if record.n_trials == 1 else "s"
    lines = [
        f"## {record.title}",
        "",
        f"Section {record.section} of the paper. `panopath paper {record.name} --seed {record.seed}`: "
        f"{record.n_trials:,} trial{plural}, {record.wall_s:.1f} s on {record.n_cores} cores, "
        f"panopath {record.version}. Raw results: {', '.join(f'`{table}`' for table in record.tables)}.",
        "",
        "| section | the paper | found | |",
        "|---|---|---|---|",
    ]
    for one in record.statements:
        cells = (text.replace("|", "\\|") for text in (one.section, one.claim, one.found, f"**{one.verdict}**"))
        lines.append(f"| {' | '.join(cells)} |")
    lines.append("")
    for file, caption in record.pictures.items():
        lines += [f"![{caption}]({folder}{file})", "", f"*{caption}*", ""]
    return lines
