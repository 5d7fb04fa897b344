"""The journal of a run: it is written line by line, and verified when it is read.

A fact is written when it has happened and is on the disk: what is not in the journal has not happened. An intention
(`entering` a state) is written before it is acted on.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Self

from bench.base.bounded_json import parse_json
from bench.base.clock import BenchClock
from bench.base.errors import JournalBroken, RunFolderError, StorageError
from bench.record.journal_line import FIRST_PREV, OWN_KEYS, Entry, decode_line, encode_line
from bench.record.storage import open_to_read, storage_errors
from drivers.durable import O_BINARY, sync_folder, write_all

CLOCK_JUMP_S = 2.0
"""The system time is said to have jumped if it moved by more than this against the monotonic clock, s: a time server
corrects it in smaller steps."""
CLOCK_JUMPED = "clock_jumped"
_BLOCK_BYTES = 512  # The smallest unit that disks write
MOST_LINE_BYTES = 32 * 1024 * 1024
"""Longest line that is read. The longest ones, with all residuals of a large run, have some megabytes."""
MOST_JOURNAL_BYTES = 1 << 29
"""Largest journal that is read: a run of fifty thousand poses has so much, or a ledger of half a million runs."""
_MOST_UNSYNCED_BYTES = 64 * 1024
"""A power cut leaves zeros only nearer to the end than this: lines are synced far more often."""
CAPTURES = "captures"
CAPTURE_STORED = "capture_stored"
"""Event of a journal line about a capture; the line holds ``Capture.as_data``."""


class Journal:
    """A journal that is open for appending, by several threads; ``torn`` is the incomplete last line it removed."""

    def __init__(self, path: Path, entries: list[Entry], torn: bytes, clock: BenchClock) -> None:
        self.path = path
        self.torn = torn
        """Bytes of an incomplete last line that ``open`` has removed; empty when there was none."""
        self._entries = entries
        self._clock = clock
        self._clock_offset_s: float | None = None
        self._lock = threading.RLock()
        with storage_errors(path):
            self._descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | O_BINARY)

    @classmethod
    def create(cls, path: Path, clock: BenchClock) -> Self:
        """Make a new journal, without lines. Raises RunFolderError when the file exists already."""
        with storage_errors(path):
            try:
                os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | O_BINARY, 0o644))
            except FileExistsError:
                raise RunFolderError(
                    "A journal exists already.", where=str(path), remedy="Resume that run."
                ) from None
            sync_folder(path.parent)
        return cls(path, [], b"", clock)

    @classmethod
    def open(cls, path: Path, clock: BenchClock) -> Self:
        """Open a journal to continue: verify it, remove an incomplete last line; `JournalBroken` changes nothing."""
        entries, torn = read_journal(path)
        if torn:
            with storage_errors(path):
                os.truncate(path, path.stat().st_size - len(torn))
        return cls(path, entries, torn, clock)

    @property
    def entries(self) -> Sequence[Entry]:
        """All lines so far, first to last."""
        return tuple(self._entries)

    @property
    def head(self) -> str:
        """Hash of the last line, which identifies the whole journal; 64 zeros when there is no line."""
        return self._entries[-1].hash if self._entries else FIRST_PREV

    def append(self, event: str, **data: Any) -> Entry:
        """Write one line and sync it. The line is on the disk when this returns.

        A ``clock_jumped`` line comes first if system and monotonic clocks parted by ``CLOCK_JUMP_S``. After a
        `StorageError` the line is not in the journal; after a failed sync no more are accepted, because the contents of
        the disk are unknown.
        """
        return self.put(event, data, synced=True)

    def close(self) -> None:
        """Close the file. Further lines are refused."""
        with self._lock:
            if self._descriptor >= 0:
                os.close(self._descriptor)
                self._descriptor = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _clock_jump_s(self, now: datetime, mono_s: float) -> float:
        """Return by how much the system time has moved against the monotonic clock since the last line, s."""
        offset_s = now.timestamp() - mono_s
        # First line of this process: only a step backwards can be recognised
        if self._clock_offset_s is None:
            last = datetime.fromisoformat(self._entries[-1].utc) if self._entries else now
            jump_s = min(0.0, (now - last).total_seconds())
        else:
            jump_s = offset_s - self._clock_offset_s
        self._clock_offset_s = offset_s
        return jump_s

    def put(self, event: str, data: Mapping[str, Any], *, synced: bool) -> Entry:
        """Write a line, as `append`; one that is not ``synced`` survives the process, but a power cut may remove it."""
        with self._lock:
            now, mono_s = self._clock.utc_now(), self._clock.monotonic()
            jump_s = self._clock_jump_s(now, mono_s)
            if abs(jump_s) > CLOCK_JUMP_S:
                self._append(now, mono_s, CLOCK_JUMPED, {"jump_s": round(jump_s, 3)}, synced=synced)
            return self._append(now, mono_s, event, data, synced=synced)

    def _append(
        self, now: datetime, mono_s: float, event: str, data: Mapping[str, Any], *, synced: bool
    ) -> Entry:
        if self._descriptor < 0:
            raise StorageError(
                "The journal is closed, or a write to it failed.",
                where=str(self.path),
                remedy="Check the disk. Then resume the run.",
            )
        line = encode_line(len(self._entries), now, mono_s, event, data, self.head)
        entry = decode_line(line, len(self._entries), self.head)
        try:
            self._write(line + b"\n", synced=synced)
            self._entries.append(entry)
        except StorageError:
            raise
        except BaseException:  # interrupted within a line: a further line could not be chained to it
            self.close()
            raise
        return entry

    def _write(self, data: bytes, *, synced: bool) -> None:
        with storage_errors(self.path):
            size = os.fstat(self._descriptor).st_size
            try:
                write_all(self._descriptor, data)
            except OSError:
                self._take_back(size)
                raise
            if synced:
                self._sync()

    def _take_back(self, size: int) -> None:
        """Remove what was written of a line. If that fails, the journal accepts no more lines after it."""
        try:
            os.ftruncate(self._descriptor, size)
        except OSError:
            self.close()

    def _sync(self) -> None:
        """Sync all lines so far. On an OSError, which is raised again, the journal accepts no more lines."""
        try:
            os.fsync(self._descriptor)
        except OSError:
            self.close()
            raise


def lines_after(path: Path, offset: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Read the complete lines after a position in a journal, bytes, without verification, and without half a line."""
    with open_to_read(path) as stream:
        stream.seek(offset)
        while line := stream.readline(MOST_LINE_BYTES):
            try:
                record = parse_json(line) if line.endswith(b"\n") else None
            except ValueError:  # the second part of a line
                continue
            if isinstance(record, dict):
                yield str(record.get("event")), {k: v for k, v in record.items() if k not in OWN_KEYS}


