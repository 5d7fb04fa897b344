"""A home-built gimbal on a GRBL 1.1 board: its axes X, Y, Z are rotary, and the board's "mm" are degrees.

Boards with grblHAL and FluidNC are such boards, too. Moves are jogs, because a jog can be cancelled without losing the
position. GRBL does not report whether it has a reference, so only a homing by this driver counts; a restart or an alarm
undoes it.

Source of the settings: "Grbl v1.1 Configuration", https://github.com/gnea/grbl/tree/master/doc/markdown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.errors import DeviceRefused, MoveFailed, OutsideLimits, WrongDevice
from drivers.serial_port import LineSettings, Port
from drivers.stage import AxisIdentity, motion
from drivers.stage.grbl_controller import GrblController, SettingReadOnly
from drivers.stage.grbl_protocol import (
    BLOCKING_STATES,
    FLUIDNC,
    GRBL,
    READY_STATES,
    UNKNOWN,
    StatusReport,
)
from drivers.stage.motion import Axis
from drivers.stage.refusals import no_reference, not_as_stated, not_movable
from drivers.stage.watched import AxisState, OneLineStage, StopCheck
from drivers.wire_log import WireLog

_REPORT_MACHINE = 1  # Bit of the setting 10: positions of the machine, not of the work
# Numbers of GRBL's settings, as those below.
_SOFT_LIMITS, _HOMING, _HOMES_DOWN, _REPORT_MASK, _INCHES = 20, 22, 23, 10, 13
_HOMING_PASSES = range(44, 50)
"""Settings of grblHAL, each with the axes that one pass of homing searches, as bits."""
_LOCATE, _SEEK, _PULL_OFF = 24, 25, 27  # Settings: speeds of the slow and the fast search, way back
_SEARCHED_TRAVELS = 1.5
"""How far the firmware searches a switch, in travels; the descendants search no farther."""
_LOCATED_PULL_OFFS = 20.0
"""How far it goes at most while it locates the switch, in ways of pulling off."""
_STEPS, _RATE, _ACCELERATION, _TRAVEL = 100, 110, 120, 130
"""Numbers of settings; those of the last line belong to the first axis, and the other axes follow."""
_PRINTED = 0.0011
"""GRBL prints its settings to three places."""
_SAME_DEG = 1e-6
"""Two angles that differ by less are one angle; in degrees."""


@dataclass(frozen=True, kw_only=True)
class GrblAxis(Axis):
    """One axis as the station file describes it.

    ``zero_deg`` is the angle of machine position 0. GRBL counts downwards from there: both limits lie below.
    """

    letter: str  # The board's name of the axis: X, Y, Z (A, B, C where the firmware has them)
    # Steps per degree. The board's ``$100`` ... must have this value; it is checked, never changed.
    steps_per_deg: float

    @property
    def scale(self) -> float:
        """Steps per degree."""
        return self.steps_per_deg


class GrblStage(OneLineStage[GrblAxis, GrblController]):
    """A stage of one to three axes on a GRBL board. Implements ``drivers.stage.Stage``.

    ``serial`` is the name that was given to the board with ``$I=...``; empty when it is not checked. ``settings`` are
    values that the board must have, such as ``$3``. These, scale or travel that do not fit raise `OutsideLimits`.
    """

    SETTINGS = LineSettings(115200)  # of the firmware as it is delivered

    def __init__(
        self,
        port: Port,
        axes: Sequence[GrblAxis],
        *,
        serial: str = "",
        settings: Mapping[str, float] | None = None,
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> None:
        self._serial = serial
        self._stated = dict(settings or {})
        self._homing = False
        super().__init__(port, axes, clock=clock, wire_log=wire_log)

    def _connected(self, port: Port, wire_log: WireLog | None) -> GrblController:
        return GrblController(port, clock=self._clock, wire_log=wire_log)

    def _set_up(self) -> None:
        self._bring_to_rest()  # a moving board refuses $I
        self._refuse_modes()
        self.identify()
        self._require_letters()
        self._program()
        report = self._line.query_status()
        for axis in self._axes.values():
            self._angle_deg(axis, report)  # now it must be stated

    def _bring_to_rest(self) -> None:
        """Stop a board that is moving; until it is programmed, its reports may be of work positions."""
        if self._line.query_status().moving:
            self.stop()

    def _refuse_modes(self) -> None:
        """Refuse a board that is held, asleep or in check mode though it was reset."""
        report = self._line.query_status()
        if report.state not in {*READY_STATES, "Alarm"}:
            raise DeviceRefused(
                f"the board is not ready: {self._describe(report)}. A reset did not change that.",
                where=self._where,
                remedy="Clear the cause at the board.",
            )

    def _require_letters(self) -> None:
        """Refuse a board without an axis of the station file, or that does not tell which setting is whose."""
        if not self._line.letters:
            raise DeviceRefused(
                "the board names fewer letters than it has axes ([AXS:...]), so the order of its settings is unknown.",
                where=self._where,
                remedy="Build its firmware without REPORT_VALUE_FOR_AXIS_NAME_ONCE.",
            )
        for axis in self._axes.values():
            if axis.letter not in self._line.letters:
                raise DeviceRefused(
                    f"the board has no axis {axis.letter}; its axes are {', '.join(self._line.letters)}.",
                    where=axis.name,
                    remedy="Correct the letter in the station file.",
                )

    def _place(self, axis: GrblAxis) -> int:
        """Return the place of an axis in the board's settings, from 0."""
        return self._line.letters.index(axis.letter)

    def identify(self) -> Sequence[AxisIdentity]:
        """See `Stage.identify`. The board's name counts as its serial number, which the station file states."""
        version, name = self._line.query_build_info()
        if self._serial and name.upper() != self._serial.upper():  # the board capitalises every line
            raise WrongDevice(
                f"the station file names {self._serial}, but a board named '{name}' answers. Nothing was moved.",
                where=self._where,
                remedy=f"Check the port, or give this board its name with '$I={self._serial}'.",
            )
        model = "GRBL 1.1" if self._line.firmware in (GRBL, UNKNOWN) else self._line.firmware.name
        return tuple(AxisIdentity(axis, "GRBL", model, name, version) for axis in self._axes)

    def _has_reference(self) -> bool:
        """Whether this driver has homed the board, which has neither restarted nor raised an alarm since then."""
        self._line.query_status()
        return self._was_homed()

    def _lifetime(self) -> tuple[int, int]:
        """Return the number of restarts and of alarms so far; each of them undoes a reference."""
        return self._line.restarts, len(self._line.alarms)

    def faults(self) -> Sequence[str]:
        """See `Stage.faults`. Names a state that blocks moves, and a missing reference."""
        try:
            self._line.query_status()
        except MoveFailed as error:  # the board waits for a reset, which homing sends
            return [f"board: {error.what}", "board: no reference"]
        report = self._line.query_status()
        controller_faults = [] if report.state in READY_STATES else [f"board: {self._describe(report)}"]
        return controller_faults if self._was_homed() else [*controller_faults, f"board: {self._lost()}"]

    def _lost(self) -> str:
        """Return why the board has no reference; call it only then."""
        if self._homed_in is not None and self._homed_in[0] != self._line.restarts:
            return "no reference, because it restarted after it was homed"
        return "no reference"

    def home(self) -> None:
        """See `Stage.home`.

        A board that has stopped at a limit switch is reset first: its motion has ended, and its reference is lost.
        """
        if self._line.needs_reset:
            self._line.wake()
        super().home()

    def stop(self) -> None:
        """See `Stage.stop`. A board that has stopped at a limit switch has stopped already."""
        try:
            super().stop()
        except MoveFailed:
            if not self._line.needs_reset:
                raise

    # ------------------------------------------------------------ on the wire

    def _check_ready(self, axis: GrblAxis) -> None:
        report = self._line.query_status()
        if not self._was_homed():
            raise no_reference(axis, f"the board has {self._lost()}")
        if report.state not in READY_STATES:
            raise not_movable(axis, self._describe(report))

    def _clear_faults(self, axis: GrblAxis) -> None:
        """Check that homing can begin: homing clears an alarm by itself, and no other blocking state."""
        report = self._line.query_status()
        if report.state not in {"Idle", "Alarm"}:
            raise not_movable(axis, self._describe(report))

    def _start(self, goals_deg: Mapping[str, float], check_not_stopped: StopCheck) -> None:
        jog = self._jog(goals_deg)
        with self._line.lock:
            check_not_stopped()
            self._line.command(jog)

    def _reachable_deg(self, axis: GrblAxis, angle_deg: float) -> float:
        """Return the angle of a whole step that is nearest, within the travel that the board prints."""
        reachable_deg = super()._reachable_deg(axis, angle_deg)
        if reachable_deg >= self._lowest_deg[axis.name] - _SAME_DEG:
            return reachable_deg
        return reachable_deg + 1.0 / axis.steps_per_deg

    def _begin_move(self, axis: GrblAxis, angle_deg: float) -> None:
        self._line.command(self._jog({axis.name: angle_deg}))

    def _jog(self, goals_deg: Mapping[str, float]) -> str:
        """Return the command that jogs axes together on a straight line, the slowest axis at its speed."""
        report = self._line.query_status()
        words, distances_deg, times_s = [], [], []
        for name, goal_deg in goals_deg.items():
            axis = self._axes[name]
            distance_deg = goal_deg - self._angle_deg(axis, report)
            distances_deg.append(distance_deg)
            times_s.append(abs(distance_deg) / axis.limits.speed_deg_s)
            words.append(f"{axis.letter}{_number(goal_deg - axis.zero_deg)}")
        feed_deg_min = 60.0 * math.hypot(*distances_deg) / max(times_s) if max(times_s) > 0 else 60.0
        return f"$J=G90G21G53{''.join(words)}F{feed_deg_min:.1f}"

    def _start_homing(self, check_not_stopped: StopCheck) -> None:
        self._homing = False
        allowed_s = self._longest_homing_s()
        super()._start_homing(check_not_stopped)
        self._line.wait_for_homing(allowed_s)
        self._homing = False

    def _longest_homing_s(self) -> float:
        """Return the longest time of a homing, s: a pass an axis, at the board's speeds in degrees a minute."""
        settings = self._line.query_settings()
        seek, locate = settings.get(_SEEK, 0.0), settings.get(_LOCATE, 0.0)
        if seek <= 0 or locate <= 0:
            return motion.LONGEST_HOMING_S
        searched = sum(settings.get(_TRAVEL + place, 0.0) for place in map(self._place, self._axes.values()))
        located = _LOCATED_PULL_OFFS * settings.get(_PULL_OFF, 0.0) * len(self._axes)
        return motion.LONGEST_HOMING_S + 60.0 * (_SEARCHED_TRAVELS * searched / seek + located / locate)

    def _begin_homing(self, axis: GrblAxis) -> None:  # noqa: ARG002 - one search finds all references
        if not self._homing:
            self._homing = True
            self._line.start_homing()

    def _finish_homing(self, axis: GrblAxis) -> None:
        """Refuse a position at the reference with which the moves to come would leave the travel."""
        position_deg = self._angle_deg(axis, self._line.query_status())
        if not self._lowest_deg[axis.name] - _PRINTED <= position_deg <= axis.zero_deg + _PRINTED:
            raise OutsideLimits(
                f"homing sets the machine position {position_deg - axis.zero_deg:.3f}, which must lie between"
                f" {self._lowest_deg[axis.name] - axis.zero_deg:.3f} (the end of the travel) and 0.",
                where=axis.name,
                remedy="Let homing set the position 0 at the switch (mpos_mm: 0 in the configuration file of FluidNC).",
            )

    def _read_state(self, axis: GrblAxis, *, homing: bool = False) -> AxisState:
        """Read state and position from one report."""
        report = self._line.query_status()
        problem = self._problem(report, homing=homing)
        position_kept = report.state in {"Hold", "Door", "Run"} and self._was_homed()
        return AxisState(self._angle_deg(axis, report), report.moving, problem, position_kept)

    def _send_stop(self) -> None:
        """Cancel the jog. A homing, or the program of another sender, ends only by a reset."""
        self._line.cancel_jog()
        if self._homing or self._line.query_status().state in {"Run", "Home"}:
            self._homing = False
            self._line.reset()

    def _angle_deg(self, axis: GrblAxis, report: StatusReport) -> float:
        return axis.zero_deg + report.position(self._place(axis), self._where)

    def _problem(self, report: StatusReport, *, homing: bool) -> str:
        """Return why a move in this state will not end at its target; empty when it may."""
        homed_in = None if homing else self._homed_in
        if homed_in is not None and homed_in[0] != self._line.restarts:
            return "the board restarted during the move: its position is lost"
        if report.state not in READY_STATES:
            return self._describe(report)
        if homed_in is not None and not self._was_homed():
            alarm = self._line.firmware.alarm(self._line.alarms[-1])
            return f"the board raised an alarm during the move, and its position is lost: {alarm}"
        return ""

    def _describe(self, report: StatusReport) -> str:
        """Return the meaning of a state that is not ready; an alarm with its number."""
        words = f"{BLOCKING_STATES.get(report.state, 'in a state that is unknown here')} ({report.state})"
        alarm = report.substate or (self._line.alarms[-1] if self._line.alarms else None)
        if report.state == "Alarm" and alarm is not None:
            words += f": {self._line.firmware.alarm(alarm)}"
        return words

    # ------------------------------------------------------------ settings

    def _program(self) -> None:
        """Check scale and homing; set limits, speed and acceleration where they differ, and read them back."""
        present = self._line.query_settings()
        wanted = self._wanted_settings(present)
        read_only = set()
        for number, value in sorted(wanted.items()):
            if _same(present.get(number), value):
                continue
            try:
                self._line.query(f"${number}={value:.3f}" if number >= _STEPS else f"${number}={value:.0f}")
            except SettingReadOnly:
                read_only.add(number)
        got = self._line.query_settings()
        wrong = [
            f"${number}: asked {value:.3f}, got {got.get(number)}"
            for number, value in wanted.items()
            if not _same(got.get(number), value)
            and not (number in read_only and _is_wider(number, got.get(number, math.nan), value))
        ]
        if wrong:
            raise DeviceRefused(
                f"settings read back differently from what was set ({'; '.join(wrong)}).",
                where=self._where,
                remedy="Change the station file to what the board supports, or the configuration file on the board.",
            )
        self._lowest_deg = {
            axis.name: axis.zero_deg - got[_TRAVEL + self._place(axis)] for axis in self._axes.values()
        }

    def _wanted_settings(self, present: Mapping[int, float]) -> dict[int, float]:
        """Check the present settings against the station file; return those that the board must have, by number."""
        wanted: dict[int, float] = {
            _SOFT_LIMITS: 1,
            _REPORT_MASK: int(present.get(_REPORT_MASK, 0)) | _REPORT_MACHINE,
        }
        self._check_homing(present)
        for name, stated in self._stated.items():
            value = self._line.query_configured(name) if "/" in name else present.get(int(name[1:]))
            if not _same(value, stated):
                raise not_as_stated(self._where, name, stated, value, f"{name}={stated:g}")
        if present.get(_INCHES):
            wanted[_INCHES] = 0
        for axis in self._axes.values():
            self._check(axis, present)
            place = self._place(axis)
            wanted[_RATE + place] = 60.0 * axis.limits.speed_deg_s
            wanted[_ACCELERATION + place] = axis.limits.acceleration_deg_s2
            wanted[_TRAVEL + place] = axis.zero_deg - axis.limits.lowest_deg
        return wanted

    def _check_homing(self, present: Mapping[int, float]) -> None:
        """Refuse a board that does not search every reference, or that moves an axis afterwards."""
        homing = present.get(_HOMING)
        if homing is None:
            raise DeviceRefused(
                f"the board ({self._line.firmware.name}) does not tell its settings: its answer to $$ has no $22.",
                where=self._where,
                remedy="Update its firmware; FluidNC tells them since version 3.8.",
            )
        if not int(homing) & 1:  # the other bits of grblHAL say how it homes
            raise DeviceRefused(
                f"homing is switched off ($22={homing:g}); without homing, no position is known.",
                where=self._where,
                remedy="Fit limit switches and set $22=1.",
            )
        if moving := self._line.query_moving_start_up_line():
            raise DeviceRefused(
                f"the board stores the start-up line '{moving}', which moves axes whenever it was homed.",
                where=self._where,
                remedy="Delete the line with $N0= and $N1=.",
            )
        if self._line.firmware is FLUIDNC:
            self._check_configured_homing()

    def _check_configured_homing(self) -> None:
        """Refuse an axis that FluidNC's configuration file leaves out of homing, or lets home downwards.

        ``$22`` is 1 there as soon as one axis is homed, and versions before 3.9.8 do not tell ``$23``.
        """
        paths = {name: f"$/axes/{axis.letter.lower()}/homing" for name, axis in self._axes.items()}
        cycles = {name: self._line.query_configured(f"{path}/cycle") for name, path in paths.items()}
        for name, path in paths.items():
            cycle = cycles[name]
            if any(value is not None for value in cycles.values()) and (cycle is None or cycle < 1):
                raise DeviceRefused(
                    f"homing does not search the reference of the axis ({path}/cycle is"
                    f" {'missing' if cycle is None else f'{cycle:g}'}).",
                    where=name,
                    remedy="Give the axis a homing cycle of 1 or more in the board's configuration file.",
                )
            if self._line.query_configured(f"{path}/positive_direction") == 0.0:
                raise OutsideLimits(
                    f"the axis homes downwards ({path}/positive_direction is false), and all angles of an axis must"
                    " lie below its switch.",
                    where=name,
                    remedy="Set positive_direction: true and reverse the axis, so that its switch lies at the upper"
                    " end of its travel; then correct zero_deg and the limits.",
                )

    def _check(self, axis: GrblAxis, present: Mapping[int, float]) -> None:
        """Raise OutsideLimits unless scale, homing direction and travel of an axis fit the station file."""
        place = self._place(axis)
        steps, travel = present.get(_STEPS + place, 0.0), present.get(_TRAVEL + place, 0.0)
        remedy = f"Correct the value that is wrong; the board's value (${_STEPS + place}) is set by hand."
        motion.check_scale(axis, axis.steps_per_deg, steps, "steps a degree", remedy, slack=_PRINTED)
        if (homes_down := int(present.get(_HOMES_DOWN, 0.0))) >> place & 1:
            # Homing then sets the position to the end of the travel, which this driver sets: all angles would shift.
            raise OutsideLimits(
                f"the axis homes downwards ($23={homes_down}): its zero would shift with its travel"
                f" ${_TRAVEL + place}.",
                where=axis.name,
                remedy=f"Set $23={homes_down & ~(1 << place)} and reverse the axis with $3, so that its switch"
                " lies at the upper end of its travel; then correct zero_deg and the limits.",
            )
        passes = [int(present[number]) for number in _HOMING_PASSES if number in present]
        if passes and not any(searched >> place & 1 for searched in passes):
            raise DeviceRefused(
                "homing does not search the reference of the axis (its bit is missing in $44 to $49).",
                where=axis.name,
                remedy=f"Add the bit of {axis.letter}, {1 << place}, to one of these settings.",
            )
        wanted = axis.limits.lowest_deg, axis.limits.highest_deg
        motion.check_travel(axis.name, wanted, (axis.zero_deg - travel, axis.zero_deg), "deg", slack=_PRINTED)


def _number(value: float) -> str:
    """Return a position with four decimals, or with three as the board prints its travel: both are then one number.

    >>> _number(-27.0), _number(-26.9995)
    ('-27.000', '-26.9995')
    """
    return f"{value:.4f}".removesuffix("0")


def _is_wider(number: int, got: float, wanted: float) -> bool:
    """Return whether a setting that cannot be written does no harm: this driver checks limits, and states each feed."""
    return number == _SOFT_LIMITS or (number // 10 in {_RATE // 10, _TRAVEL // 10} and got >= wanted)


def _same(got: float | None, wanted: float) -> bool:
    return got is not None and abs(got - wanted) <= _PRINTED
