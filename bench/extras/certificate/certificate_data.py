"""A certificate as data: `certificate.json`, from which PDF, DCC and every printed number derive. No file, no clock.

What the laboratory states are parts of lab.yaml as `bench.extras.certificate.lab_config` reads it. Times are UTC,
``2026-03-31T09:15:00Z``; numbers in brackets are clauses of ISO/IEC 17025:2017.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

from pydantic import ConfigDict, TypeAdapter, ValidationError

from bench.base.bounded_json import canonical_json, leaves, parse_json
from bench.base.errors import EvidenceError
from bench.extras.certificate.lab_config import (
    Accreditation,
    Address,
    AuthorisedBy,
    Contact,
    Customer,
    Lens,
    Method,
    PlaceKind,
)
from bench.record.results import Verdict
from bench.record.run_folder import CERTIFICATE
from sequences.tree import path_text
from sequences.wording import MESSAGES

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

PDF = "certificate.pdf"
DCC = "dcc.xml"
FORMAT: Literal["starbench/certificate/1"] = "starbench/certificate/1"
_LATER = {("run", "sequence_sha256"), ("run", "station_sha256"), ("method", "sequence_sha256")}
"""Fields that certificates of earlier versions do not have."""

_MOST_FAULTS = 20  # More are mended after the first
_FORMS = {
    "string_type": "a text",
    "float_type": "a finite number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "tuple_type": "a list",
    "dataclass_type": "a mapping",
    "model_type": "a mapping",
}


class _Strict:
    """What is read has every key and no other, and each value is of its type; numbers are finite."""

    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class Laboratory(_Strict):
    """The laboratory that calibrated (ISO/IEC 17025, 7.8.2.1 b and c)."""

    name: str
    address: Address
    contact: Contact
    accreditation: Accreditation | None  # Its accreditation; None if it has none for this calibration
    place_kind: PlaceKind  # Where it calibrated, a word of the DCC
    place: str  # The same in words


@dataclass(frozen=True)
class Camera(_Strict):
    """The calibrated camera, as it identified itself in the run."""

    maker: str  # As the camera reported it; empty if it did not
    model: str  # The same
    sensor: str  # The same
    serial: str  # The same
    firmware: str  # The same
    image_size: tuple[int, ...]  # Width and height, px
    biases: tuple[str, ...]  # Biases and their values as text, sorted by name; empty for a frame camera
    biases_sha256: str  # SHA-256 of the biases; empty for a frame camera


@dataclass(frozen=True)
class Item(_Strict):
    """The calibrated item (7.8.2.1 g)."""

    camera: Camera
    lens: Lens
    customer_id: str  # The customer's own number of the item; empty if there is none
    condition: str


@dataclass(frozen=True)
class Deviation(_Strict):
    """A deviation from the method, an addition or an exclusion (7.8.2.1 n)."""

    text: str
    # ``run`` if the sealed run states it, ``laboratory`` if the laboratory does.
    source: Literal["run", "laboratory"]


@dataclass(frozen=True)
class Condition(_Strict):
    """A condition that influences the result (7.8.4.1 b)."""

    name: str  # Name of the condition, such as ``room temperature``
    value: float | None  # Its value; None if it is stated in words
    unit: str  # Unit, ``1`` for none
    # U, k: Expanded uncertainty and its coverage factor; None if not stated.
    U: float | None
    k: float | None
    text: str  # The condition in words; empty if it has a value
    source: str  # ``run``, or the instrument with the number of its certificate


@dataclass(frozen=True)
class Traceability(_Strict):
    """A reference to which the results are traceable (7.8.4.1 c)."""

    what: str  # The reference, such as ``focal length of the collimator``
    # value, U, k, unit: Its value, expanded uncertainty, coverage factor and unit; None where not stated.
    value: float | None
    U: float | None
    k: float | None
    unit: str
    number: str  # Of its certificate; empty where not stated
    issuer: str  # Of that certificate
    date: str  # Of that certificate
    sha256: str  # Of the certificate's file; empty where not stated
    statement: str


@dataclass(frozen=True)
class Result(_Strict):
    """A result with its uncertainty (7.8.2.1 m, 7.8.4.1 a)."""

    symbol: str  # As in results.json (``fx``)
    name: str  # In words
    value: float  # Unrounded
    unit: str  # ``px``, ``mm`` or ``1``
    u: float  # Standard uncertainty, unrounded
    U: float
    k: float  # Coverage factor
    p: float  # Probability of coverage (0.9545)
    nu_eff: float | None  # Effective degrees of freedom; None for infinite
    printed_value: str  # With a minus sign ``-`` and a point
    printed_uncertainty: str  # To the same digit
    text: str  # The whole statement as printed: ``3346.4 px ± 2.5 px``
    customer_supplied: bool  # Whether the value depends on data that the customer supplied (7.8.2.2)


@dataclass(frozen=True)
class Covariance(_Strict):
    """The joint covariance of all results, in their order."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class FurtherResult(_Strict):
    """A number about the calibration that is itself an uncertainty or a residual: it has none of its own."""

    # ``projection_centre``, ``projection_median``, ``projection_worst_corner``, ``rms``, ``mean`` or
    # ``views``.
    id: str
    name: str  # In words
    value: float
    unit: str  # ``px``, ``arcsec`` or ``1``
    text: str  # The statement as printed


