"""A function generator that speaks SCPI: the Keysight 33250A, or a Rigol DG4000, which numbers its channels.

A value out of range is clipped, and only the error queue says so. `scpi` holds the syntax, `generator` the
instrument. References: Keysight 33250A user's guide, remote interface reference; Rigol DG4000 programming guide.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from simulators.lights.generator import ClipReason, Setting, Shape
from simulators.lights.generator_line import GeneratorLine
from simulators.lights.scpi import (
    CommandTree,
    ErrorQueue,
    ScpiError,
    boolean,
    choice,
    expect_no_arguments,
    number,
    only_argument,
)
from simulators.world.world import LightState

_HERTZ: Final = {"UHZ": 1e-6, "HZ": 1.0, "KHZ": 1e3, "MHZ": 1e6}
_VOLTS: Final = {"MV": 1e-3, "V": 1.0, "VPP": 1.0, "MVPP": 1e-3}
_PERCENT: Final = {"PCT": 1.0, "%": 1.0}
_OHMS: Final = {"OHM": 1.0, "KOHM": 1e3}
_LOAD_OHM: Final = (1.0, 10_000.0)

_SHAPES: Final[Mapping[str, Shape]] = {"SINusoid": "sine", "SQUare": "square", "DC": "dc"}

_CLIP_ERRORS: Final = {
    "lower limit": (-222, "value clipped to lower limit"),
    "upper limit": (-222, "value clipped to upper limit"),
    "conflict": (-221, "the other level has been adjusted"),
}


@dataclass(frozen=True)
class GeneratorModel:
    """Identity of a generator, and its variant of the language."""

    # serial, maker, name, firmware: Fields of the answer to ``*IDN?``.
    serial: str = "SG0042"
    maker: str = "Keysight Technologies"
    name: str = "33250A"
    firmware: str = "2.05-1.01-2.00-03-2"
    error_queue: bool = True  # Whether it answers ``SYST:ERR?``; some generators do not
    # Whether headers carry a channel number (``SOUR1:FREQ``, ``OUTP1``), and the state of the output is read
    # as ON or OFF instead of 1 or 0.
    numbered_channels: bool = False
    baud: int = 9600


class ScpiGenerator(GeneratorLine):
    """The generator, as a dialect of a serial line.

    clock: Returns the time in seconds.
    """

    def __init__(
        self,
        model: GeneratorModel,
        clock: Callable[[], float],
        drive: Callable[[LightState], None] = lambda _state: None,
    ) -> None:
        super().__init__(clock, drive)
        self.model = model
        self._tree = CommandTree(ErrorQueue())
        self._register_commands()

    @property
    def baud(self) -> int:
        """Baud rate of the serial port."""
        return self.model.baud

    def exchange(self, serial: str) -> None:
        """See `GeneratorLine.exchange`."""
        self.model = replace(self.model, serial=serial)
        self._tree.errors.clear()
        self._generator.reset()

    # ------------------------------------------------------------------ commands
    def _execute(self, message: str) -> list[str]:
        answer = self._tree.answer(message)
        return [] if answer is None else [answer]

    def _register_commands(self) -> None:
        tree, model, generator = self._tree, self.model, self._generator
        source, output = ("[:SOURce#]", "OUTPut#") if model.numbered_channels else ("[:SOURce]", "OUTPut")
        tree.add("*IDN", None, lambda _: self._identity())
        tree.add("*RST", self._reset, None)
        tree.add("*CLS", lambda _: tree.errors.clear(), None)
        tree.add("*OPC", expect_no_arguments, lambda _: "1")
        tree.add("*WAI", expect_no_arguments, None)
        if model.error_queue:
            tree.add("SYSTem:ERRor[:NEXT]", None, lambda _: tree.errors.next())
        for word in ("REMote", "LOCal", "RWLock"):
            tree.add(f"SYSTem:{word}", expect_no_arguments, None)
        tree.add(f"{source}:FUNCtion[:SHAPe]", self._set_shape, lambda _: self._shape())
        self._register_value(
            f"{source}:FREQuency", "frequency", _HERTZ, lambda: generator.settings.frequency_hz
        )
        self._register_value(
            f"{source}:FUNCtion:SQUare:DCYCle", "duty", _PERCENT, lambda: generator.settings.duty_percent
        )
        self._register_value(f"{source}:VOLTage", "amplitude", _VOLTS, lambda: generator.settings.amplitude_v)
        self._register_value(
            f"{source}:VOLTage:OFFSet", "offset", _VOLTS, lambda: generator.settings.offset_v
        )
        self._register_value(f"{source}:VOLTage:HIGH", "high", _VOLTS, lambda: generator.settings.high_v)
        self._register_value(f"{source}:VOLTage:LOW", "low", _VOLTS, lambda: generator.settings.low_v)
        tree.add(f"{source}:VOLTage:UNIT", self._set_unit, lambda _: "VPP")
        tree.add(
            f"{output}[:STATe]",
            lambda words: generator.switch(output=boolean(only_argument(words))),
            lambda _: self._format_switch(generator.settings.output),
        )
        tree.add(
            f"{output}:SYNC[:STATe]",
            lambda words: generator.switch(sync=boolean(only_argument(words))),
            lambda _: self._format_switch(generator.settings.sync),
        )
        if model.numbered_channels:
            tree.add(
                f"{output}:SYNC:POLarity",
                lambda words: generator.invert_sync(
                    choice(only_argument(words), self._sync_words()) in {"INV", "NEG"}
                ),
                lambda _: choice(self._sync_words()[generator.settings.sync_inverted], self._sync_words()),
            )
        tree.add(
            f"{output}:LOAD",
            self._set_load,
            lambda _: _format_number(min(generator.settings.load_ohm, 9.9e37)),
        )

    def _register_value(
        self, header: str, name: Setting, unit_factors: dict[str, float], read: Callable[[], float]
    ) -> None:
        """Register a number: command, query, and query of a bound, as in ``FREQ? MAX``."""

        def set_value(arguments: list[str]) -> None:
            word = only_argument(arguments)
            bound = _bound(word)
            lowest_highest = self._generator.bounds(name)
            value = number(word, unit_factors) if bound is None else lowest_highest[bound]
            _raise_if_clipped(self._generator.set(name, value))

        def read_value(arguments: list[str]) -> str:
            if not arguments:
                return _format_number(read())
            bound = _bound(only_argument(arguments))
            if bound is None:
                raise ScpiError(-224)
            return _format_number(self._generator.bounds(name)[bound])

        self._tree.add(header, set_value, read_value)

    def _identity(self) -> str:
        model = self.model
        return f"{model.maker},{model.name},{model.serial},{model.firmware}"

    def _reset(self, arguments: list[str]) -> None:
        expect_no_arguments(arguments)
        self._generator.reset()

    def _set_unit(self, arguments: list[str]) -> None:
        """Take the unit of the amplitude; Vrms and dBm are not simulated."""
        choice(only_argument(arguments), ["VPP"])

    def _set_shape(self, arguments: list[str]) -> None:
        word = choice(only_argument(arguments), list(_SHAPES))
        self._generator.set_shape(next(shape for name, shape in _SHAPES.items() if name.startswith(word)))

    def _shape(self) -> str:
        return {"square": "SQU", "sine": "SIN", "dc": "DC"}[self._generator.settings.shape]

    def _set_load(self, arguments: list[str]) -> None:
        word = only_argument(arguments)
        if word.upper() in {"INF", "INFINITY"}:
            self._generator.set_load(math.inf)
            return
        asked = number(word, _OHMS)
        self._generator.set_load(min(max(asked, _LOAD_OHM[0]), _LOAD_OHM[1]))
        _raise_if_clipped(
            "lower limit" if asked < _LOAD_OHM[0] else "upper limit" if asked > _LOAD_OHM[1] else ""
        )

    def _sync_words(self) -> list[str]:
        """Return the words for the polarities of the sync output: of Rigol's DG series, or of Keysight's 33500B."""
        if self.model.maker.upper().startswith("RIGOL"):
            return ["POSitive", "NEGative"]
        return ["NORMal", "INVerted"]

    def _format_switch(self, on: bool) -> str:
        if self.model.numbered_channels:
            return "ON" if on else "OFF"
        return str(int(on))


def _bound(word: str) -> int | None:
    """Return 0 for the word that means the lower bound, 1 for the upper bound, None for any other word."""
    if word.upper() in {"MIN", "MINIMUM"}:
        return 0
    return 1 if word.upper() in {"MAX", "MAXIMUM"} else None


def _raise_if_clipped(held: ClipReason) -> None:
    """Raise the SCPI error that reports a clipped value; the command tree queues it."""
    if held:
        raise ScpiError(*_CLIP_ERRORS[held])


def _format_number(value: float) -> str:
    """Format a number as the 33250A does."""
    return f"{value:+.13E}"
