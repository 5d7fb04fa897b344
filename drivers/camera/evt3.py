"""A stream of EVT3 words to events and triggers: knows what it has told so far, no files and no devices.

Times are the sensor's own clock in microseconds, unwrapped over its 24 bits from the first TIME_HIGH on;
nothing is shifted. Words that contradict the sensor's size or clock end in ``RecordingCorrupt`` with their
byte offset.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.camera.evt3_kernel import run
from drivers.camera.evt3_plain import PACKED, Mode, add_events
from drivers.camera.evt3_state import Fault, S, new_state
from drivers.camera.evt3_vectors import MARGIN
from drivers.errors import RecordingCorrupt

Words = NDArray[np.uint16]

GAPS_KEPT: Final = 64
"""Gaps beyond this number are counted, their places forgotten."""

_TRIGGERS_AT_ONCE: Final = 4096


class Events(NamedTuple):
    """Contrast change events in the order sent, one array a field.

    ``t`` (N,) int64, us, the sensor's clock (busy sensors let it step back by some us now and then); ``x`` and
    ``y`` (N,) uint16, px; ``p`` (N,) uint8, 1 = ON.
    """

    t: NDArray[np.int64]
    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    p: NDArray[np.uint8]

    def part(self, begin: int, end: int) -> Events:
        """Return views of the events from ``begin`` to before ``end``."""
        place = slice(begin, end)
        return Events(self.t[place], self.x[place], self.y[place], self.p[place])


class Triggers(NamedTuple):
    """Trigger edges: ``t`` (N,) int64, us; ``value`` (N,) uint8, 1 = rising; ``id`` (N,) uint8, channel."""

    t: NDArray[np.int64]
    value: NDArray[np.uint8]
    id: NDArray[np.uint8]


def empty_events(n: int) -> Events:
    """Uninitialised arrays for n events."""
    return Events(
        np.empty(n, np.int64), np.empty(n, np.uint16), np.empty(n, np.uint16), np.empty(n, np.uint8)
    )


def empty_triggers(n: int) -> Triggers:
    """Uninitialised arrays for n trigger edges."""
    return Triggers(np.empty(n, np.int64), np.empty(n, np.uint8), np.empty(n, np.uint8))


@dataclass(frozen=True)
class StreamStatistics:
    """What a stream has told up to its last word.

    Attributes
    ----------
    events, on_events, triggers
        How many; triggers counts both edges.
    first_t_us, last_t_us
        The sensor's clock at its first and its last time word; both -1 before any.
    rate_controller_in, rate_controller_out
        Events into and out of the rate controller, summed over its windows; None when it has not reported.
    lost_events, odd_windows
        The sensor reports how many events it sent in each 200 us: those that did not arrive, and the windows in
        which the numbers differ. Zero when it does not report.
    missing_windows
        Windows whose report did not arrive either: nobody knows how many events were sent in them, and
        ``lost_events`` is the least that it can be.
    gaps
        The clock before and after each step of TIME_HIGH by more than one, us: words are missing there.
    gap_count
        How many gaps, also beyond the first 64 kept.
    unplaced_events
        Events before the first time, row or vector base: the stream was joined in its middle.
    back_steps
        How often TIME_LOW stepped back by some us, as busy sensors do.
    """

    events: int
    on_events: int
    triggers: int
    first_t_us: int
    last_t_us: int
    rate_controller_in: int | None
    rate_controller_out: int | None
    lost_events: int
    odd_windows: int
    missing_windows: int
    gaps: tuple[tuple[int, int], ...]
    gap_count: int
    unplaced_events: int
    back_steps: int

    @property
    def duration_s(self) -> float:
        """Span of the sensor's clock from the first time word to the last; 0 without any."""
        return (self.last_t_us - self.first_t_us) * 1e-6 if self.first_t_us >= 0 else 0.0

    def losses_in_words(self) -> tuple[str, ...]:
        """Say each gap in a sentence, and what the sensor's own counts tell of lost events."""
        said = [f"Words are missing from {a} to {b} us of the sensor's clock." for a, b in self.gaps]
        if self.gap_count > len(self.gaps):
            said.append(f"{self.gap_count - len(self.gaps)} more gaps follow.")
        if self.missing_windows:
            said.append(
                f"{self.missing_windows} of the sensor's reports are missing, one every 200 us: at least "
                f"{self.lost_events} events are lost, and all that were sent in these "
                f"{self.missing_windows * 0.2:.1f} ms."
            )
        elif self.odd_windows:
            said.append(
                f"In {self.odd_windows} of the sensor's windows of 200 us other events arrived than it counted: "
                f"{self.lost_events} are missing."
            )
        return tuple(said)


