"""Slices of the live picture: their length, their rate, and what a short one takes over from a longer one."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace

from bench.align.live_figures import LiveFigures, LiveSetting

SHORT_S = 1 / 60
"""Length of most slices, s, rounded to whole flicker periods, at least one. A short slice makes a quick picture."""
LONGEST_SLICE_S = 4.0
"""Longest slice, s. With a slower flicker, a slice holds no whole period."""
_OF_THE_FLICKER = ("sync", "flicker is")
"""Words of advice that only a slice of several periods can give."""
_LEARNT = 0.3
"""Weight of the newest duration in the expected ones."""
_RATE_OVER_S = 4.0


def slice_periods(setting: LiveSetting) -> int:
    """Return how many flicker periods a short slice holds.

    Returns: At least 1; 0 if there is no flicker.
    """
    if not setting.light_on or not setting.frequency_hz:
        return 0
    return max(1, round(SHORT_S * setting.frequency_hz))


def with_signal_of(figures: LiveFigures, signal: LiveFigures) -> LiveFigures:
    """Return the figures of a short slice, completed by the figures that need a longer slice.

    signal: Figures of the last slice of at least `bench.align.live_loop.SIGNAL_PERIODS`.
    """
    kept = [one for one in signal.advice if any(word in one for word in _OF_THE_FLICKER)]
    return replace(
        figures,
        trigger_hz=signal.trigger_hz,
        event_hz=signal.event_hz,
        jitter_us=signal.jitter_us,
        event_jitter_us=signal.event_jitter_us,
        advice=(*kept, *(one for one in figures.advice if one not in kept)),
    )


def learnt_s(known_s: float, newest_s: float) -> float:
    """Return the expected duration after the newest one.

    known_s: Expected duration so far, s; 0 if none is known.
    newest_s: The newest duration, s.
    Returns: Expected duration, s.
    """
    return newest_s if known_s == 0.0 else known_s + _LEARNT * (newest_s - known_s)


def slice_duration_s(setting: LiveSetting, periods: float) -> float:
    """Return the length of a slice.

    periods: Flicker periods that it holds; 0 without flicker.
    Returns: Length, s.
    """
    if periods == 0 or not setting.frequency_hz:
        return SHORT_S
    return min(periods / setting.frequency_hz, LONGEST_SLICE_S)


def rate_per_s(times_s: Iterable[float]) -> float:
    """Return how often something happened in the last seconds.

    times_s: Times on the monotonic clock, s, in their order.
    Returns: Times a second; 0 if it happened less than twice.
    """
    now_s = time.monotonic()
    recent = [at for at in list(times_s) if now_s - at < _RATE_OVER_S]
    if len(recent) < 2:
        return 0.0
    return (len(recent) - 1) / max(1e-6, now_s - recent[0])
