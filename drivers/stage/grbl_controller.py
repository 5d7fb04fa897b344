"""Talk to a GRBL board on its line: commands and their ``ok``, real-time commands, alarms and restarts.

Degrees belong to ``drivers.stage.grbl``, the forms of lines to ``drivers.stage.grbl_protocol``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from drivers.clock import Clock
from drivers.errors import DeviceRefused, MoveFailed, MoveTimeout, ReplyGarbled, ReplyTimeout
from drivers.link import Link, ReplyReader
from drivers.retry import repeat
from drivers.serial_port import Port
from drivers.stage import grbl_protocol, motion
from drivers.stage.grbl_protocol import StatusReport
from drivers.wire_log import WireLog

_REPLY_S = 1.0
_MARKER_S = 0.5
_QUIET_S = 0.1
_LONGEST_DRAIN_S = 1.0
_BOOT_TRIES = 6
"""A board that restarts because its port was opened sends nothing for a second or two."""
_INVALID_LINE = b"Q\n"
"""A letter without a number. The board refuses it, whatever beginning of a line it holds already."""
_LONGEST_REPLY = 100
"""Most lines of one reply."""
_HALTING_ALARMS = frozenset({1, 2})
"""Alarms of a limit: after them the firmware waits in a loop that serves nothing but a reset."""
_WAKE_SILENCES = 8
"""How often the line may be silent for ``_QUIET_S`` after a reset until the welcome message."""
_WAKE_RESETS = 4
"""The firmware pauses for 0.5 s after an alarm, and then forgets a reset that came meanwhile; so it is sent again."""

T = TypeVar("T")


class GrblController(Link):
    """A GRBL board on one line. Opening asks for a status report; it sets nothing.

    clock, wire_log: See ``drivers.link.Link``.
    alarms: Codes of the alarms that the board has raised since then, oldest first.
    needs_reset: Whether the board waits for a reset after a limit: until then it answers nothing, not even
      ``?``.
    Raises ReplyError, PortLost: The board does not answer.
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self.restarts = 0
        self.alarms: list[int] = []
        self.needs_reset = False
        super().__init__(
            port,
            clock=clock,
            resynchronise=self._resynchronise,
            unsolicited=self._take_push_message,
            wire_log=wire_log,
        )
        self._wait_for_boot()

    def query_status(self) -> StatusReport:
        """Ask for state and position; repeat it when no valid report comes."""
        return repeat(self._query_status_once)

    def query(self, line: str) -> list[bytes]:
        """Send a line that does no harm when it is sent twice; repeat it when no valid reply comes.

        line: The line, without its end.
        Returns: The lines of the reply before its ``ok``.
        Raises ReplyError: No valid reply came at the last attempt.
        """
        return repeat(lambda: self.command(line))

    def command(self, line: str) -> list[bytes]:
        """Send a line, once.

        line: The line, without its end.
        Returns: The lines of the reply before its ``ok``.
        Raises ReplyError: No valid reply came.
        """
        return self._exchange(
            f"{line}\n".encode("ascii"), lambda reader: self._read_reply(line, reader), deadline_s=_REPLY_S
        )

    def require_awake(self) -> None:
        """Refuse an exchange with a board that waits for a reset.

        Raises MoveFailed: The board has stopped at a limit, and answers nothing until it is reset; homing
          resets it.
        """
        if self.needs_reset:
            code = self.alarms[-1] if self.alarms else 1
            raise MoveFailed(
                f"{grbl_protocol.ALARMS.get(code, 'unknown alarm')} (ALARM:{code}). The board stopped all axes and"
                " waits for a reset.",
                where=self.name,
                remedy="Move the axis off its limit switch by hand if it stands on it, then home the stage.",
            )

    def wake(self) -> None:
        """Reset a board that waits for a reset. Its motion has ended and its reference is lost already.

        Raises ReplyTimeout: The board sends no welcome message.
        """
        restarts = self.restarts
        with self.lock:
            for _ in range(_WAKE_RESETS):
                self.write(grbl_protocol.RESET)
                silences = 0
                while self.restarts == restarts and silences < _WAKE_SILENCES:
                    silences += not self.receive(_QUIET_S)
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

        Raises ReplyError: The line was out of step and could not be resynchronised; nothing was started.
        """
        with self.lock:
            self.require_awake()
            self.bring_into_step()
            self.write(b"$H\n")
            self.mark_out_of_step()

    def wait_for_homing(self) -> None:
        """Wait for the ``ok`` at the end of homing, or for a restart of the board.

        Raises MoveTimeout: Homing has not ended by its deadline.
        """
        end_s = self._clock.monotonic() + motion.LONGEST_HOMING_S
        restarts = self.restarts
        while self._clock.monotonic() < end_s:
            self._clock.sleep(motion.POLL_S)
            line = self._next_line()
            self.require_awake()
            if line is not None and grbl_protocol.parse_response(line) is not None:
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
        self.write(grbl_protocol.CANCEL_JOG)

    def reset(self) -> None:
        """Stop at once, whatever the board does; the position is lost when it was moving."""
        self.write(grbl_protocol.RESET)
        self.mark_out_of_step()

    def query_settings(self) -> dict[int, float]:
        """Ask for all settings.

        Returns: Values by the numbers of the settings, in the board's units.
        """
        found = [grbl_protocol.parse_setting(line) for line in self.query("$$")]
        return dict(setting for setting in found if setting is not None)

    def query_build_info(self) -> tuple[str, str]:
        """Ask for the build information.

        Raises ReplyGarbled: The reply holds no version.
        """
        for line in self.query("$I"):
            if (build := grbl_protocol.parse_build_info(line)) is not None:
                return build
        self.mark_out_of_step()
        raise ReplyGarbled(
            "the answer to $I has no version.", where=self.name, remedy="Check that the firmware is GRBL 1.1."
        )

    # ------------------------------------------------------------ inside

    def _query_status_once(self, *, deadline_s: float = _REPLY_S, urgent: bool = False) -> StatusReport:
        def read_reply(reader: ReplyReader) -> StatusReport:
            line = reader.read_line()
            report = grbl_protocol.parse_report(line, self.name)
            if report is None:
                raise ReplyGarbled(
                    f"{line[:80]!r} came instead of a status report.",
                    where=self.name,
                    remedy="Check the cable.",
                )
            return report

        return self._exchange(grbl_protocol.STATUS, read_reply, deadline_s=deadline_s, urgent=urgent)

    def _exchange(
        self, request: bytes, read: Callable[[ReplyReader], T], *, deadline_s: float, urgent: bool = False
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

        return self.exchange(request, read_awake, deadline_s=deadline_s, urgent=urgent)

    def _read_reply(self, sent: str, reader: ReplyReader) -> list[bytes]:
        lines = []
        while grbl_protocol.parse_response(line := reader.read_line()) is None:
            lines.append(line)
            if len(lines) > _LONGEST_REPLY:
                raise ReplyGarbled(
                    f"the answer to {sent} never ends.", where=self.name, remedy="Check the port."
                )
        self._raise_if_error(sent, line)
        return lines

    def _raise_if_error(self, sent: str, response: bytes) -> None:
        code = grbl_protocol.parse_response(response)
        if code:
            raise DeviceRefused(
                f"the board refuses '{sent}': {grbl_protocol.ERRORS.get(code, 'unknown error')} (error:{code}).",
                where=self.name,
                remedy="Look the error up in the firmware's list of errors.",
            )

    def _next_line(self) -> bytes | None:
        """Return the next line that has come already and is no push message."""
        with self.lock:
            self.receive(0.0)
            while (line := self.take_line()) is not None:
                if not self.route_unsolicited(line):
                    return line
        return None

    def _take_push_message(self, line: bytes) -> bool:
        if grbl_protocol.is_welcome(line):
            self.restarts += 1
            self.needs_reset = False
            return True
        alarm = grbl_protocol.parse_alarm(line)
        if alarm is not None:
            self.alarms.append(alarm)
            self.needs_reset |= alarm in _HALTING_ALARMS
        return alarm is not None or grbl_protocol.is_informational(line)

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
            self._exchange(_INVALID_LINE, self._read_to_error, deadline_s=_REPLY_S, urgent=True)
            self._query_status_once(deadline_s=_MARKER_S, urgent=True)
            self._exchange(b"\n", self._read_single_ok, deadline_s=_MARKER_S, urgent=True)

        self.prove_in_step(
            exchange_marker,
            quiet_s=_QUIET_S,
            limit_s=_LONGEST_DRAIN_S,
            failed="the board sends more than it was asked for.",
            remedy="Check the port.",
            inspect_old=self._take_push_messages,
        )

    def _read_to_error(self, reader: ReplyReader) -> None:
        """Read until an error comes: the answers to older lines come first."""
        while not grbl_protocol.parse_response(reader.read_line()):
            pass

    def _read_single_ok(self, reader: ReplyReader) -> None:
        line = reader.read_line()
        if grbl_protocol.parse_response(line) != 0:
            raise ReplyGarbled(
                f"{line[:80]!r} answers an empty line.", where=self.name, remedy="Check the port."
            )

    def _take_push_messages(self, old: bytes) -> None:
        """Note the restarts and alarms in bytes that are thrown away."""
        for line in old.splitlines(keepends=True):
            self._take_push_message(line)
