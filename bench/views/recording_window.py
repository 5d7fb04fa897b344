"""How long a recording must be, so that whole flicker periods lie inside it. Arithmetic only."""

from __future__ import annotations

RECORDING_MARGIN_S = 1e-3
"""Recorded beyond the whole periods and the one that is cut at the ends."""


def periods_in_window(window_ms: float, frequency_hz: float) -> int:
    """Return how many whole flicker periods a window stands for.

    An image gathered over a part of a period would show that part's polarity more; so windows are rounded.

    Examples
    --------
    >>> periods_in_window(33, 60)
    2
    """
    return max(1, round(window_ms * 1e-3 * frequency_hz))


def recording_duration_s(window_ms: float, frequency_hz: float) -> float:
    """Return how long to record so that the window's whole periods lie inside, wherever the light stands.

    Examples
    --------
    >>> round(recording_duration_s(33, 60), 4)
    0.051
    """
    return (periods_in_window(window_ms, frequency_hz) + 1) / frequency_hz + RECORDING_MARGIN_S
