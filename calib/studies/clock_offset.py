"""How the clocks of two cameras stand to each other, by edges of one sync signal that both recorded.

t_second = t_first + offset + rate (t_first - at). Edges may be missing in either camera. A periodic signal leaves the
offset open by whole periods: then the offset nearest zero is given, and the period with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array
from calib.errors import InputMismatch

#: Two crystals of 100 parts in a million each.
_LARGEST_RATE = 200e-6
_LEAST_EDGES = 5  # Two determine offset and rate; three more show whether they fit
#: Edges around an anchor by which a match is judged.
_NEIGHBOURS = 200
#: Anchors that are tried: that the second camera missed all of them, of which it may miss a tenth each, is no chance.
_ANCHORS = 7
#: Edges by which a match is looked for; how many of them may be missing; how many shifts are judged.
_NEXT, _NEXT_MISSED, _MOST_SHIFTS = 9, 2, 2000
#: Largest share of the edges that one camera may have missed; one edge in any case.
_MISSED = 0.1
#: Allowed distance of the two stamps of an edge: for rounding to whole microseconds, and for two trigger inputs.
_JITTER_US = 3.0
_REACHES = (16, 128, 1024, 8192)  # Edges about the anchor: the rate is fitted to ever longer parts
#: Times are whole microseconds, in both cameras: variance of the difference of two roundings.
_ROUNDING_US2 = 2.0 / 12.0


@dataclass(frozen=True)
class ClockOffset:
    """The second camera's clock against the first's, in one recording."""

    name: str
    offset_us: float
    sigma_us: float
    at_us: float  # By the first camera's clock: the middle of the edges
    rate_ppm: float  # What the second clock gains
    sigma_rate_ppm: float
    edges: int
    # The offset may differ by whole periods; None if the pattern of the edges leaves one offset only.
    period_us: float | None = None


def clock_offset(name: str, first_us: Sequence[int] | Array, second_us: Sequence[int] | Array) -> ClockOffset:
    """Estimate offset and rate of the second clock by least squares, from the rising edges of one recording, us.

    Raises InputMismatch: If there are too few edges, or the two cameras did not record the same signal together.
    """
    first, second = (np.unique(np.asarray(times, np.float64)) for times in (first_us, second_us))
    fewest = min(len(first), len(second))
    if fewest < _LEAST_EDGES:
        raise InputMismatch(
            f"At {name}, a camera recorded {fewest} rising sync edges; at least {_LEAST_EDGES} are needed.",
            remedy="Wire one sync signal to the trigger inputs of both cameras, and enable them.",
        )
    shifts = _good_shifts(first, second)
    offset = _fitted(name, first, second, *shifts[np.abs(shifts[:, 1]).argmin()]) if len(shifts) else None
    if (
        offset is None
        or abs(offset.rate_ppm) > 1e6 * _LARGEST_RATE
        or offset.edges < _expected(offset, first, second)
    ):
        raise InputMismatch(
            f"At {name}, the sync edges of the two cameras do not belong together: the first has {len(first)} rising"
            f" edges, {_usual_us(first):.0f} us apart, the second {len(second)}, {_usual_us(second):.0f} us apart.",
            remedy="Wire one sync signal to both cameras, and record them at the same time.",
        )
    apart = np.diff(shifts[:, 1])
    apart = apart[apart > _usual_us(first) / 2.0]
    if not len(apart):
        return offset
    period = float(apart[apart < 1.5 * apart.min()].mean())
    nearest = offset.offset_us - period * round(offset.offset_us / period)
    return replace(offset, offset_us=nearest, period_us=period)


def common_rate(clocks: Sequence[ClockOffset]) -> tuple[float, float]:
    """Return the weighted mean of the rates and its 1-sigma, ppm. Larger scatter enlarges it (Birge, 1932)."""
    rates = np.array([clock.rate_ppm for clock in clocks])
    weights = np.array([clock.sigma_rate_ppm for clock in clocks]) ** -2.0
    mean = float(weights @ rates / weights.sum())
    birge = weights @ (rates - mean) ** 2 / max(len(rates) - 1, 1)
    return mean, float(np.sqrt(max(birge, 1.0) / weights.sum()))


def _expected(offset: ClockOffset, first: Array, second: Array) -> float:
    """Return how many edges both must have at least, in the time that both recorded."""
    moved = first + offset.offset_us + 1e-6 * offset.rate_ppm * (first - offset.at_us)
    both = float(((moved >= second[0] - _JITTER_US) & (moved <= second[-1] + _JITTER_US)).sum())
    return both - max(1.0, _MISSED * both)


def _usual_us(times: Array) -> float:
    return float(np.median(np.diff(times)))


def _good_shifts(first: Array, second: Array) -> Array:
    """Return (n, 2) anchors and shifts by which the edges fit, each edge of the second camera at most once.

    An anchor is an edge of the first camera; some are tried, since the second may have missed it.
    """
    for anchor in first[np.linspace(0, len(first) - 1, _ANCHORS + 2).astype(int)[1:-1]]:
        near = first[np.argsort(np.abs(first - anchor), kind="stable")[:_NEIGHBOURS]]
        tolerance = _JITTER_US + _LARGEST_RATE * np.abs(near - anchor)
        tried = _promising(near, second, second - anchor)
        fits = [shift for shift in tried if _match(near, second, shift, tolerance)]
        if fits:
            return np.column_stack([np.full(len(fits), anchor), np.sort(fits)])
    return np.empty((0, 2))


def _promising(near: Array, second: Array, shifts: Array) -> Array:
    """Return the shifts by which the edges next to the anchor fit, those nearest zero first, and not too many."""
    few = near[:_NEXT]
    hits = sum((np.abs(_nearest(second, edges + shifts)) <= _JITTER_US).astype(int) for edges in few)
    kept = shifts[hits >= len(few) - _NEXT_MISSED]
    return kept[np.argsort(np.abs(kept), kind="stable")[:_MOST_SHIFTS]]


def _match(near: Array, second: Array, shift: float, tolerance: Array) -> bool:
    """Return whether both saw nearly all edges of the time that both recorded, and that time is long enough."""
    moved = near + shift
    inside = (moved >= second[0] - tolerance) & (moved <= second[-1] + tolerance)
    begin, end = moved[inside].min(initial=np.inf), moved[inside].max(initial=-np.inf)
    expected = int(((second >= begin - _JITTER_US) & (second <= end + _JITTER_US)).sum())
    both = max(int(inside.sum()), expected)
    if both < max(_LEAST_EDGES, min(len(near), len(second)) / 2):
        return False
    matched = int((np.abs(_nearest(second, moved[inside])) <= tolerance[inside]).sum())
    return both - matched <= max(1.0, _MISSED * both)


def _nearest(times: Array, wanted: Array) -> Array:
    """Return the distance from each wanted time to the nearest of the sorted times."""
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    before = times[after - 1] - wanted
    return np.where(-before <= times[after] - wanted, before, times[after] - wanted)


def _fitted(name: str, first: Array, second: Array, anchor: float, shift: float) -> ClockOffset:
    """Fit offset and rate in steps that reach further from the anchor, so that each finds the right edges.

    Uncertainties of a straight line (JCGM 100:2008, annex H.3): v / n of the offset in the middle of the times, and
    v / sum (t - middle)^2 of the rate, with the variance v of the residuals; own: the rounding of the times is added
    once, as if the edges shared it, and for the rate at both ends.
    """
    order, rate = np.argsort(np.abs(first - anchor), kind="stable"), 0.0
    allowed = _JITTER_US
    for reach in (*_REACHES, len(first)):
        near = first[order[:reach]]
        moved = near + shift + rate * (near - anchor)
        off = _nearest(second, moved)
        # Until a rate is known, edges far from the anchor are off by it.
        fits = np.abs(off) <= allowed + (_LARGEST_RATE * np.abs(near - anchor) if reach == _REACHES[0] else 0)
        difference = moved[fits] + off[fits] - near[fits]
        rate, shift = np.polyfit(near[fits] - anchor, difference, 1)
        left = difference - shift - rate * (near[fits] - anchor)
        allowed = max(_JITTER_US, 5.0 * float(np.sqrt(np.mean(left**2))))
    times = near[fits]
    at, span = float(times.mean()), float(np.ptp(times))
    scatter = float(left @ left) / (len(times) - 2)
    return ClockOffset(
        name,
        float(shift + rate * (at - anchor)),
        float(np.sqrt(scatter / len(times) + _ROUNDING_US2)),
        at,
        float(1e6 * rate),
        float(1e6 * np.sqrt(scatter / float(((times - at) ** 2).sum()) + 2.0 * _ROUNDING_US2 / span**2)),
        len(times),
    )
