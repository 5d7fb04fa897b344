"""Encoder of contrast events and triggers as EVT3 words, as an IMX636 sends them.

Format: Prophesee, EVT 3.0 data format. Habits of the sensor: a TIME_HIGH every 16 us, a TIME_LOW after each TIME_HIGH
before anything that has a time, rate-controller counters every 200 us, vectors where a block of 32 pixels holds enough
events. This module does not depend on where events come from.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.compiled import INNER, LOOP
from simulators.errors import SimulationMisuse

# Words of EVT3: types, subtypes of OTHERS, and the bit of the polarity.
ADDR_Y: Final = 0x0000
ADDR_X: Final = 0x2000
VECT_BASE_X: Final = 0x3000
VECT_12: Final = 0x4000
VECT_8: Final = 0x5000
TIME_LOW: Final = 0x6000
CONTINUED_4: Final = 0x7000
TIME_HIGH: Final = 0x8000
EXT_TRIGGER: Final = 0xA000
OTHERS: Final = 0xE000
CONTINUED_12: Final = 0xF000
RATE_IN: Final = 0x014
RATE_OUT: Final = 0x016
ON: Final = 0x0800

TICK_US: Final = 16
"""Time between two TIME_HIGH."""
COUNTER_US: Final = 200
"""Window of the rate controller's counters; they are sent with the first TIME_HIGH after its end."""
MARK_US: Final = 2000
"""At multiples of this after the start a TIME_LOW follows the TIME_HIGH in any case; an idle stream thus has times."""
BLOCK: Final = 32
"""Pixels of a vector triple (12 + 12 + 8)."""
VECTOR_FROM: Final = 5
"""Smallest number of events of a block for which a vector is shorter than single events."""

ERC_WINDOW_US: Final = 200  # As that of the counters
ERC_QUOTA: Final = 4000
"""Events that the rate controller passes in each window (20 Mev/s). It is simpler than the chip's, with the same effect
on a flickering target: it removes nearly all of its events."""
_LONG_AGO: Final = -(1 << 40)  # Before any window
# Indices into the writer's int64 state.
_TICK: Final = 0  # time of the next TIME_HIGH
_LOW: Final = 1  # time of the last TIME_LOW, -1 if a TIME_HIGH came since
_COUNT_END: Final = 2  # end of the present counter window
_COUNT_OUT: Final = 3  # events sent in the window
_COUNT_IN: Final = 4  # events that entered the rate controller in the window
_BASE: Final = 5  # vector base in force, with polarity in bit 11; -1 unknown
_Y: Final = 6  # row in force, -1 unknown; sent again with each read
_READ_T: Final = 7  # time of the row read in progress
_START: Final = 8  # time at which the stream started
_N_STATE: Final = 9

Columns = tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint8]]
"""Times (us), columns, rows and polarities of events."""


