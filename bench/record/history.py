"""History of a run, replayed from its journal: the state of a run is its journal and nothing else."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, ParamSpec

import calib.errors
from bench.base.errors import JournalBroken
from bench.base.failure import Failure
from bench.base.pasteable import pasteable
from bench.record.device_end import DeviceEnd
from bench.record.events import (
    AttemptChecked,
    CaptureStored,
    Commanded,
    Devices,
    Event,
    LedgerPlace,
    RunStarted,
    Solved,
    StateEntered,
    UntilDecided,
    VerdictData,
)
from bench.record.journal import CLOCK_JUMPED
from bench.record.journal_line import Entry
from bench.record.measured_facts import GateData, MeasuredFacts
from bench.record.run_folder import SEQUENCE_COPY, STATION_COPY
from drivers.lateness import LatenessData

P = ParamSpec("P")

_POSE_STATES = frozenset({"slewing", "settling", "recording", "checking", "backing_off"})
"""States in which a pose is at work."""


class InterlockHold(NamedTuple):
    """An interlock that holds the run."""

    rule: str  # Its name in the station file
    why: str  # A sentence without a full stop


@dataclass(frozen=True)
class Attempt:
    """One recording at one pose, as journaled when it was stored."""

    pose_index: int
    pose_name: str
    attempt: int  # Number of the attempt at this pose, from 1
    stored: CaptureStored
    checked: AttemptChecked | None = None  # Journal line about its measurement; None before it was measured
    stored_utc: str = ""  # Time of the line that it was stored, ISO 8601
    begun_utc: str = ""  # Time of the line that its recording began

    @property
    def begun_s(self) -> float:
        """When its recording began, s since 1970."""
        return datetime.fromisoformat(self.begun_utc).timestamp()

    @property
    def accepted(self) -> bool:
        """Whether it passed its gates."""
        return self.checked is not None and bool(self.checked["accepted"])

    @property
    def measured(self) -> MeasuredFacts:
        """Numbers measured in it; empty before it was measured."""
        return MeasuredFacts() if self.checked is None else self.checked["measured"]

    @property
    def reasons(self) -> Sequence[str]:
        """Why it was rejected; empty if it was accepted or not measured yet."""
        return () if self.checked is None else self.checked["reasons"]

    @property
    def gates(self) -> Sequence[GateData]:
        """The gates that judged it."""
        return () if self.checked is None else self.checked["gates"]


def _nothing() -> Any:
    return {}


@dataclass
class History:
    """A run so far. A payload whose line is not written yet is an empty mapping."""

    started: RunStarted = field(default_factory=_nothing)
    started_utc: str = ""
    devices: Devices = field(default_factory=_nothing)
    devices_left: Sequence[DeviceEnd] = ()
    """How each device was left after the last step that needs devices; empty before, or if nothing states it."""
    devices_at_end: Sequence[DeviceEnd] = ()
    """How each device was left at the last end of the run; empty if nothing states it."""
    done_steps: set[int] = field(default_factory=set)
    attempts: list[Attempt] = field(default_factory=list, init=False)
    lost: dict[int, int] = field(default_factory=dict)
    """Number of recordings that the camera could not complete, by pose index."""
    gone: frozenset[int] = frozenset()  # Poses whose accepted recording was lost or changed later
    states: list[StateEntered] = field(default_factory=list)
    deviations: list[str] = field(default_factory=list)
    holds: list[str] = field(default_factory=list)  # Pauses that a person asked for and ended
    failures: list[Failure] = field(default_factory=list)
    """The errors that ended the run before it was resumed, and the one that ended it last."""
    resumed: int = 0
    ended: str = ""
    why: str = ""
    at_pose: int | None = None
    """The pose at work, if any; it is kept while the camera settles."""
    crashes: dict[int, int] = field(default_factory=dict)
    """How often the process crashed while a pose was at work, by pose index; not counting kills from outside."""
    to_skip: dict[int, str] = field(default_factory=dict)
    """Operator who asked to skip a pose, by pose index."""
    skipped: dict[int, str] = field(default_factory=dict)
    """Why a pose is skipped, by pose index."""
    ledger: LedgerPlace = field(default_factory=_nothing)
    """Its place in the laboratory's ledger (`bench.record.ledger`)."""
    lateness: LatenessData = field(default_factory=LatenessData)
    """How late a busy computer woke the process, by its last line about it (`drivers.lateness`); empty before one."""
    busy: str = ""
    """How late the computer was when the journal last said that it is too busy, as text; empty if it never was."""
    solved: Solved = field(default_factory=_nothing)
    """Main numbers of its calibration; empty while it has none."""
    verdict: VerdictData | None = None
    """The verdict of its report; None while it has none."""
    decisions: list[UntilDecided] = field(default_factory=list)
    """What each ``until`` decided, in order."""
    worked_s: dict[int, float] = field(default_factory=dict)
    """Time worked, s, by number of the step: from entering a state for the step to the next state, without holds.
    Time after the last line of a process that was stopped is not known and does not count."""
    holder: str = ""
    """Operator who holds the run; empty while none does."""
    interlock: InterlockHold | None = None
    """The interlock that holds the run, and why; None while none does."""
    question: str = ""
    """The question to the operator; empty while there is none."""
    answer: tuple[str, str] | None = None
    """The answer given from another terminal, and by whom."""

    def __post_init__(self) -> None:
        # Places in the list of attempts, by pose index; needed at every step.
        self._places_of_pose: dict[int, list[int]] = {}
        self._accepted: dict[int, Attempt] = {}
        self._at_step: int | None = None
        self._last_mono_s = 0.0

    @property
    def failure(self) -> Failure | None:
        """Why the run failed; None if it did not."""
        return self.failures[-1] if self.ended == "failed" and self.failures else None

    @property
    def waits(self) -> bool:
        """Whether the run goes on only after a release or an answer."""
        return bool(self.holder or self.interlock or self.question)

    @property
    def chosen(self) -> Mapping[int, Mapping[str, float]]:
        """Angles of the poses that were chosen in the run, degrees, by pose index."""
        return {d["chosen"]["pose"]: d["chosen"]["angles_deg"] for d in self.decisions if "chosen" in d}

    def is_left_out(self, step: int) -> bool:
        """Return whether a step must not be done, because its ``until`` ended before it."""
        return any("ended" in d and d["step"] < step <= d["until_last"] for d in self.decisions)

    def count_time(self, entry: Entry) -> None:
        """Count the time since the previous journal line for the step at work."""
        if entry.event == Event.RUN_RESUMED:  # another process, whose clock begins anew
            self._at_step = None
        elif self._at_step is not None and entry.event != CLOCK_JUMPED:
            # A jump may be the first line of that process.
            passed_s = entry.mono_s - self._last_mono_s
            self.worked_s[self._at_step] = self.worked_s.get(self._at_step, 0.0) + passed_s
        self._last_mono_s = entry.mono_s
        if entry.event == Event.ENTERING:
            held = entry.data["state"] == "holding"
            self._at_step = None if held else entry.data.get("step")

    def add(self, attempt: Attempt) -> None:
        """Add a stored recording."""
        self._places_of_pose.setdefault(attempt.pose_index, []).append(len(self.attempts))
        self.attempts.append(attempt)
        self._accept(attempt)

    def check(self, pose_index: int, number: int, checked: AttemptChecked) -> None:
        """Add the result of measuring a stored recording; ``pose_index`` and ``number`` count from 1."""
        for place in self._places_of_pose.get(pose_index, ()):
            if self.attempts[place].attempt == number:
                self.attempts[place] = replace(self.attempts[place], checked=checked)
                self._accept(self.attempts[place])
                return
        raise ValueError(f"a stored recording for pose {pose_index}, attempt {number}")

    def _accept(self, attempt: Attempt) -> None:
        """Count a recording if it passed its gates."""
        if attempt.accepted:
            self._accepted[attempt.pose_index] = attempt
            self.gone -= {attempt.pose_index}

    def lose(self, captures: Collection[str]) -> None:
        """Count recordings no more: their poses are to be recorded again."""
        left = {
            pose: own for pose, own in self._accepted.items() if own.stored.get("capture") not in captures
        }
        self.gone |= self._accepted.keys() - left.keys()
        self._accepted = left

    def accepted(self) -> Mapping[int, Attempt]:
        """Return the accepted recording of each pose that has one, in the order of their acceptance."""
        return MappingProxyType(self._accepted)

    def last_good(self, pose_index: int) -> Attempt | None:
        """Return the recording that was accepted last: of a pose, else of the run; None without any."""
        return self._accepted.get(pose_index) or next(reversed(self._accepted.values()), None)

    def attempts_at(self, pose_index: int) -> Sequence[Attempt]:
        """Return all recordings stored at a pose, numbered from 1, in order."""
        return [self.attempts[place] for place in self._places_of_pose.get(pose_index, ())]

    def next_attempt(self, pose_index: int) -> int:
        """Return the number, from 1, of the next recording at a pose, after those stored and those lost."""
        return len(self.attempts_at(pose_index)) + self.lost.get(pose_index, 0) + 1

    def unchecked(self, pose_index: int) -> Attempt | None:
        """Return the last recording of a pose, numbered from 1, if it was stored but not yet measured."""
        attempts = self.attempts_at(pose_index)
        return attempts[-1] if attempts and attempts[-1].checked is None else None


