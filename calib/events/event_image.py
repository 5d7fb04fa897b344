"""Events of one pose to images: each gathers whole periods of the flicker in its own way.

Knows arrays of events and a `Flicker`; no files, no target. Images are brighter where the target is.

The images, and what they are good for (V is a pixel's value over n periods):

- last polarity: +1, -1 or 0, the last event of a pixel: the published method's image. Stray events flip it.
- count: all events of a pixel.
- fired-per-edge: edges of the light on which the pixel fired within the burst, at most once each, ON and OFF.
  Best where a pixel sends one or two events an edge: what it sends beyond the first depends on the readout.
- lock-in: V = sum of p cos(2 pi (t - t0) / T), p = +-1, t0 where the image as a whole answers strongest. Best
  where pixels send several events an edge, and so show shades of grey.
- first-ON latency: mean time from the start of the ON burst to the pixel's first ON event of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.errors import InputMismatch, TooFewEvents
from calib.events.bursts import FOLD_BINS, BurstWindow, burst_window, folded_rate, whole_period_window
from calib.events.flicker import Flicker

#: Events an edge from which grey levels outweigh what the readout spoils: lock-in instead of fired-per-edge.
LOCK_IN_MIN_EVENTS = 1.9
#: A pixel is lit when it fires on at least this share of the edges.
LIT_SHARE = 0.75


class ChosenImage(NamedTuple):
    """The image chosen for finding stars, and why."""

    name: str
    image: NDArray[np.float32]
    reason: str


@dataclass(frozen=True)
class SliceFacts:
    """What a slice of events was like; gates and reports use it.

    Attributes
    ----------
    start_us, end_us
        Window used, us: whole periods (`periods` of them).
    periods
        Number of periods in the window.
    events, events_outside
        Events inside and outside of the window.
    on_share
        Share of ON events among those inside.
    lit_pixels
        Pixels that fire on most edges.
    events_per_edge, events_per_edge_on, events_per_edge_off
        Mean number of events that a lit pixel sends at an edge of the light, both kinds and each.
    first_on_spread_us
        Standard deviation, over lit pixels, of the first ON event after the burst's start, us; wide when the
        readout is saturated.
    hot_pixels
        Pixels masked because they fire far more often than their surroundings.
    silent_rows
        Rows without any event between rows that hold lit pixels: rows the readout missed.
    on_window, off_window
        Where the bursts lie in the period.
    """

    start_us: float
    end_us: float
    periods: int
    events: int
    events_outside: int
    on_share: float
    lit_pixels: int
    events_per_edge: float
    events_per_edge_on: float
    events_per_edge_off: float
    first_on_spread_us: float
    hot_pixels: int
    silent_rows: int
    on_window: BurstWindow
    off_window: BurstWindow


@dataclass(frozen=True)
class EventImages:
    """Images of one pose, all (H, W), and the facts of the slice they were made of.

    Attributes
    ----------
    last_polarity
        int8, +1 ON, -1 OFF, 0 never fired.
    on_count, off_count
        uint32, events of each polarity.
    on_fired, off_fired
        uint16, edges on which the pixel fired within the burst.
    lock_in
        float32, in-phase sum at the flicker's frequency.
    on_latency_us
        float32, mean latency of the first ON event of a burst; nan where there was none.
    hot
        bool, pixels that fire far more often than those around them; filled in by `best` and `named`.
    facts
        What the slice was like.
    """

    last_polarity: NDArray[np.int8]
    on_count: NDArray[np.uint32]
    off_count: NDArray[np.uint32]
    on_fired: NDArray[np.uint16]
    off_fired: NDArray[np.uint16]
    lock_in: NDArray[np.float32]
    on_latency_us: NDArray[np.float32]
    hot: NDArray[np.bool_]
    facts: SliceFacts

    @property
    def count(self) -> NDArray[np.uint32]:
        """(H, W) uint32, events of both polarities."""
        return self.on_count + self.off_count

    @property
    def fired(self) -> NDArray[np.bool_]:
        """(H, W) bool, whether a pixel sent any event."""
        return self.last_polarity != 0

    @cached_property
    def fired_per_edge(self) -> NDArray[np.float32]:
        """(H, W) float32, 0 to 1: share of the edges on which the pixel fired; hot pixels filled in."""
        edges = 2.0 * self.facts.periods
        share = (self.on_fired.astype(np.float32) + self.off_fired) / np.float32(edges)
        return _fill(share, self.hot)

    def best(self) -> ChosenImage:
        """Choose the image to find stars in, by the events that a lit pixel sends at an edge of the light."""
        rate = self.facts.events_per_edge
        if rate >= LOCK_IN_MIN_EVENTS:
            reason = (
                f"{rate:.2f} events per edge, {LOCK_IN_MIN_EVENTS} or more: their number carries grey levels."
            )
            return ChosenImage("lock-in", _fill(self.lock_in, self.hot), reason)
        reason = f"{rate:.2f} events per edge, fewer than {LOCK_IN_MIN_EVENTS}: whether a pixel fired is what is sure."
        return ChosenImage("fired-per-edge", self.fired_per_edge, reason)

    def named(self, name: str) -> NDArray[np.float32]:
        """Return one image by its name, as float32, brighter where the target is.

        Parameters
        ----------
        name
            ``last-polarity``, ``any``, ``count``, ``fired-per-edge``, ``lock-in`` or ``on-latency``.

        Raises
        ------
        InputMismatch
            When there is no image of that name.
        """
        makers = {
            "last-polarity": lambda: self.last_polarity.astype(np.float32),
            "any": lambda: self.fired.astype(np.float32),
            "count": lambda: _fill(self.count.astype(np.float32), self.hot),
            "fired-per-edge": lambda: self.fired_per_edge,
            "lock-in": lambda: _fill(self.lock_in, self.hot),
            "on-latency": self._quickness,
        }
        if name not in makers:
            raise InputMismatch(f"No event image is called {name!r}; there are {', '.join(makers)}.")
        return makers[name]()

    def _quickness(self) -> NDArray[np.float32]:
        """First-ON latency turned round, so that bright is bright; 0 where no ON event came."""
        gate = np.float32(self.facts.on_window.length_us)
        return np.where(np.isnan(self.on_latency_us), np.float32(0), 1.0 - self.on_latency_us / gate)


def make_images(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.uint8],
    size: tuple[int, int],
    flicker: Flicker,
    *,
    window_us: tuple[float, float] | None = None,
    periods: int | None = None,
) -> EventImages:
    """Gather the events of whole flicker periods into images.

    Parameters
    ----------
    t, x, y, p
        (N,) times, us, not falling; column; row; polarity (1 = ON).
    size
        Width and height of the sensor, px.
    flicker
        The light's period and phase on the same clock.
    window_us
        Begin and end of the recording, us; by default from the first event to the last, which is shorter than
        the recording where little happens between the bursts.
    periods
        Number of periods to use; by default as many whole ones as the window holds.

    Raises
    ------
    TooFewEvents
        When the window holds no whole period (or not as many as asked), or no events.
    InputMismatch
        When arrays differ in length, or an event lies outside the sensor.
    """
    _check(t, x, y, p, size)
    start, end, whole = whole_period_window(t, flicker, window_us, periods)
    first, last = (int(i) for i in np.searchsorted(t, [np.ceil(start), np.ceil(end)]))
    if last == first:
        raise TooFewEvents(
            f"No event in {start:.0f} to {end:.0f} us.",
            where="event image",
            remedy="Check light and aperture.",
        )
    inside = slice(first, last)
    maps, gates = _gather((t[inside], x[inside], y[inside], p[inside]), size, start, flicker.period_us)
    hot = _hot_pixels(maps.on_count + maps.off_count, 2 * whole)
    facts = _facts(maps, hot, (start, end, whole), (last - first, t.size - (last - first)), gates)
    return EventImages(
        last_polarity=maps.last_polarity,
        on_count=maps.on_count,
        off_count=maps.off_count,
        on_fired=maps.on_fired,
        off_fired=maps.off_fired,
        lock_in=maps.lock_in,
        on_latency_us=_mean_latency(maps),
        hot=hot,
        facts=facts,
    )


class _Maps(NamedTuple):
    """What the kernel writes, one value a pixel."""

    last_polarity: NDArray[np.int8]
    on_count: NDArray[np.uint32]
    off_count: NDArray[np.uint32]
    on_fired: NDArray[np.uint16]
    off_fired: NDArray[np.uint16]
    on_burst: NDArray[np.int32]
    off_burst: NDArray[np.int32]
    on_latency: NDArray[np.float32]
    lock_in: NDArray[np.float32]

    @classmethod
    def blank(cls, size: tuple[int, int]) -> _Maps:
        shape = (size[1], size[0])
        return cls(
            np.zeros(shape, np.int8),
            np.zeros(shape, np.uint32),
            np.zeros(shape, np.uint32),
            np.zeros(shape, np.uint16),
            np.zeros(shape, np.uint16),
            np.full(shape, -1, np.int32),
            np.full(shape, -1, np.int32),
            np.zeros(shape, np.float32),
            np.zeros(shape, np.float32),
        )


def _gather(
    events: tuple[NDArray[Any], ...], size: tuple[int, int], start_us: float, period_us: float
) -> tuple[_Maps, tuple[BurstWindow, BurstWindow]]:
    """Find where in the period the bursts lie and when the image answers most, and fill the maps."""
    t, x, y, p = events
    off_rate, on_rate = folded_rate(t, p, start_us, period_us)
    gates = burst_window(on_rate, start_us, period_us), burst_window(off_rate, start_us, period_us)
    wave = np.exp(2j * np.pi * (np.arange(FOLD_BINS) + 0.5) / FOLD_BINS)
    answer_us = start_us + float(np.angle((on_rate - off_rate) @ wave)) / (2 * np.pi) * period_us
    maps = _Maps.blank(size)
    _accumulate(t, x, y, p, period_us, answer_us, *gates, maps)
    return maps, gates


@njit(cache=True, error_model="numpy")
def _accumulate(
    t: Any,
    x: Any,
    y: Any,
    p: Any,
    period: float,
    answer_us: float,
    on: BurstWindow,
    off: BurstWindow,
    maps: _Maps,
) -> None:
    """Add every event to all maps; times are looked at once for all events that share one."""
    seen = t[0] - 1
    on_turns = off_turns = on_late = off_late = wave = 0.0
    for i in range(t.size):
        if t[i] != seen:
            seen = t[i]
            on_turns = np.floor((seen - on.start_us) / period)
            off_turns = np.floor((seen - off.start_us) / period)
            on_late = seen - on.start_us - on_turns * period
            off_late = seen - off.start_us - off_turns * period
            wave = np.cos(2.0 * np.pi * (seen - answer_us) / period)
        r, c = y[i], x[i]
        if p[i]:
            maps.on_count[r, c] += 1
            maps.last_polarity[r, c] = 1
            maps.lock_in[r, c] += wave
            burst = np.int32(on_turns + 1)
            if on_late <= on.length_us and maps.on_burst[r, c] != burst:
                maps.on_burst[r, c] = burst
                maps.on_fired[r, c] += 1
                maps.on_latency[r, c] += on_late
        else:
            maps.off_count[r, c] += 1
            maps.last_polarity[r, c] = -1
            maps.lock_in[r, c] -= wave
            burst = np.int32(off_turns + 1)
            if off_late <= off.length_us and maps.off_burst[r, c] != burst:
                maps.off_burst[r, c] = burst
                maps.off_fired[r, c] += 1


def _hot_pixels(count: NDArray[np.uint32], edges: int) -> NDArray[np.bool_]:
    """Pixels that fire far more often than the pixels around them."""
    around = cv2.medianBlur(np.minimum(count, 65535).astype(np.uint16), 5)
    return np.asarray(count > 2.5 * around + 4.0 + 2.0 * edges)


def _fill(image: NDArray[np.float32], hot: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Put the median of the surroundings where a pixel is hot."""
    if not hot.any():
        return image
    return np.where(hot, cv2.medianBlur(image, 3), image)


