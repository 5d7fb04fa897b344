"""The history of a run, replayed from its journal: a run's state is its journal and nothing else.

This module reads journal lines only; it touches no device and no other file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TypedDict, cast

from bench.base.errors import JournalBroken
from bench.records.events import (
    AttemptChecked,
    CaptureStored,
    Commanded,
    DevicesFound,
    Event,
    FailureData,
    GateData,
    LedgerPlace,
    MeasuredFacts,
    RunStarted,
    Solved,
)
from bench.records.journal_entry import Entry

_POSE_STATES = frozenset({"slewing", "settling", "recording", "checking", "backing_off"})
"""States in which a pose is at work."""


@dataclass(frozen=True)
class Attempt:
    """One recording at one pose, as journaled when stored."""

    pose_index: int
    pose_name: str
    attempt: int
    stored: CaptureStored
    checked: AttemptChecked | None = None

    @property
    def accepted(self) -> bool:
        """Whether it passed its gates."""
        return self.checked is not None and bool(self.checked["accepted"])

    @property
    def measured(self) -> MeasuredFacts:
        """Numbers measured in it; none before it was measured."""
        return MeasuredFacts() if self.checked is None else self.checked["measured"]

    @property
    def reasons(self) -> Sequence[str]:
        """Why it was refused; nothing where it was accepted or not measured yet."""
        return () if self.checked is None else self.checked["reasons"]

    @property
    def gates(self) -> Sequence[GateData]:
        """The gates that judged it."""
        return () if self.checked is None else self.checked["gates"]


class StateEntered(TypedDict):
    """One state that a run entered: its name, and when by the system's and by the monotonic clock."""

    state: str
    utc: str
    mono_s: float


@dataclass
class History:
    """A run so far. A payload whose line is not written yet is an empty mapping."""

    started: RunStarted = field(default_factory=lambda: cast("RunStarted", {}))
    started_utc: str = ""
    devices: DevicesFound = field(default_factory=lambda: cast("DevicesFound", {}))
    done_steps: set[int] = field(default_factory=set)
    attempts: list[Attempt] = field(default_factory=list)
    lost: dict[int, int] = field(default_factory=dict)
    """Recordings the camera could not complete, by pose index."""
    states: list[StateEntered] = field(default_factory=list)
    deviations: list[str] = field(default_factory=list)
    failures: list[FailureData] = field(default_factory=list)
    """The errors that ended the run before it was resumed, and the one that ended it last."""
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
    ledger: LedgerPlace = field(default_factory=lambda: cast("LedgerPlace", {}))
    """Its place in the laboratory's ledger (`bench.records.ledger`)."""
    solved: Solved = field(default_factory=lambda: cast("Solved", {}))
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

    def check(self, pose_index: int, number: int, checked: AttemptChecked) -> None:
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
            take(history, entry)
        except (KeyError, TypeError, ValueError) as error:
            raise JournalBroken(
                f"Line {entry.seq + 1} ({entry.event}) lacks {error}.",
                remedy="This journal was written by another program or version; it cannot be resumed by this one.",
            ) from error
    return history


def take(history: History, entry: Entry) -> None:
    """Let a history follow one line of its journal.

    Parameters
    ----------
    history
        Changed in place.
    entry
        The next line.

    Raises
    ------
    KeyError, TypeError, ValueError
        When the line lacks what its event must carry.
    """
    data = entry.data
    match entry.event:
        case Event.RUN_STARTED:
            history.started, history.started_utc = cast("RunStarted", data), entry.utc
            history.ledger = data.get("ledger", {})
        case Event.RUN_RESUMED:
            history.resumed += 1
            history.ledger = data.get("ledger", history.ledger)
            history.ended = history.why = ""
            _let_go(history)
            count_crash(history, data.get("crash"))
        case Event.DEVICES:
            history.devices = cast("DevicesFound", data)
        case Event.ENTERING:
            history.rule = f"{data['rule']}: {data['why']}" if "rule" in data else ""
            history.states.append({"state": data["state"], "utc": entry.utc, "mono_s": entry.mono_s})
            history.at_pose = data.get("pose", history.at_pose) if data["state"] in _POSE_STATES else None
        case Event.STEP_DONE:
            history.done_steps.add(int(data["step"]))
        case Event.DEVIATION:
            history.deviations.append(str(data["what"]))
        case Event.SOLVED:
            history.solved = cast("Solved", data)
        case Event.COMMANDED:
            _obey(history, cast("Commanded", data))
        case Event.RUN_ENDED:
            history.ended, history.why = str(data["how"]), str(data["why"])
            if "error" in data:
                history.failures.append(cast("FailureData", data["error"]))
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
            history.check(int(data["pose"]), int(data["attempt"]), cast("AttemptChecked", data))
        case Event.CAPTURE_STORED:
            stored = cast("CaptureStored", data)
            history.add(Attempt(int(data["pose"]), str(data["pose_name"]), int(data["attempt"]), stored))


def count_crash(history: History, crash: object) -> None:
    """Count a crash against the pose that was at work, and forget that pose: this process is not at it."""
    if crash and history.at_pose is not None:
        history.crashes[history.at_pose] = history.crashes.get(history.at_pose, 0) + 1
    history.at_pose = None


def _let_go(history: History) -> None:
    """A run that ends, or is taken up again, is held by nobody and asks nothing."""
    history.holder = history.rule = history.question = ""
    history.answer = None


def _obey(history: History, data: Commanded) -> None:
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
