"""Write events to new files for analysis: Metavision's HDF5, plain HDF5, NumPy, Parquet and CSV.

The RAW file stays the evidence. All other files are computed from it and hold less: no counters of the sensor, and in
Metavision's HDF5 no time may step back. They appear complete or not at all, and are never overwritten. Layouts:

- Metavision: ``/CD/events`` (x, y, p, t; ECF-compressed chunks of 16384), ``/EXT_TRIGGER/events`` (p, t, id), each with
  ``indexes`` (id, ts): entry k names the first event of the last 2 ms window before window k that has any event,
  and its time since the first event; the header's keys as attributes.
- plain HDF5: ``/events/t, x, y, p`` and ``/triggers/t, value, id``, gzip; ``width``, ``height`` as attributes of the
  root, and the header's keys as attributes of ``/header``.
- NumPy: an ``.npz`` of ``t, x, y, p, trigger_t, trigger_value, trigger_id, size`` (width, height) and the ``header`` as
  JSON.
- Parquet: see `parquet_export`.
- CSV: the lines ``%geometry:`` width, height and ``x,y,p,t_us``, then an event a line; no edges. Without the names, it
  is Prophesee's CSV.

Source: Prophesee, "HDF5 Event File Format", https://docs.prophesee.ai/stable/data/file_formats/hdf5.html.
"""

from __future__ import annotations

import json
import zipfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, TypeVar

import h5py
import numpy as np
from isal import isal_zlib
from numba import njit
from numpy.typing import NDArray

from drivers.camera.event_arrays import (
    Events,
    EventSource,
    Triggers,
    empty_events,
    even_pieces,
    join_triggers,
)
from drivers.camera.formats import ecf
from drivers.camera.formats.hdf5_events import CD_TYPE
from drivers.camera.formats.parquet_export import GROUP_EVENTS, write_parquet
from drivers.camera.formats.planes import planes_of
from drivers.camera.formats.unfailing_stream import UnfailingStream
from drivers.camera.raw_header import MAX_SIDE_PX
from drivers.camera.raw_writer import new_file
from drivers.errors import RecordingFileError

CHUNK_EVENTS: Final = 16384
"""Number of events in a chunk of Metavision's HDF5."""
WINDOW_US: Final = 2000
"""Length of a window of the table ``indexes``, us."""
TRIGGER_TYPE: Final = np.dtype(
    {"names": ["p", "t", "id"], "formats": ["<i2", "<i8", "<i2"], "offsets": [0, 8, 16], "itemsize": 24}
)
INDEX_TYPE: Final = np.dtype([("id", "<u8"), ("ts", "<i8")])

_ASCII: Final = h5py.string_dtype("ascii")  # the only kind of attribute that Metavision reads
_NOT_THERE: Final = ("evt", "plugin_name")  # keys without meaning outside RAW
_PLAIN_COLUMNS: Final = (("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1"))
_PLAIN_CHUNK: Final = 1 << 16  # Events
_LEVEL: Final = 1
"""Level of gzip; the next one compresses events by 3 % more, in twice the time."""
_MOST_WAITING: Final = 16
"""Most chunks that are packed and not yet written: enough for all processors, and some megabytes."""

Chunk = TypeVar("Chunk")
Packed = TypeVar("Packed")
Progress = Callable[[float], object]
"""Is told which share of a source has been read, 0 to 1."""


@dataclass(frozen=True)
class ExportSummary:
    """What was written to a file."""

    events: int
    triggers: int
    # Number of events that got their predecessor's time, because the format demands rising times.
    moved_events: int = 0
    # Whether the source ends in the middle of a word, as half of all recordings do that were cut off.
    cut_off: bool = False
    edges_left_out: int = 0  # Because the format holds none
    # Number of words left out because EVT3 does not define their type
    unknown_words: int = 0
    # Time from the first to the last event, us; 0 if the source's words were copied
    span_us: int = 0
    # As `EventSource.assumed`; and "sensor_size" (what the events fill) if the one given seems too large
    assumed: Mapping[str, str] = field(default_factory=dict)


