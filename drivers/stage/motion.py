"""Compute what the moves of all stages have in common: limits, times, deadlines, progress. Touches no device."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from drivers.errors import MoveFailed, MoveTimeout, OutsideLimits
from drivers.stage import AxisLimits

DEADLINE_MARGIN_S = 3.0
"""Added to every expected time, in seconds: for a busy computer, a slow line, a controller that settles."""
PATIENCE_S = 1.5
"""A busy axis whose position has not changed for this long makes no progress; in seconds."""
HOMING_PATIENCE_S = 10.0
"""An axis creeps at its home sensor, and its counter may stand still for a while; in seconds."""
LONGEST_HOMING_S = 180.0
"""A search of the reference whose speed the controller does not tell may take minutes; in seconds."""
_HOMING_TRAVEL_DEG = 720.0
"""A rotary axis may turn once to its reference sensor, and once more back to its edge; in degrees."""
_HOMING_MARGIN_S = 30.0
"""Added to that time, in seconds: for the slow approach of the edge, and for the ramps."""
HOMED_BY_ANOTHER = "another program has homed the axis, so its zero is not known"
"""Why an axis has no reference though its controller says so: that program may have had another zero, or moved it."""
_MOST_IDLE_READS = 8
"""An idle axis whose readings never agree has failed after so many."""
POLL_S = 0.02
"""Pause between two readings of a moving axis, in seconds: the position is known at 50 Hz, and a slow line is not
filled."""


def travel_time_s(distance: float, speed: float, acceleration: float) -> float:
    """Return the time, s, of a move from rest to rest with a trapezoidal speed profile.

    With d the distance, v the highest speed and a the acceleration and deceleration, in units of one kind: ``d/v +
    v/a`` when the speed is reached (d >= v^2/a), ``2 sqrt(d/a)`` when it is not.

    >>> travel_time_s(10.0, 5.0, 10.0)
    2.5
    >>> travel_time_s(0.1, 5.0, 10.0)
    0.2
    """
    distance = abs(distance)
    if distance >= speed * speed / acceleration:
        return distance / speed + speed / acceleration
    return 2.0 * math.sqrt(distance / acceleration)


def move_time_s(limits: AxisLimits, from_deg: float, to_deg: float) -> float:
    """Return the expected time of a move of one axis, s."""
    return travel_time_s(to_deg - from_deg, limits.speed_deg_s, limits.acceleration_deg_s2)


def longest_homing_s(axis: Axis, speed_deg_s: float | None) -> float:
    """Return the longest time, s, of a search of the reference at the controller's own speed.

    None stands for a controller that does not tell it: the speed in the station file, and no less than
    `LONGEST_HOMING_S`. A speed of 0 raises `MoveFailed`.
    """
    if speed_deg_s is None:
        return max(LONGEST_HOMING_S, longest_homing_s(axis, axis.limits.speed_deg_s))
    if speed_deg_s <= 0:
        raise MoveFailed(
            "the controller's speed of the reference search is 0. Nothing was moved.",
            where=axis.name,
            remedy="Set that speed with the maker's software, then home the stage.",
        )
    return _HOMING_MARGIN_S + _HOMING_TRAVEL_DEG / speed_deg_s


def longest_move_s(
    limits: Mapping[str, AxisLimits], from_deg: Mapping[str, float], to_deg: Mapping[str, float]
) -> float:
    """Return the expected time, s, of a move of the axes of ``to_deg`` at once: the slowest one's, 0 without any."""
    return max((move_time_s(limits[axis], from_deg[axis], to_deg[axis]) for axis in to_deg), default=0.0)


def whole_range_s(limits: Mapping[str, AxisLimits]) -> float:
    """Return the expected time, s, of a move of all axes over their whole range at once."""
    lowest = {name: limit.lowest_deg for name, limit in limits.items()}
    return longest_move_s(limits, lowest, {name: limit.highest_deg for name, limit in limits.items()})


def deadline_s(limits: AxisLimits, from_deg: float, to_deg: float) -> float:
    """Return the longest time that a move may take, s: the expected time, two more ramps, and a margin."""
    ramp_s = limits.speed_deg_s / limits.acceleration_deg_s2
    return move_time_s(limits, from_deg, to_deg) + 2.0 * ramp_s + DEADLINE_MARGIN_S


def check_targets(limits: Mapping[str, AxisLimits], target_deg: Mapping[str, float], where: str) -> None:
    """Raise `OutsideLimits`, which names every target outside the soft limits, or an axis that does not exist."""
    wrong = []
    for axis, angle in target_deg.items():
        if axis not in limits:
            wrong.append(f"there is no axis {axis!r} (there are: {', '.join(limits)})")
            continue
        lowest, highest = limits[axis].lowest_deg, limits[axis].highest_deg
        if not lowest <= angle <= highest:
            wrong.append(f"{axis} {angle:g} deg is outside {lowest:g} to {highest:g} deg")
    if wrong:
        raise OutsideLimits(
            "; ".join(wrong) + ". Nothing was moved.",
            where=where,
            remedy="Change the pose in the sequence, or the station's limits if the mechanics allow.",
        )


def check_scale(axis: Axis, stated: float, present: float, unit: str, remedy: str, *, slack: float) -> None:
    """Check that a scale in the station file is the controller's, to within ``slack``, else raise `OutsideLimits`."""
    if abs(stated - present) > slack:
        raise OutsideLimits(
            f"the station file gives {stated:.9g} {unit}, the controller {present:.9g}. Nothing was set.",
            where=axis.name,
            remedy=remedy,
        )


