"""One run as its page shows it, kept up to date with each line of the journal: poses, log, last recording, course.

It writes nothing.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterator, Mapping
from operator import itemgetter
from pathlib import Path

from bench.extras.pages.panel.journal_tail import JournalTail
from bench.extras.pages.panel.shown_run import LogLine, PoseRow, PoseState
from bench.record.events import (
    Asked,
    AttemptChecked,
    AttemptLost,
    CaptureStored,
    Entering,
    Event,
    PoseSkipped,
    UntilDecided,
)
from bench.record.history import History, apply_entry
from bench.record.journal_line import Entry
from bench.record.run_folder import JOURNAL
from bench.run.status import RunPlan, event_text, read_plan
from bench.run.time_left import TimeLeft

_NOT_SHOWN = frozenset({Event.LEFT_OFF, Event.STEP_DONE})
"""Half of the lines of a journal, which change nothing that the page shows."""
_MOST_LOG_LINES = 300  # Of one answer; older ones come on request


class RunModel:
    """One run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.tail = JournalTail(folder / JOURNAL, self._begin_again)
        self.generation = 0
        """How often the journal was read from its beginning; its lines are comparable within one generation only."""
        self._begin_again()

    def _begin_again(self) -> None:
        self.generation += 1
        self.lines = 0
        self.fault = ""
        """Why the journal's content cannot be understood; empty if it can."""
        self.plan: RunPlan = RunPlan()
        self.time_left = TimeLeft((), 0.0)
        self.history = History()
        self.rows: dict[int, PoseRow] = {}
        """Poses by number."""
        self._changed: dict[int, int] = {}  # pose: line at which it changed last, oldest first
        self.log: list[LogLine] = []
        self.last_target_deg: Mapping[str, float] = {}
        self.asked: Asked | None = None
        self.stored_utc = self.asked_utc = ""
        """Times of the last recording and of the last question."""

    @property
    def last_stored(self) -> CaptureStored | None:
        """What the journal holds of the last recording."""
        return self.history.attempts[-1].stored if self.history.attempts else None

    @property
    def last_checked(self) -> AttemptChecked | None:
        """What the journal holds of the last recording that was measured."""
        return next((a.checked for a in reversed(self.history.attempts) if a.checked is not None), None)

    @property
    def gate_failures(self) -> Mapping[str, int]:
        """How many recordings each gate has rejected."""
        judged = (gate for attempt in self.history.attempts for gate in attempt.gates)
        return Counter(gate["name"] for gate in judged if gate["verdict"] == "fail")

    def refresh(self) -> bool:
        """Read what is new in the journal, at most a part of it; False if there was nothing."""
        if not self.tail.has_changed():
            return False
        before = self.tail.fault, self.lines, self.tail.incomplete
        for entry in self.tail.read():
            self._apply(entry)
        return before != (self.tail.fault, self.lines, self.tail.incomplete)

    def changed_rows(self, after: int) -> list[PoseRow]:
        """Return the poses that changed after a line, in order; 0 for all."""
        numbers = (number for number, line in self._changed.items() if after <= 0 or line > after)
        return [self.rows[number] for number in sorted(numbers)]

    def newest_rows(self) -> Iterator[PoseRow]:
        """Yield the poses, those that changed last first."""
        for number in reversed(self._changed):
            yield self.rows[number]

    def log_after(self, after: int) -> list[LogLine]:
        """Return the newest lines of the log after a line of the journal; newest last."""
        begin = bisect_right(self.log, after, key=itemgetter("line"))
        return self.log[max(begin, len(self.log) - _MOST_LOG_LINES) :]

    def log_before(self, before: int) -> list[LogLine]:
        """Return the log before a line, as `log_after`."""
        end = bisect_left(self.log, before, key=itemgetter("line"))
        return self.log[max(0, end - _MOST_LOG_LINES) : end]

    def _apply(self, entry: Entry) -> None:
        self.lines += 1
        if self.fault:
            return
        if self.lines == 1:
            self._read_plan()
        try:
            apply_entry(self.history, entry)
            self.time_left.apply(entry, self.history)
            if entry.event not in _NOT_SHOWN:
                self._keep(entry)
                self._change_rows(entry)
            text = event_text(entry)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            self.fault = (
                f"Line {entry.seq + 1} of the journal ({entry.event}) cannot be understood: it lacks {error}."
                " Another version of Starbench wrote it."
            )
            return
        if text:
            self.log.append({"line": self.lines, "utc": entry.utc, "text": text, "tone": _tone(entry)})

    def _read_plan(self) -> None:
        self.plan = read_plan(self.folder)
        self.time_left = TimeLeft(self.plan.steps, self.plan.duration_s)
        for number, pose in self.plan.poses.items():
            self.rows[number] = _row(number, str(pose["name"]), pose.get("angles_deg", {}))
            self._changed[number] = 0

    def _keep(self, entry: Entry) -> None:
        """Keep what the page shows of the newest recording."""
        data = entry.data
        match entry.event:
            case Event.CAPTURE_STORED:
                self.stored_utc = entry.utc
            case Event.ENTERING:
                self.last_target_deg = data.get("target_deg", self.last_target_deg)
            case Event.ASKED:
                self.asked, self.asked_utc = entry.of(Asked), entry.utc

    def _change_rows(self, entry: Entry) -> None:
        match entry.event:
            case Event.ENTERING:
                self._enter(entry.of(Entering))
            case Event.ATTEMPT_CHECKED:
                self._check(entry.of(AttemptChecked))
            case Event.CAPTURE_STORED:
                stored = entry.of(CaptureStored)
                row, number = self._row_at(stored["pose"]), stored["attempt"]
                self._change({**row, "attempts": number, "last": number})
            case Event.ATTEMPT_LOST:
                lost = entry.of(AttemptLost)
                row, number = self._row_at(lost["pose"]), lost["attempt"]
                self._change({**row, "state": "lost", "attempts": number, "why": lost["why"]})
            case Event.POSE_SKIPPED:
                skipped = entry.of(PoseSkipped)
                self._change({**self._row_at(skipped["pose"]), "state": "skipped", "why": skipped["what"]})
            case Event.UNTIL_DECIDED:
                decided = entry.of(UntilDecided)
                if "chosen" in decided:
                    chosen = decided["chosen"]
                    row = _row(chosen["pose"], chosen["pose_name"], chosen["angles_deg"])
                    self._change({**row, "chosen": True})
            case Event.RUN_ENDED | Event.RUN_RESUMED:
                self._leave_pose_at_work()

    def _enter(self, entered: Entering) -> None:
        if "pose" in entered:
            self._leave_pose_at_work(except_for=entered["pose"])
            row = self._row_at(entered["pose"])
            self._change({**row, "state": "at work", "name": entered["pose_name"]})
        elif self.history.at_pose is None:
            self._leave_pose_at_work()

    def _check(self, checked: AttemptChecked) -> None:
        row = self._row_at(checked["pose"])
        state: PoseState = "accepted" if checked["accepted"] else "rejected"
        why = "" if checked["accepted"] else "; ".join(checked["reasons"])
        self._change(
            {**row, "state": state, "stars": checked["stars"], "why": why, "last": checked["attempt"]}
        )

    def _leave_pose_at_work(self, except_for: int | None = None) -> None:
        """Give the pose that is at work no longer the state that it has earned."""
        number = next(reversed(self._changed), None)
        row = self.rows.get(number) if number is not None else None
        if row is None or row["state"] != "at work" or number == except_for:
            return
        if number in self.history.accepted():
            self._change({**row, "state": "accepted", "why": ""})
        else:
            self._change({**row, "state": "rejected" if row["why"] else "planned"})

    def _row_at(self, number: int) -> PoseRow:
        return self.rows.get(number) or _row(number, "", {})

    def _change(self, row: PoseRow) -> None:
        number = row["number"]
        self.rows[number] = row
        self._changed.pop(number, None)
        self._changed[number] = self.lines


def _row(number: int, name: str, angles_deg: Mapping[str, float]) -> PoseRow:
    return {
        "number": number,
        "name": name,
        "angles_deg": dict(angles_deg),
        "state": "planned",
        "attempts": 0,
        "stars": None,
        "why": "",
        "last": 0,
        "chosen": False,
    }


def _tone(entry: Entry) -> str:
    """Return how a line of the log is to be coloured."""
    data = entry.data
    match entry.event:
        case Event.ATTEMPT_CHECKED:
            return "good" if data["accepted"] else "warn"
        case Event.RUN_ENDED:
            return {"finished": "good", "aborted": "warn"}.get(data["how"], "bad")
        case Event.LEFT_OFF | Event.SUPERVISOR_LOST:
            return "bad"
        case Event.DEVIATION | Event.POSE_SKIPPED | Event.ASKED | Event.RUN_RESUMED | Event.ATTEMPT_LOST:
            return "warn"
        case Event.ENTERING | Event.COMPUTER_BUSY:
            return "warn" if data.get("state", "holding") in {"holding", "aborting", "failed"} else ""
        case _:
            return ""
