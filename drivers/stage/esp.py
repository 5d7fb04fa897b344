"""Newport stages on an ESP300, ESP301 or ESP302 controller, in degrees.

Knows its words (``1PA5``, ``1MD?``), its error buffer, and that it does not tell whether it has a reference:
only a homing by this driver counts, and a motor that was switched off or a restart undoes it. How a move is
watched is in ``drivers.stage.watched``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from drivers.clock import Clock
from drivers.errors import DeviceRefused, MoveFailed, NotHomed, OutsideLimits, WrongDevice
from drivers.readings import agreeing
from drivers.serial_port import Port, SerialPort
from drivers.stage import AxisIdentity, AxisLimits, motion
from drivers.stage.watched import GoOn, Look, WatchedStage
from drivers.text_line import PROMPT_S, TextLine
from drivers.wire_log import WireLog

_DEGREES = 7
_RESOLUTION = 1e-4
"""Settings are compared to so many degrees: what the controller prints."""
_MOST_ERRORS = 20
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
"""The last two digits of an axis's error (the others are the axis number), in plain words."""


@dataclass(frozen=True, kw_only=True)
class EspAxis:
    """One axis as the station file describes it.

    Attributes
    ----------
    name
        "pan", "tilt" or "roll".
    number
        Number of the axis on the controller, 1 to 3.
    serial
        Serial number of the stage as ``1ID?`` says it (SN1263); empty when it need not be checked.
    home_mode
        How it searches its reference (``OR``): 1 by home switch and index, 2 by home switch, 3 and 4 by the
        positive and negative limit, 5 and 6 by those and index. Without it the controller would only go to 0.
    direction
        -1 when the controller's degrees fall as the angle grows.
    zero_deg
        Angle at the controller's 0.
    limits
        Soft limits, speed and acceleration.
    tolerance_deg
        How far from its target the axis may rest.
    encoder_tolerance_deg
        Not used: the position is that of the encoder.
    """

    name: str
    number: int
    serial: str
    limits: AxisLimits
    home_mode: Literal[1, 2, 3, 4, 5, 6] = 1
    direction: Literal[1, -1] = 1
    zero_deg: float = 0.0
    tolerance_deg: float = 0.002
    encoder_tolerance_deg: float = 0.0

    def own(self, angle_deg: float) -> float:
        """Return the controller's degrees of an angle, to the digits that are sent."""
        return round((angle_deg - self.zero_deg) * self.direction, 5)

    def angle_deg(self, own_deg: float) -> float:
        """Return the angle of the controller's degrees."""
        return self.zero_deg + self.direction * own_deg


@dataclass(frozen=True)
class EspError:
    """One entry of the error buffer, with the controller's time in servo cycles since it started."""

    code: int
    time: int
    text: str

    def __str__(self) -> str:
        axis, number = divmod(self.code, 100)
        words = AXIS_ERRORS.get(number, self.text.lower()) if axis else self.text.lower()
        return f"{words} (error {self.code})"


