"""Knows how requests and replies share one line: one lock, deadlines, resynchronising, unsolicited lines.

Knows no protocol, and opens nothing: a driver hands in a port, how it resynchronises, and what it takes
for an unsolicited message.

A reply that is late, cut or garbled leaves the line *out of step*: the next reply might be an old one. The
link then lets the driver resynchronise before the next request goes out, so that no value ever answers
another question than the one asked.

The wait for a reply is the wire's own time and is bounded by its deadline; it is not a safe point, because
an exchange broken off in the middle would leave the line out of step. Drivers wait *between* exchanges
through their clock. An urgent exchange (a stop) skips resynchronising, and so waits for one exchange of
another thread at most (with its resynchronising, when the line was out of step).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

from drivers.clock import Clock
from drivers.errors import ReplyGarbled, ReplyTimeout
from drivers.serial_port import Port
from drivers.wire_log import Direction, WireLog

LONGEST_LINE = 4096
"""A line longer than this is a device that babbles, or another protocol."""

T = TypeVar("T")


class Incoming:
    """What arrives in answer to one request, up to its deadline. Handed to a ``receive`` function."""

    def __init__(self, link: Link, deadline_s: float) -> None:
        self._link = link
        self._deadline_s = deadline_s
        self._end = time.monotonic() + deadline_s

    def line(self) -> bytes:
        """Return the next line with its terminator, unsolicited ones routed away.

        Raises ReplyTimeout at the deadline, ReplyGarbled when a line grows without end.
        """
        while True:
            line = self._link.take_line()
            if line is None:
                self._more()
            elif not self._link.route(line):
                return line

    def exactly(self, count: int) -> bytes:
        """Return the next ``count`` bytes. Raises ReplyTimeout at the deadline."""
        while True:
            data = self._link.take(count)
            if data is not None:
                return data
            self._more()

    def _more(self) -> None:
        remaining = self._end - time.monotonic()
        if remaining <= 0 or not self._link.fill(remaining):
            have = self._link.unread
            cut = f"; only {have[:40]!r} came" if have else ""
            raise ReplyTimeout(
                f"no complete reply within {self._deadline_s:g} s{cut}.",
                where=self._link.name,
                remedy="See that the device is on, and that its baud rate is the station file's.",
            )


def _nothing_unsolicited(_line: bytes) -> bool:
    return False


class Link:
    """A line to one device (or a chain of them), shared by threads, one exchange at a time.

    Parameters
    ----------
    port
        The open port.
    clock
        Gives the times of the wire log.
    resynchronise
        Brings the line back into step: throws away what is old and proves, with a request whose answer
        cannot be mistaken, that the next reply will be the next request's. Called with the lock held;
        may use ``drain`` and urgent exchanges; raises ReplyError when it cannot.
    terminator
        End of a line.
    unsolicited
        Told each line; returns True when it took the line as a message that answers no request.
    wire_log
        Told every byte.
    """

    def __init__(
        self,
        port: Port,
        *,
        clock: Clock,
        resynchronise: Callable[[], None],
        terminator: bytes = b"\n",
        unsolicited: Callable[[bytes], bool] = _nothing_unsolicited,
        wire_log: WireLog | None = None,
    ) -> None:
        self.lock = threading.RLock()
        self._port = port
        self._clock = clock
        self._resynchronise = resynchronise
        self._terminator = terminator
        self._unsolicited = unsolicited
        self._wire_log = wire_log
        self._buffer = bytearray()
        self._in_step = True

    @property
    def name(self) -> str:
        """The port's name."""
        return self._port.name

    @property
    def unread(self) -> bytes:
        """What has arrived and was taken by nobody yet."""
        return bytes(self._buffer)

    def exchange(
        self, request: bytes, receive: Callable[[Incoming], T], *, deadline_s: float, urgent: bool = False
    ) -> T:
        """Send a request and receive its reply, alone on the line.

        Parameters
        ----------
        request
            The bytes to send.
        receive
            Reads the reply and understands it; raises ReplyGarbled for what is none.
        deadline_s
            Longest wait for the whole reply, in seconds.
        urgent
            Send at once, without resynchronising first. For stops, whose reply can be told from others.

        Returns
        -------
        What ``receive`` returned.

        Raises
        ------
        ReplyTimeout, ReplyGarbled
            The line is then resynchronised before the next request.
        PortLost
        """
        with self.lock:
            if not urgent:
                self.come_into_step()
            in_step_before = self._in_step
            # Whatever ends this exchange early, an interrupt included, leaves a reply unread.
            self._in_step = False
            self.send(request)
            reply = receive(Incoming(self, deadline_s))
            self._in_step = in_step_before
            return reply

    def send(self, data: bytes) -> None:
        """Send bytes that have no reply. Raises PortLost."""
        with self.lock:
            self._note(">", data)
            self._port.write(data)

    def come_into_step(self) -> None:
        """See that nothing old lies on the line; resynchronise when something does, or when in doubt.

        Raises ReplyError, PortLost.
        """
        with self.lock:
            self._take_strays()
            if not self._in_step:
                self._resynchronise()
                self._in_step = True

    def distrust(self) -> None:
        """Resynchronise before the next request: a reply was understood but cannot be right."""
        self._in_step = False

    def drain(self, quiet_s: float, limit_s: float) -> bytes:
        """Throw away what arrives until nothing has for ``quiet_s``; for ``limit_s`` at most.

        Returns what was thrown away. Raises ReplyGarbled when the device does not fall silent.
        """
        with self.lock:
            end = time.monotonic() + limit_s
            while self.fill(quiet_s):
                if time.monotonic() > end:
                    self._buffer.clear()
                    raise ReplyGarbled(
                        f"the device talks without pause for {limit_s:g} s.",
                        where=self.name,
                        remedy="See that the station file names the device's port and baud rate.",
                    )
            thrown = bytes(self._buffer)
            self._buffer.clear()
            return thrown

    def close(self) -> None:
        """Give the port back."""
        with self.lock:
            self._port.close()

    # ------------------------------------------------------------ for Incoming

    def fill(self, timeout_s: float) -> bool:
        """Wait for bytes and keep them; False when none came in time. Raises PortLost."""
        data = self._port.read(timeout_s)
        if data:
            self._note("<", data)
            self._buffer += data
        return bool(data)

    def take(self, count: int) -> bytes | None:
        """Take that many bytes, or None when there are fewer."""
        if len(self._buffer) < count:
            return None
        data = bytes(self._buffer[:count])
        del self._buffer[:count]
        return data

    def take_line(self) -> bytes | None:
        """Take one line with its terminator, or None when there is none yet.

        Raises ReplyGarbled for one without end, which is thrown away: who goes on receiving must not meet it again.
        """
        end = self._buffer.find(self._terminator)
        if end < 0 and len(self._buffer) <= LONGEST_LINE:
            return None
        if end < 0 or end > LONGEST_LINE:
            begins = bytes(self._buffer[:40])
            self._buffer.clear()
            raise ReplyGarbled(
                f"a line of more than {LONGEST_LINE} bytes: {begins!r}...",
                where=self.name,
                remedy="See that the station file names the device's port and baud rate.",
            )
        return self.take(end + len(self._terminator))

    def route(self, line: bytes) -> bool:
        """Offer a line to the handler of unsolicited ones."""
        return self._unsolicited(line)

    # ------------------------------------------------------------ inside

    def _take_strays(self) -> None:
        """Route unsolicited lines that came since the last exchange; anything else is a late reply."""
        self.fill(0.0)
        while self._buffer:
            try:
                line = self.take_line()
                understood = line is not None and self.route(line)
            except ReplyGarbled:
                understood = False
            if not understood:
                self._in_step = False
                return

    def _note(self, direction: Direction, data: bytes) -> None:
        if self._wire_log is not None:
            self._wire_log.record(self._clock.monotonic(), self.name, direction, data)
