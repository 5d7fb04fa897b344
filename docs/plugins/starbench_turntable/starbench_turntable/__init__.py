"""A turntable with one axis, as a plug-in of Starbench: its section of a station file, and its driver.

    ID?         ID TURNTABLE T7 1.0
    POS?        POS 12.500           degrees
    STATE?      STATE idle           or moving, lost (no reference), blocked
    GOTO 12.5   GOTO OK              or ERR and a reason
    HOME        HOME OK
    STOP        STOP OK

Every reply begins with the word of its request, so that no reply is taken for the answer to another one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from bench.stations.sections import AxisConfig, PortName, StageSection
from bench.stations.station_fields import Port, Serial
from drivers.clock import Clock
from drivers.errors import DeviceRefused, WrongDevice
from drivers.serial_port import SerialPort
from drivers.stage import AxisIdentity, Stage
from drivers.stage.motion import Axis as StageAxis
from drivers.stage.watched import AxisState, WatchedStage, no_reference
from drivers.text_line import TextLine
from drivers.wire_log import WireLog
from sequences.schema import Axis


@dataclass(frozen=True, kw_only=True)
class TurntableAxis(StageAxis):
    """The axis, as the driver needs it."""

    @property
    def scale(self) -> float:
        """The turntable counts in thousandths of a degree."""
        return 1000.0


class TurntableConfig(StageSection):
    """The section of the station file."""

    driver: Literal["turntable"]
    port: Port
    serial: Serial
    axes: Annotated[dict[Axis, AxisConfig], Field(min_length=1, max_length=1)]

    @property
    def ports(self) -> tuple[str, ...]:
        """Port of the turntable."""
        return (self.port,)

    @property
    def device_names(self) -> tuple[str, ...]:
        """Only one process at a time may use it."""
        return (f"turntable {self.serial}",)

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:
        """Open the turntable. Nothing moves."""
        ((name, axis),) = self.axes.items()
        own = TurntableAxis(name=name, limits=axis.limits, **axis.driver_options())
        return Turntable(port(self.port), own, serial=self.serial, clock=clock, wire_log=wire_log)


class Turntable(WatchedStage[TurntableAxis]):
    """The driver. ``WatchedStage`` watches the moves; here is only what this device understands."""

    def __init__(
        self, port: str, axis: TurntableAxis, *, serial: str, clock: Clock, wire_log: WireLog | None
    ) -> None:
        super().__init__([axis], clock=clock, where=port)
        self._axis = axis
        self._serial = serial
        opened = SerialPort(port, baudrate=115_200)
        try:
            line = TextLine(
                opened,
                identity_query="ID?",
                is_identity=lambda text: text.startswith("ID TURNTABLE "),
                reply_s=0.5,
                clock=clock,
                wire_log=wire_log,
            )
            self._line = self._share(line)
            self.identify()
            self._bring_to_rest()
        except BaseException:
            opened.close()
            raise

    def identify(self) -> Sequence[AxisIdentity]:
        """Return the identity; raise WrongDevice for another serial number."""
        _, model, serial, firmware = self._line.query("ID?").split(" ")
        if serial != self._serial:
            raise WrongDevice(
                f"the station file names serial {self._serial}, but {serial} answers. Nothing was moved.",
                where=self._line.name,
                remedy="Check the port and the serial in the station file.",
            )
        return (AxisIdentity(self._axis.name, "Example", model, serial, firmware),)

    def faults(self) -> Sequence[str]:
        """Return what the turntable reports."""
        return ["the turntable is blocked"] if self._ask("STATE") == "blocked" else []

    # ------------------------------------------------------------ what WatchedStage needs

    def _ask(self, word: str) -> str:
        """Send a query; its answer begins with the query's word."""
        answer = self._line.query(f"{word}?")
        name, _, value = answer.partition(" ")
        if name != word or not value:
            raise self._line.garbled_reply(f"{word}? was answered by {answer!r}.")
        return value

    def _command(self, text: str, *, tries: int = 1) -> None:
        """Send a command; a command that moves is sent once."""
        answer = self._line.query(text, tries=tries)
        word = text.partition(" ")[0]
        if answer == f"{word} OK":
            return
        if answer.startswith(f"{word} ERR "):
            raise DeviceRefused(
                f"'{text}' is refused: {answer}.", where=self._line.name, remedy="Check the limits."
            )
        raise self._line.garbled_reply(f"{text} was answered by {answer!r}.")

    def _has_reference(self) -> bool:
        return self._ask("STATE") != "lost"

    def _check_ready(self, axis: TurntableAxis) -> None:
        if not self._has_reference():
            raise no_reference(axis, "there is no reference")

    def _clear_faults(self, axis: TurntableAxis) -> None:
        """The turntable needs nothing before homing."""

    def _begin_move(self, axis: TurntableAxis, angle_deg: float) -> None:
        self._command(f"GOTO {angle_deg - axis.zero_deg:.3f}")

    def _begin_homing(self, axis: TurntableAxis) -> None:  # noqa: ARG002 - it has one axis
        self._command("HOME")

    def _read_state(self, axis: TurntableAxis, *, homing: bool = False) -> AxisState:
        state = self._ask("STATE")
        if state not in {"idle", "moving", "lost", "blocked"}:
            raise self._line.garbled_reply(f"STATE? was answered by {state!r}.")
        text = self._ask("POS")
        try:
            position_deg = axis.zero_deg + float(text)
        except ValueError:
            raise self._line.garbled_reply(f"POS? was answered by {text!r}.") from None
        problem = "the turntable is blocked" if state == "blocked" else ""
        if state == "lost" and not homing and not self._position_doubt:
            problem = "the turntable has lost its reference"
        return AxisState(position_deg, state == "moving", problem)

    def _send_stop(self) -> None:
        """Stop at once; the reply to that is thrown away, then a stop on a clean line is confirmed."""
        self._line.send_urgent("STOP")
        self._line.mark_out_of_step()
        self._command("STOP", tries=3)
