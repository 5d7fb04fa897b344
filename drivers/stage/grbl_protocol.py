"""Read the lines of Grbl 1.1 and its descendants: reports, replies, alarms, greetings. Sends nothing.

The descendants share Grbl's lines, but each has alarms and errors of its own: a number is told by the firmware that
sent it, and a number that is not known here is told as unknown.

Source: "Grbl v1.1 Interface", https://github.com/gnea/grbl/tree/master/doc/markdown; grblHAL ``alarms.h``, ``errors.h``
and ``report.c``, https://github.com/grblHAL/core; FluidNC ``Alarm.h``, ``Error.h`` and ``Report.cpp``,
https://github.com/bdring/FluidNC.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from drivers.errors import ReplyGarbled

READY_STATES = frozenset({"Idle", "Jog"})
BLOCKING_STATES = {
    "Run": "runs a program of another sender",
    "Hold": "held",
    "Door": "the safety door is open",
    "Alarm": "in alarm",
    "Home": "searching the reference",
    "Check": "in check mode: nothing moves",
    "Sleep": "asleep",
    "Tool": "waits for a change of a tool",
    "Starting": "starting",
}
"""Meanings of the states in which the driver must not start a move."""
MOVING_STATES = frozenset({"Jog", "Run", "Home"})
_MOVING_SUBSTATES = frozenset({("Hold", 1), ("Door", 2), ("Door", 3), ("Door", 4)})

_ALARMS = {
    1: "limit switch hit; position lost",
    2: "target beyond the soft limits",
    3: "reset while moving; position lost",
    4: "probe failed",
    5: "probe failed",
    6: "homing was reset",
    7: "safety door opened while homing",
    8: "homing could not leave the limit switch",
    9: "homing did not find the limit switch",
}
"""Alarms that all descendants have from Grbl."""

_ERRORS = {
    2: "bad number",
    3: "unknown $ command",
    5: "homing is not enabled ($22)",
    8: "not idle",
    9: "locked by an alarm or a jog",
    10: "soft limits need homing",
    11: "line too long",
    12: "step rate too high",
    13: "the safety door is open",
    15: "jog target beyond the travel",
    16: "bad jog command",
    20: "unsupported command",
    22: "no feed rate",
}
"""Errors that all descendants have from Grbl."""

READ_ONLY = 162
"""Error of FluidNC for a setting that its configuration file holds."""
_UNNUMBERED = -1
"""Code of an error that a firmware tells in words only."""
_NUMBERED = {"Read-only setting": READ_ONLY}
"""Codes of the errors in words that the driver must know."""
_REPORT = re.compile(rb"<([A-Z][A-Za-z]+)(?::(\d{1,3}))?((?:\|[^|:<>]+(?::[^|<>]*)?)+)>\r*\n")
_NUMBER = r"-?\d+\.\d+"
_MACHINE = re.compile(rf"\|MPos:({_NUMBER}(?:,{_NUMBER})*)(?:\||$)")
_SETTING = re.compile(rb"\$(\d+)=(-?\d+(?:\.\d*)?)(?: *\(.*\))?\r*\n")
_BUILD = re.compile(rb"\[VER: *([^:\]]*)(?::([^\]]*))?\]\r*\n")
_AXES = re.compile(rb"\[AXS:(\d+):([A-Z]+)\]\r*\n")
LETTERS = "XYZABC"
"""Letters of the axes, in their order, of a board that does not tell them."""
_START_UP = re.compile(rb"\$N\d+=(.*?)\r*\n")
_AXIS_WORD = re.compile(r"[ABCUVWXYZ][-+.\d#\[]", re.IGNORECASE)
_GREETING = re.compile(rb"grbl|fluidnc|for help\]|rst:0x|brownout", re.IGNORECASE)
_MESSAGE_AT_START = re.compile(rb"\[MSG:INFO: FluidNC v\d")
_ALARM = re.compile(rb"ALARM:? *(\d{1,3})?")


class Response(NamedTuple):
    """The last line of a reply."""

    code: int  # 0 for ``ok``, else the number of an error; negative for one that has words only
    words: str = ""  # The firmware's own words, if it tells its errors in words


OK = Response(0)


@dataclass(frozen=True)
class Firmware:
    """What the driver knows of one firmware."""

    name: str
    alarms: Mapping[int, str] = field(default_factory=dict)  # Meanings of its own alarms, by number
    errors: Mapping[int, str] = field(default_factory=dict)  # Meanings of its own errors, by number
    halting_alarms: frozenset[int] = frozenset({1, 2})  # After these it takes nothing but a reset

    def alarm(self, number: int) -> str:
        """Return number and meaning of an alarm; 0 stands for an alarm without a number."""
        if not number:
            return "an alarm without a number"
        meaning = _ALARMS.get(number) or self.alarms.get(number)
        return f"{meaning or f'an alarm that is unknown for {self.name}'} (ALARM:{number})"

    def error(self, response: Response) -> str:
        """Return what an error says: its own words, or the meaning of its number."""
        if response.words:
            return f"'{response.words}'"
        meaning = self.errors.get(response.code) or _ERRORS.get(response.code)
        return f"{meaning or f'an error that is unknown for {self.name}'} (error:{response.code})"


GRBL = Firmware("Grbl 1.1", {10: "homing did not find the second limit switch"})
GRBLHAL = Firmware(
    "grblHAL",
    {
        10: "the emergency stop is pressed",
        11: "homing is required",
        12: "a limit switch is engaged",
        13: "the probe is protected",
        14: "the spindle did not reach its speed",
        15: "homing did not find the second limit switch",
        16: "the self-test at power-up failed",
        17: "a motor driver reports a fault",
        18: "homing is configured wrongly",
        19: "a Modbus device does not answer",
        20: "the input and output expander does not answer",
        21: "the memory of settings failed",
        22: "a buffer ran over",
    },
    {
        18: "reset",
        45: "a limit switch is engaged",
        46: "homing is required",
        49: "the self-test failed",
        50: "the emergency stop is pressed",
        51: "a motor driver reports a fault",
        52: "the value is out of range",
        53: "the setting is disabled",
        55: "homing is configured wrongly",
        79: "not allowed until the cause of the alarm is cleared and the board is reset",
    },
    frozenset({1, 2, 10, 17, 20}),
)
FLUIDNC = Firmware(
    "FluidNC",
    {
        10: "the spindle failed",
        11: "a control or limit input was active at the start",
        12: "homing found a switch that may belong to several axes",
        13: "hard stop",
        14: "homing is required",
        15: "not initialised",
        16: "the input and output expander restarted",
        17: "a program failed",
        18: "the probe hit a limit",
    },
    {
        18: "the configuration file homes no axis",
        40: "a control or limit input was active at the start",
        READ_ONLY: "the setting is read-only; its configuration file holds it",
    },
    frozenset({1, 2, 13}),
)
UNKNOWN = Firmware("this firmware")


@dataclass(frozen=True)
class StatusReport:
    """A status report: state and position of one moment."""

    state: str  # State of the board, such as "Idle"
    substate: int  # Number after the state, as in "Hold:0"; 0 without one
    # Position of each axis in machine coordinates, in the board's unit; empty if the report has none.
    machine_position: tuple[float, ...]

    @property
    def moving(self) -> bool:
        """Whether any axis moves."""
        return self.state in MOVING_STATES or (self.state, self.substate) in _MOVING_SUBSTATES

    def position(self, place: int, where: str) -> float:
        """Return the machine position, in the board's unit, of the axis at a place: 0 for X, 1 for Y ..."""
        if not self.machine_position:
            raise no_position(where)
        if place >= len(self.machine_position):
            raise ReplyGarbled(
                f"the board reports {len(self.machine_position)} axes only.",
                where=where,
                remedy="Check the axis letters in the station file.",
            )
        return self.machine_position[place]


