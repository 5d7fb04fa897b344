"""Zaber stages over their ASCII protocol: axes in degrees on a chain of devices on one serial line.

This module decides what each warning flag means for a move. ``drivers.stage.watched`` watches the moves.
"""

from __future__ import annotations

from collections.abc import Sequence

from drivers.clock import Clock
from drivers.serial_port import Port, closed_on_error
from drivers.stage import AxisIdentity, zaber_axis, zaber_protocol
from drivers.stage.watched import AxisState, OneLineStage, no_reference, not_movable
from drivers.stage.zaber_axis import ZaberAxis
from drivers.stage.zaber_chain import ZaberChain
from drivers.wire_log import WireLog

__all__ = ["ZaberAxis", "ZaberStage"]


class ZaberStage(OneLineStage[ZaberAxis]):
    """A stage of one to three Zaber axes. Implements ``drivers.stage.Stage``.

    Open it with ``ZaberStage.open``; the constructor takes a port that is open already.

    axes: The axes, in the order of the station file.
    clock: Every wait between two requests goes through it.
    wire_log: Records every byte; None for no record.
    Raises OutsideLimits: The limits in the station file lie beyond the controller's travel, or the scales
      differ.
    Raises ReplyError, PortLost: The controller does not answer.
    """

    BAUDRATE = 115200

    def __init__(
        self, port: Port, axes: Sequence[ZaberAxis], *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        super().__init__(axes, clock=clock, where=port.name)
        with closed_on_error(port):
            devices = [axis.device for axis in axes]
            self._chain = self._share(ZaberChain(port, devices, clock=clock, wire_log=wire_log))
            self.identify()
            self._bring_to_rest()
            for axis in axes:
                zaber_axis.check_scale(self._chain, axis)
            for axis in axes:
                zaber_axis.program(self._chain, axis)
            self._encoders = {axis.name for axis in axes if self._has_encoder(axis)}

    def identify(self) -> Sequence[AxisIdentity]:
        """See `Stage.identify`.

        Raises WrongDevice: A serial number is not the one in the station file.
        """
        found = []
        for axis in self._axes.values():
            serial = self._chain.query(axis.device, 0, "get system.serial").data
            self._require_serial(
                axis,
                serial,
                f"device {axis.device} has {serial}",
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

    # ------------------------------------------------------------ on the wire

    def _check_ready(self, axis: ZaberAxis) -> None:
        """Check that an axis has a reference and no fault; clear the flags that report past events."""
        flags = self._flags(axis)
        if unreferenced := sorted(zaber_protocol.UNREFERENCED & set(flags)):
            flags_in_words = ", ".join(map(zaber_protocol.describe_flag, unreferenced))
            raise no_reference(axis, f"the axis has no reference: {flags_in_words}")
        self._refuse_faults(axis, flags)
        if flags:
            self._chain.query(axis.device, axis.axis, "warnings clear")

    def _clear_faults(self, axis: ZaberAxis) -> None:
        self._chain.query(axis.device, axis.axis, "warnings clear")
        self._refuse_faults(axis, self._flags(axis))

    def _refuse_faults(self, axis: ZaberAxis, flags: Sequence[str]) -> None:
        for flag in flags:
            if zaber_protocol.is_fault(flag):
                raise not_movable(axis, zaber_protocol.describe_flag(flag))

    def _begin_move(self, axis: ZaberAxis, angle_deg: float) -> None:
        self._chain.command(axis.device, axis.axis, f"move abs {axis.to_counts(angle_deg)}")

    def _begin_homing(self, axis: ZaberAxis) -> None:
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
