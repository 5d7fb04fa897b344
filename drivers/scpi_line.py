"""Knows how to talk to an SCPI instrument: its identity, its error queue, or the lack of one.

Knows nothing of what an instrument does.
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

    code: int
    text: str

    @property
    def is_of_the_command(self) -> bool:
        """Whether the instrument could not make out the command; otherwise it could not carry it out."""
        return -200 < self.code <= -100

    def __str__(self) -> str:
        return f'{self.code} "{self.text}"'


class ScpiLine(TextLine):
    """An instrument on a line. Asks ``*IDN?`` at once, and whether there is an error queue; sets nothing.

    Parameters
    ----------
    port
        The open port.
    clock, wire_log
        See ``drivers.link.Link``.

    Attributes
    ----------
    has_error_queue
        False when the instrument does not answer ``SYST:ERR?``; then only reading back tells.

    Raises
    ------
    ReplyTimeout, ReplyGarbled, PortLost
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        super().__init__(port, who="*IDN?", is_identity=_is_identity, clock=clock, wire_log=wire_log)
        self.has_error_queue = True
        self.has_error_queue = self._find_error_queue()

    @property
    def identity(self) -> tuple[str, str, str, str]:
        """The four fields of ``*IDN?``: maker, model, serial number, firmware."""
        maker, model, serial, firmware = (field.strip() for field in self.identity_text.split(","))
        return maker, model, serial, firmware

    def ask(self, query: str, *, deadline_s: float | None = None, tries: int = TRIES) -> str:
        """Send a query and return its answer, as any text line; a silence may be a refusal.

        Raises DeviceRefused when the error queue says that the instrument knows no such query;
        ReplyTimeout, ReplyGarbled, PortLost.
        """
        try:
            return super().ask(query, deadline_s=deadline_s, tries=1)
        except ReplyError as error:
            if isinstance(error, ReplyTimeout):
                self._refuse_errors(query)
            if tries == 1:
                raise
        return super().ask(query, deadline_s=deadline_s, tries=tries - 1)

    def tell(self, command: str) -> list[InstrumentError]:
        """Send a command, which has no answer; return what the error queue then holds.

        Raises ReplyTimeout, ReplyGarbled, PortLost.
        """
        self.send(command)
        return self.errors()

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
                raise self.garbled("the error queue never ends.")
        return found

    # ------------------------------------------------------------ inside

    def _next_error(self) -> InstrumentError:
        text = super().ask("SYST:ERR?")
        match = _ERROR.fullmatch(text)
        if match is None:
            raise self.garbled(f"SYST:ERR? answered {text!r}.")
        return InstrumentError(int(match[1]), match[2] or match[3] or "")

    def _find_error_queue(self) -> bool:
        """Whether ``SYST:ERR?`` is answered, asked twice; then empty it of what was before us."""
        try:
            super().ask("SYST:ERR?", deadline_s=PROMPT_S, tries=2)
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


def _is_identity(text: str) -> bool:
    fields = [field.strip() for field in text.split(",")]
    return len(fields) == 4 and all(fields[:2])