def check_travel(
    axis: str,
    wanted: tuple[float, float],
    present: tuple[float | None, float | None],
    unit: str,
    *,
    slack: float = 0.0,
    to_deg: Callable[[float], float] = float,
) -> None:
    """Check that the limits in the station file lie within the controller's own, else raise `OutsideLimits`.

    A driver narrows the controller's limits and never widens them, because they may be those of the mechanics.
    ``present`` holds the lowest and highest position by the controller, None where it has no limit; ``slack`` allows
    for the controller's rounding; ``to_deg`` returns the angle of a position.
    """
    lowest, highest = present
    if (lowest is not None and wanted[0] < lowest - slack) or (
        highest is not None and wanted[1] > highest + slack
    ):
        counted = "" if unit == "deg" else f" ({lowest} to {highest} {unit})"
        raise OutsideLimits(
            f"the station file allows {_range_deg(wanted, to_deg)}, but the controller allows only"
            f" {_range_deg(present, to_deg)}{counted}. Nothing was set.",
            where=axis,
            remedy="Check limits and scale in the station file; if the mechanics allow it, widen the"
            " controller's own limits with its maker's software.",
        )


def _range_deg(ends: tuple[float | None, float | None], to_deg: Callable[[float], float]) -> str:
    """Return a range of positions as angles, the lower one first."""
    falls = to_deg(1.0) < to_deg(0.0)
    low, high = (
        "no limit" if end is None else f"{to_deg(end):.6g}" for end in (ends[::-1] if falls else ends)
    )
    return f"{low} to {high} deg"


@dataclass(frozen=True, kw_only=True)
class Axis(ABC):
    """One axis as the station file describes it. A family adds its scale, and how the controller names the axis."""

    name: str  # "pan", "tilt" or "roll"
    limits: AxisLimits  # Soft limits, speed and acceleration
    serial: str = ""  # Serial number of the controller; empty when it is not checked
    zero_deg: float = 0.0  # Angle at which the counter is 0, in degrees
    tolerance_deg: float = 0.002  # Largest distance of the counter from its target at rest, in degrees
    # Largest difference between encoder and counter, in degrees; not used where the encoder is the counter.
    encoder_tolerance_deg: float = 0.05

    @property
    @abstractmethod
    def scale(self) -> float:
        """Counts per degree; negative when the counter falls as the angle grows."""

    def to_counts(self, angle_deg: float) -> int:
        """Return the count nearest to an angle."""
        return round((angle_deg - self.zero_deg) * self.scale)

    def to_angle_deg(self, counts: float) -> float:
        """Return the angle of a count, in degrees."""
        return self.zero_deg + counts / self.scale


A = TypeVar("A", bound=Axis)


class MoveWatch(Generic[A]):
    """Decides from readings of one axis whether it has arrived, is still moving, or has failed.

    Arrived: two consecutive idle readings, with the position at the target. Failed: idle readings elsewhere, of which
    two in a row agree (most protocols have no checksum, and a digit can get lost); busy past the deadline; busy
    without progress.

    ``target_deg`` is None for a search of the reference, which may end anywhere; ``now_s`` is the start of the move,
    ``allowed_s`` its longest time.
    """

    def __init__(self, axis: A, target_deg: float | None, *, now_s: float, allowed_s: float) -> None:
        self.axis = axis
        self.target_deg = target_deg
        self._allowed_s = allowed_s
        self._end_s = now_s + allowed_s
        self._patience_s = HOMING_PATIENCE_S if target_deg is None else PATIENCE_S
        self._idle_reads = 0
        self._last_deg = math.nan
        self._moved_s = now_s

    def update(self, now_s: float, position_deg: float, *, busy: bool) -> bool:
        """Take one reading of the axis; return whether it has arrived, or raise `MoveFailed`."""
        self._idle_reads = 0 if busy else self._idle_reads + 1
        agrees = abs(position_deg - self._last_deg) <= self.axis.tolerance_deg
        if position_deg != self._last_deg:
            self._last_deg = position_deg
            self._moved_s = now_s
        if self._idle_reads >= 2 and (agrees or self._is_at_target() or self._idle_reads > _MOST_IDLE_READS):
            return self._ended()
        if busy and now_s - self._moved_s > self._patience_s:
            raise self._failed(
                f"busy without progress for {self._patience_s:g} s, at {position_deg:.4f} deg{self._aim()}."
            )
        if busy and now_s > self._end_s:
            raise self._late()
        return False

    def _is_at_target(self) -> bool:
        return self.target_deg is None or abs(self._last_deg - self.target_deg) <= self.axis.tolerance_deg

    def _ended(self) -> bool:
        if self.target_deg is None or self._is_at_target():
            return True
        off_deg = self._last_deg - self.target_deg
        raise self._failed(
            f"stopped at {self._last_deg:.4f} deg, {off_deg:+.4f} deg from its target"
            f" {self.target_deg:.4f} deg."
        )

    def _late(self) -> MoveTimeout:
        where = self.axis.name
        at = "" if math.isnan(self._last_deg) else f", at {self._last_deg:.4f} deg"
        if self.target_deg is None:
            return MoveTimeout(
                f"the search of the reference has not ended after {self._allowed_s:.1f} s{at}.",
                where=where,
                remedy="Check the reference sensor and its cable, and that nothing blocks the axis.",
            )
        return MoveTimeout(
            f"still moving after {self._allowed_s:.1f} s{at}{self._aim()}.",
            where=where,
            remedy="Check that nothing blocks the axis, and that its speed is the one in the station file.",
        )

    def _aim(self) -> str:
        return "" if self.target_deg is None else f" on the way to {self.target_deg:.4f} deg"

    def _failed(self, what: str) -> MoveFailed:
        return MoveFailed(
            what, where=self.axis.name, remedy="Find what blocks the axis, then home the stage and resume."
        )
