"""Checks of units, uncertainties and digits in a digital calibration certificate, which its schema does not make.

Each function yields one line a fault, with the line of the file. `dcc_covariances` checks covariances and budgets.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from typing import TYPE_CHECKING

from scipy.special import ndtri, stdtrit

from bench.certificate.dcc_reader import number
from bench.certificate.dcc_words import (
    BINARY_PREFIXES,
    BUDGET,
    DEGREES_OF_FREEDOM,
    EARLIER,
    JOINT,
    LIMIT,
    PREFIXES,
    STATISTIC,
    unit_fault,
)
from bench.certificate.dcc_xml import NAMESPACES, qualified, short

if TYPE_CHECKING:
    from lxml.etree import _Element

WITHOUT_UNCERTAINTY = frozenset((STATISTIC, BUDGET, EARLIER, DEGREES_OF_FREEDOM, LIMIT))
"""refTypes of numbers that have no uncertainty of their own."""
_POWER = re.compile(r"tothe\{(-?\d{1,2}(?:[._]\d{1,2})?)\}")
_MOST_DIGITS = 2
_K_TOLERANCE = 0.03
"""Relative difference allowed between k and the quantile: k = 2 is commonly stated with 95 %, for which it is 1.96."""

_UNIT_TAGS = tuple(
    qualified(f"si:{name}") for name in ("unit", "unitXMLList", "listUnit", "unitPhase", "listUnitPhase")
)
_NUMBER_TAGS = tuple(
    qualified(f"si:{name}")
    for name in (
        "value", "valueXMLList", "valueReal", "valueImag", "valueMagnitude", "valuePhase", "uncertainty",
        "uncertaintyXMLList", "coverageFactor", "coverageFactorXMLList", "coverageProbability",
        "coverageProbabilityXMLList", "standardUnc", "standardUncXMLList", "intervalMin", "intervalMinXMLList",
        "intervalMax", "intervalMaxXMLList",
    )
)  # fmt: skip
_LIST_UNCERTAINTIES = (
    "si:expandedUncXMLList",
    "si:coverageIntervalXMLList",
    "si:ellipsoidalRegionXMLList",
    "si:rectangularRegionXMLList",
)


@dataclass(frozen=True)
class StatedResult:
    """A result of a DCC as stated: a quantity with ``si:real`` and an expanded uncertainty, all readable."""

    # id, label: Id of the quantity and label of the number; empty where there is none.
    id: str
    label: str
    line: int
    value: Decimal
    U: Decimal
    unit: str
    k: float
    p: float
    nu: float | None  # Effective degrees of freedom; None if not stated

    @property
    def step(self) -> float:
        """One unit of the last digit of the uncertainty; of its second digit where it is a whole number."""
        exponent = int(self.U.as_tuple().exponent)
        return 10.0 ** (exponent if exponent < 0 else max(exponent, self.U.adjusted() - _MOST_DIGITS + 1))

    @property
    def name(self) -> str:
        """The result's name in messages."""
        return self.label or self.id or "a result"


def line_of(element: _Element) -> int:
    """Return the line of an element in its file.

    Returns: The line; 0 if it is not known.
    """
    line = element.sourceline
    return line if isinstance(line, int) else 0


def stated_results(root: _Element) -> list[StatedResult]:
    """Return the results of a DCC that can be read.

    Returns: The results, in their order; without those of statistics, budgets and earlier calibrations.
    """
    found = []
    for quantity in root.iterfind(".//dcc:result//dcc:quantity", NAMESPACES):
        real = quantity.find("si:real", NAMESPACES)
        if real is None or not _needs_uncertainty(quantity):
            continue
        value, U = number(real.findtext("si:value", None, NAMESPACES)), _expanded(real, "uncertainty")
        k, p = _expanded(real, "coverageFactor"), _expanded(real, "coverageProbability")
        if value is None or U is None or k is None or p is None:
            continue
        nu = number(
            quantity.findtext(
                f"dcc:measurementMetaData/dcc:metaData[@refType='{DEGREES_OF_FREEDOM}']"
                "/dcc:data/dcc:quantity/si:real/si:value",
                None,
                NAMESPACES,
            )
        )
        found.append(
            StatedResult(
                id=quantity.get("id", ""),
                label=real.findtext("si:label", "", NAMESPACES),
                line=line_of(real),
                value=value,
                U=U,
                unit=(real.findtext("si:unit", "", NAMESPACES)).strip(),
                k=float(k),
                p=float(p),
                nu=None if nu is None else float(nu),
            )
        )
    return found


def _expanded(real: _Element, name: str) -> Decimal | None:
    return number(real.findtext(f"si:expandedUnc/si:{name}", None, NAMESPACES))


def _needs_uncertainty(quantity: _Element) -> bool:
    """Return whether a quantity of a result must have an uncertainty."""
    if any(True for _ in quantity.iterancestors(qualified("dcc:metaData"))):
        return False
    return not set(quantity.get("refType", "").split()) & WITHOUT_UNCERTAINTY


def unit_powers(unit: str) -> dict[str, int]:
    r"""Return the units in a unit of D-SI, each with its prefix and its power, to compare units.

    Returns: Power by unit, without ``\one``; empty for text that is not a unit of D-SI.
    """
    found: dict[str, int] = {}
    if unit_fault(unit) is not None:
        return found
    prefix, last, sign = "", "", 1
    for word in unit.split("\\")[1:]:
        power = _POWER.fullmatch(word)
        if power is not None:
            found[last] += sign * (int(float(power[1].replace("_", "."))) - 1)
        elif word == "per":
            sign = -1
        elif word in PREFIXES or word in BINARY_PREFIXES:
            prefix = f"\\{word}"
        else:
            last, prefix = f"{prefix}\\{word}", ""
            found[last] = found.get(last, 0) + sign
    found.pop(r"\one", None)
    return {name: power for name, power in found.items() if power != 0}


