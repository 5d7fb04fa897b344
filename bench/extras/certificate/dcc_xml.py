"""The XML of digital calibration certificates: versions, names, safe reading, elements and bytes.

Reading loads no entity and nothing from other files or the network. lxml (extra ``certificate``) is imported late.
"""

from __future__ import annotations

import re
from importlib import import_module
from typing import TYPE_CHECKING, Any

from bench.base.errors import EvidenceError, UsageError

if TYPE_CHECKING:
    from lxml.etree import _Element


MOST_BYTES = 32 * 1024 * 1024
"""Largest DCC that is read. Those of Starbench have some hundred kilobytes."""
MOST_ELEMENTS = 100_000
"""Most elements, and most attributes, that are read: each takes some hundred bytes of memory."""

DCC = "https://ptb.de/dcc"
SI = "https://ptb.de/si"
DS = "http://www.w3.org/2000/09/xmldsig#"
XADES = "http://uri.etsi.org/01903/v1.3.2#"
XSI = "http://www.w3.org/2001/XMLSchema-instance"
STARBENCH = "urn:starbench:certificate:1"
NAMESPACES = {"dcc": DCC, "si": SI, "ds": DS, "xades": XADES, "xsi": XSI, "starbench": STARBENCH}
"""Prefixes of this package and their namespaces."""
ROOT = f"{{{DCC}}}digitalCalibrationCertificate"
SIGNATURE = f"{{{DS}}}Signature"


DCC_VERSION, SI_VERSION = "3.2.1", "2.1.0"
"""Version of the DCC, and of D-SI, which its schema imports. They are only valid together."""

_DOCTYPE = re.compile(rb"<!(?:DOCTYPE|ENTITY)", re.IGNORECASE)


