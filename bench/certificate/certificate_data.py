"""A certificate as data. `certificate.json` holds it; the PDF, the DCC and every printed number derive from it.

It holds values and texts only: no file, no clock, no key. Times are UTC, ``2026-03-31T09:15:00Z``; dates are
``2026-03-31``. The parts stand in `party_data` and `result_data`; import them from here.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Literal

from bench.certificate import strict_json
from bench.certificate.party_data import (
    Accreditation,
    Address,
    AuthorisedBy,
    Camera,
    Condition,
    Contact,
    Customer,
    Deviation,
    Item,
    Laboratory,
    Lens,
    Method,
    PlaceKind,
    Traceability,
)
from bench.certificate.result_data import (
    BeforeAdjustment,
    Budget,
    BudgetRow,
    Conformity,
    Covariance,
    FurtherResult,
    Result,
    Software,
    ValueBefore,
    Verdict,
)

__all__ = [
    "CERTIFICATE",
    "FORMAT",
    "Accreditation",
    "Address",
    "Amends",
    "AuthorisedBy",
    "BeforeAdjustment",
    "Budget",
    "BudgetRow",
    "Camera",
    "Certificate",
    "Change",
    "Condition",
    "Conformity",
    "Contact",
    "Covariance",
    "Customer",
    "Deviation",
    "FurtherResult",
    "Item",
    "Laboratory",
    "Lens",
    "Method",
    "PlaceKind",
    "Result",
    "Run",
    "Software",
    "Statement",
    "Traceability",
    "ValueBefore",
    "Verdict",
    "sha256",
]

FORMAT: Literal["starbench/certificate/1"] = "starbench/certificate/1"
CERTIFICATE = "certificate.json"


@dataclass(frozen=True)
class Run:
    """The sealed run that the certificate is made from."""

    id: str
    sequence: str
    station: str
    # ledger_number, ledger_head: Number of the run in the laboratory's ledger and the ledger's hash then;
    # None and empty if it has none.
    ledger_number: int | None
    ledger_head: str
    journal_head: str  # Hash of the last line of its journal
    # seal_sha256, results_sha256: SHA-256 of its SHA256SUMS and of its results.json.
    seal_sha256: str
    results_sha256: str
    signer: str
    signer_fingerprint: str
    software: tuple[Software, ...]


@dataclass(frozen=True)
class Change:
    """A field that differs from the amended certificate."""

    # field, before, after: Path of the field, and its values as text; ``absent`` where there was or is none.
    field: str
    before: str
    after: str


@dataclass(frozen=True)
class Amends:
    """The certificate that this one replaces (7.8.8)."""

    # number, sha256: Its number, and SHA-256 of its SHA256SUMS.
    number: str
    sha256: str
    reason: str
    changes: tuple[Change, ...]  # What changed, field by field


@dataclass(frozen=True)
class Statement:
    """A fixed text of the certificate."""

    # ``simulated``, ``authorisation``, ``accreditation``, ``items``, ``identity``, ``reproduction``,
    # ``model``, ``uncertainty``, ``notes``, ``not_included``, ``traceability``, ``verification``,
    # ``adjustment``, ``customer_data``, ``recalibration`` or ``also``.
    id: str
    text: str


@dataclass(frozen=True)
class Certificate:
    """A certificate of calibration."""

    format: Literal["starbench/certificate/1"]  # ``starbench/certificate/1``
    language: Literal["en"]  # Language of the texts: ``en``
    # title, number, series: Title, unique number, and format of the series of numbers.
    title: str
    number: str
    series: str
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
        return strict_json.to_json(self)

    @classmethod
    def from_json(cls, data: bytes, where: str = CERTIFICATE) -> Certificate:
        """Read a certificate. Unknown, missing and double keys and values of another type are refused.

        data: Content of `certificate.json`.
        """
        return strict_json.from_json(data, cls, where)

    def statement(self, id: str) -> str:  # noqa: A002 - the field's name
        """Return a fixed text.

        Returns: The text; empty if the certificate does not have it.
        """
        return next((one.text for one in self.statements if one.id == id), "")


def sha256(data: bytes) -> str:
    """Return the SHA-256 of bytes.

    Returns: 64 hexadecimal digits.
    """
    return hashlib.sha256(data).hexdigest()
