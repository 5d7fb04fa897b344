"""Camera and light in the hands of a person who aligns: settings are changed, and read back from the device.

Access to the camera goes through the loop that records, so settings change between two slices only. Nothing moves.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, cast

from bench.align.live_loop import LiveLoop
from bench.base.errors import ControlRefused, Failure
from bench.stations.devices import Camera
from bench.stations.stages_and_lights import LightConfig
from bench.stations.station import Station
from bench.stations.station_cameras import (
    EventCameraConfig,
    FrameCameraConfig,
    OpenCvCameraConfig,
)
from bench.views.camera_kinds import camera_kind
from drivers.camera import CameraIdentity, CameraSettings, EventCamera, StatesBiasRanges
from drivers.camera.frames import FrameCamera, FrameSettings
from drivers.errors import DriverError
from drivers.light import Light, LightSettings
from sequences.schema import FlickerConfig, Waveform
from sequences.script import Flicker

ANSWER_S = 20.0
"""Longest wait for the camera between two slices, s."""


_IMX636: Mapping[str, tuple[int, int]] = {
    "bias_diff_on": (-150, 200),
    "bias_diff_off": (-150, 200),
    "bias_fo": (-150, 200),
    "bias_hpf": (0, 255),
    "bias_refr": (-50, 255),
}
"""Ranges of the biases where the camera's driver does not state them; the camera refuses what it cannot do."""


class CameraControl:
    """The camera's identity and settings."""

    def __init__(self, camera: Camera, station: Station, on_change: Callable[[], None]) -> None:
        self._camera = camera
        self._config = station.camera
        self._kind = camera_kind(station)
        self._on_change = on_change
        self._lock = threading.Lock()
        self._loop: LiveLoop | None = None
        self._ranges = camera.bias_ranges() if isinstance(camera, StatesBiasRanges) else _IMX636
        self.identity: CameraIdentity = camera.identify()
        """The camera, as it states itself."""
        self.settings, self.reasons = self._kind.prepare(camera)
        """Settings as read back, and every reason against a run."""

    @property
    def is_event(self) -> bool:
        """Whether this is an event camera."""
        return not isinstance(self._config, FrameCameraConfig)

    @property
    def biases(self) -> Mapping[str, int]:
        """Offsets of the biases from the factory values, as read back."""
        found: Mapping[str, int] = self.settings.get("biases", {})
        return found

    @property
    def frame_settings(self) -> Mapping[str, float | None]:
        """Exposure and gain of a camera that OpenCV opens, as read back; empty for other cameras."""
        if not isinstance(self._config, OpenCvCameraConfig):
            return {}
        return {name: self.settings.get(name) for name in ("exposure", "gain")}

    def use(self, loop: LiveLoop) -> None:
        """Change settings through this loop from now on."""
        self._loop = loop

    def set_bias(self, name: str, value: int) -> Mapping[str, int]:
        """Change one bias, offset in the camera's own steps; read all back. When refused, nothing was sent."""
        ranges = self._ranges
        if not self.is_event or name not in ranges:
            raise ControlRefused(
                f"This camera has no bias {name!r}. Nothing was sent.",
                where="camera",
                remedy=f"It has {', '.join(ranges)}." if self.is_event else "Set exposure and gain instead.",
            )
        low, high = ranges[name]
        if not low <= value <= high:
            raise ControlRefused(
                f"{name} {value} is outside {low} to {high}. Nothing was sent.",
                where="camera",
                remedy="Give a value in this range.",
            )
        config = cast("EventCameraConfig", self._config)
        with self._lock:
            # The names are those of the station; other biases keep the value that was read back.
            wanted = {one: now for one, now in self.biases.items() if one in ranges} | {name: value}
            event_camera = cast("EventCamera", self._camera)

            def change() -> CameraSettings:
                return event_camera.apply(CameraSettings(wanted, trigger_in=True, roi=config.roi))

            assert self._loop is not None
            found = self._loop.on_camera(change).result(timeout=ANSWER_S)
            self.settings = {**self.settings, "biases": dict(found.biases)}
        self._on_change()
        return self.biases

    def set_frame(self, name: str, value: float) -> Mapping[str, float | None]:
        """Change ``exposure`` or ``gain`` of a frame camera that has it (else refused), and read both back."""
        if name not in self.frame_settings:
            raise ControlRefused(
                f"This camera has no setting {name!r}. Nothing was sent.",
                where="camera",
                remedy="Set it at the camera, or with its maker's program.",
            )
        with self._lock:
            wanted = FrameSettings(**{**self.frame_settings, name: value})
            frame_camera = cast("FrameCamera", self._camera)
            assert self._loop is not None
            found = self._loop.on_camera(lambda: frame_camera.apply(wanted)).result(timeout=ANSWER_S)
            self.settings = {**self.settings, **asdict(found)}
        self._on_change()
        return self.frame_settings

    def as_data(self) -> dict[str, Any]:
        """Return the camera as the page shows it."""
        ranges = self._ranges
        identity = self.identity
        return {
            "kind": "event" if self.is_event else "frame",
            "model": " ".join(part for part in (identity.maker, identity.model) if part),
            "serial": identity.serial,
            "width_px": identity.width,
            "height_px": identity.height,
            "lens": self._config.lens,
            "biases": [
                {"name": name, "value": value, "lowest": ranges[name][0], "highest": ranges[name][1]}
                for name, value in self.biases.items()
                if name in ranges
            ],
            "frame": dict(self.frame_settings),
            "reasons": list(self.reasons),
        }


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
        """Change the light, and read back what it does; None leaves a value. When refused, nothing was sent."""
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
        """Switch the light off, and check that it is off."""
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
            "read_back": None if found is None else asdict(found),
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
