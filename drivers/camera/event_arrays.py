"""Arrays of events and trigger edges: what the EVT3 decoder, the file formats and the bench exchange."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Events(NamedTuple):
    """Contrast change events in the order in which the sensor sent them, one array a field."""

    # (N,) int64, us: the sensor's clock. Busy sensors let it step back by some microseconds now and then.
    t: NDArray[np.int64]
    # x, y: (N,) uint16, px: column and row.
    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    p: NDArray[np.uint8]  # (N,) uint8: polarity, 1 = ON, 0 = OFF

    def part(self, begin: int, end: int) -> Events:
        """Return views, not copies, of the events from ``begin`` to before ``end``."""
        place = slice(begin, end)
        return Events(self.t[place], self.x[place], self.y[place], self.p[place])


class Triggers(NamedTuple):
    """Edges at the trigger input."""

    t: NDArray[np.int64]  # (N,) int64, us: the sensor's clock
    value: NDArray[np.uint8]  # (N,) uint8: 1 = rising edge, 0 = falling edge
    id: NDArray[np.uint8]  # (N,) uint8: channel


def empty_events(n: int) -> Events:
    """Allocate arrays for n events, not initialised."""
    return Events(
        np.empty(n, np.int64), np.empty(n, np.uint16), np.empty(n, np.uint16), np.empty(n, np.uint8)
    )


def empty_triggers(n: int) -> Triggers:
    """Allocate arrays for n trigger edges, not initialised."""
    return Triggers(np.empty(n, np.int64), np.empty(n, np.uint8), np.empty(n, np.uint8))


def join_triggers(pieces: list[Triggers]) -> Triggers:
    """Concatenate triggers, given in the order of the stream; empty arrays for no pieces."""
    return (
        Triggers(*(np.concatenate(fields) for fields in zip(*pieces, strict=True)))
        if pieces
        else empty_triggers(0)
    )
