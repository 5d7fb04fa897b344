"""Build requests and parse replies of Standa's XIMC protocol: four letters, little-endian data, CRC-16. Sends nothing.

A request is the four letters of the command, its data and the CRC of the data; the reply begins with the same letters.
The reply to a setting is its letters alone. There are no message ids: two replies to the same query look alike.

Source: Standa, "8SMC5-USB User Manual", chapter on the communication protocol,
https://doc.xisupport.com/en/8smc5-usb/.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import ClassVar

from drivers.errors import DeviceRefused, ReplyGarbled

SYNCHRONISE = bytes(64)
"""Zeros complete the command that the controller is waiting for; it answers each further zero by a zero."""

RUNNING = 0x80  # MVCMD_RUNNING of the command state
FAILED = 0x40  # MVCMD_ERROR
COMMAND_NAMES = {1: "move", 2: "movr", 3: "left", 4: "rigt", 5: "stop", 6: "home", 7: "loft", 8: "sstp"}
_COMMAND = 0x3F  # MVCMD_NAME_BITS
IS_HOMED = 0x20  # STATE_IS_HOMED

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
"""Meanings of the flags of ``gets`` with which this driver moves no axis."""

BORDERS_COUNTED = 0x01
"""Flag of borders at positions of the counter; without it they are limit switches."""
BORDERS_STOP = 0x06
"""Flags of borders at which the controller stops."""

REFUSALS = {
    b"errc": "unknown command",
    b"errv": "a value is out of range and was corrected",
}
_DAMAGED = b"errd"
ENGINE_REVERSED = 0x01  # ENGINE_REVERSE
ENGINE_AT_FULL_SPEED = 0x04
"""Flag of moves at the highest speed of the motor, whatever speed is set."""
ENGINE_ANTIPLAY = 0x08
"""Flag of the compensation of backlash, which overruns the target."""
ENGINE_RAMPS = 0x10  # ENGINE_ACCEL_ON
ENGINE_LIMITS_SPEED = 0x80  # ENGINE_LIMIT_RPM

SYNC_IN_MOVES = 0x01
"""Flag of a synchronisation input that moves the axis."""

POWER_OFF = 0x02
"""Flag of a motor that is switched off some time after a move."""
ENGINE_TYPE_LAYOUT = struct.Struct("<BB6x")
STEPPER = 3
"""Engine type of ``gent``. With other motors, positions are encoder counts and speeds revolutions per minute."""
FEEDBACK_LAYOUT = struct.Struct("<HBBI4x")
BY_ENCODER = frozenset({0x01, 0x06})
"""Feedback types of ``gfbs`` (its second field) with which the positions of a stepper are encoder counts too."""
INFORMATION_LAYOUT = struct.Struct("<4s2s8sBBH12x")
VERSION_LAYOUT = struct.Struct("<BBH")
SERIAL_LAYOUT = struct.Struct("<I")
_MOVE_LAYOUT = struct.Struct("<ih6s")
_RESERVED = b"\xcc" * 6
"""The bytes that the maker's own library sends there."""


