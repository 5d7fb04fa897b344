"""The queue file, and that of one job for a running batch, as pydantic models; no file or device is opened."""

from __future__ import annotations

import zoneinfo
from collections import Counter
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from sequences.schema import Name
from sequences.strict_model import Form, StrictModel

Key = Annotated[
    str,
    Form(r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$", "up to 40 letters from A to Z, digits, - and _, such as cam-7"),
]
SettingPath = Annotated[
    str,
    Field(max_length=200),
    Form(
        r"^(sequence|station)(\.[A-Za-z0-9_]+)+$",
        "a path into the sequence or the station, such as sequence.defaults.record.window_ms",
    ),
]
Value = Annotated[str, Field(max_length=1000), Form(r"^[^\r\n]*$", "one line of text")]
File = Annotated[str, Field(min_length=1, max_length=500)]
TimeOfDay = Annotated[
    str,
    Form(r"^([01][0-9]|2[0-3]):[0-5][0-9]$", "a time of day from 00:00 to 23:59, such as 07:30"),
    Field(description="Local time such as 22:30; the next occurrence counts."),
]


def _known_zone(name: str) -> str:
    try:
        zoneinfo.ZoneInfo(name)
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
        raise ValueError("unknown time zone; write it like Europe/Berlin or UTC.") from None
    return name


Zone = Annotated[
    str, AfterValidator(_known_zone), Field(max_length=80, description="For example Europe/Berlin.")
]


class JobConfig(StrictModel):
    """One sequence on one station, once or repeated."""

    name: Key
    sequence: File
    station: File
    settings: dict[SettingPath, Value] = Field(default_factory=dict)
    """Values that replace those of the files, as YAML by path."""
    operator: Name | None = None
    seed: Annotated[int, Field(ge=0, le=2**62)] | None = None
    priority: Annotated[int, Field(ge=-100, le=100)] = 0
    start_at: TimeOfDay | None = None
    times: Annotated[int, Field(ge=1, le=1000)] = 1
    every_min: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    attempts: Annotated[int, Field(ge=1, le=20)] = 2
    on_failure: Literal["continue", "stop"] = "continue"


class JobFile(JobConfig):
    """A file with one job, to add to a running batch."""

    format: Literal["starbench/job/1"]

    def job(self) -> JobConfig:
        """Return the job in the form of a queue's jobs, without ``format``."""
        return JobConfig(**self.model_dump(exclude={"format"}))


class Queue(StrictModel):
    """A queue file."""

    format: Literal["starbench/queue/1"]
    name: Name
    zone: Zone | None = None
    start_at: TimeOfDay | None = None
    stop_by: TimeOfDay | None = None
    stop_after_h: Annotated[float, Field(gt=0, le=1000)] | None = None
    jobs: Annotated[list[JobConfig], Field(min_length=1, max_length=200)]

    @property
    def tzinfo(self) -> zoneinfo.ZoneInfo | None:
        """Time zone of the queue's times of day; None means this computer's local time."""
        return zoneinfo.ZoneInfo(self.zone) if self.zone else None

    @model_validator(mode="after")
    def _names_differ(self) -> Queue:
        names = [job.name for job in self.jobs]
        known = Counter(name.lower() for name in names)  # some file systems ignore case in folder names
        doubled = sorted({name for name in names if known[name.lower()] > 1})
        if doubled:
            raise ValueError(f"two jobs have the same name: {', '.join(doubled)}.")
        return self
