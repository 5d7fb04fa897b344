"""Follows a journal that grows, line by line.

A complete line that is not valid ends the reading: what stands before it is kept. If a file becomes shorter, or another
file takes its name, it is read again from its beginning.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from bench.base.errors import BenchError
from bench.base.pasteable import pasteable
from bench.extras.pages.panel.shown_run import Uncertainties
from bench.record.coverage import coverage_factor
from bench.record.journal import read_journal
from bench.record.journal_line import FIRST_PREV, Entry, decode_line
from bench.record.storage import storage_errors
from bench.record.stored_run import StoredRun

MOST_BYTES = 1 << 21
"""Most bytes that one call reads, so that a long journal does not stop the others."""


class JournalTail:
    """The end of a journal that another process writes; calls ``begin_again`` before it reads from the first line."""

    def __init__(self, path: Path, begin_again: Callable[[], None]) -> None:
        self.path = path
        self.fault = ""
        """Why the journal cannot be read further; empty while it can."""
        self.size = 0
        """Size of the file at the last look, bytes."""
        self.incomplete = False
        """Whether the file ends within a line."""
        self._begin_again = begin_again
        self._file = (-1, -1)
        self._seen: tuple[int, int] = (-1, -1)
        self._offset = 0
        self._lines = 0
        self._prev = FIRST_PREV

    @property
    def read_share(self) -> float:
        """How much of the file is read, 0 to 1."""
        return 1.0 if self.size <= 0 else min(1.0, self._offset / self.size)

    @property
    def more(self) -> bool:
        """Whether the next call may have lines at once."""
        return not self.fault and not self.incomplete and self._offset < self.size

    def has_changed(self) -> bool:
        """Return whether the file is another one than at the last reading, or there is more to read."""
        try:
            status = self.path.stat()
        except OSError:
            return not self.fault
        return (status.st_size, status.st_mtime_ns) != self._seen or self.more

    def read(self) -> list[Entry]:
        """Read further complete, valid lines, at most ``MOST_BYTES``; ``fault`` states why there is none."""
        try:
            with storage_errors(self.path):
                return self._read()
        except BenchError as error:
            self.fault = str(error)
            self._seen = (-1, -1)
            return []

    def _read(self) -> list[Entry]:
        with self.path.open("rb") as stream:
            status = os.fstat(stream.fileno())
            file = status.st_dev, status.st_ino
            if file != self._file or status.st_size < self._offset:
                self._restart(file)
            self.size, self._seen = status.st_size, (status.st_size, status.st_mtime_ns)
            self.fault = ""
            stream.seek(self._offset)
            data = stream.read(MOST_BYTES)
            if data and b"\n" not in data:  # one line that is longer than a part
                data += stream.readline()
        entries: list[Entry] = []
        for line in data.splitlines(keepends=True):
            if not line.endswith(b"\n"):
                break
            try:
                entry = decode_line(line[:-1], self._lines, self._prev)
            except ValueError as error:
                self.fault = self._why_not(error)
                break
            entries.append(entry)
            self._offset += len(line)
            self._lines, self._prev = self._lines + 1, entry.hash
        self.incomplete = not self.fault and not entries and self._offset < self.size
        return entries

    def _restart(self, file: tuple[int, int]) -> None:
        self._file, self._offset, self._lines, self._prev = file, 0, 0, FIRST_PREV
        self._begin_again()

    def _why_not(self, error: ValueError) -> str:
        """Return why a complete line is not valid; empty if a power cut explains it, which a resume repairs."""
        try:
            read_journal(self.path)
        except BenchError as broken:
            return str(broken)
        return (
            f"{self.path}:{self._lines + 1}: A power cut has damaged the end of the journal ({error})."
            f" What stands before is complete. `{pasteable('resume', self.path.parent)}` removes the damaged end."
        )


def read_final(folder: Path) -> Uncertainties:
    """Read the final uncertainties, as stated; empty where the results cannot be read."""
    try:
        results = StoredRun(folder).results_as_written
        calibration = results["calibration"]
        k = coverage_factor(calibration, "fx")
        uncertainties: Uncertainties = {
            "coverage_factor": k,
            "expanded_fx_px": k * float(calibration["sigma"]["fx"]),
        }
        projection = results.get("projection")
        corner = projection["worst_corner"]["expanded_px"] if projection else None
        return uncertainties if corner is None else {**uncertainties, "worst_corner_px": float(corner)}
    except (BenchError, ValueError, KeyError, TypeError, AttributeError):
        return {}
