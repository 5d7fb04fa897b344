"""Arrays of events and trigger edges: what the EVT3 decoder, the file formats and the bench exchange.

Every format is read to a source of such pieces; the times of some count from 1970, those of a recording from 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.errors import NotARecording, UnreadableEvents

MOST_RATIO: Final = 200
"""How many times larger than the file its arrays may be. Events are compressed to a third, at most to a thirtieth."""
SMALL_BYTES: Final = 1 << 24
"""Arrays of this size need no ratio."""
MOST_TRIGGERS: Final = 5_000_000
"""Largest number of trigger edges: a day of 28 Hz, or six hours of 115 Hz."""
MAX_TIME_US: Final = 86_400_000_000
"""One day: the clock words of longer gaps would fill the disk (42 MB a day), and no recording lasts that long."""
_SECOND_US: Final = 1_000_000  # us
# Us since 1970: times in this range are dates, all others count from a start.
_YEAR_2000_US: Final = 946_684_800_000_000
_YEAR_2100_US: Final = 4_102_444_800_000_000  # us since 1970
_MOST_NAMED: Final = 8  # A line

_TYPES: Final[tuple[type[np.generic], ...]] = (np.int64, np.uint16, np.uint16, np.uint8)

_Columns = tuple[NDArray[Any], ...]
TimeUnit = Literal["s", "ms", "us", "ns"]


class Events(NamedTuple):
    """Contrast change events in the order in which the sensor sent them, one array a field."""

    # (N,) int64, us: the sensor's clock. Busy sensors let it step back by some microseconds now and then.
    t: NDArray[np.int64]
    x: NDArray[np.uint16]  # (N,) uint16, px: column
    y: NDArray[np.uint16]  # (N,) uint16, px: row
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


Piece = tuple[Events, Triggers]


@dataclass(frozen=True)
class ReadingChoices:
    """What the user says of a file: what it does not state itself, and which of its streams is wanted."""

    # Width and height, px
    sensor_size: tuple[int, int] | None = None
    # A topic of a bag, a stream of an AEDAT4 file, a group of an HDF5 file
    stream: str | None = None
    # Unit of the times of a file that does not state it
    time_unit: TimeUnit | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the choices as values that JSON can hold."""
        size = list(self.sensor_size) if self.sensor_size else None
        stated = {"sensor_size": size, "stream": self.stream, "time_unit": self.time_unit}
        return {name: value for name, value in stated.items() if value is not None}

    @classmethod
    def from_json(cls, stated: Mapping[str, Any]) -> ReadingChoices:
        """Return the choices that `as_json` wrote."""
        size = stated.get("sensor_size")
        return cls(tuple(size) if size else None, stated.get("stream"), stated.get("time_unit"))

    def chosen(self, streams: Iterable[str]) -> str:
        """Return the stream to read. Raises NotARecording if it is not there, or none of several is named."""
        names = sorted(streams)
        for name in names:
            if self.stream is not None and self.stream.strip("/") == name.strip("/"):
                return name
        if self.stream is None and len(names) == 1:
            return names[0]
        if not names:
            raise NotARecording("The file holds no stream of events.", remedy="Give a file of events.")
        held = f"{len(names)} streams of events" if len(names) != 1 else "one stream of events"
        held += f": {', '.join(names[:_MOST_NAMED])}{', ...' if len(names) > _MOST_NAMED else ''}"
        raise NotARecording(
            f"There is no stream {self.stream!r}; the file holds {held}."
            if self.stream is not None
            else f"The file holds {held}.",
            remedy=f"Choose one: starbench convert --stream {names[0]}",
        )


@dataclass
class ReadingState:
    """How far a file has been read, and what its events fill so far."""

    share: float = 0.0  # Of the file, 0 to 1
    filled_px: tuple[int, int] = 0, 0  # Width and height that the events need
    times_us: tuple[int, int] | None = None  # Of the first event, and the latest; None before any
    unknown_words: int = 0  # Number of words left out because EVT3 does not define their type


class UnstatedUnit(NamedTuple):
    """The unit of times that a file does not state."""

    read_as: TimeUnit
    is_given: bool  # By the user; else assumed
    finest: TimeUnit  # The finest unit that the file's numbers can have


@dataclass(frozen=True)
class EventSource:
    """An open file of events, which is read once, piece by piece."""

    width: int  # Of the sensor, px
    height: int  # Of the sensor, px
    header: Mapping[str, str]
    # Reads events and edges in the order of the file; an edge may come before the events of its time, not after them.
    # It raises as `open_events` does.
    pieces: Callable[[], Iterator[Piece]]
    truncated: bool = False  # Whether the file ends in the middle of a word or an event
    count: int | None = None  # Number of events, if the file states it before they are read
    state: ReadingState = field(default_factory=ReadingState)
    # What the file does not state and was assumed: "time_unit" (a `TimeUnit`)
    assumed: Mapping[str, str] = field(default_factory=dict)
    unit: UnstatedUnit | None = None  # None if the file or its format states the unit of its times


def with_edges(pieces: Iterable[Events], edges: Triggers) -> Iterator[Piece]:
    """Yield pieces of events, the first of them with all edges of the file."""
    for events in pieces:
        yield events, edges
        edges = empty_triggers(0)
    if len(edges.t):
        yield empty_events(0), edges


def too_many_edges() -> NotARecording:
    """Build the error of a file with more edges than are read."""
    return NotARecording(
        f"The file has more than {MOST_TRIGGERS} trigger edges.", remedy="Cut it into shorter files."
    )


