"""Zaber stages over their ASCII protocol: axes in degrees on a chain of devices on one serial line.

This module decides what each warning flag means for a move. ``drivers.stage.watched`` watches the moves.

Source: "Zaber ASCII Protocol Manual", https://www.zaber.com/protocol-manual, settings ``maxspeed``, ``accel``,
``limit.min``, ``limit.max`` and ``limit.cycle.dist``.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from drivers.clock import Clock
from drivers.errors import DeviceRefused, OutsideLimits, ReplyGarbled
from drivers.link import Link, ReplyReader, repeat
from drivers.serial_port import LineSettings, Port
from drivers.stage import AxisIdentity, motion, zaber_protocol
from drivers.stage.motion import Axis
from drivers.stage.refusals import no_reference, not_as_stated, not_movable, reads_otherwise
from drivers.stage.watched import AxisState, OneLineStage
from drivers.stage.zaber_protocol import Reply
from drivers.wire_log import WireLog

_MARKER_S = 0.5  # Longest wait for the reply that shows that no older reply will follow
_MESSAGE_IDS = 100  # Ids have two digits
_ANSWERED_ALREADY = frozenset({1, _MESSAGE_IDS - 1})
"""Ids, against that of a request, of the request before it and of the marker between the two."""
SPEED_UNITS = 1.6384
"""maxspeed = 1.6384 x microsteps/s (ASCII Protocol Manual, setting maxspeed)."""
ACCELERATION_UNITS = 1.6384e-4
"""accel = 1.6384 / 10000 x microsteps/s^2 (ASCII Protocol Manual, setting accel)."""
_SCALE_AGREES = 1e-6  # Share of a turn: a scale is written with some digits
_MODEL_NAMES = ("deviceid", "device.id")
"""Settings with the number of the model, of firmware 6 and 7; firmware 7 need not know the older name."""
_HOME_PRESET = "limit.home.preset"
"""Setting of the position that homing sets."""


class ZaberChain(Link):
    """A chain of devices on one line. Opening sends nothing.

    ``devices`` are the addresses that this driver uses; others in the chain are stopped by ``stop_all`` only.
    """

    TELLS_ECHO = True
    SILENT_REMEDY = (
        f"{Link.SILENT_REMEDY} A device that was set to the binary protocol (9600 baud) stays silent: set it to ASCII"
        " with Zaber Launcher."
    )

    def __init__(
        self, port: Port, devices: Collection[int], *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        self._devices = sorted(set(devices))
        self._ids = itertools.cycle(range(_MESSAGE_IDS))
        super().__init__(port, clock=clock, wire_log=wire_log)

    def take_unsolicited(self, line: bytes) -> bool:
        """Take an alert or an information line."""
        return zaber_protocol.is_unsolicited(line, self.name)

    def command(self, device: int, axis: int, words: str, *, strict: bool = True) -> Reply:
        """Send a command, such as ``move abs 50000``, once; return the reply that accepts it.

        A command that moves something must never be sent twice. Device 0 stands for all, axis 0 for the device itself.
        Without ``strict``, the reply may lack a checksum.
        """
        reply = self._ask_once(device, axis, words, strict=strict)
        if not reply.accepted:
            reason = zaber_protocol.REFUSALS.get(reply.data, reply.data)
            raise DeviceRefused(
                f"device {device} refuses '{words}': {reason} ({reply.data}).",
                where=self.name,
                remedy=zaber_protocol.REMEDIES.get(
                    reply.data, "Look this command up in the controller's manual."
                ),
            )
        return reply

    def query(self, device: int, axis: int, words: str, *, strict: bool = True) -> Reply:
        """Send a command (see ``command``) that does no harm twice, until its reply is valid; return that reply."""
        return repeat(lambda: self.command(device, axis, words, strict=strict))

    def query_integer(self, device: int, axis: int, words: str) -> int:
        """Send a query (see ``command``) whose answer is one integer."""
        data = self.query(device, axis, words).data
        return self.parse_integer(data)

    def parse_integer(self, data: str) -> int:
        """Parse the data of a reply as one integer; otherwise the line is out of step."""
        if not re.fullmatch(r"-?\d{1,18}", data, re.ASCII):
            raise self.garbled_reply(f"{data!r} came instead of an integer.", "Look into the wire log.")
        return int(data)

    def query_flags(self, device: int, axis: int) -> tuple[str, ...]:
        """Ask for all warning flags of an axis; device and axis as for ``command``."""
        data = self.query(device, axis, "warnings").data
        try:
            return zaber_protocol.parse_flags(data, self.name)
        except ReplyGarbled:
            self.mark_out_of_step()
            raise

    def query_setting(self, device: int, axis: int, name: str) -> int | None:
        """Ask for an integer setting such as ``limit.max``; None when the device refuses: it has no such setting."""
        try:
            return self.query_integer(device, axis, f"get {name}")
        except DeviceRefused:
            return None

    def switch_checksums_on(self, device: int) -> None:
        """Let a device end its replies in a checksum, as no device from the factory does; it keeps this setting."""
        if self.query(device, 0, "get comm.checksum", strict=False).data != "1":
            self.query(device, 0, "set comm.checksum 1", strict=False)

    def stop_all(self) -> None:
        """Send one stop to every device on the line, at once, without resynchronising.

        A device of this driver that has not accepted it at the last attempt raises `ReplyError`.
        """
        with self.lock:
            repeat(self._stop_once)

    def _stop_once(self) -> None:
        message_id = next(self._ids)
        waiting_for = set(self._devices)

        def read_reply(reader: ReplyReader) -> None:
            while waiting_for:
                try:
                    reply = zaber_protocol.parse_reply(reader.read_line(), self.name)
                except ReplyGarbled:
                    continue  # the reply to an older request, which the stop has cut in two
                if reply.message_id == message_id and reply.accepted:
                    waiting_for.discard(reply.device)

        request = zaber_protocol.request(0, 0, message_id, "stop")
        with self.urgently():
            self.exchange(request, read_reply)

    def _ask_once(self, device: int, axis: int, words: str, *, strict: bool = True) -> Reply:
        message_id = next(self._ids)

        def read_reply(reader: ReplyReader) -> Reply:
            line = reader.read_line()
            reply = zaber_protocol.parse_reply(line, self.name, without_checksum=not strict)
            if (reply.device, reply.axis, reply.message_id) != (device, axis, message_id):
                if (reply.message_id - message_id) % _MESSAGE_IDS in _ANSWERED_ALREADY:
                    raise self.garbled_reply(
                        f"a second answer to one request came from device {reply.device}.",
                        "Two devices of the chain may have this address, as they come from the factory: send"
                        " 'renumber', then correct the addresses in the station file.",
                    )
                raise self.garbled_reply(
                    f"the answer to another request came: {reply}.", "Look into the wire log."
                )
            return reply

        request = zaber_protocol.request(device, axis, message_id, words)
        return self.exchange(request, read_reply)

    def _resynchronise(self) -> None:
        """Wait for silence; then the reply to a new message id proves that no older reply is unread."""
        self.prove_in_step(
            lambda: self._ask_once(self._devices[0], 0, "", strict=False),
            marker_s=_MARKER_S,
            silence_after=False,
        )


@dataclass(frozen=True, kw_only=True)
class ZaberAxis(Axis):
    """One axis as the station file describes it."""

    device: int
    # Microsteps per degree; negative when the counter falls as the angle grows. Never guessed from a model.
    microsteps_per_deg: float
    axis: int = 1
    # Microsteps a step for which that scale holds: the controller's setting ``resolution``.
    resolution: int = 64
    # Other settings that change every angle, such as ``driver.dir``; the controller must have these values.
    settings: Mapping[str, float] = field(default_factory=dict)

    @property
    def scale(self) -> float:
        """Microsteps per degree."""
        return self.microsteps_per_deg


class ZaberStage(OneLineStage[ZaberAxis, ZaberChain]):
    """A stage of one to three Zaber axes. Implements ``drivers.stage.Stage``.

    Limits beyond the controller's travel, or other scales, raise `OutsideLimits`.
    """

    SETTINGS = LineSettings(115200)  # of the ASCII protocol

    def _connected(self, port: Port, wire_log: WireLog | None) -> ZaberChain:
        devices = [axis.device for axis in self._axes.values()]
        return ZaberChain(port, devices, clock=self._clock, wire_log=wire_log)

    def _set_up(self) -> None:
        self.identify()
        self._bring_to_rest()
        for axis in self._axes.values():
            self._check_scale(axis)
        for axis in self._axes.values():
            self._program(axis)
        self._encoders = {
            name for name, axis in self._axes.items() if self._setting(axis, "encoder.pos") is not None
        }

    def _identity_of(self, axis: ZaberAxis) -> AxisIdentity:
        """Ask for the identity; once its serial number is the right one, switch the device's checksums on."""
        serial = self._line.query(axis.device, 0, "get system.serial", strict=False).data
        self._require_serial(
            axis,
            serial,
            f"device {axis.device} has {serial}",
            remedy="Check the port, the order of the chain, and the serial in the station file.",
        )
        self._line.switch_checksums_on(axis.device)
        models = (self._line.query_setting(axis.device, 0, name) for name in _MODEL_NAMES)
        model = next((model for model in models if model is not None), "unknown")
        firmware = self._line.query(axis.device, 0, "get version").data
        return AxisIdentity(axis.name, "Zaber", f"device id {model}", serial, firmware)

    def _has_reference(self) -> bool:
        return self._was_homed() and not any(
            zaber_protocol.UNREFERENCED & set(self._flags(axis)) for axis in self._axes.values()
        )

    def _faults_of(self, axis: ZaberAxis) -> list[str]:
        """Return the warning flags in words; those that report a past event are left out."""
        flags = self._flags(axis)
        return [
            zaber_protocol.describe_flag(flag) for flag in flags if not zaber_protocol.is_informational(flag)
        ]

    # ------------------------------------------------------------ on the wire

    def _check_ready(self, axis: ZaberAxis) -> None:
        """Check that an axis has a reference and no fault; clear the flags that report past events."""
        flags = self._flags(axis)
        if unreferenced := sorted(zaber_protocol.UNREFERENCED & set(flags)):
            flags_in_words = ", ".join(map(zaber_protocol.describe_flag, unreferenced))
            raise no_reference(axis, f"the axis has no reference: {flags_in_words}")
        if not self._was_homed():
            raise no_reference(axis, motion.HOMED_BY_ANOTHER)
        self._refuse_faults(axis, flags)
        if flags:
            self._line.query(axis.device, axis.axis, "warnings clear")

    def _clear_faults(self, axis: ZaberAxis) -> None:
        self._line.query(axis.device, axis.axis, "warnings clear")
        self._refuse_faults(axis, self._flags(axis))

    def _refuse_faults(self, axis: ZaberAxis, flags: Sequence[str]) -> None:
        for flag in flags:
            if zaber_protocol.is_fault(flag):
                raise not_movable(axis, zaber_protocol.describe_flag(flag))

    def _begin_move(self, axis: ZaberAxis, angle_deg: float) -> None:
        self._line.command(axis.device, axis.axis, f"move abs {axis.to_counts(angle_deg)}")

    def _begin_homing(self, axis: ZaberAxis) -> None:
        self._line.command(axis.device, axis.axis, "home")

    def _read_state(self, axis: ZaberAxis, *, homing: bool = False) -> AxisState:
        """Read position, busy state and the most urgent flag from one reply."""
        reply = self._line.query(axis.device, axis.axis, "get pos")
        position_deg = axis.to_angle_deg(self._line.parse_integer(reply.data))
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
        self._line.stop_all()

    def _read_encoder(self, axis: ZaberAxis) -> AxisState | None:
        if axis.name not in self._encoders:
            return None
        reply = self._line.query(axis.device, axis.axis, "get encoder.pos")
        return AxisState(axis.to_angle_deg(self._line.parse_integer(reply.data)), reply.busy)

    def _flags(self, axis: ZaberAxis) -> tuple[str, ...]:
        return self._line.query_flags(axis.device, axis.axis)

    # ------------------------------------------------------------ settings

    def _check_scale(self, axis: ZaberAxis) -> None:
        """Check scale and limits by the controller's microsteps and travel, and the stated settings."""
        turn = self._setting(axis, "limit.cycle.dist")
        resolution = self._setting(axis, "resolution")
        expected = abs(axis.microsteps_per_deg) * 360.0
        if turn:
            slack = max(1.0, _SCALE_AGREES * expected)
            remedy = "Correct microsteps_per_deg in the station file."
            motion.check_scale(axis, expected, turn, "microsteps a turn", remedy, slack=slack)
        elif resolution is not None:
            remedy = (
                f"Send 'set resolution {axis.resolution}', or state resolution: {resolution} and the scale for it in"
                " the station file."
            )
            motion.check_scale(axis, axis.resolution, resolution, "microsteps a step", remedy, slack=0.0)
        for name, stated in {_HOME_PRESET: 0.0, **axis.settings}.items():
            value = self._setting(axis, name)
            if value != stated and (value is not None or name in axis.settings):
                raise not_as_stated(axis.name, name, stated, value, f"set {name} {stated:g}")
        present = self._setting(axis, "limit.min"), self._setting(axis, "limit.max")
        motion.check_travel(axis.name, _travel(axis), present, "microsteps", to_deg=axis.to_angle_deg)

    def _program(self, axis: ZaberAxis) -> None:
        """Set limits, speed and acceleration where they differ, and read them back.

        Only settings that differ are sent, because the controller keeps them in non-volatile memory. Speed or
        acceleration below the controller's unit is refused: its acceleration 0 would mean full speed at once.
        """
        lowest, highest = _travel(axis)
        scale = abs(axis.microsteps_per_deg)
        wanted = {
            "limit.min": lowest,
            "limit.max": highest,
            "maxspeed": math.floor(axis.limits.speed_deg_s * scale * SPEED_UNITS),
            "accel": math.floor(axis.limits.acceleration_deg_s2 * scale * ACCELERATION_UNITS),
        }
        if not (wanted["maxspeed"] and wanted["accel"]):
            raise OutsideLimits(
                f"{axis.limits.speed_deg_s:g} deg/s or {axis.limits.acceleration_deg_s2:g} deg/s^2 is below the"
                " controller's smallest step.",
                where=axis.name,
                remedy="Raise speed_deg_s or acceleration_deg_s2 in the station file.",
            )
        wanted |= {"motion.accelonly": wanted["accel"], "motion.decelonly": wanted["accel"]}
        for name, value in wanted.items():
            present = self._setting(axis, name)
            if present == value or (present is None and name.startswith("motion.")):  # not in every firmware
                continue
            self._line.query(axis.device, axis.axis, f"set {name} {value}")
            got = self._line.query_integer(axis.device, axis.axis, f"get {name}")
            if got != value:
                remedy = "Change speed, acceleration or limits in the station file to what the controller supports."
                raise reads_otherwise(axis, name, value, got, remedy)

    def _setting(self, axis: ZaberAxis, name: str) -> int | None:
        return self._line.query_setting(axis.device, axis.axis, name)


def _travel(axis: ZaberAxis) -> tuple[int, int]:
    ends = (axis.to_counts(axis.limits.lowest_deg), axis.to_counts(axis.limits.highest_deg))
    return min(ends), max(ends)


def _problem(flag: str, *, homing: bool) -> str:
    """Return why a move with this flag will not end at its target; empty when it may."""
    words = zaber_protocol.describe_flag(flag)
    if zaber_protocol.is_fault(flag) or flag in zaber_protocol.INTERRUPTED:
        return words
    if flag in zaber_protocol.UNREFERENCED and not homing:
        return f"the controller lost its reference during the move, as after a restart: {words}"
    return ""
