"""Durations in words, for progress and status lines."""

from __future__ import annotations


def clock_text(seconds: float) -> str:
    """Return a duration as hours, minutes and seconds.

    seconds: The duration, s; a negative one counts as zero.
    Returns: ``m:ss``, or ``h:mm:ss`` from one hour on.

    Examples
    --------
    >>> clock_text(75), clock_text(4.2), clock_text(7322)
    ('1:15', '0:04', '2:02:02')
    """
    whole = max(0, round(seconds))
    hours, rest = divmod(whole, 3600)
    minutes, seconds_left = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{seconds_left:02d}" if hours else f"{minutes}:{seconds_left:02d}"
