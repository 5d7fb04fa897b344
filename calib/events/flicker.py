"""Period and phase of the flicker, from times and polarities of trigger edges or events; no pixel positions.

Hundreds of events share a microsecond, and what depends on it is computed once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array, Bools, Ints
from calib.errors import FlickerNotFound, TooFewEvents
from calib.events.event_times import EventTimes, event_times

#: Largest distance of an edge from its place in the train, as a share of the period: far above any jitter, and far
#: below the distance of other edges.
EDGE_TOLERANCE = 0.15
#: Least width of the bins of the event rate, us: a tenth of the shortest period. Largest number of them: it bounds the
#: time.
RATE_BIN_US, RATE_BINS = 100.0, 20_000
#: Least power of a period, in units of the mean power of as many events at random times: these reach it less than once
#: in 1e13 frequencies.
SIGNIFICANCE = 30.0
#: Least power of the fundamental, as a share of the power of its strongest harmonic: in a train of short bursts, both
#: are about equal.
FUNDAMENTAL_SHARE = 0.4
#: Least rate of a burst, as a share of the highest rate, both above the background.
BURST_SHARE = 0.1
#: Weight of a burst that the begin or the end of a recording cuts: it decides only where there are not two whole ones.
CUT_WEIGHT = 1e-3
#: Number of bins of the folded rate in which the light's rising edge is found: 65 us each at 60 Hz.
ONSET_BINS = 256
#: The first events of an edge are those of the fastest pixels, which no others delay on the way through the readout.
FIRST_SHARE = 0.01
#: Lowest and highest frequency at which events are searched for a flicker, Hz.
BAND_HZ = (15.0, 1000.0)


@dataclass(frozen=True)
class Flicker:
    """A periodic light, on the sensor's clock."""

    period_us: float  # Period, us
    phase_us: float  # Time of the first rising edge, us. The next edges follow one period later each.
    # Share of the period between a rising edge and the next falling edge; nan if no falling edge was
    # recorded.
    duty: float
    # Rms distance of the edges used from the fitted train, us; nan if there are too few edges.
    jitter_us: float
    missing: int  # Number of rising edges missing between the first and the last edge of the train
    source: Literal["triggers", "events"]  # ``"triggers"`` or ``"events"``

    @property
    def frequency_hz(self) -> float:
        """Frequency, Hz of the sensor's clock."""
        return 1e6 / self.period_us

    def lag_us(self, other: Flicker) -> float:
        """Return how much later this light rises than another one, us, between minus and plus half a period.

        Own definition: the difference of the phases, minus the nearest whole number of periods.

        Examples
        --------
        >>> by_triggers = Flicker(1000.0, 250.0, 0.5, 0.0, 0, "triggers")
        >>> by_events = Flicker(1001.0, 2240.0, 0.5, 0.0, 0, "events")
        >>> by_events.lag_us(by_triggers)
        -10.0
        """
        behind = self.phase_us - other.phase_us
        return float(behind - other.period_us * np.round(behind / other.period_us))

    def rising_edges_us(self, start_us: float, end_us: float) -> Array:
        """Return (K,) times, us, of the rising edges, phase + k period, from a start to before an end.

        Examples
        --------
        >>> flicker = Flicker(1000.0, 250.0, 0.5, 0.0, 0, "triggers")
        >>> flicker.rising_edges_us(0, 2300).tolist()
        [250.0, 1250.0, 2250.0]
        """
        first = np.ceil((start_us - self.phase_us) / self.period_us)
        last = np.ceil((end_us - self.phase_us) / self.period_us)
        return np.asarray(self.phase_us + self.period_us * np.arange(first, last), np.float64)


def first_on_delay_us(times: EventTimes, edges_us: Array) -> float:
    """Return how long after the light rises its first ON events come, us; nan without a whole period.

    Own definition: the delay of the first hundredth of a period's ON events, and of the periods the median. In half the
    light, pixels take twice as long (Lichtsteiner et al. 2008). ``edges_us`` are (K,) times of the rising edges.

    Examples
    --------
    >>> t, p = np.array([90, 108, 109, 160, 210, 211]), np.array([0, 1, 1, 0, 1, 1])
    >>> first_on_delay_us(event_times(t, p), np.array([100.0, 200.0, 300.0]))
    9.0
    """
    before = np.concatenate([[0], np.cumsum(times.on)])  # ON events before each time
    bounds = before[np.searchsorted(times.t, edges_us)]
    delays = []
    for edge_us, first, last in zip(edges_us, bounds, bounds[1:], strict=False):
        if last > first:
            wanted = first + int(FIRST_SHARE * (last - first))
            delays.append(times.t[np.searchsorted(before, wanted, side="right") - 1] - edge_us)
    return float(np.median(delays)) if delays else math.nan