class Clock32:
    """Times of a counter of 32 bits, which begins anew at 0 while they go on; given in pieces.

    >>> Clock32().continued(np.array([2**32 - 5, 2**32 - 3, 4, 2**32 - 1, 6])).tolist()
    [4294967291, 4294967293, 4294967300, 4294967295, 4294967302]
    """

    def __init__(self, bits: int = 32) -> None:
        self._bits, self._last, self._turns = bits, np.empty(0, np.int64), 0

    def continued(self, t: NDArray[Any]) -> NDArray[np.int64]:
        """Return the next times without the turns."""
        t = t.astype(np.int64)
        steps, half = np.diff(np.concatenate([self._last, t])), 1 << (self._bits - 1)
        turns = np.cumsum((steps < -half).astype(np.int64) - (steps > half))
        turns = self._turns + np.concatenate([np.zeros(len(t) - len(turns), np.int64), turns])
        if len(t):
            self._last, self._turns = t[-1:], int(turns[-1])
        return t + (turns << self._bits)


class Origin(NamedTuple):
    """The time in a file's own clock that becomes 0, us, and what the header of its events says of it."""

    us: int
    header: Mapping[str, str]


def origin_of(pieces: Iterator[Piece]) -> Origin:
    """Return the beginning of the second before the first event or edge as origin; 0 for a file without events.

    Times that count from 1970 date the file. Only the first of the pieces, with the file's own times, are read.
    """
    for events, triggers in pieces:
        times = [int(column.t.min()) for column in (events, triggers) if len(column.t)]
        if times:
            us = max(0, min(times) // _SECOND_US - 1) * _SECOND_US
            return Origin(us, {"time_origin_us": str(us), **date_of(min(times))})
    return Origin(0, {})


def date_of(us: int) -> dict[str, str]:
    """Return ``date`` of a time since 1970; nothing of another clock's, which no camera has run for so long."""
    if not _YEAR_2000_US <= us < _YEAR_2100_US:
        return {}
    return {"date": f"{datetime.fromtimestamp(us // _SECOND_US, UTC):%Y-%m-%d %H:%M:%S}"}


def require_ratio(stated_bytes: int, file_bytes: int, what: str) -> None:
    """Refuse arrays (`NotARecording`) that are much larger than the file that holds them."""
    if stated_bytes > max(SMALL_BYTES, MOST_RATIO * file_bytes):
        raise UnreadableEvents(
            f"{what} states {stated_bytes} bytes in {file_bytes}; recorded data cannot be compressed so far."
        )


def require_one_length(lengths: Mapping[str, int]) -> None:
    """Raise NotARecording unless all lengths are the same."""
    if len(set(lengths.values())) != 1:
        each = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise UnreadableEvents(f"its arrays have different lengths: {each}.")


def as_triggers(columns: Mapping[str, NDArray[Any]]) -> Triggers:
    """Return edges of ``t``, ``value`` and ``id``. Raises NotARecording unless they are whole numbers that fit."""
    require_one_length({name: len(values) for name, values in columns.items()})
    t, value, edge_id = columns["t"], columns["value"], columns["id"]
    return Triggers(
        _whole("t", t, np.int64), _whole("value", value, np.uint8), _whole("id", edge_id, np.uint8)
    )


def as_events(t: Any, x: Any, y: Any, p: Any) -> Events:
    """Return events; OFF may be -1 or 0. Raises NotARecording unless all are whole numbers that fit."""
    p = np.asarray(p)
    if p.dtype.kind == "b":
        p = p.view(np.uint8)
    elif p.dtype.kind == "i" and len(p) and p.min() == -1:
        p = np.maximum(p, 0)
    return Events(
        *(
            _whole(name, values, dtype)
            for name, values, dtype in zip("txyp", (t, x, y, p), _TYPES, strict=True)
        )
    )


def _whole(name: str, values: Any, dtype: type[np.generic]) -> Any:
    """Convert numbers to a type. Raises NotARecording if they are not whole, or do not fit."""
    values = np.asarray(values)
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise UnreadableEvents(
            f"{name} is an array of {values.dtype} with {values.ndim} dimensions, not a list of whole numbers."
        )
    cast = np.ascontiguousarray(values, dtype)  # no copy if none is needed: there may be millions
    if cast is not values and not np.array_equal(cast, values):
        raise UnreadableEvents(f"some numbers of {name} do not fit into {np.dtype(dtype)}.")
    return cast


def even_pieces(pieces: Iterable[_Columns], size: int) -> Iterator[_Columns]:
    """Put columns of any length into pieces of one length; the last may be shorter."""
    kept: list[_Columns] = []
    have = 0
    for piece in pieces:
        length, begin = len(piece[0]), 0
        if have:
            begin = min(size - have, length)
            kept.append(tuple(column[:begin] for column in piece))
            have += begin
            if have < size:
                continue
            yield _joined(kept)
        end = length - (length - begin) % size
        for first in range(begin, end, size):
            yield tuple(column[first : first + size] for column in piece)
        kept, have = [tuple(column[end:] for column in piece)], length - end
    if have:
        yield _joined(kept)


def _joined(pieces: list[_Columns]) -> _Columns:
    return tuple(np.concatenate(parts) for parts in zip(*pieces, strict=True))


def source_of_stream(
    stream: Callable[[], Iterator[Piece]], size: tuple[int, int], header: Mapping[str, str]
) -> EventSource:
    """Read a stream once, to count the events and to collect the edges; it is read again for the events.

    In AEDAT4, edges stand behind the events of their time.
    """
    count, edges, parts = 0, 0, []
    for events, triggers in stream():
        count += len(events.t)
        edges += len(triggers.t)
        if edges > MOST_TRIGGERS:
            raise too_many_edges()
        if len(triggers.t):
            parts.append(triggers)
    joined = join_triggers(parts)
    return EventSource(
        *size, header, lambda: with_edges((events for events, _ in stream()), joined), count=count
    )
