"""Descriptions of boards: how many points, how they are arranged, and where they lie on the board.

This module uses no image.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch

Kind = Literal["checkerboard", "circles", "asymmetric-circles"]
KINDS: tuple[Kind, ...] = ("checkerboard", "circles", "asymmetric-circles")

_TEXT = re.compile(r"([a-z-]+):(\d{1,3})x(\d{1,3}):(\d+(?:\.\d+)?)mm")
_FEWEST, _MOST = 3, 200


@dataclass(frozen=True)
class Board:
    """A flat board with a grid of points.

    Attributes
    ----------
    kind
        ``checkerboard``: the points are the inner corners. ``circles``: centres on a square grid.
        ``asymmetric-circles``: every second row is shifted by half a column, as in OpenCV.
    columns, rows
        Number of points along X and along Y.
    pitch_mm
        Distance of neighbouring points, mm: the side of a square, or the distance of circles. With
        ``asymmetric-circles`` it is the distance of the rows, which is half that of the circles of a row.

    Raises
    ------
    InputMismatch
        If there is no such board.
    """

    kind: Kind
    columns: int
    rows: int
    pitch_mm: float

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputMismatch(
                f"There is no board {self.kind!r}.",
                where="board",
                remedy=f"Known boards: {', '.join(KINDS)}.",
            )
        if not (_FEWEST <= self.columns <= _MOST and _FEWEST <= self.rows <= _MOST):
            raise InputMismatch(
                f"A board of {self.columns} x {self.rows} points cannot be found.",
                where="board",
                remedy=f"Give {_FEWEST} to {_MOST} points along each side. Of a checkerboard count the inner corners.",
            )
        if not 0.001 <= self.pitch_mm <= 10_000.0:
            raise InputMismatch(
                f"The points are {self.pitch_mm:g} mm apart.", where="board", remedy="Give 0.001 to 10000 mm."
            )

    @classmethod
    def parse(cls, text: str) -> Board:
        """Read a description such as ``checkerboard:11x7:20mm``.

        Parameters
        ----------
        text
            Kind, columns x rows of points, and their distance.

        Returns
        -------
        Board
            The board.

        Raises
        ------
        InputMismatch
            If the text does not describe a board.

        Examples
        --------
        >>> Board.parse("checkerboard:11x7:20mm").columns
        11
        """
        found = _TEXT.fullmatch(text)
        if found is None:
            raise InputMismatch(
                f"{text!r} does not describe a board.",
                where="board",
                remedy="Write KIND:COLUMNSxROWS:PITCHmm, such as checkerboard:11x7:20mm (count the inner corners) "
                "or circles:9x6:25mm.",
            )
        kind = next((known for known in KINDS if known == found[1]), found[1])
        return cls(kind, int(found[2]), int(found[3]), float(found[4]))  # type: ignore[arg-type]  # checked above

    @property
    def nodes(self) -> NDArray[np.int64]:
        """(N, 2) int64 column and row of each point on a square lattice, row by row; N = columns x rows."""
        row, column = np.mgrid[: self.rows, : self.columns].astype(np.int64)
        if self.kind == "asymmetric-circles":
            column = 2 * column + row % 2
        return np.column_stack([column.ravel(), row.ravel()])

    @property
    def points_mm(self) -> NDArray[np.float64]:
        """(N, 2) float64 positions of the points on the board, mm, row by row; X right, Y down."""
        return np.asarray(self.pitch_mm * self.nodes.astype(np.float64))

    def __str__(self) -> str:
        return f"{self.kind}:{self.columns}x{self.rows}:{self.pitch_mm:g}mm"