def replay(entries: Iterable[Entry]) -> History:
    """Replay a journal from its first line. Raises JournalBroken if another program or version wrote it."""
    history = History()
    for entry in entries:
        try:
            apply_entry(history, entry)
        except (KeyError, TypeError, ValueError) as error:
            raise JournalBroken(
                f"Line {entry.seq + 1} ({entry.event}) lacks {error}.",
                remedy="This journal was written by another program or version; it cannot be resumed by this one.",
            ) from error
    return history


def apply_entry(history: History, entry: Entry) -> None:
    """Apply one journal line to a history. Raises KeyError, TypeError or ValueError if it is incomplete."""
    data = entry.data
    history.count_time(entry)
    _apply_lateness(history, entry)
    match entry.event:  # the three of nearly all lines first
        case Event.LEFT_OFF:
            pass
        case Event.ENTERING:
            history.interlock = InterlockHold(data["rule"], data["why"]) if "rule" in data else None
            history.states.append({"state": data["state"], "utc": entry.utc, "mono_s": entry.mono_s})
            history.at_pose = data.get("pose", history.at_pose) if data["state"] in _POSE_STATES else None
        case Event.STEP_DONE:
            history.done_steps.add(int(data["step"]))
        case Event.RUN_STARTED:
            history.started, history.started_utc = entry.of(RunStarted), entry.utc
            history.ledger = data.get("ledger", {})
        case Event.RUN_RESUMED:
            history.resumed += 1
            history.ledger = data.get("ledger", history.ledger)
            history.ended = history.why = ""
            _clear_hold(history)
            count_crash(history, data.get("crash"))
        case Event.DEVIATION:
            (history.holds if data.get("hold") else history.deviations).append(str(data["what"]))
        case Event.COMMANDED:
            _apply_command(history, entry.of(Commanded))
        case Event.RUN_ENDED:
            history.ended, history.why = str(data["how"]), str(data["why"])
            history.devices_at_end = _ends_of(data)
            if "error" in data:
                history.failures.append(Failure(**data["error"]))
            _clear_hold(history)
            count_crash(history, data.get("crashed"))
        case Event.DEVICES:
            history.devices = entry.of(Devices)
            history.devices_left = history.devices_at_end = ()
        case Event.DEVICES_LEFT:
            history.devices_left = _ends_of(data)
        case _:
            _apply_pose_entry(history, entry)