def no_position(where: str) -> ReplyGarbled:
    """Return the error of a report that tells no machine position."""
    return ReplyGarbled(
        "a status report has no machine position ('MPos:').",
        where=where,
        remedy="Set $10=1, so that the board reports it; this needs Grbl 1.1, grblHAL or FluidNC.",
    )


def parse_report(line: bytes) -> StatusReport | None:
    r"""Parse a status report; None for another line.

    >>> parse_report(b"<Idle|MPos:0.000,-1.500,0.000|FS:0,0>\r\n")
    StatusReport(state='Idle', substate=0, machine_position=(0.0, -1.5, 0.0))
    """
    match = _REPORT.fullmatch(line)
    if match is None:
        return None
    place = _MACHINE.search(match[3].decode("latin-1"))
    position = tuple(map(float, place[1].split(","))) if place else ()
    return StatusReport(match[1].decode(), int(match[2] or 0), position)


def parse_response(line: bytes) -> Response | None:
    r"""Parse the last line of a reply, an ``ok`` or an ``error``; None for any other line.

    FluidNC and Grbl_Esp32 tell their errors in words if their owner has chosen that.

    >>> parse_response(b"error:15\r\n"), parse_response(b"error: Bad number format\r\n")
    (Response(code=15, words=''), Response(code=-1, words='Bad number format'))
    """
    match = re.fullmatch(rb"ok|error: *(?:(\d{1,3})|([ -~]+))", line.rstrip(b"\r\n"))
    if match is None:
        return None
    words = (match[2] or b"").decode("ascii")
    return Response(_NUMBERED.get(words, _UNNUMBERED) if words else int(match[1] or 0), words)