class EspStage(WatchedStage[EspAxis]):
    """A stage of one to three axes on an ESP controller. Implements ``drivers.stage.Stage``.

    Open it with ``EspStage.open``; the constructor takes a port that is open already.

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
        The station's limits reach beyond the controller's, or its axes do not count in degrees.
    DeviceRefused, ReplyError, PortLost
    """

    def __init__(
        self, port: Port, axes: Sequence[EspAxis], *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        super().__init__(axes, clock=clock, where=port.name)
        self._time = 0
        self._restarts = 0
        self._homed_at: int | None = None
        try:
            self._line = TextLine(
                port,
                who="VE?",
                is_identity=lambda text: text.upper().startswith("ESP"),
                request_end=b"\r",
                reply_s=PROMPT_S,
                clock=clock,
                wire_log=wire_log,
            )
            self._errors()
            self.identify()
            self._bring_to_rest()
            for axis in axes:
                self._program(axis)
        except BaseException:
            port.close()
            raise

    @classmethod
    def open(
        cls,
        port: str,
        axes: Sequence[EspAxis],
        *,
        baudrate: int = 19200,
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> EspStage:
        """Open the port, check who answers, and program limits, speed and acceleration. Moves nothing.

        Raises PortNotFound, PortBusy, PortDenied, and what the constructor raises.
        """
        return cls(SerialPort(port, baudrate=baudrate), axes, clock=clock, wire_log=wire_log)

    def identify(self) -> Sequence[AxisIdentity]:
        """Ask every axis who it is. Raises WrongDevice when a serial number is not the station file's."""
        found = []
        for axis in self._axes.values():
            text = self._line.ask(f"{axis.number}ID?")
            model, _, serial = (part.strip() for part in text.partition(","))
            if axis.serial and serial.removeprefix("SN") != axis.serial.removeprefix("SN"):
                raise WrongDevice(
                    f"the station file says serial {axis.serial} for {axis.name}, but axis {axis.number}"
                    f" says '{text}'. Nothing was moved.",
                    where=self._where,
                    remedy="Check the port, the axis numbers and the serials in the station file.",
                )
            found.append(AxisIdentity(axis.name, "Newport", model, serial, self._line.identity_text))
        return tuple(found)

    def _has_reference(self) -> bool:
        """Whether this driver has homed all axes, and no restart or switched-off motor undid it."""
        self._errors()
        return self._homed_at == self._restarts and all(map(self._motor_on, self._axes.values()))

    def faults(self) -> Sequence[str]:
        """Return the controller's errors since last asked, and motors that are off, in plain words."""
        found = [str(error) for error in self._errors()]
        return found + [f"{name}: motor off" for name, axis in self._axes.items() if not self._motor_on(axis)]

    def close(self) -> None:
        """Give the port back; the stage stays where it is."""
        self._line.close()

    # ------------------------------------------------------------ on the wire

    def _assure_ready(self, axis: EspAxis) -> None:
        if not self._has_reference():
            raise NotHomed(
                "the axis has no reference. Nothing was moved.",
                where=axis.name,
                remedy="Home the stage first.",
            )

    def _clear_faults(self, axis: EspAxis) -> None:
        """Empty the error buffer and power the motor, which moves nothing."""
        self._errors()
        if not self._motor_on(axis):
            self._tell(axis, "MO")
        if not self._motor_on(axis):
            raise MoveFailed(
                "the motor does not go on. Nothing was moved.",
                where=axis.name,
                remedy="See whether the controller's motor power is enabled.",
            )

    def _goal_deg(self, axis: EspAxis, angle_deg: float) -> float:
        return axis.angle_deg(axis.own(angle_deg))

    def _start(self, goals_deg: Mapping[str, float], go_on: GoOn) -> None:
        for name, angle_deg in goals_deg.items():
            axis = self._axes[name]
            with self._line.lock:
                go_on()
                self._tell(axis, f"PA{axis.own(angle_deg):.5f}")

    def _start_homing(self, go_on: GoOn) -> None:
        self._homed_at = None
        for axis in self._axes.values():
            with self._line.lock:
                go_on()
                self._tell(axis, f"OR{axis.home_mode}")

    def _look(self, axis: EspAxis, *, homing: bool = False) -> Look:  # noqa: ARG002 - its troubles are the same
        """Whether it moves, then where it is: so that a position at rest is one of rest."""
        done = self._line.switch(f"{axis.number}MD?")
        position_deg = axis.angle_deg(self._line.decimal(f"{axis.number}TP"))
        trouble = "" if self._motor_on(axis) else "the motor went off, as after a fault or a restart"
        return Look(position_deg, not done, trouble)

    def _look_at_rest(self, axis: EspAxis, *, homing: bool) -> Look:
        """Ask for the errors too, of all our axes: the buffer tells each of them once."""
        look = self._look(axis, homing=homing)
        if errors := self._our_errors():
            return look._replace(trouble=self._in_words(errors, axis))
        if not homing and self._homed_at != self._restarts:
            return look._replace(trouble="the controller restarted in mid-move: its position is lost")
        return look

    def _finish_homing(self, axis: EspAxis) -> None:  # noqa: ARG002 - one controller, one restart
        self._homed_at = self._restarts

    def _send_stop(self) -> None:
        """Ramp all axes down, then each by its number: twice, since it has no answer; then see that it is heard."""
        for number in ("", *(axis.number for axis in self._axes.values())):
            self._line.blurt(f"{number}ST")
        self._errors()

    def _listen(self, seconds: float) -> None:
        self._line.listen(seconds)

    def _motor_on(self, axis: EspAxis) -> bool:
        """Ask until two answers agree: it is a single digit, without checksum."""
        question = f"{axis.number}MO?"
        return agreeing(lambda: self._line.switch(question), what=question, where=self._where)

    def _tell(self, axis: EspAxis, words: str) -> None:
        """Send a command, once, and ask for errors. Raises DeviceRefused."""
        command = f"{axis.number}{words}"
        self._line.send(command)
        if errors := self._our_errors():
            raise DeviceRefused(
                f"the controller refuses '{command}': {self._in_words(errors, axis)}.",
                where=axis.name,
                remedy="Check limits, speed and acceleration in the station file.",
            )

    def _errors(self) -> list[EspError]:
        """Empty the error buffer; notice a restart by the controller's time going back."""
        found: list[EspError] = []
        while len(found) < _MOST_ERRORS:
            text = self._line.ask("TB?")
            match = _ERROR.fullmatch(text)
            if match is None:
                raise self._line.garbled(f"TB? answered {text!r}.")
            error = EspError(int(match[1]), int(match[2]), match[3])
            if not error.code:
                self._hear_time(error.time)
                return found
            found.append(error)
        raise self._line.garbled("the error buffer never ends.")

    def _our_errors(self) -> list[EspError]:
        """Empty the error buffer; return the errors of the controller and of our axes."""
        ours = {0} | {axis.number for axis in self._axes.values()}
        return [error for error in self._errors() if error.code // 100 in ours]

    def _in_words(self, errors: Sequence[EspError], asked: EspAxis) -> str:
        """Say errors in plain words, and whose they are when it is another axis than the one asked about."""
        names = {axis.number: axis.name for axis in self._axes.values() if axis is not asked}
        whose = [names.get(error.code // 100) for error in errors]
        return "; ".join(
            f"{name}: {error}" if name else str(error) for name, error in zip(whose, errors, strict=True)
        )

    def _hear_time(self, time: int) -> None:
        if time < self._time:
            self._restarts += 1
        self._time = time

    # ------------------------------------------------------------ settings

    def _program(self, axis: EspAxis) -> None:
        """Check unit and travel; set limits, speed and acceleration where they differ; read them back."""
        if self._line.number(f"{axis.number}SN?") != _DEGREES:
            raise OutsideLimits(
                "the axis does not count in degrees.",
                where=axis.name,
                remedy=f"Set its unit with {axis.number}SN{_DEGREES}, and its limits and speeds in degrees.",
            )
        ends = sorted((axis.own(axis.limits.lowest_deg), axis.own(axis.limits.highest_deg)))
        travel = self._line.number(f"{axis.number}SL?"), self._line.number(f"{axis.number}SR?")
        motion.check_travel(axis.name, (ends[0], ends[1]), travel, "deg", slack=_RESOLUTION)
        wanted = {
            "SL": ends[0],
            "SR": ends[1],
            "VA": axis.limits.speed_deg_s,
            "AC": axis.limits.acceleration_deg_s2,
            "AG": axis.limits.acceleration_deg_s2,
        }
        for word, value in wanted.items():
            if abs(self._line.number(f"{axis.number}{word}?") - value) > _RESOLUTION:
                self._tell(axis, f"{word}{value:.5f}")
            got = self._line.number(f"{axis.number}{word}?")
            if abs(got - value) > _RESOLUTION:
                raise DeviceRefused(
                    f"{word} was set to {value:g}, but reads {got:g}.",
                    where=axis.name,
                    remedy="Change the station file to what the controller can do.",
                )
