"""Printed form of numbers, times and other values: rounded according to their uncertainty.

U has two significant digits and is rounded up, unless rounding down takes 1 % or less; its value ends at the same
digit (JCGM 100, 7.2.6; ILAC-P14; EA-4/02). No markup.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from decimal import ROUND_CEILING, ROUND_HALF_EVEN, Decimal
from typing import Any

NOTHING = "\N{EN DASH}"
"""Printed in place of a missing value."""
MINUS = "\N{MINUS SIGN}"
_MILLI_FROM_URAD = 1000.0  # Urad: from here on in mrad
_ARCSEC_PER_TENTH_DEGREE = 360.0  # From here on in degrees


_ONE_DECIMAL_UNTIL_S = 9.95  # From here on, one decimal would give 10.0
_DIGITS = 2  # Of an uncertainty (JCGM 100, 7.2.6)
_NEGLIGIBLE = Decimal("0.01")
"""Largest share of U by which rounding down is allowed."""


def round_expanded(expanded: float) -> Decimal:
    """Round an expanded uncertainty above zero to two significant digits, up unless the difference is negligible.

    Its exponent is that of its last digit.

    >>> [str(round_expanded(u)) for u in (2.4106, 2.451, 0.0164, 9.99, 105.0, 0.000123)]
    ['2.4', '2.5', '0.017', '10', '1.1E+2', '0.00013']
    """
    exact = Decimal(repr(float(expanded)))
    if not exact.is_finite() or exact <= 0:
        raise ValueError(expanded)
    last = Decimal(1).scaleb(exact.adjusted() - _DIGITS + 1)
    down = exact.quantize(last, ROUND_HALF_EVEN)
    rounded = down if down >= exact * (1 - _NEGLIGIBLE) else exact.quantize(last, ROUND_CEILING)
    # 9.99 becomes 10.0, which has three digits
    return rounded if rounded.adjusted() == exact.adjusted() else rounded.quantize(last.scaleb(1))


def with_uncertainty(value: float, expanded: float) -> tuple[str, str]:
    """Print a value and its expanded uncertainty, U by `round_expanded`, the value to the same digit.

    If U is not a positive finite number, the value has six significant digits and U is a dash.

    >>> with_uncertainty(3345.0637, 1.2345)
    ('3345.1', '1.3')
    >>> with_uncertainty(-0.89731, 0.0996)
    ('−0.90', '0.10')
    >>> with_uncertainty(3345.06, 123.4)
    ('3350', '130')
    """
    if not (math.isfinite(value) and math.isfinite(expanded) and expanded > 0):
        return number(value, 6), NOTHING
    rounded = round_expanded(expanded)
    digit = int(rounded.as_tuple().exponent)
    return _plain(_to_digit(Decimal(repr(float(value))), digit)), _plain(rounded)


def plus_minus(value: float, expanded: float, unit: str = "") -> str:
    """Print a value, its expanded uncertainty by `with_uncertainty`, and their unit if they have one.

    >>> plus_minus(3345.0637, 1.2345, "px"), plus_minus(0.25, 0.01)
    ('3345.1 ± 1.3 px', '0.250 ± 0.010')
    """
    return f"{' ± '.join(with_uncertainty(value, expanded))} {unit}".rstrip()


def number(value: Any, digits: int = 4) -> str:
    """Print a number with significant digits, without exponent; integers in full, None and infinities as a dash.

    The minus sign is true; narrow spaces stand between thousands of an integer.

    >>> number(0.0812345), number(345), number(-3.0), number(None), number(0.0)
    ('0.08123', '345', '−3.000', '–', '0')
    """
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return NOTHING
    if isinstance(value, int):
        grouped = f"{abs(value):,}".replace(",", "\N{NARROW NO-BREAK SPACE}")
        return f"{MINUS if value < 0 else ''}{grouped}"
    if value == 0:
        return "0"
    exact = Decimal(repr(float(value)))
    return _plain(_to_digit(exact, exact.adjusted() - digits + 1))


def exact(value: float) -> str:
    """Print a number that is known exactly, in its shortest form, with nine significant digits at most.

    >>> exact(3345.06), exact(-0.9), exact(255.0), exact(0.00002)
    ('3345.06', '−0.9', '255', '0.00002')
    """
    return _plain(Decimal(f"{value:.9g}"))


def fixed(value: Any, decimals: int) -> str:
    """Print a number with a fixed number of decimals, never "minus zero"; None and infinities as a dash.

    >>> fixed(-0.0004, 3), fixed(1.23456, 3), fixed(None, 3)
    ('0.000', '1.235', '–')
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    rounded = round(float(value), decimals) + 0.0
    return f"{rounded:.{decimals}f}".replace("-", MINUS)


