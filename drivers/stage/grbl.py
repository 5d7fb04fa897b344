"""A home-built gimbal on a GRBL 1.1 board: its axes X, Y, Z turn instead of travelling, "mm" are degrees.

Moves are jogs, because a jog can be cancelled without losing the position. GRBL does not tell whether it has
a reference: only a homing by this driver counts, and a restart or an alarm undoes it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.errors import DeviceRefused, MoveFailed, NotHomed, OutsideLimits, WrongDevice
from drivers.serial_port import Port, SerialPort
from drivers.stage import AxisIdentity, AxisLimits, grbl_protocol, motion
from drivers.stage.grbl_controller import GrblController, machine_of
from drivers.stage.grbl_protocol import Report
from drivers.stage.watched import GoOn, Look, WatchedStage
from drivers.wire_log import WireLog

_LETTERS = "XYZABC"
_REPORT_MACHINE = 1
_SOFT_LIMITS, _HOMING, _HOMES_DOWN, _REPORT_MASK, _INCHES = 20, 22, 23, 10, 13
_STEPS, _RATE, _ACCELERATION, _TRAVEL = 100, 110, 120, 130
"""Setting numbers; of the last four, of the first axis."""
_PRINTED = 0.0011
"""GRBL prints its settings to three places."""


@dataclass(frozen=True, kw_only=True)
class GrblAxis:
    """One axis as the station file describes it.

    Attributes
    ----------
    name
        "pan", "tilt" or "roll".
    letter
        The board's name of the axis: X, Y, Z (A, B, C where the firmware has them).
    steps_per_deg
        What the board's ``$100`` ... must say; it is checked, never changed.
    zero_deg
        Angle of machine position 0. GRBL counts downwards from there: all limits lie below.
    limits
        Soft limits, speed and acceleration.
    tolerance_deg
        How far from its target the counter may rest.
    encoder_tolerance_deg
        Not used: GRBL knows no encoder.
    """

    name: str
    letter: str
    steps_per_deg: float
    limits: AxisLimits
    zero_deg: float
    tolerance_deg: float = 0.002
    encoder_tolerance_deg: float = math.inf


class GrblStage(WatchedStage[GrblAxis]):
    """A stage of one to three axes on a GRBL board. Implements ``drivers.stage.Stage``.

    Open it with ``GrblStage.open``; the constructor takes a port that is open already.

    Parameters
    ----------
    port
        The open port.
    axes
        The axes, in the station file's order.
    serial
        The name that was given to the board with ``$I=...``; empty when it need not be checked.
    clock
        Every wait between two requests goes through it.
    wire_log
        Told every byte.

    Raises
    ------
    WrongDevice
        Another name answers; nothing was set.
    OutsideLimits
        Scale or travel of the station file are not the board's.
    DeviceRefused, ReplyError, PortLost
    """

    def __init__(
        self,
        port: Port,
        axes: Sequence[GrblAxis],
        *,
        serial: str = "",
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> None:
        super().__init__(axes, clock=clock, where=port.name)
        self._serial = serial
        self._places = {axis.name: _LETTERS.index(axis.letter) for axis in axes}
        self._homed_at: tuple[int, int] | None = None
        self._homing = False
        try:
            self._board = GrblController(port, clock=clock, wire_log=wire_log)
            self._bring_to_rest()  # in motion, a board does not tell who it is
            self.identify()
            self._program()
        except BaseException:
            port.close()
            raise

    @classmethod
    def open(
        cls,
        port: str,
        axes: Sequence[GrblAxis],
        *,
        serial: str = "",
        baudrate: int = 115200,
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> GrblStage:
        """Open the port, check who answers, and program limits, speed and acceleration. Moves nothing.

        Raises PortNotFound, PortBusy, PortDenied, and what the constructor raises.
        """
        opened = SerialPort(port, baudrate=baudrate)
        return cls(opened, axes, serial=serial, clock=clock, wire_log=wire_log)

    def identify(self) -> Sequence[AxisIdentity]:
        """Ask the board who it is. Raises WrongDevice when its name is not the station file's."""
        version, name = self._board.build()
        if self._serial and name.upper() != self._serial.upper():  # the board capitalises what it is sent
            raise WrongDevice(
                f"the station file says {self._serial}, but a board named '{name}' answers. Nothing was moved.",
                where=self._where,
                remedy=f"Check the port; or name this board with '$I={self._serial}'.",
            )
        return tuple(AxisIdentity(axis, "GRBL", "GRBL 1.1", name, version) for axis in self._axes)

    def _has_reference(self) -> bool:
        """Whether this driver has homed the board, and it neither restarted nor raised an alarm since."""
        self._board.report()
        return self._homed_at == self._history()

    def faults(self) -> Sequence[str]:
        """Present state in plain words where it is none to work in, and whether there is a reference."""
        state = self._board.report().state
        found = [f"board: {self._in_words(state)}"] if state in grbl_protocol.STATES else []
        return found if self._homed_at == self._history() else [*found, "board: no reference"]

    def close(self) -> None:
        """Give the port back; the stage stays where it is."""
        self._board.close()

    # ------------------------------------------------------------ on the wire

    def _assure_ready(self, axis: GrblAxis) -> None:
        state = self._board.report().state
        if self._homed_at != self._history():
            raise NotHomed(
                "the board has no reference. Nothing was moved.",
                where=axis.name,
                remedy="Home the stage first.",
            )
        if state in grbl_protocol.STATES:
            raise MoveFailed(
                f"{self._in_words(state)}. Nothing was moved.",
                where=axis.name,
                remedy="Clear its cause, then home.",
            )

    def _clear_faults(self, axis: GrblAxis) -> None:
        """See that homing can begin: it lifts an alarm by itself, but no open door."""
        state = self._board.report().state
        if state not in {"Idle", "Alarm"}:
            raise MoveFailed(
                f"{self._in_words(state)}. Nothing was moved.",
                where=axis.name,
                remedy="Clear its cause, then home.",
            )

    def _goal_deg(self, axis: GrblAxis, angle_deg: float) -> float:
        steps = round((angle_deg - axis.zero_deg) * axis.steps_per_deg)
        return axis.zero_deg + steps / axis.steps_per_deg

    def _start(self, goals_deg: Mapping[str, float], go_on: GoOn) -> None:
        """Jog all axes together on a straight way, the slowest axis at its speed."""
        report = self._board.report()
        words, ways, times_s = [], [], []
        for name, goal_deg in goals_deg.items():
            axis = self._axes[name]
            way_deg = goal_deg - self._angle_deg(axis, report)
            ways.append(way_deg)
            times_s.append(abs(way_deg) / axis.limits.speed_deg_s)
            words.append(f"{axis.letter}{goal_deg - axis.zero_deg:.4f}")
        feed = 60.0 * math.hypot(*ways) / max(times_s) if max(times_s) > 0 else 60.0
        with self._board.lock:
            go_on()
            self._board.tell(f"$J=G21G53{''.join(words)}F{feed:.1f}")

    def _start_homing(self, go_on: GoOn) -> None:
        self._homed_at = None
        with self._board.lock:
            go_on()
            self._homing = True
            self._board.begin_homing()
        self._board.await_homing()
        self._homing = False

    def _look(self, axis: GrblAxis, *, homing: bool = False) -> Look:
        """State and position: both of one report."""
        report = self._board.report()
        trouble = self._trouble(report.state, homing=homing)
        harmless = report.state in {"Hold", "Door", "Run"} and self._homed_at == self._history()
        return Look(self._angle_deg(axis, report), report.moving, trouble, harmless)

    def _look_at_rest(self, axis: GrblAxis, *, homing: bool) -> Look:
        return self._look(axis, homing=homing)

    def _finish_homing(self, axis: GrblAxis) -> None:  # noqa: ARG002 - one board, one reference
        self._homed_at = self._history()

    def _send_stop(self) -> None:
        """Cancel the jog; a homing, or another's program, only ends by a reset."""
        self._board.stop_jog()
        if self._homing or self._board.report().state in {"Run", "Home"}:
            self._homing = False
            self._board.reset()

    def _listen(self, seconds: float) -> None:
        self._board.listen(seconds)

    def _angle_deg(self, axis: GrblAxis, report: Report) -> float:
        return axis.zero_deg + machine_of(report, [self._places[axis.name]], self._where)[0]

    def _history(self) -> tuple[int, int]:
        """Restarts and alarms so far: what undoes a reference."""
        return self._board.restarts, len(self._board.alarms)

    def _trouble(self, state: str, *, homing: bool) -> str:
        homed_at = None if homing else self._homed_at
        if homed_at is not None and homed_at[0] != self._board.restarts:
            return "the board restarted in mid-move: its position is lost"
        if state in grbl_protocol.STATES:
            return self._in_words(state)
        if homed_at is not None and homed_at != self._history():
            return f"the board raised ALARM:{self._board.alarms[-1]} in mid-move: its position is lost"
        return ""

    def _in_words(self, state: str) -> str:
        words = f"{grbl_protocol.STATES[state]} ({state})"
        if state == "Alarm" and self._board.alarms:
            code = self._board.alarms[-1]
            words += f": {grbl_protocol.ALARMS.get(code, 'see its list')} (ALARM:{code})"
        return words

    # ------------------------------------------------------------ settings

    def _program(self) -> None:
        """Check the scale; set limits, speed and acceleration where they differ, and read them back."""
        present = self._board.settings()
        wanted: dict[int, float] = {
            _SOFT_LIMITS: 1,
            _REPORT_MASK: int(present.get(_REPORT_MASK, 0)) | _REPORT_MACHINE,
        }
        if not present.get(_HOMING):
            raise DeviceRefused(
                "homing is switched off ($22=0), and without it no position is known.",
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
        for number, value in sorted(wanted.items()):
            if not _same(present.get(number), value):
                self._board.ask(f"${number}={value:.3f}" if number >= _STEPS else f"${number}={value:.0f}")
        got = self._board.settings()
        wrong = [
            f"${n}: asked {v:.3f}, got {got.get(n)}" for n, v in wanted.items() if not _same(got.get(n), v)
        ]
        if wrong:
            raise DeviceRefused(
                f"settings read back otherwise than set ({'; '.join(wrong)}).",
                where=self._where,
                remedy="Change the station file to what the board can do.",
            )

    def _check(self, axis: GrblAxis, present: Mapping[int, float]) -> None:
        place = self._places[axis.name]
        steps, travel = present.get(_STEPS + place, 0.0), present.get(_TRAVEL + place, 0.0)
        if not _same(steps, axis.steps_per_deg):
            raise OutsideLimits(
                f"the station's scale is {axis.steps_per_deg:g} steps a degree, the board's"
                f" ${_STEPS + place} says {steps:g}.",
                where=axis.name,
                remedy="Correct the one that is wrong; the board's is set by hand.",
            )
        if (homes_down := int(present.get(_HOMES_DOWN, 0.0))) >> place & 1:
            # Homing then sets the position to the end of the travel, which is about to be set anew: all angles shift.
            raise OutsideLimits(
                f"the axis homes downwards ($23={homes_down}): its zero would move with its travel"
                f" ${_TRAVEL + place}.",
                where=axis.name,
                remedy=f"Set $23={homes_down & ~(1 << place)} and turn the axis round with $3, so that its switch"
                " lies at the top of its travel; then correct zero_deg and the limits.",
            )
        wanted = axis.limits.lowest_deg, axis.limits.highest_deg
        motion.check_travel(axis.name, wanted, (axis.zero_deg - travel, axis.zero_deg), "deg", slack=_PRINTED)


def _same(got: float | None, wanted: float) -> bool:
    return got is not None and abs(got - wanted) <= _PRINTED
