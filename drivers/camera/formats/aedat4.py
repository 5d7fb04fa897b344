"""Read events and trigger edges of iniVation's AEDAT4 files, through the package ``aedat``.

The times of these files count from 1970; a recording of Starbench begins at 0. The second in which the first event
lies becomes 0, and stands in the header as ``time_origin_us``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.camera.event_arrays import Events, Triggers, empty_events
from drivers.camera.formats.event_source import EventSource, Piece, origin_us, source_of_stream
from drivers.errors import CameraSoftwareMissing

MAGIC: Final = b"#!AER-DAT4.0"
_PIECE_EVENTS: Final = 500_000
_RISING: Final = 1
_FALLING: Final = 2
_NO_EDGES: Final = np.zeros(0, [("t", "<u8"), ("source", "u1")])


def from_aedat4(path: Path) -> EventSource:
    """Open an AEDAT4 file.

    Returns: Its only stream of events, with the edges at the camera's signal input.
    Raises ValueError: If it has no stream of events or several.
    Raises CameraSoftwareMissing: If the package ``aedat`` is not installed.
    """
    streams = _decoder(path).id_to_stream()
    of_events = {number: one for number, one in streams.items() if one.get("type") == "events"}
    if len(of_events) != 1:
        raise ValueError(f"this AEDAT4 file has {len(of_events)} streams of events; one is needed")
    number, facts = next(iter(of_events.items()))
    origin = origin_us(_pieces(path, number, 0))
    header = {"time_origin_us": str(origin)}
    return source_of_stream(
        lambda: _pieces(path, number, origin), (int(facts["width"]), int(facts["height"])), header
    )


def _decoder(path: Path) -> Any:
    try:
        import aedat
    except ImportError as error:
        raise CameraSoftwareMissing(
            "Reading AEDAT4 files needs the package aedat.",
            where=str(path),
            remedy="Install it: pip install 'starbench[formats]'",
        ) from error
    return aedat.Decoder(path)


def _pieces(path: Path, number: int, origin: int) -> Iterator[Piece]:
    for packet in _decoder(path):
        if packet.get("stream_id") == number and "events" in packet:
            rows = packet["events"]
            for begin in range(0, len(rows), _PIECE_EVENTS):
                part = rows[begin : begin + _PIECE_EVENTS]
                yield _events(part, origin), _edges_of(_NO_EDGES, origin)
        elif "triggers" in packet:
            yield empty_events(0), _edges_of(packet["triggers"], origin)


def _events(rows: Any, origin: int) -> Events:
    return Events(
        rows["t"].astype(np.int64) - origin,
        np.ascontiguousarray(rows["x"], np.uint16),
        np.ascontiguousarray(rows["y"], np.uint16),
        rows["on"].astype(np.uint8),
    )


def _edges_of(rows: Any, origin: int) -> Triggers:
    """Keep the edges of the external signal; other triggers are the camera's own, such as frames."""
    rows = rows[np.isin(rows["source"], (_RISING, _FALLING))]
    return Triggers(
        rows["t"].astype(np.int64) - origin,
        (rows["source"] == _RISING).astype(np.uint8),
        np.zeros(len(rows), np.uint8),
    )
