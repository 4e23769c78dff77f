"""``panopath paper``: the experiments of the 2007 paper, run again."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from panopath.cli.app import AsJson, NoPlots, Quiet, Terminal
from panopath.cli.reconstruct import progress
from panopath.errors import InputError
from panopath.paper import EXPERIMENTS, Record, Settings, run_experiment, write_summary

_ALL = "all"


def paper_command(
    experiment: Annotated[
        str | None,
        typer.Argument(help=f"One of {', '.join(EXPERIMENTS)}; or {_ALL}. Without it, they are listed."),
    ] = None,
    *,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for raw results (CSV), pictures and paper.md.")
    ] = Path("panopath-paper"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = Settings.seed,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Trials of each kind; default: as many as the paper has.")
    ] = None,
    threads: Annotated[int, typer.Option(min=0, help="Threads; 0: one a core. Results do not depend on it.")] = 0,
    no_plots: NoPlots = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run the experiments of the paper that panopath starts from, and say where they agree (extra plot)."""
    terminal = Terminal(as_json, quiet)
    if experiment is None:
        terminal.answer({name: one.title for name, one in EXPERIMENTS.items()}, _list)
        return
    chosen = list(EXPERIMENTS) if experiment == _ALL else [experiment]
    if unknown := [name for name in chosen if name not in EXPERIMENTS]:
        raise InputError(f"EXPERIMENT is {unknown[0]!r}, expected {_ALL} or one of {', '.join(EXPERIMENTS)}")
    settings = Settings(seed, trials, threads)
    records = []
    for name in chosen:
        with progress(terminal, transient=True) as report:
            records.append(run_experiment(EXPERIMENTS[name], out, settings, partial(report, name), draws=not no_plots))
        terminal.note(f"{name}: {records[-1].n_trials:,} trials, {records[-1].wall_s:.1f} s")
    page = write_summary(records, out)
    plain = {"experiments": [record.to_dict() for record in records], "out": str(out)}
    terminal.answer(plain, lambda console: _show(console, records, page))


def _list(console: Console) -> None:
    table = Table("experiment", "section", "what is done")
    for name, one in EXPERIMENTS.items():
        table.add_row(name, one.section, one.title)
    console.print(table)
    console.print(f"panopath paper EXPERIMENT -o OUT; {_ALL} runs every one")


def _show(console: Console, records: list[Record], page: Path) -> None:
    for record in records:
        table = Table("section", "the paper", "found", "", title=record.title, title_justify="left")
        for one in record.statements:
            table.add_row(one.section, one.claim, one.found, one.verdict.value)
        console.print(table, soft_wrap=False)
    console.print(f"written to {page.parent} (look at {page.name})")
