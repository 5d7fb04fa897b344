"""Decode Prophesee's older words: EVT2 and EVT2.1, and the CD events of DAT files.

EVT2 has words of 32 bits: type [31:28]; for events (0 OFF, 1 ON) the low 6 bits of the time [27:22], x [21:11] and
y [10:0]; 8 carries the time's bits 33 to 6; 10 is a trigger edge with time [27:22], channel [12:8] and level [0].
EVT2.1 has such a word and a second one: a bit for each of 32 columns from x on. DAT has 8 bytes an event: time in us as
uint32, then in version 2 x [13:0], y [27:14] and polarity [31:28]; in version 1 x [8:0], y [16:9] and polarity [17].

Sources: Prophesee, "EVT 2.0 Format", https://docs.prophesee.ai/stable/data/encoding_formats/evt2.html; "EVT 2.1
Format", .../evt21.html; "DAT File Format", https://docs.prophesee.ai/stable/data/file_formats/dat.html. Order of the
halves of EVT2.1: OpenEB (evt21_event_types.h). Version 1 of DAT: expelliarmus.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from numba import njit

from drivers.camera.event_arrays import (
    Clock32,
    Events,
    EventSource,
    Piece,
    ReadingChoices,
    ReadingState,
    empty_events,
    empty_triggers,
)
from drivers.camera.raw_check import WORD_BYTES, ends_within_word
from drivers.camera.raw_header import RawHeader, header_fields, stated_size
from drivers.errors import NotARecording

_PIECE_BYTES: Final = 1 << 19  # Stays in the processor's cache
_TRIGGER_TYPES: Final = (0x0E,)  # Event types of DAT files: external triggers
_CD_TYPES: Final = (0x00, 0x0C)  # 2D and CD events, which have the same layout
_DAT_EVENT_BYTES: Final = 8  # Time and place, four bytes each
_MOST_DAT_PX: Final = 1 << 14  # 14 bits of a coordinate
_DAT_LAYOUTS: Final = {"1": (9, 8, 1), "2": (14, 14, 4)}
"""Number of bits of x, y and polarity, by the version of a DAT file."""


class _S(IntEnum):
    """Index in the state of a decoder of EVT2."""

    HIGH = 0
    """Last TIME_HIGH; -1 before the first."""
    LOOPS = 1
    """Number of times that TIME_HIGH has begun again at 0."""
    EVENTS = 2
    """Number of events written in this call."""
    EDGES = 3


class Evt2Decoder:
    """Decoder of one stream of EVT2 or EVT2.1, which is given in pieces of whole words.

    What stands before the first time is dropped: a stream may be joined in its middle. Words of other types hold no
    events.

    >>> [events, edges] = Evt2Decoder("EVT21").decode(np.array([0, 0x8000_0001, 0b101, 0x1000_1805], "<u4").tobytes())
    >>> [field.tolist() for field in events]
    [[64, 64], [3, 5], [5, 5], [1, 1]]
    """

    def __init__(self, encoding: str) -> None:
        self._state = np.array([-1, 0, 0, 0], np.int64)
        # Place of the word with the type in a unit of one or two words, and most events of a unit.
        self._place = {"EVT2": 0, "EVT21": 1, "EVT21-legacy": 0}[encoding]
        self._word_bytes, self._most = WORD_BYTES[encoding], 1 if encoding == "EVT2" else 32

    def decode(self, data: bytes) -> Piece:
        """Decode words; an incomplete one at the end is left out."""
        units = np.frombuffer(data, "<u4", count=len(data) // self._word_bytes * (self._word_bytes // 4))
        units = units.reshape(-1, self._word_bytes // 4)
        heads = np.ascontiguousarray(units[:, self._place])
        columns = np.ascontiguousarray(units[:, 1 - self._place]) if self._most > 1 else np.ones_like(heads)
        events, edges = empty_events(self._most * len(heads)), empty_triggers(len(heads))
        _take(heads, columns, self._state, tuple(events), tuple(edges))
        n, e = int(self._state[_S.EVENTS]), int(self._state[_S.EDGES])
        return events.part(0, n), edges.part(0, e)


@njit(cache=True, nogil=True)
def _take(heads: Any, columns: Any, state: Any, events: Any, edges: Any) -> None:
    """Write the events and edges of (N,) uint32 words: their heads, and a bit for each column from theirs on."""
    t_out, x_out, y_out, p_out = events
    edge_t, value, channel = edges
    n = e = 0
    high, loops = state[_S.HIGH], state[_S.LOOPS]
    for k in range(len(heads)):
        head: Any = np.int64(heads[k])
        kind = head >> 28
        if kind == 8:
            new = head & 0x0FFFFFFF
            loops += high - new > 1 << 27
            high = new
        elif high < 0:
            continue
        t = (loops << 28 | high) << 6 | (head >> 22 & 0x3F)
        if kind <= 1:
            bits: Any = np.int64(columns[k])
            x = head >> 11 & 0x7FF
            while bits:
                if bits & 1:
                    t_out[n], x_out[n], y_out[n], p_out[n] = t, x, head & 0x7FF, kind
                    n += 1
                bits >>= 1
                x += 1
        elif kind == 10:
            edge_t[e], value[e], channel[e] = t, head & 1, head >> 8 & 0x1F
            e += 1
    state[_S.HIGH], state[_S.LOOPS], state[_S.EVENTS], state[_S.EDGES] = high, loops, n, e


def from_evt2(path: Path, header: RawHeader) -> EventSource:
    """Open a RAW file of EVT2 or EVT2.1 words."""
    state = ReadingState()

    def pieces() -> Iterator[Piece]:
        decoder = Evt2Decoder(header.encoding)
        for data in _blocks(path, header.size_bytes, state):
            yield decoder.decode(data)

    return EventSource(
        header.width, header.height, header.fields, pieces, ends_within_word(path), state=state
    )


def from_dat(path: Path, start: bytes, choices: ReadingChoices) -> EventSource:
    """Open a DAT file of CD events, without trigger edges: DAT files of events hold none.

    Raises `NotARecording` if it holds other events, or its size is not stated or impossible.
    """
    fields, begin = header_fields(start)
    if begin is None:
        raise NotARecording("The header does not end.", remedy="Copy the file again.")
    with path.open("rb") as file:
        file.seek(begin)
        kind = file.read(2)
    if len(kind) == 2 and kind[0] in _TRIGGER_TYPES:
        raise NotARecording(
            "This DAT file holds trigger edges only, no events of pixels.",
            remedy="Give the DAT file of the events, whose name usually ends in _td.dat or _cd.dat.",
        )
    if len(kind) < 2 or kind[0] not in _CD_TYPES or kind[1] != _DAT_EVENT_BYTES:
        held = f"events of type {kind[0]} with {kind[1]} bytes" if len(kind) == 2 else "no events"
        raise NotARecording(
            f"This DAT file holds {held}; Starbench reads CD events with 8 bytes.",
            remedy="Give the DAT file of the events.",
        )
    version = next((value for key, value in fields.items() if key.lower() == "version"), "1")
    if version not in _DAT_LAYOUTS:
        raise NotARecording(
            f"This DAT file has version {version}; Starbench reads {' and '.join(_DAT_LAYOUTS)}.",
            remedy="Convert it with the program that wrote it.",
        )
    size = stated_size(fields, "", choices.sensor_size, most_px=_MOST_DAT_PX)
    truncated = (path.stat().st_size - begin - 2) % _DAT_EVENT_BYTES != 0
    state = ReadingState()

    def pieces() -> Iterator[Piece]:
        return _dat_pieces(_blocks(path, begin + 2, state), _DAT_LAYOUTS[version])

    return EventSource(*size, fields, pieces, truncated, state=state)


def _blocks(path: Path, begin: int, state: ReadingState) -> Iterator[bytes]:
    total_bytes = path.stat().st_size
    with path.open("rb") as file:
        file.seek(begin)
        while data := file.read(_PIECE_BYTES):
            yield data
            state.share = file.tell() / total_bytes


def _dat_pieces(blocks: Iterator[bytes], layout: tuple[int, int, int]) -> Iterator[Piece]:
    clock = Clock32()
    x_bits, y_bits, p_bits = layout
    for block in blocks:
        numbers = np.frombuffer(block, "<u4", count=len(block) // _DAT_EVENT_BYTES * 2)
        t, data = clock.continued(numbers[0::2]), numbers[1::2]
        x, y, p = (
            (data >> shift & (1 << bits) - 1)
            for shift, bits in ((0, x_bits), (x_bits, y_bits), (x_bits + y_bits, p_bits))
        )
        yield Events(t, x.astype(np.uint16), y.astype(np.uint16), p.astype(np.uint8)), empty_triggers(0)
