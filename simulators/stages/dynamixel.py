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
from typing import Final

from simulators.stages.axis_motion import Axis
from simulators.stages.dynamixel_packets import AccessError, RangeError, crc_of, status_packet, unstuffed
from simulators.stages.dynamixel_servo import DynamixelServo, ServoModel
from simulators.world.trajectory import LoadTrajectory

_START: Final = b"\xff\xff\xfd\x00"
_ALL: Final = 0xFE
_BYTE_TIMEOUT_S: Final = 0.1
_LONGEST: Final = 1024

_RESULT_FAIL, _UNKNOWN, _DAMAGED, _RANGE, _LENGTH, _LIMIT, _ACCESS = range(1, 8)


class DynamixelBus:
    """The servos on one line, as a dialect.

    clock: Returns the time in seconds.
    publish: Called with the id of a servo and each new trajectory of it.
    """

    def __init__(
        self,
        models: Mapping[int, ServoModel],
        clock: Callable[[], float],
        publish: Callable[[int, LoadTrajectory], None] = lambda _id, _pointing: None,
        baud: int = 57_600,
    ) -> None:
        self._clock = clock
        self.baud = baud
        self._buffer = b""
        self._received_at_s = clock()

        def publisher(number: int) -> Callable[[LoadTrajectory], None]:
            return lambda pointing: publish(number, pointing)

        self.servos = {
            number: DynamixelServo(number, model, Axis(model.mechanics, clock(), publisher(number)), clock())
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
        here = [servo for servo in self.servos.values() if servo.answers(now)]
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
        act = self._instructions.get(instruction)
        if act is None:
            error = _UNKNOWN
        else:
            try:
                data = act(servo, content, now)
            except AccessError:
                error = _ACCESS
            except RangeError as refused:
                error = _LIMIT if refused.by_setting else _RANGE
            except struct.error:
                error = _LENGTH
        return status_packet(servo.number, error | servo.alert, data)

    # ------------------------------------------------------------------ instructions
    def _read(self, servo: DynamixelServo, content: bytes, now: float) -> bytes:
        first, count = struct.unpack("<HH", content)
        table = servo.table(now)
        if not count or first + count > len(table):
            raise AccessError
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

    # ------------------------------------------------------------------ events outside the protocol
    def cut_power(self, t_s: float, *, restored: bool = False) -> None:
        """Cut the power of the bus, or restore it; nothing happens if it was never cut.

        t_s: Time, s.
        restored: Whether the power comes back.
        """
        for servo in self.servos.values():
            servo.power(t_s, on=restored)
