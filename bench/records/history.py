"""What has happened in a run, replayed from its journal: a run's state is its journal and nothing else.

Names every event a run writes and what each carries; knows no devices and no files but the journal's lines.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any

from bench.base.errors import JournalBroken
from bench.records.captures import CAPTURE_STORED
from bench.records.journal import Entry, Journal


class Event(StrEnum):
    """What a line of a run's journal tells."""

    RUN_STARTED = "run_started"
    """First line: id, seed, sequence and station names with the SHA-256 of their files, software, operator."""
    RUN_RESUMED = "run_resumed"
    """A process took the run up again; with ``crash`` where the one before had crashed by itself."""
    DEVICES = "devices"
    """Who the devices said they are."""
    ENTERING = "entering"
    """The machine is about to enter a state."""
    LEFT_OFF = "left_off"
    """The work of a state ended; with ``error`` where it did not end well."""
    CAPTURE_STORED = CAPTURE_STORED
    """A recording is whole and in its place, with what was known when it was made."""
    STEP_DONE = "step_done"
    """A step of the script is done and will not be done again."""
    ATTEMPT_CHECKED = "attempt_checked"
    """A recording was looked at: accepted or not, and why."""
    ATTEMPT_LOST = "attempt_lost"
    """A recording that the camera could not complete; nothing was stored."""
    SOLVED = "solved"
    """A calibration stands: its main numbers."""
    RECOVERED = "recovered"
    """What a crash had left of the run folder (RecoveryNotes)."""
    ASKED = "asked"
    """A prompt is asked: its text, default and time-out."""
    ANSWERED = "answered"
    """An operator's (or the default) answer to a prompt."""
    COMMANDED = "commanded"
    """An operator's command (`bench.run.control`): its id and word, by whom, and whether and why not it was taken."""
    POSE_SKIPPED = "pose_skipped"
    """A pose that will not be recorded any more, and why; a deviation."""
    INTERLOCK_RELEASED = "interlock_released"
    """An interlock (``rule``) lets go, after ``held_s``; that it held stands in the line ``entering``."""
    SUPERVISOR_LOST = "supervisor_lost"
    """The process that watched this one is gone; the run goes on to its own end."""
    DEVIATION = "deviation"
    """Something went otherwise than the script says; printed in the report."""
    RUN_ENDED = "run_ended"
    """Last line: finished, aborted or failed, and why; ``crashed`` where nobody had foreseen it."""


_POSE_STATES = frozenset({"slewing", "settling", "recording", "checking", "backing_off"})
"""States in which a pose is at work."""


@dataclass(frozen=True)
class Attempt:
    """One recording at one pose, as journaled when stored."""

    pose_index: int
    pose_name: str
    attempt: int
    stored: Mapping[str, Any]
    checked: Mapping[str, Any] | None = None

    @property
    def accepted(self) -> bool:
        """Whether it passed its gates."""
        return self.checked is not None and bool(self.checked["accepted"])


@dataclass
class History:
    """A run so far."""

    started: Mapping[str, Any] = field(default_factory=dict)
    started_utc: str = ""
    devices: Mapping[str, Any] = field(default_factory=dict)
    done_steps: set[int] = field(default_factory=set)
    attempts: list[Attempt] = field(default_factory=list)
    lost: dict[int, int] = field(default_factory=dict)
    """Recordings the camera could not complete, by pose index."""
    states: list[dict[str, Any]] = field(default_factory=list)
    deviations: list[str] = field(default_factory=list)
    resumed: int = 0
    ended: str = ""
    why: str = ""
    at_pose: int | None = None
    """The pose at work, if any; its number stays while the camera settles there."""
    crashes: dict[int, int] = field(default_factory=dict)
    """How often the process crashed by itself while a pose was at work, by pose index."""
    to_skip: dict[int, str] = field(default_factory=dict)
    """Poses that an operator wants skipped, and who."""
    skipped: dict[int, str] = field(default_factory=dict)
    """Poses that are skipped, and why."""
    ledger: Mapping[str, Any] = field(default_factory=dict)
    """Its place in the laboratory's ledger (`bench.records.ledger`)."""
    solved: Mapping[str, Any] = field(default_factory=dict)
    """Main numbers of its calibration; empty while it has none."""
    holder: str = ""
    """Who holds the run; empty while nobody does."""
    rule: str = ""
    """The interlock that holds the run, and why, in words; empty while none does."""
    question: str = ""
    """What is being asked; empty while nothing is."""
    answer: tuple[str, str] | None = None
    """What was answered to it from another terminal, and by whom."""

    def __post_init__(self) -> None:
        stored, self.attempts = self.attempts, []
        self._places: dict[
            int, list[int]
        ] = {}  # where in the list those of a pose stand: asked for at every step
        self._accepted: dict[int, Attempt] = {}
        for attempt in stored:
            self.add(attempt)

    def add(self, attempt: Attempt) -> None:
        """Take a recording that was stored."""
        self._places.setdefault(attempt.pose_index, []).append(len(self.attempts))
        self.attempts.append(attempt)
        if attempt.accepted:
            self._accepted[attempt.pose_index] = attempt

    def check(self, pose_index: int, number: int, checked: Mapping[str, Any]) -> None:
        """Take what was found in a stored recording. Raises ValueError where there is none of that number."""
        for place in self._places.get(pose_index, ()):
            if self.attempts[place].attempt == number:
                attempt = self.attempts[place] = replace(self.attempts[place], checked=checked)
                if attempt.accepted:
                    self._accepted[pose_index] = attempt
                return
        raise ValueError(f"a stored recording for pose {pose_index}, attempt {number}")

    def accepted(self) -> Mapping[int, Attempt]:
        """The accepted recording of each pose that has one, by pose index, in the order of their acceptance."""
        return MappingProxyType(self._accepted)

    def attempts_at(self, pose_index: int) -> Sequence[Attempt]:
        """All recordings stored at a pose, in order."""
        return [self.attempts[place] for place in self._places.get(pose_index, ())]

    def next_attempt(self, pose_index: int) -> int:
        """Number of the next recording at a pose: after those stored and those lost."""
        return len(self.attempts_at(pose_index)) + self.lost.get(pose_index, 0) + 1

    def unchecked(self, pose_index: int) -> Attempt | None:
        """The last recording of a pose, when it was stored but not yet looked at."""
        attempts = self.attempts_at(pose_index)
        return attempts[-1] if attempts and attempts[-1].checked is None else None


