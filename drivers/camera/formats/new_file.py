"""A new file that appears whole or not at all: written under another name beside its place, synced, then named.

Never over another file. Whatever interrupts the writing - an error, Ctrl-C - takes the part away with it; what a
killed process leaves is called ``.part`` and is written anew by the next.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.camera.raw_writer import sync_file
from drivers.errors import DriverError, RecordingFileError


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Give a path to write to; at the end of the block the file is at its place.

    Raises
    ------
    RecordingFileError
        When there is such a file already, or it cannot be written.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        if path.exists():
            raise _exists(path)
        try:
            part.unlink(missing_ok=True)
            yield part
            sync_file(part)
            _name(part, path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise cannot_write(path, error) from error


def cannot_write(path: Path, error: OSError) -> RecordingFileError:
    """Say why a file cannot be written."""
    return RecordingFileError(
        f"It cannot be written ({error.strerror or error}).",
        where=str(path),
        remedy="Check that its folder exists, may be written and has space.",
    )


def _name(part: Path, path: Path) -> None:
    """Give the file its name; refused when somebody else has taken it meanwhile."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise _exists(path) from None
    except OSError:  # a file system without links
        if path.exists():
            raise _exists(path) from None
        part.rename(path)
    else:
        part.unlink()
    sync_file(path)


def _exists(path: Path) -> DriverError:
    return RecordingFileError(
        "There is such a file already.", where=str(path), remedy="Choose another name, or remove it."
    )
