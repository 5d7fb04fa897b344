"""Ask again: after a bad reply, and until consecutive readings agree. Touches no device.

Only requests that do no harm when they are sent twice may be repeated: questions, settings and stops. A command that
moves something is sent once. A value is believed when consecutive readings agree, because a checksum of eight bits lets
one in 256 heavily garbled replies pass, and most text protocols have no checksum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeVar

from drivers.errors import ReplyError, ReplyGarbled, ReplyTimeout

TRIES: Final = 3
"""How often a request is sent in all, before its last error is passed on."""
TRIES_WHEN_LATE: Final = 3
"""How much more often a request is sent when time-outs came from a computer that is too busy."""

T = TypeVar("T")


def do_nothing(*_arguments: object) -> None:
    """Take any arguments and do nothing: the step of a loop that a protocol does not need."""


def repeat(
    attempt: Callable[[], T], *, tries: int = TRIES, before_next: Callable[[], object] = do_nothing
) -> T:
    """Call a function until it succeeds; again only after a `ReplyError`, the last of which is raised.

    ``tries`` is how often it is called in all, at least once; more often where the computer was too busy.
    ``before_next`` is called between a failure and the next attempt.

    >>> replies = iter(["", "", "17"])
    >>> def ask():
    ...     if not (reply := next(replies)):
    ...         raise ReplyError("no reply.")
    ...     return reply
    >>> repeat(ask)
    '17'
    """
    late = False
    for _ in range(tries - 1):
        try:
            return attempt()
        except ReplyError as error:
            before_next()
            late = late or (isinstance(error, ReplyTimeout) and error.late_s > 0)
    for _ in range(TRIES_WHEN_LATE if late else 0):
        try:
            return attempt()
        except ReplyTimeout as error:
            if not error.late_s:
                raise
            before_next()
    return attempt()


_MOST_READINGS: Final = 5


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
