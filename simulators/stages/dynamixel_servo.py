"""One simulated servo of the X series: its control table, its torque, its motion, and what it shuts down for.

The position counts 4096 a turn of the horn. The encoder knows the angle within one turn at power-up; count 2048 is the
angle 0 of the axis. `dynamixel` speaks the protocol.

Source: Robotis e-Manual, control table of XL430-W250.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final, NamedTuple

from simulators.stages.axis_motion import Axis
from simulators.stages.dynamixel_packets import AccessError, RangeError
from simulators.stages.mechanics import Mechanics

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


@dataclass(frozen=True)
class ServoModel:
    """A servo and the axis behind it."""

    mechanics: Mechanics  # Mechanical properties; a count is a position of the servo
    number: int = 1060
    boot_s: float = 0.4  # Time without answers after a restart, s


class DynamixelServo:
    """A servo.

    now_s: Time of power-up, s.
    """

    def __init__(self, number: int, model: ServoModel, axis: Axis, now_s: float) -> None:
        self.number = number
        self.axis = axis
        self.registered = b""
        self._boot_s = model.boot_s
        self._model_number = model.number
        self._values = {address: field.usual for address, field in _FIELDS.items()}
        self._values[7] = number
        self._powered = True
        self._power_up(now_s)

    def _power_up(self, t_s: float) -> None:
        for address, field in _FIELDS.items():
            if address >= _FIRST_VOLATILE:
                self._values[address] = field.usual
        self.registered = b""
        self._errors = 0
        self._turns = 0
        self._turns = -(self._position(t_s) // _TURN)
        self._values[116] = self._position(t_s)
        self._boot_ends_s = t_s

    # ------------------------------------------------------------------ state
    @property
    def alert(self) -> int:
        """The alert bit of a status packet."""
        return 0x80 if self._errors else 0

    def answers(self, t_s: float) -> bool:
        """Return whether the servo has power and runs.

        t_s: Time, s.
        Returns: Whether it answers.
        """
        return self._powered and t_s >= self._boot_ends_s

    def _position(self, t_s: float) -> int:
        return round(self.axis.motor.position(t_s)) + _MIDDLE + _TURN * self._turns

    def table(self, t_s: float) -> bytes:
        """Return the whole control table.

        t_s: Time, s.
        """
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
        """Write whole fields; all of them are checked before one is changed.

        first: Address of the first byte.
        t_s: Time, s.
        Raises AccessError: An address is read-only, or cannot be written while the torque is on.
        """
        values: list[tuple[int, int]] = []
        at = first
        while at < first + len(data):
            field = _FIELDS.get(at)
            if field is None or (at < _FIRST_VOLATILE and self._values[64]):
                raise AccessError
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
            raise RangeError
        if address == 11 and value not in {1, 3, 4, 16}:
            raise RangeError
        if address == 64 and value and self._errors:
            raise AccessError
        lowest, highest = self._values[52], self._values[48]
        beyond = address == 116 and self._values[11] == 3 and not lowest <= value <= highest
        if beyond or (address == 112 and value > self._values[44]):
            raise RangeError(by_setting=True)

    def _set(self, address: int, value: int, t_s: float) -> None:
        before = self._values[address]
        self._values[address] = value
        if address == 64 and value and not before:
            self._values[116] = self._position(t_s)
        elif address == 64 and not value:
            self.axis.halt(t_s)
        elif address == 11:
            self._turns = 0
            self._turns = -(self._position(t_s) // _TURN)
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
    def take_events(self, t_s: float) -> None:
        """Process what happened to the motion so far.

        t_s: Time, s.
        """
        event = self.axis.take_event(t_s)
        if event is None:
            return
        if event.kind == "restart":
            self.restart(event.t_s)
        else:
            self._shut_down(_ENCODER if event.kind == "twist" else _OVERLOAD, t_s)

    def _shut_down(self, error: int, t_s: float) -> None:
        """Note a hardware error, and switch the torque off if the setting says so."""
        self._errors |= error
        if self._values[63] & error or error == _ENCODER:
            self._values[64] = 0
            self.axis.halt(t_s)

    def clear_turns(self, t_s: float) -> None:
        """Count turns from the present one.

        t_s: Time, s.
        """
        if not self.axis.busy(t_s):
            self._turns = 0
            self._turns = -(self._position(t_s) // _TURN)

    def restart(self, t_s: float) -> None:
        """Restart: no answers for a while, then without torque, without errors, with the volatile values of delivery.

        t_s: Time of the restart, s.
        """
        self.axis.restart(t_s)
        self._power_up(t_s)
        self._boot_ends_s = t_s + self._boot_s

    def power(self, t_s: float, *, on: bool) -> None:
        """Cut or restore the power; nothing happens if it is as wanted.

        t_s: Time, s.
        on: Whether there is power.
        """
        if on and not self._powered:
            self._powered = True
            self.restart(t_s)
        elif not on:
            self._powered = False
            self.axis.halt(t_s)

    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """See `AxisController.emergency_stop`. The button cuts the power of the servo.

        t_s: Time, s.
        released: True restores it.
        """
        self.power(t_s, on=released)

    def exchange(self, serial: str, t_s: float) -> None:
        """Replace the servo by one of another model, fresh from power-up: servos have no serial number.

        serial: Model number, if it is that of a servo; else that of an XM430-W350.
        t_s: Time, s.
        """
        known = serial.isdigit() and 1000 <= int(serial) < 2000
        self._model_number = int(serial) if known else 1020
        self.restart(t_s)
