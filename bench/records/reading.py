"""Read files that somebody may have changed: ordinary ones only, and never more than they may hold.

A pipe would keep the reader for ever, and a file that states ten gigabytes would fill the memory. Nothing is written.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from bench.base.bounded_json import parse_json
from bench.base.errors import StorageError
from bench.records.storage import O_BINARY, storage_errors

MOST_BYTES = 100_000_000
"""Largest JSON file that is read: the results of ten thousand poses have 70 MB."""
MOST_TABLE_BYTES = 1 << 30
"""Largest table of rows, a line of JSON each, that is read."""
_RESTORE = "Restore the file from a copy."


@contextmanager
def open_to_read(path: Path) -> Iterator[BinaryIO]:
    """Open an ordinary file for reading. A pipe or a device, which might never answer, is refused.

    Raises StorageError: If it cannot be opened or read, or is no ordinary file.
    """
    with storage_errors(path):
        descriptor = os.open(path, os.O_RDONLY | O_BINARY | getattr(os, "O_NONBLOCK", 0))
        mode = os.fstat(descriptor).st_mode
        if not stat.S_ISREG(mode):
            os.close(descriptor)
            what = "a folder" if stat.S_ISDIR(mode) else "a pipe, a socket or a device"
            raise StorageError(f"This is {what}, not a file.", where=str(path), remedy=_RESTORE)
        with os.fdopen(descriptor, "rb") as stream:
            yield stream


def read_bounded(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Read an ordinary file of a bounded size.

    Raises StorageError: If it cannot be read, is no ordinary file, or is larger.
    """
    with open_to_read(path) as stream:
        is_larger = os.fstat(stream.fileno()).st_size > most_bytes
        data = b"" if is_larger else stream.read(most_bytes + 1)  # the file may grow meanwhile
    if is_larger or len(data) > most_bytes:
        raise StorageError(
            f"The file has more than {most_bytes} bytes.",
            where=str(path),
            remedy=_RESTORE,
        )
    return data


def read_json(path: Path, most_bytes: int = MOST_BYTES) -> Any:
    """Read a JSON file of a bounded size.

    Raises StorageError: As `read_bounded`.
    Raises ValueError: If it is not JSON, is nested too deeply, or has too many values.
    """
    return parse_json(read_bounded(path, most_bytes))