class Evt3Decoder:
    """Decodes one stream, given in pieces of whole words.

    Parameters
    ----------
    width, height
        Size of the sensor, px; events outside it are refused.
    first_byte
        Offset in the file of the first word, for messages.
    where
        The file or device, for messages.

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
        self._packed = np.empty(PACKED, np.uint32)

    def decode(self, words: Words, *, max_events: int = 1_000_000) -> Iterator[tuple[Events, Triggers]]:
        """Events and triggers of the words, in pieces of at most ``max_events`` (or 32 if that is less).

        Raises
        ------
        RecordingCorrupt
            At a malformed word; the pieces before it have been handed out.
        """
        start = 0
        while start < len(words):
            out = empty_events(min(max(max_events, MARGIN), 12 * (len(words) - start) + MARGIN))
            stop = self._store(words, start, out)
            yield out.part(0, int(self._state[S.TAKEN])), self._taken_triggers()
            start = self._went_on(words, start, stop)

    def decode_into(self, words: Words, events: Events, at: int) -> tuple[int, Triggers]:
        """Write the words' events into arrays, from place ``at`` on; returns the next place and the triggers.

        The arrays must have room for 32 events more than come. Raises RecordingCorrupt.
        """
        found = []
        start = 0
        while start < len(words):
            out = events.part(at, len(events.t))
            stop = self._store(words, start, out)
            found.append(self._taken_triggers())
            if stop == start and self._state[S.FAULT] == Fault.ROOM:
                raise ValueError(f"arrays of {len(events.t)} events have no room for more")
            at += int(self._state[S.TAKEN])
            start = self._went_on(words, start, stop)
        return at, join_triggers(found)

    def count(self, words: Words, image: NDArray[np.uint16]) -> Triggers:
        """Add the words' events to a count image without making a list of them.

        ``image`` (2, height, width) uint16: OFF counts, then ON counts; they wrap above 65535.
        Returns the triggers. Raises RecordingCorrupt, and ValueError for an image of another size.
        """
        if image.shape != (2, self._state[S.HEIGHT], self._state[S.WIDTH]):
            raise ValueError(f"a count image of shape {image.shape} for another sensor")
        return self._without_list(words, Mode.COUNT, image)

    def tally(self, words: Words) -> Triggers:
        """Only count the words' events; returns the triggers. Raises RecordingCorrupt."""
        return self._without_list(words, Mode.TALLY, self._no_image)

    def _without_list(self, words: Words, mode: Mode, image: NDArray[np.uint16]) -> Triggers:
        found = []
        start = 0
        while start < len(words):
            stop = run(
                words, start, mode, self._state, self._gaps, self._no_events, image, self._edges, self._packed
            )
            found.append(self._taken_triggers())
            start = self._went_on(words, start, stop)
        return join_triggers(found)

    def _store(self, words: Words, start: int, out: Events) -> int:
        """Decode words into ``out`` until they end or it is full; returns where it stopped."""
        state, gaps, edges = self._state, self._gaps, self._edges
        return int(run(words, start, Mode.STORE, state, gaps, out, self._no_image, edges, self._packed))

    def _taken_triggers(self) -> Triggers:
        """Return the trigger edges of the last run, copied out of the buffer."""
        t, value, channel = self._edges[: self._state[S.TAKEN_EDGES]].T
        return Triggers(t.copy(), value.astype(np.uint8), channel.astype(np.uint8))

    def _went_on(self, words: Words, start: int, stop: int) -> int:
        """Book the words taken; returns where to go on. Raises RecordingCorrupt."""
        self._next_byte += 2 * (stop - start)
        fault = Fault(self._state[S.FAULT])
        if fault not in (Fault.NONE, Fault.ROOM):
            raise RecordingCorrupt(
                self._explain(fault, int(words[stop])),
                offset=self._next_byte,
                where=self._where,
                remedy="What stands before that place can be read; record it again.",
            )
        return stop

    def _explain(self, fault: Fault, word: int) -> str:
        """Say what is wrong with the word."""
        state = {place: int(self._state[place]) for place in S}
        sensor = f"on a sensor of {state[S.WIDTH]} x {state[S.HEIGHT]} px"
        if fault == Fault.ROW:
            return f"An event in row {word & 0x7FF} {sensor}."
        if fault == Fault.COLUMN:
            return f"An event in column {word & 0x7FF} {sensor}."
        if fault == Fault.VECTOR:
            return f"A vector from column {state[S.BASE]} on with events beyond the last column {sensor}."
        if fault == Fault.CLOCK:
            part = "upper" if word >> 12 == 0x8 else "lower"
            return (
                f"The sensor's clock steps back from {state[S.T]} us: its {part} part reads {word & 0xFFF}."
            )
        return f"A word 0x{word:04X} of a type that EVT3 does not have."

    @property
    def clock_us(self) -> int:
        """The sensor's clock at the last time word, us; -1 before the first."""
        return int(self._state[S.T])

    @property
    def covered_us(self) -> int:
        """Span of the sensor's clock since the first time word, us."""
        first = int(self._state[S.FIRST_T])
        return self.clock_us - first if first >= 0 else 0

    def statistics(self) -> StreamStatistics:
        """Sum up what the stream has told so far."""
        state = {place: int(self._state[place]) for place in S}
        reported = state[S.REPORTED_AT] >= 0
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
            odd_windows=state[S.ODD_WINDOWS],
            missing_windows=state[S.MISSING_WINDOWS],
            gaps=tuple((int(a), int(b)) for a, b in kept),
            gap_count=state[S.GAPS],
            unplaced_events=state[S.UNPLACED],
            back_steps=state[S.BACK_STEPS],
        )


