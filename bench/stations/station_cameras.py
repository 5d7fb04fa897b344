"""The camera section of a station file: keys, ranges and defaults. One model for each driver; `devices` opens them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from bench.base.errors import UsageError
from bench.stations.sections import (
    BiasesConfig,
    EventCameraConfig,
    EventCameraSection,
    FrameCameraConfig,
    FrameCameraSection,
    with_plugins,
)
from bench.stations.station_fields import Port, Variable, VideoSource
from drivers.camera.frames import FrameSettings
from drivers.port_address import SOURCE_REMEDY, refused_source

__all__ = [
    "BiasesConfig",
    "CameraConfig",
    "EventCameraConfig",
    "FrameCameraConfig",
    "MetavisionConfig",
    "NeuromorphicEvk4Config",
    "OpenCvCameraConfig",
    "PictureFolderConfig",
    "RecordedCameraConfig",
    "SimulatedEvk4Config",
]


class SimulatedEvk4Config(EventCameraConfig):
    """A simulated EVK4, connected through a local socket."""

    driver: Literal["simulated_evk4"]
    address: Port

    @property
    def ports(self) -> tuple[str, ...]:
        """Address of the camera."""
        return (self.address,)


class MetavisionConfig(EventCameraConfig):
    """A Prophesee camera, through the Metavision SDK or OpenEB installed on this computer."""

    driver: Literal["metavision"]


class NeuromorphicEvk4Config(EventCameraConfig):
    """An EVK4, through `neuromorphic-drivers` (extra ``evk4``), without the maker's software."""

    driver: Literal["neuromorphic_evk4"]


class RecordedCameraConfig(EventCameraConfig):
    """RAW files replayed as a camera: one for each recording, in the order of their names."""

    driver: Literal["recorded"]
    path: Path


class OpenCvCameraConfig(FrameCameraConfig):
    """A video source that OpenCV opens: a video device or a network camera."""

    driver: Literal["opencv"]
    source: Annotated[
        VideoSource | None,
        Field(description="/dev/v4l/by-id/..., a number, or a URL (rtsp://, http://, tcp://)."),
    ] = None
    source_env: Annotated[
        Variable | None,
        Field(description="Environment variable that holds the source, for a URL with a password."),
    ] = None
    exposure: Annotated[float | None, Field(description="In the units of the camera's driver.")] = None
    gain: Annotated[float | None, Field(description="In the units of the camera's driver.")] = None

    @property
    def ports(self) -> tuple[str, ...]:
        """Source of the pictures; that of an environment variable is not known here."""
        return () if self.source is None else (self.source,)

    @model_validator(mode="after")
    def _one_source(self) -> OpenCvCameraConfig:
        if (self.source is None) == (self.source_env is None):
            raise PydanticCustomError("one_source", "give either source or source_env.")
        return self

    def source_in_use(self, environ: Mapping[str, str] = os.environ) -> str:
        """Return the source to open; it is secret if an environment variable holds it."""
        if self.source is not None:
            return self.source
        name = str(self.source_env)
        found = environ.get(name, "")
        if not found:
            what = f"The environment variable {name} is not set; the station's camera needs it (source_env)."
            raise UsageError(what, remedy=f"Set it to the address of the camera: export {name}=...")
        if refused_source(found) is not None:
            raise UsageError(f"The environment variable {name} is not a source.", remedy=SOURCE_REMEDY)
        return found

    def settings(self) -> FrameSettings:
        """See `FrameCameraConfig.settings`."""
        return FrameSettings(self.exposure, self.gain)


class PictureFolderConfig(FrameCameraConfig):
    """A folder of pictures replayed as a camera, ``pictures`` for each recording, in the order of their names."""

    driver: Literal["pictures"]
    path: Path


if TYPE_CHECKING:
    _Cameras = (
        SimulatedEvk4Config
        | MetavisionConfig
        | NeuromorphicEvk4Config
        | RecordedCameraConfig
        | OpenCvCameraConfig
        | PictureFolderConfig
        | EventCameraSection
        | FrameCameraSection
    )
else:
    _BUILT_IN = (
        SimulatedEvk4Config,
        MetavisionConfig,
        NeuromorphicEvk4Config,
        RecordedCameraConfig,
        OpenCvCameraConfig,
        PictureFolderConfig,
    )
    _Cameras = with_plugins("camera", _BUILT_IN)

CameraConfig = _Cameras
