"""Descriptions of boards: how many points, how arranged, and where on the board; no image."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from calib.arrays import Array, Ints
from calib.errors import InputMismatch

Kind = Literal["checkerboard", "circles", "asymmetric-circles", "blinking-dots"]
KINDS: tuple[Kind, ...] = ("checkerboard", "circles", "asymmetric-circles", "blinking-dots")

_TEXT = re.compile(r"([a-z-]+):(\d{1,3})x(\d{1,3}):(\d+(?:\.\d+)?)mm(?:@(\d+(?:\.\d+)?)-(\d+(?:\.\d+)?)Hz)?")
_FEWEST, _MOST = 3, 200
#: Frequencies of the first and the last blinking dot if none are given, Hz; the others are evenly spaced.
FIRST_HZ, LAST_HZ = 50.0, 150.0
#: Lowest and highest frequency of a dot, Hz: a pixel of an event camera follows up to some hundred hertz.
_LOWEST_HZ, _HIGHEST_HZ = 1.0, 1000.0
#: Frequencies of two dots must differ by this share, or be equal.
_LEAST_STEP = 0.004


@dataclass(frozen=True)
class Board:
    """A flat board with a grid of points; `InputMismatch` if there is no such board."""

    # ``checkerboard``: the points are the inner corners. ``circles``: centres on a square grid.
    # ``asymmetric-circles``: every second row is shifted by half a column, as in OpenCV. ``blinking-dots``:
    # centres on a square grid, each of a light that blinks at its own frequency.
    kind: Kind
    columns: int
    rows: int
    # Distance of neighbouring points, mm: the side of a square, or the distance of circles. With
    # ``asymmetric-circles`` it is the distance of the rows, which is half that of the circles of a row.
    pitch_mm: float
    # Frequencies of blinking dots, Hz, row by row. Empty for other boards. If none are given for blinking
    # dots, they are evenly spaced from `FIRST_HZ` to `LAST_HZ`.
    frequencies_hz: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for what, remedy in self._faults():
            raise InputMismatch(what, where="board", remedy=remedy)
        if self.kind == "blinking-dots" and not self.frequencies_hz:
            count = self.columns * self.rows
            object.__setattr__(self, "frequencies_hz", tuple(np.linspace(FIRST_HZ, LAST_HZ, count).tolist()))

    def _faults(self) -> Iterator[tuple[str, str]]:
        """Yield why there is no such board, and what to do."""
        if self.kind not in KINDS:
            yield f"There is no board {self.kind!r}.", f"Known boards: {', '.join(KINDS)}."
        if not (_FEWEST <= self.columns <= _MOST and _FEWEST <= self.rows <= _MOST):
            what = f"A board of {self.columns} x {self.rows} points cannot be found."
            yield (
                what,
                f"Give {_FEWEST} to {_MOST} points along each side. Of a checkerboard count the inner corners.",
            )
        if not 0.001 <= self.pitch_mm <= 10_000.0:
            yield f"The points are {self.pitch_mm:g} mm apart.", "Give 0.001 to 10000 mm."
        given, count = self.frequencies_hz, self.columns * self.rows
        if not given:
            return
        if self.kind != "blinking-dots":
            what = f"A board of the kind {self.kind} has no frequencies."
            yield what, "Leave them out, or use blinking-dots."
        if len(given) != count:
            yield (
                f"{len(given)} frequencies are given for {count} dots.",
                "Give one for each dot, row by row.",
            )
        if not all(_LOWEST_HZ <= one <= _HIGHEST_HZ for one in given):
            what = f"The frequencies go from {min(given):g} to {max(given):g} Hz."
            yield what, f"Give {_LOWEST_HZ:g} to {_HIGHEST_HZ:g} Hz."
        different = np.unique(given)
        if len(different) < 2 or (np.diff(different) / different[:-1]).min() < _LEAST_STEP:
            what = f"The frequencies of the dots differ by less than {100 * _LEAST_STEP:g} %."
            yield what, "Give frequencies that are farther apart, or the same one to several dots."

    @classmethod
    def parse(cls, text: str) -> Board:
        """Read a description such as ``checkerboard:11x7:20mm`` or ``blinking-dots:9x6:25mm@50-150Hz``.

        Kind, columns x rows of points, and their distance; for blinking dots also the frequencies of the first and of
        the last dot, between which the others are evenly spaced, row by row.

        Examples
        --------
        >>> Board.parse("checkerboard:11x7:20mm").columns
        11
        >>> Board.parse("blinking-dots:3x3:25mm@60-100Hz").frequencies_hz[:3]
        (60.0, 65.0, 70.0)
        """
        found = _TEXT.fullmatch(text)
        if found is None:
            raise InputMismatch(
                f"{text!r} does not describe a board.",
                where="board",
                remedy="Write KIND:COLUMNSxROWS:PITCHmm, such as checkerboard:11x7:20mm (count the inner corners), "
                "circles:9x6:25mm or blinking-dots:9x6:25mm@50-150Hz.",
            )
        columns, rows, frequencies = int(found[2]), int(found[3]), ()
        if found[5] is not None:
            frequencies = tuple(np.linspace(float(found[5]), float(found[6]), columns * rows).tolist())
        return cls(cast("Kind", found[1]), columns, rows, float(found[4]), frequencies)

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
        if self.kind == "blinking-dots":
            return f"grid of {self.columns} x {self.rows} blinking dots"
        grid = "asymmetric grid" if self.kind == "asymmetric-circles" else "grid"
        return f"{grid} of {self.columns} x {self.rows} circles"

    def __str__(self) -> str:
        text = f"{self.kind}:{self.columns}x{self.rows}:{self.pitch_mm:g}mm"
        if not self.frequencies_hz:
            return text
        first, last = self.frequencies_hz[0], self.frequencies_hz[-1]
        even = np.allclose(np.linspace(first, last, len(self.frequencies_hz)), self.frequencies_hz)
        return f"{text}@{first:g}-{last:g}Hz" if even else text
