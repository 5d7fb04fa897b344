"""The sequence file as pydantic models: keys, units, defaults and bounds of the script language.

`sequences.reader` reads the text and places the faults; `sequences.flatten` unfolds a checked document into steps. The
module opens no file and no device. The fields of each model are explained in ``docs/sequences.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Discriminator, Field, Tag, model_validator

from sequences.solve_schema import CheckConfig, DistortionTerm, Limit, SolveConfig
from sequences.strict_model import Form, StrictModel, Within

LimitedResult = Literal["fx", "fy", "cx", "cy", "x", "y", "r", DistortionTerm]
Bound = Annotated[float, Field(ge=-1e12, le=1e12)]
AXES = ("pan", "tilt", "roll")

Axis = Literal["pan", "tilt", "roll"]
Waveform = Literal["square", "sine", "steady"]
ImageKind = Literal["auto", "last_polarity", "any", "count", "fired_per_edge", "lock_in", "on_latency"]
Answer = Literal["continue", "abort"]
OnFailure = Literal["fail", "skip", "hold"]

Angle = Annotated[float, Field(ge=-360, le=360)]
Name = Annotated[
    str,
    Field(min_length=1, max_length=80),
    Form(r"^\S(.*\S)?$", "one line of text without blanks at its ends"),
]

NotNegative = Annotated[float, Field(ge=0)]


class RuleConfig(StrictModel):
    """Limits of one result. The guard band is the expanded uncertainty."""

    lower: Bound | None = None
    upper: Bound | None = None

    @model_validator(mode="after")
    def _limits(self) -> RuleConfig:
        if self.lower is None and self.upper is None:
            raise ValueError("needs lower, upper or both.")
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError("lower must be less than upper.")
        return self


class ResultLimitConfig(RuleConfig):
    """Limits of one result of a run, in its own unit: px, mm, or none."""

    result: LimitedResult
    """Symbol of the result, such as fx."""
    specification: Annotated[str, Field(max_length=300)] = ""
    """Where the limits come from."""


ResultLimits = Annotated[tuple[ResultLimitConfig, ...], Field(max_length=100)]


class FlickerConfig(StrictModel):
    """A flicker, as the published method's: 60 Hz, of which 33 ms make an image.

    Its level is relative to the station's brightest level, so that a sequence suits every bench.
    """

    waveform: Waveform = "square"
    frequency_hz: Annotated[float, Within(0.001, 100_000, "Hz")] = 60.0
    duty_percent: Annotated[float, Within(0.01, 99.99, "%")] = 50.0
    """Bright part of a period."""
    level_percent: Annotated[float, Within(0.01, 100, "%")] = 100.0
    """Percent of the station's brightest level."""


class LightConfig(FlickerConfig):
    """Switch the light to a flicker, or off (``light: off``)."""

    bare_words = ("on", "off")

    output: Literal["on", "off"] = "on"

    @model_validator(mode="before")
    @classmethod
    def _on_or_off(cls, value: Any) -> Any:
        return {"output": value} if isinstance(value, str) else value


class MoveConfig(StrictModel):
    """A pose to move to; without angles, the pose of the surrounding ``repeat``.

    An axis that the pose does not name goes to 0 degrees.
    """

    name: Name | None = None
    pan_deg: Angle | None = None
    tilt_deg: Angle | None = None
    roll_deg: Angle | None = None

    def angles_deg(self) -> dict[str, float]:
        """Return the angles that are given, degrees by axis."""
        given = {axis: getattr(self, f"{axis}_deg") for axis in AXES}
        return {axis: angle for axis, angle in given.items() if angle is not None}


class PoseConfig(MoveConfig):
    """A pose in a list; it has at least one angle."""

    @model_validator(mode="after")
    def _has_an_angle(self) -> PoseConfig:
        if not self.angles_deg():
            raise ValueError("a pose needs pan_deg, tilt_deg or roll_deg.")
        return self


class Span(StrictModel):
    """Evenly spaced angles, both ends included."""

    first: Angle
    last: Angle
    count: Annotated[int, Field(ge=1, le=10_000)]

    def angles_deg(self) -> list[float]:
        """Return ``count`` angles, degrees; a single angle is the middle.

        >>> Span(first=-6, last=6, count=3).angles_deg()
        [-6.0, 0.0, 6.0]
        """
        if self.count == 1:
            return [(self.first + self.last) / 2]
        step = (self.last - self.first) / (self.count - 1)
        return [self.first + i * step for i in range(self.count - 1)] + [self.last]


def _span_or_list(value: Any) -> str:
    return "span" if isinstance(value, Mapping | Span) else "list"


