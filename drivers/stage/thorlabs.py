"""Thorlabs rotation stages over the APT protocol: one controller and one port an axis, in degrees.

This module decides what a controller's state means for a move. ``drivers.stage.watched`` watches the moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Final

from drivers.clock import Clock
from drivers.errors import MoveFailed, NotHomed, OutsideLimits, WrongDevice
from drivers.serial_port import Port, SerialPort
from drivers.stage import AxisIdentity, AxisLimits
from drivers.stage.thorlabs_controller import ThorlabsController
from drivers.stage.thorlabs_protocol import Status
from drivers.stage.watched import AxisState, StopCheck, WatchedStage
from drivers.wire_log import WireLog

_BAUDRATE: Final = 115200
_BEGIN_S: Final = 0.3
"""A command has no reply, and the status shows the motion a little later; in seconds."""
_LARGEST_COUNT: Final = 2**31 - 1
_SAME_SCALE: Final = 1e-4


@dataclass(frozen=True, kw_only=True)
class ThorlabsAxis:
    """One axis as the station file describes it."""

    name: str  # "pan", "tilt" or "roll"
    port: str
    serial: str  # Serial number of the controller; empty when it is not checked
    counts_per_deg: float  # Counts per degree; negative when the counter falls as the angle grows
    limits: AxisLimits
    zero_deg: float = 0.0  # Angle at which the counter is 0, in degrees: homing ends there
    tolerance_deg: float = 0.005  # Largest distance of the counter from its target at rest, in degrees
    encoder_tolerance_deg: float = 0.05  # Not used: a motor with an encoder is counted by it


@dataclass
class _Begun:
    """A motion that this driver has started."""

    at_s: float  # Time of the command, in seconds
    goal_deg: float | None  # Target, in degrees; None for a homing
    homings: int  # Ends of homings that the controller had reported before
    seen: bool = False  # Whether the controller has shown the motion


class ThorlabsStage(WatchedStage[ThorlabsAxis]):
    """A stage of one to three Thorlabs axes. Implements ``drivers.stage.Stage``.

    Open it with ``ThorlabsStage.open``; the constructor takes ports that are open already.

    ports: The open port of each axis's controller, in the order of ``axes``.
    axes: The axes, in the order of the station file.
    clock: Every wait between two requests goes through it.
    wire_log: Records every byte; None for no record.
    Raises OutsideLimits: Speed, acceleration or scale in the station file do not fit the controller.
    Raises ReplyError, PortLost: A controller does not answer.
    """

    def __init__(
        self,
        ports: Sequence[Port],
        axes: Sequence[ThorlabsAxis],
        *,
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> None:
        super().__init__(axes, clock=clock, where=", ".join(port.name for port in ports))
        self._begun: dict[str, _Begun] = {}
        with ExitStack() as opened:
            for port in ports:
                opened.callback(port.close)
            self._controllers = {
                axis.name: ThorlabsController(port, clock=clock, wire_log=wire_log)
                for axis, port in zip(axes, ports, strict=True)
            }
            self.identify()
            for axis in axes:
                self._check_scale(axis)
            self._bring_to_rest()
            for axis in axes:
                self._program_speed(axis)
            opened.pop_all()

    @classmethod
    def open(
        cls, axes: Sequence[ThorlabsAxis], *, clock: Clock, wire_log: WireLog | None = None
    ) -> ThorlabsStage:
        """Open all ports, check the serial numbers, and set the speeds. Moves nothing, and switches no motor on.

        The ports raise the errors of ``drivers.serial_port.SerialPort``.
        """
        with ExitStack() as opened:
            ports = []
            for axis in axes:
                ports.append(SerialPort(axis.port, baudrate=_BAUDRATE, rtscts=True))
                opened.callback(ports[-1].close)
            opened.pop_all()
        return cls(ports, axes, clock=clock, wire_log=wire_log)

    def identify(self) -> Sequence[AxisIdentity]:
        """See `Stage.identify`.

        Raises WrongDevice: A serial number is not the one in the station file.
        """
        found = []
        for axis in self._axes.values():
            controller = self._controllers[axis.name]
            told = controller.read_information()
            if axis.serial and told.serial != axis.serial:
                raise WrongDevice(
                    f"the station file names serial {axis.serial} for {axis.name}, but {told.serial} answers."
                    " Nothing was moved.",
                    where=controller.name,
                    remedy="Check the ports and serials in the station file.",
                )
            found.append(AxisIdentity(axis.name, "Thorlabs", told.model, told.serial, told.firmware))
        return tuple(found)

    def _has_reference(self) -> bool:
        return all(controller.read_status().homed for controller in self._controllers.values())

    def faults(self) -> Sequence[str]:
        """See `Stage.faults`."""
        return [
            f"{name}: {fault}"
            for name, controller in self._controllers.items()
            for fault in _faults(controller.read_status(), enabled=controller.is_enabled())
        ]

    def close(self) -> None:
        """See `Stage.close`."""
        for controller in self._controllers.values():
            controller.close()

    # ------------------------------------------------------------ on the wire

    def _check_ready(self, axis: ThorlabsAxis) -> None:
        controller = self._controllers[axis.name]
        status = controller.read_status()
        if not status.homed:
            raise NotHomed(
                "the axis has no reference. Nothing was moved.",
                where=axis.name,
                remedy="Home the stage first.",
            )
        self._raise_faults(axis, status)
        if not controller.is_enabled():
            raise MoveFailed(
                "its channel is switched off, at the controller's panel or by another program."
                " Nothing was moved.",
                where=axis.name,
                remedy="Home the stage: that switches the channel on.",
            )

    def _clear_faults(self, axis: ThorlabsAxis) -> None:
        """Raise the faults that are present, and switch the channel on."""
        controller = self._controllers[axis.name]
        self._raise_faults(axis, controller.read_status())
        controller.enable()

    def _raise_faults(self, axis: ThorlabsAxis, status: Status) -> None:
        if status.faults:
            raise MoveFailed(
                f"{', '.join(status.faults)}. Nothing was moved.",
                where=axis.name,
                remedy="Clear the cause, switch the controller off and on, then home the stage.",
            )

    def _reachable_deg(self, axis: ThorlabsAxis, angle_deg: float) -> float:
        return self._angle_deg(axis, self._count(axis, angle_deg))

    def _start(self, goals_deg: Mapping[str, float], check_not_stopped: StopCheck) -> None:
        for name, angle_deg in goals_deg.items():
            controller = self._controllers[name]
            with controller.lock:
                check_not_stopped()
                controller.move(self._count(self._axes[name], angle_deg))
                self._begun[name] = _Begun(self._clock.monotonic(), angle_deg, controller.homings)

    def _start_homing(self, check_not_stopped: StopCheck) -> None:
        for name, controller in self._controllers.items():
            with controller.lock:
                check_not_stopped()
                begun = _Begun(self._clock.monotonic(), None, controller.homings)
                controller.home()
                self._begun[name] = begun

    def _read_state(self, axis: ThorlabsAxis, *, homing: bool = False) -> AxisState:
        """Read the status and then the position: at rest, the position is that of the rest."""
        controller = self._controllers[axis.name]
        status = controller.read_status()
        position_deg = self._angle_deg(axis, controller.read_position())
        at_goal = self._note_motion(axis, status, position_deg)
        busy = status.moving or (not at_goal and self._may_still_begin(axis))
        return AxisState(position_deg, busy, self._problem(status, at_goal=at_goal or busy, homing=homing))

    def _read_final_state(self, axis: ThorlabsAxis, *, homing: bool) -> AxisState:
        state = self._read_state(axis, homing=homing)
        begun, controller = self._begun.get(axis.name), self._controllers[axis.name]
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
        """Stop all axes at the same time: no axis waits for the reply of another controller."""
        self._begun.clear()

        def stop(name: str) -> None:
            limits = self._axes[name].limits
            self._controllers[name].stop(limits.speed_deg_s / limits.acceleration_deg_s2)

        with ThreadPoolExecutor(len(self._controllers)) as pool:
            stops = [pool.submit(stop, name) for name in self._controllers]
        for one in stops:
            one.result()

    def _listen(self, duration_s: float) -> None:
        next(iter(self._controllers.values())).listen(duration_s)

    # ------------------------------------------------------------ scale and settings

    def _count(self, axis: ThorlabsAxis, angle_deg: float) -> int:
        """Return the counts nearest to an angle."""
        return round((angle_deg - axis.zero_deg) * axis.counts_per_deg)

    def _angle_deg(self, axis: ThorlabsAxis, count: float) -> float:
        return axis.zero_deg + count / axis.counts_per_deg

    def _check_scale(self, axis: ThorlabsAxis) -> None:
        """Refuse another scale than that of a stage whose controller is built in, and angles beyond the counter."""
        known = self._controllers[axis.name].family.counts_per_deg
        given = abs(axis.counts_per_deg)
        if known and abs(given - known) > _SAME_SCALE * known:
            raise OutsideLimits(
                f"the station file has {given:.8g} counts/deg, but this stage has {known:.8g}. Nothing was set.",
                where=axis.name,
                remedy="Correct counts_per_deg in the station file.",
            )
        ends = (axis.limits.lowest_deg, axis.limits.highest_deg)
        if max(abs(self._count(axis, end)) for end in ends) > _LARGEST_COUNT:
            raise OutsideLimits(
                "the limits lie beyond the controller's counter. Nothing was set.",
                where=axis.name,
                remedy="Correct limits and scale in the station file.",
            )

    def _program_speed(self, axis: ThorlabsAxis) -> None:
        """Set speed and acceleration where they differ, and read them back."""
        controller = self._controllers[axis.name]
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


def _faults(status: Status, *, enabled: bool) -> list[str]:
    return (
        status.faults
        + ([] if status.homed else ["no reference"])
        + ([] if enabled else ["its channel is switched off"])
    )
