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
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


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


def printable(text: str) -> str:
    """Return text that XML 1.0 can hold."""
    return _NOT_XML.sub("\ufffd", text)


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
