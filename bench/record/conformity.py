"""Whether results keep the limits that were set for them.

A limit is kept only if the value is inside by U or more: w = U (ILAC-G8:09/2019, 4.2.2 and 4.2.3; ISO 14253-1), for
PASS or FAIL of a run as for a certificate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import TYPE_CHECKING

from bench.record.results import Conformity, LimitStatement, Verdict

if TYPE_CHECKING:
    from calib.calibration import Calibration
    from sequences.schema import ResultLimitConfig


RULE = "guard band w = U (ILAC-G8:09/2019, 4.2.2; ISO 14253-1)"
NO_CONVERGENCE = "The optimisation did not converge."


def verdict_of(value: str, expanded: str, lower: float | None, upper: float | None) -> Verdict:
    """Return ``pass``, ``conditionalPass``, ``conditionalFail`` or ``fail`` for a value; None stands for no limit.

    >>> [verdict_of(value, "2", 0.0, 10.0) for value in ("5", "8", "9", "10", "11", "12", "13")]
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


def conformity(
    calibration: Calibration,
    limits: Mapping[str, Sequence[ResultLimitConfig]],
    failed_gates: Sequence[str],
    *,
    checks: bool = False,
) -> Conformity | None:
    """Return PASS or FAIL of a run with limits, or one that ``checks`` a calibration; ``failed_gates`` count."""
    statements = [_statement(calibration, by, rule) for by, rules in limits.items() for rule in rules]
    if not statements and not checks:
        return None
    reasons = [*([] if calibration.converged else [NO_CONVERGENCE])]
    reasons += [f"The gate {name} failed." for name in failed_gates]
    kept = all(statement.verdict == "pass" for statement in statements)
    return Conformity(kept and not reasons, RULE, statements, reasons)


def _statement(calibration: Calibration, stated_by: str, rule: ResultLimitConfig) -> LimitStatement:
    name = rule.result
    value = expanded = None
    verdict: Verdict = "fail"
    if calibration.U.get(name, 0.0) > 0:
        value, expanded = calibration.values[name], calibration.U[name]
        verdict = verdict_of(repr(value), repr(expanded), rule.lower, rule.upper)
    return LimitStatement(
        name, rule.specification, stated_by, rule.lower, rule.upper, value, expanded, verdict
    )
