"""Identity and settings of the camera while a person aligns it: biases, or exposure and gain, changed and read back.

All access to the camera goes through the loop that records, so that settings change between two slices only.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, cast

from annotated_types import Ge, Le

from bench.align.live_loop import LiveLoop
from bench.base.errors import ControlRefused
from bench.stations.devices import Camera
from bench.stations.station import Station
from bench.stations.station_cameras import (
    BiasesConfig,
    EventCameraConfig,
    FrameCameraConfig,
    OpenCvCameraConfig,
)
from bench.views.station_camera_kind import camera_kind
from drivers.camera import CameraIdentity, CameraSettings, EventCamera
from drivers.camera.frames import FrameCamera, FrameSettings

ANSWER_S = 20.0
"""Longest wait for the camera between two slices, s."""


def bias_ranges() -> dict[str, tuple[int, int]]:
    """Return the lowest and highest offset of each bias.

    Returns: Range by name, in the camera's own steps from the factory value.

    Examples
    --------
    >>> bias_ranges()["bias_refr"]
    (-50, 255)
    """
    ranges = {}
    for name, field in BiasesConfig.model_fields.items():
        low = next(int(cast("int", one.ge)) for one in field.metadata if isinstance(one, Ge))
        high = next(int(cast("int", one.le)) for one in field.metadata if isinstance(one, Le))
        ranges[name] = (low, high)
    return ranges


class CameraControl:
    """The camera's identity and settings.

    on_change: Called after each change, by any thread.
    """

    def __init__(self, camera: Camera, station: Station, on_change: Callable[[], None]) -> None:
        self._camera = camera
        self._config = station.camera
        self._kind = camera_kind(station)
        self._on_change = on_change
        self._lock = threading.Lock()
        self._loop: LiveLoop | None = None
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
        """Change one bias, and read all of them back.

        value: Offset from the factory value, in the camera's own steps.
        Raises ControlRefused: If there is no such bias, or the value is outside its range; nothing was sent.
        Raises DriverError: If the camera refuses the value, or is lost.
        """
        ranges = bias_ranges()
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
            wanted = {one: int(self.biases.get(one, 0)) for one in ranges} | {name: value}
            event_camera = cast("EventCamera", self._camera)

            def change() -> CameraSettings:
                return event_camera.apply(CameraSettings(wanted, trigger_in=True, roi=config.roi))

            assert self._loop is not None
            found = self._loop.on_camera(change).result(timeout=ANSWER_S)
            self.settings = {**self.settings, "biases": dict(found.biases)}
        self._on_change()
        return self.biases

    def set_frame(self, name: str, value: float) -> Mapping[str, float | None]:
        """Change exposure or gain of a frame camera, and read both back.

        name: ``exposure`` or ``gain``.
        value: New value, in the units of the camera's driver.
        Raises ControlRefused: If this camera has no such setting; nothing was sent.
        Raises DriverError: If the camera refuses the value, or is lost.
        """
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
        ranges = bias_ranges()
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
