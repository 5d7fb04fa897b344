"""The board section of a station file: a flat board at finite distance that stands there in place of a collimator.

The module holds keys, ranges and defaults. docs/boards.md shows every key.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from calib.boards.board import Board, Kind
from calib.errors import InputMismatch
from sequences.plain_number import Within
from sequences.strict_model import StrictModel

_Points = Annotated[int, Within(3, 200)]
_Frequency = Annotated[float, Within(1, 1000, "Hz")]


class BoardConfig(StrictModel):
    """A board at finite distance, as a section or in one word: ``checkerboard:9x6:25mm``."""

    kind: Kind
    columns: Annotated[_Points, Field(description="Points along X; inner corners of a checkerboard.")]
    rows: Annotated[_Points, Field(description="Points along Y; inner corners of a checkerboard.")]
    pitch_mm: Annotated[float, Within(0.001, 10_000, "mm")]
    frequencies_hz: Annotated[
        tuple[_Frequency, ...] | None,
        Field(description="Of blinking dots, row by row. Default: evenly spaced from 50 to 150 Hz."),
    ] = None
    flicker_hz: Annotated[
        _Frequency | None,
        Field(description="Frequency at which the board flickers by itself. Default: the light flickers."),
    ] = None

    @model_validator(mode="before")
    @classmethod
    def _from_text(cls, value: Any) -> Any:
        if not isinstance(value, str):
            return value
        try:
            board = Board.parse(value)
        except InputMismatch as error:
            raise PydanticCustomError(
                "no_board", "{what} {remedy}", {"what": error.what, "remedy": error.remedy}
            ) from None
        return {
            "kind": board.kind,
            "columns": board.columns,
            "rows": board.rows,
            "pitch_mm": board.pitch_mm,
            **({"frequencies_hz": board.frequencies_hz} if board.frequencies_hz else {}),
        }

    @model_validator(mode="after")
    def _exists(self) -> BoardConfig:
        try:
            self.board()
        except InputMismatch as error:
            raise PydanticCustomError(
                "no_board", "{what} {remedy}", {"what": error.what, "remedy": error.remedy}
            ) from None
        return self

    def board(self) -> Board:
        """Return the board for the calibration engine."""
        return Board(self.kind, self.columns, self.rows, self.pitch_mm, self.frequencies_hz or ())

    @property
    def own_hz(self) -> float | None:
        """Frequency of the board's own flicker, Hz; the lowest one of blinking dots; None if the light drives it."""
        frequencies = self.board().frequencies_hz
        return min(frequencies) if frequencies else self.flicker_hz
