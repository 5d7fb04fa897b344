"""Open any program's file of events; its contents decide the format, not its name.

HDF5 is read by `hdf5_events`, RAW with EVT2 words and DAT by `prophesee_words`; tables of NumPy, Parquet and text, and
HDF5 that only its library can read, by their libraries in another process (`library_process`): piece by piece, with
bounded memory. Entry points add formats: AEDAT4, ROS bags, and those of other packages.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import (
    MOST_TRIGGERS,
    Events,
    EventSource,
    Piece,
    ReadingChoices,
    ReadingState,
    too_many_edges,
)
from drivers.camera.evt3 import Words
from drivers.camera.file_kinds import FORMS_OF_EVENTS, in_place_of_file, is_dat
from drivers.camera.formats import prophesee_words
from drivers.camera.formats.hdf5_events import opened_hdf5
from drivers.camera.formats.library_process import NO_EVENTS, source_of_library
from drivers.camera.formats.table_files import (
    NPY_MAGIC,
    PARQUET_MAGIC,
    is_table_of_text,
    order_assumed,
)
from drivers.camera.formats.time_units import UnitCheck
from drivers.camera.raw_check import read_start, require_whole
from drivers.camera.raw_file import RawFile, unreadable
from drivers.camera.raw_header import parse_header
from drivers.errors import NotARecording, RecordingCorrupt, RecordingFileError, UnreadableEvents

_MOST_BACK_STEP_US: Final = 10_000
"""Times of one camera may lie behind the latest by the length of a packet or two, which a computer has mixed up."""
_COPY_AGAIN: Final = "Copy it again from its origin, or export it again from the original recording."
GROUP: Final = "starbench.event_files"
"""Entry points of formats; Starbench's own are declared so too."""
_RAW: Final = b"% "
_HDF5: Final = b"\x89HDF\r\n\x1a\n"
_UNREADABLE: Final = (
    *(TypeError, LookupError, ValueError, OverflowError, RuntimeError, EOFError, NotImplementedError),
    zlib.error,
)
"""What HDF5 and NumPy raise for a damaged file, or one with another layout."""


@contextmanager
def open_events(path: Path | str, choices: ReadingChoices | None = None) -> Iterator[EventSource]:
    """Open a file of events until the end of the block; ``choices`` say what the file does not.

    Raises `NotARecording` if it has none of the formats, lacks a part, keeps data in another file, or an event lies
    outside the sensor; `RecordingCorrupt` if a chunk cannot be decompressed.
    """
    path, choices = Path(path), choices or ReadingChoices()
    with ExitStack() as opened:
        with _errors_of(path):
            source = _source(path, choices, opened)

        def pieces() -> Iterator[Piece]:
            with _errors_of(path):
                yield from _checked(source.pieces(), source)

        yield replace(source, pieces=pieces)


def _source(path: Path, choices: ReadingChoices, opened: ExitStack) -> EventSource:
    start = b"" if path.is_dir() else read_start(path)
    if start:
        require_whole(path)
    if start.startswith(_HDF5):
        source = opened_hdf5(opened.enter_context(h5py.File(path, "r")), choices)
        return source or opened.enter_context(source_of_library(path, "hdf5", choices))
    brought, unusable = ((), ()) if start.startswith(_RAW) else brought_formats()
    for form in brought:
        if form.recognises(path, start):
            _require_no_unit(choices)
            return opened.enter_context(form.open_events(path, choices))
    for kind, is_of_kind in _of_table(start).items():
        if is_of_kind:
            return opened.enter_context(source_of_library(path, kind, choices))
    for entry, why in unusable:
        what = f"The reader {entry.name!r} of {entry.value}, which may know it, cannot be used: {why}."
        raise NotARecording(what, remedy="Install its package again, or remove it.")
    if not start:
        read_start(path)  # refuses a folder
    _require_no_unit(choices)
    if is_dat(start):
        return prophesee_words.from_dat(path, start, choices)
    header = parse_header(start, where=str(path), sensor_size=choices.sensor_size, evt3_only=False)
    if header.encoding == "EVT3":
        return _of_recording(RawFile(path, header))
    return prophesee_words.from_evt2(path, header)


@functools.cache
def brought_formats() -> tuple[Sequence[Any], Sequence[tuple[EntryPoint, str]]]:
    """Load the formats that packages declare (`library_process.LibraryFormat`); those that cannot be used, with why."""
    formats, unusable = list[Any](), list[tuple[EntryPoint, str]]()
    for entry in entry_points(group=GROUP):
        try:
            formats.append(entry.load())
        except Exception as error:  # noqa: BLE001 - another package may raise anything
            unusable.append((entry, f"{type(error).__name__}: {error}"))
    return formats, unusable


def _of_table(start: bytes) -> dict[str, bool]:
    """Return by kind whether a file is a table, which is read by its library."""
    return {
        "npz": start[:4] == b"PK\x03\x04" and in_place_of_file(start) is None,
        "npy": start.startswith(NPY_MAGIC),
        "parquet": start.startswith(PARQUET_MAGIC),
        "text": is_table_of_text(start),
    }


