"""Talk to a Gardasoft RT controller: commands and prompts, fields, quantities.

Source: Gardasoft, "RTxxx LED lighting controllers: User Manual", section 12 (commands).
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from drivers.clock import Clock
from drivers.serial_port import Port
from drivers.text_line import PROMPT_S, TextLine
from drivers.wire_log import WireLog

CONTINUOUS: Final = "0"
PULSED: Final = "2"
"""Modes of a channel."""
_MODES = {CONTINUOUS, "1", PULSED}
IDENTITY: Final = re.compile(r"(RT\S+) (.*?) ?(V\d+)")
REFUSED: Final = re.compile(r"Err ?(\d{1,3})")
_QUANTITY = re.compile(r"(\d{1,9}(?:\.(\d{1,9}))?) ?(us|ms|s|%)?", re.IGNORECASE)
_FACTORS = {"us": 1e-3, "ms": 1.0, "s": 1e3, "%": 1.0, "": 1.0}
"""Factors that convert times to milliseconds; levels are percent already."""

REFUSALS = {
    1: "a value is invalid",
    2: "unknown command",
    3: "a number has the wrong form",
    4: "wrong number of values",
    5: "a time was out of range and was changed to a valid one",
}
"""Meanings of the error numbers."""


class Quantity(NamedTuple):
    """A number as the controller prints it."""

    value: float  # The number, in milliseconds or percent
    half_digit: float  # Half of its last digit, in the same unit

    def agrees_with(self, wanted: float) -> bool:
        """Return whether a wanted value prints like this; the controller may round by 1 part in 100,000 more.

        wanted: The wanted value, in the unit of ``value``.
        Returns: Whether both are equal within their digits.
        """
        return abs(self.value - wanted) <= self.half_digit * 1.001 + 1e-5 * abs(wanted)


class RtLine(TextLine):
    """A line to an RT controller. Every command has a reply, which is at least the prompt ``>``.

    clock, wire_log: See ``drivers.link.Link``.
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        super().__init__(
            port,
            identity_query="VR",
            is_identity=lambda text: IDENTITY.fullmatch(text) is not None,
            clock=clock,
            request_end=b"\r",
            reply_end=b">",
            reply_s=PROMPT_S,
            wire_log=wire_log,
        )

    def command_urgent(self, command: str) -> None:
        """Send a command at once, without resynchronising, and wait for its prompt.

        command: The command, without the end of a request.
        Raises ReplyError: No prompt came.
        """
        self._query_once(command, PROMPT_S, urgent=True)

    def query_fields(self, query: str) -> dict[str, str]:
        """Ask for settings.

        Raises ReplyError: No valid reply came.
        """
        text = self.query(query)
        pairs = [part.split(" ", 1) for part in text.split(", ")]
        if not all(len(pair) == 2 and re.fullmatch("[A-Z]{1,2}", pair[0]) for pair in pairs):
            raise self.garbled_reply(f"{query} answered {text!r}.")
        return dict(pairs)

    def parse_quantity(self, fields: dict[str, str], name: str) -> Quantity:
        """Parse a field as a time or a brightness.

        Returns: The value, in milliseconds or percent.
        Raises ReplyGarbled: There is no such field, or it is no quantity.
        """
        match = _QUANTITY.fullmatch(fields.get(name, "").split(",")[0])
        if match is None:
            raise self.garbled_reply(f"no quantity {name} in {fields}.")
        factor = _FACTORS[(match[3] or "").lower()]
        return Quantity(float(match[1]) * factor, 0.5 * 10.0 ** -len(match[2] or "") * factor)

    def parse_mode(self, fields: dict[str, str]) -> str:
        """Parse the mode of a channel.

        Returns: The mode's number: continuous, switched or pulsed.
        Raises ReplyGarbled: There is no valid mode in the fields.
        """
        mode = fields.get("MD", "")
        if mode not in _MODES:
            raise self.garbled_reply(f"no mode of a channel in {fields}.")
        return mode

    def _parse_reply(self, line: bytes) -> str:
        """Return the text before the prompt; the reply to most commands has none."""
        body = line.removesuffix(b">").strip(b"\r\n")
        if not re.fullmatch(rb"[ -~]*", body):
            raise self.garbled_reply(f"not a reply: {line[:80]!r}.")
        return body.decode("ascii").strip()
