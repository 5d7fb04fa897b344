"""Import events from files for analysis: Metavision's HDF5, plain HDF5 and NumPy (layouts: see ``event_files``)."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np

from drivers.camera.event_arrays import Events, Triggers, empty_events
from drivers.camera.formats import ecf
from drivers.camera.formats.event_files import CD_TYPE
from drivers.errors import NotARecording, RecordingCorrupt, RecordingFileError

_AGAIN: Final = "Export it again from the RAW recording."
_EVENT_FILES: Final = "Give a Metavision HDF5, a plain HDF5 or an .npz file of events."

_UNREADABLE: Final = (
    *(TypeError, LookupError, ValueError, OverflowError, RuntimeError, EOFError),
    *(zipfile.BadZipFile, zlib.error),
)
"""What HDF5 and NumPy raise for a damaged file, or one with another layout."""


@dataclass(frozen=True)
class ImportedEvents:
    """The contents of an imported file.

    Attributes
    ----------
    events, triggers
        In the order of the file.
    width, height
        Size of the sensor, px.
    header
        Other keys and texts that the file holds about the recording.
    """

    events: Events
    triggers: Triggers
    width: int
    height: int
    header: Mapping[str, str]


def import_events(path: Path | str) -> ImportedEvents:
    """Read a file. Its contents decide the format, not its name.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    ImportedEvents
        All of it, in memory.

    Raises
    ------
    NotARecording
        If it has none of the three formats, lacks a part, or an event lies outside the sensor.
    RecordingCorrupt
        If a chunk of events cannot be decompressed.
    RecordingFileError
        If it cannot be read.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            start = file.read(8)
        if start == b"\x89HDF\r\n\x1a\n":
            with h5py.File(path, "r") as file:
                return _from_metavision(file, path) if "CD" in file else _from_hdf5(file, path)
        if start[:4] == b"PK\x03\x04":
            return _from_numpy(path)
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
    raise NotARecording(
        "The format of this file is unknown: it is not RAW, HDF5 or .npz.",
        where=str(path),
        remedy=_EVENT_FILES,
    )


def _not_events(path: Path, why: str) -> NotARecording:
    """Build the error of a file without readable events."""
    return NotARecording(f"The file holds no readable events: {why}.", where=str(path), remedy=_EVENT_FILES)


def _from_numpy(path: Path) -> ImportedEvents:
    with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
        width, height = (int(side) for side in _part(file, "size"))
        events = _as_events(*(_part(file, name) for name in ("t", "x", "y", "p")))
        triggers = _as_triggers(*(_part(file, f"trigger_{name}") for name in ("t", "value", "id")))
    return _checked(ImportedEvents(events, triggers, width, height, {}), path)


def _from_hdf5(file: Any, path: Path) -> ImportedEvents:
    events = _as_events(*(_part(file, f"events/{name}")[:] for name in ("t", "x", "y", "p")))
    triggers = _as_triggers(*(_part(file, f"triggers/{name}")[:] for name in ("t", "value", "id")))
    header = {key: _text(value) for key, value in _part(file, "header").attrs.items()}
    size = int(_part(file.attrs, "width")), int(_part(file.attrs, "height"))
    return _checked(ImportedEvents(events, triggers, *size, header), path)


def _from_metavision(file: Any, path: Path) -> ImportedEvents:
    header = {key: _text(value) for key, value in file.attrs.items()}
    width, height = (int(side) for side in _part(header, "geometry").split("x"))
    rows = _part(file, "EXT_TRIGGER/events")[:]
    triggers = _as_triggers(rows["t"], rows["p"], rows["id"])
    events = _metavision_events(_part(file, "CD/events"), path)
    return _checked(ImportedEvents(events, triggers, width, height, header), path)


def _metavision_events(dataset: Any, path: Path) -> Events:
    """Decompress the chunks here, because few installations of HDF5 have the filter."""
    if not isinstance(dataset, h5py.Dataset):
        raise ValueError("CD/events is a group, not a dataset")  # noqa: TRY004 - of the file, not of the caller
    creation = dataset.id.get_create_plist()
    filters = [creation.get_filter(k)[0] for k in range(creation.get_nfilters())]
    if filters != [ecf.FILTER_ID]:
        return _from_rows(dataset[:])
    events = empty_events(len(dataset))
    read = 0
    for k in range(dataset.id.get_num_chunks()):
        info = dataset.id.get_chunk_info(k)
        begin = info.chunk_offset[0]
        n = min(len(events.t) - begin, dataset.chunks[0])
        skipped, data = dataset.id.read_direct_chunk(info.chunk_offset)
        try:
            part = _from_rows(np.frombuffer(data, CD_TYPE)) if skipped else ecf.decode(data)
            if len(part.t) < n:
                raise ValueError(f"a chunk holds {len(part.t)} events instead of {n}")  # noqa: TRY301
        except ValueError as error:
            raise RecordingCorrupt(
                f"The events cannot be decompressed: {error}.",
                offset=info.byte_offset,
                where=str(path),
                remedy=_AGAIN,
            ) from error
        place = slice(begin, begin + n)
        events.t[place], events.x[place] = part.t[:n], part.x[:n]
        events.y[place], events.p[place] = part.y[:n], part.p[:n]
        read += n
    if read != len(events.t):
        raise _not_events(path, f"{len(events.t) - read} of its {len(events.t)} events are missing")
    return events


def _part(of: Any, name: str) -> Any:
    """Return a part of a file. Raises ValueError if it is missing."""
    if name not in of:
        raise ValueError(f"{name} is missing")
    return of[name]


def _from_rows(rows: Any) -> Events:
    return _as_events(rows["t"], rows["x"], rows["y"], rows["p"])


def _as_events(t: Any, x: Any, y: Any, p: Any) -> Events:
    return Events(_whole(t, np.int64), _whole(x, np.uint16), _whole(y, np.uint16), _whole(p, np.uint8))


def _as_triggers(t: Any, value: Any, channel: Any) -> Triggers:
    return Triggers(_whole(t, np.int64), _whole(value, np.uint8), _whole(channel, np.uint8))


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


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _checked(found: ImportedEvents, path: Path) -> ImportedEvents:
    """Check that lengths agree and that every event lies on the sensor."""
    for arrays in (found.events, found.triggers):
        if len({len(values) for values in arrays}) != 1:
            raise _not_events(path, "the arrays have different lengths")
    events = found.events
    if len(events.t) and (
        events.x.max() >= found.width or events.y.max() >= found.height or events.p.max() > 1
    ):
        raise _not_events(path, f"an event lies outside the sensor of {found.width} x {found.height} px")
    return found
