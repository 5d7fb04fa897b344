"""The physics of one motorised axis: where it truly points at any time.

Knows ramps, settling, backlash, the reference sensor and the end stops, in motor counts and degrees; no wire,
no command, no wall clock: time is whatever the caller hands in. A controller's dialect stands on top of it.

Three positions are kept apart, because faults live in their differences: the *counter* is what the controller
believes, the *motor* is where the shaft stands (what an encoder on the shaft reads), and the *angle* is where
the load points.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

#: A load within this of its final angle has settled: 0.05 arc seconds, a thousandth of a pixel.
SETTLED_DEG = 0.05 / 3600.0

#: How far homing runs past the sensor before it comes back onto it.
_HOMING_OVERRUN_DEG = 0.1


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
    """

    counts_per_deg: float
    lowest_deg: float
    highest_deg: float
    home_deg: float = 0.0
    start_deg: float = 0.0
    settle_s: float = 0.02
    backlash_deg: float = 0.0


class Segment(NamedTuple):
    """A time of constant acceleration, in counts and seconds; the last one lasts until the next command."""

    start_s: float
    position: float
    velocity: float
    acceleration: float
    offset: float
    """Load minus motor once everything has settled: half the backlash, by the side it came from."""
    load: float
    """Where the load is at the start."""


class Leg(NamedTuple):
    """A part of a ramp: how long, and with which acceleration."""

    duration_s: float
    acceleration: float


def ramp(position: float, velocity: float, target: float, speed: float, acceleration: float) -> list[Leg]:
    """Plan a trapezoid from a position and velocity to rest at a target.

    An axis that runs the wrong way, or too fast to stop in time, brakes to a halt first.

    Parameters
    ----------
    position, velocity
        Where the axis is, and how fast, in counts and counts/s.
    target
        Where it shall rest.
    speed, acceleration
        Bounds of the ramp, positive, counts/s and counts/s^2.

    Returns
    -------
    list of Leg
        At most four; empty when it already rests there.

    Examples
    --------
    >>> [tuple(leg) for leg in ramp(0.0, 0.0, 100.0, 10.0, 10.0)]
    [(1.0, 10.0), (9.0, 0.0), (1.0, -10.0)]
    """
    legs: list[Leg] = []
    distance = target - position
    stopping = velocity * abs(velocity) / (2.0 * acceleration)
    if velocity != 0.0 and (distance * velocity <= 0.0 or abs(distance) < abs(stopping)):
        legs.append(Leg(abs(velocity) / acceleration, -math.copysign(acceleration, velocity)))
        distance -= stopping
        velocity = 0.0
    if distance == 0.0:
        return legs
    side = math.copysign(1.0, distance)
    entry = abs(velocity)
    peak = min(speed, math.sqrt(acceleration * abs(distance) + entry * entry / 2.0))
    change = peak - entry
    cruise = abs(distance) - (abs(peak * peak - entry * entry) + peak * peak) / (2.0 * acceleration)
    legs += [
        Leg(abs(change) / acceleration, side * math.copysign(acceleration, change)),
        Leg(max(0.0, cruise) / peak, 0.0),
        Leg(peak / acceleration, -side * acceleration),
    ]
    return [leg for leg in legs if leg.duration_s > 0.0]


