"""The states of a run and the edges between them; what is done in a state is the runner's business.

One `transitions` machine without automatic transitions: only the edges in ``EDGES`` exist. The work of a
state runs in its ``on_enter``; an exception there leaves the machine in the state that failed (so the state
never lies about what was going on), and only ``abort`` and ``fail`` lead on. The intent of every change is
told to the journal before it, its outcome in ``finalize_event``, which `transitions` runs even after an exception.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from transitions import EventData, Machine

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

Tell = Callable[[str, Mapping[str, Any]], None]
Work = Callable[..., None]


class RunMachine:
    """The state machine of one run.

    Parameters
    ----------
    work
        What to do on entering a state, by state name; called with the keyword arguments of ``fire``.
    tell
        Called with ("entering", facts) before a change and ("left_off", facts) when its work has ended, well
        or not.
    """

    def __init__(self, work: Mapping[str, Work], tell: Tell) -> None:
        self.state = "idle"
        self._tell = tell
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

    def fire(self, trigger: str, **facts: Any) -> None:
        """Take an edge and do the work of the state it leads to.

        Raises
        ------
        transitions.MachineError
            When there is no such edge from the present state.
        Exception
            Whatever the work raises, or the telling; the machine then stays in the state whose work failed.
        """
        self._untold: Exception | None = None
        self.trigger(trigger, **facts)  # type: ignore[attr-defined]
        if self._untold is not None:
            raise self._untold

    def can(self, trigger: str) -> bool:
        """Whether that edge leaves the present state."""
        return trigger in self._machine.get_triggers(self.state)

    def _intend(self, event: EventData) -> None:
        assert event.transition is not None
        self._tell("entering", {"state": event.transition.dest, "from": self.state, **event.kwargs})

    def _run_work(self, event: EventData) -> None:
        work = self._work.get(self.state)
        if work is not None:
            work(**event.kwargs)

    def _conclude(self, event: EventData) -> None:
        if event.transition is None:  # refused: no such edge, nothing was intended
            return
        facts: dict[str, Any] = {"state": self.state}
        if event.error is not None:
            facts["error"] = f"{type(event.error).__name__}: {event.error}"
        try:
            self._tell("left_off", facts)
        except Exception as error:  # noqa: BLE001 - `transitions` would only log it; `fire` raises it
            self._untold = error
