"""Figures of the signal of an event camera's slice: rate, load of the link, flicker, jitter.

The module reads no file and opens no device: it gets decoded events.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.errors import FlickerNotFound, TooFewEvents
from calib.events.flicker import Flicker, flicker_from_events, flicker_from_triggers
from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.evt3 import StreamStatistics

LINK_GBIT_S: Final = 1.6
"""Data that the link of an EVK4 carries, Gbit/s."""
_MOST_EVENTS: Final = 150_000
"""Number of events from which the flicker is searched; more do not make the figure better."""
_LEAST_PERIODS: Final = 3
_SHORT_PERIODS: Final = 1.9


@dataclass(frozen=True)
class SignalFigures:
    """Rates, flicker and quality of the events of a slice. A figure that was not measured is None."""

    events: int = 0
    events_per_s: float | None = None  # Event rate, 1/s
    on_share: float | None = None
    link_share: float | None = None
    triggers: int = 0
    triggers_expected: int = 0
    sync_edges: int = 0
    # The flicker that the image is made with; None if there is none. A slice too short to show one is taken
    # to have the frequency to which the light is set; then neither ``trigger_hz`` nor ``event_hz`` is known.
    flicker: Flicker | None = None
    # trigger_hz, event_hz: Frequency by the sync edges, and by the events alone, Hz.
    trigger_hz: float | None = None
    event_hz: float | None = None
    jitter_us: float | None = None  # Rms distance of the sync edges from an even train, us
    # Rms distance of the ON bursts from an even train, us. It takes three whole periods.
    event_jitter_us: float | None = None
    sync_fault: str = ""  # What is wrong with the sync edges; empty if nothing is, or there are none


def measure_signal(
    events: Events, triggers: Triggers, data_bytes: int, expected_hz: float | None, *, compare: bool = True
) -> SignalFigures:
    """Measure the signal of a slice.

    events, triggers: The decoded slice, with times from 0 on.
    data_bytes: Length of the file without its header.
    expected_hz: Frequency to which the light is set, Hz; None if unknown.
    compare: Whether the frequency is measured by the events also if the sync edges give it. That takes as
      long as a third of the image.
    Returns: Figures without a flicker if none is found.
    """
    ends = [int(a[-1]) for a in (events.t, triggers.t) if len(a)]
    duration_s = (max(ends) + 1) * 1e-6 if ends else 0.0
    count = len(events.t)
    by_triggers, fault = _by_triggers(triggers, expected_hz)
    near_hz = by_triggers.frequency_hz if by_triggers else expected_hz
    by_events = None
    # Events of a single period show its ON and its OFF burst, which could be two periods of twice the frequency.
    if (compare or by_triggers is None) and duration_s * (near_hz or math.inf) >= _SHORT_PERIODS:
        by_events = _by_events(events, near_hz)
    flicker = by_triggers or by_events or _assumed(count, duration_s, expected_hz)
    found = replace(
        _rates(count, int(np.count_nonzero(events.p)), duration_s, data_bytes),
        flicker=flicker,
        event_hz=by_events.frequency_hz if by_events else None,
        event_jitter_us=burst_jitter_us(events, flicker) if flicker else None,
        sync_fault=fault,
    )
    return _with_edges(found, triggers, by_triggers, duration_s)


def signal_of_counts(
    statistics: StreamStatistics, triggers: Triggers, data_bytes: int, expected_hz: float
) -> SignalFigures | None:
    """Return the signal of a slice whose events were only counted.

    statistics: Counts and times of the slice.
    data_bytes: Length of the file without its header.
    expected_hz: Frequency to which the light is set, Hz.
    Returns: Without figures that need the times of events; None if only these can show the flicker.
    """
    count, duration_s = statistics.events, statistics.duration_s
    by_triggers, fault = _by_triggers(triggers, expected_hz)
    flicker = by_triggers or _assumed(count, duration_s, expected_hz)
    if flicker is None and count:
        return None
    found = replace(
        _rates(count, statistics.on_events, duration_s, data_bytes), flicker=flicker, sync_fault=fault
    )
    return _with_edges(found, triggers, by_triggers, duration_s)


def shows_flicker(signal: SignalFigures | None) -> bool:
    """Return whether a slice is long enough for its events to show their frequency.

    Returns: False for a slice of one period: its ON and its OFF burst could be two periods of twice the
      frequency.
    """
    if signal is None or signal.flicker is None or not signal.events_per_s:
        return False
    return signal.events / signal.events_per_s * signal.flicker.frequency_hz >= _SHORT_PERIODS


def burst_jitter_us(events: Events, flicker: Flicker) -> float | None:
    """Return how far the ON bursts are from an even train.

    Own estimate: the median time of the ON events of each period, against a straight line through these times.

    Returns: Rms, us; None if the slice holds fewer than three whole periods.
    """
    if not len(events.t):
        return None
    # The window begins a quarter period before the light rises, so that no burst is cut.
    starts = flicker.rising_edges_us(0.0, float(events.t[-1])) - 0.25 * flicker.period_us
    starts = starts[(starts >= 0.0) & (starts + flicker.period_us <= float(events.t[-1]) + 1.0)]
    middles = []
    for start in starts:
        first, last = np.searchsorted(events.t, [math.ceil(start), math.ceil(start + flicker.period_us)])
        on = events.t[first:last][events.p[first:last] > 0]
        if len(on) >= 100:
            middles.append(float(np.median(on)))
    if len(middles) < _LEAST_PERIODS:
        return None
    numbers = np.round((np.array(middles) - middles[0]) / flicker.period_us)
    off = np.array(middles) - np.polyval(np.polyfit(numbers, middles, 1), numbers)
    return float(np.sqrt((off**2).sum() / (len(off) - 2)))


def _rates(count: int, on: int, duration_s: float, data_bytes: int) -> SignalFigures:
    """Return the figures that follow from counts and duration."""
    return SignalFigures(
        events=count,
        events_per_s=count / duration_s if duration_s else None,
        on_share=on / count if count else None,
        link_share=8e-9 * data_bytes / (duration_s * LINK_GBIT_S) if duration_s else None,
    )


def _with_edges(
    found: SignalFigures, triggers: Triggers, by_triggers: Flicker | None, duration_s: float
) -> SignalFigures:
    """Return figures with those of the sync edges."""
    expected = len(by_triggers.rising_edges_us(0.0, 1e6 * duration_s)) if by_triggers else 0
    return replace(
        found,
        triggers=int(np.count_nonzero(triggers.value == 1)),
        triggers_expected=expected,
        sync_edges=len(triggers.t),
        trigger_hz=by_triggers.frequency_hz if by_triggers and _shows_period(triggers) else None,
        jitter_us=by_triggers.jitter_us if by_triggers and math.isfinite(by_triggers.jitter_us) else None,
    )


def _by_triggers(triggers: Triggers, expected_hz: float | None) -> tuple[Flicker | None, str]:
    """Return the flicker by the sync edges, and what is wrong with them."""
    if not len(triggers.t) or (expected_hz is None and len(triggers.t) < 2):
        return None, ""
    try:
        return flicker_from_triggers(triggers.t, triggers.value, expected_hz=expected_hz), ""
    except FlickerNotFound as fault:
        if expected_hz is None:
            return None, fault.what
        first = fault.what
    try:
        return flicker_from_triggers(triggers.t, triggers.value), first
    except FlickerNotFound:
        return None, first


def _assumed(events: int, duration_s: float, expected_hz: float | None) -> Flicker | None:
    """Return the flicker to which the light is set, if the slice is too short to show any; its phase is unknown."""
    if expected_hz is None or not events or duration_s * expected_hz > _SHORT_PERIODS:
        return None
    nan = float("nan")
    return Flicker(1e6 / expected_hz, 0.0, nan, nan, 0, "events")


def _shows_period(triggers: Triggers) -> bool:
    """Return whether two edges of one direction are there: a single one takes its frequency from the settings."""
    up = int(np.count_nonzero(triggers.value == 1))
    return max(up, len(triggers.t) - up) >= 2


def _by_events(events: Events, near_hz: float | None) -> Flicker | None:
    """Return the flicker by the events alone, from some of them."""
    step = max(1, len(events.t) // _MOST_EVENTS)
    band = (15.0, 1000.0) if near_hz is None else (min(15.0, 0.6 * near_hz), max(1000.0, 1.5 * near_hz))
    try:
        return flicker_from_events(events.t[::step], events.p[::step], band_hz=band)
    except (FlickerNotFound, TooFewEvents):
        return None
