"""The script as it is run: numbered steps, one after another, with nothing left to look up.

Knows what a step holds. ``sequences.flatten`` makes steps from a sequence; the bench runs them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sequences.schema import (
    Answer,
    CalibrationModel,
    DistortionTerm,
    GateWords,
    ImageKind,
    Loss,
    OnFailure,
    Waveform,
)
from sequences.yaml_text import DocumentPath


@dataclass(frozen=True)
class Flicker:
    """What a light is to do; its level is a share of what the station's light may do."""

    waveform: Waveform
    frequency_hz: float
    duty_percent: float
    level_percent: float


@dataclass(frozen=True)
class Pose:
    """A direction of the camera.

    Attributes
    ----------
    index
        From 1 over the recordings of the run; 0 for a pose at which nothing is recorded.
    name
        For people; no two poses of a run share it.
    angles_deg
        Angle by axis, for every axis the sequence names anywhere.
    """

    index: int
    name: str
    angles_deg: Mapping[str, float]

    @property
    def key(self) -> str:
        """For files: ``pose-001``."""
        return f"pose-{self.index:03d}"


@dataclass(frozen=True)
class Gates:
    """What a recording must show to be accepted.

    ``limits`` hold the least (``min_...``) and the most (``max_...``) of numbers that a recording tells of itself, by
    their names.
    """

    min_stars: int
    max_event_rate_mev_s: float
    require_triggers: bool
    limits: Mapping[str, float] = field(default_factory=lambda: Gates.from_words(dict(GateWords())).limits)

    @classmethod
    def from_words(cls, words: Mapping[str, Any]) -> Gates:
        """Take a sequence's words, ``GateWords`` as a mapping."""
        limits = {name: limit for name, limit in words.items() if limit is not None}
        stars, rate = limits.pop("min_stars"), limits.pop("max_event_rate_mev_s")
        return cls(stars, rate, limits.pop("require_triggers"), limits)


# Every step has the same first three fields:
#   number  from 1 over the run
#   where   ``file:line:column`` of its word in the sequence
#   path    the same place inside the document


@dataclass(frozen=True)
class LightStep:
    """Switch the light to a flicker, or off (``flicker`` is None)."""

    number: int
    where: str
    path: DocumentPath
    flicker: Flicker | None


@dataclass(frozen=True)
class MoveStep:
    """Turn the camera into a pose."""

    number: int
    where: str
    path: DocumentPath
    pose: Pose


@dataclass(frozen=True)
class SettleStep:
    """Stand still that long."""

    number: int
    where: str
    path: DocumentPath
    duration_s: float


@dataclass(frozen=True)
class RecordStep:
    """Record at a pose, until a recording passes its gates or the attempts are used up.

    The ``backoff_s`` before the second attempt doubles with every further one; ``hold_s`` bounds how long
    ``on_failure: hold`` waits for an answer.
    """

    number: int
    where: str
    path: DocumentPath
    pose: Pose
    window_ms: float
    image: ImageKind
    attempts: int
    backoff_s: float
    on_failure: OnFailure
    hold_s: float
    gates: Gates


@dataclass(frozen=True)
class WaitStep:
    """Let time pass."""

    number: int
    where: str
    path: DocumentPath
    duration_s: float


@dataclass(frozen=True)
class PromptStep:
    """Ask the operator; the default answer counts after the time-out."""

    number: int
    where: str
    path: DocumentPath
    text: str
    default: Answer
    timeout_s: float


@dataclass(frozen=True)
class SolveStep:
    """Calibrate from the poses recorded so far.

    ``huber_px`` None leaves the choice to the engine; ``limits`` are the most each named result may show.
    """

    number: int
    where: str
    path: DocumentPath
    model: CalibrationModel
    distortion: tuple[DistortionTerm, ...]
    loss: Loss
    huber_px: float | None
    limits: Mapping[str, float]


@dataclass(frozen=True)
class ReportStep:
    """Write the report and seal the run."""

    number: int
    where: str
    path: DocumentPath


Step = LightStep | MoveStep | SettleStep | RecordStep | WaitStep | PromptStep | SolveStep | ReportStep
