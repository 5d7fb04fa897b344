"""A simulated Thorlabs controller with one channel, which speaks the APT protocol: K10CR1, or KDC101 with a PRM1Z8.

    id (2), parameter, parameter, destination, source            a short message
    id (2), length (2), destination | 0x80, source, data         a message with data

All numbers are little endian; the computer is 0x01, the unit 0x50. Commands have no answer, and no message has a
checksum or a number. The end of a motion is told unasked (0x0464 arrived, 0x0444 homed, 0x0466 stopped). Updates of the
status come ten times a second while they are switched on. The home parameters (0x0440) decide how fast the reference is
searched, and how far from its switch the counter becomes 0; after power-up they are slow, with an offset of 0. A K10CR1
counts the steps that it sends; a KDC101 counts the encoder of the motor, and sends at most 50 updates, asked for or
not, without a sign of life (0x0492) of the computer.

Source: Thorlabs, "APT Controllers Host-Controller Communications Protocol". That bytes of a message that is not
completed are dropped after 0.5 s, and what the unit does at unknown ids (nothing), was written without a unit at hand.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Final

from simulators.stages.axis_motion import Axis, MotionEvent, SingleController

_COMPUTER: Final = 0x01  # Address of the computer
_UNIT: Final = 0x50  # Of a controller with its own USB port
_UPDATE_S: Final = 0.1  # Ten updates a second
_HOME_SPEED_DEG_S: Final = 2.0
"""Speed of homing after power-up; the last part of a homing is ten times slower."""
_MAKERS_OFFSET_DEG: Final = 4.0
"""From the switch to the zero of the stage, where the maker's programs put it when they connect."""
_FORWARD: Final = 1  # Direction of a homing
_CAM_DEG: Final = 1.5
"""Width of the cam at the switch: a search forward finds its other edge."""
_PATIENCE: Final = 50  # Updates that are sent without a sign of life
_SERVO_PERIOD_S: Final = 2048.0 / 6.0e6  # 2048 ticks of a clock of 6 MHz
_LONGEST: Final = 255  # Bytes of a message's data

#: Settings that are kept as they come: length of their data by the id that sets them. The next ids ask and answer.
_KEPT: Final = {0x0413: 14, 0x043A: 6, 0x0440: 14}

_FORWARD_SWITCH, _REVERSE_SWITCH = 0x1, 0x2  # Status bits of the protocol, here and below
_TURNS_FORWARD, _TURNS_BACK = 0x10, 0x20
_CONNECTED, _HOMING, _HOMED = 0x100, 0x200, 0x400
_TRACKING, _SETTLED, _DOES_NOT_FOLLOW = 0x1000, 0x2000, 0x4000
_POWER_OK, _ENABLED = 0x1000_0000, 0x8000_0000


