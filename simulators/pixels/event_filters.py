"""On-chip event filters: anti-flicker (AFK), spatio-temporal contrast (STC), trail, event rate controller (ERC).

Each filter removes events. Its rules are simpler than the chip's, but have the same effect on a flickering target: AFK
removes it, STC removes most events of a bright edge, and the rate controller removes nearly all of them. The names and
their purposes are those of Prophesee's documentation of event signal processing. This module works on events only. The
state is kept from slice to slice.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.compiled import LOOP
from simulators.pixels.sensor import Events

FILTERS: Final = ("afk", "stc", "trail", "erc")
"""The camera's names of the filters, in the order in which they act."""

BURST_US: Final = 10_000
"""STC and trail: events of one pixel and polarity that are closer in time than this form one burst."""
AFK_SHORTEST_US: Final = 1e6 / 520.0
AFK_LONGEST_US: Final = 1e6 / 50.0
"""AFK: a region flickers if the time between its bursts of ON events lies between these limits."""
AFK_REGION: Final = 4
"""AFK: side of a region, px."""
AFK_PERIODS: Final = 2
"""AFK: number of such periods after which a region counts as flickering."""
ERC_WINDOW_US: Final = 200
ERC_QUOTA: Final = 4000
"""ERC: events passed in each window (20 Mev/s)."""

_LONG_AGO: Final = -(1 << 40)


class EventFilters:
    """The enabled filters of a sensor, by name; missing = off."""

    def __init__(self, width: int, height: int, enabled: Mapping[str, bool]) -> None:
        self._enabled = [name for name in FILTERS if enabled.get(name, False)]
        # per pixel: time of the last event, its polarity, its number in the burst
        self._bursts = {
            name: (
                np.full((height, width), _LONG_AGO, np.int64),
                np.full((height, width), 2, np.uint8),
                np.zeros((height, width), np.int32),
            )
            for name in self._enabled
            if name in ("stc", "trail")
        }
        regions = (-(-height // AFK_REGION), -(-width // AFK_REGION))
        # per region: time of the last rise, whether the last event was ON, periods seen in the band
        self._afk = (
            np.full(regions, _LONG_AGO, np.int64),
            np.zeros(regions, np.uint8),
            np.zeros(regions, np.int32),
        )
        self._erc = np.array([_LONG_AGO, 0], np.int64)  # window, events in it

    def apply(self, events: Events) -> tuple[Events, NDArray[np.int64]]:
        """Pass the next slice, in order of time; also return the times, us, that entered the rate controller."""
        for name in self._enabled:
            if name == "erc":
                continue
            keep = self._keep(name, events)
            events = Events(events.t[keep], events.x[keep], events.y[keep], events.p[keep])
        entered_t = events.t
        if "erc" in self._enabled:
            keep = _within_quota(events.t, self._erc)
            events = Events(events.t[keep], events.x[keep], events.y[keep], events.p[keep])
        return events, entered_t

    def _keep(self, name: str, events: Events) -> NDArray[np.bool_]:
        """Return which events a filter passes."""
        if name == "afk":
            return np.asarray(_not_flickering(events, self._afk))
        number = _burst_number(events, self._bursts[name])
        return np.asarray(number == 1 if name == "trail" else number > 1)


@njit(**LOOP)
def _burst_number(
    events: Events,
    bursts: tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.int32]],
) -> NDArray[np.int32]:
    """Return the number of each event in its pixel's burst, from 1."""
    t, x, y, p = events
    last_t, last_p, count = bursts
    number = np.empty(t.size, np.int32)
    for i in range(t.size):
        r, c = y[i], x[i]
        goes_on = last_p[r, c] == p[i] and t[i] - last_t[r, c] <= BURST_US
        count[r, c] = count[r, c] + 1 if goes_on else 1
        last_t[r, c], last_p[r, c] = t[i], p[i]
        number[i] = count[r, c]
    return number


@njit(**LOOP)
def _not_flickering(
    events: Events,
    afk: tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.int32]],
) -> NDArray[np.bool_]:
    """Return, for each event, whether its region does not flicker within the band."""
    t, x, y, p = events
    last_rise, was_on, periods = afk
    keep = np.empty(t.size, np.bool_)
    for i in range(t.size):
        r, c = y[i] // AFK_REGION, x[i] // AFK_REGION
        if p[i] and not was_on[r, c]:
            period = t[i] - last_rise[r, c]
            if period >= AFK_SHORTEST_US:  # shorter ones are the ragged edge of one rise
                periods[r, c] = periods[r, c] + 1 if period <= AFK_LONGEST_US else 0
                last_rise[r, c] = t[i]
        was_on[r, c] = p[i]
        if t[i] - last_rise[r, c] > AFK_LONGEST_US:
            periods[r, c] = 0
        keep[i] = periods[r, c] < AFK_PERIODS
    return keep


@njit(**LOOP)
def _within_quota(t: NDArray[np.int64], erc: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return, for each event, whether it is within its window's quota."""
    keep = np.empty(t.size, np.bool_)
    for i in range(t.size):
        window = t[i] // ERC_WINDOW_US
        if window != erc[0]:
            erc[0], erc[1] = window, 0
        erc[1] += 1
        keep[i] = erc[1] <= ERC_QUOTA
    return keep
