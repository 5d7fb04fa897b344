"""Flicker lights on an SCPI function generator: its output feeds the lamp, its sync output the camera.

A generator may clip a setting, refuse it, or accept and ignore it, so every setting is read back. Opening switches
nothing. Generators of several makes have different commands:

``keysight``: 33220A, 33250A and compatible generators, with one channel without a number. (Not the 33120A, which has
neither levels nor an output switch.) Source: "Agilent 33220A 20 MHz Function/Arbitrary Waveform Generator User's
Guide", chapter "Remote Interface Reference".
``numbered``: channels with a number, ``SOUR1:`` and ``OUTP1``: Keysight 33500B, Rigol DG. (Not Tektronix AFG, which has
a duty cycle for pulses only.) Source: Keysight, "33500B Series: Operating and Service Guide".
``siglent``: SDG, all settings of a channel in one command, ``C1:BSWV``. Source: Siglent, "SDG Series Programming
Guide".
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from drivers.clock import Clock
from drivers.errors import LightFault, SettingRefused, WrongDevice
from drivers.light import LightIdentity, LightSettings, Waveform
from drivers.light.watched import WatchedLight, steady_settings
from drivers.serial_port import Port, closed_on_error
from drivers.text_line import InstrumentError, ScpiLine
from drivers.wire_log import WireLog

Load = Literal["high-z", "50-ohm", "unchanged"]
"""Load that the generator assumes at its output; its levels are those at this load."""

DialectName = Literal["keysight", "numbered", "siglent"]

Setting = tuple[str, str]
"""Name of a setting, for messages, and the command that makes it."""


_SHORT: dict[Waveform, str] = {"square": "SQU", "sine": "SIN", "steady": "DC"}
_LONG: dict[Waveform, str] = {"square": "SQUARE", "sine": "SINE", "steady": "DC"}


@dataclass(frozen=True)
class HeaderDialect:
    """SCPI commands with one header a setting."""

    source: str = ""  # Prefix of the headers of the signal: "" or "SOUR1:"
    output_header: str = "OUTP"  # Header of the output switch: "OUTP" or "OUTP1"

    def load(self, load: Load) -> Setting:
        """Return the command for the load, which is not "unchanged"."""
        return "load", f"{self.output_header}:LOAD {'INF' if load == 'high-z' else '50'}"

    def reset_modes(self) -> list[Setting]:
        """Return the commands that end bursts, sweeps and modulations, and make the polarity normal."""
        modes = {"burst": "BURS", "sweep": "SWE", "amplitude": "AM", "frequency": "FM", "shift keying": "FSK"}
        off = [(name, f"{self.source}{header}:STAT OFF") for name, header in modes.items()]
        return [*off, ("polarity", f"{self.output_header}:POL NORM")]

    def normal_sync(self) -> Sequence[str]:
        """Return commands that make the polarity of the sync output normal, to be sent until one is accepted.

        Keysight 33500B says NORM, Rigol DG1000Z POS; a 33220A has no such setting.
        """
        return [f"{self.output_header}:SYNC:POL {word}" for word in ("NORM", "POS")] if self.source else []

    def settings(self, wanted: LightSettings, present_low_v: float) -> list[Setting]:
        """Return the commands for all settings but the output, in an order in which the generator accepts each.

        The high level must stay above the low level, at present ``present_low_v``, after every command.
        """
        source = self.source
        if wanted.waveform == "steady":
            return [
                ("waveform", f"{source}FUNC DC"),
                ("steady level", f"{source}VOLT:OFFS {wanted.high_v:.6g}"),
            ]
        found = [
            ("waveform", f"{source}FUNC {_SHORT[wanted.waveform]}"),
            ("frequency", f"{source}FREQ {wanted.frequency_hz:.12g}"),
        ]
        if wanted.waveform == "square":
            found.append(("duty", f"{source}FUNC:SQU:DCYC {wanted.duty_percent:.6g}"))
        high = ("high level", f"{source}VOLT:HIGH {wanted.high_v:.6g}")
        low = ("low level", f"{source}VOLT:LOW {wanted.low_v:.6g}")
        found += [high, low] if wanted.high_v > present_low_v else [low, high]
        sync = "ON" if wanted.sync_output else "OFF"
        return [*found, ("sync", f"{self.output_header}:SYNC {sync}")]

    def output(self, on: bool) -> Setting:
        """Return the command for the output."""
        return "output", f"{self.output_header} {'ON' if on else 'OFF'}"

    def query_low_v(self, line: ScpiLine) -> float:
        """Ask for the low level, in volts."""
        return line.query_number(f"{self.source}VOLT:LOW?")

    def query_settings(self, line: ScpiLine, *, backwards: bool) -> LightSettings:
        """Ask for all settings, in one of two orders; refuse (`LightFault`) what is no square, sine or steady level.

        A reply that is one query late could be taken for an answer twice, but not when the two readings have different
        orders.
        """
        source = self.source
        waveform = _waveform(line.query(f"{source}FUNC?"), line.name)
        if waveform == "steady":
            return steady_settings(line.query_number(f"{source}VOLT:OFFS?"))
        # In the two orders each number has different neighbours, so a reply that is one query late differs.
        queries = {"low_v": "VOLT:LOW?", "high_v": "VOLT:HIGH?", "frequency_hz": "FREQ?"}
        if waveform == "square":
            queries["duty_percent"] = "FUNC:SQU:DCYC?"
        order = reversed(queries) if backwards else iter(queries)
        numbers = {name: line.query_number(source + queries[name]) for name in order}
        return LightSettings(
            waveform, sync_output=line.query_switch(f"{self.output_header}:SYNC?"), **numbers
        )

    def query_output(self, line: ScpiLine) -> bool:
        """Ask whether the output is on. Another query comes first: a late answer to it is not that of a switch."""
        line.query(f"{self.source}FUNC?")
        return line.query_switch(f"{self.output_header}?")


class SiglentDialect:
    """Siglent's commands: all settings of channel 1 in one command of names and values, joined by commas."""

    def load(self, load: Load) -> Setting:
        """See `HeaderDialect.load`."""
        return "load", f"C1:OUTP LOAD,{'HZ' if load == 'high-z' else '50'}"

    def reset_modes(self) -> list[Setting]:
        """See `HeaderDialect.reset_modes`."""
        modes = {"burst": "BTWV", "sweep": "SWWV", "modulation": "MDWV"}
        off = [(name, f"C1:{header} STATE,OFF") for name, header in modes.items()]
        return [*off, ("polarity", "C1:OUTP PLRT,NOR")]

    def normal_sync(self) -> Sequence[str]:
        """See `HeaderDialect.normal_sync`. The polarity is fixed."""
        return []

    def settings(self, wanted: LightSettings, present_low_v: float) -> list[Setting]:  # noqa: ARG002
        """See `HeaderDialect.settings`. One command holds both levels, so their order does not matter."""
        if wanted.waveform == "steady":
            return [("steady level", f"C1:BSWV WVTP,DC,OFST,{wanted.high_v:.6g}")]
        words = [f"WVTP,{_LONG[wanted.waveform]}", f"FRQ,{wanted.frequency_hz:.12g}"]
        words += [f"HLEV,{wanted.high_v:.6g}", f"LLEV,{wanted.low_v:.6g}"]
        if wanted.waveform == "square":
            words.append(f"DUTY,{wanted.duty_percent:.6g}")
        sync = "ON" if wanted.sync_output else "OFF"
        return [("flicker", f"C1:BSWV {','.join(words)}"), ("sync", f"C1:SYNC {sync}")]

    def output(self, on: bool) -> Setting:
        """See `HeaderDialect.output`."""
        return "output", f"C1:OUTP {'ON' if on else 'OFF'}"

    def query_low_v(self, line: ScpiLine) -> float:
        """See `HeaderDialect.query_low_v`."""
        fields = self._query_fields(line, "BSWV")
        return self._parse_number(line, fields, "LLEV" if "LLEV" in fields else "OFST")

    def query_settings(self, line: ScpiLine, *, backwards: bool) -> LightSettings:  # noqa: ARG002 - answers carry their names
        """See `HeaderDialect.query_settings`."""
        fields = self._query_fields(line, "BSWV")
        waveform = _waveform(fields.get("WVTP", ""), line.name)
        if waveform == "steady":
            return steady_settings(self._parse_number(line, fields, "OFST"))
        settings = LightSettings(
            waveform=waveform,
            frequency_hz=self._parse_number(line, fields, "FRQ"),
            low_v=self._parse_number(line, fields, "LLEV"),
            high_v=self._parse_number(line, fields, "HLEV"),
            sync_output=self._query_first(line, "SYNC") == "ON",
        )
        if waveform == "square":
            settings = replace(settings, duty_percent=self._parse_number(line, fields, "DUTY"))
        return settings

    def query_output(self, line: ScpiLine) -> bool:
        """See `HeaderDialect.query_output`."""
        return self._query_first(line, "OUTP") == "ON"

    def _query_words(self, line: ScpiLine, header: str) -> list[str]:
        text = line.query(f"C1:{header}?").upper()
        start = f"C1:{header} "
        if not text.startswith(start):
            raise line.garbled_reply(f"C1:{header}? answered {text!r}.")
        return text.removeprefix(start).split(",")

    def _query_first(self, line: ScpiLine, header: str) -> str:
        word = self._query_words(line, header)[0]
        if word not in {"ON", "OFF"}:
            raise line.garbled_reply(f"C1:{header}? answered {word!r}, not on or off.")
        return word

    def _query_fields(self, line: ScpiLine, header: str) -> dict[str, str]:
        words = self._query_words(line, header)
        return dict(zip(words[::2], words[1::2], strict=False))

    def _parse_number(self, line: ScpiLine, fields: dict[str, str], name: str) -> float:
        """Parse a number with its unit, as in ``60HZ`` or ``3.3V``."""
        match = re.fullmatch(r"([+-]?\d+(?:\.\d*)?(?:E[+-]?\d+)?)(?:HZ|V|%)?", fields.get(name, ""))
        if match is None or not math.isfinite(float(match[1])):
            raise line.garbled_reply(f"no number {name} in {fields}.")
        return float(match[1])


