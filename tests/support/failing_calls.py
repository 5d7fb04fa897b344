"""One call to the file system fails, the n-th below some folders, as a disk that is full or broken lets it fail.

As SQLite is tested: the same work is repeated, and each time the next of its calls is the one that fails, until all
calls pass. Patched are the functions of ``os`` and ``io`` that this program and pathlib call; Python's own buffered files
count by their opening.
"""

import errno
import io
import os
import re
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from unittest import mock

PATHS = ("open", "truncate", "rename", "replace", "link", "unlink", "mkdir", "chmod")
DESCRIPTORS = ("write", "fsync", "ftruncate")
ERRORS = (errno.ENOSPC, errno.EIO)


class FailingCalls:
    """Counts the calls below a folder within its block; the one after ``passing`` fails, none if that is negative."""

    def __init__(self, folder: Path, passing: int = -1, number: int = errno.EIO):
        self.folder, self.passing, self.number = str(folder), passing, number
        self.calls, self.failed = 0, ""
        self._stack = ExitStack()

    def __enter__(self):
        for name in PATHS:
            self._patch(os, name, lambda args: str(args[0]) if not isinstance(args[0], int) else "")
        for name in DESCRIPTORS:
            self._patch(os, name, lambda args: opened_at(args[0]))
        self._stack.enter_context(mock.patch.object(io, "open", self._open(io.open)))
        self._stack.enter_context(mock.patch.object(io, "FileIO", self._raw_file()))
        return self

    def __exit__(self, *_):
        self._stack.close()

    def _patch(self, owner, name, place_of):
        real = getattr(owner, name)

        def call(*args, **more):
            place = place_of(args)
            if self._fails(place, f"{name} {place}"):
                if name == "write":  # a part reaches the disk
                    real(args[0], bytes(args[1])[: len(args[1]) // 2])
                raise self._error(args[0] if name in PATHS else None)
            return real(*args, **more)

        self._stack.enter_context(mock.patch.object(owner, name, call))

    def _open(self, real):
        def call(file, mode="r", *args, **more):
            if (
                not isinstance(file, int)
                and set(mode) & set("wax+")
                and self._fails(str(file), f"open {file}")
            ):
                raise self._error(file)
            return real(file, mode, *args, **more)

        return call

    def _raw_file(self):
        calls = self

        class RawFile(io.FileIO):
            def write(self, data):
                if calls._fails(str(self.name), f"write {self.name}"):
                    super().write(bytes(data)[: len(data) // 2])
                    raise calls._error(None)
                return super().write(data)

        return RawFile

    def _fails(self, place, what):
        if not place.startswith(self.folder):
            return False
        self.calls += 1
        if self.calls != self.passing + 1:
            return False
        self.failed = what
        return True

    def _error(self, file):
        return OSError(self.number, os.strerror(self.number), *([str(file)] if file is not None else []))


def opened_at(descriptor):
    """The path that a descriptor was opened at; empty if it is none of a file."""
    try:
        return str(Path(f"/proc/self/fd/{descriptor}").readlink())
    except OSError:
        return ""


def each_call(work, *, first=0, step=1):
    """Do ``work(passing, number)``, which returns the calls, with each call in turn failing, by each error; yield both.

    ``work`` returns a `FailingCalls`; the loop ends when none failed.
    """
    for number in ERRORS:
        passing = first
        while (calls := work(passing, number)).failed:
            yield calls
            passing += step


def kind_of(failed, folder):
    """The kind of a failed call: what was called, and the file's name without its numbers."""
    name, _, place = failed.partition(" ")
    inside = Path(place).relative_to(folder).parts[-2:] if place != str(folder) else (".",)
    return f"{name} {re.sub('[0-9a-f]{6,}|[0-9]+', 'N', '/'.join(inside))}"


class Tally:
    """How many calls failed of each kind, and what then fell."""

    def __init__(self):
        self.tried, self.fallen = Counter(), []

    def add(self, calls):
        """Count a call that failed."""
        self.tried[kind_of(calls.failed, calls.folder)] += 1

    def __len__(self):
        return self.tried.total()

    def show(self, what):
        """Print a line for each kind, most frequent first, and each that fell."""
        print(f"\n{what}: {len(self)} failed calls, {len(self.fallen)} of them not overcome")
        for kind, count in self.tried.most_common():
            print(f"{count:6d}  {kind}")
        for fell in self.fallen:
            print(f"  not overcome: {fell}")
