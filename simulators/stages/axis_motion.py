"""The motion of one motorised axis: what its controller commands, where its motor is, where its load points.

What all controllers share is here, too: power, a restart without answers, events of the motion, and a buffer. A `Unit`
has power and axes; a `Controller` has a line of its own.

The module covers the reference sensor, the end stops and the faults of a motion. It depends neither on a protocol
nor on the wall clock: the caller passes all times in. The controllers' dialects build on it.

Three positions are kept apart, because faults show in their differences. The *counter* is what the controller believes.
The *motor* is the position of the shaft, which an encoder on the shaft reads. The *angle* is where the load points.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple

from simulators.world.trajectory import LoadTrajectory, MotorTrajectory

#: Distance that homing runs past the sensor before it returns to it, degrees.
_HOMING_OVERRUN_DEG = 0.1

FaultKind = Literal[
    "stall", "limit", "twist", "restart", "stop_short", "no_progress", "slip", "creep", "unplug", "press_stop"
]


@dataclass(frozen=True)
class Mechanics:
    """Mechanical properties of an axis.

    counts_per_deg: Motor counts (microsteps or encoder counts) per degree of the load.
    lowest_deg, highest_deg: End stops of the load, degrees.
    home_deg: Angle of the reference sensor, degrees; homing sets the counter to 0 there.
    start_deg: Angle at power-up, degrees. The controller does not know it: its counter starts at 0.
    settle_s: Time constant with which the load follows the motor, s; after a ramp the rest decays as exp(-t /
      settle_s).
    backlash_deg: Backlash of the gear, degrees: the load stands half of it behind the motor, on the side that
      it came from.
    stall_detection: Whether the controller notices a stalled motor and stops. Otherwise its counter
      continues.
    """

    counts_per_deg: float
    lowest_deg: float
    highest_deg: float
    home_deg: float = 0.0
    start_deg: float = 0.0
    settle_s: float = 0.02
    backlash_deg: float = 0.0
    stall_detection: bool = True


@dataclass(frozen=True)
class AxisModel:
    """An axis as its controller is delivered; a controller takes what its kind has."""

    mechanics: Mechanics
    serial: str = ""  # Serial number of the controller or of the stage
    limit_deg: float = 15.0  # Soft limit in both directions, degrees
    speed_deg_s: float = 40.0  # Speed at power-up, degrees/s
    acceleration_deg_s2: float = 200.0  # Acceleration at power-up, degrees/s^2
    encoder: bool = True  # Whether the shaft has an encoder
    name: str = ""  # Model, as the controller states it; empty for the usual one


@dataclass(frozen=True)
class MotionFault:
    """A fault of a motion to come."""

    # ``stall``: the motor is blocked. ``limit``: a limit switch closes. ``twist``: the two axes of a lockstep
    # pair lose their alignment. ``restart``: the controller reboots. ``stop_short``: it stops as if it had
    # arrived. ``no_progress``: it stops and keeps reporting busy. ``slip``: the motor stands still, the
    # counter continues. ``creep``: the motor drifts after it has arrived, and the counter does not follow.
    # ``unplug``, ``press_stop``: an event outside the controller, which ``then`` causes.
    kind: FaultKind
    # Time of the fault, as a share of the motion's duration; ``creep`` begins at the end whatever the share.
    share: float = 0.5
    creep_deg_s: float = 0.01  # Speed of the drift, degrees/s
    skip: int = 0  # Number of motions that pass unchanged first
    # Called when the motion begins, with the time at which the fault happens, s.
    then: Callable[[float], None] | None = None


class MotionEvent(NamedTuple):
    """An event that the controller notices."""

    kind: FaultKind  # "stall", "limit", "twist" or "restart"
    t_s: float  # Time of the event, s


class Axis:
    """One axis. Times are in seconds, on the caller's clock; positions are motor counts from the load's true zero.

    Commands take the time at which they arrive; queries take the time that they ask about. ``publish`` is called with
    each new trajectory of the load; this is how the world learns where the axis points. ``commanded`` is the trajectory
    that the controller commands, ``motor`` that of the shaft. ``stuck_busy``: the controller keeps reporting busy.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        now_s: float = 0.0,
        publish: Callable[[LoadTrajectory], None] = lambda _pointing: None,
    ) -> None:
        self.mechanics = mechanics
        self._publish = publish
        start = float(round(mechanics.start_deg * mechanics.counts_per_deg))
        self._origin = start
        self._encoder_origin = start
        self._homing = False
        self._homing_sets_counter = True
        self._referenced = False
        self.armed: MotionFault | None = None  # The fault of a motion to come
        self._false_idle_replies = 0
        self.stuck_busy = False
        self._event: MotionEvent | None = None
        self.commanded = self.motor = MotorTrajectory.resting(now_s, start)
        self.pointing = self._follow_motor(start, 0.0)

    # ------------------------------------------------------------------ queries
    def counter(self, t_s: float) -> float:
        """Return the controller's counter."""
        self._finish_homing(t_s)
        return self.commanded.position(t_s) - self._origin

    def encoder(self, t_s: float) -> float:
        """Return the count of an encoder on the shaft; it is set to 0 together with the counter."""
        self._finish_homing(t_s)
        return self.motor.position(t_s) - self._encoder_origin

    def rest_counter(self, t_s: float) -> float:
        """Return the counter at which the present command ends."""
        self._finish_homing(t_s)
        return self.commanded.rest - self._origin

    def velocity(self, t_s: float) -> float:
        """Return the commanded velocity."""
        return self.commanded.velocity(t_s)

    def busy(self, t_s: float) -> bool:
        """Return whether a ramp is under way; settling of the load does not count."""
        return t_s < self.commanded.end_s

    def reports_busy(self, t_s: float) -> bool:
        """Return what the controller reports: the truth, unless a fault is set; each false "idle" is reported once."""
        busy = self.busy(t_s)
        if busy and self._false_idle_replies > 0:
            self._false_idle_replies -= 1
            return False
        return busy or self.stuck_busy

    def referenced(self, t_s: float) -> bool:
        """Return whether homing has set the reference."""
        self._finish_homing(t_s)
        return self._referenced

    def take_event(self, t_s: float) -> MotionEvent | None:
        """Return, once, the event that the controller must have noticed by now; None if there is none."""
        event = self._event
        if event is None or t_s < event.t_s:
            return None
        self._event = None
        return event

    # ------------------------------------------------------------------ commands
    def move_to(self, target: float, t_s: float, speed: float, acceleration: float) -> None:
        """Ramp to a counter value from the present position and velocity."""
        self._abandon_homing(t_s)
        self._ramp_through(t_s, [(target + self._origin, speed)], acceleration)

    def stop(self, t_s: float, acceleration: float) -> None:
        """Brake to a halt on a whole count; this aborts homing, without a reference."""
        self._abandon_homing(t_s)
        velocity = self.commanded.velocity(t_s)
        rest = self.commanded.position(t_s) + velocity * abs(velocity) / (2.0 * acceleration)
        rest = float(math.ceil(rest) if velocity > 0.0 else math.floor(rest))
        self._ramp_through(t_s, [(rest, max(abs(velocity), 1.0))], acceleration)

    def halt(self, t_s: float) -> None:
        """Stop at once, as if the motor's current were cut."""
        self._abandon_homing(t_s)
        self._event = None
        load, offset = self._load(t_s)
        self.commanded = MotorTrajectory.resting(t_s, float(round(self.commanded.position(t_s))))
        self.motor = MotorTrajectory.resting(t_s, float(round(self.motor.position(t_s))))
        self.pointing = self._follow_motor(load, offset)

    def home(
        self, t_s: float, speed: float, slow: float, acceleration: float, *, set_counter: bool = True
    ) -> None:
        """Find the reference sensor: run past it, then return slowly from below (both counts/s)."""
        self._finish_homing(t_s)
        self._referenced = False
        self._homing = True
        self._homing_sets_counter = set_counter
        sensor = float(round(self.mechanics.home_deg * self.mechanics.counts_per_deg)) - self._slip(t_s)
        below = sensor - _HOMING_OVERRUN_DEG * self.mechanics.counts_per_deg
        self._ramp_through(t_s, [(below, speed), (sensor, slow)], acceleration)

    def restart(self, t_s: float) -> None:
        """Power-cycle the controller: the axis halts, counter and encoder become 0, and the reference is lost."""
        self.halt(t_s)
        self._referenced = False
        self._origin = self.commanded.rest
        self._encoder_origin = self.motor.rest

    def forget_reference(self) -> None:
        """Drop the reference; the counter stays as it is."""
        self._referenced = False

    def set_counter(self, value: float, t_s: float) -> None:
        """Assign another counter value to the present position."""
        self._finish_homing(t_s)
        self._origin = self.commanded.position(t_s) - value

    def set_encoder(self, value: float, t_s: float) -> None:
        """Assign another encoder value to the present position."""
        self._finish_homing(t_s)
        self._encoder_origin = self.motor.position(t_s) - value

    # ------------------------------------------------------------------ faults
    def arm(self, fault: MotionFault | None) -> None:
        """Arm a fault for a motion to come; it replaces an armed one."""
        self.armed = fault

    def report_false_idle(self, times: int) -> None:
        """Let the controller report idle although the axis moves."""
        self._false_idle_replies = times

    def push(self, counts: float, t_s: float) -> None:
        """Turn the shaft from outside; the counter does not notice."""
        load, offset = self._load(t_s)
        pieces = [piece._replace(position=piece.position + counts) for piece in self.motor.pieces]
        begun = [piece for piece in pieces if piece.start_s > t_s]
        present = self.motor.at(t_s)
        first = present._replace(
            start_s=t_s, position=present.position_at(t_s) + counts, velocity=present.velocity_at(t_s)
        )
        self.motor = MotorTrajectory((first, *begun))
        self.pointing = self._follow_motor(load, offset)

    # ------------------------------------------------------------------ internals
    def _slip(self, t_s: float) -> float:
        """Return motor minus commanded position: what has slipped or was pushed since power-up."""
        return self.motor.position(t_s) - self.commanded.position(t_s)

    def _load(self, t_s: float) -> tuple[float, float]:
        """Return the position of the load, and its side of the backlash."""
        return self.pointing.load(t_s), self.pointing.offsets[self.pointing.motor.index(t_s)]

    def _follow_motor(self, load: float, offset: float) -> LoadTrajectory:
        """Let the load follow the motor from now on, and publish its trajectory."""
        m = self.mechanics
        backlash = m.backlash_deg * m.counts_per_deg
        pointing = LoadTrajectory.following(self.motor, load, offset, backlash, m.counts_per_deg, m.settle_s)
        self._publish(pointing)
        return pointing

    def _ramp_through(self, t_s: float, stations: list[tuple[float, float]], acceleration: float) -> None:
        """Ramp from the present state through stations (commanded position, speed), resting at each."""
        load, offset = self._load(t_s)
        lost = self._slip(t_s)
        begin, velocity = (
            self.motor.position(t_s),
            self.motor.velocity(t_s) if t_s < self.motor.end_s else 0.0,
        )
        self.commanded = MotorTrajectory.through(
            t_s, self.commanded.position(t_s), self.commanded.velocity(t_s), stations, acceleration
        )
        shifted = [(station + lost, speed) for station, speed in stations]
        self.motor = MotorTrajectory.through(t_s, begin, velocity, shifted, acceleration)
        self._event = None
        if self.armed is not None and self.armed.skip > 0:
            self.armed = replace(self.armed, skip=self.armed.skip - 1)
        elif self.armed is not None:
            fault, self.armed = self.armed, None
            self._apply_fault(fault)
        self._stop_at_end_stops()
        self.pointing = self._follow_motor(load, offset)

    def _apply_fault(self, fault: MotionFault) -> None:
        t_s = self.commanded.start_s + fault.share * (self.commanded.end_s - self.commanded.start_s)
        if fault.then is not None:
            fault.then(t_s)
        elif fault.kind == "creep":
            self.motor = self.motor.until(self.motor.end_s, fault.creep_deg_s * self.mechanics.counts_per_deg)
        elif fault.kind == "slip":
            self.motor = self.motor.until(t_s)
        elif fault.kind == "stall":
            self._stall(t_s)
        else:
            self.motor, self.commanded = self.motor.until(t_s), self.commanded.until(t_s)
            self.stuck_busy = self.stuck_busy or fault.kind == "no_progress"
            if fault.kind in {"limit", "twist", "restart"}:
                self._event = MotionEvent(fault.kind, t_s)

    def _stop_at_end_stops(self) -> None:
        scale = self.mechanics.counts_per_deg
        hit_s = self.motor.first_beyond(self.mechanics.lowest_deg * scale, self.mechanics.highest_deg * scale)
        if hit_s is not None:
            self._stall(hit_s)

    def _stall(self, t_s: float) -> None:
        """Stop the motor at a time; a controller with stall detection stops there too, any other one counts on."""
        self.motor = self.motor.until(t_s)
        if self.mechanics.stall_detection:
            self.commanded = self.commanded.until(t_s)
            self._event = MotionEvent("stall", t_s)

    def _finish_homing(self, t_s: float) -> None:
        if self._homing and t_s >= self.commanded.end_s:
            self._homing = False
            self._referenced = self._event is None
            if self._referenced and self._homing_sets_counter:
                self._origin = self.commanded.rest
                self._encoder_origin = self.motor.rest

    def _abandon_homing(self, t_s: float) -> None:
        self._finish_homing(t_s)
        self._homing = False


