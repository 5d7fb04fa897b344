"""What lab.yaml and the run must answer: clauses of ISO/IEC 17025:2017, each with the keys of lab.yaml that answer it.

A certificate that leaves a clause open, or contradicts the run, is refused. docs/extras/certificate/certificates.md has
the table of all clauses, also of those that the run or a fixed text answers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from operator import attrgetter

from bench.extras.certificate.facts_of_run import is_unnamed
from bench.extras.certificate.lab_config import LabConfig, PreviousConfig
from bench.record.results import Results
from calib.model.result_parts import PASSPORT
from sequences.reader import Located
from sequences.tree import DocumentPath, Fault
from sequences.wording import did_you_mean

Missing = Callable[[LabConfig, Results], Sequence[str]]
"""Returns the keys of lab.yaml, dotted, that are to be stated and are not."""
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

_LABORATORY = ("laboratory.name", "laboratory.address", "laboratory.contact", "laboratory.accreditation")
_CUSTOMER = ("customer.name", "customer.address", "customer.contact")

_OF_THE_RUN = frozenset({"camera temperature", "event rate", "illumination", "light", "light frequency"})
"""Conditions that the run records; a second statement could contradict it."""
_NO_NAMES = frozenset({"-", "n/a", "none", "unknown", "tbd", "todo", "?"})


@dataclass(frozen=True)
class Clause:
    """A clause that lab.yaml must answer."""

    number: str  # Number of the clause, such as ``7.8.2.1 e``
    item: str
    missing: Missing

    def message(self, key: str) -> str:
        """Return what is missing and what to write, without the key itself."""
        return f"is missing. ISO/IEC 17025, {self.number}: {self.item}. {_REMEDIES.get(key, 'Add it.')}"


def _keys(*keys: str) -> Missing:
    """Return a check that keys are stated."""
    return lambda lab, _results: [key for key in keys if attrgetter(key)(lab) in (None, "")]


def _item(lab: LabConfig, results: Results) -> Sequence[str]:
    """A camera that does not report its serial number is identified by the laboratory."""
    own = ("item.maker", "item.model", "item.serial") if is_unnamed(results) else ()
    return _keys(*own, *_ITEM)(lab, results)


def _conditions(lab: LabConfig, _results: Results) -> Sequence[str]:
    if lab.conditions is None:
        return ["conditions"]
    names = " ".join(condition.name.lower() for condition in lab.conditions)
    return [f"conditions.{word}" for word in ("temperature", "humidity") if word not in names]


def _traceability(lab: LabConfig, results: Results) -> Sequence[str]:
    """The collimator's certificate needs number, date and issuer; the run knows what the station states."""
    missing = [] if lab.traceability is not None else ["traceability"]
    in_run = results.get("passport")
    if in_run is None:
        known = any(source.number and source.issuer and source.date for source in lab.sources)
        return missing if known else [*missing, "sources"]
    stated = next((source for source in lab.sources if source.row == PASSPORT), None)
    needed = [name for name in ("number", "date") if not getattr(in_run, name)] + ["issuer"]
    return [*missing, *(f"sources.{name}" for name in needed if not getattr(stated, name, None))]


CLAUSES = (
    Clause("7.8.2.1 b", "name and address of the laboratory; its accreditation or none", _keys(*_LABORATORY)),
    Clause("7.8.2.1 c", "place where the calibration was performed", _keys("place")),
    Clause("7.8.2.1 e", "name and contact of the customer", _keys(*_CUSTOMER)),
    Clause("7.8.2.1 f", "method used", _keys("method")),
    Clause("7.8.2.1 g", "description, identification and condition of the item", _item),
    Clause("7.8.2.1 h", "date of receipt", _keys("item.received")),
    Clause("7.8.2.1 n", "deviations from the method, additions, exclusions", _keys("deviations")),
    Clause("7.8.2.1 o", "person who authorises", _keys("authorised_by")),
    Clause("7.8.2.1 p", "results of external providers", _keys("external")),
    Clause(
        "7.8.2.2", "data that the customer supplied, marked, with a disclaimer", _keys("customer_supplied")
    ),
    Clause("7.8.4.1 b", "conditions that influence the result", _conditions),
    Clause("7.8.4.1 c", "metrological traceability", _traceability),
    Clause("7.8.4.1 d", "results before and after adjustment", _keys("previous_certificate")),
    Clause(
        "7.8.4.1 e, 7.8.6",
        "statement of conformity with its decision rule, or none",
        _keys("decision_rules"),
    ),
)


