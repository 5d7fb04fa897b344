"""The interlocks section of a station file: what makes a run hold, when the run continues, and the longest hold.

This module has the keys and their ranges; `bench.run.interlocks` has the interlocks.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from bench.stations.station_fields import Positive, Text
from sequences.strict_model import StrictModel

Hold = Annotated[
    float,
    Field(gt=0, le=86_400, description="Longest hold of this interlock in a run, all its holds together, s."),
]


class _InterlockConfig(StrictModel):
    max_hold_s: Hold = 1800.0


class DoorConfig(_InterlockConfig):
    """A sensor of the enclosure: a file with one word, such as a GPIO file of the kernel. Any other word means open."""

    path: Text
    closed: Annotated[Text, Field(description="Word in the file while the door is closed.")] = "1"
    max_age_s: Annotated[Positive | None, Field(description="A file older than this means open, s.")] = None


class CameraTemperatureConfig(_InterlockConfig):
    """The image sensor is too warm."""

    max_c: Annotated[float, Field(ge=-50, le=150)]
    release_c: Annotated[float, Field(ge=-50, le=150)]

    @model_validator(mode="after")
    def _cooler(self) -> CameraTemperatureConfig:
        if self.release_c >= self.max_c:
            raise PydanticCustomError(
                "release", "release_c must be below max_c; otherwise the hold would switch on and off."
            )
        return self


class EventRateConfig(_InterlockConfig):
    """Ambient light: after a recording with too high an event rate, the rate in the dark must become low again."""

    max_mev_s: Positive
    release_mev_s: Positive
    probe_ms: Annotated[
        float, Field(ge=1, le=1000, description="Duration of a recording in the dark, ms.")
    ] = 20.0

    @model_validator(mode="after")
    def _lower(self) -> EventRateConfig:
        if self.release_mev_s >= self.max_mev_s:
            raise PydanticCustomError(
                "release",
                "release_mev_s must be below max_mev_s; otherwise the hold would switch on and off.",
            )
        return self


class DiskSpaceConfig(_InterlockConfig):
    """Free space on the disk of the run folder."""

    min_free_gb: Positive
    release_gb: Positive

    @model_validator(mode="after")
    def _more(self) -> DiskSpaceConfig:
        if self.release_gb < self.min_free_gb:
            raise PydanticCustomError("release", "release_gb must not be below min_free_gb.")
        return self


class DeviceLostConfig(_InterlockConfig):
    """A device was disconnected: the run waits, opens it again, checks its identity, and homes it if needed."""

    retry_s: Annotated[float, Field(ge=0.1, le=600)] = 5.0


class InterlocksConfig(StrictModel):
    """Interlocks of a station; only those that are named are active."""

    door: DoorConfig | None = None
    camera_temperature: CameraTemperatureConfig | None = None
    event_rate: EventRateConfig | None = None
    disk_space: DiskSpaceConfig | None = None
    device_lost: DeviceLostConfig | None = None


InterlockName = Literal["door", "camera_temperature", "event_rate", "disk_space", "device_lost"]
