"""Moves of the stage by a person: small steps within the limits, homing, and a stop that waits for nothing.

One thread does the moves; `StageControl.stop` sends the stop on the caller's own thread and drops what waits.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from bench.base.errors import ControlRefused
from bench.base.failure import Failure
from bench.extras.pages.align.figure_rows import FigureRow
from drivers.errors import DriverError, ReplyError
from drivers.stage import Stage

LARGEST_STEP_DEG = 5.0
"""Largest step of one axis, degrees. A person looks at the picture while the camera turns; long ways are for runs."""
_SAME_DEG = 0.01
"""If counter and goal are nearer than this, the next step begins at the goal, so that rounding does not add up."""
_STOP_AGAIN_S = 0.03  # After this the stop is sent again: one that is lost costs no more
_STOP_WAIT_S = 2.0  # Longer than a query of a slow controller

Work = Literal["move", "home"]


@dataclass(frozen=True)
class StageState:
    """What is known of the stage."""

    # Last reading of the counters by axis, degrees; empty before the first one.
    position_deg: Mapping[str, float] = field(default_factory=dict)
    # Where the axes are going, or went last, degrees.
    goal_deg: Mapping[str, float] = field(default_factory=dict)
    homed: bool | None = None  # Whether every axis has a reference; None before it was asked
    work: Work | None = None  # ``move`` or ``home`` while the stage moves; None at rest
    faults: tuple[str, ...] = ()
    failure: Failure | None = None  # Why the last motion failed; None if nothing is wrong


class StageControl:
    """A stage in the hands of a person."""

    def __init__(self, stage: Stage, on_change: Callable[[], None]) -> None:
        self._stage = stage
        self._on_change = on_change
        self._lock = threading.Lock()
        self._wake = threading.Condition(self._lock)
        self._state = StageState()
        self._wanted: dict[str, float] = {}
        self._home_wanted = False
        self._generation = 0
        """How often the stage was stopped. A move of an earlier generation must not go on."""
        self._running: int | None = None
        """Generation of the move at work; None where there is none."""
        self._closing = False
        self._silent: Failure | None = None
        """Why the stage does not answer; None while it does."""
        self._thread = threading.Thread(target=self._work, name="align-stage", daemon=True)
        self._thread.start()

    @property
    def moving(self) -> bool:
        """Whether the stage moves, or is about to."""
        return self._state.work is not None

    def known_deg(self) -> Mapping[str, float]:
        """Return the present angles, degrees by axis; empty while the stage is not homed."""
        return self._state.position_deg if self._state.homed else {}

    def row(self) -> FigureRow:
        """Return what the stage does, for the page."""
        state = self._state
        words = "at rest"
        if self._silent is not None:
            words = "does not answer"
        elif state.work is not None:
            words = "homing" if state.work == "home" else "turning"
        elif state.homed is False:
            words = "not homed"
        elif state.faults:
            words = "; ".join(state.faults)
        return FigureRow(
            "Stage", words, expected="at rest", good=words == "at rest" and state.failure is None
        )

    def as_data(self) -> dict[str, Any]:
        """Return the state as the page shows it: plain values; an entry an axis in ``axes``."""
        state, limits = self._state, self._stage.limits
        failure = self._silent or state.failure
        axes = [
            {
                "name": name,
                "position_deg": state.position_deg.get(name),
                "goal_deg": state.goal_deg.get(name),
                "lowest_deg": limits[name].lowest_deg,
                "highest_deg": limits[name].highest_deg,
            }
            for name in self._stage.axes
        ]
        return {
            "axes": axes,
            "homed": state.homed,
            "work": state.work,
            "answers": self._silent is None,
            "failure": failure.to_dict() if failure else None,
        }

    # ------------------------------------------------------------------ what a person asks for

    def move_by(self, steps_deg: Mapping[str, float]) -> dict[str, float]:
        """Turn axes by small steps, added to the goal; return each goal, degrees, at once.

        `ControlRefused`, and nothing moves, if a goal lies outside the limits or the stage cannot move now.
        """
        self._check_steps(steps_deg)
        if not self.moving:
            self.look()
        with self._lock:
            state = self._state
            if self._closing:
                raise ControlRefused("The stage is being closed.", remedy="Start align again.")
            if state.homed is False:
                raise ControlRefused(
                    "The stage is not homed, so its angles are not known. Nothing was moved.",
                    where="stage",
                    remedy="Press Home first. Homing turns the axes over a large part of their range.",
                )
            if state.work == "home":
                raise ControlRefused(
                    "The stage is homing. Nothing was added.", where="stage", remedy="Wait, or press STOP."
                )
            goals = {name: self._goal(name, step) for name, step in steps_deg.items()}
            self._wanted |= goals
            self._set(goal_deg={**state.goal_deg, **goals}, work="move", failure=None)
            self._wake.notify_all()
        self._on_change()
        return goals

    def home(self) -> None:
        """Search the references of all axes, also after the return; refused if the stage moves."""
        with self._lock:
            if self._state.work is not None or self._closing:
                raise ControlRefused(
                    "The stage moves. Homing was not started.", where="stage", remedy="Wait, or press STOP."
                )
            self._home_wanted = True
            self._set(goal_deg={}, work="home", failure=None)
            self._wake.notify_all()
        self._on_change()

    def stop(self) -> None:
        """Stop all axes now, on this thread, and drop every move that waits. For any thread, at any time."""
        try:
            self._stop()
        except DriverError as error:
            failure = Failure.of(error)
            what = f"CHECK THE BENCH: the stage did not confirm its stop. {failure.what}"
            with self._lock:
                self._set(failure=replace(failure, what=what))
            raise
        finally:
            self._on_change()

    def _stop(self) -> None:
        with self._lock:
            self._generation = generation = self._generation + 1
            self._wanted.clear()
            self._home_wanted = False
            if self._running is None:
                self._set(work=None, goal_deg={})

        def has_ended() -> bool:
            return self._running is None or self._running >= generation

        self._stage.stop()
        # A move that the working thread was just starting began after that stop: it is stopped again.
        end_s = time.monotonic() + _STOP_WAIT_S
        while not has_ended() and time.monotonic() < end_s:
            with self._wake:
                ended = self._wake.wait_for(has_ended, _STOP_AGAIN_S)
            if not ended:
                self._stage.stop()

    # ------------------------------------------------------------------ what is read

    def look(self, *, thoroughly: bool = True) -> None:
        """Read position, and if ``thoroughly`` reference and faults too: not possible while the stage moves."""
        try:
            position_deg = dict(self._stage.position_deg())
        except ReplyError:
            if self.moving:  # while it turns, two readings need not agree
                return
            raise
        read: dict[str, Any] = {"position_deg": position_deg}
        if thoroughly and not self.moving:
            read |= {"homed": self._stage.is_homed(), "faults": tuple(self._stage.faults())}
        with self._lock:
            self._set(**read)

    def look_safely(self, *, thoroughly: bool) -> None:
        """Read as `look` does; a stage that does not answer becomes the state's failure."""
        silent = None
        try:
            self.look(thoroughly=thoroughly)
        except DriverError as error:
            silent = Failure.of(error)
        self._silent = silent

    def close(self) -> None:
        """End the working thread. The stage must have been stopped before."""
        with self._lock:
            self._closing = True
            self._wake.notify_all()
        self._thread.join(timeout=_STOP_WAIT_S)

    # ------------------------------------------------------------------ inside

    def _check_steps(self, steps_deg: Mapping[str, float]) -> None:
        for name, step in steps_deg.items():
            if name not in self._stage.axes:
                known = ", ".join(self._stage.axes)
                raise ControlRefused(
                    f"The stage has no axis {name!r}.", where="stage", remedy=f"It has {known}."
                )
            if not 0 < abs(step) <= LARGEST_STEP_DEG:
                raise ControlRefused(
                    f"A step of {step:g} deg is not possible. Nothing was moved.",
                    where=name,
                    remedy=f"Give a step of at most {LARGEST_STEP_DEG:g} deg, other than 0.",
                )

    def _goal(self, name: str, step_deg: float) -> float:
        """Return where a step leads. Raises ControlRefused outside the limits."""
        state, limits = self._state, self._stage.limits[name]
        now_deg, goal_deg = state.position_deg.get(name), state.goal_deg.get(name)
        start_deg = now_deg
        if goal_deg is not None and (state.work or now_deg is None or abs(goal_deg - now_deg) < _SAME_DEG):
            start_deg = goal_deg
        if start_deg is None:
            raise ControlRefused(
                "The position is not known yet. Nothing was moved.", where=name, remedy="Try again."
            )
        goal = round(start_deg + step_deg, 6)
        if not limits.lowest_deg <= goal <= limits.highest_deg:
            limit = limits.highest_deg if step_deg > 0 else limits.lowest_deg
            room = max(0.0, (limit - start_deg) * (1 if step_deg > 0 else -1))
            raise ControlRefused(
                f"{name} is at {start_deg:.3f} deg and its limit is {limit:g} deg. Nothing was moved.",
                where=name,
                remedy=f"Give a step of at most {room:.3f} deg in this direction, or turn the other way.",
            )
        return goal

    def _set(self, **changes: Any) -> None:
        """Change the state; the lock is held."""
        self._state = replace(self._state, **changes)

    def _work(self) -> None:
        """Do what is wanted, until the control is closed."""
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._closing or self._home_wanted or self._wanted)
                if self._closing:
                    return
                home, goals, generation = self._home_wanted, dict(self._wanted), self._generation
                self._home_wanted = False
                self._wanted.clear()
                self._running = generation
            failure = self._do(home=home, goals_deg=goals, generation=generation)
            with self._wake:
                self._running = None
                if failure is not None:
                    self._wanted.clear()
                    self._set(goal_deg={}, failure=failure)
                elif self._generation != generation and not self._wanted:
                    self._set(goal_deg={})
                if not self._wanted and not self._home_wanted:
                    self._set(work=None)
                self._wake.notify_all()
            self.look_safely(thoroughly=True)
            self._on_change()

    def _do(self, *, home: bool, goals_deg: Mapping[str, float], generation: int) -> Failure | None:
        """Make one move; return why it failed. A stop on request is no failure."""
        try:
            if generation != self._generation:
                return None
            if home:
                self._stage.home()
            else:
                self._stage.move_to(goals_deg)
        except DriverError as error:
            return Failure.of(error) if generation == self._generation else None
        return None
