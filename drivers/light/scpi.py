"""Flicker lights on an SCPI function generator: its output feeds the lamp, its sync output the camera.

A generator may clip a setting, refuse it, or accept and ignore it, so every setting is read back. Opening switches
nothing. The commands of each make are in ``drivers.light.scpi_dialects``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from drivers.clock import Clock
from drivers.errors import SettingRefused, WrongDevice
from drivers.light import LightIdentity, LightSettings
from drivers.light.scpi_dialects import DIALECTS, DialectName, Load, Setting
from drivers.light.watched import WatchedLight
from drivers.serial_port import Port, closed_on_error
from drivers.text_line import InstrumentError, ScpiLine
from drivers.wire_log import WireLog

# Largest difference of two equal values: the finest resolution that generators have and print.
_FREQUENCY_REL = 1e-6
_DUTY_PERCENT = 0.01
_LEVEL_REL = 1e-3
_LEVEL_V = 0.002


class ScpiLight(WatchedLight):
    """A light behind an SCPI generator.

    serial: The generator's serial number as in the answer to ``*IDN?``; None when it is not checked.
    clock, wire_log: See ``drivers.link.Link``.
    load: Load setting, sent before the levels; "unchanged" for a generator that has no such setting.
    dialect: Commands of the generator: "keysight", "numbered" or "siglent".
    Raises ReplyError, PortLost: The generator does not answer.
    """

    BAUDRATE = 9600
    _line: ScpiLine
    OUTPUT = LAMP = "output"
    STAYS_DARK = ("reads off", "Check whether the generator shows an overload of its output.")
    STAYS_LIT = ("reads on", "Switch the generator's output off by hand.")

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
        super().__init__()
        self._backwards = itertools.cycle((False, True))
        self._modes_reset = False
        self._sync_is_normal = False
        with closed_on_error(port):
            self._line = ScpiLine(port, clock=clock, wire_log=wire_log)
            self.identify()

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
        remedy = "Ask for values within the generator's range and resolution."
        self._refuse_otherwise(_differences(settings, got), remedy)
        return got

    def _read_once(self) -> LightSettings:
        """Ask for all settings: SCPI has no checksums, and a digit can change on the line.

        Raises LightFault: The waveform is neither a square, a sine nor a steady level.
        """
        return self._dialect.query_settings(self._line, backwards=next(self._backwards))

    def read(self) -> LightSettings:
        """See `Light.read`. Consecutive readings ask in two orders."""
        self._backwards = itertools.cycle((False, True))
        return super().read()

    def sync_polarity(self) -> str:
        """See `StatesSyncPolarity.sync_polarity`. Ends bursts and modulations, too, as `apply` does."""
        self._reset_modes()
        return "normal" if self._sync_is_normal else "not stated by the device"

    def _switch_on(self) -> None:
        self._set(self._dialect.output(on=True))

    def _switch_off(self) -> None:
        _, command = self._dialect.output(on=False)
        self._line.send_urgent(command)

    def _insist_off(self) -> bool:
        _, command = self._dialect.output(on=False)
        self._line.command(command)
        return True

    def is_on(self) -> bool:
        """See `Light.is_on`."""
        return self._agreed(lambda: self._dialect.query_output(self._line), "the output's switch")

    def _reported_faults(self) -> list[str]:
        """Return the errors since the last call."""
        return [f"the generator reports {error}" for error in self._line.read_errors()]

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


def _differences(asked: LightSettings, got: LightSettings) -> list[str]:
    """Return every setting that reads back differently.

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
    return [
        f"{name}: asked {getattr(asked, name)}, got {getattr(got, name)}"
        for name, agreed in agrees.items()
        if name in counts and not agreed
    ]


def _remedy(name: str, errors: Sequence[InstrumentError]) -> str:
    if any(error.code == -113 for error in errors):
        if name == "load":
            return "Write 'load: unchanged' in the station file: this generator has no load setting."
        return "Check that the station file names the right driver for this generator."
    return "Ask for a value within the generator's range."
