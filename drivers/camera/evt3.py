"""Decode a stream of EVT3 words to events and triggers.

Times are microseconds of the sensor's own clock. They are unwrapped over its 24 bits from the first TIME_HIGH on;
no offset is subtracted. Words that contradict the sensor's size or its clock raise ``RecordingCorrupt`` with their
byte offset. This module opens no files and no devices. ``evt3_kernel`` lists the types of words and their source.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events, Triggers, copy_events, empty_events, join_triggers
from drivers.camera.evt3_kernel import max_event_count, run
from drivers.camera.evt3_place import Place, place_of, set_place
from drivers.camera.evt3_state import S, StopReason, new_state
from drivers.camera.evt3_statistics import StreamStatistics as StreamStatistics  # noqa: PLC0414 - exported
from drivers.camera.evt3_usual import Mode
from drivers.camera.evt3_vectors import MARGIN, add_events
from drivers.camera.word_vectors import BLOCK_WORDS
from drivers.errors import RecordingCorrupt

Words = NDArray[np.uint16]
"""EVT3 words, (N,) uint16."""

GAPS_KEPT: Final = 64
"""Number of gaps whose times are kept; further gaps are only counted."""

_TRIGGERS_AT_ONCE: Final = 4096
_WORDS_AT_ONCE: Final = 1 << 20
"""Largest number of words whose events are counted to give arrays their size."""


class Evt3Decoder:
    """Decoder of one stream, which is given in pieces of whole words.

    width, height: Size of the sensor, px; events outside it raise ``RecordingCorrupt``.
    first_byte: Offset of the first word in the file, bytes; for messages.

    Examples
    --------
    >>> words = np.array([0x8001, 0x6002, 0x0005, 0x2803], np.uint16)
    >>> [(events, _)] = Evt3Decoder(1280, 720).decode(words)
    >>> [int(field[0]) for field in events]
    [4098, 3, 5, 1]
    """

    def __init__(self, width: int, height: int, *, first_byte: int = 0, where: str = "") -> None:
        self._state = new_state(width, height)
        self._gaps = np.zeros((GAPS_KEPT, 2), np.int64)
        self._next_byte = first_byte
        self._where = where
        self._no_events = empty_events(0)
        self._no_image = np.zeros((2, 0, 0), np.uint16)
        self._edges = np.empty((_TRIGGERS_AT_ONCE, 3), np.int64)
        self._scratch = np.empty(BLOCK_WORDS, np.uint16), np.empty(BLOCK_WORDS, np.uint16)

    def decode(self, words: Words, *, max_events: int = 1_000_000) -> Iterator[tuple[Events, Triggers]]:
        """Decode words to events and triggers, in pieces.

        words: (N,) uint16, the next words of the stream.
        max_events: Largest number of events in a piece; 32 if it is smaller.
        Raises RecordingCorrupt: At a malformed word, after the pieces before it.
        """
        start, words = 0, _in_a_row(words)
        while start < len(words):
            rest = len(words) - start
            most = 12 * rest if rest > _WORDS_AT_ONCE else max_event_count(words[start:])
            out = empty_events(min(max(max_events, MARGIN), most + MARGIN))
            stop = self._store(words, start, out)
            yield out.part(0, int(self._state[S.TAKEN])), self._copied_triggers()
            start = self._advance(words, start, stop)

    def decode_into(self, words: Words, events: Events, at: int) -> tuple[int, Triggers]:
        """Decode words into arrays that the caller provides.

        words: (N,) uint16, the next words of the stream.
        events: Arrays to fill. Up to 32 places after the last event may be touched, but none outside the
          arrays.
        at: Index of the first event to write.
        Returns: Index after the last event written, and the triggers.
        Raises ValueError: If the arrays have no room for more events.
        """
        found = []
        start, words = 0, _in_a_row(words)
        while start < len(words):
            room = len(events.t) - at
            few = room < 2 * MARGIN
            out = empty_events(2 * MARGIN) if few else events.part(at, len(events.t))
            stop = self._store(words, start, out)
            found.append(self._copied_triggers())
            taken = int(self._state[S.TAKEN])
            if taken > room:
                raise ValueError(f"arrays for {len(events.t)} events have no room for more events")
            if few:
                copy_events(out.part(0, taken), events.part(at, at + taken))
            at += taken
            start = self._advance(words, start, stop)
        return at, join_triggers(found)

    def count(self, words: Words, image: NDArray[np.uint16]) -> Triggers:
        """Add the events of words to an image of counts, without a list of events.

        words: (N,) uint16, the next words of the stream.
        image: (2, height, width) uint16, OFF counts, then ON counts; counts wrap above 65535.
        Raises ValueError: If the image does not have the sensor's size.
        """
        if image.shape != (2, self._state[S.HEIGHT], self._state[S.WIDTH]):
            raise ValueError(
                f"a count image of shape {image.shape} does not fit the sensor of "
                f"{self._state[S.WIDTH]} x {self._state[S.HEIGHT]} px"
            )
        return self._count_or_tally(words, Mode.COUNT, image)

    def tally(self, words: Words) -> Triggers:
        """Count the events of words for ``statistics``, without storing them.

        words: (N,) uint16, the next words of the stream.
        """
        return self._count_or_tally(words, Mode.TALLY, self._no_image)

    def _count_or_tally(self, words: Words, mode: Mode, image: NDArray[np.uint16]) -> Triggers:
        found = []
        start, words = 0, _in_a_row(words)
        while start < len(words):
            stop = self._run(words, start, mode, self._no_events, image)
            found.append(self._copied_triggers())
            start = self._advance(words, start, stop)
        return join_triggers(found)

    def _store(self, words: Words, start: int, out: Events) -> int:
        """Decode words into ``out`` until they end or it is full; return the index of the next word."""
        return self._run(words, start, Mode.STORE, out, self._no_image)

    def _run(self, words: Words, start: int, mode: Mode, out: Events, image: NDArray[np.uint16]) -> int:
        """Take words, see ``evt3_kernel.run``; return the index of the next word."""
        state, gaps, edges, scratch = self._state, self._gaps, self._edges, self._scratch
        # Numbers and plain tuples: other types cost Numba 17 us a call.
        return int(run(words, start, int(mode), state, gaps, tuple(out), image, edges, scratch))

    def _copied_triggers(self) -> Triggers:
        """Return a copy of the trigger edges of the last run."""
        t, value, channel = self._edges[: self._state[S.TAKEN_EDGES]].T
        return Triggers(t.copy(), value.astype(np.uint8), channel.astype(np.uint8))

    def _advance(self, words: Words, start: int, stop: int) -> int:
        """Move the byte offset over the words taken; return the index of the next word, or raise RecordingCorrupt."""
        self._next_byte += 2 * (stop - start)
        reason = StopReason(self._state[S.STOP_REASON])
        if reason not in (StopReason.NONE, StopReason.ROOM):
            raise RecordingCorrupt(
                self._explain(reason, int(words[stop])),
                offset=self._next_byte,
                where=self._where,
                remedy="Record it again. The part before that byte can be read.",
            )
        return stop

    def _explain(self, reason: StopReason, word: int) -> str:
        """Describe what is wrong with a word."""
        state = {place: int(self._state[place]) for place in S}
        sensor = f"the sensor of {state[S.WIDTH]} x {state[S.HEIGHT]} px"
        if reason == StopReason.ROW:
            return f"Row {word & 0x7FF} lies outside {sensor}."
        if reason == StopReason.COLUMN:
            return f"An event in column {word & 0x7FF} lies outside {sensor}."
        if reason == StopReason.VECTOR:
            return f"A vector that begins at column {state[S.BASE]} holds events beyond the last column of {sensor}."
        if reason == StopReason.CLOCK:
            part = "upper" if word >> 12 == 0x8 else "lower"
            return (
                f"The sensor's clock steps back from {state[S.T]} us: its {part} part reads {word & 0xFFF}."
            )
        return f"The type of word 0x{word:04X} does not exist in EVT3."

    @property
    def place(self) -> Place:
        """Clock, row and vector base after the last word."""
        return place_of(self._state)

    def at(self, place: Place, first_byte: int) -> Evt3Decoder:
        """Return a decoder of the same stream that continues elsewhere. Its statistics begin anew.

        place: Clock, row and vector base before its first word.
        first_byte: Offset of that word in the file, bytes.
        """
        size = int(self._state[S.WIDTH]), int(self._state[S.HEIGHT])
        decoder = Evt3Decoder(*size, first_byte=first_byte, where=self._where)
        set_place(decoder._state, place)
        return decoder

    @property
    def next_byte(self) -> int:
        """Offset of the next word in the file, bytes."""
        return self._next_byte

    @property
    def clock_us(self) -> int:
        """The sensor's clock at the last time word, us; -1 before the first."""
        return int(self._state[S.T])

    @property
    def covered_us(self) -> int:
        """Time on the sensor's clock since the first time word, us."""
        first = int(self._state[S.FIRST_T])
        return self.clock_us - first if first >= 0 else 0

    def statistics(self) -> StreamStatistics:
        """Sum up the stream as decoded so far.

        Returns: Counts, times and losses.
        """
        state = {place: int(self._state[place]) for place in S}
        reported = state[S.EVENTS_AT_REPORT] >= 0
        kept = self._gaps[: min(state[S.GAPS], GAPS_KEPT)]
        return StreamStatistics(
            events=state[S.EVENTS],
            on_events=state[S.ON_EVENTS],
            triggers=state[S.TRIGGERS],
            first_t_us=state[S.FIRST_T],
            last_t_us=state[S.T],
            rate_controller_in=state[S.RATE_IN] if reported else None,
            rate_controller_out=state[S.RATE_OUT] if reported else None,
            lost_events=state[S.LOST],
            mismatched_windows=state[S.MISMATCHED_WINDOWS],
            missing_windows=state[S.MISSING_WINDOWS],
            gaps=tuple((int(a), int(b)) for a, b in kept),
            gap_count=state[S.GAPS],
            unplaced_events=state[S.UNPLACED],
            back_steps=state[S.BACK_STEPS],
        )


