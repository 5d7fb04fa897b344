"""Convert a file of events: RAW, Metavision's HDF5, plain HDF5, NumPy; each to each, and to Parquet and CSV.

Files of other programs are read too (`event_files`). A RAW file made here does not hold a camera's own bytes, and its
header says so; else it states what the source states, and nothing more. All files are read piece by piece; only for a
new NumPy file all events are in memory. What the new format cannot represent is lost: the sensor's counters outside
RAW, back-steps of its clock in Metavision's HDF5, edges in CSV.

Every reader decodes the EVT3 words of a new RAW file alike: a TIME_HIGH is followed by a TIME_LOW before anything else,
and steps by one through any gap, so that no turn of the 24-bit clock is lost. Times are absolute from the start of the
sensor's clock, as ``drivers.camera.evt3`` returns them. Each event is a word of its own; vectors would save a fifth.
``drivers.camera.evt3_kernel`` lists the words and their source.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import IntEnum
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.camera.event_arrays import (
    MAX_TIME_US,
    Events,
    EventSource,
    ReadingChoices,
    Triggers,
    empty_events,
    empty_triggers,
    join_triggers,
)
from drivers.camera.evt3 import Words
from drivers.camera.evt3_state import MAX_BACK_STEP_US
from drivers.camera.file_kinds import is_dat
from drivers.camera.formats.event_exports import (
    ExportSummary,
    Progress,
    export_csv,
    export_hdf5,
    export_metavision,
    export_numpy,
    export_parquet,
)
from drivers.camera.formats.event_files import open_events
from drivers.camera.raw_check import read_start
from drivers.camera.raw_file import RawFile, is_recording
from drivers.camera.raw_header import MAX_SIDE_PX, encoding_of, header_fields, render_fields
from drivers.camera.raw_writer import new_file
from drivers.errors import NotARecording, RecordingFileError

Kind = Literal["raw", "metavision", "hdf5", "numpy", "parquet", "csv"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)

ENDINGS: Final[Mapping[Kind, str]] = {
    "raw": ".raw",
    "metavision": ".hdf5",
    "hdf5": ".h5",
    "numpy": ".npz",
    "parquet": ".parquet",
    "csv": ".csv",
}
_EXPORTS: Final = {
    "metavision": export_metavision,
    "hdf5": export_hdf5,
    "numpy": export_numpy,
    "parquet": export_parquet,
    "csv": export_csv,
}

_OF_LAYOUT: Final = frozenset(
    {"evt", "format", "geometry", "endianness", "width", "height", "version", "converted_from", "end"}
)
"""Keys, in small letters, that describe how the source is laid out."""

_LEAST_SHARE: Final = 0.75
"""Events that fill less of both sides of a given size are of a smaller sensor or a region: 640 x 480 of 1280 x 720."""
_MAX_ADDRESS: Final = 2047  # EVT3 has 11 bits
_MAX_CHANNEL: Final = 15  # EVT3 has 4 bits


def kind_of_name(path: Path) -> Kind | None:
    """Return the kind of file that a name stands for, or None: Metavision writes ``.hdf5``, others ``.h5``.

    >>> [kind_of_name(Path(name)) for name in ("a.raw", "a.hdf5", "a.h5", "a.npz", "a.csv", "a.txt")]
    ['raw', 'metavision', 'hdf5', 'numpy', 'csv', None]
    """
    return next((kind for kind, ending in ENDINGS.items() if ending == path.suffix.lower()), None)


def convert(
    source: Path,
    target: Path,
    kind: Kind,
    choices: ReadingChoices | None = None,
    *,
    progress: Progress = lambda _: None,
) -> ExportSummary:
    """Write the events and triggers of a file as a new file of another kind; the source's contents decide its kind.

    The target must not exist, and appears complete or not at all. ``choices`` say what the source does not state
    itself. Raises `NotARecording` if the source holds no events, or both files would be RAW, `RecordingFileError` also
    if EVT3 cannot represent the contents.
    """
    with open_events(source, choices) as opened:
        if kind != "raw":
            written = _EXPORTS[kind](opened, target, progress)
        elif is_evt3(source):
            written = _with_size(opened, source, target)
        else:
            written = write_raw(opened, target, source=source, progress=progress)
        first_us, last_us = opened.state.times_us or (0, 0)
        assumed = {**opened.assumed, **_too_large(choices, opened.state.filled_px)}
        return replace(written, span_us=last_us - first_us, assumed=assumed)


def _too_large(choices: ReadingChoices | None, sides: tuple[int, int]) -> dict[str, str]:
    """Return what the events fill of the size that the user gave, if that seems too large."""
    width, height = (choices and choices.sensor_size) or (0, 0)
    is_filled = sides[0] >= _LEAST_SHARE * width or sides[1] >= _LEAST_SHARE * height
    return {} if is_filled or not any(sides) else {"sensor_size": f"{sides[0]} x {sides[1]}"}


def _with_size(opened: EventSource, source: Path, path: Path) -> ExportSummary:
    """Copy a recording that does not state the size of its sensor, with a header that states it; else refuse."""
    if is_recording(source):
        raise NotARecording(
            "The file is a RAW recording already.",
            where=str(source),
            remedy="Choose another kind of file.",
        )
    size = opened.width, opened.height
    recording = RawFile.open(source, size)
    events = triggers = 0
    for piece, edges in opened.pieces():
        events += len(piece.t)
        triggers += len(edges.t)
    with new_file(path) as part, part.open("xb") as file:
        file.write(render_fields({**recording.header, "geometry": "{}x{}".format(*size)}))
        for words in recording.words():
            file.write(words.tobytes())
    return ExportSummary(events, triggers, cut_off=opened.truncated, unknown_words=opened.state.unknown_words)


def write_raw(
    opened: EventSource, path: Path, *, source: Path, progress: Progress = lambda _: None
) -> ExportSummary:
    """Write events as a new RAW file of EVT3, whose header names the source; the path must not exist.

    Raises `RecordingFileError` also if EVT3 cannot represent the sensor's size, times or triggers.
    """
    if not all(0 < side <= MAX_SIDE_PX for side in (opened.width, opened.height)):
        raise RecordingFileError(
            f"EVT3 cannot represent a sensor of {opened.width} x {opened.height} px.",
            where=str(source),
            remedy="Convert it to HDF5 or .npz.",
        )
    encoder = Evt3Encoder()
    count = triggers = 0
    with new_file(path) as part, part.open("xb") as file:
        file.write(_header(opened, source))
        waiting, latest = empty_triggers(0), -1
        try:
            for piece, edges in opened.pieces():
                triggers += len(edges.t)
                if len(edges.t):
                    waiting = join_triggers([waiting, edges])
                if not len(piece.t):
                    continue
                count += len(piece.t)
                latest = max(latest, int(piece.t.max()))
                until = int(np.searchsorted(waiting.t, latest, "right"))
                file.write(encoder.words(piece, waiting.part(0, until)).tobytes())
                waiting = waiting.part(until, len(waiting.t))
                progress(opened.state.share)
            file.write(encoder.words(empty_events(0), waiting).tobytes())
        except ValueError as error:
            raise RecordingFileError(
                f"EVT3 cannot represent the file: {error}.",
                where=str(source),
                remedy="Convert it to HDF5 or .npz, or change its values: times from 0 to one day, trigger values 0 or"
                " 1, trigger ids 0 to 15.",
            ) from error
    return ExportSummary(count, triggers, encoder.moved_events, opened.truncated)


def is_evt3(path: Path) -> bool:
    """Return whether a file is a RAW recording with EVT3 words; False if it cannot be read: what reads it says why."""
    try:
        start = read_start(path)
        return (
            start.startswith(b"% ") and not is_dat(start) and encoding_of(header_fields(start)[0]) == "EVT3"
        )
    except (OSError, RecordingFileError):
        return False


def _header(opened: EventSource, source: Path) -> bytes:
    """Return the header of a new RAW file: the facts of its source, and its name."""
    facts = {key: value for key, value in opened.header.items() if key.lower() not in _OF_LAYOUT}
    layout = {
        "evt": "3.0",
        "format": f"EVT3;height={opened.height};width={opened.width}",
        "geometry": f"{opened.width}x{opened.height}",
    }
    return render_fields({**facts, **layout, "converted_from": f"{source.name}; not the bytes of a camera"})


class _S(IntEnum):
    """Index in the state array."""

    TURN = 0
    """Time divided by 4096 us at the last TIME_HIGH; -1 before the first."""
    LOW = 1
    """Last TIME_LOW; -1 if one must follow."""
    Y = 2
    MOVED = 3
    """Number of events and edges that got their predecessor's time."""


