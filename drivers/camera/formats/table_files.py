"""Read tables of events from files of NumPy, of Parquet and of text, in the process of `library_reader`.

- ``.npz`` as `event_exports` writes it; edges, size and header may be missing. Else, as ``.npy``, one array with named
  columns (tonic, expelliarmus, N-ImageNet) or of N x 4 (EV-IMO, esim_py).
- Parquet, as `parquet_export` and evlib write it; metadata may be missing.
- Text: a line for each event, with names above it or without; above them may stand comments and the sensor's size:
  ``%geometry:1280,720`` (Prophesee's CSV), two numbers (E2VID), or names ``x@1280`` and ``y@720`` (faery).
"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
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
_HEAD_BYTES: Final = 1 << 16
_GEOMETRY: Final = re.compile(r"[%# ]*geometry *[:=]? *(\d{1,5}) *[,x ] *(\d{1,5}) *", re.IGNORECASE)
_MARKS_OF_COMMENTS: Final = "#% \t\r\n"
_UNIT: Final = re.compile(r"[ \t]+(?=[\[(])")
"""Between a name and its unit: ``timestamp [us]``."""
_OF_DECIMAL_COMMAS: Final = (";", "\t")
"""Delimiters of the spreadsheets of countries that write 0,5."""
_LONGEST_LINE: Final = 60  # Of a message
_SIZE: Final = 2
"""Numbers of a line that states the size."""
_TRUTH: Final = {"true": "1", "false": "0", "on": "1", "off": "0"}
"""Polarities as pandas and people write them."""
_TRUTHS: Final = re.compile(r"\b(?:true|false|on|off)\b", re.IGNORECASE)
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
        sides = [file[name] for name in ("size", "width", "height") if name in file]
        width, height = (
            map(int, np.concatenate([np.ravel(side) for side in sides])[:_SIZE]) if sides else (0, 0)
        )
        is_ours = "header" in file
        header = json.loads(str(file["header"])) if is_ours else {}
    sizes = {"the file": (width, height)} if width and height else {}
    return Columns(
        lambda: iter([arrays]), len(arrays[0]), sizes, header, triggers, "us" if is_ours else unit
    ).source(choices)


def _events_of(file: Mapping[str, Any], choices: ReadingChoices) -> tuple[Parts, TimeUnit | None]:
    """Return the columns of an archive, or its one table, and the unit that the name of the times states."""
    names = named(file)
    if None in names and len(file) <= _MOST_ARRAYS:
        unread: list[UnreadableEvents] = []
        tables = dict(_tables(file, unread))
        if tables:
            return [tables[choices.chosen(tables)]], None
        if unread:
            raise unread[0]
    own = [name or missing for name, missing in zip(names, Events._fields, strict=True)]
    arrays = [_array(file, name) for name in own]
    require_one_length({name: len(column) for name, column in zip(own, arrays, strict=True)})
    return arrays, unit_of_name(own[0])


def _tables(file: Mapping[str, Any], unread: list[UnreadableEvents]) -> Iterator[tuple[str, Any]]:
    """Yield the tables of events of an archive; the errors of its other arrays, such as of objects, are collected."""
    for name in file:
        try:
            table = _array(file, name)
        except UnreadableEvents as error:
            unread.append(error)
        else:
            if is_table(table.shape, table.dtype):
                yield name, table


def _array(file: Mapping[str, Any], name: str) -> Any:
    if name not in file:
        raise UnreadableEvents(f"{name} is missing in this .npz file.")
    try:
        return file[name]
    except ValueError as error:  # pickled, or cut off
        raise UnreadableEvents(f"{name} of this .npz file is no whole array of numbers.") from error


def from_npy(path: Path, choices: ReadingChoices) -> EventSource:
    """Open NumPy's ``.npy``: an array with named columns, or of four."""
    try:
        table = np.load(path, allow_pickle=False)
    except ValueError as error:
        raise UnreadableEvents("this .npy file is no whole array of numbers.") from error
    if not is_table(table.shape, table.dtype):
        shape = " x ".join(map(str, table.shape))
        raise UnreadableEvents(f"this array of {shape} has no columns t, x, y and p, and not four columns.")
    return Columns(lambda: iter([[table]]), len(table)).source(choices)


