"""Reading whole files and writing them so that a failure leaves nothing half done."""

from __future__ import annotations

import contextlib
import gzip
import os
import zlib
from collections.abc import Iterator
from pathlib import Path

from panopath.errors import InputError

GZIP_MAGIC = b"\x1f\x8b"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


def read_bytes(path: Path) -> bytes:
    """Read all bytes of a file, gzip undone.

    Raises
    ------
    InputError
        Where the file is absent, cannot be read, is empty, or is damaged gzip.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder, expected a file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if data.startswith(GZIP_MAGIC):
        try:
            data = gzip.decompress(data)
        except (EOFError, zlib.error, gzip.BadGzipFile):
            raise InputError(f"{path}: the gzip data are damaged or cut short") from None
    if not data.strip():
        raise InputError(f"{path}: is empty")
    return data


def check_text(data: bytes, source: str) -> bytes:
    """Take a UTF-8 mark off, and say so where bytes are not text.

    Raises
    ------
    InputError
        Naming the file.
    """
    if data.startswith(_UTF16):
        raise InputError(f"{source}: is UTF-16 text, expected UTF-8")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\x00" in data[:4096]:
        raise InputError(f"{source}: is binary of a kind that is not known here")
    return data


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a path to write to; only when the block ends well does it become ``path``."""
    staged = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield staged
        os.replace(staged, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    finally:
        # where it could not be made, it may not be possible to take it away either
        with contextlib.suppress(OSError):
            staged.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, gzip where the name ends in ``.gz``.

    Raises
    ------
    InputError
        Where it cannot be written.
    """
    if path.suffix == ".gz":
        # no name and no time inside, so that the same data are the same bytes
        data = gzip.compress(data, compresslevel=6, mtime=0)
    with replacing(path) as staged:
        staged.write_bytes(data)