class Unit(ABC):
    """Something with power that moves axes; for ``BOOT_S`` after a restart it gives no answers.

    No maker states that time; those here are chosen, of the order of a second.
    """

    BOOT_S: ClassVar[float] = 0.0

    def __init__(self, axes: Iterable[Axis], now_s: float) -> None:
        self._moved = tuple(axes)
        self._powered = True
        self._boot_ends_s = now_s

    @abstractmethod
    def _power_up(self) -> None:
        """Set the state after power-up."""

    @abstractmethod
    def _notice(self, axis: Axis, event: MotionEvent, t_s: float) -> None:
        """Process an event of a motion that is no restart."""

    def awake(self, t_s: float) -> bool:
        """Return whether it has power and has booted."""
        return self._powered and t_s >= self._boot_ends_s

    def take_events(self, t_s: float) -> None:
        """Process the events of the motions so far."""
        for axis in self._moved:
            event = axis.take_event(t_s)
            if event is None:
                continue
            if event.kind == "restart":
                self.restart(event.t_s)
                return
            self._notice(axis, event, t_s)

    def restart(self, t_s: float) -> None:
        """Reboot: no answers for a while, then the state after power-up; references are lost, counters are 0."""
        for axis in self._moved:
            axis.restart(t_s)
        self._power_up()
        self._boot_ends_s = t_s + self.BOOT_S

    def exchange(self, serial: str, t_s: float) -> None:
        """Replace it by another one of its kind, fresh from power-up; most kinds tell a serial number."""
        del serial
        self.restart(t_s)

    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """Press or release the emergency stop, which cuts the power; released, nothing happens if it was not cut."""
        if not released:
            self._powered = False
            for axis in self._moved:
                axis.halt(t_s)
        elif not self._powered:
            self._powered = True
            self.restart(t_s)


