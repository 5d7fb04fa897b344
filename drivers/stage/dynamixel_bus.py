"""Talk to Dynamixel X series servos on one bus: whole packets, repeated questions, confirmed writes and stops.

A packet of Robotis' Dynamixel Protocol 2.0:

    FF FF FD 00  id  length (2)  instruction or 55  (error, in a status packet)  parameters  CRC (2)

The CRC-16 has the polynomial 0x8005 and begins with 0. Where FF FF FD stands between length and CRC, a further FD
follows. There is no number of a packet: two status packets of a servo to the same instruction look alike.
Degrees and the names of axes belong to ``drivers.stage.dynamixel``.

Sources: Robotis e-Manual, "DYNAMIXEL Protocol 2.0" and the control tables of XL430-W250 and XM430-W350,
https://emanual.robotis.com.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

from drivers.clock import Clock
from drivers.errors import DeviceRefused, ReplyError, ReplyGarbled
from drivers.link import Link, ReplyReader, repeat
from drivers.serial_port import Port
from drivers.wire_log import WireLog

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

    >>> hex(crc16(bytes.fromhex("ff ff fd 00 01 03 00 01")))
    '0x4e19'
    """
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _TABLE[crc >> 8 ^ byte]
    return crc


def packet(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return an instruction packet.

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
    """Return the size, bytes, of the packet whose first seven bytes these are; 0 when no servo sends such a packet."""
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


_MARKER_S: Final = 0.3
_FIRST_STOP_S: Final = 0.2
_BOOT_POLL_S: Final = 0.1
_BOOT_POLLS: Final = 30
_TICK_SLACK_S: Final = 0.05
_LONGEST_COMPARISON_S: Final = 10.0
"""The servo's own time repeats after 33 s."""
_PUSHING_COUNTS: Final = 20
"""A servo at rest that is further from its goal is blocked, and pushes."""
_SPEED_UNIT_COUNTS: Final = SPEED_UNIT_RPM * COUNTS_A_TURN / 60.0
_RAMP_UNIT_COUNTS: Final = RAMP_UNIT_REV_MIN2 * COUNTS_A_TURN / 3600.0


class _Age(NamedTuple):
    """The servo's own time in its latest state, and when it was asked and answered."""

    tick_ms: int
    sent_s: float
    received_s: float


class DynamixelBus(Link):
    """The servos on one line. Opening sends nothing."""

    quiet_s = 0.03
    reply_s = 0.5

    def __init__(
        self, port: Port, servos: Sequence[int], *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        self._servos = tuple(servos)
        self._asked = self._servos[0]
        self._ages: dict[int, _Age] = {}
        super().__init__(port, clock=clock, wire_log=wire_log)
        self.mark_out_of_step()

    def take_line(self) -> bytes | None:
        """Take one unread packet, or None. Bytes before a header are noise, and are thrown away."""
        while True:
            unread = self.unread
            start = unread.find(HEADER)
            if start < 0:
                self.take(max(0, len(unread) - len(HEADER) + 1))
                return None
            self.take(start)
            if len(unread) - start < HEAD_SIZE:
                return None
            if length := size(unread[start : start + HEAD_SIZE]):
                return self.take(length)
            self.take(len(HEADER))

    def take_unsolicited(self, line: bytes) -> bool:
        """Take an instruction: an adapter of one wire hears what it sends."""
        return self._parse(line).instruction != STATUS

    def read_settings(self, servo: int) -> Settings:
        """Ask for the settings that outlast a loss of power."""
        return Settings.unpack(repeat(lambda: self._read(servo, 0, SETTINGS_SIZE)))

    def read_state(self, servo: int) -> State:
        """Ask for the state."""
        return repeat(lambda: self._read_state(servo))

    def write_value(self, servo: int, address: int, data: bytes) -> None:
        """Write a value, again when no status packet comes; no goal while the torque is on: see `move`."""
        repeat(lambda: self._write(servo, address, data))

    def move(self, servo: int, goal: int) -> None:
        """Write a goal, counts, once. After a `ReplyError` the axis may be moving."""
        self._write(servo, GOAL, struct.pack("<i", goal))

    def reboot(self, servo: int) -> None:
        """Restart a servo, once, and wait until it answers. Its torque is off then."""
        self._exchange(servo, REBOOT, b"", 0)
        for _ in range(_BOOT_POLLS):
            self._clock.sleep(_BOOT_POLL_S)
            try:
                self._exchange(servo, PING, b"", 3, deadline_s=_BOOT_POLL_S)
            except ReplyError:
                continue
            return
        self.read_state(servo)

    def stop_all(self) -> None:
        """Set the goal of every servo where it can come to rest, and read it back; else raise `ReplyError`.

        A servo that does not answer does not delay the stop of the others: it is asked again after them. The torque
        stays on, so that no axis falls. Out of step, the line may give an old state: a stop by it goes out at once, and
        is repeated in step.
        """
        with self.lock:
            failed: ReplyError | None = None
            for servo in self._stop_quickly():
                try:
                    repeat(lambda servo=servo: self._stop(servo))  # type: ignore[misc]
                except ReplyError as error:
                    failed = error
            if failed is not None:
                raise failed

    # ------------------------------------------------------------ inside

    def _stop_quickly(self) -> list[int]:
        """Stop every servo that answers soon; return the others."""
        left = []
        usual_s, self.reply_s = self.reply_s, _FIRST_STOP_S
        try:
            for servo in () if self._in_step else self._servos:
                with suppress(ReplyError, DeviceRefused), self.urgently():
                    self._stop(servo, confirmed=False)
            for servo in self._servos:
                try:
                    self._stop(servo)
                except ReplyError:
                    left.append(servo)
        finally:
            self.reply_s = usual_s
        return left

    def _stop(self, servo: int, *, confirmed: bool = True) -> None:
        state = self._read_state(servo)
        if not state.torque:
            return
        goal = _resting_goal(state)
        if goal != state.goal:
            self.move(servo, goal)
            if not confirmed:
                return
            state = self._read_state(servo)
        if state.torque and state.goal != goal:
            raise ReplyGarbled(
                f"servo {servo} did not take the goal of a stop.",
                where=self.name,
                remedy="Cut the servo's power.",
            )

    def _read_state(self, servo: int) -> State:
        with self.lock:
            self._asked = servo
            self.bring_into_step()
            sent_s = self._clock.monotonic()
            state = State.unpack(self._read(servo, STATE_FIRST, STATE_SIZE))
            self._check_age(servo, state, sent_s, self._clock.monotonic())
            return state

    def _check_age(self, servo: int, state: State, sent_s: float, received_s: float) -> None:
        """Refuse a state that the servo's own clock shows to be an old one: a late packet looks like its successor."""
        before = self._ages.pop(servo, None)
        if before is not None and received_s - before.sent_s < _LONGEST_COMPARISON_S:
            tick_s = (state.tick_ms - before.tick_ms) % TICK_PERIOD_MS / 1000.0
            least_s = 0.5 * (sent_s - before.received_s) - _TICK_SLACK_S
            most_s = 2.0 * (received_s - before.sent_s) + _TICK_SLACK_S
            if not least_s <= tick_s <= most_s:
                self.mark_out_of_step()
                raise garbled(f"servo {servo} sent a state of another moment, or has restarted.", self.name)
        self._ages[servo] = _Age(state.tick_ms, sent_s, received_s)

    def _read(self, servo: int, first: int, count: int) -> bytes:
        return self._exchange(servo, READ, struct.pack("<HH", first, count), count)

    def _write(self, servo: int, address: int, data: bytes) -> None:
        self._exchange(servo, WRITE, struct.pack("<H", address) + data, 0)

    def _exchange(
        self, servo: int, instruction: int, parameters: bytes, count: int, *, deadline_s: float | None = None
    ) -> bytes:
        """Send an instruction, and return the parameters of its status packet."""

        def read_reply(reader: ReplyReader) -> bytes | DeviceRefused:
            while True:
                status = self._parse(reader.read_line())
                if status.servo == servo:  # a late packet of another servo is no answer
                    try:
                        return data_of(status, count, self.name)
                    except DeviceRefused as error:
                        return error

        with self.lock:
            self._asked = servo
            request = packet(servo, instruction, parameters)
            answer = self.exchange(request, read_reply, deadline_s=deadline_s)
        if isinstance(answer, DeviceRefused):
            raise answer
        return answer

    def _parse(self, data: bytes) -> Packet:
        return parse(data, self.name)

    def _resynchronise(self) -> None:
        """Wait for silence; then get the answer to a ping, which no other instruction has, alone on the line."""
        self.prove_in_step(
            lambda: self._exchange(self._asked, PING, b"", 3),
            marker_s=_MARKER_S,
            remedy="Check the cable, and that no two servos have the same id.",
            once_if_silent=True,
        )


def _resting_goal(state: State) -> int:
    """Return the goal at which a servo comes to rest by its ramp, at most the present goal."""
    away = state.goal - state.position
    if not state.moving:
        return state.goal if abs(away) <= _PUSHING_COUNTS else state.position
    speed, ramp = state.velocity * _SPEED_UNIT_COUNTS, state.ramp * _RAMP_UNIT_COUNTS
    braking = math.trunc(speed * abs(speed) / (2.0 * ramp)) if ramp else 0
    if braking * away > 0 and abs(braking) > abs(away):
        return state.goal
    return state.position + braking