def _remainder(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (0xA001 if byte & 1 else 0)
    return byte


_REMAINDERS = [_remainder(byte) for byte in range(256)]


def crc16(data: bytes) -> int:
    """Return the CRC of the data of a message, a CRC-16/MODBUS: polynomial 0xA001 (reflected), start value 0xFFFF.

    >>> f"{crc16(b'123456789'):04X}"
    '4B37'
    """
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _REMAINDERS[(crc ^ byte) & 0xFF]
    return crc


def request(command: str, data: bytes = b"") -> bytes:
    """Return the bytes of a request; data are empty for a command without data.

    >>> request("gets")
    b'gets'
    """
    return command.encode("ascii") + (data + struct.pack("<H", crc16(data)) if data else b"")


def check_head(command: str, head: bytes, where: str) -> None:
    """Check that a reply, by its first four bytes, begins with the letters of its command."""
    if head == command.encode("ascii"):
        return
    if head in REFUSALS:
        raise DeviceRefused(
            f"the controller refuses {command}: {REFUSALS[head]} ({head.decode()}).",
            where=where,
            remedy="Check the values in the station file, and the controller's firmware.",
        )
    if head == _DAMAGED:
        what = f"the controller received {command} with a wrong CRC (errd) and did nothing."
    else:
        what = f"the answer to {command} begins with {head!r}."
    raise ReplyGarbled(what, where=where, remedy="Check the cable.")


def check_data(command: str, data: bytes, where: str) -> bytes:
    """Check the CRC of a reply's data, and return them without it."""
    body, given = data[:-2], data[-2:]
    if struct.pack("<H", crc16(body)) != given:
        raise ReplyGarbled(f"wrong CRC in the answer to {command}.", where=where, remedy="Check the cable.")
    return body


@dataclass(frozen=True)
class Status:
    """The data of ``gets``: the state of the axis at one moment."""

    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<xB3xihq16xI9x")

    command_state: int  # Latest motion command, and whether it runs or has failed
    steps: int  # Position, in full steps
    microsteps: int  # Microsteps of the position beyond the full steps
    encoder: int  # Position, in encoder counts
    flags: int  # State flags; see ``IS_HOMED`` and ``STATE_FLAGS``

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
        """Name of the latest motion command, whoever gave it."""
        return COMMAND_NAMES.get(self.command_state & _COMMAND, "unknown")

    @property
    def homed(self) -> bool:
        """Whether the counter has a reference."""
        return bool(self.flags & IS_HOMED)

    @property
    def faults(self) -> list[str]:
        """Meanings of the flags with which the axis must not be moved."""
        return [words for flag, words in STATE_FLAGS.items() if self.flags & flag]


class Settings:
    """Settings that are read and written as a whole: a frozen dataclass of all fields of their layout."""

    LAYOUT: ClassVar[struct.Struct]
    READ: ClassVar[str]
    WRITE: ClassVar[str]
    """Commands that ask for them, and that set them."""

    def pack(self) -> bytes:
        """Pack the data of a request, without CRC."""
        return self.LAYOUT.pack(*vars(self).values())


@dataclass(frozen=True)
class MoveSettings(Settings):
    """The data of ``gmov`` and ``smov``."""

    LAYOUT = struct.Struct("<IBHHIBB9s")
    READ, WRITE = "gmov", "smov"

    speed: int  # In full steps per second
    speed_microsteps: int  # Microsteps per second beyond the full steps
    acceleration: int  # In full steps per second squared
    deceleration: int  # In full steps per second squared
    antiplay_speed: int  # Speed of the backlash compensation, in full steps per second
    antiplay_microsteps: int  # Microsteps per second of it, beyond the full steps
    flags: int
    reserved: bytes


@dataclass(frozen=True)
class EdgeSettings(Settings):
    """The data of ``geds`` and ``seds``: the borders at which the controller itself stops."""

    LAYOUT = struct.Struct("<BBihih6s")
    READ, WRITE = "geds", "seds"

    border_flags: int
    switch_flags: int
    left_steps: int  # Left border, in full steps
    left_microsteps: int  # Microsteps of the left border beyond the full steps
    right_steps: int  # Right border, in full steps
    right_microsteps: int  # Microsteps of the right border beyond the full steps
    reserved: bytes


@dataclass(frozen=True)
class EngineSettings(Settings):
    """The data of ``geng`` and ``seng``: the motor, and how it is driven."""

    LAYOUT = struct.Struct("<HHIBHhBH12s")
    READ, WRITE = "geng", "seng"

    voltage: int
    current: int
    speed: int  # Highest speed, if a flag limits it, in full steps per second
    speed_microsteps: int  # Microsteps per second of it, beyond the full steps
    flags: int
    antiplay: int  # Overrun of the compensation of backlash, in full steps
    microstep_mode: int  # Mode n means 2^(n-1) microsteps per full step
    steps_per_turn: int
    reserved: bytes


@dataclass(frozen=True)
class HomeSettings(Settings):
    """The data of ``ghom`` and ``shom``: the search of the reference."""

    LAYOUT = struct.Struct("<IBIBihH9s")
    READ, WRITE = "ghom", "shom"

    fast: int  # Fast speed, in full steps per second
    fast_microsteps: int  # Microsteps per second of it, beyond the full steps
    slow: int  # Slow speed, in full steps per second
    slow_microsteps: int  # Microsteps per second of it, beyond the full steps
    offset: int  # Way from the sensor to the end of the search, in full steps
    offset_microsteps: int  # Microsteps of it, beyond the full steps
    flags: int
    reserved: bytes


@dataclass(frozen=True)
class SyncInSettings(Settings):
    """The data of ``gsni`` and ``ssni``: what a pulse at the synchronisation input moves."""

    LAYOUT = struct.Struct("<BHihIB8s")
    READ, WRITE = "gsni", "ssni"

    flags: int
    clutter_us: int
    position: int
    position_microsteps: int
    speed: int
    speed_microsteps: int
    reserved: bytes


@dataclass(frozen=True)
class PowerSettings(Settings):
    """The data of ``gpwr`` and ``spwr``: the current of the motor at rest."""

    LAYOUT = struct.Struct("<BHHHB6s")
    READ, WRITE = "gpwr", "spwr"

    hold_percent: int
    reduce_after_ms: int
    off_after_s: int
    ramp_ms: int
    flags: int
    reserved: bytes


def move_data(steps: int, microsteps: int) -> bytes:
    """Return the data of ``move``, without CRC; the microsteps beyond the full steps have the same sign."""
    return _MOVE_LAYOUT.pack(steps, microsteps, _RESERVED)
