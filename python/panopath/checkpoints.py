"""What a long run has done so far, in a folder: arrays by name, each with the key of what it was made from.

A file is there whole or not at all. What was made from other input, with other choices or by another version has
another key, and is as if it were not there.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError

Arrays = dict[str, npt.NDArray[Any]]

_MARK = "panopath.json"
_KEY = "__key__"
#: Bytes at either end of a file that say whether it is still the same.
_PROBE = 1 << 16


class Checkpoints:
    """Checkpoints in a folder of their own; see the module's text."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            mark = folder / _MARK
            if not mark.exists():
                mark.write_text(json.dumps({"panopath": "checkpoints"}) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(f"{folder}: cannot be written ({error.strerror})") from None

    @staticmethod
    def is_at(folder: Path) -> bool:
        """Whether a folder holds checkpoints of panopath."""
        return (folder / _MARK).is_file()

    def read(self, name: str, key: str) -> Arrays | None:
        """Give what was written under this name, None where there is nothing of this key."""
        path = self._path(name)
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                if str(archive[_KEY]) != key:
                    return None
                return {entry: archive[entry] for entry in archive.files if entry != _KEY}
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None  # damaged: made again

    def write(self, name: str, key: str, arrays: Mapping[str, npt.ArrayLike]) -> None:
        """Write arrays under a name.

        Raises
        ------
        InputError
            Where the folder cannot be written, such as when the disk is full.
        """
        path = self._path(name)
        staged = path.with_name(f".{path.name}.part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with staged.open("wb") as file:
                np.savez(file, allow_pickle=False, **{_KEY: np.array(key)}, **dict(arrays))
            os.replace(staged, path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from None
        finally:
            with contextlib.suppress(OSError):
                staged.unlink(missing_ok=True)

    def clear(self) -> None:
        """Forget everything."""
        for path in self.folder.iterdir():
            if path.name != _MARK:
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.npz"


def key_of(*parts: Any) -> str:
    """Key of what something is made from: records, numbers, text, other keys; the version counts too."""
    return hashlib.sha256("\n".join([_core.__version__, *map(repr, parts)]).encode()).hexdigest()


def key_of_file(path: Path) -> str:
    """Key of a file: its name, size, time of change, and both ends.

    Raises
    ------
    InputError
        Where it cannot be read.
    """
    try:
        with path.open("rb") as file:
            state = os.fstat(file.fileno())
            head = file.read(_PROBE)
            file.seek(max(0, state.st_size - _PROBE))
            tail = file.read(_PROBE)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    return key_of(path.name, state.st_size, state.st_mtime_ns, hashlib.sha256(head + tail).hexdigest())
