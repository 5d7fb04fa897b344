"""Pack and unpack the messages of Thorlabs' APT protocol, and know the families of its controllers.

A message has a header of six bytes and little-endian data. A short one is its id, two parameters, the destination and
the source. A long one has the length of its data in place of the parameters, and the top bit of its destination set.
There is no checksum and no number of a request: a reply is recognised by its id, its addresses, its length and its
channel. Moves and settings have no reply.

Source: Thorlabs, "APT Controllers Host-Controller Communications Protocol", issue 25 and later.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import Final, Self

from drivers.errors import DeviceRefused, ReplyGarbled

HOST: Final = 0x01  # Address of the computer
UNIT: Final = 0x50  # Address of a controller with its own USB port
_RACKS: Final = frozenset({0x11, *range(0x21, 0x2B)})
"""Addresses of a controller with bays, and of its bays."""
NO_BAYS: Final = "BSC20x and BBD20x, such as those of an HDR50, do not work: use a controller of one axis."
CHANNEL: Final = 1  # Controllers of one axis have this one alone
HEAD_SIZE: Final = 6  # Bytes of a message without data
_LONG: Final = 0x80  # Bit of the destination: data follow the head
_LONGEST_DATA: Final = 255  # Bytes, as the protocol has them

# Ids of messages, as the APT protocol has them.
STOP_UPDATES: Final = 0x0012
REQUEST_INFORMATION: Final = 0x0005
SET_ENABLED: Final = 0x0210
REQUEST_ENABLED: Final = 0x0211
REQUEST_POSITION: Final = 0x0411
SET_SPEED: Final = 0x0413
REQUEST_SPEED: Final = 0x0414
REQUEST_STATUS: Final = 0x0429
SET_BACKLASH: Final = 0x043A
REQUEST_BACKLASH: Final = 0x043B
SET_HOME: Final = 0x0440
REQUEST_HOME: Final = 0x0441
HOME: Final = 0x0443
HOMED: Final = 0x0444
MOVE_TO: Final = 0x0453
STOP: Final = 0x0465
STILL_THERE: Final = 0x0492
"""A sign of life of the computer. Some controllers stop their updates after about 50 without it."""

FAULT: Final = 0x0080  # HW_RESPONSE, and HW_RICHRESPONSE
REFUSED: Final = 0x0081
UNASKED: Final = frozenset({FAULT, REFUSED, HOMED, 0x0464, 0x0466, 0x0481, 0x0491})
"""Ids of what a controller sends without a request of this driver: errors, ends of motions, updates."""
ON: Final = 1  # CHANENABLESTATE
STOP_BY_RAMP: Final = 2  # 1 would be at once

INFORMATION_LAYOUT: Final = struct.Struct("<I8sH4B60sHHH")
POSITION_LAYOUT: Final = struct.Struct("<Hi")
STATUS_LAYOUT: Final = struct.Struct("<HI")
SPEED_LAYOUT: Final = struct.Struct("<Hiii")
HOME_LAYOUT: Final = struct.Struct("<HHHii")
REFUSED_LAYOUT: Final = struct.Struct("<HH64s")

# Bits of the status.
_MOVING: Final = 0x0000_00F0
CONNECTED: Final = 0x0000_0100  # A motor is recognised
_HOMING: Final = 0x0000_0200
_HOMED: Final = 0x0000_0400
LIMITS: Final = {
    0x0000_0001: "forward limit switch",
    0x0000_0002: "reverse limit switch",
    0x0000_0004: "forward limit of the controller",
    0x0000_0008: "reverse limit of the controller",
}
FAULTS: Final = {
    0x0000_4000: "the motor does not follow (position error)",
    0x0000_8000: "the controller reports a fault of itself",
    0x0002_0000: "too hot",
    0x0004_0000: "supply voltage fault",
    0x0008_0000: "the motor lost its commutation",
    0x0100_0000: "the motor is overloaded",
    0x0200_0000: "encoder fault",
    0x0400_0000: "too much current",
    0x0800_0000: "supply current fault",
    0x4000_0000: "the controller reports an error",
}
"""Meanings of the status bits with which this driver moves no axis."""
_USED: Final = _MOVING | CONNECTED | _HOMING | _HOMED | sum(LIMITS) | sum(FAULTS)
_STEPPER: Final = (53.68, 53.68 * 204.94e-6)  # Units of the protocol for a count/s, and for a count/s^2

FORWARD: Final = 1  # Directions of a homing
REVERSE: Final = 2
SWITCHES: Final = {FORWARD: 4, REVERSE: 1}
"""Limit switch of a search of the reference, by its direction."""
_SAME_SPEED: Final = 0.01
"""Largest relative difference of two equal speeds or ramps: a controller may round them to its own steps."""


@dataclass(frozen=True)
class Family:
    """What differs between families of controllers."""

    speed_factor: float  # Units of speed for one count per second
    acceleration_factor: float  # Units of acceleration for one count per second squared
    sign_of_life: bool  # Whether the controller needs signs of life
    # Scale of a stage with a built-in controller; 0 where the stage is a separate one.
    counts_per_deg: float = 0.0


def _by_sample_time(sample_s: float) -> Family:
    return Family(65536.0 * sample_s, 65536.0 * sample_s**2, sign_of_life=True)


FAMILIES: Final = {
    "K10CR1": Family(*_STEPPER, sign_of_life=False, counts_per_deg=409_600 / 3),
    "K10CR2": Family(*_STEPPER, sign_of_life=False),
    "KST": Family(*_STEPPER, sign_of_life=False),
    "TST101": Family(*_STEPPER, sign_of_life=False),
    "KDC101": _by_sample_time(2048 / 6e6),
    "TDC001": _by_sample_time(2048 / 6e6),
    "KBD101": _by_sample_time(102.4e-6),
    "TBD001": _by_sample_time(102.4e-6),
}
"""Families by the beginning of the model's name, as the controller reports it."""


