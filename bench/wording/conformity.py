"""Which limits a calibration keeps, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.wording.numbers import exact, plus_minus
from bench.wording.parameters import unit_text

if TYPE_CHECKING:
    from bench.record.results import Conformity, LimitStatement

_KEPT = {
    "pass": "inside by U or more",
    "conditionalPass": "inside, but by less than U: not proven",
    "conditionalFail": "outside, by U or less",
    "fail": "outside by more than U",
}


def conformity_headline(conformity: Conformity) -> str:
    """Return PASS or FAIL, and how many limits are kept.

    >>> from bench.record.results import Conformity
    >>> conformity_headline(Conformity(passed=True, rule="", statements=[], reasons=[]))
    'PASS: the checked calibration is right.'
    """
    if not conformity.statements:  # a check alone
        if conformity.passed:
            return "PASS: the checked calibration is right."
        return "FAIL: the checked calibration is not right, or a gate failed."
    kept = sum(statement.verdict == "pass" for statement in conformity.statements)
    return f"{'PASS' if conformity.passed else 'FAIL'}: {kept} of {len(conformity.statements)} limits kept."


def conformity_sentences(conformity: Conformity) -> list[str]:
    """Return a sentence for each limit, those that are not kept first, then the other reasons and the decision rule."""
    ordered = sorted(conformity.statements, key=lambda statement: statement.verdict == "pass")
    rule = [f"Decision rule: {conformity.rule}."] if ordered else []
    return [*map(_statement_text, ordered), *conformity.reasons, *rule]


def _statement_text(statement: LimitStatement) -> str:
    name, unit = statement.result, unit_text(statement.result)
    bounds = [("at least", statement.lower), ("at most", statement.upper)]
    limits = " and ".join(f"{word} {exact(bound)}" for word, bound in bounds if bound is not None)
    source = f" by {statement.specification}" if statement.specification else ""
    asked = f"{limits}{' ' if unit else ''}{unit}{source}"
    if statement.value is None or statement.expanded is None:
        return f"{name}: this calibration did not estimate it (limit: {asked})."
    shown = plus_minus(statement.value, statement.expanded, unit)
    return f"{name} {shown} ({asked}): {_KEPT[statement.verdict]}."
