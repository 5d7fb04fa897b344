"""The commands of SCPI generators of several makes: settings of a flicker, and modes that another program left behind.

``keysight``: 33220A, 33250A and compatible generators, with one channel without a number. (Not the 33120A, which has
neither levels nor an output switch.) Source: "Agilent 33220A 20 MHz Function/Arbitrary Waveform Generator User's
Guide", chapter "Remote Interface Reference".
``numbered``: channels with a number, ``SOUR1:`` and ``OUTP1``: Keysight 33500B, Rigol DG. (Not Tektronix AFG, which has
a duty cycle for pulses only.) Sources: Keysight, "33500B Series: Operating and Service Guide"; Rigol, "DG1000Z Series
Programming Guide".
``siglent``: SDG, all settings of a channel in one command, ``C1:BSWV``. Source: Siglent, "SDG Series Programming
Guide".
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

from drivers.errors import LightFault
from drivers.light import LightSettings, Waveform
from drivers.light.watched import steady_settings
from drivers.quantity import Quantity, read_quantity
from drivers.text_line import READABLE_REMEDY, ScpiLine

Load = Literal["high-z", "50-ohm", "unchanged"]
"""Load that the generator assumes at its output; its levels are those at this load."""

DialectName = Literal["keysight", "numbered", "siglent"]

Setting = tuple[str, str]
"""Name of a setting, for messages, and the command that makes it."""
# Largest difference of two equal values: the finest resolution that generators have and print.
_FREQUENCY_REL: Final = 1e-6
_DUTY_PERCENT: Final = 0.01
_LEVEL_REL: Final = 1e-3
_LEVEL_V: Final = 0.002
_INFINITE: Final = 1e9
"""SCPI prints an infinite number as 9.9E37."""
_UNITS: Final[Mapping[str, str]] = {"frequency_hz": "Hz", "duty_percent": "%", "low_v": "V", "high_v": "V"}

_SHORT: dict[Waveform, str] = {"square": "SQU", "sine": "SIN", "steady": "DC"}
_LONG: dict[Waveform, str] = {"square": "SQUARE", "sine": "SINE", "steady": "DC"}

_LONG_HEADERS: Final[Mapping[str, str]] = {
    "BSWV": "BASIC_WAVE",
    "OUTP": "OUTPUT",
    "SYNC": "SYNC",
    "MDWV": "MODULATEWAVE",
    "SWWV": "SWEEPWAVE",
    "BTWV": "BURSTWAVE",
    "CMBN": "COMBINE",
    "INVT": "INVERT",
    "NOISE_ADD": "NOISE_ADD",
    "COUP": "COUPLING",
}
_FIELDS: Final[Mapping[str, str]] = {
    "frequency_hz": "FRQ",
    "duty_percent": "DUTY",
    "low_v": "LLEV",
    "high_v": "HLEV",
}


class Mode(NamedTuple):
    """Something that another program may have left on, or set otherwise."""

    name: str  # For messages
    header: str  # Header of its command and, with a question mark, of its query
    words: tuple[str, ...] = ("OFF",)  # Spellings of the wanted state, to be sent until one is accepted

    @property
    def is_switch(self) -> bool:
        """Whether it is on or off, so that a generator has no reason to refuse "off"."""
        return self.words == ("OFF",)

    @property
    def commands(self) -> list[str]:
        """Commands that set it, to be sent until one is accepted."""
        return [f"{self.header} {word}" for word in self.words]

    @property
    def query(self) -> str:
        """Query of its state."""
        return f"{self.header}?"


@dataclass(frozen=True)
class GeneratorReading:
    """The settings of a generator as it prints them; ``numbers`` have the names of `LightSettings`."""

    waveform: Waveform
    sync_output: bool
    numbers: Mapping[str, Quantity]

    @property
    def settings(self) -> LightSettings:
        """The settings as numbers."""
        values: dict[str, Any] = {name: number.value for name, number in self.numbers.items()}
        if self.waveform == "steady":
            return steady_settings(values["high_v"])
        return LightSettings(self.waveform, sync_output=self.sync_output, **values)

    def differences(self, asked: LightSettings) -> list[str]:
        """Return every setting that differs; of a steady light, only waveform and level count."""
        level_v = _LEVEL_V + _LEVEL_REL * max(abs(asked.high_v), abs(asked.low_v))
        tolerances = {
            "frequency_hz": _FREQUENCY_REL * asked.frequency_hz,
            "duty_percent": _DUTY_PERCENT,
            "high_v": level_v,
            "low_v": level_v,
        }
        got = self.settings
        wrong = [
            name
            for name, number in self.numbers.items()
            if not number.agrees_with(getattr(asked, name), tolerances[name])
        ]
        if asked.waveform != self.waveform:
            wrong = ["waveform"]
        elif asked.waveform != "steady" and asked.sync_output != self.sync_output:
            wrong.append("sync_output")
        return [f"{name}: asked {getattr(asked, name)}, got {getattr(got, name)}" for name in wrong]


@dataclass(frozen=True)
class HeaderDialect:
    """SCPI commands with one header a setting."""

    source: str = ""  # Prefix of the headers of the signal: "" or "SOUR1:"
    output_header: str = "OUTP"  # Header of the output switch: "OUTP" or "OUTP1"

    # What modulates: Keysight 33500B has all up to SUM, Rigol's DG series those up to HARM; MOD ends any of a DG's.
    MODULATIONS = (
        *("AM", "FM", "PM", "PWM", "FSK", "BPSK", "SUM"),
        *("MOD", "ASK", "PSK", "QPSK", "OSK", "3FSK", "4FSK", "IQ", "HARM"),
    )

    def load(self, load: Load) -> Mode:
        """Return the load, which is not "unchanged", as it is set and read back."""
        return Mode("load", f"{self.output_header}:LOAD", ("INF" if load == "high-z" else "50",))

    def modes(self) -> Iterator[Mode]:
        """Return what may be left behind, in the order in which it is ended."""
        yield Mode("burst", f"{self.source}BURS:STAT")
        yield Mode("sweep", f"{self.source}SWE:STAT")
        for name in self.MODULATIONS:
            yield Mode(f"modulation {name}", f"{self.source}{name}:STAT")
        yield Mode("output's polarity", f"{self.output_header}:POL", ("NORM",))
        yield Mode("unit of the levels", f"{self.source}VOLT:UNIT", ("VPP",))
        yield Mode("range of the levels", f"{self.source}VOLT:RANG:AUTO", ("ON",))
        if not self.source:
            return
        yield Mode("output's gate", f"{self.output_header}:MODE", ("NORM",))
        yield Mode("list of frequencies", f"{self.source}FREQ:MODE", ("CW", "FIX"))
        yield Mode("phase", f"{self.source}PHAS", ("0",))
        for channel in ("SOUR1", "SOUR2"):
            yield Mode(f"tracking of {channel}", f"{channel}:TRAC")
        yield Mode("sum of both channels", f"{self.source}COMB:FEED", ("NONE",))
        for coupled in ("FREQ:COUP", "VOLT:COUP"):
            yield Mode("coupling of the channels", f"{self.source}{coupled}:STAT")
        yield Mode("coupling of the channels", "COUP:STAT")
        yield Mode("sync output's mode", f"{self.output_header}:SYNC:MODE", ("NORM",))
        yield Mode("sync output's delay", f"{self.output_header}:SYNC:DEL", ("0",))
        yield Mode("noise on the output", f"{self.output_header}:NOIS:STAT")
        yield Mode("sync output's channel", "OUTP:SYNC:SOUR", ("CH1",))

    def sync_polarity(self) -> Mode | None:
        """Return the polarity of the sync output: NORM of a Keysight 33500B, POS of a Rigol; a 33220A has none."""
        if not self.source:
            return None
        return Mode("sync output's polarity", f"{self.output_header}:SYNC:POL", ("NORM", "POS"))

    def is_set(self, mode: Mode, answer: str) -> bool:
        """Whether the answer to a mode's query is the wanted state."""
        number = read_quantity(answer)
        if number is not None:
            wanted = {"OFF": 0.0, "ON": 1.0, "0": 0.0, "50": 50.0, "INF": _INFINITE}.get(mode.words[0])
            return min(number.value, _INFINITE) == wanted
        return answer.strip('"').upper().startswith(mode.words)

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
        commands = [
            ("waveform", f"{source}FUNC {_SHORT[wanted.waveform]}"),
            ("frequency", f"{source}FREQ {wanted.frequency_hz:.12g}"),
        ]
        if wanted.waveform == "square":
            commands.append(("duty", f"{source}FUNC:SQU:DCYC {wanted.duty_percent:.6g}"))
        high = ("high level", f"{source}VOLT:HIGH {wanted.high_v:.6g}")
        low = ("low level", f"{source}VOLT:LOW {wanted.low_v:.6g}")
        commands += [high, low] if wanted.high_v > present_low_v else [low, high]
        sync = "ON" if wanted.sync_output else "OFF"
        return [*commands, ("sync", f"{self.output_header}:SYNC {sync}")]

    def output(self, on: bool) -> Setting:
        """Return the command for the output."""
        return "output", f"{self.output_header} {'ON' if on else 'OFF'}"

    def query_low_v(self, line: ScpiLine) -> float:
        """Ask for the low level, in volts."""
        return line.query_quantity(f"{self.source}VOLT:LOW?", "V").value

    def query_settings(self, line: ScpiLine, *, backwards: bool) -> GeneratorReading:
        """Ask for all settings, in one of two orders; refuse (`LightFault`) what is no square, sine or steady level.

        A reply that is one query late could be taken for an answer twice, but not when the two readings have different
        orders.
        """
        waveform = _waveform(line.query(f"{self.source}FUNC?"), line.name)
        if waveform == "steady":
            queries = {"high_v": "VOLT:OFFS?"}
        else:
            # In the two orders each number has different neighbours, so a reply that is one query late differs.
            queries = {"low_v": "VOLT:LOW?", "high_v": "VOLT:HIGH?", "frequency_hz": "FREQ?"}
        if waveform == "square":
            queries["duty_percent"] = "FUNC:SQU:DCYC?"
        order = reversed(queries) if backwards else iter(queries)
        numbers = {name: line.query_quantity(self.source + queries[name], _UNITS[name]) for name in order}
        sync = waveform != "steady" and line.query_switch(f"{self.output_header}:SYNC?")
        return GeneratorReading(waveform, sync, numbers)

    def query_output(self, line: ScpiLine) -> bool:
        """Ask whether the output is on. Another query comes first: a late answer to it is not that of a switch."""
        line.query(f"{self.source}FUNC?")
        return line.query_switch(f"{self.output_header}?")


