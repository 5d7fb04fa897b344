"""One pass over the events of a window: all sums that event images are made of, one value a pixel.

Before it, the times alone give whole periods, the folded rate, and when in a period the bursts come.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple, TypeVar, cast

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.arrays import Array, Array32, Bools, Bytes, EventArrays, Ints
from calib.compiled import KERNEL
from calib.errors import InputMismatch, TooFewEvents
from calib.events.event_times import EventTimes
from calib.events.flicker import Flicker, folded_rates

Grey = TypeVar("Grey", Array32, Bytes)
#: Share of a period that a window may lack and still count as whole: 33 ms at 60 Hz are two periods less 1 %.
PERIOD_TOLERANCE = 0.03
#: Number of bins of the folded rate: 33 us each at 60 Hz.
FOLD_BINS = 512
#: Share of a burst's events that lie in its window: a longer one would gather noise for a few late events.
BURST_SHARE = 0.98
#: Types of the fields of `PixelSums`.
_KINDS = (np.uint32, np.uint32, np.int32, np.int32, np.float32, np.float32, np.uint16, np.uint16, np.int8)


class BurstWindow(NamedTuple):
    """Part of the flicker period in which the burst of one polarity comes."""

    # Start of the first burst on the sensor's clock, us. The next bursts start one period later each.
    start_us: float
    length_us: float  # Length, us


def burst_window(folded: Array, start_us: float, period_us: float) -> BurstWindow:
    """Find the shortest part of the period that holds the share `BURST_SHARE` of a burst; all of it without a burst.

    The background is the lower quartile of the bins. A bin counts by what exceeds it by more than three standard
    deviations of a Poisson count. Own procedure: a bin of n events counts max(n - b - 3 b^(1/2), 0), with the
    background b. ``folded`` is a (FOLD_BINS,) row of `folded_rates`; times are in us.
    """
    background = np.percentile(folded, 25)
    excess = np.maximum(folded - background - 3.0 * np.sqrt(background), 0.0)
    if excess.sum() == 0.0:
        return BurstWindow(start_us, period_us)
    total = np.concatenate([[0.0], np.cumsum(np.tile(excess, 2))])
    begins = np.arange(FOLD_BINS)
    ends = np.searchsorted(total, total[begins] + BURST_SHARE * total[FOLD_BINS])
    first = int(np.argmin(ends - begins))
    last = int(ends[first])
    # The first events of a burst are few and matter most: extend the window back to where the burst starts.
    quiet = np.flatnonzero(np.roll(excess[::-1], first) == 0.0)
    first -= (int(quiet[0]) if quiet.size else 0) + 1
    bin_us = period_us / FOLD_BINS
    return BurstWindow(start_us + first * bin_us, min(last - first, FOLD_BINS) * bin_us)


def whole_period_window(
    t: Ints, flicker: Flicker, window_us: tuple[float, float] | None, periods: int | None
) -> tuple[float, float, int]:
    """Choose a window of whole periods within a recording: start and end, us, and number of periods.

    If the recording is longer, the window starts just before an edge of the light, so that it cuts no burst. Own rule:
    as many periods as fit, if up to `PERIOD_TOLERANCE` of a period may be missing. None for the window is from the
    first to the last event; None for ``periods`` is as many as it holds.
    Raises TooFewEvents: If there are no events, or fewer periods than wanted.
    """
    if t.size == 0:
        raise TooFewEvents("The recording holds no events.", remedy="Check that the light is on.")
    begin, end = window_us if window_us is not None else (float(t[0]), float(t[-1]) + 1.0)
    available = int((end - begin) / flicker.period_us + PERIOD_TOLERANCE)
    wanted = available if periods is None else periods
    if wanted < 1 or available < wanted:
        raise TooFewEvents(
            f"{(end - begin) / 1000:.2f} ms hold {available} whole periods of {flicker.period_us / 1000:.2f} ms; "
            f"{max(wanted, 1)} are needed.",
            remedy="Record for longer.",
        )
    slack = end - begin - wanted * flicker.period_us
    edges = [flicker.phase_us]
    if np.isfinite(flicker.duty):
        edges.append(flicker.phase_us + flicker.duty * flicker.period_us)
    waits = [(edge - 0.01 * flicker.period_us - begin) % flicker.period_us for edge in edges]
    start = begin + (min(waits) if min(waits) <= slack else 0.0)
    return start, start + wanted * flicker.period_us, wanted


class PixelSums(NamedTuple):
    """Sums over the events of each pixel, all (H, W)."""

    on_count: NDArray[np.uint32]  # uint32, number of ON events
    off_count: NDArray[np.uint32]  # uint32, number of OFF events
    on_burst: NDArray[np.int32]  # int32, last ON burst in which the pixel fired, from 1; 0 if there was none
    # int32, last OFF burst in which the pixel fired, from 1; 0 if there was none
    off_burst: NDArray[np.int32]
    # float32, us, sum over the ON bursts of the time from the start of the burst to the pixel's first ON
    # event.
    on_latency: Array32
    lock_in: Array32  # float32, sum of polarity times cosine of the flicker's phase
    on_fired: NDArray[np.uint16]  # uint16, number of ON bursts in which the pixel fired
    off_fired: NDArray[np.uint16]  # uint16, number of OFF bursts in which the pixel fired
    last_polarity: NDArray[np.int8]  # int8, polarity of the last event: +1 ON, -1 OFF, 0 if there was none

    @classmethod
    def empty(cls, size: tuple[int, int]) -> PixelSums:
        """Return the sums before the first event, all 0; size is width and height, px."""
        return cls(*(np.zeros(size[::-1], kind) for kind in _KINDS))

    def mean_latency_us(self) -> Array32:
        """Return (H, W) the mean latency of each pixel's first ON events, us; nan where no ON burst held an event."""
        mean = np.full(self.on_latency.shape, np.nan, np.float32)
        np.divide(self.on_latency, self.on_fired, out=mean, where=self.on_fired > 0)
        return mean


