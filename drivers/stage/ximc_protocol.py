"""Knows the words of Standa's XIMC protocol: commands of four letters, little-endian data, CRC-16. Sends nothing.

A request is the four letters, its data and the CRC of the data; the reply repeats the letters. A setting
command is answered by its letters alone. No ids: two replies to the same question cannot be told apart.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import ClassVar, Self

from drivers.errors import DeviceRefused, ReplyGarbled

SYNCHRONISE = bytes(64)
"""Zeros fill up whatever command the controller is in the middle of; each further one it answers by a zero."""

RUNNING = 0x80
FAILED = 0x40
COMMAND_NAMES = {1: "move", 2: "movr", 3: "left", 4: "rigt", 5: "stop", 6: "home", 7: "loft", 8: "sstp"}
_COMMAND = 0x3F
IS_HOMED = 0x20

STATE_FLAGS = {
    0x0000_0040: "alarm",
    0x0000_0080: "the counter and the encoder differ",
    0x0000_0100: "motor driver too hot",
    0x0000_0200: "controller too hot",
    0x0000_0400: "supply voltage too high",
    0x0000_0800: "supply current too high",
    0x0000_1000: "USB voltage too high",
    0x0000_2000: "USB voltage too low",
    0x0000_4000: "USB current too high",
    0x0000_8000: "stuck at the wrong limit",
    0x0001_0000: "supply voltage too low",
    0x0002_0000: "motor driver fault",
    0x0010_0000: "windings differ",
    0x0020_0000: "encoder fault",
    0x0080_0000: "motor control failed",
    0x0100_0000: "external alarm input",
}
"""Flags of ``gets`` with which an axis is not moved, in plain words."""

BORDERS_COUNTED = 0x01
"""Borders lie at counts; otherwise at limit switches."""
BORDERS_STOP = 0x06

REFUSALS = {
    b"errc": "it does not know this command",
    b"errv": "a value is out of its range, and was corrected",
}
_DAMAGED = b"errd"


def _remainder(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (0xA001 if byte & 1 else 0)
    return byte


_REMAINDERS = [_remainder(byte) for byte in range(256)]


def crc16(data: bytes) -> int:
    """Return the CRC of a message's data: polynomial 0xA001 (reflected), start 0xFFFF.

    >>> f"{crc16(b'123456789'):04X}"
    '4B37'
    """
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _REMAINDERS[(crc ^ byte) & 0xFF]
    return crc


def request(command: str, data: bytes = b"") -> bytes:
    """Return a request's bytes.

    >>> request("gets")
    b'gets'
    """
    return command.encode("ascii") + (data + struct.pack("<H", crc16(data)) if data else b"")


def check_head(command: str, head: bytes, where: str) -> None:
    """See that a reply's four letters are the command's.

    Raises DeviceRefused when the controller refuses it, ReplyGarbled for anything else.
    """
    if head == command.encode("ascii"):
        return
    if head in REFUSALS:
        raise DeviceRefused(
            f"the controller refuses {command}: {REFUSALS[head]} ({head.decode()}).",
            where=where,
            remedy="Check the values in the station file, and the controller's firmware.",
        )
    if head == _DAMAGED:
        what = f"the controller got {command} damaged (errd), and did nothing."
    else:
        what = f"the answer to {command} begins with {head!r}."
    raise ReplyGarbled(what, where=where, remedy="Check the cable.")


def check_data(command: str, data: bytes, where: str) -> bytes:
    """Return a reply's data without its CRC. Raises ReplyGarbled when the CRC is wrong."""
    body, given = data[:-2], data[-2:]
    if struct.pack("<H", crc16(body)) != given:
        raise ReplyGarbled(f"wrong CRC in the answer to {command}.", where=where, remedy="Check the cable.")
    return body


@dataclass(frozen=True)
class Status:
    """The answer to ``gets``: everything about the axis at one moment."""

    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<5Bihqih5hIIB4x")

    command_state: int
    encoder_state: int
    steps: int
    microsteps: int
    encoder: int
    flags: int

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Take the data of ``gets`` apart."""
        fields = cls.LAYOUT.unpack(data)
        return cls(fields[1], fields[3], fields[5], fields[6], fields[7], fields[15])

    @property
    def running(self) -> bool:
        """Whether a motion command is being carried out."""
        return bool(self.command_state & RUNNING)

    @property
    def failed(self) -> bool:
        """Whether the last motion command ended with an error."""
        return not self.running and bool(self.command_state & FAILED)

    @property
    def command(self) -> str:
        """Name of the latest motion command, by whomever."""
        return COMMAND_NAMES.get(self.command_state & _COMMAND, "unknown")

    @property
    def homed(self) -> bool:
        """Whether the counter has a reference."""
        return bool(self.flags & IS_HOMED)

    @property
    def troubles(self) -> list[str]:
        """What speaks against moving, in plain words."""
        return [words for flag, words in STATE_FLAGS.items() if self.flags & flag]


@dataclass(frozen=True)
class MoveSettings:
    """The data of ``gmov`` and ``smov``: speeds in steps/s and microsteps/s, accelerations in steps/s^2."""

    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IBHHIBB9s")

    speed: int
    speed_microsteps: int
    acceleration: int
    deceleration: int
    antiplay_speed: int
    antiplay_microsteps: int
    flags: int
    reserved: bytes

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Take the data apart."""
        return cls(*cls.LAYOUT.unpack(data))

    def pack(self) -> bytes:
        """Put the data together."""
        return self.LAYOUT.pack(*vars(self).values())


@dataclass(frozen=True)
class EdgeSettings:
    """The data of ``geds`` and ``seds``: where the controller itself stops."""

    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BBihih6s")

    border_flags: int
    switch_flags: int
    left_steps: int
    left_microsteps: int
    right_steps: int
    right_microsteps: int
    reserved: bytes

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Take the data apart."""
        return cls(*cls.LAYOUT.unpack(data))

    def pack(self) -> bytes:
        """Put the data together."""
        return self.LAYOUT.pack(*vars(self).values())


ENGINE_LAYOUT = struct.Struct("<HHIBHhBH12x")
MICROSTEP_MODE = 6
"""Place of the step division mode in the data of ``geng``: n means 1/2^(n-1) step."""
ENGINE_TYPE_LAYOUT = struct.Struct("<BB6x")
STEPPER = 3
"""Engine type of ``gent``; of other motors, positions are encoder counts and speeds revolutions a minute."""
FEEDBACK_LAYOUT = struct.Struct("<HBBI4x")
BY_ENCODER = frozenset({0x01, 0x06})
"""Feedback types of ``gfbs``, in its second place, with which a stepper's positions are encoder counts as well."""
INFORMATION_LAYOUT = struct.Struct("<4s2s8sBBH12x")
VERSION_LAYOUT = struct.Struct("<BBH")
SERIAL_LAYOUT = struct.Struct("<I")
_MOVE_LAYOUT = struct.Struct("<ih6s")
_RESERVED = b"\xcc" * 6
"""What the maker's own library puts there."""


def move_data(steps: int, microsteps: int) -> bytes:
    """Return the data of ``move``: where to, in full steps and microsteps of the same sign."""
    return _MOVE_LAYOUT.pack(steps, microsteps, _RESERVED)