class RateController:
    """The event rate controller (ERC) of a sensor; its state is kept from slice to slice."""

    def __init__(self) -> None:
        self._window = np.array([_LONG_AGO, 0], np.int64)  # its number, and the events in it

    def passed(self, t: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which events of the next slice pass: each window of time has a quota. ``t``: (N,) us, rising."""
        return np.asarray(_within_quota(t, self._window))


@njit(**LOOP)
def _within_quota(t: NDArray[np.int64], erc: NDArray[np.int64]) -> NDArray[np.bool_]:
    keep = np.empty(t.size, np.bool_)
    for i in range(t.size):
        window = t[i] // ERC_WINDOW_US
        if window != erc[0]:
            erc[0], erc[1] = window, 0
        erc[1] += 1
        keep[i] = erc[1] <= ERC_QUOTA
    return keep


class Evt3Writer:
    """Encoder of a stream in slices, which continues from slice to slice; it starts at a multiple of 16 us."""

    def __init__(self, start_us: int = 0, *, width: int = 1280, height: int = 720) -> None:
        if start_us % TICK_US:
            raise SimulationMisuse(
                f"A stream cannot start at {start_us} us.", remedy=f"Start at a multiple of {TICK_US} us."
            )
        self.width, self.height = width, height
        self._now_us = start_us
        self._state = np.zeros(_N_STATE, np.int64)
        self._state[_TICK] = self._state[_START] = start_us
        self._state[_COUNT_END] = start_us + COUNTER_US
        self._state[_LOW] = self._state[_BASE] = self._state[_Y] = self._state[_READ_T] = -1

    def write(
        self,
        t: NDArray[np.int64],
        x: NDArray[np.uint16],
        y: NDArray[np.uint16],
        p: NDArray[np.uint8],
        *,
        until_us: int,
        trigger_t: NDArray[np.int64] | None = None,
        trigger_value: NDArray[np.uint8] | None = None,
        entered_t: NDArray[np.int64] | None = None,
    ) -> NDArray[np.uint16]:
        """Return the words of a slice, from the end of the previous one to ``until_us`` (exclusive).

        The words do not depend on how the stream is cut into slices. Events outside slice or sensor raise
        `SimulationMisuse`. ``t, x, y, p`` are four (N,) arrays: int64 us, uint16 px, uint16 px, uint8 (1 = ON); t does
        not decrease, and events of one time, row and polarity are in order of x. ``trigger_t, trigger_value`` are edges
        of the trigger input, two (M,) arrays: int64 us in order of time, and uint8 (1 = rising), to which twice the
        number of the channel is added. ``entered_t``, (K,) int64 us, are the events that entered the rate controller;
        None: those of the slice.
        """
        none_t, none_value = np.empty(0, np.int64), np.empty(0, np.uint8)
        edges = (
            none_t if trigger_t is None else trigger_t,
            none_value if trigger_value is None else trigger_value,
        )
        for times in (t, edges[0]):
            if times.size and not (self._now_us <= times[0] and times[-1] < until_us):
                raise SimulationMisuse(
                    f"Events from {times[0]} to {times[-1]} us do not fit a slice "
                    f"from {self._now_us} to {until_us} us."
                )
        if x.size and (int(x.max()) >= self.width or int(y.max()) >= self.height):
            raise SimulationMisuse(
                f"An event lies outside the sensor of {self.width} x {self.height} pixels."
            )
        ticks = (until_us - self._now_us) // TICK_US + 2
        room = 4 * t.size + 2 * edges[0].size + 3 * ticks + 8 * (ticks * TICK_US // COUNTER_US + 2)
        words = np.empty(room, np.uint16)
        n = _write(
            words,
            self._state,
            (t, x, y, p),
            edges,
            t if entered_t is None else entered_t,
            until_us,
            self.width,
        )
        self._now_us = until_us
        return words[:n]


@njit(**LOOP)
def _write(
    words: NDArray[np.uint16],
    state: NDArray[np.int64],
    events: Columns,
    edges: tuple[NDArray[np.int64], NDArray[np.uint8]],
    entered_t: NDArray[np.int64],
    until: int,
    width: int,
) -> int:
    """Merge ticks, edges and row reads by time; return the number of words."""
    t = events[0]
    edge_t, edge_value = edges
    end = np.int64(until)
    # A plain 0 is a type of its own: numba would compile all that is called once more, for it.
    n = i = k = entered = int(np.int64(0))
    while True:
        t_event = t[i] if i < t.size else end
        t_edge = edge_t[k] if k < edge_t.size else end
        first = min(t_event, t_edge)
        # Ticks come first: an event at the time of a tick is sent after it.
        if state[_TICK] <= first and state[_TICK] < end:
            n, entered = _write_ticks(words, n, state, entered_t, entered, first, end)
        if first == end:
            break
        n = _write_time_low(words, n, state, int(first))
        if t_edge <= t_event:
            words[n] = EXT_TRIGGER | (edge_value[k] & 1) | ((edge_value[k] >> 1) << 8)
            n += 1
            k += 1
            continue
        last = _run_end(events, i)
        n = _write_run(words, n, state, events, i, last, width)
        state[_COUNT_OUT] += last - i
        i = last
    state[_COUNT_IN] += entered_t.size - entered
    return n


@njit(**INNER)
def _write_ticks(
    words: NDArray[np.uint16],
    n: int,
    state: NDArray[np.int64],
    entered_t: NDArray[np.int64],
    entered: int,
    first: np.int64,
    end: np.int64,
) -> tuple[int, int]:
    """Write each TIME_HIGH from ``first`` to before ``end``, with the counters that are due."""
    while state[_TICK] <= first and state[_TICK] < end:
        tick = state[_TICK]
        words[n] = TIME_HIGH | ((tick >> 12) & 0xFFF)
        n += 1
        state[_LOW] = -1
        if (tick - state[_START]) % MARK_US == 0:
            n = _write_time_low(words, n, state, tick)
        if tick >= state[_COUNT_END]:
            while entered < entered_t.size and entered_t[entered] < tick:
                entered += 1
                state[_COUNT_IN] += 1
            n = _write_counters(words, n, state)
        state[_TICK] = tick + TICK_US
    return n, entered


@njit(**INNER)
def _run_end(events: Columns, first: int) -> int:
    """Return the end of the run that begins at ``first``: one time, row and polarity, from left to right."""
    t, x, y, p = events
    last = first + 1
    while (
        last < t.size
        and t[last] == t[first]
        and y[last] == y[first]
        and p[last] == p[first]
        and x[last] > x[last - 1]
    ):
        last += 1
    return last


@njit(**INNER)
def _write_time_low(words: NDArray[np.uint16], n: int, state: NDArray[np.int64], t: int) -> int:
    """Write a TIME_LOW, unless the same one is in force; return the number of words."""
    if state[_LOW] != t:
        words[n] = TIME_LOW | (t & 0xFFF)
        state[_LOW] = t
        n += 1
    return n


@njit(**INNER)
def _write_counters(words: NDArray[np.uint16], n: int, state: NDArray[np.int64]) -> int:
    """Write the events into and out of the rate controller in the window that ends; begin the next window."""
    for k in range(2):
        count = state[_COUNT_IN] if k == 0 else state[_COUNT_OUT]
        words[n] = OTHERS | (RATE_IN if k == 0 else RATE_OUT)
        words[n + 1] = CONTINUED_12 | (count & 0xFFF)
        words[n + 2] = CONTINUED_12 | ((count >> 12) & 0xFFF)
        words[n + 3] = CONTINUED_4 | ((count >> 24) & 0xF)
        n += 4
    state[_COUNT_IN] = state[_COUNT_OUT] = 0
    state[_COUNT_END] += COUNTER_US
    return n


@njit(**INNER)
def _write_run(
    words: NDArray[np.uint16],
    n: int,
    state: NDArray[np.int64],
    events: Columns,
    first: int,
    last: int,
    width: int,
) -> int:
    """Write events first .. last - 1, of one time, row and polarity, from left to right; return the number of words."""
    _, x, y, p = events
    if state[_Y] != y[first] or state[_READ_T] != state[_LOW]:
        words[n] = ADDR_Y | y[first]
        n += 1
        state[_Y], state[_READ_T] = y[first], state[_LOW]
    polarity = ON if p[first] else 0
    while first < last:
        block = x[first] // BLOCK * BLOCK
        end, bits = first, 0
        while end < last and x[end] < block + BLOCK:
            bits |= 1 << (np.int64(x[end]) - block)
            end += 1
        if end - first >= VECTOR_FROM and block + BLOCK <= width:
            if state[_BASE] != (block | polarity):
                words[n] = VECT_BASE_X | polarity | block
                n += 1
            words[n] = VECT_12 | (bits & 0xFFF)
            words[n + 1] = VECT_12 | ((bits >> 12) & 0xFFF)
            words[n + 2] = VECT_8 | (bits >> 24)
            n += 3
            state[_BASE] = (block + BLOCK) | polarity
        else:
            for j in range(first, end):
                words[n] = ADDR_X | polarity | x[j]
                n += 1
            state[_BASE] = -1
        first = end
    return n
