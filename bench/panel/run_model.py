"""One run as its page shows it, kept up to date with each line of the journal: poses, log, last recording, course.

What a page needs again and again is kept small: of each recording the model keeps its verdict and its place, not all
numbers. It reads the run's folder and writes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.panel.journal_tail import JournalTail
from bench.panel.run_plan import RunPlan, read_plan
from bench.records.events import Event
from bench.records.history import History, apply_entry
from bench.records.journal_entry import Entry
from bench.records.run_folder import JOURNAL
from bench.run.journal_text import line_text
from bench.run.time_left import TimeLeft

Json = dict[str, Any]

_KEPT_OF_CAPTURE = ("pose", "pose_name", "attempt")
_KEPT_OF_CHECK = ("pose", "attempt", "accepted", "reasons", "stars")
_CLOCK_TEXT = len("12:34:56 UTC  ")


@dataclass(frozen=True)
class Place:
    """Where a recording is, and what is needed to show it again."""

    capture: str  # Its file, relative to the run folder
    expected_grid: Any = None  # Grid by which its stars were labelled; None if the tag did that


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
        self.rows: dict[int, Json] = {}
        """Poses by number."""
        self._changed: dict[int, int] = {}  # pose: line at which it changed last, oldest first
        self.log: list[tuple[int, str, str, str]] = []
        """Number of the line, its time, its text and its tone."""
        self.places: dict[tuple[int, int], Place] = {}
        """Places of the recordings by pose and attempt."""
        self.grids: list[tuple[int, Any, int]] = []
        """Pose, grid and number of stars of the accepted recordings, in the order of their acceptance."""
        self.last_stored: Mapping[str, Any] = {}
        self.last_checked: Mapping[str, Any] = {}
        self.last_target_deg: Mapping[str, float] = {}
        self.asked: Mapping[str, Any] = {}
        self.held_since_utc = ""
        self.gate_failures: dict[str, int] = {}
        """How many recordings each gate has rejected."""
        self._stored_utc = self._asked_utc = ""

    @property
    def stored_utc(self) -> str:
        """Time of the last recording."""
        return self._stored_utc

    @property
    def asked_utc(self) -> str:
        """Time of the last question."""
        return self._asked_utc

    def refresh(self) -> bool:
        """Read what is new in the journal, at most a part of it.

        Returns: Whether there was anything new.
        """
        if not self.tail.has_changed():
            return False
        before = self.tail.fault, self.lines, self.tail.incomplete
        for entry in self.tail.read():
            self._apply(entry)
        return before != (self.tail.fault, self.lines, self.tail.incomplete)

    def changed_rows(self, after: int) -> list[Json]:
        """Return the poses that changed after a line.

        after: Number of lines that a page has; 0 for none.
        Returns: Rows in the order of the poses.
        """
        if after <= 0:
            return [self.rows[number] for number in sorted(self.rows)]
        found = []
        for number, line in reversed(self._changed.items()):
            if line <= after:
                break
            found.append(number)
        return [self.rows[number] for number in sorted(found)]

    def newest_rows(self) -> Iterator[Json]:
        """Yield the poses, those that changed last first."""
        for number in reversed(self._changed):
            yield self.rows[number]

    def log_after(self, after: int, most: int) -> list[Json]:
        """Return the log after a line, at most its newest lines.

        Returns: ``line``, ``utc``, ``text``, ``tone``; the newest last.
        """
        begin = len(self.log)
        while begin > 0 and len(self.log) - begin < most and self.log[begin - 1][0] > after:
            begin -= 1
        return [_log_dict(one) for one in self.log[begin:]]

    def log_before(self, before: int, most: int) -> list[Json]:
        """Return the log before a line.

        before: Number of a line.
        Returns: As `log_after`.
        """
        end = len(self.log)
        while end > 0 and self.log[end - 1][0] >= before:
            end -= 1
        return [_log_dict(one) for one in self.log[max(0, end - most) : end]]

    def _apply(self, entry: Entry) -> None:
        self.lines += 1
        if self.fault:
            return
        if self.lines == 1:
            self._read_plan()
        try:
            slim = _slim(entry)  # fails first if the line lacks something
            self._keep(entry)
            apply_entry(self.history, slim)
            self.time_left.apply(entry, self.history)
            self._change_rows(entry)
            text = line_text(entry)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            self.fault = (
                f"Line {entry.seq + 1} of the journal ({entry.event}) cannot be understood: it lacks {error}."
                " Another version of Starbench wrote it."
            )
            return
        if text:
            self.log.append((self.lines, entry.utc, text[_CLOCK_TEXT:], _tone(entry)))

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
                self.places[int(data["pose"]), int(data["attempt"])] = Place(str(data["capture"]))
                self.last_stored, self._stored_utc = data, entry.utc
            case Event.ATTEMPT_CHECKED:
                self._keep_check(entry)
            case Event.ENTERING:
                self.last_target_deg = data.get("target_deg", self.last_target_deg)
                if data["state"] == "holding":
                    self.held_since_utc = entry.utc
            case Event.ASKED:
                self.asked, self._asked_utc = data, entry.utc

    def _keep_check(self, entry: Entry) -> None:
        data = entry.data
        self.last_checked = data
        place = int(data["pose"]), int(data["attempt"])
        measured = data.get("measured", {})
        if measured.get("expected_grid") is not None and place in self.places:
            self.places[place] = replace(self.places[place], expected_grid=measured["expected_grid"])
        if data["accepted"] and measured.get("grid") is not None:
            self.grids.append((place[0], measured["grid"], int(data["stars"])))
        for gate in data.get("gates", ()):
            if gate["verdict"] == "fail":
                self.gate_failures[gate["name"]] = self.gate_failures.get(gate["name"], 0) + 1

    def _change_rows(self, entry: Entry) -> None:
        data, number = entry.data, entry.data.get("pose")
        match entry.event:
            case Event.ENTERING if number is not None:
                self._leave_pose_at_work(except_for=number)
                self._change(number, state="at work", name=data.get("pose_name"))
            case Event.ENTERING:
                if self.history.at_pose is None:
                    self._leave_pose_at_work()
            case Event.ATTEMPT_CHECKED:
                state = "accepted" if data["accepted"] else "rejected"
                why = "; ".join(data["reasons"])
                self._change(
                    int(data["pose"]), state=state, stars=data["stars"], why=why, last=data["attempt"]
                )
            case Event.CAPTURE_STORED:
                self._change(int(data["pose"]), attempts=int(data["attempt"]), last=int(data["attempt"]))
            case Event.ATTEMPT_LOST:
                self._change(int(data["pose"]), state="lost", attempts=int(data["attempt"]), why=data["why"])
            case Event.POSE_SKIPPED:
                self._change(int(data["pose"]), state="skipped", why=data["what"])
            case Event.UNTIL_DECIDED if "chosen" in data:
                chosen = data["chosen"]
                self.rows[chosen["pose"]] = _row(chosen["pose"], chosen["pose_name"], chosen["angles_deg"])
                self._change(chosen["pose"], chosen=True)
            case Event.RUN_ENDED | Event.RUN_RESUMED:
                self._leave_pose_at_work()

    def _leave_pose_at_work(self, except_for: int | None = None) -> None:
        """Give the pose that is at work no longer the state that it has earned."""
        number = next(reversed(self._changed), None)
        row = self.rows.get(number) if number is not None else None
        if row is None or row["state"] != "at work" or number == except_for:
            return
        assert number is not None
        state = "accepted" if number in self.history.accepted() else "rejected" if row["why"] else "planned"
        self._change(number, state=state)

    def _change(self, number: int, **values: Any) -> None:
        old = self.rows.get(number) or _row(number, str(values.get("name") or ""), {})
        given = {name: value for name, value in values.items() if value is not None}
        if given.get("state") == "accepted":
            given["why"] = ""
        self.rows[number] = {**old, **given}
        self._changed.pop(number, None)
        self._changed[number] = self.lines


def _row(number: int, name: str, angles_deg: Mapping[str, float]) -> Json:
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


def _slim(entry: Entry) -> Entry:
    """Return a line without the many numbers of a recording, which the history would keep."""
    data = entry.data
    if entry.event == Event.CAPTURE_STORED:
        return replace(entry, data={name: data[name] for name in _KEPT_OF_CAPTURE})
    if entry.event == Event.ATTEMPT_CHECKED:
        kept = {name: data[name] for name in _KEPT_OF_CHECK}
        return replace(entry, data={**kept, "gates": (), "measured": {}})
    return entry


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


def _log_dict(line: tuple[int, str, str, str]) -> Json:
    return dict(zip(("line", "utc", "text", "tone"), line, strict=True))
