"""The ``$`` commands of a GRBL 1.1 controller, except jogs: lists, settings, check mode, sleep, unlocking.

A part of `simulators.stages.grbl`, which holds the state and moves the axes. Which state allows which command, and with
which error the others answer, was compared with the firmware compiled for a PC.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Literal

from simulators.stages.gcode import GcodeError
from simulators.stages.grbl_planner import format_setting, must_be_positive, parse_setting

State = Literal["Idle", "Run", "Jog", "Home", "Alarm", "Check", "Sleep"]

SOFT_LIMITS, HOMING_ENABLED = 20, 22
_HELP: Final = "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n"
_ZERO: Final = "0.000,0.000,0.000"
_OFFSETS: Final = ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30", "G92")


class Answered(Exception):
    """The line has been answered already."""


class SystemCommands:
    """The commands; `simulators.stages.grbl.GrblController` derives from it."""

    name: str  # Name that a user has given the board by ``$I=``
    settings: dict[int, float]  # Values of the ``$`` settings, by number
    _factory: Mapping[int, float]
    _output: str
    _state: State
    _motion: str
    _distance: str
    _feed: float
    _home: Callable[[], None]
    _reset_state: Callable[[State], None]

    def _system(self, command: str) -> None:
        always = {"": self._help, "$": self._list, "G": self._modes, "C": self._check, "X": self._unlock}
        if command in always:
            always[command]()
            return
        if command[0] in always:
            raise GcodeError(3)
        if self._state not in {"Idle", "Alarm"}:
            raise GcodeError(8)
        at_rest = {
            "#": self._offsets,
            "H": self._home,
            "SLP": self._sleep,
            "I": self._build,
            "N": self._start_lines,
        }
        if command in at_rest:
            at_rest[command]()
        elif command.startswith("I="):
            self.name = command[2:]
        elif command in {"RST=$", "RST=*", "RST=#"}:
            self._restore(only_offsets=command[-1] == "#")
        elif command[0] == "N" and self._state != "Idle":
            raise GcodeError(8)
        elif command in {"N0=", "N1="}:  # start-up lines with content are not simulated
            return
        elif command[0] in "#HSIR":
            raise GcodeError(3)
        else:
            self._set(command)

    def _help(self) -> None:
        self._output += _HELP

    def _offsets(self) -> None:
        """List the work offsets; they are all zero."""
        self._output += "".join(f"[{name}:{_ZERO}]\r\n" for name in _OFFSETS)
        self._output += f"[TLO:0.000]\r\n[PRB:{_ZERO}:0]\r\n"

    def _start_lines(self) -> None:
        self._output += "$N0=\r\n$N1=\r\n"

    def _build(self) -> None:
        self._output += f"[VER:1.1h.20190830:{self.name}]\r\n[OPT:V,15,128]\r\n"

    def _modes(self) -> None:
        modes = f"{self._motion} G54 G17 G21 {self._distance} G94 M5 M9 T0 F{self._feed:g} S0"
        self._output += f"[GC:{modes}]\r\n"

    def _list(self) -> None:
        if self._state == "Run":
            raise GcodeError(8)
        self._output += "".join(
            f"${number}={format_setting(number, value)}\r\n" for number, value in self.settings.items()
        )

    def _unlock(self) -> None:
        if self._state == "Alarm":
            self._state = "Idle"
            self._output += "[MSG:Caution: Unlocked]\r\n"

    def _check(self) -> None:
        """Begin to check lines without motion; the same command ends this by a restart."""
        if self._state == "Check":
            self._output += "[MSG:Disabled]\r\nok\r\n"
            self._reset_state("Idle")
            raise Answered
        if self._state != "Idle":
            raise GcodeError(8)
        self._state = "Check"
        self._output += "[MSG:Enabled]\r\n"

    def _sleep(self) -> None:
        """Serve nothing but status reports, until a reset."""
        self._state = "Sleep"
        self._output += "ok\r\n[MSG:Sleeping]\r\n"

    def _restore(self, *, only_offsets: bool) -> None:
        if not only_offsets:
            self.settings.update(self._factory)
        self._output += "[MSG:Restoring defaults]\r\nok\r\n"
        self._reset_state(self._state)
        raise Answered

    def _set(self, command: str) -> None:
        number, value = parse_setting(command)
        # The firmware accepts a scale, speed or acceleration of zero, and is unusable afterwards.
        if value < 0.0 or (value == 0.0 and must_be_positive(number)):
            raise GcodeError(4)
        if number not in self.settings:
            raise GcodeError(3)
        if number == SOFT_LIMITS and value and not self.settings[HOMING_ENABLED]:
            raise GcodeError(10)
        self.settings[number] = value
        if number == HOMING_ENABLED and not value:
            self.settings[SOFT_LIMITS] = 0.0
