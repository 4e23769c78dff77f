"""``panopath view``: a scene to walk about in."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from panopath.cli.app import AsJson, Quiet, Terminal
from panopath.viewer import view


def view_command(
    out: Annotated[Path, typer.Argument(help="Folder that panopath wrote, or a COLMAP model.")],
    *,
    port: Annotated[int, typer.Option(min=0, max=65_535, help="Port to serve at; 0 takes a free one.")] = 8080,
    host: Annotated[str, typer.Option(help="Address to serve at; the default is seen by this machine alone.")] = (
        "127.0.0.1"
    ),
    images: Annotated[Path | None, typer.Option(help="Folder of the panoramas, named like the views.")] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Open no browser.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Show a scene in the browser: points, path, panoramas to stand in, uncertainty. Ctrl+C ends it."""
    terminal = Terminal(as_json, quiet)
    with view(out, port=port, host=host, open_browser=not no_browser, block=False, images=images) as viewer:
        terminal.answer(
            {"url": viewer.url, "folder": str(out)},
            lambda console: console.print(f"{out} at {viewer.url} (Ctrl+C ends it)", markup=False),
        )
        # whoever waits for the address reads it through a pipe
        sys.stdout.flush()
        viewer.wait()