Angles = Annotated[
    Annotated[Span, Tag("span")] | Annotated[list[Angle], Field(min_length=1), Tag("list")],
    Discriminator(_span_or_list),
]


class Grid(StrictModel):
    """Every combination of the axes' angles. The fastest axis is the first one given of pan, tilt, roll.

    ``serpentine`` goes back and forth along the fast axis; ``rows`` starts each row at the same end.
    """

    pan_deg: Angles | None = None
    tilt_deg: Angles | None = None
    roll_deg: Angles | None = None
    order: Literal["serpentine", "rows"] = "serpentine"

    @model_validator(mode="after")
    def _has_an_axis(self) -> Grid:
        if not self.angles_deg():
            raise ValueError("a grid needs pan_deg, tilt_deg or roll_deg.")
        return self

    def angles_deg(self) -> dict[str, list[float]]:
        """Return the angles of the axes that are given, lists of degrees by axis."""
        given = {axis: getattr(self, f"{axis}_deg") for axis in AXES}
        return {
            axis: angles.angles_deg() if isinstance(angles, Span) else list(angles)
            for axis, angles in given.items()
            if angles is not None
        }


def _pose_set_kind(value: Any) -> str:
    return "grid" if isinstance(value, Mapping | Grid) else "list"


def _pose_set_or_name_kind(value: Any) -> str:
    return "name" if isinstance(value, str) else _pose_set_kind(value)


PoseList = Annotated[list[PoseConfig], Field(min_length=1, max_length=10_000)]
PoseSet = Annotated[
    Annotated[PoseList, Tag("list")] | Annotated[Grid, Tag("grid")], Discriminator(_pose_set_kind)
]
PoseSetOrName = Annotated[
    Annotated[Name, Tag("name")] | Annotated[PoseList, Tag("list")] | Annotated[Grid, Tag("grid")],
    Discriminator(_pose_set_or_name_kind),
]


class SettleConfig(StrictModel):
    """Keep the stage still, so that vibrations decay before a recording."""

    duration_s: Annotated[float, Field(ge=0, le=3600)] = 0.5  # Chosen; `max_motion_px` finds what still moves


class GateConfig(StrictModel):
    """Conditions that a recording must meet to be accepted."""

    min_stars: Annotated[int, Field(ge=0, le=100_000)] = 40  # As `detect.MIN_FOR_LIKELIHOOD`
    max_event_rate_mev_s: Annotated[float | None, Field(gt=0, le=10_000)] = None
    """Default 200; 500 under a sine."""
    max_data_rate_gbit_s: NotNegative | None = None
    require_triggers: bool = True
    """Every flicker period must have its sync edge."""
    max_motion_px: NotNegative = 0.05  # As `event_image.MOVING_PX` of the engine, whose reason stands there
    """Image motion between the two halves of the window."""
    max_triggers_missed: NotNegative = 1  # An edge may fall on an end of the window
    max_trigger_jitter_us: NotNegative | None = None
    max_flicker_off_percent: NotNegative | None = None
    """Measured frequency against the set one; default 0.1 by triggers, 0.5 by events."""
    max_flicker_disagreement_percent: NotNegative | None = None
    """Frequency by triggers against frequency by events; default 0.5, 5 under a sine."""
    max_rate_controller_loss_percent: NotNegative = 1.0  # Chosen
    max_silent_rows: NotNegative = 3
    """Rows without events between rows with events: some are dead in some cameras; more hide parts of stars."""
    max_hot_pixels: NotNegative | None = None
    min_flicker_duty: NotNegative | None = None
    """Part of a period in which the sync signal is high, 0 to 1."""
    max_flicker_duty: NotNegative | None = None
    min_lit_pixels: NotNegative | None = None
    """Pixels that fire at nearly every edge."""
    min_events_per_edge: NotNegative | None = None
    max_events_per_edge: NotNegative | None = None
    min_on_share: NotNegative | None = None
    max_on_share: NotNegative | None = None
    max_first_on_spread_us: NotNegative | None = None
    max_edge_width_px: NotNegative | None = None
    """Blur of the stars' edges by lens and pixel together."""


class RecordConfig(StrictModel):
    """Record the flicker at the current pose and find the stars in it."""

    window_ms: Annotated[float, Within(0.01, 60_000, "ms")] = 33.0
    """Rounded to whole flicker periods."""
    image: ImageKind = "auto"
    attempts: Annotated[int, Field(ge=1, le=20)] = 2  # The second tells a chance from a fault
    backoff_s: Annotated[float, Field(ge=0, le=600)] = 0.0
    """Pause before the second attempt. Each further pause is twice as long."""
    on_failure: OnFailure = "fail"
    """What to do when no attempt is left."""
    hold_s: Annotated[float, Field(gt=0, le=7 * 86_400)] = 3600.0  # Chosen: a person can come
    """How long hold waits for an answer."""
    gates: GateConfig = GateConfig()


