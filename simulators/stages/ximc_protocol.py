"""Wire format of the XIMC protocol: commands, layouts of settings, CRC, and positions in steps and 1/256 steps.

Source: Standa's published definition of the XIMC communication protocol.
"""

from __future__ import annotations

import struct
from typing import Final

#: Microsteps per step; positions use them in each mode of the motor.
MICROSTEPS: Final = 256

#: Number of each command in the status field "last command" (MvCmdSts).
COMMAND_NUMBERS: Final = {
    "move": 1,
    "movr": 2,
    "left": 3,
    "rigt": 4,
    "stop": 5,
    "home": 6,
    "loft": 7,
    "sstp": 8,
}

#: Layouts of settings, by the letters that follow g (get) or s (set); padding bytes are reserved.
LAYOUTS: Final = {
    "mov": (struct.Struct("<IBHHIBB9x"), 24),
    "eng": (struct.Struct("<HHIBHhBH12x"), 28),
    "ent": (struct.Struct("<BB6x"), 8),
    "eds": (struct.Struct("<BBihih6x"), 20),
    "hom": (struct.Struct("<IBIBihH9x"), 27),
    "fbs": (struct.Struct("<HBBI4x"), 12),
}


class ErrorReply(Exception):
    """An error answer.

    letters: ``errc`` (unknown command), ``errd`` (wrong CRC) or ``errv`` (wrong value).
    """

    def __init__(self, letters: bytes) -> None:
        self.letters = letters
        super().__init__(letters.decode())


def crc16(data: bytes) -> int:
    """Return the cyclic redundancy check with polynomial 0xA001 (reflected) and start value 0xFFFF.

    data: Data of a command or an answer, without the four letters.
    Returns: The CRC, 16 bit.

    Examples
    --------
    >>> hex(crc16(b"123456789"))
    '0x4b37'
    """
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
    return crc


def data_length(letters: bytes) -> int:
    """Return the number of bytes after the letters of a command.

    Returns: Length of the data, CRC included; 0 for a command without data.
    """
    name = letters.decode("latin-1")
    if name in {"move", "movr"}:
        return 14
    if name == "spos":
        return 22
    if name[0] == "s" and name[1:] in LAYOUTS:
        return LAYOUTS[name[1:]][1] + 2
    return 0


def to_counts(steps: int, fraction: int) -> int:
    """Combine whole steps and 1/256 steps.

    steps, fraction: Whole steps and 1/256 steps, with the same sign.
    Returns: Position, 1/256 steps.
    """
    return steps * MICROSTEPS + fraction


def to_steps(counts: int) -> tuple[int, int]:
    """Split a position into whole steps and 1/256 steps, both with the same sign.

    counts: Position, 1/256 steps.
    Returns: Whole steps and 1/256 steps.

    Examples
    --------
    >>> to_steps(-257)
    (-1, -1)
    """
    sign = -1 if counts < 0 else 1
    whole, fraction = divmod(abs(counts), MICROSTEPS)
    return sign * whole, sign * fraction
