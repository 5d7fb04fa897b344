"""The XML of digital calibration certificates: version, names and bytes. lxml (an extra) is imported late."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from bench.base.entry_points import extra_library

if TYPE_CHECKING:
    from lxml.etree import _Element


NAMESPACES = {
    "dcc": "https://ptb.de/dcc",
    "si": "https://ptb.de/si",
    "xsi": "http://www.w3.org/2001/XMLSchema-instance",
    "starbench": "urn:starbench:certificate:1",
}
"""Prefixes of this package and their namespaces."""
DCC_VERSION = "3.2.1"
"""Version of the DCC; its schema imports D-SI 2.1.0."""

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
SIGNATURE = re.compile(rb"<ds:Signature[\s/>]")
"""Begin of a signature inside a DCC: earlier versions wrote one at its end on request."""
_SIGNATURE_END = b"</ds:Signature>\n"
_END = b"</dcc:digitalCalibrationCertificate>\n"


def library(name: str) -> Any:
    """Import a library of the extra ``certificate``. Raises UsageError when it is not installed."""
    what = f"{name.partition('.')[0]} is not installed. Certificates need it."
    return extra_library(name, what, remedy="Install it: pip install 'starbench[certificate]'.")


def printable(text: str) -> str:
    """Return text that XML 1.0 can hold."""
    return _NOT_XML.sub("\ufffd", text)


def to_bytes(root: _Element) -> bytes:
    """Return a DCC as its file: UTF-8 with declaration and final line feed, spaces between elements as they are."""
    etree = library("lxml.etree")
    body: bytes = etree.tostring(root.getroottree(), encoding="UTF-8", xml_declaration=False)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + body.strip() + b"\n"


def differs_by_a_signature(stored: bytes, dcc: bytes) -> bool:
    """Return whether a file is this DCC with one signature before its end, and nothing else."""
    begin = dcc.removesuffix(_END)
    inside = stored.removeprefix(begin).removesuffix(_END)
    return (
        stored == begin + inside + _END
        and SIGNATURE.match(inside) is not None
        and len(SIGNATURE.findall(inside)) == 1
        and inside.endswith(_SIGNATURE_END)
    )
