"""Knows how different makes of function generators say the same things. Decides nothing.

``keysight``: 33220A, 33250A and what copies them, one channel without a number. (Not the 33120A, which has neither
levels nor an output switch.)
``numbered``: ``SOUR1:`` and ``OUTP1``, as Keysight 33500B and Rigol DG have it. (Not Tektronix AFG, which has a duty
cycle for pulses alone.)
``siglent``: SDG, all settings of a channel in one command, ``C1:BSWV``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Literal, Protocol

from drivers.errors import LightFault
from drivers.light import LightSettings, Waveform
from drivers.scpi_line import ScpiLine

Load = Literal["high-z", "50-ohm", "unchanged"]
"""What the generator takes its output to be connected to: its levels are those at this load."""

DialectName = Literal["keysight", "numbered", "siglent"]

Setting = tuple[str, str]
"""Name of a setting, for messages, and the command that makes it."""


_SHORT: dict[Waveform, str] = {"square": "SQU", "sine": "SIN", "steady": "DC"}
_LONG: dict[Waveform, str] = {"square": "SQUARE", "sine": "SINE", "steady": "DC"}


def _steady(level_v: float) -> LightSettings:
    """Give the settings of a light that burns at a level."""
    return LightSettings(waveform="steady", low_v=level_v, high_v=level_v, sync_output=False)


class Dialect(Protocol):
    """How a make of generators says what a flicker light needs."""

    def load(self, load: Load) -> Setting:
        """Command for the load."""
        ...

    def plain(self) -> list[Setting]:
        """Commands that end what somebody may have left on: bursts, sweeps, modulations, a turned polarity."""
        ...

    def settings(self, wanted: LightSettings, present_low_v: float) -> list[Setting]:
        """Commands for everything but the output, in an order in which no step contradicts the last."""
        ...

    def output(self, on: bool) -> Setting:
        """Command for the output."""
        ...

    def low_v(self, line: ScpiLine) -> float:
        """Ask for the low level."""
        ...

    def read(self, line: ScpiLine, *, backwards: bool) -> LightSettings:
        """Ask for all settings, in one order or the other. Raises LightFault when the waveform is none of ours.

        A reply that comes one question late, twice in the same place, would pass for an answer; not in two orders.
        """
        ...

    def is_on(self, line: ScpiLine) -> bool:
        """Ask whether the output is on."""
        ...


@dataclass(frozen=True)
class HeaderDialect:
    """One header a setting, as SCPI has it.

    Attributes
    ----------
    source
        Put before the headers of the signal, "" or "SOUR1:".
    output_header
        Header of the output switch, "OUTP" or "OUTP1".
    """

    source: str = ""
    output_header: str = "OUTP"

    def load(self, load: Load) -> Setting:
        """Command for the load."""
        return "load", f"{self.output_header}:LOAD {'INF' if load == 'high-z' else '50'}"

    def plain(self) -> list[Setting]:
        """Commands that end bursts, sweeps and modulations, and turn the output upright."""
        modes = {"burst": "BURS", "sweep": "SWE", "amplitude": "AM", "frequency": "FM", "shift keying": "FSK"}
        off = [(name, f"{self.source}{header}:STAT OFF") for name, header in modes.items()]
        return [*off, ("polarity", f"{self.output_header}:POL NORM")]

    def settings(self, wanted: LightSettings, present_low_v: float) -> list[Setting]:
        """Commands for everything but the output; high stays above low in between, whatever they were."""
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
        """Command for the output."""
        return "output", f"{self.output_header} {'ON' if on else 'OFF'}"

    def low_v(self, line: ScpiLine) -> float:
        """Ask for the low level."""
        return line.number(f"{self.source}VOLT:LOW?")

    def read(self, line: ScpiLine, *, backwards: bool) -> LightSettings:
        """Ask for all settings."""
        source = self.source
        waveform = _waveform(line.ask(f"{source}FUNC?"), line.name)
        if waveform == "steady":
            return _steady(line.number(f"{source}VOLT:OFFS?"))
        # Each number has other neighbours in the two orders, or a word; none of them could be equal to it.
        queries = {"low_v": "VOLT:LOW?", "high_v": "VOLT:HIGH?", "frequency_hz": "FREQ?"}
        if waveform == "square":
            queries["duty_percent"] = "FUNC:SQU:DCYC?"
        order = reversed(queries) if backwards else iter(queries)
        numbers = {name: line.number(source + queries[name]) for name in order}
        return LightSettings(waveform, sync_output=line.switch(f"{self.output_header}:SYNC?"), **numbers)

    def is_on(self, line: ScpiLine) -> bool:
        """Ask whether the output is on, after something else whose answer is no switch's."""
        line.ask(f"{self.source}FUNC?")
        return line.switch(f"{self.output_header}?")


