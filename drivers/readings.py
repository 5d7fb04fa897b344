"""Knows when a value read over a line is believed: when two readings in a row agree. Touches no device.

A checksum of eight bits lets one in 256 of heavily garbled replies pass, and SCPI has none at all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from drivers.errors import ReplyGarbled

_READINGS = 5

T = TypeVar("T")


def agreeing(read: Callable[[], T], alike: Callable[[T, T], bool], *, what: str, where: str) -> T:
    """Read until two readings in a row are alike, and return the second; five times at most.

    Parameters
    ----------
    read
        Reads once.
    alike
        Whether two readings, the earlier first, tell the same.
    what, where
        What is read, and from which device, for the message.

    Raises
    ------
    ReplyGarbled
        When no two readings in a row are alike; and whatever ``read`` raises.

    >>> values = iter([5, 7, 7])
    >>> agreeing(lambda: next(values), int.__eq__, what="the value", where="")
    7
    """
    before = read()
    for _ in range(_READINGS - 1):
        now = read()
        if alike(before, now):
            return now
        before = now
    raise ReplyGarbled(
        f"{_READINGS} readings of {what} do not agree.",
        where=where,
        remedy="Check the cable, and that nobody turns a knob.",
    )
