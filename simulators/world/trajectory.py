"""Trajectories of a motor and of the load on it: their positions over time between two commands.

A motor follows trapezoidal ramps; the load follows it with a first-order lag, behind the play of a gear. Objects are
immutable, so that any thread may read them. Positions are motor counts from the true zero of the load; times are those
of the caller's clock.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

SETTLED_DEG = 0.05 / 3600.0
"""A load within this of its final angle has settled: 0.05 arc seconds, a thousandth of a pixel."""


class RampPhase(NamedTuple):
    """A part of a ramp."""

    duration_s: float
    acceleration: float  # Constant acceleration, counts/s^2


def ramp(
    position: float, velocity: float, target: float, speed: float, acceleration: float
) -> list[RampPhase]:
    """Plan a trapezoidal velocity profile from a position and velocity to rest at a target, counts.

    An axis that runs the wrong way, or too fast to stop in time, brakes to a halt first. There are four legs at most,
    and none if the axis already rests at the target.

    >>> [tuple(leg) for leg in ramp(0.0, 0.0, 100.0, 10.0, 10.0)]
    [(1.0, 10.0), (9.0, 0.0), (1.0, -10.0)]
    """
    legs: list[RampPhase] = []
    distance = target - position
    stopping = velocity * abs(velocity) / (2.0 * acceleration)
    if velocity != 0.0 and (distance * velocity <= 0.0 or abs(distance) < abs(stopping)):
        legs.append(RampPhase(abs(velocity) / acceleration, -math.copysign(acceleration, velocity)))
        distance -= stopping
        velocity = 0.0
    if distance != 0.0:
        legs += _trapezoid(distance, abs(velocity), speed, acceleration)
    return [leg for leg in legs if leg.duration_s > 0.0]


def _trapezoid(distance: float, entry: float, speed: float, acceleration: float) -> list[RampPhase]:
    """Change to the highest speed, keep it, and brake; ``entry`` is the speed v0 towards the target at the start.

    Constant acceleration a: v^2 changes by 2 a times the way. If the whole distance d is needed, the peak p thus has
    p^2 = a d + v0^2 / 2.
    """
    side = math.copysign(1.0, distance)
    peak = min(speed, math.sqrt(acceleration * abs(distance) + entry * entry / 2.0))
    change = peak - entry
    cruise = abs(distance) - (abs(peak * peak - entry * entry) + peak * peak) / (2.0 * acceleration)
    return [
        RampPhase(abs(change) / acceleration, side * math.copysign(acceleration, change)),
        RampPhase(max(0.0, cruise) / peak, 0.0),
        RampPhase(peak / acceleration, -side * acceleration),
    ]


class Piece(NamedTuple):
    """An interval of constant acceleration; the last one of a trajectory lasts until the next command."""

    start_s: float
    position: float  # Position of the motor at that time, counts
    velocity: float  # Velocity of the motor at that time, counts/s
    acceleration: float  # Constant acceleration, counts/s^2

    def position_at(self, t_s: float) -> float:
        """Return the position at a time."""
        s = max(0.0, t_s - self.start_s)
        return self.position + self.velocity * s + self.acceleration * s * s / 2.0

    def velocity_at(self, t_s: float) -> float:
        """Return the velocity at a time."""
        return self.velocity + self.acceleration * max(0.0, t_s - self.start_s)


@dataclass(frozen=True)
class MotorTrajectory:
    """Position of a motor over time, from one command to the next."""

    # Intervals in order of time; in the last one the motor rests, or drifts slowly.
    pieces: tuple[Piece, ...]

    @classmethod
    def resting(cls, t_s: float, position: float) -> Self:
        """Return the trajectory of a motor that stands still."""
        return cls((Piece(t_s, position, 0.0, 0.0),))

    @classmethod
    def through(
        cls,
        t_s: float,
        position: float,
        velocity: float,
        stations: list[tuple[float, float]],
        acceleration: float,
    ) -> Self:
        """Plan ramps through positions (counts, each with the speed limit of its ramp, counts/s), with stops there."""
        pieces: list[Piece] = []
        for station, speed in stations:
            for leg in ramp(position, velocity, station, speed, acceleration):
                piece = Piece(t_s, position, velocity, leg.acceleration)
                pieces.append(piece)
                t_s += leg.duration_s
                position, velocity = piece.position_at(t_s), piece.velocity_at(t_s)
            position, velocity = station, 0.0
        return cls((*pieces, Piece(t_s, position, 0.0, 0.0)))

    @property
    def start_s(self) -> float:
        """Time of the command."""
        return self.pieces[0].start_s

    @property
    def end_s(self) -> float:
        """Time at which the motor comes to rest."""
        return self.pieces[-1].start_s

    @property
    def rest(self) -> float:
        """Position at which the motor comes to rest, counts."""
        return self.pieces[-1].position

    def index(self, t_s: float) -> int:
        """Return the index of the piece at a time."""
        return max(0, bisect_right(self.pieces, t_s, key=lambda piece: piece.start_s) - 1)

    def at(self, t_s: float) -> Piece:
        """Return the piece at a time; the first one before the command."""
        return self.pieces[self.index(t_s)]

    def position(self, t_s: float) -> float:
        """Return the motor's position at a time."""
        return self.at(t_s).position_at(t_s)

    def velocity(self, t_s: float) -> float:
        """Return the motor's velocity at a time."""
        return self.at(t_s).velocity_at(t_s)

    def until(self, t_s: float, creep: float = 0.0) -> Self:
        """Return the trajectory that stops abruptly at a time, on a whole count."""
        if t_s >= self.end_s and creep == 0.0:
            return self
        kept = [piece for piece in self.pieces if piece.start_s < t_s]
        return type(self)((*kept, Piece(t_s, float(round(self.position(t_s))), creep, 0.0)))

    def first_beyond(self, lowest: float, highest: float) -> float | None:
        """Return the time at which the trajectory first leaves a range; None if it stays inside."""
        for index, piece in enumerate(self.pieces):
            ends_s = self.pieces[index + 1].start_s if index + 1 < len(self.pieces) else piece.start_s
            for bound, outwards in ((highest, 1.0), (lowest, -1.0)):
                if (piece.position_at(ends_s) - bound) * outwards > 0.0:
                    return piece.start_s + _time_to(bound, piece)
        return None


