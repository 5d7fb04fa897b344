"""States of a run and the edges between them; the work of each state is in `bench.run.states`.

One `transitions` machine without automatic transitions: only the edges in ``EDGES`` exist. The work of a state runs
in ``on_enter``. If it raises, the machine stays in that state, so the state always names the work that failed; only
``abort`` and ``fail`` leave it. Every change is journaled before it is made. Its outcome is journaled in
``finalize_event``, which `transitions` calls also after an exception.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, Unpack, cast

from transitions import EventData, Machine

from bench.records.events import Circumstances, Entering, LeftOff

READY = (
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

STATES = (
    "idle", "preflight", "homing", "lighting", "slewing", "settling", "recording", "checking", "choosing",
    "backing_off", "waiting", "holding", "recovering", "parking", "solving", "reporting", "finished", "aborting",
    "aborted", "failed",
)  # fmt: skip

END_STATES = ("finished", "aborted", "failed")

_BUSY = tuple(s for s in STATES if s not in {*END_STATES, "aborting"})

EDGES: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("recover", ("idle",), "recovering"),
    ("preflight", ("idle", "recovering", "checking", "holding"), "preflight"),
    ("home", ("preflight",), "homing"),
    ("set_light", READY, "lighting"),
    ("slew", READY, "slewing"),
    ("settle", READY, "settling"),
    ("record", (*READY, "recording"), "recording"),
    ("check", ("recording", "recovering", "checking"), "checking"),
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

Work = Callable[..., None]
"""Work of a state: called with the step, the causes, and the circumstances by name."""


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
        """Receive the end of the work of a state, successful or not.

        data: The state, and the error if the work failed.
        """
        ...


class RunMachine:
    """The state machine of one run.

    work: Work to do on entering a state, by the state's name.
    listener: Receives every change before it is made, and the end of its work.
    Raises ValueError: If work is given for a state that does not exist.
    """

    def __init__(self, work: Mapping[str, Work], listener: Listener) -> None:
        self.state = "idle"
        self._listener = listener
        self._work = work
        unknown = set(work) - set(STATES)
        if unknown:
            raise ValueError(f"unknown states: {sorted(unknown)}")
        self._machine = Machine(
            model=self,
            states=list(STATES),
            initial="idle",
            transitions=[
                {"trigger": trigger, "source": list(sources), "dest": target}
                for trigger, sources, target in EDGES
            ],
            auto_transitions=False,
            send_event=True,
            before_state_change=self._intend,
            after_state_change=self._run_work,
            finalize_event=self._conclude,
        )

    def fire(
        self, trigger: str, step: Numbered | None = None, *causes: Any, **circumstances: Unpack[Circumstances]
    ) -> None:
        """Take an edge and do the work of the state that it enters.

        causes: Passed to the work only.
        Raises transitions.MachineError: If the present state has no such edge.
        """
        self._unwritten: Exception | None = None
        self.trigger(trigger, step, *causes, **circumstances)  # type: ignore[attr-defined]
        if self._unwritten is not None:
            raise self._unwritten

    def can(self, trigger: str) -> bool:
        """Return whether an edge leaves the present state.

        Returns: True if it does.
        """
        return trigger in self._machine.get_triggers(self.state)

    def _intend(self, event: EventData) -> None:
        assert event.transition is not None
        step: Numbered | None = next(iter(event.args), None)
        number = {} if step is None else {"step": step.number}
        self._listener.entering(
            cast("Entering", {"state": event.transition.dest, "from": self.state, **number, **event.kwargs})
        )

    def _run_work(self, event: EventData) -> None:
        work = self._work.get(self.state)
        if work is not None:
            work(*event.args, **event.kwargs)

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
