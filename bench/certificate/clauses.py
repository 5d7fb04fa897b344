"""The clauses of ISO/IEC 17025:2017 that a certificate must answer, each with the field that answers it.

A certificate that leaves a clause open is refused; the message names the clause and the key of lab.yaml. The table is
printed in docs/certificates.md. No file is read here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.certificate.lab_config import LabConfig
from bench.records.results import Results
from calib.model.budget_row import PASSPORT

Path = tuple[str, ...]
RUN = "the sealed run"
FIXED = "fixed text"


def _always_answered(lab: LabConfig, results: Results) -> Sequence[Path]:
    """Return nothing: no key of lab.yaml is needed."""
    del lab, results
    return ()


@dataclass(frozen=True)
class Clause:
    """A clause, and what answers it."""

    number: str  # Number of the clause, such as ``7.8.2.1 e``
    item: str
    field: str
    origin: str  # The key of lab.yaml that gives them, ``the sealed run``, ``fixed text`` or both
    missing: Callable[[LabConfig, Results], Sequence[Path]] = _always_answered


@dataclass(frozen=True)
class Unanswered:
    """A clause that is not answered."""

    clause: Clause
    path: Path

    @property
    def key(self) -> str:
        """The missing key, dotted."""
        return ".".join(self.path)

    @property
    def message(self) -> str:
        """What is missing and what to write, without the key itself."""
        remedy = _REMEDIES.get(self.key, "Add it.")
        return f"is missing. ISO/IEC 17025, {self.clause.number}: {self.clause.item}. {remedy}"


_LIST = "List them, or write none."
_REMEDIES = {
    "laboratory.accreditation": "Give body, number and scope, or write none.",
    "deviations": _LIST,
    "external": _LIST,
    "customer_supplied": _LIST,
    "decision_rules": _LIST,
    "previous_certificate": "Give number and date, or write none.",
    "item.lens.serial": "Write none if the lens has no number.",
    "conditions.temperature": "Add an entry to conditions whose name contains 'temperature'.",
    "conditions.humidity": "Add an entry to conditions whose name contains 'humidity'.",
    "traceability": "State to what the references are traceable.",
    "sources": "Add the certificate of a reference: row, number, issuer, date.",
    **{
        f"sources.{name}": f"Add it to sources: {{row: {PASSPORT}, {name}: ...}}."
        for name in ("number", "date", "issuer")
    },
}


def _keys(*dotted: str) -> Callable[[LabConfig, Results], Sequence[Path]]:
    """Return a check that keys are stated."""

    def missing(lab: LabConfig, results: Results) -> Sequence[Path]:
        del results
        return [path for path in (tuple(key.split(".")) for key in dotted) if _value(lab, path) is None]

    return missing


def _value(lab: Any, path: Path) -> Any:
    for name in path:
        lab = getattr(lab, name)
    return lab


_ITEM = (
    "item.condition",
    "item.lens.maker",
    "item.lens.model",
    "item.lens.serial",
    "item.lens.focus",
    "item.lens.focus_locked",
    "item.lens.aperture",
    "item.lens.aperture_locked",
)


def _item(lab: LabConfig, results: Results) -> Sequence[Path]:
    """A camera that does not report its serial number is identified by the laboratory."""
    unnamed = not results["devices"]["camera"].get("serial")
    own = ("item.maker", "item.model", "item.serial") if unnamed else ()
    return _keys(*own, *_ITEM)(lab, results)


def _conditions(lab: LabConfig, results: Results) -> Sequence[Path]:
    del results
    if lab.conditions is None:
        return [("conditions",)]
    names = [one.name.lower() for one in lab.conditions]
    wanted = ("temperature", "humidity")
    return [("conditions", word) for word in wanted if not any(word in name for name in names)]


def _traceability(lab: LabConfig, results: Results) -> Sequence[Path]:
    """The collimator's certificate needs number, date and issuer; the run knows what the station states."""
    missing: list[Path] = [] if lab.traceability is not None else [("traceability",)]
    in_run: Mapping[str, Any] = results.get("passport") or {}
    if not in_run:
        known = any(one.number and one.issuer and one.date for one in lab.sources)
        return missing if known else [*missing, ("sources",)]
    stated = next((one for one in lab.sources if one.row == PASSPORT), None)
    needed = [name for name in ("number", "date", "issuer") if not in_run.get(name)]
    return [
        *missing,
        *(("sources", name) for name in needed if getattr(stated, name, None) is None),
    ]