class Evt3Encoder:
    """Encoder of one stream, which is given in pieces whose times continue each other.

    >>> from drivers.camera.event_arrays import empty_triggers
    >>> event = Events(np.array([4098]), np.array([3], "u2"), np.array([5], "u2"), np.array([1], "u1"))
    >>> [hex(word) for word in Evt3Encoder().words(event, empty_triggers(0))]
    ['0x8000', '0x8001', '0x6002', '0x5', '0x2803']
    """

    def __init__(self) -> None:
        self._state = np.array([-1, -1, -1, 0], np.int64)

    @property
    def moved_events(self) -> int:
        """Number of events and edges that stepped back further than EVT3 allows, and got their predecessor's time."""
        return int(self._state[_S.MOVED])

    def words(self, events: Events, triggers: Triggers) -> Words:
        """Encode the next events and edges, merged by time, as (N,) uint16; edges stand before events of the same us.

        Values out of range raise `ValueError`: times 0 to one day, columns and rows below 2048 px, polarities and edge
        values 0 or 1, channels 0 to 15.
        """
        for t in (events.t, triggers.t):
            if len(t) and (t.min() < 0 or t.max() >= MAX_TIME_US):
                raise ValueError(f"times from {t.min()} to {t.max()} us do not lie within one day from 0 on")
        for what, values, largest in (
            *(("a column", events.x, _MAX_ADDRESS), ("a row", events.y, _MAX_ADDRESS)),
            *(("a polarity", events.p, 1), ("a trigger's value", triggers.value, 1)),
            ("a trigger's id", triggers.id, _MAX_CHANNEL),
        ):
            if len(values) and values.max() > largest:
                raise ValueError(f"{what} of {values.max()} is above {largest}")
        latest = max((int(t.max()) for t in (events.t, triggers.t) if len(t)), default=0)
        turns = max(0, (latest >> 12) - int(self._state[_S.TURN]))
        out = np.empty(turns + 3 * len(events.t) + 2 * len(triggers.t) + 2, np.uint16)
        n = _encode(events, triggers, self._state, out)
        return out[:n].astype("<u2", copy=False)


