"""What a sequence file may say: the script language's words, units, defaults and bounds.

Knows the shape of one document as pydantic models; ``sequences.reader`` brings the text here and places the
faults, ``sequences.script`` flattens a checked document into steps. Touches no file and no device.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    Tag,
    field_validator,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

AXES = ("pan", "tilt", "roll")

Axis = Literal["pan", "tilt", "roll"]
Waveform = Literal["square", "sine", "steady"]
ImageKind = Literal["auto", "last_polarity", "any", "count", "fired_per_edge", "lock_in", "on_latency"]
CalibrationModel = Literal["spherical", "planar", "auto"]
DistortionTerm = Literal["k1", "k2", "p1", "p2", "k3"]
Loss = Literal["huber", "l2", "cauchy"]
Answer = Literal["continue", "abort"]
OnFailure = Literal["fail", "skip", "hold"]

Angle = Annotated[float, Field(ge=-360, le=360)]
Name = Annotated[str, Field(min_length=1, max_length=80, pattern=r"^\S(.*\S)?$")]


Limit = Annotated[float, Field(gt=0)] | None
NotNegative = Annotated[float, Field(ge=0)]


class Words(BaseModel):
    """A mapping of a document: its own keys and no others, finite numbers only, never changed once read."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)

    bare_words: ClassVar[tuple[str, ...]] = ()
    """Single words that may stand for the whole mapping."""

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Let the exported schema allow the bare words too."""
        reference = handler(core_schema)
        if cls.bare_words:
            schema = handler.resolve_ref_schema(reference)
            mapping = dict(schema)
            schema.clear()
            schema["anyOf"] = [{"enum": list(cls.bare_words)}, mapping]
        return reference


class FlickerWords(Words):
    """A flicker. Its level is a share of what the station's light may do, so a sequence fits every bench."""

    waveform: Waveform = "square"
    frequency_hz: Annotated[float, Field(gt=0, le=100_000)] = 60.0
    duty_percent: Annotated[float, Field(gt=0, lt=100, description="Share of a period that is bright.")] = (
        50.0
    )
    level_percent: Annotated[float, Field(gt=0, le=100, description="Of the station's brightest level.")] = (
        100.0
    )


class LightWords(FlickerWords):
    """Switch the light to a flicker; or ``light: off``."""

    bare_words = ("on", "off")

    output: Literal["on", "off"] = "on"

    @model_validator(mode="before")
    @classmethod
    def _on_or_off(cls, value: Any) -> Any:
        return {"output": value} if isinstance(value, str) else value


class MoveWords(Words):
    """A pose to move to; without angles: the pose of the surrounding ``repeat``.

    An axis the pose does not name stands at 0 degrees.
    """

    name: Name | None = None
    pan_deg: Angle | None = None
    tilt_deg: Angle | None = None
    roll_deg: Angle | None = None

    def angles_deg(self) -> dict[str, float]:
        """Angles given, by axis."""
        given = {axis: getattr(self, f"{axis}_deg") for axis in AXES}
        return {axis: angle for axis, angle in given.items() if angle is not None}


class PoseWords(MoveWords):
    """A pose of a list: at least one angle."""

    @model_validator(mode="after")
    def _has_an_angle(self) -> PoseWords:
        if not self.angles_deg():
            raise PydanticCustomError("no_angle", "a pose needs pan_deg, tilt_deg or roll_deg.")
        return self