def read_journal(path: Path) -> tuple[list[Entry], bytes]:
    """Read and verify a journal without changing it; return also what a power cut has left at the end.

    That is a line without its line feed, or zeros in blocks that were allocated and not written; never a synced line.
    """
    entries: list[Entry] = []
    begin = 0
    with open_to_read(path) as stream:
        while line := stream.readline(MOST_LINE_BYTES):
            if len(line) >= MOST_LINE_BYTES:
                raise _broken(f"this line has more than {MOST_LINE_BYTES} bytes", path, entries)
            if not line.endswith(b"\n"):
                return entries, line
            prev = entries[-1].hash if entries else FIRST_PREV
            try:
                entries.append(decode_line(line[:-1], len(entries), prev))
            except (ValueError, RecursionError) as error:
                rest = line + stream.read(_MOST_UNSYNCED_BYTES)
                if _was_cut_off(rest, begin):
                    return entries, rest
                raise _broken(str(error), path, entries) from error
            begin += len(line)
            if begin > MOST_JOURNAL_BYTES:
                raise _broken(f"it has more than {MOST_JOURNAL_BYTES} bytes", path, entries)
    return entries, b""


def _broken(what: str, path: Path, entries: Sequence[Entry]) -> JournalBroken:
    """Return the error about the line after some."""
    return JournalBroken(
        f"The journal is not valid: {what}.",
        where=f"{path}:{len(entries) + 1}",
        remedy="The file was changed after it was written: restore it from a copy.",
    )


def _was_cut_off(rest: bytes, begin: int) -> bool:
    """Whether a journal ends, from an invalid line or a block on, with zeros of blocks that were never written."""
    first = rest.find(b"\0")
    if first < 0 or len(rest) >= _MOST_UNSYNCED_BYTES:
        return False
    last = len(rest) - len(rest[first:].lstrip(b"\0"))
    from_block = first == 0 or (begin + first) % _BLOCK_BYTES == 0
    return from_block and (last == len(rest) or (begin + last) % _BLOCK_BYTES == 0)


@dataclass(frozen=True)
class Capture:
    """A recording in the run folder."""

    name: str
    size: int  # Size, bytes
    sha256: str  # SHA-256, hexadecimal

    def as_data(self) -> dict[str, Any]:
        """Return what the journal's ``capture_stored`` holds of this recording: ``capture``, ``size``, ``sha256``."""
        return {"capture": self.name, "size": self.size, "sha256": self.sha256}


def capture_name(pose_index: int, attempt: int, ending: str = ".raw") -> str:
    """Return the name of a pose's recording within the run folder; pose and attempt count from 1.

    >>> capture_name(1, 2)
    'captures/pose-001-attempt-2.raw'
    """
    return f"{CAPTURES}/pose-{pose_index:03d}-attempt-{attempt}{ending}"


def stored_captures(entries: Iterable[Entry]) -> dict[str, Capture]:
    """Return the captures that a journal lists; the last entry of a name counts."""
    captures = {}
    for entry in entries:
        if entry.event == CAPTURE_STORED:
            capture = _capture_of(entry.data)
            captures[capture.name] = capture
    return captures


def _capture_of(data: Mapping[str, Any]) -> Capture:
    try:
        return Capture(str(data["capture"]), int(data["size"]), str(data["sha256"]))
    except (KeyError, TypeError, ValueError) as error:
        raise RunFolderError(
            "The journal lists a capture without its name, size or hash.",
            remedy="This journal was not written by this program; the run cannot be resumed.",
        ) from error