def angle(arcsec: float) -> str:
    """Print an angle with three significant digits: degrees from 0.1 degrees on, arc seconds below.

    >>> angle(1.83), angle(359.0), angle(360.0), angle(20900.0)
    ('1.83″', '359″', '0.100°', '5.81°')
    """
    if arcsec >= _ARCSEC_PER_TENTH_DEGREE:
        return f"{number(arcsec / 3600, 3)}\N{DEGREE SIGN}"
    return f"{number(arcsec, 3)}\N{DOUBLE PRIME}"


def angle_text(urad: float) -> str:
    """Print a small angle with two significant digits, in µrad, or in mrad from 1000 µrad on.

    >>> angle_text(0.0), angle_text(23.44), angle_text(994.0), angle_text(996.0), angle_text(5123.0)
    ('0 µrad', '23 µrad', '990 µrad', '1.0 mrad', '5.1 mrad')
    """
    # Rounded first: 999.6 µrad is 1.0 mrad.
    rounded = float(f"{urad:.2g}")
    if rounded >= _MILLI_FROM_URAD:
        return f"{number(rounded / 1000.0, 2)} mrad"
    return f"{number(urad, 2)} \N{MICRO SIGN}rad"


def moment(text: str | None) -> str:
    """Print an ISO 8601 time in UTC, to the second; a dash for None and for an empty text.

    >>> moment("2026-03-01T12:00:05.123456Z")
    '2026-03-01 12:00:05 UTC'
    """
    if not text:
        return NOTHING
    return f"{datetime.fromisoformat(text):%Y-%m-%d %H:%M:%S} UTC"


def duration(seconds: float) -> str:
    """Print a duration in ms, s, min or h, as suits its length.

    >>> duration(0.0331), duration(9.94), duration(12.34), duration(754), duration(7300)
    ('33 ms', '9.9 s', '12 s', '12 min 34 s', '2 h 1 min')
    """
    milliseconds, whole = round(1000 * seconds), round(seconds)
    if seconds < _ONE_DECIMAL_UNTIL_S:
        return f"{milliseconds} ms" if milliseconds < 1000 else f"{seconds:.1f} s"
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def value_text(value: Any) -> str:
    """Print any value of results.json in one line; a dash for None and for empty values.

    >>> value_text({"bias_fo": 0, "afk": False}), value_text([1, 2.5]), value_text(None)
    ('bias_fo 0, afk off', '1, 2.500', '–')
    """
    if value is None or value in ("", {}, []):
        return NOTHING
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, int | float):
        return number(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {value_text(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(value_text(item) for item in value)
    return str(value)


def _to_digit(value: Decimal, digit: int) -> Decimal:
    """Round to the decimal digit 10**digit, half to even."""
    return value.quantize(Decimal(1).scaleb(digit), rounding=ROUND_HALF_EVEN)


def _plain(value: Decimal) -> str:
    """Print without exponent, with a true minus sign and no minus zero."""
    text = f"{value:f}"
    return text.removeprefix("-") if not value else text.replace("-", MINUS)
