"""When the work of a process last used its clock, in memory that another process can read. Uses no device and no disk.

The work itself writes the moment, so that it is right whatever the other threads of the process do: a driver that keeps
the interpreter's lock stops them all. The memory is a file that exists in memory only (memfd_create(2)); another
process of the same user reads it as ``/proc/PID/fd/NUMBER``. Where the system has no such files, nothing is shared.
"""

from __future__ import annotations

import mmap
import os
import struct
import weakref
from contextlib import suppress
from pathlib import Path

from bench.base.linux_process import PROC

NOT_SHARED = -1
"""Number of the file where the system has no such files."""
_NAME = "starbench-work"
_FORM = "dd"
"""Moment of the last use, s by the monotonic clock; 1 while devices may move, shine or record, otherwise 0."""
_SIZE = struct.calcsize(_FORM)


class WorkMoment:
    """The moment at which the work last used its clock, for other processes.

    number: Number of the file, by which another process finds it; ``NOT_SHARED`` if there is none.
    """

    def __init__(self) -> None:
        self.number, self._values = NOT_SHARED, memoryview(bytearray(_SIZE)).cast("d")
        with suppress(AttributeError, OSError):
            self.number = os.memfd_create(_NAME)
            weakref.finalize(self, os.close, self.number)
            os.ftruncate(self.number, _SIZE)
            self._values = memoryview(mmap.mmap(self.number, _SIZE)).cast("d")

    def used(self, moment_s: float) -> None:
        """Note that the work uses its clock.

        moment_s: The present time by the monotonic clock, s.
        """
        self._values[0] = moment_s

    def entering(self, *, with_devices: bool) -> None:
        """Note the kind of the work that begins.

        with_devices: Whether devices may move, shine or record. Such work uses its clock many times a second.
        """
        self._values[1] = float(with_devices)


def read_work_moment(pid: int, number: int, proc: Path = PROC) -> float | None:
    """Read when the work of another process last used its clock.

    number: `WorkMoment.number` of that process.
    Returns: Moment by the monotonic clock, s. None while no device may move, shine or record, and where
      nothing can be read.
    """
    path = proc / str(pid) / "fd" / str(number)
    try:
        # The number of a process is used again: only our own kind of file is opened, never a pipe or a port.
        if number == NOT_SHARED or not str(path.readlink()).startswith(f"/memfd:{_NAME}"):
            return None
        moment_s, with_devices = struct.unpack(_FORM, path.read_bytes()[:_SIZE])
    except (OSError, struct.error):
        return None
    return float(moment_s) if with_devices else None
