"""Files for analysis: a RAW file is exported to Metavision's HDF5, plain HDF5 and NumPy; any program's are imported.

The RAW file stays the evidence. All other files are computed from it and hold less: no counters of the sensor, and in
Metavision's HDF5 no time may step back. They appear complete or not at all, and are never overwritten. Layouts:

- Metavision: ``/CD/events`` (x, y, p, t; ECF-compressed chunks of 16384), ``/EXT_TRIGGER/events`` (p, t, id), each with
  ``indexes`` (id, ts): entry k names the first event of the last 2 ms window before window k that has any event,
  and its time since the first event; the header's keys as attributes.
- plain HDF5: ``/events/t, x, y, p`` and ``/triggers/t, value, id``, gzip; ``width``, ``height`` as attributes of the
  root, and the header's keys as attributes of ``/header``.
- NumPy: an ``.npz`` of ``t, x, y, p, trigger_t, trigger_value, trigger_id, size`` (width, height).

Both kinds of HDF5 are read here, RAW with EVT2 and DAT in `prophesee_words`; NumPy's files, AEDAT4 and ROS bags by
their libraries in another process (`library_process`): piece by piece, with bounded memory.

Source: Prophesee, "HDF5 Event File Format", https://docs.prophesee.ai/stable/data/file_formats/hdf5.html.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import (
    MOST_TRIGGERS,
    Events,
    EventSource,
    Triggers,
    as_events,
    as_triggers,
    join_triggers,
    require_one_length,
    require_ratio,
)
from drivers.camera.formats import ecf, prophesee_words
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
from drivers.camera.raw_file import RawFile
from drivers.camera.raw_writer import new_file, read_start, require_whole
from drivers.errors import NotARecording, RecordingCorrupt, RecordingFileError

CHUNK_EVENTS: Final = 16384
"""Number of events in a chunk of Metavision's HDF5."""
WINDOW_US: Final = 2000
"""Length of a window of the table ``indexes``, us."""

CD_TYPE: Final = np.dtype(
    {
        "names": ["x", "y", "p", "t"],
        "formats": ["<u2", "<u2", "<i2", "<i8"],
        "offsets": [0, 2, 4, 8],
        "itemsize": 16,
    }
)
TRIGGER_TYPE: Final = np.dtype(
    {"names": ["p", "t", "id"], "formats": ["<i2", "<i8", "<i2"], "offsets": [0, 8, 16], "itemsize": 24}
)
INDEX_TYPE: Final = np.dtype([("id", "<u8"), ("ts", "<i8")])

_ASCII: Final = h5py.string_dtype("ascii")  # the only kind of attribute that Metavision reads
_NOT_THERE: Final = ("evt", "plugin_name")  # keys without meaning outside RAW


@dataclass(frozen=True)
class ExportSummary:
    """What was written to a file."""

    events: int
    triggers: int
    # Number of events that got their predecessor's time, because the format demands rising times.
    moved_events: int = 0
    # Whether the recording ends in the middle of a word, as half of all recordings do that were cut off.
    cut_off: bool = False


def export_metavision(recording: RawFile, path: Path) -> ExportSummary:
    """Write a Metavision HDF5 file, with bounded memory; the path must not exist."""
    triggers: list[Triggers] = []
    with _new_hdf5(path) as file:
        for key, value in _attributes(recording).items():
            file.attrs.create(key, value, dtype=_ASCII)
        events = _ecf_dataset(file.create_group("CD"))
        index = _Index()
        latest, moved = -(1 << 62), 0
        for chunk in _in_chunks(recording, triggers):
            rising = np.maximum(np.maximum.accumulate(chunk.t), latest)
            latest = int(rising[-1])
            moved += int((rising != chunk.t).sum())
            events.resize((index.events + len(chunk.t),))
            events.id.write_direct_chunk((index.events,), ecf.encode(chunk._replace(t=rising)))
            index.add(rising)
        index.write(file["CD"])
        edges = join_triggers(triggers)
        _write_triggers(file.create_group("EXT_TRIGGER"), edges)
    return ExportSummary(index.events, len(edges.t), moved, recording.truncated)


def export_hdf5(recording: RawFile, path: Path) -> ExportSummary:
    """Write a plain HDF5 file, with bounded memory; the path must not exist."""
    triggers: list[Triggers] = []
    n = 0
    with _new_hdf5(path) as file:
        file.attrs.update(width=recording.width, height=recording.height)
        file.create_group("header").attrs.update(recording.header)
        stored = {
            name: file.create_dataset(
                f"events/{name}",
                (0,),
                dtype,
                maxshape=(None,),
                chunks=(1 << 16,),
                compression=1,
                shuffle=True,
            )
            for name, dtype in (("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1"))
        }
        for chunk in _in_chunks(recording, triggers, size=1 << 20):
            for name, values in chunk._asdict().items():
                stored[name].resize((n + len(values),))
                stored[name][n:] = values
            n += len(chunk.t)
        edges = join_triggers(triggers)
        for name, values in edges._asdict().items():
            file.create_dataset(f"triggers/{name}", data=values)
    return ExportSummary(n, len(edges.t), cut_off=recording.truncated)


def export_numpy(recording: RawFile, path: Path) -> ExportSummary:
    """Write an ``.npz`` file; the path must not exist. All events are in memory meanwhile."""
    events, triggers = recording.read()
    with new_file(path) as part, part.open("xb") as file:
        np.savez_compressed(
            file,
            **events._asdict(),
            **{f"trigger_{name}": values for name, values in triggers._asdict().items()},
            size=np.array([recording.width, recording.height]),
        )
    return ExportSummary(len(events.t), len(triggers.t), cut_off=recording.truncated)


