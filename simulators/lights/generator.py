"""A function generator without its command language: settings, their limits, and the light that results.

The generator has one output with a square wave, a sine wave or a constant level. A value out of range is clipped
to the nearest possible one, and the caller gets the reason. The generator publishes its output as a `LightState`.
The phase continues through each change, as in a synthesiser.

Ranges follow the Keysight 33250A: at most 80 MHz, duty cycle 20 to 80 %, 10 V into an open circuit, 50 ohm source
(its user's guide).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal

from simulators.world.world import LightState, SyncLine

Shape = Literal["square", "sine", "dc"]
"""Waveforms; ``dc`` is a constant level at the offset."""
Setting = Literal["frequency", "duty", "amplitude", "offset", "high", "low"]

#: Reason why a value was clipped; empty if it was not.
ClipReason = Literal["", "lower limit", "upper limit", "conflict"]

#: Output resistance, ohm: the voltage into an open circuit is twice the voltage into 50 ohm.
SOURCE_OHM: Final = 50.0

_FREQUENCY_HZ: Final = (1e-6, 80e6)
_DUTY_PERCENT: Final = (20.0, 80.0)

#: Largest level and smallest amplitude into an open circuit, V.
_MAX_V: Final = 10.0
_MIN_AMPLITUDE_V: Final = 0.002


@dataclass(frozen=True)
class Settings:
    """All settings; the defaults are those after a reset."""

    shape: Shape = "sine"
    frequency_hz: float = 1000.0  # Frequency, Hz
    duty_percent: float = 50.0  # Duty cycle of the square wave, percent
    # low_v, high_v: Levels at the load that is set, V.
    low_v: float = -0.05
    high_v: float = 0.05
    load_ohm: float = SOURCE_OHM
    # output, sync: Whether the output and the sync output are on.
    output: bool = False
    sync: bool = True
    sync_inverted: bool = False  # Whether the sync output falls where it otherwise rises

    @property
    def amplitude_v(self) -> float:
        """Peak-to-peak amplitude, V."""
        return self.high_v - self.low_v

    @property
    def offset_v(self) -> float:
        """Mean of the two levels, V."""
        return (self.high_v + self.low_v) / 2.0


class Generator:
    """A function generator with one output.

    clock: Returns the time in seconds.
    most_v: Largest level into an open circuit, V, for values that are set from now on.
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
        """Restore the settings of a reset."""
        self._apply(Settings())

    def set_shape(self, shape: Shape) -> None:
        """Set the waveform."""
        self._apply(replace(self.settings, shape=shape))

    def switch(self, *, output: bool | None = None, sync: bool | None = None) -> None:
        """Switch the output or the sync output.

        output, sync: New states; None leaves a state as it is.
        """
        now = self.settings
        self._apply(
            replace(
                now, output=now.output if output is None else output, sync=now.sync if sync is None else sync
            )
        )

    def invert_sync(self, inverted: bool) -> None:
        """Set the polarity of the sync output.

        inverted: Whether it is inverted.
        """
        self._apply(replace(self.settings, sync_inverted=inverted))

    def set_load(self, ohm: float) -> None:
        """Set the load for which voltages are shown; the output itself stays as it is."""
        scale = _voltage_share(ohm) / _voltage_share(self.settings.load_ohm)
        low_v, high_v = self.settings.low_v * scale, self.settings.high_v * scale
        self._apply(replace(self.settings, load_ohm=ohm, low_v=low_v, high_v=high_v))

    def set(self, name: Setting, value: float) -> ClipReason:
        """Set a value, clipped to its range.

        value: New value: Hz, percent or V.
        Returns: Why the value was clipped; empty if it was not.
        """
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
        """Return the range of a setting, which depends on the other settings.

        Returns: Lowest and highest value: Hz, percent or V.
        """
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
        """Limit levels that are set from now on.

        most_v: Largest level into an open circuit, V; None restores the normal limit.
        """
        self.most_v = _MAX_V if most_v is None else most_v

    def trip(self) -> None:
        """Let the overload protection switch the output off, without a message."""
        self.switch(output=False)

    # ------------------------------------------------------------------ inside
    def _set_level(self, name: Setting, value: float) -> ClipReason:
        """Set both levels from amplitude, offset, high or low level; the other level gives way if necessary."""
        now, share = self.settings, _voltage_share(self.settings.load_ohm)
        least = _MIN_AMPLITUDE_V * share
        if name == "offset" and now.shape == "dc":
            # The amplitude has no effect on DC; it shrinks so that offset and amplitude fit the range later.
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
        """Publish the state of the light."""
        now, settings = self._clock(), self.settings
        levels = (settings.offset_v,) * 2 if settings.shape == "dc" else (settings.low_v, settings.high_v)
        # The lamp's input is an open circuit: it gets the source voltage, whatever load is set.
        open_circuit = 1.0 / _voltage_share(settings.load_ohm)
        self._light = LightState(
            waveform="sine" if settings.shape == "sine" else "square",
            frequency_hz=settings.frequency_hz,
            duty_percent=settings.duty_percent,
            low_v=levels[0] * open_circuit,
            high_v=levels[1] * open_circuit,
            output=settings.output,
            sync=settings.sync and settings.shape != "dc",
            sync_line=SyncLine(inverted=settings.sync_inverted),
            origin_s=now - self._light.phase_at(now) / settings.frequency_hz,
        )
        self._drive(self._light)


def _voltage_share(load_ohm: float) -> float:
    """Return the voltage at a load as a share of the source voltage (voltage divider)."""
    return 1.0 if math.isinf(load_ohm) else load_ohm / (load_ohm + SOURCE_OHM)
