"""Thorlabs rotation stages over the APT protocol: one controller and one port an axis, in degrees.

This module decides what a controller's state means for a move. ``drivers.stage.watched`` watches the moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

from drivers.errors import DeviceRefused, OutsideLimits
from drivers.serial_port import LineSettings
from drivers.stage import AxisIdentity
from drivers.stage.line_per_axis import LinePerAxisStage
from drivers.stage.motion import Axis, check_scale
from drivers.stage.refusals import CHECK_PORTS, not_movable
from drivers.stage.thorlabs_controller import ThorlabsController
from drivers.stage.thorlabs_messages import CONNECTED, FORWARD, REVERSE, SWITCHES, HomeParameters, Status
from drivers.stage.watched import AxisState

_ZERO_UNKNOWN: Final = "the controller does not tell its home parameters, so its zero is not known"
_BEGIN_S: Final = 0.3
"""A command has no reply, and the status shows the motion a little later; in seconds."""
_LARGEST_COUNT: Final = 2**31 - 1  # Of the protocol's 32 bits
_SAME_SCALE: Final = 1e-4  # Share: counts per degree may be written rounded
_DIRECTIONS: Final = {"forward": FORWARD, "reverse": REVERSE}
Direction = Literal["forward", "reverse"]
_KNOWN_STAGES: Final = (409_600 / 3, 1919.6418579)
"""Scales of K10CR1 and PRM1Z8: they search in reverse."""
_KNOWN_OFFSET_DEG: Final = 4.0
"""From their switch to their zero, as the maker's programs set it when they connect; in degrees."""
_HOME_SPEED_DEG_S: Final = 10.0
"""Speed of a search, as the maker's programs set it: after power-up a K10CR1 has one that takes minutes."""


