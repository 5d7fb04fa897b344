"""Make an `EventSource` of a format whose events and trigger edges stand in one stream, with bounded memory.

The stream is read twice: once to count the events and to collect the edges, once to pass the events on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from drivers.camera.event_arrays import Events, Triggers, join_triggers

MOST_TRIGGERS: Final = 5_000_000
"""Largest number of trigger edges: a day of 28 Hz, or six hours of 115 Hz."""

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
    """Read a stream once, and return it as a source of events.

    stream: Begins to read the file anew; yields events and edges, in the order of the file.
    size: Width and height of the sensor, px.
    Raises ValueError: If it has too many edges.
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
