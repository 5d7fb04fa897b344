"""Watch every move of a stage to its end, for controllers of all makes: limits, start, arrival, stop.

A driver of a controller family implements the abstract methods, which talk on its wire. The decisions whether a move
has arrived or failed are made here, once for all families. This module implements no protocol.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from drivers.agreed_reading import Reading, read_position_until_agreed
from drivers.clock import Clock
from drivers.errors import (
    DriverError,
    MoveFailed,
    MoveTimeout,
    NotHomed,
    PortLost,
    ReplyError,
    WrongDevice,
)
from drivers.serial_number import is_same_serial
from drivers.serial_port import OnOnePort, Port, closed_on_error
from drivers.stage import AxisIdentity, AxisLimits, motion
from drivers.stage.motion import A, MoveWatch
from drivers.stage.refusals import HOME_FIRST, no_reference
from drivers.wire_log import WireLog

_STOP_POLL_S = 0.02  # A few answers at 9600 baud
_SAME_DEG = 1e-9
"""Angles that differ by less are one angle, in degrees: no controller counts so finely."""
_CLEAR_AND_RESUME = "Clear the cause, then home the stage and resume."

StopCheck = Callable[[], None]
"""Raises MoveFailed when ``stop`` was called since the move began.

A driver calls it with the line's lock held, and keeps the lock until its command is out. A stop then either comes
before the command, which is not sent, or after it, and stops what the command has started.
"""
L = TypeVar("L", bound="AxisLine")


class AxisLine(Protocol):
    """What the watch of a move needs of the line to an axis, or of a maker's library: `drivers.link.Link` has it."""

    @property
    def lock(self) -> AbstractContextManager[Any]:
        """While a thread holds it, no other thread can command the axis."""

    def listen(self, duration_s: float) -> None:
        """Wait, not longer than this; no clock of a run interrupts it."""

    def close(self) -> None:
        """Let the device go. A second call does nothing."""


class AxisState(NamedTuple):
    """State of an axis; all values of one moment, as far as the protocol allows."""

    position_deg: float  # Position, in degrees
    busy: bool  # Whether the axis moves
    problem: str = ""  # Why the present move will not end at its target; empty while nothing is wrong
    # Whether the position is still known after that problem, as after another command or a hold.
    position_kept: bool = False