@dataclass(frozen=True)
class BudgetRow(_Strict):
    """A row of an uncertainty budget."""

    name: str
    type: Literal["A", "B"]  # Type of its evaluation, ``A`` or ``B`` (JCGM 100, 4.2 and 4.3)
    value: float | None  # As stated; None for a source that the adjustment itself gives
    unit: str  # Of the value; empty without one
    distribution: str
    divisor: float | None  # Gives the standard uncertainty; None without a stated value
    sensitivity: float | None  # Change of the result by one unit of the value; None without one
    sensitivity_unit: str  # Empty without one
    u: float  # Contribution to the result's standard uncertainty, in its unit
    share: float  # Of its variance, 0 to 1
    nu: float | None  # Degrees of freedom; None for infinite
    source: str  # Where the value comes from
    number: str  # Of its certificate; empty where there is none
    date: str  # Of that certificate
    sha256: str  # Of that certificate


@dataclass(frozen=True)
class Budget(_Strict):
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
class ValueBefore(_Strict):
    """A value of an earlier calibration."""

    # symbol, value, U, unit: Symbol, value, expanded uncertainty (None if unknown) and unit.
    symbol: str
    value: float
    U: float | None
    unit: str


@dataclass(frozen=True)
class BeforeAdjustment(_Strict):
    """The calibration that was valid before this one, and the change since then (7.8.4.1 d)."""

    text: str
    number: str  # Of its certificate or run; empty where there is none
    date: str  # Of that
    sha256: str  # Of its seal
    values: tuple[ValueBefore, ...]  # Its values; empty if they are not known
    change_rms_px: float | None  # Of the projection over the image since then; None if not known
    change_largest_px: float | None  # The same at its largest place


@dataclass(frozen=True)
class Conformity(_Strict):
    """A statement of conformity of one result (7.8.6)."""

    symbol: str
    specification: str
    lower: float | None  # Limit of tolerance; None where there is none
    upper: float | None  # The same
    unit: str
    guard_band: float
    rule: str
    verdict: Verdict  # ``pass``, ``conditionalPass``, ``conditionalFail`` or ``fail``


@dataclass(frozen=True)
class Software(_Strict):
    """A program that contributed to the results."""

    name: str
    version: str


@dataclass(frozen=True)
class Run(_Strict):
    """The sealed run that the certificate is made from."""

    id: str
    sequence: str
    station: str
    ledger_number: int | None  # Of the run in the laboratory's ledger; None if it has none
    ledger_head: str  # Hash of the ledger then; empty if it has none
    journal_head: str  # Hash of the last line of its journal
    seal_sha256: str  # Of its SHA256SUMS
    results_sha256: str  # Of its results.json
    signer: str
    signer_fingerprint: str
    software: tuple[Software, ...]
    sequence_sha256: str = ""  # By its journal; empty in certificates of earlier versions
    station_sha256: str = ""  # The same


@dataclass(frozen=True)
class Change(_Strict):
    """A field that differs from the amended certificate."""

    field: str  # Its path
    before: str  # As text; ``absent`` where there was none
    after: str  # As text; ``absent`` where there is none


@dataclass(frozen=True)
class Amends(_Strict):
    """The certificate that this one replaces (7.8.8)."""

    number: str  # Of the amended certificate
    sha256: str  # Of its SHA256SUMS
    reason: str
    changes: tuple[Change, ...]  # What changed, field by field