def from_parquet(path: Path, choices: ReadingChoices) -> EventSource:
    """Open a Parquet file with the columns of events; those of a duration state their unit."""
    pa = require_pyarrow()
    opened = ExitStack()
    try:
        file = opened.enter_context(pa.parquet.ParquetFile(path))
    except pa.ArrowException as error:
        raise UnreadableEvents("this Parquet file is damaged or incomplete.") from error
    names = required(file.schema_arrow.names)
    kind = file.schema_arrow.field(names[0]).type
    is_time = pa.types.is_duration(kind) or pa.types.is_timestamp(kind)
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
            columns = [batch.column(name) for name in names]
            if is_time:
                columns[0] = columns[0].cast(pa.int64())
            yield [column.to_numpy(zero_copy_only=False) for column in columns]

    unit = "us" if "header" in stated else kind.unit if is_time else unit_of_name(names[0])
    header = json.loads(stated.get("header", "{}"))
    columns = Columns(parts, file.metadata.num_rows, sizes, header, triggers or empty_triggers(0), unit)
    return columns.source(choices)


class _TextLayout(NamedTuple):
    """What the first lines of a text file say of its events."""

    skipped: int  # Lines above the first event
    delimiter: str | None
    names: list[str]  # Of the columns; empty without names
    places: Sequence[int]  # Of t, x, y and p; without names, of the four columns
    sizes: dict[str, tuple[int, int]]
    has_truths: bool  # Whether polarities are the words true and false


def is_table_of_text(start: bytes) -> bool:
    """Return whether a file that starts with these bytes is text with a line of four or more numbers an event."""
    is_recording = bool(encoding_of(header_fields(start)[0]))
    return not is_recording and _text_layout(start) is not None


def _text_layout(start: bytes) -> _TextLayout | None:
    sizes, names, delimiter = dict[str, tuple[int, int]](), list[str](), None
    if b"\0" in start[:_HEAD_BYTES]:
        return None
    for number, line in enumerate(start[:_HEAD_BYTES].decode("utf-8-sig", "replace").splitlines()):
        if not line.strip(_MARKS_OF_COMMENTS):
            continue
        delimiter = next((sign for sign in ";\t," if sign in line.strip()), None)
        words = _words(line, delimiter)
        own = [name for name in named(names) if name is not None]
        # Of cells with names, those of events are numbers; others may be text
        cells = [words[k] for k in map(names.index, own) if k < len(words)] if len(own) == COLUMNS else []
        are_numbers = bool(words[0]) and all(_NUMBER.fullmatch(word) for word in words if word)
        are_numbers |= len(cells) == COLUMNS and all(map(_NUMBER.fullmatch, cells))
        if geometry := _GEOMETRY.fullmatch(line.strip()):
            sizes["geometry"] = (int(geometry[1]), int(geometry[2]))
        elif are_numbers and len(words) == _SIZE and not number:
            sizes["the first line"] = (int(float(words[0])), int(float(words[1])))
        elif are_numbers and line[0] not in "#%":
            names = names if _is_header(names, line, delimiter) else []  # else they are words of a comment
            own = [name for name in _of_header(names) if name is not None]
            if len(own) < COLUMNS and (own or len(words) != COLUMNS):
                return None
            places = [names.index(name) for name in own] or range(COLUMNS)
            return _TextLayout(number, delimiter, own, places, sizes, bool(_TRUTHS.search(line)))
        else:
            above = [word.partition("@")[0] for word in words]
            if line[0] not in "#%" or not names or any(named(above)):
                names = above
            sides = [
                word.partition("@")[2] for name in ("x", "y") for word in words if word.startswith(f"{name}@")
            ]
            if len(sides) == _SIZE and all(map(str.isdecimal, sides)):
                sizes["the names of columns"] = (int(sides[0]), int(sides[1]))
    return None


