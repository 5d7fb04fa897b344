"""What stands in a drafted station file where only a person can know the value, and where it still does.

Knows the words of drafts (`station_draft`) and the places of a document's values; touches no device.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sequences.tree import DocumentPath, Fault, Tree, path_text

ASK = "ASK-THE-LABEL"
NO_PORT = "/dev/serial/by-id/CHOOSE-A-PORT"
NO_SOURCE = "/dev/v4l/by-id/CHOOSE-A-CAMERA"
_ALL = frozenset({ASK, NO_PORT, NO_SOURCE})


def find_placeholders(station: Tree) -> list[Fault]:
    """Find every value of a drafted station file that nobody has filled in yet, each at its line."""
    return [
        Fault(station.file, *station.spot(path), path_text(path), f"still to be filled in (it says {text}).")
        for path, text in _texts(station.value, ())
        if text in _ALL
    ]


def _texts(value: Any, path: DocumentPath) -> Iterator[tuple[DocumentPath, str]]:
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _texts(inner, (*path, key))
