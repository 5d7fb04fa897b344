"""A function generator without its language: settings, how they bound each other, and what the light makes of them.

Knows one output of square, sine or a level; a value that cannot be is held at the nearest that can, and the caller is
told why. What it drives is told as a `LightState`; the phase goes on through every change, as in a synthesiser.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal

from simulators.world.world import LightState

Shape = Literal["square", "sine", "dc"]
"""``dc`` puts out the offset alone."""
Setting = Literal["frequency", "duty", "amplitude", "offset", "high", "low"]

#: Why a value was not taken as it was given.
ClipReason = Literal["", "lower limit", "upper limit", "conflict"]

#: Output resistance: into an open input the voltage is twice that into 50 ohm.
SOURCE_OHM: Final = 50.0

_FREQUENCY_HZ: Final = (1e-6, 80e6)
_DUTY_PERCENT: Final = (20.0, 80.0)

#: Range of the output into an open input, and the least amplitude there.
_MAX_V: Final = 10.0
_MIN_AMPLITUDE_V: Final = 0.002


@dataclass(frozen=True)
class Settings:
    """All settings, as after a reset; voltages are those into the load that is set."""

    shape: Shape = "sine"
    frequency_hz: float = 1000.0
    duty_percent: float = 50.0
    low_v: float = -0.05
    high_v: float = 0.05
    load_ohm: float = SOURCE_OHM
    output: bool = False
    sync: bool = True

    @property
    def amplitude_v(self) -> float:
        """Peak to peak."""
        return self.high_v - self.low_v

    @property
    def offset_v(self) -> float:
        """Middle of the two levels."""
        return (self.high_v + self.low_v) / 2.0


class Generator:
    """A generator.

    Parameters
    ----------
    clock
        Time in seconds.
    drive
        Called with what the light does from now on, whenever that changes.

    Attributes
    ----------
    most_v
        Highest level into an open input; values to come are held within it.
    settings
        What is set.
    """

    def __init__(self, clock: Callable[[], float], drive: Callable[[LightState], None]) -> None:
        self._clock = clock
        self._drive = drive
        self._light = LightState(origin_s=clock())
        self.most_v = _MAX_V
        self.settings = Settings()
        self._publish()

    # ------------------------------------------------------------------ settings
    def reset(self) -> None:
        """Set everything back."""
        self._apply(Settings())

    def set_shape(self, shape: Shape) -> None:
        """Take another waveform."""
        self._apply(replace(self.settings, shape=shape))

    def switch(self, *, output: bool | None = None, sync: bool | None = None) -> None:
        """Switch the output, or the sync output."""
        now = self.settings
        self._apply(
            replace(
                now, output=now.output if output is None else output, sync=now.sync if sync is None else sync
            )
        )

    def set_load(self, ohm: float) -> None:
        """Take another load: the output stays as it is, the voltages shown for it change."""
        scale = _voltage_share(ohm) / _voltage_share(self.settings.load_ohm)
        low_v, high_v = self.settings.low_v * scale, self.settings.high_v * scale
        self._apply(replace(self.settings, load_ohm=ohm, low_v=low_v, high_v=high_v))

    def set(self, name: Setting, value: float) -> ClipReason:
        """Set a value, or the nearest that can be, and say which bound held it."""
        lowest, highest = self.bounds(name)
        held: ClipReason = "lower limit" if value < lowest else "upper limit" if value > highest else ""
        value = min(max(value, lowest), highest)
        now = self.settings
        if name == "frequency":
            self._apply(replace(now, frequency_hz=round(value, 6)))
        elif name == "duty":
            self._apply(replace(now, duty_percent=round(value, 1)))
        else:
            moved = self._set_level(name, value)
            held = held or moved
        return held

    def bounds(self, name: Setting) -> tuple[float, float]:
        """Values that a setting takes at present."""
        share = _voltage_share(self.settings.load_ohm)
        most, least = self.most_v * share, _MIN_AMPLITUDE_V * share
        half = self.settings.amplitude_v / 2.0
        ranges: dict[Setting, tuple[float, float]] = {
            "frequency": _FREQUENCY_HZ,
            "duty": _DUTY_PERCENT,
            "amplitude": (least, 2.0 * most),
            "offset": (-most, most) if self.settings.shape == "dc" else (half - most, most - half),
            "high": (least - most, most),
            "low": (-most, most - least),
        }
        return ranges[name]

    def clip(self, most_v: float | None) -> None:
        """Hold levels to come within less than usual, or no more."""
        self.most_v = _MAX_V if most_v is None else most_v

    def trip(self) -> None:
        """Have the overload protection switch the output off, without a word."""
        self.switch(output=False)

    # ------------------------------------------------------------------ inside
    def _set_level(self, name: Setting, value: float) -> ClipReason:
        """Set both levels from one of the four ways to say them; the other level yields where it must."""
        now, share = self.settings, _voltage_share(self.settings.load_ohm)
        least = _MIN_AMPLITUDE_V * share
        if name == "offset" and now.shape == "dc":
            # The amplitude puts nothing out, and yields so that offset and amplitude fit the range later.
            half = min(now.amplitude_v / 2.0, max(self.most_v * share - abs(value), least / 2.0))
            self._apply(replace(now, low_v=value - half, high_v=value + half))
            return ""
        low_v, high_v = {
            "amplitude": (now.offset_v - value / 2.0, now.offset_v + value / 2.0),
            "offset": (value - now.amplitude_v / 2.0, value + now.amplitude_v / 2.0),
            "high": (min(now.low_v, value - least), value),
            "low": (value, max(now.high_v, value + least)),
        }[name]
        most = self.most_v * share
        conflict = low_v < -most - 1e-9 or high_v > most + 1e-9
        conflict |= (name == "high" and low_v < now.low_v) or (name == "low" and high_v > now.high_v)
        self._apply(replace(now, low_v=round(max(low_v, -most), 4), high_v=round(min(high_v, most), 4)))
        return "conflict" if conflict else ""

    def _apply(self, settings: Settings) -> None:
        self.settings = settings
        self._publish()

    def _publish(self) -> None:
        """Let the world know what the light does now."""
        now, settings = self._clock(), self.settings
        levels = (settings.offset_v,) * 2 if settings.shape == "dc" else (settings.low_v, settings.high_v)
        # The lamp's input is open: it sees the source's own voltage, whatever load the display is set for.
        open_circuit = 1.0 / _voltage_share(settings.load_ohm)
        self._light = LightState(
            waveform="sine" if settings.shape == "sine" else "square",
            frequency_hz=settings.frequency_hz,
            duty_percent=settings.duty_percent,
            low_v=levels[0] * open_circuit,
            high_v=levels[1] * open_circuit,
            output=settings.output,
            sync=settings.sync and settings.shape != "dc",
            origin_s=now - self._light.phase_at(now) / settings.frequency_hz,
        )
        self._drive(self._light)


def _voltage_share(load_ohm: float) -> float:
    """Share of the source's own voltage that stands at a load."""
    return 1.0 if math.isinf(load_ohm) else load_ohm / (load_ohm + SOURCE_OHM)
