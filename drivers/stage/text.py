"""Stages whose controller has a described text protocol, in degrees.

`drivers.described.description` says what such a protocol may be; the bench reads it from a file. A position is the
controller's counts by the scale of the station file. All settings that were written are read again before and after
each move: another value means that the controller has restarted, and the reference is lost.

In a mode that another program has left, a setting can be a motion. So opening only asks, and ``home`` sets modes and
settings. A homing is believed by evidence: a controller may ignore the command in silence, and its counter may be 0
anywhere. The module moves nothing but by ``home`` and ``move_to``; ``drivers.stage.watched`` watches the moves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.described.description import AxisSetting, Exchange, StageDescription, Switch, Value
from drivers.described.line import DescribedLine, shown
from drivers.errors import DeviceRefused, ReplyError, ReplyTimeout
from drivers.link import TRIES
from drivers.serial_port import LineSettings, Port
from drivers.stage import AxisIdentity, motion
from drivers.stage.motion import Axis
from drivers.stage.refusals import no_reference, reads_otherwise
from drivers.stage.watched import AxisState, OneLineStage, StopCheck
from drivers.wire_log import WireLog

_STOPS_IN_SILENCE = 2
"""How often a stop is sent at once while no reply comes."""
_BEGINS_S = 1.0
"""Longest time from a command until the controller reports that the axis moves, s."""
_MOST_ERRORS = 40
"""Errors of other programs' commands that a controller may hold."""
_SCALE_SLACK = 2e-4
"""Largest relative difference between the scale of the station file and the controller's: it prints few digits."""


@dataclass(frozen=True, kw_only=True)
class TextAxis(Axis):
    """One axis as the station file describes it."""

    address: str  # The controller's word for the axis, which stands for ``{address}`` in the description
    counts_per_deg: float  # Scale; negative when the counter falls as the angle grows

    @property
    def scale(self) -> float:
        """Counts per degree."""
        return self.counts_per_deg

    def to_position(self, angle_deg: float) -> float:
        """Return the counter at an angle, in counts, not rounded: the description says how it is sent."""
        return (angle_deg - self.zero_deg) * self.counts_per_deg


