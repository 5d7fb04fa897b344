"""The states of a run and the edges between them; the work of each state stands in `bench.run.state_work`.

One `transitions` machine without automatic transitions: only the edges in ``EDGES`` exist. The work of a
state runs in its ``on_enter``; an exception there leaves the machine in the state that failed (so the state
always names the work that was going on), and only ``abort`` and ``fail`` lead on. The intent of every change is
journaled before it, its outcome in ``finalize_event``, which `transitions` runs even after an exception.
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
    "backing_off",
    "waiting",
    "holding",
    "parking",
)
"""States whose work, once done, leaves the bench ready for the next step of the script."""

STATES = (
    "idle", "preflight", "homing", "lighting", "slewing", "settling", "recording", "checking", "backing_off",
    "waiting", "holding", "recovering", "parking", "solving", "reporting", "finished", "aborting", "aborted", "failed",
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
    ("park", READY, "parking"),
    ("solve", (*READY, "solving"), "solving"),
    ("report", (*READY, "solving", "reporting"), "reporting"),
    ("finish", (*READY, "solving", "reporting"), "finished"),
    ("abort", _BUSY, "aborting"),
    ("abort_done", ("aborting",), "aborted"),
    ("fail", (*_BUSY, "aborting"), "failed"),
)
"""(trigger, states it leaves, state it enters)."""

Work = Callable[..., None]
"""The work of a state: called with the step, the causes, and the circumstances by name."""


class Numbered(Protocol):
    """A step of a script, as far as the machine is concerned."""

    @property
    def number(self) -> int:
        """Number of the step in the script, from 1."""
        ...


class Listener(Protocol):
    """Takes note of every change of state; the journal, first of all."""

    def entering(self, data: Entering) -> None:
        """Take note of a change before it is made."""
        ...

    def left_off(self, data: LeftOff) -> None:
        """Take note that the work of a state has ended, well or not."""
        ...


class RunMachine:
    """The state machine of one run.

    Parameters
    ----------
    work
        What to do on entering a state, by state name.
    listener
        Takes note of a change before it is made, and when its work has ended.

    Raises
    ------
    ValueError
        When work is given for a state that does not exist.
    """

    def __init__(self, work: Mapping[str, Work], listener: Listener) -> None:
        self.state = "idle"
        self._listener = listener
        self._work = work
        unknown = set(work) - set(STATES)
        if unknown:
            raise ValueError(f"no such states: {sorted(unknown)}")
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
        """Take an edge and do the work of the state it leads to.

        Parameters
        ----------
        trigger
            Name of the edge.
        step
            The step of the script that the edge is taken for. The work is given the step; the journal, its number.
        causes
            Given to the work alone.
        circumstances
            Given to work and journal.

        Raises
        ------
        transitions.MachineError
            When there is no such edge from the present state.
        Exception
            Whatever the work raises, or the journal; the machine then stays in the state whose work failed.
        """
        self._unwritten: Exception | None = None
        self.trigger(trigger, step, *causes, **circumstances)  # type: ignore[attr-defined]
        if self._unwritten is not None:
            raise self._unwritten

    def can(self, trigger: str) -> bool:
        """Whether that edge leaves the present state."""
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
        if event.transition is None:  # refused: no such edge, nothing was intended
            return
        facts: LeftOff = {"state": self.state}
        if event.error is not None:
            facts["error"] = f"{type(event.error).__name__}: {event.error}"
        try:
            self._listener.left_off(facts)
        except Exception as error:  # noqa: BLE001 - `transitions` would only log it; `fire` raises it
            self._unwritten = error
