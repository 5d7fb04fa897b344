"""Arrays of events and trigger edges: what the EVT3 decoder, the file formats and the bench exchange.

Every format is read to a source of such pieces; the times of some count from 1970, those of a recording from 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

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

    def part(self, begin: int, end: int) -> Triggers:
        """Return views, not copies, of the edges from ``begin`` to before ``end``."""
        place = slice(begin, end)
        return Triggers(self.t[place], self.value[place], self.id[place])


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


MOST_RATIO: Final = 200
"""How many times larger than the file its arrays may be. Events are compressed to a third, at most to a thirtieth."""
SMALL_BYTES: Final = 1 << 24
"""Arrays of this size need no ratio."""
MOST_TRIGGERS: Final = 5_000_000
"""Largest number of trigger edges: a day of 28 Hz, or six hours of 115 Hz."""
_SECOND_US: Final = 1_000_000

Piece = tuple[Events, Triggers]


@dataclass(frozen=True)
class EventSource:
    """An open file of events."""

    count: int
    triggers: Triggers  # All trigger edges, in the order of the file
    # width, height: Size of the sensor, px.
    width: int
    height: int
    header: Mapping[str, str]
    # Reads the events in the order of the file. It raises as `open_events` does.
    pieces: Callable[[], Iterator[Events]]


def source_of_stream(
    stream: Callable[[], Iterator[Piece]], size: tuple[int, int], header: Mapping[str, str]
) -> EventSource:
    """Read a stream once, to count the events and to collect the edges; it is read again for the events.

    ``stream`` begins to read the file anew, in the order of the file; ``size`` is width and height, px. Too many edges
    raise `ValueError`.
    """
    count, edges, found = 0, 0, []
    for events, triggers in stream():
        count += len(events.t)
        edges += len(triggers.t)
        if edges > MOST_TRIGGERS:
            raise ValueError(f"it has more than {MOST_TRIGGERS} trigger edges")
        if len(triggers.t):
            found.append(triggers)

    def pieces() -> Iterator[Events]:
        for events, _ in stream():
            yield events

    return EventSource(count, join_triggers(found), *size, header, pieces)


def origin_us(pieces: Iterator[Piece]) -> int:
    """Return the beginning of the second before the first event or edge, us; 0 for a file without events.

    Only the first of the pieces, with the file's own times, are read.
    """
    for events, triggers in pieces:
        times = [int(column.t.min()) for column in (events, triggers) if len(column.t)]
        if times:
            return max(0, min(times) // _SECOND_US - 1) * _SECOND_US
    return 0


def require_ratio(stated_bytes: int, file_bytes: int, what: str) -> None:
    """Refuse arrays (`ValueError`) that are much larger than the file that holds them."""
    if stated_bytes > max(SMALL_BYTES, MOST_RATIO * file_bytes):
        raise ValueError(
            f"{what} states {stated_bytes} bytes in {file_bytes}; recorded data cannot be compressed so far"
        )


def require_one_length(lengths: Mapping[str, int]) -> None:
    """Raise ValueError unless all lengths are the same."""
    if len(set(lengths.values())) != 1:
        raise ValueError("the arrays have different lengths")


def as_triggers(columns: Mapping[str, NDArray[Any]]) -> Triggers:
    """Return edges of ``t``, ``value`` and ``id``. Raises ValueError unless they are whole numbers that fit."""
    require_one_length({name: len(values) for name, values in columns.items()})
    return Triggers(
        _whole(columns["t"], np.int64), _whole(columns["value"], np.uint8), _whole(columns["id"], np.uint8)
    )


def as_events(t: Any, x: Any, y: Any, p: Any) -> Events:
    """Return events. Raises ValueError unless they are whole numbers that fit."""
    return Events(_whole(t, np.int64), _whole(x, np.uint16), _whole(y, np.uint16), _whole(p, np.uint8))


def _whole(values: Any, dtype: type[np.generic]) -> Any:
    """Convert numbers to a type. Raises ValueError if they are not whole, or do not fit."""
    values = np.asarray(values)
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise ValueError(
            f"an array of {values.dtype} with {values.ndim} dimensions is not a list of whole numbers"
        )
    cast = np.ascontiguousarray(values, dtype)  # no copy if none is needed: there may be millions
    if cast is not values and not np.array_equal(cast, values):
        raise ValueError(f"some numbers do not fit into {np.dtype(dtype)}")
    return cast
