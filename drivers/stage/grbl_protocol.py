"""Parse the lines of GRBL 1.1: status reports, settings, responses, alarms; and name its real-time commands.

This module sends nothing. Source: the pages "Grbl v1.1 Interface", "Grbl v1.1 Jogging", "Grbl v1.1 Commands" and
"Grbl v1.1 Configuration" of the firmware's documentation, https://github.com/gnea/grbl/tree/master/doc/markdown.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.errors import ReplyGarbled

STATUS = b"?"
CANCEL_JOG = b"\x85"
RESET = b"\x18"
"""Real-time commands: the firmware takes these bytes out of the line at once, whatever it is doing."""

READY_STATES = frozenset({"Idle", "Jog"})
_MOVING = frozenset({("Jog", 0), ("Run", 0), ("Home", 0), ("Hold", 1), ("Door", 2), ("Door", 3)})
BLOCKING_STATES = {
    "Run": "runs a program of another sender",
    "Hold": "held",
    "Door": "the safety door is open",
    "Alarm": "in alarm",
    "Home": "searching the reference",
    "Check": "in check mode: nothing moves",
    "Sleep": "asleep",
}
"""Meanings of the states in which this driver must not start a move."""

ALARMS = {
    1: "limit switch hit; position lost",
    2: "target beyond the soft limits",
    3: "reset while moving; position lost",
    4: "probe failed",
    5: "probe failed",
    6: "homing was reset",
    7: "safety door opened while homing",
    8: "homing could not leave the limit switch",
    9: "homing did not find the limit switch",
    10: "homing did not find the second limit switch",
}

ERRORS = {
    2: "bad number",
    3: "unknown $ command",
    5: "homing is not enabled ($22)",
    8: "not idle",
    9: "locked by an alarm or a jog",
    10: "soft limits need homing",
    11: "line too long",
    12: "step rate too high",
    15: "jog target beyond the travel",
    16: "bad jog command",
    20: "unsupported command",
    22: "no feed rate",
}

_REPORT = re.compile(rb"<([A-Z][a-z]+)(?::(\d))?((?:\|[A-Za-z]+:[^|<>]*)+)>\r\n")
_NUMBER = r"-?\d+\.\d+"
_MACHINE = re.compile(rf"\|MPos:({_NUMBER}(?:,{_NUMBER})+)(?:\||$)")
_SETTING = re.compile(rb"\$(\d+)=(-?\d+(?:\.\d+)?)\r\n")
_BUILD = re.compile(rb"\[VER:([^:\]]*):([^\]]*)\]\r\n")


@dataclass(frozen=True)
class StatusReport:
    """A status report: state and position of one moment."""

    state: str  # State of the board, such as "Idle"
    substate: int  # Number after the state, as in "Hold:0"; 0 without one
    machine_position: tuple[float, ...]  # Position of each axis in machine coordinates, in the board's unit

    @property
    def moving(self) -> bool:
        """Whether any axis moves."""
        return (self.state, self.substate) in _MOVING


def parse_report(line: bytes, where: str = "") -> StatusReport | None:
    r"""Parse a status report.

    Returns: State and position; None for a line that is no status report.
    Raises ReplyGarbled: The report has no machine position, or an unknown state.

    Examples
    --------
    >>> parse_report(b"<Idle|MPos:0.000,-1.500,0.000|FS:0,0>\r\n")
    StatusReport(state='Idle', substate=0, machine_position=(0.0, -1.5, 0.0))
    """
    match = _REPORT.fullmatch(line)
    if match is None:
        return None
    place = _MACHINE.search(match[3].decode("latin-1"))
    if place is None or match[1].decode() not in READY_STATES | BLOCKING_STATES.keys():
        raise ReplyGarbled(
            f"a status report without machine position or with an unknown state: {line[:80]!r}.",
            where=where,
            remedy="Set $10=1, so that the board reports machine positions.",
        )
    return StatusReport(match[1].decode(), int(match[2] or 0), tuple(map(float, place[1].split(","))))


def parse_setting(line: bytes) -> tuple[int, float] | None:
    r"""Parse one line of the answer to ``$$``.

    Returns: Number and value of the setting; None for any other line.

    Examples
    --------
    >>> parse_setting(b"$100=800.000\r\n")
    (100, 800.0)
    """
    match = _SETTING.fullmatch(line)
    return (int(match[1]), float(match[2])) if match else None


def parse_build_info(line: bytes) -> tuple[str, str] | None:
    r"""Parse the first line of the answer to ``$I``.

    Returns: Version of the firmware, and the name that was given to the board; None for any other line.

    Examples
    --------
    >>> parse_build_info(b"[VER:1.1h.20190830:gimbal-7]\r\n")
    ('1.1h.20190830', 'gimbal-7')
    """
    match = _BUILD.fullmatch(line)
    return (match[1].decode("latin-1"), match[2].decode("latin-1")) if match else None


def parse_response(line: bytes) -> int | None:
    r"""Parse the last line of a reply.

    Returns: 0 for ``ok``, the code of an ``error``; None for any other line.

    Examples
    --------
    >>> parse_response(b"error:15\r\n")
    15
    """
    if line == b"ok\r\n":
        return 0
    match = re.fullmatch(rb"error:(\d{1,3})\r\n", line)
    return int(match[1]) if match else None


def parse_alarm(line: bytes) -> int | None:
    r"""Parse an alarm.

    Returns: Code of the alarm; None for any other line.

    Examples
    --------
    >>> parse_alarm(b"ALARM:3\r\n")
    3
    """
    match = re.fullmatch(rb"ALARM:(\d{1,2})\r\n", line)
    return int(match[1]) if match else None


def is_welcome(line: bytes) -> bool:
    """Return whether a line is the welcome message, which the firmware sends when it has started.

    Returns: Whether it is.
    """
    return line.startswith(b"Grbl ")


def is_informational(line: bytes) -> bool:
    """Return whether a line needs no action: an empty line, a message, or the echo of a start-up line.

    Returns: Whether it is one of these.
    """
    return line == b"\r\n" or line.startswith((b"[MSG:", b">"))


def machine_positions(report: StatusReport, places: Sequence[int], where: str) -> tuple[float, ...]:
    """Return the machine positions of some axes.

    places: Places of the axes in the report: 0 for X, 1 for Y ...
    Returns: Machine positions, in the board's unit.
    """
    if max(places) >= len(report.machine_position):
        raise ReplyGarbled(
            f"the board reports {len(report.machine_position)} axes only.",
            where=where,
            remedy="Check the axis letters in the station file.",
        )
    return tuple(report.machine_position[place] for place in places)
