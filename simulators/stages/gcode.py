"""Parser of one G-code block, in the subset that a GRBL controller of a rotary stage needs.

Grammar and error numbers are those of GRBL 1.1 (its source, ``gcode.c``, and its wiki page "Interface").
The module does not move anything.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
_COMMENT: Final = re.compile(r"\([^)]*(?:\)|$)|;.*")

#: Accepted codes without effect here: plane, work offset, units per minute, spindle and coolant off.
_WITHOUT_EFFECT: Final = {"G17", "G21", "G40", "G49", "G54", "G61", "G80", "G94", "M5", "M9"}
_GROUPS: Final = {
    **dict.fromkeys(("G0", "G1"), "motion"),
    **dict.fromkeys(("G90", "G91"), "distance"),
    "G53": "once",
}


class GcodeError(Exception):
    """A refused block, with an error number of GRBL 1.1."""

    def __str__(self) -> str:
        return f"error:{self.args[0]}"


@dataclass(frozen=True)
class Block:
    """Content of a block; None stands for what the block does not contain."""

    motion: str | None = None  # "G0" or "G1"; the last one remains in force
    distance: str | None = None  # "G90" (absolute) or "G91" (relative); the last one remains in force
    feed: float | None = None  # Feed, units/min
    machine_coordinates: bool = False  # Whether the block contains G53
    targets: dict[str, float] = field(default_factory=dict)  # Coordinates by axis letter, units


def strip_line(line: str) -> str:
    """Return a line as the firmware keeps it: without blanks, comments and ``/``, in capitals.

    >>> strip_line("g0 (fast) x-1 ; and back"), strip_line("$ i"), strip_line("G1 (not closed")
    ('G0X-1', '$I', 'G1')
    """
    return re.sub(r"[\s/]", "", _COMMENT.sub("", line)).upper()


def parse_block(line: str, axes: str = "XYZ") -> Block:
    """Parse a block, with or without comments and blanks.

    `GcodeError`: 1 letter expected, 2 bad number, 4 negative value, 20 unsupported code, 21 two codes of one group, 23
    code is not a whole number, 24 two codes need the axes, 25 repeated letter.

    >>> parse_block("G90 g1 X-1.5 F600").targets
    {'X': -1.5}
    """
    codes: dict[str, str] = {}
    values: dict[str, float] = {}
    for letter, value in _words(strip_line(line)):
        if letter in "GM":
            _take_code(letter, value, codes)
        elif letter not in axes and letter not in "FPNST":
            raise GcodeError(20)
        elif letter in values:
            raise GcodeError(25)
        elif letter in "FPNST" and value < 0.0:
            raise GcodeError(4)
        else:
            values[letter] = value
    return Block(
        motion=codes.get("motion"),
        distance=codes.get("distance"),
        feed=values.get("F"),
        machine_coordinates="once" in codes,
        targets={letter: values[letter] for letter in axes if letter in values},
    )


def _words(text: str) -> Iterator[tuple[str, float]]:
    """Yield the letters of a block, each with its number."""
    while text:
        letter, text = text[0], text[1:]
        if not "A" <= letter <= "Z":
            raise GcodeError(1)
        match = NUMBER.match(text)
        if match is None:
            raise GcodeError(2)
        text = text[match.end() :]
        yield letter, float(match[0])


def _take_code(letter: str, value: float, codes: dict[str, str]) -> None:
    if value != int(value):
        raise GcodeError(23)
    code = f"{letter}{int(value)}"
    if code in _WITHOUT_EFFECT:
        return
    if code not in _GROUPS:
        raise GcodeError(20)
    group = _GROUPS[code]
    if group in codes:
        raise GcodeError(24 if group == "motion" else 21)
    codes[group] = code
