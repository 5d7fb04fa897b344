"""Flicker lights on an SCPI function generator: its output feeds the lamp, its sync output the camera.

A generator may clip a setting, refuse it, or accept and ignore it, so every setting is read back. Opening switches
nothing. The commands of each make are in ``drivers.light.scpi_dialects``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TypeVar

from drivers.clock import Clock
from drivers.errors import LightFault, SettingRefused, WrongDevice
from drivers.light import LightIdentity, LightSettings
from drivers.light.scpi_dialects import DIALECTS, DialectName, Load, Setting
from drivers.readings import read_until_agreed
from drivers.scpi_line import InstrumentError, ScpiLine
from drivers.serial_port import Port, SerialPort
from drivers.wire_log import WireLog

# Largest difference of two equal values: the finest resolution that generators have and print.
_FREQUENCY_REL = 1e-6
_DUTY_PERCENT = 0.01
_LEVEL_REL = 1e-3
_LEVEL_V = 0.002

T = TypeVar("T")


class ScpiLight:
    """A light behind an SCPI generator. Implements ``drivers.light.Light``.

    Open it with ``ScpiLight.open``; the constructor takes a port that is open already.

    serial: The generator's serial number as in the answer to ``*IDN?``; None when it is not checked.
    clock, wire_log: See ``drivers.link.Link``.
    load: Load setting, sent before the levels; "unchanged" for a generator that has no such setting.
    dialect: Commands of the generator: "keysight", "numbered" or "siglent".
    Raises ReplyError, PortLost: The generator does not answer.
    """

    def __init__(
        self,
        port: Port,
        *,
        serial: str | None = None,
        clock: Clock,
        wire_log: WireLog | None = None,
        load: Load = "high-z",
        dialect: DialectName = "keysight",
    ) -> None:
        self._serial = serial
        self._load: Load = load
        self._dialect = DIALECTS[dialect]
        self._switched_on = False
        self._modes_reset = False
        self._sync_is_normal = False
        try:
            self._line = ScpiLine(port, clock=clock, wire_log=wire_log)
            self.identify()
        except BaseException:
            port.close()
            raise

    @classmethod
    def open(
        cls,
        port: str,
        *,
        serial: str | None = None,
        baudrate: int = 9600,
        clock: Clock,
        wire_log: WireLog | None = None,
        load: Load = "high-z",
        dialect: DialectName = "keysight",
    ) -> ScpiLight:
        """Open the port and check the serial number. Sets and switches nothing.

        port: Address of the port; see ``drivers.serial_port.SerialPort``, which raises the errors of opening.
        baudrate: Bits per second.
        """
        opened = SerialPort(port, baudrate=baudrate)
        return cls(opened, serial=serial, clock=clock, wire_log=wire_log, load=load, dialect=dialect)

    def identify(self) -> LightIdentity:
        """See `Light.identify`.

        Raises WrongDevice: The serial number is not the one in the station file.
        """
        identity = LightIdentity(*self._line.identity)
        if self._serial is not None and identity.serial != self._serial:
            raise WrongDevice(
                f"the station file names serial {self._serial}, but {identity.maker} {identity.model} with"
                f" serial {identity.serial} answers. Nothing was set.",
                where=self._line.name,
                remedy="Check the port and the serial in the station file.",
            )
        return identity

    def apply(self, settings: LightSettings) -> LightSettings:
        """See `Light.apply`. The error names what was asked for and what the generator has instead."""
        self._reset_modes()
        if self._load != "unchanged":
            self._set(self._dialect.load(self._load))
        for setting in self._dialect.settings(settings, self._dialect.query_low_v(self._line)):
            self._set(setting)
        got = self.read()
        _check_settings(settings, got, self._line.name)
        return got

    def read(self) -> LightSettings:
        """See `Light.read`. Reads until two readings agree: SCPI has no checksums, and a digit can change on the line.

        Raises LightFault: The waveform is neither a square, a sine nor a steady level.
        Raises ReplyGarbled: The readings do not agree.
        """
        backwards = itertools.cycle((False, True))
        return self._read_until_agreed(
            lambda: self._dialect.query_settings(self._line, backwards=next(backwards)), "the settings"
        )

    def sync_polarity(self) -> str:
        """See `StatesSyncPolarity.sync_polarity`. Ends bursts and modulations, too, as `apply` does."""
        self._reset_modes()
        return "normal" if self._sync_is_normal else "not stated by the device"

    def on(self) -> None:
        """See `Light.on`."""
        self._set(self._dialect.output(on=True))
        if not self.is_on():
            raise LightFault(
                "the output was switched on, but reads off.",
                where=self._line.name,
                remedy="Check whether the generator shows an overload of its output.",
            )
        self._switched_on = True

    def off(self) -> None:
        """See `Light.off`. The command is sent at once, without resynchronising.

        Raises ReplyError, PortLost: The generator does not answer, so its state is unknown.
        """
        self._switched_on = False
        _, command = self._dialect.output(on=False)
        self._line.send_urgent(command)
        if not self.is_on():
            return
        self._line.command(command)
        if self.is_on():
            raise LightFault(
                "the output was switched off, but reads on.",
                where=self._line.name,
                remedy="Switch the generator's output off by hand.",
            )

    def is_on(self) -> bool:
        """See `Light.is_on`. Asks until two answers agree."""
        return self._read_until_agreed(lambda: self._dialect.query_output(self._line), "the output's switch")

    def faults(self) -> Sequence[str]:
        """See `Light.faults`. Returns the errors since the last call, and an unexpected darkness."""
        found = [f"the generator reports {error}" for error in self._line.read_errors()]
        if self._switched_on and not self.is_on():
            found.append("the output was switched on, but is off")
        return found

    def close(self) -> None:
        """See `Light.close`."""
        self._line.close()

    # ------------------------------------------------------------ inside

    def _reset_modes(self) -> None:
        """End, once, the modes that another program may have left on. A generator without a mode may refuse."""
        if not self._modes_reset:
            for setting in self._dialect.reset_modes():
                self._set(setting, may_be_unknown=True)
            self._sync_is_normal = any(map(self._accepts, self._dialect.normal_sync()))
            self._modes_reset = True

    def _accepts(self, command: str) -> bool:
        """Send a command that the generator may lack; return whether it confirms that it took it."""
        return not self._line.command(command) and self._line.has_error_queue

    def _set(self, setting: Setting, *, may_be_unknown: bool = False) -> None:
        name, command = setting
        errors = [
            error for error in self._line.command(command) if not (may_be_unknown and error.is_command_error)
        ]
        if errors:
            raise SettingRefused(
                f"{name} is refused: '{command}' is answered by {'; '.join(map(str, errors))}.",
                where=self._line.name,
                remedy=_remedy(name, errors),
            )

    def _read_until_agreed(self, read: Callable[[], T], what: str) -> T:
        return read_until_agreed(read, what=what, where=self._line.name)


def _check_settings(asked: LightSettings, got: LightSettings, where: str) -> None:
    """Raise SettingRefused with every setting that reads back differently.

    Of a steady light, only the waveform and the level count.
    """
    level_v = _LEVEL_V + _LEVEL_REL * max(abs(asked.high_v), abs(asked.low_v))
    agrees = {
        "waveform": asked.waveform == got.waveform,
        "frequency_hz": math.isclose(asked.frequency_hz, got.frequency_hz, rel_tol=_FREQUENCY_REL),
        "duty_percent": asked.waveform != "square"
        or abs(asked.duty_percent - got.duty_percent) <= _DUTY_PERCENT,
        "high_v": abs(asked.high_v - got.high_v) <= level_v,
        "low_v": abs(asked.low_v - got.low_v) <= level_v,
        "sync_output": asked.sync_output == got.sync_output,
    }
    counts = {"waveform", "high_v"} if asked.waveform == "steady" else set(agrees)
    wrong = [
        f"{name}: asked {getattr(asked, name)}, got {getattr(got, name)}"
        for name, agreed in agrees.items()
        if name in counts and not agreed
    ]
    if wrong:
        raise SettingRefused(
            f"settings read back differently from what was set ({'; '.join(wrong)}).",
            where=where,
            remedy="Ask for values within the generator's range and resolution.",
        )


def _remedy(name: str, errors: Sequence[InstrumentError]) -> str:
    if any(error.code == -113 for error in errors):
        if name == "load":
            return "Write 'load: unchanged' in the station file: this generator has no load setting."
        return "Check that the station file names the right driver for this generator."
    return "Ask for a value within the generator's range."
