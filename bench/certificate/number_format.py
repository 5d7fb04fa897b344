"""The form of the numbers of certificates: a text with ``{number:05d}`` and perhaps ``{year}``. Text only."""

from __future__ import annotations

import re

SIMULATED = "SIMULATED-"
"""Begin of the number of a certificate of simulated devices; these have a series of their own."""
_FORMAT = re.compile(
    r"(?P<before>(?:[A-Za-z0-9._/-]|\{year\})*)\{number(?::0(?P<digits>[1-9])d)?\}(?P<after>(?:[A-Za-z0-9._/-]|\{year\})*)"
)


def is_number_format(text: str) -> bool:
    """Return whether a text is the format of a series of numbers.

    Returns: Whether it has ``{number}`` or ``{number:05d}`` exactly once and otherwise only plain characters
      and ``{year}``.

    Examples
    --------
    >>> [is_number_format(one) for one in ("SB-{year}-{number:05d}", "SB", "{number.__class__}")]
    [True, False, False]
    """
    return _FORMAT.fullmatch(text) is not None


def number_of(text: str, *, year: int, number: int) -> str:
    """Return a number of a series.

    number: The number in the series, from 1.
    Raises ValueError: When this is not a format of a series.

    Examples
    --------
    >>> number_of("SB-{year}-{number:05d}", year=2026, number=17)
    'SB-2026-00017'
    """
    match = _FORMAT.fullmatch(text)
    if match is None:
        raise ValueError(text)
    digits = f"{number:0{match['digits'] or 1}d}"
    return "".join(
        [match["before"].replace("{year}", str(year)), digits, match["after"].replace("{year}", str(year))]
    )


def series_of(text: str, *, year: int, simulated: bool) -> str:
    """Return the name of a series: numbers count from 1 in each, and in each year if the format names the year.

    simulated: Whether devices were simulated.

    Examples
    --------
    >>> series_of("SB-{year}-{number:05d}", year=2026, simulated=True)
    'SIMULATED-SB-2026-{number:05d}'
    """
    return (SIMULATED if simulated else "") + text.replace("{year}", str(year))


def number_pattern(text: str) -> re.Pattern[str]:
    """Return what a number of a series looks like.

    Returns: Matches the numbers of any year: a number may be used in the year after it was reserved.
    Raises ValueError: When this is not a format of a series.

    Examples
    --------
    >>> bool(number_pattern("SB-{year}-{number:05d}").fullmatch("SB-2026-00017"))
    True
    """
    match = _FORMAT.fullmatch(text)
    if match is None:
        raise ValueError(text)
    before, after = (
        "[0-9]{4}".join(map(re.escape, match[name].split("{year}"))) for name in ("before", "after")
    )
    return re.compile(f"{before}[0-9]{{{match['digits'] or 1},9}}{after}")
