"""Knows how to talk to a device that answers text, has no ids and no checksums, but can say who it is.

What keeps an old reply from answering a new question is the identity: after any doubt the line is drained
and the device asked who it is, until exactly the known answer comes, and nothing after it.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable
from typing import Final

from drivers.clock import Clock
from drivers.errors import ReplyGarbled
from drivers.link import Incoming, Link
from drivers.retry import TRIES, repeat, resynchronise
from drivers.serial_port import Port
from drivers.wire_log import WireLog

REPLY_S: Final = 2.0
"""Some devices need a tenth of a second to carry a setting out, and answer nothing meanwhile."""
PROMPT_S: Final = 0.75
"""For what a device answers at once, or never."""
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_QUIET_S = 0.1
_LOUD_S = 2.0


def _nothing_unsolicited(_line: bytes) -> bool:
    return False


class TextLine:
    """A device on a line. Asks who it is at once; sets nothing.

    Parameters
    ----------
    port
        The open port.
    who
        The question whose answer identifies the device, and never changes.
    is_identity
        Whether an answer to it has the right form; a wrong one is asked again.
    request_end, reply_end
        What ends a request and a reply.
    reply_s
        Longest wait for a reply, in seconds.
    unsolicited, clock, wire_log
        See ``drivers.link.Link``.

    Attributes
    ----------
    identity_text
        The answer to ``who``.

    Raises
    ------
    ReplyTimeout, ReplyGarbled, PortLost
    """

    def __init__(
        self,
        port: Port,
        *,
        who: str,
        is_identity: Callable[[str], bool],
        clock: Clock,
        request_end: bytes = b"\n",
        reply_end: bytes = b"\n",
        reply_s: float = REPLY_S,
        unsolicited: Callable[[bytes], bool] = _nothing_unsolicited,
        wire_log: WireLog | None = None,
    ) -> None:
        self._who = who
        self._is_identity = is_identity
        self._request_end = request_end
        self._reply_end = reply_end
        self._reply_s = reply_s
        self._link = Link(
            port,
            clock=clock,
            resynchronise=self._resynchronise,
            terminator=reply_end,
            unsolicited=unsolicited,
            wire_log=wire_log,
        )
        self.identity_text = ""
        self._link.drain(_QUIET_S, _LOUD_S)
        self.identity_text = self._identify()

    @property
    def name(self) -> str:
        """The port's name."""
        return self._link.name

    @property
    def lock(self) -> threading.RLock:
        """Held, nobody else can send."""
        return self._link.lock

    def ask(self, query: str, *, deadline_s: float | None = None, tries: int = TRIES) -> str:
        """Send a query and return its answer; asked again, three times in all, when the answer is none.

        Raises ReplyTimeout, ReplyGarbled, PortLost.
        """
        deadline_s = deadline_s or self._reply_s
        return repeat(lambda: self._ask(query, deadline_s), tries=tries)

    def number(self, query: str) -> float:
        """Send a query whose answer is one finite number. Raises as ``ask``."""
        text = self.ask(query)
        if not _NUMBER.fullmatch(text) or not math.isfinite(float(text)):
            raise self.garbled(f"{query} answered {text!r}, not a number.")
        return float(text)

    def decimal(self, query: str) -> float:
        """Send a query whose answer is a finite number with a decimal point: no switch's or count's can pass for it.

        Raises as ``ask``.
        """
        text = self.ask(query)
        if "." not in text or not _NUMBER.fullmatch(text) or not math.isfinite(float(text)):
            raise self.garbled(f"{query} answered {text!r}, not a number with decimals.")
        return float(text)

    def switch(self, query: str) -> bool:
        """Send a query whose answer is on or off. Raises as ``ask``."""
        text = self.ask(query).upper()
        if text not in {"1", "ON", "0", "OFF"}:
            raise self.garbled(f"{query} answered {text!r}, not on or off.")
        return text in {"1", "ON"}

    def send(self, command: str) -> None:
        """Send a command that has no answer. Raises ReplyError, PortLost."""
        self._link.exchange(self._bytes(command), _nothing, deadline_s=0.0)

    def blurt(self, command: str) -> None:
        """Send a command at once, whatever the line is in the middle of: for stopping and switching off."""
        self._link.exchange(self._bytes(command), _nothing, deadline_s=0.0, urgent=True)

    def garbled(self, what: str) -> ReplyGarbled:
        """Return the error of an answer that was understood but cannot be right; distrust the line."""
        self._link.distrust()
        return ReplyGarbled(what, where=self.name, remedy="Check the cable, the port and the baud rate.")

    def listen(self, seconds: float) -> None:
        """Wait that long for what comes. A wait that no clock interrupts: for stopping only."""
        with self._link.lock:
            self._link.fill(seconds)

    def close(self) -> None:
        """Give the port back."""
        self._link.close()

    # ------------------------------------------------------------ inside

    def _bytes(self, text: str) -> bytes:
        return text.encode("ascii") + self._request_end

    def _ask(self, query: str, deadline_s: float, *, urgent: bool = False) -> str:
        def receive(incoming: Incoming) -> str:
            return self._text(incoming.line())

        return self._link.exchange(self._bytes(query), receive, deadline_s=deadline_s, urgent=urgent)

    def _text(self, line: bytes) -> str:
        """Understand a reply: printable ASCII and its end (a CR before it may be missing), not empty."""
        body = line.removesuffix(self._reply_end).removesuffix(b"\r")
        if not re.fullmatch(rb"[ -~]+", body):
            raise self.garbled(f"not a reply: {line[:80]!r}.")
        return body.decode("ascii").strip()

    def _identify(self) -> str:
        def ask_once() -> str:
            text = self._ask(self._who, PROMPT_S)
            if not self._is_identity(text):
                raise self.garbled(f"{self._who} answered {text!r}, which is no identity.")
            return text

        return repeat(ask_once, before_next=lambda: self._link.drain(_QUIET_S, _LOUD_S))

    def _resynchronise(self) -> None:
        """Wait for silence, then for the identity and silence again: nothing older can come after it."""
        if not self.identity_text:
            return  # it is just being asked, by _identify, which drains the line itself

        def is_known() -> bool:
            return self._ask(self._who, PROMPT_S, urgent=True) == self.identity_text

        if not resynchronise(self._link, is_known, quiet_s=_QUIET_S, limit_s=_LOUD_S):
            raise self.garbled(f"no clear answer to {self._who}, though it answered it before.")


def _nothing(_incoming: Incoming) -> None:
    """Receive nothing: a command has no answer."""
