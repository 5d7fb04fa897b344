"""Function generators of three makes: the instrument, and its command languages.

The generator has one output with a square wave, a sine wave or a constant level. A value out of range is clipped to the
nearest possible one. Ranges follow the Keysight 33250A: at most 80 MHz, duty cycle 20 to 80 %, 10 V into an open
circuit, 50 ohm source (its user's guide).

`ScpiGenerator` is a Keysight 33250A, or a Rigol DG4000, which numbers its channels. References: Keysight 33250A user's
guide, remote interface reference; Rigol DG4000 programming guide. `SiglentGenerator` sets several values at once:

    C1:BSWV WVTP,SQUARE,FRQ,60HZ,...       waveform of channel 1: a name and a value for each setting
    C1:BSWV?                               answered by the same header and all settings
    C1:OUTP ON,LOAD,HZ                     output and load

Reference: programming guide of Siglent's SDG series.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

from simulators.lights.driver import LightDriver
from simulators.lights.scpi import (
    CommandTree,
    ErrorQueue,
    ScpiError,
    boolean,
    choice,
    number,
    only_argument,
)
from simulators.world.world import LightState, SyncLine

Shape = Literal["square", "sine", "dc"]
"""Waveforms; ``dc`` is a constant level at the offset."""
Setting = Literal["frequency", "duty", "offset", "high", "low"]

#: Reason why a value was clipped; empty if it was not.
ClipReason = Literal["", "lower limit", "upper limit", "conflict"]

#: Output resistance, ohm: the voltage into an open circuit is twice the voltage into 50 ohm.
SOURCE_OHM: Final = 50.0

_FREQUENCY_HZ: Final = (1e-6, 80e6)  # Of the Keysight 33250A, here and below
_DUTY_PERCENT: Final = (20.0, 80.0)

#: Largest level and smallest amplitude into an open circuit, V.
_MAX_V: Final = 10.0
_MIN_AMPLITUDE_V: Final = 0.002

#: Size of the input buffer, bytes.
_MAX_MESSAGE: Final = 2048
_LOAD_OHM: Final = (1.0, 10_000.0)  # Of the 33250A: the loads that it can be told

_VALUES: Final[tuple[tuple[str, Setting, str], ...]] = (
    ("FREQuency", "frequency", "frequency_hz"),
    ("FUNCtion:SQUare:DCYCle", "duty", "duty_percent"),
    ("VOLTage:OFFSet", "offset", "offset_v"),
    ("VOLTage:HIGH", "high", "high_v"),
    ("VOLTage:LOW", "low", "low_v"),
)
"""Header, name, and attribute of `Settings`, of each number."""

_SHAPES: Final[Mapping[str, Shape]] = {"SINusoid": "sine", "SQUare": "square", "DC": "dc"}

_CLIP_ERRORS: Final = {
    "lower limit": (-222, "value clipped to lower limit"),
    "upper limit": (-222, "value clipped to upper limit"),
    "conflict": (-221, "the other level has been adjusted"),
}


@dataclass(frozen=True)
class Settings:
    """All settings; the defaults are those after a reset."""

    shape: Shape = "sine"
    frequency_hz: float = 1000.0  # Frequency, Hz
    duty_percent: float = 50.0  # Duty cycle of the square wave, percent
    low_v: float = -0.05  # Lower level at the load that is set, V
    high_v: float = 0.05  # Upper level at the load that is set, V
    load_ohm: float = SOURCE_OHM
    output: bool = False  # Whether the output is on
    sync: bool = True  # Whether the sync output is on
    sync_inverted: bool = False  # Whether the sync output falls where it otherwise rises
    sync_channel: str = "CH1"  # Channel whose edges the sync output gives; only those of CH1 fit the light

    @property
    def amplitude_v(self) -> float:
        """Peak-to-peak amplitude, V."""
        return self.high_v - self.low_v

    @property
    def offset_v(self) -> float:
        """Mean of the two levels, V."""
        return (self.high_v + self.low_v) / 2.0


class Generator(LightDriver):
    """A function generator with one output, without its command language; ``most_v`` is the largest level, V."""

    def __init__(self, clock: Callable[[], float], drive: Callable[[LightState], None], baud: int) -> None:
        super().__init__(clock, drive, baud=baud, longest=_MAX_MESSAGE)
        self.most_v = _MAX_V
        self.settings = Settings()
        self.modulations: set[str] = set()
        self._publish()

    @abstractmethod
    def _execute(self, message: str) -> list[str]:
        """Execute a message and return its answers, one a line."""

    def _answer(self, message: bytes) -> bytes:
        answers = self._execute(message.decode("ascii", "replace"))
        return b"".join(f"{answer}\n".encode("ascii") for answer in answers)

    # ------------------------------------------------------------------ settings
    def reset(self) -> None:
        """Restore the settings of a reset."""
        self.settings = Settings()
        self.modulations.clear()
        self._publish()

    def modulate(self, name: str, *, on: bool) -> None:
        """Switch a modulation, a sweep or a burst."""
        (self.modulations.add if on else self.modulations.discard)(name)
        self._publish()

    def leave(self, what: str) -> None:
        """See `LightDriver.leave`."""
        if what not in self.LEFT:
            super().leave(what)
        self.modulate(what, on=True)

    def change(self, **settings: Any) -> None:
        """Change settings, which are in their range; the light follows."""
        self.settings = replace(self.settings, **settings)
        self._publish()

    def set_load(self, ohm: float) -> None:
        """Set the load for which voltages are shown; the output itself stays as it is."""
        scale = _voltage_share(ohm) / _voltage_share(self.settings.load_ohm)
        self.change(load_ohm=ohm, low_v=self.settings.low_v * scale, high_v=self.settings.high_v * scale)

    def set(self, name: Setting, value: float) -> ClipReason:
        """Set a value, clipped to its range."""
        lowest, highest = self.bounds(name)
        held: ClipReason = "lower limit" if value < lowest else "upper limit" if value > highest else ""
        value = min(max(value, lowest), highest)
        if name == "frequency":
            self.change(frequency_hz=round(value, 6))
        elif name == "duty":
            self.change(duty_percent=round(value, 1))
        else:
            moved = self._set_level(name, value)
            held = held or moved
        return held

    def bounds(self, name: Setting) -> tuple[float, float]:
        """Return the range of a setting, which depends on the other settings."""
        share = _voltage_share(self.settings.load_ohm)
        most, least = self.most_v * share, _MIN_AMPLITUDE_V * share
        half = self.settings.amplitude_v / 2.0
        ranges: dict[Setting, tuple[float, float]] = {
            "frequency": _FREQUENCY_HZ,
            "duty": _DUTY_PERCENT,
            "offset": (-most, most) if self.settings.shape == "dc" else (half - most, most - half),
            "high": (least - most, most),
            "low": (-most, most - least),
        }
        return ranges[name]

    def clip(self, most_v: float | None) -> None:
        """See `LightDriver.clip`; the voltage is that into an open circuit."""
        self.most_v = _MAX_V if most_v is None else most_v

    def trip(self) -> None:
        """Let the overload protection switch the output off, without a message."""
        self.change(output=False)

    # ------------------------------------------------------------------ inside
    def _set_level(self, name: Setting, value: float) -> ClipReason:
        """Set both levels from offset, high or low level; the other level gives way if necessary."""
        now, share = self.settings, _voltage_share(self.settings.load_ohm)
        least = _MIN_AMPLITUDE_V * share
        if name == "offset" and now.shape == "dc":
            # The amplitude has no effect on DC; it shrinks so that offset and amplitude fit the range later.
            half = min(now.amplitude_v / 2.0, max(self.most_v * share - abs(value), least / 2.0))
            self.change(low_v=value - half, high_v=value + half)
            return ""
        low_v, high_v = {
            "offset": (value - now.amplitude_v / 2.0, value + now.amplitude_v / 2.0),
            "high": (min(now.low_v, value - least), value),
            "low": (value, max(now.high_v, value + least)),
        }[name]
        most = self.most_v * share
        conflict = low_v < -most - 1e-9 or high_v > most + 1e-9
        conflict |= (name == "high" and low_v < now.low_v) or (name == "low" and high_v > now.high_v)
        self.change(low_v=round(max(low_v, -most), 4), high_v=round(min(high_v, most), 4))
        return "conflict" if conflict else ""

    def _publish(self) -> None:
        """Publish the state of the light."""
        settings = self.settings
        # Whatever modulates is shown as AM of 100 % depth, which halves the mean amplitude.
        high_v = settings.offset_v if self.modulations else settings.high_v
        levels = (settings.offset_v,) * 2 if settings.shape == "dc" else (settings.low_v, high_v)
        # The lamp's input is an open circuit: it gets the source voltage, whatever load is set.
        open_circuit = 1.0 / _voltage_share(settings.load_ohm)
        self._show(
            settings.frequency_hz,
            waveform="sine" if settings.shape == "sine" else "square",
            duty_percent=settings.duty_percent,
            low_v=levels[0] * open_circuit,
            high_v=levels[1] * open_circuit,
            output=settings.output,
            sync=settings.sync and settings.shape != "dc" and settings.sync_channel == "CH1",
            sync_line=SyncLine(inverted=settings.sync_inverted),
        )


def _voltage_share(load_ohm: float) -> float:
    """Return the voltage at a load as a share of the source voltage (voltage divider)."""
    return 1.0 if math.isinf(load_ohm) else load_ohm / (load_ohm + SOURCE_OHM)


@dataclass(frozen=True)
class GeneratorModel:
    """Identity of a generator, and its variant of the language."""

    serial: str = "SG0042"  # Serial number in the answer to ``*IDN?``
    maker: str = "Keysight Technologies"  # Maker in that answer
    name: str = "33250A"  # Model in that answer
    firmware: str = "2.05-1.01-2.00-03-2"  # Firmware in that answer
    error_queue: bool = True  # Whether it answers ``SYST:ERR?``; some generators do not
    # Whether headers carry a channel number (``SOUR1:FREQ``, ``OUTP1``), and the state of the output is read
    # as ON or OFF instead of 1 or 0.
    numbered_channels: bool = False
    # Headers of what modulates, without STATe.
    modulations: tuple[str, ...] = ("AM", "FM", "FSKey", "SWEep", "BURSt")
    baud: int = 9600


class ScpiGenerator(Generator):
    """A generator that speaks SCPI; a value out of range is clipped, and only the error queue says so."""

    def __init__(
        self,
        model: GeneratorModel,
        clock: Callable[[], float],
        drive: Callable[[LightState], None] = lambda _state: None,
    ) -> None:
        super().__init__(clock, drive, model.baud)
        self.model = model
        self.LEFT = (*model.modulations, *(["SYNC2"] if model.numbered_channels else []))
        self._tree = CommandTree(ErrorQueue())
        self._register_commands()
        for name in model.modulations:
            self._register_modulation(name)

    def leave(self, what: str) -> None:
        """See `LightDriver.leave`. ``SYNC2``: the sync output belongs to channel 2."""
        if what == "SYNC2" in self.LEFT:
            self.change(sync_channel="CH2")
        else:
            super().leave(what)

    def exchange(self, serial: str) -> None:
        """See `LightDriver.exchange`."""
        self.model = replace(self.model, serial=serial)
        self._tree.errors.clear()
        self.reset()

    # ------------------------------------------------------------------ commands
    def _execute(self, message: str) -> list[str]:
        answer = self._tree.answer(message)
        return [] if answer is None else [answer]

    def _register_commands(self) -> None:
        tree, model = self._tree, self.model
        source, output = ("[:SOURce#]", "OUTPut#") if model.numbered_channels else ("[:SOURce]", "OUTPut")
        tree.add("*IDN", None, lambda _: self._identity())
        tree.add("*CLS", lambda _: tree.errors.clear(), None)
        if model.error_queue:
            tree.add("SYSTem:ERRor[:NEXT]", None, lambda _: tree.errors.next())
        tree.add(f"{source}:FUNCtion[:SHAPe]", self._set_shape, lambda _: self._shape())
        for header, name, attribute in _VALUES:
            self._register_value(f"{source}:{header}", name, attribute)
        tree.add(f"{source}:VOLTage:UNIT", self._set_unit, lambda _: "VPP")
        tree.add(
            f"{output}[:STATe]",
            lambda words: self.change(output=boolean(only_argument(words))),
            lambda _: self._format_switch(self.settings.output),
        )
        tree.add(
            f"{output}:SYNC[:STATe]",
            lambda words: self.change(sync=boolean(only_argument(words))),
            lambda _: self._format_switch(self.settings.sync),
        )
        if model.numbered_channels:
            tree.add(
                f"{output}:SYNC:POLarity",
                lambda words: self.change(
                    sync_inverted=choice(only_argument(words), self._sync_words()) in {"INV", "NEG"}
                ),
                lambda _: choice(self._sync_words()[self.settings.sync_inverted], self._sync_words()),
            )
            tree.add(
                "OUTPut:SYNC:SOURce",
                lambda words: self.change(sync_channel=only_argument(words).upper()),
                lambda _: self.settings.sync_channel,
            )
        tree.add(
            f"{output}:LOAD",
            self._set_load,
            lambda _: _format_number(min(self.settings.load_ohm, 9.9e37)),
        )

    def _register_modulation(self, name: str) -> None:
        source = "[:SOURce#]" if self.model.numbered_channels else "[:SOURce]"
        self._tree.add(
            f"{source}:{name}:STATe",
            lambda words: self.modulate(name, on=boolean(only_argument(words))),
            lambda _: self._format_switch(name in self.modulations),
        )

    def _register_value(self, header: str, name: Setting, attribute: str) -> None:
        """Register a number: command and query."""
        self._tree.add(
            header,
            lambda words: _raise_if_clipped(self.set(name, number(only_argument(words)))),
            lambda _: _format_number(getattr(self.settings, attribute)),
        )

    def _identity(self) -> str:
        model = self.model
        return f"{model.maker},{model.name},{model.serial},{model.firmware}"

    def _set_unit(self, arguments: list[str]) -> None:
        """Take the unit of the amplitude; Vrms and dBm are not simulated."""
        choice(only_argument(arguments), ["VPP"])

    def _set_shape(self, arguments: list[str]) -> None:
        word = choice(only_argument(arguments), list(_SHAPES))
        self.change(shape=next(shape for name, shape in _SHAPES.items() if name.startswith(word)))

    def _shape(self) -> str:
        return {"square": "SQU", "sine": "SIN", "dc": "DC"}[self.settings.shape]

    def _set_load(self, arguments: list[str]) -> None:
        word = only_argument(arguments)
        if word.upper() in {"INF", "INFINITY"}:
            self.set_load(math.inf)
            return
        asked = number(word)
        self.set_load(min(max(asked, _LOAD_OHM[0]), _LOAD_OHM[1]))
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


def _raise_if_clipped(held: ClipReason) -> None:
    """Raise the SCPI error that reports a clipped value; the command tree queues it."""
    if held:
        raise ScpiError(*_CLIP_ERRORS[held])


def _format_number(value: float) -> str:
    """Format a number as the 33250A does."""
    return f"{value:+.13E}"
