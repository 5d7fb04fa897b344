"""Knows the words of GRBL 1.1: real-time bytes, status reports, settings, errors, alarms. Sends nothing.

Source: "Grbl v1.1 Interface" and "Grbl v1.1 Jogging" of the firmware's documentation.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from drivers.errors import ReplyGarbled

STATUS = b"?"
CANCEL_JOG = b"\x85"
RESET = b"\x18"
"""Real-time bytes: picked out of the line by the firmware, whatever else it is doing."""

WORKING = frozenset({"Idle", "Jog"})
_MOVING = frozenset({("Jog", 0), ("Run", 0), ("Home", 0), ("Hold", 1), ("Door", 2), ("Door", 3)})
STATES = {
    "Run": "runs somebody else's program",
    "Hold": "held",
    "Door": "the safety door is open",
    "Alarm": "in alarm",
    "Home": "searching its reference",
    "Check": "in check mode: nothing moves",
    "Sleep": "asleep",
}
"""States other than standing and jogging, in which we have no business, in plain words."""

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
class Report:
    """A status report: the state, and where the axes are in machine coordinates, all of one moment."""

    state: str
    substate: int
    machine: tuple[float, ...]

    @property
    def moving(self) -> bool:
        """Whether something moves."""
        return (self.state, self.substate) in _MOVING


def parse_report(line: bytes, where: str = "") -> Report | None:
    r"""Understand a status report; None for a line that is none.

    Raises ReplyGarbled for one without the machine position.

    >>> parse_report(b"<Idle|MPos:0.000,-1.500,0.000|FS:0,0>\r\n")
    Report(state='Idle', substate=0, machine=(0.0, -1.5, 0.0))
    """
    match = _REPORT.fullmatch(line)
    if match is None:
        return None
    place = _MACHINE.search(match[3].decode("latin-1"))
    if place is None or match[1].decode() not in WORKING | STATES.keys():
        raise ReplyGarbled(
            f"a status report of another form: {line[:80]!r}.",
            where=where,
            remedy="Set $10=1, so that it reports machine positions.",
        )
    return Report(match[1].decode(), int(match[2] or 0), tuple(map(float, place[1].split(","))))


def parse_setting(line: bytes) -> tuple[int, float] | None:
    r"""Understand one line of ``$$``; None for another.

    >>> parse_setting(b"$100=800.000\r\n")
    (100, 800.0)
    """
    match = _SETTING.fullmatch(line)
    return (int(match[1]), float(match[2])) if match else None


def parse_build(line: bytes) -> tuple[str, str] | None:
    r"""Understand the first line of ``$I``: version, and the name its owner gave it; None for another.

    >>> parse_build(b"[VER:1.1h.20190830:gimbal-7]\r\n")
    ('1.1h.20190830', 'gimbal-7')
    """
    match = _BUILD.fullmatch(line)
    return (match[1].decode("latin-1"), match[2].decode("latin-1")) if match else None


def parse_verdict(line: bytes) -> int | None:
    r"""Understand the end of an answer: 0 for ``ok``, the code of an ``error``; None for another line.

    >>> parse_verdict(b"error:15\r\n")
    15
    """
    if line == b"ok\r\n":
        return 0
    match = re.fullmatch(rb"error:(\d{1,3})\r\n", line)
    return int(match[1]) if match else None


def parse_alarm(line: bytes) -> int | None:
    r"""Understand an alarm; None for another line.

    >>> parse_alarm(b"ALARM:3\r\n")
    3
    """
    match = re.fullmatch(rb"ALARM:(\d{1,2})\r\n", line)
    return int(match[1]) if match else None


def is_banner(line: bytes) -> bool:
    """Whether this is what the firmware says when it has (re)started."""
    return line.startswith(b"Grbl ")


def is_chatter(line: bytes) -> bool:
    """Whether this is a line that tells nothing: empty, a message, a start-up line."""
    return line == b"\r\n" or line.startswith((b"[MSG:", b">"))
