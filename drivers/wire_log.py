"""Record every byte to and from a device as JSON lines, in files of bounded size. Touches no device."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Literal, Protocol, TextIO

Direction = Literal[">", "<"]
"""">" to the device, "<" from it."""


class WireLog(Protocol):
    """Record of the bytes that a link sends and receives."""

    def record(self, t_s: float, port: str, direction: Direction, data: bytes) -> None:
        """Record bytes to or from a device at a time on the bench's monotonic clock.

        This never raises, because a full disk must not keep a stop from being sent.
        """
        ...


class WireLogFile:
    """A wire log on disk, one JSON object a line: ``{"t": s, "port": name, "dir": ">", "bytes": text}``.

    Bytes are written as Latin-1 text, so every byte is one character and text stays readable. A file that would exceed
    ``max_bytes`` is renamed to ``<name>.1`` (older ones to ``.2`` ...) and a new one is begun. The folder must exist;
    an existing file is continued. ``fault`` says why logging ended; None while it works. A log that cannot be written
    does not stop a device from being controlled; the bench reports this text instead.
    """

    def __init__(self, path: Path, *, max_bytes: int = 8_000_000, kept: int = 3) -> None:
        self.path = path
        self.fault: str | None = None
        self._max_bytes = max_bytes
        self._kept = kept
        self._lock = threading.Lock()
        self._file: TextIO | None = None
        self._size = 0

    def record(self, t_s: float, port: str, direction: Direction, data: bytes) -> None:
        """See `WireLog.record`. Appends one line."""
        entry = {"t": round(t_s, 6), "port": port, "dir": direction, "bytes": data.decode("latin-1")}
        line = json.dumps(entry) + "\n"
        with self._lock:
            if self.fault is not None:
                return
            try:
                self._append(line)
            except OSError as error:
                self.fault = f"the wire log {self.path} ended: {error.strerror or error}"

    def close(self) -> None:
        """Close the file; a later record opens it again."""
        with self._lock:
            self._close()

    def _append(self, line: str) -> None:
        if self._file is None:
            self._open()
        if self._size and self._size + len(line) > self._max_bytes:
            self._rotate()
        assert self._file is not None
        self._file.write(line)
        self._file.flush()
        self._size += len(line)

    def _open(self) -> None:
        self._file = self.path.open("a", encoding="ascii")
        self._size = self._file.tell()

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