def _ends_of(data: Mapping[str, Any]) -> Sequence[DeviceEnd]:
    return [DeviceEnd(**end) for end in data.get("devices", ())]


def _apply_lateness(history: History, entry: Entry) -> None:
    """Keep how late the computer was; the end of a run states it too."""
    data = entry.data
    if "lateness" in data:
        history.lateness = data["lateness"]
    if entry.event == Event.COMPUTER_BUSY:
        history.busy = f"{data['late_s']:.1f} s late in {data['window_s']:.0f} s"


def _apply_pose_entry(history: History, entry: Entry) -> None:
    data = entry.data
    match entry.event:
        case Event.ASKED:
            history.question, history.answer = str(data["text"]), None
        case Event.ANSWERED:
            history.question, history.answer = "", None
        case Event.POSE_SKIPPED:
            history.skipped[int(data["pose"])] = str(data["what"])
            history.deviations.append(str(data["what"]))
        case Event.SOLVED:
            history.solved, history.verdict = entry.of(Solved), None
        case Event.WRITTEN:
            history.verdict = data.get("verdict")
        case Event.UNTIL_DECIDED:
            history.decisions.append(entry.of(UntilDecided))
        case Event.RECOVERED:
            history.lose([*data["missing"], *data["changed"]])
        case Event.ATTEMPT_LOST:
            history.lost[int(data["pose"])] = history.lost.get(int(data["pose"]), 0) + 1
        case Event.ATTEMPT_CHECKED:
            history.check(int(data["pose"]), int(data["attempt"]), entry.of(AttemptChecked))
        case Event.CAPTURE_STORED:
            pose, name, attempt = int(data["pose"]), str(data["pose_name"]), int(data["attempt"])
            begun_utc = history.states[-1]["utc"] if history.states else entry.utc
            history.add(Attempt(pose, name, attempt, entry.of(CaptureStored), None, entry.utc, begun_utc))


