"""Read tables of events from files of NumPy, of Parquet and of text, in the process of `library_reader`.

- ``.npz`` as `event_exports` writes it; edges, size and header may be missing. Else, as ``.npy``, an array with named
  columns.
- Parquet, as `parquet_export` writes it; metadata may be missing.
- Text: a line for each event, below the names of its columns; without names ``t x y p``. Above may stand comments
  (``#``, ``%``). A line ``%geometry:1280,720`` states the sensor's size, and without names the order ``x,y,p,t`` of
  Prophesee's CSV.
"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from drivers.camera.event_arrays import (
    Events,
    EventSource,
    ReadingChoices,
    TimeUnit,
    Triggers,
    as_triggers,
    empty_triggers,
    require_one_length,
    require_ratio,
)
from drivers.camera.formats.event_columns import (
    COLUMNS,
    Columns,
    Parts,
    is_table,
    named,
    required,
    unit_of_name,
)
from drivers.camera.formats.parquet_export import require_pyarrow
from drivers.camera.raw_header import GIVE_SIZE, encoding_of, header_fields
from drivers.errors import NotARecording, UnreadableEvents

NPY_MAGIC: Final = b"\x93NUMPY"
PARQUET_MAGIC: Final = b"PAR1"
PIECE_EVENTS: Final = 500_000  # Read at once
_MOST_ARRAYS: Final = 32
"""An archive with more arrays is none of events."""
_HEAD_BYTES: Final = 1 << 16  # Holds comments, names and the first events of a text
_GEOMETRY: Final = re.compile(r"% *geometry *: *(\d{1,5}) *, *(\d{1,5}) *", re.IGNORECASE)
_MARKS_OF_COMMENTS: Final = ("#", "%")
_UNIT: Final = re.compile(r"[ \t]+(?=[\[(])")
"""Between a name and its unit: ``timestamp [us]``."""
_LONGEST_LINE: Final = 60  # Of a message
_SIDES: Final = 2  # Of a sensor
_TRUTHS: Final = re.compile(r"\b(?:true|false)\b", re.IGNORECASE)
_NUMBER: Final = re.compile(rf"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?|{_TRUTHS.pattern}", re.IGNORECASE)


def from_npz(path: Path, choices: ReadingChoices) -> EventSource:
    """Open NumPy's ``.npz``. Only plain numbers, and the header's text, are read."""
    with zipfile.ZipFile(path) as archive:
        if not any(name.endswith(".npy") for name in archive.namelist()):
            raise NotARecording("This is a zip archive without NumPy's arrays.", remedy="Unpack it first.")
        require_ratio(sum(member.file_size for member in archive.infolist()), path.stat().st_size, "it")
    with np.load(path, allow_pickle=False) as file:
        arrays, unit = _events_of(file, choices)
        edges = {name: f"trigger_{name}" for name in Triggers._fields}
        has_edges = any(stored in file for stored in edges.values())
        triggers = (
            as_triggers({name: _array(file, stored) for name, stored in edges.items()})
            if has_edges
            else empty_triggers(0)
        )
        width, height = map(int, np.ravel(file["size"])[:_SIDES]) if "size" in file else (0, 0)
        is_ours = "header" in file
        header = json.loads(str(file["header"])) if is_ours else {}
    sizes = {"the file": (width, height)} if width and height else {}
    return Columns(
        lambda: iter([arrays]), len(arrays[0]), sizes, header, triggers, "us" if is_ours else unit
    ).source(choices)


def _events_of(file: Mapping[str, Any], choices: ReadingChoices) -> tuple[Parts, TimeUnit | None]:
    """Return the columns of an archive, or its one table, and the unit that the name of the times states."""
    names = named(file)
    if names.count(None) == COLUMNS and len(file) <= _MOST_ARRAYS:
        tables = {name: table for name in file if is_table((table := _array(file, name)).shape, table.dtype)}
        if tables:
            return [tables[choices.chosen(tables)]], None
    own = [name or missing for name, missing in zip(names, Events._fields, strict=True)]
    arrays = [_array(file, name) for name in own]
    require_one_length({name: len(column) for name, column in zip(own, arrays, strict=True)})
    return arrays, unit_of_name(own[0])


def _array(file: Mapping[str, Any], name: str) -> Any:
    if name not in file:
        raise UnreadableEvents(f"{name} is missing in this .npz file.")
    try:
        return file[name]
    except ValueError as error:  # pickled, or cut off
        raise UnreadableEvents(f"{name} of this .npz file is no whole array of numbers.") from error


def from_npy(path: Path, choices: ReadingChoices) -> EventSource:
    """Open NumPy's ``.npy``: an array with named columns."""
    try:
        table = np.load(path, allow_pickle=False)
    except ValueError as error:
        raise UnreadableEvents("this .npy file is no whole array of numbers.") from error
    if not is_table(table.shape, table.dtype):
        shape = " x ".join(map(str, table.shape))
        raise UnreadableEvents(f"this array of {shape} has no columns named t, x, y and p.")
    return Columns(lambda: iter([[table]]), len(table)).source(choices)


