"""Terminals and pipes that cannot show every sign: they are told in signs they have, and nothing fails for it.

Knows streams and nothing of what is said.
"""

from __future__ import annotations

import codecs
import io
from typing import TextIO

_NAME = "starbench-plain"
_PLAIN = {
    "±": "+/-",
    "\N{MINUS SIGN}": "-",
    "≤": "<=",
    "≥": ">=",
    "°": "deg",
    "\N{HORIZONTAL ELLIPSIS}": "...",
}


def replace_unencodable(*streams: TextIO | None) -> None:
    """Let streams replace signs that their encoding lacks, instead of failing at them."""
    codecs.register_error(_NAME, _replaced)
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_NAME)


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(_PLAIN.get(sign, "?") for sign in missing), error.end