@njit(cache=True, nogil=True)
def _advance_clock(t: int, state: NDArray[np.int64], out: NDArray[np.uint16], n: int) -> int:
    """Bring the stream's clock to a time; return the number of words so far."""
    turn, low = t >> 12, t & 0xFFF
    now = state[_S.TURN] << 12 | max(state[_S.LOW], 0)
    if turn < state[_S.TURN] or t < now - MAX_BACK_STEP_US:
        state[_S.MOVED] += 1
        return n
    while state[_S.TURN] < turn:
        state[_S.TURN] += 1
        state[_S.LOW] = -1
        out[n] = 0x8000 | (state[_S.TURN] & 0xFFF)
        n += 1
    if low != state[_S.LOW]:
        state[_S.LOW] = low
        out[n] = 0x6000 | low
        n += 1
    return n


@njit(cache=True, nogil=True)
def _encode(events: Events, edges: Triggers, state: NDArray[np.int64], out: NDArray[np.uint16]) -> Any:
    t, x, y, p = events
    edge_t, value, channel = edges
    n = e = 0
    for i in range(len(t) + 1):  # the last edges come behind the last event
        while e < len(edge_t) and (i == len(t) or edge_t[e] <= t[i]):
            n = _advance_clock(edge_t[e], state, out, n)
            out[n] = 0xA000 | (channel[e] & 0xF) << 8 | (value[e] & 1)
            n, e = n + 1, e + 1
        if i == len(t):
            break
        n = _advance_clock(t[i], state, out, n)
        if y[i] != state[_S.Y]:
            state[_S.Y] = y[i]
            out[n] = y[i]
            n += 1
        out[n] = 0x2000 | np.uint16(p[i]) << 11 | x[i]
        n += 1
    return n
