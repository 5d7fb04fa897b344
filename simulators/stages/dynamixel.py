"""Simulated Robotis servos of the X series on one bus, which speak Dynamixel Protocol 2.0.

    FF FF FD 00  id  length (2)  instruction  parameters  CRC (2)            an instruction; id FE addresses all
    FF FF FD 00  id  length (2)  55  error  parameters  CRC (2)              its status packet

A packet with a wrong CRC, for a servo that is here, is answered by error 3; all else that is no packet is dropped. At
power-up the torque is off, the profile is without limit, and turns are counted from the present one. Overload, heat and
the like are kept in the hardware error status, set the alert bit of every status packet, and switch the torque off
until the servo restarts. What a servo does with half a packet (it drops it after 0.1 s), and the time of a restart,
were written without a servo at hand.

Source: Robotis e-Manual, "DYNAMIXEL Protocol 2.0" and the control table of XL430-W250.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, NamedTuple

from simulators.stages.axis_motion import Axis, AxisModel, MotionEvent, Unit
from simulators.world.trajectory import LoadTrajectory

_START: Final = b"\xff\xff\xfd\x00"
_ALL: Final = 0xFE
_BYTE_TIMEOUT_S: Final = 0.1
_LONGEST: Final = 1024

_RESULT_FAIL, _UNKNOWN, _DAMAGED, _RANGE, _LENGTH, _LIMIT, _ACCESS = range(1, 8)


_TURN: Final = 4096
_MIDDLE: Final = 2048
_TABLE_BYTES: Final = 147
_FIRST_VOLATILE: Final = 64
_COUNTS_PER_SPEED: Final = 0.229 * _TURN / 60.0
_COUNTS_PER_RAMP: Final = 214.577 * _TURN / 3600.0
_FASTEST: Final = 10_000.0
_NO_RAMP: Final = 1.0e6

_VOLTAGE, _ENCODER, _OVERLOAD = 0x01, 0x08, 0x20
_POSITION_MODES: Final = {3, 4, 5}


class _Refused(Exception):
    """A refused instruction, with the error of its status packet."""

    def __init__(self, error: int) -> None:
        super().__init__(error)
        self.error = error


def _unknown(_servo: DynamixelServo, _content: bytes, _now: float) -> bytes:
    raise _Refused(_UNKNOWN)


def crc_of(data: bytes) -> int:
    """Return the CRC-16 of a packet without its last two bytes, bit by bit: polynomial 0x8005, begun with 0."""
    register = 0
    for byte in data:
        for bit in (128, 64, 32, 16, 8, 4, 2, 1):
            carry = (register >> 15) ^ (1 if byte & bit else 0)
            register = (register << 1) & 0xFFFF
            if carry:
                register ^= 0x8005
    return register


def unstuffed(body: bytes) -> bytes:
    """Drop the byte FD that follows each FF FF FD."""
    clean = bytearray()
    skip = False
    for byte in body:
        if skip:
            skip = False
            if byte == 0xFD:
                continue
        clean.append(byte)
        skip = clean[-3:] == b"\xff\xff\xfd"
    return bytes(clean)


def status_packet(number: int, error: int, data: bytes = b"") -> bytes:
    """Return a status packet."""
    body = bytearray()
    for byte in (0x55, error, *data):
        body.append(byte)
        if body[-3:] == b"\xff\xff\xfd":
            body.append(0xFD)
    packet = b"\xff\xff\xfd\x00" + bytes([number]) + (len(body) + 2).to_bytes(2, "little") + bytes(body)
    return packet + crc_of(packet).to_bytes(2, "little")


class _Field(NamedTuple):
    """A value that can be written: its size, its range, its value at delivery."""

    size: int
    lowest: int
    highest: int
    usual: int


_FIELDS: Final = {
    7: _Field(1, 0, 252, 1),
    8: _Field(1, 0, 7, 1),
    9: _Field(1, 0, 254, 250),
    10: _Field(1, 0, 13, 0),
    11: _Field(1, 0, 16, 3),
    12: _Field(1, 0, 255, 255),
    20: _Field(4, -1_044_479, 1_044_479, 0),
    24: _Field(4, 0, 1023, 10),
    31: _Field(1, 0, 100, 72),
    32: _Field(2, 60, 140, 140),
    34: _Field(2, 60, 140, 60),
    36: _Field(2, 0, 885, 885),
    44: _Field(4, 0, 1023, 265),
    48: _Field(4, 0, 4095, 4095),
    52: _Field(4, 0, 4095, 0),
    63: _Field(1, 0, 63, 52),
    64: _Field(1, 0, 1, 0),
    65: _Field(1, 0, 1, 0),
    68: _Field(1, 0, 2, 2),
    98: _Field(1, 0, 127, 0),
    100: _Field(2, -885, 885, 885),
    104: _Field(4, -1023, 1023, 0),
    108: _Field(4, 0, 32_767, 0),
    112: _Field(4, 0, 32_767, 0),
    116: _Field(4, -1_048_575, 1_048_575, 0),
}
"""Fields by address. Other bytes of the table are read-only."""


_MODEL_NUMBER: Final = 1060
"""An XL430-W250."""
_BOOT_S: Final = 0.4


class DynamixelServo(Unit):
    """A servo; a count of its axis is a position of the servo."""

    def __init__(
        self, number: int, model: AxisModel, now_s: float, publish: Callable[[LoadTrajectory], None]
    ) -> None:
        self.number = number
        self.axis = Axis(model.mechanics, now_s, publish)
        super().__init__([self.axis], now_s, _BOOT_S)
        self._model_number = _MODEL_NUMBER
        self._values = {address: field.usual for address, field in _FIELDS.items()}
        self._values[7] = number
        self._power_up()

    def _power_up(self) -> None:
        for address, field in _FIELDS.items():
            if address >= _FIRST_VOLATILE:
                self._values[address] = field.usual
        self.registered = b""
        self._errors = 0
        at_rest_s = self.axis.motor.start_s
        self._count_turns(at_rest_s)
        self._values[116] = self._position(at_rest_s)

    # ------------------------------------------------------------------ state
    @property
    def alert(self) -> int:
        """The alert bit of a status packet."""
        return 0x80 if self._errors else 0

    def _position(self, t_s: float) -> int:
        return round(self.axis.motor.position(t_s)) + _MIDDLE + _TURN * self._turns

    def _count_turns(self, t_s: float) -> None:
        """Count turns from the present one."""
        self._turns = 0
        self._turns = -(self._position(t_s) // _TURN)

    def table(self, t_s: float) -> bytes:
        """Return the whole control table."""
        table = bytearray(_TABLE_BYTES)
        struct.pack_into("<HIB", table, 0, self._model_number, 0, 45)
        for address, field in _FIELDS.items():
            signed = field.lowest < 0
            table[address : address + field.size] = self._values[address].to_bytes(
                field.size, "little", signed=signed
            )
        busy = self.axis.reports_busy(t_s)
        velocity = round(self.axis.velocity(t_s) / _COUNTS_PER_SPEED) if self.axis.busy(t_s) else 0
        position = self._position(t_s)
        table[13] = 2
        table[70] = self._errors
        struct.pack_into("<HBB", table, 120, round(t_s * 1000) % 32_768, busy, 0x02 if busy else 0x01)
        struct.pack_into("<ii", table, 128, velocity, position)
        struct.pack_into("<ii", table, 136, velocity, position)
        struct.pack_into("<HB", table, 144, 118, 34)
        return bytes(table)

    # ------------------------------------------------------------------ writing
    def write(self, first: int, data: bytes, t_s: float) -> None:
        """Write whole fields from an address on, all checked before; `_Refused` if one cannot be written."""
        values: list[tuple[int, int]] = []
        at = first
        while at < first + len(data):
            field = _FIELDS.get(at)
            if field is None or (at < _FIRST_VOLATILE and self._values[64]):
                raise _Refused(_ACCESS)
            part = data[at - first : at - first + field.size]
            if len(part) < field.size:
                raise struct.error
            values.append((at, int.from_bytes(part, "little", signed=field.lowest < 0)))
            at += field.size
        if not values:
            raise struct.error
        for address, value in values:
            self._check(address, value)
        for address, value in values:
            self._set(address, value, t_s)

    def _check(self, address: int, value: int) -> None:
        field = _FIELDS[address]
        if not field.lowest <= value <= field.highest:
            raise _Refused(_RANGE)
        if address == 11 and value not in {1, 3, 4, 16}:
            raise _Refused(_RANGE)
        if address == 64 and value and self._errors:
            raise _Refused(_ACCESS)
        lowest, highest = self._values[52], self._values[48]
        beyond = address == 116 and self._values[11] == 3 and not lowest <= value <= highest
        if beyond or (address == 112 and value > self._values[44]):
            raise _Refused(_LIMIT)  # a setting of the servo limits it

    def _set(self, address: int, value: int, t_s: float) -> None:
        before = self._values[address]
        self._values[address] = value
        if address == 64 and value and not before:
            self._values[116] = self._position(t_s)
        elif address == 64 and not value:
            self.axis.halt(t_s)
        elif address == 11:
            self._count_turns(t_s)
        elif address == 116:
            if not self._values[64] and self._values[10] & 0x08:
                self._values[64] = 1
            if self._values[64] and self._values[11] in _POSITION_MODES:
                self._go(value, t_s)

    def _go(self, goal: int, t_s: float) -> None:
        """Move to a goal by the profile; a value of 0 in it means without limit."""
        speed = self._values[112] * _COUNTS_PER_SPEED or _FASTEST
        ramp = self._values[108] * _COUNTS_PER_RAMP or _NO_RAMP
        target = self.axis.counter(t_s) + goal - self._position(t_s)
        self.axis.move_to(float(target), t_s, speed, ramp)

    # ------------------------------------------------------------------ events outside the protocol
    def _notice(self, axis: Axis, event: MotionEvent, t_s: float) -> None:
        del axis
        self.shut_down(_ENCODER if event.kind == "twist" else _OVERLOAD, t_s)

    def shut_down(self, error: int, t_s: float) -> None:
        """Note a hardware error, and switch the torque off if the setting says so."""
        self._errors |= error
        if self._values[63] & error or error == _ENCODER:
            self._values[64] = 0
            self.axis.halt(t_s)

    def clear_turns(self, t_s: float) -> None:
        """Count turns from the present one, unless the servo moves."""
        if not self.axis.busy(t_s):
            self._count_turns(t_s)

    def exchange(self, serial: str, t_s: float) -> None:
        """Replace the servo by another model, fresh from power-up; ``serial`` is its number, else XM430-W350."""
        known = serial.isdigit() and 1000 <= int(serial) < 2000
        self._model_number = int(serial) if known else 1020
        self.restart(t_s)


class DynamixelBus:
    """The servos on one line, as a dialect; ``publish`` is called with an id and each new trajectory of that servo."""

    def __init__(
        self,
        models: Mapping[int, AxisModel],
        clock: Callable[[], float],
        publish: Callable[[int, LoadTrajectory], None] = lambda _id, _pointing: None,
        baud: int = 57_600,
    ) -> None:
        self._clock = clock
        self.baud = baud
        self._buffer = b""
        self._received_at_s = clock()

        self.servos = {
            number: DynamixelServo(number, model, clock(), partial(publish, number))
            for number, model in models.items()
        }
        self._instructions: dict[int, Callable[[DynamixelServo, bytes, float], bytes]] = {
            0x01: lambda servo, _data, now: servo.table(now)[0:2] + servo.table(now)[6:7],
            0x02: self._read,
            0x03: self._write,
            0x04: self._register,
            0x05: self._act,
            0x08: self._reboot,
            0x10: self._clear,
        }

    # ------------------------------------------------------------------ the line
    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`."""
        now = self._clock()
        if now - self._received_at_s > _BYTE_TIMEOUT_S:
            self._buffer = b""
        self._received_at_s = now
        self._buffer += data
        answers = b""
        while True:
            begins = self._buffer.find(_START)
            if begins < 0:
                self._buffer = self._buffer[-3:]
                return answers
            self._buffer = self._buffer[begins:]
            if len(self._buffer) < 7:
                return answers
            length = int.from_bytes(self._buffer[5:7], "little")
            if not 3 <= length <= _LONGEST:
                self._buffer = self._buffer[1:]
                continue
            if len(self._buffer) < 7 + length:
                return answers
            packet, self._buffer = self._buffer[: 7 + length], self._buffer[7 + length :]
            answers += self._take(packet, now)

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. A servo says nothing unasked."""
        now = self._clock()
        for servo in self.servos.values():
            servo.take_events(now)
        return b""

    def _take(self, packet: bytes, now: float) -> bytes:
        """Carry out an instruction packet, and return the status packets."""
        number = packet[4]
        here = [servo for servo in self.servos.values() if servo.awake(now)]
        addressed = [servo for servo in here if number in {servo.number, _ALL}]
        if crc_of(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
            return b"".join(
                status_packet(servo.number, _DAMAGED | servo.alert) for servo in addressed if number != _ALL
            )
        body = unstuffed(packet[7:-2])
        instruction, content = body[0], body[1:]
        if number == _ALL and instruction in {0x82, 0x83}:
            return self._synchronous(instruction, content, here, now)
        silent = number == _ALL and instruction != 0x01
        said = b"".join(self._execute(servo, instruction, content, now) for servo in addressed)
        return b"" if silent else said

    def _execute(self, servo: DynamixelServo, instruction: int, content: bytes, now: float) -> bytes:
        servo.take_events(now)
        error, data = 0, b""
        act = self._instructions.get(instruction, _unknown)
        try:
            data = act(servo, content, now)
        except _Refused as refused:
            error = refused.error
        except struct.error:
            error = _LENGTH
        return status_packet(servo.number, error | servo.alert, data)

    # ------------------------------------------------------------------ instructions
    def _read(self, servo: DynamixelServo, content: bytes, now: float) -> bytes:
        first, count = struct.unpack("<HH", content)
        table = servo.table(now)
        if not count or first + count > len(table):
            raise _Refused(_ACCESS)
        return table[first : first + count]

    def _write(self, servo: DynamixelServo, content: bytes, now: float) -> bytes:
        (first,) = struct.unpack_from("<H", content)
        servo.write(first, content[2:], now)
        return b""

    def _register(self, servo: DynamixelServo, content: bytes, _now: float) -> bytes:
        struct.unpack_from("<H", content)
        servo.registered = content
        return b""

    def _act(self, servo: DynamixelServo, _content: bytes, now: float) -> bytes:
        content, servo.registered = servo.registered, b""
        return self._write(servo, content, now) if content else b""

    def _reboot(self, servo: DynamixelServo, _content: bytes, now: float) -> bytes:
        servo.restart(now)
        return b""

    def _clear(self, servo: DynamixelServo, content: bytes, now: float) -> bytes:
        if content == bytes.fromhex("01 44 58 4c 22"):
            servo.clear_turns(now)
        return b""

    def _synchronous(self, instruction: int, content: bytes, here: list[DynamixelServo], now: float) -> bytes:
        """Read or write the same addresses of several servos; only a reading is answered, in the given order."""
        if len(content) < 4:
            return b""
        first, count = struct.unpack_from("<HH", content)
        by_id = {servo.number: servo for servo in here}
        rest = content[4:]
        if instruction == 0x82:
            request = struct.pack("<HH", first, count)
            return b"".join(self._execute(by_id[one], 0x02, request, now) for one in rest if one in by_id)
        for at in range(0, len(rest) - count, count + 1):
            if rest[at] in by_id:
                data = struct.pack("<H", first) + rest[at + 1 : at + 1 + count]
                self._execute(by_id[rest[at]], 0x03, data, now)
        return b""
