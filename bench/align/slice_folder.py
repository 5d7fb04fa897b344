"""The private folder of live slices: in memory where there is room, and nothing of it outlasts its process for long.

A process that was killed leaves its folder behind; the next session removes it.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path

_MEMORY = Path("/dev/shm")  # noqa: S108 - only a folder of our own in it is used
_ROOM = 500_000_000
_NAME = re.compile(r"starbench-align-(\d+)-\w+")


def make_slice_folder() -> Path:
    """Make a folder that only this user can read; remove those of processes that have ended.

    Returns: The new folder. In memory, if half a gigabyte is free there: hours of slices would wear out a
      disk.
    """
    in_memory = _MEMORY.is_dir() and os.access(_MEMORY, os.W_OK) and shutil.disk_usage(_MEMORY).free > _ROOM
    parent = _MEMORY if in_memory else Path(tempfile.gettempdir())
    _remove_left_behind(parent)
    return Path(tempfile.mkdtemp(prefix=f"starbench-align-{os.getpid()}-", dir=parent))


def _remove_left_behind(parent: Path) -> None:
    """Remove this user's folders of processes that have ended."""
    for folder in parent.glob("starbench-align-*"):
        found = _NAME.fullmatch(folder.name)
        try:
            if found and folder.lstat().st_uid == os.getuid() and not _is_alive(int(found[1])):
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:  # another session removes it at the same time
            continue


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
