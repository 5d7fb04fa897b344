"""The uncertainty budget of each result, from the engine's budget and the certificates behind it, and as printed.

U = k u is that of results.json. U has two significant digits and is rounded up, unless rounding down takes 1 % or less
(JCGM 100, 7.2.6; EA-4/02).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from bench.base.errors import EvidenceError
from bench.extras.certificate.certificate_data import Budget, BudgetRow
from bench.record.results import CalibrationData
from bench.record.run_folder import RESULTS
from bench.report.calibration_tables import overlap
from bench.wording.numbers import MINUS, number, with_uncertainty
from calib.model import result_parts
from calib.model.result_parts import COVERAGE, PASSPORT
from calib.uncertainty.covariance import coverage_factor

_SAME = 1e-3
"""Largest relative difference between the combined rows and the stated uncertainty: below its last printed digit."""
_OVERLAP = (
    "All sources act together in one joint adjustment. The engine splits the combined uncertainty by source, so that"
    " the squares of the rows add up to u squared. A sensitivity is the contribution over the standard uncertainty of"
    " the stated value; a row without a stated value has none."
)


class BudgetDiffers(EvidenceError):
    """The rows of a budget do not give the uncertainty that is stated."""


def print_result(value: float, expanded: float) -> tuple[str, str]:
    """Return a finite value and its expanded uncertainty, above zero, as printed, both to the same digit.

    >>> print_result(3346.4271, 2.4106)
    ('3346.4', '2.4')
    >>> print_result(-0.00004, 0.0164)
    ('0.000', '0.017')
    """
    if not (math.isfinite(value) and math.isfinite(expanded) and expanded > 0):
        raise ValueError((value, expanded))
    shown, uncertainty = with_uncertainty(value, expanded)
    return _plain(shown), _plain(uncertainty)


def print_plain(value: float) -> str:
    """Return a number with two significant digits, without an exponent.

    >>> [print_plain(value) for value in (0.61023, 0.08094, 174.05, 0.0)]
    ['0.61', '0.081', '170', '0']
    """
    return _plain(number(float(value), 2))


def _plain(text: str) -> str:
    """Return a printed number with the minus sign of a computer."""
    return text.replace(MINUS, "-")


def with_unit(text: str, unit: str) -> str:
    """Return a number with its unit; nothing is written for the unit ``1``."""
    return text if unit == "1" else f"{text} {unit}"


@dataclass(frozen=True)
class RowSource:
    """The certificate behind a row."""

    number: str = ""  # Of the certificate; empty where not stated
    date: str = ""  # Of the certificate; empty where not stated
    sha256: str = ""  # Of its file; empty where not stated
    value: float | None = None  # Uncertainty as the certificate states it; None to take the engine's
    divisor: float | None = None  # Coverage factor; None to take the engine's
    unit: str = ""  # Of the value


@dataclass(frozen=True)
class Expanded:
    """The uncertainty of a result."""

    u: float  # Standard uncertainty
    nu_eff: float | None  # Effective degrees of freedom; None for infinite
    k: float  # Coverage factor

    @property
    def U(self) -> float:  # noqa: N802 - the field's symbol
        """Expanded uncertainty."""
        return self.k * self.u


def expanded(calibration: CalibrationData, symbol: str) -> Expanded:
    """Return a result's uncertainty: with the k of its posterior, or the common one of a method of reference."""
    sigma = float(calibration["sigma"][symbol])
    if own_factors := calibration.get("coverage_factors"):  # of a posterior: there are no degrees of freedom
        return Expanded(sigma, None, float(own_factors[symbol]))
    return Expanded(sigma, _freedom_of_views(calibration), float(calibration["coverage_factor"]))


