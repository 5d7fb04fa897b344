"""A simulated FLIR (Directed Perception) E series pan-tilt unit with the axes pan and tilt.

    PP1000 SP        a command; blank, CR or LF end it
    PP1000 * CR LF   its answer: the command as an echo (EE), ``*`` for done or ``!`` and a reason
    PP SP            a query; verbose (FV) ``PP * Current Pan position is 1000``, terse (FT) ``PP * 1000``

There is no checksum and no message id. A limit switch prints ``!P`` or ``!T`` without a line end. A reset (``R``,
``RP``, ``RT``) is answered when it has ended; commands wait meanwhile, ``H`` does not. At power-up echo and verbose
answers are on, and nothing is calibrated (as after ``RD``). The unit counts steps and has no encoder.

Modes that survive a client: in pure velocity control (``CV``) a speed is a motion, to the end of the travel, and ``CI``
ends it; in slaved mode (``S``) a move waits for ``A`` or for ``I``; a step mode (``WPQ``) is in force after the next
reset. A unit with `before_reset` knows neither scale nor limits until its first reset, as a PTU-E46 does.

Reference: FLIR, "E Series Pan-Tilt Command Reference Manual", and the D46 and D300 user's manuals, section 4. What
``H`` does in a reset, the banner, and the wording of rare answers were written without a unit at hand.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from simulators.stages.axis_motion import Axis, AxisModel, AxisOfController, Controller, MotionEvent
from simulators.world.trajectory import LoadTrajectory

_COMMAND: Final = re.compile(r"([A-Z]+?)(-?\d+)?")
_MAX_LINE: Final = 64  # Commands have some characters
_NAMES: Final = {"P": "Pan", "T": "Tilt"}
_BASE_SPEED: Final = 57  # The default of a D300 (its manual, 4.4.5); a D46 has 1000
_MOST_SPEED_DEG_S: Final = 100.0
_LARGEST: Final = 10**9
_STEPS: Final = {"F": 0.5, "H": 1.0, "Q": 2.0, "E": 4.0, "A": 4.0}
"""Positions in each step mode for one in half steps; automatic steps count as the finest."""


_TOLD: Final = {
    "P": "Current {} position is {}",
    "O": "Target {} position is {}",
    "D": "Current {} speed is {} positions/sec",
    "S": "Target {} speed is {} positions/sec",
    "A": "{} acceleration is {} positions/sec^2",
    "B": "{} base speed is {} positions/sec",
    "U": "Maximum {} speed is {} positions/sec",
    "L": "Minimum {} speed is {} positions/sec",
    "N": "Minimum {} position is {}",
    "X": "Maximum {} position is {}",
    "NU": "Minimum {} position is {}",
    "XU": "Maximum {} position is {}",
    "R": "{1} seconds arc per position",
}
"""Verbose answers, with the axis's name and the value, by the letters after the axis's letter."""


class _PtuError(Exception):
    """A refused command, with the text after the exclamation mark."""


@dataclass
class PtuAxis(AxisOfController):
    """State of one axis."""

    letter: str
    model: AxisModel  # A count is a position of the unit; a reset finds the limits
    settings: dict[str, int] = field(default_factory=dict)  # Values by the letters after the axis's letter
    factor: float = 1.0  # Positions for one count of the model
    chosen: str = "H"  # Step mode that the next reset brings into force
    waiting: int | None = None  # Target that waits in slaved mode

    def power_up(self) -> None:
        """Set the settings of a power-up."""
        scale = self.model.mechanics.counts_per_deg
        self.settings = {
            "S": round(self.model.speed_deg_s * scale),
            "A": round(self.model.acceleration_deg_s2 * scale),
            "B": _BASE_SPEED,
            "U": round(_MOST_SPEED_DEG_S * scale),
            "L": 0,
        }
        self.waiting = None
        self.count_in("H")

    def count_in(self, mode: str) -> None:
        """Bring a step mode into force, with the limits in its positions."""
        self.factor = _STEPS[mode]
        self.chosen = mode
        end = round(self.model.limit_deg * self.model.mechanics.counts_per_deg * self.factor)
        self.settings |= {"N": -end, "X": end, "NU": -end, "XU": end}


class PtuController(Controller):
    """The unit; ``serial`` is the answer to ``VS``."""

    baud = 9600
    BOOT_S = 2.0

    def __init__(
        self,
        models: dict[str, AxisModel],
        serial: str,
        clock: Callable[[], float],
        publish: Callable[[str, LoadTrajectory], None] = lambda _letter, _pointing: None,
    ) -> None:
        self.axes = {
            letter: PtuAxis(self, Axis(model.mechanics, clock(), partial(publish, letter)), letter, model)
            for letter, model in models.items()
        }
        super().__init__((axis.axis for axis in self.axes.values()), clock)
        self.serial = serial
        self.before_reset = False
        self._power_up()
        self._banner = b""

    def _power_up(self) -> None:
        self._buffer = b""
        self._banner = b"### Pan-Tilt Controller ###\r\n"
        self._waiting: deque[str] = deque()
        self._resetting: list[PtuAxis] = []
        self._pending = b""
        self._echo = self._verbose = True
        self._limits = "factory"
        self._by_speed = self._slaved = False
        for axis in self.axes.values():
            axis.power_up()

    # ------------------------------------------------------------------ the line
    def _answer(self, now: float) -> bytes:
        *commands, rest = re.split(r"[ \r\n]", self._buffer.decode("ascii", "replace"))
        self._buffer = rest[-_MAX_LINE:].encode("ascii", "replace")
        if "H" in map(str.upper, commands) and self._resetting:
            self._waiting.clear()
            self._resetting = []
        self._waiting.extend(command for command in commands if command)
        return self._run(now)

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. These are limit switches, ends of resets, and the banner."""
        now = self._clock()
        self.take_events(now)
        if not self.awake(now):
            return b""
        banner, self._banner = self._banner, b""
        return banner + self._run(now)

    def _run(self, now: float) -> bytes:
        answers, self._pending = self._pending, b""
        while True:
            if self._resetting:
                if any(axis.axis.reports_busy(now) for axis in self._resetting):
                    break
                self.before_reset = False
                for ptu_axis in self._resetting:
                    if _STEPS[ptu_axis.chosen] != ptu_axis.factor:
                        ptu_axis.count_in(ptu_axis.chosen)
                hits = "".join(f"!{axis.letter}!{axis.letter}" for axis in reversed(self._resetting))
                answers += f"{hits}*\r\n".encode("ascii", "replace")
                self._resetting = []
            if not self._waiting:
                break
            answers += self._execute(self._waiting.popleft(), now)
        return answers

    def _execute(self, command: str, now: float) -> bytes:
        echo = f"{command} " if self._echo else ""
        try:
            answer = self._said(command.upper(), now)
        except _PtuError as error:
            answer = f"! {error}"
        end = "" if self._resetting else "\r\n"
        return f"{echo}{answer}{end}".encode("ascii", "replace")

    # ------------------------------------------------------------------ commands
    def _said(self, command: str, now: float) -> str:
        if command in {"EE", "ED", "FV", "FT", "LE", "LD", "LU"}:
            return self._set_mode(command)
        if command in {"CI", "CV", "I", "S", "A"} or command in self._step_modes:
            return self._set_control(command, now)
        if command in {"R", "RP", "RT"}:
            return self._reset(command, now)
        if command == "H":
            return self._halt(now)
        answers = {
            "V": "Pan-Tilt Controller v3.1.2(C17/E), (C)1991-2014 FLIR Commercial Systems, Inc., All Rights Reserved",
            "VS": self.serial,
            "E": "Echoing ON" if self._echo else "Echoing OFF",
            "F": "ASCII verbose mode" if self._verbose else "ASCII terse mode",
            "L": f"Limit bounds are {'DISABLED' if self._limits == 'off' else 'ENABLED'} ({self._limits} limits)",
            "C": f"PTU is in {'pure velocity' if self._by_speed else 'independent'} speed control mode",
        }
        if command in answers:
            return f"* {answers[command]}"
        match = _COMMAND.fullmatch(command)
        if match is None or match[1][0] not in self.axes or len(match[1]) < 2:
            raise _PtuError("Illegal command entered")
        value = None if match[2] is None else int(match[2])
        if value is not None and abs(value) > _LARGEST:
            raise _PtuError("Illegal command argument")
        return self._axis_command(self.axes[match[1][0]], match[1][1:], value, now)

    def _set_mode(self, command: str) -> str:
        if command[0] == "E":
            self._echo = command == "EE"
        elif command[0] == "F":
            self._verbose = command == "FV"
        else:
            self._limits = {"E": "factory", "D": "off", "U": "user"}[command[1]]
        return "*"

    @property
    def _step_modes(self) -> set[str]:
        return {f"W{letter}{mode}" for letter in self.axes for mode in _STEPS}

    def _set_control(self, command: str, now: float) -> str:
        if command[0] == "W":
            self.axes[command[1]].chosen = command[2:]
            return "*"
        if command[0] == "C":
            self._by_speed = command == "CV"
            return "*"
        self._slaved = command == "S" or (command == "A" and self._slaved)
        for axis in self.axes.values():
            if command in {"I", "A"} and axis.waiting is not None:
                self._move_at_once(axis, axis.waiting, axis.settings["S"], now)
                axis.waiting = None
        return "*"

    def _axis_command(self, axis: PtuAxis, name: str, value: int | None, now: float) -> str:
        axis_name = _NAMES[axis.letter]
        if name == "P" and value is not None:
            return self._move(axis, value, now)
        if name == "S" and value is not None and self._by_speed:
            return self._run_at(axis, value, now)
        if name in axis.settings and value is not None:
            return self._set(axis, name, value)
        if value is not None:
            raise _PtuError("Illegal command argument")
        speed = axis.axis.velocity(now) * axis.factor
        read: dict[str, Callable[[], int | str]] = {
            "P": lambda: self._position(axis, now),
            "O": lambda: round(axis.axis.rest_counter(now) * axis.factor),
            "D": lambda: self._speed(axis, speed, now),
            "R": lambda: f"{3600.0 / axis.model.mechanics.counts_per_deg / axis.factor:.6f}",
        }
        if name not in _TOLD:
            raise _PtuError("Illegal command entered")
        if self.before_reset and name in {"R", "N", "X", "NU", "XU"}:
            return "* 0"
        value_now = read[name]() if name in read else axis.settings[name]
        if not self._verbose:
            return f"* {value_now}"
        return f"* {_TOLD[name].format(axis_name, value_now)}"

    def _position(self, axis: PtuAxis, now: float) -> int:
        return round(axis.axis.counter(now) * axis.factor)

    def _run_at(self, axis: PtuAxis, speed: int, now: float) -> str:
        """Run to the end of the travel at a speed; at 0, stop."""
        if speed:
            end = self._range(axis)[speed > 0]
            self._move_at_once(axis, end, abs(speed), now)
        elif axis.axis.busy(now):
            axis.axis.stop(now, axis.settings["A"] / axis.factor)
        return "*"

    def _speed(self, axis: PtuAxis, speed: float, now: float) -> int:
        """Return the present speed, which is 0 only at rest."""
        if not axis.axis.reports_busy(now):
            return 0
        return round(speed) or axis.settings["B"]

    def _set(self, axis: PtuAxis, name: str, value: int) -> str:
        if name in {"N", "X"}:
            raise _PtuError("Illegal command argument")
        if name == "S" and value > axis.settings["U"]:
            raise _PtuError(f"{_NAMES[axis.letter]} speed cannot exceed {axis.settings['U']} pos/sec")
        if name in {"S", "A", "B", "U"} and value <= 0:
            raise _PtuError("Illegal command argument")
        if self.before_reset and name in {"NU", "XU"}:
            raise _PtuError("Axis is not calibrated")
        if (name == "NU" and not axis.settings["N"] <= value <= 0) or (
            name == "XU" and not 0 <= value <= axis.settings["X"]
        ):
            raise _PtuError("User limit is outside of the factory limits")
        axis.settings[name] = value
        return "*"

    def _range(self, axis: PtuAxis) -> tuple[int, int]:
        """Return the positions between which the unit moves."""
        return {
            "factory": (axis.settings["N"], axis.settings["X"]),
            "user": (axis.settings["NU"], axis.settings["XU"]),
            "off": (-_LARGEST, _LARGEST),
        }[self._limits]

    def _move(self, axis: PtuAxis, target: int, now: float) -> str:
        name = _NAMES[axis.letter]
        lowest, highest = self._range(axis)
        if target > highest:
            raise _PtuError(f"Maximum allowable {name} position is {highest}")
        if target < lowest:
            raise _PtuError(f"Minimum allowable {name} position is {lowest}")
        if self._slaved:
            axis.waiting = target
        elif not self._by_speed:
            self._move_at_once(axis, target, axis.settings["S"], now)
        return "*"

    def _move_at_once(self, axis: PtuAxis, target: int, speed: int, now: float) -> None:
        axis.axis.move_to(target / axis.factor, now, speed / axis.factor, axis.settings["A"] / axis.factor)

    def _reset(self, command: str, now: float) -> str:
        self._resetting = [axis for letter, axis in self.axes.items() if command in {"R", f"R{letter}"}]
        for axis in self._resetting:
            speed = 20.0 * axis.model.mechanics.counts_per_deg
            axis.waiting = None
            axis.axis.home(now, speed, speed / 10.0, axis.settings["A"] / axis.factor)
        return ""

    def _halt(self, now: float) -> str:
        for axis in self.axes.values():
            if axis.axis.busy(now):
                axis.axis.stop(now, axis.settings["A"] / axis.factor)
        return "*"

    # ------------------------------------------------------------------ events outside the protocol
    def exchange(self, serial: str, t_s: float) -> None:
        """See `Unit.exchange`."""
        self.serial = serial
        self.restart(t_s)

    def _notice(self, axis: Axis, event: MotionEvent, t_s: float) -> None:
        del event, t_s
        (ptu_axis,) = (ptu_axis for ptu_axis in self.axes.values() if ptu_axis.axis is axis)
        self._pending += f"!{ptu_axis.letter}".encode("ascii", "replace")
