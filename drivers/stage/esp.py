"""Newport stages on an ESP300, ESP301 or ESP302 controller, in degrees.

This module implements the controller's commands (``1PA5``, ``1MD?``). The controller does not
report whether an axis has a reference, so only a homing by this driver counts; a restart, or a motor that was switched
off, undoes it. ``drivers.stage.watched`` watches the moves.

Source: Newport, "ESP300" and "ESP301 User's Manual", section 3 (remote mode).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from drivers.clock import Clock
from drivers.errors import DeviceRefused, OutsideLimits, ReplyTimeout
from drivers.serial_port import LineSettings, Port
from drivers.stage import AxisIdentity, motion
from drivers.stage.motion import Axis
from drivers.stage.refusals import no_reference, not_movable, reads_otherwise
from drivers.stage.watched import AxisState, OneLineStage
from drivers.text_line import PROMPT_S, TextLine
from drivers.wire_log import WireLog

_ERROR = re.compile(r"(\d{1,4}), ?(\d{1,12}), ?([ -~]+)")

AXIS_ERRORS = {
    0: "motor type not defined",
    1: "parameter out of range",
    2: "amplifier fault",
    3: "following error beyond its threshold",
    4: "positive limit switch reached",
    5: "negative limit switch reached",
    6: "positive software limit reached",
    7: "negative software limit reached",
    8: "motor or stage not connected",
    9: "feedback signal lost",
    10: "speed beyond its maximum",
    11: "acceleration beyond its maximum",
    13: "motor off",
    15: "jerk beyond its maximum",
    17: "critical settings are protected",
    18: "stage device error",
    19: "the stage's data are invalid",
    20: "homing aborted",
}
"""Meanings of the last two digits of an error of an axis; the digits before them are the number of the axis."""
_NO_SUCH_COMMAND = 6
"""Number of the error of a command that this controller does not know."""
_LEFT_BEHIND = {"TJ": 1.0, "SH": 0.0, "BA": 0.0, "CO": 0.0}
"""What another program may have left otherwise: the profile of moves (1: a trapezoid; from 4 on, an axis follows
another one), the position at the reference, the corrections of backlash and of the scale."""
_DECIMALS = range(4, 7)
"""Values of ``FP`` that print positions finely: with less, a move seems to stop short; 7 prints powers of ten."""
_DEGREES = 7
"""Value of ``SN`` for an axis that counts in degrees."""
_RESOLUTION = 1e-4
"""Largest difference of two equal settings, in degrees: the controller prints no more digits."""
_SAME_RESOLUTION = 1e-4
"""Largest relative difference of two equal resolutions: the controller prints few digits."""
_MOST_ERRORS = 20  # Twice the controller's queue


@dataclass(frozen=True)
class EspError:
    """One entry of the error buffer."""

    code: int  # Error number; 0 for an empty buffer
    time_cycles: int
    text: str  # The controller's own description

    def __str__(self) -> str:
        axis, number = divmod(self.code, 100)
        words = AXIS_ERRORS.get(number, self.text.lower()) if axis else self.text.lower()
        return f"{words} (error {self.code})"


def parse_error(text: str) -> EspError | None:
    """Parse the answer to ``TB?``; None for any other text.

    >>> str(parse_error("213, 5321, AXIS 2 MOTOR NOT ENABLED"))
    'motor off (error 213)'
    """
    match = _ERROR.fullmatch(text)
    return EspError(int(match[1]), int(match[2]), match[3]) if match else None


@dataclass(frozen=True, kw_only=True)
class EspAxis(Axis):
    """One axis as the station file describes it. Its serial is that of the stage, as in the answer to ``1ID?``."""

    number: int  # Number of the axis on the controller, 1 to 3
    # Parameter of ``OR``, the search of the reference: 1 by home switch and index, 2 by home switch, 3 and 4
    # by the positive and negative limit, 5 and 6 by those and index. Without it the controller would only
    # move to 0.
    home_mode: Literal[1, 2, 3, 4, 5, 6] = 1
    direction: Literal[1, -1] = 1  # -1 when the controller's degrees fall as the angle grows, else 1
    # Degrees of an encoder count, as the controller must report them; None if they are not compared.
    resolution_deg: float | None = None

    @property
    def scale(self) -> float:
        """The controller counts in degrees."""
        return self.direction

    def to_controller_deg(self, angle_deg: float) -> float:
        """Return the controller's position of an angle, in degrees, rounded to the digits that are sent."""
        return round((angle_deg - self.zero_deg) * self.direction, 5)