def from_parquet(path: Path, choices: ReadingChoices) -> EventSource:
    """Open a Parquet file with the columns of events."""
    pa = require_pyarrow()
    opened = ExitStack()
    try:
        file = opened.enter_context(pa.parquet.ParquetFile(path))
    except pa.ArrowException as error:
        raise UnreadableEvents("this Parquet file is damaged or incomplete.") from error
    names = required(file.schema_arrow.names)
    stated = {key.decode(): value.decode() for key, value in (file.metadata.metadata or {}).items()}
    sizes = (
        {"the file": (int(stated["width"]), int(stated["height"]))}
        if {"width", "height"} <= stated.keys()
        else {}
    )
    edges = json.loads(stated.get("triggers", "{}"))
    triggers = (
        as_triggers({name: np.array(edges[name], np.int64) for name in Triggers._fields}) if edges else None
    )

    def parts() -> Iterator[Parts]:
        for batch in file.iter_batches(PIECE_EVENTS, columns=names):
            yield [batch.column(name).to_numpy(zero_copy_only=False) for name in names]

    unit = "us" if "header" in stated else unit_of_name(names[0])
    header = json.loads(stated.get("header", "{}"))
    columns = Columns(parts, file.metadata.num_rows, sizes, header, triggers or empty_triggers(0), unit)
    return columns.source(choices)


class _TextLayout(NamedTuple):
    """What the first lines of a text file say of its events."""

    skipped: int  # Lines above the first event
    delimiter: str | None
    times: str  # Name of the column of times
    places: list[int]  # Of t, x, y and p in a line
    sizes: dict[str, tuple[int, int]]
    has_truths: bool  # Whether polarities are the words true and false
    assumed: str  # Names of the columns if no line states them
    fits: bool  # Whether the first line below the names holds a number for each


def is_table_of_text(start: bytes) -> bool:
    """Return whether a file that starts with these bytes is text with a line of numbers an event."""
    is_recording = bool(encoding_of(header_fields(start)[0]))
    return not is_recording and _text_layout(start) is not None


def _text_layout(start: bytes) -> _TextLayout | None:
    """Return where the events of a text file stand; None if it states no names, and has no line of four numbers."""
    sizes, header, commented = dict[str, tuple[int, int]](), list[str](), list[str]()
    if b"\0" in start[:_HEAD_BYTES]:
        return None
    for number, line in enumerate(start[:_HEAD_BYTES].decode("utf-8-sig", "replace").splitlines()):
        delimiter = next((sign for sign in ";\t," if sign in line.strip()), None)
        words = _words(line, delimiter)
        numbers = [bool(_NUMBER.fullmatch(word.replace(",", "."))) for word in words]
        if geometry := _GEOMETRY.fullmatch(line.strip()):
            sizes["geometry"] = (int(geometry[1]), int(geometry[2]))
        elif line.startswith(_MARKS_OF_COMMENTS):
            commented = words if None not in named(words) else commented
        elif not any(numbers):
            header = words or header
        else:
            stated = header or (commented if len(commented) == len(words) else [])
            names = stated or _without_names(sizes)
            places = [names.index(name) for name in named(names) if name is not None]
            if len(places) < COLUMNS or not (stated or (all(numbers) and len(words) == COLUMNS)):
                return None
            return _TextLayout(
                skipped=number,
                delimiter=delimiter,
                times=names[places[0]],
                places=places,
                sizes=sizes,
                has_truths=bool(_TRUTHS.search(line)),
                assumed="" if stated else ", ".join(names),
                fits=max(places) < len(words) <= len(names)
                and all(_NUMBER.fullmatch(words[k]) for k in places),
            )
    return None