def parse_alarm(line: bytes) -> int | None:
    r"""Parse the code of an alarm, 0 for one without a number; None for any other line.

    >>> parse_alarm(b"ALARM:3\r\n")
    3
    """
    match = _ALARM.match(line)
    return int(match[1] or 0) if match else None


def is_greeting(line: bytes) -> bool:
    r"""Return whether a line contains the greeting of a firmware that has started, or of its boot loader.

    Every descendant greets in words of its own, and FluidNC in words that its owner can change. The line may begin with
    what the board said before it lost its power.

    >>> is_greeting(b"<Idle|MPos:0.0GrblHAL 1.1f ['$' or '$HELP' for help]\r\n"), is_greeting(b"[FIRMWARE:grblHAL]\r\n")
    (True, False)
    """
    # Names of hosts and files may hold the same words
    if line.startswith((b"$", b"[")) or _REPORT.fullmatch(line):
        return _MESSAGE_AT_START.match(line) is not None
    return _GREETING.search(line) is not None


def is_message(line: bytes) -> bool:
    r"""Return whether a line is a push message that says nothing about the position, or the echo of a line.

    >>> is_message(b"[MSG:Caution: Unlocked]\r\n")
    True
    """
    return not line.strip() or line.startswith((b"[MSG:", b"[echo:", b">"))


def parse_settings(lines: Iterable[bytes]) -> dict[int, float]:
    r"""Parse the answer to ``$$``: values by number, in the board's units. Settings that are texts are left out.

    >>> parse_settings([b"$13=0\r\n", b"$300=grblHAL\r\n", b"$130=27.000\r\n"])
    {13: 0.0, 130: 27.0}
    """
    return {int(line[1]): float(line[2]) for line in map(_SETTING.fullmatch, lines) if line}


def parse_configured(lines: Iterable[bytes], name: str) -> float | None:
    r"""Parse FluidNC's answer to ``$/...``: the number of that name in its configuration file; None without one.

    A switch is 1 for true and 0 for false.

    >>> parse_configured([b"$/axes/x/homing/cycle=2\r\n"], "$/axes/x/homing/cycle")
    2.0
    """
    begin = f"{name}=".encode("ascii")
    words = next((line.removeprefix(begin).strip() for line in lines if line.startswith(begin)), b"")
    if words in {b"true", b"false"}:
        return float(words == b"true")
    return float(words) if re.fullmatch(rb"-?\d+(?:\.\d*)?", words) else None


class Build(NamedTuple):
    """What a board says of itself."""

    version: str
    name: str
    firmware: Firmware
    # Letters of its axes, in the order of settings and reports; one that stands twice moves two motors. Empty if it
    # names two motors only once, because the order of its settings is then not known.
    letters: str


def parse_build_info(lines: Iterable[bytes]) -> Build | None:
    r"""Parse the answer to ``$I``; None without a version.

    >>> build = parse_build_info([b"[VER:1.1h.20190830:GIMBAL]\r\n", b"[AXS:5:XYZAC]\r\n", b"[OPT:V,15,128]\r\n"])
    >>> build.version, build.name, build.firmware.name, build.letters
    ('1.1h.20190830', 'GIMBAL', 'Grbl 1.1', 'XYZAC')
    """
    lines = list(lines)
    build = next(filter(None, map(_BUILD.fullmatch, lines)), None)
    if build is None:
        return None
    version, name = build[1].decode("latin-1"), (build[2] or b"").decode("latin-1")
    axes = next(filter(None, map(_AXES.fullmatch, lines)), None)
    letters = axes[2].decode("ascii") if axes else LETTERS
    if axes and int(axes[1]) != len(letters):
        letters = ""
    return Build(version, name, _firmware(version, lines), letters)


def _firmware(version: str, lines: Iterable[bytes]) -> Firmware:
    """Return the firmware that says its name, or whose version has Grbl's form."""
    named = next((line for line in lines if line.startswith(b"[FIRMWARE:")), b"").lower()
    if b"grblhal" in named:
        return GRBLHAL
    if "fluidnc" in version.lower():
        return FLUIDNC
    is_grbl = not named and re.fullmatch(r"1\.1[a-z]\.\d{8}", version)
    return GRBL if is_grbl else UNKNOWN


def moving_start_up_line(lines: Iterable[bytes]) -> str:
    r"""Return the first start-up line in the answer to ``$N`` that moves an axis; empty without one.

    >>> moving_start_up_line([b"$N0=G21 G90\r\n", b"$N1=G0 X-10\r\n"])
    'G0 X-10'
    """
    stored = [
        stored_line[1].decode("latin-1") for stored_line in map(_START_UP.fullmatch, lines) if stored_line
    ]
    return next((line for line in stored if _AXIS_WORD.search(line)), "")