def unanswered(lab: LabConfig, results: Results) -> list[tuple[Clause, str]]:
    """Return the clauses that lab.yaml and the run leave open, in order, each with one missing key."""
    return [(clause, key) for clause in CLAUSES for key in clause.missing(lab, results)]


def faults_of_lab(lab: Located[LabConfig], results: Results, sequence_sha256: str) -> list[Fault]:
    """Return what prevents a certificate: contradictions first, then clauses without an answer, in their order.

    ``sequence_sha256`` is that of the run's sequence.yaml; empty if it is not known.
    """
    faults = [lab.fault(path, message) for path, message in _contradictions(lab.value, results)]
    allowed = lab.value.method.sequence_sha256 if lab.value.method else ""
    if allowed and allowed != sequence_sha256:
        what = f"the run used another sequence.yaml: SHA-256 {sequence_sha256 or 'not known'}."
        faults.append(lab.fault(("method", "sequence_sha256"), what))
    for clause, key in unanswered(lab.value, results):
        spot = lab.tree.spot(tuple(key.split(".")[:-1]))
        faults.append(Fault(lab.file, spot.line, spot.column, key, clause.message(key)))
    return faults


def _contradictions(lab: LabConfig, results: Results) -> Iterator[tuple[DocumentPath, str]]:
    if not is_unnamed(results):
        serial = str(results["devices"]["camera"]["serial"])
        if lab.item.serial is not None and lab.item.serial != serial:
            yield ("item", "serial"), f"the run calibrated camera {serial}, not {lab.item.serial}."
        for name in ("maker", "model"):
            if getattr(lab.item, name) is not None:
                yield ("item", name), f"the camera {serial} identified itself in the run; leave it out."
    yield from _names(lab)
    yield from _dates(lab, results)
    symbols = list(results["calibration"]["camera"])
    for path, symbol in _results_named(lab):
        if symbol not in symbols:
            yield path, f"the run has no result {symbol!r}.{did_you_mean(symbol, symbols)}"
    for at, condition in enumerate(lab.conditions or ()):
        if condition.name.lower() in _OF_THE_RUN:
            yield ("conditions", at, "name"), "the run itself recorded this condition; leave it out."
    yield from _sources(lab, results)


def _results_named(lab: LabConfig) -> Iterator[tuple[DocumentPath, str]]:
    for at, rule in enumerate(lab.decision_rules or ()):
        yield ("decision_rules", at, "result"), rule.result
    for at, supplied in enumerate(lab.customer_supplied or ()):
        for place, symbol in enumerate(supplied.results):
            yield ("customer_supplied", at, "results", place), symbol


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


def _dates(lab: LabConfig, results: Results) -> Iterator[tuple[DocumentPath, str]]:
    begun = datetime.fromisoformat(results["run"]["started_utc"]).date()
    when = f"the calibration began on {begun.isoformat()}"
    if lab.item.received is not None and lab.item.received > begun:
        yield ("item", "received"), f"{when}, before this date of receipt."
    previous = lab.previous_certificate
    if isinstance(previous, PreviousConfig) and previous.date > begun:
        yield ("previous_certificate", "date"), f"{when}, before this previous certificate."
    for at, source in enumerate(lab.sources):
        if source.date is not None and source.date > begun:
            yield ("sources", at, "date"), f"{when}, before the date of this certificate."


def _sources(lab: LabConfig, results: Results) -> Iterator[tuple[DocumentPath, str]]:
    names, seen = [row.name for row in results["calibration"]["budget_rows"]], set()
    in_run = results.get("passport")
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
            used = getattr(in_run, key) if in_run else None
            if stated and used and used != stated:
                yield ("sources", at, key), f"the run used {used!r}, not {stated!r}."
