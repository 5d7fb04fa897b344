"""What a description says of a device: requests, replies, units. Plain data; the bench reads the files.

Names of values that a stage's requests may carry: ``target`` (controller's counts), of settings ``value``. A light's
requests carry ``value``. ``{address}`` is the axis's address, ``{request}`` in a reply is the request that was sent.

Its requests and replies are templates: text with placeholders such as ``{counts:integer}``, no regular expressions. A
placeholder takes as many characters of its kind as there are, and the text after it cannot begin with such a character.
So a reply is read in one pass from left to right, whatever a device sends. Nothing is evaluated.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, reduce
from operator import xor
from typing import Final, Literal

from drivers.errors import OutsideLimits
from drivers.serial_port import LineSettings

LONGEST: Final = 200
"""Characters of a template at most; requests and replies are some words."""
MOST_DECIMALS: Final = 9  # A double has 15 digits, and angles take three before the point

Value = float | str

_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")
_NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")
_PADDED = " {0,15}[+-]? {0,15}"
"""What may stand before the digits of a number: some devices print all numbers with one length, as in ``-   1000``."""
_NUMBER = _PADDED + r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?"
_SHAPES: Final = {
    "integer": re.compile(_PADDED + r"[0-9]{1,15}", re.ASCII),
    "number": re.compile(_NUMBER, re.ASCII),
    "word": re.compile(r"[A-Za-z0-9_.+-]+", re.ASCII),
    "text": re.compile(r"[ -~]+", re.ASCII),
    "sign": re.compile(r"[+-]", re.ASCII),
    "size": re.compile(r"[0-9]{1,15}", re.ASCII),
}
_HEX: Final = {"hex": 0, "signed_hex": 1}
"""Kinds of a fixed number of hexadecimal digits, and how many bits are the sign (two's complement)."""
MOST_HEX_DIGITS: Final = 8  # Registers have 32 bits at most
_MOST_DIGITS: Final = 15  # Those of a double
_FIRST: Final = {
    **dict.fromkeys(("integer", "size"), "0123456789"),
    "number": "0123456789.eE+-",
    "word": "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_.+-",
}
"""Characters with which the text after a placeholder of that kind cannot begin; none where its length is fixed."""
Checksum = Literal["none", "xor", "sum", "complement"]
AxisQuantity = Literal["speed", "acceleration", "lowest", "highest", "constant"]
ScaleUnit = Literal["counts_per_deg", "deg_per_count", "arcsec_per_count"]
LightQuantity = Literal["waveform", "frequency_hz", "duty_percent", "level_percent", "sync", "constant"]


class TemplateFault(ValueError):
    """A template that cannot be used; the message says what to write instead."""


@dataclass(frozen=True)
class Placeholder:
    """A place of a template that a value takes."""

    name: str
    # One of `_SHAPES` or `_HEX`; empty for a value that is known when the template is used.
    kind: str = ""
    # Of a number that is sent: digits after the point, None for as many as needed. All digits of a hexadecimal number;
    # least number of digits of a whole one; all letters of a word.
    digits: int | None = None

    @property
    def shape(self) -> re.Pattern[str]:
        """The characters that its value may have."""
        if self.kind in _HEX:
            return re.compile(f"[0-9A-Fa-f]{{{self.digits}}}")
        if self.kind == "word" and self.digits:
            return re.compile(f"[A-Za-z0-9_.+-]{{{self.digits}}}", re.ASCII)
        return _SHAPES[self.kind]

    @property
    def has_fixed_length(self) -> bool:
        """Whether its end is known, whatever follows."""
        return self.kind in {*_HEX, "sign"} or (self.kind == "word" and bool(self.digits))


@dataclass(frozen=True)
class Template:
    """A request or a reply with places for values. `parse_template` makes one."""

    text: str
    parts: tuple[str | Placeholder, ...]  # Texts and placeholders, in their order

    @property
    def read_names(self) -> frozenset[str]:
        """Names of the placeholders that a reply gives values to."""
        return frozenset(part.name for part in self.parts if isinstance(part, Placeholder) and part.kind)

    def render(self, values: Mapping[str, Value]) -> str:
        """Return the text with the values in their places."""
        return "".join(
            part if isinstance(part, str) else _written(part, values[part.name]) for part in self.parts
        )

    def as_sent(self, values: Mapping[str, Value], name: str) -> Value:
        """Return a value of a request with the digits that are sent; a value that does not stand in it, as it is."""
        read: Value | None = None
        for part in self.parts:
            if isinstance(part, Placeholder) and part.kind and part.name == name:
                read = _read(part, _written(part, values[name]), read)  # a sign stands before its size
        return values[name] if read is None or isinstance(read, str) else read

    def match(self, line: str, known: Mapping[str, Value]) -> dict[str, Value] | None:
        """Read the values of a line without its end; None if it does not have this form, but for the number of blanks.

        ``known`` holds the values of the placeholders without a kind.
        """
        values: dict[str, Value] = {}
        at = 0
        for part in self.parts:
            if isinstance(part, str) or not part.kind:
                text = part if isinstance(part, str) else str(known[part.name])
                literal = _literal(text if at else text.lstrip()).match(line, at)
                if literal is None:
                    return None
                at = literal.end()
                continue
            shape = part.shape.match(line, at)
            value = None if shape is None else _read(part, shape[0], values.get(part.name))
            if shape is None or value is None:
                return None
            values[part.name] = value
            at = shape.end()
        return values if at == len(line) else None


def parse_template(text: str, *, known: frozenset[str], readable: frozenset[str] | None) -> Template:
    """Read a template: ``{name}`` stands for a known value, ``{name:kind}`` for a value that is read or sent.

    ``known`` and ``readable`` are the names that may stand without and with a kind; ``readable`` is None for a reply,
    which may have any. Raises `TemplateFault` if a placeholder is unknown, or a reply could be read in two ways.

    >>> reply = parse_template("POS={counts:integer} {unit:word}", known=frozenset(), readable=None)
    >>> reply.match("POS=-120 steps", {})
    {'counts': -120.0, 'unit': 'steps'}
    >>> reply.match("POS=-120", {}) is None
    True
    """
    if not text:
        raise TemplateFault("must not be empty.")
    if len(text) > LONGEST:
        raise TemplateFault(f"must have {LONGEST} or fewer characters.")
    if not all(" " <= letter <= "~" for letter in text):
        raise TemplateFault("must be printable ASCII; line ends have their own keys.")
    parts: list[str | Placeholder] = []
    end = 0
    for placeholder in _PLACEHOLDER.finditer(text):
        parts += [text[end : placeholder.start()], _placeholder(placeholder[1], known, readable)]
        end = placeholder.end()
    parts = [part for part in (*parts, text[end:]) if part != ""]
    if any(isinstance(part, str) and ("{" in part or "}" in part) for part in parts):
        raise TemplateFault("a brace has no partner; a placeholder is written {name:kind}.")
    _check_names([part for part in parts if isinstance(part, Placeholder) and part.kind])
    for part, following in zip(parts, [*parts[1:], None], strict=True):
        if isinstance(part, Placeholder) and part.kind and readable is None:
            _check_end(part, following)
    return Template(text, tuple(parts))


@lru_cache(maxsize=256)
def _literal(text: str) -> re.Pattern[str]:
    """Return the pattern of a text, in which a blank stands for one or more: devices align their columns."""
    return re.compile(re.sub(r"(\\ )+", " ++", re.escape(text)))


def _placeholder(inner: str, known: frozenset[str], readable: frozenset[str] | None) -> Placeholder:
    name, colon, kind = inner.partition(":")
    if not _NAME.fullmatch(name):
        raise TemplateFault(f"{{{inner}}} is no placeholder; write {{name:kind}} with a small-letter name.")
    if not colon:
        if name not in known:
            listed = ", ".join(f"{{{known_name}}}" for known_name in sorted(known)) or "none"
            raise TemplateFault(
                f"{{{name}}} needs a kind, such as {{{name}:integer}}. Without a kind: {listed}."
            )
        return Placeholder(name)
    if readable is not None and name not in readable:
        listed = ", ".join(sorted(readable)) or "none"
        raise TemplateFault(f"there is no value {name!r} here. Known here: {listed}.")
    kind, point, digits = kind.partition(".")
    if kind not in {*_SHAPES, *_HEX}:
        raise TemplateFault(f"{kind!r} is no kind; write one of {', '.join([*_SHAPES, *_HEX])}.")
    if kind in _HEX:
        if not digits.isdecimal() or not 0 < int(digits) <= MOST_HEX_DIGITS:
            raise TemplateFault(f"digits are written {{{name}:{kind}.8}}, at most {MOST_HEX_DIGITS}.")
        return Placeholder(name, kind, int(digits))
    if not point:
        return Placeholder(name, kind)
    if kind in {"integer", "word"} and digits.isdecimal() and 0 < int(digits) <= _MOST_DIGITS:
        return Placeholder(name, kind, int(digits))
    if kind != "number" or not digits.isdecimal() or int(digits) > MOST_DECIMALS:
        raise TemplateFault(f"decimals are written {{{name}:number.3}}, at most {MOST_DECIMALS}.")
    return Placeholder(name, kind, int(digits))


def _check_names(read: Sequence[Placeholder]) -> None:
    """Check that each value is read once, and that a sign stands before its size."""
    names = [part.name for part in read if part.kind != "sign"]
    if len(names) != len(set(names)):
        raise TemplateFault("a name stands twice.")
    kinds = [(part.name, part.kind) for part in read]
    for at, (name, kind) in enumerate(kinds):
        if kind == "sign" and (name, "size") not in kinds[at:]:
            raise TemplateFault(f"{{{name}:sign}} needs {{{name}:size}} behind it.")


def _check_end(part: Placeholder, following: str | Placeholder | None) -> None:
    """Check that it is clear where a value ends."""
    if following is None or part.has_fixed_length:
        return
    if part.kind == "text":
        raise TemplateFault(f"{{{part.name}:text}} takes the rest of the line, so nothing may follow it.")
    if isinstance(following, Placeholder):
        raise TemplateFault(f"text must stand between {{{part.name}}} and {{{following.name}}}.")
    if following[0] in _FIRST[part.kind]:
        raise TemplateFault(
            f"the end of {{{part.name}}} is not clear, because {following[0]!r} may be part of it."
        )


def _read(place: Placeholder, text: str, sign: Value | None) -> Value | None:
    """Return the value of a text of the placeholder's shape, behind its sign if there was one; None for no number."""
    if place.kind in {"word", "text"}:
        return text
    if place.kind == "sign":
        return float(f"{text}1")
    if place.kind in _HEX:
        number, bits = int(text, 16), 4 * len(text)
        return float(number - (1 << bits if _HEX[place.kind] and number >> bits - 1 else 0))
    value = float(text.replace(" ", "")) * float(sign or 1.0)
    return value if math.isfinite(value) else None


def _written(place: Placeholder, value: Value) -> str:
    if isinstance(value, str) or place.kind in {"", "word", "text"}:
        return f"{value:g}" if isinstance(value, float) else str(value)
    if place.kind == "integer":
        return f"{round(value):0{place.digits or 1}d}"
    if place.kind == "sign":
        return "-" if round(value) < 0 else "+"
    if place.kind == "size":
        return str(abs(round(value)))
    if place.kind in _HEX:
        digits, sign_bits = place.digits or 0, _HEX[place.kind]
        most = 1 << 4 * digits - sign_bits
        if not -most * sign_bits <= round(value) < most:
            raise OutsideLimits(
                f"{value:g} does not fit into {digits} hexadecimal digits. Nothing was sent.",
                where=f"{{{place.name}:{place.kind}.{digits}}}",
                remedy="Check scale, limits and speeds in the station file.",
            )
        return f"{round(value) % (1 << 4 * digits):0{digits}X}"
    return f"{value:.{9 if place.digits is None else place.digits}f}"


def with_checksum(kind: Checksum, body: bytes) -> bytes:
    """Return a message with its checksum of eight bits, in two hexadecimal digits.

    >>> [with_checksum(kind, b"AB1") for kind in ("none", "xor", "sum", "complement")]
    [b'AB1', b'AB1*32', b'AB1B4', b'AB14C']
    """
    if kind == "xor":
        return b"%b*%02X" % (body, reduce(xor, body, 0))
    total = sum(body) if kind == "sum" else -sum(body)
    return body if kind == "none" else b"%b%02X" % (body, total & 0xFF)


@dataclass(frozen=True)
class Exchange:
    """A request and its reply."""

    send: Template
    reply: Template | None = None  # The form of the reply; None when the device does not answer


@dataclass(frozen=True)
class Refusal:
    """A reply by which the device refuses a request."""

    reply: Template  # Its form; a value ``message`` or ``code`` in it is told
    means: str = ""  # What it means; empty when the message says it
    codes: Mapping[str, str] = field(default_factory=dict)
    fine: tuple[str, ...] = ()  # Codes that refuse nothing


@dataclass(frozen=True)
class Notice:
    """A text that the device sends without a request, within a line or alone."""

    text: str
    means: str = ""  # What it means for a move; empty when it means nothing


@dataclass(frozen=True, kw_only=True)
class LineDescription:
    """The line to a device."""

    maker: str
    model: str
    settings: LineSettings  # Where the station file does not say otherwise
    request_end: bytes
    reply_end: bytes  # Empty where a silence of ``quiet_s`` ends each reply
    prompt: bytes  # Ends each reply in place of ``reply_end``, and is a part of it; empty for none
    reply_s: float  # Longest wait for a reply, in seconds
    quiet_s: float  # After this time without a byte, the line counts as silent; in seconds
    # Longest time from the opening of the port to the first answer, in seconds: some boards restart then.
    start_s: float
    checksum: Checksum  # What requests and replies end in; `with_checksum` makes it
    # Sent before the end of a request, when a beginning of a request may be in the device's buffer: it makes
    # that request invalid. Without it, a query that was cut could become a command.
    clear: bytes
    # Requests that set the form of the replies, and nothing else. Sent at opening and when the line is out of
    # step.
    setup: tuple[Template, ...]
    identity: Exchange  # Query whose answer never changes. Value ``firmware`` is told if the reply has it.
    serial: Exchange | None  # Query of the serial number, value ``serial``; None if the device has none
    refusals: tuple[Refusal, ...]
    notices: tuple[Notice, ...]
    unasked: tuple[Template, ...]  # Forms of lines that the device sends without a request, to be left out


@dataclass(frozen=True)
class Switch:
    """A query of a state that has two sides, such as moving or idle."""

    query: Exchange  # The query; its reply has the value ``state``
    # Answers that mean the second side (idle, homed, on, no fault); numbers are compared as numbers.
    true_words: tuple[str, ...]
    mask: int = -1  # The bits that count, where the answer is a whole number


@dataclass(frozen=True, kw_only=True)
class AxisSetting:
    """A setting of an axis that is written where it differs, and read back."""

    quantity: AxisQuantity
    set: Exchange  # How to write it; carries ``value``
    query: Exchange  # How to read it; the reply has ``value``
    factor: float = 1.0  # The device's value divided by that in counts; not of a constant
    constant: Value = 0.0  # Value of a setting that does not depend on the station file; a word or a number
    # Largest difference between the value that was written and the one that is read, in percent.
    tolerance_percent: float = 0.0

    @property
    def is_position(self) -> bool:
        """Whether it is a position, which a device may know only after a search of its reference."""
        return self.quantity in {"lowest", "highest"}


@dataclass(frozen=True, kw_only=True)
class StageDescription:
    """A stage whose controller has a described protocol. Positions are in the controller's counts."""

    line: LineDescription
    move: Exchange  # Starts a move to the absolute position ``target``, or sets the target where ``start`` starts it
    start: Exchange | None
    move_replies_at_end: bool  # Whether the reply to ``move`` comes only when the axis has arrived
    stop: Exchange
    position: Exchange  # Query of the position counter, value ``counts``
    idle: Switch  # Query whether an axis is idle
    home: Exchange  # Starts the search of an axis's reference
    home_replies_at_end: bool  # Whether the reply to ``home`` comes only when the search has ended
    # Query of the encoder in the units of the counter, value ``counts``; None if there is none.
    encoder: Exchange | None
    at_home: float | None  # Counts at which a finished search leaves the axis; None if they are not known
    reference: Switch | None  # Query whether an axis has a reference; None if the controller does not tell
    errors: Switch | None  # Query of the errors of commands, which removes them; None if there is none
    faults: Switch | None  # Query of faults of an axis; None if there is none
    scale: Exchange | None  # Query of the controller's scale, value ``scale``; None if it does not tell
    scale_unit: ScaleUnit
    # Query of the controller's own lower end of the travel, ``counts``; None if it does not tell.
    lowest: Exchange | None
    highest: Exchange | None  # The same of the upper end
    # Commands to the whole device that undo modes of another program. Each stands between two stops, before
    # settings are written: in its mode, a setting could be a motion.
    modes: tuple[Exchange, ...]
    settings: tuple[AxisSetting, ...]
    setup: tuple[Exchange, ...]  # Commands to each axis, after the settings; they move nothing


@dataclass(frozen=True, kw_only=True)
class LightSetting:
    """A setting of a light."""

    quantity: LightQuantity
    set: Exchange  # How to write it; carries ``value``
    query: Exchange  # How to read it; the reply has ``value``
    # The device's value is this factor times the quantity, or times 1 / quantity if ``inverse``.
    factor: float = 1.0
    query_factor: float = 1.0  # The same of the value that is read
    inverse: bool = False  # Whether the device takes the reciprocal, as a period instead of a frequency
    # The device's words by Starbench's (``square``, ``steady``, ``on``, ``off``); empty for a number.
    words: Mapping[str, str] = field(default_factory=dict)
    constant: Value = 0.0  # Value of a setting that does not depend on the sequence; a word or a number
    lowest: float = float("-inf")
    highest: float = float("inf")
    # Largest difference between the value that was written and the one that is read, in percent.
    tolerance_percent: float = 0.0


@dataclass(frozen=True, kw_only=True)
class LightDescription:
    """A light whose controller has a described protocol."""

    line: LineDescription
    on: Exchange
    off: Exchange
    is_on: Switch
    faults: Switch | None  # Query of faults; None if there is none
    settings: tuple[LightSetting, ...]  # The settings, in the order in which they are written
