"""Follow the status of a run in another process: new states and lines as they come."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from bench.records.folder_lock import is_locked
from bench.records.journal_entry import Entry
from bench.records.run_folder import JOURNAL
from bench.records.storage import storage_errors
from bench.run.journal_text import line_text
from bench.run.status import Status, read_with_entries

FOLLOW_S = 0.5
_READING_SHARE = 4.0
"""A follower waits at least this many times as long as it read the journal, so that it takes little of a computer."""


def follow(
    folder: Path,
    sleep: Callable[[float], None] = time.sleep,
    *,
    ticks: bool = False,
    monotonic: Callable[[], float] = time.monotonic,
) -> Iterator[Status]:
    """Read the status of a run after every change, as long as a process works on the run.

    sleep: Waits between two reads of the journal.
    ticks: Whether to yield also when nothing has changed, with the remaining time counted down.
    monotonic: Returns the time since an arbitrary moment, s.
    Yields: One per change; the last one shows how the run ended.
    """
    for status, _ in _followed(folder, sleep, ticks=ticks, monotonic=monotonic):
        yield status


def follow_lines(
    folder: Path,
    sleep: Callable[[float], None] = time.sleep,
    monotonic: Callable[[], float] = time.monotonic,
) -> Iterator[tuple[Status, Sequence[str]]]:
    """Read the status of a run as `follow` does, with the journal lines that are new, as text.

    sleep, monotonic: As for `follow`.
    Yields: The status, and the new lines, the newest last. The first time these are the last lines of the
      status.
    """
    seen = None
    for status, entries in _followed(folder, sleep, ticks=False, monotonic=monotonic):
        if seen is None:
            yield status, status.last
        else:
            yield status, [text for text in map(line_text, entries[seen:]) if text]
        seen = len(entries)


def _followed(
    folder: Path, sleep: Callable[[float], None], *, ticks: bool, monotonic: Callable[[], float]
) -> Iterator[tuple[Status, Sequence[Entry]]]:
    """Yield the status and all journal lines after every change; with ``ticks`` also without a change."""
    seen, pause_s = -1, FOLLOW_S
    while True:
        with storage_errors(folder):
            size = (folder / JOURNAL).stat().st_size
        if size != seen or not is_locked(folder):
            began_s = monotonic()
            (status, entries), seen = read_with_entries(folder, datetime.now(UTC)), size
            read_s = monotonic()
            pause_s = max(FOLLOW_S, _READING_SHARE * (read_s - began_s))
            yield status, entries
            if not status.running:
                return
        elif ticks:
            yield _counted_down(status, monotonic() - read_s), entries
        sleep(pause_s)


def _counted_down(status: Status, since_s: float) -> Status:
    """Return a status with the time counted down that has passed since it was read; a held run has no such time."""
    if status.left_s is None or status.held_by or status.question:
        return status
    return replace(status, left_s=max(0.0, status.left_s - since_s))
