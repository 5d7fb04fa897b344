"""Import events from files for analysis, of any program.

Metavision's HDF5 and plain HDF5 (layouts: see ``event_files``) are read here, RAW with EVT2 and DAT in
`prophesee_words`; NumPy's files, AEDAT4 and ROS bags by their libraries in another process (`library_process`).
The events are read piece by piece, with bounded memory, and only from the file itself.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events
from drivers.camera.formats import ecf, prophesee_words
from drivers.camera.formats.event_files import CD_TYPE
from drivers.camera.formats.event_source import (
    MOST_TRIGGERS,
    EventSource,
    as_events,
    as_triggers,
    require_one_length,
    require_ratio,
)
from drivers.camera.formats.hdf5_reading import (
    ChunkDamaged,
    dataset,
    filters,
    has_member,
    member,
    rows,
    texts,
    whole,
)
from drivers.camera.formats.library_process import source_of_library
from drivers.camera.formats.library_reader import AEDAT4_MAGIC, is_bag
from drivers.camera.raw_header import MAX_HEADER_BYTES
from drivers.camera.raw_writer import require_regular, require_whole
from drivers.errors import NotARecording, RecordingCorrupt, RecordingFileError

_AGAIN: Final = "Export it again from the RAW recording."
_EVENT_FILES: Final = "Give a file of events: RAW, HDF5, .npz, DAT, AEDAT4 or a ROS bag."
PIECE_EVENTS: Final = 500_000
_NAMES: Final = ("t", "x", "y", "p")
_TRIGGER_NAMES: Final = ("t", "value", "id")

_UNREADABLE: Final = (
    *(TypeError, LookupError, ValueError, OverflowError, RuntimeError, EOFError, NotImplementedError),
    zlib.error,
)
"""What HDF5 and NumPy raise for a damaged file, or one with another layout."""


@contextmanager
def open_events(path: Path | str) -> Iterator[EventSource]:
    """Open a file of events until the end of the block. Its contents decide the format, not its name.

    Raises `NotARecording` if it has none of the formats, lacks a part, keeps data in another file, or an event lies
    outside the sensor; `RecordingCorrupt` if a chunk cannot be decompressed.
    """
    path = Path(path)
    with ExitStack() as opened:
        with _told(path):
            start = _start(path)
            if start.startswith(b"\x89HDF\r\n\x1a\n"):
                hdf5 = opened.enter_context(h5py.File(path, "r"))
                source = _from_metavision(hdf5) if has_member(hdf5, "CD") else _from_hdf5(hdf5)
            elif start[:4] == b"PK\x03\x04":
                source = opened.enter_context(source_of_library(path, "npz"))
            elif is_bag(path, start):
                source = opened.enter_context(source_of_library(path, "bag"))
            elif start.startswith(AEDAT4_MAGIC):
                source = opened.enter_context(source_of_library(path, "aedat4"))
            else:
                source = _from_prophesee(path, start)

        def pieces() -> Iterator[Events]:
            with _told(path):
                yield from _checked(source.pieces(), source)

        yield EventSource(source.count, source.triggers, source.width, source.height, source.header, pieces)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn what HDF5, NumPy and the system raise into errors of recordings."""
    try:
        yield
    except ChunkDamaged as error:
        raise RecordingCorrupt(
            f"The events cannot be decompressed: {error}.",
            offset=error.offset,
            where=str(path),
            remedy=_AGAIN,
        ) from error
    except _UNREADABLE as error:
        raise _not_events(path, str(error)) from error
    except MemoryError as error:
        raise RecordingFileError(
            f"The file states more events than fit into memory ({error}).", where=str(path), remedy=_AGAIN
        ) from error
    except OSError as error:
        raise RecordingFileError(
            f"The file cannot be read ({error.strerror or error}).",
            where=str(path),
            remedy="Check the path and the file.",
        ) from error


def _start(path: Path) -> bytes:
    """Return the first bytes of a file that is whole; nothing for the folder of a ROS 2 bag."""
    if is_bag(path, b""):
        return b""
    require_regular(path)
    with path.open("rb") as file:
        start = file.read(MAX_HEADER_BYTES)
    require_whole(path)
    return start


def _from_prophesee(path: Path, start: bytes) -> EventSource:
    """Open a recording of an older Metavision."""
    fields, begin = prophesee_words.header_fields(start)
    if prophesee_words.is_dat(start):
        return prophesee_words.from_dat(path, fields, begin)
    if prophesee_words.is_evt2(fields):
        return prophesee_words.from_evt2(path, fields, begin)
    raise NotARecording(
        "The format of this file is unknown: it is not RAW (EVT3, EVT2), HDF5, .npz, DAT, AEDAT4 or a ROS bag.",
        where=str(path),
        remedy=_EVENT_FILES,
    )


