"""The uncertainty budget of each result, from the engine's budget and the certificates behind it, and as printed.

Each result has its own degrees of freedom and its own k (JCGM 100, G.4); U = k u is that of results.json. U has two
significant digits and is rounded up, unless rounding down takes 1 % or less (JCGM 100, 7.2.6; EA-4/02).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, Decimal
from typing import Any, Literal

from bench.base.errors import EvidenceError
from bench.extras.certificate.certificate_data import Budget, BudgetRow
from bench.record.results import BudgetRowData, CalibrationData
from bench.report.calibration_tables import overlap
from bench.wording.numbers import round_expanded
from calib.model.result_parts import COMMON_FIELD, PASSPORT, POSE_FIELDS, PRIORS, READINGS, STARS
from calib.uncertainty.covariance import coverage_factor

_CERTAIN = (PASSPORT, PRIORS)
"""Sources of the adjustment whose variance is known: their degrees of freedom are infinite."""
_TYPE_A = (STARS, POSE_FIELDS, COMMON_FIELD)
_SAME = 1e-3
"""Largest relative difference between the combined rows and the stated uncertainty: below its last printed digit."""
_OVERLAP = (
    "All sources act together in one joint adjustment. The engine splits the combined uncertainty by source, so that"
    " the squares of the rows add up to u squared. A sensitivity is the contribution over the standard uncertainty of"
    " the stated value; a row without a stated value has none."
)

_SOURCES = {
    STARS: "residuals of the stars, with the gimbal's readings if there are any",
    POSE_FIELDS: "differences between the views",
    COMMON_FIELD: "residuals that all views share",
    PRIORS: "station, and expected sizes",
}


def printed(number: Decimal) -> str:
    """Return a decimal number without an exponent.

    >>> printed(Decimal("1.1E+2"))
    '110'
    """
    return f"{number:f}"


class BudgetDiffers(EvidenceError):
    """The rows of a budget do not give the uncertainty that is stated."""


def print_result(value: float, expanded: float) -> tuple[str, str]:
    """Return a finite value and its expanded uncertainty, above zero, as printed, both to the same digit.

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


def print_plain(value: float) -> str:
    """Return a number with two significant digits, without an exponent.

    >>> [print_plain(one) for one in (0.61023, 0.08094, 174.05, 0.0)]
    ['0.61', '0.081', '170', '0']
    """
    exact = Decimal(repr(float(value)))
    if exact == 0:
        return "0"
    step = Decimal(1).scaleb(exact.adjusted() - 1)
    return printed((exact / step).quantize(Decimal(1), ROUND_HALF_EVEN) * step)


def with_unit(text: str, unit: str) -> str:
    """Return a number with its unit; nothing is written for the unit ``1``."""
    return text if unit == "1" else f"{text} {unit}"


@dataclass(frozen=True)
class RowSource:
    """The certificate behind a row."""

    # number, date, sha256: Number and date of the certificate, and SHA-256 of it; empty where not stated.
    number: str = ""
    date: str = ""
    sha256: str = ""
    # value, divisor, unit: Uncertainty as the certificate states it, its divisor (coverage factor) and unit;
    # None to take the engine's.
    value: float | None = None
    divisor: float | None = None
    unit: str = ""


@dataclass(frozen=True)
class Expanded:
    """The uncertainty of a result with its own degrees of freedom."""

    # u, nu_eff, k: Standard uncertainty, effective degrees of freedom (None for infinite), coverage factor.
    u: float
    nu_eff: float | None
    k: float
    growth: float  # The factor by which results.json enlarges u; at least 1

    @property
    def U(self) -> float:  # noqa: N802 - the field's symbol
        """Expanded uncertainty."""
        return self.k * self.u


def row_names(calibration: CalibrationData) -> list[str]:
    """Return the names of the rows, to which certificates can be assigned."""
    return [str(row["name"]) for row in calibration["budget_rows"]]


