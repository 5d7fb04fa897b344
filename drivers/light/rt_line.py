"""Knows how a Gardasoft RT controller is spoken to: lines and prompts, fields, quantities. Decides nothing.

From the manual of the RT series, section 12.
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
_MODES = {CONTINUOUS, "1", PULSED}
IDENTITY: Final = re.compile(r"(RT\S+) (.*?) ?(V\d+)")
REFUSED: Final = re.compile(r"Err ?(\d{1,3})")
_QUANTITY = re.compile(r"(\d{1,9}(?:\.(\d{1,9}))?) ?(us|ms|s|%)?", re.IGNORECASE)
_FACTORS = {"us": 1e-3, "ms": 1.0, "s": 1e3, "%": 1.0, "": 1.0}
"""To milliseconds, and to percent."""

REFUSALS = {
    1: "a value is invalid",
    2: "it does not know this command",
    3: "a number has the wrong form",
    4: "wrong number of values",
    5: "a time was out of range and was changed to a valid one",
}


class Quantity(NamedTuple):
    """A number as printed, in ms or percent, and half its last digit."""

    value: float
    half_digit: float

    def is_near(self, wanted: float) -> bool:
        """Whether a wanted value prints like this; a part in 100,000 more is the controller's own rounding."""
        return abs(self.value - wanted) <= self.half_digit * 1.001 + 1e-5 * abs(wanted)


class RtLine(TextLine):
    """An RT controller on a line: each command is answered, at the least by its prompt ``>``."""

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        super().__init__(
            port,
            who="VR",
            is_identity=lambda text: IDENTITY.fullmatch(text) is not None,
            clock=clock,
            request_end=b"\r",
            reply_end=b">",
            reply_s=PROMPT_S,
            wire_log=wire_log,
        )

    def at_once(self, command: str) -> None:
        """Send a command before any resynchronising, and see its prompt. Raises ReplyError, PortLost."""
        self._ask(command, PROMPT_S, urgent=True)

    def fields(self, query: str) -> dict[str, str]:
        """Ask for settings, and return them by their names. Raises ReplyError, PortLost."""
        text = self.ask(query)
        pairs = [part.split(" ", 1) for part in text.split(", ")]
        if not all(len(pair) == 2 and re.fullmatch("[A-Z]{1,2}", pair[0]) for pair in pairs):
            raise self.garbled(f"{query} answered {text!r}.")
        return dict(pairs)

    def quantity(self, fields: dict[str, str], name: str) -> Quantity:
        """Understand one of the fields as a time in ms or a brightness in percent. Raises ReplyGarbled."""
        match = _QUANTITY.fullmatch(fields.get(name, "").split(",")[0])
        if match is None:
            raise self.garbled(f"no quantity {name} in {fields}.")
        factor = _FACTORS[(match[3] or "").lower()]
        return Quantity(float(match[1]) * factor, 0.5 * 10.0 ** -len(match[2] or "") * factor)

    def mode(self, fields: dict[str, str]) -> str:
        """Understand a channel's mode: continuous, switched or pulsed. Raises ReplyGarbled."""
        mode = fields.get("MD", "")
        if mode not in _MODES:
            raise self.garbled(f"no mode of a channel in {fields}.")
        return mode

    def _text(self, line: bytes) -> str:
        """Understand what stands before the prompt; nothing does where a command only carries out."""
        body = line.removesuffix(b">").strip(b"\r\n")
        if not re.fullmatch(rb"[ -~]*", body):
            raise self.garbled(f"not a reply: {line[:80]!r}.")
        return body.decode("ascii").strip()
