"""Every error that panopath raises on purpose."""

from __future__ import annotations


class PanopathError(Exception):
    """Root of every error panopath raises on purpose; its text is one clear line."""


class InputError(PanopathError, ValueError):
    """The input cannot be used; the text names the file, line or argument and what was expected."""


class UndeterminedError(InputError):
    """The input can be read but shows no scene, such as one of a camera that stands still; the text says why."""


class MissingExtraError(InputError):
    """Something needs a package that the base install leaves out; the text says which extra brings it."""