@dataclass(frozen=True)
class Statement(_Strict):
    """A fixed text of the certificate."""

    # ``simulated``, ``authorisation``, ``accreditation``, ``items``, ``identity``, ``reproduction``,
    # ``model``, ``uncertainty``, ``notes``, ``not_included``, ``traceability``, ``verification``,
    # ``adjustment``, ``customer_data``, ``recalibration``, ``also``, ``limits``, ``limits_reason`` or ``earlier_runs``.
    id: str
    text: str


@dataclass(frozen=True)
class Certificate(_Strict):
    """A certificate of calibration."""

    format: Literal["starbench/certificate/1"]  # ``starbench/certificate/1``
    language: Literal["en"]  # Language of the texts: ``en``
    title: str
    number: str  # Unique
    series: str  # Format of the series of numbers
    simulated: bool  # Whether any device of the run was simulated: every page then says SIMULATED
    laboratory: Laboratory
    customer: Customer
    item: Item
    received: str
    begun_utc: str
    ended_utc: str
    issued_utc: str
    method: Method
    deviations: tuple[Deviation, ...]
    conditions: tuple[Condition, ...]
    traceability: tuple[Traceability, ...]
    results: tuple[Result, ...]
    covariance: Covariance
    further: tuple[FurtherResult, ...]
    budgets: tuple[Budget, ...]  # The uncertainty budget of each result, in their order
    before_adjustment: BeforeAdjustment | None  # The calibration before this one; None if none is known
    conformity: tuple[Conformity, ...]  # Statements of conformity; empty if none was asked for
    customer_supplied: tuple[str, ...]
    external: tuple[str, ...]
    opinions: tuple[str, ...]
    authorised_by: AuthorisedBy
    run: Run
    amends: Amends | None  # The certificate that it replaces, if any
    statements: tuple[Statement, ...]

    def to_json(self) -> bytes:
        """Return the certificate as `certificate.json` holds it."""
        return canonical_json(_form().dump_python(self, mode="json", by_alias=True), ascii_only=False)

    @classmethod
    def from_json(cls, data: bytes, where: str = CERTIFICATE) -> Certificate:
        """Read a certificate. Unknown, missing and double keys and values of another type are refused."""
        try:
            # It refuses what two readers could read differently, and what is nested too deeply.
            stated = {place for place, _ in leaves(parse_json(data))}
            certificate = _form().validate_json(data, strict=True)
            written = leaves(parse_json(certificate.to_json()))
            faults = [
                f"{path_text(place)} is missing" for place, _ in written if place not in stated | _LATER
            ]
            if not faults:
                return certificate
        except ValidationError as error:
            faults = [_fault(error_detail) for error_detail in error.errors()]
        except ValueError as error:
            faults = [f"it is not readable JSON ({error})"]
        more = [f"and {len(faults) - _MOST_FAULTS} more"] if len(faults) > _MOST_FAULTS else []
        raise EvidenceError(
            "This is not a certificate of this form: " + "; ".join([*faults[:_MOST_FAULTS], *more]) + ".",
            where=where,
            remedy="Another version of Starbench wrote it, or it was changed.",
        )

    def statement(self, id: str) -> str:  # noqa: A002 - the field's name
        """Return a fixed text; empty if the certificate does not have it."""
        return next((statement.text for statement in self.statements if statement.id == id), "")


@cache
def _form() -> TypeAdapter[Certificate]:
    return TypeAdapter(Certificate)


def _fault(error_details: ErrorDetails) -> str:
    """Return what pydantic found as people read it, with its place in the certificate."""
    kind, place, more = error_details["type"], error_details["loc"], error_details.get("ctx", {})
    path = path_text(place) or "the whole"
    if kind == "missing":
        return f"{path} is missing"
    if kind in {"unexpected_keyword_argument", "extra_forbidden"}:
        return f"{path_text((*place[:-1], str(place[-1])[:60]))} is unknown"
    if kind == "literal_error":
        wanted = str(more["expected"]).replace("'", "").replace(" or ", ", ")
        return f"{path} must be one of {wanted}"
    if kind == "value_error":
        return f"{path} {more['error']}".removesuffix(".")
    if kind in _FORMS:
        return f"{path} must be {_FORMS[kind]}"
    return f"{path} {MESSAGES.get(kind, error_details['msg']).format(**more)}".removesuffix(".")


def sha256(data: bytes) -> str:
    """Return the SHA-256 of bytes, 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