class _Reading:
    """One pass over a source: its events for the new file; its edges and what it states are known at the end."""

    def __init__(self, source: EventSource, progress: Progress) -> None:
        self._source, self._progress = source, progress
        self._edges: list[Triggers] = []
        self._events = 0

    def events(self) -> Iterator[Events]:
        """Yield the events piece by piece."""
        for events, edges in self._source.pieces():
            if len(edges.t):
                self._edges.append(edges)
            yield events
            self._events += len(events.t)
            self._progress(self._source.state.share)

    def chunks(self, size: int) -> Iterator[Events]:
        """Yield the events in pieces of one size; the last may be shorter."""
        for chunk in even_pieces(self.events(), size):
            yield Events(*chunk)

    def triggers(self) -> Triggers:
        """Return the edges read so far."""
        return join_triggers(self._edges)

    def summary(self, moved: int = 0) -> ExportSummary:
        """Sum up what was read."""
        edges = sum(len(part.t) for part in self._edges)
        return ExportSummary(
            self._events,
            edges,
            moved,
            cut_off=self._source.truncated,
            unknown_words=self._source.state.unknown_words,
        )


def _packed(
    chunks: Iterator[tuple[int, Chunk]], pack: Callable[[Chunk], Packed]
) -> Iterator[tuple[int, Packed]]:
    """Pack chunks, each with its number of events, on all processors, in their order."""
    with ThreadPoolExecutor() as pool:
        waiting: deque[tuple[int, Future[Packed]]] = deque()
        for n, chunk in chunks:
            waiting.append((n, pool.submit(pack, chunk)))
            if len(waiting) > _MOST_WAITING:
                first, packed = waiting.popleft()
                yield first, packed.result()
        for n, packed in waiting:
            yield n, packed.result()


def _packed_planes(events: Events) -> list[bytes]:
    """Return a chunk of each column as HDF5's filters shuffle and gzip make it."""
    columns = np.split(
        planes_of(events, _PLAIN_CHUNK),
        np.cumsum([np.dtype(dtype).itemsize for _, dtype in _PLAIN_COLUMNS])[:-1],
    )
    return [isal_zlib.compress(column, _LEVEL) for column in columns]


def export_metavision(source: EventSource, path: Path, progress: Progress = lambda _: None) -> ExportSummary:
    """Write a Metavision HDF5 file, with bounded memory; the path must not exist."""
    if max(source.width, source.height) > MAX_SIDE_PX:
        raise RecordingFileError(
            f"Metavision's HDF5 cannot hold a sensor of {source.width} x {source.height} px.",
            where=str(path),
            remedy="Write plain HDF5 (.h5) or .npz.",
        )
    with _new_hdf5(path) as (file, disk):
        for key, value in _attributes(source).items():
            file.attrs.create(key, value, dtype=_ASCII)
        events = _ecf_dataset(file.create_group("CD"))
        index = _Index()
        reading = _Reading(source, progress)
        moved = n = 0

        def rising() -> Iterator[tuple[int, Events]]:
            nonlocal moved
            latest = -(1 << 62)
            for chunk in reading.chunks(CHUNK_EVENTS):
                t = ecf.rising(chunk.t, latest)
                latest = int(t[-1])
                if t is not chunk.t:
                    moved += int((t != chunk.t).sum())
                index.add(t)
                yield len(t), chunk._replace(t=t)

        for more, data in _packed(rising(), ecf.encode):
            events.id.set_extent((n + more,))
            events.id.write_direct_chunk((n,), data)
            disk.raise_failure()
            n += more
        index.write(file["CD"])
        _write_triggers(file.create_group("EXT_TRIGGER"), reading.triggers())
    return reading.summary(moved)


