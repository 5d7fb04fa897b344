"""Read Prophesee's older files: RAW with EVT2 words, and DAT with CD events. Piece by piece, with bounded memory.

EVT2 has words of 32 bits: type [31:28]; for events (0 OFF, 1 ON) the low 6 bits of the time [27:22], x [21:11] and
y [10:0]; 8 carries the time's bits 33 to 6; 10 is a trigger edge with time [27:22], channel [12:8] and level [0].
DAT has 8 bytes an event: time in us as uint32, then x [13:0], y [27:14] and polarity [31:28].

Sources: Prophesee, "EVT 2.0 Format", https://docs.prophesee.ai/stable/data/encoding_formats/evt2.html. Prophesee, "DAT
File Format", https://docs.prophesee.ai/stable/data/file_formats/dat.html.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.camera import raw_header
from drivers.camera.event_arrays import Events, EventSource, Piece, Triggers, empty_triggers, source_of_stream
from drivers.camera.raw_header import MAX_HEADER_BYTES
from drivers.camera.raw_writer import read_start

_PIECE_BYTES: Final = 1 << 21
_CD_TYPES: Final = (0x00, 0x0C)
_DAT_EVENT_BYTES: Final = 8
_HEAD_BYTES: Final = 4096
_KEPT: Final = ("serial_number", "date", "integrator_name", "sensor_name")
_SIZES: Final = {"49": (1280, 720), "48": (1280, 720), "42": (1280, 720), "21": (640, 480), "28": (640, 480)}
"""Size of the sensor by ``system_ID``, px, for files that do not state it."""


def header_fields(start: bytes) -> tuple[Mapping[str, str], int]:
    """Read the header in a file's first 65536 bytes: keys in small letters, and its length, bytes, if it ends."""
    fields, size_bytes = raw_header.header_fields(start)
    if size_bytes is None:
        raise ValueError(f"its header does not end within {MAX_HEADER_BYTES} bytes")
    return {key.lower(): value for key, value in fields.items()}, size_bytes


def is_evt2(fields: Mapping[str, str]) -> bool:
    """Return whether a header announces EVT2: ``format EVT2`` or ``evt 2.0``."""
    encoding = fields.get("format", "").partition(";")[0]
    return encoding == "EVT2" or (not encoding and fields.get("evt") == "2.0")


def is_evt2_file(path: Path) -> bool:
    """Return whether a file is RAW with EVT2 words; False where it cannot be read: what reads it then says why."""
    try:
        return is_evt2(header_fields(read_start(path))[0])
    except (OSError, ValueError):
        return False


def is_dat(start: bytes) -> bool:
    """Return whether a file that starts with these bytes is a DAT file of events.

    It is, by the first line that Prophesee's writers give to these files, or by a header that states a version and a
    size but no encoding of RAW, as faery writes it.
    """
    if start.startswith(b"% Data file containing"):
        return True
    lines = start[:_HEAD_BYTES].split(b"\n")
    keys = {line.split()[1].lower() for line in lines if line.startswith(b"% ") and len(line.split()) > 1}
    return {b"version", b"width", b"height"} <= keys and not keys & {b"evt", b"format"}


def from_evt2(path: Path, fields: Mapping[str, str], begin: int) -> EventSource:
    """Open a RAW file of EVT2 words, the first at byte ``begin``.

    Raises `ValueError` if its size is not stated or impossible, or it has an event before its first time.
    """
    return source_of_stream(lambda: _evt2_pieces(path, begin), _size(fields), _kept(fields))


def from_dat(path: Path, fields: Mapping[str, str], begin: int) -> EventSource:
    """Open a DAT file of CD events, from byte ``begin``, without trigger edges: DAT files of events hold none.

    Raises `ValueError` if it holds other events, or its size is not stated or impossible.
    """
    with path.open("rb") as file:
        file.seek(begin)
        kind = file.read(2)
    if len(kind) < 2 or kind[0] not in _CD_TYPES or kind[1] != _DAT_EVENT_BYTES:
        held = f"events of type {kind[0]} with {kind[1]} bytes" if len(kind) == 2 else "no events"
        raise ValueError(f"this DAT file holds {held}; Starbench reads CD events with 8 bytes")
    return source_of_stream(lambda: _dat_pieces(path, begin + 2), _size(fields), _kept(fields))


