"""SCPI as text: headers in short and long form, messages of several units, numbers with units, errors.

Syntax and error numbers are those of IEEE 488.2 and SCPI-99. The module depends on no instrument: an instrument
registers its commands in a `CommandTree`, which calls them with their arguments as words.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

#: Executes a command with these arguments.
Setter = Callable[[list[str]], None]

#: Returns the answer to a query with these arguments.
Getter = Callable[[list[str]], str]

_NODE = re.compile(r"(\[)?:?(\*?[A-Z]+)([a-z]*)(#)?\]?")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:E[+-]?\d+)?", re.IGNORECASE)

_ERRORS = {
    0: "No error",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -113: "Undefined header",
    -221: "Settings conflict",
    -222: "Data out of range",
    -224: "Illegal parameter value",
    -350: "Queue overflow",
}


class ScpiError(Exception):
    """An error of a command; ``code`` is one of SCPI-99, e.g. -113 for an undefined header."""

    def __init__(self, code: int, detail: str = "") -> None:
        self.code = code
        self.text = _ERRORS[code] + (f"; {detail}" if detail else "")
        super().__init__(f"{code} {self.text}")


class ErrorQueue:
    """Error queue, first in, first out; full, it ends in "Queue overflow" (SCPI-99, volume 2, chapter 21)."""

    def __init__(self, length: int = 20) -> None:
        self._length = length
        self._errors: list[ScpiError] = []

    def add(self, error: ScpiError) -> None:
        """Append an error; when the queue is full, replace its last entry by -350."""
        if len(self._errors) < self._length:
            self._errors.append(error)
        else:
            self._errors[-1] = ScpiError(-350)

    def next(self) -> str:
        """Remove the oldest error: number and text, as an instrument prints them; ``+0,"No error"`` if none."""
        error = self._errors.pop(0) if self._errors else ScpiError(0)
        return f'{error.code:+d},"{error.text}"'

    def clear(self) -> None:
        """Remove all errors."""
        self._errors.clear()


class Unit(NamedTuple):
    """One command or query of a message."""

    header: str  # Absolute header, in capitals, without a question mark
    query: bool  # Whether it is a query
    arguments: list[str]


def units(message: str) -> Iterator[Unit]:
    """Split a message at its semicolons; a header without a leading colon continues the path of the one before.

    >>> [unit.header for unit in units("VOLT:HIGH 5;LOW 0;:FREQ 60;*OPC?")]
    ['VOLT:HIGH', 'VOLT:LOW', 'FREQ', '*OPC']
    """
    path = ""
    for part in message.split(";"):
        header, _, rest = part.strip().partition(" ")
        if not header:
            continue
        query = header.endswith("?")
        name = header.rstrip("?").upper()
        if not name.startswith("*"):
            name = name[1:] if name.startswith(":") else path + name
            path = name[: name.rfind(":") + 1]
        yield Unit(name, query, [word.strip() for word in rest.split(",")] if rest.strip() else [])


def header_pattern(specification: str) -> re.Pattern[str]:
    """Compile a header from the notation of instrument manuals.

    Capitals are the short form, brackets enclose optional nodes, # stands for an optional channel number 1.

    >>> pattern = header_pattern("[:SOURce#]:FREQuency[:CW]")
    >>> [bool(pattern.fullmatch(header)) for header in ("FREQ", "SOURCE1:FREQUENCY:CW", "FREQU")]
    [True, True, False]
    """
    expression = ""
    for optional, short, tail, channel in _NODE.findall(specification):
        node = re.escape(short) + (f"(?:{tail.upper()})?" if tail else "") + ("1?" if channel else "")
        # The first node carries no colon, whichever of the optional ones that is.
        expression += f"(?:(?:^|(?<!^):){node})?" if optional else f"(?:^|(?<!^):){node}"
    return re.compile(expression)


@dataclass(frozen=True)
class _Entry:
    pattern: re.Pattern[str]
    setter: Setter | None
    getter: Getter | None


class CommandTree:
    """The commands of an instrument."""

    def __init__(self, errors: ErrorQueue) -> None:
        self.errors = errors
        self._entries: list[_Entry] = []

    def add(self, specification: str, setter: Setter | None, getter: Getter | None) -> None:
        """Register a header, as `header_pattern` takes it, as a command, a query, or both."""
        self._entries.append(_Entry(header_pattern(specification), setter, getter))

    def answer(self, message: str) -> str | None:
        """Execute a message; return the queries' answers, or None. An error -1xx ends the message, -2xx not."""
        answers: list[str] = []
        for unit in units(message):
            try:
                result = self._carry_out(unit)
            except ScpiError as error:
                self.errors.add(error)
                if error.code > -200:
                    break
            else:
                answers += [] if result is None else [result]
        return ";".join(answers) if answers else None

    def _carry_out(self, unit: Unit) -> str | None:
        for entry in self._entries:
            if entry.pattern.fullmatch(unit.header):
                if unit.query and entry.getter is not None:
                    return entry.getter(unit.arguments)
                if not unit.query and entry.setter is not None:
                    entry.setter(unit.arguments)
                    return None
        raise ScpiError(-113)


def only_argument(arguments: Sequence[str]) -> str:
    """Return the only argument; `ScpiError` -109 without an argument, -108 with several."""
    if not arguments:
        raise ScpiError(-109)
    if len(arguments) > 1:
        raise ScpiError(-108)
    return arguments[0]


def number(word: str) -> float:
    """Read a number without a unit; `ScpiError` -104 for anything else."""
    if not _NUMBER.fullmatch(word):
        raise ScpiError(-104)
    return float(word)


def boolean(word: str) -> bool:
    """Read ON, OFF or a number; only 0 is off."""
    if word.upper() in {"ON", "OFF"}:
        return word.upper() == "ON"
    return number(word) != 0.0


def choice(word: str, choices: Sequence[str]) -> str:
    """Read one of several words, in short or long form; `ScpiError` -224 if the word is none of them.

    >>> choice("square", ["SINusoid", "SQUare"])
    'SQU'
    """
    for word_of_choice in choices:
        if header_pattern(word_of_choice).fullmatch(word.upper()):
            return "".join(letter for letter in word_of_choice if letter.isupper() or letter.isdigit())
    raise ScpiError(-224)
