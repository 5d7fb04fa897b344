"""Build instructions and parse status packets of Robotis' Dynamixel Protocol 2.0, for X series servos. Sends nothing.

    FF FF FD 00  id  length (2)  instruction or 55  (error, in a status packet)  parameters  CRC (2)

The CRC-16 has the polynomial 0x8005 and begins with 0. Where FF FF FD stands between length and CRC, a further FD
follows. There is no number of a packet: two status packets of a servo to the same instruction look alike.

Sources: Robotis e-Manual, "DYNAMIXEL Protocol 2.0" and the control tables of XL430-W250 and XM430-W350,
https://emanual.robotis.com.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final, Self

from drivers.errors import DeviceRefused, ReplyGarbled

HEADER: Final = b"\xff\xff\xfd\x00"
HEAD_SIZE: Final = 7
_LONGEST: Final = 250
_STUFFED, _PLAIN = b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"

PING: Final = 0x01
READ: Final = 0x02
WRITE: Final = 0x03
REBOOT: Final = 0x08
STATUS: Final = 0x55

COUNTS_A_TURN: Final = 4096
SPEED_UNIT_RPM: Final = 0.229
RAMP_UNIT_REV_MIN2: Final = 214.577
EXTENDED_POSITION: Final = 4
LARGEST_GOAL: Final = 1_048_575
LARGEST_RAMP: Final = 32_767
TICK_PERIOD_MS: Final = 32_768
TIME_BASED_OR_TORQUE_BY_GOAL: Final = 0x0C
"""Bits of the drive mode: the profile counts times instead of speeds; a goal switches the torque on."""

DRIVE_MODE: Final = 10
OPERATING_MODE: Final = 11
TORQUE: Final = 64
PROFILE: Final = 108
GOAL: Final = 116
SETTINGS_SIZE: Final = 64
STATE_FIRST: Final = 64
STATE_SIZE: Final = 83

MODELS: Final = {
    1000: "XH430-W350",
    1010: "XH430-W210",
    1020: "XM430-W350",
    1030: "XM430-W210",
    1060: "XL430-W250",
    1070: "XC430-W150",
    1080: "XC430-W240",
    1090: "2XL430-W250",
    1100: "XH540-W270",
    1110: "XH540-W150",
    1120: "XM540-W270",
    1130: "XM540-W150",
    1160: "2XC430-W250",
    1190: "XL330-M077",
    1200: "XL330-M288",
}
"""Names of X series models with this control table, by model number."""

_REFUSALS: Final = {
    1: "it could not carry the instruction out",
    2: "it does not know the instruction",
    4: "a value is out of range",
    5: "the data have the wrong length",
    6: "a value is beyond a limit that is set in the servo",
    7: "the value cannot be written now: it is read-only, or the torque is on",
}
_DAMAGED: Final = 3
_CODE: Final = 0x7F

HARDWARE_ERRORS: Final = {
    0x01: "supply voltage out of range",
    0x04: "too hot",
    0x08: "encoder fault",
    0x10: "an electric shock in the circuit, or too little power for the motor",
    0x20: "overload: the motor was blocked, or its load is too heavy",
}
"""Meanings of the bits of the hardware error status."""


def _remainder(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = (value << 1 ^ 0x8005) if value & 0x8000 else value << 1
    return value & 0xFFFF


_TABLE: Final = tuple(_remainder(byte) for byte in range(256))


def crc16(data: bytes) -> int:
    """Return the CRC of a packet without its last two bytes.

    Examples
    --------
    >>> hex(crc16(bytes.fromhex("ff ff fd 00 01 03 00 01")))
    '0x4e19'
    """
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _TABLE[crc >> 8 ^ byte]
    return crc


def packet(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return an instruction packet.

    Examples
    --------
    >>> packet(1, PING).hex(" ")
    'ff ff fd 00 01 03 00 01 19 4e'
    """
    body = (bytes([instruction]) + parameters).replace(_PLAIN, _STUFFED)
    head = HEADER + struct.pack("<BH", servo, len(body) + 2)
    return head + body + struct.pack("<H", crc16(head + body))