class SiglentDialect:
    """All settings of channel 1 in one command of names and values, joined by commas."""

    def load(self, load: Load) -> Setting:
        """Command for the load."""
        return "load", f"C1:OUTP LOAD,{'HZ' if load == 'high-z' else '50'}"

    def plain(self) -> list[Setting]:
        """Commands that end bursts, sweeps and modulations, and turn the output upright."""
        modes = {"burst": "BTWV", "sweep": "SWWV", "modulation": "MDWV"}
        off = [(name, f"C1:{header} STATE,OFF") for name, header in modes.items()]
        return [*off, ("polarity", "C1:OUTP PLRT,NOR")]

    def settings(self, wanted: LightSettings, present_low_v: float) -> list[Setting]:  # noqa: ARG002
        """Commands for everything but the output; both levels go in one, so their order does not matter."""
        if wanted.waveform == "steady":
            return [("steady level", f"C1:BSWV WVTP,DC,OFST,{wanted.high_v:.6g}")]
        words = [f"WVTP,{_LONG[wanted.waveform]}", f"FRQ,{wanted.frequency_hz:.12g}"]
        words += [f"HLEV,{wanted.high_v:.6g}", f"LLEV,{wanted.low_v:.6g}"]
        if wanted.waveform == "square":
            words.append(f"DUTY,{wanted.duty_percent:.6g}")
        sync = "ON" if wanted.sync_output else "OFF"
        return [("flicker", f"C1:BSWV {','.join(words)}"), ("sync", f"C1:SYNC {sync}")]

    def output(self, on: bool) -> Setting:
        """Command for the output."""
        return "output", f"C1:OUTP {'ON' if on else 'OFF'}"

    def low_v(self, line: ScpiLine) -> float:
        """Ask for the low level."""
        fields = self._fields(line, "BSWV")
        return self._number(line, fields, "LLEV" if "LLEV" in fields else "OFST")

    def read(self, line: ScpiLine, *, backwards: bool) -> LightSettings:  # noqa: ARG002 - answers name themselves
        """Ask for all settings."""
        fields = self._fields(line, "BSWV")
        waveform = _waveform(fields.get("WVTP", ""), line.name)
        if waveform == "steady":
            return _steady(self._number(line, fields, "OFST"))
        settings = LightSettings(
            waveform=waveform,
            frequency_hz=self._number(line, fields, "FRQ"),
            low_v=self._number(line, fields, "LLEV"),
            high_v=self._number(line, fields, "HLEV"),
            sync_output=self._first(line, "SYNC") == "ON",
        )
        if waveform == "square":
            settings = replace(settings, duty_percent=self._number(line, fields, "DUTY"))
        return settings

    def is_on(self, line: ScpiLine) -> bool:
        """Ask whether the output is on."""
        return self._first(line, "OUTP") == "ON"

    def _words(self, line: ScpiLine, header: str) -> list[str]:
        text = line.ask(f"C1:{header}?").upper()
        start = f"C1:{header} "
        if not text.startswith(start):
            raise line.garbled(f"C1:{header}? answered {text!r}.")
        return text.removeprefix(start).split(",")

    def _first(self, line: ScpiLine, header: str) -> str:
        word = self._words(line, header)[0]
        if word not in {"ON", "OFF"}:
            raise line.garbled(f"C1:{header}? answered {word!r}, not on or off.")
        return word

    def _fields(self, line: ScpiLine, header: str) -> dict[str, str]:
        words = self._words(line, header)
        return dict(zip(words[::2], words[1::2], strict=False))

    def _number(self, line: ScpiLine, fields: dict[str, str], name: str) -> float:
        """Understand a number with its unit, as in ``60HZ`` or ``3.3V``."""
        match = re.fullmatch(r"([+-]?\d+(?:\.\d*)?(?:E[+-]?\d+)?)(?:HZ|V|%)?", fields.get(name, ""))
        if match is None or not math.isfinite(float(match[1])):
            raise line.garbled(f"no number {name} in {fields}.")
        return float(match[1])


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
        f"the generator makes {word!r}, neither a square, a sine nor a steady level.",
        where=where,
        remedy="Apply the light's settings first.",
    )
