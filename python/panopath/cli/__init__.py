"""The command line: parse, call, print. One file a command."""

from panopath.cli import check, demo, evaluate, map, simulate, solve  # noqa: F401 (each adds its command)
from panopath.cli.app import app, main

__all__ = ["app", "main"]
