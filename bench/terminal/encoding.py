"""Output to terminals and pipes: a plain substitute for what an encoding lacks, or what would steer the terminal."""

from __future__ import annotations

import codecs
import io
import unicodedata
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

    streams: Streams such as standard output; anything that is not a text stream is left as it is.
    """
    codecs.register_error(_NAME, _replaced)
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_NAME)


def printable(text: str) -> str:
    r"""Write characters that would steer a terminal as escape sequences; names of files may hold them.

    Examples
    --------
    >>> print(printable("a\x1b[2Jb"))
    a\x1b[2Jb
    """
    return "".join(_escaped(letter) for letter in text)


def _escaped(letter: str) -> str:
    if letter in "\n\t" or unicodedata.category(letter) not in {"Cc", "Cf", "Cs"}:
        return letter
    return (
        letter.encode("ascii", "backslashreplace").decode() if ord(letter) > 0x7F else f"\\x{ord(letter):02x}"
    )


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(_PLAIN.get(character, "?") for character in missing), error.end
