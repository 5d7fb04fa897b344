r"""What all parts of a digital certificate write: units, texts, numbers, software, identifications, refTypes.

Units are those of the Digital System of Units (D-SI), as its XML writes them: ``\milli\metre``, ``\metre\per\second``.
The schema takes any text for a unit; these functions do not. Units and prefixes are those of the SI brochure (BIPM, 9th
edition, tables 2 to 8) in the notation of D-SI (Hutzschenreuter et al. 2019, SmartCom Digital System of Units, chapter
2). D-SI has no pixel: lengths in the image have the unit ``\one``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import Decimal
from functools import cache
from typing import TYPE_CHECKING

from bench.certificate.certificate_data import Certificate, Software
from bench.certificate.dcc_xml import LANGUAGE, add
from bench.certificate.sealed_run import FORM

if TYPE_CHECKING:
    from lxml.etree import _Element


PREFIXES = {
    "quecto": -30, "ronto": -27, "yocto": -24, "zepto": -21, "atto": -18, "femto": -15, "pico": -12, "nano": -9,
    "micro": -6, "milli": -3, "centi": -2, "deci": -1, "deca": 1, "hecto": 2, "kilo": 3, "mega": 6, "giga": 9,
    "tera": 12, "peta": 15, "exa": 18, "zetta": 21, "yotta": 24, "ronna": 27, "quetta": 30,
}  # fmt: skip
"""Prefixes, each with its power of ten."""
BINARY_PREFIXES = frozenset(("kibi", "mebi", "gibi", "tebi", "pebi", "exbi", "zebi", "yobi"))

_WITHOUT_POWER = frozenset(("one", "percent", "ppm"))
_WITHOUT_PREFIX = _WITHOUT_POWER | {
    "day", "decibel", "degreecelsius", "hectare", "hour", "kilogram", "minute", "mmHg",
}  # fmt: skip
_WITH_PREFIX = frozenset((
    "ampere", "candela", "kelvin", "metre", "mole", "second",
    "becquerel", "coulomb", "farad", "gram", "gray", "henry", "hertz", "joule", "katal", "lumen", "lux", "newton",
    "ohm", "pascal", "radian", "siemens", "sievert", "steradian", "tesla", "volt", "watt", "weber",
    "angstrom", "arcminute", "arcsecond", "astronomicalunit", "bar", "barn", "bel", "bit", "byte", "dalton", "degree",
    "electronvolt", "knot", "litre", "nauticalmile", "neper", "tonne",
))  # fmt: skip
_POWER = re.compile(r"tothe\{(-?\d{1,2}(?:[._]\d{1,2})?)\}")

OUR_UNITS = {
    "": r"\one",
    "1": r"\one",
    "px": r"\one",
    "%": r"\percent",
    "ppm": r"\ppm",
    "m": r"\metre",
    "mm": r"\milli\metre",
    "µm": r"\micro\metre",
    "nm": r"\nano\metre",
    "rad": r"\radian",
    "mrad": r"\milli\radian",
    "µrad": r"\micro\radian",
    "deg": r"\degree",
    "°": r"\degree",
    "arcmin": r"\arcminute",
    "arcsec": r"\arcsecond",
    "s": r"\second",
    "ms": r"\milli\second",
    "min": r"\minute",
    "h": r"\hour",
    "Hz": r"\hertz",
    "kHz": r"\kilo\hertz",
    "MHz": r"\mega\hertz",
    "K": r"\kelvin",
    "°C": r"\degreecelsius",
    "%RH": r"\percent",
    "% RH": r"\percent",
    "hPa": r"\hecto\pascal",
    "kPa": r"\kilo\pascal",
    "Pa": r"\pascal",
    "mbar": r"\milli\bar",
    "lx": r"\lux",
    "V": r"\volt",
    "A": r"\ampere",
    "mA": r"\milli\ampere",
    "Mev/s": r"\micro\second\tothe{-1}",
    "event": r"\one",
    "events": r"\one",
}
"""Units as Starbench prints them, and as D-SI writes them."""


_QUOTIENT = re.compile(r"\s*([^/()]+?)\s*(?:/\s*(?:\((.+)\)|(.+)))?\s*")


def d_si_unit(unit: str) -> str | None:
    r"""Return the D-SI form of a unit that Starbench prints.

    unit: One of `OUR_UNITS`, a quotient of these such as ``px / (mm/K)``, or a unit in D-SI's notation.
    Returns: The unit in D-SI's notation; None if it has none.

    Examples
    --------
    >>> d_si_unit("arcsec"), d_si_unit("mm/K"), d_si_unit("px / (mm/K)"), d_si_unit("furlong")
    ('\\arcsecond', '\\milli\\metre\\kelvin\\tothe{-1}', '\\milli\\metre\\tothe{-1}\\kelvin', None)
    """
    if unit in OUR_UNITS:
        return OUR_UNITS[unit]
    if unit_fault(unit) is None:
        return unit
    powers = _powers(unit)
    written = "" if powers is None else _written(powers)
    return written if unit_fault(written) is None else None


def product(first: str, second: str) -> str:
    r"""Return the product of two units, the unit of their covariance.

    first, second: Units of D-SI among the values of `OUR_UNITS` that have no power.

    Examples
    --------
    >>> product(r"\one", r"\milli\metre"), product(r"\milli\metre", r"\milli\metre"), product(r"\one", r"\one")
    ('\\milli\\metre', '\\milli\\metre\\tothe{2}', '\\one')
    """
    powers = {first: 1}
    powers[second] = powers.get(second, 0) + 1
    return _written(powers)


def _powers(unit: str) -> dict[str, int] | None:
    """Return the units of D-SI in a unit that Starbench prints, each with its power."""
    found = _QUOTIENT.fullmatch(unit)
    if found is None or found[1] not in OUR_UNITS:
        return None
    powers = {OUR_UNITS[found[1]]: 1}
    divisor = found[2] or found[3]
    if divisor is None:
        return powers
    below = {OUR_UNITS[divisor]: 1} if divisor in OUR_UNITS else _powers(divisor)
    if below is None or any("tothe" in one or "per\\" in one for one in (*powers, *below)):
        return None
    for one, power in below.items():
        powers[one] = powers.get(one, 0) - power
    return powers


def _written(powers: dict[str, int]) -> str:
    """Return a product of units in D-SI's notation."""
    parts = [
        one if power == 1 else rf"{one}\tothe{{{power}}}"
        for one, power in powers.items()
        if one != r"\one" and power != 0
    ]
    return "".join(parts) or r"\one"


