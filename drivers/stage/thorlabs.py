"""Thorlabs rotation stages over the APT protocol: one controller and one port an axis, in degrees.

This module decides what a controller's state means for a move. ``drivers.stage.watched`` watches the moves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

from drivers.errors import OutsideLimits
from drivers.stage import AxisIdentity
from drivers.stage.motion import Axis
from drivers.stage.thorlabs_controller import Status, ThorlabsController
from drivers.stage.watched import CHECK_PORTS, AxisState, LinePerAxisStage, no_reference, not_movable

_BEGIN_S: Final = 0.3
"""A command has no reply, and the status shows the motion a little later; in seconds."""
_LARGEST_COUNT: Final = 2**31 - 1
_SAME_SCALE: Final = 1e-4


@dataclass(frozen=True, kw_only=True)
class ThorlabsAxis(Axis):
    """One axis as the station file describes it. Homing ends at ``zero_deg``."""

    port: str
    counts_per_deg: float  # Counts per degree; negative when the counter falls as the angle grows
    tolerance_deg: float = 0.005

    @property
    def scale(self) -> float:
        """Counts per degree."""
        return self.counts_per_deg


@dataclass
class _Begun:
    """A motion that this driver has started."""

    at_s: float  # Time of the command, in seconds
    goal_deg: float | None  # Target, in degrees; None for a homing
    homings: int  # Ends of homings that the controller had reported before
    seen: bool = False  # Whether the controller has shown the motion


class ThorlabsStage(LinePerAxisStage[ThorlabsAxis, ThorlabsController]):
    """A stage of one to three Thorlabs axes. Implements ``drivers.stage.Stage``.

    Speed, acceleration or scale that do not fit the controller raise `OutsideLimits`.
    """

    PORT: ClassVar = {"baudrate": 115200, "rtscts": True}
    CONTROLLER = ThorlabsController

    def _set_up(self) -> None:
        self._begun: dict[str, _Begun] = {}
        for axis in self._axes.values():
            self._check_scale(axis)
        self._bring_to_rest()
        for axis in self._axes.values():
            self._program_speed(axis)

    def identify(self) -> Sequence[AxisIdentity]:
        """See `Stage.identify`; serial numbers are compared with those in the station file."""
        found = []
        for axis in self._axes.values():
            controller = self._lines[axis.name]
            told = controller.read_information()
            self._require_serial(
                axis, told.serial, f"{told.serial} answers", where=controller.name, remedy=CHECK_PORTS
            )
            found.append(AxisIdentity(axis.name, "Thorlabs", told.model, told.serial, told.firmware))
        return tuple(found)

    def _has_reference(self) -> bool:
        return all(controller.read_status().homed for controller in self._lines.values())

    def _faults_of(self, axis: ThorlabsAxis) -> list[str]:
        controller = self._lines[axis.name]
        status, enabled = controller.read_status(), controller.is_enabled()
        return (
            status.faults
            + ([] if status.homed else ["no reference"])
            + ([] if enabled else ["its channel is switched off"])
        )

    # ------------------------------------------------------------ on the wire

    def _check_ready(self, axis: ThorlabsAxis) -> None:
        controller = self._lines[axis.name]
        status = controller.read_status()
        if not status.homed:
            raise no_reference(axis)
        self._raise_faults(axis, status)
        if not controller.is_enabled():
            raise not_movable(
                axis,
                "its channel is switched off, at the controller's panel or by another program",
                "Home the stage: that switches the channel on.",
            )

    def _clear_faults(self, axis: ThorlabsAxis) -> None:
        """Raise the faults that are present, and switch the channel on."""
        controller = self._lines[axis.name]
        self._raise_faults(axis, controller.read_status())
        controller.enable()

    def _raise_faults(self, axis: ThorlabsAxis, status: Status) -> None:
        if status.faults:
            raise not_movable(
                axis,
                ", ".join(status.faults),
                "Clear the cause, switch the controller off and on, then home the stage.",
            )

    def _begin_move(self, axis: ThorlabsAxis, angle_deg: float) -> None:
        controller = self._lines[axis.name]
        controller.move(axis.to_counts(angle_deg))
        self._begun[axis.name] = _Begun(self._clock.monotonic(), angle_deg, controller.homings)

    def _begin_homing(self, axis: ThorlabsAxis) -> None:
        controller = self._lines[axis.name]
        begun = _Begun(self._clock.monotonic(), None, controller.homings)
        controller.home()
        self._begun[axis.name] = begun

    def _read_state(self, axis: ThorlabsAxis, *, homing: bool = False) -> AxisState:
        """Read the status and then the position: at rest, the position is that of the rest."""
        controller = self._lines[axis.name]
        status = controller.read_status()
        position_deg = axis.to_angle_deg(controller.read_position())
        at_goal = self._note_motion(axis, status, position_deg)
        busy = status.moving or (not at_goal and self._may_still_begin(axis))
        return AxisState(position_deg, busy, self._problem(status, at_goal=at_goal or busy, homing=homing))

    def _read_final_state(self, axis: ThorlabsAxis, *, homing: bool) -> AxisState:
        state = self._read_state(axis, homing=homing)
        begun, controller = self._begun.get(axis.name), self._lines[axis.name]
        if homing and not controller.read_status().homed:
            return state._replace(problem="homing ended without a reference")
        if homing and begun is not None and not begun.seen and controller.homings == begun.homings:
            return state._replace(problem="the controller did not begin to home")
        if not homing:
            position_deg = self._agreed_position_deg(axis, self._read_state)
            return state._replace(position_deg=position_deg)
        return state

    def _note_motion(self, axis: ThorlabsAxis, status: Status, position_deg: float) -> bool:
        """Note that the motion was seen; return whether its target is reached, or there is none."""
        begun = self._begun.get(axis.name)
        if begun is None:
            return True
        begun.seen = begun.seen or (status.moving and (begun.goal_deg is not None or status.homing))
        if begun.goal_deg is None:
            return begun.seen
        return abs(position_deg - begun.goal_deg) <= axis.tolerance_deg

    def _may_still_begin(self, axis: ThorlabsAxis) -> bool:
        begun = self._begun.get(axis.name)
        return begun is not None and not begun.seen and self._clock.monotonic() - begun.at_s < _BEGIN_S

    def _problem(self, status: Status, *, at_goal: bool, homing: bool) -> str:
        """Return why a move in this state will not end at its target; empty when it may."""
        if status.faults:
            return ", ".join(status.faults)
        if not status.homed and not homing:
            return "the controller lost its reference during the move, as after a restart"
        if status.limits and not at_goal and not homing:
            return f"stopped at a limit: {', '.join(status.limits)}"
        return ""

    def _send_stop(self) -> None:
        self._begun.clear()
        super()._send_stop()

    def _stop_one(self, name: str) -> None:
        limits = self._axes[name].limits
        self._lines[name].stop(limits.speed_deg_s / limits.acceleration_deg_s2)

    # ------------------------------------------------------------ scale and settings

    def _check_scale(self, axis: ThorlabsAxis) -> None:
        """Refuse another scale than that of a stage whose controller is built in, and angles beyond the counter."""
        known = self._lines[axis.name].family.counts_per_deg
        given = abs(axis.counts_per_deg)
        if known and abs(given - known) > _SAME_SCALE * known:
            raise OutsideLimits(
                f"the station file has {given:.8g} counts/deg, but this stage has {known:.8g}. Nothing was set.",
                where=axis.name,
                remedy="Correct counts_per_deg in the station file.",
            )
        ends = (axis.limits.lowest_deg, axis.limits.highest_deg)
        if max(abs(axis.to_counts(end)) for end in ends) > _LARGEST_COUNT:
            raise OutsideLimits(
                "the limits lie beyond the controller's counter. Nothing was set.",
                where=axis.name,
                remedy="Correct limits and scale in the station file.",
            )

    def _program_speed(self, axis: ThorlabsAxis) -> None:
        """Set speed and acceleration where they differ, and read them back."""
        controller = self._lines[axis.name]
        scale = abs(axis.counts_per_deg)
        speed = math.floor(axis.limits.speed_deg_s * scale * controller.family.speed_factor)
        ramp = math.floor(axis.limits.acceleration_deg_s2 * scale * controller.family.acceleration_factor)
        if not 1 <= speed <= _LARGEST_COUNT or not 1 <= ramp <= _LARGEST_COUNT:
            raise OutsideLimits(
                f"speed {speed} and acceleration {ramp}, in the controller's units, are outside its range.",
                where=axis.name,
                remedy="Change speed_deg_s and acceleration_deg_s2 in the station file.",
            )
        controller.set_speed(ramp, speed)
