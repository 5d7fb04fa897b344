"""Courses: where a motor is at any time between two commands, and where the load on it points.

Knows trapezoidal ramps and a load that follows with a first-order lag behind the play of a gear. Everything is
immutable, so that any thread may ask. Positions are motor counts from the true zero of the load, times are
whatever clock the caller has.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

#: A load within this of its final angle has settled: 0.05 arc seconds, a thousandth of a pixel.
SETTLED_DEG = 0.05 / 3600.0


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
    if distance != 0.0:
        legs += _trapezoid(distance, abs(velocity), speed, acceleration)
    return [leg for leg in legs if leg.duration_s > 0.0]


def _trapezoid(distance: float, entry: float, speed: float, acceleration: float) -> list[Leg]:
    """Change to the highest speed, keep it, and brake; enters with a speed towards the target."""
    side = math.copysign(1.0, distance)
    peak = min(speed, math.sqrt(acceleration * abs(distance) + entry * entry / 2.0))
    change = peak - entry
    cruise = abs(distance) - (abs(peak * peak - entry * entry) + peak * peak) / (2.0 * acceleration)
    return [
        Leg(abs(change) / acceleration, side * math.copysign(acceleration, change)),
        Leg(max(0.0, cruise) / peak, 0.0),
        Leg(peak / acceleration, -side * acceleration),
    ]


class Piece(NamedTuple):
    """A time of constant acceleration; the last one of a course lasts until the next command."""

    start_s: float
    position: float
    velocity: float
    acceleration: float

    def position_at(self, t_s: float) -> float:
        """Position, counts; before the start it is that of the start."""
        s = max(0.0, t_s - self.start_s)
        return self.position + self.velocity * s + self.acceleration * s * s / 2.0

    def velocity_at(self, t_s: float) -> float:
        """Velocity, counts/s."""
        return self.velocity + self.acceleration * max(0.0, t_s - self.start_s)


@dataclass(frozen=True)
class Course:
    """Where a motor is from one command until the next.

    Attributes
    ----------
    pieces
        In order of time; in the last one it rests, or creeps.
    """

    pieces: tuple[Piece, ...]

    @classmethod
    def resting(cls, t_s: float, position: float) -> Self:
        """Make a course that stands still."""
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
        """Plan ramps through stations (position, speed), resting at each, from a position and velocity."""
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
        """Time from which on the motor rests."""
        return self.pieces[-1].start_s

    @property
    def rest(self) -> float:
        """Where it comes to rest."""
        return self.pieces[-1].position

    def index(self, t_s: float) -> int:
        """Find the number of the piece of a time, from 0."""
        return max(0, bisect_right(self.pieces, t_s, key=lambda piece: piece.start_s) - 1)

    def at(self, t_s: float) -> Piece:
        """Find the piece of a time."""
        return self.pieces[self.index(t_s)]

    def position(self, t_s: float) -> float:
        """Position at a time, counts."""
        return self.at(t_s).position_at(t_s)

    def velocity(self, t_s: float) -> float:
        """Velocity at a time, counts/s."""
        return self.at(t_s).velocity_at(t_s)

    def until(self, t_s: float, creep: float = 0.0) -> Self:
        """Make the course that ends at once at a time, on a whole count; it may creep from there, counts/s."""
        if t_s >= self.end_s and creep == 0.0:
            return self
        kept = [piece for piece in self.pieces if piece.start_s < t_s]
        return type(self)((*kept, Piece(t_s, float(round(self.position(t_s))), creep, 0.0)))

    def first_beyond(self, lowest: float, highest: float) -> float | None:
        """Time at which the course first leaves a range, None if it stays inside."""
        for index, piece in enumerate(self.pieces):
            ends_s = self.pieces[index + 1].start_s if index + 1 < len(self.pieces) else piece.start_s
            for bound, outwards in ((highest, 1.0), (lowest, -1.0)):
                if (piece.position_at(ends_s) - bound) * outwards > 0.0:
                    return piece.start_s + _time_to(bound, piece)
        return None


def _time_to(position: float, piece: Piece) -> float:
    """Earliest time after a piece's start at which it passes a position that it does pass; 0 if it is past."""
    distance, v, a = position - piece.position, piece.velocity, piece.acceleration
    side = math.copysign(1.0, v if v != 0.0 else a)
    root = math.sqrt(max(0.0, v * v + 2.0 * a * distance))
    speed_sum = v + side * root
    return max(0.0, 2.0 * distance / speed_sum) if speed_sum != 0.0 else 0.0


