"""Sync files and folders, so that what was written survives a power cut; write every byte. Errors are the system's."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

O_BINARY: Final = getattr(os, "O_BINARY", 0)
"""Flag of ``os.open``; without it, Windows writes two bytes for each line feed."""
FOLDERS_OPEN: Final = hasattr(os, "O_DIRECTORY")
"""Whether a folder can be opened, to be locked or synced; not on Windows."""
_TO_SYNC: Final = os.O_RDONLY if FOLDERS_OPEN else os.O_RDWR
"""Windows does not sync a file that is open for reading only."""


def sync_folder(folder: Path) -> None:
    """Sync a folder, so that names in it survive a power cut. Does nothing on Windows, which cannot sync folders."""
    if FOLDERS_OPEN:
        _sync(folder, os.O_RDONLY | os.O_DIRECTORY)


def sync_file(path: Path) -> None:
    """Sync a file, so that its contents survive a power cut. Raises OSError when it cannot be synced."""
    _sync(path, _TO_SYNC)


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_all(descriptor: int, data: bytes | bytearray | memoryview) -> None:
    """Write every byte. ``os.write`` alone may write fewer."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]
