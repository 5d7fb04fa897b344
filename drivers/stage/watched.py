"""Knows how a move is seen to its end, whoever makes the controller: limits, start, watch, arrival, stop.

A family of controllers supplies what it says on its wire (the methods that are abstract here); what decides
that a move has arrived or failed stands here once. Knows no protocol.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Generic, NamedTuple, Protocol, TypeVar

from drivers.clock import Clock
from drivers.errors import DriverError, MoveFailed, MoveTimeout, NotHomed, PortLost
from drivers.readings import Reading, agreeing_position
from drivers.stage import AxisIdentity, AxisLimits, motion

_HOMING_PATIENCE_S = 10.0
"""At its home sensor an axis creeps, and its counter may rest."""
_STOP_POLL_S = 0.02
_CLEAR_AND_HOME = "Clear its cause, then home the stage and resume."

GoOn = Callable[[], None]
"""Raises MoveFailed when a stop came since the move began.

Asked with the line's lock held until the command is out: a stop then goes before the command, which is not
sent any more, or after it, and stops it.
"""


class Look(NamedTuple):
    """One look at an axis: all of one moment, as far as the protocol can."""

    position_deg: float
    busy: bool
    trouble: str = ""
    """Why this move will not end at its target, in plain words; empty while nothing speaks against it."""
    harmless: bool = False
    """Whether the position is still known for sure after that trouble: another command, a hold."""


class WatchedAxis(Protocol):
    """What must be known of an axis, whoever makes it."""

    @property
    def name(self) -> str:
        """Its name: "pan", "tilt" or "roll"."""
        ...

    @property
    def limits(self) -> AxisLimits:
        """Soft limits, speed and acceleration."""
        ...

    @property
    def tolerance_deg(self) -> float:
        """How far from its target the counter may rest."""
        ...

    @property
    def encoder_tolerance_deg(self) -> float:
        """How far the encoder may differ from the counter."""
        ...


A = TypeVar("A", bound=WatchedAxis)


class WatchedStage(ABC, Generic[A]):
    """A stage whose every move is watched to its end. Implements ``drivers.stage.Stage``.

    Parameters
    ----------
    axes
        The axes, in the station file's order.
    clock
        Every wait between two requests goes through it.
    where
        Name of the line, for messages.
    """

    def __init__(self, axes: Sequence[A], *, clock: Clock, where: str) -> None:
        self._axes = {axis.name: axis for axis in axes}
        self._clock = clock
        self._where = where
        self._stops = 0
        self._doubt = ""

    # ------------------------------------------------------------ what a family supplies

    @abstractmethod
    def identify(self) -> Sequence[AxisIdentity]:
        """Ask every axis who it is. Raises WrongDevice when a serial number is not the station file's."""

    @abstractmethod
    def _has_reference(self) -> bool:
        """Whether every axis has a reference, as far as the controller can tell."""

    @abstractmethod
    def faults(self) -> Sequence[str]:
        """Present faults and warnings in plain words."""

    @abstractmethod
    def close(self) -> None:
        """Give the port back; the stage stays where it is."""

    @abstractmethod
    def _assure_ready(self, axis: A) -> None:
        """See that an axis may be moved; raise NotHomed or MoveFailed when not, with nothing sent."""

    @abstractmethod
    def _clear_faults(self, axis: A) -> None:
        """Clear what can be cleared before homing; raise MoveFailed for what remains."""

    @abstractmethod
    def _goal_deg(self, axis: A, angle_deg: float) -> float:
        """Return the angle nearest to the one asked for that the controller can count."""

    @abstractmethod
    def _start(self, goals_deg: Mapping[str, float], go_on: GoOn) -> None:
        """Send the axes on their way; with the line's lock held, call ``go_on`` before each such command."""

    @abstractmethod
    def _start_homing(self, go_on: GoOn) -> None:
        """Send all axes to find their reference; ``go_on`` as for ``_start``."""

    @abstractmethod
    def _look(self, axis: A, *, homing: bool = False) -> Look:
        """Look at one axis."""

    @abstractmethod
    def _look_at_rest(self, axis: A, *, homing: bool) -> Look:
        """Look once more, for everything the controller knows against the move that just ended."""

    def _finish_homing(self, axis: A) -> None:
        """Do what is left once an axis stands at its reference; most controllers need nothing."""

    @abstractmethod
    def _send_stop(self) -> None:
        """Stop all axes, at once, before any resynchronising, and see that the controller heard it."""

    @abstractmethod
    def _listen(self, seconds: float) -> None:
        """Wait that long, on the line, where no clock interrupts."""

    def _encoder(self, axis: A) -> Look | None:  # noqa: ARG002 - most have none
        """Look at the encoder of an axis; None when it has none."""
        return None

    # ------------------------------------------------------------ what it is

    @property
    def axes(self) -> Sequence[str]:
        """Names of the axes, in the station file's order."""
        return tuple(self._axes)

    @property
    def limits(self) -> Mapping[str, AxisLimits]:
        """Soft limits, by axis."""
        return {name: axis.limits for name, axis in self._axes.items()}

    def is_homed(self) -> bool:
        """Whether every axis has a reference, and no move since has ended where nobody knows."""
        return not self._doubt and self._has_reference()

    def move_duration_s(self, from_deg: Mapping[str, float], to_deg: Mapping[str, float]) -> float:
        """Return the expected time of a move, in seconds."""
        return motion.longest_move_s(self.limits, from_deg, to_deg)

    def position_deg(self) -> Mapping[str, float]:
        """Position counter, by axis, in degrees; each read until two readings agree."""
        return {name: self._reading_deg(axis, self._look) for name, axis in self._axes.items()}

    def encoder_deg(self) -> Mapping[str, float]:
        """Read the encoders of those axes that have one, in degrees."""
        with_encoder = [axis for axis in self._axes.values() if self._encoder(axis) is not None]
        return {axis.name: self._reading_deg(axis, self._encoder) for axis in with_encoder}

    # ------------------------------------------------------------ what it does

    def home(self) -> None:
        """Find the reference of every axis; clears what faults can be cleared first.

        Asks before whether the controllers are still those that were opened. Raises WrongDevice, MoveFailed,
        MoveTimeout.
        """
        go_on = self._begin()
        self.identify()
        for axis in self._axes.values():
            self._clear_faults(axis)
        self._doubt = self._doubt or "homing was broken off"
        try:
            self._start_homing(go_on)
            now_s = self._clock.monotonic()
            self._wait([(axis, _homing_watch(axis, now_s)) for axis in self._axes.values()], go_on)
            for axis in self._axes.values():
                self._see_end(axis, None)
            for axis in self._axes.values():
                self._finish_homing(axis)
            self._doubt = ""
        except DriverError as error:
            raise self._stopped_after(error) from error

    def move_to(self, target_deg: Mapping[str, float]) -> None:
        """Move the named axes to absolute angles, and see that they arrive.

        Raises OutsideLimits and NotHomed before anything is sent; MoveFailed, MoveTimeout after all axes
        have been stopped.
        """
        motion.check_targets(self.limits, target_deg, self._where)
        if not target_deg:
            return
        go_on = self._begin()
        moving = [self._axes[name] for name in target_deg]
        start_deg = {axis.name: self._standing_deg(axis) for axis in moving}
        goal_deg = {axis.name: self._goal_deg(axis, target_deg[axis.name]) for axis in moving}
        try:
            self._start(goal_deg, go_on)
            now_s = self._clock.monotonic()
            allowed_s = max(
                motion.deadline_s(axis.limits, start_deg[axis.name], goal_deg[axis.name]) for axis in moving
            )
            self._wait(
                [(axis, _watch(axis, goal_deg[axis.name], now_s, allowed_s)) for axis in moving], go_on
            )
            for axis in moving:
                self._see_end(axis, goal_deg[axis.name])
        except DriverError as error:
            raise self._stopped_after(error) from error

    def stop(self) -> None:
        """Stop all axes at once, and see that they stand. From any thread; no clock interrupts it.

        Raises MoveTimeout when an axis does not come to rest; ReplyError, PortLost.
        """
        self._stops += 1
        self._send_stop()
        limits = self.limits.values()
        ramp_s = max(limit.speed_deg_s / limit.acceleration_deg_s2 for limit in limits)
        for _ in range(math.ceil((2.0 * ramp_s + 1.0) / _STOP_POLL_S)):
            if not any(self._look(axis).busy for axis in self._axes.values()):
                return
            self._listen(_STOP_POLL_S)
        raise MoveTimeout("still busy after a stop.", where=self._where, remedy="Cut the stage's power.")

    # ------------------------------------------------------------ a move, step by step

    def _bring_to_rest(self) -> None:
        """Stop what is found moving at opening: the port is ours, so whoever set it moving is gone."""
        if any(self._look(axis).busy for axis in self._axes.values()):
            self.stop()

    def _begin(self) -> GoOn:
        stops = self._stops

        def go_on() -> None:
            if self._stops != stops:
                raise MoveFailed(
                    "stopped on request.", where=self._where, remedy="Resume when it is safe to move."
                )

        return go_on

    def _standing_deg(self, axis: A) -> float:
        """Return where an axis stands; raise unless it may be moved from there."""
        if self._doubt:
            raise NotHomed(
                f"the position is in doubt ({self._doubt}). Nothing was moved.",
                where=axis.name,
                remedy="Home the stage first.",
            )
        self._assure_ready(axis)
        look = self._look(axis)
        if look.busy:
            raise MoveFailed(
                "the axis is moving already, by somebody else's command. Nothing was sent.",
                where=axis.name,
                remedy="See who else moves it (a knob, another program), then resume.",
            )
        return look.position_deg

    def _wait(self, watches: list[tuple[A, motion.MoveWatch]], go_on: GoOn) -> None:
        """Watch axes in motion until the last has arrived."""
        while watches:
            self._clock.sleep(motion.POLL_S)
            going = []
            for axis, watch in watches:
                go_on()
                look = self._look(axis, homing=watch.target_deg is None)
                self._refuse_trouble(axis, look)
                if not self._look_with(watch, look):
                    going.append((axis, watch))
            watches = going

    def _look_with(self, watch: motion.MoveWatch, look: Look) -> bool:
        """Let the watch judge a look; a failure leaves the position in doubt."""
        try:
            return watch.look(self._clock.monotonic(), look.position_deg, busy=look.busy)
        except (MoveFailed, MoveTimeout) as error:
            self._doubt = error.what
            raise

    def _refuse_trouble(self, axis: A, look: Look) -> None:
        if not look.trouble:
            return
        if not look.harmless:
            self._doubt = look.trouble
        raise MoveFailed(f"{look.trouble}.", where=axis.name, remedy=_CLEAR_AND_HOME)

    def _see_end(self, axis: A, goal_deg: float | None) -> None:
        """Raise MoveFailed when a last look, all the controller knows, or the encoder speak against the move."""
        look = self._look_at_rest(axis, homing=goal_deg is None)
        self._refuse_trouble(axis, look)
        if goal_deg is None:
            return
        off_deg = look.position_deg - goal_deg
        if look.busy or abs(off_deg) > axis.tolerance_deg:
            self._doubt = "it did not stay where it had arrived"
            raise MoveFailed(
                f"did not stay where it had arrived: {off_deg:+.4f} deg from its target.",
                where=axis.name,
                remedy=_CLEAR_AND_HOME,
            )
        if self._encoder(axis) is None:
            return
        counter_deg = self._reading_deg(axis, self._look)
        encoder_deg = self._reading_deg(axis, self._encoder)
        if abs(encoder_deg - counter_deg) > axis.encoder_tolerance_deg:
            self._doubt = "it slipped"
            raise MoveFailed(
                f"slipped: the counter says {counter_deg:.4f} deg, the encoder {encoder_deg:.4f} deg.",
                where=axis.name,
                remedy="See that load and acceleration are not too high, then home and resume.",
            )

    def _reading_deg(self, axis: A, read: Callable[[A], Look | None]) -> float:
        """Read a counter, or an encoder, until the readings bear each other out."""

        def once() -> Reading:
            look = read(axis)
            assert look is not None
            return Reading(self._clock.monotonic(), look.position_deg, look.busy)

        return agreeing_position(
            once,
            tolerance_deg=axis.tolerance_deg,
            speed_deg_s=axis.limits.speed_deg_s,
            what=f"{axis.name}'s position",
            where=self._where,
        )

    def _stopped_after(self, error: DriverError) -> DriverError:
        """Stop all axes after a failed move; return the error, with what happened if that failed too."""
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


def _watch(axis: WatchedAxis, goal_deg: float, now_s: float, allowed_s: float) -> motion.MoveWatch:
    return motion.MoveWatch(
        axis.name, goal_deg, tolerance_deg=axis.tolerance_deg, now_s=now_s, allowed_s=allowed_s
    )


def _homing_watch(axis: WatchedAxis, now_s: float) -> motion.MoveWatch:
    span_deg = axis.limits.highest_deg - axis.limits.lowest_deg
    return motion.MoveWatch(
        axis.name,
        None,
        tolerance_deg=axis.tolerance_deg,
        now_s=now_s,
        allowed_s=30.0 + 5.0 * span_deg / axis.limits.speed_deg_s,
        patience_s=_HOMING_PATIENCE_S,
    )
