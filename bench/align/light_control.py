"""The light in the hands of a person: on, off, frequency, level; everything is read back from the device.

The light goes on only when `set` is called with ``on=True``. The module moves nothing.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from bench.base.errors import ControlRefused
from bench.base.failure import Failure
from bench.stations.station_lights import LightConfig
from drivers.errors import DriverError
from drivers.light import Light, LightSettings
from sequences.schema import FlickerConfig, Waveform
from sequences.script import Flicker

RANGES = {"duty_percent": (1.0, 99.0), "level_percent": (0.1, 100.0)}
"""Lowest and highest value of each number besides the frequency, whose range the station states."""


@dataclass(frozen=True)
class LightReading:
    """What is known of the light."""

    flicker: Flicker  # What was asked for last
    # Settings as the device reported them last; None before the first reading.
    settings: LightSettings | None = None
    on: bool | None = None  # Whether the output is on, as the device reported; None if unknown
    faults: tuple[str, ...] = ()
    failure: Failure | None = None  # Why the light does not answer or refuses; None if nothing is wrong


class LightControl:
    """A light in the hands of a person.

    on_change: Called after each change, by any thread.
    """

    def __init__(
        self,
        light: Light,
        config: LightConfig,
        for_camera: Callable[[Flicker], Flicker],
        on_change: Callable[[], None],
    ) -> None:
        self._light = light
        self._config = config
        self._for_camera = for_camera
        self._on_change = on_change
        self._lock = threading.Lock()
        start = FlickerConfig()
        low, high = config.frequency_range_hz
        self.reading = LightReading(
            Flicker(
                start.waveform,
                min(max(start.frequency_hz, low), high),
                start.duty_percent,
                start.level_percent,
            )
        )
        """What is known of the light."""

    def set(
        self,
        *,
        on: bool | None = None,
        waveform: Waveform | None = None,
        frequency_hz: float | None = None,
        duty_percent: float | None = None,
        level_percent: float | None = None,
    ) -> LightReading:
        """Change the light, and read back what it does.

        on: Whether the output is to be on; None leaves it as it is.
        waveform, frequency_hz, duty_percent, level_percent: New values; None leaves a value as it is.
        Returns: As the device reports it after the change.
        Raises ControlRefused: If a value is outside its range; nothing was sent.
        Raises DriverError: If the light refuses or does not answer.
        """
        changes = {
            "waveform": waveform,
            "frequency_hz": frequency_hz,
            "duty_percent": duty_percent,
            "level_percent": level_percent,
        }
        given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
        self._check(given)
        with self._lock:
            flicker = replace(self.reading.flicker, **given)
            try:
                if on is False:
                    self._light.off()
                if given or on:
                    self._light.apply(self._config.settings(self._for_camera(flicker)))
                if on:
                    self._light.on()
                self.reading = self._read(flicker)
            except DriverError as error:
                self.reading = replace(self.reading, on=None, failure=Failure.of(error))
                raise
            finally:
                self._on_change()
            return self.reading

    def off(self) -> None:
        """Switch the light off, and check that it is off.

        Raises DriverError: If the light does not confirm.
        """
        with self._lock:
            self._light.off()
            self.reading = replace(self.reading, on=False)
        self._on_change()

    def look(self) -> None:
        """Read whether the light is on, its settings and its faults. Never raises: a failure becomes the state."""
        with self._lock:
            before = self.reading
            try:
                self.reading = self._read(before.flicker)
            except DriverError as error:
                self.reading = replace(before, on=None, failure=Failure.of(error))
            changed = before != self.reading
        if changed:
            self._on_change()

    def as_data(self) -> dict[str, Any]:
        """Return the light as the page shows it."""
        now = self.reading
        found = now.settings
        steady = self._for_camera(now.flicker).waveform == "steady"
        return {
            "on": now.on,
            "waveform": self._for_camera(now.flicker).waveform,
            "steady_only": steady,
            "frequency_hz": now.flicker.frequency_hz,
            "duty_percent": now.flicker.duty_percent,
            "level_percent": now.flicker.level_percent,
            "read_back": None
            if found is None
            else {
                "waveform": found.waveform,
                "frequency_hz": found.frequency_hz,
                "duty_percent": found.duty_percent,
                "low_v": found.low_v,
                "high_v": found.high_v,
                "sync_output": found.sync_output,
            },
            "frequency_range_hz": list(self._config.frequency_range_hz),
            "faults": list(now.faults),
            "failure": now.failure.to_dict() if now.failure else None,
        }

    def _read(self, flicker: Flicker) -> LightReading:
        return LightReading(flicker, self._light.read(), self._light.is_on(), tuple(self._light.faults()))

    def _check(self, given: dict[str, Any]) -> None:
        """Check the ranges. Raises ControlRefused."""
        if given.get("waveform", "square") not in ("square", "sine", "steady"):
            raise ControlRefused(
                f"The light has no waveform {given['waveform']!r}.",
                where="light",
                remedy="Use square or sine.",
            )
        ranges = {**RANGES, "frequency_hz": self._config.frequency_range_hz}
        for name, (low, high) in ranges.items():
            value = given.get(name, low)
            if not low <= value <= high:
                raise ControlRefused(
                    f"{name} {value:g} is outside {low:g} to {high:g}. Nothing was sent.",
                    where="light",
                    remedy="Give a value in this range. The station file states the range of the frequency.",
                )
