"""Talk to an SCPI instrument: its identity and its error queue. Commands of particular instruments do not belong here.

Sources: SCPI Consortium, "SCPI-1999", volume 2 (command reference), ``SYSTem:ERRor`` and its error numbers; IEEE 488.2
for ``*IDN?``.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from drivers.clock import Clock
from drivers.errors import DeviceRefused, ReplyError, ReplyTimeout
from drivers.retry import TRIES
from drivers.serial_port import Port
from drivers.text_line import PROMPT_S, TextLine
from drivers.wire_log import WireLog

_LONGEST_QUEUE = 40
_ERROR = re.compile(r'([+-]?\d+) ?, ?(?:"([^"]*)"|([^"]*))')


class InstrumentError(NamedTuple):
    """One entry of the error queue."""

    code: int  # Error number; 0 for an empty queue
    text: str  # The instrument's own description

    @property
    def is_command_error(self) -> bool:
        """Whether the instrument did not understand the command; otherwise it could not carry it out."""
        return -200 < self.code <= -100

    def __str__(self) -> str:
        return f'{self.code} "{self.text}"'


class ScpiLine(TextLine):
    """A line to an SCPI instrument. Opening asks ``*IDN?`` and ``SYST:ERR?``; it sets nothing.

    clock, wire_log: See ``drivers.link.Link``.
    has_error_queue: False when the instrument does not answer ``SYST:ERR?``. A refused setting then shows
      only when it is read back.
    Raises ReplyTimeout, ReplyGarbled: The instrument does not identify itself.
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        super().__init__(
            port,
            identity_query="*IDN?",
            is_identity=_is_identity,
            identity_form="'maker, model, serial number, firmware', the four fields of IEEE 488.2,",
            clock=clock,
            wire_log=wire_log,
        )
        self.has_error_queue = True
        self.has_error_queue = self._find_error_queue()

    @property
    def identity(self) -> tuple[str, str, str, str]:
        """The four fields of ``*IDN?``: maker, model, serial number, firmware."""
        maker, model, serial, firmware = (field.strip() for field in self.identity_text.split(","))
        return maker, model, serial, firmware

    def query(self, query: str, *, deadline_s: float | None = None, tries: int = TRIES) -> str:
        """See `TextLine.query`. After a silence, also ask the error queue whether the query was refused.

        Raises DeviceRefused: The error queue says that the instrument does not know the query.
        Raises ReplyTimeout, ReplyGarbled: No valid reply came at the last attempt.
        """
        try:
            return super().query(query, deadline_s=deadline_s, tries=1)
        except ReplyError as error:
            if isinstance(error, ReplyTimeout):
                self._raise_if_refused(query)
            if tries == 1:
                raise
        return super().query(query, deadline_s=deadline_s, tries=tries - 1)

    def command(self, command: str) -> list[InstrumentError]:
        """Send a command, once, and read the error queue.

        command: A command without reply.
        Returns: Errors in the queue after the command, oldest first; empty without a queue.
        Raises ReplyTimeout, ReplyGarbled: The error queue could not be read.
        """
        self.send(command)
        return self.read_errors()

    def read_errors(self) -> list[InstrumentError]:
        """Empty the error queue.

        Returns: Errors that were in the queue, oldest first; empty without a queue.
        Raises ReplyTimeout, ReplyGarbled: The queue could not be read, or has no end.
        """
        found: list[InstrumentError] = []
        while self.has_error_queue:
            error = self._next_error()
            if error.code == 0:
                break
            found.append(error)
            if len(found) > _LONGEST_QUEUE:
                raise self.garbled_reply("the error queue never ends.")
        return found

    # ------------------------------------------------------------ inside

    def _next_error(self) -> InstrumentError:
        text = super().query("SYST:ERR?")
        match = _ERROR.fullmatch(text)
        if match is None:
            raise self.garbled_reply(f"SYST:ERR? answered {text!r}.")
        return InstrumentError(int(match[1]), match[2] or match[3] or "")

    def _find_error_queue(self) -> bool:
        """Whether ``SYST:ERR?`` is answered, asked twice; a queue that is found is emptied of older errors."""
        try:
            super().query("SYST:ERR?", deadline_s=PROMPT_S, tries=2)
        except ReplyTimeout:
            return False
        self.read_errors()
        return True

    def _raise_if_refused(self, query: str) -> None:
        """Raise DeviceRefused when the error queue holds errors after a query without answer."""
        errors = self.read_errors()
        if errors:
            raise DeviceRefused(
                f"{query} is refused: {'; '.join(map(str, errors))}.",
                where=self.name,
                remedy="Check that the station file names the right driver for this instrument.",
            )


def _is_identity(text: str) -> bool:
    fields = [field.strip() for field in text.split(",")]
    return len(fields) == 4 and all(fields[:2])
