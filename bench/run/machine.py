"""States of a run and the edges between them; the work of each state is in `bench.run.states`.

Only the edges in ``EDGES`` exist; none is automatic. The work runs in ``on_enter``: if it raises, the machine stays in
that state. A change is journaled before it is made, its outcome in ``finalize_event``, which comes also after an
exception.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any, Literal, Protocol, Unpack, cast, get_args

from bench.record.events import Circumstances, Entering, Event, LeftOff
from bench.record.history import History
from bench.record.journal_line import Entry
from sequences.script import PromptStep, SettleStep, WaitStep

if TYPE_CHECKING:
    from transitions import EventData

_LEAST_STEPS = 3
_SMALLEST, _LARGEST = 0.5, 50.0
_FIXED = frozenset(step.word for step in (PromptStep, WaitStep, SettleStep))
"""Steps that take the time that the sequence states, on any bench."""


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

    def apply(self, entry: Entry, history: History) -> None:
        """Follow one line of the journal."""
        if entry.event in {Event.STEP_DONE, Event.RUN_STARTED, Event.RUN_RESUMED}:
            self._mark_utc = entry.utc
        if entry.event == Event.STEP_DONE:
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
        """Return the time left, s, scaled by the steps so far; it does not pass while the run is held."""
        left_s = self._scaled_s(self._duration_s, self._fixed_s)
        if held or not self._mark_utc:
            return left_s
        since_s = (now - datetime.fromisoformat(self._mark_utc)).total_seconds()
        return max(0.0, left_s - max(0.0, since_s))

    def left_at_step_s(self, step: int) -> float:
        """Return the planned time from the last step done to the begin of a later step, scaled, s."""
        own_s = self._planned_s.get(step, 0.0)
        fixed_s = self._fixed_after_s.get(step, 0.0) - (own_s if step in self._fixed else 0.0)
        return self._scaled_s(self._after_s.get(step, 0.0) - own_s, fixed_s)

    @property
    def pace(self) -> float:
        """What the steps so far took, divided by what was planned for them; 1 at the begin."""
        if self._counted < _LEAST_STEPS or self._counted_s <= 0:
            return 1.0
        return min(max(self._took_s / self._counted_s, _SMALLEST), _LARGEST)

    def next_of(self, numbers: Sequence[int], done: set[int]) -> int | None:
        """Return the first of some steps, in order, that is still to come; None if none is."""
        return next((n for n in numbers if n not in done and self._after_s.get(n, 0.0) > self._begun_s), None)


State = Literal[
    "idle", "preflight", "homing", "lighting", "slewing", "settling", "recording", "checking", "choosing",
    "backing_off", "waiting", "holding", "recovering", "parking", "solving", "reporting", "finished", "aborting",
    "aborted", "failed",
]  # fmt: skip
STATES: tuple[State, ...] = get_args(State)
Trigger = Literal[
    "recover", "preflight", "home", "set_light", "slew", "settle", "record", "check", "back_off", "wait", "hold",
    "choose", "park", "solve", "report", "finish", "abort", "abort_done", "fail",
]  # fmt: skip

READY: tuple[State, ...] = (
    "homing",
    "recovering",
    "lighting",
    "slewing",
    "settling",
    "checking",
    "choosing",
    "backing_off",
    "waiting",
    "holding",
    "parking",
)
"""States whose work, once done, leaves the bench ready for the next step of the script."""

END_STATES: tuple[State, ...] = ("finished", "aborted", "failed")

_BUSY = tuple(s for s in STATES if s not in {*END_STATES, "aborting"})

EDGES: tuple[tuple[Trigger, tuple[State, ...], State], ...] = (
    ("recover", ("idle",), "recovering"),
    ("preflight", ("idle", "recovering", "checking", "holding"), "preflight"),
    ("home", ("preflight",), "homing"),
    ("set_light", READY, "lighting"),
    ("slew", (*READY, "recording"), "slewing"),
    ("settle", (*READY, "recording"), "settling"),
    ("record", (*READY, "recording"), "recording"),
    ("check", (*READY, "recording"), "checking"),
    ("back_off", ("recording", "checking"), "backing_off"),
    ("wait", READY, "waiting"),
    ("hold", (*READY, "idle", "preflight", "recording"), "holding"),
    ("choose", READY, "choosing"),
    ("park", READY, "parking"),
    ("solve", (*READY, "solving"), "solving"),
    ("report", (*READY, "solving", "reporting"), "reporting"),
    ("finish", (*READY, "solving", "reporting"), "finished"),
    ("abort", _BUSY, "aborting"),
    ("abort_done", ("aborting",), "aborted"),
    ("fail", (*_BUSY, "aborting"), "failed"),
)
"""(trigger, states that it leaves, state that it enters)."""


class Numbered(Protocol):
    """A step of a script; the machine needs only its number."""

    @property
    def number(self) -> int:
        """Number of the step in the script, from 1."""
        ...


class Listener(Protocol):
    """Receives every change of state; the run's journal is the main one."""

    def entering(self, data: Entering) -> None:
        """Receive a change before it is made."""
        ...

    def left_off(self, data: LeftOff) -> None:
        """Receive the end of the work of a state, successful or not."""
        ...


class RunMachine:
    """The state machine of one run; ``listener`` receives every change before it is made, and the end of its work.

    ``on_enter`` is the work of each state that has any, called with the step, the causes, and, by name, circumstances.
    """

    def __init__(self, on_enter: Mapping[State, Callable[..., None]], listener: Listener) -> None:
        self.state: State = "idle"
        self._listener = listener
        import transitions  # here, because `status` needs the states alone

        def entered(work: Callable[..., None]) -> Callable[[EventData], None]:
            return lambda event: work(*event.args, **event.kwargs)

        works = {name: entered(work) for name, work in on_enter.items()}

        self._machine = transitions.Machine(
            model=self,
            states=[transitions.State(name, on_enter=works.get(name)) for name in STATES],
            initial="idle",
            transitions=[
                {"trigger": trigger, "source": list(sources), "dest": target}
                for trigger, sources, target in EDGES
            ],
            auto_transitions=False,
            send_event=True,
            before_state_change=self._intend,
            finalize_event=self._conclude,
        )

    def fire(
        self,
        trigger: Trigger,
        step: Numbered | None = None,
        *causes: Any,
        **circumstances: Unpack[Circumstances],
    ) -> None:
        """Take an edge, which must leave the present state, and do the work of the state that it enters."""
        self._unwritten: Exception | None = None
        self.trigger(trigger, step, *causes, **circumstances)  # type: ignore[attr-defined]
        if self._unwritten is not None:
            raise self._unwritten

    def can(self, trigger: Trigger) -> bool:
        """Return whether an edge leaves the present state."""
        return trigger in self._machine.get_triggers(self.state)

    def _intend(self, event: EventData) -> None:
        assert event.transition is not None
        step: Numbered | None = next(iter(event.args), None)
        number = {} if step is None else {"step": step.number}
        self._listener.entering(
            cast("Entering", {"state": event.transition.dest, "from": self.state, **number, **event.kwargs})
        )

    def _conclude(self, event: EventData) -> None:
        if event.transition is None:  # there is no such edge; nothing was journaled
            return
        facts: LeftOff = {"state": self.state}
        if event.error is not None:
            facts["error"] = f"{type(event.error).__name__}: {event.error}"
        try:
            self._listener.left_off(facts)
        except Exception as error:  # noqa: BLE001 - `transitions` would only log it; `fire` raises it
            self._unwritten = error
