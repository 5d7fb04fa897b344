"""Talk to a GRBL 1.1 board on its line: commands and their ``ok``, real-time commands, reports, alarms, restarts.

Degrees belong to ``drivers.stage.grbl``, forms of lines to ``drivers.stage.grbl_protocol``. Source: the pages "Grbl
v1.1 Interface", "Grbl v1.1 Jogging", "Grbl v1.1 Commands" and "Grbl v1.1 Configuration" of the firmware's
documentation, https://github.com/gnea/grbl/tree/master/doc/markdown.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

from drivers.clock import Clock
from drivers.errors import DeviceRefused, MoveFailed, MoveTimeout, ReplyTimeout
from drivers.link import Link, ReplyReader, repeat
from drivers.serial_port import Port
from drivers.stage import grbl_protocol, motion
from drivers.stage.grbl_protocol import StatusReport
from drivers.wire_log import WireLog

STATUS = b"?"
CANCEL_JOG = b"\x85"
RESET = b"\x18"
"""Real-time commands: the firmware takes these bytes out of the line at once, whatever it is doing."""

_MARKER_S = 0.5  # Longest wait for the reply that shows that no older reply will follow
_BOOT_TRIES = 6
"""A board that restarts because its port was opened sends nothing for a second or two."""
_INVALID_LINE = b"Q\n"
"""A letter without a number. The board refuses it, whatever beginning of a line it holds already."""
_LONGEST_REPLY = 500
"""Most lines of one reply; grblHAL has some 200 settings."""
WAKE_SILENCES = 8
"""How often the line may be silent for ``quiet_s`` after a reset until the welcome message."""
_AFTER_ALARM_S = 2.0
"""A homing that failed has told its alarm; ``ok`` or a restart may follow within this time, in seconds."""
_WAKE_RESETS = 4
"""The firmware pauses for 0.5 s after an alarm, and then forgets a reset that came meanwhile; so it is sent again."""

_SHOWN = 60  # Most bytes of an answer in a message
_FIRMWARES = "The firmware must be Grbl 1.1, grblHAL or FluidNC; Grbl 0.9 reports otherwise, as Marlin and Smoothie do."
_CLEAR_ALARM = (
    "Clear the cause (move the axis off its limit switch, release the emergency stop), then home the stage."
)

T = TypeVar("T")


class SettingReadOnly(DeviceRefused):
    """The setting is held by a configuration file on the board."""


class GrblController(Link):
    """A GRBL board on one line. Opening asks for a status report; it sets nothing.

    ``alarms`` are the codes that the board has raised since then, oldest first. ``needs_reset``: the board waits for a
    reset after an alarm; Grbl itself then answers nothing, not even ``?``. ``firmware``, and the ``letters`` of its
    axes in their order, are known once ``query_build_info`` was answered.
    """

    TELLS_ECHO = True
    quiet_s = 0.1  # Longer than any pause within a reply; more would slow each connection

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self.restarts = 0
        self.alarms: list[int] = []
        self.needs_reset = False
        self.firmware = grbl_protocol.UNKNOWN
        self.letters = grbl_protocol.LETTERS
        self._reports_axes = 0
        """How many axes its reports tell; 0 until one has told a machine position."""
        self._awaits_report = False
        super().__init__(port, clock=clock, wire_log=wire_log)
        self._wait_for_boot()

    def query_status(self) -> StatusReport:
        """Ask for state and position; repeat it when no valid report comes. An unknown state is read twice."""
        report = repeat(self._query_status_once)
        if report.state not in grbl_protocol.READY_STATES | grbl_protocol.BLOCKING_STATES.keys():
            report = repeat(self._query_status_once)
        return report

    def query(self, line: str) -> list[bytes]:
        """Send a line (without its end) that does no harm twice, until its reply is valid: its lines before ``ok``."""
        return repeat(lambda: self.command(line))

    def command(self, line: str) -> list[bytes]:
        """Send a line (without its end), once; return the lines of the reply before its ``ok``."""
        return self._exchange(f"{line}\n".encode("ascii"), lambda reader: self._read_reply(line, reader))

    def require_awake(self) -> None:
        """Refuse an exchange (`MoveFailed`) with a board that has stopped at an alarm: homing resets it."""
        if self.needs_reset:
            raise self._alarmed("stopped all axes and waits for a reset")

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
        if self.restarts == restarts and self.needs_reset:
            raise self._alarmed("does not take a reset")
        if self.restarts == restarts:
            # Which a mute board does not answer, but another firmware, or one at another rate
            self.write(b"\n")
            self.receive(self.reply_s)
            if heard := self.drain():
                raise self.garbled_reply(
                    f"the device answers {heard[:_SHOWN]!r}, and no status report.", _FIRMWARES
                )
            why, remedy = self.why_silent()
            what = f"the board does not answer, and a reset brings no welcome message{why and f': {why}'}."
            raise ReplyTimeout(what, where=self.name, remedy=remedy)

    def start_homing(self) -> None:
        """Start homing. The board answers nothing until homing has ended.

        After a `ReplyError` (the line could not be resynchronised) nothing was started.
        """
        with self.lock:
            self.require_awake()
            self.bring_into_step()
            self.write(b"$H\n")
            self.mark_out_of_step()

    def wait_for_homing(self, allowed_s: float) -> None:
        """Wait for the ``ok`` at the end of homing, a restart or an alarm; `MoveTimeout` at the deadline."""
        end_s = self._clock.monotonic() + allowed_s
        restarts, alarms, failed = self.restarts, len(self.alarms), False
        while (now_s := self._clock.monotonic()) < end_s:
            self._clock.sleep(motion.POLL_S)
            line = self._next_line()
            self.require_awake()
            if line is not None and grbl_protocol.parse_response(line) is not None:
                self._raise_if_error("$H", line)
                return
            if self.restarts != restarts:
                return
            if len(self.alarms) > alarms:
                alarms, end_s = len(self.alarms), now_s + _AFTER_ALARM_S
                failed = True
        if failed:
            return
        raise MoveTimeout(
            f"homing has not ended after {allowed_s:.0f} s.",
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
        return grbl_protocol.parse_settings(self.query("$$"))

    def query_build_info(self) -> tuple[str, str]:
        """Ask for the firmware's version, and the board's name.

        A grblHAL that was built to be compatible with Grbl says its own name, and its axes, only if asked for more.
        """
        lines = self.query("$I")
        build = grbl_protocol.parse_build_info(lines)
        if build is None:
            raise self.garbled_reply(
                "the answer to $I has no version.", "Check that the firmware is GRBL 1.1."
            )
        if build.firmware is grbl_protocol.GRBL:
            with suppress(DeviceRefused):  # Grbl itself has no such command
                build = grbl_protocol.parse_build_info([*lines, *self.query("$I+")]) or build
        version, name, self.firmware, self.letters = build
        return version, name

    def query_configured(self, name: str) -> float | None:
        """Ask FluidNC for a value of its configuration file, such as ``$/axes/x/homing/cycle``; None if it has none."""
        try:
            return grbl_protocol.parse_configured(self.query(name), name)
        except DeviceRefused:
            return None

    def query_moving_start_up_line(self) -> str:
        """Ask for the stored line that moves an axis whenever the board starts or was homed; empty without one."""
        try:
            return grbl_protocol.moving_start_up_line(self.query("$N"))
        except DeviceRefused:  # a firmware without such lines
            return ""

    # ------------------------------------------------------------ inside

    def _alarmed(self, state: str) -> MoveFailed:
        what = f"{self.firmware.alarm(self.alarms[-1])}. The board {state}."
        return MoveFailed(what, where=self.name, remedy=_CLEAR_ALARM)

    def _query_status_once(self) -> StatusReport:
        def read_reply(reader: ReplyReader) -> StatusReport:
            self._awaits_report = True
            try:
                while (line := reader.read_line()).startswith(b"["):
                    pass  # some descendants push more than messages
            finally:
                self._awaits_report = False
            report = grbl_protocol.parse_report(line)
            if report is None:
                is_whole = line.startswith(b"<") and line.rstrip().endswith(b">")
                what = f"{line[:80]!r} came instead of a status report."
                raise self.garbled_reply(what, _FIRMWARES if is_whole else "Check the cable.")
            if self._reports_axes and len(report.machine_position) != self._reports_axes:
                raise grbl_protocol.no_position(self.name)  # a letter or a comma got lost
            self._reports_axes = len(report.machine_position)
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
        while grbl_protocol.parse_response(line := reader.read_line()) is None:
            lines.append(line)
            if len(lines) > _LONGEST_REPLY:
                raise self.garbled_reply(f"the answer to {sent} never ends.")
        self._raise_if_error(sent, line)
        return lines

    def _raise_if_error(self, sent: str, line: bytes) -> None:
        response = grbl_protocol.parse_response(line)
        if response is not None and response.code:
            refused = SettingReadOnly if response.code == grbl_protocol.READ_ONLY else DeviceRefused
            raise refused(
                f"the board refuses '{sent}': {self.firmware.error(response)}.",
                where=self.name,
                remedy="Look the error up in the firmware's list of errors.",
            )

    def _next_line(self) -> bytes | None:
        """Return the next line that has come already and is no push message."""
        with self.lock:
            self.receive(0.0)
            while (line := self.take_line()) is not None:
                if not self._take_push_message(line):
                    return line
        return None

    def take_unsolicited(self, line: bytes) -> bool:
        """Take a push message, or a report that nobody asked for: boards can send those all the time."""
        is_report = not self._awaits_report and grbl_protocol.parse_report(line) is not None
        return is_report or self._take_push_message(line)

    def is_filler(self, data: bytes) -> bool:
        """See `Link.is_filler`. Restarts and alarms are noted."""
        lines = data.splitlines(keepends=True)
        return not data or (data.endswith(b"\n") and all(map(self.take_unsolicited, lines)))

    def _take_push_message(self, line: bytes) -> bool:
        """Take a push message: note restarts and alarms."""
        if grbl_protocol.is_greeting(line):
            self.restarts += 1
            self.needs_reset = False
            return True
        alarm = grbl_protocol.parse_alarm(line)
        if alarm is not None:
            self.alarms.append(alarm)
            self.needs_reset |= alarm in self.firmware.halting_alarms
        return alarm is not None or grbl_protocol.is_message(line)

    def _wait_for_boot(self) -> None:
        try:
            report = repeat(self._query_status_once, tries=_BOOT_TRIES)
            if report.state not in {"Idle", "Alarm", *grbl_protocol.MOVING_STATES}:
                self.wake()  # held (perhaps not at rest yet), asleep or in check mode by another program
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
            inspect_old=self._take_push_messages,
        )

    def _read_to_error(self, reader: ReplyReader) -> None:
        """Read until an error comes: the answers to older lines come first."""
        response = None
        try:
            while response is None or not response.code:
                response = grbl_protocol.parse_response(reader.read_line())
        except ReplyTimeout as error:
            if response is None or error.late_s:
                raise
            what = "the board answers ok to a line that is no command."
            raise self.garbled_reply(what, _FIRMWARES) from error

    def _read_single_ok(self, reader: ReplyReader) -> None:
        line = reader.read_line()
        if grbl_protocol.parse_response(line) != grbl_protocol.OK:
            raise self.garbled_reply(f"{line[:80]!r} answers an empty line.")

    def _take_push_messages(self, old: bytes) -> None:
        """Note the restarts and alarms in bytes that are thrown away."""
        for line in old.splitlines(keepends=True):
            self.take_unsolicited(line)
