"""The specification of a comparison: which methods, on which bench, with how many images, how often.

A strict YAML file, or an included one, ``table1`` or ``sweep``. This module runs nothing.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from bench.base.errors import ScriptError, UsageError
from sequences.errors import DocumentFaults
from sequences.reader import Located, read_document
from sequences.strict_model import StrictModel

SHIPPED = Path(__file__).parent / "specs"

Method = Literal["starbench", "recipe", "zhang", "checkerboard", "reconstruction", "angles"]
"""``starbench``: this project's engine. ``recipe``: the published recipe. ``zhang``: OpenCV's planar calibration of the
same star images. ``checkerboard``: a board on a flickering screen, placed by hand for each image. ``reconstruction``: a
board that does not flicker, seen by a moving camera. ``angles``: one star image, by angle invariance."""
_FEWEST = 2
STAR_METHODS: tuple[Method, ...] = ("starbench", "recipe", "zhang", "angles")
Detector = Literal["symmetry", "sectors", "subpixel"]
Collimator = Literal["ideal", "like-real", "like-bench", "S1", "S2", "S3"]
Noise = Literal["none", "clean", "typical", "heavy"]


class BoardConfig(StrictModel):
    """The board of a checkerboard method, and how it is placed."""

    columns: Annotated[int, Field(ge=3, le=40, description="Inner corners along the board.")] = 11
    rows: Annotated[int, Field(ge=3, le=40, description="Inner corners across the board.")] = 7
    square_mm: Annotated[float, Field(gt=0, le=1000)] = 12.0
    distance_mm: Annotated[float, Field(ge=100, le=20_000, description="Typical distance of the board.")] = (
        900.0
    )
    tilt_deg: Annotated[float, Field(ge=0, le=60, description="Largest tilt of a placement.")] = 35.0
    focus: Annotated[
        Literal["sharp", "infinity", "board"],
        Field(
            description="sharp: a camera without focus, sharp at every distance. infinity: focused as before the "
            "collimator, so that the board is blurred. board: focused on the board, so that the focal length differs."
        ),
    ] = "infinity"
    f_number: Annotated[float, Field(ge=1, le=32)] = 2.8


class MotionConfig(StrictModel):
    """How the board moves before the camera in the method ``reconstruction``, and the filter."""

    speed_px_s: Annotated[float, Field(ge=10, le=20_000, description="Speed in the picture, px/s.")] = 1000.0
    way_px: Annotated[float, Field(ge=10, le=400, description="Way of a recording, px.")] = 100.0
    angle_deg: Annotated[
        float | None,
        Field(
            ge=0,
            le=90,
            description="Angle to the edges of the board; drawn from 20 to 70 degrees if not given.",
        ),
    ] = None
    cutoff_hz: Annotated[float, Field(ge=0.01, le=1000, description="Cutoff frequency of the filter.")] = 10.0
    two_sided: Annotated[
        bool,
        Field(
            description="Use later events as well; false: the filter as published, of earlier events only."
        ),
    ] = True


class DataConfig(StrictModel):
    """Recorded points in place of simulated images; there is no truth."""

    path: Annotated[
        str,
        Field(
            min_length=1,
            max_length=1000,
            description="Folder of point files (x, y, X, Y, id), or a table (.csv: time, view, x, y, column, row).",
        ),
    ]
    image_size: tuple[Annotated[int, Field(ge=16, le=20_000)], Annotated[int, Field(ge=16, le=20_000)]]
    origin: Annotated[
        Literal["corner", "centre"],
        Field(description="Position of (0, 0): corner or centre of the first pixel."),
    ] = "corner"
    board: Annotated[
        bool, Field(description="The target is a board at finite distance, without a collimator.")
    ] = False
    pitch_mm: Annotated[float | None, Field(gt=0, le=1000, description="Pitch of the points of a table.")] = (
        None
    )


class ColumnConfig(StrictModel):
    """One column of the table: a method on a bench."""

    name: Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[^\x00-\x1f]+$")]
    method: Method
    collimator: Annotated[Collimator, Field(description="Collimator of the star methods.")] = "ideal"
    bow_um: Annotated[float, Field(ge=0, le=1000, description="Bow of the reticle at 40 mm, um.")] = 0.0
    flatness_um: Annotated[
        float | None,
        Field(gt=0, le=1000, description="Flatness of the reticle at 40 mm that the station states, um."),
    ] = None
    noise: Noise = "typical"
    images: Annotated[int, Field(ge=1, le=50)] = 3
    passport: Annotated[
        bool, Field(description="Give a certificate of the collimator's radius: 255 +- 0.05 mm (1 sigma).")
    ] = False
    known_collimator: Annotated[
        bool | None,
        Field(
            description="Calibrate the collimator first: nine images of another camera make its passport. One image of "
            "the camera is then enough."
        ),
    ] = None
    readings: Annotated[
        bool, Field(description="Give the readings of the gimbal, with the bounds of parallax.")
    ] = False
    detector: Annotated[
        Detector,
        Field(description="Corners by symmetry (Starbench), OpenCV's sectors, or OpenCV's cornerSubPix."),
    ] = "symmetry"
    lens: Annotated[str, Field(pattern=r"^[a-z0-9]{2,30}$", description="Distortion coefficients.")] = "k1k2"
    board: BoardConfig = BoardConfig()
    motion: Annotated[MotionConfig | None, Field(description="Motion of the method reconstruction.")] = None
    data: Annotated[DataConfig | None, Field(description="Recorded points in place of simulated images.")] = (
        None
    )

    @model_validator(mode="after")
    def _data_have_no_simulation(self) -> ColumnConfig:
        if self.data is None:
            return self
        if self.method not in ("starbench", "recipe", "zhang") or (
            self.data.board and self.method == "recipe"
        ):
            raise PydanticCustomError(
                "data", "Recorded points take the methods starbench, zhang and, before a collimator, recipe."
            )
        if self.passport or self.readings or self.known_collimator:
            raise PydanticCustomError(
                "data", "Recorded points have no passport, readings or known_collimator."
            )
        return self

    @model_validator(mode="after")
    def _enough_images(self) -> ColumnConfig:
        if self.method == "angles":
            if self.images != 1:
                raise PydanticCustomError("images", "uses one image: the method angles needs images: 1.")
            return self
        if self.images < _FEWEST and not (self.known_collimator and self.method == "starbench"):
            raise PydanticCustomError(
                "images",
                "needs two images or more. One is enough with known_collimator and the method starbench.",
            )
        return self


class ComparisonConfig(StrictModel):
    """A comparison."""

    format: Literal["starbench/comparison/1"]
    name: Annotated[str, Field(min_length=1, max_length=60)]
    about: Annotated[str, Field(max_length=2000)] = ""
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = 1
    repetitions: Annotated[int, Field(ge=1, le=1000)] = 30
    columns: Annotated[list[ColumnConfig], Field(min_length=1, max_length=100)]

    @field_validator("columns")
    @classmethod
    def _names_differ(cls, columns: list[ColumnConfig]) -> list[ColumnConfig]:
        names = [column.name for column in columns]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise PydanticCustomError("twice", "names two columns {name}.", {"name": repr(twice)})
        return columns


def shipped_names() -> list[str]:
    """Return the names of the included specifications, in alphabetical order."""
    return sorted(path.stem for path in SHIPPED.glob("*.yaml"))


def read_spec(name: str) -> Located[ComparisonConfig]:
    """Read a specification by its path, or by the name of an included one."""
    path = SHIPPED / f"{name}.yaml" if name in shipped_names() else Path(name)
    if not path.is_file():
        raise UsageError(
            "There is no such specification.",
            where=name,
            remedy=f"Give a file, or one of: {', '.join(shipped_names())}.",
        )
    try:
        return read_document(path, ComparisonConfig)
    except DocumentFaults as error:
        raise ScriptError([str(fault) for fault in error.faults]) from error
