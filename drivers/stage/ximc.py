"""Standa stages over XIMC: one controller and one port an axis, in degrees.

This module decides what a controller's state means for a move. ``drivers.stage.watched`` watches the moves.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from drivers.clock import Clock
from drivers.errors import DeviceRefused, OutsideLimits
from drivers.link import TRIES, ReplyReader, repeat
from drivers.serial_port import LineSettings, Port
from drivers.stage import AxisIdentity, motion, ximc_protocol
from drivers.stage.line_per_axis import AxisController, LinePerAxisStage
from drivers.stage.motion import Axis
from drivers.stage.refusals import CHECK_PORTS, not_movable, read_back_otherwise
from drivers.stage.watched import AxisState
from drivers.stage.ximc_protocol import (
    EdgeSettings,
    EngineSettings,
    HomeSettings,
    MoveSettings,
    PowerSettings,
    Settings,
    Status,
    SyncInSettings,
)
from drivers.wire_log import WireLog

_MARKER_S = 0.5  # Longest wait for the serial number; after it no older reply follows

S = TypeVar("S", bound=Settings)
_OWN_COMMANDS = {"move", "home"}


class XimcController(AxisController):
    """The controller of one axis, on its own line. Opening asks for settings; it sets nothing.

    The protocol needs 115200 baud and two stop bits; ``division`` is microsteps per full step. A controller that drives
    no stepper motor, or counts by an encoder, is refused.
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        super().__init__(port, clock=clock, wire_log=wire_log)
        self.mark_out_of_step()
        self.serial = self.read_serial()
        self._check_units()
        self.division: int = self._read_division()

    def read_serial(self) -> str:
        """Ask for the serial number."""
        return str(self._query("gser", ximc_protocol.SERIAL_LAYOUT)[0])

    def read_identity(self) -> tuple[str, str, str]:
        """Ask for maker, model and firmware."""
        maker, _, model, *_ = self._query("geti", ximc_protocol.INFORMATION_LAYOUT)
        major, minor, release = self._query("gfwv", ximc_protocol.VERSION_LAYOUT)
        return _text(maker), _text(model), f"{major}.{minor}.{release}"

    def read_status(self) -> Status:
        """Ask for the state of the axis."""
        return Status(*self._query("gets", Status.LAYOUT))

    def read_settings(self, kind: type[S]) -> S:
        """Ask for settings, which are in the controller's units."""
        return kind(*self._query(kind.READ, kind.LAYOUT))

    def set(self, command: str, data: bytes) -> None:
        """Send a setting, data without CRC; repeat it when its echo does not come, which does no harm."""
        repeat(lambda: self.command(command, data))

    def command(self, command: str, data: bytes = b"") -> None:
        """Send a command, data without CRC, once, and wait for its echo."""

        def read_reply(reader: ReplyReader) -> None:
            ximc_protocol.check_head(command, reader.read_exactly(4), self.name)

        self.exchange(ximc_protocol.request(command, data), read_reply)

    def move(self, count: int) -> None:
        """Start a move; the command is sent once. Without a valid echo the axis may be moving."""
        self.command("move", ximc_protocol.move_data(*self.to_steps(count)))

    def stop(self) -> None:
        """Ramp down at once, without resynchronising; repeat the stop when its echo does not come."""
        with self.urgently():
            repeat(lambda: self.command("sstp"), before_next=self.drain)

    def to_microsteps(self, steps: int, microsteps: int) -> int:
        """Return a position in microsteps, from full steps and the microsteps beyond them."""
        return steps * self.division + microsteps

    def to_steps(self, count: int) -> tuple[int, int]:
        """Split a position into full steps and microsteps of the same sign."""
        steps, microsteps = divmod(abs(count), self.division)
        return (steps, microsteps) if count >= 0 else (-steps, -microsteps)

    # ------------------------------------------------------------ inside

    def _check_units(self) -> None:
        """Raise DeviceRefused unless positions are steps of a stepper motor."""
        engine_type, _ = self._query("gent", ximc_protocol.ENGINE_TYPE_LAYOUT)
        if engine_type != ximc_protocol.STEPPER:
            raise DeviceRefused(
                f"the controller drives no stepper motor (engine type {engine_type}), so its units differ.",
                where=self.name,
                remedy="Use a stage with a stepper motor; this driver supports no other.",
            )
        _, feedback, *_ = self._query("gfbs", ximc_protocol.FEEDBACK_LAYOUT)
        if feedback in ximc_protocol.BY_ENCODER:
            raise DeviceRefused(
                f"the controller counts by its encoder (feedback type {feedback}), and its speeds are in rpm.",
                where=self.name,
                remedy="Set its feedback to 'None' with the maker's software; this driver can still read the encoder.",
            )

    def _read_division(self) -> int:
        mode = self.read_settings(EngineSettings).microstep_mode
        if not 1 <= mode <= 9:
            what = f"unknown step division mode {mode}."
            raise self.garbled_reply(what, "Look the mode up in the controller's manual.")
        return 1 << (mode - 1)

    def _query(self, command: str, layout: struct.Struct, *, tries: int = TRIES) -> tuple[Any, ...]:
        """Send a query, ``tries`` times in all until its reply is valid; return the values in its data."""

        def read_reply(reader: ReplyReader) -> bytes:
            ximc_protocol.check_head(command, reader.read_exactly(4), self.name)
            return ximc_protocol.check_data(command, reader.read_exactly(layout.size + 2), self.name)

        request = ximc_protocol.request(command)
        return layout.unpack(repeat(lambda: self.exchange(request, read_reply), tries=tries))

    def _resynchronise(self) -> None:
        """Complete by zeros what the controller waits for; then get its serial number, alone on the line."""

        def clear_device() -> None:
            self.write(ximc_protocol.SYNCHRONISE)
            self.drain()

        self.prove_in_step(
            lambda: self._query("gser", ximc_protocol.SERIAL_LAYOUT, tries=1),
            marker_s=_MARKER_S,
            clear_device=clear_device,
        )