@dataclass(frozen=True)
class Pointing:
    """Where the load on a motor points while the motor follows a course.

    The load x follows the motor q with a first-order lag, ``settle_s dx/dt = q - x``, which has a closed form
    for each piece: a parabola behind the motor's, and an exponential that forgets where the load began.

    Attributes
    ----------
    course
        The motor's.
    offsets
        Load minus motor at rest, for each piece: half the play of the gear, by the side it came from.
    loads
        Where the load is at the start of each piece.
    counts_per_deg, settle_s
        Scale, and time constant of the lag.
    """

    course: Course
    offsets: tuple[float, ...]
    loads: tuple[float, ...]
    counts_per_deg: float
    settle_s: float

    @classmethod
    def following(
        cls,
        course: Course,
        load: float,
        offset: float,
        backlash: float,
        counts_per_deg: float,
        settle_s: float,
    ) -> Self:
        """Let a load follow a course, from where it is and with the play of the gear on the side it is."""
        offsets: list[float] = []
        loads: list[float] = [load]
        ends = [piece.start_s for piece in course.pieces[1:]]
        for piece, end_s in zip(course.pieces, [*ends, course.end_s], strict=True):
            middle = piece.velocity_at((piece.start_s + end_s) / 2.0)
            if backlash != 0.0 and middle != 0.0:
                offset = -math.copysign(backlash / 2.0, middle)
            offsets.append(offset)
            loads.append(_follow(piece, offset, loads[-1], end_s, settle_s))
        return cls(course, tuple(offsets), tuple(loads[:-1]), counts_per_deg, settle_s)

    @property
    def rest(self) -> float:
        """Where the load comes to rest, counts."""
        return self.course.rest + self.offsets[-1]

    @cached_property
    def settled_from_s(self) -> float:
        """Time from which on the load stands at its final angle to within `SETTLED_DEG`; infinite if it creeps."""
        if self.course.pieces[-1].velocity != 0.0:
            return math.inf
        residual = abs(self.loads[-1] - self.rest) / self.counts_per_deg
        if residual <= SETTLED_DEG:
            return self.course.end_s
        return self.course.end_s + self.settle_s * math.log(residual / SETTLED_DEG)

    def load(self, t_s: float) -> float:
        """Where the load is, counts."""
        index = self.course.index(t_s)
        return _follow(self.course.pieces[index], self.offsets[index], self.loads[index], t_s, self.settle_s)

    def angle_deg(self, t_s: float) -> float:
        """Where the load points; exactly its final angle once it has settled."""
        load = self.rest if t_s >= self.settled_from_s else self.load(t_s)
        return load / self.counts_per_deg


def _follow(piece: Piece, offset: float, load: float, t_s: float, settle_s: float) -> float:
    """Solve settle_s dx/dt = q - x over a piece of constant acceleration."""
    motor = piece.position_at(t_s) + offset
    if settle_s <= 0.0:
        return motor
    lag = settle_s * settle_s * piece.acceleration
    steady = motor - settle_s * piece.velocity_at(t_s) + lag
    steady_at_start = piece.position + offset - settle_s * piece.velocity + lag
    return steady + (load - steady_at_start) * math.exp(-max(0.0, t_s - piece.start_s) / settle_s)