def count_crash(history: History, crash: object) -> None:
    """Count a crash, unless there was none, against the pose that was at work; none is at work afterwards."""
    if crash and history.at_pose is not None:
        history.crashes[history.at_pose] = history.crashes.get(history.at_pose, 0) + 1
    history.at_pose = None


def _clear_hold(history: History) -> None:
    """Clear hold and question, because a run that ends or is resumed has neither."""
    history.holder = history.question = ""
    history.interlock = None
    history.answer = None


def _apply_command(history: History, data: Commanded) -> None:
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


def begun_with(history: History, folder: Path) -> Sequence[str]:
    """Return the arguments of `starbench run` that begin a run again; an earlier version kept only its files."""
    copies = (str(folder / SEQUENCE_COPY), "--station", str(folder / STATION_COPY))
    return history.started.get("begun_with") or copies


def way_on(history: History, folder: Path) -> tuple[str, str]:
    """Return what there is to know, as a sentence, and the command that can work.

    A resumed run uses its own copies of the files, so it ends in the same way if one of them was wrong.
    """
    kind = history.failure.kind if history.failure else ""
    if kind and issubclass(getattr(calib.errors, kind, type(None)), calib.errors.CalibrationError):
        return (
            "All recordings are kept. With the same model they are refused again. With the joint adjustment:",
            pasteable("calibrate", folder, "--model", "joint"),
        )
    if kind and (not history.attempts or (kind == "PoseFailed" and not history.accepted())):
        nothing = "accepted" if history.attempts else "recorded"
        files = begun_with(history, folder)
        look = f" See what the camera sees: `{pasteable('align', *files[1:3])}`." if history.attempts else ""
        known = (
            f"Nothing was {nothing}.{look} If the cause is on the bench, remove it and continue: "
            f"`{pasteable('resume', folder)}`. If a file was wrong, correct it and begin again, since a run continues "
            "with its own copies:"
        )
        return known, pasteable("run", *files)
    return "All recordings are kept. To continue:", pasteable("resume", folder)