def _not_events(path: Path, why: str) -> NotARecording:
    """Build the error of a file without readable events."""
    return NotARecording(f"The file holds no readable events: {why}.", where=str(path), remedy=_EVENT_FILES)


def _from_hdf5(file: Any) -> EventSource:
    columns = {name: dataset(file, f"events/{name}") for name in _NAMES}
    require_one_length({name: _length(column, f"events/{name}") for name, column in columns.items()})
    require_ratio(sum(column.nbytes for column in columns.values()), int(file.id.get_filesize()), "events")
    edges = {name: dataset(file, f"triggers/{name}") for name in _TRIGGER_NAMES}
    header = texts(member(file, "header"))
    sides = texts(file)
    missing = [name for name in ("width", "height") if name not in sides]
    if missing:
        raise ValueError(f"{missing[0]} is missing")
    triggers = as_triggers({name: _edges(column, f"triggers/{name}") for name, column in edges.items()})

    def pieces() -> Iterator[Events]:
        for part in zip(*(_even(rows(column)) for column in columns.values()), strict=True):
            yield as_events(*part)

    return EventSource(len(columns["t"]), triggers, int(sides["width"]), int(sides["height"]), header, pieces)


def _from_metavision(file: Any) -> EventSource:
    header = texts(file)
    if "geometry" not in header:
        raise ValueError("geometry is missing")
    width, height = (int(side) for side in header["geometry"].split("x"))
    table = _edges(dataset(file, "EXT_TRIGGER/events"), "EXT_TRIGGER/events")
    triggers = as_triggers({"t": table["t"], "value": table["p"], "id": table["id"]})
    events = dataset(file, "CD/events")
    _length(events, "CD/events")
    # Few installations of HDF5 have the filter, so the chunks are decompressed here.
    is_ecf = filters(events) == [ecf.FILTER_ID]

    def pieces() -> Iterator[Events]:
        for part in rows(events, _decoded_ecf if is_ecf else None):
            yield as_events(*(part[name] for name in _NAMES))

    return EventSource(len(events), triggers, width, height, header, pieces)


def _decoded_ecf(chunk: bytes) -> NDArray[Any]:
    """Decompress a chunk to rows, as HDF5 would."""
    found = ecf.decode(chunk)
    table = np.empty(len(found.t), CD_TYPE)
    for name, values in found._asdict().items():
        table[name] = values
    return table


def _length(column: Any, name: str) -> int:
    """Return the number of rows. Raises ValueError if the array is no list."""
    if len(column.shape) != 1:
        raise ValueError(f"{name} has {len(column.shape)} dimensions; a list is needed")
    return int(column.shape[0])


def _edges(column: Any, name: str) -> NDArray[Any]:
    """Read a list of edges at once."""
    if (n := _length(column, name)) > MOST_TRIGGERS:
        raise ValueError(f"{name} has {n} elements; at most {MOST_TRIGGERS} are read")
    return whole(column, MOST_TRIGGERS * column.dtype.itemsize)


def _even(parts: Iterator[NDArray[Any]]) -> Iterator[NDArray[Any]]:
    """Put arrays of any lengths into pieces of one length; the last may be shorter."""
    kept: list[NDArray[Any]] = []
    have = 0
    for part in parts:
        kept.append(part)
        have += len(part)
        if have >= PIECE_EVENTS:
            joined = np.concatenate(kept)
            for begin in range(0, have - PIECE_EVENTS + 1, PIECE_EVENTS):
                yield joined[begin : begin + PIECE_EVENTS]
            rest = joined[have - have % PIECE_EVENTS :]
            kept, have = [rest], len(rest)
    if have:
        yield np.concatenate(kept)


def _checked(pieces: Iterator[Events], of: EventSource) -> Iterator[Events]:
    """Check that every event lies on the sensor, and that none is missing."""
    read = 0
    for events in pieces:
        if len(events.t) and (
            events.x.max() >= of.width or events.y.max() >= of.height or events.p.max() > 1
        ):
            raise ValueError(f"an event lies outside the sensor of {of.width} x {of.height} px")
        read += len(events.t)
        yield events
    if read != of.count:
        raise ValueError(f"{of.count - read} of its {of.count} events are missing")
