"""Talk to one Thorlabs controller by the APT protocol: messages, repeated queries, signs of life, confirmed stops.

A message has a header of six bytes and little-endian data. A short one is its id, two parameters, the destination and
the source. A long one has the length of its data in place of the parameters, and the top bit of its destination set.
There is no checksum and no number of a request: a reply is recognised by its id, its addresses, its length and its
channel. Moves and settings have no reply. Degrees belong to ``drivers.stage.thorlabs``.

Source: Thorlabs, "APT Controllers Host-Controller Communications Protocol", issue 25 and later.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Self, TypeVar

from drivers.agreed_reading import read_until_agreed
from drivers.clock import Clock
from drivers.errors import DeviceRefused, ReplyGarbled, ReplyTimeout
from drivers.link import TRIES, repeat
from drivers.serial_port import Port
from drivers.stage.line_per_axis import AxisController
from drivers.stage.refusals import read_back_otherwise
from drivers.wire_log import WireLog

HOST: Final = 0x01  # Address of the computer
UNIT: Final = 0x50  # Address of a controller with its own USB port
_RACKS: Final = frozenset({0x11, *range(0x21, 0x2B)})
"""Addresses of a controller with bays, and of its bays."""
_NO_BAYS: Final = "BSC20x and BBD20x, such as those of an HDR50, do not work: use a controller of one axis."
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
_REFUSED_LAYOUT: Final = struct.Struct("<HH64s")

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

_MARKER_S: Final = 0.45
_STOP_POLL_S: Final = 0.02
_POLLS_A_STOP: Final = 5
"""While the axis moves, the stop is sent again after so many readings: it may be lost, and has no reply."""

T = TypeVar("T")


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
        raise DeviceRefused(
            f"a controller with bays answers (address {source:#x}), which this driver does not know.",
            where=where,
            remedy=_NO_BAYS,
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


class ThorlabsController(AxisController):
    """The controller of one axis, on a line of messages. Opening asks for its identity; it sets nothing but silence.

    The protocol needs 115200 baud. ``homings`` is how many ends of a homing it has reported, ``reports`` what it has
    reported against the latest command, in words. An unknown model is refused.
    """

    SILENT_REMEDY = f"Check that the controller is switched on, and its port. {_NO_BAYS}"
    reply_s = 0.5

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self._sign_of_life = b""
        self.homings = 0
        self.reports: list[str] = []
        super().__init__(port, clock=clock, wire_log=wire_log)
        self.mark_out_of_step()
        self.family = family_of(self.read_information().model, self.name)
        if self.family.sign_of_life:
            self._sign_of_life = short(STILL_THERE)

    def take_line(self) -> bytes | None:
        """Take one unread message; None when no complete one is unread.

        What does not begin with a header raises `ReplyGarbled` and is thrown away.
        """
        unread = self.unread
        if len(unread) < HEAD_SIZE:
            return None
        try:
            return self.take(size(unread[:HEAD_SIZE], self.name))
        except ReplyGarbled:
            self.take(len(unread))
            raise

    def take_unsolicited(self, line: bytes) -> bool:
        """Take a message that answers no request; count the ends of homings, and keep what it reports."""
        message = struct.unpack_from("<H", line)[0]
        self.homings += message == HOMED
        if message == FAULT:
            self.reports.append("the controller reports a fault of itself (message 0x0080)")
        elif message == REFUSED and len(line) == HEAD_SIZE + _REFUSED_LAYOUT.size:
            request, code, notes = _REFUSED_LAYOUT.unpack(line[HEAD_SIZE:])
            words = notes.split(b"\0")[0].decode("ascii", errors="replace").strip()
            self.reports.append(
                f"the controller reports '{words or 'no reason'}' (code {code}, request {request:#06x})"
            )
        return message in UNASKED

    def read_information(self) -> Information:
        """Ask who it is, until two answers agree."""
        return self._read_twice(
            lambda: Information.unpack(self._query(REQUEST_INFORMATION, INFORMATION_LAYOUT)),
            "the identity",
        )

    def read_status(self) -> Status:
        """Ask for the status, until two answers agree: one changed bit could give an axis a reference."""
        return self._read_twice(
            lambda: Status.unpack(self._query(REQUEST_STATUS, STATUS_LAYOUT)), "the status"
        )

    def read_position(self) -> int:
        """Ask once for the position, counts; who needs it sure asks again."""
        return int(POSITION_LAYOUT.unpack(self._query(REQUEST_POSITION, POSITION_LAYOUT))[1])

    def read_speed(self) -> tuple[int, int]:
        """Ask for acceleration and speed, in the controller's units."""
        data = self._read_twice(lambda: self._query(REQUEST_SPEED, SPEED_LAYOUT), "the speed")
        _, _, acceleration, speed = SPEED_LAYOUT.unpack(data)
        return int(acceleration), int(speed)

    def set_speed(self, acceleration: int, speed: int) -> None:
        """Set acceleration and speed, in the controller's units, and read them back; twice does no harm."""
        self._set_until_right(
            long(SET_SPEED, SPEED_LAYOUT.pack(CHANNEL, 0, acceleration, speed)),
            self.read_speed,
            lambda present: same_speed(acceleration, present[0]) and same_speed(speed, present[1]),
            "acceleration and speed",
            (acceleration, speed),
        )

    def read_home(self) -> HomeParameters | None:
        """Ask for the parameters of a search of the reference; None if the controller does not tell them."""
        try:
            data = self._read_twice(lambda: self._query(REQUEST_HOME, HOME_LAYOUT), "the home parameters")
        except ReplyTimeout as error:
            self._require_alive(error)
            return None
        return HomeParameters(*HOME_LAYOUT.unpack(data)[1:])

    def set_home(self, wanted: HomeParameters) -> HomeParameters | None:
        """Set the parameters of a search of the reference; return what is read back, as `read_home`."""
        request = long(SET_HOME, HOME_LAYOUT.pack(CHANNEL, *vars(wanted).values()))
        if self.read_home() is None:
            self._command(request)
            return None
        self._set_until_right(request, self.read_home, wanted.agrees, "the home parameters", wanted)
        return self.read_home()

    def clear_backlash(self) -> None:
        """Switch a correction of backlash off, which overruns the target; a controller without one does not answer."""
        try:
            self._set_until_right(
                long(SET_BACKLASH, POSITION_LAYOUT.pack(CHANNEL, 0)),
                lambda: POSITION_LAYOUT.unpack(self._query(REQUEST_BACKLASH, POSITION_LAYOUT))[1],
                lambda counts: counts == 0,
                "the backlash correction",
                0,
            )
        except ReplyTimeout as error:
            self._require_alive(error)

    def is_enabled(self) -> bool:
        """Ask whether the channel is switched on."""
        state = self._read_twice(
            lambda: self._ask(REQUEST_ENABLED, lambda reply: parameter_of(reply, REQUEST_ENABLED, self.name)),
            "the state of the channel",
        )
        return state == ON

    def enable(self) -> None:
        """Switch the channel on: the motor holds its position."""
        self._set_until_right(short(SET_ENABLED, CHANNEL, ON), self.is_enabled, bool, "the channel", True)

    def move(self, count: int) -> None:
        """Start a move to a count. The command is sent once, and has no reply."""
        self.reports.clear()
        self._command(long(MOVE_TO, POSITION_LAYOUT.pack(CHANNEL, count)))

    def home(self) -> None:
        """Start a search of the reference. The command is sent once, and has no reply."""
        self.reports.clear()
        self._command(short(HOME, CHANNEL))

    def stop(self, ramp_s: float) -> None:
        """Ramp down at once, and ask until the axis stands, else raise `ReplyError`.

        A stop that shows no effect is sent again; ``ramp_s`` is the time of the ramp from full speed.
        """
        with self.lock:
            repeat(lambda: self._stop_once(ramp_s), tries=2)

    # ------------------------------------------------------------ inside

    def _stop_once(self, ramp_s: float) -> None:
        request = self._sign_of_life + short(STOP, CHANNEL, STOP_BY_RAMP)
        for poll in range(math.ceil((2.0 * ramp_s + 0.5) / _STOP_POLL_S)):
            if poll % _POLLS_A_STOP == 0:
                self.write(request)
            if not self.read_status().moving:
                return
            self.receive(_STOP_POLL_S)
        raise ReplyTimeout(
            "the controller still reports a motion after a stop.",
            where=self.name,
            remedy="Cut the stage's power.",
        )

    def _set_until_right(
        self, request: bytes, read: Callable[[], T], is_right: Callable[[T], bool], what: str, wanted: object
    ) -> None:
        """Send a setting that has no reply, and read it back; send it again if it got lost."""
        for _ in range(3):
            if is_right(read()):
                return
            self._command(request)
        if not is_right(got := read()):
            raise read_back_otherwise(self.name, what, wanted, got)

    def _require_alive(self, error: ReplyTimeout) -> None:
        """Raise the error of a silence unless the controller answers another question: it did not know that one."""
        if error.late_s:
            raise error
        self.read_status()

    def _command(self, request: bytes) -> None:
        with self.lock:
            self.bring_into_step()
            self.write(request)

    def _read_twice(self, read: Callable[[], T], what: str) -> T:
        return read_until_agreed(read, what=what, where=self.name)

    def _query(self, message: int, layout: struct.Struct, *, tries: int = TRIES) -> bytes:
        """Send a query and return the data of the reply; see `_ask`."""
        return self._ask(message, lambda reply: data_of(reply, message, layout, self.name), tries=tries)

    def _ask(self, message: int, parse: Callable[[bytes], T], *, tries: int = TRIES) -> T:
        """Send a query, ``tries`` times in all until its reply is valid; return what ``parse`` makes of the reply."""
        channel = 0 if message == REQUEST_INFORMATION else CHANNEL
        request = self._sign_of_life + short(message, channel)
        return repeat(lambda: self.exchange(request, lambda reader: parse(reader.read_line())), tries=tries)

    def _resynchronise(self) -> None:
        """Silence what another program has switched on; then get the identity, alone on the line."""

        def clear_device() -> None:
            # Nothing that could complete a cut command may be sent here: a move is a command with data.
            self.write(short(STOP_UPDATES))
            self.drain()

        self.prove_in_step(
            lambda: self._query(REQUEST_INFORMATION, INFORMATION_LAYOUT, tries=1),
            marker_s=_MARKER_S,
            clear_device=clear_device,
            once_if_silent=True,
        )
