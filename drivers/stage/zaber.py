"""Zaber stages over their ASCII protocol: axes in degrees on a chain of devices on one serial line.

Knows what each warning flag means for a move; how a move is watched is in ``drivers.stage.watched``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.clock import Clock
from drivers.errors import MoveFailed, NotHomed, WrongDevice
from drivers.serial_port import Port, SerialPort
from drivers.stage import AxisIdentity, zaber_axis, zaber_protocol
from drivers.stage.watched import GoOn, Look, WatchedStage
from drivers.stage.zaber_axis import ZaberAxis
from drivers.stage.zaber_chain import ZaberChain
from drivers.wire_log import WireLog

__all__ = ["ZaberAxis", "ZaberStage"]


class ZaberStage(WatchedStage[ZaberAxis]):
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
        super().__init__(axes, clock=clock, where=port.name)
        self._chain = ZaberChain(port, [axis.device for axis in axes], clock=clock, wire_log=wire_log)
        try:
            self.identify()
            self._bring_to_rest()
            for axis in axes:
                zaber_axis.check_scale(self._chain, axis)
            for axis in axes:
                zaber_axis.program(self._chain, axis)
            self._encoders = {axis.name for axis in axes if self._has_encoder(axis)}
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

    def identify(self) -> Sequence[AxisIdentity]:
        """Ask every axis who it is. Raises WrongDevice when a serial number is not the station file's."""
        found = []
        for axis in self._axes.values():
            serial = self._chain.query(axis.device, 0, "get system.serial").data
            if axis.serial and serial != axis.serial:
                raise WrongDevice(
                    f"the station file says serial {axis.serial} for {axis.name}, but device {axis.device}"
                    f" says {serial}. Nothing was moved.",
                    where=self._where,
                    remedy="Check the port, the order of the chain, and the serial in the station file.",
                )
            model = self._chain.query(axis.device, 0, "get deviceid").data
            firmware = self._chain.query(axis.device, 0, "get version").data
            found.append(AxisIdentity(axis.name, "Zaber", f"device id {model}", serial, firmware))
        return tuple(found)

    def _has_reference(self) -> bool:
        return not any(zaber_protocol.UNREFERENCED & set(self._flags(axis)) for axis in self._axes.values())

    def faults(self) -> Sequence[str]:
        """Present warning flags of all axes in plain words, those aside that are only history."""
        return [
            f"{name}: {zaber_protocol.in_words(flag)}"
            for name, axis in self._axes.items()
            for flag in self._flags(axis)
            if not zaber_protocol.is_history(flag)
        ]

    def park(self) -> None:
        """Let every controller keep its position over a loss of power; moves nothing, and refuses all moves.

        Raises DeviceRefused while an axis moves.
        """
        self._tell_each("tools parking park")

    def unpark(self) -> None:
        """Take the axes out of their parking; they move at most to the nearest full step. Raises DeviceRefused."""
        self._tell_each("tools parking unpark")

    def close(self) -> None:
        """Give the port back; the stage stays where it is."""
        self._chain.close()

    # ------------------------------------------------------------ on the wire

    def _tell_each(self, words: str) -> None:
        for axis in self._axes.values():
            self._chain.command(axis.device, axis.axis, words)

    def _assure_ready(self, axis: ZaberAxis) -> None:
        """See that an axis is referenced and without fault; clear what is only history."""
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

    def _clear_faults(self, axis: ZaberAxis) -> None:
        self._chain.query(axis.device, axis.axis, "warnings clear")
        self._refuse_faults(axis, self._flags(axis))

    def _refuse_faults(self, axis: ZaberAxis, flags: Sequence[str]) -> None:
        for flag in flags:
            if zaber_protocol.is_fault(flag):
                raise MoveFailed(
                    f"{zaber_protocol.in_words(flag)}. Nothing was moved.",
                    where=axis.name,
                    remedy="Clear its cause, then home the stage.",
                )

    def _goal_deg(self, axis: ZaberAxis, angle_deg: float) -> float:
        return axis.angle_deg(axis.microsteps(angle_deg))

    def _start(self, goals_deg: Mapping[str, float], go_on: GoOn) -> None:
        for name, angle_deg in goals_deg.items():
            axis = self._axes[name]
            with self._chain.lock:
                go_on()
                self._chain.command(axis.device, axis.axis, f"move abs {axis.microsteps(angle_deg)}")

    def _start_homing(self, go_on: GoOn) -> None:
        for axis in self._axes.values():
            with self._chain.lock:
                go_on()
                self._chain.command(axis.device, axis.axis, "home")

    def _look(self, axis: ZaberAxis, *, homing: bool = False) -> Look:
        """Position, whether busy, and the most urgent flag: all of one reply."""
        reply = self._chain.query(axis.device, axis.axis, "get pos")
        position_deg = axis.angle_deg(self._chain.whole(reply.data))
        trouble = _trouble(reply.flag, homing=homing)
        return Look(position_deg, reply.busy, trouble, reply.flag in zaber_protocol.INTERRUPTED)

    def _look_at_rest(self, axis: ZaberAxis, *, homing: bool) -> Look:
        """Ask for all flags, since a reply shows the most urgent one only."""
        look = self._look(axis, homing=homing)
        flags = self._flags(axis)
        if homing and (unreferenced := zaber_protocol.UNREFERENCED & set(flags)):
            words = zaber_protocol.in_words(min(unreferenced))
            return look._replace(trouble=f"homing ended without a reference: {words}", harmless=False)
        troubles = {flag: _trouble(flag, homing=homing) for flag in flags}
        for flag, trouble in troubles.items():
            if trouble:
                return look._replace(trouble=trouble, harmless=flag in zaber_protocol.INTERRUPTED)
        return look

    def _send_stop(self) -> None:
        self._chain.stop_all()

    def _listen(self, seconds: float) -> None:
        self._chain.listen(seconds)

    def _encoder(self, axis: ZaberAxis) -> Look | None:
        if axis.name not in self._encoders:
            return None
        reply = self._chain.query(axis.device, axis.axis, "get encoder.pos")
        return Look(axis.angle_deg(self._chain.whole(reply.data)), reply.busy)

    def _has_encoder(self, axis: ZaberAxis) -> bool:
        return self._chain.setting(axis.device, axis.axis, "encoder.pos") is not None

    def _flags(self, axis: ZaberAxis) -> tuple[str, ...]:
        return self._chain.flags(axis.device, axis.axis)


def _trouble(flag: str, *, homing: bool) -> str:
    """Say why a move on which this flag shows will not end at its target; empty when it may."""
    words = zaber_protocol.in_words(flag)
    if zaber_protocol.is_fault(flag) or flag in zaber_protocol.INTERRUPTED:
        return words
    if flag in zaber_protocol.UNREFERENCED and not homing:
        return f"the controller lost its reference in mid-move, as after a restart: {words}"
    return ""
