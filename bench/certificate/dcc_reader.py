"""Reads a length, number, date, issuer and hash from the DCC of a reference, such as a collimator.

It judges neither the signature (`dcc_signature`) nor the form (`dcc_xml`).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING

from bench.base.errors import EvidenceError
from bench.certificate.dcc_units import length_mm
from bench.certificate.dcc_xml import NAMESPACES, library, qualified, read_dcc, short

if TYPE_CHECKING:
    from lxml.etree import _Element

_WORDS = ("focal length", "effective focal length", "brennweite", "distance focale")
_LABELS = ("r", "f", "efl")
_CORE = "dcc:administrativeData/dcc:coreData"
_MOST_NAMED = 8


@dataclass(frozen=True)
class Length:
    """A length that a DCC states as a result."""

    # id, label, name: Id of the quantity, label and name of the number; empty where there is none.
    id: str
    label: str
    name: str
    # value_mm, uncertainty_mm: Value and expanded uncertainty, mm.
    value_mm: float
    uncertainty_mm: float
    k: float

    @property
    def called(self) -> str:
        """The quantity in messages: its label or id, and its name."""
        return " ".join(filter(None, (self.label or self.id, f"({short(self.name)})" if self.name else "")))


@dataclass(frozen=True)
class Reference:
    """What a station and a certificate need to know of a reference."""

    # number, date, issuer: Number, date and laboratory of its certificate; the date is empty if it is not
    # stated.
    number: str
    date: str
    issuer: str
    sha256: str  # SHA-256 of the file
    length: Length
    temperature_c: float | None  # Temperature that the DCC states, °C; None if it states none, or several


def read_reference(data: bytes, where: str, *, wanted: str = "") -> Reference:
    """Read a length by id, label or name (empty: the focal length, or the only one); `EvidenceError` if in doubt."""
    root = read_dcc(data, where)
    if next(root.iter(library("lxml.etree").Comment), None) is not None:
        raise EvidenceError(
            "The DCC has XML comments, which can hide a part of a value.",
            where=where,
            remedy="Ask its issuer for the file without them, or copy the value by hand.",
        )
    stated = root.findtext(f"{_CORE}/dcc:uniqueIdentifier", "", NAMESPACES).strip()
    if not stated:
        raise EvidenceError("The DCC has no number.", where=where, remedy="Ask its issuer for a whole one.")
    issued = root.findtext(f"{_CORE}/dcc:issueDate", "", NAMESPACES)
    ended = root.findtext(f"{_CORE}/dcc:endPerformanceDate", "", NAMESPACES)
    return Reference(
        number=stated,
        date=(issued or ended).strip()[:10],
        issuer=" ".join(
            _contents(root, "dcc:administrativeData/dcc:calibrationLaboratory/dcc:contact/dcc:name")
        )[:200],
        sha256=hashlib.sha256(data).hexdigest(),
        length=_choose(_lengths(root), wanted, where),
        temperature_c=_temperature(root),
    )


def _lengths(root: _Element) -> list[Length]:
    """Return the lengths among the results that have an expanded uncertainty."""
    found = []
    for quantity in root.iterfind(".//dcc:result//dcc:quantity", NAMESPACES):
        real = quantity.find("si:real", NAMESPACES)
        if real is None or next(quantity.iterancestors(qualified("dcc:metaData")), None) is not None:
            continue
        value = number(real.findtext("si:value", None, NAMESPACES))
        expanded = number(real.findtext("si:expandedUnc/si:uncertainty", None, NAMESPACES))
        k = number(real.findtext("si:expandedUnc/si:coverageFactor", None, NAMESPACES))
        unit = real.findtext("si:unit", "", NAMESPACES).strip()
        if value is None or expanded is None or k is None or expanded <= 0 or k < 1:
            continue
        value_mm, uncertainty_mm = length_mm(float(value), unit), length_mm(float(expanded), unit)
        if value_mm is not None and uncertainty_mm is not None and math.isfinite(value_mm):
            name = " ".join(_contents(quantity, "dcc:name") or _result_name(quantity))
            label = real.findtext("si:label", "", NAMESPACES).strip()
            found.append(Length(quantity.get("id", ""), label, name, value_mm, uncertainty_mm, float(k)))
    return found


def number(text: str | None) -> Decimal | None:
    """Return a number of D-SI; None if the text is not a finite number in decimal notation."""
    try:
        found = Decimal((text or "").strip())
    except InvalidOperation:
        return None
    return found if found.is_finite() and abs(found.adjusted()) <= 300 else None


def _choose(lengths: Sequence[Length], wanted: str, where: str) -> Length:
    """Return the length that is wanted, or the focal length, or the only one."""
    if wanted:
        chosen = [one for one in lengths if wanted in (one.id, one.label, one.name)]
    else:
        named = [one for one in lengths if _is_focal_length(one)]
        chosen = named or list(lengths)
    if len(chosen) == 1:
        return chosen[0]
    known = "; ".join(one.called for one in lengths[:_MOST_NAMED]) or "none"
    what = f"length named {short(wanted)!r}" if wanted else "focal length"
    raise EvidenceError(
        f"The DCC does not state exactly one {what} with an expanded uncertainty. Lengths with one: {known}.",
        where=where,
        remedy="Name the quantity with --quantity, or copy the value by hand.",
    )


def _is_focal_length(one: Length) -> bool:
    return one.label.lower() in _LABELS or any(word in one.name.lower() for word in _WORDS)


def _result_name(quantity: _Element) -> list[str]:
    result = next(quantity.iterancestors(qualified("dcc:result")), None)
    return [] if result is None else _contents(result, "dcc:name")


def _contents(parent: _Element, path: str) -> list[str]:
    """Return the first text of an element, in the first language."""
    found = parent.find(f"{path}/dcc:content", NAMESPACES)
    return [] if found is None or not (found.text or "").strip() else [(found.text or "").strip()]


def _temperature(root: _Element) -> float | None:
    """Return the temperature among the conditions, if there is exactly one."""
    found = set()
    for condition in root.iterfind(".//dcc:influenceCondition", NAMESPACES):
        for real in condition.iterfind(".//si:real", NAMESPACES):
            value = number(real.findtext("si:value", None, NAMESPACES))
            unit = real.findtext("si:unit", "", NAMESPACES).strip()
            if value is not None and unit in (r"\degreecelsius", r"\kelvin"):
                found.add(round(float(value) - (273.15 if unit == r"\kelvin" else 0.0), 6))
    return found.pop() if len(found) == 1 else None