class AptController(SingleController):
    """The controller; its model's name is "K10CR1", the usual one, or "KDC101"."""

    inputs = 0
    """Status bits of inputs, and those that no document explains."""
    speed_step = 1
    """Step, in its units, to which it rounds speeds and ramps that are set down."""
    BOOT_S = 1.0
    BYTE_TIMEOUT_S = 0.5

    @property
    def _name(self) -> str:
        return self.model.name or "K10CR1"

    @property
    def _servo(self) -> bool:
        """Whether the motor has an encoder."""
        return not self._name.startswith("K10CR")

    def _speed_units(self) -> tuple[float, float]:
        """Return the scales of the ramp settings: units for one count/s, and for one count/s^2."""
        if self._servo:
            return _SERVO_PERIOD_S * 65_536.0, _SERVO_PERIOD_S**2 * 65_536.0
        return 53.68, 1.0 / 90.9

    def _power_up(self) -> None:
        self._buffer = b""
        self._kept = {number: b"\1\0" + bytes(length - 2) for number, length in _KEPT.items()}
        speed, acceleration = self._speed_units()
        scale = self.model.mechanics.counts_per_deg
        ramp = round(self.model.acceleration_deg_s2 * scale * acceleration)
        home_speed = round(_HOME_SPEED_DEG_S * scale * speed)
        self._kept[0x0440] = struct.pack("<HHHii", 1, 2, 1, home_speed, 0)
        self._kept[0x0413] = struct.pack("<Hiii", 1, 0, ramp, round(self.model.speed_deg_s * scale * speed))
        self._enabled = True
        self._updates = False
        self._updated_at_s = self._clock()  # the moment at which a restart is noticed
        self._unanswered = 0
        self._switches = 0
        self._does_not_follow = False
        self._motion = ""

    # ------------------------------------------------------------------ the line
    def _answer(self, now: float) -> bytes:
        answers = b""
        while len(self._buffer) >= 6:
            number, first, second, destination, source = struct.unpack_from("<HBBBB", self._buffer)
            length = first | second << 8 if destination & 0x80 else 0
            if destination & 0x7F not in {_UNIT, 0x11, 0x21} or source != _COMPUTER or length > _LONGEST:
                self._buffer = self._buffer[1:]
                continue
            if len(self._buffer) < 6 + length:
                break
            content, self._buffer = self._buffer[6 : 6 + length], self._buffer[6 + length :]
            answers += self._execute(number, first, second, content, now)
        return answers

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. These are ends of motions, and updates of the status."""
        now = self._clock()
        self.take_events(now)
        if not self.awake(now):
            return b""
        reports = b""
        if self._motion and not self.axis.reports_busy(now):
            reports, self._motion = self._end_of_motion(now), ""
        if self._updates and now - self._updated_at_s >= _UPDATE_S and self._still_there():
            self._updated_at_s = now
            reports += self._long(0x0491 if self._servo else 0x0481, self._update(now))
        return reports

    def _end_of_motion(self, now: float) -> bytes:
        if self._motion == "home":
            return self._short(0x0444, 1, 0)
        return self._long(0x0464 if self._motion == "move" else 0x0466, self._update(now))

    def _long(self, number: int, content: bytes) -> bytes:
        return struct.pack("<HHBB", number, len(content), _COMPUTER | 0x80, _UNIT) + content

    def _short(self, number: int, first: int, second: int) -> bytes:
        return struct.pack("<HBBBB", number, first, second, _COMPUTER, _UNIT)

    # ------------------------------------------------------------------ messages
    def _execute(self, number: int, first: int, second: int, content: bytes, now: float) -> bytes:
        if number == 0x0492:
            self._unanswered = 0
            return b""
        if number in {0x0005, 0x0211, 0x0411, 0x0429, 0x0480, 0x0490} or number - 1 in _KEPT:
            return self._tell(number, now)
        if number in _KEPT:
            if len(content) == _KEPT[number] and content[:2] == b"\x01\x00":
                self._kept[number] = self._rounded(number, content)
        elif number in {0x0011, 0x0012}:
            self._updates, self._updated_at_s = number == 0x0011, now
        elif number == 0x0210 and first == 1 and second in {1, 2}:
            self._enable(second == 1, now)
        elif self._enabled:
            self._command(number, first, second, content, now)
        return b""

    def _command(self, number: int, first: int, second: int, content: bytes, now: float) -> None:
        if number == 0x0443 and first == 1:
            self._home(now)
        elif number == 0x0465 and first == 1:
            if self.axis.busy(now):
                self._motion = "stop"
                self.axis.halt(now) if second == 1 else self.axis.stop(now, self._ramp()[1])
        elif number in {0x0453, 0x0448} and len(content) == 6:
            channel, value = struct.unpack("<Hi", content)
            if channel == 1:
                self._move(value + (self._position(now) if number == 0x0448 else 0), now)

    def _rounded(self, number: int, content: bytes) -> bytes:
        if number == 0x0413:
            *head, ramp, speed = struct.unpack("<Hiii", content)
            return struct.pack("<Hiii", *head, ramp - ramp % self.speed_step, speed - speed % self.speed_step)
        if number == 0x0440:
            *head, speed, offset = struct.unpack("<HHHii", content)
            return struct.pack("<HHHii", *head, speed - speed % self.speed_step, offset)
        return content

    def _home(self, now: float) -> None:
        """Search the switch in the direction that is set; the counter becomes 0 at the offset from it."""
        self._switches, self._motion = 0, "home"
        _, direction, _, speed, offset = struct.unpack("<HHHii", self._kept[0x0440])
        made = self.model.mechanics
        edge_deg = _CAM_DEG if direction == _FORWARD else 0.0
        zero_deg = made.home_deg + edge_deg + offset / made.counts_per_deg - _MAKERS_OFFSET_DEG
        self.axis.mechanics = replace(made, home_deg=zero_deg)
        counts_s = speed / self._speed_units()[0]
        if counts_s > 0.0:
            self.axis.home(now, counts_s, counts_s / 10.0, self._ramp()[1])

    def _move(self, target: int, now: float) -> None:
        self._switches, self._motion = 0, "move"
        self.axis.move_to(float(target), now, *self._ramp())

    def _ramp(self) -> tuple[float, float]:
        """Return speed and acceleration in counts/s and counts/s^2."""
        _, _, acceleration, speed = struct.unpack("<Hiii", self._kept[0x0413])
        speed_unit, acceleration_unit = self._speed_units()
        return max(speed / speed_unit, 1.0), max(acceleration / acceleration_unit, 1.0)

    def _enable(self, enabled: bool, now: float) -> None:
        self._enabled = enabled
        if not enabled and self.axis.busy(now):
            self.axis.halt(now)
        if enabled:
            self._does_not_follow = False

    # ------------------------------------------------------------------ readings
    def _tell(self, number: int, now: float) -> bytes:
        if number == 0x0005:
            return self._information()
        if number == 0x0211:
            return self._short(0x0212, 1, 1 if self._enabled else 2)
        if number == 0x0411:
            return self._long(0x0412, struct.pack("<Hi", 1, self._position(now)))
        if number == 0x0429:
            return self._long(0x042A, struct.pack("<HI", 1, self._bits(now)))
        if number - 1 in _KEPT:
            return self._long(number + 1, self._kept[number - 1])
        update = self._still_there()
        return self._long(number + 1, self._update(now, servo=number == 0x0490)) if update else b""

    def _information(self) -> bytes:
        name = self._name.encode("ascii", "replace")[:8]
        kind = 44 if self._servo else 16
        return self._long(
            0x0006,
            struct.pack(
                "<I8sHBBBB60sHHH", int(self.model.serial), name, kind, 3, 0, 2, 0, b"simulated", 1, 3, 1
            ),
        )

    def _still_there(self) -> bool:
        """Count an update that is due; return whether the computer has given a sign of life lately."""
        self._unanswered += 1
        return not self._servo or self._unanswered <= _PATIENCE

    def _update(self, now: float, *, servo: bool | None = None) -> bytes:
        if self._servo if servo is None else servo:
            speed = round(self.axis.velocity(now) * self._speed_units()[0] / 65_536.0)
            low = max(-32_768, min(32_767, speed))
            return struct.pack("<HihhI", 1, self._position(now), low, 12, self._bits(now))
        return struct.pack("<HiiI", 1, self._position(now), self._encoder(now), self._bits(now))

    def _position(self, now: float) -> int:
        counted = self.axis.encoder(now) if self._servo else self.axis.counter(now)
        return max(-(2**31), min(2**31 - 1, round(counted)))

    def _encoder(self, now: float) -> int:
        return self._position(now) if self._servo else 0

    def _bits(self, now: float) -> int:
        busy = self.axis.reports_busy(now)
        bits = self.inputs | _CONNECTED | _POWER_OK | (_ENABLED if self._enabled else 0)
        bits |= _HOMED if self.axis.referenced(now) else 0
        if busy and self._motion == "home":
            bits |= _HOMING
        if busy:
            bits |= _TURNS_FORWARD if self.axis.velocity(now) >= 0.0 else _TURNS_BACK
        else:
            bits |= self._switches | (_SETTLED if self._servo else 0)
        bits |= _TRACKING if self._servo else 0
        return bits | (_DOES_NOT_FOLLOW if self._does_not_follow else 0)

    # ------------------------------------------------------------------ events outside the protocol
    def switch_off_channel(self, t_s: float) -> None:
        """Switch the channel off at the panel."""
        self._enable(False, t_s)

    def _notice(self, axis: Axis, event: MotionEvent, t_s: float) -> None:
        if event.kind == "limit":
            self._switches = _FORWARD_SWITCH if axis.counter(t_s) > 0.0 else _REVERSE_SWITCH
        else:
            self._does_not_follow = True
            self._enabled = False
            axis.forget_reference()