def _time_to(position: float, piece: Piece) -> float:
    """Return when, at the earliest, a piece passes a position, as it must; 0 if it starts beyond it.

    The root of d = v t + a t^2 / 2 as t = 2 d / (v + sqrt(v^2 + 2 a d)), which also holds for a = 0.
    """
    distance, v, a = position - piece.position, piece.velocity, piece.acceleration
    side = math.copysign(1.0, v if v != 0.0 else a)
    root = math.sqrt(max(0.0, v * v + 2.0 * a * distance))
    speed_sum = v + side * root
    return max(0.0, 2.0 * distance / speed_sum) if speed_sum != 0.0 else 0.0


@dataclass(frozen=True)
class LoadTrajectory:
    """Position and angle of a load over time, while its motor follows a trajectory.

    The load x follows the motor q with a first-order lag, ``settle_s dx/dt = q - x``. For each piece this has a closed
    form: a parabola behind the motor's, and an exponential decay of the load's initial distance from it.
    """

    motor: MotorTrajectory
    # Load minus motor at rest, counts, for each piece: half the play of the gear, with the sign of the side
    # that the load came from.
    offsets: tuple[float, ...]
    loads: tuple[float, ...]  # Position of the load at the start of each piece, counts
    counts_per_deg: float
    settle_s: float

    @classmethod
    def following(
        cls,
        motor: MotorTrajectory,
        load: float,
        offset: float,
        backlash: float,
        counts_per_deg: float,
        settle_s: float,
    ) -> Self:
        """Return the trajectory of a load on a motor."""
        offsets: list[float] = []
        loads: list[float] = [load]
        ends = [piece.start_s for piece in motor.pieces[1:]]
        for piece, end_s in zip(motor.pieces, [*ends, motor.end_s], strict=True):
            middle = piece.velocity_at((piece.start_s + end_s) / 2.0)
            if backlash != 0.0 and middle != 0.0:
                offset = -math.copysign(backlash / 2.0, middle)
            offsets.append(offset)
            loads.append(_follow(piece, offset, loads[-1], end_s, settle_s))
        return cls(motor, tuple(offsets), tuple(loads[:-1]), counts_per_deg, settle_s)

    @property
    def rest(self) -> float:
        """Position at which the load comes to rest, counts."""
        return self.motor.rest + self.offsets[-1]

    @cached_property
    def settled_from_s(self) -> float:
        """Time from which on the load is within `SETTLED_DEG` of its final angle; infinite if the motor drifts."""
        if self.motor.pieces[-1].velocity != 0.0:
            return math.inf
        residual = abs(self.loads[-1] - self.rest) / self.counts_per_deg
        if residual <= SETTLED_DEG:
            return self.motor.end_s
        return self.motor.end_s + self.settle_s * math.log(residual / SETTLED_DEG)

    def load(self, t_s: float) -> float:
        """Return the position of the load at a time."""
        index = self.motor.index(t_s)
        return _follow(self.motor.pieces[index], self.offsets[index], self.loads[index], t_s, self.settle_s)

    def angle_deg(self, t_s: float) -> float:
        """Return the angle of the load at a time."""
        load = self.rest if t_s >= self.settled_from_s else self.load(t_s)
        return load / self.counts_per_deg


def _follow(piece: Piece, offset: float, load: float, t_s: float, settle_s: float) -> float:
    """Solve tau dx/dt = q - x, tau = settle_s, over a piece of constant acceleration.

    x = q - tau q' + tau^2 q'' + C exp(-t / tau), with C from the load at the start of the piece.
    """
    motor = piece.position_at(t_s) + offset
    if settle_s <= 0.0:
        return motor
    lag = settle_s * settle_s * piece.acceleration
    steady = motor - settle_s * piece.velocity_at(t_s) + lag
    steady_at_start = piece.position + offset - settle_s * piece.velocity + lag
    return steady + (load - steady_at_start) * math.exp(-max(0.0, t_s - piece.start_s) / settle_s)