def count_events(events: Events, image: NDArray[np.uint16]) -> None:
    """Add events to a count image, as ``Evt3Decoder.count`` does with the words they came in.

    ``image`` (2, height, width) uint16: OFF counts, then ON counts; they wrap above 65535.
    Raises ValueError when an event lies outside the image; those before it are not counted either.

    Examples
    --------
    >>> image = np.zeros((2, 4, 4), np.uint16)
    >>> count_events(Events(np.array([7]), *np.array([[3], [2], [1]], np.uint16)), image)
    >>> int(image[1, 2, 3]), int(image.sum())
    (1, 1)
    """
    if len(events.t) and not add_events(events.x, events.y, events.p, image):
        raise ValueError(f"an event outside an image of shape {image.shape}")


def first_time_high(words: Words) -> int | None:
    """Index of the first TIME_HIGH word, where a stream that is joined in its middle can begin; None without.

    >>> first_time_high(np.array([0x0005, 0x2803, 0x8001], np.uint16))
    2
    """
    found = np.flatnonzero(words >> 12 == 0x8)
    return int(found[0]) if len(found) else None


def join_triggers(pieces: list[Triggers]) -> Triggers:
    """One Triggers of many, in order; of none, an empty one."""
    return (
        Triggers(*(np.concatenate(fields) for fields in zip(*pieces, strict=True)))
        if pieces
        else empty_triggers(0)
    )