def _in_a_row(words: Words) -> Words:
    """Return words as one piece of memory, in which the compiled code reads many at a time."""
    return np.ascontiguousarray(words, np.uint16)


def count_events(events: Events, image: NDArray[np.uint16]) -> None:
    """Add events to an image of counts, as ``Evt3Decoder.count`` does with words.

    image: (2, height, width) uint16, OFF counts, then ON counts; counts wrap above 65535.
    Raises ValueError: If an event lies outside the image; the image is then unchanged.

    Examples
    --------
    >>> image = np.zeros((2, 4, 4), np.uint16)
    >>> count_events(Events(np.array([7]), *np.array([[3], [2], [1]], np.uint16)), image)
    >>> int(image[1, 2, 3]), int(image.sum())
    (1, 1)
    """
    if len(events.t) and not add_events(events.x, events.y, events.p, image):
        raise ValueError(f"an event lies outside the image of shape {image.shape}")


def first_time_high(words: Words) -> int | None:
    """Find the first TIME_HIGH word: there a stream that is joined in its middle can begin.

    words: (N,) uint16, EVT3 words.
    Returns: Index of the word; None if there is none.

    Examples
    --------
    >>> first_time_high(np.array([0x0005, 0x2803, 0x8001], np.uint16))
    2
    """
    found = np.flatnonzero(words >> 12 == 0x8)
    return int(found[0]) if len(found) else None
