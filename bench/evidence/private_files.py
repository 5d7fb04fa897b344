"""Refuse files on which the trust rests if other users can read or write them.

The rule is that of OpenSSH (sshd_config(5), ``StrictModes``): neither the group nor others may write the
file or its folder. A folder with the sticky bit is safe, because nobody can replace the files of another
user in it.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import TypeVar

from bench.base.errors import EvidenceError
from bench.record.storage import read_bounded

Line = TypeVar("Line")
_WRITABLE_BY_OTHERS = 0o022  # Mode bits of group and others
_MOST_BYTES = 16 << 20  # A list of tens of thousands of keys
_ANY_ACCESS_BY_OTHERS = 0o077  # Mode bits of group and others, as ssh asks of a private key


def refuse_writable_by_others(path: Path, what: str) -> None:
    """Refuse a file, or a folder, that group or others can change or replace."""
    if not hasattr(os, "getuid"):  # Windows has no such modes
        return
    real = path.resolve()
    for place in (real, real.parent):
        mode = place.stat().st_mode
        is_sticky_folder = stat.S_ISDIR(mode) and mode & stat.S_ISVTX
        if mode & _WRITABLE_BY_OTHERS and not is_sticky_folder:
            thing = what if place == real else f"the folder of {what}"
            raise EvidenceError(
                f"Other users can change {thing} (mode {stat.S_IMODE(mode):04o}), so it proves nothing.",
                where=str(place),
                remedy=f"If nobody has changed it: chmod go-w '{place}'. Otherwise get it again.",
            )


def read_list(path: Path, what: str) -> str:
    """Read a list on which the trust rests: text of at most 16 MB that other users cannot change."""
    refuse_writable_by_others(path, what)
    try:
        return read_bounded(path, _MOST_BYTES).decode()
    except UnicodeDecodeError as error:
        raise EvidenceError(
            f"{what[0].upper()}{what[1:]} is not text.",
            where=str(path),
            remedy="Expected is one key a line, in OpenSSH's format; a binary list (KRL) is not supported.",
        ) from error


def refuse_readable_by_others(path: Path) -> None:
    """Refuse a private key that other users can read, or own."""
    if not hasattr(os, "getuid"):
        return
    status = path.stat()
    if status.st_mode & _ANY_ACCESS_BY_OTHERS or status.st_uid != os.getuid():
        raise EvidenceError(
            f"Other users can read the key (mode {stat.S_IMODE(status.st_mode):04o}): its signatures prove nothing.",
            where=str(path),
            remedy=f"If nobody has read it: chmod 600 '{path}'. Otherwise make a new key.",
        )
