"""What a station file says about interlocks: what makes a run hold of itself, when it goes on, how long it may hold.

Words and bounds alone; what they do stands in `bench.run.interlocks`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from bench.stations.station_fields import Positive, Text
from sequences.schema import StrictModel

Hold = Annotated[float, Field(gt=0, le=86_400, description="Longest hold in a run, all its holds together.")]


class _InterlockConfig(StrictModel):
    max_hold_s: Hold = 1800.0


class DoorConfig(_InterlockConfig):
    """A sensor of the enclosure: a file that holds one word, as the kernel's GPIO files do; anything else is open."""

    path: Text
    closed: Annotated[Text, Field(description="What the file holds while the door is closed.")] = "1"
    max_age_s: Annotated[Positive | None, Field(description="Older, the file tells nothing: open.")] = None


class CameraTemperatureConfig(_InterlockConfig):
    """The camera's sensor gets too warm."""

    max_c: Annotated[float, Field(ge=-50, le=150)]
    release_c: Annotated[float, Field(ge=-50, le=150)]

    @model_validator(mode="after")
    def _cooler(self) -> CameraTemperatureConfig:
        if self.release_c >= self.max_c:
            raise PydanticCustomError(
                "release", "release_c must be below max_c, else it would go on and off."
            )
        return self


class EventRateConfig(_InterlockConfig):
    """Light from elsewhere: after a recording of too high a rate, the rate in the dark must be low again."""

    max_mev_s: Positive
    release_mev_s: Positive
    probe_ms: Annotated[float, Field(ge=1, le=1000, description="Length of the recordings in the dark.")] = (
        20.0
    )

    @model_validator(mode="after")
    def _lower(self) -> EventRateConfig:
        if self.release_mev_s >= self.max_mev_s:
            raise PydanticCustomError(
                "release", "release_mev_s must be below max_mev_s, else it would go on and off."
            )
        return self


class DiskSpaceConfig(_InterlockConfig):
    """Room on the run's disk."""

    min_free_gb: Positive
    release_gb: Positive

    @model_validator(mode="after")
    def _more(self) -> DiskSpaceConfig:
        if self.release_gb < self.min_free_gb:
            raise PydanticCustomError("release", "release_gb must not be below min_free_gb.")
        return self


class DeviceLostConfig(_InterlockConfig):
    """A device that went away is waited for, opened anew, seen to be the same one, and homed where it must be."""

    retry_s: Annotated[float, Field(ge=0.1, le=600)] = 5.0


class InterlocksConfig(StrictModel):
    """Interlocks of a station; none unless named."""

    door: DoorConfig | None = None
    camera_temperature: CameraTemperatureConfig | None = None
    event_rate: EventRateConfig | None = None
    disk_space: DiskSpaceConfig | None = None
    device_lost: DeviceLostConfig | None = None


InterlockName = Literal["door", "camera_temperature", "event_rate", "disk_space", "device_lost"]
