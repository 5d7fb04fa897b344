"""A home-built gimbal on a GRBL 1.1 board: its axes X, Y, Z are rotary, and the board's "mm" are degrees.

Moves are jogs, because a jog can be cancelled without losing the position. GRBL does not report whether it has a
reference, so only a homing by this driver counts; a restart or an alarm undoes it.

Source of the settings: "Grbl v1.1 Configuration", https://github.com/gnea/grbl/tree/master/doc/markdown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.errors import DeviceRefused, MoveFailed, OutsideLimits, WrongDevice
from drivers.serial_port import Port
from drivers.stage import AxisIdentity, motion
from drivers.stage.grbl_controller import ALARMS, BLOCKING_STATES, GrblController, StatusReport
from drivers.stage.motion import Axis
from drivers.stage.watched import AxisState, OneLineStage, StopCheck, no_reference, not_movable
from drivers.wire_log import WireLog

_LETTERS = "XYZABC"
_REPORT_MACHINE = 1
_SOFT_LIMITS, _HOMING, _HOMES_DOWN, _REPORT_MASK, _INCHES = 20, 22, 23, 10, 13
_STEPS, _RATE, _ACCELERATION, _TRAVEL = 100, 110, 120, 130
"""Numbers of settings; those of the last line belong to the first axis, and the other axes follow."""
_PRINTED = 0.0011
"""GRBL prints its settings to three places."""


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

    ``serial`` is the name that was given to the board with ``$I=...``; empty when it is not checked. Scale or travel
    that do not fit the board's raise `OutsideLimits`.
    """

    BAUDRATE = 115200

    def __init__(
        self,
        port: Port,
        axes: Sequence[GrblAxis],
        *,
        serial: str = "",
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> None:
        self._serial = serial
        self._places = {axis.name: _LETTERS.index(axis.letter) for axis in axes}
        self._homing = False
        super().__init__(port, axes, clock=clock, wire_log=wire_log)

    def _connected(self, port: Port, wire_log: WireLog | None) -> GrblController:
        return GrblController(port, clock=self._clock, wire_log=wire_log)

    def _set_up(self) -> None:
        self._bring_to_rest()  # a moving board refuses $I
        self.identify()
        self._program()

    def identify(self) -> Sequence[AxisIdentity]:
        """See `Stage.identify`. The board's name counts as its serial number, which the station file states."""
        version, name = self._line.query_build_info()
        if self._serial and name.upper() != self._serial.upper():  # the board capitalises every line
            raise WrongDevice(
                f"the station file names {self._serial}, but a board named '{name}' answers. Nothing was moved.",
                where=self._where,
                remedy=f"Check the port, or give this board its name with '$I={self._serial}'.",
            )
        return tuple(AxisIdentity(axis, "GRBL", "GRBL 1.1", name, version) for axis in self._axes)

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
        state = self._line.query_status().state
        found = [f"board: {self._describe(state)}"] if state in BLOCKING_STATES else []
        return found if self._was_homed() else [*found, "board: no reference"]

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
        state = self._line.query_status().state
        if not self._was_homed():
            raise no_reference(axis, "the board has no reference")
        if state in BLOCKING_STATES:
            raise not_movable(axis, self._describe(state))

    def _clear_faults(self, axis: GrblAxis) -> None:
        """Check that homing can begin: homing clears an alarm by itself, and no other blocking state."""
        state = self._line.query_status().state
        if state not in {"Idle", "Alarm"}:
            raise not_movable(axis, self._describe(state))

    def _start(self, goals_deg: Mapping[str, float], check_not_stopped: StopCheck) -> None:
        jog = self._jog(goals_deg)
        with self._line.lock:
            check_not_stopped()
            self._line.command(jog)

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
            words.append(f"{axis.letter}{goal_deg - axis.zero_deg:.4f}")
        feed_deg_min = 60.0 * math.hypot(*distances_deg) / max(times_s) if max(times_s) > 0 else 60.0
        return f"$J=G21G53{''.join(words)}F{feed_deg_min:.1f}"

    def _start_homing(self, check_not_stopped: StopCheck) -> None:
        self._homing = False
        super()._start_homing(check_not_stopped)
        self._line.wait_for_homing()
        self._homing = False

    def _begin_homing(self, axis: GrblAxis) -> None:  # noqa: ARG002 - one search finds all references
        if not self._homing:
            self._homing = True
            self._line.start_homing()

    def _read_state(self, axis: GrblAxis, *, homing: bool = False) -> AxisState:
        """Read state and position from one report."""
        report = self._line.query_status()
        problem = self._problem(report.state, homing=homing)
        position_kept = report.state in {"Hold", "Door", "Run"} and self._was_homed()
        return AxisState(self._angle_deg(axis, report), report.moving, problem, position_kept)

    def _send_stop(self) -> None:
        """Cancel the jog. A homing, or the program of another sender, ends only by a reset."""
        self._line.cancel_jog()
        if self._homing or self._line.query_status().state in {"Run", "Home"}:
            self._homing = False
            self._line.reset()

    def _angle_deg(self, axis: GrblAxis, report: StatusReport) -> float:
        return axis.zero_deg + report.position(self._places[axis.name], self._where)

    def _problem(self, state: str, *, homing: bool) -> str:
        """Return why a move in this state will not end at its target; empty when it may."""
        homed_in = None if homing else self._homed_in
        if homed_in is not None and homed_in[0] != self._line.restarts:
            return "the board restarted during the move: its position is lost"
        if state in BLOCKING_STATES:
            return self._describe(state)
        if homed_in is not None and not self._was_homed():
            return f"the board raised ALARM:{self._line.alarms[-1]} during the move: its position is lost"
        return ""

    def _describe(self, state: str) -> str:
        words = f"{BLOCKING_STATES[state]} ({state})"
        if state == "Alarm" and self._line.alarms:
            code = self._line.alarms[-1]
            words += f": {ALARMS.get(code, 'unknown alarm')} (ALARM:{code})"
        return words

    # ------------------------------------------------------------ settings

    def _program(self) -> None:
        """Check the scale; set limits, speed and acceleration where they differ, and read them back."""
        present = self._line.query_settings()
        wanted = self._wanted_settings(present)
        for number, value in sorted(wanted.items()):
            if not _same(present.get(number), value):
                self._line.query(f"${number}={value:.3f}" if number >= _STEPS else f"${number}={value:.0f}")
        got = self._line.query_settings()
        wrong = [
            f"${n}: asked {v:.3f}, got {got.get(n)}" for n, v in wanted.items() if not _same(got.get(n), v)
        ]
        if wrong:
            raise DeviceRefused(
                f"settings read back differently from what was set ({'; '.join(wrong)}).",
                where=self._where,
                remedy="Change the station file to what the board supports.",
            )

    def _wanted_settings(self, present: Mapping[int, float]) -> dict[int, float]:
        """Check the present settings against the station file; return those that the board must have, by number."""
        wanted: dict[int, float] = {
            _SOFT_LIMITS: 1,
            _REPORT_MASK: int(present.get(_REPORT_MASK, 0)) | _REPORT_MACHINE,
        }
        if not present.get(_HOMING):
            raise DeviceRefused(
                "homing is switched off ($22=0); without homing, no position is known.",
                where=self._where,
                remedy="Fit limit switches and set $22=1.",
            )
        if present.get(_INCHES):
            wanted[_INCHES] = 0
        for axis in self._axes.values():
            self._check(axis, present)
            place = self._places[axis.name]
            wanted[_RATE + place] = 60.0 * axis.limits.speed_deg_s
            wanted[_ACCELERATION + place] = axis.limits.acceleration_deg_s2
            wanted[_TRAVEL + place] = axis.zero_deg - axis.limits.lowest_deg
        return wanted

    def _check(self, axis: GrblAxis, present: Mapping[int, float]) -> None:
        """Raise OutsideLimits unless scale, homing direction and travel of an axis fit the station file."""
        place = self._places[axis.name]
        steps, travel = present.get(_STEPS + place, 0.0), present.get(_TRAVEL + place, 0.0)
        if not _same(steps, axis.steps_per_deg):
            raise OutsideLimits(
                f"the scale in the station file is {axis.steps_per_deg:g} steps a degree, the board's"
                f" ${_STEPS + place} is {steps:g}.",
                where=axis.name,
                remedy="Correct the value that is wrong; the board's value is set by hand.",
            )
        if (homes_down := int(present.get(_HOMES_DOWN, 0.0))) >> place & 1:
            # Homing then sets the position to the end of the travel, which this driver sets: all angles would shift.
            raise OutsideLimits(
                f"the axis homes downwards ($23={homes_down}): its zero would shift with its travel"
                f" ${_TRAVEL + place}.",
                where=axis.name,
                remedy=f"Set $23={homes_down & ~(1 << place)} and reverse the axis with $3, so that its switch"
                " lies at the upper end of its travel; then correct zero_deg and the limits.",
            )
        wanted = axis.limits.lowest_deg, axis.limits.highest_deg
        motion.check_travel(axis.name, wanted, (axis.zero_deg - travel, axis.zero_deg), "deg", slack=_PRINTED)


def _same(got: float | None, wanted: float) -> bool:
    return got is not None and abs(got - wanted) <= _PRINTED
