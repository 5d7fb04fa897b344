"""Export a RAW file to files for analysis: Metavision's HDF5, plain HDF5 and NumPy.

The RAW file stays the evidence. All other files are computed from it and hold less: no counters of the sensor, and in
Metavision's HDF5 no time may step back. They appear complete or not at all, and are never overwritten. Layouts:

- Metavision: ``/CD/events`` (x, y, p, t; ECF-compressed chunks of 16384), ``/EXT_TRIGGER/events`` (p, t, id), each with
  ``indexes`` (id, ts): entry k names the first event of the last 2 ms window before window k that has any event,
  and its time since the first event; the header's keys as attributes.
- plain HDF5: ``/events/t, x, y, p`` and ``/triggers/t, value, id``, gzip; ``width``, ``height`` as attributes of the
  root, and the header's keys as attributes of ``/header``.
- NumPy: an ``.npz`` of ``t, x, y, p, trigger_t, trigger_value, trigger_id, size`` (width, height).

Source: Prophesee, "HDF5 Event File Format", https://docs.prophesee.ai/stable/data/file_formats/hdf5.html.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events, Triggers, empty_events, join_triggers
from drivers.camera.formats import ecf
from drivers.camera.raw_file import RawFile
from drivers.camera.raw_writer import new_file

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
    """Yield events in pieces of ``size`` (the last may be shorter), views of the same arrays; append the triggers."""
    whole = empty_events(size)
    filled = 0
    for events, edges in recording.pieces():
        triggers.append(edges)
        done = 0
        while done < len(events.t):
            take = min(size - filled, len(events.t) - done)
            to, of = slice(filled, filled + take), slice(done, done + take)
            whole.t[to], whole.x[to] = events.t[of], events.x[of]
            whole.y[to], whole.p[to] = events.y[of], events.p[of]
            filled, done = filled + take, done + take
            if filled == size:
                yield whole
                filled = 0
    if filled:
        yield whole.part(0, filled)


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
