"""The parts of a certificate with numbers: results, covariance, budgets, conformity. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["pass", "conditionalPass", "conditionalFail", "fail"]


@dataclass(frozen=True)
class Result:
    """A result with its uncertainty (7.8.2.1 m, 7.8.4.1 a)."""

    # symbol, name: Symbol as in results.json (``fx``), and name in words.
    symbol: str
    name: str
    # value, u: Value and standard uncertainty, unrounded.
    value: float
    unit: str  # ``px``, ``mm`` or ``1``
    u: float
    U: float
    # k, p: Coverage factor, and probability of coverage (0.9545).
    k: float
    p: float
    nu_eff: float | None  # Effective degrees of freedom; None for infinite
    # printed_value, printed_uncertainty: Both as printed, to the same digit, with a minus sign ``-`` and a
    # point.
    printed_value: str
    printed_uncertainty: str
    text: str  # The whole statement as printed: ``3346.4 px ± 2.5 px``
    customer_supplied: bool  # Whether the value depends on data that the customer supplied (7.8.2.2)


@dataclass(frozen=True)
class Covariance:
    """The joint covariance of all results, in their order."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class FurtherResult:
    """A number about the calibration that is itself an uncertainty or a residual: it has none of its own."""

    # ``projection_centre``, ``projection_median``, ``projection_worst_corner``, ``rms``, ``mean`` or
    # ``views``.
    id: str
    # name, value, unit, text: Name in words, value, unit (``px``, ``arcsec`` or ``1``) and the statement as
    # printed.
    name: str
    value: float
    unit: str
    text: str


@dataclass(frozen=True)
class BudgetRow:
    """A row of an uncertainty budget."""

    name: str
    type: Literal["A", "B"]  # Type of its evaluation, ``A`` or ``B`` (JCGM 100, 4.2 and 4.3)
    # value, unit: Stated value, and its unit; None and empty for a source that the adjustment itself gives.
    value: float | None
    unit: str
    # distribution, divisor: Distribution, and the divisor that gives the standard uncertainty; None for a
    # source without a stated value.
    distribution: str
    divisor: float | None
    # sensitivity, sensitivity_unit: Change of the result by one unit of the value; None and empty for a
    # source without a stated value.
    sensitivity: float | None
    sensitivity_unit: str
    # u, share: Contribution to the standard uncertainty of the result, in its unit; share of its variance, 0
    # to 1.
    u: float
    share: float
    nu: float | None  # Degrees of freedom; None for infinite
    source: str  # Where the value comes from
    # number, date, sha256: Number and date of its certificate, and SHA-256 of that; empty where there is
    # none.
    number: str
    date: str
    sha256: str


@dataclass(frozen=True)
class Budget:
    """The uncertainty budget of one result."""

    symbol: str
    unit: str
    rows: tuple[BudgetRow, ...]  # The rows; their squares add up to the square of ``u``
    # u, nu_eff, k, U: Combined standard uncertainty, effective degrees of freedom (None for infinite),
    # coverage factor and expanded uncertainty.
    u: float
    nu_eff: float | None
    k: float
    U: float
    remarks: tuple[str, ...]  # What a reader must know about the rows


@dataclass(frozen=True)
class ValueBefore:
    """A value of an earlier calibration."""

    # symbol, value, U, unit: Symbol, value, expanded uncertainty (None if unknown) and unit.
    symbol: str
    value: float
    U: float | None
    unit: str


@dataclass(frozen=True)
class BeforeAdjustment:
    """The calibration that was valid before this one, and the change since then (7.8.4.1 d)."""

    text: str
    # number, date, sha256: Number of its certificate or run, its date, SHA-256 of its seal; empty where there
    # is none.
    number: str
    date: str
    sha256: str
    values: tuple[ValueBefore, ...]  # Its values; empty if they are not known
    # change_rms_px, change_largest_px: RMS and largest change of the projection over the image since then;
    # None if not known.
    change_rms_px: float | None
    change_largest_px: float | None


@dataclass(frozen=True)
class Conformity:
    """A statement of conformity of one result (7.8.6)."""

    symbol: str
    specification: str
    # lower, upper: Limits of tolerance; None where there is none.
    lower: float | None
    upper: float | None
    unit: str
    guard_band: float
    rule: str
    verdict: Verdict  # ``pass``, ``conditionalPass``, ``conditionalFail`` or ``fail``


@dataclass(frozen=True)
class Software:
    """A program that contributed to the results."""

    name: str
    version: str