@dataclass(frozen=True, kw_only=True)
class ThorlabsAxis(Axis):
    """One axis as the station file describes it. Homing ends at ``zero_deg``.

    None stands for the value of the stage, if this driver knows it.
    """

    port: str
    counts_per_deg: float  # Counts per degree; negative when the counter falls as the angle grows
    home_offset_deg: float | None = None  # From the reference switch to the zero, by the counter, in degrees
    home_direction: Direction | None = None  # Direction of the search, by the counter
    home_speed_deg_s: float | None = None  # Speed of the search
    tolerance_deg: float = 0.005  # Ten counts of a PRM1Z8, whose servo does not rest at its goal exactly

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

    SETTINGS = LineSettings(115200, rtscts=True)  # as the protocol has it
    CONTROLLER = ThorlabsController
    FAULT_REMEDY = "Clear the cause, switch the controller off and on, then home the stage."

    def _set_up(self) -> None:
        self._begun: dict[str, _Begun] = {}
        self._home: dict[str, HomeParameters | None] = {}
        for axis in self._axes.values():
            self._check_scale(axis)

    def _identity_of(self, axis: ThorlabsAxis) -> AxisIdentity:
        controller = self._lines[axis.name]
        stated = controller.read_information()
        self._require_serial(
            axis, stated.serial, f"{stated.serial} answers", where=controller.name, remedy=CHECK_PORTS
        )
        return AxisIdentity(axis.name, "Thorlabs", stated.model, stated.serial, stated.firmware)

    def _faults_of(self, axis: ThorlabsAxis) -> list[str]:
        controller = self._lines[axis.name]
        return (
            super()._faults_of(axis)
            + ([] if controller.is_enabled() else ["its channel is switched off"])
            + ([] if self._home[axis.name] else [_ZERO_UNKNOWN])
            + controller.reports
        )

    # ------------------------------------------------------------ on the wire

    def _check_ready(self, axis: ThorlabsAxis) -> None:
        super()._check_ready(axis)
        if not self._lines[axis.name].is_enabled():
            raise not_movable(
                axis,
                "its channel is switched off, at the controller's panel or by another program",
                "Home the stage: that switches the channel on.",
            )

    def _clear_faults(self, axis: ThorlabsAxis) -> None:
        """Raise the faults that are present, set everything again (a restart has undone it), switch the channel on."""
        controller = self._lines[axis.name]
        self._raise_faults(axis, controller.read_status())
        self._program(axis)
        controller.enable()

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
        problem = self._problem(status, homing=homing)
        if not problem and status.limits and not (at_goal or busy or homing):
            problem = f"stopped at a limit: {', '.join(status.limits)}"
        if controller.reports and not at_goal and not status.moving:
            problem = "; ".join(controller.reports)
        return AxisState(position_deg, busy, problem)

    def _read_final_state(self, axis: ThorlabsAxis, *, homing: bool) -> AxisState:
        state = super()._read_final_state(axis, homing=homing)
        if not homing:
            return state._replace(position_deg=self._agreed_position_deg(axis, self._read_state))
        begun = self._begun.get(axis.name)
        if begun is not None and not begun.seen and self._lines[axis.name].homings == begun.homings:
            controller = self._lines[axis.name]
            status = controller.read_status()
            reported = "; ".join(controller.reports) or self._problem(status, homing=True)
            why = "" if status.bits & CONNECTED else ": it recognises no motor, so check the stage's cable"
            return state._replace(problem=reported or f"the controller did not begin to home{why}")
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
        if known:
            remedy = "Correct counts_per_deg in the station file."
            check_scale(axis, given, known, "counts per degree", remedy, slack=_SAME_SCALE * known)
        ends = (axis.limits.lowest_deg, axis.limits.highest_deg)
        if max(abs(axis.to_counts(end)) for end in ends) > _LARGEST_COUNT:
            raise OutsideLimits(
                "the limits lie beyond the controller's counter. Nothing was set.",
                where=axis.name,
                remedy="Correct limits and scale in the station file.",
            )

    def _program(self, axis: ThorlabsAxis) -> None:
        self._program_speed(axis)
        self._program_home(axis)
        self._lines[axis.name].clear_backlash()

    def _program_home(self, axis: ThorlabsAxis) -> None:
        """Set how the reference is searched, and where its zero is; refuse to guess that."""
        controller = self._lines[axis.name]
        scale = abs(axis.counts_per_deg)
        known = any(abs(scale - counts) <= _SAME_SCALE * counts for counts in _KNOWN_STAGES)
        offset_deg, direction = axis.home_offset_deg, axis.home_direction
        if known:
            offset_deg = _KNOWN_OFFSET_DEG if offset_deg is None else offset_deg
            direction = direction or "reverse"
        if offset_deg is None or direction is None:
            present = controller.read_home()
            raise DeviceRefused(
                "the station file does not say how this axis is homed, and where its zero is."
                + (_stated(present, scale) if present else "")
                + " Nothing was set.",
                where=axis.name,
                remedy="Write home_offset_deg and home_direction into the station file.",
            )
        speed_deg_s = axis.home_speed_deg_s or min(_HOME_SPEED_DEG_S, axis.limits.speed_deg_s)
        self._home[axis.name] = controller.set_home(
            HomeParameters(
                _DIRECTIONS[direction],
                SWITCHES[_DIRECTIONS[direction]],
                math.floor(speed_deg_s * scale * controller.family.speed_factor),
                round(offset_deg * scale),
            )
        )

    def _homing_speed_deg_s(self, axis: ThorlabsAxis) -> float | None:
        home, controller = self._home[axis.name], self._lines[axis.name]
        if home is None:
            return None
        return home.speed / controller.family.speed_factor / abs(axis.counts_per_deg)

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


def _stated(home: HomeParameters, scale: float) -> str:
    """Return home parameters as they would stand in a station file, as a sentence."""
    direction = next((word for word, number in _DIRECTIONS.items() if number == home.direction), "")
    home_text = f"home_offset_deg: {home.offset / scale:.6g}" + (
        direction and f", home_direction: {direction}"
    )
    return f" The controller has {home_text}, from its maker's program or from power-up."
