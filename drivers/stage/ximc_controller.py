"""Knows how to ask one XIMC controller on its line: retries, resynchronising by zeros, counts in microsteps.

Knows no degrees; see ``drivers.stage.ximc``.
"""

from __future__ import annotations

import struct
import threading

from drivers.clock import Clock
from drivers.errors import DeviceRefused, ReplyGarbled
from drivers.link import Incoming, Link
from drivers.retry import repeat, resynchronise
from drivers.serial_port import Port
from drivers.stage import ximc_protocol
from drivers.stage.ximc_protocol import EdgeSettings, MoveSettings, Status
from drivers.wire_log import WireLog

_REPLY_S = 1.0
_MARKER_S = 0.5
_QUIET_S = 0.05
_LOUD_S = 1.0


class XimcController:
    """One controller, of one axis, on one line. Opening sends questions only.

    Parameters
    ----------
    port
        The open port; the protocol wants 115200 baud and two stop bits.
    clock, wire_log
        See ``drivers.link.Link``.

    Attributes
    ----------
    serial
        Its serial number.
    division
        Microsteps in a full step.

    Raises
    ------
    DeviceRefused
        When it drives no stepper motor, or counts by an encoder.
    ReplyError, PortLost
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self._link = Link(port, clock=clock, resynchronise=self._resynchronise, wire_log=wire_log)
        self._link.distrust()
        self.serial = self.read_serial()
        layout = ximc_protocol.ENGINE_TYPE_LAYOUT
        engine_type, _ = layout.unpack(self._get("gent", layout))
        if engine_type != ximc_protocol.STEPPER:
            raise DeviceRefused(
                f"the controller drives no stepper motor (engine type {engine_type}); its units are others.",
                where=self.name,
                remedy="Use a stepper stage; this driver knows no other.",
            )
        _, feedback, *_ = ximc_protocol.FEEDBACK_LAYOUT.unpack(
            self._get("gfbs", ximc_protocol.FEEDBACK_LAYOUT)
        )
        if feedback in ximc_protocol.BY_ENCODER:
            raise DeviceRefused(
                f"the controller counts by its encoder (feedback type {feedback}), and its speeds are in rpm.",
                where=self.name,
                remedy="Set its feedback to 'None' with the maker's software; the encoder is read all the same.",
            )
        engine = ximc_protocol.ENGINE_LAYOUT.unpack(self._get("geng", ximc_protocol.ENGINE_LAYOUT))
        mode: int = engine[ximc_protocol.MICROSTEP_MODE]
        if not 1 <= mode <= 9:
            raise ReplyGarbled(
                f"unknown step division mode {mode}.", where=self.name, remedy="See its manual."
            )
        self.division: int = 1 << (mode - 1)

    @property
    def name(self) -> str:
        """The port's name."""
        return self._link.name

    @property
    def lock(self) -> threading.RLock:
        """Held, nobody else can send."""
        return self._link.lock

    def read_serial(self) -> str:
        """Ask for the serial number."""
        layout = ximc_protocol.SERIAL_LAYOUT
        return str(layout.unpack(self._get("gser", layout))[0])

    def identity(self) -> tuple[str, str, str]:
        """Ask for maker, model and firmware."""
        layout = ximc_protocol.INFORMATION_LAYOUT
        maker, _, model, *_ = layout.unpack(self._get("geti", layout))
        version = ximc_protocol.VERSION_LAYOUT
        major, minor, release = version.unpack(self._get("gfwv", version))
        return _text(maker), _text(model), f"{major}.{minor}.{release}"

    def status(self) -> Status:
        """Ask for everything about the axis at this moment."""
        return Status.unpack(self._get("gets", Status.LAYOUT))

    def move_settings(self) -> MoveSettings:
        """Ask for speed and acceleration."""
        return MoveSettings.unpack(self._get("gmov", MoveSettings.LAYOUT))

    def edge_settings(self) -> EdgeSettings:
        """Ask where the controller stops by itself."""
        return EdgeSettings.unpack(self._get("geds", EdgeSettings.LAYOUT))

    def set(self, command: str, data: bytes) -> None:
        """Send a setting; sent again when its echo is lost, which does no harm."""
        repeat(lambda: self.command(command, data))

    def command(self, command: str, data: bytes = b"", *, urgent: bool = False) -> None:
        """Send a command, once, and see it echoed.

        Raises DeviceRefused, ReplyTimeout, ReplyGarbled, PortLost.
        """

        def receive(incoming: Incoming) -> None:
            ximc_protocol.check_head(command, incoming.exactly(4), self.name)

        request = ximc_protocol.request(command, data)
        self._link.exchange(request, receive, deadline_s=_REPLY_S, urgent=urgent)

    def move(self, count: int) -> None:
        """Start a move to a count of microsteps, sent once."""
        self.command("move", ximc_protocol.move_data(*self.split(count)))

    def stop(self) -> None:
        """Ramp down, at once and before any resynchronising; sent again until it is echoed."""
        with self._link.lock:
            repeat(
                lambda: self.command("sstp", urgent=True),
                before_next=lambda: self._link.drain(_QUIET_S, _LOUD_S),
            )

    def count(self, steps: int, microsteps: int) -> int:
        """Return a position in microsteps."""
        return steps * self.division + microsteps

    def split(self, count: int) -> tuple[int, int]:
        """Split a count into full steps and microsteps of the same sign."""
        steps, microsteps = divmod(abs(count), self.division)
        return (steps, microsteps) if count >= 0 else (-steps, -microsteps)

    def listen(self, seconds: float) -> None:
        """Wait that long for what comes. A wait that no clock interrupts: for stopping only."""
        with self._link.lock:
            self._link.fill(seconds)

    def close(self) -> None:
        """Give the port back."""
        self._link.close()

    # ------------------------------------------------------------ inside

    def _get(self, command: str, layout: struct.Struct) -> bytes:
        """Send a question, up to three times, and return its data."""
        return repeat(lambda: self._ask(command, layout))

    def _ask(
        self, command: str, layout: struct.Struct, *, deadline_s: float = _REPLY_S, urgent: bool = False
    ) -> bytes:
        def receive(incoming: Incoming) -> bytes:
            ximc_protocol.check_head(command, incoming.exactly(4), self.name)
            return ximc_protocol.check_data(command, incoming.exactly(layout.size + 2), self.name)

        return self._link.exchange(
            ximc_protocol.request(command), receive, deadline_s=deadline_s, urgent=urgent
        )

    def _resynchronise(self) -> None:
        """Fill up by zeros what the controller waits for, then ask for its serial number, alone on the line."""

        def clear_device() -> None:
            self._link.send(ximc_protocol.SYNCHRONISE)
            self._link.drain(_QUIET_S, _LOUD_S)

        def exchange_marker() -> bool:
            self._ask("gser", ximc_protocol.SERIAL_LAYOUT, deadline_s=_MARKER_S, urgent=True)
            return True

        if not resynchronise(
            self._link, exchange_marker, quiet_s=_QUIET_S, limit_s=_LOUD_S, clear_device=clear_device
        ):
            raise ReplyGarbled(
                "more bytes come than were asked for.",
                where=self.name,
                remedy="Check the port and the cable.",
            )


def _text(field: bytes) -> str:
    return field.rstrip(b"\0 ").decode("ascii", errors="replace")
