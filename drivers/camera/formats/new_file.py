"""Write a new file so that it appears complete or not at all: under another name, synced, then renamed.

Another file is never overwritten. If an error or Ctrl-C interrupts the writing, the partial file is removed. A killed
process leaves it under the name ``.part``, and the next one writes it anew.
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
    """Provide a path to write to; at the end of the block the file is renamed to its own name.

    path: The file to make; it must not exist.
    Raises RecordingFileError: If the file exists, or cannot be written.
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
        raise write_error(path, error) from error


def write_error(path: Path, error: OSError) -> RecordingFileError:
    """Build the error of a file that cannot be written.

    Returns: With the system's reason.
    """
    return RecordingFileError(
        f"The file cannot be written ({error.strerror or error}).",
        where=str(path),
        remedy="Check that its folder exists, that you may write to it, and that the disk has space.",
    )


def _name(part: Path, path: Path) -> None:
    """Give the file its name. Raises RecordingFileError if another program has taken the name meanwhile."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise _exists(path) from None
    except OSError:  # a file system without hard links
        if path.exists():
            raise _exists(path) from None
        part.rename(path)
    else:
        part.unlink()
    sync_file(path)


def _exists(path: Path) -> DriverError:
    return RecordingFileError(
        "The file exists already.", where=str(path), remedy="Choose another name, or remove the file."
    )