def _require_no_unit(choices: ReadingChoices) -> None:
    """Refuse (`NotARecording`) a unit for a file whose format states it."""
    if choices.time_unit is not None:
        raise NotARecording("The format of this file states the unit.", remedy="Leave out --time-unit.")


def _of_recording(recording: RawFile) -> EventSource:
    state = ReadingState()
    total_bytes = recording.path.stat().st_size

    def words() -> Iterator[Words]:
        read_bytes = recording.raw_header.size_bytes
        for block in recording.words():
            yield block
            read_bytes += block.nbytes
            state.share = read_bytes / total_bytes

    def pieces() -> Iterator[Piece]:
        decoder = recording.decoder(skip_unknown=True)
        yield from decoder.decode(words())
        state.unknown_words = decoder.statistics().unknown_words

    size = recording.width, recording.height
    return EventSource(*size, recording.header, pieces, recording.truncated, state=state)


@contextmanager
def _errors_of(path: Path) -> Iterator[None]:
    """Name the file in errors of recordings, and turn what HDF5, NumPy and the system raise into such."""
    try:
        yield
    except RecordingCorrupt as error:
        if error.where:
            raise
        what = error.what.removesuffix(f" (byte {error.offset}).")
        raise RecordingCorrupt(what, offset=error.offset, where=str(path), remedy=error.remedy) from error
    except RecordingFileError as error:
        if error.where:
            raise
        named = error.remedy and not isinstance(error, UnreadableEvents)
        what = error.what if named else f"{NO_EVENTS}: {error.what}"
        remedy = f"{error.remedy or FORMS_OF_EVENTS}{order_assumed(path)}"
        raise NotARecording(what, where=str(path), remedy=remedy) from error
    except _UNREADABLE as error:
        what = f"{NO_EVENTS}: it is damaged, or has another layout than its first bytes say."
        raise NotARecording(what, where=str(path), remedy=_COPY_AGAIN) from error
    except MemoryError as error:
        what = "The file states more events than fit into memory."
        raise RecordingFileError(what, where=str(path), remedy=_COPY_AGAIN) from error
    except OSError as error:
        if error.errno is None:  # of HDF5
            what = f"{NO_EVENTS}: it is damaged or incomplete."
            raise NotARecording(what, where=str(path), remedy=_COPY_AGAIN) from error
        raise unreadable(path, error) from error


def _require_possible(events: Events, of: EventSource) -> None:
    x, y, p = int(events.x.max()), int(events.y.max()), int(events.p.max())
    if x >= of.width or y >= of.height:
        raise NotARecording(
            f"An event at column {x} or row {y} lies outside the sensor of {of.width} x {of.height} px.",
            remedy="Check the size of the sensor that the file, or your option, states: width x height; columns and"
            " rows count from 0.",
        )
    if p > 1:
        raise UnreadableEvents(f"an event has the polarity {p}; 0 and 1 are possible.")
    of.state.filled_px = max(of.state.filled_px[0], x + 1), max(of.state.filled_px[1], y + 1)


def _checked(pieces: Iterator[Piece], of: EventSource) -> Iterator[Piece]:
    """Check that events lie on the sensor and follow each other, that none is missing, and the number of edges."""
    read = edges = 0
    of.state.filled_px, of.state.times_us = (0, 0), None
    unit = UnitCheck(of)
    for events, triggers in pieces:
        if len(events.t):
            _require_possible(events, of)
            before: tuple[int, int] | None = of.state.times_us
            first, latest = before or (int(events.t[0]), int(events.t[0]))
            of.state.times_us = first, _latest(events.t, latest, read)
            unit.add(events.t)
        read += len(events.t)
        edges += len(triggers.t)
        if edges > MOST_TRIGGERS:
            raise too_many_edges()
        if of.count:
            of.state.share = read / of.count
        yield events, triggers
    unit.end()
    if of.count is not None and read != of.count:
        raise UnreadableEvents(f"{of.count - read} of its {of.count} events are missing.")


def _latest(t: NDArray[np.int64], latest: int, before: int) -> int:
    """Return the latest time, ``latest`` being that of ``before`` events; refuse one too far behind those before it."""
    if t[0] >= latest and (t[1:] >= t[:-1]).all():  # a third of the time of a difference
        return int(t[-1])
    so_far = np.maximum.accumulate(np.maximum(t, latest))
    is_behind = so_far - t > _MOST_BACK_STEP_US
    if not is_behind.any():
        return int(so_far[-1])
    at = int(np.argmax(is_behind))
    raise NotARecording(
        f"The times step back from {so_far[at]} to {t[at]} us, near event {before + at}: the events are not sorted, or"
        " the camera's clock began anew.",
        remedy="Sort them by time, or give each recording as a file of its own.",
    )
