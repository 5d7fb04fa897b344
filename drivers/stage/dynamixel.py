"""Dynamixel X series servos as the axes of a gimbal: several ids on one bus, in degrees.

A servo knows its angle within one turn at power-up, and its torque is off then. So homing searches nothing: it takes
the present position as goal and switches the torque on. Only moves move the servo.

Closing leaves the torque as it is: without it, an axis could fall.

This module decides what a servo's state means for a move. ``drivers.stage.watched`` watches the moves.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from drivers.errors import DeviceRefused, OutsideLimits, ReplyGarbled, WrongDevice
from drivers.serial_port import Port
from drivers.stage import AxisIdentity
from drivers.stage import dynamixel_bus as protocol
from drivers.stage.dynamixel_bus import DynamixelBus, Settings, State
from drivers.stage.motion import Axis
from drivers.stage.watched import AxisState, OneLineStage, no_reference, not_movable
from drivers.wire_log import WireLog

_LARGEST_PART_OF_TURN: Final = 0.95


@dataclass(frozen=True, kw_only=True)
class DynamixelAxis(Axis):
    """One axis as the station file describes it. A servo has no serial number."""

    id: int
    # Counts per degree; 4096 / 360 without a gear, negative when the counter falls as the angle grows.
    counts_per_deg: float
    model: str = ""  # Name of its model, such as "XL430-W250"; empty when it is not checked
    zero_count: int = 2048  # Count within the servo's turn at the angle ``zero_deg``
    tolerance_deg: float = 0.3

    @property
    def scale(self) -> float:
        """Counts per degree; the count is that since ``zero_count``."""
        return self.counts_per_deg


class DynamixelStage(OneLineStage[DynamixelAxis, DynamixelBus]):
    """A stage of one to three Dynamixel servos. Implements ``drivers.stage.Stage``.

    A servo is refused whose torque is on in a mode that this driver cannot use.
    """

    BAUDRATE = 57600

    def _connected(self, port: Port, wire_log: WireLog | None) -> DynamixelBus:
        ids = [axis.id for axis in self._axes.values()]
        return DynamixelBus(port, ids, clock=self._clock, wire_log=wire_log)

    def _set_up(self) -> None:
        self._goals: dict[str, int] = {}
        self.identify()
        for axis in self._axes.values():
            _check_span(axis)
        self._bring_to_rest()
        for axis in self._axes.values():
            self._program(axis)

    def identify(self) -> Sequence[AxisIdentity]:
        """See `Stage.identify`. A servo has no serial number; its model (of the X series) and its id stand for it."""
        found = []
        for axis in self._axes.values():
            settings = self._line.read_settings(axis.id)
            model = protocol.MODELS.get(settings.model, "")
            if not model or (axis.model and model != axis.model):
                wanted = f"a {axis.model}" if axis.model else "a servo of the X series"
                raise WrongDevice(
                    f"the station file names {wanted} for {axis.name}, but the servo with id {axis.id} is"
                    f" {f'a {model}' if model else f'of model number {settings.model}'}. Nothing was moved.",
                    where=self._where,
                    remedy="Check the port, the ids of the servos, and the models in the station file.",
                )
            firmware = str(settings.firmware)
            found.append(AxisIdentity(axis.name, "Robotis", f"{model} (id {axis.id})", "", firmware))
        return tuple(found)

    def _has_reference(self) -> bool:
        return all(self._line.read_state(axis.id).torque for axis in self._axes.values())

    def _faults_of(self, axis: DynamixelAxis) -> list[str]:
        state = self._line.read_state(axis.id)
        return state.faults + ([] if state.torque else ["the torque is off"])

    # ------------------------------------------------------------ on the wire

    def _check_ready(self, axis: DynamixelAxis) -> None:
        state = self._line.read_state(axis.id)
        if state.errors:
            raise not_movable(
                axis,
                _shut_down(state),
                "Clear the cause, hold the camera, then home the stage: that restarts this servo.",
            )
        if not state.torque:
            raise no_reference(
                axis,
                "the torque of the servo is off, as after a loss of power",
                "Home the stage first: that switches the torque on where the axis stands.",
            )
        self._program_profile(axis, state)

    def _clear_faults(self, axis: DynamixelAxis) -> None:
        """Restart a servo that has shut down, whose torque is off already, and set it up again."""
        state = self._line.read_state(axis.id)
        if state.errors and not state.torque:
            self._line.reboot(axis.id)
            state = self._line.read_state(axis.id)
        if state.errors:
            raise not_movable(
                axis,
                _shut_down(state),
                "Clear the cause, switch the servo's power off and on, then home the stage.",
            )
        self._program(axis)

    def _begin_move(self, axis: DynamixelAxis, angle_deg: float) -> None:
        goal = self._goal(axis, self._line.read_state(axis.id), angle_deg)
        self._goals[axis.name] = goal
        self._line.move(axis.id, goal)

    def _begin_homing(self, axis: DynamixelAxis) -> None:
        """Switch the torque on where the axis stands."""
        state = self._line.read_state(axis.id)
        if not state.torque:
            self._line.write_value(axis.id, protocol.GOAL, struct.pack("<i", state.position))
            self._line.write_value(axis.id, protocol.TORQUE, b"\1")
            state = self._line.read_state(axis.id)
        self._goals[axis.name] = state.goal

    def _read_state(self, axis: DynamixelAxis, *, homing: bool = False) -> AxisState:  # noqa: ARG002
        state = self._line.read_state(axis.id)
        position_deg = self._angle_deg(axis, state.position)
        if state.errors:
            return AxisState(position_deg, state.moving, _shut_down(state))
        if axis.name not in self._goals:
            return AxisState(position_deg, state.moving)
        if not state.torque:
            problem = "the torque of the servo went off: it lost its power or restarted, and holds nothing"
            return AxisState(position_deg, state.moving, problem)
        if state.goal != self._goals[axis.name]:
            problem = "interrupted: another program or a stop has changed the goal of the servo"
            return AxisState(position_deg, state.moving, problem, position_kept=True)
        return AxisState(position_deg, state.moving)

    def _send_stop(self) -> None:
        self._goals.clear()
        self._line.stop_all()

    # ------------------------------------------------------------ scale and settings

    def _angle_deg(self, axis: DynamixelAxis, count: int) -> float:
        """Return the angle of a count: of all turns of the servo, the one nearest to the middle of the limits.

        A servo begins to count its turns anew at each power-up; the limits span less than a turn.
        """
        angle_deg = axis.to_angle_deg(count - axis.zero_count)
        middle_deg = (axis.limits.lowest_deg + axis.limits.highest_deg) / 2.0
        turn_deg = protocol.COUNTS_A_TURN / abs(axis.counts_per_deg)
        return angle_deg - turn_deg * round((angle_deg - middle_deg) / turn_deg)

    def _goal(self, axis: DynamixelAxis, state: State, angle_deg: float) -> int:
        """Return the count of an angle in the turn that the servo counts at present."""
        present = axis.to_counts(self._angle_deg(axis, state.position))
        goal = state.position + axis.to_counts(angle_deg) - present
        if abs(goal) > protocol.LARGEST_GOAL:
            raise ReplyGarbled(
                f"the servo counts {state.position}, which is beyond its own range.",
                where=axis.name,
                remedy="Switch the servo's power off and on, then home the stage.",
            )
        return goal

    def _program(self, axis: DynamixelAxis) -> None:
        """Set modes and profile where they differ. Modes can be set without torque only."""
        settings, state = self._line.read_settings(axis.id), self._line.read_state(axis.id)
        drive_mode = settings.drive_mode & ~protocol.TIME_BASED_OR_TORQUE_BY_GOAL
        wanted = {protocol.DRIVE_MODE: drive_mode, protocol.OPERATING_MODE: protocol.EXTENDED_POSITION}
        present = {
            protocol.DRIVE_MODE: settings.drive_mode,
            protocol.OPERATING_MODE: settings.operating_mode,
        }
        if wanted != present and state.torque:
            raise DeviceRefused(
                f"the torque is on in operating mode {settings.operating_mode}, drive mode"
                f" {settings.drive_mode:#04x}; this driver needs operating mode 4 (extended position) and a profile"
                " of speeds, and switches no torque off, because an axis could fall. Nothing was set.",
                where=axis.name,
                remedy="Hold the camera and switch the servo's power off and on.",
            )
        for address, value in wanted.items():
            if value != present[address]:
                self._line.write_value(axis.id, address, bytes([value]))
        settings = self._line.read_settings(axis.id)
        if (settings.drive_mode, settings.operating_mode) != tuple(wanted.values()):
            raise DeviceRefused(
                "operating mode and drive mode read back differently from what was set:"
                f" {settings.operating_mode} and {settings.drive_mode:#04x}.",
                where=axis.name,
                remedy="Set operating mode 4 with DYNAMIXEL Wizard.",
            )
        _check_speed(axis, settings)
        self._program_profile(axis, self._line.read_state(axis.id))

    def _program_profile(self, axis: DynamixelAxis, state: State) -> None:
        """Set speed and acceleration where they differ, as after a restart, and read them back."""
        wanted = _profile(axis)
        if (state.ramp, state.speed) == wanted:
            return
        self._line.write_value(axis.id, protocol.PROFILE, struct.pack("<II", *wanted))
        state = self._line.read_state(axis.id)
        if (state.ramp, state.speed) != wanted:
            raise DeviceRefused(
                f"acceleration and speed read back differently from what was set: {state.ramp} and {state.speed}"
                f" instead of {wanted[0]} and {wanted[1]}.",
                where=axis.name,
                remedy="Change the station file to what the servo supports.",
            )


def _profile(axis: DynamixelAxis) -> tuple[int, int]:
    """Return acceleration and speed in the servo's units; 0 would mean without limit."""
    turns_a_deg = abs(axis.counts_per_deg) / protocol.COUNTS_A_TURN
    speed = math.floor(axis.limits.speed_deg_s * turns_a_deg * 60.0 / protocol.SPEED_UNIT_RPM)
    ramp = math.floor(axis.limits.acceleration_deg_s2 * turns_a_deg * 3600.0 / protocol.RAMP_UNIT_REV_MIN2)
    return ramp, speed