@dataclass(frozen=True)
class Packet:
    """A packet whose CRC is right."""

    servo: int
    instruction: int  # Number of the instruction; `STATUS` of a status packet
    content: bytes  # What follows, without stuffing


def size(head: bytes) -> int:
    """Return the size of the packet that begins with a header.

    head: The first seven bytes, header included.
    Returns: Size in bytes; 0 when no servo sends such a packet.
    """
    length: int = struct.unpack_from("<H", head, 5)[0]
    return HEAD_SIZE + length if 3 <= length <= _LONGEST else 0


def parse(data: bytes, where: str) -> Packet:
    """Check a packet."""
    if crc16(data[:-2]) != struct.unpack_from("<H", data, len(data) - 2)[0]:
        raise garbled(f"a packet with a wrong CRC came: {data[:40].hex(' ')}.", where)
    body = data[HEAD_SIZE:-2].replace(_STUFFED, _PLAIN)
    return Packet(data[4], body[0], body[1:])


def data_of(status: Packet, count: int, where: str) -> bytes:
    """Check a status packet, and return its parameters."""
    if not status.content:
        raise garbled(f"servo {status.servo} sent a status packet without an error field.", where)
    code = status.content[0] & _CODE
    if code == _DAMAGED:
        raise garbled(f"servo {status.servo} received a damaged instruction.", where)
    if code:
        raise DeviceRefused(
            f"servo {status.servo} refuses: {_REFUSALS.get(code, f'error {code}')}.",
            where=where,
            remedy="Compare the station file with the servo's settings (DYNAMIXEL Wizard).",
        )
    if len(status.content) != count + 1:
        raise garbled(f"servo {status.servo} sent {len(status.content) - 1} bytes instead of {count}.", where)
    return status.content[1:]


@dataclass(frozen=True)
class Settings:
    """The settings that outlast a loss of power, as far as this driver uses them."""

    model: int
    firmware: int
    drive_mode: int
    operating_mode: int
    most_speed: int  # Largest speed, in units of `SPEED_UNIT_RPM`

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Unpack the first `SETTINGS_SIZE` bytes of the control table."""
        model, firmware, drive_mode, mode, speed = struct.unpack("<H4xB3xBB32xI16x", data)
        return cls(model, firmware, drive_mode, mode, speed)


@dataclass(frozen=True)
class State:
    """What a servo does at one moment: one reading of the second part of its control table."""

    torque: bool  # Whether the torque is on
    errors: int
    ramp: int
    speed: int
    # goal, position: In counts.
    goal: int
    moving: bool  # Whether the servo moves, or carries a profile out
    velocity: int  # Present velocity, in units of `SPEED_UNIT_RPM`
    position: int
    tick_ms: int  # The servo's own time, ms; it begins anew after `TICK_PERIOD_MS` and after a restart

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Unpack `STATE_SIZE` bytes of the control table from `STATE_FIRST` on."""
        torque, errors, ramp, speed, goal, tick_ms, moving, profile, velocity, position = struct.unpack(
            "<B5xB37xIIiHBB4xii11x", data
        )
        return cls(
            torque == 1,
            errors,
            ramp,
            speed,
            goal,
            bool(moving) or bool(profile & 2),
            velocity,
            position,
            tick_ms,
        )

    @property
    def faults(self) -> list[str]:
        """Hardware errors, in words."""
        return [words for bit, words in HARDWARE_ERRORS.items() if self.errors & bit] or (
            [f"hardware error {self.errors:#04x}"] if self.errors else []
        )


def garbled(what: str, where: str) -> ReplyGarbled:
    """Return the error of a packet that cannot be used."""
    return ReplyGarbled(
        what, where=where, remedy="Check the cable, the baud rate, and that no two servos have the same id."
    )
