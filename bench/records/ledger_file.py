"""The file of the ledger: its lines, its lock, and the marks of its state elsewhere. It gives lines no meaning.

`bench.records.ledger` has the runs in it, and its breaks.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError, EvidenceError
from bench.records.journal import Journal, read_journal
from bench.records.journal_entry import Entry
from bench.records.ledger_breaks import EXPLAIN, find_breaks, highest_counts, highest_run
from bench.records.ledger_marks import (
    LedgerMark,
    OwnMark,
    Witness,
    append_to_anchor,
    ask_anchor,
    read_own_mark,
    write_own_mark,
)
from bench.records.storage import make_folder, open_to_lock, storage_errors
from drivers import file_lock

LEDGER = "ledger.jsonl"


class LedgerFile:
    """The file of a ledger. Every method reads it anew, because other processes write to it too.

    home: The configuration folder, from `bench.base.home.home_folder`.
    utc_now, monotonic: As for `bench.records.journal.Journal`.
    warnings: Second places that could not be read or written by the last call; nothing was stopped by them.
    """

    def __init__(
        self, home: Path, *, utc_now: Callable[[], datetime], monotonic: Callable[[], float]
    ) -> None:
        self.home = home
        self.path = home / LEDGER
        self.warnings: list[str] = []
        self._clocks: dict[str, Any] = {"utc_now": utc_now, "monotonic": monotonic}

    def entries(self) -> list[Entry]:
        """Read and verify every line, of any event: runs, certificates and whatever else was entered.

        Returns: First to last; empty while there is no ledger.
        Raises JournalBroken: When the ledger is not valid.
        Raises StorageError: When it cannot be read.
        """
        return read_journal(self.path)[0] if self.path.exists() else []

    def append(self, event: str, **facts: Any) -> Entry:
        """Enter one line of any event. Use ``locked`` where the line depends on the lines before.

        event: Name of the event, in the past tense, such as ``certificate_issued``.
        facts: Data of the event, as for `bench.records.journal.Journal.append`.
        Returns: The line; its ``hash`` is the new head.
        Raises EvidenceError, JournalBroken, StorageError: As ``locked``.
        """
        with self.locked() as journal:
            return journal.append(event, **facts)

    @contextmanager
    def locked(self) -> Iterator[Journal]:
        """Lock the ledger against other processes, verify it, and open it for writing.

        In the block, ``journal.entries`` holds every line so far, and ``journal.append(event, **facts)`` enters a line.
        So a number that follows from the lines before is given once only. The lock waits; keep the block short. The new
        head goes to the second places afterwards (see ``warnings``).

        Raises EvidenceError: When lines of the ledger are missing or were replaced, or the file is gone.
        Raises JournalBroken: When a line is not valid.
        Raises StorageError: When it cannot be read or written.
        """
        self.warnings = []
        with self._held():
            refuse(list(find_breaks(self.entries(), self._own_mark()).what), self.path)
            with self._opened() as journal:
                yield journal
        self._write_anchors()

    # ------------------------------------------------------------ lock and marks

    @contextmanager
    def _held(self) -> Iterator[None]:
        """Lock the ledger against other processes."""
        make_folder(self.home)
        with storage_errors(self.path):
            lock = open_to_lock(self.home)
        try:
            file_lock.lock(lock, wait=True)
            yield
        finally:
            os.close(lock)

    @contextmanager
    def _opened(self) -> Iterator[Journal]:
        """Open the ledger for writing; the bench's own mark follows each new head."""
        opener = Journal.open if self.path.exists() else Journal.create
        with opener(self.path, **self._clocks) as journal:
            before = journal.head
            try:
                yield journal
            finally:
                if journal.head != before:
                    self._write_own_mark(journal.entries)

    def _own_mark(self) -> OwnMark | str | None:
        try:
            return read_own_mark(self.home)
        except BenchError as error:
            return str(error)

    def _write_own_mark(self, entries: Sequence[Entry]) -> None:
        own = self._own_mark()
        counts = tuple(sorted(highest_counts(entries).items()))
        mark = LedgerMark(len(entries), highest_run(entries), entries[-1].hash, entries[-1].utc, counts)
        new = replace(own, mark=mark) if isinstance(own, OwnMark) else OwnMark(mark)
        try:
            write_own_mark(self.home, new)
        except BenchError as error:
            self.warnings.append(f"The bench's own mark of the ledger cannot be written: {error}")

    def _ask_anchors(self, anchor: str | None) -> list[Witness]:
        """Ask all second places: those that were used before, and the one that a station names."""
        own = self._own_mark()
        used = own.anchors if isinstance(own, OwnMark) else ()
        places = dict.fromkeys([*used, *([anchor] if anchor else [])])
        return [ask_anchor(Path(place), was_there=place in used) for place in places]

    def _write_anchors(self, anchor: str | None = None) -> None:
        """Write the newest head to all second places; what fails becomes a warning."""
        own = self._own_mark()
        if not isinstance(own, OwnMark):
            return
        for place in dict.fromkeys([*own.anchors, *([anchor] if anchor else [])]):
            try:
                append_to_anchor(Path(place), own.mark)
            except BenchError as error:
                self.warnings.append(f"The second place of the ledger cannot be written: {error}")
        if anchor and anchor not in own.anchors:
            self._change_anchors(lambda known: (*known, anchor))

    def _change_anchors(self, change: Callable[[tuple[str, ...]], tuple[str, ...]]) -> None:
        """Change the list of second places that the bench's own mark holds; what fails becomes a warning."""
        with self._held():
            own = self._own_mark()
            if not isinstance(own, OwnMark):
                return
            try:
                write_own_mark(self.home, replace(own, anchors=tuple(dict.fromkeys(change(own.anchors)))))
            except BenchError as error:
                self.warnings.append(f"The bench's own mark of the ledger cannot be written: {error}")


def refuse(faults: Sequence[str], path: Path) -> None:
    """Refuse a ledger with faults.

    faults: The faults, as sentences; nothing is refused if there are none.
    Raises EvidenceError: When there is a fault.
    """
    if faults:
        raise EvidenceError(f"The ledger is broken: {' '.join(faults)}", where=str(path), remedy=EXPLAIN)
