"""The parts of a certificate with numbers: results, covariance, budgets, conformity. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["pass", "conditionalPass", "conditionalFail", "fail"]


@dataclass(frozen=True)
class Result:
    """A result with its uncertainty (7.8.2.1 m, 7.8.4.1 a).

    Attributes
    ----------
    symbol, name
        Symbol as in results.json (``fx``), and name in words.
    value, u
        Value and standard uncertainty, unrounded.
    unit
        ``px``, ``mm`` or ``1``.
    U
        Expanded uncertainty, rounded up to two significant digits.
    k, p
        Coverage factor, and probability of coverage (0.9545).
    nu_eff
        Effective degrees of freedom; None for infinite.
    printed_value, printed_uncertainty
        Both as printed, to the same digit, with a minus sign ``-`` and a point.
    text
        The whole statement as printed: ``3346.4 px ± 2.5 px``.
    customer_supplied
        Whether the value depends on data that the customer supplied (7.8.2.2).
    """

    symbol: str
    name: str
    value: float
    unit: str
    u: float
    U: float
    k: float
    p: float
    nu_eff: float | None
    printed_value: str
    printed_uncertainty: str
    text: str
    customer_supplied: bool


@dataclass(frozen=True)
class Covariance:
    """The joint covariance of all results, in their order.

    Attributes
    ----------
    names, units
        Symbols and units of the results.
    matrix
        The covariance, standard uncertainties squared on its diagonal; element i, j has the unit of i times that of j.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class FurtherResult:
    """A number about the calibration that is itself an uncertainty or a residual, so it has no uncertainty of its own.

    Attributes
    ----------
    id
        ``projection_centre``, ``projection_median``, ``projection_worst_corner``, ``rms``, ``mean`` or ``views``.
    name, value, unit, text
        Name in words, value, unit (``px``, ``arcsec`` or ``1``) and the statement as printed.
    """

    id: str
    name: str
    value: float
    unit: str
    text: str


@dataclass(frozen=True)
class BudgetRow:
    """A row of an uncertainty budget.

    Attributes
    ----------
    name
        Source of the uncertainty.
    type
        Type of its evaluation, ``A`` or ``B`` (JCGM 100, 4.2 and 4.3).
    value, unit
        Stated value, and its unit; None and empty for a source that the adjustment itself gives.
    distribution, divisor
        Distribution, and the divisor that gives the standard uncertainty; None for a source without a stated value.
    sensitivity, sensitivity_unit
        Change of the result by one unit of the value; None and empty for a source without a stated value.
    u, share
        Contribution to the standard uncertainty of the result, in its unit; share of its variance, 0 to 1.
    nu
        Degrees of freedom; None for infinite.
    source
        Where the value comes from.
    number, date, sha256
        Number and date of its certificate, and SHA-256 of that; empty where there is none.
    """

    name: str
    type: Literal["A", "B"]
    value: float | None
    unit: str
    distribution: str
    divisor: float | None
    sensitivity: float | None
    sensitivity_unit: str
    u: float
    share: float
    nu: float | None
    source: str
    number: str
    date: str
    sha256: str


@dataclass(frozen=True)
class Budget:
    """The uncertainty budget of one result.

    Attributes
    ----------
    symbol, unit
        Symbol and unit of the result.
    rows
        The rows; their squares add up to the square of ``u``.
    u, nu_eff, k, U
        Combined standard uncertainty, effective degrees of freedom (None for infinite), coverage factor and expanded
        uncertainty.
    remarks
        What a reader must know about the rows.
    """

    symbol: str
    unit: str
    rows: tuple[BudgetRow, ...]
    u: float
    nu_eff: float | None
    k: float
    U: float
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class ValueBefore:
    """A value of an earlier calibration.

    Attributes
    ----------
    symbol, value, U, unit
        Symbol, value, expanded uncertainty (None if unknown) and unit.
    """

    symbol: str
    value: float
    U: float | None
    unit: str


@dataclass(frozen=True)
class BeforeAdjustment:
    """The calibration that was valid before this one, and the change since then (7.8.4.1 d).

    Attributes
    ----------
    text
        What it is: an earlier run or certificate, or what the customer stated.
    number, date, sha256
        Number of its certificate or run, its date, SHA-256 of its seal; empty where there is none.
    values
        Its values; empty if they are not known.
    change_rms_px, change_largest_px
        RMS and largest change of the projection over the image since then; None if not known.
    """

    text: str
    number: str
    date: str
    sha256: str
    values: tuple[ValueBefore, ...]
    change_rms_px: float | None
    change_largest_px: float | None


@dataclass(frozen=True)
class Conformity:
    """A statement of conformity of one result (7.8.6).

    Attributes
    ----------
    symbol
        Symbol of the result.
    specification
        The specification or standard, in words.
    lower, upper
        Limits of tolerance; None where there is none.
    unit
        Their unit.
    guard_band
        Guard band w, in the same unit.
    rule
        The decision rule as printed.
    verdict
        ``pass``, ``conditionalPass``, ``conditionalFail`` or ``fail``.
    """

    symbol: str
    specification: str
    lower: float | None
    upper: float | None
    unit: str
    guard_band: float
    rule: str
    verdict: Verdict


@dataclass(frozen=True)
class Software:
    """A program that contributed to the results.

    Attributes
    ----------
    name, version
        Its name and version.
    """

    name: str
    version: str
