"""Record every byte to and from a device as JSON lines, in files of bounded size. Touches no device."""

from __future__ import annotations

import io
import json
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

Direction = Literal[">", "<"]
"""">" to the device, "<" from it."""


_LONGEST_LINE_BYTES = 1 << 20
"""More than a line of the longest reply has; so much is looked at for the end of the last whole line."""


class WireLog(Protocol):
    """Record of the bytes that a link sends and receives."""

    def record(self, t_s: float, port: str, direction: Direction, data: bytes) -> None:
        """Record bytes to or from a device at a time on the bench's monotonic clock.

        This never raises, because a full disk must not keep a stop from being sent.
        """


@dataclass(frozen=True)
class WireLogFault:
    """Why a wire log ended."""

    since_s: float  # Time of the first bytes that it lacks, s, on the bench's monotonic clock
    why: str


class WireLogFile:
    """A wire log on disk, one JSON object a line: ``{"t": s, "port": name, "dir": ">", "bytes": text}``.

    Bytes are written as Latin-1 text, so every byte is one character and text stays readable. A file that would exceed
    ``max_bytes`` is renamed to ``<name>.1`` (older ones to ``.2`` ...) and a new one is begun. The folder must exist;
    an existing file is continued, without the part of a line that a power cut has left. ``fault`` says why logging
    ended; None while it works. A log that cannot be written does not stop a device from being controlled; after a fault
    its files stay as they are, so that the bench can state what they hold.
    """

    def __init__(self, path: Path, *, max_bytes: int = 8_000_000, kept: int = 3) -> None:
        self.path = path
        self.fault: WireLogFault | None = None
        self._max_bytes = max_bytes
        self._kept = kept
        self._lock = threading.Lock()
        self._file: io.FileIO | None = None
        self._size = 0
        self._last_s = 0.0

    def record(self, t_s: float, port: str, direction: Direction, data: bytes) -> None:
        """See `WireLog.record`. Appends one line."""
        entry = {"t": round(t_s, 6), "port": port, "dir": direction, "bytes": data.decode("latin-1")}
        line = (json.dumps(entry) + "\n").encode("ascii")
        with self._lock:
            if self.fault is not None:
                return
            self._last_s = t_s
            try:
                self._append(line)
            except OSError as error:
                self._end(error)

    def close(self) -> None:
        """Close the file; a later record opens it again. This never raises; a failure is a ``fault``."""
        with self._lock:
            try:
                self._close()
            except OSError as error:
                self._end(error)

    def _end(self, error: OSError) -> None:
        """Write nothing more, and leave whole lines, as far as the file still can be changed."""
        self.fault = WireLogFault(self._last_s, error.strerror or str(error))
        if self._file is not None:
            with suppress(OSError):  # the first error is the one to report
                self._file.truncate(self._size)
            with suppress(OSError):
                self._close()

    def _append(self, line: bytes) -> None:
        if self._file is None:
            self._open()
        if self._size and self._size + len(line) > self._max_bytes:
            self._rotate()
        assert self._file is not None
        rest = memoryview(line)
        while rest:
            rest = rest[self._file.write(rest) :]
        self._size += len(line)

    def _open(self) -> None:
        self._file = io.FileIO(self.path, "a+")
        self._size = self._file.seek(0, io.SEEK_END)
        back = min(self._size, _LONGEST_LINE_BYTES)
        self._file.seek(self._size - back)
        torn = len(self._file.read().rpartition(b"\n")[2])
        if torn:
            self._size -= torn
            self._file.truncate(self._size)

    def _close(self) -> None:
        if self._file is not None:
            file, self._file = self._file, None
            file.close()

    def _rotate(self) -> None:
        self._close()
        for number in range(self._kept, 0, -1):
            older = self._numbered(number)
            newer = self._numbered(number - 1) if number > 1 else self.path
            if newer.exists():
                newer.replace(older)
        if not self._kept:
            self.path.unlink()
        self._open()

    def _numbered(self, number: int) -> Path:
        return self.path.with_name(f"{self.path.name}.{number}")
