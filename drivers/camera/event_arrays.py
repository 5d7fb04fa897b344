"""Arrays of events and trigger edges: what the EVT3 decoder, the file formats and the bench exchange."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Events(NamedTuple):
    """Contrast change events in the order in which the sensor sent them, one array a field.

    Attributes
    ----------
    t
        (N,) int64, us: the sensor's clock. Busy sensors let it step back by some microseconds now and then.
    x, y
        (N,) uint16, px: column and row.
    p
        (N,) uint8: polarity, 1 = ON, 0 = OFF.
    """

    t: NDArray[np.int64]
    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    p: NDArray[np.uint8]

    def part(self, begin: int, end: int) -> Events:
        """Return views of some of the events.

        Parameters
        ----------
        begin
            Index of the first event.
        end
            Index after the last event.

        Returns
        -------
        Events
            Views, not copies.
        """
        place = slice(begin, end)
        return Events(self.t[place], self.x[place], self.y[place], self.p[place])


class Triggers(NamedTuple):
    """Edges at the trigger input.

    Attributes
    ----------
    t
        (N,) int64, us: the sensor's clock.
    value
        (N,) uint8: 1 = rising edge, 0 = falling edge.
    id
        (N,) uint8: channel.
    """

    t: NDArray[np.int64]
    value: NDArray[np.uint8]
    id: NDArray[np.uint8]


def empty_events(n: int) -> Events:
    """Allocate arrays for events.

    Parameters
    ----------
    n
        Number of events.

    Returns
    -------
    Events
        Arrays of length n, not initialised.
    """
    return Events(
        np.empty(n, np.int64), np.empty(n, np.uint16), np.empty(n, np.uint16), np.empty(n, np.uint8)
    )


def copy_events(source: Events, target: Events) -> None:
    """Copy events into other arrays, which may overlap.

    Parameters
    ----------
    source
        The events.
    target
        Arrays of the same length, filled in.
    """
    target.t[:], target.x[:], target.y[:], target.p[:] = source


def empty_triggers(n: int) -> Triggers:
    """Allocate arrays for trigger edges.

    Parameters
    ----------
    n
        Number of edges.

    Returns
    -------
    Triggers
        Arrays of length n, not initialised.
    """
    return Triggers(np.empty(n, np.int64), np.empty(n, np.uint8), np.empty(n, np.uint8))


def join_triggers(pieces: list[Triggers]) -> Triggers:
    """Concatenate triggers.

    Parameters
    ----------
    pieces
        Triggers in the order of the stream.

    Returns
    -------
    Triggers
        All edges; empty arrays for no pieces.
    """
    return (
        Triggers(*(np.concatenate(fields) for fields in zip(*pieces, strict=True)))
        if pieces
        else empty_triggers(0)
    )
