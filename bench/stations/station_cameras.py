"""The camera section of a station file: keys, ranges and defaults. One model for each driver; `devices` opens them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from bench.stations.station_fields import Port, Serial, Text, VideoSource
from drivers.camera.frames import FrameSettings
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
        VideoSource, Field(description="/dev/v4l/by-id/..., a number, or a URL (rtsp://, http://, tcp://).")
    ]
    exposure: Annotated[float | None, Field(description="In the units of the camera's driver.")] = None
    gain: Annotated[float | None, Field(description="In the units of the camera's driver.")] = None

    @property
    def ports(self) -> tuple[str, ...]:
        """Source of the pictures."""
        return (self.source,)

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
