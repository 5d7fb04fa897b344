"""iniVation's AEDAT4, through the package ``aedat``.

Its times count from 1970; a recording of Starbench begins at 0. The second before the first event becomes 0, and stands
in the header as ``time_origin_us``. Edges stand behind the events of their time.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.camera.event_arrays import (
    Events,
    EventSource,
    Piece,
    ReadingChoices,
    Triggers,
    empty_events,
    empty_triggers,
    origin_of,
    source_of_stream,
)
from drivers.camera.formats.library_process import LibraryFormat
from drivers.camera.raw_header import agreed_size

_PIECE: Final = 500_000  # Events
_MAGIC: Final = b"#!AER-DAT4.0"
_RISING: Final = 1  # Of the trigger sources
_FALLING: Final = 2  # Of the trigger sources
AEDAT4: Final = LibraryFormat(f"{__name__}:open_aedat4", lambda _, start: start.startswith(_MAGIC))


def open_aedat4(path: Path, choices: ReadingChoices) -> EventSource:
    """Open a stream of events of an AEDAT4 file, named by its number, with the edges at the camera's signal input."""
    streams = {str(number): packet_stream for number, packet_stream in _decoder(path).id_to_stream().items()}
    name = choices.chosen(number for number, stream in streams.items() if stream.get("type") == "events")
    width, height = (streams[name].get(side) for side in ("width", "height"))
    size = agreed_size(
        {"the stream": (int(width), int(height))} if width and height else {}, choices.sensor_size, ""
    )
    origin = origin_of(_aedat4_pieces(path, int(name), 0))
    return source_of_stream(lambda: _aedat4_pieces(path, int(name), origin.us), size, origin.header)


def _decoder(path: Path) -> Any:
    import aedat

    return aedat.Decoder(path)


def _aedat4_pieces(path: Path, number: int, origin: int) -> Iterator[Piece]:
    for packet in _decoder(path):
        if packet.get("stream_id") == number and "events" in packet:
            rows = packet["events"]
            for begin in range(0, len(rows), _PIECE):
                part = rows[begin : begin + _PIECE]
                yield _aedat4_events(part, origin), empty_triggers(0)
        elif "triggers" in packet:
            yield empty_events(0), _aedat4_edges(packet["triggers"], origin)


def _aedat4_events(rows: Any, origin: int) -> Events:
    return Events(
        rows["t"].astype(np.int64) - origin,
        np.ascontiguousarray(rows["x"], np.uint16),
        np.ascontiguousarray(rows["y"], np.uint16),
        rows["on"].astype(np.uint8),
    )


def _aedat4_edges(rows: Any, origin: int) -> Triggers:
    """Keep the edges of the external signal; other triggers are the camera's own, such as frames."""
    rows = rows[np.isin(rows["source"], (_RISING, _FALLING))]
    return Triggers(
        rows["t"].astype(np.int64) - origin,
        (rows["source"] == _RISING).astype(np.uint8),
        np.zeros(len(rows), np.uint8),
    )
