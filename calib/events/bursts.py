"""When within a flicker period the events come: whole-period windows, the folded rate, and bursts.

Knows times and polarities of events and the light's `Flicker`; nothing of where in the image they lie.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.errors import TooFewEvents
from calib.events.flicker import Flicker

#: Share of a period that a window may lack and still count as whole: 33 ms at 60 Hz are two periods less 1 %.
PERIOD_TOLERANCE = 0.03
#: Bins in which one period's event rate is looked at.
FOLD_BINS = 512
#: Share of a burst's events that its gate holds.
BURST_SHARE = 0.98


class BurstWindow(NamedTuple):
    """When, within a period, one polarity's burst of events comes.

    Attributes
    ----------
    start_us
        Begin of a burst on the sensor's clock, us; the others follow every period.
    length_us
        Length, us.
    """

    start_us: float
    length_us: float


@njit(cache=True, error_model="numpy")
def folded_rate(t: Any, p: Any, start_us: float, period_us: float) -> Any:
    """Return the (2, FOLD_BINS) histogram of OFF and ON events over one period, from a begin on."""
    folded = np.zeros((2, FOLD_BINS))
    for i in range(t.size):
        turns = (t[i] - start_us) / period_us
        at = int((turns - np.floor(turns)) * FOLD_BINS)
        folded[1 if p[i] else 0, min(at, FOLD_BINS - 1)] += 1.0
    return folded


def burst_window(folded: NDArray[np.float64], start_us: float, period_us: float) -> BurstWindow:
    """Shortest stretch of the period that holds `BURST_SHARE` of what rises above the background."""
    background = np.percentile(folded, 25)
    excess = np.maximum(folded - background - 3.0 * np.sqrt(background), 0.0)
    if excess.sum() == 0.0:
        return BurstWindow(start_us, period_us)
    total = np.concatenate([[0.0], np.cumsum(np.tile(excess, 2))])
    begins = np.arange(FOLD_BINS)
    ends = np.searchsorted(total, total[begins] + BURST_SHARE * total[FOLD_BINS])
    first = int(np.argmin(ends - begins))
    last = int(ends[first])
    # The first events of a burst are few, and matter most: reach back to where it begins.
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
    """Choose begin, end (us) and number of the whole periods of a recording to use.

    Where the recording holds more than these, the window begins just before an edge of the light, so that no
    burst is cut.

    Parameters
    ----------
    t
        (N,) times of the events, us.
    flicker
        Period and phase of the light.
    window_us
        Begin and end of the recording; by default those of its events.
    periods
        Number of periods wanted; by default as many as there are.

    Raises
    ------
    TooFewEvents
        When there are no events, or not as many periods.
    """
    if t.size == 0:
        raise TooFewEvents("It holds no events.", where="event image", remedy="Check that the light is on.")
    begin, end = window_us if window_us is not None else (float(t[0]), float(t[-1]) + 1.0)
    there = int((end - begin) / flicker.period_us + PERIOD_TOLERANCE)
    wanted = there if periods is None else periods
    if wanted < 1 or there < wanted:
        raise TooFewEvents(
            f"{(end - begin) / 1000:.2f} ms hold {there} whole periods of {flicker.period_us / 1000:.2f} ms, "
            f"{max(wanted, 1)} wanted.",
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
