"""What a queue file may say: the jobs of a night, in which order, how often, and what follows a failure.

Knows the shape of one document as pydantic models; touches no file and no device.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from sequences.schema import Name, Words

Key = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$")]
File = Annotated[str, Field(min_length=1, max_length=500)]


class JobWords(Words):
    """One sequence on one station, once or repeated."""

    name: Key
    sequence: File
    station: File
    operator: Name | None = None
    seed: Annotated[int, Field(ge=0, le=2**62)] | None = None
    priority: Annotated[int, Field(ge=-100, le=100)] = 0
    times: Annotated[int, Field(ge=1, le=1000)] = 1
    every_min: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    attempts: Annotated[int, Field(ge=1, le=20)] = 2
    on_failure: Literal["continue", "stop"] = "continue"


class Queue(Words):
    """A queue file."""

    format: Literal["starbench/queue/1"]
    name: Name
    stop_after_h: Annotated[float, Field(gt=0, le=1000)] | None = None
    jobs: Annotated[list[JobWords], Field(min_length=1, max_length=200)]

    @model_validator(mode="after")
    def _names_differ(self) -> Queue:
        names = [job.name for job in self.jobs]
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            raise PydanticCustomError(
                "doubled", "two jobs have the same name: {names}.", {"names": ", ".join(doubled)}
            )
        return self