class Span(Words):
    """Evenly spaced angles, both ends included."""

    first: Angle
    last: Angle
    count: Annotated[int, Field(ge=1, le=10_000)]

    def angles_deg(self) -> list[float]:
        """List the angles.

        Examples
        --------
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


class Grid(Words):
    """Every combination of the angles of its axes; the axis named first in pan, tilt, roll moves fastest.

    ``serpentine`` turns back and forth along the fast axis, ``rows`` begins each row at the same end.
    """

    pan_deg: Angles | None = None
    tilt_deg: Angles | None = None
    roll_deg: Angles | None = None
    order: Literal["serpentine", "rows"] = "serpentine"

    @model_validator(mode="after")
    def _has_an_axis(self) -> Grid:
        if not self.angles_deg():
            raise PydanticCustomError("no_axis", "a grid needs pan_deg, tilt_deg or roll_deg.")
        return self

    def angles_deg(self) -> dict[str, list[float]]:
        """Angles by axis, of the axes named."""
        given = {axis: getattr(self, f"{axis}_deg") for axis in AXES}
        return {
            axis: angles.angles_deg() if isinstance(angles, Span) else list(angles)
            for axis, angles in given.items()
            if angles is not None
        }


def _pose_set_kind(value: Any) -> str:
    if isinstance(value, str):
        return "name"
    return "grid" if isinstance(value, Mapping | Grid) else "list"


PoseList = Annotated[list[PoseWords], Field(min_length=1, max_length=10_000)]
PoseSet = Annotated[
    Annotated[PoseList, Tag("list")] | Annotated[Grid, Tag("grid")], Discriminator(_pose_set_kind)
]
PoseSetOrName = Annotated[
    Annotated[Name, Tag("name")] | Annotated[PoseList, Tag("list")] | Annotated[Grid, Tag("grid")],
    Discriminator(_pose_set_kind),
]


class SettleWords(Words):
    """Stand still, so that vibrations die away before a recording."""

    duration_s: Annotated[float, Field(ge=0, le=3600)] = 0.5


class GateWords(Words):
    """What a recording must show to be accepted."""

    min_stars: Annotated[int, Field(ge=0, le=100_000)] = 40
    max_event_rate_mev_s: Annotated[float, Field(gt=0, le=10_000)] = 200.0
    require_triggers: Annotated[bool, Field(description="One sync edge a flicker period, none missing.")] = (
        True
    )
    max_motion_px: Annotated[
        NotNegative, Field(description="From the first half of the window to the second.")
    ] = 0.05
    max_triggers_missed: NotNegative = 1
    max_trigger_jitter_us: NotNegative | None = None
    max_flicker_off_percent: Annotated[
        NotNegative | None,
        Field(description="From what the light was set to; 0.1 by triggers, 0.5 by events."),
    ] = None
    max_flicker_disagreement_percent: Annotated[
        NotNegative, Field(description="Between the flicker by triggers and by events.")
    ] = 0.5
    max_rate_controller_loss_percent: NotNegative = 1.0
    max_silent_rows: Annotated[NotNegative, Field(description="Rows without events amid lit ones.")] = 3
    max_hot_pixels: NotNegative | None = None
    min_flicker_duty: Annotated[
        NotNegative | None, Field(description="Share of a period for which the sync signal is high, 0 to 1.")
    ] = None
    max_flicker_duty: NotNegative | None = None
    min_lit_pixels: Annotated[
        NotNegative | None, Field(description="Pixels that fire at nearly every edge.")
    ] = None
    min_events_per_edge: NotNegative | None = None
    max_events_per_edge: NotNegative | None = None
    min_on_share: NotNegative | None = None
    max_on_share: NotNegative | None = None
    max_first_on_spread_us: NotNegative | None = None


class RecordWords(Words):
    """Record the flicker at the present pose and find the stars in it."""

    window_ms: Annotated[float, Field(gt=0, le=60_000, description="Rounded to whole flicker periods.")] = (
        33.0
    )
    image: ImageKind = "auto"
    attempts: Annotated[int, Field(ge=1, le=20)] = 2
    backoff_s: Annotated[
        float,
        Field(ge=0, le=600, description="Before the second attempt; twice as long before each further one."),
    ] = 0.0
    on_failure: Annotated[OnFailure, Field(description="Once the attempts are used up.")] = "fail"
    hold_s: Annotated[float, Field(gt=0, le=7 * 86_400, description="How long hold waits for an answer.")] = (
        3600.0
    )
    gates: GateWords = GateWords()


class WaitWords(Words):
    """Let time pass: warm-up, drift between two rounds."""

    duration_s: Annotated[float, Field(gt=0, le=7 * 86_400)]


class PromptWords(Words):
    """Ask the operator; unattended, the default answer counts after the time-out."""

    text: Annotated[str, Field(min_length=1, max_length=500)]
    default: Answer = "continue"
    timeout_s: Annotated[float, Field(gt=0, le=7 * 86_400)] = 600.0


class LimitWords(Words):
    """The most a result may show. Within a tenth of its limit it is marginal, above it the result fails."""

    rms_px: Limit = None
    mean_px: Limit = None
    sigma_fx_px: Limit = None
    sigma_fy_px: Limit = None
    sigma_cx_px: Limit = None
    sigma_cy_px: Limit = None
    sigma_k1: Limit = None
    sigma_k2: Limit = None
    sigma_p1: Limit = None
    sigma_p2: Limit = None
    sigma_k3: Limit = None
    sigma_x_mm: Limit = None
    sigma_y_mm: Limit = None
    sigma_r_mm: Limit = None


class SolveWords(Words):
    """Calibrate from the poses recorded so far."""

    model: CalibrationModel = "spherical"
    distortion: tuple[DistortionTerm, ...] = ("k1", "k2")
    loss: Loss = "huber"
    huber_px: Annotated[float, Field(gt=0, le=100)] | None = None
    limits: LimitWords = LimitWords()

    @field_validator("distortion")
    @classmethod
    def _each_once(cls, terms: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(terms)) != len(terms):
            raise PydanticCustomError("term_twice", "a distortion term stands twice.")
        return terms


class ReportWords(Words):
    """Write the report and seal the run."""


class RepeatWords(Words):
    """Steps done again and again: once a pose (``poses``), or so many times (``times``)."""

    poses: PoseSetOrName | None = None
    times: Annotated[int, Field(ge=1, le=100_000)] | None = None
    steps: Annotated[list[StepWords], Field(min_length=1)]

    @model_validator(mode="after")
    def _poses_or_times(self) -> RepeatWords:
        if (self.poses is None) == (self.times is None):
            raise PydanticCustomError("poses_or_times", "a repeat needs either poses or times.")
        return self


class StepWords(Words):
    """One step: a mapping with its one word as key, or the bare word where the defaults will do."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})
    bare_words = ("light", "move", "settle", "record", "solve", "report")

    light: LightWords | None = None
    move: MoveWords | None = None
    settle: SettleWords | None = None
    record: RecordWords | None = None
    wait: WaitWords | None = None
    prompt: PromptWords | None = None
    solve: SolveWords | None = None
    report: ReportWords | None = None
    repeat: RepeatWords | None = None

    @model_validator(mode="before")
    @classmethod
    def _one_word(cls, value: Any) -> Any:
        if isinstance(value, str):
            return {value: {}}
        if isinstance(value, Mapping):
            if len(value) != 1:
                message = "a step is one of {words}; here are {count}: give each its own dash."
                words = ", ".join(cls.model_fields)
                raise PydanticCustomError("one_word", message, {"words": words, "count": len(value)})
            return {word: {} if said is None else said for word, said in value.items()}
        return value

    @property
    def word(self) -> str:
        """Which step it is."""
        return next(iter(self.model_fields_set))


class DefaultWords(Words):
    """What steps mean where they say nothing themselves."""

    light: FlickerWords = FlickerWords()
    settle: SettleWords = SettleWords()
    record: RecordWords = RecordWords()
    solve: SolveWords = SolveWords()


class Sequence(Words):
    """A sequence file."""

    format: Literal["starbench/sequence/1"]
    name: Name
    description: Annotated[str, Field(max_length=2000)] = ""
    defaults: DefaultWords = DefaultWords()
    poses: dict[Name, PoseSet] = {}
    steps: Annotated[list[StepWords], Field(min_length=1)]
