"""A run's journal and its history together: each line that is written is applied at once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from bench.record.events import Event, event_name
from bench.record.history import History, P, apply_entry, replay
from bench.record.journal import Journal
from bench.record.journal_line import Entry

_WITHOUT_HARDWARE = frozenset({"settling", "checking"})
"""States in which nothing moves, is switched or is stored."""


class RunLog:
    """A run's journal and history; the history follows the journal line by line. Safe to use from several threads."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.history = replay(journal.entries)
        self._lock = threading.RLock()
        self._followers: list[Callable[[Entry, History], None]] = []

    def follow(self, follower: Callable[[Entry, History], None]) -> None:
        """Tell a follower each line of the journal with the history after it: those that are there, then all others."""
        with self._lock:
            for entry in self.journal.entries:
                follower(entry, self.history)
            self._followers.append(follower)

    @contextmanager
    def held(self) -> Iterator[History]:
        """Keep other threads from writing inside the block, to decide by the history and write the decision."""
        with self._lock:
            yield self.history

    def write(self, payload: Callable[P, object], *_: P.args, **data: P.kwargs) -> None:
        """Write one line and update the history; it survives a power cut unless a restart finds the same again.

        ``payload`` is the type of what the line holds, which names its event (`bench.record.events.event_name`).
        """
        event = Event(event_name(payload))
        with self._lock:
            entry = self.journal.put(event, data, synced=not _is_repeatable(event, data))
            apply_entry(self.history, entry)
            for follower in self._followers:
                follower(entry, self.history)


def _is_repeatable(event: Event, data: Mapping[str, Any]) -> bool:
    """Return whether a line may be lost with the power, because a restart does or finds the same again."""
    match event:
        case Event.LEFT_OFF:
            return "error" not in data
        case Event.ENTERING:
            return data["state"] in _WITHOUT_HARDWARE
        case Event.ATTEMPT_CHECKED | Event.STEP_DONE:
            return True
    return False