def _attributes(recording: RawFile) -> Mapping[str, str]:
    """Return the attributes of a Metavision file: the header's keys, in ASCII."""
    kept = {key: value for key, value in recording.header.items() if key not in _NOT_THERE}
    given = {**kept, "version": "1.0", "geometry": f"{recording.width}x{recording.height}"}
    return {key: value.encode("ascii", "replace").decode() for key, value in given.items()}


def _in_chunks(recording: RawFile, triggers: list[Triggers], *, size: int = CHUNK_EVENTS) -> Iterator[Events]:
    """Yield events in pieces of ``size`` (the last may be shorter); append the triggers."""

    def pieces() -> Iterator[Events]:
        for events, edges in recording.pieces():
            triggers.append(edges)
            yield events

    for chunk in _even(pieces(), size):
        yield Events(*chunk)


def _ecf_dataset(group: Any) -> Any:
    """Create a dataset whose chunks are written compressed, so that HDF5 itself needs no filter."""
    creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    creation.set_chunk((CHUNK_EVENTS,))
    creation.set_filter(ecf.FILTER_ID, h5py.h5z.FLAG_OPTIONAL, ())
    space = h5py.h5s.create_simple((0,), (h5py.h5s.UNLIMITED,))
    h5py.h5d.create(group.id, b"events", h5py.h5t.py_create(CD_TYPE, logical=True), space, creation)
    return group["events"]


def _write_triggers(group: Any, edges: Triggers) -> None:
    rows = np.zeros(len(edges.t), TRIGGER_TYPE)
    rows["p"], rows["t"], rows["id"] = edges.value, edges.t, edges.id
    group.create_dataset("events", data=rows, maxshape=(None,), chunks=(CHUNK_EVENTS,))
    index = _Index()
    index.add(edges.t)
    index.write(group)


class _Index:
    """The table by which readers find a time: the first event of each 2 ms window."""

    def __init__(self) -> None:
        self.events = 0
        self._origin_us = 0
        self._windows: list[NDArray[np.int64]] = []
        self._first: list[NDArray[np.int64]] = []
        self._times: list[NDArray[np.int64]] = []

    def add(self, t: NDArray[np.int64]) -> None:
        """Add the next events' times, which rise."""
        if not len(t):
            return
        if not self.events:
            self._origin_us = int(t[0])
        since = t - self._origin_us
        windows, first = np.unique(since // WINDOW_US, return_index=True)
        self._windows.append(windows)
        self._first.append(first + self.events)
        self._times.append(since[first])
        self.events += len(t)

    def write(self, group: Any) -> None:
        """Write the table beside the events."""
        rows = np.zeros(0, INDEX_TYPE)
        if self.events:
            windows, kept = np.unique(np.concatenate(self._windows), return_index=True)
            last_before = np.searchsorted(windows, np.arange(windows[-1] + 2)) - 1
            chosen = kept[np.maximum(last_before, 0)]
            rows = np.zeros(len(last_before), INDEX_TYPE)
            rows["id"] = np.concatenate(self._first)[chosen]
            rows["ts"] = np.concatenate(self._times)[chosen]
            rows[0] = (0, -1)
        table = group.create_dataset("indexes", data=rows, maxshape=(None,), chunks=(CHUNK_EVENTS,))
        if self.events:
            table.attrs.create("offset", str(-self._origin_us), dtype=_ASCII)


@contextmanager
def _new_hdf5(path: Path) -> Iterator[Any]:
    with new_file(path) as part, h5py.File(part, "x") as file:
        yield file


_AGAIN: Final = "Export it again from the RAW recording."
_EVENT_FILES: Final = "Give a file of events: RAW, HDF5, .npz, DAT, AEDAT4 or a ROS bag."
PIECE_EVENTS: Final = 500_000
_Columns = tuple[NDArray[Any], ...]

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
    start = read_start(path)
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
    columns = {name: dataset(file, f"events/{name}") for name in Events._fields}
    require_one_length({name: _length(column, f"events/{name}") for name, column in columns.items()})
    require_ratio(sum(column.nbytes for column in columns.values()), int(file.id.get_filesize()), "events")
    edges = {name: dataset(file, f"triggers/{name}") for name in Triggers._fields}
    header = texts(member(file, "header"))
    sides = texts(file)
    missing = [name for name in ("width", "height") if name not in sides]
    if missing:
        raise ValueError(f"{missing[0]} is missing")
    triggers = as_triggers({name: _edges(column, f"triggers/{name}") for name, column in edges.items()})

    def pieces() -> Iterator[Events]:
        even = (_even(((part,) for part in rows(column)), PIECE_EVENTS) for column in columns.values())
        for parts in zip(*even, strict=True):
            yield as_events(*(part for (part,) in parts))

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
            yield as_events(*(part[name] for name in Events._fields))

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


def _even(pieces: Iterable[_Columns], size: int) -> Iterator[_Columns]:
    """Put columns of any length into pieces of one length; the last may be shorter."""
    kept: list[_Columns] = []
    have = 0
    for piece in pieces:
        kept.append(piece)
        have += len(piece[0])
        if have >= size:
            joined = _joined(kept)
            for begin in range(0, have - size + 1, size):
                yield tuple(column[begin : begin + size] for column in joined)
            kept = [tuple(column[have - have % size :] for column in joined)]
            have %= size
    if have:
        yield _joined(kept)


def _joined(pieces: list[_Columns]) -> _Columns:
    return tuple(np.concatenate(parts) for parts in zip(*pieces, strict=True))


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