def _mean_latency(maps: _Maps) -> NDArray[np.float32]:
    """Mean latency of the first ON events of each pixel, us; nan where there was none."""
    mean = np.full(maps.on_latency.shape, np.nan, np.float32)
    np.divide(maps.on_latency, maps.on_fired, out=mean, where=maps.on_fired > 0)
    return mean


def _facts(
    maps: _Maps,
    hot: NDArray[np.bool_],
    window: tuple[float, float, int],
    events: tuple[int, int],
    gates: tuple[BurstWindow, BurstWindow],
) -> SliceFacts:
    """Sum up what the slice was like."""
    start, end, periods = window
    lit = (maps.on_fired >= LIT_SHARE * periods) & (maps.off_fired >= LIT_SHARE * periods) & ~hot
    number = int(np.count_nonzero(lit))
    on, off = (float(c[lit].mean()) / periods if number else 0.0 for c in (maps.on_count, maps.off_count))
    latency = maps.on_latency[lit] / np.maximum(maps.on_fired[lit], 1)
    rows = np.flatnonzero(lit.any(axis=1))
    amid = maps.last_polarity[rows[0] : rows[-1] + 1] if rows.size else maps.last_polarity[:0]
    return SliceFacts(
        start_us=start,
        end_us=end,
        periods=periods,
        events=events[0],
        events_outside=events[1],
        on_share=float(maps.on_count.sum(dtype=np.int64)) / events[0],
        lit_pixels=number,
        events_per_edge=(on + off) / 2.0,
        events_per_edge_on=on,
        events_per_edge_off=off,
        first_on_spread_us=float(latency.std()) if number else float("nan"),
        hot_pixels=int(np.count_nonzero(hot)),
        silent_rows=int(np.count_nonzero(~amid.any(axis=1))),
        on_window=gates[0],
        off_window=gates[1],
    )


def _check(t: Any, x: Any, y: Any, p: Any, size: tuple[int, int]) -> None:
    """Refuse arrays that do not belong together, or events beside the sensor."""
    if not t.shape == x.shape == y.shape == p.shape:
        raise InputMismatch(
            f"{t.size} times, {x.size} columns, {y.size} rows, {p.size} polarities.", where="event image"
        )
    if t.size and (int(x.max()) >= size[0] or int(y.max()) >= size[1]):
        raise InputMismatch(
            f"An event at column {int(x.max())} or row {int(y.max())} of a {size[0]} x {size[1]} sensor.",
            where="event image",
            remedy="Give the size that stands in the recording's header.",
        )
