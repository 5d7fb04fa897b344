"""Talk to a device that answers text without message ids and checksums, but can identify itself.

The identity keeps an old reply from being taken for the answer to a new query. When a reply was bad, the line is
drained and the identity is asked for, until exactly the known identity comes and nothing follows it.

SCPI instruments are such devices with a queue of errors. Sources: SCPI Consortium, "SCPI-1999", volume 2 (command
reference), ``SYSTem:ERRor`` and its error numbers; IEEE 488.2 for ``*IDN?``. Commands of particular instruments do not
belong here.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

from drivers.clock import Clock
from drivers.errors import DeviceRefused, ReplyError, ReplyTimeout
from drivers.link import TRIES, Link, ReplyReader, do_nothing, repeat
from drivers.quantity import Quantity, read_quantity
from drivers.serial_port import Port
from drivers.wire_log import WireLog

REPLY_S: Final = 2.0
"""Longest wait for a reply, in seconds: some devices carry out a setting first, for a tenth of a second."""
PROMPT_S: Final = 0.75
"""Longest wait for a reply that comes at once or never, in seconds."""
READABLE_REMEDY: Final = (
    "It answers, so the line works: check that the station file names the right port, driver and dialect."
)
"""What to do about an answer that can be read, but not understood."""
_LONGEST_QUEUE = 40  # Instruments keep some 20 errors; one that repeats its last would never end
_ERROR = re.compile(r'([+-]?\d+)(?: ?[, ] ?(?:"([^"]*)"|([^"]*)))?')
_PROMPT = re.compile(rb"\s*(?:[\w .-]{0,20}>\s*)*")
"""What an instrument with a prompt sends before or after its answers, as in ``33500B> ``."""
_HARDWARE_MISSING = -241  # SCPI-99: the command needs an option that is not built in


class TextLine(Link):
    """A line to one device. Opening asks for its identity; it sets nothing.

    ``identity_query`` has an answer that never changes, ``identity_text``; repeated after one that ``is_identity``
    refuses. ``identity_form`` says the right form in words. ``reply_s`` is the longest wait for a reply. Raises
    `ReplyTimeout` or `ReplyGarbled` if the device does not identify itself, `PortLost` if the port is gone.
    """

    quiet_s = 0.1  # Longer than any pause within a reply; more would slow each connection
    longest_drain_s = 2.0  # The rest of a long reply has come by then

    def __init__(
        self,
        port: Port,
        *,
        identity_query: str,
        is_identity: Callable[[str], bool],
        identity_form: str = "another form",
        clock: Clock,
        request_end: bytes = b"\n",
        reply_end: bytes = b"\n",
        reply_s: float = REPLY_S,
        wire_log: WireLog | None = None,
    ) -> None:
        self._identity_query = identity_query
        self._is_identity = is_identity
        self._identity_form = identity_form
        self._request_end = request_end
        self.terminator = reply_end
        self.reply_s = reply_s
        super().__init__(port, clock=clock, wire_log=wire_log)
        self.identity_text = ""
        self.drain()
        self.identity_text = self._identify()

    def query(self, query: str, *, deadline_s: float | None = None, tries: int = TRIES) -> str:
        """Send a query, ``tries`` times in all, until a valid answer comes; return it without the end of a reply.

        Raises `ReplyTimeout` or `ReplyGarbled` after the last attempt, `PortLost` if the port is gone.
        """
        return repeat(lambda: self._query_once(query, deadline_s), tries=tries)

    def query_number(self, query: str, *, with_decimals: bool = False) -> float:
        """Send a query whose answer is one finite number; ``with_decimals``: with a decimal point, as no count.

        Raises `ReplyTimeout` or `ReplyGarbled`: no valid reply came, or no number.
        """
        text = self.query(query)
        number = read_quantity(text)
        if number is None or (with_decimals and "." not in text):
            form = "a number with decimals" if with_decimals else "a number"
            raise self.garbled_reply(f"{query} answered {text!r}, not {form}.", READABLE_REMEDY)
        return number.value

    def query_switch(self, query: str) -> bool:
        """Return whether the answer to a query is ``1`` or ``ON``; `ReplyGarbled` if it is neither on nor off."""
        text = self.query(query).upper()
        if text not in {"1", "ON", "0", "OFF"}:
            raise self.garbled_reply(f"{query} answered {text!r}, not on or off.", READABLE_REMEDY)
        return text in {"1", "ON"}

    def send(self, command: str) -> None:
        """Send a command that has no reply; `ReplyError` if the line could not be resynchronised."""
        self.exchange(self._encode(command), do_nothing, deadline_s=0.0)

    def send_urgent(self, command: str) -> None:
        """Send a command that has no reply at once, without resynchronising: for stopping and switching off."""
        with self.urgently():
            self.send(command)

    def inspect_old(self, old: bytes) -> None:
        """Look at bytes, of any number of lines, that are thrown away, for messages that nobody asked for."""

    # ------------------------------------------------------------ inside

    def _encode(self, text: str) -> bytes:
        return text.encode("ascii") + self._request_end

    def _query_once(self, query: str, deadline_s: float | None = None) -> str:
        def read_reply(reader: ReplyReader) -> str:
            return self._parse_reply(reader.read_line())

        return self.exchange(self._encode(query), read_reply, deadline_s=deadline_s)

    def _parse_reply(self, line: bytes) -> str:
        """Return the text of a reply: printable ASCII, not empty. A CR before its end may be missing."""
        body = line.removesuffix(self.terminator).removesuffix(b"\r")
        if not re.fullmatch(rb"[ -~]+", body):
            raise self.garbled_reply(f"not a reply: {line[:80]!r}.")
        return body.decode("ascii").strip()

    def _identify(self) -> str:
        def query_identity() -> str:
            text = self._query_once(self._identity_query, PROMPT_S)
            if not self._is_identity(text):
                raise self.garbled_reply(
                    f"{self._identity_query} answered {text!r}; {self._identity_form} was expected.",
                    READABLE_REMEDY,
                )
            return text

        return repeat(query_identity, before_next=self.drain)

    def _resynchronise(self) -> None:
        """Ask for the identity on a silent line: no older reply can come after the known identity and a silence."""
        if not self.identity_text:
            return  # _identify asks for it at this moment, and drains the line itself

        def is_known() -> bool:
            return self._query_once(self._identity_query, PROMPT_S) == self.identity_text

        self.prove_in_step(
            is_known,
            failed=f"no clear answer to {self._identity_query}, though the device answered it before.",
            inspect_old=self.inspect_old,
        )


class InstrumentError(NamedTuple):
    """One entry of the error queue."""

    code: int  # Error number; 0 for an empty queue
    text: str  # The instrument's own description

    @property
    def is_command_error(self) -> bool:
        """Whether the instrument did not understand the command; otherwise it could not carry it out."""
        return -200 < self.code <= -100

    @property
    def tells_of_a_lack(self) -> bool:
        """Whether the instrument does not have what the command is about."""
        return self.is_command_error or self.code == _HARDWARE_MISSING

    def __str__(self) -> str:
        return f'{self.code} "{self.text}"'


class ScpiLine(TextLine):
    """A line to an SCPI instrument. Opening asks ``*IDN?`` and ``SYST:ERR?``; it sets nothing.

    Prompts, empty lines and echoes are no answers. ``has_error_queue`` is False for an instrument that does not answer
    ``SYST:ERR?``: a refused setting then shows only when it is read back.
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self._latest_sent: deque[bytes] = deque(maxlen=2)
        self._echoes = False
        super().__init__(
            port,
            identity_query="*IDN?",
            is_identity=lambda text: _identity(text) is not None,
            identity_form="'maker, model, serial number, firmware', the four fields of IEEE 488.2,",
            clock=clock,
            wire_log=wire_log,
        )
        self.has_error_queue = True
        self.has_error_queue = self._find_error_queue()

    @property
    def identity(self) -> tuple[str, str, str, str]:
        """The fields of ``*IDN?``: maker, model, serial number, and all that follows as the firmware."""
        identity = _identity(self.identity_text)
        assert identity is not None
        return identity

    def query(self, query: str, *, deadline_s: float | None = None, tries: int = TRIES) -> str:
        """See `TextLine.query`. After a silence, also ask the error queue whether the query was refused."""
        try:
            return super().query(query, deadline_s=deadline_s, tries=1)
        except ReplyError as error:
            if isinstance(error, ReplyTimeout):
                self._raise_if_refused(query)
            if tries == 1:
                raise
        return super().query(query, deadline_s=deadline_s, tries=tries - 1)

    def query_if_known(self, query: str) -> str | None:
        """Send a query that the instrument may lack; None when it refuses it, or says nothing twice."""
        try:
            return self.query(query, deadline_s=PROMPT_S, tries=2)
        except (DeviceRefused, ReplyTimeout):
            return None

    def query_quantity(self, query: str, unit: str) -> Quantity:
        """Send a query whose answer is one number, with or without its unit."""
        text = self.query(query)
        quantity = read_quantity(text, unit)
        if quantity is None:
            raise self.garbled_reply(f"{query} answered {text!r}, not a number in {unit}.", READABLE_REMEDY)
        return quantity

    def command(self, command: str) -> list[InstrumentError]:
        """Send a command without reply, once; return the errors in the queue after it, oldest first."""
        self.send(command)
        return self.read_errors()

    def read_errors(self) -> list[InstrumentError]:
        """Empty the error queue; return its errors, oldest first. A queue without an end raises `ReplyGarbled`."""
        errors: list[InstrumentError] = []
        while self.has_error_queue:
            error = self._next_error()
            if error.code == 0:
                break
            errors.append(error)
            if len(errors) > _LONGEST_QUEUE:
                raise self.garbled_reply("the error queue never ends.")
        return errors

    def write(self, data: bytes) -> None:
        """See `Link.write`."""
        self._latest_sent.append(data.strip())
        super().write(data)

    def take_line(self) -> bytes | None:
        """See `Link.take_line`. Some instruments end their lines with CR alone."""
        line = super().take_line()
        return self.take(len(self.unread)) if line is None and self.unread.endswith(b"\r") else line

    def take_unsolicited(self, line: bytes) -> bool:
        """See `Link.take_unsolicited`: a prompt, an empty line, or the echo of what was sent.

        An instrument that does not echo a query has no echo: Siglent's answers have the form of commands.
        """
        text = _without_prompt(line)
        is_echo = text in self._latest_sent and (self._echoes or text.endswith(b"?"))
        self._echoes = self._echoes or is_echo
        return is_echo or not text

    def is_filler(self, data: bytes) -> bool:
        """See `Link.is_filler`."""
        return all(self.take_unsolicited(line) for line in data.splitlines())

    # ------------------------------------------------------------ inside

    def _parse_reply(self, line: bytes) -> str:
        # A Rigol DG1022 puts the channel before some answers, as in CH1:SIN.
        return super()._parse_reply(_without_prompt(line)).removeprefix("CH1:")

    def _next_error(self) -> InstrumentError:
        text = super().query("SYST:ERR?")
        match = _ERROR.fullmatch(text)
        if match is None:
            raise self.garbled_reply(f"SYST:ERR? answered {text!r}.", READABLE_REMEDY)
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


def _without_prompt(line: bytes) -> bytes:
    prompt = _PROMPT.match(line)
    return line[prompt.end() if prompt else 0 :].strip()


def _identity(text: str) -> tuple[str, str, str, str] | None:
    """Return maker, model, serial number and all that follows; None if the text is no identity.

    IEEE 488.2 has four fields. A Siglent SDG800 or SDG1000 and a Rigol DG1022 have five, and Siglent repeats the query.
    """
    fields = [field.strip() for field in text.removeprefix("*IDN ").split(",")]
    if len(fields) < 4 or not all(re.search("[A-Za-z]", field) for field in fields[:2]):
        return None
    maker, model, serial, *more = fields
    return maker, model, serial, ",".join(filter(None, more))
