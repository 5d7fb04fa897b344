"""What all parts of a digital calibration certificate write: texts, numbers, software, identifications, refTypes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import Decimal
from typing import TYPE_CHECKING

from bench.certificate.certificate_data import Certificate, Software
from bench.certificate.dcc_units import d_si_unit
from bench.certificate.dcc_xml import LANGUAGE, add
from bench.certificate.written_with import FORM

if TYPE_CHECKING:
    from lxml.etree import _Element

SIMULATED = "SIMULATED"
STATISTIC = "starbench_statistic"
BUDGET = "starbench_budgetEntry"
EARLIER = "starbench_earlierValue"
DEGREES_OF_FREEDOM = "starbench_effectiveDegreesOfFreedom"
JOINT = "starbench_jointCovariance"
SIMULATED_TYPE = "starbench_simulated"
LIMIT = "starbench_limit"
CONTRIBUTION = "contribution to the standard uncertainty"
COMBINED = "combined standard uncertainty"

REF_TYPES = {
    STATISTIC: "A number that is itself an uncertainty or a residual; it has no uncertainty of its own.",
    BUDGET: "A number of an uncertainty budget.",
    EARLIER: "A number of an earlier calibration, as stated there.",
    DEGREES_OF_FREEDOM: "Effective degrees of freedom of a result's uncertainty (JCGM 100, G.4).",
    JOINT: "All results, unrounded, with their covariance matrix (JCGM 102).",
    SIMULATED_TYPE: "States that devices were simulated: this is not a calibration of a real item.",
    LIMIT: "A limit of tolerance or a guard band of a statement of conformity.",
}
"""The refTypes of Starbench and their meanings. Those that begin with ``basic_`` are PTB's."""

_RELEASE = re.compile(r"\d{1,3}(?:\.\d{1,3}){0,3}(?![0-9A-Za-z])")


def joined(*parts: str) -> str:
    """Return texts as one.

    parts: The texts; empty ones are left out.
    Returns: The text, with a semicolon between parts where there is no full stop.
    """
    whole = ""
    for part in filter(None, map(str.strip, parts)):
        between = "" if not whole else (" " if whole.endswith(".") else "; ")
        whole += between + part
    return whole


def token(text: str) -> str:
    """Return text for an element that must not begin or end with a space.

    Returns: The text with each run of spaces as one space; ``-`` if nothing is left.
    """
    return " ".join(text.split()) or "-"


def add_text(parent: _Element, name: str, text: str, /, **attributes: str | None) -> _Element:
    """Add an element of the type ``textType`` or ``richContentType`` with one text.

    attributes: Attributes of the element; those that are None are left out.
    """
    new = add(parent, name, **attributes)
    add(new, "dcc:content", text.strip() or "-", lang=LANGUAGE)
    return new


def number_text(value: float) -> str:
    """Return a number as D-SI writes it, with all its digits.

    Raises ValueError: When it is not finite.

    Examples
    --------
    >>> number_text(-0.25), number_text(1e-7), number_text(3)
    ('-0.25', '1e-07', '3.0')
    """
    text = repr(float(value))
    if not text.strip("-")[0].isdigit():
        raise ValueError(f"{text} is not a number that D-SI can state")
    return text


def plain_number(value: float, digits: int) -> str:
    """Return a number without an exponent, as D-SI wants coverage factors and probabilities.

    Returns: The number, without zeros at its end.

    Examples
    --------
    >>> plain_number(2.0, 4), plain_number(0.95450, 5)
    ('2', '0.9545')
    """
    return f"{Decimal(repr(round(float(value), digits))).normalize():f}"


def add_real(
    parent: _Element, value: str, unit: str, /, *, label: str = "", expanded: tuple[str, ...] = ()
) -> _Element:
    """Add a number with its unit as ``si:real``.

    value: The number in D-SI's notation.
    unit: The unit in D-SI's notation.
    label: Label of the number; empty for none.
    expanded: Expanded uncertainty, coverage factor, probability of coverage and, if it is known,
      distribution; empty for a number without uncertainty.
    """
    real = add(parent, "si:real")
    if label:
        add(real, "si:label", label)
    add(real, "si:value", value)
    add(real, "si:unit", unit)
    if expanded:
        stated = add(real, "si:expandedUnc")
        names = ("uncertainty", "coverageFactor", "coverageProbability", "distribution")
        for name, text in zip(names, expanded, strict=False):
            add(stated, f"si:{name}", text)
    return real


def add_number(parent: _Element, name: str, value: float, unit: str, ref_type: str) -> None:
    """Add a quantity without uncertainty: ``si:real`` if D-SI has its unit, else words.

    ref_type: The quantity's refType.
    """
    quantity = add(parent, "dcc:quantity", refType=ref_type)
    add_text(quantity, "dcc:name", name)
    written = d_si_unit(unit)
    if written is None:
        add_text(quantity, "dcc:noQuantity", f"{number_text(value)} {unit}")
    else:
        add_real(quantity, number_text(value), written)


def add_words(parent: _Element, name: str, text: str, ref_type: str) -> None:
    """Add a quantity that is stated in words.

    ref_type: The quantity's refType.
    """
    quantity = add(parent, "dcc:quantity", refType=ref_type)
    add_text(quantity, "dcc:name", name)
    add_text(quantity, "dcc:noQuantity", text)


def add_software(parent: _Element, programs: Sequence[Software]) -> None:
    """Add programs to a list of software. A release is written as ``v1.2.3``, which PTB's rules want."""
    for one in programs:
        software = add(parent, "dcc:software")
        add_text(software, "dcc:name", one.name)
        release = _RELEASE.match(one.version)
        add(software, "dcc:release", f"v{release[0] if release else '0'}")
        add(software, "dcc:type", "application" if one.name in ("starbench", "python") else "library")
        if release is None or release[0] != one.version:
            add_text(software, "dcc:description", f"Full version: {one.version}")


def software_of(certificate: Certificate) -> tuple[list[Software], list[Software]]:
    """Return the programs of the run, and what wrote the certificate."""
    listed = list(certificate.run.software)
    at = next((at for at, one in enumerate(listed) if one.name == FORM), len(listed))
    return listed[:at], listed[at:]


def identifications(parent: _Element, *found: tuple[str, str, str]) -> None:
    """Add identifications.

    found: Issuer (a word of the DCC), value and name of each; those without a value are left out. A name of
      ``Serial number`` gets PTB's refType.
    """
    stated = [one for one in found if one[1].strip()]
    if not stated:
        return
    several = add(parent, "dcc:identifications")
    for issuer, value, name in stated:
        one = add(
            several, "dcc:identification", refType="basic_serialNumber" if name == "Serial number" else None
        )
        add(one, "dcc:issuer", issuer)
        add(one, "dcc:value", token(value))
        add_text(one, "dcc:name", name)