def budget_of(
    calibration: CalibrationData,
    symbol: str,
    unit: str,
    sources: Mapping[str, RowSource],
    rounded: float,
) -> Budget:
    """Return the uncertainty budget of a result; `EvidenceError` if it is missing or its rows do not add up."""
    stated = expanded(calibration, symbol)
    of_engine = {row.name: row for row in calibration["budget_rows"]}
    rows = [
        _row(
            of_engine.get(name, result_parts.BudgetRow(name, "B", "")),
            symbol,
            unit,
            by_symbol.get(symbol, 0.0),
            stated,
            sources,
        )
        for name, by_symbol in calibration["budget"].items()
    ]
    combined = math.sqrt(sum(row.u**2 for row in rows))
    if not abs(combined - stated.u) <= _SAME * stated.u:
        raise BudgetDiffers(
            f"The rows of the uncertainty budget of {symbol} give u = {combined:.4g} {unit}, but {stated.u:.4g} is"
            " stated.",
            where=RESULTS,
        )
    remarks = [_OVERLAP, *filter(None, [overlap(calibration)])]
    if stated.nu_eff is not None:
        remarks.append(
            f"The rows with {stated.nu_eff:.3g} degrees of freedom rest on the same differences between views: count"
            " them as one row."
        )
    return Budget(
        symbol,
        unit,
        tuple(row for row in rows if row.u > 0),
        u=nine_digits(stated.u),
        nu_eff=None if stated.nu_eff is None else nine_digits(stated.nu_eff),
        k=nine_digits(stated.k),
        U=rounded,
        remarks=tuple(remarks),
    )


def _row(
    of_engine: result_parts.BudgetRow,
    symbol: str,
    unit: str,
    u: float,
    whole: Expanded,
    sources: Mapping[str, RowSource],
) -> BudgetRow:
    """Return the row of a source of the engine's budget; an earlier version's has a variance alone."""
    name = of_engine.name
    source = sources.get(name, RowSource())
    value, divisor, value_unit = _stated_value(of_engine, source)
    has_value = bool(value) and bool(divisor)
    sensitivity = u * divisor / value if has_value and value and divisor else None
    if sensitivity is not None and of_engine.sensitivity.get(symbol, 0.0) < 0:
        sensitivity = -sensitivity
    base = value_unit.partition(" ")[0]
    is_stated = of_engine.divisor is not None and name != PASSPORT
    nu = of_engine.degrees_of_freedom if is_stated else whole.nu_eff
    return BudgetRow(
        name=name,
        type=of_engine.type,
        value=value if has_value else None,
        unit=value_unit if has_value else "",
        distribution=of_engine.distribution,
        divisor=nine_digits(divisor) if has_value and divisor else None,
        sensitivity=None if sensitivity is None else nine_digits(sensitivity),
        sensitivity_unit=(unit if base == "1" else f"{unit}/{base}") if has_value else "",
        u=nine_digits(u),
        share=nine_digits((u / whole.u) ** 2) if whole.u > 0 else 0.0,
        nu=None if nu is None else nine_digits(float(nu)),
        source=of_engine.source or "joint adjustment",
        number=source.number,
        date=source.date,
        sha256=source.sha256,
    )


def _stated_value(row: result_parts.BudgetRow, source: RowSource) -> tuple[float | None, float | None, str]:
    """Return the stated value of a row with divisor and unit. A passport's is not the engine's."""
    if source.value is not None:
        return source.value, source.divisor, source.unit
    if row.name == PASSPORT or row.value is None or row.divisor is None:
        return None, None, ""
    return row.value, row.divisor, row.unit


def _freedom_of_views(calibration: CalibrationData) -> float | None:
    """Return the degrees of freedom that belong to the k of a method of reference; None for infinite."""
    from scipy import special

    k = float(calibration["coverage_factor"])
    if abs(coverage_factor(math.inf) - k) < _SAME:
        return None
    return float(special.stdtridf(0.5 + 0.5 * COVERAGE, k))


def nine_digits(number: float) -> float:
    """Return a calculated number with nine digits, so that another processor calculates the same text."""
    return float(f"{number:.9g}")
