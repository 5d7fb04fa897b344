"""Talk to one XIMC controller on its line: repeated queries, resynchronising by zeros, positions in microsteps.

Degrees belong to ``drivers.stage.ximc``, the forms of messages to ``drivers.stage.ximc_protocol``.
"""

from __future__ import annotations

import struct

from drivers.clock import Clock
from drivers.errors import DeviceRefused, ReplyGarbled
from drivers.link import Link, ReplyReader
from drivers.retry import repeat
from drivers.serial_port import Port
from drivers.stage import ximc_protocol
from drivers.stage.ximc_protocol import EdgeSettings, MoveSettings, Status
from drivers.wire_log import WireLog

_REPLY_S = 1.0
_MARKER_S = 0.5
_QUIET_S = 0.05
_LONGEST_DRAIN_S = 1.0


class XimcController(Link):
    """The controller of one axis, on its own line. Opening asks for settings; it sets nothing.

    port: The open port; the protocol needs 115200 baud and two stop bits.
    clock, wire_log: See ``drivers.link.Link``.
    division: Microsteps per full step.
    Raises DeviceRefused: The controller drives no stepper motor, or counts by an encoder.
    Raises ReplyError, PortLost: The controller does not answer.
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        super().__init__(port, clock=clock, resynchronise=self._resynchronise, wire_log=wire_log)
        self.mark_out_of_step()
        self.serial = self.read_serial()
        self._check_units()
        self.division: int = self._query_division()

    def read_serial(self) -> str:
        """Ask for the serial number."""
        layout = ximc_protocol.SERIAL_LAYOUT
        return str(layout.unpack(self._query("gser", layout))[0])

    def read_identity(self) -> tuple[str, str, str]:
        """Ask for maker, model and firmware."""
        layout = ximc_protocol.INFORMATION_LAYOUT
        maker, _, model, *_ = layout.unpack(self._query("geti", layout))
        version = ximc_protocol.VERSION_LAYOUT
        major, minor, release = version.unpack(self._query("gfwv", version))
        return _text(maker), _text(model), f"{major}.{minor}.{release}"

    def read_status(self) -> Status:
        """Ask for the state of the axis."""
        return Status.unpack(self._query("gets", Status.LAYOUT))

    def read_move_settings(self) -> MoveSettings:
        """Ask for speed and acceleration.

        Returns: The settings, in the controller's units.
        """
        return MoveSettings.unpack(self._query("gmov", MoveSettings.LAYOUT))

    def read_edge_settings(self) -> EdgeSettings:
        """Ask for the borders at which the controller itself stops.

        Returns: The settings, in the controller's units.
        """
        return EdgeSettings.unpack(self._query("geds", EdgeSettings.LAYOUT))

    def set(self, command: str, data: bytes) -> None:
        """Send a setting; repeat it when its echo does not come, which does no harm.

        data: Data of the command, without CRC.
        Raises ReplyTimeout, ReplyGarbled: No valid echo came at the last attempt.
        """
        repeat(lambda: self.command(command, data))

    def command(self, command: str, data: bytes = b"", *, urgent: bool = False) -> None:
        """Send a command, once, and wait for its echo.

        data: Data of the command, without CRC.
        urgent: Send at once, without resynchronising.
        Raises ReplyTimeout, ReplyGarbled: No valid echo came.
        """

        def read_reply(reader: ReplyReader) -> None:
            ximc_protocol.check_head(command, reader.read_exactly(4), self.name)

        request = ximc_protocol.request(command, data)
        self.exchange(request, read_reply, deadline_s=_REPLY_S, urgent=urgent)

    def move(self, count: int) -> None:
        """Start a move; the command is sent once.

        Raises ReplyTimeout, ReplyGarbled: No valid echo came: the axis may be moving.
        """
        self.command("move", ximc_protocol.move_data(*self.to_steps(count)))

    def stop(self) -> None:
        """Ramp down at once, without resynchronising; repeat the stop when its echo does not come.

        Raises ReplyError: No echo came at the last attempt.
        """
        with self.lock:
            repeat(
                lambda: self.command("sstp", urgent=True),
                before_next=lambda: self.drain(_QUIET_S, _LONGEST_DRAIN_S),
            )

    def to_microsteps(self, steps: int, microsteps: int) -> int:
        """Return a position in microsteps.

        microsteps: Microsteps beyond the full steps.
        """
        return steps * self.division + microsteps

    def to_steps(self, count: int) -> tuple[int, int]:
        """Split a position into full steps and microsteps of the same sign.

        Returns: Full steps, and microsteps beyond them.
        """
        steps, microsteps = divmod(abs(count), self.division)
        return (steps, microsteps) if count >= 0 else (-steps, -microsteps)

    # ------------------------------------------------------------ inside

    def _check_units(self) -> None:
        """Raise DeviceRefused unless positions are steps of a stepper motor."""
        layout = ximc_protocol.ENGINE_TYPE_LAYOUT
        engine_type, _ = layout.unpack(self._query("gent", layout))
        if engine_type != ximc_protocol.STEPPER:
            raise DeviceRefused(
                f"the controller drives no stepper motor (engine type {engine_type}), so its units differ.",
                where=self.name,
                remedy="Use a stage with a stepper motor; this driver supports no other.",
            )
        layout = ximc_protocol.FEEDBACK_LAYOUT
        _, feedback, *_ = layout.unpack(self._query("gfbs", layout))
        if feedback in ximc_protocol.BY_ENCODER:
            raise DeviceRefused(
                f"the controller counts by its encoder (feedback type {feedback}), and its speeds are in rpm.",
                where=self.name,
                remedy="Set its feedback to 'None' with the maker's software; this driver can still read the encoder.",
            )

    def _query_division(self) -> int:
        engine = ximc_protocol.ENGINE_LAYOUT.unpack(self._query("geng", ximc_protocol.ENGINE_LAYOUT))
        mode: int = engine[ximc_protocol.MICROSTEP_MODE]
        if not 1 <= mode <= 9:
            raise ReplyGarbled(
                f"unknown step division mode {mode}.",
                where=self.name,
                remedy="Look the mode up in the controller's manual.",
            )
        return 1 << (mode - 1)

    def _query(self, command: str, layout: struct.Struct) -> bytes:
        """Send a query, repeat it when no valid reply comes, and return the data of the reply."""
        return repeat(lambda: self._query_once(command, layout))

    def _query_once(
        self, command: str, layout: struct.Struct, *, deadline_s: float = _REPLY_S, urgent: bool = False
    ) -> bytes:
        def read_reply(reader: ReplyReader) -> bytes:
            ximc_protocol.check_head(command, reader.read_exactly(4), self.name)
            return ximc_protocol.check_data(command, reader.read_exactly(layout.size + 2), self.name)

        return self.exchange(ximc_protocol.request(command), read_reply, deadline_s=deadline_s, urgent=urgent)

    def _resynchronise(self) -> None:
        """Complete by zeros what the controller waits for; then get its serial number, alone on the line."""

        def clear_device() -> None:
            self.write(ximc_protocol.SYNCHRONISE)
            self.drain(_QUIET_S, _LONGEST_DRAIN_S)

        self.prove_in_step(
            lambda: self._query_once("gser", ximc_protocol.SERIAL_LAYOUT, deadline_s=_MARKER_S, urgent=True),
            quiet_s=_QUIET_S,
            limit_s=_LONGEST_DRAIN_S,
            clear_device=clear_device,
        )


def _text(field: bytes) -> str:
    return field.rstrip(b"\0 ").decode("ascii", errors="replace")
