"""What lab.yaml says against the run, or against itself: each with its place in the file. No file is read here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from bench.certificate.budget_rows import row_names
from bench.certificate.clauses import unanswered
from bench.certificate.lab_config import LabConfig, PreviousConfig
from bench.certificate.run_facts import is_unnamed
from bench.records.results import Results
from calib.model.budget_row import PASSPORT
from sequences.reader import Located
from sequences.tree import DocumentPath, Fault
from sequences.wording import did_you_mean

_OF_THE_RUN = frozenset({"camera temperature", "event rate", "illumination", "light", "light frequency"})
"""Conditions that the run records; a second statement could contradict it."""
_NO_NAMES = frozenset({"-", "n/a", "none", "unknown", "tbd", "todo", "?"})


def faults_of_lab(lab: Located[LabConfig], found: Results) -> list[Fault]:
    """Return what prevents a certificate: clauses that are not answered, and contradictions.

    Returns: All of them: contradictions first, then the clauses in their order.
    """
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
    author = lab.authorised_by.name if lab.authorised_by else None
    stated = (
        ("laboratory", "name", lab.laboratory.name),
        ("customer", "name", lab.customer.name),
        ("item", "serial", lab.item.serial),
        ("authorised_by", "name", author),
    )
    for part, key, text in stated:
        if text is not None and text.lower() in _NO_NAMES:
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
    in_run: Mapping[str, Any] = found.get("passport") or {}
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
            if stated and in_run.get(key) and str(in_run[key]) != stated:
                yield ("sources", at, key), f"the run used {in_run[key]!r}, not {stated!r}."
