"""Descriptions of boards: how many points, how arranged, and where on the board; no image."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from calib.arrays import Array, Ints
from calib.errors import InputMismatch

Kind = Literal["checkerboard", "circles", "asymmetric-circles"]
KINDS: tuple[Kind, ...] = ("checkerboard", "circles", "asymmetric-circles")

_TEXT = re.compile(r"([a-z-]+):(\d{1,3})x(\d{1,3}):(\d+(?:\.\d+)?)(\w*)", re.IGNORECASE)
#: Millimetres of the units that a person may write, for a message.
_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "in": 25.4}
_FEWEST, _MOST = 3, 200  # Points along a side: less gives no homography; more is no print


@dataclass(frozen=True)
class Board:
    """A flat board with a grid of points; `InputMismatch` if there is no such board."""

    # ``checkerboard``: the points are the inner corners. ``circles``: centres on a square grid.
    # ``asymmetric-circles``: every second row is shifted by half a column, as in OpenCV.
    kind: Kind
    columns: int
    rows: int
    # Distance of neighbouring points, mm: the side of a square, or the distance of circles. With
    # ``asymmetric-circles`` it is the distance of the rows, which is half that of the circles of a row.
    pitch_mm: float

    def __post_init__(self) -> None:
        for what, remedy in self._faults():
            raise InputMismatch(what, where="board", remedy=remedy)

    def _faults(self) -> Iterator[tuple[str, str]]:
        """Yield why there is no such board, and what to do."""
        if self.kind not in KINDS:
            yield (
                f"There is no board {self.kind!r}.",
                f"Known boards: {', '.join(KINDS)}. One with markers (ChArUco, AprilGrid) is not found.",
            )
        if not (_FEWEST <= self.columns <= _MOST and _FEWEST <= self.rows <= _MOST):
            what = f"A board of {self.columns} x {self.rows} points cannot be found."
            yield (
                what,
                f"Give {_FEWEST} to {_MOST} points along each side. Of a checkerboard count the inner corners.",
            )
        if not 0.001 <= self.pitch_mm <= 10_000.0:
            yield f"The points are {self.pitch_mm:g} mm apart.", "Give 0.001 to 10000 mm."

    @classmethod
    def parse(cls, text: str) -> Board:
        """Read a description such as ``checkerboard:11x7:20mm``: kind, columns x rows of points, and their distance.

        >>> Board.parse("checkerboard:11x7:20mm").columns
        11
        """
        parts = _TEXT.fullmatch(text)
        if parts is None:
            raise InputMismatch(
                f"{text!r} does not describe a board.",
                where="board",
                remedy="Write KIND:COLUMNSxROWS:PITCHmm, such as checkerboard:11x7:20mm (count the inner corners), "
                "or circles:9x6:25mm.",
            )
        unit = parts[5].lower()
        if unit != "mm":
            raise InputMismatch(
                f"The pitch of {text!r} has {'another unit than mm' if unit else 'no unit'}.",
                where="board",
                remedy=f"Write {float(parts[4]) * _MM.get(unit, 1.0):g}mm, if that is right.",
            )
        return cls(cast("Kind", parts[1].lower()), int(parts[2]), int(parts[3]), float(parts[4]))

    @property
    def nodes(self) -> Ints:
        """(N, 2) int64 column and row of each point on a square lattice, row by row; N = columns x rows."""
        row, column = np.mgrid[: self.rows, : self.columns].astype(np.int64)
        if self.kind == "asymmetric-circles":
            column = 2 * column + row % 2
        return np.column_stack([column.ravel(), row.ravel()])

    @property
    def points_mm(self) -> Array:
        """(N, 2) float64 positions of the points on the board, mm, row by row; X right, Y down."""
        return np.asarray(self.pitch_mm * self.nodes.astype(np.float64))

    @property
    def symmetric(self) -> bool:
        """Whether the board looks the same after half a turn, so that its points may be numbered from either end."""
        if self.kind == "checkerboard":
            return (self.columns + self.rows) % 2 == 0
        return self.kind == "circles" or (self.kind == "asymmetric-circles" and self.rows % 2 == 1)

    @property
    def words(self) -> str:
        """The board in words, for messages."""
        if self.kind == "checkerboard":
            return f"checkerboard of {self.columns} x {self.rows} inner corners"
        grid = "asymmetric grid" if self.kind == "asymmetric-circles" else "grid"
        return f"{grid} of {self.columns} x {self.rows} circles"

    def __str__(self) -> str:
        return f"{self.kind}:{self.columns}x{self.rows}:{self.pitch_mm:g}mm"