def export_hdf5(source: EventSource, path: Path, progress: Progress = lambda _: None) -> ExportSummary:
    """Write a plain HDF5 file, with bounded memory; the path must not exist."""
    n = 0
    reading = _Reading(source, progress)
    with _new_hdf5(path) as (file, disk):
        file.attrs.update(width=source.width, height=source.height)
        file.create_group("header").attrs.update(source.header)
        stored = {
            name: file.create_dataset(
                f"events/{name}",
                (0,),
                dtype,
                maxshape=(None,),
                chunks=(_PLAIN_CHUNK,),
                compression=_LEVEL,
                shuffle=True,
            )
            for name, dtype in _PLAIN_COLUMNS
        }
        chunks = ((len(chunk.t), chunk) for chunk in reading.chunks(_PLAIN_CHUNK))
        for more, packed in _packed(chunks, _packed_planes):
            for column, data in zip(stored.values(), packed, strict=True):
                column.id.set_extent((n + more,))
                column.id.write_direct_chunk((n,), data)
            disk.raise_failure()
            n += more
        for name, values in reading.triggers()._asdict().items():
            file.create_dataset(f"triggers/{name}", data=values)
    return reading.summary()


def export_numpy(source: EventSource, path: Path, progress: Progress = lambda _: None) -> ExportSummary:
    """Write an ``.npz`` file; the path must not exist. All events are in memory meanwhile."""
    reading = _Reading(source, progress)
    pieces = [*reading.events(), empty_events(0)]
    events = [np.concatenate(column) for column in zip(*pieces, strict=True)]
    del pieces
    arrays = {
        **Events(*events)._asdict(),
        **{f"trigger_{name}": values for name, values in reading.triggers()._asdict().items()},
        "size": np.array([source.width, source.height]),
        "header": np.array(json.dumps(dict(source.header))),
    }
    with new_file(path) as part, zipfile.ZipFile(part, "x", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, values, allow_pickle=False)
    return reading.summary()


def export_parquet(source: EventSource, path: Path, progress: Progress = lambda _: None) -> ExportSummary:
    """Write a Parquet file, with bounded memory; the path must not exist."""
    reading = _Reading(source, progress)
    with new_file(path) as part:
        write_parquet(part, source, reading.chunks(GROUP_EVENTS), reading.triggers)
    return reading.summary()


def export_csv(source: EventSource, path: Path, progress: Progress = lambda _: None) -> ExportSummary:
    """Write a CSV file, with bounded memory; the path must not exist."""
    reading = _Reading(source, progress)
    with new_file(path) as part, part.open("x", encoding="ascii", newline="\n") as file:
        file.write(f"%geometry:{source.width},{source.height}\nx,y,p,t_us\n")
        for t, x, y, p in reading.events():
            rows = zip(x.tolist(), y.tolist(), p.tolist(), t.tolist(), strict=True)
            file.writelines(map("%d,%d,%d,%d\n".__mod__, rows))
    summary = reading.summary()
    return replace(summary, triggers=0, edges_left_out=summary.triggers)


def _attributes(source: EventSource) -> Mapping[str, str]:
    """Return the attributes of a Metavision file: the header's keys, in ASCII."""
    kept = {key: value for key, value in source.header.items() if key not in _NOT_THERE}
    given = {**kept, "version": "1.0", "geometry": f"{source.width}x{source.height}"}
    return {key: value.encode("ascii", "replace").decode() for key, value in given.items()}


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
        first = _first_of_windows(t, self._origin_us)
        since = t[first] - self._origin_us
        self._windows.append(since // WINDOW_US)
        self._first.append(first + self.events)
        self._times.append(since)
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


@njit(cache=True, nogil=True)
def _first_of_windows(t: Any, origin_us: int) -> Any:
    """Return the numbers of the events that lie in another window than the one before."""
    first = np.empty(len(t), np.int64)
    n, end_us = 0, np.int64(origin_us)
    for i in range(len(t)):
        if t[i] >= end_us or t[i] < end_us - WINDOW_US:
            end_us = origin_us + ((t[i] - origin_us) // WINDOW_US + 1) * WINDOW_US
            first[n] = i
            n += 1
    return first[:n].copy()


@contextmanager
def _new_hdf5(path: Path) -> Iterator[tuple[Any, UnfailingStream]]:
    with new_file(path) as part, part.open("x+b", buffering=0) as stream:
        disk = UnfailingStream(stream)
        with h5py.File(disk, "w") as file:
            yield file, disk
        disk.raise_failure()
