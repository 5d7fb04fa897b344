"""Options of an offline calibration as sources.json holds them, so that the calibration can be made again.

Passport, target and station file are not among them: the folder of the results holds a copy of the
passport, and sources.json describes the target and the station file. Reads and writes no files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from bench.plan.passports import PassportInUse
from bench.solve.offline_options import OfflineOptions
from calib.boards.board import Board
from calib.target import StarTarget

_ELSEWHERE = ("passport", "target", "station")
_BOARD = "board"


def options_data(options: OfflineOptions) -> dict[str, Any]:
    """Return options as JSON holds them; ``passport`` is the name of the file, or None."""
    plain = {
        field.name: getattr(options, field.name) for field in fields(options) if field.name not in _ELSEWHERE
    }
    return {
        **plain,
        _BOARD: None if options.board is None else str(options.board),
        "passport": None if options.passport is None else options.passport.name,
    }


def options_of_data(
    data: Mapping[str, Any], passport: PassportInUse | None, target: StarTarget | None
) -> OfflineOptions:
    """Return the options that `options_data` wrote; `ValueError` if one is unknown here: a later version wrote it."""
    known = {field.name for field in fields(OfflineOptions)}
    if unknown := sorted(set(data) - known):
        raise ValueError(f"unknown options: {', '.join(unknown)}")
    given: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in data.items()
        if name not in (*_ELSEWHERE, _BOARD)
    }
    board = None if data[_BOARD] is None else Board.parse(data[_BOARD])
    return OfflineOptions(**given, board=board, passport=passport, target=target or StarTarget())
