"""Read a value until consecutive readings agree; only then is it believed.

A checksum of eight bits lets one in 256 heavily garbled replies pass, and most text protocols have none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeVar

from drivers.errors import ReplyGarbled

_MOST_READINGS: Final = 5  # Two that agree are wanted

T = TypeVar("T")


def read_until_agreed(read: Callable[[], T], *, what: str, where: str) -> T:
    """Read until two consecutive readings are equal, at most five times; else raise `ReplyGarbled`.

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
    """Read a position, degrees, until consecutive readings agree, at most five times; else raise `ReplyGarbled`.

    Of an axis at rest, two equal readings agree, or three within the tolerance (a servo trembles): the median counts.
    Of a moving axis, two readings agree when the axis can have moved from one to the other in the time between them.
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
