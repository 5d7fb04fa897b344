"""A simulated Standa 8SMC controller with one axis, which speaks the binary XIMC protocol.

    four letters                                a command without data
    four letters, data, CRC16                   a command with data; the CRC covers the data alone
    the four letters again (, data, CRC16)      its answer; errc, errd, errv instead: unknown, CRC, value

All numbers are little endian. A byte 0 in place of a command is answered by a byte 0; a host finds the
beginning of commands with it. A command whose bytes stop coming is dropped after 0.4 s. Positions are steps and
1/256 steps. Homing does not set the position: the host does. It goes on from the sensor by a way that is kept in the
controller (``shom``).

Source: Standa's published definition of the XIMC communication protocol.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from simulators.stages.axis_motion import Axis, MotionEvent, SingleController

#: Microsteps per step; positions use them in each mode of the motor.
MICROSTEPS: Final = 256

#: Number of each command in the status field "last command" (MvCmdSts).
COMMAND_NUMBERS: Final = {"move": 1, "left": 3, "stop": 5, "home": 6, "sstp": 8}

#: Layouts of settings, by the letters that follow g (get) or s (set); padding bytes are reserved.
LAYOUTS: Final = {
    "mov": (struct.Struct("<IBHHIBB9x"), 24),
    "eng": (struct.Struct("<HHIBHhBH12x"), 28),
    "ent": (struct.Struct("<BB6x"), 8),
    "eds": (struct.Struct("<BBihih6x"), 20),
    "hom": (struct.Struct("<IBIBihH9x"), 27),
    "fbs": (struct.Struct("<HBBI4x"), 12),
    "sni": (struct.Struct("<BHihIB8x"), 22),
    "pwr": (struct.Struct("<BHHHB6x"), 14),
}

_HOME_SPEED_DEG_S: Final = 20.0
"""Speed of homing; the last part is ten times slower."""
_COUNTS_PER_STEP: Final = 20
"""Resolution of the encoder on the shaft."""

_MOVING, _AT_SPEED = 0x01, 0x02  # Bits of the status, here and below
_RUNNING, _FAILED = 0x80, 0x40
_IS_HOMED, _ALARM, _SLIPPED = 0x20, 0x40, 0x80
_ERROR_FLAGS: Final = {b"errc": 0x01, b"errd": 0x02, b"errv": 0x04}
_RIGHT_EDGE, _LEFT_EDGE = 0x01, 0x02  # Switches that are reached
_STOP_LEFT, _STOP_RIGHT = 0x02, 0x04  # Borders that stop


class ErrorReply(Exception):
    """An error answer: ``errc`` (unknown command), ``errd`` (wrong CRC) or ``errv`` (wrong value)."""

    def __init__(self, letters: bytes) -> None:
        self.letters = letters
        super().__init__(letters.decode())


def crc16(data: bytes) -> int:
    """Return the cyclic redundancy check with polynomial 0xA001 (reflected) and start value 0xFFFF.

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
    """Return the number of bytes after the letters of a command, CRC included; 0 for a command without data."""
    name = letters.decode("latin-1")
    if name == "move":
        return 14
    if name[0] == "s" and name[1:] in LAYOUTS:
        return LAYOUTS[name[1:]][1] + 2
    return 0


def to_counts(steps: int, fraction: int) -> int:
    """Combine whole steps and 1/256 steps."""
    return steps * MICROSTEPS + fraction


def to_steps(counts: int) -> tuple[int, int]:
    """Split a position into whole steps and 1/256 steps, both with the same sign.

    >>> to_steps(-257)
    (-1, -1)
    """
    sign = -1 if counts < 0 else 1
    whole, fraction = divmod(abs(counts), MICROSTEPS)
    return sign * whole, sign * fraction