class TextStage(OneLineStage[TextAxis, DescribedLine]):
    """A stage of one to three axes on one controller. Implements ``drivers.stage.Stage``.

    ``serial`` is empty when it is not checked. Limits or a scale that contradict the controller's raise
    `OutsideLimits`.
    """

    def __init__(
        self,
        port: Port,
        axes: Sequence[TextAxis],
        description: StageDescription,
        *,
        serial: str = "",
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> None:
        self._description = description
        self._serial = serial
        self._unseen: dict[str, tuple[float, float]] = {}
        """Motions that the controller has not shown yet, by axis: time of the command, s, and target, degrees."""
        self._unproven: dict[str, float] = {}
        """Axes of which nothing shows yet that they search their reference, and where they stood before, degrees."""
        self._awaited: list[tuple[Exchange, dict[str, Value], str]] = []
        """Commands whose late reply has not come, with their values and what was sent; only the first is sent."""
        super().__init__(port, axes, clock=clock, wire_log=wire_log)

    def _connected(self, port: Port, wire_log: WireLog | None) -> DescribedLine:
        return DescribedLine(port, self._description.line, clock=self._clock, wire_log=wire_log)

    def _set_up(self) -> None:
        self.identify()
        self._bring_to_rest()
        self._line.take_notices()

    @classmethod
    def _line_settings(cls, _axes: Sequence[TextAxis], description: StageDescription) -> LineSettings:
        return description.line.settings

    def identify(self) -> Sequence[AxisIdentity]:
        """See `Stage.identify`; the serial number is compared with the one in the station file."""
        line = self._description.line
        serial = self._line.read_serial(self._serial)
        firmware = shown(self._line.identity.get("firmware", ""))
        return tuple(AxisIdentity(name, line.maker, line.model, serial, firmware) for name in self._axes)

    def _has_reference(self) -> bool:
        """Whether this driver has homed, the controller does not deny it, and nothing has changed since."""
        if not self._was_homed() or any(map(self._without_reference, self._axes.values())):
            return False
        return not self._changed_settings()

    def faults(self) -> Sequence[str]:
        """See `Stage.faults`. Returns what the controller said unasked, and the faults that it reports."""
        return [*self._line.take_notices(), *super().faults()]

    def _faults_of(self, axis: TextAxis) -> list[str]:
        if self._description.faults is None:
            return []
        fine, answer = self._line.switch(self._description.faults, self._of(axis))
        return [] if fine else [answer]

    # ------------------------------------------------------------ on the wire

    def _of(self, axis: TextAxis, **values: Value) -> dict[str, Value]:
        return {"address": axis.address, **values}

    def _check_ready(self, axis: TextAxis) -> None:
        if not self._has_reference():
            raise no_reference(axis, "this program has not homed the axis, or its controller has restarted")
        self._line.take_notices()

    def _clear_faults(self, axis: TextAxis) -> None:
        """Set modes and settings that an axis can have before it has a reference. Each mode stands between stops."""
        self._line.take_notices()
        errors = self._description.errors
        for _ in range(_MOST_ERRORS if errors is not None else 0):
            if errors is None or self._line.switch(errors, self._of(axis))[0]:
                break
        for mode in self._description.modes:
            self._line.query(self._description.stop, self._of(axis))
            self._command(mode, axis)
            self._line.query(self._description.stop, self._of(axis))
        for setting in self._description.settings:
            if not setting.is_position:
                self._set(axis, setting)

    def _finish_homing(self, axis: TextAxis) -> None:
        """Compare what a homing may have changed, and write the other settings."""
        self._check_axis(axis)
        for setting in self._description.settings:
            self._set(axis, setting)
        for command in self._description.setup:
            self._command(command, axis)

    def _reachable_deg(self, axis: TextAxis, angle_deg: float) -> float:
        values = self._of(axis, target=axis.to_position(angle_deg))
        return axis.to_angle_deg(float(self._description.move.send.as_sent(values, "target")))

    def _begin_move(self, axis: TextAxis, angle_deg: float) -> None:
        target = axis.to_position(angle_deg)
        if self._description.move_replies_at_end:
            self._order_late(self._description.move, self._of(axis, target=target))
        else:
            self._unseen[axis.name] = self._clock.monotonic(), angle_deg
            self._command(self._description.move, axis, tries=1, target=target)
        if self._description.start is not None:
            self._command(self._description.start, axis, tries=1)

    def _start_homing(self, check_not_stopped: StopCheck) -> None:
        self._awaited, self._unproven = [], {}
        super()._start_homing(check_not_stopped)

    def _begin_homing(self, axis: TextAxis) -> None:
        """Start a search; note what will show that it took place, but for a reply that only a finished one has."""
        if self._description.home_replies_at_end:
            self._order_late(self._description.home, self._of(axis))
            return
        if not self._without_reference(axis):  # a new reference shows it
            self._unproven[axis.name] = self._read_state(axis).position_deg
        self._unseen[axis.name] = self._clock.monotonic(), math.nan
        self._command(self._description.home, axis, tries=1)

    def _command(self, command: Exchange, axis: TextAxis, *, tries: int = TRIES, **values: Value) -> None:
        """Send a command, then look for errors if it has no reply."""
        self._line.query(command, self._of(axis, **values), tries=tries)
        self._accepts(command, axis, values)

    def _accepts(self, command: Exchange, axis: TextAxis, values: dict[str, Value]) -> bool:
        """Ask whether a command without a reply was an error; raise DeviceRefused if so. False if that is not told."""
        errors = self._description.errors
        if errors is None or command.reply is not None:
            return False
        fine, answer = self._line.switch(errors, self._of(axis))
        if not fine:
            raise DeviceRefused(
                f"the device refuses '{command.send.render(self._of(axis, **values))}'"
                f"{self._answered(errors, axis, answer)}.",
                where=axis.name,
                remedy="Look the answer up in the manual of the device.",
            )
        return True

    def _order_late(self, command: Exchange, values: dict[str, Value]) -> None:
        """Send what moves an axis and is answered when that has ended, after the replies to all before it."""
        self._awaited.append((command, values, ""))
        if len(self._awaited) == 1:
            self._send_awaited()

    def _send_awaited(self) -> None:
        command, values, _ = self._awaited[0]
        self._awaited[0] = command, values, self._line.send_without_reply(command, values)

    def _is_awaiting(self) -> bool:
        """Look for the late reply to a command; then send the next one."""
        command, values, request = self._awaited[0]
        if self._line.poll(command, request, values):
            self._awaited.pop(0)
            if self._awaited:
                self._send_awaited()
        return bool(self._awaited)

    def _read_state(self, axis: TextAxis, *, homing: bool = False) -> AxisState:
        """Ask whether the axis is idle, then where it is: the position of an idle axis is then one at rest."""
        if self._awaited:
            with self._line.lock:
                if self._is_awaiting():
                    return AxisState(math.nan, busy=True)
        idle, _ = self._line.switch(self._description.idle, self._of(axis))
        counts = self._line.query(self._description.position, self._of(axis))["counts"]
        problem = "" if homing else "; ".join(self._line.take_notices())
        position_deg = axis.to_angle_deg(float(counts))
        if not idle or abs(position_deg - self._unproven.get(axis.name, position_deg)) > axis.tolerance_deg:
            self._unproven.pop(axis.name, None)
        return AxisState(position_deg, not idle or self._may_still_begin(axis, position_deg, idle), problem)

    def _may_still_begin(self, axis: TextAxis, position_deg: float, idle: bool) -> bool:
        """Whether an axis that is idle away from its target may not have begun its motion yet."""
        begun_s, goal_deg = self._unseen.get(axis.name, (-math.inf, math.nan))
        arrived = abs(position_deg - goal_deg) <= axis.tolerance_deg
        if not idle or arrived or self._clock.monotonic() - begun_s >= _BEGINS_S:
            self._unseen.pop(axis.name, None)
        return axis.name in self._unseen

    def _without_reference(self, axis: TextAxis) -> str:
        """Return the answer of a controller that has no reference, as the end of a sentence; else empty."""
        reference = self._description.reference
        if reference is None:
            return ""
        has_reference, answer = self._line.switch(reference, self._of(axis))
        return "" if has_reference else self._answered(reference, axis, answer)

    def _answered(self, switch: Switch, axis: TextAxis, answer: str) -> str:
        return f": '{switch.query.send.render(self._of(axis))}' is answered by '{answer}'"

    def _what_says_busy(self) -> str:
        idle = self._description.idle
        answers = [(axis, *self._line.switch(idle, self._of(axis))) for axis in self._axes.values()]
        axis, _, answer = next((busy for busy in answers if not busy[1]), answers[0])
        return f"{self._answered(idle, axis, answer)}, which is not under idle in its description"

    def _read_final_state(self, axis: TextAxis, *, homing: bool) -> AxisState:
        """Read the settings and the faults too: a restart undoes the settings."""
        state = self._read_state(axis, homing=homing)
        if self._changed_settings(with_positions=not homing):
            return state._replace(problem="the controller restarted during the move: its position is lost")
        if homing and (without := self._without_reference(axis)):
            return state._replace(problem=f"homing ended without a reference{without}")
        if homing and (doubt := self._unbelieved(axis, state.position_deg)):
            return state._replace(problem=doubt)
        if homing:
            self._line.take_notices()  # a search of the reference may touch the limit switches
        faults = self.faults()
        return state._replace(problem=state.problem or "; ".join(faults))

    def _unbelieved(self, axis: TextAxis, position_deg: float) -> str:
        """Return why an axis that is idle after the search of its reference has not found it; empty if it has."""
        if axis.name in self._unproven and not self._accepts(self._description.home, axis, {}):
            return (
                f"nothing shows that the controller searched the reference: the axis stayed at {position_deg:.4f} deg."
                " The controller ignored the command, or the axis is at its reference already: then turn it away"
            )
        at_home = self._description.at_home
        if at_home is not None and abs(position_deg - axis.to_angle_deg(at_home)) > axis.tolerance_deg:
            return f"the search of the reference ended at {axis.to_counts(position_deg)} counts, not at {at_home:g}"
        return ""

    def _read_encoder(self, axis: TextAxis) -> AxisState | None:
        if self._description.encoder is None:
            return None
        idle, _ = self._line.switch(self._description.idle, self._of(axis))
        counts = self._line.query(self._description.encoder, self._of(axis))["counts"]
        return AxisState(axis.to_angle_deg(float(counts)), not idle)

    def _send_stop(self) -> None:
        """Stop at once, twice if no reply comes; when the reply is bad or late, once more on a clean line.

        On a line without any reply, the clean line is tried only once. A stage without power is then told sooner.
        """
        self._unseen.clear()
        if self._awaited:
            self._awaited = []
            self._homed_in = None
            self._line.mark_out_of_step()  # an outstanding late reply is thrown away before the next request
        waiting, tries = self._stop_commands(), 1
        for _ in range(_STOPS_IN_SILENCE):
            for values in waiting.copy():
                try:
                    self._line.query_urgent(self._description.stop, values)
                    waiting.remove(values)
                except ReplyError as error:
                    if not isinstance(error, ReplyTimeout) or error.late_s:
                        tries = TRIES
            if tries == TRIES:
                break
        errors: list[ReplyError] = []
        for values in waiting:
            try:
                self._line.query(self._description.stop, values, tries=tries)
            except ReplyError as error:
                errors.append(error)
        if errors:
            raise errors[0]

    def _stop_commands(self) -> list[dict[str, Value]]:
        """Return the values of each stop that must be sent: one for all axes, or one for each."""
        stops = {self._description.stop.send.render(self._of(axis)): axis for axis in self._axes.values()}
        return [self._of(axis) for axis in stops.values()]

    # ------------------------------------------------------------ settings

    def _check_axis(self, axis: TextAxis) -> None:
        """Compare scale and travel with the station's. A device may know them only after a homing."""
        scale, lowest, highest = (
            None if query is None else self._number(query, axis, name)
            for query, name in (
                (self._description.scale, "scale"),
                (self._description.lowest, "counts"),
                (self._description.highest, "counts"),
            )
        )
        if scale is not None:
            self._check_scale(axis, scale)
        ends = sorted(map(axis.to_position, (axis.limits.lowest_deg, axis.limits.highest_deg)))
        motion.check_travel(
            axis.name, (ends[0], ends[1]), (lowest, highest), "counts", slack=1.0, to_deg=axis.to_angle_deg
        )

    def _check_scale(self, axis: TextAxis, counts_per_deg: float) -> None:
        if counts_per_deg <= 0:
            raise self._line.garbled_reply(f"the controller reports a scale of {counts_per_deg:g}.")
        counts = {
            "counts_per_deg": counts_per_deg,
            "deg_per_count": 1.0 / counts_per_deg,
            "arcsec_per_count": 3600.0 / counts_per_deg,
        }[self._description.scale_unit]
        remedy = "Correct counts_per_deg in the station file (its sign is the direction), or the controller's steps."
        given = abs(axis.counts_per_deg)
        motion.check_scale(axis, given, counts, "counts per degree", remedy, slack=_SCALE_SLACK * counts)

    def _number(self, query: Exchange, axis: TextAxis, name: str) -> float:
        return float(self._value(query, axis, name))

    def _value(self, query: Exchange, axis: TextAxis, name: str) -> Value:
        """Read a value until two readings agree."""
        return self._line.agreed(lambda: self._line.query(query, self._of(axis))[name], name)

    def _wanted(self, axis: TextAxis, setting: AxisSetting) -> Value:
        """Return a setting in the controller's units, rounded as it is sent."""
        limits, scale = axis.limits, abs(axis.counts_per_deg)
        ends = sorted(map(axis.to_position, (limits.lowest_deg, limits.highest_deg)))
        value: Value = {
            "speed": limits.speed_deg_s * scale * setting.factor,
            "acceleration": limits.acceleration_deg_s2 * scale * setting.factor,
            "lowest": ends[0] * setting.factor,
            "highest": ends[1] * setting.factor,
            "constant": setting.constant,
        }[setting.quantity]
        return setting.set.send.as_sent(self._of(axis, value=value), "value")

    def _differs(self, axis: TextAxis, setting: AxisSetting) -> Value | None:
        """Return the value that a setting reads, if it is not the wanted one."""
        wanted, got = self._wanted(axis, setting), self._value(setting.query, axis, "value")
        if isinstance(wanted, str):
            return got if got != wanted else None
        slack = abs(wanted) * setting.tolerance_percent / 100.0 + 1e-9
        try:
            return got if abs(float(got) - wanted) > slack else None
        except ValueError as error:
            raise self._line.garbled_reply(f"{got!r} came for the {setting.quantity}, no number.") from error

    def _set(self, axis: TextAxis, setting: AxisSetting) -> None:
        if self._differs(axis, setting) is None:
            return
        wanted = self._wanted(axis, setting)
        self._command(setting.set, axis, value=wanted)
        if (got := self._differs(axis, setting)) is not None:
            raise reads_otherwise(axis, f"the {setting.quantity}", shown(wanted), shown(got))

    def _changed_settings(self, *, with_positions: bool = True) -> bool:
        """Whether a setting that was written has another value now, as after a restart."""
        return any(
            self._differs(axis, setting) is not None
            for axis in self._axes.values()
            for setting in self._description.settings
            if with_positions or not setting.is_position
        )