Dialect = HeaderDialect | SiglentDialect

DIALECTS: dict[DialectName, Dialect] = {
    "keysight": HeaderDialect(),
    "numbered": HeaderDialect("SOUR1:", "OUTP1"),
    "siglent": SiglentDialect(),
}


def _waveform(word: str, where: str) -> Waveform:
    if word.upper() in {"SQU", "SQUARE"}:
        return "square"
    if word.upper() in {"SIN", "SINE", "SINUSOID"}:
        return "sine"
    if word.upper() == "DC":
        return "steady"
    raise LightFault(
        f"the generator's waveform is {word!r}, neither a square, a sine nor a steady level.",
        where=where,
        remedy="Apply the light's settings first.",
    )


# Largest difference of two equal values: the finest resolution that generators have and print.
_FREQUENCY_REL = 1e-6
_DUTY_PERCENT = 0.01
_LEVEL_REL = 1e-3
_LEVEL_V = 0.002


class ScpiLight(WatchedLight):
    """A light behind an SCPI generator; ``serial`` as in the answer to ``*IDN?``, None when it is not checked.

    ``load`` is sent before the levels; "unchanged" for a generator without this setting. ``dialect``: "keysight",
    "numbered" or "siglent".
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
        """See `Light.identify`; the serial number is compared with the one in the station file."""
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
        """Ask for all settings: SCPI has no checksums, and a digit can change on the line."""
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
    """Return every setting that reads back differently; of a steady light, only waveform and level count."""
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
