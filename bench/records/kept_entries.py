"""Entries kept from earlier calculations: a file each, named by the hash of all that decides its content.

Entries are no evidence, and their folder may be deleted at any time. It belongs to one user, and has a largest size. An
entry that cannot be read or written is told, and never an error.
"""

from __future__ import annotations

import os
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

_BUCKETS = 256
_STALE_S = 3600.0


@dataclass
class KeptEntries:
    """A folder of entries; several processes may use it at once."""

    folder: Path  # The folder; it is made at the first entry, readable for its owner only
    # Size of all entries together. The entries that were used least recently are deleted first.
    most_bytes: int
    # Sentences for the user: which entries were broken, and why none can be kept.
    remarks: list[str] = field(default_factory=list)
    _usable: bool | None = field(default=None, init=False, repr=False)

    # ending, thing, otherwise: Ending of the files; what an entry is called, and what is done without it, in
    # messages.
    ending: ClassVar[str] = ".entry"
    thing: ClassVar[str] = "entry"
    otherwise: ClassVar[str] = "it is calculated"

    def read_entry(self, key: str) -> bytes | None:
        """Return the content of an entry.

        key: 64 hexadecimal digits.
        Returns: As it was written, if nobody changed it; None if there is no entry, or it cannot be read.
        """
        path = self._path(key)
        try:
            if path.stat().st_size > self.most_bytes // _BUCKETS:
                self.drop_entry(key, "it is larger than any entry")
                return None
            data = path.read_bytes()
            with suppress(OSError):
                os.utime(path)
        except FileNotFoundError:
            return None
        except OSError as error:
            self.remarks.append(
                f"{path}: a kept {self.thing} cannot be read ({error.strerror}); {self.otherwise} again."
            )
            return None
        return data

    def drop_entry(self, key: str, why: str) -> None:
        """Delete an entry that is broken, and tell it."""
        path = self._path(key)
        self.remarks.append(f"{path}: a kept {self.thing} is broken ({why}); {self.otherwise} again.")
        with suppress(OSError):
            path.unlink()

    def write_entry(self, key: str, data: bytes) -> None:
        """Keep an entry. If this is not possible, say so and go on.

        key: 64 hexadecimal digits.
        """
        if not self.is_usable():
            return
        path = self._path(key)
        if len(data) > self.most_bytes // _BUCKETS:
            return
        try:
            path.parent.mkdir(mode=0o700, exist_ok=True)
            self._make_room(path.parent, len(data))
            descriptor, part = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".tmp")
            try:
                with os.fdopen(descriptor, "wb") as stream:
                    stream.write(data)
                Path(part).replace(path)
            except OSError:
                with suppress(OSError):
                    Path(part).unlink()
                raise
        except OSError as error:
            self._refuse(f"{error.strerror or error}")

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}{self.ending}"

    def _make_room(self, bucket: Path, size: int) -> None:
        """Delete the entries of a bucket that were used least recently, and parts that dead processes left.

        Keys are hashes, so entries are spread evenly over the buckets, and each has the same share of the size.
        """
        entries = []
        for entry in os.scandir(bucket):
            with suppress(FileNotFoundError):
                status = entry.stat(follow_symlinks=False)
                if entry.name.startswith("."):
                    if time.time() - status.st_mtime > _STALE_S:
                        Path(entry.path).unlink(missing_ok=True)
                    continue
                entries.append((status.st_mtime_ns, status.st_size, entry.path))
        total = size + sum(one[1] for one in entries)
        for _, had, name in sorted(entries):
            if total <= self.most_bytes // _BUCKETS:
                break
            Path(name).unlink(missing_ok=True)
            total -= had

    def is_usable(self) -> bool:
        """Return whether entries can be kept.

        Returns: Whether the folder is there, belongs to this user, and nobody else may write to it.
        """
        if self._usable is None:
            self._usable = True
            try:
                self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
                status = self.folder.stat()
                if hasattr(os, "getuid"):
                    if status.st_uid != os.getuid():
                        self._refuse("the folder belongs to another user")
                    elif status.st_mode & 0o077:
                        self._refuse(
                            f"other users may use the folder; change its mode: chmod 700 {self.folder}"
                        )
            except OSError as error:
                self._refuse(f"{error.strerror or error}")
        return self._usable

    def _refuse(self, why: str) -> None:
        if self._usable is not False:
            self.remarks.append(
                f"{self.folder}: {self.thing}s cannot be kept ({why}); {self.otherwise} each time."
            )
        self._usable = False