class EspStage(OneLineStage[EspAxis, TextLine]):
    """A stage of one to three axes on an ESP controller. Implements ``drivers.stage.Stage``.

    Limits beyond the controller's, and axes that do not count in degrees, raise `OutsideLimits`.
    """

    SETTINGS = LineSettings(19200, rtscts=True)  # the maker's controllers always use the two lines

    @staticmethod
    def line(port: Port, clock: Clock, wire_log: WireLog | None = None) -> TextLine:
        """Return the line to a controller at a port, which asks for its identity and sets nothing."""
        return TextLine(
            port,
            identity_query="VE?",
            is_identity=lambda text: text.upper().startswith("ESP"),
            request_end=b"\r",
            reply_s=PROMPT_S,
            clock=clock,
            wire_log=wire_log,
        )

    def _connected(self, port: Port, wire_log: WireLog | None) -> TextLine:
        return self.line(port, self._clock, wire_log)

    def _set_up(self) -> None:
        self._time_cycles = self._restarts = 0
        self._read_errors()
        self.identify()
        for axis in self._axes.values():
            self._print_all_digits(axis)
        self._bring_to_rest()
        for axis in self._axes.values():
            self._program(axis)

    def _identity_of(self, axis: EspAxis) -> AxisIdentity:
        text = self._line.query(f"{axis.number}ID?")
        model, _, serial = (part.strip() for part in text.partition(","))
        same = serial.removeprefix("SN") == axis.serial.removeprefix("SN")
        self._require_serial(
            axis,
            axis.serial if same else serial,
            f"axis {axis.number} answers '{text}'",
            remedy="Check the port, the axis numbers and the serials in the station file.",
        )
        return AxisIdentity(axis.name, "Newport", model, serial, self._line.identity_text)

    def _has_reference(self) -> bool:
        """Whether this driver has homed all axes, and since then no controller restarted and no motor went off."""
        self._read_errors()
        return self._was_homed() and all(map(self._motor_on, self._axes.values()))

    def _lifetime(self) -> int:
        return self._restarts

    def faults(self) -> Sequence[str]:
        """See `Stage.faults`. Returns the errors since the last call, and the motors that are off."""
        return [*map(str, self._read_errors()), *super().faults()]

    def _faults_of(self, axis: EspAxis) -> list[str]:
        return [] if self._motor_on(axis) else ["motor off"]

    # ------------------------------------------------------------ on the wire

    def _check_ready(self, axis: EspAxis) -> None:
        if not self._has_reference():
            raise no_reference(axis)

    def _clear_faults(self, axis: EspAxis) -> None:
        """Empty the error buffer, set everything again, and switch the motor on, which moves nothing."""
        self._read_errors()
        self._program(axis)
        if not self._motor_on(axis):
            self._command(axis, "MO")
        if not self._motor_on(axis):
            raise not_movable(
                axis, "the motor stays off", "Check that the motor power of the controller is enabled."
            )

    def _reachable_deg(self, axis: EspAxis, angle_deg: float) -> float:
        return axis.to_angle_deg(axis.to_controller_deg(angle_deg))

    def _begin_move(self, axis: EspAxis, angle_deg: float) -> None:
        self._command(axis, f"PA{axis.to_controller_deg(angle_deg):.5f}")

    def _begin_homing(self, axis: EspAxis) -> None:
        self._command(axis, f"OR{axis.home_mode}")

    def _homing_speed_deg_s(self, axis: EspAxis) -> float | None:
        return self._read_known(axis, "OH")

    def _read_state(self, axis: EspAxis, *, homing: bool = False) -> AxisState:  # noqa: ARG002 - the same problems in both
        """Ask whether the axis moves, then where it is: the position of an idle axis is then one at rest."""
        done = self._line.query_switch(f"{axis.number}MD?")
        position_deg = axis.to_angle_deg(self._line.query_number(f"{axis.number}TP", with_decimals=True))
        problem = "" if self._motor_on(axis) else "the motor went off, as after a fault or a restart"
        return AxisState(position_deg, not done, problem)

    def _read_final_state(self, axis: EspAxis, *, homing: bool) -> AxisState:
        """Ask for the errors of all axes too: the buffer returns each error only once."""
        state = self._read_state(axis, homing=homing)
        if errors := self._relevant_errors():
            return state._replace(problem=self._describe(errors, axis))
        if not homing and not self._was_homed():
            return state._replace(problem="the controller restarted during the move: its position is lost")
        return state

    def _send_stop(self) -> None:
        """Stop all axes, then each by its number, because a stop has no reply; then check that the line answers."""
        for number in ("", *(axis.number for axis in self._axes.values())):
            self._line.send_urgent(f"{number}ST")
        self._read_errors()

    def _motor_on(self, axis: EspAxis) -> bool:
        """Ask until two answers agree: the answer is a single digit without checksum."""
        query = f"{axis.number}MO?"
        return self._line.agreed(lambda: self._line.query_switch(query), query)

    def _command(self, axis: EspAxis, words: str) -> None:
        """Send a command, once, and ask for errors. Raises DeviceRefused."""
        command = f"{axis.number}{words}"
        self._line.send(command)
        if errors := self._relevant_errors():
            raise DeviceRefused(
                f"the controller refuses '{command}': {self._describe(errors, axis)}.",
                where=axis.name,
                remedy="Check limits, speed and acceleration in the station file.",
            )

    def _read_errors(self) -> list[EspError]:
        """Empty the error buffer; count a restart when the controller's time has gone back."""
        errors: list[EspError] = []
        while len(errors) < _MOST_ERRORS:
            text = self._line.query("TB?")
            error = parse_error(text)
            if error is None:
                raise self._line.garbled_reply(f"TB? answered {text!r}.")
            if not error.code:
                self._note_time(error.time_cycles)
                return errors
            errors.append(error)
        raise self._line.garbled_reply("the error buffer never ends.")

    def _relevant_errors(self) -> list[EspError]:
        """Empty the error buffer; return the errors of the controller and of the axes of this stage."""
        numbers = {0} | {axis.number for axis in self._axes.values()}
        return [error for error in self._read_errors() if error.code // 100 in numbers]

    def _describe(self, errors: Sequence[EspError], asked: EspAxis) -> str:
        """Return errors as text, with the name of the axis when it is not the one that was asked about."""
        names = {axis.number: axis.name for axis in self._axes.values() if axis is not asked}
        whose = [names.get(error.code // 100) for error in errors]
        return "; ".join(
            f"{name}: {error}" if name else str(error) for name, error in zip(whose, errors, strict=True)
        )

    def _note_time(self, time_cycles: int) -> None:
        if time_cycles < self._time_cycles:
            self._restarts += 1
        self._time_cycles = time_cycles

    # ------------------------------------------------------------ settings

    def _program(self, axis: EspAxis) -> None:
        """Check unit, scale and travel; set all that another program may have left otherwise; read it back."""
        if self._line.query_number(f"{axis.number}SN?") != _DEGREES:
            raise OutsideLimits(
                "the axis does not count in degrees.",
                where=axis.name,
                remedy=f"Set its unit with {axis.number}SN{_DEGREES}, then its limits and speeds in degrees.",
            )
        self._check_resolution(axis)
        self._print_all_digits(axis)
        limits = axis.limits
        ends = sorted(map(axis.to_controller_deg, (limits.lowest_deg, limits.highest_deg)))
        travel = self._line.query_number(f"{axis.number}SL?"), self._line.query_number(f"{axis.number}SR?")
        motion.check_travel(axis.name, (ends[0], ends[1]), travel, "deg", slack=_RESOLUTION)
        wanted = {
            "SL": ends[0],
            "SR": ends[1],
            "VA": limits.speed_deg_s,
            "AC": limits.acceleration_deg_s2,
            "AG": limits.acceleration_deg_s2,
        }
        for name, value in _LEFT_BEHIND.items():
            if self._read_known(axis, name) is not None:
                self._set(axis, name, value)
        for name, value in wanted.items():
            self._set(axis, name, value)

    def _print_all_digits(self, axis: EspAxis) -> None:
        """Let the controller print positions with as many decimals as the driver compares."""
        decimals = self._read_known(axis, "FP")
        if decimals is None or decimals in _DECIMALS:
            return
        self._command(axis, f"FP{_DECIMALS[0]}")
        if (got := self._line.query_number(f"{axis.number}FP?")) not in _DECIMALS:
            raise reads_otherwise(axis, "FP", f"{_DECIMALS[0]}", f"{got:g}")

    def _check_resolution(self, axis: EspAxis) -> None:
        """Compare the degrees of an encoder count with the station's, if that states them."""
        if axis.resolution_deg is None:
            return
        stated_deg = self._line.query_number(f"{axis.number}SU?")
        remedy = f"Set it with {axis.number}SU, or correct resolution_deg in the station file."
        slack = _SAME_RESOLUTION * axis.resolution_deg
        motion.check_scale(axis, axis.resolution_deg, stated_deg, "deg a count", remedy, slack=slack)

    def _read_known(self, axis: EspAxis, name: str) -> float | None:
        """Read a setting; None if this controller has no such command, which it does not answer."""
        try:
            return self._line.query_number(f"{axis.number}{name}?")
        except ReplyTimeout:
            if any(error.code == _NO_SUCH_COMMAND for error in self._read_errors()):
                return None
            raise

    def _set(self, axis: EspAxis, name: str, value: float) -> None:
        """Set a setting where it differs, and read it back. Raises DeviceRefused."""
        if abs(self._line.query_number(f"{axis.number}{name}?") - value) > _RESOLUTION:
            self._command(axis, f"{name}{value:.5f}")
        got = self._line.query_number(f"{axis.number}{name}?")
        if abs(got - value) > _RESOLUTION:
            raise reads_otherwise(axis, name, f"{value:g}", f"{got:g}")
