"""Repeat a request after a bad reply, and bring a line back into step.

Every protocol of this package shares the two loops that stand here. Only requests that do no harm when they are sent
twice may be repeated: questions, settings and stops. A command that moves something is sent once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol, TypeVar

from drivers.errors import ReplyError, ReplyTimeout

TRIES: Final = 3
"""How often a request is sent in all, before its last error is passed on."""
TRIES_WHEN_LATE: Final = 3
"""How much more often a request is sent when time-outs came from a computer that is too busy."""
RESYNCHRONISE_TRIES: Final = 2

T = TypeVar("T")


def do_nothing(*_arguments: object) -> None:
    """Take any arguments and do nothing: the step of a loop that a protocol does not need."""


def repeat(
    attempt: Callable[[], T], *, tries: int = TRIES, before_next: Callable[[], object] = do_nothing
) -> T:
    """Call a function until it succeeds.

    attempt: Sends one request and returns what it reads. Another call is made only after a ReplyError.
    tries: How often ``attempt`` is called in all, at least once; more often where the computer was too busy.
    before_next: Called between a failure and the next attempt.
    Returns: What ``attempt`` returned.
    Raises ReplyError: The one of the last attempt. Any other exception of ``attempt`` ends the loop at once.

    Examples
    --------
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


class Drainable(Protocol):
    """A line whose unread bytes can be thrown away, such as ``drivers.link.Link``."""

    def drain(self, quiet_s: float, limit_s: float) -> bytes:
        """See `Link.drain`."""
        ...


def resynchronise(
    link: Drainable,
    exchange_marker: Callable[[], object],
    *,
    quiet_s: float,
    limit_s: float,
    clear_device: Callable[[], object] = do_nothing,
    inspect_old: Callable[[bytes], object] = do_nothing,
    silence_after: bool = True,
    once_if_silent: bool = False,
) -> bool:
    """Bring a line back into step: throw away what is old, then prove that nothing old is left.

    The proof is a marker: a request whose answer cannot be the answer to an older request. The line is in step when
    the marker is answered and, for a protocol without message ids, nothing follows its answer. Two attempts are made.

    link: The line, held by this thread.
    exchange_marker: Sends the marker; returns False when its answer is not the expected one, and raises
      ReplyError for no valid answer.
    quiet_s: How long nothing may arrive before the line counts as silent, in seconds.
    limit_s: Longest wait for that silence, in seconds.
    clear_device: Sends what makes the device forget the beginning of a command. Called after the line was
      silent.
    inspect_old: Gets the old bytes before they are lost, for unsolicited messages in them.
    silence_after: Whether nothing may follow the marker's answer.
    once_if_silent: Whether a marker without an answer ends the attempts, unless the computer is too busy. For
      a caller that repeats the request, and with it this, by itself: a device without power is then told
      sooner.
    Returns: False when the last answer to the marker was unexpected, or something followed it.
    Raises ReplyError: The marker was not answered at the last attempt, or the device does not fall silent.
    """
    for tries_left in reversed(range(RESYNCHRONISE_TRIES)):
        inspect_old(link.drain(quiet_s, limit_s))
        clear_device()
        try:
            expected = exchange_marker() is not False
        except ReplyError as error:
            silent = isinstance(error, ReplyTimeout) and not error.late_s
            if not tries_left or (silent and once_if_silent):
                raise
            continue
        followed = silence_after and link.drain(quiet_s, limit_s)
        if expected and not followed:
            return True
    return False
