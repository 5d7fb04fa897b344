"""One block of G-code, as far as a GRBL controller of a rotary stage takes it.

Knows words, their values and which of them a block may hold; knows no motion. Error numbers are GRBL 1.1's.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
_COMMENT: Final = re.compile(r"\([^)]*\)|;.*")

#: Codes that are understood and change nothing here: plane, work offset, units per minute, spindle and coolant off.
_WITHOUT_EFFECT: Final = {"G17", "G21", "G40", "G49", "G54", "G61", "G80", "G94", "M5", "M9"}
_GROUPS: Final = {
    **dict.fromkeys(("G0", "G1"), "motion"),
    **dict.fromkeys(("G90", "G91"), "distance"),
    **dict.fromkeys(("G4", "G53"), "once"),
}


class GcodeError(Exception):
    """A block that is refused, by GRBL's error number."""

    def __init__(self, number: int) -> None:
        self.number = number
        super().__init__(f"error:{number}")


@dataclass(frozen=True)
class Block:
    """What a block says.

    Attributes
    ----------
    motion
        "G0" or "G1" where it is said; the last one said holds on.
    distance
        "G90" (absolute) or "G91" (relative) where it is said.
    dwell_s
        How long to wait, of G4.
    feed
        Units a minute, where it is said.
    machine_coordinates
        Whether G53 is said.
    targets
        Coordinates by axis letter.
    """

    motion: str | None = None
    distance: str | None = None
    dwell_s: float | None = None
    feed: float | None = None
    machine_coordinates: bool = False
    targets: dict[str, float] = field(default_factory=dict)


def parse_block(line: str, axes: str = "XYZ") -> Block:
    """Take a block apart.

    Raises
    ------
    GcodeError
        1 a letter is expected, 2 bad number, 4 negative, 20 unsupported, 21 two codes of one group, 23 a code that is
        no whole number, 24 two codes that want the axes, 25 a letter twice, 28 no dwell time.

    Examples
    --------
    >>> parse_block("G90 g1 X-1.5 F600").targets
    {'X': -1.5}
    """
    codes: dict[str, str] = {}
    values: dict[str, float] = {}
    for letter, value in _words(_COMMENT.sub("", line).replace(" ", "").replace("\t", "").upper()):
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
    if codes.get("once") == "G4" and "P" not in values:
        raise GcodeError(28)
    return Block(
        motion=codes.get("motion"),
        distance=codes.get("distance"),
        dwell_s=values["P"] if codes.get("once") == "G4" else None,
        feed=values.get("F"),
        machine_coordinates=codes.get("once") == "G53",
        targets={letter: values[letter] for letter in axes if letter in values},
    )


def _words(text: str) -> Iterator[tuple[str, float]]:
    """Take letters and their numbers off a block."""
    while text:
        letter, text = text[0], text[1:]
        if not "A" <= letter <= "Z":
            raise GcodeError(1)
        match = _NUMBER.match(text)
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
