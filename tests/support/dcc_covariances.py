"""Checks of covariance matrices and budgets in a digital calibration certificate, and of the results against them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from dcc_numbers import StatedResult, line_of, stated_results, unit_powers
from numpy.typing import NDArray
from scipy.special import chdtri

from bench.certificate.dcc_reader import number
from bench.certificate.dcc_words import BUDGET, COMBINED, CONTRIBUTION, JOINT, product
from bench.certificate.dcc_xml import NAMESPACES, qualified, short

if TYPE_CHECKING:
    from lxml.etree import _Element

_ASYMMETRY = 1e-9
_MOST_SIZE = 500
_BUDGET_TOLERANCE = 0.01


def covariance_faults(root: _Element) -> Iterator[str]:
    """Yield covariance matrices that are not complete, not symmetric or not positive semi-definite.

    A list of results with a matrix is also compared with the results that it names: labels, values, units, and U
    against k times the square root of the diagonal.
    """
    for region in root.iter(*(qualified(f"si:{name}") for name in _REGIONS)):
        matrix = region.find("si:covarianceMatrix", NAMESPACES)
        several = region.getparent()
        if matrix is None or several is None:
            continue
        size = _size(several)
        if size == 0:  # a complex number or a list of another kind: two numbers each
            continue
        faults = list(_shape_faults(matrix, size))
        yield from faults
        if not faults:
            yield from _content_faults(matrix, _units(several, size))
            yield from _region_faults(region, size)
    yield from _joint_faults(root)


_REGIONS = (
    "ellipsoidalRegion",
    "rectangularRegion",
    "ellipsoidalRegionXMLList",
    "rectangularRegionXMLList",
)


def _size(several: _Element) -> int:
    """Return how many numbers a list has; 0 for a list of another kind."""
    if several.tag == qualified("si:realListXMLList"):
        return len(several.findtext("si:valueXMLList", "", NAMESPACES).split())
    return len(several.findall("si:real", NAMESPACES)) if several.tag == qualified("si:realList") else 0


def _units(several: _Element, size: int) -> list[str]:
    """Return the unit of each number of a list; empty if they cannot be told."""
    units = several.findtext("si:unitXMLList", "", NAMESPACES).split()
    if len(units) == 1:
        return units * size
    return units if len(units) == size else []


def _shape_faults(matrix: _Element, size: int) -> Iterator[str]:
    """Yield what is missing in a matrix, and elements that are no numbers."""
    columns = matrix.findall("si:column", NAMESPACES)
    if size > _MOST_SIZE:
        yield f"line {matrix.sourceline}: the covariance has {size} rows; at most {_MOST_SIZE} are checked"
        return
    if len(columns) != size:
        yield f"line {matrix.sourceline}: the covariance has {len(columns)} columns for {size} results"
    for column in columns:
        rows = column.findall("si:covariance", NAMESPACES)
        if len(rows) != size:
            yield f"line {column.sourceline}: the column of the covariance has {len(rows)} rows for {size} results"
        for row in rows:
            if number(row.findtext("si:value", None, NAMESPACES)) is None:
                text = short(row.findtext("si:value", "", NAMESPACES)) or "an empty text"
                yield f"line {row.sourceline}: {text} in the covariance is not a finite decimal number"


def _values(matrix: _Element) -> NDArray[np.float64]:
    """Return a complete matrix as an array, row by row."""
    return np.array(
        [
            [
                float(row.findtext("si:value", "nan", NAMESPACES))
                for row in column.iterfind("si:covariance", NAMESPACES)
            ]
            for column in matrix.iterfind("si:column", NAMESPACES)
        ]
    ).T


def _content_faults(matrix: _Element, units: Sequence[str]) -> Iterator[str]:
    """Yield what is wrong in a complete matrix."""
    values, line = _values(matrix), matrix.sourceline
    diagonal = np.diag(values)
    if np.any(diagonal <= 0.0):
        yield f"line {line}: the diagonal of the covariance has {diagonal.min():g}; it must be above 0"
        return
    sigma = np.sqrt(diagonal)
    correlation = values / sigma[:, None] / sigma[None, :]
    if np.max(np.abs(correlation - correlation.T)) > _ASYMMETRY:
        yield f"line {line}: the covariance is not symmetric"
    elif (least := float(np.linalg.eigvalsh(0.5 * (correlation + correlation.T)).min())) < -_ASYMMETRY:
        yield f"line {line}: the covariance is not positive semi-definite: its least eigenvalue is {least:.2g}"
    for column, first in zip(matrix.iterfind("si:column", NAMESPACES), units, strict=False):
        for row, second in zip(column.iterfind("si:covariance", NAMESPACES), units, strict=False):
            stated = row.findtext("si:unit", "", NAMESPACES)
            if unit_powers(stated) != unit_powers(product(first, second)):
                yield (
                    f"line {row.sourceline}: the unit {short(stated)} in the covariance is not {short(first)} times"
                    f" {short(second)}"
                )


def _region_faults(region: _Element, size: int) -> Iterator[str]:
    """Yield an ellipsoid whose coverage factor is too small for its number of results (JCGM 102:2011, 6.5)."""
    k = number(region.findtext("si:coverageFactor", None, NAMESPACES))
    p = number(region.findtext("si:coverageProbability", None, NAMESPACES))
    if k is None or p is None or not 0 < p < 1 or "ellipsoidal" not in region.tag:
        return
    least = float(np.sqrt(chdtri(size, 1.0 - float(p))))
    if float(k) < 0.97 * least:
        yield (
            f"line {region.sourceline}: the coverage factor {k} of the ellipsoid is too small for {size} results and"
            f" p = {p}; the least is {least:.2f}"
        )


def _joint_faults(root: _Element) -> Iterator[str]:
    """Yield where the list of results with the joint covariance disagrees with the results themselves."""
    results = {one.id: one for one in stated_results(root) if one.id}
    lists = [
        one for one in root.iterfind(".//dcc:quantity", NAMESPACES) if JOINT in one.get("refType", "").split()
    ]
    if not lists:
        if len(results) > 1 and any("starbench" in one.get("refType", "") for one in root.iter()):
            yield "the results have no joint covariance"
        return
    for quantity in lists:
        several = quantity.find("si:realListXMLList", NAMESPACES)
        if several is None:
            yield f"line {quantity.sourceline}: the joint covariance has no list of results"
            continue
        yield from _against_results(quantity, several, results)


def _against_results(
    quantity: _Element, several: _Element, results: dict[str, StatedResult]
) -> Iterator[str]:
    line = line_of(several)
    ids = quantity.get("refId", "").split()
    labels = several.findtext("si:labelXMLList", "", NAMESPACES).split()
    values = several.findtext("si:valueXMLList", "", NAMESPACES).split()
    if several.find("si:ellipsoidalRegionXMLList/si:covarianceMatrix", NAMESPACES) is None:
        yield f"line {line}: the joint list of the results has no covariance"
        return
    if not len(ids) == len(labels) == len(values):
        yield f"line {line}: the joint list has {len(ids)} references, {len(labels)} labels and {len(values)} values"
        return
    for missing in sorted(set(results) - set(ids)):
        yield f"line {line}: the joint covariance lacks {results[missing].name}"
    units = _units(several, len(values))
    matrix = several.find("si:ellipsoidalRegionXMLList/si:covarianceMatrix", NAMESPACES)
    complete = matrix is not None and not list(_shape_faults(matrix, len(values)))
    diagonal = np.diag(_values(matrix)) if complete and matrix is not None else None
    for at, (id_, label, text) in enumerate(zip(ids, labels, values, strict=True)):
        one = results.get(id_)
        if one is None:
            continue
        yield from _member_faults(one, line, label, text, units[at] if units else one.unit)
        if diagonal is not None and diagonal[at] > 0:
            expanded = one.k * float(np.sqrt(diagonal[at]))
            if not expanded - 0.51 * one.step <= float(one.U) <= 1.001 * expanded + one.step:
                yield (
                    f"line {line}: U = {one.U} of {one.name} is not k times the root of the diagonal of the"
                    f" covariance, {expanded:.3g}"
                )


def _member_faults(one: StatedResult, line: int, label: str, text: str, unit: str) -> Iterator[str]:
    """Yield where a member of the joint list differs from its result."""
    value = number(text)
    if label != one.label:
        yield f"line {line}: the joint list calls {one.name} {short(label)}"
    if unit != one.unit:
        yield f"line {line}: the joint list has {one.name} in {short(unit)}, the result in {short(one.unit)}"
    if value is not None and abs(float(value - one.value)) > 0.51 * one.step:
        yield f"line {line}: {one.name} is {one.value} as a result and {value} in the joint list"


def budget_faults(root: _Element) -> Iterator[str]:
    """Yield budgets whose rows do not add up, or not to the uncertainty of their result (JCGM 100:2008, 5.1)."""
    results = {one.id: one for one in stated_results(root) if one.id}
    for budget in root.iterfind(".//dcc:result[@refId]", NAMESPACES):
        named = results.get(budget.get("refId", ""))
        rows, combined = _numbers(budget, CONTRIBUTION), _numbers(budget, COMBINED)
        if named is not None and rows and combined:
            yield from _sum_faults(line_of(budget), named, math.hypot(*rows), combined[0])


def _sum_faults(line: int, result: StatedResult, summed: float, combined: float) -> Iterator[str]:
    if abs(summed - combined) > _BUDGET_TOLERANCE * combined:
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
