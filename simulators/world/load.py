"""Trajectory of the load on a motor: its angle while the motor moves, and when it has settled.

The load follows with a first-order lag, behind the play of a gear. Objects are immutable, so that any thread may read
them. Positions are motor counts from the true zero of the load; times are those of the caller's clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Self

from simulators.world.trajectory import MotorTrajectory, Piece

SETTLED_DEG = 0.05 / 3600.0
"""A load within this of its final angle has settled: 0.05 arc seconds, a thousandth of a pixel."""


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
        """Return the trajectory of a load on a motor.

        load: Position of the load at the start, counts.
        offset: Load minus motor at the start, counts, from the play of the gear.
        backlash: Play of the gear, counts.
        counts_per_deg: Scale, motor counts per degree of the load.
        settle_s: Time constant of the lag; 0 for none.
        """
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
        """Return the position of the load at a time.

        Returns: Position, counts.
        """
        index = self.motor.index(t_s)
        return _follow(self.motor.pieces[index], self.offsets[index], self.loads[index], t_s, self.settle_s)

    def angle_deg(self, t_s: float) -> float:
        """Return the angle of the load at a time.

        Returns: Angle; exactly the final one once the load has settled.
        """
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
