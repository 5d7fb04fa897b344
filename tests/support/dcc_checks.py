"""Checks of a digital calibration certificate that its schema does not make: is it complete, does it contradict itself.

`check_dcc` needs neither schema nor network. Numbers are checked in `dcc_numbers` and `dcc_covariances`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from datetime import date
from decimal import Decimal
from itertools import islice
from typing import TYPE_CHECKING

from dcc_covariances import budget_faults, covariance_faults
from dcc_numbers import (
    StatedResult,
    coverage_faults,
    digit_faults,
    missing_uncertainties,
    number_faults,
    stated_results,
    unit_faults,
)

from bench.certificate.dcc_parties import NO_NUMBER
from bench.certificate.dcc_reader import number
from bench.certificate.dcc_words import SIMULATED, SIMULATED_TYPE
from bench.certificate.dcc_xml import NAMESPACES, library, qualified, read_dcc, short

if TYPE_CHECKING:
    from lxml.etree import _Element

_EMPTY = frozenset({"", "-", "n/a", "none", "unknown", "tbd", "todo", "?", NO_NUMBER})
_SHA256 = re.compile(r"[0-9a-f]{64}")
_RELEASE = re.compile(r"[A-Za-z] ?(?:\d{1,3}\.){0,3}\d{1,3}")
_CORE = "dcc:administrativeData/dcc:coreData"
_MOST_FAULTS = 200


def check_dcc(data: bytes, where: str = "the DCC") -> list[str]:
    """Check the content of a digital calibration certificate.

    where: The file, for messages about a file that cannot be read.
    Returns: One line a fault; empty if none was found. At most 200.
    Raises EvidenceError: When it cannot be read safely, is not a DCC, or has a version that is not known.
    Raises UsageError: When lxml is not installed.
    """
    root = read_dcc(data, where)
    found = list(islice((fault for check in CHECKS for fault in check(root)), _MOST_FAULTS + 1))
    return found if len(found) <= _MOST_FAULTS else [*found[:-1], "and more"]


def _hidden_faults(root: _Element) -> Iterator[str]:
    """Yield comments and processing instructions: they can hide a part of a value from a reader."""
    etree = library("lxml.etree")
    for one in root.iter(etree.Comment, etree.ProcessingInstruction, etree.Entity):
        yield f"line {one.sourceline}: there is an XML comment or instruction, which can hide a part of a value"


def _identity_faults(root: _Element) -> Iterator[str]:
    """Yield what is missing of number, items, laboratory, customer and persons."""
    if _is_empty(root.findtext(f"{_CORE}/dcc:uniqueIdentifier", "", NAMESPACES)):
        yield "the certificate has no number (uniqueIdentifier)"
    serials = 0
    for item in root.iterfind(".//dcc:item", NAMESPACES):
        values = item.iterfind("dcc:identifications/dcc:identification", NAMESPACES)
        stated = [one for one in values if not _is_empty(one.findtext("dcc:value", "", NAMESPACES))]
        serials += any(_is_serial(one) for one in stated)
        if _is_empty(_text(item, "dcc:name")):
            yield f"line {item.sourceline}: an item has no name"
    if not serials:
        yield "no item has a serial number"
    for path, name in (
        ("dcc:calibrationLaboratory/dcc:contact", "calibration laboratory"),
        ("dcc:customer", "customer"),
    ):
        if _is_empty(_text(root, f"dcc:administrativeData/{path}/dcc:name")):
            yield f"the {name} has no name"
    persons = root.findall(".//dcc:respPerson", NAMESPACES)
    signers = [
        one for one in persons if one.findtext("dcc:mainSigner", "", NAMESPACES).strip() in ("true", "1")
    ]
    if not any(not _is_empty(_text(one, "dcc:person/dcc:name")) for one in signers):
        yield "no person authorises the certificate (respPerson with mainSigner and a name)"


def _is_serial(identification: _Element) -> bool:
    named = _text(identification, "dcc:name").lower()
    return "basic_serialNumber" in identification.get("refType", "").split() or "serial" in named


def _date_faults(root: _Element) -> Iterator[str]:
    """Yield dates that cannot be read or are out of order."""
    names = ("receiptDate", "beginPerformanceDate", "endPerformanceDate", "issueDate")
    before: tuple[str, date] | None = None
    for name in names:
        text = root.findtext(f"{_CORE}/dcc:{name}", None, NAMESPACES)
        if text is None:
            continue
        try:
            found = date.fromisoformat(text.strip()[:10])
        except ValueError:
            yield f"{name} {short(text) or 'without text'} is not a date"
            continue
        if before is not None and found < before[1]:
            yield f"{name} {found} is before {before[0]} {before[1]}"
        before = (name, found)


def _amendment_faults(root: _Element) -> Iterator[str]:
    """Yield an amendment that does not name the certificate that it replaces, and hashes that are none."""
    replaced = root.find(f"{_CORE}/dcc:reportAmendedSubstituted", NAMESPACES)
    previous = root.find(f"{_CORE}/dcc:previousReport", NAMESPACES)
    own = root.findtext(f"{_CORE}/dcc:uniqueIdentifier", "", NAMESPACES).strip()
    if replaced is not None:
        number_ = replaced.findtext("dcc:replacedUniqueIdentifier", "", NAMESPACES).strip()
        if number_ == own:
            yield "the certificate replaces itself"
        if previous is None:
            yield "the certificate replaces another, but has no hash of that (previousReport)"
        elif previous.findtext("dcc:referralID", "", NAMESPACES).strip() != number_:
            yield "reportAmendedSubstituted and previousReport name two certificates"
    for element in root.iter(
        *(qualified(f"dcc:{name}") for name in ("previousReport", "certificate", "linkedReport"))
    ):
        procedure = element.findtext("dcc:procedure", "", NAMESPACES).upper().replace("-", "").strip()
        value = element.findtext("dcc:value", "", NAMESPACES).strip().lower()
        if procedure == "SHA256" and not _SHA256.fullmatch(value):
            yield f"line {element.sourceline}: {short(value) or 'an empty text'} is not a hash by SHA-256"


def _reference_faults(root: _Element) -> Iterator[str]:
    """Yield references to nothing, ids that nothing refers to, and ids that stand twice."""
    ids = Counter(one.get("id", "") for one in root.iter("{*}*") if one.get("id"))
    referred: set[str] = set()
    for element in root.iter("{*}*"):
        for one in element.get("refId", "").split():
            referred.add(one)
            if one not in ids:
                yield f"line {element.sourceline}: refId {short(one)} refers to no id"
    yield from (f"id {short(one)} stands {count} times" for one, count in ids.items() if count > 1)
    yield from (f"nothing refers to the id {short(one)}" for one in ids if one not in referred)


def _language_faults(root: _Element) -> Iterator[str]:
    """Yield texts that are empty or in a language that the certificate does not declare."""
    used = {
        (one.text or "").strip() for one in root.iterfind(f"{_CORE}/dcc:usedLangCodeISO639_1", NAMESPACES)
    }
    for content in root.iter(qualified("dcc:content")):
        language = content.get("lang")
        if language is not None and language not in used:
            yield f"line {content.sourceline}: the language {short(language)} is not one of the certificate"
        if not (content.text or "").strip():
            yield f"line {content.sourceline}: a text is empty"


def _software_faults(root: _Element) -> Iterator[str]:
    """Yield versions of software in another form than PTB's rules want: a letter and up to four numbers."""
    for release in root.iter(qualified("dcc:release")):
        if not _RELEASE.fullmatch((release.text or "").strip()):
            yield f"line {release.sourceline}: the release {short(release.text or '')} has not the form v1.2.3"


