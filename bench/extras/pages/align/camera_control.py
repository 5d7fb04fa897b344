"""The camera in the hands of a person: its biases, or exposure and gain, and whether it is set as in a run.

Settings change between two slices only, through the loop that records.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, TypeVar

from bench.base.errors import ControlRefused
from bench.extras.pages.align.figure_rows import FigureRow
from bench.extras.pages.align.live_loop import LiveLoop
from bench.measure.camera_kinds import camera_kind, event_camera, frame_camera
from bench.stations.cameras import OpenCvCameraConfig
from bench.stations.devices import Camera
from bench.stations.sections import FrameCameraSection
from bench.stations.station import Station
from drivers.camera import CameraSettings, StatesBiasRanges
from drivers.camera.frames import FrameSettings

T = TypeVar("T")
ANSWER_S = 20.0
"""Longest wait for the camera between two slices, s: twice the longest slice on a busy computer (`session.OLD_S`)."""
_IMX636: Mapping[str, tuple[int, int]] = {
    "bias_diff_on": (-150, 200),
    "bias_diff_off": (-150, 200),
    "bias_fo": (-150, 200),
    "bias_hpf": (0, 255),
    "bias_refr": (-50, 255),
}
"""Ranges of the biases where the camera's driver does not state them; the camera refuses what it cannot do."""


class CameraControl:
    """A camera in the hands of a person."""

    def __init__(self, camera: Camera, station: Station, on_change: Callable[[], None]) -> None:
        self._camera = camera
        self._config = station.camera
        self._kind = camera_kind(station)
        self._on_change = on_change
        self._lock = threading.Lock()
        self._loop: LiveLoop | None = None
        self._ranges = camera.bias_ranges() if isinstance(camera, StatesBiasRanges) else _IMX636
        self.settings, self.reasons = self._kind.prepare(camera)
        """Settings as read back, and every reason against a run."""
        self._of_station = dict(self.settings)  # With these the camera was opened, as a run opens it

    @property
    def is_event(self) -> bool:
        """Whether this is an event camera."""
        return not isinstance(self._config, FrameCameraSection)

    @property
    def values(self) -> Mapping[str, float | None]:
        """What was read back: biases, offsets from the factory values; of a frame camera, exposure and gain."""
        if self.is_event:
            biases = self.settings.get("biases", {})
            return {name: value for name, value in biases.items() if name in self._ranges}
        if isinstance(self._config, OpenCvCameraConfig):
            return {name: self.settings.get(name) for name in ("exposure", "gain")}
        return {}

    @property
    def changed(self) -> Mapping[str, float]:
        """Those of `values` that differ from what the station file states."""
        expected = self._expected
        return {n: v for n, v in self.values.items() if v is not None and expected.get(n) not in (None, v)}

    @property
    def _expected(self) -> Mapping[str, float | None]:
        return self._of_station.get("biases", {}) if self.is_event else self._of_station

    def use(self, loop: LiveLoop) -> None:
        """Change settings through this loop from now on."""
        self._loop = loop

    def set(self, name: str, value: float) -> Mapping[str, float | None]:
        """Change a bias, in the camera's own steps, or exposure or gain; read all back. Refused: nothing was sent."""
        names = self._ranges if self.is_event else self.values
        if name not in names:
            raise ControlRefused(
                f"This camera has no setting {name!r}. Nothing was sent.",
                where="camera",
                remedy=f"It has {', '.join(names)}." if names else "Set it at the camera itself.",
            )
        with self._lock:
            if self.is_event:
                self._set_bias(name, value)
            else:
                wanted = FrameSettings(**{**self.values, name: value})
                frame = self._between_slices(lambda: frame_camera(self._camera).apply(wanted))
                self.settings = {**self.settings, **asdict(frame)}
        self._on_change()
        return self.values

    def _set_bias(self, name: str, value: float) -> None:
        low, high = self._ranges[name]
        if not low <= value <= high or value != int(value):
            raise ControlRefused(
                f"{name} {value:g} is no whole number from {low} to {high}. Nothing was sent.",
                where="camera",
                remedy="Give a value in this range.",
            )
        # Other biases keep the value that was read back.
        biases = {bias: int(now) for bias, now in self.values.items() if now is not None} | {name: int(value)}
        roi = None if isinstance(self._config, FrameCameraSection) else self._config.roi
        settings = CameraSettings(biases, trigger_in=True, roi=roi)
        applied = self._between_slices(lambda: event_camera(self._camera).apply(settings))
        self.settings = {**self.settings, "biases": dict(applied.biases)}

    def _between_slices(self, apply: Callable[[], T]) -> T:
        assert self._loop is not None
        return self._loop.on_camera(apply).result(timeout=ANSWER_S)

    def row(self) -> FigureRow:
        """Return whether the camera is set as in a run, for the page."""
        found = [*self.reasons, *(f"{name} is changed" for name in self.changed)]
        expected = "as in the station file"
        return FigureRow("Camera", "; ".join(found) or expected, expected=expected, good=not found)

    def as_data(self) -> dict[str, Any]:
        """Return the camera as the page shows it."""
        return {
            "kind": "event" if self.is_event else "frame",
            "settings": [
                {
                    "name": name,
                    "value": value,
                    "range": list(self._ranges[name]) if self.is_event else None,
                    "expected": self._expected.get(name),
                    "changed": name in self.changed,
                }
                for name, value in self.values.items()
            ],
        }
