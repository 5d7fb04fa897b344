"""Decide when a value that was read over a line is believed: when consecutive readings agree. Touches no device.

A checksum of eight bits lets one in 256 heavily garbled replies pass, and most text protocols have no checksum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

from drivers.errors import ReplyGarbled

_MOST_READINGS = 5

T = TypeVar("T")


def read_until_agreed(read: Callable[[], T], *, what: str, where: str) -> T:
    """Read until two consecutive readings are equal, at most five times.

    read: Reads once.
    Raises ReplyGarbled: No two consecutive readings are equal. Exceptions of ``read`` pass through.

    Examples
    --------
    >>> values = iter([5, 7, 7])
    >>> read_until_agreed(lambda: next(values), what="the value", where="")
    7
    """
    before = read()
    for _ in range(_MOST_READINGS - 1):
        now = read()
        if now == before:
            return now
        before = now
    raise _disagreement(what, where)


class Reading(NamedTuple):
    """One reading of an axis."""

    t_s: float  # Time of the reading, in seconds
    position_deg: float  # Position, in degrees
    moving: bool  # Whether the axis was moving


def read_position_until_agreed(
    read: Callable[[], Reading], *, tolerance_deg: float, speed_deg_s: float, what: str, where: str
) -> float:
    """Read a position until consecutive readings agree, at most five times.

    Of an axis at rest, two equal readings agree, or three within the tolerance (a servo trembles): the median counts.
    Of a moving axis, two readings agree when the axis can have moved from one to the other in the time between them.

    read: Reads once.
    tolerance_deg: Largest tremble of an axis at rest, in degrees.
    speed_deg_s: Highest speed of the axis, in degrees per second.
    Returns: Position, in degrees.
    Raises ReplyGarbled: The readings do not agree. Exceptions of ``read`` pass through.
    """
    readings = [read()]
    for _ in range(_MOST_READINGS - 1):
        readings.append(read())
        if (position_deg := _agreed(readings, tolerance_deg, speed_deg_s)) is not None:
            return position_deg
    raise _disagreement(what, where)


def _agreed(readings: Sequence[Reading], tolerance_deg: float, speed_deg_s: float) -> float | None:
    """Return the position on which the latest readings agree; None when they do not."""
    before, now = readings[-2:]
    if before.moving or now.moving:
        reach_deg = tolerance_deg + speed_deg_s * (now.t_s - before.t_s)
        return now.position_deg if abs(now.position_deg - before.position_deg) <= reach_deg else None
    if now.position_deg == before.position_deg:
        return now.position_deg
    low, *middle, high = sorted(reading.position_deg for reading in readings[-3:])
    return middle[0] if middle and high - low <= tolerance_deg else None


def _disagreement(what: str, where: str) -> ReplyGarbled:
    return ReplyGarbled(
        f"{_MOST_READINGS} readings of {what} do not agree.",
        where=where,
        remedy="Check the cable, and that nobody operates the device by hand.",
    )
