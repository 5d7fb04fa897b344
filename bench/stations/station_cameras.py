"""The camera section of a station file: keys, ranges and defaults. One model for each driver; `devices` opens them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from bench.base.errors import UsageError
from bench.stations.station_fields import Port, Serial, Text, Variable, VideoSource
from drivers.camera.frames import FrameSettings
from drivers.port_address import SOURCE_REMEDY, refused_source
from sequences.strict_model import StrictModel

NotNegative = Annotated[int, Field(ge=0, le=8191)]
Pixels = Annotated[int, Field(gt=0, le=8192)]


class BiasesConfig(StrictModel):
    """Bias offsets from the factory values, within the ranges of the IMX636. The default is 0."""

    bias_diff_on: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_diff_off: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_fo: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_hpf: Annotated[int, Field(ge=0, le=255)] = 0
    bias_refr: Annotated[int, Field(ge=-50, le=255)] = 0


class EventCameraConfig(StrictModel):
    """Keys of every event camera."""

    serial: Serial
    biases: BiasesConfig = BiasesConfig()
    roi: Annotated[
        tuple[NotNegative, NotNegative, Pixels, Pixels] | None,
        Field(
            description="Region of interest: column, row, width, height, px. Only the driver `metavision` sets it."
        ),
    ] = None
    lens: Text | None = None

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports of the camera; a camera on USB has none."""
        return ()


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


class FrameCameraConfig(StrictModel):
    """Keys of every frame camera. Its light is steady."""

    serial: Annotated[
        str, Field(max_length=64, description="Serial number on USB. If it is empty, any camera is accepted.")
    ] = ""
    lens: Text | None = None
    pictures: Annotated[
        int, Field(ge=1, le=1000, description="Number of pictures that are averaged at each pose.")
    ] = 8

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports of the camera; most have none."""
        return ()

    def settings(self) -> FrameSettings:
        """Return the settings for the driver.

        Returns
        -------
        FrameSettings
            Exposure and gain in the units of the camera's driver; None leaves them unchanged.
        """
        return FrameSettings()


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
        """Return the source to open.

        Parameters
        ----------
        environ
            Environment variables of the process.

        Returns
        -------
        str
            The source; it is secret if an environment variable holds it.

        Raises
        ------
        UsageError
            When the environment variable is not set, or holds something that is not a source.
        """
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


CameraConfig = Annotated[
    SimulatedEvk4Config
    | MetavisionConfig
    | NeuromorphicEvk4Config
    | RecordedCameraConfig
    | OpenCvCameraConfig
    | PictureFolderConfig,
    Field(discriminator="driver"),
]