def unit_faults(root: _Element) -> Iterator[str]:
    """Yield the units that D-SI does not have. The second and further units of ``si:hybrid`` may be others."""
    for element in root.iter(*_UNIT_TAGS):
        units = (element.text or "").split(" ") if element.tag.endswith("XMLList") else [element.text or ""]
        hybrid = next(element.iterancestors(qualified("si:hybrid")), None)
        for unit in dict.fromkeys(units):
            if hybrid is not None and unit.startswith("|"):
                continue
            if fault := unit_fault(unit):
                yield f"line {element.sourceline}: {short(unit) or 'an empty text'} is not a unit of D-SI: {fault}"
    for hybrid in root.iter(qualified("si:hybrid")):
        texts = [one.text or "" for one in hybrid.iter(*_UNIT_TAGS)]
        if not any(unit_fault(text) is None for text in texts):
            yield f"line {hybrid.sourceline}: the quantity is in no unit of D-SI"


def number_faults(root: _Element) -> Iterator[str]:
    """Yield what should be a number and is none, such as NaN, infinity or a decimal comma."""
    for element in root.iter(*_NUMBER_TAGS):
        texts = (element.text or "").split() if element.tag.endswith("XMLList") else [element.text or ""]
        if not texts:
            yield f"line {element.sourceline}: a list of numbers is empty"
        for text in texts:
            if number(text) is None:
                yield f"line {element.sourceline}: {short(text) or 'an empty text'} is not a finite decimal number"


def missing_uncertainties(root: _Element) -> Iterator[str]:
    """Yield the results that have no uncertainty, or one of zero, and a certificate without any result."""
    stated = 0
    for quantity in root.iterfind(".//dcc:result//dcc:quantity", NAMESPACES):
        if not _needs_uncertainty(quantity):
            continue
        for real in quantity.iterfind(".//si:real", NAMESPACES):
            if next(real.iterancestors(qualified("dcc:quantity"))) is not quantity:
                continue
            stated += 1
            yield from _missing_in_real(real)
        for several in quantity.iterfind(".//si:realListXMLList", NAMESPACES):
            if next(several.iterancestors(qualified("dcc:quantity"))) is quantity:
                stated += JOINT not in quantity.get("refType", "").split()
                if all(several.find(name, NAMESPACES) is None for name in _LIST_UNCERTAINTIES):
                    yield f"line {several.sourceline}: a list of results has no uncertainty"
    if stated == 0:
        yield "there is no result with a number"


def _missing_in_real(real: _Element) -> Iterator[str]:
    label = short(real.findtext("si:label", "", NAMESPACES)) or "a result"
    expanded = real.find("si:expandedUnc", NAMESPACES)
    interval = real.find("si:coverageInterval", NAMESPACES)
    if expanded is None and interval is None:
        yield f"line {real.sourceline}: {label} has no uncertainty"
        return
    name = "si:expandedUnc/si:uncertainty" if expanded is not None else "si:coverageInterval/si:standardUnc"
    found = number(real.findtext(name, None, NAMESPACES))
    if found is not None and found <= 0:
        yield f"line {real.sourceline}: the uncertainty of {label} is {found}; it must be above 0"


def coverage_faults(root: _Element) -> Iterator[str]:
    """Yield coverage factors and probabilities that cannot be, or do not belong together (JCGM 100:2008, annex G)."""
    for tag, least, most in (("coverageFactor", 1.0, math.inf), ("coverageProbability", 0.0, 1.0)):
        for element in root.iter(qualified(f"si:{tag}"), qualified(f"si:{tag}XMLList")):
            for found in filter(None, map(number, (element.text or "").split())):
                if not least <= found <= most:
                    yield f"line {element.sourceline}: {tag} is {found}; it must be from {least:g} to {most:g}"
            if any(number(text) == 0 for text in (element.text or "").split()):
                yield f"line {element.sourceline}: {tag} is 0"
    for one in stated_results(root):
        if not (0.0 < one.p < 1.0 and one.k >= 1.0):
            continue
        if one.nu is not None and one.nu < 1.0:
            yield f"line {one.line}: {one.name} has {one.nu:g} degrees of freedom; the least is 1"
            continue
        quantile = 0.5 * (1.0 + one.p)
        exact = float(ndtri(quantile) if one.nu is None else stdtrit(one.nu, quantile))
        rounded = exact if one.nu is None else float(stdtrit(math.floor(one.nu), quantile))
        if all(abs(one.k - each) > _K_TOLERANCE * each for each in (exact, rounded)):
            degrees = "infinite" if one.nu is None else f"{one.nu:g}"
            yield (
                f"line {one.line}: k = {one.k:g} of {one.name} does not belong to p = {one.p:g} and"
                f" {degrees} degrees of freedom, for which k is {exact:.2f}"
            )


def digit_faults(root: _Element) -> Iterator[str]:
    """Yield results whose U has too many digits, or whose value ends at another digit (JCGM 100:2008, 7.2.6)."""
    for one in stated_results(root):
        digits, exponent = list(one.U.as_tuple().digits), int(one.U.as_tuple().exponent)
        while exponent >= 0 and len(digits) > 1 and digits[-1] == 0:
            digits.pop()
        if len(digits) > _MOST_DIGITS:
            yield f"line {one.line}: U = {one.U} of {one.name} has {len(digits)} digits; {_MOST_DIGITS} are the most"
        if one.value.as_tuple().exponent != exponent:
            yield f"line {one.line}: {one.name} = {one.value} and U = {one.U} do not end at the same digit"