def library(name: str) -> Any:
    """Import a library of the extra ``certificate``. Raises UsageError when it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        raise UsageError(
            f"{name.partition('.')[0]} is not installed. Certificates need it.",
            remedy="Install it: pip install 'starbench[certificate]'.",
        ) from error


def read_xml(data: bytes, where: str) -> _Element:
    """Read XML from a source that is not trusted: UTF-8 without document type or entity, and not too large."""
    etree = library("lxml.etree")
    if len(data) > MOST_BYTES:
        raise _unreadable(f"it has {len(data)} bytes; at most {MOST_BYTES} are read", where)
    if data.count(b"<") > 2 * MOST_ELEMENTS or data.count(b"=") > MOST_ELEMENTS:
        raise _unreadable(f"it has more than {MOST_ELEMENTS} elements or attributes", where)
    if b"\x00" in data:
        raise _unreadable("it is not XML in UTF-8", where)
    if _DOCTYPE.search(data):
        raise _unreadable("it declares a document type or an entity, which a DCC never needs", where)
    parser = etree.XMLParser(
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        dtd_validation=False,
        attribute_defaults=False,
        huge_tree=False,
        remove_blank_text=False,
        strip_cdata=False,
        collect_ids=False,
    )
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError, LookupError) as error:
        raise _unreadable(f"it is not well-formed XML ({error})", where) from error
    if (root.getroottree().docinfo.encoding or "UTF-8").upper() not in ("UTF-8", "US-ASCII", "ASCII"):
        raise _unreadable("it is not XML in UTF-8", where)
    return root


def read_dcc(data: bytes, where: str) -> _Element:
    """Read a digital calibration certificate of version `DCC_VERSION`, from a source that is not trusted."""
    root = read_xml(data, where)
    if root.tag != ROOT:
        raise EvidenceError(
            f"This XML file is not a digital calibration certificate: its root is {short(str(root.tag))}.",
            where=where,
            remedy="Name the dcc.xml of a certificate.",
        )
    stated = root.get("schemaVersion", "")
    if stated != DCC_VERSION:
        raise EvidenceError(
            f"The DCC has version {short(stated) or 'none'}; known: {DCC_VERSION} with D-SI {SI_VERSION}.",
            where=where,
            remedy="Ask its issuer for a known version, or check it with another program.",
        )
    return root


def short(text: str, most: int = 80) -> str:
    """Return text of others for a message: on one line, unprintable characters as ``?``, cut with ``…``."""
    joined = "".join(each if each.isprintable() else "?" for each in " ".join(text[: 8 * most].split()))
    return joined if len(joined) <= most else joined[: most - 1] + "…"


def qualified(name: str) -> str:
    """Return the name of an element with its prefix, such as ``dcc:name``, as lxml writes it.

    >>> qualified("si:unit")
    '{https://ptb.de/si}unit'
    """
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"


def printable(text: str) -> str:
    """Return text that XML 1.0 can hold."""
    return _NOT_XML.sub("\ufffd", text)


_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def to_bytes(root: _Element) -> bytes:
    """Return a DCC as its file: UTF-8 with declaration and final line feed, spaces between elements as they are."""
    etree = library("lxml.etree")
    body: bytes = etree.tostring(root.getroottree(), encoding="UTF-8", xml_declaration=False)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + body.strip() + b"\n"


def _unreadable(what: str, where: str) -> EvidenceError:
    return EvidenceError(
        f"The XML cannot be read: {what}.",
        where=where,
        remedy="Name the XML file of a certificate. If it is one, get it from the laboratory again.",
    )


# Units of the Digital System of Units (D-SI), as its XML writes them: ``\milli\metre``, ``\metre\per\second``.

PREFIXES = {
    "quecto": -30, "ronto": -27, "yocto": -24, "zepto": -21, "atto": -18, "femto": -15, "pico": -12, "nano": -9,
    "micro": -6, "milli": -3, "centi": -2, "deci": -1, "deca": 1, "hecto": 2, "kilo": 3, "mega": 6, "giga": 9,
    "tera": 12, "peta": 15, "exa": 18, "zetta": 21, "yotta": 24, "ronna": 27, "quetta": 30,
}  # fmt: skip
"""Prefixes, each with its power of ten."""
_WITH_PREFIX = (
    "ampere candela kelvin metre mole second becquerel coulomb farad gray henry hertz joule katal lumen lux newton ohm"
    " pascal radian siemens sievert steradian tesla volt watt weber angstrom arcminute arcsecond astronomicalunit bar"
    " barn bel bit byte dalton degree electronvolt gram knot litre nauticalmile neper tonne"
)
_ALONE = "day decibel degreecelsius hectare hour kilogram minute mmHg"


def _one_of(names: str) -> str:
    return rf"\\(?:{'|'.join(names.split())})"


_BINARY = rf"{_one_of('kibi mebi gibi tebi pebi exbi zebi yobi')}{_one_of('bit byte')}"
_DECIMAL = rf"(?!\\kilo\\gram(?:\\|$))(?:{_one_of(' '.join(PREFIXES))})?{_one_of(_WITH_PREFIX)}"
_POWER = r"\\tothe\{-?\d{1,2}(?:[._]\d{1,2})?\}"
_PRODUCT = (
    rf"(?:(?:{_one_of('one percent ppm')}|(?:{_BINARY}|{_one_of(_ALONE)}|{_DECIMAL})(?:{_POWER})?)(?=\\|$))+"
)
_UNIT = re.compile(rf"{_PRODUCT}(?:\\per{_PRODUCT})?")

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
    r"""Return the D-SI form of a unit that Starbench prints; None if it has none.

    That is one of `OUR_UNITS`, a quotient of these such as ``px / (mm/K)``, or a unit in D-SI's notation.

    >>> d_si_unit("arcsec"), d_si_unit("mm/K"), d_si_unit("px / (mm/K)"), d_si_unit("furlong")
    ('\\arcsecond', '\\milli\\metre\\kelvin\\tothe{-1}', '\\milli\\metre\\tothe{-1}\\kelvin', None)
    """
    if unit in OUR_UNITS:
        return OUR_UNITS[unit]
    if is_unit(unit):
        return unit
    powers = _powers(unit)
    written = "" if powers is None else _written(powers)
    return written if is_unit(written) else None


def product(first: str, second: str) -> str:
    r"""Return the unit of two units' covariance: D-SI units among the values of `OUR_UNITS` that have no power.

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


def is_unit(text: str) -> bool:
    r"""Return whether a text is a unit of D-SI.

    >>> [is_unit(one) for one in (r"\metre\per\second", r"\pixel", r"\milli\milli\metre", r"\one\tothe{2}")]
    [True, False, False, False]
    """
    return _UNIT.fullmatch(text) is not None