@dataclass(frozen=True)
class Trajectory:
    """Where motor and load are from one command until the next: immutable, so that any thread may ask.

    Attributes
    ----------
    segments
        In order of time; the axis rests in the last one.
    counts_per_deg
        Motor counts a degree.
    settle_s
        Time constant of the load following the motor.
    """

    segments: tuple[Segment, ...]
    counts_per_deg: float
    settle_s: float

    @property
    def start_s(self) -> float:
        """Time of the command."""
        return self.segments[0].start_s

    @property
    def end_s(self) -> float:
        """Time from which on the motor rests."""
        return self.segments[-1].start_s

    @property
    def rest(self) -> float:
        """Where the motor comes to rest, counts from the true zero."""
        return self.segments[-1].position

    @property
    def rest_load(self) -> float:
        """Where the load comes to rest, counts from the true zero."""
        return self.segments[-1].position + self.segments[-1].offset

    @cached_property
    def settled_from_s(self) -> float:
        """Time from which on the load stands at its final angle, to within `SETTLED_DEG`."""
        residual = abs(self.segments[-1].load - self.rest_load) / self.counts_per_deg
        if residual <= SETTLED_DEG:
            return self.end_s
        return self.end_s + self.settle_s * math.log(residual / SETTLED_DEG)

    def at(self, t_s: float) -> Segment:
        """Find the segment of a time."""
        index = bisect_right(self.segments, t_s, key=lambda segment: segment.start_s)
        return self.segments[max(0, index - 1)]

    def motor(self, t_s: float) -> float:
        """Where the shaft stands, counts from the true zero."""
        segment = self.at(t_s)
        s = max(0.0, t_s - segment.start_s)
        return segment.position + segment.velocity * s + segment.acceleration * s * s / 2.0

    def velocity(self, t_s: float) -> float:
        """Speed of the motor, counts/s."""
        segment = self.at(t_s)
        return segment.velocity + segment.acceleration * max(0.0, t_s - segment.start_s)

    def load(self, t_s: float) -> float:
        """Where the load is, counts from the true zero."""
        return follow(self.at(t_s), t_s, self.settle_s)

    def angle_deg(self, t_s: float) -> float:
        """Where the load points; exactly its final angle once it has settled."""
        load = self.rest_load if t_s >= self.settled_from_s else self.load(t_s)
        return load / self.counts_per_deg


def follow(segment: Segment, t_s: float, settle_s: float) -> float:
    """Position of a load that follows the motor with a first-order lag, settle_s dx/dt = q - x.

    Under constant acceleration the lag has a closed form: a parabola behind the motor's, and an exponential
    that forgets where the load was at the start of the segment.
    """
    s = max(0.0, t_s - segment.start_s)
    a = segment.acceleration
    motor = segment.position + segment.velocity * s + a * s * s / 2.0 + segment.offset
    if settle_s <= 0.0:
        return motor
    steady = motor - settle_s * (segment.velocity + a * s) + settle_s * settle_s * a
    steady_at_start = (
        segment.position + segment.offset - settle_s * segment.velocity + settle_s * settle_s * a
    )
    return steady + (segment.load - steady_at_start) * math.exp(-s / settle_s)


