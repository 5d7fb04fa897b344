"""Talk to a device by its description: every reply is matched, every other one is refused, no old one is accepted.

A reply that does not have the described form leaves the line out of step. The line is then drained, the device forgets
an incomplete request, the form of the replies is set again, and the identity is asked for until exactly the known one
comes and nothing follows it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from drivers.clock import Clock
from drivers.described.description import (
    Exchange,
    LineDescription,
    Notice,
    Switch,
    Template,
    Value,
    with_checksum,
)
from drivers.errors import DeviceRefused, ReplyError, ReplyTimeout, WrongDevice
from drivers.link import LONGEST_LINE, TRIES, Link, ReplyReader, repeat
from drivers.serial_number import is_same_serial
from drivers.serial_port import Port
from drivers.wire_log import WireLog

_SHOWN = 80  # One line of a terminal
_BREAK = re.compile(rb" *[\r\n]+ *")
_FILLERS = b"\r\n\0"
"""What devices send beside the end of a line: a second end, another half of it, NUL at power-up."""
_MOST_OTHER_ANSWERS = 3
"""A device that starts prints a text or two; one that answers otherwise after that is not the described one."""


def shown(value: Value) -> str:
    """Return a part of an identity as people write it.

    >>> shown(4711.0), shown(" E1042 "), shown(1.5)
    ('4711', 'E1042', '1.5')
    """
    return f"{value:.15g}" if isinstance(value, float) else value.strip()


class DescribedLine(Link):
    """A line to one device. Opening sets the form of the replies and asks for the identity, nothing else."""

    GARBLED_REMEDY = "Check the cable, the baud rate and the device's description."
    longest_drain_s = 2.0  # The rest of a long reply has come by then

    def __init__(
        self, port: Port, description: LineDescription, *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        self._description = description
        self.quiet_s, self.reply_s = description.quiet_s, description.reply_s
        self._notices: list[Notice] = []
        self._known = self._known_serial = ""
        self.terminator = description.prompt or description.reply_end
        super().__init__(port, clock=clock, wire_log=wire_log)
        self.identity: Mapping[str, Value] = {}
        self.drain()
        self._clear_device()
        self.identity = self._first_identity(clock)

    def query(
        self, exchange: Exchange, values: Mapping[str, Value] | None = None, *, tries: int = TRIES
    ) -> dict[str, Value]:
        """Send a request that does no harm twice, ``tries`` times in all until its reply is valid; 1 for what moves."""
        return repeat(lambda: self._exchange(exchange, values or {}), tries=tries)

    def query_urgent(self, exchange: Exchange, values: Mapping[str, Value] | None = None) -> None:
        """Send a request at once, without resynchronising, and read its reply: for stopping and switching off.

        Whatever it raises, the request is out.
        """
        with self.urgently():
            self._exchange(exchange, values or {})

    def switch(self, switch: Switch, values: Mapping[str, Value] | None = None) -> tuple[bool, str]:
        """Ask for a state: return whether the answer is one of the switch's words, and the answer."""
        state = self.query(switch.query, values)["state"]
        if isinstance(state, float):
            state = state if switch.mask < 0 else float(int(state) & switch.mask)
            return state in {float(word) for word in switch.true_words}, f"{state:g}"
        return state in switch.true_words, state

    def send_without_reply(self, exchange: Exchange, values: Mapping[str, Value]) -> str:
        """Send a request whose reply comes much later (``poll`` reads it); return it as sent, without its end."""
        request = exchange.send.render(values)
        with self.lock:
            self.bring_into_step()
            self.write(self._encode(request))
        return request

    def poll(self, exchange: Exchange, request: str, values: Mapping[str, Value]) -> bool:
        """Look, without waiting, whether the late reply to what ``send_without_reply`` returned has come."""
        with self.lock:
            self.receive(0.0)
            line = self.take_line()
            while line is not None:
                text = self._text(line)
                known = {**values, "request": request}
                if text and not (exchange.reply and _is_echo(text, exchange.reply, known)):
                    self._match(exchange, request, text, values)
                    return True
                line = self.take_line()
        return False

    def take_line(self) -> bytes | None:
        """See `Link.take_line`. A reply without an end is what came before a silence."""
        if self.terminator:
            return super().take_line()
        while 0 < len(self.unread) <= LONGEST_LINE and self.receive(self.quiet_s):
            pass
        return self.take(len(self.unread)) or None

    def take_unsolicited(self, line: bytes) -> bool:
        """Take a line of a form that the device sends without a request."""
        text = line.strip(b"\r\n").decode("ascii", "replace")
        return any(form.match(text, {}) is not None for form in self._description.unasked)

    def is_filler(self, data: bytes) -> bool:
        """See `Link.is_filler`."""
        return not data.strip(_FILLERS)

    def take_notices(self) -> list[str]:
        """Return what the device said without being asked since the last call."""
        notices, self._notices = self._notices, []
        return list(dict.fromkeys(notice.means for notice in notices if notice.means))

    def read_serial(self, expected: str) -> str:
        """Ask for the serial number (empty: the device has none); refuse another one than expected, if any is."""
        serial = self._description.serial
        own_serial = shown(self.query(serial)["serial"]) if serial is not None else ""
        if expected and not is_same_serial(own_serial, expected):
            raise WrongDevice(
                f"the station file names serial {expected}, but the device answers"
                f" '{own_serial or 'no serial number'}'. Nothing was moved or switched.",
                where=self.name,
                remedy="Check the port and the serial in the station file.",
            )
        self._known_serial = own_serial
        return own_serial

    # ------------------------------------------------------------ inside

    def _exchange(self, exchange: Exchange, values: Mapping[str, Value]) -> dict[str, Value]:
        request = exchange.send.render(values)

        def read_reply(reader: ReplyReader) -> str:
            text = ""
            while exchange.reply is not None and (
                not text or _is_echo(text, exchange.reply, {**values, "request": request})
            ):
                text = self._text(reader.read_line())
            return text

        with self.lock:
            text = self.exchange(self._encode(request), read_reply)
            return self._match(exchange, request, text, values) if exchange.reply is not None else {}

    def _match(
        self, exchange: Exchange, request: str, text: str, values: Mapping[str, Value]
    ) -> dict[str, Value]:
        """Return the values of a reply; raise for a refusal, and for a reply of another form."""
        known = {**values, "request": request}
        for refusal in self._description.refusals:
            refused = refusal.reply.match(text, known)
            code = "" if refused is None else refused.get("code", "")
            code = f"{code:g}" if isinstance(code, float) else code
            if refused is not None and code not in refusal.fine:
                meaning = (
                    refusal.codes.get(code, "") or refusal.means or str(refused.get("message", "")).strip()
                )
                raw = "" if not meaning or meaning in text else f" ('{text}')"
                raise DeviceRefused(
                    f"the device refuses '{request}': {meaning or text}{raw}.",
                    where=self.name,
                    remedy="Check the limits and ranges in the station file and in the device's description."
                    if values.keys() - {"address"}
                    else "Check that the description is that of this model and firmware, and that the device is free"
                    " to do it.",
                )
        assert exchange.reply is not None
        match = exchange.reply.match(text, known)
        if match is None:
            raise self.garbled_reply(
                f"'{request}' was answered by {text[:_SHOWN]!r}, not as described ({exchange.reply.text})."
            )
        own = f"_{str(values.get('address', '')).lower()}"  # of one axis, where a reply tells of several
        return match | {name.removesuffix(own): value for name, value in match.items() if name.endswith(own)}

    def _encode(self, request: str) -> bytes:
        return (
            with_checksum(self._description.checksum, request.encode("ascii")) + self._description.request_end
        )

    def _text(self, line: bytes) -> str:
        """Return the text of a line without notices; empty if nothing else is in it. Checks the checksum."""
        body = line.strip(_FILLERS)
        # Some devices answer the end of a request by a line feed before the reply.
        body = _BREAK.sub(b" ", self._take_from(body))
        if not re.fullmatch(rb"[\t -~]*", body):
            raise self.garbled_reply(f"not a reply: {line[:_SHOWN]!r}.")
        if added := len(with_checksum(self._description.checksum, b"")):
            whole, body = body, body[:-added]
            if whole and whole != with_checksum(self._description.checksum, body):
                raise self.garbled_reply(f"a reply without its checksum: {line[:_SHOWN]!r}.")
        return body.decode("ascii").replace("\t", " ").strip()

    def _take_from(self, data: bytes) -> bytes:
        """Keep the notices in some bytes, and return the rest."""
        for notice in self._description.notices:
            mark = notice.text.encode("ascii")
            if mark in data:
                self._notices.append(notice)
                data = data.replace(mark, b"")
        return data

    def _clear_device(self) -> None:
        """Make an incomplete request invalid, set the form of the replies, and throw away the answers."""
        if clear := self._description.clear + self._description.request_end:
            self.write(clear)
        self._take_from(self.drain())
        for command in self._description.setup:
            self.write(self._encode(command.render({})))
            self._take_from(self.drain())

    def _first_identity(self, clock: Clock) -> dict[str, Value]:
        """Ask who the device is, for as long as it may take to start, unless another device answers."""
        started_s = clock.monotonic() + self._description.start_s
        others = 0
        while clock.monotonic() < started_s and others < _MOST_OTHER_ANSWERS:
            try:
                return self._identify()
            except ReplyError as error:
                others += not isinstance(error, ReplyTimeout)
                self._clear_device()
        return repeat(self._identify, before_next=self._clear_device)

    def _identify(self) -> dict[str, Value]:
        with self.urgently():
            identity = self._exchange(self._description.identity, {})
        self._known = repr(sorted(identity.items()))
        return identity

    def _resynchronise(self) -> None:
        if not self._known:
            return  # _identify asks for it at this moment

        def is_known() -> bool:
            identity = self._exchange(self._description.identity, {})
            return repr(sorted(identity.items())) == self._known and self._has_known_serial()

        self.prove_in_step(
            is_known,
            failed=f"no clear answer to '{self._description.identity.send.text}', though the device answered it"
            " before.",
            clear_device=self._clear_device,
            inspect_old=self._take_from,
            once_if_silent=True,
        )

    def _has_known_serial(self) -> bool:
        """Ask for the serial number on a line that was opened again: another device may be there."""
        serial = self._description.serial
        if self.connections == 1 or serial is None or not self._known_serial:
            return True
        return shown(self._exchange(serial, {})["serial"]) == self._known_serial


def _is_echo(text: str, reply: Template, known: Mapping[str, Value]) -> bool:
    """Return whether a line repeats the request and is no reply: a device may echo in a line of its own."""
    return text == str(known["request"]).rstrip() and reply.match(text, known) is None
