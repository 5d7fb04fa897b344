"""Errors of the engine about a board: they speak of points and of the board, not of stars. Texts only."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bench.report.target_words import TargetWords
from calib.errors import CalibrationError


@contextmanager
def errors_in(words: TargetWords) -> Iterator[None]:
    """Raise the engine's errors in the words of the target.

    Raises calib.errors.CalibrationError: The error of the block, of the same class and with the same place.
    """
    try:
        yield
    except CalibrationError as error:
        if not words.is_board:
            raise
        said = type(error)(words.fitting(error.what), where=error.where, remedy=words.fitting(error.remedy))
        raise said from error