class Axis:
    """One axis: what its controller commands and believes, and the trajectory that follows from it.

    Commands take the time at which they arrive; questions take the time they ask about.

    Parameters
    ----------
    mechanics
        What the axis is built of.
    now_s
        Time of power-up.
    publish
        Called with every new trajectory: how the world learns where the axis points.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        now_s: float = 0.0,
        publish: Callable[[Trajectory], None] = lambda _trajectory: None,
    ) -> None:
        self.mechanics = mechanics
        self._publish = publish
        start = float(round(mechanics.start_deg * mechanics.counts_per_deg))
        self._origin = start
        self._homing = False
        self._referenced = False
        self.trajectory = self._made((Segment(now_s, start, 0.0, 0.0, 0.0, start),))

    # ------------------------------------------------------------------ questions
    def counter(self, t_s: float) -> float:
        """Where the controller believes the axis is, in counts."""
        self._finish_homing(t_s)
        return self.trajectory.motor(t_s) - self._origin

    def encoder(self, t_s: float) -> float:
        """Count of an encoder on the shaft, set to 0 together with the counter."""
        return self.counter(t_s)

    def rest_counter(self, t_s: float) -> float:
        """Where the present command ends, in counts of the counter."""
        self._finish_homing(t_s)
        return self.trajectory.rest - self._origin

    def busy(self, t_s: float) -> bool:
        """Whether a ramp is still under way; a load that only settles is not busy."""
        return t_s < self.trajectory.end_s

    def referenced(self, t_s: float) -> bool:
        """Whether the counter has been set at the reference sensor."""
        self._finish_homing(t_s)
        return self._referenced

    # ------------------------------------------------------------------ commands
    def move_to(self, target: float, t_s: float, speed: float, acceleration: float) -> None:
        """Ramp to a counter value, from wherever and however fast the axis is."""
        self._abandon_homing(t_s)
        self._go(t_s, [(target + self._origin, speed)], acceleration)

    def stop(self, t_s: float, acceleration: float) -> None:
        """Brake to a halt; ends homing without a reference."""
        self._abandon_homing(t_s)
        velocity = self.trajectory.velocity(t_s)
        rest = self.trajectory.motor(t_s) + velocity * abs(velocity) / (2.0 * acceleration)
        rest = float(math.ceil(rest) if velocity > 0.0 else math.floor(rest))
        self._go(t_s, [(rest, max(abs(velocity), 1.0))], acceleration)

    def halt(self, t_s: float) -> None:
        """Stand still at once, as with the motor's current cut."""
        self._abandon_homing(t_s)
        self._go(t_s, [], 1.0)

    def home(self, t_s: float, speed: float, slow: float, acceleration: float) -> None:
        """Find the reference sensor: past it at speed, and onto it slowly from below."""
        self._finish_homing(t_s)
        sensor = float(round(self.mechanics.home_deg * self.mechanics.counts_per_deg))
        below = sensor - _HOMING_OVERRUN_DEG * self.mechanics.counts_per_deg
        self._go(t_s, [(below, speed), (sensor, slow)], acceleration)
        self._referenced = False
        self._homing = True

    def restart(self, t_s: float) -> None:
        """Power-cycle the controller: it halts, counts from 0 where it stands, and has no reference."""
        self.halt(t_s)
        self._referenced = False
        self._origin = self.trajectory.motor(t_s)

    def set_counter(self, value: float, t_s: float) -> None:
        """Call the present position by another number."""
        self._finish_homing(t_s)
        self._origin = self.trajectory.motor(t_s) - value

    # ------------------------------------------------------------------ inside
    def _made(self, segments: tuple[Segment, ...]) -> Trajectory:
        trajectory = Trajectory(segments, self.mechanics.counts_per_deg, self.mechanics.settle_s)
        self._publish(trajectory)
        return trajectory

    def _go(self, t_s: float, stations: list[tuple[float, float]], acceleration: float) -> None:
        """Ramp from here and now through stations (position, speed), resting at each."""
        position, velocity = self.trajectory.motor(t_s), self.trajectory.velocity(t_s) if stations else 0.0
        start, load, offset = t_s, self.trajectory.load(t_s), self.trajectory.at(t_s).offset
        segments: list[Segment] = []
        for station, speed in stations:
            target = self._within_stops(station)
            for leg in ramp(position, velocity, target, speed, acceleration):
                offset = self._offset(velocity + leg.acceleration * leg.duration_s / 2.0, offset)
                segment = Segment(start, position, velocity, leg.acceleration, offset, load)
                segments.append(segment)
                start += leg.duration_s
                position += velocity * leg.duration_s + leg.acceleration * leg.duration_s**2 / 2.0
                velocity += leg.acceleration * leg.duration_s
                load = follow(segment, start, self.mechanics.settle_s)
            position, velocity = target, 0.0
        position = float(round(position))
        segments.append(Segment(start, position, 0.0, 0.0, offset, load))
        self.trajectory = self._made(tuple(segments))

    def _within_stops(self, position: float) -> float:
        """Hold the motor, and with it the load, between the end stops."""
        scale = self.mechanics.counts_per_deg
        return min(max(position, self.mechanics.lowest_deg * scale), self.mechanics.highest_deg * scale)

    def _offset(self, velocity: float, before: float) -> float:
        """Backlash: the load hangs back, half the play behind a motor that runs."""
        if velocity == 0.0 or self.mechanics.backlash_deg == 0.0:
            return before
        return -math.copysign(self.mechanics.backlash_deg * self.mechanics.counts_per_deg / 2.0, velocity)

    def _finish_homing(self, t_s: float) -> None:
        if self._homing and t_s >= self.trajectory.end_s:
            self._origin = self.trajectory.rest
            self._referenced = True
            self._homing = False

    def _abandon_homing(self, t_s: float) -> None:
        self._finish_homing(t_s)
        self._homing = False
