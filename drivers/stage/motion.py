"""Knows what every stage's moves have in common: limits, times, deadlines, progress. Touches no device."""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.errors import MoveFailed, MoveTimeout, OutsideLimits
from drivers.stage import AxisLimits

DEADLINE_MARGIN_S = 3.0
"""Added to every expected time: a busy host, a slow line, a controller's settling."""
PATIENCE_S = 1.5
"""A busy axis whose position has not changed for this long makes no progress."""
LONGEST_HOMING_S = 180.0
"""A home-built stage may search its reference for minutes."""
POLL_S = 0.02
"""Pause between two looks at a moving axis."""


def travel_time_s(distance: float, speed: float, acceleration: float) -> float:
    """Time of a move from rest to rest with a trapezoidal speed, in seconds.

    With d the distance, v the speed and a the acceleration: ``d/v + v/a`` when the speed is reached
    (d >= v^2/a), ``2 sqrt(d/a)`` when it is not. Any one unit of length in all three.

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
    """Return the expected time of one axis's move, in seconds."""
    return travel_time_s(to_deg - from_deg, limits.speed_deg_s, limits.acceleration_deg_s2)


def longest_move_s(
    limits: Mapping[str, AxisLimits], from_deg: Mapping[str, float], to_deg: Mapping[str, float]
) -> float:
    """Time of the slowest axis of a move in which all start together, in seconds."""
    return max((move_time_s(limits[axis], from_deg[axis], to_deg[axis]) for axis in to_deg), default=0.0)


def deadline_s(limits: AxisLimits, from_deg: float, to_deg: float) -> float:
    """Longest time a move may take, in seconds: expected time, two ramps more, and a margin."""
    ramp_s = limits.speed_deg_s / limits.acceleration_deg_s2
    return move_time_s(limits, from_deg, to_deg) + 2.0 * ramp_s + DEADLINE_MARGIN_S


def check_targets(limits: Mapping[str, AxisLimits], target_deg: Mapping[str, float], where: str) -> None:
    """Raise OutsideLimits, naming every axis at fault, unless all targets may be gone to."""
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


def check_travel(
    axis: str,
    wanted: tuple[float, float],
    present: tuple[float | None, float | None],
    unit: str,
    *,
    slack: float = 0.0,
) -> None:
    """Raise OutsideLimits unless the station's limits lie within the controller's own.

    The controller's are narrowed by a driver, never widened: they may be those of the mechanics.

    Parameters
    ----------
    axis
        Name of the axis.
    wanted, present
        Lowest and highest position by the station file and by the controller (None: it has none).
    unit
        Of both, for the message.
    slack
        What the controller's rounding may take away.
    """
    lowest, highest = present
    if (lowest is not None and wanted[0] < lowest - slack) or (
        highest is not None and wanted[1] > highest + slack
    ):
        raise OutsideLimits(
            f"the station file's limits, {wanted[0]:.8g} to {wanted[1]:.8g} {unit}, reach beyond the"
            f" controller's, {lowest} to {highest} {unit}. Nothing was set.",
            where=axis,
            remedy="Check limits and scale in the station file; if the mechanics allow it, widen the"
            " controller's own limits with its maker's software.",
        )


class MoveWatch:
    """Decides, from what is read of one axis in motion, whether it has arrived, goes on, or has failed.

    Arrived: two reads in a row say idle, and the position is at the target. Failed: idle twice elsewhere;
    busy past the deadline; busy without progress.

    Parameters
    ----------
    axis
        Name of the axis, for messages.
    target_deg
        Where it is to arrive; None for a search for the reference, which ends wherever it ends.
    tolerance_deg
        How far from the target counts as at it.
    now_s, allowed_s
        Time at the start of the move and how long it may take, in seconds.
    patience_s
        Longest time busy without change of position.
    """

    def __init__(
        self,
        axis: str,
        target_deg: float | None,
        *,
        tolerance_deg: float,
        now_s: float,
        allowed_s: float,
        patience_s: float = PATIENCE_S,
    ) -> None:
        self.axis = axis
        self.target_deg = target_deg
        self._tolerance_deg = tolerance_deg
        self._allowed_s = allowed_s
        self._end_s = now_s + allowed_s
        self._patience_s = patience_s
        self._idle_reads = 0
        self._last_deg = math.nan
        self._moved_s = now_s

    def look(self, now_s: float, position_deg: float, *, busy: bool) -> bool:
        """Take one reading of the axis; True when it has arrived.

        Raises MoveFailed, MoveTimeout.
        """
        self._idle_reads = 0 if busy else self._idle_reads + 1
        if position_deg != self._last_deg:
            self._last_deg = position_deg
            self._moved_s = now_s
        if self._idle_reads >= 2:
            return self._ended()
        if busy and now_s - self._moved_s > self._patience_s:
            raise self._failed(
                f"busy without progress for {self._patience_s:g} s, at {position_deg:.4f} deg{self._aim()}."
            )
        if now_s > self._end_s:
            raise MoveTimeout(
                f"still moving after {self._allowed_s:.1f} s, at {position_deg:.4f} deg{self._aim()}.",
                where=self.axis,
                remedy="See that nothing blocks the axis, and that its speed is the station file's.",
            )
        return False

    def _ended(self) -> bool:
        if self.target_deg is None:
            return True
        off_deg = self._last_deg - self.target_deg
        if abs(off_deg) <= self._tolerance_deg:
            return True
        raise self._failed(
            f"stopped at {self._last_deg:.4f} deg, {off_deg:+.4f} deg from its target"
            f" {self.target_deg:.4f} deg."
        )

    def _aim(self) -> str:
        return "" if self.target_deg is None else f" on the way to {self.target_deg:.4f} deg"

    def _failed(self, what: str) -> MoveFailed:
        return MoveFailed(what, where=self.axis, remedy="See what blocks the axis, then home and resume.")
