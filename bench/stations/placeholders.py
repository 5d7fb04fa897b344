"""Placeholders in a drafted or example station file for values that a person must fill in.

A file with placeholders is valid, so that `plan` can read it and name every value that is missing; but no
run starts.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

from pydantic import BeforeValidator

from bench.base.bounded_json import leaves
from sequences.tree import Fault, Tree, path_text


class Unknown(StrEnum):
    """What stands in the place of a value."""

    SERIAL = "ASK-THE-LABEL"
    NUMBER = "ASK-THE-DATA-SHEET"
    PORT = "/dev/serial/by-id/CHOOSE-A-PORT"
    ADDRESS = "socket://CHOOSE-AN-ADDRESS:5025"
    SOURCE = "/dev/v4l/by-id/CHOOSE-A-CAMERA"
    BOARD = "NAME-THE-BOARD"
    LABORATORY = "YOUR-LABORATORY"


def _accept_placeholder(value: Any) -> Any:
    """Replace the placeholder of a number by 1, so that the file can be read and what is missing named."""
    return 1.0 if value == Unknown.NUMBER else value


ToFillIn = BeforeValidator(_accept_placeholder)
"""Marks a number of a station file that a draft leaves open."""


def not_zero(scale: float) -> float:
    """Refuse a scale of 0."""
    if scale == 0:
        raise ValueError("a scale of 0 moves nothing.")
    return scale


def find_placeholders(station: Tree) -> list[Fault]:
    """Find the values of a drafted station file that are not filled in yet."""
    return [
        Fault(
            station.file, *station.spot(path), path_text(path), f"this value is missing (placeholder {text})."
        )
        for path, text in leaves(station.value)
        if isinstance(text, str) and text in set(Unknown)
    ]
