"""When in a flicker period the events come: whole periods, the folded rate, and the bursts; no pixel positions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.errors import TooFewEvents
from calib.events.event_times import EventTimes
from calib.events.flicker import Flicker

#: Share of a period that a window may lack and still count as whole: 33 ms at 60 Hz are two periods less 1 %.
PERIOD_TOLERANCE = 0.03
#: Number of bins of the folded rate.
FOLD_BINS = 512
#: Share of a burst's events that lie in its window.
BURST_SHARE = 0.98


class BurstWindow(NamedTuple):
    """Part of the flicker period in which the burst of one polarity comes."""

    # Start of the first burst on the sensor's clock, us. The next bursts start one period later each.
    start_us: float
    length_us: float  # Length, us


def folded_rate(times: EventTimes, start_us: float, period_us: float) -> NDArray[np.float64]:
    """Return (2, FOLD_BINS) OFF and ON events over the phase of a period (epoch folding; Leahy et al., 1983)."""
    turns = (times.t - start_us) / period_us
    at = np.minimum(((turns - np.floor(turns)) * FOLD_BINS).astype(np.int64), FOLD_BINS - 1)
    return np.array([np.bincount(at, count, FOLD_BINS) for count in (times.off, times.on)])


def burst_window(folded: NDArray[np.float64], start_us: float, period_us: float) -> BurstWindow:
    """Find the shortest part of the period that holds the share `BURST_SHARE` of a burst; all of it without a burst.

    The background is the lower quartile of the bins. A bin counts by what exceeds it by more than three standard
    deviations of a Poisson count. Own procedure: a bin of n events counts max(n - b - 3 b^(1/2), 0), with the
    background b. ``folded`` is a (FOLD_BINS,) row of `folded_rate`; times are in us.
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
    t: NDArray[np.int64],
    flicker: Flicker,
    window_us: tuple[float, float] | None,
    periods: int | None,
) -> tuple[float, float, int]:
    """Choose a window of whole periods within a recording: start and end, us, and number of periods.

    If the recording is longer, the window starts just before an edge of the light, so that it cuts no burst. Own rule:
    as many periods as fit, if up to `PERIOD_TOLERANCE` of a period may be missing. None for the window is from the
    first to the last event; None for ``periods`` is as many as it holds.
    Raises TooFewEvents: If there are no events, or fewer periods than wanted.
    """
    if t.size == 0:
        raise TooFewEvents(
            "The recording holds no events.", where="event image", remedy="Check that the light is on."
        )
    begin, end = window_us if window_us is not None else (float(t[0]), float(t[-1]) + 1.0)
    available = int((end - begin) / flicker.period_us + PERIOD_TOLERANCE)
    wanted = available if periods is None else periods
    if wanted < 1 or available < wanted:
        raise TooFewEvents(
            f"{(end - begin) / 1000:.2f} ms hold {available} whole periods of {flicker.period_us / 1000:.2f} ms; "
            f"{max(wanted, 1)} are needed.",
            where="event image",
            remedy="Record for longer.",
        )
    slack = end - begin - wanted * flicker.period_us
    edges = [flicker.phase_us]
    if np.isfinite(flicker.duty):
        edges.append(flicker.phase_us + flicker.duty * flicker.period_us)
    waits = [(edge - 0.01 * flicker.period_us - begin) % flicker.period_us for edge in edges]
    start = begin + (min(waits) if min(waits) <= slack else 0.0)
    return start, start + wanted * flicker.period_us, wanted
