"""The columns of a comparison: which methods, on which bench, with how many images, how often. ``*.yaml`` hold them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, model_validator

Method = Literal["starbench", "recipe", "zhang", "checkerboard", "reconstruction", "angles"]
"""``starbench``: this project's engine. ``recipe``: the published recipe. ``zhang``: OpenCV's planar calibration of the
same star images. ``checkerboard``: a board on a flickering screen, placed by hand for each image. ``reconstruction``: a
board that does not flicker, seen by a moving camera. ``angles``: one star image, by angle invariance."""
STAR_METHODS: tuple[Method, ...] = ("starbench", "recipe", "zhang", "angles")
_FEWEST = 2


class Strict(BaseModel):
    """A part of the file: no field is ignored."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Screen(Strict):
    """The board of a checkerboard method, and how it is placed."""

    columns: int = 11
    rows: int = 7
    square_mm: float = 12.0
    distance_mm: float = 900.0
    tilt_deg: float = 35.0
    # sharp: at every distance. infinity: focused as before the collimator, so that the board is blurred. board: focused
    # on the board, so that the focal length differs.
    focus: Literal["sharp", "infinity", "board"] = "infinity"
    f_number: float = 2.8


class Column(Strict):
    """One column of the table: a method on a bench."""

    name: str
    method: Method
    group: str = ""  # Heading of the table above this column and those that follow it
    # stranger: a bench of `worlds.stranger`, whose station states what a column knows
    collimator: Literal["ideal", "like-real", "like-bench", "S1", "S2", "S3", "stranger"] = "ideal"
    noise: Literal["none", "clean", "typical", "heavy"] = "typical"
    images: Annotated[int, Field(ge=1, le=50)] = 3
    passport: bool = False  # A certificate of the collimator's radius
    known_collimator: bool = False  # Nine images of another camera make the collimator's passport first
    readings: bool = False  # The readings of the gimbal, with the bounds of parallax
    lens: str = "k1k2"
    board: Screen = Screen()
    two_sided: bool = True  # False: ``reconstruction`` by the filter as published, of earlier events only

    @model_validator(mode="after")
    def _enough_images(self) -> Column:
        alone = self.method == "angles" or (self.known_collimator and self.method == "starbench")
        if self.images < _FEWEST and not alone:
            raise ValueError("one image is enough with the method angles or a known collimator only")
        if self.method == "angles" and self.images != 1:
            raise ValueError("the method angles uses one image")
        return self


class Comparison(Strict):
    """A whole comparison."""

    about: str
    seed: int
    repetitions: int
    columns: tuple[Column, ...]


def read_comparison(name: str) -> Comparison:
    """Read ``table1`` or ``sweep``."""
    text = (Path(__file__).parent / f"{name}.yaml").read_text(encoding="utf-8")
    return Comparison.model_validate(yaml.safe_load(text))