def _size(fields: Mapping[str, str]) -> tuple[int, int]:
    """Return width and height. Raises ValueError."""
    options = dict(option.partition("=")[::2] for option in fields.get("format", "").split(";")[1:])
    given = [(options.get("width", ""), options.get("height", ""))]
    given.append(tuple(fields.get("geometry", "").partition("x")[::2]))  # type: ignore[arg-type]
    given.append((fields.get("width", ""), fields.get("height", "")))
    found = {pair for pair in given if pair[0] and pair[1]}
    if not found and fields.get("system_id") in _SIZES:
        return _SIZES[fields["system_id"]]
    if len(found) != 1:
        raise ValueError(
            "its header states several sizes of the sensor" if found else "its sensor's size is missing"
        )
    width, height = found.pop()
    if not all(re.fullmatch(r"[1-9][0-9]{0,3}", side) for side in (width, height)):
        raise ValueError(f"its header states an invalid size of the sensor: {width!r} x {height!r}")
    return int(width), int(height)


def _kept(fields: Mapping[str, str]) -> dict[str, str]:
    return {key: fields[key] for key in _KEPT if key in fields}


def _blocks(path: Path, begin: int, step: int) -> Iterator[NDArray[np.uint32]]:
    """Read whole units of ``step`` bytes; a unit that is cut off at the end is left out."""
    with path.open("rb") as file:
        file.seek(begin)
        while data := file.read(_PIECE_BYTES):
            whole = len(data) - len(data) % step
            yield np.frombuffer(data[:whole], "<u4")


def _evt2_pieces(path: Path, begin: int) -> Iterator[Piece]:
    high, loops = -1, 0
    for words in _blocks(path, begin, 4):
        kind = words >> 28
        is_high = kind == 8
        highs = (words[is_high] & 0x0FFFFFFF).astype(np.int64)
        before = np.concatenate([[max(high, 0)], highs])
        turned = np.cumsum(np.diff(before) < -(1 << 27))
        of_loops = np.concatenate([[loops], loops + turned])
        place = np.cumsum(is_high)
        timed = (kind <= 1) | (kind == 10)
        if high < 0 and timed[: int(np.argmax(is_high)) if len(highs) else len(words)].any():
            raise ValueError("an event stands before the first time")
        base = (before[place] + (of_loops[place] << 28)) << 6
        t = base + ((words >> 22) & 0x3F)
        cd, edge = kind <= 1, kind == 10
        events = Events(
            t[cd],
            ((words[cd] >> 11) & 0x7FF).astype(np.uint16),
            (words[cd] & 0x7FF).astype(np.uint16),
            kind[cd].astype(np.uint8),
        )
        yield (
            events,
            Triggers(
                t[edge], (words[edge] & 1).astype(np.uint8), ((words[edge] >> 8) & 0x1F).astype(np.uint8)
            ),
        )
        if len(highs):
            high, loops = int(highs[-1]), int(of_loops[-1])


def _dat_pieces(path: Path, begin: int) -> Iterator[Piece]:
    last, loops = 0, 0
    for numbers in _blocks(path, begin, _DAT_EVENT_BYTES):
        low, data = numbers[0::2].astype(np.int64), numbers[1::2]
        turned = np.cumsum(np.diff(np.concatenate([[last], low])) < -(1 << 31))
        t = low + ((loops + turned) << 32)
        if len(low):
            last, loops = int(low[-1]), loops + int(turned[-1])
        x, y = (data & 0x3FFF).astype(np.uint16), ((data >> 14) & 0x3FFF).astype(np.uint16)
        yield Events(t, x, y, (data >> 28).astype(np.uint8)), empty_triggers(0)