def _simulated_faults(root: _Element) -> Iterator[str]:
    """Yield a certificate of simulated devices that does not say so everywhere."""
    number_ = root.findtext(f"{_CORE}/dcc:uniqueIdentifier", "", NAMESPACES)
    titles = [_text(one, "dcc:name") for one in root.iterfind(".//dcc:measurementResult", NAMESPACES)]
    names = [_text(one, "dcc:name") for one in root.iterfind(".//dcc:item", NAMESPACES)]
    items = " ".join(
        "".join(map(str, one.itertext("{*}*"))) for one in root.iterfind(".//dcc:items", NAMESPACES)
    )
    flagged = any(one.get("simulated") == "true" for one in root.iterfind("dcc:comment/*", NAMESPACES))
    statements = root.findall(".//dcc:statement", NAMESPACES)
    stated = any(
        SIMULATED_TYPE in one.get("refType", "").split() and SIMULATED in _text(one, "dcc:declaration")
        for one in statements
    )
    marked_titles = [SIMULATED in title for title in titles]
    signs = (flagged, stated, SIMULATED in number_, any(marked_titles), "simulated" in items.lower())
    if not any(signs):
        return
    says = "the certificate is of simulated devices, but"
    if not stated:
        yield f"{says} no statement says {SIMULATED}"
    if not all(marked_titles):
        yield f"{says} the name of its measurement does not say {SIMULATED}"
    if not any(SIMULATED in name for name in names):
        yield f"{says} the name of no item says {SIMULATED}"
    if SIMULATED not in number_:
        yield f"{says} its number does not say {SIMULATED}"


