"""What lab.yaml and the run must answer: the clauses of ISO/IEC 17025:2017, each with the field that answers it.

A certificate that leaves a clause open, or contradicts the run, is refused. docs/certificates.md prints the table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from bench.certificate.budget_rows import row_names
from bench.certificate.lab_config import LabConfig, PreviousConfig
from bench.certificate.run_facts import is_unnamed
from bench.records.results import Results
from calib.model.result_parts import PASSPORT
from sequences.reader import Located
from sequences.tree import DocumentPath, Fault
from sequences.wording import did_you_mean

Path = tuple[str, ...]
RUN = "the sealed run"
FIXED = "fixed text"


@dataclass(frozen=True)
class Clause:
    """A clause, and what answers it."""

    number: str  # Number of the clause, such as ``7.8.2.1 e``
    item: str
    field: str
    origin: str  # The key of lab.yaml that gives them, ``the sealed run``, ``fixed text`` or both
    # Returns the keys of lab.yaml that are not stated; None if no key is needed.
    missing: Callable[[LabConfig, Results], Sequence[Path]] | None = None


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
        return [path for path in (tuple(key.split(".")) for key in dotted) if _value(lab, path) in (None, "")]

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
    in_run = results.get("passport")
    if in_run is None:
        known = any(one.number and one.issuer and one.date for one in lab.sources)
        return missing if known else [*missing, ("sources",)]
    stated = next((one for one in lab.sources if one.row == PASSPORT), None)
    needed = [name for name in ("number", "date") if not in_run.get(name)] + ["issuer"]
    return [
        *missing,
        *(("sources", name) for name in needed if not getattr(stated, name, None)),
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
    """Return the clauses that lab.yaml and the run leave open, in order, one for each missing key."""
    asked = [(clause, clause.missing(lab, results)) for clause in CLAUSES if clause.missing is not None]
    return [Unanswered(clause, path) for clause, paths in asked for path in paths]


def table() -> str:
    """Return the table of the clauses in Markdown, as docs/certificates.md prints it."""
    head = "| clause | asks for | field of certificate.json | comes from |\n| --- | --- | --- | --- |\n"
    return head + "".join(f"| {one.number} | {one.item} | {one.field} | {one.origin} |\n" for one in CLAUSES)


_OF_THE_RUN = frozenset({"camera temperature", "event rate", "illumination", "light", "light frequency"})
"""Conditions that the run records; a second statement could contradict it."""
_NO_NAMES = frozenset({"-", "n/a", "none", "unknown", "tbd", "todo", "?"})


def faults_of_lab(lab: Located[LabConfig], found: Results) -> list[Fault]:
    """Return what prevents a certificate: contradictions first, then clauses without an answer, in their order."""
    faults = [lab.fault(path, message) for path, message in _contradictions(lab.value, found)]
    for one in unanswered(lab.value, found):
        spot = lab.position(tuple(one.path[:-1]))
        faults.append(Fault(lab.file, spot.line, spot.column, one.key, one.message))
    return faults


def _contradictions(lab: LabConfig, found: Results) -> Iterator[tuple[DocumentPath, str]]:
    if not is_unnamed(found):
        serial = str(found["devices"]["camera"]["serial"])
        if lab.item.serial is not None and lab.item.serial != serial:
            yield ("item", "serial"), f"the run calibrated camera {serial}, not {lab.item.serial}."
        for name in ("maker", "model"):
            if getattr(lab.item, name) is not None:
                yield ("item", name), f"the camera {serial} identified itself in the run; leave it out."
    yield from _names(lab)
    yield from _dates(lab, found)
    symbols = list(found["calibration"]["camera"])
    for at, rule in enumerate(lab.decision_rules or ()):
        if rule.result not in symbols:
            path: DocumentPath = ("decision_rules", at, "result")
            yield path, f"the run has no result {rule.result!r}.{did_you_mean(rule.result, symbols)}"
    for at, supplied in enumerate(lab.customer_supplied or ()):
        for place, symbol in enumerate(supplied.results):
            if symbol not in symbols:
                path = ("customer_supplied", at, "results", place)
                yield path, f"the run has no result {symbol!r}.{did_you_mean(symbol, symbols)}"
    for at, condition in enumerate(lab.conditions or ()):
        if condition.name.lower() in _OF_THE_RUN:
            yield ("conditions", at, "name"), "the run itself recorded this condition; leave it out."
    yield from _sources(lab, found)


def _names(lab: LabConfig) -> Iterator[tuple[DocumentPath, str]]:
    """Yield what should identify somebody or something and does not."""
    author = lab.authorised_by.name if lab.authorised_by else ""
    stated = (
        ("laboratory", "name", lab.laboratory.name),
        ("customer", "name", lab.customer.name),
        ("item", "serial", lab.item.serial),
        ("authorised_by", "name", author),
    )
    for part, key, text in stated:
        if text and text.lower() in _NO_NAMES:
            yield (
                (part, key),
                f"{text!r} identifies nothing. A certificate needs the {'number' if key == 'serial' else key}.",
            )


def _dates(lab: LabConfig, found: Results) -> Iterator[tuple[DocumentPath, str]]:
    begun = datetime.fromisoformat(found["run"]["started_utc"]).date()
    when = f"the calibration began on {begun.isoformat()}"
    if lab.item.received is not None and lab.item.received > begun:
        yield ("item", "received"), f"{when}, before this date of receipt."
    previous = lab.previous_certificate
    if isinstance(previous, PreviousConfig) and previous.date > begun:
        yield ("previous_certificate", "date"), f"{when}, before this previous certificate."
    for at, source in enumerate(lab.sources):
        if source.date is not None and source.date > begun:
            yield ("sources", at, "date"), f"{when}, before the date of this certificate."


def _sources(lab: LabConfig, found: Results) -> Iterator[tuple[DocumentPath, str]]:
    names, seen = row_names(found["calibration"]), set()
    in_run = found.get("passport")
    for at, source in enumerate(lab.sources):
        if source.row is None:
            continue
        if source.row not in names:
            hint = did_you_mean(source.row, names)
            yield ("sources", at, "row"), f"the uncertainty budget has no row {source.row!r}.{hint}"
        if source.row in seen:
            yield ("sources", at, "row"), f"a source of the row {source.row!r} is stated twice."
        seen.add(source.row)
        if source.row != PASSPORT:
            continue
        for key, stated in (("number", source.number), ("date", source.date and source.date.isoformat())):
            used = in_run.get(key) if in_run else None
            if stated and used and used != stated:
                yield ("sources", at, key), f"the run used {used!r}, not {stated!r}."
