"""The time left of a run, from its plan and the pace of the steps so far, at first of the bench's earlier runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from bench.record.events import Event
from bench.record.history import History
from bench.record.journal_line import Entry
from sequences.script import PromptStep, SettleStep, WaitStep

_LEAST_STEPS = 3  # Done before they say how fast the others go
_SMALLEST, _LARGEST = 0.5, 50.0  # Pace that is believed
_LEAST_LEFT_S = 1.0  # While something is to be done, no time left is 0:00
_FIXED = frozenset(step.word for step in (PromptStep, WaitStep, SettleStep))
"""Steps that take the time that the sequence states, on any bench."""
_MARKS = frozenset({Event.STEP_DONE, Event.RUN_STARTED, Event.RUN_RESUMED})
"""Lines from which the time of the next step counts."""


class TimeLeft:
    """Time left of one run, from ``steps`` and ``duration_s`` of plan.json; `apply` follows the journal."""

    def __init__(self, steps: Sequence[Mapping[str, Any]], duration_s: float) -> None:
        self._planned_s = {int(step["number"]): float(step["duration_s"]) for step in steps}
        self._after_s = {int(step["number"]): float(step["done_after_s"]) for step in steps}
        self._fixed = {int(step["number"]) for step in steps if step["what"] in _FIXED}
        self._fixed_after_s: dict[int, float] = {}
        self._fixed_s = 0.0
        for number in self._planned_s:
            self._fixed_s += self._planned_s[number] if number in self._fixed else 0.0
            self._fixed_after_s[number] = self._fixed_s
        self._duration_s = duration_s
        self._begun_s = self._begun_fixed_s = 0.0
        self._counted_s = self._took_s = 0.0
        self._counted = 0
        self._mark_utc = ""
        self._pace_before = 1.0  # Of earlier runs of the bench

    def apply(self, entry: Entry, history: History) -> None:
        """Follow one line of the journal."""
        if entry.event in _MARKS:
            self._mark_utc = entry.utc
        if entry.event == Event.RUN_STARTED:
            self._pace_before = float(entry.data.get("pace", 1.0))
        elif entry.event == Event.STEP_DONE:
            step = int(entry.data["step"])
            self._begin(step)
            planned_s = self._planned_s.get(step, 0.0)
            if planned_s > 0 and step not in self._fixed and not entry.data.get("skipped"):
                self._counted += 1
                self._counted_s += planned_s
                self._took_s += history.worked_s.get(step, planned_s)
        elif entry.event == Event.UNTIL_DECIDED and "ended" in entry.data:
            self._begin(int(entry.data["until_last"]))

    def _begin(self, after_step: int) -> None:
        """Begin the steps after one that is done or left out."""
        self._begun_s = max(self._begun_s, self._after_s.get(after_step, 0.0))
        self._begun_fixed_s = max(self._begun_fixed_s, self._fixed_after_s.get(after_step, 0.0))

    def _scaled_s(self, until_s: float, fixed_until_s: float) -> float:
        """Return the time from the last step done to a moment of the plan, with its fixed part, scaled."""
        fixed_s = max(0.0, fixed_until_s - self._begun_fixed_s)
        return fixed_s + max(0.0, until_s - self._begun_s - fixed_s) * self.pace

    def left_s(self, now: datetime, *, held: bool) -> float:
        """Return the time left, s, scaled by the steps so far; it does not pass while the run is held.

        A step that is late is expected to need as long again as it is late already. So the time left ends with the run.
        """
        left_s = self._scaled_s(self._duration_s, self._fixed_s)
        if held or not self._mark_utc:
            return left_s
        since_s = max(0.0, (now - datetime.fromisoformat(self._mark_utc)).total_seconds())
        step_s = self._present_step_s()
        return max(_LEAST_LEFT_S, left_s - step_s + abs(step_s - since_s))

    def _present_step_s(self) -> float:
        """Return the scaled time of the step at work; after the last one, of what follows it."""
        for number, after_s in self._after_s.items():
            if after_s > self._begun_s:
                return self._scaled_s(after_s, self._fixed_after_s[number])
        return self._scaled_s(self._duration_s, self._fixed_s)

    def left_at_step_s(self, step: int) -> float:
        """Return the planned time from the last step done to the begin of a later step, scaled, s."""
        own_s = self._planned_s.get(step, 0.0)
        fixed_s = self._fixed_after_s.get(step, 0.0) - (own_s if step in self._fixed else 0.0)
        return self._scaled_s(self._after_s.get(step, 0.0) - own_s, fixed_s)

    @property
    def pace(self) -> float:
        """What the steps so far took, divided by what was planned for them; that of earlier runs at the begin."""
        known = self._counted >= _LEAST_STEPS and self._counted_s > 0
        pace = self._took_s / self._counted_s if known else self._pace_before
        return min(max(pace, _SMALLEST), _LARGEST)

    def next_of(self, numbers: Sequence[int], done: set[int]) -> int | None:
        """Return the first of some steps, in order, that is still to come; None if none is."""
        return next((n for n in numbers if n not in done and self._after_s.get(n, 0.0) > self._begun_s), None)
