"""Find the events in an HDF5 file, whoever wrote it, and read them piece by piece.

- Metavision: ``/CD/events`` (x, y, p, t), ``/EXT_TRIGGER/events`` (p, t, id), the header's keys as attributes.
- Columns of one length in a group: ``t, x, y, p``, or ``ts, xs, ys, ps``. Our own plain layout, DSEC, e2calib and M3ED
  are such; ``triggers/t, value, id``, ``width`` and ``height`` (attributes), ``calib/resolution`` and ``t_offset`` (us)
  beside them are read if they are there.
- A table ``events`` of N x 4: t, x, y, p (v2e), x, y, t, p (MVSEC) or x, y, p, t; the column that rises has the times.

Times with fractions are in s, all others in us. Times of 32 bits begin anew after 71.6 minutes.

Sources: Prophesee, "HDF5 Event File Format", https://docs.prophesee.ai/stable/data/file_formats/hdf5.html; DSEC,
https://dsec.ifi.uzh.ch/data-format; M3ED, https://m3ed.io/data_overview; MVSEC, https://daniilidis-group.github.io/mvsec.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import (
    MOST_TRIGGERS,
    Clock32,
    Events,
    EventSource,
    ReadingChoices,
    Triggers,
    as_events,
    as_triggers,
    date_of,
    empty_triggers,
    even_pieces,
    from_zero,
    require_one_length,
    require_ratio,
    with_edges,
)
from drivers.camera.formats import ecf
from drivers.camera.formats.hdf5_reading import (
    dataset,
    filters,
    has_member,
    member,
    needs_library,
    rows,
    rows_by_library,
    texts,
    whole,
)
from drivers.camera.raw_header import stated_size
from drivers.errors import UnreadableEvents

CD_TYPE: Final = np.dtype(
    {
        "names": ["x", "y", "p", "t"],
        "formats": ["<u2", "<u2", "<i2", "<i8"],
        "offsets": [0, 2, 4, 8],
        "itemsize": 16,
    }
)
PIECE_EVENTS: Final = 500_000
_CD: Final = "CD/events"
_COLUMNS: Final = (
    ("t", "ts", "timestamp", "timestamps"),
    ("x", "xs"),
    ("y", "ys"),
    ("p", "ps", "polarity", "polarities"),
)
"""Names of the columns t, x, y and p."""
_OF_WHOLE: Final = (0, 1, 2, 3)
_OF_FRACTIONS: Final = (2, 0, 1, 3)
_ORDERS: Final = (_OF_WHOLE, _OF_FRACTIONS, (3, 0, 1, 2))
"""Places of t, x, y and p in the tables of known programs."""
_MOST_GROUPS: Final = 1000
_MOST_PX: Final = 1 << 16
_MOST_MEMBERS: Final = 10_000
_ELSEWHERE: Final = "a link to another place; only data in the file itself are read"


def opened_hdf5(file: Any, choices: ReadingChoices, *, by_library: bool = False) -> EventSource | None:
    """Read the events of an open file; None if only HDF5 itself can read them, and ``by_library`` does not allow it.

    Raises `NotARecording` if it holds no events, or lacks what they need; `RecordingCorrupt` if a chunk cannot be read.
    """
    name = _CD if has_member(file, "CD") else choices.chosen(_streams(file))
    arrays = _arrays(file, name)
    lengths = {path: _length(array, path) for path, array in arrays.items()}
    require_one_length(lengths)
    require_ratio(sum(array.nbytes for array in arrays.values()), int(file.id.get_filesize()), "it")
    # Few installations of HDF5 have the filter ECF, so its chunks are decompressed here.
    is_ecf = name == _CD and filters(arrays[_CD]) == [ecf.FILTER_ID]
    if not is_ecf and not by_library and any(map(needs_library, arrays.values())):
        return None

    def read(array: Any) -> Iterator[tuple[NDArray[Any]]]:
        parts = rows_by_library(array) if by_library else rows(array, _decoded_ecf if is_ecf else None)
        return ((part,) for part in parts)

    def events() -> Iterator[Events]:
        even = [even_pieces(read(array), PIECE_EVENTS) for array in arrays.values()]
        unit_us, clock, order = 0.0, Clock32(), None
        for parts in zip(*even, strict=True):
            own = [part for (part,) in parts]
            order = order or (_order(own[0]) if own[0].ndim == 2 else None)
            columns = _columns(own, order)
            unit_us = unit_us or _unit_us(columns[0])
            t, *others = (
                _whole_of(values, unit) for values, unit in zip(columns, (unit_us, 1, 1, 1), strict=True)
            )
            yield as_events(clock.continued(t) if t.dtype == np.uint32 else t, *others)

    header = (
        texts(file) if name == _CD else texts(member(file, "header")) if has_member(file, "header") else {}
    )
    offset = _number(member(file, "t_offset")[()]) if has_member(file, "t_offset") else None
    if offset is not None:
        header |= {"time_origin_us": str(offset), **date_of(offset)}
    size = _size(file, name, header, choices)
    edges = _triggers(file)
    count = lengths.popitem()[1]
    return from_zero(EventSource(*size, header, lambda: with_edges(events(), edges), count=count))


def _streams(file: Any) -> list[str]:
    """Find the events of a file: groups with the columns of events, and tables of that name."""
    complete: list[str] = []
    incomplete: list[str] = []
    links: list[str] = []
    waiting = [("", file)]
    for name, group in waiting:
        members = {key: group.get(key, getlink=True) for key in islice(group, _MOST_MEMBERS)}
        missing = sum(not any(name in members for name in names) for names in _COLUMNS)
        if missing <= 1:
            (incomplete if missing else complete).append(name)
        for key, link in members.items():
            path = f"{name}/{key}".lstrip("/")
            if not isinstance(link, h5py.HardLink):
                links.append(path)
            elif isinstance(child := group[key], h5py.Group) and len(waiting) < _MOST_GROUPS:
                waiting.append((path, child))
            elif key == "events" and isinstance(child, h5py.Dataset):
                complete.append(path)
    if not complete and not incomplete:
        held = (
            f"{links[0]} is {_ELSEWHERE}" if links else "no group of this HDF5 file has columns t, x, y and p"
        )
        raise UnreadableEvents(f"{held}.")
    return complete or incomplete


def _arrays(file: Any, name: str) -> dict[str, Any]:
    """Return the arrays of a stream: one table, or its columns t, x, y, p."""
    group = member(file, name) if name else file
    if name == _CD or isinstance(group, h5py.Dataset):
        return {name: dataset(file, name)}
    own = [next((column for column in names if has_member(group, column)), names[0]) for names in _COLUMNS]
    paths = [f"{name}/{column}".lstrip("/") for column in own]
    return {path: dataset(file, path) for path in paths}


def _length(array: Any, path: str) -> int:
    """Return the number of rows. Raises NotARecording if the array is no list, and no table of four columns."""
    if len(array.shape) != 1 and not (path.endswith("events") and array.shape[1:] == (4,)):
        raise UnreadableEvents(f"{path} has {len(array.shape)} dimensions; a list is needed.")
    return int(array.shape[0])


def _columns(parts: list[NDArray[Any]], order: Sequence[int] | None) -> list[NDArray[Any]]:
    """Return t, x, y and p of rows of a table, or of columns."""
    table = parts[0]
    if len(parts) == 1 and table.ndim == 1:
        return [_column(table, name, "events") for name in Events._fields]
    if order is not None:
        return [np.ascontiguousarray(table[:, k]) for k in order]
    return parts


def _order(table: NDArray[Any]) -> Sequence[int]:
    """Return the places of t, x, y and p in a table: where times rise, and polarities are; else as usual for its type.

    Raises NotARecording if no column can be that of polarities.
    """
    usual = _OF_WHOLE if table.dtype.kind in "iu" else _OF_FRACTIONS
    fitting = [one for one in (usual, *_ORDERS) if np.isin(table[:, one[3]], (-1, 0, 1)).all()]
    if not fitting:
        raise UnreadableEvents("no column of its table holds polarities, which are -1, 0 or 1.")
    rising = [one for one in fitting if not (table[1:, one[0]] < table[:-1, one[0]]).any()]
    return (rising or fitting)[0]


def _column(table: NDArray[Any], name: str, of: str) -> NDArray[Any]:
    if name not in (table.dtype.names or ()):
        raise UnreadableEvents(f"the table of {of} has no column {name}.")
    column: NDArray[Any] = table[name]
    return column


def _unit_us(t: NDArray[Any]) -> float:
    """Return the unit of times: 1e6 us if they have fractions, for those of microseconds are whole."""
    return 1e6 if t.dtype.kind == "f" and not np.array_equal(t, np.rint(t)) else 1.0


def _whole_of(values: NDArray[Any], unit: float) -> NDArray[Any]:
    """Return floating-point numbers of a unit as whole numbers; others as they are."""
    if values.dtype.kind != "f":
        return values
    cast = np.rint(values * unit).astype(np.int64)
    if unit == 1 and not np.array_equal(cast, values):
        raise UnreadableEvents("some of its columns, rows or polarities are no whole numbers.")
    return cast


def _decoded_ecf(chunk: bytes) -> NDArray[Any]:
    """Decompress a chunk to rows, as HDF5 would."""
    events = ecf.decode(chunk)
    table = np.empty(len(events.t), CD_TYPE)
    for name, values in events._asdict().items():
        table[name] = values
    return table


def _triggers(file: Any) -> Triggers:
    """Return the edges beside the events; none if the file has none."""
    if has_member(file, "EXT_TRIGGER"):
        if not has_member(member(file, "EXT_TRIGGER"), "events"):
            return empty_triggers(0)
        table = _edges(file, "EXT_TRIGGER/events")
        names = {"t": "t", "value": "p", "id": "id"}
        return as_triggers({name: _column(table, own, "edges") for name, own in names.items()})
    if has_member(file, "triggers") and set(Triggers._fields) <= set(member(file, "triggers")):
        return as_triggers({name: _edges(file, f"triggers/{name}") for name in Triggers._fields})
    return empty_triggers(0)


def _edges(file: Any, path: str) -> NDArray[Any]:
    """Read a list of edges at once."""
    column = dataset(file, path)
    if (n := _length(column, path)) > MOST_TRIGGERS:
        raise UnreadableEvents(f"{path} has {n} elements; at most {MOST_TRIGGERS} are read.")
    return whole(column, MOST_TRIGGERS * column.dtype.itemsize)


def _size(file: Any, name: str, header: Mapping[str, str], choices: ReadingChoices) -> tuple[int, int]:
    """Return width and height, px, wherever the file states them, else as given."""
    sizes = {}
    if {"width", "height"} <= set(file.attrs):
        sizes["the attributes"] = (_number(file.attrs["width"]), _number(file.attrs["height"]))
    resolution = f"{name}/calib/resolution"
    if name and name != _CD and resolution in file:
        width, height = whole(dataset(file, resolution), 64)
        sizes["calib/resolution"] = (_number(width), _number(height))
    return stated_size(header, "", choices.sensor_size, others=sizes, most_px=_MOST_PX)


def _number(value: Any) -> int:
    """Return a whole number of a file. Raises NotARecording if it is none."""
    if np.ndim(value) != 0 or np.asarray(value).dtype.kind not in "iu":
        raise UnreadableEvents(f"it states {str(value)[:40]!r} where a whole number is needed.")
    return int(value)
