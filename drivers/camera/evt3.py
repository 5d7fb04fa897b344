"""Decode a stream of EVT3 words to events and triggers.

Times are microseconds of the sensor's own clock. They are unwrapped over its 24 bits from the first TIME_HIGH on;
no offset is subtracted. Words that contradict the sensor's size or its clock raise ``RecordingCorrupt`` with their
byte offset. This module opens no files and no devices. ``evt3_kernel`` lists the types of words and their source.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events, Triggers, empty_events, join_triggers
from drivers.camera.evt3_kernel import MARGIN, add_events, run
from drivers.camera.evt3_state import S, StopReason, new_state
from drivers.errors import RecordingCorrupt

Words = NDArray[np.uint16]
"""EVT3 words, (N,) uint16."""

PIECE_EVENTS: Final = (1 << 16) + MARGIN - 1
"""Most events of a piece; they stay in the processor's caches. Without vectors there are 1 << 16: a chunk of HDF5."""
GAPS_KEPT: Final = 64
"""Number of gaps whose times are kept; further gaps are only counted."""

_MOST_BLOCKS: Final = 4
"""Most blocks of words in a piece, so that a long file without events shows how far it has been read."""
_TRIGGERS_AT_ONCE: Final = 4096  # A full second of the fastest flicker that is used
_COUNTED_AT_ONCE: Final = 1 << 14
"""Number of events that are decoded at once where they are only counted: these stay in the processor's caches."""


_AGAIN: Final = "copy the file again, or record it again. The part before that byte can be read."
_CHECK_SIZE: Final = f"Check the size of the sensor that the file states; if it is right, {_AGAIN}"
_REMEDIES: Final = {
    StopReason.CLOCK: f"C{_AGAIN[1:]}",
    StopReason.RESERVED: f"C{_AGAIN[1:]} `starbench convert` leaves such words out.",
}


@dataclass(frozen=True)
class StreamStatistics:
    """Counts, times and losses of a stream up to its last word."""

    events: int
    on_events: int
    triggers: int
    first_t_us: int  # The sensor's clock at its first time word, us; -1 before any
    last_t_us: int  # The sensor's clock at its last time word, us; -1 before any
    # Events into the rate controller, over its windows of 200 us; None without reports.
    rate_controller_in: int | None
    rate_controller_out: int | None  # Events out of it, over the same windows; None without reports
    # Number of events that the sensor counted in its windows and that did not arrive; 0 without reports.
    lost_events: int
    # Number of windows in which the sensor's count differs from the number of events that arrived; 0 without
    # reports.
    mismatched_windows: int
    # Number of windows whose report did not arrive. It is not known how many events the sensor sent in them,
    # so ``lost_events`` is then a lower bound.
    missing_windows: int
    # The clock before and after each step of TIME_HIGH by more than one, us: words are missing there. The
    # first 64.
    gaps: tuple[tuple[int, int], ...]
    gap_count: int
    # Number of words left out because EVT3 does not define their type; padding is not counted.
    unknown_words: int

    @property
    def duration_s(self) -> float:
        """Time on the sensor's clock from the first time word to the last, s; 0 without time words."""
        return (self.last_t_us - self.first_t_us) * 1e-6 if self.first_t_us >= 0 else 0.0

    def loss_messages(self) -> tuple[str, ...]:
        """Describe each gap, and the losses that the sensor's own counts show; no sentence if nothing was lost."""
        messages = [f"Words are missing from {a} to {b} us of the sensor's clock." for a, b in self.gaps]
        if self.gap_count > len(self.gaps):
            messages.append(f"{self.gap_count - len(self.gaps)} more gaps follow.")
        if self.missing_windows:
            messages.append(
                f"{self.missing_windows} event count reports of the sensor are missing (it sends one every 200 us): "
                f"at least {self.lost_events} events are lost, and all events sent in these "
                f"{self.missing_windows * 0.2:.1f} ms."
            )
        elif self.mismatched_windows:
            messages.append(
                f"In {self.mismatched_windows} windows of 200 us the number of events that arrived differs from the "
                f"sensor's count: {self.lost_events} events are missing."
            )
        return tuple(messages)


