"""What other places know of the ledger: the bench's own mark, and the second places that stations name.

A ledger is a chain, so its lines cannot be changed unseen. Lines cut off its end, or a deleted file, leave a valid
chain. Two other places show them. ``ledger_high`` lies beside the ledger and holds its highest state. A second place
(``ledger: {anchor: PATH}`` in a station file) is a file on another disk or share; a line is added to it with every
change of the ledger. This module reads and writes both, and trusts neither.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from bench.base.bounded_json import parse_json
from bench.base.errors import BenchError, StorageError
from bench.records.journal import Entry
from bench.records.storage import O_BINARY, read_bounded, storage_errors, sync_folder, write_all, write_atomic

MARK = "ledger_high"
ANCHOR_PATIENCE_S = 10.0
"""Longest wait for a second place, s; a share that does not answer must not stop a run."""
_MOST_ANCHOR_BYTES = 64 << 20
_MOST_MARK_BYTES = 1 << 20
_MARK_FORM = "is not a mark of a ledger"

Found = TypeVar("Found")


@dataclass(frozen=True)
class LedgerMark:
    """The state of a ledger after one of its lines."""

    lines: int
    runs: int  # Highest number of a run
    head: str  # Hash of the last line
    utc: str  # Time of the last line, ISO 8601
    counts: tuple[tuple[str, int], ...] = ()

    def to_line(self) -> bytes:
        """Return the mark as one line of JSON."""
        return (json.dumps(self.to_dict(), separators=(",", ":")) + "\n").encode()

    def to_dict(self) -> dict[str, Any]:
        """Return the mark as JSON carries it: all attributes; ``counts`` as a mapping, left out if it is empty."""
        facts = {"lines": self.lines, "runs": self.runs, "head": self.head, "utc": self.utc}
        return {**facts, "counts": dict(self.counts)} if self.counts else facts

    def disagreement(self, entries: Sequence[Entry]) -> str:
        """Return how a ledger contradicts this mark.

        Returns: The end of a sentence that begins with "The ledger"; empty if the ledger contains the marked
          line.
        """
        if len(entries) < self.lines:
            return (
                f"has {len(entries)} of at least {self.lines} lines: {self.lines - len(entries)} are missing"
            )
        if entries[self.lines - 1].hash != self.head:
            return f"has another line {self.lines} than it had on {self.utc[:16]}: lines were removed or replaced"
        return ""


def parse_mark(line: bytes) -> LedgerMark:
    """Read one mark, a line of `LedgerMark.to_line`."""
    found = parse_json(line)
    if not isinstance(found, dict):
        raise ValueError(_MARK_FORM)  # noqa: TRY004 - a fault of the file, not of an argument
    return _mark_of(found)


def _mark_of(found: Mapping[str, Any]) -> LedgerMark:
    lines, runs, head, utc = (found.get(name) for name in ("lines", "runs", "head", "utc"))
    numbers = [n for n in (lines, runs) if isinstance(n, int) and not isinstance(n, bool) and n >= 0]
    if len(numbers) != 2 or not lines or not (isinstance(head, str) and isinstance(utc, str)):
        raise ValueError(_MARK_FORM)
    counts = found.get("counts", {})
    if not (isinstance(counts, dict) and all(isinstance(count, int) for count in counts.values())):
        raise ValueError(_MARK_FORM)
    return LedgerMark(numbers[0], numbers[1], head, utc, tuple(sorted(counts.items())))


# ---------------------------------------------------------------- the bench's own mark


@dataclass(frozen=True)
class OwnMark:
    """Content of ``ledger_high``."""

    mark: LedgerMark
    anchors: tuple[str, ...] = ()


def read_own_mark(home: Path) -> OwnMark | None:
    """Read ``ledger_high``; None if there is no such file."""
    path = home / MARK
    with storage_errors(path):
        if not path.exists():
            return None
        data = read_bounded(path, _MOST_MARK_BYTES)
    try:
        mark, anchors = parse_mark(data), parse_json(data).get("anchors", ())
    except ValueError as error:
        raise StorageError(
            "This file does not hold the state of the ledger.",
            where=str(path),
            remedy="Somebody changed it. State what happened: `starbench ledger --explain TEXT`.",
        ) from error
    named = anchors if isinstance(anchors, list) else ()
    return OwnMark(mark, tuple(place for place in named if isinstance(place, str)))


def write_own_mark(home: Path, own: OwnMark) -> None:
    """Write ``ledger_high``."""
    record = {**own.mark.to_dict(), "anchors": list(own.anchors)}
    write_atomic(home / MARK, (json.dumps(record, separators=(",", ":")) + "\n").encode())


# ---------------------------------------------------------------- second places


def read_anchor(path: Path) -> list[LedgerMark]:
    """Read the marks of a second place, first to last, without an incomplete last line."""

    def read() -> bytes:
        with storage_errors(path), path.open("rb") as stream:
            return stream.read(_MOST_ANCHOR_BYTES)

    marks = []
    for number, line in enumerate(_in_time(read, path).split(b"\n")[:-1], start=1):
        try:
            marks.append(parse_mark(line))
        except ValueError as error:
            raise StorageError(
                "This line is not a mark of a ledger.",
                where=f"{path}:{number}",
                remedy="Another program wrote it. Give each bench a file of its own: `ledger: {anchor: PATH}`.",
            ) from error
    return marks


def append_to_anchor(path: Path, mark: LedgerMark) -> None:
    """Add a mark to a second place and sync it. The file is made if it is missing; its folder is not."""

    def append() -> None:
        with storage_errors(path):
            is_new = not path.exists()
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | O_BINARY, 0o644)
            try:
                drop_torn_line(descriptor)
                write_all(descriptor, mark.to_line())
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
            if is_new:
                sync_folder(path.parent)

    _in_time(append, path)


def drop_torn_line(descriptor: int) -> None:
    """Remove what a power cut has left of a line at the end of a second place."""
    size = os.fstat(descriptor).st_size
    back = min(size, 4096)
    os.lseek(descriptor, size - back, os.SEEK_SET)
    tail = os.read(descriptor, back)
    if tail and not tail.endswith(b"\n"):
        os.ftruncate(descriptor, size - back + tail.rfind(b"\n") + 1)


def _in_time(work: Callable[[], Found], path: Path) -> Found:
    """Do work on a second place in a thread; raise StorageError if it does not end in time."""
    done: list[Found] = []
    failed: list[BaseException] = []

    def thread() -> None:
        try:
            done.append(work())
        except BaseException as error:  # noqa: BLE001 - raised again below, in the caller's thread
            failed.append(error)

    worker = threading.Thread(target=thread, name="ledger anchor", daemon=True)
    worker.start()
    worker.join(ANCHOR_PATIENCE_S)
    if failed:
        raise failed[0]
    if not done:
        raise StorageError(
            f"The second place of the ledger does not answer within {ANCHOR_PATIENCE_S:.0f} s.",
            where=str(path),
            remedy="Check the disk or share.",
        )
    return done[0]


@dataclass(frozen=True)
class Witness:
    """What one place knows of the ledger, or why it cannot be asked."""

    place: str
    marks: Sequence[LedgerMark] = ()  # Its marks, first to last
    trouble: str = ""  # Why it cannot be read; empty if it can
    was_there: bool = True  # Whether this bench has written to it before

    def objections(self, entries: Sequence[Entry], excused: Iterable[str]) -> list[LedgerMark]:
        """Return the marks that a ledger contradicts, first to last, from the last one that a break names."""
        known = set(excused)
        begin = max((i + 1 for i, mark in enumerate(self.marks) if mark.head in known), default=0)
        return [mark for mark in self.marks[begin:] if mark.disagreement(entries)]


def ask_anchor(path: Path, *, was_there: bool) -> Witness:
    """Read a second place; what goes wrong, as its loss if it ``was_there``, becomes its ``trouble``."""
    if not was_there:
        with suppress(OSError):
            if path.parent.is_dir() and not path.exists():
                return Witness(str(path), was_there=False)
    try:
        return Witness(str(path), read_anchor(path), was_there=was_there)
    except BenchError as error:
        return Witness(str(path), trouble=error.what, was_there=was_there)
