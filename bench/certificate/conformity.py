"""Statements of conformity: value, limits and guard band, in the four words of the DCC. Decimal numbers only.

The guard band is the expanded uncertainty, w = U (ILAC-G8:09/2019, 4.2.2 and 4.2.3). The decision uses the printed
numbers, so that a reader can repeat it.
"""

from __future__ import annotations

from decimal import Decimal

from bench.certificate.lab_config import RuleConfig
from bench.certificate.result_data import Conformity, Result, Verdict

RULE = (
    "Decision rule: guard band w = U, the expanded uncertainty; the printed numbers count. pass: the value lies inside"
    " the limits by U or more. conditionalPass: inside the limits, but by less than U. conditionalFail: outside the"
    " limits, by U or less. fail: outside the limits by more than U. (ILAC-G8, guarded acceptance and rejection.)"
)


def verdict_of(value: str, expanded: str, lower: float | None, upper: float | None) -> Verdict:
    """Return the verdict on a value.

    lower, upper: Limits; None where there is none.
    Returns: ``pass``, ``conditionalPass``, ``conditionalFail`` or ``fail``.

    Examples
    --------
    >>> [verdict_of(one, "2", 0.0, 10.0) for one in ("5", "8", "9", "10", "11", "12", "13")]
    ['pass', 'pass', 'conditionalPass', 'conditionalPass', 'conditionalFail', 'conditionalFail', 'fail']
    """
    band = Decimal(expanded)
    inside = min(
        (Decimal(repr(upper)) - Decimal(value)) if upper is not None else Decimal("Infinity"),
        (Decimal(value) - Decimal(repr(lower))) if lower is not None else Decimal("Infinity"),
    )
    if inside >= band:
        return "pass"
    if inside >= 0:
        return "conditionalPass"
    return "conditionalFail" if inside >= -band else "fail"


def conformity_of(rule: RuleConfig, result: Result) -> Conformity:
    """Return the statement of conformity of a result."""
    return Conformity(
        symbol=result.symbol,
        specification=rule.specification,
        lower=rule.lower,
        upper=rule.upper,
        unit=result.unit,
        guard_band=result.U,
        rule=RULE,
        verdict=verdict_of(result.printed_value, result.printed_uncertainty, rule.lower, rule.upper),
    )
