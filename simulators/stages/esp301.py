"""A simulated Newport ESP301 controller with up to three rotary axes.

    nCC value CR         a command to axis n; semicolons separate several commands on a line
    nCC? CR              a query, answered by a line that ends in CR LF; nothing else is answered

There is no checksum and no message id. A refused command gets no answer: its error (axis * 100 + number) waits in
a queue for ``TB?``. Positions are in degrees, and those that are read come from the encoder. Motors are
off at power-up and after each fault. What another client has set survives: the position at the reference (``SH``), a
correction of the scale in percent (``CO``), and the profile (``TJ``: from 4 on, the axis follows another one, and
moves of its own do nothing).

Reference: Newport ESP301 user's manual, command descriptions and appendix "Error messages". The time stamp in
``TB?`` was written from memory of the manual.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

from simulators.stages.axis_motion import Axis, AxisModel, AxisOfController, Controller, MotionEvent
from simulators.world.trajectory import LoadTrajectory

_COMMAND: Final = re.compile(r"\s*(\d*)\s*([A-Z]{2})\s*(.*?)\s*", re.IGNORECASE)
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[Ee][+-]?\d)?")
_QUEUE_LENGTH: Final = 10  # Errors that the controller keeps
_MAX_LINE: Final = 256  # Longer than any list of commands
_AS_POWER = 7
"""Value of ``FP`` that prints positions as powers of ten."""
_FOLLOWS_ANOTHER: Final = 4
"""Profile from which on an axis follows another one."""
_HOME_SPEED_DEG_S: Final = 20.0  # Of a homing; below, the largest of a move: those of a small rotary stage
_MOST_SPEED_DEG_S, _MOST_ACCELERATION_DEG_S2 = 80.0, 320.0

_ERROR_TEXTS: Final = {
    0: "NO ERROR DETECTED",
    4: "EMERGENCY STOP ACTIVATED",
    6: "COMMAND DOES NOT EXIST",
    7: "PARAMETER OUT OF RANGE",
    9: "AXIS NUMBER OUT OF RANGE",
    37: "AXIS NUMBER MISSING",
    38: "COMMAND PARAMETER MISSING",
}
_AXIS_ERROR_TEXTS: Final = {
    1: "PARAMETER OUT OF RANGE",
    3: "FOLLOWING ERROR THRESHOLD EXCEEDED",
    4: "POSITIVE HARDWARE LIMIT DETECTED",
    5: "NEGATIVE HARDWARE LIMIT DETECTED",
    6: "POSITIVE SOFTWARE LIMIT DETECTED",
    7: "NEGATIVE SOFTWARE LIMIT DETECTED",
    10: "MAXIMUM VELOCITY EXCEEDED",
    11: "MAXIMUM ACCELERATION EXCEEDED",
    13: "MOTOR NOT ENABLED",
    20: "HOMING ABORTED",
    30: "COMMAND NOT ALLOWED DURING HOMING",
}


class EspError(Exception):
    """A refused command: number of a controller error or of an axis error, depending on where it is raised."""

    def __init__(self, number: int) -> None:
        self.number = number
        super().__init__(str(number))


def error_text(number: int) -> str:
    """Return the text that ``TB?`` answers for a controller error, or axis * 100 + number of an axis error."""
    return _AXIS_ERROR_TEXTS[number % 100] if number >= 100 else _ERROR_TEXTS[number]


@dataclass
class EspAxis(AxisOfController):
    """State of one axis: its mechanics and its settings in the controller."""

    number: int  # Number of the axis, from 1
    model: AxisModel
    motor_on: bool = False
    homing: bool = False
    settings: dict[str, float] = field(default_factory=dict)

    def exchange(self, serial: str, t_s: float) -> None:
        """Replace the stage by another one of this model, and restart the controller."""
        self.model = replace(self.model, serial=serial)
        super().exchange(serial, t_s)

    @property
    def scale(self) -> float:
        """Counts per degree that the controller counts."""
        return self.model.mechanics.counts_per_deg * (1.0 + self.settings.get("CO", 0.0) / 100.0)

    def printed(self, position_deg: float) -> str:
        """Return a position as ``FP`` has it: with so many decimals, or as a power of ten."""
        decimals = int(self.settings.get("FP", 5.0))
        return f"{position_deg:.6E}" if decimals == _AS_POWER else f"{position_deg:.{decimals}f}"


class EspController(Controller):
    """The controller; ``models`` are its axes, from number 1."""

    baud = 19_200
    BOOT_S = 1.0

    def __init__(
        self,
        models: list[AxisModel],
        clock: Callable[[], float],
        publish: Callable[[int, LoadTrajectory], None] = lambda _number, _pointing: None,
    ) -> None:
        self.axes = {
            number: EspAxis(self, Axis(model.mechanics, clock(), partial(publish, number)), number, model)
            for number, model in enumerate(models, start=1)
        }
        super().__init__((axis.axis for axis in self.axes.values()), clock)
        self._stop_pressed = False
        self._power_up()
        self._axis_commands = self._known_axis_commands()

    def _power_up(self) -> None:
        self._buffer = b""
        self._commands: deque[str] = deque()
        self._waiting_for: EspAxis | None = None
        self._errors: deque[int] = deque(maxlen=_QUEUE_LENGTH)
        for axis in self.axes.values():
            axis.motor_on = axis.homing = False
            axis.settings = {
                "VA": axis.model.speed_deg_s,
                "AC": axis.model.acceleration_deg_s2,
                "AG": axis.model.acceleration_deg_s2,
                "OH": _HOME_SPEED_DEG_S,
                "SL": -axis.model.limit_deg,
                "SR": axis.model.limit_deg,
                "VU": _MOST_SPEED_DEG_S,
                "AU": _MOST_ACCELERATION_DEG_S2,
                "SN": 7.0,
                "SU": 1.0 / axis.model.mechanics.counts_per_deg,
                "TJ": 1.0,
                "SH": 0.0,
                "BA": 0.0,
                "CO": 0.0,
                "FP": 5.0,
            }

    # ------------------------------------------------------------------ the line
    def _answer(self, now: float) -> bytes:
        *lines, self._buffer = self._buffer.replace(b"\n", b"").split(b"\r")
        self._buffer = self._buffer[-_MAX_LINE:]
        for line in lines:
            self._commands.extend(line.decode("ascii", "replace").split(";"))
        return self._run_pending(now)

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. These are answers of commands that had to wait."""
        now = self._clock()
        self.take_events(now)
        return self._run_pending(now)

    def _run_pending(self, now: float) -> bytes:
        """Execute commands in order until one has to wait."""
        answers = ""
        while self._commands:
            if self._waiting_for is not None and self._waiting_for.axis.reports_busy(now):
                break
            self._waiting_for = None
            answer = self._execute(self._commands.popleft(), now)
            answers += "" if answer is None else f"{answer}\r\n"
        return answers.encode("ascii")

    def _execute(self, command: str, now: float) -> str | None:
        if not command.strip():
            return None
        match = _COMMAND.fullmatch(command)
        if match is None:
            self._errors.append(6)
            return None
        number, name, rest = match[1], match[2].upper(), match[3]
        try:
            if name in {"VE", "TB", "ST"} and not number:
                return self._controller_command(name, now)
            return self._axis_command(number, name, rest, now)
        except EspError as error:
            self._errors.append(error.number)
            return None

    # ------------------------------------------------------------------ commands to the controller
    def _controller_command(self, name: str, now: float) -> str | None:
        if name == "VE":
            return "ESP301 Version 3.0.1 6/1/99"
        if name == "TB":
            number = self._errors.popleft() if self._errors else 0
            return f"{number}, {int(now * 1000) % 10_000_000}, {error_text(number)}"
        for each_axis in self.axes.values():
            self._stop(each_axis, now)
        return None

    # ------------------------------------------------------------------ commands to an axis
    def _axis_command(self, number: str, name: str, rest: str, now: float) -> str | None:
        if name not in self._axis_commands and name not in self.axes[1].settings:
            raise EspError(6)
        if not number:
            raise EspError(37)
        if int(number) not in self.axes:
            raise EspError(9)
        esp_axis = self.axes[int(number)]
        try:
            if name in esp_axis.settings:
                return self._setting(esp_axis, name, rest)
            return self._axis_commands[name](esp_axis, rest, now)
        except EspError as error:
            raise EspError(
                error.number if error.number in {4, 38} else esp_axis.number * 100 + error.number
            ) from None

    def _known_axis_commands(self) -> Mapping[str, Callable[[EspAxis, str, float], str | None]]:
        return {
            "ID": lambda esp_axis, _rest, _now: (
                f"{esp_axis.model.name or 'URS75BCC'}, SN{esp_axis.model.serial}"
            ),
            "TP": lambda esp_axis, _rest, now: esp_axis.printed(esp_axis.axis.encoder(now) / esp_axis.scale),
            "MD": lambda esp_axis, _rest, now: str(int(not esp_axis.axis.reports_busy(now))),
            "MO": self._motor_on,
            "MF": self._motor_off,
            "PA": self._move,
            "OR": self._home,
            "DH": self._define_home,
            "ST": lambda esp_axis, _rest, now: self._stop(esp_axis, now),
            "WS": self._wait,
        }

    def _setting(self, axis: EspAxis, name: str, rest: str) -> str | None:
        if rest in {"", "?"}:
            return f"{axis.settings[name]:g}"
        value = _number(rest)
        if name in {"VU", "AU"} and value <= 0.0:
            raise EspError(1)
        if name in {"VA", "OH"} and not 0.0 < value <= axis.settings["VU"]:
            raise EspError(10)
        if name in {"AC", "AG"} and not 0.0 < value <= axis.settings["AU"]:
            raise EspError(11)
        if (
            (name == "SN" and value != 7.0)
            or (name == "SL" and value > 0.0)
            or (name == "SR" and value < 0.0)
        ):
            raise EspError(1)
        axis.settings[name] = value
        return None

    def _motor_on(self, axis: EspAxis, rest: str, _now: float) -> str | None:
        if rest == "?":
            return str(int(axis.motor_on))
        if self._stop_pressed:
            raise EspError(4)
        axis.motor_on = True
        return None

    def _motor_off(self, axis: EspAxis, rest: str, now: float) -> str | None:
        if rest == "?":
            return str(int(not axis.motor_on))
        if axis.axis.busy(now):
            axis.axis.halt(now)
        axis.motor_on = False
        return None

    def _move(self, axis: EspAxis, rest: str, now: float) -> None:
        scale, target = axis.scale, _number(rest)
        self._require_motion_allowed(axis)
        if target > axis.settings["SR"]:
            raise EspError(6)
        if target < axis.settings["SL"]:
            raise EspError(7)
        if axis.settings["TJ"] < _FOLLOWS_ANOTHER:
            speed, acceleration = axis.settings["VA"] * scale, axis.settings["AC"] * scale
            axis.axis.move_to(float(round(target * scale)), now, speed, acceleration)

    def _home(self, axis: EspAxis, rest: str, now: float) -> None:
        if rest not in {"", "0", "1", "2", "3", "4"}:
            raise EspError(1)
        self._require_motion_allowed(axis)
        scale = axis.scale
        speed = axis.settings["OH"] * scale
        axis.homing = True
        axis.axis.home(now, speed, speed / 10.0, axis.settings["AC"] * scale)

    def _require_motion_allowed(self, axis: EspAxis) -> None:
        if not axis.motor_on:
            raise EspError(13)
        if axis.homing:
            raise EspError(30)

    def _define_home(self, axis: EspAxis, rest: str, now: float) -> None:
        value = (_number(rest) if rest else 0.0) * axis.scale
        axis.axis.set_counter(value, now)
        axis.axis.set_encoder(value, now)

    def _stop(self, axis: EspAxis, now: float) -> None:
        if axis.axis.busy(now):
            axis.axis.stop(now, axis.settings["AG"] * axis.scale)
        if axis.homing:
            axis.homing = False
            self._errors.append(axis.number * 100 + 20)

    def _wait(self, axis: EspAxis, _rest: str, _now: float) -> None:
        self._waiting_for = axis

    # ------------------------------------------------------------------ events outside the protocol
    def take_events(self, t_s: float) -> None:
        """See `Unit.take_events`. A homing that has ended is no longer one, and counts from ``SH``."""
        for axis in self.axes.values():
            if axis.homing and not axis.axis.busy(t_s):
                axis.homing = False
                if axis.axis.referenced(t_s):
                    for assign in (axis.axis.set_counter, axis.axis.set_encoder):
                        assign(axis.settings["SH"] * axis.scale, t_s)
        super().take_events(t_s)

    def _notice(self, axis: Axis, event: MotionEvent, t_s: float) -> None:
        (esp_axis,) = (esp_axis for esp_axis in self.axes.values() if esp_axis.axis is axis)
        esp_axis.motor_on = False
        limit = 4 if axis.counter(t_s) > 0.0 else 5
        self._errors.append(esp_axis.number * 100 + (limit if event.kind == "limit" else 3))

    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """Press the emergency stop, which switches all motors off, or release it; the motors then stay off."""
        self._stop_pressed = not released
        if released:
            return
        self._errors.append(4)
        for axis in self.axes.values():
            axis.axis.halt(t_s)
            axis.motor_on = axis.homing = False


def _number(text: str) -> float:
    if not text:
        raise EspError(38)
    if not _NUMBER.fullmatch(text):
        raise EspError(1)
    return float(text)