class SiglentDialect:
    """Siglent's commands: settings of channel 1 as names and values, joined by commas.

    The answers begin with a short header, a long one or none, as ``CHDR`` was set.
    """

    def load(self, load: Load) -> Mode:
        """See `HeaderDialect.load`."""
        return Mode("load", "C1:OUTP", (f"LOAD,{'HZ' if load == 'high-z' else '50'}",))

    def modes(self) -> Iterator[Mode]:
        """See `HeaderDialect.modes`."""
        for name, header in {"modulation": "MDWV", "sweep": "SWWV", "burst": "BTWV"}.items():
            yield Mode(f"{name}", f"C1:{header}", ("STATE,OFF",))
        yield Mode("output's polarity", "C1:OUTP", ("PLRT,NOR",))
        yield Mode("inversion", "C1:INVT")
        yield Mode("noise on the output", "C1:NOISE_ADD", ("STATE,OFF",))
        yield Mode("sum of both channels", "C1:CMBN")
        for coupled in ("TRACE", "FCOUP", "PCOUP", "ACOUP", "STATE"):
            yield Mode("coupling of the channels", "COUP", (f"{coupled},OFF",))

    def sync_polarity(self) -> Mode | None:
        """See `HeaderDialect.sync_polarity`. The polarity is fixed."""
        return None

    def is_set(self, mode: Mode, answer: str) -> bool:
        """See `HeaderDialect.is_set`. An answer that does not name what the mode is about tells of a lack of it."""
        words = f",{_without_header(answer, mode.header.removeprefix('C1:')).upper()},".replace(" ", "")
        name, comma, _ = mode.words[0].rpartition(",")
        return f",{mode.words[0]}," in words or (bool(comma) and f",{name}," not in words)

    def settings(self, wanted: LightSettings, present_low_v: float) -> list[Setting]:
        """See `HeaderDialect.settings`. Each is a command of its own.

        An SDG1032X loses the command after one that has the waveform and more; a BK 4055B hangs at 52 bytes by USB.
        """
        basic = [("waveform", f"WVTP,{_LONG[wanted.waveform]}")]
        if wanted.waveform == "steady":
            basic.append(("steady level", f"OFST,{wanted.high_v:.6g}"))
            return _basic_wave(basic)
        high, low = ("high level", f"HLEV,{wanted.high_v:.6g}"), ("low level", f"LLEV,{wanted.low_v:.6g}")
        basic.append(("frequency", f"FRQ,{wanted.frequency_hz:.12g}"))
        basic += [high, low] if wanted.high_v > present_low_v else [low, high]
        if wanted.waveform == "square":
            basic.append(("duty", f"DUTY,{wanted.duty_percent:.6g}"))
        commands = _basic_wave([*basic, ("phase", "PHSE,0")])
        if wanted.waveform == "sine":
            commands.append(("harmonics", "C1:HARM HARMSTATE,OFF"))
        if not wanted.sync_output:
            return [*commands, ("sync", "C1:SYNC OFF")]
        # The channel stands alone, because a generator without this choice may ignore the whole.
        return [*commands, ("sync channel", "C1:SYNC ON,TYPE,CH1"), ("sync", "C1:SYNC ON")]

    def output(self, on: bool) -> Setting:
        """See `HeaderDialect.output`."""
        return "output", f"C1:OUTP {'ON' if on else 'OFF'}"

    def query_low_v(self, line: ScpiLine) -> float:
        """See `HeaderDialect.query_low_v`."""
        text = self._query_fields(line, "BSWV")
        return self._read_number(line, text, "LLEV" if "LLEV," in text else "OFST", "V").value

    def query_settings(self, line: ScpiLine, *, backwards: bool) -> GeneratorReading:  # noqa: ARG002 - answers carry their names
        """See `HeaderDialect.query_settings`."""
        text = self._query_fields(line, "BSWV")
        waveform = _waveform(text.partition("WVTP,")[2].partition(",")[0], line.name)
        names = dict(_FIELDS) if waveform != "steady" else {"high_v": "OFST"}
        if waveform != "square":
            names.pop("duty_percent", None)
        numbers = {name: self._read_number(line, text, field, _UNITS[name]) for name, field in names.items()}
        return GeneratorReading(waveform, waveform != "steady" and self._query_switch(line, "SYNC"), numbers)

    def query_output(self, line: ScpiLine) -> bool:
        """See `HeaderDialect.query_output`."""
        return self._query_switch(line, "OUTP")

    def _query_fields(self, line: ScpiLine, header: str) -> str:
        """Return the answer without its header; refuse that to another query."""
        text = line.query(f"C1:{header}?")
        fields = _without_header(text, header)
        begins = {"BSWV": "WVTP,", "OUTP": "(ON|OFF),.*(LOAD|PLRT),", "SYNC": "(ON|OFF)(,TYPE,.*)?$"}[header]
        if not re.match(begins, fields, re.IGNORECASE):
            raise line.garbled_reply(f"C1:{header}? answered {text!r}.", READABLE_REMEDY)
        return fields.upper() if header != "BSWV" else fields

    def _query_switch(self, line: ScpiLine, header: str) -> bool:
        return self._query_fields(line, header).startswith("ON")

    def _read_number(self, line: ScpiLine, text: str, name: str, unit: str) -> Quantity:
        """Read a number after its name, as in ``FRQ,60HZ``; it may have a decimal comma, too."""
        match = re.search(rf"(?:^|,){name},(.*?)(?=,[A-Z]|$)", text, re.IGNORECASE)
        quantity = read_quantity(match[1], unit) if match else None
        if quantity is None:
            raise line.garbled_reply(f"no number {name} in {text!r}.", READABLE_REMEDY)
        return quantity


def _basic_wave(words: Sequence[Setting]) -> list[Setting]:
    return [(name, f"C1:BSWV {word}") for name, word in words]


def _without_header(answer: str, header: str) -> str:
    """Return a Siglent's answer without its short or long header, if it has one; the blank after it may be missing."""
    return re.sub(rf"^(C1:)?({_LONG_HEADERS[header]}|{header}) ?", "", answer, flags=re.IGNORECASE)


Dialect = HeaderDialect | SiglentDialect

DIALECTS: Final[Mapping[DialectName, Dialect]] = {
    "keysight": HeaderDialect(),
    "numbered": HeaderDialect("SOUR1:", "OUTP1"),
    "siglent": SiglentDialect(),
}


def _waveform(word: str, where: str) -> Waveform:
    word = word.strip('"').upper()
    if word in {"SQU", "SQUARE"}:
        return "square"
    if word in {"SIN", "SINE", "SINUSOID"}:
        return "sine"
    if word == "DC":
        return "steady"
    raise LightFault(
        f"the generator's waveform is {word!r}, neither a square, a sine nor a steady level.",
        where=where,
        remedy="Apply the light's settings first.",
    )
