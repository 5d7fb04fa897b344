"""Check a file of a recording before it is read: an ordinary file, without parts that were never written.

A pipe or a device would keep the reader forever; a file with holes states more bytes than were ever
written.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import Final

from drivers.camera.raw_header import MAX_HEADER_BYTES, encoding_of, header_fields
from drivers.errors import NotARecording, RecordingCorrupt

_SMALL_BYTES: Final = 1 << 20  # Gaps that a writer leaves may be a large share of a smaller file
_LEAST_SHARE: Final = 0.1
"""Share of a file that may be holes: some writers leave gaps between their parts."""
_MOST_HOLES: Final = 10_000  # The sum of the first ones says enough
_KINDS: Final = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


WORD_BYTES: Final = {"EVT2": 4, "EVT21": 8, "EVT21-legacy": 8, "EVT3": 2}
"""Bytes of a word by encoding."""


def require_regular(path: Path) -> None:
    """Refuse (`NotARecording`) a folder, a pipe, a socket or a device; a link to a file is followed."""
    mode = path.stat().st_mode
    if stat.S_ISREG(mode):
        return
    what = next((name for is_one, name in _KINDS if is_one(mode)), "no ordinary file")
    raise NotARecording(f"This is {what}, not a file.", where=str(path), remedy="Give a file.")


def read_start(path: Path) -> bytes:
    """Read what may be the header of a file; refuse (`NotARecording`) a folder, a pipe, a socket or a device."""
    require_regular(path)
    with path.open("rb") as file:
        return file.read(MAX_HEADER_BYTES)


def ends_within_word(path: Path) -> bool:
    """Return whether a RAW file ends in the middle of a word, as most files do that were cut off; no if unreadable."""
    try:
        fields, size_bytes = header_fields(read_start(path))
    except OSError:
        return False
    unit = WORD_BYTES.get(encoding_of(fields), 0)
    return bool(unit and size_bytes) and (path.stat().st_size - (size_bytes or 0)) % unit != 0


def require_whole(path: Path) -> None:
    """Refuse a file with holes: parts that its file system has never stored, because they were never written.

    The `RecordingCorrupt` names the byte at which the first hole begins.
    """
    if not hasattr(os, "SEEK_HOLE"):  # Windows
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        size = os.fstat(descriptor).st_size
        if size < _SMALL_BYTES:
            return
        first, missing = _holes(descriptor, size)
    finally:
        os.close(descriptor)
    if missing > _LEAST_SHARE * size:
        raise RecordingCorrupt(
            f"The file is incomplete: of its {size} bytes, {missing} were never written.",
            offset=first,
            where=str(path),
            remedy="Copy it again from its origin, or leave it out.",
        )


def _holes(descriptor: int, size: int) -> tuple[int, int]:
    """Return where the first hole of a file begins, and how many bytes its holes have together."""
    first, missing, at = size, 0, 0
    for _ in range(_MOST_HOLES):
        try:
            hole = os.lseek(descriptor, at, os.SEEK_HOLE)
            if hole >= size:
                break
            first = min(first, hole)
            at = os.lseek(descriptor, hole, os.SEEK_DATA)
        except OSError as error:  # ENXIO: no data behind the hole; anything else: the file system cannot tell
            return first, missing + (size - hole if error.errno == errno.ENXIO else 0)
        missing += at - hole
    return first, missing
