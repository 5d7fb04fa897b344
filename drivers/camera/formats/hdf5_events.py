"""Find the events in an HDF5 file, whoever wrote it, and read them piece by piece.

- Metavision: ``/CD/events`` (x, y, p, t), ``/EXT_TRIGGER/events`` (p, t, id), the header's keys as attributes.
- Columns of one length in a group, or a table with names: ``t, x, y, p``. Our own plain layout is written so. Read if
  present: ``triggers/t, value, id``; ``width`` and ``height`` of the file or the group; ``t_offset``, us, which is
  added to the times.

`event_columns` has the unit of times. Times of 32 bits begin anew after 71.6 minutes.

Source: Prophesee, "HDF5 Event File Format", https://docs.prophesee.ai/stable/data/file_formats/hdf5.html.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import islice
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import (
    MOST_TRIGGERS,
    EventSource,
    ReadingChoices,
    Triggers,
    as_triggers,
    empty_triggers,
    even_pieces,
    require_one_length,
    require_ratio,
)
from drivers.camera.file_kinds import FORMS_OF_EVENTS
from drivers.camera.formats import ecf
from drivers.camera.formats.event_columns import Columns, Parts, is_table, named, unit_of_name
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
from drivers.errors import NotARecording, UnreadableEvents

CD_TYPE: Final = np.dtype(
    {
        "names": ["x", "y", "p", "t"],
        "formats": ["<u2", "<u2", "<i2", "<i8"],
        "offsets": [0, 2, 4, 8],
        "itemsize": 16,
    }
)
PIECE_EVENTS: Final = 500_000  # Some 8 MB as rows
_CD: Final = "CD/events"
_OFFSET: Final = "t_offset"
_MOST_GROUPS: Final = 1000  # Files of events have a few; a hostile one has no end of them
_MOST_PX: Final = 1 << 16  # No sensor has more; a wrong number would ask for the memory
_MOST_MEMBERS: Final = 10_000  # Event files have some tens
_MOST_NAMED, _LONGEST_NAME = 8, 60  # Of a message
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
        return (
            (part.reshape(-1),)
            for part in (
                rows_by_library(array) if by_library else rows(array, _decoded_ecf if is_ecf else None)
            )
        )

    def parts() -> Iterator[Parts]:
        even = [even_pieces(read(array), PIECE_EVENTS) for array in arrays.values()]
        return ([part for (part,) in columns] for columns in zip(*even, strict=True))

    header = (
        texts(file) if name == _CD else texts(member(file, "header")) if has_member(file, "header") else {}
    )
    path, times = next(iter(arrays.items()))
    is_of_us = times.dtype.kind != "f" and (name == _CD or has_member(file, "header"))
    unit = "us" if is_of_us else unit_of_name(path.rpartition("/")[2])
    if (offset_us := _offset(file, name)) is not None:
        if times.dtype.kind == "f" or unit not in {None, "us"}:
            raise UnreadableEvents(f"{_OFFSET} is added to whole numbers of us; {path} has others.")
        unit = "us"
    columns = Columns(
        parts,
        lengths.popitem()[1],
        {"the file": _size(file, name, header, choices)},
        header,
        _triggers(file),
        unit,
        offset_us or 0,
    )
    return columns.source(replace(choices, sensor_size=None))


def _offset(file: Any, name: str) -> int | None:
    """Return the time that is to be added to those of a stream, us, as an array of the file or of the stream's group.

    Raises NotARecording if there are two, or it is no whole number.
    """
    group = file[name] if name else file
    nodes = {node.name: node for node in (file, group.parent, group)}.values()
    holders = [node for node in nodes if isinstance(node, h5py.Group) and has_member(node, _OFFSET)]
    offsets = [node.attrs[_OFFSET] for node in nodes if _OFFSET in node.attrs]
    offsets += [whole(dataset(holder, _OFFSET), 64) for holder in holders]
    if len(offsets) > 1:
        raise UnreadableEvents(f"it states {_OFFSET} {len(offsets)} times.")
    return _number(offsets[0]) if offsets else None


def _streams(file: Any) -> list[str]:
    """Find the events of a file: groups with the columns of events, of which one may be missing, and tables."""
    streams: dict[bool, list[str]] = {True: [], False: []}  # By whether they are whole
    others: list[str] = []
    waiting = [("", file)]
    for name, group in waiting:
        members = {key: group.get(key, getlink=True) for key in islice(group, _MOST_MEMBERS)}
        if (missing := named(members).count(None)) <= 1:
            streams[not missing].append(name)
        for key, link in members.items():
            path = f"{name}/{key}".lstrip("/")
            if not isinstance(link, h5py.HardLink):
                others.append(f"{path[:_LONGEST_NAME]}, {_ELSEWHERE}")
            elif isinstance(child := group[key], h5py.Group) and len(waiting) < _MOST_GROUPS:
                waiting.append((path, child))
            elif isinstance(child, h5py.Dataset) and is_table(child.shape or (), child.dtype):
                streams[True].append(path)
            else:
                others.append(path[:_LONGEST_NAME])
    if not any(streams.values()):
        raise NotARecording(
            "The file holds no events: no group of this HDF5 file has columns t, x, y and p; it holds"
            f" {', '.join(others[:_MOST_NAMED]) or 'nothing'}.",
            remedy=FORMS_OF_EVENTS,
        )
    return streams[True] or streams[False]


def _arrays(file: Any, name: str) -> dict[str, Any]:
    """Return the arrays of a stream: one table, or its columns t, x, y, p."""
    group = member(file, name) if name else file
    if name == _CD or isinstance(group, h5py.Dataset):
        return {name: dataset(file, name)}
    own = [column or missing for column, missing in zip(named(group), "txyp", strict=True)]
    paths = [f"{name}/{column}".lstrip("/") for column in own]
    return {path: dataset(file, path) for path in paths}


def _length(array: Any, path: str) -> int:
    """Return the number of rows. Raises NotARecording if the array is no list; MATLAB writes one as N x 1 or 1 x N."""
    if not array.shape or array.size != max(array.shape):
        sides = " x ".join(map(str, array.shape)) or "no side"
        raise UnreadableEvents(f"{path} is an array of {sides}; a list is needed.")
    return int(array.size)


def _column(table: NDArray[Any], name: str) -> NDArray[Any]:
    if name not in (table.dtype.names or ()):
        raise UnreadableEvents(f"the table of edges has no column {name}.")
    column: NDArray[Any] = table[name]
    return column


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
        return as_triggers({name: _column(table, own) for name, own in names.items()})
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
    groups = [file, file[name]] if name and name != _CD else [file]
    sizes = {
        f"an attribute of {group.name}": (_number(group.attrs["width"]), _number(group.attrs["height"]))
        for group in groups
        if {"width", "height"} <= set(group.attrs)
    }
    return stated_size(header, "", choices.sensor_size, others=sizes, most_px=_MOST_PX)


def _number(value: Any) -> int:
    """Return a whole number of a file, alone or as the one element of a list. Raises NotARecording if it is none."""
    number = np.ravel(value)
    if number.size != 1 or number.dtype.kind not in "iuf" or number[0] != np.rint(number[0]):
        raise UnreadableEvents(f"it states {str(value)[:40]!r} where a whole number is needed.")
    return int(number[0])
