"""The physics of one motorised axis: what its controller commands, where its motor stands, where it points.

Knows reference sensor, end stops and what can go wrong with a motion; no wire, no command's wording, no wall
clock: time is whatever the caller hands in. A controller's dialect stands on top of it.

Three positions are kept apart, because faults live in their differences: the *counter* is what the controller
believes, the *motor* is where the shaft stands (what an encoder on it reads), and the *angle* is where the load
points.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, cast

from simulators.world.trajectory import Course, Pointing

#: How far homing runs past the sensor before it comes back onto it.
_HOMING_OVERRUN_DEG = 0.1

FaultKind = Literal[
    "stall", "limit", "twist", "restart", "stop_short", "no_progress", "slip", "creep", "unplug", "press_stop"
]


@dataclass(frozen=True)
class Mechanics:
    """What an axis is built of.

    Parameters
    ----------
    counts_per_deg
        Motor counts (microsteps, encoder counts) a degree of the load.
    lowest_deg, highest_deg
        End stops of the load.
    home_deg
        Angle of the reference sensor; the counter is 0 there after homing.
    start_deg
        Angle at power-up, unknown to the controller, whose counter starts at 0.
    settle_s
        Time constant of the load following the motor; after a ramp the rest decays as exp(-t / settle_s).
    backlash_deg
        Play of the gear: the load stands half of it behind the motor, on the side it came from.
    stall_detection
        Whether the controller notices a motor that is held fast, and stops; without it, it counts on.
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
class MotionFault:
    """What is to go wrong with the next motion.

    Attributes
    ----------
    kind
        ``stall``: the motor is held fast. ``limit``: a limit switch closes. ``twist``: a pair of axes comes
        apart. ``restart``: the controller reboots. ``stop_short``: it stops as if it had arrived.
        ``no_progress``: it stops and says busy for ever. ``slip``: the motor stands, the counter goes on.
        ``creep``: the motor drifts once it has arrived, unknown to the counter. ``unplug``, ``press_stop``:
        something from outside, which ``then`` brings about.
    share
        When, as a share of the motion's duration; not of ``creep``, which begins at its end.
    creep_deg_s
        Speed of the drift.
    skip
        Motions to let pass before.
    then
        Told the moment at which it happens, once that motion begins.
    """

    kind: FaultKind
    share: float = 0.5
    creep_deg_s: float = 0.01
    skip: int = 0
    then: Callable[[float], None] | None = None


Noticed = Literal["stall", "limit", "twist", "restart"]


class MotionEvent(NamedTuple):
    """Something a controller notices."""

    kind: Noticed
    t_s: float


