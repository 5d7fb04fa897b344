"""Events and triggers to EVT3 words: what an imported recording is written with. No camera's words pass here.

Every reader takes these words alike: a TIME_HIGH is followed by a TIME_LOW before anything else, and steps by one
through any gap, so that no turn of the 24-bit clock is lost. Times are absolute from the start of the sensor's
clock, as ``drivers.camera.evt3`` gives them. Each event is a word of its own: vectors would save a fifth.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.camera.evt3 import Events, Triggers, Words

MOST_US: Final = 86_400_000_000
"""A day: the clock's words of longer gaps would fill the disk (42 MB a day), and no recording lasts that long."""


_MAX_ADDRESS: Final = 2047
_MAX_CHANNEL: Final = 15
_MOST_BACK_US: Final = 64
"""TIME_LOW may step back a little, as busy sensors have it; a reader takes more for missing words."""


class _S(IntEnum):
    """Places in the state array."""

    TURN = 0
    """Time over 4096 us at the last TIME_HIGH, -1 before the first."""
    LOW = 1
    """Last TIME_LOW, -1 where one is due."""
    Y = 2
    MOVED = 3


class Evt3Encoder:
    """Encodes one stream, given in pieces whose times go on from each other.

    Examples
    --------
    >>> from drivers.camera.evt3 import empty_triggers
    >>> event = Events(np.array([4098]), np.array([3], "u2"), np.array([5], "u2"), np.array([1], "u1"))
    >>> [hex(word) for word in Evt3Encoder().words(event, empty_triggers(0))]
    ['0x8000', '0x8001', '0x6002', '0x5', '0x2803']
    """

    def __init__(self) -> None:
        self._state = np.array([-1, -1, -1, 0], np.int64)

    @property
    def moved(self) -> int:
        """Events and edges that stepped back further than the words can say, and got their predecessor's time."""
        return int(self._state[_S.MOVED])

    def words(self, events: Events, triggers: Triggers) -> Words:
        """Words of the next events and edges, merged by their times; edges before events of their microsecond.

        Parameters
        ----------
        events, triggers
            Times from 0 to a day, us; addresses below 2048, polarities and values 0 or 1, channels 0 to 15.

        Raises
        ------
        ValueError
            When anything lies outside that.
        """
        for t in (events.t, triggers.t):
            if len(t) and (t.min() < 0 or t.max() >= MOST_US):
                raise ValueError(f"times from {t.min()} to {t.max()} us, not within a day from 0 on")
        for what, values, most in (
            *(("a column", events.x, _MAX_ADDRESS), ("a row", events.y, _MAX_ADDRESS)),
            *(("a polarity", events.p, 1), ("a trigger's value", triggers.value, 1)),
            ("a trigger's id", triggers.id, _MAX_CHANNEL),
        ):
            if len(values) and values.max() > most:
                raise ValueError(f"{what} of {values.max()}, above {most}")
        latest = max((int(t.max()) for t in (events.t, triggers.t) if len(t)), default=0)
        turns = max(0, (latest >> 12) - int(self._state[_S.TURN]))
        out = np.empty(turns + 3 * len(events.t) + 2 * len(triggers.t) + 2, np.uint16)
        n = _encode(*events, *triggers, self._state, out)
        return out[:n].astype("<u2", copy=False)


@njit(cache=True, nogil=True)
def _go_to(t: int, state: NDArray[np.int64], out: NDArray[np.uint16], n: int) -> int:
    """Bring the stream's clock to a time; returns the number of words so far."""
    turn, low = t >> 12, t & 0xFFF
    now = state[_S.TURN] << 12 | max(state[_S.LOW], 0)
    if turn < state[_S.TURN] or t < now - _MOST_BACK_US:
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
            n = _go_to(edge_t[e], state, out, n)
            out[n] = 0xA000 | (channel[e] & 0xF) << 8 | (value[e] & 1)
            n, e = n + 1, e + 1
        n = _go_to(t[i], state, out, n)
        if y[i] != state[_S.Y]:
            state[_S.Y] = y[i]
            out[n] = y[i]
            n += 1
        out[n] = 0x2000 | np.uint16(p[i]) << 11 | x[i]
        n += 1
    while e < len(edge_t):
        n = _go_to(edge_t[e], state, out, n)
        out[n] = 0xA000 | (channel[e] & 0xF) << 8 | (value[e] & 1)
        n, e = n + 1, e + 1
    return n
