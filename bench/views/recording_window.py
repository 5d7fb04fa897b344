"""How long a recording must be to contain whole flicker periods."""

from __future__ import annotations

RECORDING_MARGIN_S = 1e-3
"""Time recorded in addition to the whole periods and the one that is cut at the ends, s."""


def periods_in_window(window_ms: float, frequency_hz: float) -> int:
    """Return the number of whole flicker periods nearest to a window, at least one.

    An image over a part of a period would favour one polarity, so windows are rounded to whole periods.

    window_ms: Length of the window, ms.
    frequency_hz: Frequency of the flicker, Hz.

    Examples
    --------
    >>> periods_in_window(33, 60)
    2
    """
    return max(1, round(window_ms * 1e-3 * frequency_hz))


def recording_duration_s(window_ms: float, frequency_hz: float) -> float:
    """Return the recording time that contains the window's whole periods at any phase of the light.

    window_ms: Length of the window, ms.
    frequency_hz: Frequency of the flicker, Hz.
    Returns: Duration, s.

    Examples
    --------
    >>> round(recording_duration_s(33, 60), 4)
    0.051
    """
    return (periods_in_window(window_ms, frequency_hz) + 1) / frequency_hz + RECORDING_MARGIN_S
