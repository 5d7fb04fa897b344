"""The camera section of a station file: keys, ranges and defaults, one model for each driver.

A driver is imported when its section is opened.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import model_validator

from bench.base.clock import BenchClock
from bench.base.errors import UsageError
from bench.stations.plugins import with_plugins
from bench.stations.sections import EventCameraSection, FrameCameraSection, PortName
from bench.stations.station_fields import Port, Variable, VideoSource
from drivers.camera import EventCamera
from drivers.camera.frames import FrameCamera, FrameSettings
from drivers.port_address import SOURCE_REMEDY, refused_source


class SimulatedEvk4Config(EventCameraSection):
    """A simulated EVK4, connected through a local socket."""

    driver: Literal["simulated_evk4"]
    address: Port

    @property
    def ports(self) -> tuple[str, ...]:
        """Address of the camera."""
        return (self.address,)

    def open_device(self, port: PortName, *, clock: BenchClock) -> EventCamera:
        """See `EventCameraSection.open_device`."""
        from drivers.camera.simulated_evk4 import SimulatedEvk4Camera

        return SimulatedEvk4Camera.open(
            port(self.address), serial=self.serial, clock=clock, utc_now=clock.utc_now
        )


class MetavisionConfig(EventCameraSection):
    """A Prophesee camera, through the Metavision SDK or OpenEB installed on this computer."""

    driver: Literal["metavision"]

    def open_device(self, port: PortName, *, clock: BenchClock) -> EventCamera:  # noqa: ARG002 - it has no port
        """See `EventCameraSection.open_device`."""
        from drivers.camera.metavision import MetavisionEvk4

        return MetavisionEvk4.open(serial=self.serial, clock=clock)


class NeuromorphicEvk4Config(EventCameraSection):
    """An EVK4, through `neuromorphic-drivers` (extra ``evk4``), without the maker's software."""

    driver: Literal["neuromorphic_evk4"]

    def open_device(self, port: PortName, *, clock: BenchClock) -> EventCamera:  # noqa: ARG002 - it has no port
        """See `EventCameraSection.open_device`."""
        from drivers.camera.neuromorphic_evk4 import NeuromorphicEvk4

        return NeuromorphicEvk4.open(serial=self.serial, clock=clock, utc_now=clock.utc_now)


class RecordedCameraConfig(EventCameraSection):
    """RAW files replayed as a camera: one for each recording, in the order of their names."""

    driver: Literal["recorded"]
    path: Path

    def open_device(self, port: PortName, *, clock: BenchClock) -> EventCamera:  # noqa: ARG002 - it has no port
        """See `EventCameraSection.open_device`."""
        from drivers.camera.recorded import RecordedCamera

        return RecordedCamera.open(self.path, serial=self.serial, clock=clock)


class OpenCvCameraConfig(FrameCameraSection):
    """A video source that OpenCV opens: a video device or a network camera."""

    driver: Literal["opencv"]
    source: VideoSource | None = None
    """/dev/v4l/by-id/..., a number, or a URL (rtsp://, http://, tcp://)."""
    source_env: Variable | None = None
    """Environment variable that holds the source, for a URL with a password."""
    exposure: float | None = None
    """In the units of the camera's driver."""
    gain: float | None = None
    """In the units of the camera's driver."""

    @property
    def ports(self) -> tuple[str, ...]:
        """Source of the pictures; that of an environment variable is not known here."""
        return () if self.source is None else (self.source,)

    @model_validator(mode="after")
    def _one_source(self) -> OpenCvCameraConfig:
        if (self.source is None) == (self.source_env is None):
            raise ValueError("give either source or source_env.")
        return self

    def source_in_use(self, environ: Mapping[str, str] = os.environ) -> str:
        """Return the source to open; it is secret if an environment variable holds it."""
        if self.source is not None:
            return self.source
        name = str(self.source_env)
        source = environ.get(name, "")
        if not source:
            what = f"The environment variable {name} is not set; the station's camera needs it (source_env)."
            raise UsageError(what, remedy=f"Set it to the address of the camera: export {name}=...")
        if refused_source(source) is not None:
            raise UsageError(f"The environment variable {name} is not a source.", remedy=SOURCE_REMEDY)
        return source

    def settings(self) -> FrameSettings:
        """See `FrameCameraSection.settings`."""
        return FrameSettings(self.exposure, self.gain)

    def open_device(self, port: PortName, *, clock: BenchClock) -> FrameCamera:
        """See `FrameCameraSection.open_device`."""
        from drivers.camera.frame_cameras import OpenCvFrameCamera

        source = port(self.source_in_use())
        hidden = f"${self.source_env}" if self.source_env else ""
        return OpenCvFrameCamera.open(source, serial=self.serial, clock=clock, shown_as=hidden)


class PictureFolderConfig(FrameCameraSection):
    """A folder of pictures replayed as a camera, ``pictures`` for each recording, in the order of their names."""

    driver: Literal["pictures"]
    path: Path

    def open_device(self, port: PortName, *, clock: BenchClock) -> FrameCamera:  # noqa: ARG002 - it has no port
        """See `FrameCameraSection.open_device`."""
        from drivers.camera.frame_cameras import FolderFrameCamera

        return FolderFrameCamera.open(self.path, serial=self.serial, clock=clock)


if TYPE_CHECKING:
    CameraConfig = EventCameraSection | FrameCameraSection
else:
    CameraConfig = with_plugins(
        "camera",
        (
            SimulatedEvk4Config,
            MetavisionConfig,
            NeuromorphicEvk4Config,
            RecordedCameraConfig,
            OpenCvCameraConfig,
            PictureFolderConfig,
        ),
    )
