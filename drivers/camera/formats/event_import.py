"""Import events from files for analysis, of any program.

Metavision's HDF5, plain HDF5 and NumPy (layouts: see ``event_files``) are read here; for others see `prophesee_words`,
`aedat4` and `ros_bags`.
The events are read piece by piece, with bounded memory, and only from the file itself (`hdf5_reading`, `npz_reading`).
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.formats import aedat4, ecf, prophesee_words, ros_bags
from drivers.camera.formats.event_files import CD_TYPE
from drivers.camera.formats.hdf5_reading import (
    ChunkDamaged,
    dataset,
    filters,
    has_member,
    member,
    require_ratio,
    rows,
    texts,
    whole,
)
from drivers.camera.formats.npz_reading import NpzFile
from drivers.camera.formats.streamed import MOST_TRIGGERS, EventSource
from drivers.camera.raw_header import MAX_HEADER_BYTES
from drivers.camera.whole_file import require_regular, require_whole
from drivers.errors import NotARecording, RecordingCorrupt, RecordingFileError

_AGAIN: Final = "Export it again from the RAW recording."
_EVENT_FILES: Final = "Give a file of events: RAW, HDF5, .npz, DAT, AEDAT4 or a ROS bag."
_PIECE_EVENTS: Final = 500_000
_NAMES: Final = ("t", "x", "y", "p")
_TRIGGER_NAMES: Final = ("t", "value", "id")

_UNREADABLE: Final = (
    *(TypeError, LookupError, ValueError, OverflowError, RuntimeError, EOFError, NotImplementedError),
    *(zipfile.BadZipFile, zlib.error),
)
"""What HDF5 and NumPy raise for a damaged file, or one with another layout."""


@contextmanager
def open_events(path: Path | str) -> Iterator[EventSource]:
    """Open a file of events. Its contents decide the format, not its name.

    Yields: The file; its events can be read until the end of the block.
    Raises NotARecording: If it has none of the formats, lacks a part, keeps data in another file, or an event
      lies outside the sensor.
    Raises RecordingCorrupt: If a chunk of events cannot be decompressed.
    Raises RecordingFileError: If it cannot be read.
    """
    path = Path(path)
    with ExitStack() as opened:
        with _told(path):
            start = _start(path)
            if start.startswith(b"\x89HDF\r\n\x1a\n"):
                hdf5 = opened.enter_context(h5py.File(path, "r"))
                source = _from_metavision(hdf5) if has_member(hdf5, "CD") else _from_hdf5(hdf5)
            elif start[:4] == b"PK\x03\x04":
                source = _from_numpy(opened.enter_context(NpzFile(path)))
            else:
                source = _from_others(path, start)

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
    if ros_bags.is_bag(path, b""):
        return b""
    require_regular(path)
    with path.open("rb") as file:
        start = file.read(MAX_HEADER_BYTES)
    require_whole(path)
    return start


def _from_others(path: Path, start: bytes) -> EventSource:
    """Open a recording of another program than Metavision and Starbench, or of an older Metavision."""
    if ros_bags.is_bag(path, start):
        return ros_bags.from_bag(path)
    if start.startswith(aedat4.MAGIC):
        return aedat4.from_aedat4(path)
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


def _from_numpy(file: NpzFile) -> EventSource:
    width, height = (int(side) for side in _list(file, "size", most=2))
    lengths = {name: file.length(name) for name in _NAMES}
    _require_one_length(lengths)
    triggers = _triggers(
        {name: _list(file, f"trigger_{name}", most=MOST_TRIGGERS) for name in _TRIGGER_NAMES}
    )

    def pieces() -> Iterator[Events]:
        for part in zip(*(file.rows(name, _PIECE_EVENTS) for name in _NAMES), strict=True):
            yield _as_events(*part)

    return EventSource(lengths["t"], triggers, width, height, {}, pieces)


def _list(file: NpzFile, name: str, *, most: int) -> NDArray[Any]:
    """Read a short list at once."""
    if (n := file.length(name)) > most:
        raise ValueError(f"{name} has {n} elements; at most {most} are read")
    return np.concatenate([np.zeros(0, np.int64), *file.rows(name, _PIECE_EVENTS)])


def _from_hdf5(file: Any) -> EventSource:
    columns = {name: dataset(file, f"events/{name}") for name in _NAMES}
    _require_one_length({name: _length(column, f"events/{name}") for name, column in columns.items()})
    require_ratio(sum(column.nbytes for column in columns.values()), int(file.id.get_filesize()), "events")
    edges = {name: dataset(file, f"triggers/{name}") for name in _TRIGGER_NAMES}
    header = texts(member(file, "header"))
    sides = texts(file)
    missing = [name for name in ("width", "height") if name not in sides]
    if missing:
        raise ValueError(f"{missing[0]} is missing")
    triggers = _triggers({name: _edges(column, f"triggers/{name}") for name, column in edges.items()})

    def pieces() -> Iterator[Events]:
        for part in zip(*(_even(rows(column)) for column in columns.values()), strict=True):
            yield _as_events(*part)

    return EventSource(len(columns["t"]), triggers, int(sides["width"]), int(sides["height"]), header, pieces)


def _from_metavision(file: Any) -> EventSource:
    header = texts(file)
    if "geometry" not in header:
        raise ValueError("geometry is missing")
    width, height = (int(side) for side in header["geometry"].split("x"))
    table = _edges(dataset(file, "EXT_TRIGGER/events"), "EXT_TRIGGER/events")
    triggers = _triggers({"t": table["t"], "value": table["p"], "id": table["id"]})
    events = dataset(file, "CD/events")
    _length(events, "CD/events")
    # Few installations of HDF5 have the filter, so the chunks are decompressed here.
    is_ecf = filters(events) == [ecf.FILTER_ID]

    def pieces() -> Iterator[Events]:
        for part in rows(events, _decoded_ecf if is_ecf else None):
            yield _as_events(*(part[name] for name in _NAMES))

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
        if have >= _PIECE_EVENTS:
            joined = np.concatenate(kept)
            for begin in range(0, have - _PIECE_EVENTS + 1, _PIECE_EVENTS):
                yield joined[begin : begin + _PIECE_EVENTS]
            rest = joined[have - have % _PIECE_EVENTS :]
            kept, have = [rest], len(rest)
    if have:
        yield np.concatenate(kept)


def _require_one_length(lengths: Mapping[str, int]) -> None:
    if len(set(lengths.values())) != 1:
        raise ValueError("the arrays have different lengths")


def _triggers(columns: Mapping[str, NDArray[Any]]) -> Triggers:
    _require_one_length({name: len(values) for name, values in columns.items()})
    return Triggers(
        _whole(columns["t"], np.int64), _whole(columns["value"], np.uint8), _whole(columns["id"], np.uint8)
    )


def _as_events(t: Any, x: Any, y: Any, p: Any) -> Events:
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
