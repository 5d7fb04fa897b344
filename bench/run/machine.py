"""States of a run and the edges between them; the work of each state is in `bench.run.states`.

The order of calls, for a step that moves the stage: `Steps` (`bench.run.steps`) fires the trigger ``slew``. The machine
tells the `Runner` (`bench.run.runner`), which writes ``entering`` into the journal. It changes the state
and calls ``on_enter``, `StateWork.slewing` (`bench.run.states`), which moves the stage. Last, it tells the `Runner`.

Only the edges in ``EDGES`` exist; none is automatic. The work runs in ``on_enter``: if it raises, the machine stays in
that state. A change is journaled before it is made, its outcome in ``finalize_event``, which comes also after an
exception.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Literal, Unpack, cast, get_args

from bench.record.events import Circumstances, Entering, LeftOff

if TYPE_CHECKING:
    from transitions import EventData

    from bench.plan.job import ScriptStep

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
MAX_HOLD_S = 8 * 3600.0
"""A run that an operator holds for longer than this, a working day, is aborted safely, s."""

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


class RunMachine:
    """The state machine of one run; ``entering`` hears of every change before it is made, ``left_off`` how it ended.

    ``on_enter`` is the work of each state that has any, called with the step, the causes, and, by name, circumstances.
    """

    def __init__(
        self,
        on_enter: Mapping[State, Callable[..., None]],
        entering: Callable[[Entering], None],
        left_off: Callable[[LeftOff], None],
    ) -> None:
        self.state: State = "idle"
        self._entering, self._left_off = entering, left_off
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
        step: ScriptStep | None = None,
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
        step: ScriptStep | None = next(iter(event.args), None)
        number = {} if step is None else {"step": step.number}
        self._entering(
            cast("Entering", {"state": event.transition.dest, "from": self.state, **number, **event.kwargs})
        )

    def _conclude(self, event: EventData) -> None:
        if event.transition is None:  # there is no such edge; nothing was journaled
            return
        facts: LeftOff = {"state": self.state}
        if event.error is not None:
            facts["error"] = f"{type(event.error).__name__}: {event.error}"
        try:
            self._left_off(facts)
        except Exception as error:  # noqa: BLE001 - `transitions` would only log it; `fire` raises it
            self._unwritten = error
