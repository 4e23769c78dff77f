"""The application, its exit codes, and how a command speaks. Degrees here, radians inside.

Answers go to standard output, progress and complaints to standard error.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import typer
from rich.console import Console

from panopath import _core
from panopath.errors import PanopathError, UndeterminedError

EXIT_INPUT = 2


EXIT_UNDETERMINED = 3


#: What shells expect of a program that Ctrl-C stopped.
EXIT_INTERRUPTED = 130


EXIT_HELP = (
    "Exit codes: 0 success; 2 unusable input or command; 3 the input does not determine the scene; 130 interrupted."
)


app = typer.Typer(
    name="panopath",
    help="From the bearings of an omni-directional camera to its path and the space around it.",
    epilog=EXIT_HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Tell all: parts, hinges, causes, modes, noise.")]


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but complaints.")]


Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Write over what is there though panopath did not make it.")
]


NoPlots = Annotated[bool, typer.Option("--no-plots", help="Draw no pictures.")]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; ends by ``SystemExit`` with one of the exit codes.

    What a user got wrong becomes one line; an error of ours keeps its traceback.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        app(given, prog_name="panopath")
    except PanopathError as error:
        line = " ".join(str(error).split())
        if "--json" in given:
            sys.stdout.write(json.dumps({"error": line}) + "\n")
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"panopath: {line}", markup=False)
        sys.exit(EXIT_UNDETERMINED if isinstance(error, UndeterminedError) else EXIT_INPUT)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:
        # whoever read our output has seen enough; keep the interpreter from complaining when it closes the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False) -> None:
    if version:
        typer.echo(f"panopath {_core.__version__}")
        raise typer.Exit


@dataclass(frozen=True)
class Terminal:
    """Where a command speaks: its answer to standard output, everything else to standard error."""

    as_json: bool
    quiet: bool

    @contextlib.contextmanager
    def working(self, what: str) -> Iterator[None]:
        """Show that something long is under way, and how long it took."""
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        if self.quiet or self.as_json or not console.is_terminal:
            yield
            return
        begin = time.perf_counter()
        with console.status(f"{what} ..."):
            yield
        console.print(f"[dim]{what}: {time.perf_counter() - begin:.2f} s[/dim]")

    def warn(self, text: str) -> None:
        """Say something that a person should know, on standard error."""
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"panopath: {text}", markup=False)

    def note(self, text: str) -> None:
        """Say something on the way, on standard error."""
        if not (self.quiet or self.as_json):
            Console(stderr=True, highlight=False, soft_wrap=True).print(text, markup=False)

    def answer(self, plain: dict[str, Any], show: Callable[[Console], None]) -> None:
        """Give the answer: as JSON, or as ``show`` prints it, or not at all."""
        if self.as_json:
            sys.stdout.write(json.dumps(plain) + "\n")
        elif not self.quiet:
            show(Console(highlight=False, soft_wrap=True))
