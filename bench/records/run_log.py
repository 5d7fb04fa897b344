"""The journal of a run open for writing, together with the history that it amounts to.

The type of each event's payload is fixed in `bench.records.events`; a type checker refuses a line that lacks something.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal, Unpack, overload

from bench.records.device_events import DevicesFound, DevicesLeft
from bench.records.events import (
    Answered,
    Asked,
    AttemptChecked,
    AttemptLost,
    CaptureStored,
    Commanded,
    ComputerBusy,
    Deviation,
    Entering,
    Event,
    InterlockReleased,
    LeftOff,
    PoseSkipped,
    Recovered,
    RunEnded,
    RunResumed,
    RunStarted,
    Solved,
    StepDone,
    SupervisorLost,
    UntilDecided,
    Written,
)
from bench.records.history import History, apply_entry, replay
from bench.records.journal import Journal

_WITHOUT_HARDWARE = frozenset({"settling", "checking"})
"""States in which nothing moves, is switched or is stored."""


class RunLog:
    """A run's journal and history; the history follows the journal line by line. Safe to use from several threads."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.history = replay(journal.entries)
        self._lock = threading.RLock()

    @contextmanager
    def held(self) -> Iterator[History]:
        """Keep other threads from writing inside the block, to decide by the history and write the decision.

        Yields: The history, which does not change but by this thread.
        """
        with self._lock:
            yield self.history

    @overload
    def write(self, event: Literal[Event.RUN_STARTED], **data: Unpack[RunStarted]) -> None: ...
    @overload
    def write(self, event: Literal[Event.RUN_RESUMED], **data: Unpack[RunResumed]) -> None: ...
    @overload
    def write(self, event: Literal[Event.DEVICES], **data: Unpack[DevicesFound]) -> None: ...
    @overload
    def write(self, event: Literal[Event.CAPTURE_STORED], **data: Unpack[CaptureStored]) -> None: ...
    @overload
    def write(self, event: Literal[Event.STEP_DONE], **data: Unpack[StepDone]) -> None: ...
    @overload
    def write(self, event: Literal[Event.ATTEMPT_CHECKED], **data: Unpack[AttemptChecked]) -> None: ...
    @overload
    def write(self, event: Literal[Event.ATTEMPT_LOST], **data: Unpack[AttemptLost]) -> None: ...
    @overload
    def write(self, event: Literal[Event.SOLVED], **data: Unpack[Solved]) -> None: ...
    @overload
    def write(self, event: Literal[Event.WRITTEN], **data: Unpack[Written]) -> None: ...
    @overload
    def write(self, event: Literal[Event.UNTIL_DECIDED], **data: Unpack[UntilDecided]) -> None: ...
    @overload
    def write(self, event: Literal[Event.RECOVERED], **data: Unpack[Recovered]) -> None: ...
    @overload
    def write(self, event: Literal[Event.ASKED], **data: Unpack[Asked]) -> None: ...
    @overload
    def write(self, event: Literal[Event.ANSWERED], **data: Unpack[Answered]) -> None: ...
    @overload
    def write(self, event: Literal[Event.COMMANDED], **data: Unpack[Commanded]) -> None: ...
    @overload
    def write(self, event: Literal[Event.POSE_SKIPPED], **data: Unpack[PoseSkipped]) -> None: ...
    @overload
    def write(self, event: Literal[Event.INTERLOCK_RELEASED], **data: Unpack[InterlockReleased]) -> None: ...
    @overload
    def write(self, event: Literal[Event.SUPERVISOR_LOST], **data: Unpack[SupervisorLost]) -> None: ...
    @overload
    def write(self, event: Literal[Event.COMPUTER_BUSY], **data: Unpack[ComputerBusy]) -> None: ...
    @overload
    def write(self, event: Literal[Event.DEVIATION], **data: Unpack[Deviation]) -> None: ...
    @overload
    def write(self, event: Literal[Event.RUN_ENDED], **data: Unpack[RunEnded]) -> None: ...
    @overload
    def write(self, event: Literal[Event.DEVICES_LEFT], **data: Unpack[DevicesLeft]) -> None: ...
    def write(self, event: Event, **data: Any) -> None:
        """Write one line and update the history.

        The line survives a power cut when this returns, except a line that is repeated or found again after a restart
        with the same result: such a line is synced together with the next one.

        data: Its payload (`bench.records.events`).
        Raises StorageError: When the journal cannot be written.
        """
        self._write(event, data)

    def write_entering(self, data: Entering) -> None:
        """Write that the machine is about to enter a state. Otherwise as ``write``."""
        self._write(Event.ENTERING, data)

    def write_left_off(self, data: LeftOff) -> None:
        """Write that the work of a state ended. Otherwise as ``write``.

        data: The state, and the error where the work failed.
        """
        self._write(Event.LEFT_OFF, data)

    def _write(self, event: Event, data: Mapping[str, Any]) -> None:
        write = self.journal.append_unsynced if _is_repeatable(event, data) else self.journal.append
        with self._lock:
            apply_entry(self.history, write(event, **data))


def _is_repeatable(event: Event, data: Mapping[str, Any]) -> bool:
    """Return whether a line may be lost with the power, because a restart does or finds the same again.

    Before anything moves, is switched or is asked, a line that lasts is written, and these with it.
    """
    match event:
        case Event.LEFT_OFF:
            return "error" not in data
        case Event.ENTERING:
            return data["state"] in _WITHOUT_HARDWARE
        case Event.ATTEMPT_CHECKED | Event.STEP_DONE:
            return True
    return False