class WaitConfig(StrictModel):
    """Wait, for example for a warm-up or between two rounds."""

    duration_s: Annotated[float, Field(gt=0, le=7 * 86_400)]


class PromptConfig(StrictModel):
    """Ask the operator; after the time-out the default answer counts: without one, the run ends safely."""

    text: Annotated[str, Field(min_length=1, max_length=500)]
    default: Answer = "abort"
    timeout_s: Annotated[float, Field(gt=0, le=7 * 86_400)] = 600.0  # Chosen: a person is in the room


class ReportConfig(StrictModel):
    """Write the report and seal the run."""


class UntilConfig(StrictModel):
    """Record poses, and choose each next one, until the uncertainties meet their goals or a bound ends the step."""

    expanded_fx_px: Limit = None
    """Goal: expanded uncertainty of fx."""
    worst_corner_px: Limit = None
    """Goal: largest expanded uncertainty of a corner of the image."""
    at_most: Annotated[int, Field(ge=2, le=500)] = 25  # One more lowers U by 2 % at best, by the square root
    """Accepted recordings of this step, those of start included."""
    minutes: Annotated[float, Field(gt=0, le=10_080, description="Time that the step works.")] | None = None
    start: PoseSetOrName | None = None
    """Poses to record first."""
    settle: SettleConfig = SettleConfig()
    record: RecordConfig = RecordConfig()

    @model_validator(mode="after")
    def _has_a_goal(self) -> UntilConfig:
        if not self.goals():
            raise ValueError("an until needs a goal: expanded_fx_px or worst_corner_px.")
        return self

    def goals(self) -> dict[str, float]:
        """Return the goals that are given: the largest expanded uncertainty allowed, px, by name."""
        given = {"expanded_fx_px": self.expanded_fx_px, "worst_corner_px": self.worst_corner_px}
        return {name: goal for name, goal in given.items() if goal is not None}


class RepeatConfig(StrictModel):
    """Repeat steps: once for each pose (``poses``), or a number of times (``times``)."""

    poses: PoseSetOrName | None = None
    times: Annotated[int, Field(ge=1, le=100_000)] | None = None
    steps: Annotated[list[StepConfig], Field(min_length=1)]

    @model_validator(mode="after")
    def _poses_or_times(self) -> RepeatConfig:
        if (self.poses is None) == (self.times is None):
            raise ValueError("a repeat needs either poses or times.")
        return self


class StepConfig(StrictModel):
    """One step: a mapping with the step's word as its only key, or the bare word to use the defaults."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})
    bare_words = ("light", "move", "settle", "record", "solve", "report")

    light: LightConfig | None = None
    move: MoveConfig | None = None
    settle: SettleConfig | None = None
    record: RecordConfig | None = None
    wait: WaitConfig | None = None
    prompt: PromptConfig | None = None
    solve: SolveConfig | None = None
    check: CheckConfig | None = None
    report: ReportConfig | None = None
    repeat: RepeatConfig | None = None
    until: UntilConfig | None = None

    @model_validator(mode="before")
    @classmethod
    def _one_word(cls, value: Any) -> Any:
        if isinstance(value, str):
            return {value: {}}
        if isinstance(value, Mapping):
            if len(value) != 1:
                words = ", ".join(cls.model_fields)
                raise ValueError(
                    f"a step has one key, of {words}; this one has {len(value)}: give each step its own dash."
                )
            return {word: {} if given is None else given for word, given in value.items()}
        return value

    @property
    def word(self) -> str:
        """The step's word, for example ``record``."""
        return next(iter(self.model_fields_set))


RepeatConfig.model_rebuild()  # its steps are defined after it; messages ask for their words


class DefaultConfig(StrictModel):
    """Settings of steps that do not give their own."""

    light: FlickerConfig = FlickerConfig()
    settle: SettleConfig = SettleConfig()
    record: RecordConfig = RecordConfig()
    solve: SolveConfig = SolveConfig()


class Sequence(StrictModel):
    """A sequence file."""

    format: Literal["starbench/sequence/1"]
    name: Name
    description: Annotated[str, Field(max_length=2000)] = ""
    defaults: DefaultConfig = DefaultConfig()
    poses: Annotated[dict[Name, PoseSet], Field(default_factory=dict)]
    limits: ResultLimits = ()
    steps: Annotated[list[StepConfig], Field(min_length=1)]