def order_assumed(path: Path) -> str:
    """Return a sentence on the order of columns that a text file of events does not name; empty for any other file."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        start = file.read(_HEAD_BYTES)
    layout = _text_layout(start) if is_table_of_text(start) else None
    if layout is None or not layout.assumed:
        return ""
    return f" No line names its columns, which were read as {layout.assumed}; a first line can name them."


def _without_names(sizes: Mapping[str, tuple[int, int]]) -> list[str]:
    """Return what the cells of a line are that no line names; Prophesee's CSV states the size."""
    return ["x", "y", "p", "t"] if sizes else ["t", "x", "y", "p"]


def _words(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line; none for what stands behind its last delimiter if that is blank."""
    text = _UNIT.sub("", line.lstrip("#%").strip())
    return [word.strip(' "') for word in text.rstrip(delimiter).split(delimiter)] if text else []


def from_text(path: Path, choices: ReadingChoices) -> EventSource:
    """Open text with a line for each event."""
    with path.open("rb") as file:
        layout = _text_layout(file.read(_HEAD_BYTES))
        assert layout is not None
        file.seek(max(0, path.stat().st_size - _HEAD_BYTES))
        last_line = file.read().rpartition(b"\n")[2].decode("utf-8", "replace").partition("#")[0].strip()
    truncated = bool(last_line) and len(_words(last_line, layout.delimiter)) <= max(layout.places)
    if not layout.fits:
        raise _no_event(path, layout)
    if not layout.sizes and choices.sensor_size is None:
        raise NotARecording(
            "This is a text file of events, which does not state the sensor's size.",
            remedy=GIVE_SIZE,
        )

    def parts() -> Iterator[Parts]:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            lines: Iterator[str] = islice(file, layout.skipped, None)
            if truncated:
                lines = (line for line, _ in pairwise(lines))
            if layout.has_truths:
                lines = (
                    _TRUTHS.sub(lambda word: str(int(word[0].lower() == "true")), line) for line in lines
                )
            for first in filter(str.strip, lines):
                table = _rows(chain([first], lines), path, layout)
                yield [table[:, k] for k in range(COLUMNS)]

    columns = Columns(parts, None, layout.sizes, unit=unit_of_name(layout.times))
    return replace(columns.source(choices), truncated=truncated)


def _rows(lines: Iterator[str], path: Path, layout: _TextLayout) -> Any:
    """Return the next rows. Raises NotARecording if a line does not hold the numbers of an event."""
    try:
        return np.loadtxt(
            lines,
            delimiter=layout.delimiter,
            usecols=layout.places,
            comments="#",
            quotechar='"',
            max_rows=PIECE_EVENTS,
            ndmin=2,
        )
    except ValueError as error:
        raise _no_event(path, layout) from error


def _no_event(path: Path, layout: _TextLayout) -> NotARecording:
    """Build the error of the first line that does not hold the numbers of an event."""
    number, line = _line_of_no_event(path, layout)
    return NotARecording(
        f"Line {number} does not hold the numbers of an event: {line.strip()[:_LONGEST_LINE]!r}.",
        remedy="It needs one for each name, with a decimal point. Correct it or take it out in a copy of the file.",
    )


def _line_of_no_event(path: Path, layout: _TextLayout) -> tuple[int, str]:
    """Return number and text of the first line that does not hold the numbers of an event."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in islice(enumerate(file, 1), layout.skipped, None):
            words = dict(enumerate(_words(line, layout.delimiter)))
            are_numbers = all(_NUMBER.fullmatch(words.get(place, "")) for place in layout.places)
            if not layout.fits or (line.partition("#")[0].strip() and not are_numbers):
                return number, line
    return 0, ""  # numbers in a form that Python reads and NumPy does not
