"""One block of G-code, as far as a GRBL controller of a rotary stage takes it.

Knows words, their values and which of them a block may hold; knows no motion. Error numbers are GRBL 1.1's.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Final

_WORD: Final = re.compile(r"([A-Z])([^A-Z]*)")
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
        1 no letter, 2 bad number, 20 unsupported code, 21 two codes of one group, 25 a letter twice,
        28 no dwell time, 22 feed not positive.

    Examples
    --------
    >>> parse_block("G90 g1 X-1.5 F600").targets
    {'X': -1.5}
    """
    text = _COMMENT.sub("", line).replace(" ", "").replace("\t", "").upper()
    if _WORD.sub("", text):
        raise GcodeError(1)
    codes: dict[str, str] = {}
    values: dict[str, float] = {}
    for letter, digits in _WORD.findall(text):
        value = _number(digits)
        if letter in "GM":
            _take_code(f"{letter}{value:g}", codes)
        elif letter in axes or letter in "FPNST":
            if letter in values:
                raise GcodeError(25)
            values[letter] = value
        else:
            raise GcodeError(20)
    if codes.get("once") == "G4" and "P" not in values:
        raise GcodeError(28)
    if values.get("F", 1.0) <= 0.0:
        raise GcodeError(22)
    return Block(
        motion=codes.get("motion"),
        distance=codes.get("distance"),
        dwell_s=values["P"] if codes.get("once") == "G4" else None,
        feed=values.get("F"),
        machine_coordinates=codes.get("once") == "G53",
        targets={letter: values[letter] for letter in axes if letter in values},
    )


def _take_code(code: str, codes: dict[str, str]) -> None:
    if code in _WITHOUT_EFFECT:
        return
    if code not in _GROUPS:
        raise GcodeError(20)
    if _GROUPS[code] in codes:
        raise GcodeError(21)
    codes[_GROUPS[code]] = code


def _number(digits: str) -> float:
    try:
        return float(digits)
    except ValueError:
        raise GcodeError(2) from None
