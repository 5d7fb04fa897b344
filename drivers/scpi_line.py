"""Knows how to talk to an SCPI instrument on one line: queries, commands, its error queue or the lack of it.

SCPI has neither ids nor checksums. What keeps an old reply from answering a new question is the identity
string: after any doubt the line is drained and ``*IDN?`` asked until exactly that string comes, and nothing
after it. Knows nothing of what an instrument does.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from drivers.clock import Clock
from drivers.errors import DeviceRefused, ReplyError, ReplyGarbled, ReplyTimeout
from drivers.link import Incoming, Link
from drivers.serial_port import Port
from drivers.wire_log import WireLog

_REPLY_S = 2.0
"""Some generators need a tenth of a second to change their waveform, and answer nothing meanwhile."""
_MARKER_S = 1.0
"""For what an instrument answers at once, or never."""
_QUIET_S = 0.1
_LOUD_S = 2.0
_TRIES = 3
_LONGEST_QUEUE = 40

_ERROR = re.compile(r'([+-]?\d+) ?, ?(?:"([^"]*)"|([^"]*))')


class InstrumentError(NamedTuple):
    """One entry of the error queue."""

    code: int
    text: str

    def __str__(self) -> str:
        return f'{self.code} "{self.text}"'


class ScpiLine:
    """An instrument on a line. Asks ``*IDN?`` at once, and whether there is an error queue; sets nothing.

    Parameters
    ----------
    port
        The open port.
    clock, wire_log
        See ``drivers.link.Link``.

    Attributes
    ----------
    identity
        The four fields of ``*IDN?``: maker, model, serial number, firmware.
    has_error_queue
        False when the instrument does not answer ``SYST:ERR?``; then only reading back tells.

    Raises
    ------
    ReplyTimeout, ReplyGarbled, PortLost
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self._link = Link(port, clock=clock, resynchronise=self._resynchronise, wire_log=wire_log)
        self._identity_text = ""
        self._link.drain(_QUIET_S, _LOUD_S)
        self._identity_text = self._identify()
        self.identity = _fields(self._identity_text, self.name)
        self.has_error_queue = True
        self.has_error_queue = self._find_error_queue()

    @property
    def name(self) -> str:
        """The port's name."""
        return self._link.name

    def ask(self, query: str) -> str:
        """Send a query and return its answer; asked again, up to three times, when the answer is none.

        Raises DeviceRefused when the instrument says that it knows no such query; ReplyTimeout,
        ReplyGarbled, PortLost.
        """
        try:
            return self._ask(query, _REPLY_S)
        except ReplyTimeout:
            self._refuse_errors(query)
        except ReplyGarbled:
            pass  # garbled once is noise on the line
        return self._ask_again(query, _REPLY_S, tries=_TRIES - 1)

    def number(self, query: str) -> float:
        """Send a query whose answer is one finite number. Raises as ``ask``."""
        text = self.ask(query)
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self._garbled(f"{query} answered {text!r}, not a number.")
        return value

    def switch(self, query: str) -> bool:
        """Send a query whose answer is on or off. Raises as ``ask``."""
        text = self.ask(query).upper()
        if text not in {"1", "ON", "0", "OFF"}:
            raise self._garbled(f"{query} answered {text!r}, not on or off.")
        return text in {"1", "ON"}

    def tell(self, command: str) -> list[InstrumentError]:
        """Send a command, which has no answer; return what its error queue then holds.

        Raises ReplyTimeout, ReplyGarbled, PortLost.
        """
        self._link.exchange(f"{command}\n".encode("ascii"), _nothing, deadline_s=0.0)
        return self.errors()

    def blurt(self, command: str) -> None:
        """Send a command at once, whatever else the line is in the middle of: for switching off."""
        self._link.exchange(f"{command}\n".encode("ascii"), _nothing, deadline_s=0.0, urgent=True)

    def errors(self) -> list[InstrumentError]:
        """Empty the error queue and return what it held, oldest first; empty without a queue.

        Raises ReplyGarbled when it never ends; ReplyTimeout, PortLost.
        """
        found: list[InstrumentError] = []
        while self.has_error_queue:
            error = self._next_error()
            if error.code == 0:
                break
            found.append(error)
            if len(found) > _LONGEST_QUEUE:
                raise self._garbled("the error queue never ends.")
        return found

    def close(self) -> None:
        """Give the port back."""
        self._link.close()

    # ------------------------------------------------------------ inside

    def _ask(self, query: str, deadline_s: float, *, urgent: bool = False) -> str:
        def receive(incoming: Incoming) -> str:
            return self._text(incoming.line())

        return self._link.exchange(
            f"{query}\n".encode("ascii"), receive, deadline_s=deadline_s, urgent=urgent
        )

    def _ask_again(self, query: str, deadline_s: float, *, tries: int = _TRIES) -> str:
        for _ in range(tries - 1):
            try:
                return self._ask(query, deadline_s)
            except ReplyError:
                continue
        return self._ask(query, deadline_s)

    def _text(self, line: bytes) -> str:
        """Understand a line: printable ASCII, with LF or CR LF at its end, not empty."""
        body = line.removesuffix(b"\n").removesuffix(b"\r")
        if not re.fullmatch(rb"[ -~]+", body):
            raise self._garbled(f"not a reply: {line[:80]!r}.")
        return body.decode("ascii").strip()

    def _next_error(self) -> InstrumentError:
        text = self._ask_again("SYST:ERR?", _REPLY_S)
        match = _ERROR.fullmatch(text)
        if match is None:
            raise self._garbled(f"SYST:ERR? answered {text!r}.")
        return InstrumentError(int(match[1]), match[2] or match[3] or "")

    def _find_error_queue(self) -> bool:
        """Whether ``SYST:ERR?`` is answered, asked twice; then empty it of what was before us."""
        try:
            self._ask_again("SYST:ERR?", _MARKER_S, tries=2)
        except ReplyTimeout:
            return False
        self.errors()
        return True

    def _refuse_errors(self, query: str) -> None:
        """After a query without answer: raise DeviceRefused when the queue says that it is unknown."""
        errors = self.errors()
        if errors:
            raise DeviceRefused(
                f"{query} is refused: {'; '.join(map(str, errors))}.",
                where=self.name,
                remedy="See that the station file names the right dialect for this instrument.",
            )

    def _identify(self) -> str:
        for attempt in range(_TRIES):
            try:
                text = self._ask("*IDN?", _MARKER_S)
                _fields(text, self.name)
            except ReplyError:
                self._link.drain(_QUIET_S, _LOUD_S)
                if attempt == _TRIES - 1:
                    raise
            else:
                return text
        raise AssertionError

    def _resynchronise(self) -> None:
        """Wait for silence, then for our identity and silence again: nothing older can come after it."""
        if not self._identity_text:
            return  # it is just being asked, by _identify, which drains the line itself
        for attempt in range(_TRIES):
            self._link.drain(_QUIET_S, _LOUD_S)
            try:
                answer = self._ask("*IDN?", _MARKER_S, urgent=True)
            except ReplyError:
                if attempt == _TRIES - 1:
                    raise
                continue
            if not self._link.drain(_QUIET_S, _LOUD_S) and answer == self._identity_text:
                return
        raise self._garbled("no clear answer to *IDN?, though it answered it before.")

    def _garbled(self, what: str) -> ReplyGarbled:
        self._link.distrust()
        return ReplyGarbled(what, where=self.name, remedy="Check the cable, the port and the baud rate.")


def _nothing(_incoming: Incoming) -> None:
    """Receive nothing: a command has no answer."""


def _fields(identity: str, where: str) -> tuple[str, str, str, str]:
    fields = tuple(field.strip() for field in identity.split(","))
    if len(fields) != 4 or not all(fields[:2]):
        raise ReplyGarbled(
            f"*IDN? answered {identity!r}, not maker, model, serial and firmware.",
            where=where,
            remedy="See that the station file names the light's port.",
        )
    return fields[0], fields[1], fields[2], fields[3]
