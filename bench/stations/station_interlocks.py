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


class _Bounded(StrictModel):
    max_hold_s: Hold = 1800.0


class DoorWords(_Bounded):
    """A sensor of the enclosure: a file that holds one word, as the kernel's GPIO files do; anything else is open."""

    path: Text
    closed: Annotated[Text, Field(description="What the file holds while the door is closed.")] = "1"
    max_age_s: Annotated[Positive | None, Field(description="Older, the file tells nothing: open.")] = None


class CameraTemperatureWords(_Bounded):
    """The camera's sensor gets too warm."""

    max_c: Annotated[float, Field(ge=-50, le=150)]
    release_c: Annotated[float, Field(ge=-50, le=150)]

    @model_validator(mode="after")
    def _cooler(self) -> CameraTemperatureWords:
        if self.release_c >= self.max_c:
            raise PydanticCustomError(
                "release", "release_c must be below max_c, else it would go on and off."
            )
        return self


class EventRateWords(_Bounded):
    """Light from elsewhere: after a recording of too high a rate, the rate in the dark must be low again."""

    max_mev_s: Positive
    release_mev_s: Positive
    probe_ms: Annotated[float, Field(ge=1, le=1000, description="Length of the recordings in the dark.")] = (
        20.0
    )

    @model_validator(mode="after")
    def _lower(self) -> EventRateWords:
        if self.release_mev_s >= self.max_mev_s:
            raise PydanticCustomError(
                "release", "release_mev_s must be below max_mev_s, else it would go on and off."
            )
        return self


class DiskSpaceWords(_Bounded):
    """Room on the run's disk."""

    min_free_gb: Positive
    release_gb: Positive

    @model_validator(mode="after")
    def _more(self) -> DiskSpaceWords:
        if self.release_gb < self.min_free_gb:
            raise PydanticCustomError("release", "release_gb must not be below min_free_gb.")
        return self


class DeviceLostWords(_Bounded):
    """A device that went away is waited for, opened anew, seen to be the same one, and homed where it must be."""

    retry_s: Annotated[float, Field(ge=0.1, le=600)] = 5.0


class InterlockWords(StrictModel):
    """Interlocks of a station; none unless named."""

    door: DoorWords | None = None
    camera_temperature: CameraTemperatureWords | None = None
    event_rate: EventRateWords | None = None
    disk_space: DiskSpaceWords | None = None
    device_lost: DeviceLostWords | None = None


InterlockName = Literal["door", "camera_temperature", "event_rate", "disk_space", "device_lost"]