class XimcController(SingleController):
    """The controller; the limits of its axis are its borders at power-up, at which it stops."""

    BOOT_S = 0.5
    BYTE_TIMEOUT_S = 0.4
    _stop_pressed = False

    def _deliver(self) -> None:
        self._counts_per_step = _COUNTS_PER_STEP if self.model.encoder else 0
        self.settings = self._factory_settings()
        """By the letters of `LAYOUTS`; they survive a restart."""
        self._commands = self._known_commands()

    def _power_up(self) -> None:
        self._buffer = b""
        self._command = self._flags = self._edges = 0
        self._failed = False

    # ------------------------------------------------------------------ the line
    def _answer(self, now: float) -> bytes:
        answers = b""
        while self._buffer:
            if self._buffer[0] == 0:
                self._buffer = self._buffer[1:]
                answers += b"\0"
                continue
            letters = self._buffer[:4]
            if len(letters) < 4:
                break
            length = data_length(letters)
            if len(self._buffer) < 4 + length:
                break
            content, self._buffer = self._buffer[4 : 4 + length], self._buffer[4 + length :]
            answers += self._reply(letters, content, now)
        return answers

    def _reply(self, letters: bytes, content: bytes, now: float) -> bytes:
        try:
            data = self._execute(letters.decode("latin-1"), content, now)
        except ErrorReply as error:
            # After an error, the next byte need not be the beginning of a command.
            self._buffer = b""
            self._flags |= _ERROR_FLAGS[error.letters]
            return error.letters
        return letters + (data + struct.pack("<H", crc16(data)) if data else b"")

    def _execute(self, name: str, content: bytes, now: float) -> bytes:
        if content:
            content, crc = content[:-2], struct.unpack("<H", content[-2:])[0]
            if crc != crc16(content):
                raise ErrorReply(b"errd")
        if name[0] == "g" and name[1:] in LAYOUTS:
            return LAYOUTS[name[1:]][0].pack(*self.settings[name[1:]])
        if name[0] == "s" and name[1:] in LAYOUTS:
            return self._set(name[1:], content)
        if name not in self._commands:
            raise ErrorReply(b"errc")
        return self._commands[name](content, now)

    # ------------------------------------------------------------------ commands
    def _known_commands(self) -> dict[str, Callable[[bytes, float], bytes]]:
        return {
            "geti": lambda _data, _now: struct.pack("<4s2s8sBBH12x", b"XIMC", b"SM", b"8SMC5\0\0\0", 4, 5, 8),
            "gser": lambda _data, _now: struct.pack("<I", int(self.model.serial)),
            "gfwv": lambda _data, _now: struct.pack("<BBH", 4, 6, 12),
            "gets": lambda _data, now: self._status(now),
            "gpos": lambda _data, now: struct.pack("<ihq6x", *self._position(now), self._encoder(now)),
            "zero": self._zero,
            "move": lambda data, now: self._move("move", to_counts(*struct.unpack("<ih6x", data)), now),
            "left": lambda _data, now: self._move("left", self._border(0), now),
            "home": self._home,
            "stop": self._stop,
            "sstp": self._soft_stop,
        }

    def _move(self, name: str, target: int, now: float) -> bytes:
        """Move to a position; if a border lies before it, stop there and report the command as failed."""
        if not self._accept_command(name):
            return b""
        flags = self.settings["eds"][0]
        lowest, highest = self._border(0), self._border(1)
        if target < lowest and flags & _STOP_LEFT:
            target, self._failed, self._edges = lowest, True, _LEFT_EDGE
        elif target > highest and flags & _STOP_RIGHT:
            target, self._failed, self._edges = highest, True, _RIGHT_EDGE
        speed, fraction, acceleration, *_ = self.settings["mov"]
        self.axis.move_to(target, now, float(to_counts(speed, fraction)), float(acceleration * MICROSTEPS))
        return b""

    def _home(self, _data: bytes, now: float) -> bytes:
        if self._accept_command("home"):
            fast, fraction, slow, slow_fraction, way, way_fraction, _ = self.settings["hom"]
            made = self.model.mechanics
            way_deg = to_counts(way, way_fraction) / made.counts_per_deg
            self.axis.mechanics = replace(made, home_deg=made.home_deg + way_deg)
            acceleration = float(self.settings["mov"][2] * MICROSTEPS)
            fast_speed, slow_speed = float(to_counts(fast, fraction)), float(to_counts(slow, slow_fraction))
            self.axis.home(now, fast_speed, slow_speed, acceleration, set_counter=False)
        return b""

    def _accept_command(self, name: str) -> bool:
        """Record the command; in alarm, a command is answered and ignored."""
        if self._flags & _ALARM:
            return False
        self._command = COMMAND_NUMBERS[name]
        self._failed = False
        self._edges = 0
        return True

    def _stop(self, _data: bytes, now: float) -> bytes:
        """Stop at once and end an alarm; steps may be lost, so the reference is dropped."""
        if self.axis.busy(now):
            self.axis.halt(now)
            self.axis.forget_reference()
        self._command = COMMAND_NUMBERS["stop"]
        if not self._stop_pressed:
            self._flags &= ~(_ALARM | _SLIPPED)
        return b""

    def _soft_stop(self, _data: bytes, now: float) -> bytes:
        if self.axis.busy(now):
            self.axis.stop(now, float(self.settings["mov"][3] * MICROSTEPS))
        self._command = COMMAND_NUMBERS["sstp"]
        return b""

    def _zero(self, _data: bytes, now: float) -> bytes:
        self.axis.set_counter(0.0, now)
        self.axis.set_encoder(0.0, now)
        return b""

    def _set(self, name: str, content: bytes) -> bytes:
        values = LAYOUTS[name][0].unpack(content)
        if name == "mov" and (values[:2] == (0, 0) or not values[2] or not values[3]):
            raise ErrorReply(b"errv")
        if name == "hom" and (values[:2] == (0, 0) or values[2:4] == (0, 0)):
            raise ErrorReply(b"errv")
        self.settings[name] = values
        return b""

    # ------------------------------------------------------------------ readings
    def _status(self, now: float) -> bytes:
        busy = self.axis.reports_busy(now)
        velocity = round(self.axis.velocity(now))
        speed = to_counts(*self.settings["mov"][:2])
        moving = (_MOVING if busy else 0) | (_AT_SPEED if abs(velocity) >= speed else 0)
        command = self._command | (_RUNNING if busy else 0) | (_FAILED if self._failed and not busy else 0)
        flags = self._flags | (_IS_HOMED if self.axis.referenced(now) else 0)
        self._flags &= ~0x07
        encoder = 0x04 if self._counts_per_step else 0x00
        edges = self._edges if not busy else 0
        return struct.pack(
            "<BBBBBihqihhhhhhIIB4x",
            *(moving, command, 0x03 if busy else 0x04, encoder, 0),
            *self._position(now),
            self._encoder(now),
            *to_steps(velocity),
            *(420, 2410, 95, 508, 318),
            *(flags, edges, 10),
        )

    def _position(self, now: float) -> tuple[int, int]:
        return to_steps(round(self.axis.counter(now)))

    def _encoder(self, now: float) -> int:
        return round(self.axis.encoder(now) * self._counts_per_step / MICROSTEPS)

    def _border(self, side: int) -> int:
        return to_counts(*self.settings["eds"][2 + 2 * side : 4 + 2 * side])

    # ------------------------------------------------------------------ events outside the protocol
    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """Press the emergency input, which halts the axis and raises the alarm, or release it; the alarm stays."""
        self._stop_pressed = not released
        if not released:
            self.axis.halt(t_s)
            self.axis.forget_reference()
            self._flags |= _ALARM

    def _notice(self, axis: Axis, event: MotionEvent, t_s: float) -> None:
        self._failed = True
        if event.kind == "limit":
            self._edges = _RIGHT_EDGE if axis.counter(t_s) > 0.0 else _LEFT_EDGE
        else:
            self._flags |= _SLIPPED | _ALARM
            axis.forget_reference()

    def _factory_settings(self) -> dict[str, tuple[int, ...]]:
        model, scale = self.model, self.model.mechanics.counts_per_deg
        speed = to_steps(round(model.speed_deg_s * scale))
        acceleration = round(model.acceleration_deg_s2 * scale / MICROSTEPS)
        fast, slow = (to_steps(round(_HOME_SPEED_DEG_S * scale / part)) for part in (1, 10))
        left, right = (to_steps(round(border * scale)) for border in (-model.limit_deg, model.limit_deg))
        return {
            "mov": (*speed, acceleration, acceleration, *speed, 0),
            "eng": (3600, 670, *speed, 0, 0, 0x09, 200),
            "ent": (0x03, 0x02),
            "eds": (_STOP_LEFT | _STOP_RIGHT, 0, *left, *right),
            "hom": (*fast, *slow, 0, 0, 0x0130),
            "fbs": (4000, 0x05, 0, 200 * self._counts_per_step),
            "sni": (0, 4, 0, 0, 0, 0),
            "pwr": (50, 1000, 60, 100, 0x05),
        }