CLAUSES = (
    Clause("7.8.2.1 a", "title", "title", "title"),
    Clause(
        "7.8.2.1 b",
        "name and address of the laboratory; its accreditation or none",
        "laboratory",
        "laboratory",
        _keys("laboratory.name", "laboratory.address", "laboratory.contact", "laboratory.accreditation"),
    ),
    Clause(
        "7.8.2.1 c",
        "place where the calibration was performed",
        "laboratory.place",
        "place",
        _keys("place"),
    ),
    Clause("7.8.2.1 d", "unique number on every page, and a clear end", "number", "numbers, the ledger"),
    Clause(
        "7.8.2.1 e",
        "name and contact of the customer",
        "customer",
        "customer",
        _keys("customer.name", "customer.address", "customer.contact"),
    ),
    Clause("7.8.2.1 f", "method used", "method", "method", _keys("method")),
    Clause(
        "7.8.2.1 g",
        "description, identification and condition of the item",
        "item",
        f"item; camera, firmware and biases: {RUN}",
        _item,
    ),
    Clause("7.8.2.1 h", "date of receipt", "received", "item.received", _keys("item.received")),
    Clause("7.8.2.1 i", "dates of the calibration", "begun_utc, ended_utc", RUN),
    Clause("7.8.2.1 j", "date of issue", "issued_utc", "the clock of the laboratory"),
    Clause(
        "7.8.2.1 l",
        "the results relate only to the item; reproduction in full only",
        "statements: items, reproduction",
        FIXED,
    ),
    Clause("7.8.2.1 m", "results with their units", "results", RUN),
    Clause(
        "7.8.2.1 n",
        "deviations from the method, additions, exclusions",
        "deviations",
        f"deviations; skipped poses, failed gates, interruptions: {RUN}",
        _keys("deviations"),
    ),
    Clause(
        "7.8.2.1 o",
        "person who authorises",
        "authorised_by, and the person's signature beside the seal",
        "authorised_by",
        _keys("authorised_by"),
    ),
    Clause("7.8.2.1 p", "results of external providers", "external", "external", _keys("external")),
    Clause(
        "7.8.2.2",
        "data that the customer supplied, marked, with a disclaimer",
        "customer_supplied, results: customer_supplied",
        "customer_supplied",
        _keys("customer_supplied"),
    ),
    Clause(
        "7.8.4.1 a",
        "measurement uncertainty in the unit of the result",
        "results: U, k, p, nu_eff; covariance; budgets",
        RUN,
    ),
    Clause(
        "7.8.4.1 b",
        "conditions that influence the result",
        "conditions",
        f"conditions; camera temperature, light and event rate: {RUN}",
        _conditions,
    ),
    Clause(
        "7.8.4.1 c",
        "metrological traceability",
        "traceability, statements: traceability",
        f"traceability, sources; collimator's certificate: {RUN}",
        _traceability,
    ),
    Clause(
        "7.8.4.1 d",
        "results before and after adjustment",
        "before_adjustment, statements: adjustment",
        f"previous_certificate; last calibration on this bench: {RUN}",
        _keys("previous_certificate"),
    ),
    Clause(
        "7.8.4.1 e, 7.8.6",
        "statement of conformity with its decision rule, or none",
        "conformity",
        "decision_rules",
        _keys("decision_rules"),
    ),
    Clause(
        "7.8.4.3",
        "no recalibration interval unless agreed with the customer",
        "statements: recalibration",
        "recalibration (leave it out)",
    ),
    Clause("7.8.7", "opinions, marked as such", "opinions", "opinions"),
    Clause(
        "7.8.8",
        "amendments: own number, reference to the original, change identified",
        "amends",
        "`starbench certificate issue`",
    ),
    Clause(
        "7.5, 7.11",
        "original observations, protected from tampering",
        "run",
        f"{RUN}: its id, seal and journal",
    ),
)


def unanswered(lab: LabConfig, results: Results) -> list[Unanswered]:
    """Return the clauses that lab.yaml and the run together leave open.

    Returns: In the order of the clauses, one for each missing key.
    """
    return [Unanswered(clause, path) for clause in CLAUSES for path in clause.missing(lab, results)]


def table() -> str:
    """Return the table of the clauses in Markdown, as docs/certificates.md prints it."""
    head = "| clause | asks for | field of certificate.json | comes from |\n| --- | --- | --- | --- |\n"
    return head + "".join(f"| {one.number} | {one.item} | {one.field} | {one.origin} |\n" for one in CLAUSES)