def _text(field: bytes) -> str:
    return field.rstrip(b"\0 ").decode("ascii", errors="replace")


@dataclass(frozen=True, kw_only=True)
class XimcAxis(Axis):
    """One axis as the station file describes it. Homing sets the counter to 0 at ``zero_deg``."""

    port: str
    steps_per_deg: float  # Full steps per degree; negative when the counter falls as the angle grows
    # Encoder counts per degree, with sign; None without an encoder.
    encoder_counts_per_deg: float | None = None
    # Way from the sensor to the zero, by the counter, in degrees; None if the controller adds none.
    home_offset_deg: float | None = None
    reversed: bool | None = None  # Whether the controller reverses the motor; None if that is not compared
    division: int = 1  # Microsteps per full step; the driver asks the controller

    @property
    def scale(self) -> float:
        """Microsteps per degree."""
        return self.steps_per_deg * self.division


class XimcStage(LinePerAxisStage[XimcAxis, XimcController]):
    """A stage of one to three Standa axes. Implements ``drivers.stage.Stage``.

    Limits, speed or acceleration beyond the controller's raise `OutsideLimits`.
    """

    SETTINGS = LineSettings(115200, frame="8N2")  # as the protocol has it
    CONTROLLER = XimcController

    def _set_up(self) -> None:
        self._axes = {
            name: replace(axis, division=self._lines[name].division) for name, axis in self._axes.items()
        }

    def _identity_of(self, axis: XimcAxis) -> AxisIdentity:
        controller = self._lines[axis.name]
        serial = controller.read_serial()
        self._require_serial(axis, serial, f"{serial} answers", where=controller.name, remedy=CHECK_PORTS)
        maker, model, firmware = controller.read_identity()
        return AxisIdentity(axis.name, maker, model, serial, firmware)

    # ------------------------------------------------------------ on the wire

    def _clear_faults(self, axis: XimcAxis) -> None:
        """Clear an alarm by a stop command, which has an effect when the cause of the alarm is gone."""
        controller = self._lines[axis.name]
        if controller.read_status().faults:
            controller.command("stop")
        self._raise_faults(axis, controller.read_status())
        self._program(axis)

    def _begin_move(self, axis: XimcAxis, angle_deg: float) -> None:
        self._lines[axis.name].move(axis.to_counts(angle_deg))

    def _begin_homing(self, axis: XimcAxis) -> None:
        self._lines[axis.name].command("home")

    def _read_state(self, axis: XimcAxis, *, homing: bool = False) -> AxisState:
        """Read position, busy state and problems from one reply."""
        controller = self._lines[axis.name]
        status = controller.read_status()
        position_deg = axis.to_angle_deg(controller.to_microsteps(status.steps, status.microsteps))
        if status.homed and status.running and status.command not in _OWN_COMMANDS and not status.faults:
            problem = f"interrupted by another command ({status.command})"
            return AxisState(position_deg, status.running, problem, position_kept=True)
        problem = self._problem(status, homing=homing)
        if not problem and status.failed:
            problem = f"the controller reports that its {status.command} failed"
        return AxisState(position_deg, status.running, problem)

    def _finish_homing(self, axis: XimcAxis) -> None:
        """Set the counter and the encoder to zero at the reference."""
        self._lines[axis.name].set("zero", b"")

    def _stop_one(self, name: str) -> None:
        self._lines[name].stop()

    def _read_encoder(self, axis: XimcAxis) -> AxisState | None:
        if axis.encoder_counts_per_deg is None:
            return None
        status = self._lines[axis.name].read_status()
        return AxisState(axis.zero_deg + status.encoder / axis.encoder_counts_per_deg, status.running)

    # ------------------------------------------------------------ settings

    def _program(self, axis: XimcAxis) -> None:
        """Set everything, as for all families; refuse what cannot be known."""
        controller = self._lines[axis.name]
        self._check_division(axis)
        sync = controller.read_settings(SyncInSettings)
        self._set(axis, sync, replace(sync, flags=sync.flags & ~ximc_protocol.SYNC_IN_MOVES), "sync input")
        power = controller.read_settings(PowerSettings)
        self._set(axis, power, replace(power, flags=power.flags & ~ximc_protocol.POWER_OFF), "motor current")
        self._program_engine(axis)
        self._program_home(axis)
        self._program_speed(axis)
        self._program_borders(axis)

    def _check_division(self, axis: XimcAxis) -> None:
        """Refuse microsteps that have changed since the counter was read by them."""
        mode = self._lines[axis.name].read_settings(EngineSettings).microstep_mode
        if axis.division != 1 << (mode - 1):
            raise not_movable(
                axis,
                f"the controller counts {1 << (mode - 1)} microsteps a step, and {axis.division} when it was opened",
                "Open the stage again.",
            )

    def _program_engine(self, axis: XimcAxis) -> None:
        """Switch off what overruns a target or leaves the ramps, and compare the direction of the motor."""
        present = self._lines[axis.name].read_settings(EngineSettings)
        is_reversed = bool(present.flags & ximc_protocol.ENGINE_REVERSED)
        if axis.reversed is not None and axis.reversed != is_reversed:
            raise OutsideLimits(
                f"the station file has reversed: {str(axis.reversed).lower()}, but the controller"
                f" {'reverses' if is_reversed else 'does not reverse'} the motor. Nothing was set.",
                where=axis.name,
                remedy="Set it with the maker's software, or correct reversed and the sign of steps_per_deg.",
            )
        unwanted = ximc_protocol.ENGINE_AT_FULL_SPEED | ximc_protocol.ENGINE_ANTIPLAY
        flags = present.flags & ~unwanted | ximc_protocol.ENGINE_RAMPS
        self._set(axis, present, replace(present, flags=flags), "engine")
        highest = present.speed * axis.division + present.speed_microsteps
        wanted = axis.limits.speed_deg_s * abs(axis.scale)
        if flags & ximc_protocol.ENGINE_LIMITS_SPEED and wanted > highest:
            raise OutsideLimits(
                f"the controller limits the motor to {highest / abs(axis.scale):.6g} deg/s.",
                where=axis.name,
                remedy="Lower speed_deg_s in the station file, or raise the limit with the maker's software.",
            )

    def _program_home(self, axis: XimcAxis) -> None:
        """Set the way from the sensor to the zero; the speeds and the sensor belong to the stage."""
        controller = self._lines[axis.name]
        present = controller.read_settings(HomeSettings)
        if axis.home_offset_deg is None:
            offset = controller.to_microsteps(present.offset, present.offset_microsteps)
            if offset:
                raise OutsideLimits(
                    "the station file does not say where the zero is, and the controller goes"
                    f" {offset / axis.scale:.6g} deg on from its sensor. Nothing was set.",
                    where=axis.name,
                    remedy=f"Write home_offset_deg: {offset / axis.scale:.6g} into the station file, or 0.",
                )
            return
        steps, microsteps = controller.to_steps(round(axis.home_offset_deg * axis.scale))
        wanted = replace(present, offset=steps, offset_microsteps=microsteps)
        self._set(axis, present, wanted, "home settings")

    def _homing_speed_deg_s(self, axis: XimcAxis) -> float | None:
        """Ask for the speed of the search; its end is slow, so a tenth of its way is at the lower speed."""
        controller = self._lines[axis.name]
        home = controller.read_settings(HomeSettings)
        fast = controller.to_microsteps(home.fast, home.fast_microsteps)
        slow = controller.to_microsteps(home.slow, home.slow_microsteps)
        return min(fast, 10 * slow) / abs(axis.scale)

    def _program_speed(self, axis: XimcAxis) -> None:
        """Set speed and acceleration where they differ, and read them back."""
        controller = self._lines[axis.name]
        scale = abs(axis.steps_per_deg)
        speed = math.floor(axis.limits.speed_deg_s * scale * controller.division)
        ramp = math.floor(axis.limits.acceleration_deg_s2 * scale)
        if not 1 <= ramp <= 0xFFFF or not 1 <= speed // controller.division <= 100_000:
            raise OutsideLimits(
                f"{speed / controller.division:g} steps/s and {ramp} steps/s^2 are outside the controller's range.",
                where=axis.name,
                remedy="Change speed_deg_s and acceleration_deg_s2 in the station file.",
            )
        present = controller.read_settings(MoveSettings)
        wanted = replace(
            present,
            speed=speed // controller.division,
            speed_microsteps=speed % controller.division,
            acceleration=ramp,
            deceleration=ramp,
        )
        self._set(axis, present, wanted, "speed and acceleration")

    def _program_borders(self, axis: XimcAxis) -> None:
        """Narrow the borders of the controller, unless its borders are limit switches, which are better."""
        controller = self._lines[axis.name]
        present = controller.read_settings(EdgeSettings)
        if not present.border_flags & ximc_protocol.BORDERS_COUNTED:
            return
        ends = sorted(map(axis.to_counts, (axis.limits.lowest_deg, axis.limits.highest_deg)))
        borders = (
            controller.to_microsteps(present.left_steps, present.left_microsteps),
            controller.to_microsteps(present.right_steps, present.right_microsteps),
        )
        motion.check_travel(axis.name, (ends[0], ends[1]), borders, "microsteps", to_deg=axis.to_angle_deg)
        (left, left_micro), (right, right_micro) = map(controller.to_steps, ends)
        wanted = replace(
            present,
            border_flags=present.border_flags | ximc_protocol.BORDERS_STOP,
            left_steps=left,
            left_microsteps=left_micro,
            right_steps=right,
            right_microsteps=right_micro,
        )
        self._set(axis, present, wanted, "borders")

    def _set(self, axis: XimcAxis, present: Settings, wanted: Settings, what: str) -> None:
        """Set what differs, and read it back."""
        controller = self._lines[axis.name]
        if wanted != present:
            controller.set(wanted.WRITE, wanted.pack())
        if (got := controller.read_settings(type(wanted))) != wanted:
            raise read_back_otherwise(axis.name, what, wanted, got)