def _conformity_faults(root: _Element) -> Iterator[str]:
    """Yield statements of conformity without rule or result, and verdicts that the limits contradict."""
    results = {one.id: one for one in stated_results(root) if one.id}
    exact = _unrounded(root)
    for statement in root.iter(qualified("dcc:statement"), qualified("dcc:metaData")):
        verdict = statement.findtext("dcc:conformity", None, NAMESPACES)
        if verdict is None:
            continue
        line = f"line {statement.sourceline}"
        if _is_empty(statement.findtext("dcc:convention", "", NAMESPACES)):
            yield f"{line}: a statement of conformity has no decision rule"
        ids = statement.get("refId", "").split()
        if statement.tag == qualified("dcc:statement") and not any(one in results for one in ids):
            yield f"{line}: a statement of conformity names no result"
        limits = _limits(statement)
        for id_ in ids:
            if id_ in results and limits is not None:
                yield from _verdict_faults(line, verdict.strip(), results[id_], exact.get(id_), limits)


def _limits(statement: _Element) -> tuple[Decimal | None, Decimal | None, Decimal] | None:
    """Return lower limit, upper limit and guard band of a statement; None if it has no limit."""
    found: dict[str, Decimal | None] = {}
    for quantity in statement.iterfind("dcc:data/dcc:quantity", NAMESPACES):
        found[_text(quantity, "dcc:name")] = number(quantity.findtext("si:real/si:value", None, NAMESPACES))
    lower, upper = found.get("lower limit"), found.get("upper limit")
    return (
        None if lower is None and upper is None else (lower, upper, found.get("guard band w") or Decimal(0))
    )


def _unrounded(root: _Element) -> dict[str, Decimal]:
    """Return the unrounded values of the results, from their joint list."""
    found: dict[str, Decimal] = {}
    for quantity in root.iterfind(".//dcc:result//dcc:quantity[@refId]", NAMESPACES):
        texts = quantity.findtext("si:realListXMLList/si:valueXMLList", "", NAMESPACES).split()
        ids = quantity.get("refId", "").split()
        if len(ids) == len(texts):
            found |= {
                id_: value
                for id_, text in zip(ids, texts, strict=True)
                if (value := number(text)) is not None
            }
    return found


def _verdict_faults(
    line: str,
    verdict: str,
    result: StatedResult,
    exact: Decimal | None,
    limits: tuple[Decimal | None, Decimal | None, Decimal],
) -> Iterator[str]:
    """Yield a verdict that neither the printed nor the unrounded value gives (guard band: ILAC-G8:09/2019, 4.2)."""
    lower, upper, guard = limits
    allowed = set()
    for value in filter(lambda one: one is not None, (result.value, exact)):
        assert value is not None
        margins = [value - lower] if lower is not None else []
        margins += [upper - value] if upper is not None else []
        margin = min(margins)
        if margin >= 0:
            allowed.add("pass" if margin >= guard else "conditionalPass")
        else:
            allowed |= {"fail"} if -margin >= guard else set()
            allowed |= {"conditionalFail"} if -margin <= guard else set()
    if verdict not in allowed:
        yield (
            f"{line}: the verdict on {result.name} is {short(verdict)}, but {result.value} with these limits and the"
            f" guard band {guard} is {' or '.join(sorted(allowed))}"
        )


def _text(parent: _Element, path: str) -> str:
    return " ".join(one.text or "" for one in parent.iterfind(f"{path}/dcc:content", NAMESPACES)).strip()


def _is_empty(text: str) -> bool:
    return text.strip().lower() in _EMPTY


CHECKS = (
    _hidden_faults,
    _identity_faults,
    _date_faults,
    _amendment_faults,
    _reference_faults,
    _language_faults,
    _software_faults,
    _simulated_faults,
    unit_faults,
    number_faults,
    missing_uncertainties,
    coverage_faults,
    digit_faults,
    covariance_faults,
    budget_faults,
    _conformity_faults,
)
"""The checks that `check_dcc` makes, in this order."""
