"""A function generator in the way of the Keysight 33250A, driving the light and the camera's trigger input.

Knows the instrument: its settings, how they bound each other, and that it clips what it cannot do and says so
only when asked for errors. SCPI's syntax is `scpi`'s. What it drives is told as a `LightState`; the phase
goes on through every change, as in a synthesiser.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from simulators.scpi import CommandTree, ErrorQueue, ScpiError, boolean, choice, no_arguments, number, the_one
from simulators.world import LightState

_HERTZ = {"UHZ": 1e-6, "HZ": 1.0, "KHZ": 1e3, "MHZ": 1e6}
_VOLTS = {"MV": 1e-3, "V": 1.0, "VPP": 1.0, "MVPP": 1e-3}
_PERCENT = {"PCT": 1.0, "%": 1.0}
_OHMS = {"OHM": 1.0, "KOHM": 1e3}

#: Output resistance: into an open input the voltage is twice that into 50 ohm.
_SOURCE_OHM = 50.0

#: Least amplitude, V peak to peak into 50 ohm.
_LEAST_AMPLITUDE_V = 0.001

#: Longest message the input buffer takes.
_LONGEST = 2048


@dataclass(frozen=True)
class GeneratorModel:
    """What a generator says it is.

    Attributes
    ----------
    error_queue
        Whether it answers ``SYST:ERR?``; some do not.
    baud
        Baud rate of its serial port.
    """

    serial: str = "SG0042"
    maker: str = "Keysight Technologies"
    name: str = "33250A"
    firmware: str = "2.05-1.01-2.00-03-2"
    error_queue: bool = True
    baud: int = 9600


@dataclass(frozen=True)
class _Settings:
    """All settings, as after ``*RST``; voltages are those into the load that is set."""

    shape: str = "SIN"
    frequency_hz: float = 1000.0
    duty_percent: float = 50.0
    low_v: float = -0.05
    high_v: float = 0.05
    load_ohm: float = _SOURCE_OHM
    output: bool = False
    sync: bool = True


class ScpiGenerator:
    """The generator, as a dialect of a serial line.

    Parameters
    ----------
    model
        What it is.
    clock
        Time in seconds.
    drive
        Called with what the light does from now on, whenever that changes.
    """

    def __init__(
        self,
        model: GeneratorModel,
        clock: Callable[[], float],
        drive: Callable[[LightState], None] = lambda _state: None,
    ) -> None:
        self.model = model
        self._clock = clock
        self._drive = drive
        self._heard = b""
        self._settings = _Settings()
        self._light = LightState(origin_s=clock())
        self._tree = CommandTree(ErrorQueue())
        self._teach()
        self._tell()

    @property
    def baud(self) -> int:
        """Baud rate of its serial port."""
        return self.model.baud

    def receive(self, data: bytes) -> bytes:
        """Take bytes as they arrive and give what they ask for."""
        *messages, self._heard = (self._heard + data).split(b"\n")
        self._heard = self._heard[-_LONGEST:]
        answers = [self._tree.answer(message.decode("ascii", "replace")) for message in messages]
        return b"".join(f"{answer}\n".encode("ascii") for answer in answers if answer is not None)

    def unsolicited(self) -> bytes:
        """Say nothing unasked."""
        return b""

    # ------------------------------------------------------------------ what it understands
    def _teach(self) -> None:
        tree, model = self._tree, self.model
        identity = f"{model.maker},{model.name},{model.serial},{model.firmware}"
        tree.add("*IDN", None, lambda _: identity)
        tree.add("*RST", self._reset, None)
        tree.add("*CLS", lambda _: tree.errors.clear(), None)
        tree.add("*OPC", no_arguments, lambda _: "1")
        tree.add("*WAI", no_arguments, None)
        if model.error_queue:
            tree.add("SYSTem:ERRor[:NEXT]", None, lambda _: tree.errors.next())
        for word in ("REMote", "LOCal", "RWLock"):
            tree.add(f"SYSTem:{word}", no_arguments, None)
        tree.add("[:SOURce]:FUNCtion[:SHAPe]", self._set_shape, lambda _: self._settings.shape)
        tree.add("[:SOURce]:FREQuency", self._set_frequency, self._get(_frequency, self._frequency_range))
        tree.add("[:SOURce]:FUNCtion:SQUare:DCYCle", self._set_duty, self._get(_duty, lambda: (20.0, 80.0)))
        tree.add("[:SOURce]:VOLTage", self._set_amplitude, self._get(_amplitude, self._amplitude_range))
        tree.add("[:SOURce]:VOLTage:OFFSet", self._set_offset, self._get(_offset, self._level_range))
        tree.add("[:SOURce]:VOLTage:HIGH", self._set_high, self._get(_high, self._level_range))
        tree.add("[:SOURce]:VOLTage:LOW", self._set_low, self._get(_low, self._level_range))
        tree.add("OUTPut[:STATe]", self._set_output, lambda _: str(int(self._settings.output)))
        tree.add("OUTPut:SYNC", self._set_sync, lambda _: str(int(self._settings.sync)))
        tree.add("OUTPut:LOAD", self._set_load, lambda _: _printed(min(self._settings.load_ohm, 9.9e37)))

    def _get(
        self, reading: Callable[[_Settings], float], bounds: Callable[[], tuple[float, float]]
    ) -> Callable[[list[str]], str]:
        """Make a query that also tells the setting's bounds, as ``FREQ? MAX``."""

        def answer(arguments: list[str]) -> str:
            if not arguments:
                return _printed(reading(self._settings))
            end = choice(the_one(arguments), ["MINimum", "MAXimum"])
            return _printed(bounds()[end == "MAX"])

        return answer

    # ------------------------------------------------------------------ settings
    def _reset(self, arguments: list[str]) -> None:
        no_arguments(arguments)
        self._change(_Settings())

    def _set_shape(self, arguments: list[str]) -> None:
        self._change(replace(self._settings, shape=choice(the_one(arguments), ["SINusoid", "SQUare"])))

    def _set_frequency(self, arguments: list[str]) -> None:
        value, clipped = self._value(arguments, _HERTZ, self._frequency_range())
        self._change(replace(self._settings, frequency_hz=round(value, 6)), clipped)

    def _set_duty(self, arguments: list[str]) -> None:
        value, clipped = self._value(arguments, _PERCENT, (20.0, 80.0))
        self._change(replace(self._settings, duty_percent=round(value, 1)), clipped)

    def _set_amplitude(self, arguments: list[str]) -> None:
        value, clipped = self._value(arguments, _VOLTS, self._amplitude_range())
        middle = _offset(self._settings)
        self._set_levels(middle - value / 2.0, middle + value / 2.0, clipped)

    def _set_offset(self, arguments: list[str]) -> None:
        half = _amplitude(self._settings) / 2.0
        lowest, highest = self._level_range()
        value, clipped = self._value(arguments, _VOLTS, (lowest + half, highest - half))
        self._set_levels(value - half, value + half, clipped)

    def _set_high(self, arguments: list[str]) -> None:
        lowest, highest = self._level_range()
        least = self._amplitude_range()[0]
        value, clipped = self._value(arguments, _VOLTS, (lowest + least, highest))
        if value < self._settings.low_v + least:
            clipped = ScpiError(-221, "high level below low level; low level adjusted")
        self._set_levels(min(self._settings.low_v, value - least), value, clipped)

    def _set_low(self, arguments: list[str]) -> None:
        lowest, highest = self._level_range()
        least = self._amplitude_range()[0]
        value, clipped = self._value(arguments, _VOLTS, (lowest, highest - least))
        if value > self._settings.high_v - least:
            clipped = ScpiError(-221, "low level above high level; high level adjusted")
        self._set_levels(value, max(self._settings.high_v, value + least), clipped)

    def _set_levels(self, low_v: float, high_v: float, clipped: ScpiError | None) -> None:
        """Set both levels; what reaches past the output's range ends there."""
        lowest, highest = self._level_range()
        if low_v < lowest - 1e-9 or high_v > highest + 1e-9:
            clipped = ScpiError(-221, "offset changed due to amplitude")
        low_v, high_v = max(low_v, lowest), min(high_v, highest)
        self._change(replace(self._settings, low_v=round(low_v, 4), high_v=round(high_v, 4)), clipped)

    def _set_output(self, arguments: list[str]) -> None:
        self._change(replace(self._settings, output=boolean(the_one(arguments))))

    def _set_sync(self, arguments: list[str]) -> None:
        self._change(replace(self._settings, sync=boolean(the_one(arguments))))

    def _set_load(self, arguments: list[str]) -> None:
        """Take another load: the output stays as it is, the voltages shown for it change."""
        word = the_one(arguments)
        clipped = None
        if word.upper() in {"INF", "INFINITY"}:
            load = math.inf
        else:
            load, clipped = self._value([word], _OHMS, (1.0, 10_000.0))
        scale = _share(load) / _share(self._settings.load_ohm)
        low_v, high_v = self._settings.low_v * scale, self._settings.high_v * scale
        self._change(replace(self._settings, load_ohm=load, low_v=low_v, high_v=high_v), clipped)

    # ------------------------------------------------------------------ bounds
    def _frequency_range(self) -> tuple[float, float]:
        return 1e-6, 80e6

    def _level_range(self) -> tuple[float, float]:
        most = 10.0 * _share(self._settings.load_ohm)
        return -most, most

    def _amplitude_range(self) -> tuple[float, float]:
        share = _share(self._settings.load_ohm)
        return 2.0 * _LEAST_AMPLITUDE_V * share, 20.0 * share

    def _value(
        self, arguments: list[str], unit_factors: dict[str, float], bounds: tuple[float, float]
    ) -> tuple[float, ScpiError | None]:
        """Read a number and hold it within bounds; the error says that it was held."""
        word = the_one(arguments)
        lowest, highest = bounds
        if word.upper() in {"MIN", "MINIMUM", "MAX", "MAXIMUM"}:
            return (highest if word.upper().startswith("MAX") else lowest), None
        value = number(word, unit_factors)
        if value < lowest:
            return lowest, ScpiError(-222, "value clipped to lower limit")
        if value > highest:
            return highest, ScpiError(-222, "value clipped to upper limit")
        return value, None

    # ------------------------------------------------------------------ effect
    def _change(self, settings: _Settings, clipped: ScpiError | None = None) -> None:
        self._settings = settings
        self._tell()
        if clipped is not None:
            raise clipped

    def _tell(self) -> None:
        """Let the world know what the light does now."""
        now, settings = self._clock(), self._settings
        # The lamp's input is open: it sees the source's own voltage, whatever load the display is set for.
        open_circuit = 1.0 / _share(settings.load_ohm)
        self._light = LightState(
            waveform="square" if settings.shape == "SQU" else "sine",
            frequency_hz=settings.frequency_hz,
            duty_percent=settings.duty_percent,
            low_v=settings.low_v * open_circuit,
            high_v=settings.high_v * open_circuit,
            output=settings.output,
            sync=settings.sync,
            origin_s=now - self._light.phase_at(now) / settings.frequency_hz,
        )
        self._drive(self._light)


def _share(load_ohm: float) -> float:
    """Share of the source's own voltage that stands at a load."""
    return 1.0 if math.isinf(load_ohm) else load_ohm / (load_ohm + _SOURCE_OHM)


def _frequency(settings: _Settings) -> float:
    return settings.frequency_hz


def _duty(settings: _Settings) -> float:
    return settings.duty_percent


def _amplitude(settings: _Settings) -> float:
    return settings.high_v - settings.low_v


def _offset(settings: _Settings) -> float:
    return (settings.high_v + settings.low_v) / 2.0


def _high(settings: _Settings) -> float:
    return settings.high_v


def _low(settings: _Settings) -> float:
    return settings.low_v


def _printed(value: float) -> str:
    """Print a number as the instrument does."""
    return f"{value:+.13E}"