@cache
def unit_fault(unit: str) -> str | None:
    r"""Return why a text is not a unit of D-SI.

    Returns: The reason; None if it is a unit.

    Examples
    --------
    >>> unit_fault(r"\metre\per\second") is None
    True
    >>> unit_fault(r"\pixel")
    'D-SI knows no unit or prefix \\pixel'
    """
    if not unit.startswith("\\"):
        return r"it does not begin with a backslash, as \metre does"
    if any(each.isspace() for each in unit):
        return "it has a space"
    words = unit.split("\\")[1:]
    if words.count("per") > 1:
        return r"it has more than one \per"
    at = words.index("per") if "per" in words else len(words)
    products = [words[:at]] if at == len(words) else [words[:at], words[at + 1 :]]
    return next(filter(None, map(_product_fault, products)), None)


def _product_fault(words: Sequence[str]) -> str | None:
    """Return why words are not a product of units with prefixes and powers."""
    prefix, unit = "", ""
    for word in words:
        if word.startswith("tothe"):
            if fault := _power_fault(word, "" if prefix else unit):
                return fault
            unit = "?"
        elif word in PREFIXES or word in BINARY_PREFIXES:
            if prefix:
                return f"\\{prefix}\\{word} are two prefixes"
            prefix = word
        elif fault := _unit_with_prefix_fault(prefix, word):
            return fault
        else:
            prefix, unit = "", word
    if prefix:
        return f"no unit follows the prefix \\{prefix}"
    return None if unit else r"a unit is missing beside \per"


def _power_fault(word: str, unit: str) -> str | None:
    """Return why a word is not the power of a unit (``?`` for one that has a power)."""
    if _POWER.fullmatch(word) is None:
        return f"\\{word} is not a power such as \\tothe{{-1}}"
    if unit in ("", "?"):
        return f"\\{word} follows no unit"
    return f"\\{unit} takes no power" if unit in _WITHOUT_POWER else None


def _unit_with_prefix_fault(prefix: str, unit: str) -> str | None:
    if unit not in _WITH_PREFIX | _WITHOUT_PREFIX:
        return f"D-SI knows no unit or prefix \\{unit}"
    if not prefix:
        return None
    binary = prefix in BINARY_PREFIXES
    if (
        unit in _WITHOUT_PREFIX
        or (binary and unit not in ("bit", "byte"))
        or (prefix, unit) == ("kilo", "gram")
    ):
        return f"\\{unit} does not take the prefix \\{prefix}"
    return None


def length_mm(value: float, unit: str) -> float | None:
    r"""Return a length in millimetres.

    unit: Its unit in D-SI's notation: ``\metre``, with a prefix or without.
    Returns: The length, mm; None if the unit is not one of length.

    Examples
    --------
    >>> length_mm(0.255, r"\metre"), length_mm(255.0, r"\milli\metre"), length_mm(1.0, r"\second")
    (255.0, 255.0, None)
    """
    found = re.fullmatch(r"(?:\\(\w+))?\\metre", unit)
    if found is None or (found[1] and found[1] not in PREFIXES):
        return None
    power = (PREFIXES[found[1]] if found[1] else 0) + 3
    return value * 10**power if power >= 0 else value / 10**-power


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