def expanded(calibration: CalibrationData, symbol: str) -> Expanded:
    """Return a result's uncertainty with its own degrees of freedom (Welch and Satterthwaite, JCGM 100, G.4.1).

    All sources of the adjustment that are not known beforehand are evaluated together, so they count as one.
    """
    if own_factors := calibration.get(
        "coverage_factors"
    ):  # of the posterior: there are no degrees of freedom
        return Expanded(float(calibration["sigma"][symbol]), None, float(own_factors[symbol]), 1.0)
    k = float(calibration["coverage_factor"])
    common = _common_freedom(calibration, k)
    own = _welch_satterthwaite(calibration, symbol, _freedom_of_views(calibration, common))
    nu = min(own, common)
    k_own = k if nu >= common else coverage_factor(nu)
    growth = max(k_own / k, 1.0)
    sigma = float(calibration["sigma"][symbol])
    return Expanded(sigma / growth, nu if math.isfinite(nu) else None, k * growth, growth)


def budget_of(
    calibration: CalibrationData,
    symbol: str,
    unit: str,
    sources: Mapping[str, RowSource],
    rounded: float,
) -> Budget:
    """Return the uncertainty budget of a result; `EvidenceError` if it is missing or its rows do not add up."""
    stated = expanded(calibration, symbol)
    spread = _spread_freedom(calibration)
    rows = []
    split = _Split(calibration, symbol, unit, sources, stated.u)
    for group, by_symbol in calibration["budget"].items():
        variance = (float(by_symbol.get(symbol, 0.0)) / stated.growth) ** 2
        nu = None if group in _CERTAIN or group in _terms(calibration["budget_rows"]) else spread
        rows += split.rows(group, variance, nu)
    combined = math.sqrt(sum(row.u**2 for row in rows))
    if not abs(combined - stated.u) <= _SAME * stated.u:
        raise BudgetDiffers(
            f"The rows of the uncertainty budget of {symbol} give u = {combined:.4g} {unit}, but {stated.u:.4g} is"
            " stated.",
            where="results.json",
        )
    remarks = [_OVERLAP, *filter(None, [overlap(calibration)])]
    if spread is not None and math.isfinite(spread):
        remarks.append(
            f"The rows with {spread:.3g} degrees of freedom rest on the same differences between views; the formula of"
            " Welch and Satterthwaite counts them as one row."
        )
    if stated.growth > 1.0 + 1e-9:
        sigma = float(calibration["sigma"][symbol])
        remarks.append(
            f"results.json states u = {with_unit(f'{sigma:.4g}', unit)} with the common coverage factor"
            f" k = {float(calibration['coverage_factor']):.3g}; here u and k are those of this result's own degrees of"
            " freedom. U is the same."
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


@dataclass(frozen=True)
class _Split:
    """The uncertainty of one result, to be split into rows."""

    calibration: CalibrationData
    symbol: str
    unit: str
    sources: Mapping[str, RowSource]
    u: float

    def rows(self, group: str, variance: float, nu: float | None) -> list[BudgetRow]:
        """Return the rows of a source of the engine's budget; their squares add up to its variance."""
        members = [row for row in self.calibration["budget_rows"] if _group(row, self.calibration) == group]
        weights = [float(row["contribution"].get(self.symbol, 0.0)) ** 2 for row in members]
        if not sum(weights) > 0:  # the engine splits distortion coefficients by groups only
            name = ", ".join(str(row["name"]) for row in members) or group
            return [
                self._row(members[0] if len(members) == 1 else None, name, group, math.sqrt(variance), nu)
            ]
        scale = variance / sum(weights)
        return [
            self._row(row, str(row["name"]), group, math.sqrt(weight * scale), nu)
            for row, weight in zip(members, weights, strict=True)
        ]

    def _row(
        self, stated: BudgetRowData | None, name: str, group: str, u: float, nu: float | None
    ) -> BudgetRow:
        row: Mapping[str, Any] = stated or {}
        kind: Literal["A", "B"] = "A" if row.get("type", "") == "A" or (not row and group in _TYPE_A) else "B"
        source = self.sources.get(name, RowSource())
        value, divisor, value_unit = _stated_value(row, source)
        has_value = bool(value) and bool(divisor)
        sensitivity = u * divisor / value if has_value and value and divisor else None
        if sensitivity is not None and (row.get("sensitivity") or {}).get(self.symbol, 0.0) < 0:
            sensitivity = -sensitivity
        base = value_unit.partition(" ")[0]
        freedom = row.get("degrees_of_freedom") if stated and group in _terms([stated]) else nu
        return BudgetRow(
            name=name,
            type=kind,
            value=value if has_value else None,
            unit=value_unit if has_value else "",
            distribution=str(row.get("distribution") or "normal"),
            divisor=nine_digits(divisor) if has_value and divisor else None,
            sensitivity=None if sensitivity is None else nine_digits(sensitivity),
            sensitivity_unit=(self.unit if base == "1" else f"{self.unit}/{base}") if has_value else "",
            u=nine_digits(u),
            share=nine_digits((u / self.u) ** 2) if self.u > 0 else 0.0,
            nu=None if freedom is None or not math.isfinite(freedom) else nine_digits(float(freedom)),
            source=str(row.get("source") or _SOURCES.get(group, "joint adjustment")),
            number=source.number,
            date=source.date,
            sha256=source.sha256,
        )


def _stated_value(row: Mapping[str, Any], source: RowSource) -> tuple[float | None, float | None, str]:
    """Return the stated value of a row with divisor and unit. A passport's is not the engine's."""
    if source.value is not None:
        return source.value, source.divisor, source.unit
    if row.get("name") == PASSPORT or row.get("value") is None or row.get("divisor") is None:
        return None, None, ""
    return float(row["value"]), float(row["divisor"]), str(row.get("unit") or "")


def _group(row: BudgetRowData, calibration: CalibrationData) -> str:
    """Return the source of the engine's budget that a row is a part of."""
    name = str(row["name"])
    if name in calibration["budget"]:
        return name
    return STARS if name == READINGS else PRIORS


def _terms(rows: Sequence[BudgetRowData]) -> dict[str, float]:
    """Return the degrees of freedom of the stated terms, by name: rows with a value, other than the adjustment's."""
    return {
        str(row["name"]): float(row["degrees_of_freedom"] or math.inf)
        for row in rows
        if row.get("divisor") is not None and row["name"] != PASSPORT
    }


def _variances(calibration: CalibrationData, symbol: str) -> tuple[float, float, float]:
    """Return of a parameter the whole variance, that of the views, and the sum of squared variances over freedom."""
    budget, terms = calibration["budget"], _terms(calibration["budget_rows"])
    if not budget:
        raise EvidenceError(
            "The results have no uncertainty budget.",
            where="results.json",
            remedy="Calibrate with this version of Starbench.",
        )
    parts = {source: float(by_symbol.get(symbol, 0.0)) ** 2 for source, by_symbol in budget.items()}
    views = sum(v for source, v in parts.items() if source not in _CERTAIN and source not in terms)
    stated = sum(parts.get(name, 0.0) ** 2 / freedom for name, freedom in terms.items())
    return sum(parts.values()), views, stated


def _common_freedom(calibration: CalibrationData, k: float) -> float:
    """Return the degrees of freedom that belong to the common coverage factor; infinite for k = 2."""
    stated = [row.get("degrees_of_freedom") for row in calibration["budget_rows"] if row["type"] == "A"]
    common_freedom = float(stated[0]) if stated and stated[0] else math.inf
    if abs(coverage_factor(common_freedom) - k) < _SAME:
        return common_freedom
    low, high = 0.0, 20.0  # k falls with the degrees of freedom: bisection on their logarithm
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if coverage_factor(math.exp(middle)) > k else (low, middle)
    return math.exp(low)


def _spread_freedom(calibration: CalibrationData) -> float:
    """Return the degrees of freedom of what the views give; infinite where k is that of the posterior."""
    if calibration.get("coverage_factors"):
        return math.inf
    return _freedom_of_views(calibration, _common_freedom(calibration, float(calibration["coverage_factor"])))


def _freedom_of_views(calibration: CalibrationData, common: float) -> float:
    """Return the degrees of freedom of what the views give: those that explain the common ones of the focal lengths."""
    if not math.isfinite(common):
        return math.inf
    freedoms = []
    for symbol in ("fx", "fy"):
        whole, views, stated = _variances(calibration, symbol)
        rest = whole**2 / common - stated
        if rest > 0 and views > 0:
            freedoms.append(views**2 / rest)
    return max(freedoms, default=common)


def _welch_satterthwaite(calibration: CalibrationData, symbol: str, nu_views: float) -> float:
    """Return the effective degrees of freedom of a parameter."""
    whole, views, stated = _variances(calibration, symbol)
    spread = views**2 / nu_views + stated
    return whole**2 / spread if spread > 0 else math.inf


def nine_digits(number: float) -> float:
    """Return a calculated number with nine digits, so that another processor calculates the same text."""
    return float(f"{number:.9g}")
