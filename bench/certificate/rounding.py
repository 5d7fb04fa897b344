"""Values and uncertainties as a certificate prints them: U with two significant digits, the value to the same digit.

JCGM 100, 7.2.6 and EA-4/02: at most two significant digits of U. U is rounded up, unless it would be rounded down by
1 % or less. The results are decimal texts with ``-`` and a point, so that PDF and DCC print the same.
"""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_HALF_EVEN, Decimal

DIGITS = 2
_NEGLIGIBLE = Decimal("0.01")
"""Largest share of U by which rounding down is allowed."""


def round_expanded(expanded: float) -> Decimal:
    """Round an expanded uncertainty to two significant digits, up unless the difference is negligible.

    Returns: The rounded uncertainty; its exponent is that of its last digit.
    Raises ValueError: If it is not above zero.

    Examples
    --------
    >>> [str(round_expanded(one)) for one in (2.4106, 2.451, 0.0164, 9.99, 105.0, 0.000123)]
    ['2.4', '2.5', '0.017', '10', '1.1E+2', '0.00013']
    """
    exact = Decimal(repr(float(expanded)))
    if not exact.is_finite() or exact <= 0:
        raise ValueError(expanded)
    last = Decimal(1).scaleb(exact.adjusted() - DIGITS + 1)
    down = exact.quantize(last, ROUND_HALF_EVEN)
    rounded = down if down >= exact * (1 - _NEGLIGIBLE) else exact.quantize(last, ROUND_CEILING)
    # 9.99 becomes 10.0, which has three digits
    return rounded if rounded.adjusted() == exact.adjusted() else rounded.quantize(last.scaleb(1))


def printed(number: Decimal) -> str:
    """Return a decimal number without an exponent.

    Examples
    --------
    >>> printed(Decimal("1.1E+2"))
    '110'
    """
    return f"{number:f}"


def print_result(value: float, expanded: float) -> tuple[str, str]:
    """Return a value and its expanded uncertainty as printed, both to the same digit.

    Raises ValueError: If a number is not finite, or the uncertainty not above zero.

    Examples
    --------
    >>> print_result(3346.4271, 2.4106)
    ('3346.4', '2.4')
    >>> print_result(-0.00004, 0.0164)
    ('0.000', '0.017')
    """
    uncertainty = round_expanded(expanded)
    exact = Decimal(repr(float(value)))
    if not exact.is_finite():
        raise ValueError(value)
    rounded = _to_digit_of(exact, uncertainty)
    return printed(abs(rounded) if rounded == 0 else rounded), printed(uncertainty)


def _to_digit_of(exact: Decimal, uncertainty: Decimal) -> Decimal:
    """Round to the last digit of the uncertainty, which may be tens or hundreds."""
    step = Decimal(1).scaleb(int(uncertainty.as_tuple().exponent))
    return (exact / step).quantize(Decimal(1), ROUND_HALF_EVEN) * step


def print_plain(value: float, digits: int = 2) -> str:
    """Return a number with some significant digits, without an exponent.

    Examples
    --------
    >>> [print_plain(one) for one in (0.61023, 0.08094, 174.05, 0.0)]
    ['0.61', '0.081', '170', '0']
    """
    exact = Decimal(repr(float(value)))
    if exact == 0:
        return "0"
    step = Decimal(1).scaleb(exact.adjusted() - digits + 1)
    return printed((exact / step).quantize(Decimal(1), ROUND_HALF_EVEN) * step)


def with_unit(text: str, unit: str) -> str:
    """Return a number with its unit; nothing is written for the unit one.

    unit: ``px``, ``mm``, ``1`` or another unit.
    """
    return text if unit == "1" else f"{text} {unit}"
