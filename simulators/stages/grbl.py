"""A simulated GRBL 1.1 controller of a home-built gimbal: X is pan, Y is tilt, Z is roll; one unit is one degree.

The module handles lines with their ``ok`` or ``error:n``, real-time bytes that act before all queued lines,
states, alarms, settings and homing. There is no encoder, and a stall goes unnoticed. `gcode` parses blocks;
`grbl_planner` moves the axes together.

Source: the GRBL 1.1h firmware and its wiki pages "Interface", "Commands" and "Configuration"; answers were
compared line by line with the firmware compiled for a PC. Homing was written from the documents alone.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Mapping
from typing import Final, Literal, NamedTuple

from simulators.stages.axis_motion import Axis, AxisModel, MotionEvent, Unit
from simulators.stages.gcode import Block, GcodeError, parse_block, strip_line
from simulators.stages.grbl_planner import (
    Motion,
    Planner,
    factory_settings,
    format_setting,
    must_be_positive,
    parse_setting,
)
from simulators.world.trajectory import LoadTrajectory

State = Literal["Idle", "Run", "Jog", "Home", "Alarm", "Check", "Sleep"]

SOFT_LIMITS, HOMING_ENABLED = 20, 22  # Numbers of GRBL's settings
_HELP: Final = "[HLP:$$ $I $N $x=val $Nx=line $J=line $SLP $C $X $H ? ctrl-x]\r\n"
_RESET_BYTE: Final = 0x18  # Ctrl-X
_LOCKED: Final = "[MSG:'$H'|'$X' to unlock]\r\n"
_MAX_LINE: Final = 79  # The firmware's buffer of 80 with its end
_PAUSE_S: Final = 0.5
"""After it has told an alarm, the firmware waits for this time, s. What it receives meanwhile is lost."""

#: Fields that only some status reports contain, by the number of the report modulo ten.
_EXTRA_FIELDS: Final = {0: "|WCO:0.000,0.000,0.000", 1: "|Ov:100,100,100"}


class Firmware(NamedTuple):
    """What differs between the firmwares of the family."""

    welcome: str
    build: str  # Answer to ``$I``, with the name of the board
    read_only: range = range(0)  # Settings that only a file on the board changes


#: The firmwares by name; ``fork`` is one that nobody knows.
FIRMWARES: Final[Mapping[str, Firmware]] = {
    "grbl": Firmware("Grbl 1.1h ['$' for help]", "[VER:1.1h.20190830:{}]\r\n[OPT:V,15,128]\r\n"),
    "grblhal": Firmware(
        "GrblHAL 1.1f ['$' or '$HELP' for help]",
        "[VER:1.1f.20230912:{}]\r\n[OPT:VNMHSL,35,1024,3,0]\r\n[FIRMWARE:grblHAL]\r\n",
    ),
    "fluidnc": Firmware(
        "Grbl 3.7 [FluidNC v3.7.17 (wifi) '$' for help]",
        "[VER:3.7 FluidNC v3.7.17 (esp32-wifi) :{}]\r\n[OPT:PHS]\r\n",
        range(20, 133),
    ),
    "fork": Firmware("Machine 2 ['$' for help]", "[VER:2.0.1:{}]\r\n[OPT:V]\r\n"),
}


class _Pause(NamedTuple):
    """The wait after an alarm."""

    until_s: float  # Its end, s
    then: str
    restarts: bool  # Whether it restarts then; otherwise it waits for a reset


class GrblController(Unit):
    """The controller of the axes X, Y and Z; homing ends ``pull_off_deg`` from the switch."""

    baud = 115_200

    def __init__(
        self,
        models: Mapping[str, AxisModel],
        clock: Callable[[], float],
        publish: Callable[[str, LoadTrajectory], None] = lambda _letter, _pointing: None,
        pull_off_deg: float = 1.0,
    ) -> None:
        self._clock = clock
        self.name = ""
        self.firmware = FIRMWARES["grbl"]
        self._factory = factory_settings(models, pull_off_deg)
        self.settings = dict(self._factory)
        self._planner = Planner(models, self.settings, clock(), publish)
        self.axes: Mapping[str, Axis] = self._planner.axes
        """Its axes, by letter."""
        super().__init__(self.axes.values(), clock())
        self._letters = "".join(models)
        self._in_reset = False
        self._reports = 0
        self._output = ""
        self._reset_state("Alarm" if self.settings[HOMING_ENABLED] else "Idle")
        self._real_time: Mapping[int, Callable[[], None]] = {
            ord("?"): self._report,
            _RESET_BYTE: self._reset,
            0x85: self._cancel_jog,
        }

    def _reset_state(self, state: State) -> None:
        """Set the state after a reset."""
        self._line = ""
        self._pending_lines: deque[str] = deque()
        self._planner.forget()
        self._state: State = state
        self._must_reset = self._owes_ok = False
        self._pause: _Pause | None = None
        self._motion, self._distance, self._feed = "G0", "G90", 0.0
        self._output += f"\r\n{self.firmware.welcome}\r\n" + (_LOCKED if state == "Alarm" else "")

    # ------------------------------------------------------------------ the line
    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`. Real-time bytes act at once, lines in their order."""
        self._advance()
        for byte in data if not (self._in_reset or self._pause) else b"":
            if byte in self._real_time:
                # After ALARM:1 or 2 the firmware waits in a loop that serves nothing but a reset, not even ?.
                if not self._must_reset or byte == _RESET_BYTE:
                    self._real_time[byte]()
            elif byte in b"\r\n":
                self._pending_lines.append(self._line)
                self._line = ""
            elif 0x20 <= byte < 0x7F:
                self._line += chr(byte)
            self._take_lines()
        return self._take_output()

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. These are late ``ok``, alarms and the welcome message."""
        self._advance()
        return self._take_output()

    def _take_output(self) -> bytes:
        output, self._output = self._output, ""
        return output.encode("ascii")

    def _take_lines(self) -> None:
        """Execute lines in order until one has to wait; none is executed while a reset is due."""
        while self._pending_lines and not self._waiting() and not self._must_reset:
            line = self._pending_lines.popleft().strip()
            # Grbl skips slashes; FluidNC has paths of its configuration file.
            if not (self.firmware.read_only and line.startswith("$/")):
                line = strip_line(line)
            try:
                self._execute(line)
            except GcodeError as error:
                self._output += f"{error}\r\n"
            else:
                if not self._waiting() and not self._must_reset:
                    self._output += "ok\r\n"

    def _waiting(self) -> bool:
        return self._state in {"Home", "Sleep"} or self._pause is not None

    # ------------------------------------------------------------------ lines
    def _execute(self, line: str) -> None:
        if len(line) > _MAX_LINE:
            raise GcodeError(11)
        if not line:
            return
        if line.startswith("$J"):
            self._jog(line[2:])
        elif line.startswith("$"):
            self._system(line[1:])
        elif self._state in {"Alarm", "Jog"}:
            raise GcodeError(9)
        else:
            self._block(parse_block(line, self._letters))

    def _home(self) -> None:
        if not self.settings[HOMING_ENABLED]:
            raise GcodeError(5)
        self._state = "Home"
        self._planner.home(self._clock())

    def _block(self, block: Block) -> None:
        motion, feed = block.motion or self._motion, self._feed if block.feed is None else block.feed
        if motion == "G1" and not feed and block.targets:
            raise GcodeError(22)
        self._motion, self._feed = motion, feed
        self._distance = block.distance or self._distance
        if self._state == "Check":
            return
        if block.targets:
            relative = self._distance == "G91" and not block.machine_coordinates
            targets = self._targets(block, relative=relative)
            if self.settings[SOFT_LIMITS] and not self._planner.inside(targets):
                self._alarm(2)
                self._owes_ok = True
                return
            self._planner.add(Motion(targets, self._feed if self._motion == "G1" else None), self._clock())
            self._state = "Run"

    def _jog(self, command: str) -> None:
        if self._state not in {"Idle", "Jog"}:
            raise GcodeError(8)
        if not command.startswith("="):
            raise GcodeError(3)
        block = parse_block(command[1:], self._letters)
        if block.motion:
            raise GcodeError(16)
        if not block.feed:
            raise GcodeError(22)
        if block.targets:
            targets = self._targets(block, relative=(block.distance or self._distance) == "G91")
        else:  # the firmware takes missing axes of a jog as zeros if all are missing
            targets = dict.fromkeys(self._letters, 0.0)
        if self.settings[SOFT_LIMITS] and not self._planner.inside(targets):
            raise GcodeError(15)
        self._planner.add(Motion(targets, block.feed), self._clock())
        self._state = "Jog"

    def _targets(self, block: Block, *, relative: bool) -> dict[str, float]:
        """Return the targets of a block; relative ones start where all earlier motions end."""
        targets = self._planner.final_target(self._clock())
        for letter, value in block.targets.items():
            targets[letter] = value + (targets[letter] if relative else 0.0)
        return targets

    # ------------------------------------------------------------------ commands that begin with $
    def _system(self, command: str) -> None:
        always: dict[str, Callable[[], None]] = {
            "": lambda: self._say(_HELP),
            "$": self._list,
            "C": self._check,
            "X": self._unlock,
        }
        if command in always:
            always[command]()
            return
        if command[0] in always:
            raise GcodeError(3)
        if self._state not in {"Idle", "Alarm"}:
            raise GcodeError(8)
        at_rest: dict[str, Callable[[], None]] = {
            "H": self._home,
            "SLP": self._sleep,
            "I": lambda: self._say(self.firmware.build.format(self.name)),
            "N": lambda: self._say("$N0=\r\n$N1=\r\n"),
        }
        if command in at_rest:
            at_rest[command]()
        elif command.startswith("I="):
            self.name = command[2:]
        elif command[0] == "N" and self._state != "Idle":
            raise GcodeError(8)
        elif command in {"N0=", "N1="}:  # start-up lines with content are not simulated
            return
        elif command[0] in "HSI":
            raise GcodeError(3)
        elif command[0] == "/":
            self._configured(command)
        else:
            self._set(command)

    def _configured(self, path: str) -> None:
        """Answer what the configuration file of a FluidNC board says of homing."""
        match = re.fullmatch(r"/axes/([a-z])/homing/(cycle|positive_direction)", path)
        if match is None or match[1].upper() not in self._letters:
            raise GcodeError(3)
        upwards = not int(self.settings[23]) >> self._letters.index(match[1].upper()) & 1
        self._output += f"${path}={'1' if match[2] == 'cycle' else str(upwards).lower()}\r\n"

    def _say(self, text: str) -> None:
        self._output += text

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
        """Enter check mode: until a reset, lines are checked and nothing moves."""
        if self._state != "Idle":
            raise GcodeError(8)
        self._state = "Check"
        self._output += "[MSG:Enabled]\r\n"

    def _sleep(self) -> None:
        """Serve nothing but status reports, until a reset."""
        self._state = "Sleep"
        self._output += "ok\r\n[MSG:Sleeping]\r\n"

    def _set(self, command: str) -> None:
        number, value = parse_setting(command)
        # The firmware accepts a scale, speed or acceleration of zero, and is unusable afterwards.
        if value < 0.0 or (value == 0.0 and must_be_positive(number)):
            raise GcodeError(4)
        if number not in self.settings:
            raise GcodeError(3)
        if number in self.firmware.read_only:
            raise GcodeError(162)
        if number == SOFT_LIMITS and value and not self.settings[HOMING_ENABLED]:
            raise GcodeError(10)
        self.settings[number] = value
        if number == HOMING_ENABLED and not value:
            self.settings[SOFT_LIMITS] = 0.0

    # ------------------------------------------------------------------ progress in time
    def _advance(self) -> None:
        """Process everything that has happened since the last call."""
        now = self._clock()
        if self._pause is not None and now >= self._pause.until_s:
            self._output += self._pause.then
            restarts, self._pause = self._pause.restarts, None
            if restarts:
                self._reset_state("Alarm")
        self.take_events(now)
        self._planner.go_on(now)
        if self._state == "Home" and not self._planner.moving(now):
            self._finish_homing(now)
        if self._state in {"Run", "Jog"} and self._planner.done(now):
            self._state = "Idle"
        self._take_lines()

    def _finish_homing(self, now: float) -> None:
        if self._planner.homed(now):
            self._state = "Idle"
            self._output += "ok\r\n"
        else:
            self._planner.forget()
            self._restart_after_alarm(9, "ok\r\n")

    def _alarm(self, number: int) -> None:
        """Tell an alarm of a limit; the board then waits for a reset."""
        self._planner.forget()
        self._state, self._must_reset = "Alarm", True
        self._output += f"ALARM:{number}\r\n"
        self._pause = _Pause(self._clock() + _PAUSE_S, "[MSG:Reset to continue]\r\n", restarts=False)

    def _restart_after_alarm(self, number: int, then: str) -> None:
        """Tell any other alarm. A homing that failed is answered by ``ok`` all the same."""
        self._state = "Alarm"
        self._output += f"ALARM:{number}\r\n"
        self._pause = _Pause(self._clock() + _PAUSE_S, then, restarts=True)

    # ------------------------------------------------------------------ real-time bytes
    def _report(self) -> None:
        now = self._clock()
        state = "Idle" if self._planner.reports_false_idle(now) else self._state
        position = ",".join(f"{value:.3f}" for value in self._planner.position(now))
        extra = _EXTRA_FIELDS.get(self._reports % 10, "")
        self._reports += 1
        self._output += f"<{state}|MPos:{position}|FS:{self._planner.feed(now):.0f},0{extra}>\r\n"

    def _cancel_jog(self) -> None:
        if self._state == "Jog":
            self._planner.cancel(self._clock())

    def _reset(self) -> None:
        """Execute a soft reset: harmless at rest; in motion, steps and therefore the position are lost."""
        now = self._clock()
        if self._planner.moving(now):
            homing = self._state == "Home"
            self._planner.halt(now)
            self._restart_after_alarm(6 if homing else 3, "ok\r\n" if homing else "")
            return
        if self._owes_ok:
            self._output += "ok\r\n"
        self._reset_state("Alarm" if self._state in {"Alarm", "Sleep"} else "Idle")

    # ------------------------------------------------------------------ events outside the protocol
    def _notice(self, axis: Axis, event: MotionEvent, t_s: float) -> None:
        del axis, event
        self._planner.halt(t_s)
        self._alarm(1)

    def _power_up(self) -> None:
        self._reset_state("Alarm" if self.settings[HOMING_ENABLED] else "Idle")

    def exchange(self, serial: str, t_s: float) -> None:
        """See `Unit.exchange`. GRBL has no serial number, but a name that a user gives it by ``$I=``."""
        self.name = serial
        self.settings.clear()
        self.settings.update(self._factory)
        self.restart(t_s)

    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """Hold the board in reset, as a stop button on its reset pin does, or release it."""
        self._in_reset = not released
        if released:
            self._reset_state("Alarm")
        else:
            self._planner.halt(t_s)
            self._state = "Alarm"
            self._output = ""
