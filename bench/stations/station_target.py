"""The target section of a station file: the printed star pattern, and the drawing of its reticle.

The module holds keys, ranges and defaults. `bench.stations.target` draws the reticle; docs/target.md shows every key.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from bench.stations.station_fields import Serial, Text
from calib.errors import InputMismatch
from calib.target import StarTarget
from sequences.plain_number import Within
from sequences.strict_model import StrictModel

Units = Literal["mm", "um", "inch"]
Polarity = Literal["positive", "negative"]
Squares = Annotated[int, Within(2, 10_000)]
_GlassSide = Annotated[float, Within(0.01, 100_000, "mm")]

_FEWEST_PITCHES = 4.0
"""Width of the margin around the pattern, pitches, if no size is given: it holds the text and the scale bars."""


class DrawingConfig(StrictModel):
    """The drawing of the reticle: its size, and what stands in the margin around the pattern."""

    size_mm: Annotated[
        tuple[_GlassSide, _GlassSide] | None,
        Field(
            description="Width and height of the glass or sheet. Default: the pattern and 4 pitches on each side."
        ),
    ] = None
    units: Annotated[Units, Field(description="Unit of the coordinates in DXF, GDSII and SVG files.")] = "mm"
    scale_bar_mm: Annotated[
        float | None,
        Field(ge=0, le=100_000, description="Length of the scale bars; 0: none. Default: a round length."),
    ] = None
    outline: Annotated[bool, Field(description="Whether the edge of the glass is drawn.")] = True
    mirrored: Annotated[
        bool,
        Field(
            description="Whether left and right change places: the camera sees the pattern through the glass."
        ),
    ] = False


class TargetConfig(StrictModel):
    """The printed star pattern."""

    description: Annotated[
        Text | None, Field(description="What the target is made of, its drawing, its maker.")
    ] = None
    serial: Annotated[
        Serial | None, Field(description="Serial number of the target; the drawing shows it.")
    ] = None
    squares: tuple[Squares, Squares] = (50, 72)
    pitch_mm: Annotated[float, Within(0.001, 1000, "mm")] = 144.5 / 36
    segments: int = 16
    tag_family: str = "36h11"
    tag_id: int = 3
    tag_square: tuple[int, int] = (23, 34)
    tag_squares: int = 4
    polarity: Annotated[
        Polarity,
        Field(
            description="positive: the black parts of the pattern are opaque; negative: the white parts are."
        ),
    ] = "positive"
    drawing: DrawingConfig = DrawingConfig()

    @model_validator(mode="before")
    @classmethod
    def _no_sentence(cls, value: Any) -> Any:
        if isinstance(value, str):
            raise PydanticCustomError(
                "sentence",
                "a sentence does not describe the pattern. Write it as a key of its own,"
                " target: {description: ...}, beside squares, pitch_mm and the tag.",
            )
        return value

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
            raise PydanticCustomError(
                "not_printable", "{what}", {"what": f"no such target can be printed: {error.what}"}
            ) from None
        for given, needed in zip(self.drawing.size_mm or (), self._pattern_mm(pattern), strict=False):
            if given < needed:
                raise PydanticCustomError(
                    "too_small",
                    "the pattern does not fit: drawing.size_mm must be at least [{width}, {height}].",
                    dict(
                        zip(("width", "height"), (f"{n:.6g}" for n in self._pattern_mm(pattern)), strict=True)
                    ),
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
        """Return the sections of the simulated world that describe this target.

        Returns: Sections ``target`` and ``reticle``, as JSON has them.
        """
        keys = {"squares", "pitch_mm", "segments", "tag_family", "tag_id", "tag_square", "tag_squares"}
        return {"target": self.model_dump(mode="json", include=keys), "reticle": {"polarity": self.polarity}}
