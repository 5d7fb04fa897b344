"""The light in the hands of a person: switched and set within the station's ranges, and read back."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

from bench.base.errors import ControlRefused
from bench.base.failure import Failure
from bench.extras.pages.align.figure_rows import FigureRow
from bench.stations.stages_and_lights import LightConfig
from drivers.errors import DriverError
from drivers.light import Light, LightSettings
from sequences.schema import FlickerConfig
from sequences.script import Flicker

RANGES = {"duty_percent": (1.0, 99.0), "level_percent": (0.1, 100.0)}
"""Lowest and highest value of each number besides the frequency, whose range the station states. At a duty of 0 or 100
%, or without light, nothing flickers."""


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
    """A light in the hands of a person."""

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
        hz = min(max(start.frequency_hz, low), high)
        self.reading = LightReading(Flicker(start.waveform, hz, start.duty_percent, start.level_percent))
        """What is known of the light."""

    def set(self, *, on: bool | None = None, **given: Any) -> LightReading:
        """Change the light, and read back what it does. When refused, nothing was sent.

        ``on`` None leaves it as it is; ``given`` are attributes of a `Flicker`, the others stay.
        """
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
        """Switch the light off, and check that it is off."""
        with self._lock:
            self._light.off()
            self.reading = replace(self.reading, on=False)
        self._on_change()

    def look(self) -> None:
        """Read whether the light is on, its settings and its faults. Never raises: a failure becomes the state."""
        with self._lock:
            try:
                self.reading = self._read(self.reading.flicker)
            except DriverError as error:
                self.reading = replace(self.reading, on=None, failure=Failure.of(error))

    def row(self) -> FigureRow:
        """Return what the light does, for the page."""
        now = self.reading
        words = "; ".join(now.faults) or {None: "unknown", True: "on", False: "off"}[now.on]
        return FigureRow("Light", words, expected="on", good=words == "on")

    def as_data(self) -> dict[str, Any]:
        """Return the light as the page shows it."""
        now = self.reading
        settings = now.settings
        steady = self._for_camera(now.flicker).waveform == "steady"
        return {
            "on": now.on,
            "steady_only": steady,
            "frequency_hz": now.flicker.frequency_hz,
            "duty_percent": now.flicker.duty_percent,
            "level_percent": now.flicker.level_percent,
            "read_back": None if settings is None else asdict(settings),
            "frequency_range_hz": list(self._config.frequency_range_hz),
            "failure": now.failure.to_dict() if now.failure else None,
        }

    def _read(self, flicker: Flicker) -> LightReading:
        return LightReading(flicker, self._light.read(), self._light.is_on(), tuple(self._light.faults()))

    def _check(self, given: dict[str, Any]) -> None:
        """Check the ranges. Raises ControlRefused."""
        ranges = {**RANGES, "frequency_hz": self._config.frequency_range_hz}
        for name, (low, high) in ranges.items():
            value = given.get(name, low)
            if not low <= value <= high:
                raise ControlRefused(
                    f"{name} {value:g} is outside {low:g} to {high:g}. Nothing was sent.",
                    where="light",
                    remedy="Give a value in this range. The station file states the range of the frequency.",
                )
