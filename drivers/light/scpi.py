"""Flicker lights driven by an SCPI function generator: its output feeds the lamp, its sync the camera.

Knows what may go wrong with a setting: clipped, refused, taken and silently dropped. Every setting is read
back. Nothing is switched by opening. How makes say it is in ``drivers.light.scpi_dialects``.
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
from drivers.readings import agreeing
from drivers.scpi_line import InstrumentError, ScpiLine
from drivers.serial_port import Port, SerialPort
from drivers.wire_log import WireLog

# How far a value read back may lie from the one asked: the finest of what generators resolve and print.
_FREQUENCY_REL = 1e-6
_DUTY_PERCENT = 0.01
_LEVEL_REL = 1e-3
_LEVEL_V = 0.002

T = TypeVar("T")


class ScpiLight:
    """A light behind an SCPI generator. Implements ``drivers.light.Light``.

    Open it with ``ScpiLight.open``; the constructor takes a port that is open already.

    Parameters
    ----------
    port
        The open port.
    serial
        The generator's serial number as ``*IDN?`` says it; None when it need not be checked.
    clock, wire_log
        See ``drivers.link.Link``.
    load
        Set before the levels; "unchanged" for a generator that has no such setting.
    dialect
        How the generator wants to be spoken to: "keysight", "numbered" or "siglent".

    Raises
    ------
    WrongDevice
        Another serial number answers; nothing was set.
    ReplyError, PortLost
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
        self._plain = False
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
        """Open the port and check who answers. Sets and switches nothing.

        Raises PortNotFound, PortBusy, PortDenied, and what the constructor raises.
        """
        opened = SerialPort(port, baudrate=baudrate)
        return cls(opened, serial=serial, clock=clock, wire_log=wire_log, load=load, dialect=dialect)

    def identify(self) -> LightIdentity:
        """Return who it is. Raises WrongDevice when the serial number is not the station file's."""
        identity = LightIdentity(*self._line.identity)
        if self._serial is not None and identity.serial != self._serial:
            raise WrongDevice(
                f"the station file says serial {self._serial}, but {identity.maker} {identity.model} with"
                f" serial {identity.serial} answers. Nothing was set.",
                where=self._line.name,
                remedy="Check the port and the serial in the station file.",
            )
        return identity

    def apply(self, settings: LightSettings) -> LightSettings:
        """Set everything, read it back, and return what the generator says.

        Raises SettingRefused, naming what was asked and what the generator has instead.
        """
        self._make_plain()
        if self._load != "unchanged":
            self._set(self._dialect.load(self._load))
        for setting in self._dialect.settings(settings, self._dialect.low_v(self._line)):
            self._set(setting)
        got = self.read()
        _compare(settings, got, self._line.name)
        return got

    def read(self) -> LightSettings:
        """Return the present settings, asked of the generator.

        Everything is read twice: SCPI has no checksums, and a digit can change on the line. Raises
        LightFault when it makes neither square, sine nor a steady level; ReplyGarbled when two readings never agree.
        """
        turns = itertools.cycle((False, True))
        return self._agreeing(lambda: self._dialect.read(self._line, backwards=next(turns)), "the settings")

    def on(self) -> None:
        """Switch the output on and see that it is. Raises LightFault, SettingRefused."""
        self._set(self._dialect.output(on=True))
        if not self.is_on():
            raise LightFault(
                "the output was switched on, but reads off.",
                where=self._line.name,
                remedy="See whether the generator shows an overload on its output.",
            )
        self._switched_on = True

    def off(self) -> None:
        """Switch the output off and see that it is. Goes out at once, before any resynchronising.

        Raises LightFault; ReplyError, PortLost when it cannot be known.
        """
        self._switched_on = False
        _, command = self._dialect.output(on=False)
        self._line.blurt(command)
        if not self.is_on():
            return
        self._line.tell(command)
        if self.is_on():
            raise LightFault(
                "the output was switched off, but reads on.",
                where=self._line.name,
                remedy="Switch the generator's output off by hand.",
            )

    def is_on(self) -> bool:
        """Whether the output is on, asked of the generator twice."""
        return self._agreeing(lambda: self._dialect.is_on(self._line), "the output's switch")

    def faults(self) -> Sequence[str]:
        """Return the generator's errors since last asked, and whether it went dark by itself."""
        found = [f"the generator reports {error}" for error in self._line.errors()]
        if self._switched_on and not self.is_on():
            found.append("the output was switched on, but is off")
        return found

    def close(self) -> None:
        """Give the port back; does not switch anything."""
        self._line.close()

    # ------------------------------------------------------------ inside

    def _make_plain(self) -> None:
        """End, once, what somebody before us has left on; who does not know the command has no such mode."""
        if not self._plain:
            for setting in self._dialect.plain():
                self._set(setting, may_be_unknown=True)
            self._plain = True

    def _set(self, setting: Setting, *, may_be_unknown: bool = False) -> None:
        name, command = setting
        errors = [
            error for error in self._line.tell(command) if not (may_be_unknown and error.is_of_the_command)
        ]
        if errors:
            raise SettingRefused(
                f"{name} is not taken: '{command}' is answered by {_in_words(errors)}.",
                where=self._line.name,
                remedy=_remedy(name, errors),
            )

    def _agreeing(self, read: Callable[[], T], what: str) -> T:
        return agreeing(read, what=what, where=self._line.name)


def _compare(asked: LightSettings, got: LightSettings, where: str) -> None:
    """Raise SettingRefused, naming every setting that reads back otherwise than asked.

    Of a steady light, only its waveform and its level count.
    """
    level_v = _LEVEL_V + _LEVEL_REL * max(abs(asked.high_v), abs(asked.low_v))
    pairs = [
        ("waveform", asked.waveform, got.waveform, asked.waveform == got.waveform),
        (
            "frequency_hz",
            asked.frequency_hz,
            got.frequency_hz,
            math.isclose(asked.frequency_hz, got.frequency_hz, rel_tol=_FREQUENCY_REL),
        ),
        (
            "duty_percent",
            asked.duty_percent,
            got.duty_percent,
            asked.waveform != "square" or abs(asked.duty_percent - got.duty_percent) <= _DUTY_PERCENT,
        ),
        ("high_v", asked.high_v, got.high_v, abs(asked.high_v - got.high_v) <= level_v),
        ("low_v", asked.low_v, got.low_v, abs(asked.low_v - got.low_v) <= level_v),
        ("sync_output", asked.sync_output, got.sync_output, asked.sync_output == got.sync_output),
    ]
    counts = {"waveform", "high_v"} if asked.waveform == "steady" else {name for name, *_ in pairs}
    wrong = [
        f"{name}: asked {want}, got {have}" for name, want, have, same in pairs if not same and name in counts
    ]
    if wrong:
        raise SettingRefused(
            f"the generator has other settings than asked ({'; '.join(wrong)}).",
            where=where,
            remedy="Ask for values within the generator's range and resolution.",
        )


def _in_words(errors: Sequence[InstrumentError]) -> str:
    return "; ".join(map(str, errors))


def _remedy(name: str, errors: Sequence[InstrumentError]) -> str:
    if any(error.code == -113 for error in errors):
        if name == "load":
            return "Say 'load: unchanged' in the station file: this generator has no load setting."
        return "See that the station file names the right driver for this generator."
    return "Ask for a value within the generator's range."