class Controller(Unit):
    """A controller with a line of its own, as its dialect; half a message is dropped after ``BYTE_TIMEOUT_S``."""

    baud = 115_200
    BYTE_TIMEOUT_S: ClassVar[float] = math.inf

    def __init__(self, axes: Iterable[Axis], clock: Callable[[], float]) -> None:
        super().__init__(axes, clock())
        self._clock = clock
        self._received_at_s = clock()
        self._buffer = b""

    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`."""
        now = self._clock()
        self.take_events(now)
        if not self.awake(now):
            return b""
        if now - self._received_at_s > self.BYTE_TIMEOUT_S:
            self._buffer = b""
        self._received_at_s = now
        self._buffer += data
        return self._answer(now)

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. Most controllers say nothing unasked."""
        return b""

    @abstractmethod
    def _answer(self, now: float) -> bytes:
        """Take whole messages from the buffer, and return their answers."""


class SingleController(Controller):
    """A controller of one axis with a line of its own, whose serial number has digits only."""

    def __init__(
        self,
        model: AxisModel,
        clock: Callable[[], float],
        publish: Callable[[LoadTrajectory], None] = lambda _pointing: None,
    ) -> None:
        self.model = model
        self.axis = Axis(model.mechanics, clock(), publish)
        super().__init__([self.axis], clock)
        self._deliver()
        self._power_up()

    def _deliver(self) -> None:
        """Set what survives a restart as the factory sets it; most have nothing of that kind."""

    def exchange(self, serial: str, t_s: float) -> None:
        """See `Unit.exchange`; serial number 0 if the given one is not a number."""
        self.model = replace(self.model, serial=serial if serial.isdigit() else "0")
        self._deliver()
        self.restart(t_s)


@dataclass
class AxisOfController:
    """One of several axes of a controller, for faults: what happens to the controller happens to all its axes."""

    controller: Unit
    axis: Axis

    def restart(self, t_s: float) -> None:
        """See `Unit.restart`."""
        self.controller.restart(t_s)

    def exchange(self, serial: str, t_s: float) -> None:
        """See `Unit.exchange`."""
        self.controller.exchange(serial, t_s)

    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """See `Unit.emergency_stop`."""
        self.controller.emergency_stop(t_s, released=released)
