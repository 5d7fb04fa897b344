"""The XML of digital calibration certificates (DCC): versions, names, safe reading, elements and bytes.

Reading loads no entity, no document type and nothing from other files or the network. lxml is imported by the functions
that need it, because it belongs to the extra ``certificate``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from bench.base.errors import EvidenceError, UsageError

if TYPE_CHECKING:
    from lxml.etree import _Element

LANGUAGE = "en"
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


@dataclass(frozen=True)
class Versions:
    """A version of the DCC and the version of D-SI that its schema imports. They are only valid together."""

    # dcc, si: Version of the DCC's schema and of D-SI's.
    dcc: str
    si: str


VERSIONS = (Versions("3.2.1", "2.1.0"),)
"""The pairs that can be written, checked and read; the first is written."""

_DOCTYPE = re.compile(rb"<!(?:DOCTYPE|ENTITY)", re.IGNORECASE)


def library(name: str) -> Any:
    """Import a library of the extra ``certificate``.

    Raises UsageError: When it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise UsageError(
            f"{name.partition('.')[0]} is not installed. Digital calibration certificates need it.",
            remedy="Install it: pip install 'starbench[certificate]'.",
        ) from error


def read_xml(data: bytes, where: str) -> _Element:
    """Read XML from a source that is not trusted.

    data: The file's content.
    Raises EvidenceError: When it is not well-formed XML in UTF-8, has a document type or an entity, or is too
      large.
    Raises UsageError: When lxml is not installed.
    """
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
    """Read a digital calibration certificate of a version in `VERSIONS`.

    data: The file's content.
    Raises EvidenceError: When it cannot be read safely, is not a DCC, or has another version.
    Raises UsageError: When lxml is not installed.
    """
    root = read_xml(data, where)
    if root.tag != ROOT:
        raise EvidenceError(
            f"This XML file is not a digital calibration certificate: its root is {short(str(root.tag))}.",
            where=where,
            remedy="Name the dcc.xml of a certificate.",
        )
    versions_of(root, where)
    return root


def versions_of(root: _Element, where: str) -> Versions:
    """Return the versions of a DCC.

    Raises EvidenceError: When the version is not in `VERSIONS`.
    """
    stated = root.get("schemaVersion", "")
    for one in VERSIONS:
        if one.dcc == stated:
            return one
    known = ", ".join(f"{one.dcc} with D-SI {one.si}" for one in VERSIONS)
    raise EvidenceError(
        f"The DCC has version {short(stated) or 'none'}; known: {known}.",
        where=where,
        remedy="Ask its issuer for a known version, or check it with another program.",
    )


def short(text: str, most: int = 80) -> str:
    """Return text of others for a message: printable, on one line, and not long.

    Returns: The text with runs of spaces joined, unprintable characters as ``?``, cut with ``…``.
    """
    joined = "".join(each if each.isprintable() else "?" for each in " ".join(text[: 8 * most].split()))
    return joined if len(joined) <= most else joined[: most - 1] + "…"


def qualified(name: str) -> str:
    """Return the name of an element as lxml writes it.

    name: Prefix and name, such as ``dcc:name``.

    Examples
    --------
    >>> qualified("si:unit")
    '{https://ptb.de/si}unit'
    """
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"


def add(parent: _Element, name: str, content: str | None = None, /, **attributes: str | None) -> _Element:
    """Add an element as the last child of another.

    content: Its text; None for none.
    attributes: Its attributes; those that are None are left out.
    """
    child = parent.makeelement(qualified(name), {key: value for key, value in attributes.items() if value})
    parent.append(child)
    if content is not None:
        child.text = printable(content)
    return child


def printable(text: str) -> str:
    """Return text that XML 1.0 can hold."""
    return _NOT_XML.sub("\ufffd", text)


_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def to_bytes(root: _Element) -> bytes:
    """Return a DCC as the bytes of its file. Spaces between its elements are written as they are.

    Returns: XML in UTF-8 with its declaration, and a line feed at its end.
    """
    etree = library("lxml.etree")
    body: bytes = etree.tostring(root.getroottree(), encoding="UTF-8", xml_declaration=False)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + body.strip() + b"\n"


def _unreadable(what: str, where: str) -> EvidenceError:
    return EvidenceError(
        f"The XML cannot be read: {what}.",
        where=where,
        remedy="Name the XML file of a certificate. If it is one, get it from the laboratory again.",
    )
