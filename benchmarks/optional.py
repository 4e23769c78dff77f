"""Packages of the extra ``peers``, which the benchmarks need and panopath does not."""

import importlib
from typing import Any


def load(name: str) -> Any:
    """Import a module that has no types of its own; the error says how to get it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise SystemExit(f"{name} is not installed: pip install 'panopath[peers]' ({error})") from None
