"""Encode events and triggers as EVT3 words, to write an imported recording. A camera's own words never pass here.

Every reader decodes these words alike: a TIME_HIGH is followed by a TIME_LOW before anything else, and steps by one
through any gap, so that no turn of the 24-bit clock is lost. Times are absolute from the start of the sensor's
clock, as ``drivers.camera.evt3`` returns them. Each event is a word of its own; vectors would save a fifth.
``drivers.camera.evt3_kernel`` lists the words and their source.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.evt3 import Words

MAX_TIME_US: Final = 86_400_000_000
"""One day: the clock words of longer gaps would fill the disk (42 MB a day), and no recording lasts that long."""


_MAX_ADDRESS: Final = 2047
_MAX_CHANNEL: Final = 15
_MAX_BACK_STEP_US: Final = 64
"""TIME_LOW may step back by this time, as it does in busy sensors; a reader takes more for missing words."""


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

    Examples
    --------
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
        """Encode the next events and edges, merged by time; edges stand before events of the same microsecond.

        events: Times from 0 to one day, us; columns and rows below 2048 px; polarities 0 or 1.
        triggers: Times from 0 to one day, us; values 0 or 1; channels 0 to 15.
        Returns: (N,) uint16, EVT3 words.
        Raises ValueError: If a value lies outside its range.
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
        n = _encode(*events, *triggers, self._state, out)
        return out[:n].astype("<u2", copy=False)


@njit(cache=True, nogil=True)
def _advance_clock(t: int, state: NDArray[np.int64], out: NDArray[np.uint16], n: int) -> int:
    """Bring the stream's clock to a time; return the number of words so far."""
    turn, low = t >> 12, t & 0xFFF
    now = state[_S.TURN] << 12 | max(state[_S.LOW], 0)
    if turn < state[_S.TURN] or t < now - _MAX_BACK_STEP_US:
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
def _encode(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.uint8],
    edge_t: NDArray[np.int64],
    value: NDArray[np.uint8],
    channel: NDArray[np.uint8],
    state: NDArray[np.int64],
    out: NDArray[np.uint16],
) -> Any:
    n = e = 0
    for i in range(len(t)):
        while e < len(edge_t) and edge_t[e] <= t[i]:
            n = _advance_clock(edge_t[e], state, out, n)
            out[n] = 0xA000 | (channel[e] & 0xF) << 8 | (value[e] & 1)
            n, e = n + 1, e + 1
        n = _advance_clock(t[i], state, out, n)
        if y[i] != state[_S.Y]:
            state[_S.Y] = y[i]
            out[n] = y[i]
            n += 1
        out[n] = 0x2000 | np.uint16(p[i]) << 11 | x[i]
        n += 1
    while e < len(edge_t):
        n = _advance_clock(edge_t[e], state, out, n)
        out[n] = 0xA000 | (channel[e] & 0xF) << 8 | (value[e] & 1)
        n, e = n + 1, e + 1
    return n
