"""``panopath doctor``: what is installed, and what is not."""

from __future__ import annotations

import typer
from rich.console import Console
from rich.table import Table

from panopath.cli.app import EXIT_INPUT, AsJson, Quiet, Terminal
from panopath.doctor import Diagnosis, Library, diagnose


def doctor_command(*, as_json: AsJson = False, quiet: Quiet = False) -> None:
    """Say what is installed: versions, extras, threads, vector instructions. For reports of errors, too."""
    terminal = Terminal(as_json, quiet)
    with terminal.working("looking"):
        found = diagnose()
    terminal.answer(found.to_dict(), lambda console: _show(console, found))
    if not found.is_healthy:
        raise typer.Exit(EXIT_INPUT)


def _show(console: Console, found: Diagnosis) -> None:
    console.print(f"panopath {found.version}, {found.python}, {found.system}")
    console.print(
        f"core built for {found.built_for}; vector instructions: {found.vector_instructions}; "
        f"{found.n_threads} threads on {found.n_cores} cores"
    )
    table = Table("extra", "library", "needed", "installed")
    for extra, libraries in {"": found.base, **found.extras}.items():
        for k, library in enumerate(libraries):
            table.add_row((extra or "(base)") if k == 0 else "", library.name, library.required, _state(library))
    console.print(table)
    missing = [name for name, libraries in found.extras.items() if any(one.version is None for one in libraries)]
    if missing:
        console.print(f"not installed: {', '.join(missing)}; pip install 'panopath[{','.join(missing)}]'", markup=False)


def _state(library: Library) -> str:
    if library.version is None:
        return "[yellow]no[/yellow]"
    return f"[red]{library.version}: {library.trouble}[/red]" if library.trouble else library.version
