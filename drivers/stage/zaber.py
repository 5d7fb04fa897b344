"""Zaber stages over their ASCII protocol: axes in degrees on a chain of devices on one serial line.

This module decides what each warning flag means for a move. ``drivers.stage.watched`` watches the moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.clock import Clock
from drivers.errors import MoveFailed, NotHomed, WrongDevice
from drivers.serial_port import Port, SerialPort
from drivers.stage import AxisIdentity, zaber_axis, zaber_protocol
from drivers.stage.watched import AxisState, StopCheck, WatchedStage
from drivers.stage.zaber_axis import ZaberAxis
from drivers.stage.zaber_chain import ZaberChain
from drivers.wire_log import WireLog

__all__ = ["ZaberAxis", "ZaberStage"]


class ZaberStage(WatchedStage[ZaberAxis]):
    """A stage of one to three Zaber axes. Implements ``drivers.stage.Stage``.

    Open it with ``ZaberStage.open``; the constructor takes a port that is open already.

    axes: The axes, in the order of the station file.
    clock: Every wait between two requests goes through it.
    wire_log: Records every byte; None for no record.
    Raises OutsideLimits: The limits in the station file lie beyond the controller's travel, or the scales
      differ.
    Raises ReplyError, PortLost: The controller does not answer.
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
        """Open the port, check the serial numbers, and set limits, speed and acceleration. Moves nothing.

        port: Address of the port; see ``drivers.serial_port.SerialPort``, which raises the errors of opening.
        baudrate: Bits per second.
        """
        return cls(SerialPort(port, baudrate=baudrate), axes, clock=clock, wire_log=wire_log)

    def identify(self) -> Sequence[AxisIdentity]:
        """See `Stage.identify`.

        Raises WrongDevice: A serial number is not the one in the station file.
        """
        found = []
        for axis in self._axes.values():
            serial = self._chain.query(axis.device, 0, "get system.serial").data
            if axis.serial and serial != axis.serial:
                raise WrongDevice(
                    f"the station file names serial {axis.serial} for {axis.name}, but device {axis.device}"
                    f" has {serial}. Nothing was moved.",
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
        """See `Stage.faults`. Warning flags that report a past event are left out."""
        return [
            f"{name}: {zaber_protocol.describe_flag(flag)}"
            for name, axis in self._axes.items()
            for flag in self._flags(axis)
            if not zaber_protocol.is_informational(flag)
        ]

    def close(self) -> None:
        """See `Stage.close`."""
        self._chain.close()

    # ------------------------------------------------------------ on the wire

    def _command_each(self, words: str) -> None:
        for axis in self._axes.values():
            self._chain.command(axis.device, axis.axis, words)

    def _check_ready(self, axis: ZaberAxis) -> None:
        """Check that an axis has a reference and no fault; clear the flags that report past events."""
        flags = self._flags(axis)
        if unreferenced := sorted(zaber_protocol.UNREFERENCED & set(flags)):
            raise NotHomed(
                f"the axis has no reference: {', '.join(map(zaber_protocol.describe_flag, unreferenced))}."
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
                    f"{zaber_protocol.describe_flag(flag)}. Nothing was moved.",
                    where=axis.name,
                    remedy="Clear the cause, then home the stage.",
                )

    def _reachable_deg(self, axis: ZaberAxis, angle_deg: float) -> float:
        return axis.to_angle_deg(axis.to_microsteps(angle_deg))

    def _start(self, goals_deg: Mapping[str, float], check_not_stopped: StopCheck) -> None:
        for name, angle_deg in goals_deg.items():
            axis = self._axes[name]
            with self._chain.lock:
                check_not_stopped()
                self._chain.command(axis.device, axis.axis, f"move abs {axis.to_microsteps(angle_deg)}")

    def _start_homing(self, check_not_stopped: StopCheck) -> None:
        for axis in self._axes.values():
            with self._chain.lock:
                check_not_stopped()
                self._chain.command(axis.device, axis.axis, "home")

    def _read_state(self, axis: ZaberAxis, *, homing: bool = False) -> AxisState:
        """Read position, busy state and the most urgent flag from one reply."""
        reply = self._chain.query(axis.device, axis.axis, "get pos")
        position_deg = axis.to_angle_deg(self._chain.parse_integer(reply.data))
        problem = _problem(reply.flag, homing=homing)
        return AxisState(position_deg, reply.busy, problem, reply.flag in zaber_protocol.INTERRUPTED)

    def _read_final_state(self, axis: ZaberAxis, *, homing: bool) -> AxisState:
        """Ask for all flags too: a reply shows the most urgent one only."""
        state = self._read_state(axis, homing=homing)
        flags = self._flags(axis)
        if homing and (unreferenced := zaber_protocol.UNREFERENCED & set(flags)):
            words = zaber_protocol.describe_flag(min(unreferenced))
            problem = f"homing ended without a reference: {words}"
            return state._replace(problem=problem, position_kept=False)
        for flag in flags:
            if problem := _problem(flag, homing=homing):
                return state._replace(problem=problem, position_kept=flag in zaber_protocol.INTERRUPTED)
        return state

    def _send_stop(self) -> None:
        self._chain.stop_all()

    def _listen(self, duration_s: float) -> None:
        self._chain.listen(duration_s)

    def _read_encoder(self, axis: ZaberAxis) -> AxisState | None:
        if axis.name not in self._encoders:
            return None
        reply = self._chain.query(axis.device, axis.axis, "get encoder.pos")
        return AxisState(axis.to_angle_deg(self._chain.parse_integer(reply.data)), reply.busy)

    def _has_encoder(self, axis: ZaberAxis) -> bool:
        return self._chain.query_setting(axis.device, axis.axis, "encoder.pos") is not None

    def _flags(self, axis: ZaberAxis) -> tuple[str, ...]:
        return self._chain.query_flags(axis.device, axis.axis)


def _problem(flag: str, *, homing: bool) -> str:
    """Return why a move with this flag will not end at its target; empty when it may."""
    words = zaber_protocol.describe_flag(flag)
    if zaber_protocol.is_fault(flag) or flag in zaber_protocol.INTERRUPTED:
        return words
    if flag in zaber_protocol.UNREFERENCED and not homing:
        return f"the controller lost its reference during the move, as after a restart: {words}"
    return ""
