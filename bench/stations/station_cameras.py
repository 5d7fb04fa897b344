"""What a station file says of cameras: their words, their bounds, their defaults.

One model a driver; `devices` opens what they describe.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from bench.stations.station_fields import Port, Serial, Text
from drivers.camera.frames import FrameSettings
from sequences.schema import StrictModel

NotNegative = Annotated[int, Field(ge=0, le=8191)]
Pixels = Annotated[int, Field(gt=0, le=8192)]


class BiasesConfig(StrictModel):
    """Offsets from the factory values, within what an IMX636 takes; those not named stay at 0."""

    bias_diff_on: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_diff_off: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_fo: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_hpf: Annotated[int, Field(ge=0, le=255)] = 0
    bias_refr: Annotated[int, Field(ge=-50, le=255)] = 0


class EventCameraConfig(StrictModel):
    """What every camera has."""

    serial: Serial
    biases: BiasesConfig = BiasesConfig()
    roi: Annotated[
        tuple[NotNegative, NotNegative, Pixels, Pixels] | None,
        Field(
            description="Only part of the sensor: column, row, width, height, px. `metavision` alone sets it."
        ),
    ] = None
    lens: Text | None = None

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports it is reached by; cameras on USB have none."""
        return ()


class SimulatedEvk4Config(EventCameraConfig):
    """A simulated EVK4, reached over a local socket."""

    driver: Literal["simulated_evk4"]
    address: Port

    @property
    def ports(self) -> tuple[str, ...]:
        """Its address."""
        return (self.address,)


class MetavisionConfig(EventCameraConfig):
    """A Prophesee camera, reached through Metavision or OpenEB as installed on this computer."""

    driver: Literal["metavision"]


class NeuromorphicEvk4Config(EventCameraConfig):
    """An EVK4 reached through `neuromorphic-drivers` (extra ``evk4``), without the vendor's software."""

    driver: Literal["neuromorphic_evk4"]


class RecordedCameraConfig(EventCameraConfig):
    """RAW recordings played as a camera, one a recording in the order of their names."""

    driver: Literal["recorded"]
    path: Path


class FrameCameraConfig(StrictModel):
    """What every frame camera has; its light burns steadily."""

    serial: Annotated[
        str, Field(max_length=64, description="As USB tells it; without it, any camera will do.")
    ] = ""
    lens: Text | None = None
    pictures: Annotated[int, Field(ge=1, le=1000, description="Taken at each pose, and averaged.")] = 8

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports it is reached by."""
        return ()

    def settings(self) -> FrameSettings:
        """Settings as drivers take them."""
        return FrameSettings()


class OpenCvCameraConfig(FrameCameraConfig):
    """Whatever OpenCV opens as a video source: a video device, a network camera."""

    driver: Literal["opencv"]
    source: Annotated[
        Port, Field(description="/dev/v4l/by-id/..., a number, or a URL (rtsp://, http://, tcp://).")
    ]
    exposure: Annotated[float | None, Field(description="In the camera driver's own units.")] = None
    gain: Annotated[float | None, Field(description="In the camera driver's own units.")] = None

    @property
    def ports(self) -> tuple[str, ...]:
        """Its source."""
        return (self.source,)

    def settings(self) -> FrameSettings:
        """Settings as drivers take them."""
        return FrameSettings(self.exposure, self.gain)


class PictureFolderConfig(FrameCameraConfig):
    """A folder of pictures played as a camera, so many a recording in the order of their names."""

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