def flicker_from_triggers(
    t_us: Ints, value: NDArray[np.integer], *, expected_hz: float | None = None
) -> Flicker:
    """Fit a periodic train of edges to the times of the light's sync signal.

    Rising edge k is expected at t = phase + k * period, and the falling edge after it at duty * period later. Period,
    phase and duty are fitted by least squares to the edges that fit. Missing edges are counted. Edges that do not fit
    (bounces, crosstalk) are left out. This model and the selection of the edges are this project's own.

    Parameters
    ----------
    t_us
        (N,) int64, times of the edges, us, in ascending order.
    value
        (N,) int, 1 for a rising edge, 0 for a falling one.
    expected_hz
        Frequency set at the light, Hz; None if it is not known. If it is given, one edge is enough, and edges whose
        frequency differs from it by more than `EDGE_TOLERANCE` are refused.

    Returns
    -------
    Flicker
        With the source ``"triggers"``.

    Raises
    ------
    FlickerNotFound
        If there are too few edges, or they are not periodic.
    """
    t = np.asarray(t_us, np.float64)
    is_rising = np.asarray(value) == 1
    period = _period_guess(t, is_rising, expected_hz)
    rising, falling = _train(t[is_rising], period), _train(t[~is_rising], period)
    extra = t.size - rising[0].size - falling[0].size
    if rising[0].size == 0 or extra > max(2, t.size // 2):
        raise FlickerNotFound(
            f"{t.size} trigger edges are not periodic: only {rising[0].size} rising and "
            f"{falling[0].size} falling ones fit a period.",
            where="triggers",
            remedy="Check the sync cable and that the light flickers.",
        )
    period, phase, fall_phase, jitter = _fit_trains(rising, falling, period)
    if expected_hz is not None and abs(period * expected_hz / 1e6 - 1.0) > EDGE_TOLERANCE:
        raise FlickerNotFound(
            f"The triggers come at {1e6 / period:.3f} Hz, but the light is set to {expected_hz:.3f} Hz.",
            where="triggers",
            remedy="Check the sync cable and the light's settings.",
        )
    k = rising[1]
    return Flicker(
        period_us=period,
        phase_us=phase + period * float(k.min()),
        duty=float(((fall_phase - phase) / period) % 1.0),
        jitter_us=jitter,
        missing=int(k.max() - k.min()) + 1 - k.size,
        source="triggers",
    )


def flicker_from_events(
    t_us: Ints, p: NDArray[np.integer], *, band_hz: tuple[float, float] = BAND_HZ
) -> Flicker:
    """Estimate the flicker from the events, for recordings without triggers.

    The power spectra of the ON rate and of the OFF rate are added. Both rates are trains of bursts, whose fundamental
    is about as strong as any harmonic, so the lowest strong frequency is the flicker's. The phases of the bursts then
    refine it. The light rises where the ON events of the folded period start.

    The events should be those of the slice that is imaged, because an error of the period grows into an error of the
    phase over time. Power spectrum and epoch folding: Leahy et al. (1983).

    Parameters
    ----------
    t_us
        (N,) int64, times of the events, us, in ascending order.
    p
        (N,) int, polarities: 1 is ON, 0 is OFF.
    band_hz
        Lowest and highest frequency searched, Hz.

    Returns
    -------
    Flicker
        With the source ``"events"``; its jitter is nan.

    Raises
    ------
    TooFewEvents
        If there are fewer than 100 events.
    FlickerNotFound
        If no period stands out, or the events cover fewer than two periods.
    """
    return flicker_from_times(event_times(t_us, np.asarray(p)), band_hz=band_hz)


def flicker_from_times(times: EventTimes, *, band_hz: tuple[float, float] = BAND_HZ) -> Flicker:
    """Estimate the flicker from events that are gathered by their time already; see `flicker_from_events`."""
    if times.first[-1] < 100:
        raise TooFewEvents(
            f"{times.first[-1]} events; at least 100 are needed to find the flicker.",
            where="flicker",
            remedy="Check that the light is on.",
        )
    start, span = float(times.t[0]), float(times.t[-1] - times.t[0])
    late = times.t.astype(np.float64) - start
    bin_us = max(RATE_BIN_US, span / RATE_BINS)
    bins, at = int(span / bin_us) + 1, (late / bin_us).astype(np.int64)
    rates = np.array([np.bincount(at, count, bins) for count in (times.on, times.off)])
    period = 1e6 / _search_frequency(rates, bin_us, band_hz)
    on, off = map(_onset, folded_rates(times, start, period, ONSET_BINS))
    return Flicker(
        period_us=period,
        phase_us=start + on * period,
        duty=float((off - on) % 1.0),
        jitter_us=float("nan"),
        missing=0,
        source="events",
    )


def _period_guess(t: Array, rising: Bools, expected_hz: float | None) -> float:
    """Return the median distance of neighbouring edges of one direction, us.

    If an expected frequency is given, only distances near its period count; a single edge gives that period. Own
    estimate: the median is not changed by a few missing or additional edges.
    """
    distances = np.concatenate([np.diff(t[rising]), np.diff(t[~rising])])
    distances = distances[distances > 0]
    if expected_hz is not None:
        near = distances[np.abs(distances * expected_hz / 1e6 - 1.0) < EDGE_TOLERANCE]
        if near.size:
            return float(np.median(near))
        if t.size and not distances.size:
            return 1e6 / expected_hz
    if not distances.size:
        raise FlickerNotFound(
            f"{t.size} trigger edges; a period needs at least two edges of one direction.",
            where="triggers",
            remedy="Record at least two periods, and check that the camera's trigger input is enabled.",
        )
    return float(np.median(distances))


def _train(t: Array, period: float) -> tuple[Array, Array]:
    """Select the edges of one direction that fit a periodic train; return their times and their numbers of periods.

    The search starts at the edge that agrees with most of its neighbours and extends in steps. Each step refits the
    period, so that the count stays right although the first guess of the period is slightly wrong. Own procedure: edge
    k fits if |t - anchor - k period| < `EDGE_TOLERANCE` period.
    """
    if t.size == 0:
        return t, t
    turns = (t[:64, None] - t[None, :64]) / period
    agree = np.abs(turns - np.round(turns)) < EDGE_TOLERANCE
    anchor = float(t[np.argmax(agree.sum(axis=0))])
    # Over 16 periods, the first guess may be EDGE_TOLERANCE / 16 wrong: 1 %.
    for reach in (16.0, 400.0, np.inf):
        turns = (t - anchor) / period
        k = np.round(turns)
        off = np.abs(turns - k)
        nearest = np.lexsort((off, k))
        once = nearest[np.concatenate([[True], np.diff(k[nearest]) != 0])]
        fits = np.sort(once[(off[once] < EDGE_TOLERANCE) & (np.abs(k[once]) <= reach)])
        if fits.size > 1:
            period, anchor = (float(v) for v in np.polyfit(k[fits], t[fits], 1))
    return t[fits], k[fits]


def _fit_trains(
    rising: tuple[Array, Array], falling: tuple[Array, Array], period: float
) -> tuple[float, float, float, float]:
    """Fit period, phase of the rising edges and phase of the falling edges by least squares.

    Returns them, and the rms residual, all in us. The period stays fixed if neither direction has two edges. Own model:
    t = phase + k period, with one phase for each direction.
    """
    t = np.concatenate([rising[0], falling[0]])
    k = np.concatenate([rising[1], falling[1]])
    is_rising = np.arange(t.size) < rising[0].size
    origin = t[0]
    fixed_period = len(np.unique(rising[1])) < 2 and len(np.unique(falling[1])) < 2
    target = t - origin  # a fixed period: each direction has one number of periods, 0
    design = np.column_stack([is_rising, ~is_rising, k])[:, : 2 if fixed_period else 3]
    solution, _, rank, _ = np.linalg.lstsq(design, target, rcond=None)
    residuals = target - design @ solution
    spare = t.size - int(rank)
    jitter = float(np.sqrt(residuals @ residuals / spare)) if spare > 0 else float("nan")
    fall_phase = origin + solution[1] if falling[0].size else float("nan")
    fitted = period if fixed_period else float(solution[2])
    return fitted, float(origin + solution[0]), float(fall_phase), jitter


def _search_frequency(rates: Array, bin_us: float, band_hz: tuple[float, float]) -> float:
    """Return the flicker's frequency, Hz, from the (2, bins) numbers of ON and OFF events.

    The power is divided by the number of events: mean 1 for random times, half that of Leahy et al. (1983).
    """
    bins = rates.shape[1]
    span_s = bins * bin_us * 1e-6
    # From nearly two periods in the span to somewhat below the Nyquist frequency of the bins, 0.5e6 / bin_us.
    lowest, highest = max(band_hz[0], 1.8 / span_s), min(band_hz[1], 0.4e6 / bin_us)
    padded = 1 << int(np.ceil(np.log2(16 * bins)))
    frequencies = np.fft.rfftfreq(padded, bin_us * 1e-6)
    centred = rates - rates.mean(axis=1, keepdims=True)
    power = np.sum(np.abs(np.fft.rfft(centred, padded, axis=1)) ** 2, axis=0) / rates.sum()
    band = np.flatnonzero((frequencies >= lowest) & (frequencies <= highest))
    if band.size < 3:
        raise FlickerNotFound(
            f"{1000 * span_s:.1f} ms of events cover fewer than two periods of {band_hz[0]:g} to {band_hz[1]:g} Hz.",
            where="events",
            remedy="Record for longer.",
        )
    inner = band[1:-1]
    peaks = inner[(power[inner] >= power[inner - 1]) & (power[inner] > power[inner + 1])]
    strongest = power[peaks].max(initial=0.0)
    if strongest < SIGNIFICANCE:
        raise FlickerNotFound(
            f"No period stands out in the events between {lowest:.0f} and {highest:.0f} Hz.",
            where="events",
            remedy="Check that the light flickers, or wire its sync output to the trigger input.",
        )
    coarse = float(frequencies[peaks[power[peaks] >= FUNDAMENTAL_SHARE * strongest][0]])
    return coarse / _turns_per_burst(rates, coarse * 1e-6 * bin_us * np.arange(bins, dtype=np.float64))


def _turns_per_burst(rates: Array, turns: Array) -> float:
    """Return the distance of the bursts of ON and OFF events in turns of a period near theirs, from their centres.

    Own estimate: the slope of the phases of the bursts, by least squares, weighted by their size. ``rates`` are
    (2, bins), ``turns`` (bins,).
    """
    design, phases = [], []
    for polarity, rate in enumerate(rates):
        excess = np.maximum(rate - np.percentile(rate, 25), 0.0)
        wave = np.where(excess < BURST_SHARE * excess.max(), 0.0, excess) * np.exp(2j * np.pi * turns)
        centre = np.angle(wave.sum())
        cycle = turns - centre / (2 * np.pi) + 0.5  # from quiet to quiet
        number = (np.floor(cycle) - np.floor(cycle[0])).astype(np.int64)
        burst = np.bincount(number, wave.real) + 1j * np.bincount(number, wave.imag)
        weight = np.sqrt(np.abs(burst))
        # A cut burst has another centre than a whole one. It tells something where there are not two whole ones.
        weight[0] *= 1.0 if cycle[0] % 1.0 < 0.25 else CUT_WEIGHT
        weight[-1] *= 1.0 if cycle[-1] % 1.0 > 0.75 else CUT_WEIGHT
        rows = np.column_stack([np.eye(2)[np.full(burst.size, polarity)], np.arange(burst.size)])
        design.append(rows * weight[:, None])
        phases.append(np.angle(burst * np.exp(-1j * centre)) * weight)
    slope = np.linalg.lstsq(np.concatenate(design), np.concatenate(phases), rcond=None)[0][2]
    return float(1.0 + slope / (2 * np.pi))


def folded_rates(times: EventTimes, start_us: float, period_us: float, bins: int) -> Array:
    """Return (2, bins) ON and OFF events over the phase of a period (epoch folding; Leahy et al., 1983)."""
    turns = np.asarray(times.t - start_us, np.float64) / period_us
    at = np.minimum(((turns - np.floor(turns)) * bins).astype(np.int64), bins - 1)
    return np.array([np.bincount(at, count, bins) for count in (times.on, times.off)])


def _onset(rate: Array) -> float:
    """Return the phase, in periods, at which the burst with the highest bin starts.

    Own rule: from the highest bin, go back to the first bin with less than a tenth of the highest bin's excess over the
    lower quartile. The burst starts in the bin after it.
    """
    excess = np.maximum(rate - np.percentile(rate, 25), 0.0)
    peak = int(np.argmax(excess))
    back = np.roll(excess[::-1], peak + 1)
    quiet = np.flatnonzero(back < BURST_SHARE * excess[peak])
    steps = int(quiet[0]) - 1 if quiet.size else 0
    return ((peak - steps) % ONSET_BINS) / ONSET_BINS
