"""The script as the bench runs it: numbered steps in order (`sequences.flatten`), each with all its settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from sequences.schema import Answer, GateConfig, ImageKind, OnFailure, Waveform
from sequences.solve_schema import CalibrationModel, DistortionTerm, Loss, Readings
from sequences.tree import DocumentPath

WAVEFORM_LIMITS: Mapping[Waveform, Mapping[str, float]] = {
    "square": {"max_event_rate_mev_s": 200.0, "max_flicker_disagreement_percent": 0.5},
    "sine": {"max_event_rate_mev_s": 500.0, "max_flicker_disagreement_percent": 5.0},
}
"""Default limits of gates that depend on the waveform. Under a sine, a lit pixel sends four times as many events. They
are spread over the period, so that the events alone give the frequency less well."""


@dataclass(frozen=True)
class Flicker:
    """A waveform for the light."""

    waveform: Waveform  # Shape of the light's level over time
    frequency_hz: float  # Periods in a second
    duty_percent: float  # Part of a period in which the light is bright
    level_percent: float  # Bright level, in percent of the brightest level that the station allows


@dataclass(frozen=True)
class Pose:
    """A direction of the camera."""

    index: int  # Number of the pose's recording, from 1 over the run; 0 if nothing is recorded at the pose
    name: str  # Unique among the poses of a run
    # Angle by axis, for every axis that the sequence names anywhere; empty for a pose that the run will
    # choose.
    angles_deg: Mapping[str, float]
    chosen_in_run: bool = False  # Whether the run chooses the angles while it measures (``until``)

    @property
    def key(self) -> str:
        """Name for files: ``pose-001``."""
        return f"pose-{self.index:03d}"


@dataclass(frozen=True)
class Gates:
    """Conditions that a recording must meet to be accepted."""

    min_stars: int  # Stars that must be found, at least
    max_event_rate_mev_s: float  # Highest event rate allowed, million events per second
    require_triggers: bool  # Whether every flicker period must have its sync edge
    # Lower (``min_...``) and upper (``max_...``) limits of the recording's other numbers, by name.
    limits: Mapping[str, float] = field(
        default_factory=lambda: Gates.from_settings(dict(GateConfig())).limits
    )

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any], waveform: Waveform = "square") -> Gates:
        """Make gates from the fields of a `GateConfig`; None sets no limit.

        The waveform of the light chooses the defaults of `WAVEFORM_LIMITS`.
        """
        usual = WAVEFORM_LIMITS.get(waveform, WAVEFORM_LIMITS["square"])
        every: dict[str, Any] = {
            name: usual.get(name) if limit is None else limit for name, limit in settings.items()
        }
        limits = {name: limit for name, limit in every.items() if limit is not None}
        stars, rate = limits.pop("min_stars"), limits.pop("max_event_rate_mev_s")
        return cls(stars, rate, limits.pop("require_triggers"), limits)


@dataclass(frozen=True)
class Until:
    """What an ``until`` step asks for, and the steps and poses that it unfolds into."""

    first: int  # Number of its first step
    last: int  # Number of its last step
    # Largest expanded uncertainties allowed, px: ``expanded_fx_px``, ``worst_corner_px``.
    goals: Mapping[str, float]
    at_most: int
    minutes: float | None  # Time after which no further pose is chosen, minutes; None for no limit
    starts: int  # How many of the poses are those of its ``start``
    poses: range  # Numbers of its poses: first those of its ``start``, then those that the run may choose


@dataclass(frozen=True)
class _NumberedStep:
    number: int  # From 1 over the run
    where: str  # ``file:line:column`` of the step in the sequence
    path: DocumentPath  # The same place, as keys and indices of the document


@dataclass(frozen=True)
class LightStep(_NumberedStep):
    """Switch the light to a flicker, or off (``flicker`` is None)."""

    word: ClassVar[str] = "light"

    flicker: Flicker | None


@dataclass(frozen=True)
class MoveStep(_NumberedStep):
    """Turn the camera to a pose."""

    word: ClassVar[str] = "move"

    pose: Pose


@dataclass(frozen=True)
class SettleStep(_NumberedStep):
    """Keep the stage still for ``duration_s`` before a recording."""

    word: ClassVar[str] = "settle"

    duration_s: float


@dataclass(frozen=True)
class RecordStep(_NumberedStep):
    """Record at a pose until a recording passes the gates or no attempt is left.

    ``backoff_s`` is the pause before the second attempt; it doubles before each further attempt. ``hold_s`` limits how
    long ``on_failure: hold`` waits for an answer.
    """

    word: ClassVar[str] = "record"

    pose: Pose
    window_ms: float
    image: ImageKind
    attempts: int
    backoff_s: float
    on_failure: OnFailure
    hold_s: float
    gates: Gates


@dataclass(frozen=True)
class WaitStep(_NumberedStep):
    """Let time pass."""

    word: ClassVar[str] = "wait"

    duration_s: float


@dataclass(frozen=True)
class PromptStep(_NumberedStep):
    """Ask the operator; after ``timeout_s`` the default answer counts."""

    word: ClassVar[str] = "prompt"

    text: str
    default: Answer
    timeout_s: float


@dataclass(frozen=True)
class SolveStep(_NumberedStep):
    """Calibrate from the poses recorded so far.

    What is None, the bench or the engine chooses. ``distortion`` holds coefficients in the order of their lens model,
    or ``auto``. ``passport`` is a file as the document names it, ``none`` for no passport, or None for the station's.
    ``limits`` are the upper limits of the named results. ``checked`` is the calibration that a step
    ``check`` compares with the result.
    """

    word: ClassVar[str] = "solve"

    model: CalibrationModel | None
    distortion: tuple[DistortionTerm, ...] | Literal["auto"]
    loss: Loss | None
    huber_px: float | None
    limits: Mapping[str, float]
    passport: str | None = None
    other_collimator: Literal["refuse", "accept"] = "refuse"
    readings: Readings = "auto"
    guard_band: float = 1.0
    checked: str | None = None


@dataclass(frozen=True)
class ChooseStep(_NumberedStep):
    """Calibrate from the poses so far, and choose the next pose of an ``until``, or end it.

    ``pose`` is the pose to choose, with its number and name, but without angles; None after the last one, when the
    step can only end the ``until``. ``solve`` holds the options of the calibration.
    """

    word: ClassVar[str] = "choose"

    until: Until
    pose: Pose | None
    solve: SolveStep


@dataclass(frozen=True)
class ReportStep(_NumberedStep):
    """Write the report and seal the run."""

    word: ClassVar[str] = "report"


Step = (
    LightStep
    | MoveStep
    | SettleStep
    | RecordStep
    | WaitStep
    | PromptStep
    | SolveStep
    | ChooseStep
    | ReportStep
)
