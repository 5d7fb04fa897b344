"""Knows how to ask a GRBL board on its line: lines and their ``ok``, real-time bytes, alarms and restarts.

Knows no degrees; see ``drivers.stage.grbl``.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence

from drivers.clock import Clock
from drivers.errors import DeviceRefused, MoveTimeout, ReplyGarbled
from drivers.link import Incoming, Link
from drivers.retry import repeat, resynchronise
from drivers.serial_port import Port
from drivers.stage import grbl_protocol, motion
from drivers.stage.grbl_protocol import Report
from drivers.wire_log import WireLog

_REPLY_S = 1.0
_MARKER_S = 0.5
_QUIET_S = 0.1
_LOUD_S = 1.0
_BOOT_TRIES = 6
"""A board that restarts because its port was opened says nothing for a second or two."""
_SPOILER = b"Q\n"
"""A letter without a number: whatever half line the board still holds, with this at its end it is refused."""


class GrblController:
    """A GRBL board on one line. Opening sends questions only.

    Parameters
    ----------
    port
        The open port.
    clock, wire_log
        See ``drivers.link.Link``.

    Attributes
    ----------
    restarts
        How often the board has said that it started, since we listen.
    alarms
        Codes of the alarms it has raised, oldest first.

    Raises
    ------
    ReplyError, PortLost
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self.restarts = 0
        self.alarms: list[int] = []
        self._clock = clock
        self._link = Link(
            port,
            clock=clock,
            resynchronise=self._resynchronise,
            unsolicited=self._take_push,
            wire_log=wire_log,
        )
        self._wait_for_boot()

    @property
    def name(self) -> str:
        """The port's name."""
        return self._link.name

    @property
    def lock(self) -> threading.RLock:
        """Held, nobody else can send."""
        return self._link.lock

    def report(self) -> Report:
        """Ask for state and position, up to three times."""
        return repeat(self._report)

    def ask(self, line: str) -> list[bytes]:
        """Send a line that does no harm when it is sent again; return the lines before its ``ok``.

        Raises DeviceRefused, ReplyError, PortLost.
        """
        return repeat(lambda: self.tell(line))

    def tell(self, line: str) -> list[bytes]:
        """Send a line, once; return the lines before its ``ok``. Raises as ``ask``."""
        return self._link.exchange(
            f"{line}\n".encode("ascii"), lambda incoming: self._answer(line, incoming), deadline_s=_REPLY_S
        )

    def begin_homing(self) -> None:
        """Start homing; the board answers nothing until it has ended. Raises ReplyError, PortLost."""
        with self._link.lock:
            self._link.come_into_step()
            self._link.send(b"$H\n")
            self._link.distrust()

    def await_homing(self) -> None:
        """Wait for the ``ok`` at the end of homing.

        Raises DeviceRefused, MoveTimeout, PortLost; and what the clock raises.
        """
        end_s = self._clock.monotonic() + motion.LONGEST_HOMING_S
        restarts = self.restarts
        while self._clock.monotonic() < end_s:
            self._clock.sleep(motion.POLL_S)
            line = self._next_line()
            if line is not None and grbl_protocol.parse_verdict(line) is not None:
                self._judge("$H", line)
                return
            if self.restarts != restarts:
                return
        raise MoveTimeout(
            f"homing has not ended after {motion.LONGEST_HOMING_S:g} s.",
            where=self.name,
            remedy="See what blocks the axes.",
        )

    def stop_jog(self) -> None:
        """Ramp down and forget what was to come; the position is kept."""
        self._link.send(grbl_protocol.CANCEL_JOG)

    def reset(self) -> None:
        """Stop at once, whatever it does; while it moves, the position is lost."""
        self._link.send(grbl_protocol.RESET)
        self._link.distrust()

    def settings(self) -> dict[int, float]:
        """Ask for all settings, by number."""
        found = [grbl_protocol.parse_setting(line) for line in self.ask("$$")]
        return dict(setting for setting in found if setting is not None)

    def build(self) -> tuple[str, str]:
        """Ask for version and name."""
        for line in self.ask("$I"):
            if (build := grbl_protocol.parse_build(line)) is not None:
                return build
        self._link.distrust()
        raise ReplyGarbled("$I tells no version.", where=self.name, remedy="See that this is GRBL 1.1.")

    def listen(self, seconds: float) -> None:
        """Wait that long for what comes. A wait that no clock interrupts: for stopping only."""
        with self._link.lock:
            self._link.fill(seconds)

    def close(self) -> None:
        """Give the port back."""
        self._link.close()

    # ------------------------------------------------------------ inside

    def _report(self, *, deadline_s: float = _REPLY_S, urgent: bool = False) -> Report:
        def receive(incoming: Incoming) -> Report:
            line = incoming.line()
            report = grbl_protocol.parse_report(line, self.name)
            if report is None:
                raise ReplyGarbled(
                    f"{line[:80]!r} where a status report belongs.",
                    where=self.name,
                    remedy="Check the cable.",
                )
            return report

        return self._link.exchange(grbl_protocol.STATUS, receive, deadline_s=deadline_s, urgent=urgent)

    def _answer(self, sent: str, incoming: Incoming) -> list[bytes]:
        lines = []
        while grbl_protocol.parse_verdict(line := incoming.line()) is None:
            lines.append(line)
            if len(lines) > 100:
                raise ReplyGarbled(
                    f"{sent} is answered without end.", where=self.name, remedy="Check the port."
                )
        self._judge(sent, line)
        return lines

    def _judge(self, sent: str, verdict: bytes) -> None:
        code = grbl_protocol.parse_verdict(verdict)
        if code:
            raise DeviceRefused(
                f"the board refuses '{sent}': {grbl_protocol.ERRORS.get(code, 'see its list')} (error:{code}).",
                where=self.name,
                remedy="See the firmware's list of errors.",
            )

    def _next_line(self) -> bytes | None:
        """Return a line that has come already, those nobody asked for routed away."""
        with self._link.lock:
            self._link.fill(0.0)
            while (line := self._link.take_line()) is not None:
                if not self._link.route(line):
                    return line
        return None

    def _take_push(self, line: bytes) -> bool:
        if grbl_protocol.is_banner(line):
            self.restarts += 1
            return True
        alarm = grbl_protocol.parse_alarm(line)
        if alarm is not None:
            self.alarms.append(alarm)
        return alarm is not None or grbl_protocol.is_chatter(line)

    def _wait_for_boot(self) -> None:
        repeat(self._report, tries=_BOOT_TRIES)
        self._link.distrust()  # it may still hold half a line of somebody before us

    def _resynchronise(self) -> None:
        """Spoil what half line the board holds and wait for its refusal; then one ``ok`` to an empty line, alone."""

        def exchange_marker() -> bool:
            self._link.exchange(_SPOILER, self._refusal, deadline_s=_REPLY_S, urgent=True)
            self._report(deadline_s=_MARKER_S, urgent=True)
            self._link.exchange(b"\n", self._single_ok, deadline_s=_MARKER_S, urgent=True)
            return True

        if not resynchronise(
            self._link, exchange_marker, quiet_s=_QUIET_S, limit_s=_LOUD_S, hear=self._route_all
        ):
            raise ReplyGarbled(
                "the board says more than it was asked.", where=self.name, remedy="Check the port."
            )

    def _refusal(self, incoming: Incoming) -> None:
        """Receive until something is refused: answers to what was asked before come first."""
        while not grbl_protocol.parse_verdict(incoming.line()):
            pass

    def _single_ok(self, incoming: Incoming) -> None:
        line = incoming.line()
        if grbl_protocol.parse_verdict(line) != 0:
            raise ReplyGarbled(
                f"{line[:80]!r} answers an empty line.", where=self.name, remedy="Check the port."
            )

    def _route_all(self, thrown: bytes) -> None:
        """Hear restarts and alarms out of what is thrown away."""
        for line in thrown.splitlines(keepends=True):
            self._take_push(line)


def machine_of(report: Report, places: Sequence[int], where: str) -> tuple[float, ...]:
    """Return the machine positions at some places of a report. Raises ReplyGarbled when it has fewer."""
    if max(places) >= len(report.machine):
        raise ReplyGarbled(
            f"the board reports {len(report.machine)} axes only.",
            where=where,
            remedy="Check the axis letters in the station file.",
        )
    return tuple(report.machine[place] for place in places)