class Axis:
    """One axis.

    Commands take the time at which they arrive; questions take the time they ask about.

    Parameters
    ----------
    mechanics
        What the axis is built of.
    now_s
        Time of power-up.
    publish
        Called with every new course of the load: how the world learns where the axis points.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        now_s: float = 0.0,
        publish: Callable[[Pointing], None] = lambda _pointing: None,
    ) -> None:
        self.mechanics = mechanics
        self._publish = publish
        start = float(round(mechanics.start_deg * mechanics.counts_per_deg))
        self._origin = start
        self._encoder_origin = start
        self._homing = False
        self._homing_sets_counter = True
        self._referenced = False
        self._armed: MotionFault | None = None
        self._false_idle_replies = 0
        self.stuck_busy = False
        self._event: MotionEvent | None = None
        self.commanded = self.motor = Course.resting(now_s, start)
        self.pointing = self._follow_motor(start, 0.0)

    # ------------------------------------------------------------------ questions
    def counter(self, t_s: float) -> float:
        """Where the controller believes the axis is, in counts."""
        self._finish_homing(t_s)
        return self.commanded.position(t_s) - self._origin

    def encoder(self, t_s: float) -> float:
        """Count of an encoder on the shaft, set to 0 together with the counter."""
        self._finish_homing(t_s)
        return self.motor.position(t_s) - self._encoder_origin

    def rest_counter(self, t_s: float) -> float:
        """Where the present command ends, in counts of the counter as it is now."""
        self._finish_homing(t_s)
        return self.commanded.rest - self._origin

    def velocity(self, t_s: float) -> float:
        """Commanded velocity, counts/s."""
        return self.commanded.velocity(t_s)

    def busy(self, t_s: float) -> bool:
        """Whether a ramp is still under way; a load that only settles is not busy."""
        return t_s < self.commanded.end_s

    def reports_busy(self, t_s: float) -> bool:
        """What the controller tells of that: the truth, unless a fault of reporting was set."""
        busy = self.busy(t_s)
        if busy and self._false_idle_replies > 0:
            self._false_idle_replies -= 1
            return False
        return busy or self.stuck_busy

    def referenced(self, t_s: float) -> bool:
        """Whether the counter has been set at the reference sensor."""
        self._finish_homing(t_s)
        return self._referenced

    def take_event(self, t_s: float) -> MotionEvent | None:
        """Give, once, what the controller must have noticed by now."""
        event = self._event
        if event is None or t_s < event.t_s:
            return None
        self._event = None
        return event

    # ------------------------------------------------------------------ commands
    def move_to(self, target: float, t_s: float, speed: float, acceleration: float) -> None:
        """Ramp to a counter value, from wherever and however fast the axis is."""
        self._abandon_homing(t_s)
        self._ramp_through(t_s, [(target + self._origin, speed)], acceleration)

    def stop(self, t_s: float, acceleration: float) -> None:
        """Brake to a halt on a whole count; ends homing without a reference."""
        self._abandon_homing(t_s)
        velocity = self.commanded.velocity(t_s)
        rest = self.commanded.position(t_s) + velocity * abs(velocity) / (2.0 * acceleration)
        rest = float(math.ceil(rest) if velocity > 0.0 else math.floor(rest))
        self._ramp_through(t_s, [(rest, max(abs(velocity), 1.0))], acceleration)

    def halt(self, t_s: float) -> None:
        """Stand still at once, as with the motor's current cut."""
        self._abandon_homing(t_s)
        self._event = None
        load, offset = self._load(t_s)
        self.commanded = Course.resting(t_s, float(round(self.commanded.position(t_s))))
        self.motor = Course.resting(t_s, float(round(self.motor.position(t_s))))
        self.pointing = self._follow_motor(load, offset)

    def home(
        self, t_s: float, speed: float, slow: float, acceleration: float, *, set_counter: bool = True
    ) -> None:
        """Find the reference sensor: past it at speed, and onto it slowly from below; perhaps count from there."""
        self._finish_homing(t_s)
        self._referenced = False
        self._homing = True
        self._homing_sets_counter = set_counter
        sensor = float(round(self.mechanics.home_deg * self.mechanics.counts_per_deg)) - self._slip(t_s)
        below = sensor - _HOMING_OVERRUN_DEG * self.mechanics.counts_per_deg
        self._ramp_through(t_s, [(below, speed), (sensor, slow)], acceleration)

    def restart(self, t_s: float) -> None:
        """Power-cycle the controller: it halts, counts from 0 where it stands, and has no reference."""
        self.halt(t_s)
        self._referenced = False
        self._origin = self.commanded.rest
        self._encoder_origin = self.motor.rest

    def forget_reference(self) -> None:
        """Have the controller no longer trust its counter."""
        self._referenced = False

    def set_counter(self, value: float, t_s: float) -> None:
        """Call the present position by another number."""
        self._finish_homing(t_s)
        self._origin = self.commanded.position(t_s) - value

    def set_encoder(self, value: float, t_s: float) -> None:
        """Have the encoder count from another number."""
        self._finish_homing(t_s)
        self._encoder_origin = self.motor.position(t_s) - value

    # ------------------------------------------------------------------ faults
    def arm(self, fault: MotionFault | None) -> None:
        """Let something go wrong with a motion to come, in place of what was armed before; None for nothing."""
        self._armed = fault

    def report_false_idle(self, times: int) -> None:
        """Have it reported idle that many times while it still moves."""
        self._false_idle_replies = times

    def push(self, counts: float, t_s: float) -> None:
        """Turn the shaft from outside, unknown to the counter."""
        load, offset = self._load(t_s)
        pieces = [piece._replace(position=piece.position + counts) for piece in self.motor.pieces]
        begun = [piece for piece in pieces if piece.start_s > t_s]
        present = self.motor.at(t_s)
        first = present._replace(
            start_s=t_s, position=present.position_at(t_s) + counts, velocity=present.velocity_at(t_s)
        )
        self.motor = Course((first, *begun))
        self.pointing = self._follow_motor(load, offset)

    # ------------------------------------------------------------------ inside
    def _slip(self, t_s: float) -> float:
        """Motor minus commanded position: what slipped or was pushed since power-up."""
        return self.motor.position(t_s) - self.commanded.position(t_s)

    def _load(self, t_s: float) -> tuple[float, float]:
        """Where the load is, and on which side of the gear's play."""
        return self.pointing.load(t_s), self.pointing.offsets[self.pointing.course.index(t_s)]

    def _follow_motor(self, load: float, offset: float) -> Pointing:
        """Let the load follow the motor from now on, and tell the world."""
        m = self.mechanics
        backlash = m.backlash_deg * m.counts_per_deg
        pointing = Pointing.following(self.motor, load, offset, backlash, m.counts_per_deg, m.settle_s)
        self._publish(pointing)
        return pointing

    def _ramp_through(self, t_s: float, stations: list[tuple[float, float]], acceleration: float) -> None:
        """Ramp from here and now through stations (commanded position, speed), resting at each."""
        load, offset = self._load(t_s)
        lost = self._slip(t_s)
        begin, velocity = (
            self.motor.position(t_s),
            self.motor.velocity(t_s) if t_s < self.motor.end_s else 0.0,
        )
        self.commanded = Course.through(
            t_s, self.commanded.position(t_s), self.commanded.velocity(t_s), stations, acceleration
        )
        shifted = [(station + lost, speed) for station, speed in stations]
        self.motor = Course.through(t_s, begin, velocity, shifted, acceleration)
        self._event = None
        if self._armed is not None and self._armed.skip > 0:
            self._armed = replace(self._armed, skip=self._armed.skip - 1)
        elif self._armed is not None:
            fault, self._armed = self._armed, None
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
                self._event = MotionEvent(cast("Noticed", fault.kind), t_s)

    def _stop_at_end_stops(self) -> None:
        scale = self.mechanics.counts_per_deg
        hit_s = self.motor.first_beyond(self.mechanics.lowest_deg * scale, self.mechanics.highest_deg * scale)
        if hit_s is not None:
            self._stall(hit_s)

    def _stall(self, t_s: float) -> None:
        """Let the motor stand from a time on; a controller that notices stops there, another counts on."""
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