class Evt3Decoder:
    """Decoder of one stream, which is given in pieces of whole words.

    Events outside ``width`` and ``height``, px, raise `RecordingCorrupt`; ``first_byte`` is the offset of the first
    word in the file, for messages. Words whose type EVT3 does not define raise too, or are counted and left out
    (``skip_unknown``): in a new recording they are a fault of the transfer, in a file of others often a maker's own.

    >>> words = np.array([0x8001, 0x6002, 0x0005, 0x2803], np.uint16)
    >>> [(events, _)] = Evt3Decoder(1280, 720).decode([words])
    >>> [int(field[0]) for field in events]
    [4098, 3, 5, 1]
    """

    def __init__(
        self,
        width: int,
        height: int,
        *,
        first_byte: int = 0,
        where: str = "",
        skip_unknown: bool = False,
    ) -> None:
        self._state = new_state(width, height)
        self._state[S.UNKNOWN] = 0 if skip_unknown else -1
        self._gaps = np.zeros((GAPS_KEPT, 2), np.int64)
        self._next_byte = first_byte
        self._where = where
        self._edges = np.empty((_TRIGGERS_AT_ONCE, 3), np.int64)
        self._passing = empty_events(0)

    def decode(
        self, blocks: Iterable[Words], *, max_events: int = PIECE_EVENTS
    ) -> Iterator[tuple[Events, Triggers]]:
        """Decode blocks of words, (N,) uint16, in pieces of at most ``max_events`` events, of which 32 is the least.

        At a malformed word, it first yields what came before, then raises `RecordingCorrupt`. If a block cannot be
        read, the piece that was begun is not yielded.
        """
        size = max(max_events, MARGIN)
        out, n, edges, blocks_read = empty_events(size), 0, list[Triggers](), 0
        for words in blocks:
            start, blocks_read = 0, blocks_read + 1
            while start < len(words):
                stop = self._run(words, start, out.part(n, size))
                n += int(self._state[S.TAKEN])
                if self._state[S.TAKEN_EDGES]:
                    edges.append(self._copied_triggers())
                if stop < len(words) or n > size - MARGIN or blocks_read >= _MOST_BLOCKS:
                    yield out.part(0, n), join_triggers(edges)
                    out, n, edges, blocks_read = empty_events(size), 0, [], 0
                start = self._advance(words, start, stop)
        if n or edges or blocks_read:
            yield out.part(0, n), join_triggers(edges)

    def decode_into(self, words: Words, events: Events, at: int) -> tuple[int, Triggers]:
        """Decode words, (N,) uint16, into the caller's arrays from index ``at``; return the index after the last event.

        32 places after the last event may be touched; without room for them, `ValueError` is raised.
        """
        triggers = []
        start = 0
        while start < len(words):
            if len(events.t) - at < MARGIN:
                raise ValueError(f"arrays for {len(events.t)} events have no room for more events")
            stop = self._run(words, start, events.part(at, len(events.t)))
            triggers.append(self._copied_triggers())
            at += int(self._state[S.TAKEN])
            start = self._advance(words, start, stop)
        return at, join_triggers(triggers)

    def count(self, words: Words, image: NDArray[np.uint16]) -> Triggers:
        """Add the events of words to an image of counts, without a list of events.

        The words are (N,) uint16; the image is (2, height, width) uint16, OFF counts, then ON counts, which wrap above
        65535.
        """
        if image.shape != (2, self._state[S.HEIGHT], self._state[S.WIDTH]):
            raise ValueError(
                f"a count image of shape {image.shape} does not fit the sensor of "
                f"{self._state[S.WIDTH]} x {self._state[S.HEIGHT]} px"
            )
        return self._pass(words, image)

    def tally(self, words: Words) -> Triggers:
        """Count the events of words, (N,) uint16, for ``statistics``, and drop them."""
        return self._pass(words, None)

    def _pass(self, words: Words, image: NDArray[np.uint16] | None) -> Triggers:
        """Decode words to events that are not kept, but added to an image if there is one."""
        if not len(self._passing.t):
            self._passing = empty_events(_COUNTED_AT_ONCE)
        triggers = []
        start = 0
        while start < len(words):
            stop = self._run(words, start, self._passing)
            if image is not None:
                add_events(tuple(self._passing), int(self._state[S.TAKEN]), image)
            triggers.append(self._copied_triggers())
            start = self._advance(words, start, stop)
        return join_triggers(triggers)

    def _run(self, words: Words, start: int, out: Events) -> int:
        """Take words, see ``evt3_kernel.run``; return the index of the next word."""
        # Numbers and plain tuples: other types cost Numba 17 us a call.
        return int(run(words, start, self._state, self._gaps, tuple(out), self._edges))

    def _copied_triggers(self) -> Triggers:
        """Return a copy of the trigger edges of the last run."""
        t, value, channel = self._edges[: self._state[S.TAKEN_EDGES]].T
        return Triggers(t.copy(), value.astype(np.uint8), channel.astype(np.uint8))

    def _advance(self, words: Words, start: int, stop: int) -> int:
        """Move the byte offset over the words taken; return the index of the next word, or raise RecordingCorrupt."""
        self._next_byte += 2 * (stop - start)
        if stop < len(words) and (reason := StopReason(self._state[S.STOP_REASON])) != StopReason.ROOM:
            raise RecordingCorrupt(
                self._explain(reason, int(words[stop])),
                offset=self._next_byte,
                where=self._where,
                remedy=_REMEDIES.get(reason, _CHECK_SIZE),
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
        if reason == StopReason.RESERVED:
            return f"The type of word 0x{word:04X} does not exist in EVT3."
        part = "upper" if word >> 12 == 0x8 else "lower"
        return f"The sensor's clock steps back from {state[S.T]} us: its {part} part reads {word & 0xFFF}."

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
        """Sum up the stream as decoded so far."""
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
            unknown_words=max(state[S.UNKNOWN], 0),
        )


def first_time_high(words: Words) -> int | None:
    """Find the first TIME_HIGH word of (N,) uint16: there a stream that is joined in its middle can begin.

    >>> first_time_high(np.array([0x0005, 0x2803, 0x8001], np.uint16))
    2
    """
    at = np.flatnonzero(words >> 12 == 0x8)
    return int(at[0]) if len(at) else None