def _words(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line: none for blanks behind its last delimiter, and numbers with a decimal point."""
    line = _UNIT.sub("", line.strip(_MARKS_OF_COMMENTS))
    words = [word.strip(' "') for word in line.rstrip(delimiter).split(delimiter)]
    return [word.replace(",", ".") for word in words] if delimiter in _OF_DECIMAL_COMMAS else words


def _is_header(names: list[str], line: str, delimiter: str | None) -> bool:
    """Return whether words above the first event name its cells, of which the last may be empty or without a name."""
    words = _words(line, delimiter)
    count = len(words)
    own = [names.index(name) for name in named(names) if name is not None]
    if len(own) < COLUMNS:
        return len(names) in {count, line.count(delimiter) + 1 if delimiter else count}
    if len(names) >= count or max(own) >= count:
        return max(own) < count
    # The cell without a name may be the first one: R numbers its rows so
    polarity = words[own[-1]].lower()
    return delimiter is not None and _TRUTH.get(polarity, polarity) in {"-1", "0", "1"}


def _of_header(names: list[str]) -> list[str | None]:
    """Return which names of a header are t, x, y and p; of four, the unknown one is the one that is missing."""
    own = named(names)
    if len(names) == COLUMNS and own.count(None) == 1:
        own[own.index(None)] = next(name for name in names if name not in own)
    return own


def from_text(path: Path, choices: ReadingChoices) -> EventSource:
    """Open text with a line for each event."""
    with path.open("rb") as file:
        layout = _text_layout(file.read(_HEAD_BYTES))
        assert layout is not None
        file.seek(max(0, path.stat().st_size - _HEAD_BYTES))
        last_line = file.read().rpartition(b"\n")[2].decode("utf-8", "replace").partition("#")[0].strip()
    is_no_event = bool(last_line) and len(_words(last_line, layout.delimiter)) <= max(layout.places)
    truncated = is_no_event and any(map(str.isdigit, last_line))  # else a mark of the end
    if not layout.sizes and choices.sensor_size is None:
        raise NotARecording(
            "This is a text file of events, which does not state the sensor's size.",
            remedy=GIVE_SIZE,
        )

    def parts() -> Iterator[Parts]:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            lines: Iterator[str] = islice(file, layout.skipped, None)
            if is_no_event:
                lines = (line for line, _ in pairwise(lines))
            if layout.delimiter in _OF_DECIMAL_COMMAS:
                lines = (line.replace(",", ".") for line in lines)
            if layout.has_truths:
                lines = (_TRUTHS.sub(lambda word: _TRUTH[word[0].lower()], line) for line in lines)
            for first in filter(str.strip, lines):
                table = _rows(chain([first], lines), path, layout)
                yield [table[:, k] for k in range(COLUMNS)] if layout.names else [table]

    unit = unit_of_name(layout.names[0]) if layout.names else None
    return replace(Columns(parts, None, layout.sizes, unit=unit).source(choices), truncated=truncated)


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
        number, line = _line_of_no_event(path, layout)
        raise NotARecording(
            f"Line {number} does not hold the numbers of an event: {line.strip()[:_LONGEST_LINE]!r}.",
            remedy="Correct it or take it out in a copy of the file.",
        ) from error


def _line_of_no_event(path: Path, layout: _TextLayout) -> tuple[int, str]:
    """Return number and text of the first line that does not hold the numbers of an event."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in islice(enumerate(file, 1), layout.skipped, None):
            words = dict(enumerate(_words(line, layout.delimiter)))
            are_numbers = all(_NUMBER.fullmatch(words.get(place, "")) for place in layout.places)
            if line.partition("#")[0].strip() and not are_numbers:
                return number, line
    return 0, ""  # numbers in a form that Python reads and NumPy does not
