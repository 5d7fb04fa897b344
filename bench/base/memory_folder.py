"""Where short-lived files go: into memory if it has room, so that they wear no disk and wait for none."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

MEMORY = Path("/dev/shm")  # noqa: S108 - only folders of our own in it are used


def temporary_parent(room_bytes: int) -> Path:
    """Return a folder in memory with more free room than this; else the system's folder of temporary files."""
    try:
        roomy = os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > room_bytes
    except OSError:
        roomy = False
    return MEMORY if roomy else Path(tempfile.gettempdir())