def _check_speed(axis: DynamixelAxis, settings: Settings) -> None:
    ramp, speed = _profile(axis)
    if not 1 <= speed <= settings.most_speed or not 1 <= ramp <= protocol.LARGEST_RAMP:
        raise OutsideLimits(
            f"the station file asks for {speed} units of 0.229 rpm and {ramp} units of 214.6 rev/min^2; the servo"
            f" takes 1 to {settings.most_speed} and 1 to {protocol.LARGEST_RAMP}.",
            where=axis.name,
            remedy="Change speed_deg_s and acceleration_deg_s2 in the station file.",
        )


def _check_span(axis: DynamixelAxis) -> None:
    """Refuse limits that span more than a turn of the servo, which begins to count turns anew at each power-up."""
    turn_deg = protocol.COUNTS_A_TURN / abs(axis.counts_per_deg)
    if axis.limits.highest_deg - axis.limits.lowest_deg > _LARGEST_PART_OF_TURN * turn_deg:
        raise OutsideLimits(
            f"the limits span more than {_LARGEST_PART_OF_TURN:.0%} of a turn of the servo ({turn_deg:.4g} deg of the"
            " axis): after a loss of power, its angle would not be known. Nothing was set.",
            where=axis.name,
            remedy="Choose narrower limits, or a gear with a smaller ratio.",
        )


def _shut_down(state: State) -> str:
    words = ", ".join(state.faults)
    return words if state.torque else f"{words}; the servo has switched its torque off, and holds nothing"
