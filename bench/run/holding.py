"""What a run does while it holds: for an operator, for the answer to a question, or because of an interlock.

While an operator or an interlock holds the run, the light is off and the stage does not move.
"""

from __future__ import annotations

from collections.abc import Callable

from bench.base.clock import Aborted, BenchClock
from bench.records.events import Entering, Event
from bench.records.run_log import RunLog
from bench.run.interlock_text import interlock_text
from bench.run.interlocks import Interlocks, Trip
from bench.run.run_devices import RunDevices
from bench.terminal.prompt import Reply, ask
from sequences.script import PromptStep

MAX_HOLD_S = 8 * 3600.0
"""A run that an operator holds for longer than this is aborted safely, s."""
HOLD_POLL_S = 0.1
HOLD_NOTIFY_INTERVAL_S = 600.0
"""Shortest time between two notifications about holds by the same interlock, s."""


class Holding:
    """The work of the state ``holding``.

    interlocks: Decide when a run that one of them holds continues.
    """

    def __init__(
        self,
        devices: RunDevices,
        log: RunLog,
        interlocks: Interlocks,
        clock: BenchClock,
        say: Callable[[str], None],
    ) -> None:
        self._devices = devices
        self._log = log
        self._interlocks = interlocks
        self._clock = clock
        self._say = say

    def hold(self, question: PromptStep | None, trip: Trip | None, *, by: str) -> None:
        """Hold until the operator releases the run, the interlock clears, or the question is answered.

        question: Question to the operator, if neither an operator nor an interlock holds the run.
        trip: Interlock that holds the run, if any.
        by: Operator who holds the run; empty if there is none.
        Raises Aborted: If a stop was requested, the answer was to abort, or an operator has held the run for
          too long.
        Raises InterlockHeld: If an interlock has held the run for too long.
        """
        if by:
            self._until_released()
        elif trip is not None:
            self._until_clear(trip)
        else:
            assert question is not None
            self._until_answered(question)

    def _until_released(self) -> None:
        """Wait until the owner releases the run, at most ``MAX_HOLD_S``."""
        self._devices.switch_off_light()
        history, begin_s = self._log.history, self._clock.monotonic()
        while history.holder:
            if self._clock.monotonic() - begin_s > MAX_HOLD_S:
                raise Aborted(f"held by {history.holder} for more than {MAX_HOLD_S / 3600:g} h")
            self._clock.sleep(HOLD_POLL_S)

    def _until_clear(self, trip: Trip) -> None:
        with self._clock.shielded():
            self._devices.come_to_rest()
        held_s = self._interlocks.wait_until_clear(trip)
        name = interlock_text(trip.interlock.name)
        self._log.write(Event.INTERLOCK_RELEASED, rule=trip.interlock.name, held_s=round(held_s, 3))
        what = f"The {name} interlock held for {held_s:.0f} s: {trip.why}."
        self._log.write(Event.DEVIATION, what=what)
        self._say(f"{what} The run continues.")

    def _until_answered(self, step: PromptStep) -> None:
        self._log.write(
            Event.ASKED, step=step.number, text=step.text, default=step.default, timeout_s=step.timeout_s
        )
        answer = ask(
            step.text,
            default=step.default,
            timeout_s=step.timeout_s,
            clock=self._clock,
            say=self._say,
            elsewhere=self._answer_from_elsewhere,
        )
        # An answer from elsewhere that was accepted at the last moment counts: its sender was told so.
        with self._log.held():
            answer = self._answer_from_elsewhere() or answer
            self._log.write(Event.ANSWERED, step=step.number, answer=answer.word, by=answer.by)
        if answer.word == "abort":
            raise Aborted(f"{step.text} was answered with abort ({answer.by})")

    def _answer_from_elsewhere(self) -> Reply | None:
        """Return the answer given by `starbench answer`, if there is one."""
        given = self._log.history.answer
        return Reply(*given) if given is not None else None


class HoldNotifier:
    """Notifies absent people that a run holds; about the same interlock not too often.

    notify: Called with the occasion (``hold``), a short text and the hash of the journal's line.
    """

    def __init__(self, clock: BenchClock, notify: Callable[[str, str, str], None]) -> None:
        self._clock = clock
        self._notify = notify
        self._notified_s: dict[str, float] = {}

    def entering(self, facts: Entering, line: str) -> None:
        """Notify that the run holds. A door that opens again and again does not cause a hundred messages.

        line: Hash of that line.
        """
        rule, now_s = str(facts.get("rule", "")), self._clock.monotonic()
        if rule and now_s - self._notified_s.get(rule, -HOLD_NOTIFY_INTERVAL_S) < HOLD_NOTIFY_INTERVAL_S:
            return
        self._notified_s[rule] = now_s
        self._notify("hold", _waits_for(facts), line)


def _waits_for(facts: Entering) -> str:
    """Return what a run that holds waits for."""
    if "rule" in facts:
        return f"is held by the {interlock_text(facts['rule'])} interlock: {facts['why']}"
    return f"is held by {facts['by']}" if "by" in facts else "asks the operator a question"
