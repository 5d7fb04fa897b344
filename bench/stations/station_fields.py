"""Field types that the sections of a station file share: ports (real or simulated), serial numbers, texts, numbers."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from calib.errors import InputMismatch
from calib.target import StarTarget
from drivers.port_address import PORT_REMEDY, SOURCE_REMEDY, refused_port, refused_source
from sequences.strict_model import Form, StrictModel, Within

SIMULATED_PREFIX = "sim:"
SIMULATED_PORTS = (
    "sim:gimbal",
    "sim:gimbal-pan",
    "sim:gimbal-tilt",
    "sim:gimbal-roll",
    "sim:light",
    "sim:camera",
    "sim:frame-camera",
)
Text = Annotated[str, Field(min_length=1, max_length=200)]

Frame = Annotated[
    str,
    Form(r"^[78][NEO][12]$", "data bits (7, 8), parity (N, E, O) and stop bits (1, 2), such as 7E1"),
]

Variable = Annotated[
    str,
    Field(max_length=100),
    Form(
        r"^[A-Za-z_][A-Za-z0-9_]*$",
        "the name of an environment variable, such as BENCH_MAIL, not the secret itself",
    ),
]
"""Name of an environment variable, which holds a secret in place of the station file."""

Serial = Annotated[
    str,
    Field(
        min_length=1,
        max_length=64,
        description="As the device reports it, with all zeros.",
        # An editor may read it as a number; Starbench reads it as text
        json_schema_extra={"type": ["string", "integer"]},
    ),
]

Positive = Annotated[float, Within(1e-6, 1e9)]

FocalLength = Annotated[float, Within(1, 100_000, "mm")]

Hold = Annotated[
    float,
    Field(gt=0, le=86_400, description="Longest hold of this interlock in a run, all its holds together, s."),
]

InterlockName = Literal["door", "camera_temperature", "event_rate", "disk_space", "device_lost"]

Units = Literal["mm", "um", "inch"]
Polarity = Literal["positive", "negative"]
Squares = Annotated[int, Within(2, 10_000)]
_GlassSide = Annotated[float, Within(0.01, 100_000, "mm")]

_FEWEST_PITCHES = 4.0
"""Width of the margin around the pattern, pitches, if no size is given: it holds the text and the scale bars."""


def _simulated_or_real(port: str, info: ValidationInfo) -> str:
    """Accept a simulated port only if the station has a simulation section."""
    if not port.startswith(SIMULATED_PREFIX):
        return port
    if port not in SIMULATED_PORTS:
        known = ", ".join(SIMULATED_PORTS)
        raise ValueError(f"no such simulated device; known: {known}.")
    document = (info.context or {}).get("document", {})
    if "simulation" not in document:
        raise ValueError("a simulated device needs a simulation section (simulation: {} is enough).")
    return port


def _not_another_url(port: str) -> str:
    """Accept the kinds of URL that reach a device; others write files or search for a device."""
    if not port.startswith(SIMULATED_PREFIX) and (refused := refused_port(port)) is not None:
        raise ValueError(f"{refused} {PORT_REMEDY}")
    return port


def _not_another_protocol(source: str) -> str:
    """Accept the kinds of video source that reach a camera or a video file."""
    if not source.startswith(SIMULATED_PREFIX) and (refused := refused_source(source)) is not None:
        raise ValueError(f"{refused} {SOURCE_REMEDY}")
    return source


Port = Annotated[Text, AfterValidator(_simulated_or_real), AfterValidator(_not_another_url)]


VideoSource = Annotated[Text, AfterValidator(_simulated_or_real), AfterValidator(_not_another_protocol)]


class InterlockConfig(StrictModel):
    """What every interlock states."""

    max_hold_s: Hold = 1800.0


class DoorConfig(InterlockConfig):
    """A sensor of the enclosure: a file with one word, such as a GPIO file of the kernel. Any other word means open."""

    path: Text
    closed: Text = "1"
    """Word in the file while the door is closed."""
    max_age_s: Positive | None = None
    """A file older than this means open, s."""


class CameraTemperatureConfig(InterlockConfig):
    """The image sensor is too warm."""

    max_c: Annotated[float, Field(ge=-50, le=150)]
    release_c: Annotated[float, Field(ge=-50, le=150)]

    @model_validator(mode="after")
    def _cooler(self) -> CameraTemperatureConfig:
        if self.release_c >= self.max_c:
            raise ValueError("release_c must be below max_c; otherwise the hold would switch on and off.")
        return self


class EventRateConfig(InterlockConfig):
    """Ambient light: after a recording with too high an event rate, the rate in the dark must become low again."""

    max_mev_s: Positive
    release_mev_s: Positive
    probe_ms: Annotated[float, Field(ge=1, le=1000)] = 20.0
    """Duration of a recording in the dark, ms."""

    @model_validator(mode="after")
    def _lower(self) -> EventRateConfig:
        if self.release_mev_s >= self.max_mev_s:
            raise ValueError(
                "release_mev_s must be below max_mev_s; otherwise the hold would switch on and off."
            )
        return self


class DiskSpaceConfig(InterlockConfig):
    """Free space on the disk of the run folder."""

    min_free_gb: Positive
    release_gb: Positive

    @model_validator(mode="after")
    def _more(self) -> DiskSpaceConfig:
        if self.release_gb < self.min_free_gb:
            raise ValueError("release_gb must not be below min_free_gb.")
        return self


class DeviceLostConfig(InterlockConfig):
    """A device was disconnected: the run waits, opens it again, checks its identity, and homes it if needed."""

    retry_s: Annotated[float, Field(ge=0.1, le=600)] = 5.0


class InterlocksConfig(StrictModel):
    """Interlocks of a station; only those that are named are active."""

    door: DoorConfig | None = None
    camera_temperature: CameraTemperatureConfig | None = None
    event_rate: EventRateConfig | None = None
    disk_space: DiskSpaceConfig | None = None
    device_lost: DeviceLostConfig | None = None


class DrawingConfig(StrictModel):
    """The drawing of the reticle: its size, and what stands in the margin around the pattern."""

    size_mm: tuple[_GlassSide, _GlassSide] | None = None
    """Width and height of the glass or sheet. Default: the pattern and 4 pitches on each side."""
    units: Units = "mm"
    """Unit of the coordinates in DXF, GDSII and SVG files."""
    scale_bar_mm: Annotated[float | None, Field(ge=0, le=100_000)] = None
    """Length of the scale bars; 0: none. Default: a round length."""
    outline: bool = True
    """Whether the edge of the glass is drawn."""
    mirrored: bool = False
    """Whether left and right change places: the camera sees the pattern through the glass."""


class TargetConfig(StrictModel):
    """The printed star pattern."""

    description: Text | None = None
    """What the target is made of, its drawing, its maker."""
    serial: Serial | None = None
    """Serial number of the target; the drawing shows it."""
    squares: tuple[Squares, Squares] = (StarTarget.squares_x, StarTarget.squares_y)
    # Squares that a camera can tell apart behind a collimator: those in metres or micrometres are refused.
    pitch_mm: Annotated[float, Within(0.05, 500, "mm")] = StarTarget.pitch_mm
    segments: int = StarTarget.segments
    tag_family: str = StarTarget.tag_family
    tag_id: int = StarTarget.tag_id
    tag_square: tuple[int, int] = StarTarget.tag_square
    tag_squares: int = StarTarget.tag_squares
    polarity: Polarity = "positive"
    """positive: the black parts of the pattern are opaque; negative: the white parts are."""
    drawing: DrawingConfig = DrawingConfig()

    @model_validator(mode="before")
    @classmethod
    def _no_sentence(cls, value: Any) -> Any:
        if not isinstance(value, str):
            return value
        raise ValueError(
            "a sentence does not describe the pattern. Write it as a key of its own,"
            " target: {description: ...}, beside squares, pitch_mm and the tag."
        )

    @field_validator("tag_family", mode="before")
    @classmethod
    def _family_name(cls, value: Any) -> Any:
        """Accept the names of other programs: tag36h11, DICT_APRILTAG_36h11."""
        if not isinstance(value, str):
            return value
        return value.removeprefix("DICT_APRILTAG_").removeprefix("tag").lower()

    @model_validator(mode="after")
    def _printable(self) -> TargetConfig:
        try:
            pattern = self.pattern()
        except InputMismatch as error:
            raise ValueError(f"no such target can be printed: {error.what}") from None
        least = self._pattern_mm(pattern)
        if any(given < needed for given, needed in zip(self.drawing.size_mm or least, least, strict=True)):
            raise ValueError(
                "the pattern does not fit: drawing.size_mm must be at least"
                f" [{', '.join(f'{side:.6g}' for side in least)}]."
            )
        return self

    @staticmethod
    def _pattern_mm(pattern: StarTarget) -> tuple[float, float]:
        return pattern.squares_x * pattern.pitch_mm, pattern.squares_y * pattern.pitch_mm

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the glass or sheet, mm."""
        margin = 2.0 * _FEWEST_PITCHES * self.pitch_mm
        width, height = self._pattern_mm(self.pattern())
        return self.drawing.size_mm or (width + margin, height + margin)

    def pattern(self) -> StarTarget:
        """Return the pattern for the calibration engine."""
        return StarTarget(
            squares_x=self.squares[0],
            squares_y=self.squares[1],
            pitch_mm=self.pitch_mm,
            segments=self.segments,
            tag_id=self.tag_id,
            tag_square=self.tag_square,
            tag_squares=self.tag_squares,
            tag_family=self.tag_family,
        )

    def in_simulation(self) -> dict[str, Any]:
        """Return the sections ``target`` and ``reticle`` of the simulated world that describe this target."""
        keys = {"squares", "pitch_mm", "segments", "tag_family", "tag_id", "tag_square", "tag_squares"}
        return {"target": self.model_dump(mode="json", include=keys), "reticle": {"polarity": self.polarity}}
