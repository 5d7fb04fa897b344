"""Placeholders in a drafted station file (`station_draft`) for values that a person must fill in."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sequences.tree import DocumentPath, Fault, Tree, path_text

UNKNOWN_SERIAL = "ASK-THE-LABEL"
UNKNOWN_SCALE = "ASK-THE-DATA-SHEET"
UNKNOWN_PORT = "/dev/serial/by-id/CHOOSE-A-PORT"
UNKNOWN_SOURCE = "/dev/v4l/by-id/CHOOSE-A-CAMERA"
_ALL = frozenset({UNKNOWN_SERIAL, UNKNOWN_SCALE, UNKNOWN_PORT, UNKNOWN_SOURCE})


def find_placeholders(station: Tree) -> list[Fault]:
    """Find the values of a drafted station file that are not filled in yet.

    Parameters
    ----------
    station
        The document, with the positions of its values.

    Returns
    -------
    list of Fault
        One fault for each placeholder, at its line.
    """
    return [
        Fault(
            station.file, *station.spot(path), path_text(path), f"this value is missing (placeholder {text})."
        )
        for path, text in _texts(station.value, ())
        if text in _ALL
    ]


def _texts(value: Any, path: DocumentPath) -> Iterator[tuple[DocumentPath, str]]:
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _texts(inner, (*path, key))