def same_speed(wanted: int, present: int) -> bool:
    """Whether a speed or a ramp was kept, but for the controller's rounding.

    >>> same_speed(15_021, 15_000), same_speed(146, 145), same_speed(15_021, 0)
    (True, True, False)
    """
    return abs(wanted - present) <= max(1.0, _SAME_SPEED * wanted)


@dataclass(frozen=True)
class HomeParameters:
    """How a controller searches its reference, and how far from its switch it sets the counter to 0."""

    direction: int  # ``FORWARD`` or ``REVERSE``, by the counter
    switch: int  # Limit switch, one of ``SWITCHES``
    speed: int  # In the controller's units
    offset: int  # From the switch to the zero, in counts

    def agrees(self, home_parameters: HomeParameters | None) -> bool:
        """Whether a controller has kept them."""
        return (
            home_parameters is not None
            and replace(self, speed=home_parameters.speed) == home_parameters
            and same_speed(self.speed, home_parameters.speed)
        )


@dataclass(frozen=True)
class Information:
    """What a controller says of itself."""

    serial: str
    model: str
    firmware: str

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Unpack the 84 bytes of a reply's data."""
        serial, model, _, minor, interim, major, *_ = INFORMATION_LAYOUT.unpack(data)
        name = model.split(b"\0")[0].decode("ascii", errors="replace").strip()
        return cls(str(serial), name, f"{major}.{interim}.{minor}")


@dataclass(frozen=True)
class Status:
    """The status bits that this driver uses."""

    bits: int

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Unpack the 6 bytes of a reply's data."""
        return cls(STATUS_LAYOUT.unpack(data)[1] & _USED)

    @property
    def moving(self) -> bool:
        """Whether the axis moves, for any reason."""
        return bool(self.bits & (_MOVING | _HOMING))

    @property
    def homing(self) -> bool:
        """Whether it searches its reference."""
        return bool(self.bits & _HOMING)

    @property
    def homed(self) -> bool:
        """Whether it has a reference."""
        return bool(self.bits & _HOMED)

    @property
    def limits(self) -> list[str]:
        """Limits at which it stands."""
        return [words for bit, words in LIMITS.items() if self.bits & bit]

    @property
    def faults(self) -> list[str]:
        """Faults, in words."""
        return [words for bit, words in FAULTS.items() if self.bits & bit]


def short(message: int, first: int = 0, second: int = 0) -> bytes:
    """Return a short message.

    >>> short(HOME, CHANNEL).hex(" ")
    '43 04 01 00 50 01'
    """
    return struct.pack("<HBBBB", message, first, second, UNIT, HOST)


def long(message: int, data: bytes) -> bytes:
    """Return a message with data.

    >>> long(MOVE_TO, POSITION_LAYOUT.pack(CHANNEL, -2)).hex(" ")
    '53 04 06 00 d0 01 01 00 fe ff ff ff'
    """
    return struct.pack("<HHBB", message, len(data), UNIT | _LONG, HOST) + data


def size(head: bytes, where: str) -> int:
    """Return the size, bytes, of the message with these first six bytes; else raise `ReplyGarbled`."""
    message, length, destination, source = struct.unpack("<HHBB", head)
    if message == REQUEST_INFORMATION + 1 and source in _RACKS and destination & ~_LONG in {0, HOST}:
        # One changed byte makes this of a known controller's answer, so it is no refusal: it is asked again.
        raise ReplyGarbled(
            f"a controller with bays answers (address {source:#x}), which this driver does not know.",
            where=where,
            remedy=NO_BAYS,
        )
    if destination & ~_LONG not in {0, HOST} or source != UNIT:
        raise _garbled(f"{head.hex(' ')} came, which is not from a controller to this computer.", where)
    if not destination & _LONG:
        return HEAD_SIZE
    if length > _LONGEST_DATA:
        raise _garbled(f"a message of {length} bytes was announced ({head.hex(' ')}).", where)
    return HEAD_SIZE + int(length)


def data_of(message: bytes, wanted: int, layout: struct.Struct, where: str) -> bytes:
    """Check that a message answers the request ``wanted`` (its id is the next number), and return its data."""
    data = message[HEAD_SIZE:]
    if struct.unpack_from("<H", message)[0] != wanted + 1 or len(data) != layout.size:
        raise _garbled(f"{message[:20].hex(' ')} came, which is no answer to request {wanted:#06x}.", where)
    if wanted != REQUEST_INFORMATION and struct.unpack_from("<H", data)[0] != CHANNEL:
        raise _garbled(f"a reply for another channel came: {message.hex(' ')}.", where)
    return data


def parameter_of(message: bytes, wanted: int, where: str) -> int:
    """Check a short message as `data_of` does, and return its second parameter."""
    number, channel, value, destination, _ = struct.unpack_from("<HBBBB", message)
    if number != wanted + 1 or destination & _LONG or channel != CHANNEL:
        raise _garbled(f"{message[:20].hex(' ')} came, which is no answer to request {wanted:#06x}.", where)
    return int(value)


def family_of(model: str, where: str) -> Family:
    """Return the family of a model; refuse a model whose units this driver does not know."""
    for beginning, family in FAMILIES.items():
        if model.upper().startswith(beginning):
            return family
    raise DeviceRefused(
        f"the controller is a {model!r}, whose units of speed this driver does not know.",
        where=where,
        remedy=f"Use one of: {', '.join(FAMILIES)}.",
    )


def _garbled(what: str, where: str) -> ReplyGarbled:
    return ReplyGarbled(
        what, where=where, remedy="Check that the port is that of the Thorlabs controller, and its cable."
    )
