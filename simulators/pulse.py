"""Publish how much time the simulated bench could use, so that another program can tell a busy computer from a fault.

A thread asks to be woken 50 times a second. Each time, it adds the time since the last time to a sum, but no more than
twice the time it asked for. The sum stands in the first 8 bytes of a small file, as a little-endian double, in seconds:
it runs as fast as a clock on an idle computer, and more slowly where the process waits for a processor.
"""

from __future__ import annotations

import mmap
import struct
import threading
import time
from contextlib import suppress
from pathlib import Path

PERIOD_S = 0.02
"""The thread asks to be woken after this time, s."""


class Pulse:
    """The time that this process could use, in a file."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(8))
        with path.open("r+b") as file:
            self._shared = mmap.mmap(file.fileno(), 8)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="pulse", daemon=True)
        self._thread.start()

    def _beat(self) -> None:
        lived_s, last_s = 0.0, time.monotonic()
        while not self._ended.wait(PERIOD_S):
            now_s = time.monotonic()
            lived_s += min(now_s - last_s, 2.0 * PERIOD_S)
            last_s = now_s
            struct.pack_into("<d", self._shared, 0, lived_s)

    def close(self) -> None:
        """End the thread; the file remains."""
        self._ended.set()
        self._thread.join()
        with suppress(BufferError):
            self._shared.close()
