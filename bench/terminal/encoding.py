"""Output to terminals and pipes whose encoding lacks a character: a plain substitute is written instead."""

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
    """Make text streams replace characters that their encoding lacks. Otherwise writing them would raise an error.

    Parameters
    ----------
    *streams
        Streams such as standard output; anything that is not a text stream is left as it is.
    """
    codecs.register_error(_NAME, _replaced)
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_NAME)


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(_PLAIN.get(character, "?") for character in missing), error.end
