"""Share one line between requests and replies: one lock, deadlines, resynchronising, unsolicited lines; ask again.

A reply that is late, cut or garbled leaves the line *out of step*: the next reply might be an old one. The link then
resynchronises before it sends the next request, so no reply is ever taken for the answer to another request.

The wait for a reply runs on the system's own clock and ends at its deadline, which a busy computer stretches
(`drivers.lateness`). The operator cannot interrupt it, because an exchange that is broken off would leave the line out
of step; drivers wait *between* exchanges, through their clock. A stop is sent without resynchronising, after one
exchange of another thread at most.

Only what does no harm when it is sent twice is repeated: questions, settings and stops.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ClassVar, Final, TypeVar

from drivers.agreed_reading import read_until_agreed
from drivers.clock import Clock
from drivers.errors import PortError, PortLost, ReplyError, ReplyGarbled, ReplyTimeout
from drivers.lateness import REMEDY as BUSY_REMEDY
from drivers.lateness import Deadline, busy_text
from drivers.serial_port import Port, ReopeningPort
from drivers.silence import ECHO_REMEDY, KEPT, ONE_AT_A_TIME, Cause, known_cause, why_incomplete
from drivers.visa_port import VisaPort
from drivers.wire_log import Direction, WireLog

TRIES: Final = 3
"""How often a request is sent in all, before its last error is passed on: one lost message is chance, three are a
fault."""
TRIES_WHEN_LATE: Final = 3
"""How much more often a request is sent when time-outs came from a computer that is too busy."""

LONGEST_LINE = 4096
"""Longest line, in bytes. A longer one comes from a device that sends without pause, or from another protocol."""

RESYNCHRONISE_TRIES: Final = 2  # A second marker, if the first one was lost
CONNECT_TRIES: Final = 3  # As many as those of a request
CONNECT_PAUSE_S: Final = 0.5
"""A device that has closed a connection may need a moment before it accepts another one."""

_LONGEST_WAIT_S = 0.25
"""Longest single wait after a deadline was stretched, in seconds. After each the link uses its clock, as a sign of
life."""

T = TypeVar("T")
P = TypeVar("P")


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


class ReplyReader:
    """Reads the reply to one request, whole within ``deadline_s``, for ``read_reply``; this thread holds the line.

    ``unknown``: should the device be silent, it does not know the request, because it has just answered another one.
    """

    def __init__(self, link: Link, request: bytes, deadline_s: float, *, unknown: bool = False) -> None:
        self._link = link
        self._request = request
        self._unknown = request if unknown else b""
        self._deadline_s = deadline_s
        self._deadline = Deadline(deadline_s, link.name)

    def read_line(self) -> bytes:
        """Read the next line that is no unsolicited message, of ``LONGEST_LINE`` at most."""
        while True:
            line = self._link.take_line()
            if line is None:
                self._wait_for_more()
            elif not self._link.take_unsolicited(line):
                if self._link.TELLS_ECHO and line.startswith(self._request):
                    sent_back = f"the line sends back what it is sent: {self._request!r}."
                    raise self._link.garbled_reply(sent_back, ECHO_REMEDY)
                return line

    def read_exactly(self, count: int) -> bytes:
        """Read the next ``count`` bytes."""
        while True:
            data = self._link.take(count)
            if data is not None:
                return data
            self._wait_for_more()

    def _wait_for_more(self) -> None:
        left_s, longer_s = self._deadline.left_s(), 0.0
        while left_s > 0:
            if self._link.receive(left_s):
                return
            # No longer than this computer was late, whatever the port's own time is.
            late_s = self._deadline.late_s() - longer_s
            left_s = min(self._deadline.left_s(), _LONGEST_WAIT_S, late_s)
            longer_s += max(left_s, 0.0)
        what, late_s = f"no complete reply within {self._deadline_s:g} s", self._deadline.starved_s()
        why, remedy = (
            Cause(busy_text(late_s), BUSY_REMEDY) if late_s else self._link.why_silent(self._unknown)
        )
        end = f"; {why}." if why else "."
        raise ReplyTimeout(f"{what}{end}", where=self._link.name, remedy=remedy, late_s=late_s)


class Link(ABC):
    """A line to one device or a chain of devices. Threads share it; one exchange is made at a time.

    ``wire_log`` records every byte. While a thread holds ``lock``, no other thread can send.
    """

    TELLS_ECHO: ClassVar[bool] = False
    """Whether no reply of this protocol begins with its request, so that an echo can be told."""
    terminator: bytes = b"\n"
    """End of a line that the device sends."""
    GARBLED_REMEDY: ClassVar[str] = "Check the cable, the port and the baud rate."
    SILENT_REMEDY: ClassVar[str] = (
        "Check that the device is switched on, and that the station file has its port, its baud rate, its"
        " frame, and the addresses of a chain."
    )
    reply_s: float = 1.0
    """Longest time for a whole reply, unless an exchange has its own, in seconds; most of it is for a busy computer."""
    quiet_s: float = 0.05
    """After this time without a byte the line counts as silent, in seconds."""
    longest_drain_s: float = 1.0
    """Longest wait for that silence, in seconds."""

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self.lock = threading.RLock()
        self.name = port.name
        self._port = port
        self._clock = clock
        self._wire_log = wire_log
        self._buffer = bytearray()
        self._heard = b""  # The latest bytes, read or not
        self._in_step = True
        """Whether the next reply belongs to the next request, as far as is known."""
        self._proven = False  # Whether the device has just answered the marker of ``prove_in_step``
        self.connections = 1
        """How often the port was opened."""
        self._urgent = False
        self._urgent_reply_s: float | None = None

    @abstractmethod
    def _resynchronise(self) -> None:
        """Bring the line back into step (see ``prove_in_step``), or raise `ReplyError`.

        It is called with the lock held, may call ``drain`` and exchange ``urgently``.
        """

    def take_unsolicited(self, line: bytes) -> bool:  # noqa: ARG002 - most protocols have no such messages
        """Take a line that answers no request; return whether it is one."""
        return False

    def is_filler(self, data: bytes) -> bool:
        """Whether bytes that answer no request say nothing, such as a prompt."""
        return not data

    @property
    def unread(self) -> bytes:
        """Bytes that have arrived and that nobody has taken yet."""
        return bytes(self._buffer)

    def exchange(
        self,
        request: bytes,
        read_reply: Callable[[ReplyReader], T],
        *,
        deadline_s: float | None = None,
    ) -> T:
        """Send a request and return what ``read_reply`` makes of its reply, alone on the line.

        ``read_reply`` raises `ReplyGarbled` when the bytes are no reply to this request; ``deadline_s`` is for the
        whole reply; None stands for ``reply_s``. After an error the line is resynchronised before the next request. On
        a port that is gone and can be opened again, the request is sent once more after the port was opened again.
        """
        with self.lock:
            try:
                return self._exchange_once(request, read_reply, deadline_s)
            except PortLost as lost:
                if not self.connect_again(lost):
                    raise
            return self._exchange_once(request, read_reply, deadline_s)

    def agreed(self, read: Callable[[], T], what: str) -> T:
        """Return a value on which two readings in a row agree; see `drivers.agreed_reading`."""
        return read_until_agreed(read, what=what, where=self.name)

    def connect_again(self, lost: PortLost | None = None) -> bool:
        """Open a port again that can be, and ask who is there before the next request; False for any other port.

        Without ``lost`` only a connection on a network. A port that cannot be opened raises ``lost``, with the reason,
        or the error of opening.
        """
        if not isinstance(self._port, ReopeningPort | VisaPort) or not (lost or self._port.is_network):
            return False
        with self.lock:
            for tries_left in reversed(range(CONNECT_TRIES if self._port.is_network else 1)):
                try:
                    self._port.reopen()
                    break
                except PortError as error:
                    if tries_left:
                        self._clock.sleep(CONNECT_PAUSE_S)
                    elif lost is None:
                        raise
                    else:
                        what = f"{lost.what} It cannot be opened again: {error.what}"
                        raise PortLost(what, where=self.name, remedy=lost.remedy) from error
            self._buffer.clear()
            self._in_step = False
            self.connections += 1
        return True

    def _exchange_once(
        self, request: bytes, read_reply: Callable[[ReplyReader], T], deadline_s: float | None
    ) -> T:
        with self.lock:
            self._proven = False
            self.bring_into_step()
            if deadline_s is None:
                deadline_s = self.reply_s if self._urgent_reply_s is None else self._urgent_reply_s
            in_step_before = self._in_step
            # Whatever ends this exchange early, an interrupt included, leaves a reply unread.
            self._in_step = False
            self.write(request)
            reply = read_reply(ReplyReader(self, request, deadline_s, unknown=self._proven))
            self._in_step = in_step_before
            return reply

    @contextmanager
    def urgently(self, reply_s: float | None = None) -> Iterator[None]:
        """Send this thread's requests in the block at once, without resynchronising.

        It is for stops, whose reply cannot be mistaken for another one. ``reply_s`` takes the place of the line's own.
        """
        with self.lock:
            before = self._urgent, self._urgent_reply_s
            self._urgent, self._urgent_reply_s = True, reply_s
            try:
                yield
            finally:
                self._urgent, self._urgent_reply_s = before

    def write(self, data: bytes) -> None:
        """Send bytes that have no reply."""
        with self.lock:
            self._note(">", data)
            self._at_port(self._port.write, data)

    def bring_into_step(self) -> None:
        """Resynchronise when an old reply is unread, or may still come, except `urgently`."""
        with self.lock:
            if self._urgent:
                return
            self._take_strays()
            if not self._in_step:
                self._resynchronise()
                self._in_step = True

    def mark_out_of_step(self) -> None:
        """Resynchronise before the next request: a reply had the right form, but cannot be right."""
        self._in_step = False

    def garbled_reply(self, what: str, remedy: str = "") -> ReplyGarbled:
        """Mark the line as out of step (a reply had the right form, but cannot be right); return the error to raise.

        ``remedy`` is empty for what helps on most lines of this kind.
        """
        self.mark_out_of_step()
        why, known_remedy = known_cause(self._heard) or ("", "")
        what = f"{what} Perhaps {why}." if why else what
        return ReplyGarbled(what, where=self.name, remedy=known_remedy or remedy or self.GARBLED_REMEDY)

    def why_silent(self, unknown: bytes = b"") -> Cause:
        """Return why a request has no reply; ``unknown`` as for `ReplyReader`."""
        if cause := known_cause(self._heard):
            return cause
        if self._buffer:
            return why_incomplete(self.unread, self.terminator)
        if unknown:
            return Cause(
                f"the request {unknown[:40]!r} has none; another one was answered just before",
                "The line works: check that the station file names the right driver, model and addresses.",
            )
        return Cause("", self.SILENT_REMEDY + (ONE_AT_A_TIME if "://" in self.name else ""))

    def drain(self) -> bytes:
        """Throw away what arrives until the line is silent, but for fillers; `ReplyGarbled` if it never is."""
        with self.lock:
            end = time.monotonic() + self.longest_drain_s
            heard_s, heard = self._clock.monotonic(), 0
            while self.receive(self.quiet_s):
                now_s = self._clock.monotonic()
                end_of_lines = self._buffer.rfind(self.terminator)
                whole = end_of_lines + len(self.terminator) if end_of_lines >= heard else heard
                if not self.is_filler(bytes(self._buffer[heard:whole])):
                    heard_s = now_s
                heard = whole
                if heard == len(self._buffer) and now_s - heard_s >= self.quiet_s:
                    break  # a device that tells its state all the time says nothing else
                if time.monotonic() > end:
                    self._buffer.clear()
                    raise self.garbled_reply(
                        f"the device sends without pause for {self.longest_drain_s:g} s."
                    )
            thrown = bytes(self._buffer)
            self._buffer.clear()
            return thrown

    def prove_in_step(
        self,
        exchange_marker: Callable[[], object],
        *,
        marker_s: float | None = None,
        failed: str = "more bytes come than were asked for.",
        clear_device: Callable[[], object] = do_nothing,
        inspect_old: Callable[[bytes], object] = do_nothing,
        silence_after: bool = True,
        once_if_silent: bool = False,
    ) -> None:
        """Bring the line back into step: throw away what is old, then prove that nothing old is left.

        The proof is a marker: a request whose answer cannot be the answer to an older request. The line is in step when
        the marker is answered and, with ``silence_after`` (a protocol without message ids), nothing follows its answer;
        else ``failed`` is told. There are two attempts.

        ``exchange_marker`` returns False when its answer is not the expected one, and raises `ReplyError` for no valid
        answer within ``marker_s`` (None: ``reply_s``). ``clear_device`` makes the device forget the beginning of a
        command; it is called after the line was silent. ``inspect_old`` gets the old bytes before they are lost, for
        unsolicited messages in them. With ``once_if_silent`` there is no second attempt after
        a marker without an answer, unless the computer was late: the caller repeats its request, which comes here
        again, and a device without power is reported sooner.
        """
        for tries_left in reversed(range(RESYNCHRONISE_TRIES)):
            inspect_old(self.drain())
            clear_device()
            try:
                with self.urgently(marker_s):
                    expected = exchange_marker() is not False
            except ReplyError as error:
                silent = isinstance(error, ReplyTimeout) and not error.late_s
                if not tries_left or (silent and once_if_silent):
                    raise
                continue
            followed = silence_after and not self.is_filler(self.drain())
            if expected and not followed:
                self._proven = True
                return
        raise self.garbled_reply(failed)

    def listen(self, duration_s: float) -> None:
        """Wait for bytes on the line. No clock interrupts this wait: it is for stopping only."""
        with self.lock:
            self.receive(duration_s)

    def close(self) -> None:
        """Close the port."""
        with self.lock:
            self._port.close()

    # ------------------------------------------------------------ for ReplyReader

    def receive(self, timeout_s: float) -> bool:
        """Wait for bytes and keep them as unread; return whether any came. ``timeout_s`` is for the first byte."""
        data = self._at_port(self._port.read, timeout_s)
        self._clock.monotonic()
        if data:
            self._note("<", data)
            self._buffer += data
            self._heard = (self._heard + data)[-KEPT:]
        return bool(data)

    def take(self, count: int) -> bytes | None:
        """Take a number of unread bytes; None when fewer are unread."""
        if len(self._buffer) < count:
            return None
        data = bytes(self._buffer[:count])
        del self._buffer[:count]
        return data

    def take_line(self) -> bytes | None:
        """Take one unread line with its terminator; None when no complete line is unread.

        A line that is too long raises `ReplyGarbled` and is thrown away, so that the next call does not find it again.
        """
        end = self._buffer.find(self.terminator)
        if end < 0 and len(self._buffer) <= LONGEST_LINE:
            return None
        if end < 0 or end > LONGEST_LINE:
            begins = bytes(self._buffer[:40])
            self._buffer.clear()
            raise self.garbled_reply(f"a line of more than {LONGEST_LINE} bytes: {begins!r}...")
        return self.take(end + len(self.terminator))

    # ------------------------------------------------------------ inside

    def _at_port(self, action: Callable[[P], T], argument: P) -> T:
        """Read or write; a port that is lost gets the cause that the other end has told before it closed it."""
        try:
            return action(argument)
        except PortLost as lost:
            cause = known_cause(self._heard)
            if cause is None:
                raise
            raise PortLost(
                f"{lost.what} Before, {cause.what}.", where=self.name, remedy=cause.remedy
            ) from lost

    def _take_strays(self) -> None:
        """Take unsolicited lines that came since the last exchange; anything else is a late reply."""
        self.receive(0.0)
        while not self.is_filler(self.unread):
            try:
                line = self.take_line()
                understood = line is not None and self.take_unsolicited(line)
            except ReplyGarbled:
                understood = False
            if not understood:
                self._in_step = False
                return
        self._buffer.clear()

    def _note(self, direction: Direction, data: bytes) -> None:
        if self._wire_log is not None:
            self._wire_log.record(self._clock.monotonic(), self.name, direction, data)
