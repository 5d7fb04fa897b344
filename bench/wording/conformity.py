"""Which limits a calibration keeps, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.wording.numbers import exact, with_uncertainty
from bench.wording.parameters import unit_text

if TYPE_CHECKING:
    from bench.record.results import ConformityData, StatementData

_KEPT = {
    "pass": "inside by U or more",
    "conditionalPass": "inside, but by less than U: not proven",
    "conditionalFail": "outside, by U or less",
    "fail": "outside by more than U",
}


def conformity_headline(found: ConformityData) -> str:
    """Return PASS or FAIL, and how many limits are kept.

    >>> conformity_headline({"passed": True, "rule": "", "statements": [], "reasons": []})
    'PASS: the checked calibration is right.'
    """
    if not found["statements"]:  # a check alone
        return (
            "PASS: the checked calibration is right."
            if found["passed"]
            else "FAIL: the checked calibration is not right, or a gate failed."
        )
    kept = sum(one["verdict"] == "pass" for one in found["statements"])
    return f"{'PASS' if found['passed'] else 'FAIL'}: {kept} of {len(found['statements'])} limits kept."


def conformity_sentences(found: ConformityData) -> list[str]:
    """Return a sentence for each limit, those that are not kept first, then the other reasons and the decision rule."""
    ordered = sorted(found["statements"], key=lambda one: one["verdict"] == "pass")
    rule = [f"Decision rule: {found['rule']}."] if ordered else []
    return [*map(_statement_text, ordered), *found["reasons"], *rule]


def _statement_text(one: StatementData) -> str:
    name, unit = one["result"], unit_text(one["result"])
    bounds = [("at least", one["lower"]), ("at most", one["upper"])]
    limits = " and ".join(f"{word} {exact(bound)}" for word, bound in bounds if bound is not None)
    asked = (
        f"{limits}{' ' if unit else ''}{unit}{' by ' if one['specification'] else ''}{one['specification']}"
    )
    if one["value"] is None or one["expanded"] is None:
        return f"{name}: this calibration did not estimate it (limit: {asked})."
    value, expanded = with_uncertainty(one["value"], one["expanded"])
    return f"{name} {value} ± {expanded}{' ' if unit else ''}{unit} ({asked}): {_KEPT[one['verdict']]}."
