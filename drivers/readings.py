"""Knows when a value read over a line is believed: when two readings in a row agree. Touches no device.

A checksum of eight bits lets one in 256 of heavily garbled replies pass, and SCPI has none at all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from drivers.errors import ReplyGarbled

_READINGS = 5

T = TypeVar("T")


def agreeing(read: Callable[[], T], *, what: str, where: str) -> T:
    """Read until two readings in a row are equal, and return them; five times at most.

    Parameters
    ----------
    read
        Reads once.
    what, where
        What is read, and from which device, for the message.

    Raises
    ------
    ReplyGarbled
        When no two readings in a row are equal; and whatever ``read`` raises.

    >>> values = iter([5, 7, 7])
    >>> agreeing(lambda: next(values), what="the value", where="")
    7
    """
    before = read()
    for _ in range(_READINGS - 1):
        now = read()
        if now == before:
            return now
        before = now
    raise _disagreement(what, where)


class Reading(NamedTuple):
    """A position read at some time, in seconds, of an axis that moved or stood."""

    t_s: float
    position_deg: float
    moving: bool


def agreeing_position(
    read: Callable[[], Reading], *, tolerance_deg: float, speed_deg_s: float, what: str, where: str
) -> float:
    """Read a position until the readings bear each other out; five times at most.

    Of an axis that stands, two equal readings in a row do, or the middle one of three within the tolerance
    (a servo trembles); of one that moves, two that lie no further apart than it can have come.

    Parameters
    ----------
    read
        Reads once.
    tolerance_deg
        How far a standing axis may tremble.
    speed_deg_s
        The highest speed of the axis.
    what, where
        What is read, and from which device, for the message.

    Raises
    ------
    ReplyGarbled
        When they do not; and whatever ``read`` raises.
    """
    readings = [read()]
    for _ in range(_READINGS - 1):
        readings.append(read())
        before, now = readings[-2:]
        if before.moving or now.moving:
            reach_deg = tolerance_deg + speed_deg_s * (now.t_s - before.t_s)
            if abs(now.position_deg - before.position_deg) <= reach_deg:
                return now.position_deg
        elif now.position_deg == before.position_deg:
            return now.position_deg
        elif len(readings) > 2:
            low, middle, high = sorted(reading.position_deg for reading in readings[-3:])
            if high - low <= tolerance_deg:
                return middle
    raise _disagreement(what, where)


def _disagreement(what: str, where: str) -> ReplyGarbled:
    return ReplyGarbled(
        f"{_READINGS} readings of {what} do not agree.",
        where=where,
        remedy="Check the cable, and that nobody turns a knob.",
    )
