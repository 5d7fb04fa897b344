"""Checks of the uncertainty budgets in a digital calibration certificate of Starbench: their rows must give U."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from bench.certificate.dcc_numbers import StatedResult, line_of, number, stated_results
from bench.certificate.dcc_words import BUDGET, COMBINED, CONTRIBUTION
from bench.certificate.dcc_xml import NAMESPACES

if TYPE_CHECKING:
    from lxml.etree import _Element

_TOLERANCE = 0.01


def budget_faults(root: _Element) -> Iterator[str]:
    """Yield budgets whose rows do not add up, or not to the uncertainty of their result (JCGM 100:2008, 5.1)."""
    results = {one.id: one for one in stated_results(root) if one.id}
    for budget in root.iterfind(".//dcc:result[@refId]", NAMESPACES):
        named = results.get(budget.get("refId", ""))
        rows, combined = _numbers(budget, CONTRIBUTION), _numbers(budget, COMBINED)
        if named is not None and rows and combined:
            yield from _faults(line_of(budget), named, math.hypot(*rows), combined[0])


def _faults(line: int, result: StatedResult, summed: float, combined: float) -> Iterator[str]:
    if abs(summed - combined) > _TOLERANCE * combined:
        yield (
            f"line {line}: the rows of the budget of {result.name} add up to {summed:.4g}, but the combined standard"
            f" uncertainty is {combined:.4g}"
        )
    expanded = result.k * combined
    if not expanded - 0.51 * result.step <= float(result.U) <= 1.001 * expanded + result.step:
        yield (
            f"line {line}: U = {result.U} of {result.name} is not k times the combined standard uncertainty of its"
            f" budget, {expanded:.3g}"
        )


def _numbers(budget: _Element, name: str) -> list[float]:
    """Return the numbers of a budget that have a name."""
    found = []
    for quantity in budget.iterfind(f".//dcc:quantity[@refType='{BUDGET}']", NAMESPACES):
        if quantity.findtext("dcc:name/dcc:content", "", NAMESPACES) == name:
            value = number(quantity.findtext("si:real/si:value", None, NAMESPACES))
            found += [] if value is None else [float(value)]
    return found