class RunLog:
    """A run's journal together with what it amounts to, kept up to date line by line."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.history = replay(journal.entries)
        self._lock = threading.RLock()

    @contextmanager
    def held(self) -> Iterator[History]:
        """Keep other threads from telling anything meanwhile: to decide on what has happened, and tell it."""
        with self._lock:
            yield self.history

    def tell(self, event: Event, **data: Any) -> None:
        """Write one line, and let ``history`` know it. Raises StorageError.

        When this returns the line lasts, but for lines that tell of the way only: those last with the next one.
        """
        write = self.journal.append_unsynced if _on_the_way(event, data) else self.journal.append
        with self._lock:
            _take(self.history, write(event, **data))


_WITHOUT_HARDWARE = frozenset({"settling", "checking"})
"""States in which nothing moves, is switched or is stored."""


def _on_the_way(event: Event, data: Mapping[str, Any]) -> bool:
    """Whether a line may be lost with the power: what it tells is done again, or found out again, with the same end.

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


def replay(entries: Iterable[Entry]) -> History:
    """Replay a journal.

    Raises
    ------
    JournalBroken
        When an event lacks what it must carry: another program wrote it.
    """
    history = History()
    for entry in entries:
        try:
            _take(history, entry)
        except (KeyError, TypeError, ValueError) as error:
            raise JournalBroken(
                f"Line {entry.seq + 1} ({entry.event}) lacks {error}.",
                remedy="This journal was written by another program or version; it cannot be resumed by this one.",
            ) from error
    return history


def _take(history: History, entry: Entry) -> None:
    data = entry.data
    match entry.event:
        case Event.RUN_STARTED:
            history.started, history.started_utc = data, entry.utc
            history.ledger = data.get("ledger", {})
        case Event.RUN_RESUMED:
            history.resumed += 1
            history.ledger = data.get("ledger", history.ledger)
            history.ended = history.why = ""
            _let_go(history)
            count_crash(history, data.get("crash"))
        case Event.DEVICES:
            history.devices = data
        case Event.ENTERING:
            history.rule = f"{data['rule']}: {data['why']}" if "rule" in data else ""
            history.states.append({"state": data["state"], "utc": entry.utc, "mono_s": entry.mono_s})
            history.at_pose = data.get("pose", history.at_pose) if data["state"] in _POSE_STATES else None
        case Event.STEP_DONE:
            history.done_steps.add(int(data["step"]))
        case Event.DEVIATION:
            history.deviations.append(str(data["what"]))
        case Event.SOLVED:
            history.solved = data
        case Event.COMMANDED:
            _obey(history, data)
        case Event.RUN_ENDED:
            history.ended, history.why = str(data["how"]), str(data["why"])
            _let_go(history)
            count_crash(history, data.get("crashed"))
        case _:
            _take_of_pose(history, entry)


def _take_of_pose(history: History, entry: Entry) -> None:
    data = entry.data
    match entry.event:
        case Event.ASKED:
            history.question, history.answer = str(data["text"]), None
        case Event.ANSWERED:
            history.question, history.answer = "", None
        case Event.POSE_SKIPPED:
            history.skipped[int(data["pose"])] = str(data["what"])
            history.deviations.append(str(data["what"]))
        case Event.ATTEMPT_LOST:
            history.lost[int(data["pose"])] = history.lost.get(int(data["pose"]), 0) + 1
        case Event.ATTEMPT_CHECKED:
            history.check(int(data["pose"]), int(data["attempt"]), data)
        case Event.CAPTURE_STORED:
            history.add(Attempt(int(data["pose"]), str(data["pose_name"]), int(data["attempt"]), data))


def count_crash(history: History, crash: object) -> None:
    """Count a crash against the pose that was at work, and forget that pose: this process is not at it."""
    if crash and history.at_pose is not None:
        history.crashes[history.at_pose] = history.crashes.get(history.at_pose, 0) + 1
    history.at_pose = None


def _let_go(history: History) -> None:
    """A run that ends, or is taken up again, is held by nobody and asks nothing."""
    history.holder = history.rule = history.question = ""
    history.answer = None


def _obey(history: History, data: Mapping[str, Any]) -> None:
    if not data["taken"]:
        return
    match data["word"]:
        case "hold":
            history.holder = str(data["by"])
        case "release":
            history.holder = ""
        case "answer":
            history.answer = str(data["answer"]), str(data["by"])
        case "skip":
            history.to_skip[int(data["pose"])] = str(data["by"])
