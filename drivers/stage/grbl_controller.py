"""Talk to a GRBL 1.1 board on its line: commands and their ``ok``, real-time commands, reports, alarms, restarts.

Degrees belong to ``drivers.stage.grbl``. Source: the pages "Grbl v1.1 Interface", "Grbl v1.1 Jogging", "Grbl v1.1
Commands" and "Grbl v1.1 Configuration" of the firmware's documentation,
https://github.com/gnea/grbl/tree/master/doc/markdown.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from drivers.clock import Clock
from drivers.errors import DeviceRefused, MoveFailed, MoveTimeout, ReplyGarbled, ReplyTimeout
from drivers.link import Link, ReplyReader, repeat
from drivers.serial_port import Port
from drivers.stage import motion
from drivers.wire_log import WireLog

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

    def position(self, place: int, where: str) -> float:
        """Return the machine position, in the board's unit, of the axis at a place: 0 for X, 1 for Y ..."""
        if place >= len(self.machine_position):
            raise ReplyGarbled(
                f"the board reports {len(self.machine_position)} axes only.",
                where=where,
                remedy="Check the axis letters in the station file.",
            )
        return self.machine_position[place]


def parse_report(line: bytes, where: str = "") -> StatusReport | None:
    r"""Parse a status report; None for another line. Without machine position or known state it is garbled.

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


def parse_response(line: bytes) -> int | None:
    r"""Parse the last line of a reply: 0 for ``ok``, the code of an ``error``; None for any other line.

    >>> parse_response(b"error:15\r\n")
    15
    """
    if line == b"ok\r\n":
        return 0
    match = re.fullmatch(rb"error:(\d{1,3})\r\n", line)
    return int(match[1]) if match else None


def parse_alarm(line: bytes) -> int | None:
    r"""Parse the code of an alarm; None for any other line.

    >>> parse_alarm(b"ALARM:3\r\n")
    3
    """
    match = re.fullmatch(rb"ALARM:(\d{1,2})\r\n", line)
    return int(match[1]) if match else None


_MARKER_S = 0.5
_BOOT_TRIES = 6
"""A board that restarts because its port was opened sends nothing for a second or two."""
_INVALID_LINE = b"Q\n"
"""A letter without a number. The board refuses it, whatever beginning of a line it holds already."""
_LONGEST_REPLY = 100
"""Most lines of one reply."""
_HALTING_ALARMS = frozenset({1, 2})
"""Alarms of a limit: after them the firmware waits in a loop that serves nothing but a reset."""
WAKE_SILENCES = 8
"""How often the line may be silent for ``quiet_s`` after a reset until the welcome message."""
_WAKE_RESETS = 4
"""The firmware pauses for 0.5 s after an alarm, and then forgets a reset that came meanwhile; so it is sent again."""

T = TypeVar("T")


class GrblController(Link):
    """A GRBL board on one line. Opening asks for a status report; it sets nothing.

    ``alarms`` are the codes that the board has raised since then, oldest first. ``needs_reset``: the board waits for a
    reset after a limit; until then it answers nothing, not even ``?``.
    """

    quiet_s = 0.1

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self.restarts = 0
        self.alarms: list[int] = []
        self.needs_reset = False
        super().__init__(port, clock=clock, wire_log=wire_log)
        self._wait_for_boot()

    def query_status(self) -> StatusReport:
        """Ask for state and position; repeat it when no valid report comes."""
        return repeat(self._query_status_once)

    def query(self, line: str) -> list[bytes]:
        """Send a line (without its end) that does no harm twice, until its reply is valid: its lines before ``ok``."""
        return repeat(lambda: self.command(line))

    def command(self, line: str) -> list[bytes]:
        """Send a line (without its end), once; return the lines of the reply before its ``ok``."""
        return self._exchange(f"{line}\n".encode("ascii"), lambda reader: self._read_reply(line, reader))

    def require_awake(self) -> None:
        """Refuse an exchange (`MoveFailed`) with a board that has stopped at a limit: homing resets it."""
        if self.needs_reset:
            code = self.alarms[-1] if self.alarms else 1
            raise MoveFailed(
                f"{ALARMS.get(code, 'unknown alarm')} (ALARM:{code}). The board stopped all axes and"
                " waits for a reset.",
                where=self.name,
                remedy="Move the axis off its limit switch by hand if it stands on it, then home the stage.",
            )

    def wake(self) -> None:
        """Reset a board that waits for a reset. Its motion has ended and its reference is lost already.

        Without its welcome message, `ReplyTimeout` is raised.
        """
        restarts = self.restarts
        with self.lock:
            for _ in range(_WAKE_RESETS):
                self.write(RESET)
                silences = 0
                while self.restarts == restarts and silences < WAKE_SILENCES:
                    silences += not self.receive(self.quiet_s)
                    while self._next_line() is not None:
                        silences += 1  # a board that babbles is no board that has restarted
                if self.restarts != restarts:
                    break
            self.mark_out_of_step()
        if self.restarts == restarts:
            raise ReplyTimeout(
                "the board does not answer, and a reset brings no welcome message.",
                where=self.name,
                remedy="Check that the board is switched on, its cable, and that the station file has its baud rate.",
            )

    def start_homing(self) -> None:
        """Start homing. The board answers nothing until homing has ended.

        After a `ReplyError` (the line could not be resynchronised) nothing was started.
        """
        with self.lock:
            self.require_awake()
            self.bring_into_step()
            self.write(b"$H\n")
            self.mark_out_of_step()

    def wait_for_homing(self) -> None:
        """Wait for the ``ok`` at the end of homing, or for a restart of the board; `MoveTimeout` at the deadline."""
        end_s = self._clock.monotonic() + motion.LONGEST_HOMING_S
        restarts = self.restarts
        while self._clock.monotonic() < end_s:
            self._clock.sleep(motion.POLL_S)
            line = self._next_line()
            self.require_awake()
            if line is not None and parse_response(line) is not None:
                self._raise_if_error("$H", line)
                return
            if self.restarts != restarts:
                return
        raise MoveTimeout(
            f"homing has not ended after {motion.LONGEST_HOMING_S:g} s.",
            where=self.name,
            remedy="Find what blocks the axes.",
        )

    def cancel_jog(self) -> None:
        """Ramp down and cancel the jog; the position is kept."""
        self.write(CANCEL_JOG)

    def reset(self) -> None:
        """Stop at once, whatever the board does; the position is lost when it was moving."""
        self.write(RESET)
        self.mark_out_of_step()

    def query_settings(self) -> dict[int, float]:
        """Ask for all settings: values by number, in the board's units."""
        found = map(_SETTING.fullmatch, self.query("$$"))
        return {int(setting[1]): float(setting[2]) for setting in found if setting}

    def query_build_info(self) -> tuple[str, str]:
        """Ask for the firmware's version, and the board's name."""
        for build in map(_BUILD.fullmatch, self.query("$I")):
            if build:
                return build[1].decode("latin-1"), build[2].decode("latin-1")
        raise self.garbled_reply("the answer to $I has no version.", "Check that the firmware is GRBL 1.1.")

    # ------------------------------------------------------------ inside

    def _query_status_once(self) -> StatusReport:
        def read_reply(reader: ReplyReader) -> StatusReport:
            line = reader.read_line()
            report = parse_report(line, self.name)
            if report is None:
                raise ReplyGarbled(
                    f"{line[:80]!r} came instead of a status report.",
                    where=self.name,
                    remedy="Check the cable.",
                )
            return report

        return self._exchange(STATUS, read_reply)

    def _exchange(
        self, request: bytes, read: Callable[[ReplyReader], T], *, deadline_s: float | None = None
    ) -> T:
        """Make an exchange; raise MoveFailed as soon as it is known that the board waits for a reset."""
        self.require_awake()

        def read_awake(reader: ReplyReader) -> T:
            self.require_awake()  # the alarm came with the old lines, just before this request
            try:
                return read(reader)
            except ReplyTimeout:
                self.require_awake()
                raise

        return self.exchange(request, read_awake, deadline_s=deadline_s)

    def _read_reply(self, sent: str, reader: ReplyReader) -> list[bytes]:
        lines = []
        while parse_response(line := reader.read_line()) is None:
            lines.append(line)
            if len(lines) > _LONGEST_REPLY:
                raise ReplyGarbled(
                    f"the answer to {sent} never ends.", where=self.name, remedy="Check the port."
                )
        self._raise_if_error(sent, line)
        return lines

    def _raise_if_error(self, sent: str, response: bytes) -> None:
        code = parse_response(response)
        if code:
            raise DeviceRefused(
                f"the board refuses '{sent}': {ERRORS.get(code, 'unknown error')} (error:{code}).",
                where=self.name,
                remedy="Look the error up in the firmware's list of errors.",
            )

    def _next_line(self) -> bytes | None:
        """Return the next line that has come already and is no push message."""
        with self.lock:
            self.receive(0.0)
            while (line := self.take_line()) is not None:
                if not self.take_unsolicited(line):
                    return line
        return None

    def take_unsolicited(self, line: bytes) -> bool:
        """Take a push message: note restarts and alarms."""
        if line.startswith(b"Grbl "):  # the welcome message of a firmware that has started
            self.restarts += 1
            self.needs_reset = False
            return True
        alarm = parse_alarm(line)
        if alarm is not None:
            self.alarms.append(alarm)
            self.needs_reset |= alarm in _HALTING_ALARMS
        is_message = line == b"\r\n" or line.startswith((b"[MSG:", b">"))  # ">": echo of a start-up line
        return alarm is not None or is_message

    def _wait_for_boot(self) -> None:
        try:
            repeat(self._query_status_once, tries=_BOOT_TRIES)
        except (ReplyTimeout, MoveFailed):
            # A board that moves by jog or program answers ?. A mute one waits for a reset after a limit, or is homing
            # for a program that has ended. This driver has no reference yet, so a reset loses nothing.
            self.wake()
        self.mark_out_of_step()  # the board may hold the beginning of a line that another program sent

    def _resynchronise(self) -> None:
        """Spoil the beginning of a line that the board may hold; then get one ``ok`` to an empty line, alone."""

        def exchange_marker() -> None:
            self._exchange(_INVALID_LINE, self._read_to_error, deadline_s=self.reply_s)
            self._query_status_once()
            self._exchange(b"\n", self._read_single_ok)

        self.prove_in_step(
            exchange_marker,
            marker_s=_MARKER_S,
            failed="the board sends more than it was asked for.",
            remedy="Check the port.",
            inspect_old=self._take_push_messages,
        )

    def _read_to_error(self, reader: ReplyReader) -> None:
        """Read until an error comes: the answers to older lines come first."""
        while not parse_response(reader.read_line()):
            pass

    def _read_single_ok(self, reader: ReplyReader) -> None:
        line = reader.read_line()
        if parse_response(line) != 0:
            raise ReplyGarbled(
                f"{line[:80]!r} answers an empty line.", where=self.name, remedy="Check the port."
            )

    def _take_push_messages(self, old: bytes) -> None:
        """Note the restarts and alarms in bytes that are thrown away."""
        for line in old.splitlines(keepends=True):
            self.take_unsolicited(line)
