"""Standa stages over XIMC: one controller and one port an axis, in degrees.

Knows what a controller's state means for a move; how a move is watched is in ``drivers.stage.watched``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace

from drivers.clock import Clock
from drivers.errors import DeviceRefused, MoveFailed, NotHomed, OutsideLimits, WrongDevice
from drivers.serial_port import Port, SerialPort
from drivers.stage import AxisIdentity, AxisLimits, motion, ximc_protocol
from drivers.stage.watched import GoOn, Look, WatchedStage
from drivers.stage.ximc_controller import XimcController
from drivers.stage.ximc_protocol import Status
from drivers.wire_log import WireLog

_BAUDRATE = 115200
_OURS = {"move", "home"}


@dataclass(frozen=True, kw_only=True)
class XimcAxis:
    """One axis as the station file describes it.

    Attributes
    ----------
    name
        "pan", "tilt" or "roll".
    port
        Port of its controller.
    serial
        Serial number of the controller; empty when it need not be checked.
    steps_per_deg
        Full steps a degree; negative when the counter falls as the angle grows.
    zero_deg
        Angle of the reference: homing sets the counter to 0 there.
    limits
        Soft limits, speed and acceleration.
    tolerance_deg
        How far from its target the counter may rest.
    encoder_counts_per_deg
        Encoder counts a degree (with sign), or None without an encoder.
    encoder_tolerance_deg
        How far the encoder may differ from the counter.
    """

    name: str
    port: str
    serial: str
    steps_per_deg: float
    limits: AxisLimits
    zero_deg: float = 0.0
    tolerance_deg: float = 0.002
    encoder_counts_per_deg: float | None = None
    encoder_tolerance_deg: float = 0.05


class XimcStage(WatchedStage[XimcAxis]):
    """A stage of one to three Standa axes. Implements ``drivers.stage.Stage``.

    Open it with ``XimcStage.open``; the constructor takes ports that are open already.

    Parameters
    ----------
    ports
        The open port of each axis's controller, in the order of ``axes``.
    axes
        The axes, in the station file's order.
    clock
        Every wait between two requests goes through it.
    wire_log
        Told every byte.

    Raises
    ------
    WrongDevice
        A serial number differs; nothing was set.
    DeviceRefused, OutsideLimits, ReplyError, PortLost
    """

    def __init__(
        self,
        ports: Sequence[Port],
        axes: Sequence[XimcAxis],
        *,
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> None:
        super().__init__(axes, clock=clock, where=", ".join(port.name for port in ports))
        with ExitStack() as opened:
            for port in ports:
                opened.callback(port.close)
            self._controllers = {
                axis.name: XimcController(port, clock=clock, wire_log=wire_log)
                for axis, port in zip(axes, ports, strict=True)
            }
            self.identify()
            self._bring_to_rest()
            for axis in axes:
                self._program_speed(axis)
                self._program_borders(axis)
            opened.pop_all()

    @classmethod
    def open(cls, axes: Sequence[XimcAxis], *, clock: Clock, wire_log: WireLog | None = None) -> XimcStage:
        """Open all ports, check who answers, and program speed and borders. Moves nothing.

        Raises PortNotFound, PortBusy, PortDenied, and what the constructor raises.
        """
        with ExitStack() as opened:
            ports = []
            for axis in axes:
                ports.append(SerialPort(axis.port, baudrate=_BAUDRATE, stopbits=2))
                opened.callback(ports[-1].close)
            opened.pop_all()
        return cls(ports, axes, clock=clock, wire_log=wire_log)

    def identify(self) -> Sequence[AxisIdentity]:
        """Ask every controller who it is. Raises WrongDevice when a serial is not the station file's."""
        found = []
        for axis in self._axes.values():
            controller = self._controllers[axis.name]
            serial = controller.read_serial()
            if axis.serial and serial != axis.serial:
                raise WrongDevice(
                    f"the station file says serial {axis.serial} for {axis.name}, but {serial} answers."
                    " Nothing was moved.",
                    where=controller.name,
                    remedy="Check the ports and serials in the station file.",
                )
            maker, model, firmware = controller.identity()
            found.append(AxisIdentity(axis.name, maker, model, serial, firmware))
        return tuple(found)

    def _has_reference(self) -> bool:
        return all(controller.status().homed for controller in self._controllers.values())

    def faults(self) -> Sequence[str]:
        """Present faults of all axes in plain words."""
        return [
            f"{name}: {words}"
            for name, controller in self._controllers.items()
            for words in _words(controller.status())
        ]

    def close(self) -> None:
        """Give the ports back; the stage stays where it is."""
        for controller in self._controllers.values():
            controller.close()

    # ------------------------------------------------------------ on the wire

    def _assure_ready(self, axis: XimcAxis) -> None:
        status = self._controllers[axis.name].status()
        if not status.homed:
            raise NotHomed(
                "the axis has no reference. Nothing was moved.",
                where=axis.name,
                remedy="Home the stage first.",
            )
        self._refuse(axis, status)

    def _clear_faults(self, axis: XimcAxis) -> None:
        """Clear an alarm: a stop command does, when its cause is gone."""
        controller = self._controllers[axis.name]
        if controller.status().troubles:
            controller.command("stop")
        self._refuse(axis, controller.status())

    def _refuse(self, axis: XimcAxis, status: Status) -> None:
        if status.troubles:
            raise MoveFailed(
                f"{', '.join(status.troubles)}. Nothing was moved.",
                where=axis.name,
                remedy="Clear its cause, then home the stage.",
            )

    def _goal_deg(self, axis: XimcAxis, angle_deg: float) -> float:
        return self._angle_deg(axis, self._count(axis, angle_deg))

    def _start(self, goals_deg: Mapping[str, float], go_on: GoOn) -> None:
        for name, angle_deg in goals_deg.items():
            controller = self._controllers[name]
            with controller.lock:
                go_on()
                controller.move(self._count(self._axes[name], angle_deg))

    def _start_homing(self, go_on: GoOn) -> None:
        for controller in self._controllers.values():
            with controller.lock:
                go_on()
                controller.command("home")

    def _look(self, axis: XimcAxis, *, homing: bool = False) -> Look:
        """Position, whether busy, and what speaks against the move: all of one reply."""
        controller = self._controllers[axis.name]
        status = controller.status()
        position_deg = self._angle_deg(axis, controller.count(status.steps, status.microsteps))
        if status.homed and status.running and status.command not in _OURS and not status.troubles:
            words = f"interrupted by another command ({status.command})"
            return Look(position_deg, status.running, words, harmless=True)
        return Look(position_deg, status.running, _trouble(status, homing=homing))

    def _look_at_rest(self, axis: XimcAxis, *, homing: bool) -> Look:
        look = self._look(axis, homing=homing)
        if homing and not self._controllers[axis.name].status().homed:
            return look._replace(trouble="homing ended without a reference")
        return look

    def _finish_homing(self, axis: XimcAxis) -> None:
        """Make the reference the counter's zero, the encoder's too."""
        self._controllers[axis.name].set("zero", b"")

    def _send_stop(self) -> None:
        """Stop every axis, whatever the others do: none waits for an answer of another's controller."""
        with ThreadPoolExecutor(len(self._controllers)) as at_once:
            stops = [at_once.submit(controller.stop) for controller in self._controllers.values()]
        for stop in stops:
            stop.result()

    def _listen(self, seconds: float) -> None:
        next(iter(self._controllers.values())).listen(seconds)

    def _encoder(self, axis: XimcAxis) -> Look | None:
        if axis.encoder_counts_per_deg is None:
            return None
        status = self._controllers[axis.name].status()
        return Look(axis.zero_deg + status.encoder / axis.encoder_counts_per_deg, status.running)

    # ------------------------------------------------------------ scale and settings

    def _count(self, axis: XimcAxis, angle_deg: float) -> int:
        """Return the microsteps nearest to an angle."""
        division = self._controllers[axis.name].division
        return round((angle_deg - axis.zero_deg) * axis.steps_per_deg * division)

    def _angle_deg(self, axis: XimcAxis, count: float) -> float:
        division = self._controllers[axis.name].division
        return axis.zero_deg + count / (axis.steps_per_deg * division)

    def _program_speed(self, axis: XimcAxis) -> None:
        """Set speed and acceleration where they differ, and read them back."""
        controller = self._controllers[axis.name]
        scale = abs(axis.steps_per_deg)
        speed = math.floor(axis.limits.speed_deg_s * scale * controller.division)
        ramp = math.floor(axis.limits.acceleration_deg_s2 * scale)
        if not 1 <= ramp <= 0xFFFF or not 1 <= speed // controller.division <= 100_000:
            raise OutsideLimits(
                f"{speed / controller.division:g} steps/s and {ramp} steps/s^2 are beyond the controller.",
                where=axis.name,
                remedy="Change speed_deg_s and acceleration_deg_s2 in the station file.",
            )
        present = controller.move_settings()
        wanted = replace(
            present,
            speed=speed // controller.division,
            speed_microsteps=speed % controller.division,
            acceleration=ramp,
            deceleration=ramp,
        )
        if wanted != present:
            controller.set("smov", wanted.pack())
        got = controller.move_settings()
        _compare(axis, "speed and acceleration", wanted, got)

    def _program_borders(self, axis: XimcAxis) -> None:
        """Narrow the controller's own borders, unless it stops at limit switches: those are better."""
        controller = self._controllers[axis.name]
        present = controller.edge_settings()
        if not present.border_flags & ximc_protocol.BORDERS_COUNTED:
            return
        ends = sorted(self._count(axis, end) for end in (axis.limits.lowest_deg, axis.limits.highest_deg))
        set_before = (
            controller.count(present.left_steps, present.left_microsteps),
            controller.count(present.right_steps, present.right_microsteps),
        )
        motion.check_travel(axis.name, (ends[0], ends[1]), set_before, "microsteps")
        (left, left_micro), (right, right_micro) = map(controller.split, ends)
        wanted = replace(
            present,
            border_flags=present.border_flags | ximc_protocol.BORDERS_STOP,
            left_steps=left,
            left_microsteps=left_micro,
            right_steps=right,
            right_microsteps=right_micro,
        )
        if wanted != present:
            controller.set("seds", wanted.pack())
        _compare(axis, "borders", wanted, controller.edge_settings())


def _compare(axis: XimcAxis, what: str, wanted: object, got: object) -> None:
    if wanted != got:
        raise DeviceRefused(
            f"{what} read back otherwise than set: {got} instead of {wanted}.",
            where=axis.name,
            remedy="Change the station file to what the controller can do.",
        )


def _words(status: Status) -> list[str]:
    return status.troubles + ([] if status.homed else ["no reference"])


def _trouble(status: Status, *, homing: bool) -> str:
    """Say why a move in this state will not end at its target; empty when it may."""
    if status.troubles:
        return ", ".join(status.troubles)
    if not status.homed and not homing:
        return "the controller lost its reference in mid-move, as after a restart"
    if status.failed:
        return f"the controller says that its {status.command} failed"
    return ""
