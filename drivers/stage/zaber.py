"""Zaber stages over their ASCII protocol: axes in degrees on a chain of devices on one serial line.

Knows scale, limits and what each warning flag means for a move. A move that ends elsewhere, an axis that
lost its reference in mid-move, a controller that stays busy or never was: each ends in a typed error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from drivers.clock import Clock
from drivers.errors import DriverError, MoveFailed, MoveTimeout, NotHomed, PortLost, WrongDevice
from drivers.readings import agreeing
from drivers.serial_port import Port, SerialPort
from drivers.stage import AxisIdentity, AxisLimits, motion, zaber_axis, zaber_protocol
from drivers.stage.zaber_axis import ZaberAxis
from drivers.stage.zaber_chain import ZaberChain
from drivers.wire_log import WireLog

__all__ = ["ZaberAxis", "ZaberStage"]

_HOMING_PATIENCE_S = 10.0
"""At its home sensor an axis creeps, and its counter may rest."""
_STOP_POLL_S = 0.02


class ZaberStage:
    """A stage of one to three Zaber axes. Implements ``drivers.stage.Stage``.

    Open it with ``ZaberStage.open``; the constructor takes a port that is open already.

    Parameters
    ----------
    port
        The open port.
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
    OutsideLimits
        The station's limits reach beyond the controller's travel, or its scale is not the controller's.
    DeviceRefused, ReplyError, PortLost
    """

    def __init__(
        self, port: Port, axes: Sequence[ZaberAxis], *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        self._axes = {axis.name: axis for axis in axes}
        self._clock = clock
        self._chain = ZaberChain(port, [axis.device for axis in axes], clock=clock, wire_log=wire_log)
        self._stops = 0
        try:
            self.identify()
            for axis in axes:
                zaber_axis.check_scale(self._chain, axis)
            for axis in axes:
                zaber_axis.program(self._chain, axis)
            self._encoders = [axis for axis in axes if self._has_encoder(axis)]
        except BaseException:
            self._chain.close()
            raise

    @classmethod
    def open(
        cls,
        port: str,
        axes: Sequence[ZaberAxis],
        *,
        baudrate: int = 115200,
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> ZaberStage:
        """Open the port, check who answers, and program limits, speed and acceleration. Moves nothing.

        Raises PortNotFound, PortBusy, PortDenied, and what the constructor raises.
        """
        return cls(SerialPort(port, baudrate=baudrate), axes, clock=clock, wire_log=wire_log)

    # ------------------------------------------------------------ what it is

    @property
    def axes(self) -> Sequence[str]:
        """Names of the axes, in the station file's order."""
        return tuple(self._axes)

    @property
    def limits(self) -> Mapping[str, AxisLimits]:
        """Soft limits, by axis."""
        return {name: axis.limits for name, axis in self._axes.items()}

    def identify(self) -> Sequence[AxisIdentity]:
        """Ask every axis who it is. Raises WrongDevice when a serial number is not the station file's."""
        found = []
        for axis in self._axes.values():
            serial = self._chain.query(axis.device, 0, "get system.serial").data
            if axis.serial and serial != axis.serial:
                raise WrongDevice(
                    f"the station file says serial {axis.serial} for {axis.name}, but device {axis.device}"
                    f" says {serial}. Nothing was moved.",
                    where=self._chain.name,
                    remedy="Check the port, the order of the chain, and the serial in the station file.",
                )
            model = self._chain.query(axis.device, 0, "get deviceid").data
            firmware = self._chain.query(axis.device, 0, "get version").data
            found.append(AxisIdentity(axis.name, "Zaber", f"device id {model}", serial, firmware))
        return tuple(found)

    def is_homed(self) -> bool:
        """Whether every axis has a reference."""
        return not any(zaber_protocol.UNREFERENCED & set(self._flags(axis)) for axis in self._axes.values())

    def position_deg(self) -> Mapping[str, float]:
        """Position counter, by axis, in degrees."""
        return {name: self._reading_deg(axis, "pos") for name, axis in self._axes.items()}

    def encoder_deg(self) -> Mapping[str, float]:
        """Read the encoders of those axes that have one, in degrees."""
        return {axis.name: self._reading_deg(axis, "encoder.pos") for axis in self._encoders}

    def faults(self) -> Sequence[str]:
        """Present warning flags of all axes in plain words."""
        return [
            f"{name}: {zaber_protocol.in_words(flag)}"
            for name, axis in self._axes.items()
            for flag in self._flags(axis)
        ]

    def move_duration_s(self, from_deg: Mapping[str, float], to_deg: Mapping[str, float]) -> float:
        """Return the expected time of a move, in seconds."""
        return motion.longest_move_s(self.limits, from_deg, to_deg)

    # ------------------------------------------------------------ what it does

    def home(self) -> None:
        """Find the reference of every axis, all at once; clears what faults can be cleared first.

        Raises MoveFailed, MoveTimeout.
        """
        stops = self._stops
        for axis in self._axes.values():
            self._chain.query(axis.device, axis.axis, "warnings clear")
            self._refuse_faults(axis, self._flags(axis))
        try:
            watches = [(axis, self._start(axis, "home", None, stops)) for axis in self._axes.values()]
            self._wait(watches, stops)
            for axis in self._axes.values():
                self._see_referenced(axis)
        except DriverError as error:
            raise self._stopped_after(error) from error

    def move_to(self, target_deg: Mapping[str, float]) -> None:
        """Move the named axes to absolute angles, and see that they arrive.

        Raises OutsideLimits and NotHomed before anything is sent; MoveFailed, MoveTimeout after all axes
        have been stopped.
        """
        motion.check_targets(self.limits, target_deg, self._chain.name)
        stops = self._stops
        moves = [(self._axes[name], angle) for name, angle in target_deg.items()]
        for axis, _ in moves:
            self._make_ready(axis)
        try:
            watches = [(axis, self._start(axis, "move abs", angle, stops)) for axis, angle in moves]
            self._wait(watches, stops)
            for axis, _ in moves:
                self._see_arrived(axis)
        except DriverError as error:
            raise self._stopped_after(error) from error

    def stop(self) -> None:
        """Stop all axes at once, and see that they stand. From any thread; no clock interrupts it.

        Raises MoveTimeout when an axis does not come to rest; ReplyError, PortLost.
        """
        self._stops += 1
        self._chain.stop_all()
        ramp_s = max(
            axis.limits.speed_deg_s / axis.limits.acceleration_deg_s2 for axis in self._axes.values()
        )
        for _ in range(math.ceil((2.0 * ramp_s + 1.0) / _STOP_POLL_S)):
            if not any(self._look(axis)[1] for axis in self._axes.values()):
                return
            self._chain.pause(_STOP_POLL_S)
        raise MoveTimeout("still busy after a stop.", where=self._chain.name, remedy="Cut the stage's power.")

    def close(self) -> None:
        """Give the port back; the stage stays where it is."""
        self._chain.close()

    # ------------------------------------------------------------ a move, step by step

    def _make_ready(self, axis: ZaberAxis) -> None:
        """See that an axis can be moved: referenced, without fault, standing; clear what is only history."""
        flags = self._flags(axis)
        if unreferenced := sorted(zaber_protocol.UNREFERENCED & set(flags)):
            raise NotHomed(
                f"the axis has no reference: {', '.join(map(zaber_protocol.in_words, unreferenced))}."
                " Nothing was moved.",
                where=axis.name,
                remedy="Home the stage first.",
            )
        self._refuse_faults(axis, flags)
        if flags:
            self._chain.query(axis.device, axis.axis, "warnings clear")
        if self._look(axis)[1]:
            raise MoveFailed(
                "the axis is moving already, by somebody else's command. Nothing was sent.",
                where=axis.name,
                remedy="See who else moves it (a knob, another program), then resume.",
            )

    def _start(self, axis: ZaberAxis, verb: str, angle_deg: float | None, stops: int) -> motion.MoveWatch:
        """Send one axis on its way, unless a stop came since the move began; return its watch."""
        start_deg = axis.angle_deg(self._look(axis)[0])
        self._refuse_after_stop(stops)
        if angle_deg is None:
            words, goal_deg = verb, None
            span_deg = axis.limits.highest_deg - axis.limits.lowest_deg
            allowed_s = 30.0 + 5.0 * span_deg / axis.limits.speed_deg_s
            patience_s = _HOMING_PATIENCE_S
        else:
            count = axis.microsteps(angle_deg)
            words, goal_deg = f"{verb} {count}", axis.angle_deg(count)
            allowed_s = motion.deadline_s(axis.limits, start_deg, goal_deg)
            patience_s = motion.PATIENCE_S
        self._chain.command(axis.device, axis.axis, words)
        return motion.MoveWatch(
            axis.name,
            goal_deg,
            tolerance_deg=axis.tolerance_deg,
            now_s=self._clock.monotonic(),
            allowed_s=allowed_s,
            patience_s=patience_s,
        )

    def _wait(self, watches: list[tuple[ZaberAxis, motion.MoveWatch]], stops: int) -> None:
        """Watch axes in motion until the last has arrived."""
        while watches:
            self._clock.sleep(motion.POLL_S)
            going = []
            for axis, watch in watches:
                self._refuse_after_stop(stops)
                count, busy, flag = self._look(axis)
                self._refuse_flag_in_motion(axis, flag, homing=watch.target_deg is None)
                if not watch.look(self._clock.monotonic(), axis.angle_deg(count), busy=busy):
                    going.append((axis, watch))
            watches = going

    def _see_arrived(self, axis: ZaberAxis) -> None:
        """Ask for all flags, since a reply shows the most urgent only, and compare with the encoder."""
        for flag in self._flags(axis):
            self._refuse_flag_in_motion(axis, flag, homing=False)
        if axis in self._encoders:
            counter_deg = self._reading_deg(axis, "pos")
            encoder_deg = self._reading_deg(axis, "encoder.pos")
            if abs(encoder_deg - counter_deg) > axis.encoder_tolerance_deg:
                raise MoveFailed(
                    f"slipped: the counter says {counter_deg:.4f} deg, the encoder {encoder_deg:.4f} deg.",
                    where=axis.name,
                    remedy="See that load and acceleration are not too high, then home and resume.",
                )

    def _see_referenced(self, axis: ZaberAxis) -> None:
        flags = self._flags(axis)
        if bad := [flag for flag in flags if flag in zaber_protocol.UNREFERENCED]:
            raise MoveFailed(
                f"homing ended without a reference: {zaber_protocol.in_words(bad[0])}.",
                where=axis.name,
                remedy="See that nothing blocks the axis, then home again.",
            )
        for flag in flags:
            self._refuse_flag_in_motion(axis, flag, homing=True)

    def _refuse_faults(self, axis: ZaberAxis, flags: Sequence[str]) -> None:
        for flag in flags:
            if zaber_protocol.is_fault(flag):
                raise MoveFailed(
                    f"{zaber_protocol.in_words(flag)}. Nothing was moved.",
                    where=axis.name,
                    remedy="Clear its cause, then home the stage.",
                )

    def _refuse_flag_in_motion(self, axis: ZaberAxis, flag: str, *, homing: bool) -> None:
        """Raise MoveFailed for a flag that means that this move will not end at its target."""
        words = zaber_protocol.in_words(flag)
        if zaber_protocol.is_fault(flag):
            raise MoveFailed(
                f"{words}.", where=axis.name, remedy="Clear its cause, then home the stage and resume."
            )
        if flag in zaber_protocol.INTERRUPTED:
            raise MoveFailed(
                f"{words}.", where=axis.name, remedy="See who else moved or stopped it, then resume."
            )
        if flag in zaber_protocol.UNREFERENCED and not homing:
            raise MoveFailed(
                f"the controller lost its reference in mid-move, as after a restart: {words}.",
                where=axis.name,
                remedy="Check its supply and cable, then home the stage and resume.",
            )

    def _refuse_after_stop(self, stops: int) -> None:
        if self._stops != stops:
            raise MoveFailed(
                "stopped on request.", where=self._chain.name, remedy="Resume when it is safe to move."
            )

    def _stopped_after(self, error: DriverError) -> DriverError:
        """Stop all axes after a failed move; return the error, with what happened if that failed too."""
        if isinstance(error, PortLost):
            return error
        try:
            self.stop()
        except DriverError as second:
            return type(error)(
                f"{error.what} The stop that followed failed too: {second.what}",
                where=error.where,
                remedy=f"Cut the stage's power. {error.remedy}",
            )
        return error

    # ------------------------------------------------------------ reading

    def _look(self, axis: ZaberAxis) -> tuple[int, bool, str]:
        """Return counter, whether busy, and most urgent flag, all of one moment: of one reply."""
        reply = self._chain.query(axis.device, axis.axis, "get pos")
        return self._chain.whole(reply.data), reply.busy, reply.flag

    def _flags(self, axis: ZaberAxis) -> tuple[str, ...]:
        return self._chain.flags(axis.device, axis.axis)

    def _reading_deg(self, axis: ZaberAxis, counter: str) -> float:
        """Read a counter until two readings agree: as far as the axis can have moved between them."""

        def read() -> tuple[float, float, bool]:
            reply = self._chain.query(axis.device, axis.axis, f"get {counter}")
            return axis.angle_deg(self._chain.whole(reply.data)), self._clock.monotonic(), reply.busy

        def alike(before: tuple[float, float, bool], now: tuple[float, float, bool]) -> bool:
            moving_s = now[1] - before[1] if before[2] or now[2] else 0.0
            return abs(now[0] - before[0]) <= axis.tolerance_deg + axis.limits.speed_deg_s * moving_s

        return agreeing(read, alike, what=f"{axis.name}'s position", where=self._chain.name)[0]

    def _has_encoder(self, axis: ZaberAxis) -> bool:
        return self._chain.setting(axis.device, axis.axis, "encoder.pos") is not None
