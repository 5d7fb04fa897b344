"""Placeholders in a drafted or example station file for values that a person must fill in.

A file with placeholders is valid, so that `plan` can read it and name every value that is missing; but no
run starts.
"""

from __future__ import annotations

from typing import Any

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from bench.base.bounded_json import leaves
from sequences.tree import Fault, Tree, path_text

UNKNOWN_SERIAL = "ASK-THE-LABEL"
UNKNOWN_NUMBER = "ASK-THE-DATA-SHEET"
UNKNOWN_PORT = "/dev/serial/by-id/CHOOSE-A-PORT"
UNKNOWN_ADDRESS = "socket://CHOOSE-AN-ADDRESS:5025"
UNKNOWN_SOURCE = "/dev/v4l/by-id/CHOOSE-A-CAMERA"
UNKNOWN_BOARD = "NAME-THE-BOARD"
UNKNOWN_LABORATORY = "YOUR-LABORATORY"
_ALL = frozenset(
    {
        UNKNOWN_SERIAL,
        UNKNOWN_NUMBER,
        UNKNOWN_PORT,
        UNKNOWN_ADDRESS,
        UNKNOWN_SOURCE,
        UNKNOWN_BOARD,
        UNKNOWN_LABORATORY,
    }
)


def _accept_placeholder(value: Any) -> Any:
    """Replace the placeholder of a number by 1, so that the file can be read and what is missing named."""
    return 1.0 if value == UNKNOWN_NUMBER else value


ToFillIn = BeforeValidator(_accept_placeholder)
"""Marks a number of a station file that a draft leaves open."""


def not_zero(scale: float) -> float:
    """Refuse a scale of 0."""
    if scale == 0:
        raise PydanticCustomError("no_scale", "a scale of 0 moves nothing.")
    return scale


def find_placeholders(station: Tree) -> list[Fault]:
    """Find the values of a drafted station file that are not filled in yet."""
    return [
        Fault(
            station.file, *station.spot(path), path_text(path), f"this value is missing (placeholder {text})."
        )
        for path, text in leaves(station.value)
        if isinstance(text, str) and text in _ALL
    ]
