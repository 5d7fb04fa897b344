"""How long a run still takes: the times of its plan, scaled by what its steps took so far."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from bench.records.events import Event
from bench.records.history import History
from bench.records.journal_entry import Entry

_LEAST_STEPS = 3
_SMALLEST, _LARGEST = 0.5, 50.0


class TimeLeft:
    """Time left of one run; `apply` follows the journal.

    Parameters
    ----------
    steps
        ``steps`` of plan.json, in order.
    duration_s
        ``duration_s`` of plan.json.
    """

    def __init__(self, steps: Sequence[Mapping[str, Any]], duration_s: float) -> None:
        self._planned_s = {int(step["number"]): float(step["duration_s"]) for step in steps}
        self._after_s = {int(step["number"]): float(step["done_after_s"]) for step in steps}
        self._duration_s = duration_s
        self._begun_s = 0.0
        self._counted_s = self._took_s = 0.0
        self._counted = 0
        self._mark_utc = ""

    def apply(self, entry: Entry, history: History) -> None:
        """Follow one line of the journal.

        Parameters
        ----------
        entry
            The line.
        history
            History of the run, to which the line is applied already.
        """
        if entry.event in {Event.STEP_DONE, Event.RUN_STARTED, Event.RUN_RESUMED}:
            self._mark_utc = entry.utc
        if entry.event == Event.STEP_DONE:
            step = int(entry.data["step"])
            self._begun_s = max(self._begun_s, self._after_s.get(step, 0.0))
            planned_s = self._planned_s.get(step, 0.0)
            if planned_s > 0 and not entry.data.get("skipped"):
                self._counted += 1
                self._counted_s += planned_s
                self._took_s += history.worked_s.get(step, planned_s)
        elif entry.event == Event.UNTIL_DECIDED and "ended" in entry.data:
            last = int(entry.data["until_last"])
            self._begun_s = max(self._begun_s, self._after_s.get(last, 0.0))

    def left_s(self, now: datetime, *, held: bool) -> float:
        """Return the time left.

        Parameters
        ----------
        now
            The present time, with its time zone.
        held
            Whether the run is held; time does not pass for it then.

        Returns
        -------
        float
            Time, s. From the third step on, the planned times are scaled by what the steps so far took.
        """
        left_s = max(0.0, self._duration_s - self._begun_s) * self.pace
        if held or not self._mark_utc:
            return left_s
        since_s = (now - datetime.fromisoformat(self._mark_utc)).total_seconds()
        return max(0.0, left_s - max(0.0, since_s))

    def left_at_step_s(self, step: int) -> float:
        """Return the planned time from the last step done to the begin of a later step, scaled.

        Parameters
        ----------
        step
            Number of the later step.

        Returns
        -------
        float
            Time, s.
        """
        begin_s = self._after_s.get(step, 0.0) - self._planned_s.get(step, 0.0)
        return max(0.0, begin_s - self._begun_s) * self.pace

    @property
    def pace(self) -> float:
        """What the steps so far took, divided by what was planned for them; 1 at the begin."""
        if self._counted < _LEAST_STEPS or self._counted_s <= 0:
            return 1.0
        return min(max(self._took_s / self._counted_s, _SMALLEST), _LARGEST)

    def next_of(self, numbers: Sequence[int], done: set[int]) -> int | None:
        """Return the first of some steps that is still to come.

        Parameters
        ----------
        numbers
            Numbers of the steps, in order.
        done
            Numbers of the steps that are done.

        Returns
        -------
        int or None
            Its number; None if none is to come.
        """
        return next((n for n in numbers if n not in done and self._after_s.get(n, 0.0) > self._begun_s), None)