def require_inside(x: NDArray[np.uint16], y: NDArray[np.uint16], size: tuple[int, int]) -> None:
    """Raise InputMismatch if an event lies outside of the sensor."""
    if x.size and (int(x.max()) >= size[0] or int(y.max()) >= size[1]):
        raise InputMismatch(
            f"An event lies at column {int(x.max())} or row {int(y.max())} of a {size[0]} x {size[1]} sensor.",
            remedy="Give the size that stands in the recording's header.",
        )


class Halves(NamedTuple):
    """In how many bursts each pixel fired in the two halves of a window, (H, W) uint16 each."""

    first: NDArray[np.uint16]
    second: NDArray[np.uint16]


def half_bounds(window: tuple[float, float, int]) -> list[float]:
    """Return the bounds of the parts of a window, us: first half, what belongs to neither half, second half.

    Own rule: n periods give two halves of floor(n / 2) periods; a middle period belongs to neither. One period has no
    halves, so it is one part. The window is start and end, us, and number of periods.
    """
    start, end, periods = window
    half = (end - start) / periods * (periods // 2)
    return [start, start + half, end - half, end] if periods > 1 else [start, end]


def accumulate(
    times: EventTimes,
    events: EventArrays,
    size: tuple[int, int],
    window: tuple[float, float, int],
    period_us: float,
) -> tuple[PixelSums, Halves | None, BurstWindow]:
    """Find the bursts in the period, and sum up the events of each pixel in one pass.

    Returns the sums of the window, those of its halves (None for one period), and the window of the ON burst.
    The phase 0 of the lock-in sum (synchronous detection; Meade, 1983) is that of the first Fourier coefficient: the ON
    rate minus the OFF rate of the whole image is largest there. There is at least one event at the times.
    """
    start_us = window[0]
    on_rate, off_rate = folded_rates(times, start_us, period_us, FOLD_BINS)
    on_window, off_window = (burst_window(rate, start_us, period_us) for rate in (on_rate, off_rate))
    wave = np.exp(2j * np.pi * (np.arange(FOLD_BINS) + 0.5) / FOLD_BINS)
    response_us = start_us + float(np.angle((on_rate - off_rate) @ wave)) / (2 * np.pi) * period_us
    sums = PixelSums.empty(size)
    parts: tuple[Any, ...] = sums
    flat = PixelSums(*(part.ravel() for part in parts))
    fired = []
    for begin, end in pairwise(half_bounds(window)):
        part = times.between(begin, end)
        _add_events(part, events, size[0], period_us, response_us, (on_window, off_window), flat)
        fired.append(sums.on_fired + sums.off_fired)
    halves = Halves(fired[0], fired[-1] - fired[-2]) if len(fired) > 1 else None
    return sums, halves, on_window


@njit(**KERNEL)
def _add_events(
    times: EventTimes,
    events: Any,
    width: int,
    period: float,
    response_us: float,
    bursts: Any,
    sums: PixelSums,
) -> None:
    """Add every event to all sums, which are flat; what depends on the time alone is computed once for each time.

    Whether an event is the first of its burst is added as 0 or 1: a branch would be foreseen wrongly too often, and the
    loop would take four times as long. Equations: head of `calib.events.event_image`; lock-in: Meade (1983).
    """
    (_, x, y, p), (on, off) = events, bursts
    # In variables of their own: the compiled loop would load their addresses from the tuple for every event.
    on_count, off_count, on_seen, off_seen, on_latency, lock_in, on_fired, off_fired, last_polarity = sums
    columns = np.uint64(width)
    for k in range(times.t.size):
        now = times.t[k]
        on_turns = np.floor((now - on.start_us) / period)
        off_turns = np.floor((now - off.start_us) / period)
        on_late = now - on.start_us - on_turns * period
        off_late = now - off.start_us - off_turns * period
        on_burst, off_burst = np.int32(on_turns + 2), np.int32(off_turns + 2)
        in_on, in_off = on_late <= on.length_us, off_late <= off.length_us
        wave, late = np.float32(np.cos(2.0 * np.pi * (now - response_us) / period)), np.float32(on_late)
        for i in range(times.first[k], times.first[k + 1]):
            at = np.uint64(y[i]) * columns + np.uint64(x[i])
            if p[i]:
                on_count[at] += np.uint32(1)
                last_polarity[at] = 1
                lock_in[at] += wave
                if in_on:
                    is_first = on_seen[at] != on_burst
                    on_seen[at] = on_burst
                    on_fired[at] += np.uint16(is_first)
                    on_latency[at] += late * np.float32(is_first)
            else:
                off_count[at] += np.uint32(1)
                last_polarity[at] = -1
                lock_in[at] -= wave
                if in_off:
                    is_first = off_seen[at] != off_burst
                    off_seen[at] = off_burst
                    off_fired[at] += np.uint16(is_first)


def hot_pixels(on_count: NDArray[np.uint32], off_count: NDArray[np.uint32], allowed: int) -> Bools:
    """Find the pixels with more than 2.5 m + ``allowed`` events, with the median m of the 5 x 5 pixels around each.

    Own rule: neighbours of one brightness differ by less than the factor, and few events say nothing of it.
    """
    count = on_count + off_count
    around = cv2.medianBlur(np.minimum(count, 65535).astype(np.uint16), 5)
    return np.asarray(count > 2.5 * around + allowed)


def without_hot_pixels(image: Grey, hot: Bools) -> Grey:
    """Replace hot pixels by the median of the 3 x 3 pixels around them; at the rim, the last pixels are repeated."""
    return cast("Grey", np.where(hot, cv2.medianBlur(image, 3), image))
