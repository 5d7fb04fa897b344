"""What a queue file may say: the jobs of a night, in which order, when, how often, and what follows a failure.

Knows the shape of two documents as pydantic models, a queue and a single job to add to one; touches no other file
and no device.
"""

from __future__ import annotations

import zoneinfo
from collections import Counter
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from sequences.schema import Name, Words

Key = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$")]
SettingPath = Annotated[str, Field(max_length=200, pattern=r"^(sequence|station)(\.[A-Za-z0-9_]+)+$")]
Value = Annotated[str, Field(max_length=1000, pattern=r"^[^\r\n]*$")]
File = Annotated[str, Field(min_length=1, max_length=500)]
TimeOfDay = Annotated[
    str,
    Field(
        pattern=r"^([01][0-9]|2[0-3]):[0-5][0-9]$", description="Local time, as 22:30: its next occurrence."
    ),
]


def _known_zone(name: str) -> str:
    try:
        zoneinfo.ZoneInfo(name)
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
        raise PydanticCustomError(
            "no_such_zone", "no such time zone here; they are called as Europe/Berlin or UTC."
        ) from None
    return name


Zone = Annotated[str, AfterValidator(_known_zone), Field(max_length=80, description="As Europe/Berlin.")]


class JobWords(Words):
    """One sequence on one station, once or repeated."""

    name: Key
    sequence: File
    station: File
    settings: dict[SettingPath, Value] = Field(
        default_factory=dict, description="What is set otherwise than the files say, as YAML by path."
    )
    operator: Name | None = None
    seed: Annotated[int, Field(ge=0, le=2**62)] | None = None
    priority: Annotated[int, Field(ge=-100, le=100)] = 0
    start_at: TimeOfDay | None = None
    times: Annotated[int, Field(ge=1, le=1000)] = 1
    every_min: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    attempts: Annotated[int, Field(ge=1, le=20)] = 2
    on_failure: Literal["continue", "stop"] = "continue"


class JobFile(JobWords):
    """A file with one job, to be added to a batch under way."""

    format: Literal["starbench/job/1"]

    def words(self) -> JobWords:
        """Give the job as a queue has it."""
        return JobWords(**self.model_dump(exclude={"format"}))


class Queue(Words):
    """A queue file."""

    format: Literal["starbench/queue/1"]
    name: Name
    zone: Zone | None = None
    start_at: TimeOfDay | None = None
    stop_by: TimeOfDay | None = None
    stop_after_h: Annotated[float, Field(gt=0, le=1000)] | None = None
    jobs: Annotated[list[JobWords], Field(min_length=1, max_length=200)]

    @property
    def tzinfo(self) -> zoneinfo.ZoneInfo | None:
        """Whose clocks its times of day are read on; None for those of this machine."""
        return zoneinfo.ZoneInfo(self.zone) if self.zone else None

    @model_validator(mode="after")
    def _names_differ(self) -> Queue:
        names = [job.name for job in self.jobs]
        known = Counter(
            name.lower() for name in names
        )  # not every disk tells A from a in the name of a folder
        doubled = sorted({name for name in names if known[name.lower()] > 1})
        if doubled:
            raise PydanticCustomError(
                "doubled", "two jobs have the same name: {names}.", {"names": ", ".join(doubled)}
            )
        return self
