"""Commands of function generators of several makes, for the settings that a flicker light needs.

``keysight``: 33220A, 33250A and compatible generators, with one channel without a number. (Not the 33120A, which has
neither levels nor an output switch.) Source: "Agilent 33220A 20 MHz Function/Arbitrary Waveform Generator User's
Guide", chapter "Remote Interface Reference".
``numbered``: channels with a number, ``SOUR1:`` and ``OUTP1``: Keysight 33500B, Rigol DG. (Not Tektronix AFG, which has
a duty cycle for pulses only.) Source: Keysight, "33500B Series: Operating and Service Guide".
``siglent``: SDG, all settings of a channel in one command, ``C1:BSWV``. Source: Siglent, "SDG Series Programming
Guide".
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

from drivers.errors import LightFault
from drivers.light import LightSettings, Waveform
from drivers.light.watched import steady_settings
from drivers.text_line import ScpiLine

Load = Literal["high-z", "50-ohm", "unchanged"]
"""Load that the generator assumes at its output; its levels are those at this load."""

DialectName = Literal["keysight", "numbered", "siglent"]

Setting = tuple[str, str]
"""Name of a setting, for messages, and the command that makes it."""


_SHORT: dict[Waveform, str] = {"square": "SQU", "sine": "SIN", "steady": "DC"}
_LONG: dict[Waveform, str] = {"square": "SQUARE", "sine": "SINE", "steady": "DC"}


class Dialect(Protocol):
    """Commands of one make of generators."""

    def load(self, load: Load) -> Setting:
        """Return the command for the load.

        load: The load; not "unchanged".
        """
        ...

    def reset_modes(self) -> list[Setting]:
        """Return the commands that end bursts, sweeps and modulations, and make the polarity normal."""
        ...

    def normal_sync(self) -> Sequence[str]:
        """Return commands of which one makes the polarity of the sync output normal.

        Returns: Commands, to be sent until one is accepted; empty for a generator with a fixed polarity.
        """
        ...

    def settings(self, wanted: LightSettings, present_low_v: float) -> list[Setting]:
        """Return the commands for all settings but the output, in an order in which the generator accepts each.

        present_low_v: Its present low level, in volts: the high level must stay above the low level after
          every command.
        """
        ...

    def output(self, on: bool) -> Setting:
        """Return the command for the output.

        on: Whether the output shall be on.
        """
        ...

    def query_low_v(self, line: ScpiLine) -> float:
        """Ask for the low level."""
        ...

    def query_settings(self, line: ScpiLine, *, backwards: bool) -> LightSettings:
        """Ask for all settings, in one of two orders.

        A reply that is one query late could be taken for an answer twice, but not when the two readings have different
        orders.

        backwards: Whether to ask in the second order.
        Raises LightFault: The waveform is neither a square, a sine nor a steady level.
        """
        ...

    def query_output(self, line: ScpiLine) -> bool:
        """Ask whether the output is on.

        Returns: Whether it is.
        """
        ...


@dataclass(frozen=True)
class HeaderDialect:
    """SCPI commands with one header a setting."""

    source: str = ""  # Prefix of the headers of the signal: "" or "SOUR1:"
    output_header: str = "OUTP"  # Header of the output switch: "OUTP" or "OUTP1"

    def load(self, load: Load) -> Setting:
        """See `Dialect.load`."""
        return "load", f"{self.output_header}:LOAD {'INF' if load == 'high-z' else '50'}"

    def reset_modes(self) -> list[Setting]:
        """See `Dialect.reset_modes`."""
        modes = {"burst": "BURS", "sweep": "SWE", "amplitude": "AM", "frequency": "FM", "shift keying": "FSK"}
        off = [(name, f"{self.source}{header}:STAT OFF") for name, header in modes.items()]
        return [*off, ("polarity", f"{self.output_header}:POL NORM")]

    def normal_sync(self) -> Sequence[str]:
        """See `Dialect.normal_sync`. Keysight 33500B says NORM, Rigol DG1000Z POS; a 33220A has no such setting."""
        return [f"{self.output_header}:SYNC:POL {word}" for word in ("NORM", "POS")] if self.source else []

    def settings(self, wanted: LightSettings, present_low_v: float) -> list[Setting]:
        """See `Dialect.settings`."""
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
        """See `Dialect.output`."""
        return "output", f"{self.output_header} {'ON' if on else 'OFF'}"

    def query_low_v(self, line: ScpiLine) -> float:
        """See `Dialect.query_low_v`."""
        return line.query_number(f"{self.source}VOLT:LOW?")

    def query_settings(self, line: ScpiLine, *, backwards: bool) -> LightSettings:
        """See `Dialect.query_settings`."""
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
        """See `Dialect.query_output`. Another query comes first: a late answer to it is not that of a switch."""
        line.query(f"{self.source}FUNC?")
        return line.query_switch(f"{self.output_header}?")


class SiglentDialect:
    """Siglent's commands: all settings of channel 1 in one command of names and values, joined by commas."""

    def load(self, load: Load) -> Setting:
        """See `Dialect.load`."""
        return "load", f"C1:OUTP LOAD,{'HZ' if load == 'high-z' else '50'}"

    def reset_modes(self) -> list[Setting]:
        """See `Dialect.reset_modes`."""
        modes = {"burst": "BTWV", "sweep": "SWWV", "modulation": "MDWV"}
        off = [(name, f"C1:{header} STATE,OFF") for name, header in modes.items()]
        return [*off, ("polarity", "C1:OUTP PLRT,NOR")]

    def normal_sync(self) -> Sequence[str]:
        """See `Dialect.normal_sync`. The polarity is fixed."""
        return []

    def settings(self, wanted: LightSettings, present_low_v: float) -> list[Setting]:  # noqa: ARG002
        """See `Dialect.settings`. One command holds both levels, so their order does not matter."""
        if wanted.waveform == "steady":
            return [("steady level", f"C1:BSWV WVTP,DC,OFST,{wanted.high_v:.6g}")]
        words = [f"WVTP,{_LONG[wanted.waveform]}", f"FRQ,{wanted.frequency_hz:.12g}"]
        words += [f"HLEV,{wanted.high_v:.6g}", f"LLEV,{wanted.low_v:.6g}"]
        if wanted.waveform == "square":
            words.append(f"DUTY,{wanted.duty_percent:.6g}")
        sync = "ON" if wanted.sync_output else "OFF"
        return [("flicker", f"C1:BSWV {','.join(words)}"), ("sync", f"C1:SYNC {sync}")]

    def output(self, on: bool) -> Setting:
        """See `Dialect.output`."""
        return "output", f"C1:OUTP {'ON' if on else 'OFF'}"

    def query_low_v(self, line: ScpiLine) -> float:
        """See `Dialect.query_low_v`."""
        fields = self._query_fields(line, "BSWV")
        return self._parse_number(line, fields, "LLEV" if "LLEV" in fields else "OFST")

    def query_settings(self, line: ScpiLine, *, backwards: bool) -> LightSettings:  # noqa: ARG002 - answers carry their names
        """See `Dialect.query_settings`."""
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
        """See `Dialect.query_output`."""
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
