"""Choose the zero of times that count from 1970, as recordings of Starbench begin at 0."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from drivers.camera.formats.streamed import Piece

_SECOND_US: Final = 1_000_000


def origin_us(pieces: Iterator[Piece]) -> int:
    """Return the beginning of the second before the first event or edge.

    pieces: Events and edges with the file's own times; only the first of them are read.
    Returns: Time, us; 0 for a file without events.
    """
    for events, triggers in pieces:
        times = [int(column.t.min()) for column in (events, triggers) if len(column.t)]
        if times:
            return max(0, min(times) // _SECOND_US - 1) * _SECOND_US
    return 0