class WatchedStage(ABC, Generic[A]):
    """A stage whose every move is watched to its end. Implements ``drivers.stage.Stage``.

    ``axes`` are in the order of the station file; every wait between two requests goes through ``clock``; ``where`` is
    the name of the line, for messages.
    """

    def __init__(self, axes: Sequence[A], *, clock: Clock, where: str) -> None:
        self._axes = {axis.name: axis for axis in axes}
        self._lines: Mapping[str, AxisLine] = {}
        """The line of each axis; axes may share one."""
        self._clock = clock
        self._where = where
        self._stops = 0
        self._position_doubt = ""
        """Why the position is in doubt; empty while it is known."""
        self._homed_in: Any = None  # `_lifetime` of the controller at the last homing by this driver
        self._rest_deg: dict[str, float] = {}
        """Where this driver has left each axis, degrees; without axes that it has stopped."""

    # ------------------------------------------------------------ what a family implements

    def identify(self) -> Sequence[AxisIdentity]:
        """See `Stage.identify`."""
        return tuple(self._identity_of(axis) for axis in self._axes.values())

    def _identity_of(self, axis: A) -> AxisIdentity:
        """Ask one axis for its identity; a family that asks its controller for all axes has its own ``identify``."""
        raise NotImplementedError(axis.name)

    @abstractmethod
    def _has_reference(self) -> bool:
        """Whether every axis has a reference, as far as the controller reports it."""

    def _lifetime(self) -> object:
        """Return what changes when a controller loses its reference that does not report whether it has one."""
        return True

    def _was_homed(self) -> bool:
        """Whether this driver has homed the controller in its present lifetime."""
        return self._homed_in is not None and self._homed_in == self._lifetime()

    def faults(self) -> Sequence[str]:
        """See `Stage.faults`."""
        return [f"{name}: {fault}" for name, axis in self._axes.items() for fault in self._faults_of(axis)]

    def _faults_of(self, axis: A) -> list[str]:
        """Ask for the faults of one axis; a family that asks for those of all axes at once has its own ``faults``."""
        raise NotImplementedError(axis.name)

    @abstractmethod
    def _check_ready(self, axis: A) -> None:
        """Check that an axis may be moved; raise NotHomed or MoveFailed when it may not. Sends no command."""

    @abstractmethod
    def _clear_faults(self, axis: A) -> None:
        """Clear the faults that can be cleared before homing; raise MoveFailed for those that remain."""

    @abstractmethod
    def _begin_move(self, axis: A, angle_deg: float) -> None:
        """Start the move of one axis, with the line's lock held."""

    @abstractmethod
    def _begin_homing(self, axis: A) -> None:
        """Start the search of one reference, with the line's lock held."""

    def _homing_speed_deg_s(self, axis: A) -> float | None:  # noqa: ARG002 - many controllers do not tell it
        """Ask for the speed of a search of the reference; None if the controller does not tell it."""
        return None

    def _reachable_deg(self, axis: A, angle_deg: float) -> float:
        """Return the angle nearest to a target that the controller can count, within the limits, in degrees."""
        nearest_deg = axis.to_angle_deg(axis.to_counts(angle_deg))
        if nearest_deg < axis.limits.lowest_deg - _SAME_DEG:
            return nearest_deg + 1.0 / abs(axis.scale)
        if nearest_deg > axis.limits.highest_deg + _SAME_DEG:
            return nearest_deg - 1.0 / abs(axis.scale)
        return nearest_deg

    def _start(self, goals_deg: Mapping[str, float], check_not_stopped: StopCheck) -> None:
        """Start moves; call ``check_not_stopped`` before each command, with the line's lock held."""
        for name, angle_deg in goals_deg.items():
            with self._lines[name].lock:
                check_not_stopped()
                self._begin_move(self._axes[name], angle_deg)

    def _start_homing(self, check_not_stopped: StopCheck) -> None:
        """Start the search of all references; ``check_not_stopped`` as for ``_start``."""
        for name, axis in self._axes.items():
            with self._lines[name].lock:
                check_not_stopped()
                self._begin_homing(axis)

    @abstractmethod
    def _read_state(self, axis: A, *, homing: bool = False) -> AxisState:
        """Read the state of one axis."""

    def _read_final_state(self, axis: A, *, homing: bool) -> AxisState:
        """Read the state after a move, with everything that the controller reports against the move."""
        return self._read_state(axis, homing=homing)

    def _finish_homing(self, axis: A) -> None:
        """Do what remains once an axis stands at its reference; most controllers need nothing."""

    @abstractmethod
    def _send_stop(self) -> None:
        """Stop all axes at once, without resynchronising, and check that the controller received the stop."""

    def _what_says_busy(self) -> str:
        """Return what a stage that stays busy answers, as the end of a sentence; empty where busy has one meaning."""
        return ""

    def _read_encoder(self, axis: A) -> AxisState | None:  # noqa: ARG002 - most controllers have none
        """Read the encoder of an axis; None when it has none."""
        return None

    # ------------------------------------------------------------ state

    @property
    def axes(self) -> Sequence[str]:
        """Names of the axes, in the order of the station file."""
        return tuple(self._axes)

    @property
    def limits(self) -> Mapping[str, AxisLimits]:
        """Soft limits, by axis."""
        return {name: axis.limits for name, axis in self._axes.items()}

    def close(self) -> None:
        """See `Stage.close`."""
        for line in dict.fromkeys(self._lines.values()):
            line.close()

    def is_homed(self) -> bool:
        """See `Stage.is_homed`. An axis that stands elsewhere than this driver has left it has no reference."""
        if self._position_doubt or not self._has_reference():
            return False
        return not any(map(self._displaced, self._axes.values()))

    def move_duration_s(self, from_deg: Mapping[str, float], to_deg: Mapping[str, float]) -> float:
        """See `Stage.move_duration_s`."""
        return motion.longest_move_s(self.limits, from_deg, to_deg)

    def position_deg(self) -> Mapping[str, float]:
        """See `Stage.position_deg`. Each counter is read until two readings agree."""
        return {name: self._agreed_position_deg(axis, self._read_state) for name, axis in self._axes.items()}

    def encoder_deg(self) -> Mapping[str, float]:
        """See `Stage.encoder_deg`. Each encoder is read until two readings agree."""
        with_encoder = [axis for axis in self._axes.values() if self._read_encoder(axis) is not None]
        return {axis.name: self._agreed_position_deg(axis, self._read_encoder) for axis in with_encoder}

    # ------------------------------------------------------------ moves

    def home(self) -> None:
        """See `Stage.home`. Clears the faults that can be cleared, after checking the serial numbers."""
        check_not_stopped = self._new_stop_check()
        self.identify()
        allowed_s = {}
        for name, axis in self._axes.items():
            self._clear_faults(axis)
            allowed_s[name] = motion.longest_homing_s(axis, self._homing_speed_deg_s(axis))
        self._position_doubt = self._position_doubt or "homing did not end"
        try:
            self._homed_in = None
            self._start_homing(check_not_stopped)
            self._watch(dict.fromkeys(self._axes), allowed_s, check_not_stopped)
            for axis in self._axes.values():
                self._finish_homing(axis)
            self._position_doubt, self._homed_in = "", self._lifetime()
            self._rest_deg = {name: self._read_state(axis).position_deg for name, axis in self._axes.items()}
        except DriverError as error:
            raise self._stopped_after(error) from error

    def move_to(self, target_deg: Mapping[str, float]) -> None:
        """See `Stage.move_to`."""
        motion.check_targets(self.limits, target_deg, self._where)
        if not target_deg:
            return
        check_not_stopped = self._new_stop_check()
        moving = [self._axes[name] for name in target_deg]
        start_deg = {axis.name: self._standing_deg(axis) for axis in moving}
        goal_deg = {axis.name: self._reachable_deg(axis, target_deg[axis.name]) for axis in moving}
        for name in goal_deg:
            self._rest_deg.pop(name, None)
        try:
            self._start(goal_deg, check_not_stopped)
            allowed_s = max(
                motion.deadline_s(axis.limits, start_deg[axis.name], goal_deg[axis.name]) for axis in moving
            )
            self._watch(goal_deg, dict.fromkeys(goal_deg, allowed_s), check_not_stopped)
            self._rest_deg |= goal_deg
        except DriverError as error:
            if isinstance(error, ReplyError | PortLost):  # nobody saw where the axes stopped
                self._position_doubt = self._position_doubt or error.what
            raise self._stopped_after(error) from error

    def stop(self) -> None:
        """See `Stage.stop`. Returns when all axes stand; no clock interrupts it."""
        self._stops += 1
        self._rest_deg.clear()
        self._send_stop()
        ramp_s = max(limit.speed_deg_s / limit.acceleration_deg_s2 for limit in self.limits.values())
        for _ in range(math.ceil((2.0 * ramp_s + 1.0) / _STOP_POLL_S)):
            if not any(self._read_state(axis).busy for axis in self._axes.values()):
                return
            next(iter(self._lines.values())).listen(_STOP_POLL_S)
        raise MoveTimeout(
            f"still busy after a stop{self._what_says_busy()}.",
            where=self._where,
            remedy="Cut the stage's power, if it moves.",
        )

    # ------------------------------------------------------------ inside

    def _share(self, line: L) -> L:
        """Note the line of all axes; return it."""
        self._lines = dict.fromkeys(self._axes, line)
        return line

    def _bring_to_rest(self) -> None:
        """Stop a stage that is moving when it is opened: no other program holds its port any more."""
        if any(self._read_state(axis).busy for axis in self._axes.values()):
            self.stop()

    def _require_serial(self, axis: A, serial: str, answers: str, *, where: str = "", remedy: str) -> None:
        """Raise WrongDevice unless the serial number is the one in the station file, if that has one."""
        if axis.serial and not is_same_serial(serial, axis.serial):
            raise WrongDevice(
                f"the station file names serial {axis.serial} for {axis.name}, but {answers}. Nothing was moved.",
                where=where or self._where,
                remedy=remedy,
            )

    def _new_stop_check(self) -> StopCheck:
        stops = self._stops

        def check_not_stopped() -> None:
            if self._stops != stops:
                raise MoveFailed(
                    "stopped on request.", where=self._where, remedy="Resume when it is safe to move."
                )

        return check_not_stopped

    def _standing_deg(self, axis: A) -> float:
        """Return the position of an axis at rest; raise unless the axis may be moved from there."""
        if self._position_doubt:
            raise NotHomed(
                f"the position is in doubt ({self._position_doubt}). Nothing was moved.",
                where=axis.name,
                remedy=HOME_FIRST,
            )
        self._check_ready(axis)
        state = self._read_state(axis)
        if state.busy:
            raise MoveFailed(
                "the axis is already moving, and this program has not started it. Nothing was sent.",
                where=axis.name,
                remedy="Find what moves it (a knob, another program), then resume.",
            )
        if displaced := self._displaced(axis):
            self._position_doubt = displaced
            raise no_reference(axis, displaced)
        return state.position_deg

    def _displaced(self, axis: A) -> str:
        """Return where an axis stands if not where this driver has left it, as after a restart; else empty."""
        rest_deg = self._rest_deg.get(axis.name, math.nan)
        position_deg = self._read_state(axis).position_deg
        if abs(position_deg - rest_deg) > axis.tolerance_deg:  # not where it is not known
            position_deg = self._agreed_position_deg(axis, self._read_state)
        if not abs(position_deg - rest_deg) > axis.tolerance_deg:
            return ""
        return (
            f"it was left at {rest_deg:.4f} deg and reads {position_deg:.4f} deg: the controller restarted, or"
            " something else moved the axis"
        )

    def _watch(
        self,
        goal_deg: Mapping[str, float | None],
        allowed_s: Mapping[str, float],
        check_not_stopped: StopCheck,
    ) -> None:
        """Watch moving axes until the last one has arrived; then look whether they stayed. None: a homing."""
        now_s = self._clock.monotonic()
        watches = [
            MoveWatch(self._axes[name], goal, now_s=now_s, allowed_s=allowed_s[name])
            for name, goal in goal_deg.items()
        ]
        while watches:
            self._clock.sleep(motion.POLL_S)
            watches = [watch for watch in watches if not self._has_arrived(watch, check_not_stopped)]
        for name, goal in goal_deg.items():
            self._check_end(self._axes[name], goal)

    def _has_arrived(self, watch: MoveWatch[A], check_not_stopped: StopCheck) -> bool:
        """Read the state of an axis and pass it to its watch; a failed move leaves the position in doubt."""
        check_not_stopped()
        state = self._read_state(watch.axis, homing=watch.target_deg is None)
        self._raise_problem(watch.axis, state)
        try:
            return watch.update(self._clock.monotonic(), state.position_deg, busy=state.busy)
        except (MoveFailed, MoveTimeout) as error:
            self._position_doubt = error.what
            raise

    def _raise_problem(self, axis: A, state: AxisState) -> None:
        if not state.problem:
            return
        if not state.position_kept:
            self._position_doubt = state.problem
        raise MoveFailed(f"{state.problem}.", where=axis.name, remedy=_CLEAR_AND_RESUME)

    def _check_end(self, axis: A, goal_deg: float | None) -> None:
        """Raise MoveFailed when the final state or the encoder contradicts the arrival."""
        state = self._read_final_state(axis, homing=goal_deg is None)
        self._raise_problem(axis, state)
        if goal_deg is None:
            return
        off_deg = state.position_deg - goal_deg
        if abs(off_deg) > axis.tolerance_deg:  # a digit can get lost where there is no checksum
            off_deg = self._agreed_position_deg(axis, self._read_state) - goal_deg
        if state.busy or abs(off_deg) > axis.tolerance_deg:
            self._position_doubt = "the axis did not stay at its target"
            raise MoveFailed(
                f"the axis did not stay at its target: it is {off_deg:+.4f} deg away.",
                where=axis.name,
                remedy=_CLEAR_AND_RESUME,
            )
        self._check_slip(axis)

    def _check_slip(self, axis: A) -> None:
        """Raise MoveFailed when an encoder, if there is one, differs from the counter."""
        if self._read_encoder(axis) is None:
            return
        counter_deg = self._agreed_position_deg(axis, self._read_state)
        encoder_deg = self._agreed_position_deg(axis, self._read_encoder)
        if abs(encoder_deg - counter_deg) > axis.encoder_tolerance_deg:
            self._position_doubt = "the axis slipped"
            raise MoveFailed(
                f"slipped: the counter reads {counter_deg:.4f} deg, the encoder {encoder_deg:.4f} deg.",
                where=axis.name,
                remedy="Check that load and acceleration are not too high, then home the stage and resume.",
            )

    def _agreed_position_deg(self, axis: A, read: Callable[[A], AxisState | None]) -> float:
        """Read a counter, or an encoder, until the readings agree."""

        def read_once() -> Reading:
            state = read(axis)
            assert state is not None
            return Reading(self._clock.monotonic(), state.position_deg, state.busy)

        return read_position_until_agreed(
            read_once,
            tolerance_deg=axis.tolerance_deg,
            speed_deg_s=axis.limits.speed_deg_s,
            what=f"{axis.name}'s position",
            where=self._where,
        )

    def _stopped_after(self, error: DriverError) -> DriverError:
        """Stop all axes after a failed move; return the error, which names a failed stop too."""
        if isinstance(error, PortLost):
            return error
        try:
            self.stop()
        except DriverError as second:
            return type(error)(
                f"{error.what} The stop that followed failed too: {second.what}",
                where=error.where,
                remedy=f"Cut the stage's power. {error.remedy}",
            )
        return error


class OneLineStage(OnOnePort, WatchedStage[A], Generic[A, L]):
    """A stage whose axes share one line. Axes stand in the order of the station file.

    Opening checks who answers, and sets limits, speed and acceleration. It moves nothing.
    """

    def __init__(
        self, port: Port, axes: Sequence[A], *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        super().__init__(axes, clock=clock, where=port.name)
        with closed_on_error(port):
            self._line = self._share(self._connected(port, wire_log))
            self._set_up()

    @abstractmethod
    def _connected(self, port: Port, wire_log: WireLog | None) -> L:
        """Return the line of the controller on an open port."""

    @abstractmethod
    def _set_up(self) -> None:
        """Compare the serial numbers, bring the axes to rest, and set what the station file states."""
