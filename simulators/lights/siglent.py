"""Simulated function generators of Siglent's SDG series: they understand Siglent's commands."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Final

from simulators.lights.generators import Generator, Setting, Shape
from simulators.world.world import LightState

_HEADER: Final = re.compile(r"C1:(BSWV|OUTP|SYNC|MDWV|SWWV|BTWV|CMBN|INVT)(\?)?(?:\s+(.*))?", re.IGNORECASE)
_LONG: Final[Mapping[str, str]] = {
    "BSWV": "BASIC_WAVE",
    "OUTP": "OUTPUT",
    "MDWV": "MODULATEWAVE",
    "SWWV": "SWEEPWAVE",
    "BTWV": "BURSTWAVE",
    "CMBN": "COMBINE",
    "INVT": "INVERT",
}
_NUMBER: Final = re.compile(r"([+-]?[0-9]+\.?[0-9]*(?:E[+-]?[0-9]+)?)(?:HZ|V)?")
_SIGLENT_SHAPES: Final[Mapping[str, Shape]] = {"SQUARE": "square", "SINE": "sine", "DC": "dc"}
_VALUES: Final[Mapping[str, Setting]] = {
    "FRQ": "frequency",
    "DUTY": "duty",
    "OFST": "offset",
    "HLEV": "high",
    "LLEV": "low",
}


class SiglentGenerator(Generator):
    """A generator of Siglent's SDG series: it ignores unknown commands and clips values, and reports neither.

    With ``loses_next`` it loses the message after a `BSWV` with the waveform and more, as an SDG1032X with firmware
    1.01.01.33R1 does.
    """

    LEFT = ("CHDR-LONG", "CHDR-OFF", "MDWV", "SWWV", "BTWV", "CMBN", "PLRT", "INVT")

    def __init__(
        self,
        serial: str,
        clock: Callable[[], float],
        drive: Callable[[LightState], None] = lambda _state: None,
        *,
        loses_next: bool = False,
    ) -> None:
        super().__init__(clock, drive, 9600)
        self._serial = serial
        self._header = "SHORT"
        self._may_lose, self._loses_next = loses_next, False

    def leave(self, what: str) -> None:
        """See `LightDriver.leave`."""
        if what in {"CHDR-LONG", "CHDR-OFF"}:
            self._header = what.removeprefix("CHDR-")
        else:
            super().leave(what)

    def exchange(self, serial: str) -> None:
        """See `LightDriver.exchange`."""
        self._serial = serial
        self.reset()

    # ------------------------------------------------------------------ commands
    def _execute(self, message: str) -> list[str]:
        answers = (self._said(command.strip()) for command in message.split(";"))
        return [answer for answer in answers if answer]

    def _said(self, command: str) -> str:
        if self._loses_next:
            self._loses_next = False
            return ""
        match = _HEADER.fullmatch(command)
        if match is not None:
            words = [word.strip().upper() for word in (match[3] or "").split(",")]
            return self._ask(match[1].upper()) if match[2] else self._set(match[1].upper(), words)
        if command.upper() == "*IDN?":
            return f"Siglent Technologies,SDG1032X,{self._serial},1.01.01.33R6"
        return ""

    def _ask(self, name: str) -> str:
        begins = {"SHORT": f"C1:{name} ", "LONG": f"C1:{_LONG.get(name, name)} "}.get(self._header, "")
        answers = {"BSWV": self._wave, "OUTP": self._output, "SYNC": self._sync_output}
        return begins + (answers[name]() if name in answers else self._mode(name))

    def _set(self, name: str, words: list[str]) -> str:
        setters = {"BSWV": self._set_wave, "OUTP": self._set_output, "SYNC": self._set_sync}
        if name in setters:
            setters[name](words)
        else:
            self.modulate(name, on=words[-1] == "ON")
        return ""

    def _mode(self, name: str) -> str:
        return f"{'' if name in {'CMBN', 'INVT'} else 'STATE,'}{'ON' if name in self.modulations else 'OFF'}"

    def _set_wave(self, words: list[str]) -> None:
        self._loses_next = self._may_lose and "WVTP" in words and len(words) > 2
        for name, value in zip(words[::2], words[1::2], strict=False):
            number = _siglent_number(value)
            if name == "WVTP" and value in _SIGLENT_SHAPES:
                self.change(shape=_SIGLENT_SHAPES[value])
            elif name in _VALUES and number is not None:
                self.set(_VALUES[name], number)

    def _set_output(self, words: list[str]) -> None:
        if words[0] in {"ON", "OFF"}:
            self.change(output=words[0] == "ON")
        if words[0] == "PLRT":
            self.modulate("PLRT", on=words[-1] == "INVT")
        if "LOAD" in words[:-1]:
            load = words[words.index("LOAD") + 1]
            ohm = math.inf if load == "HZ" else _siglent_number(load)
            if ohm is not None and ohm >= 1.0:
                self.set_load(ohm)

    def _set_sync(self, words: list[str]) -> None:
        if words[0] in {"ON", "OFF"}:
            self.change(sync=words[0] == "ON")

    def _wave(self) -> str:
        now = self.settings
        if now.shape == "dc":
            return f"WVTP,DC,OFST,{now.offset_v:g}V"
        shape = "SQUARE" if now.shape == "square" else "SINE"
        duty = f",DUTY,{now.duty_percent:g}" if now.shape == "square" else ""
        return (
            f"WVTP,{shape},FRQ,{now.frequency_hz:.10g}HZ,PERI,{1.0 / now.frequency_hz:.6g}S,"
            f"AMP,{now.amplitude_v:g}V,OFST,{now.offset_v:g}V,HLEV,{now.high_v:g}V,LLEV,{now.low_v:g}V,PHSE,0{duty}"
        )

    def _output(self) -> str:
        now = self.settings
        load = "HZ" if math.isinf(now.load_ohm) else f"{now.load_ohm:g}"
        polarity = "INVT" if "PLRT" in self.modulations else "NOR"
        return f"{'ON' if now.output else 'OFF'},LOAD,{load},PLRT,{polarity}"

    def _sync_output(self) -> str:
        return f"{'ON' if self.settings.sync else 'OFF'}"


def _siglent_number(text: str) -> float | None:
    """Read a number, which may end in its unit; None if the text is no number."""
    match = _NUMBER.fullmatch(text)
    return float(match[1]) if match else None
