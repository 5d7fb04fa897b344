"""Output to terminals and pipes: a plain substitute for what an encoding lacks, or what would steer the terminal."""

from __future__ import annotations

import codecs
import io
import re
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
_ASCII_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]")

_TIMES = {1: "once", 2: "twice"}


def replace_unencodable(*streams: TextIO | None) -> None:
    """Make text streams replace characters that their encoding lacks; others are left as they are."""
    codecs.register_error(_NAME, _replaced)
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_NAME)


def printable(text: str) -> str:
    r"""Write characters that would steer a terminal as escape sequences; names of files may hold them.

    >>> print(printable("a\x1b[2Jb"))
    a\x1b[2Jb
    """
    if text.isascii() and not _ASCII_CONTROLS.search(text):  # nearly every text, and the longest ones
        return text
    return "".join(map(_escaped, text))


def printable_line(text: str) -> str:
    r"""Write ends of lines so, too: a name of a file cannot write a line of its own.

    >>> print(printable_line("a\nSEALED: 20 files"))
    a\nSEALED: 20 files
    """
    return printable(text).replace("\n", r"\n").replace("\t", r"\t")


def printable_only(text: str) -> str:
    r"""Replace each character that is not printable, also an end of line, by a question mark.

    >>> printable_only("a\x1b[2Jb")
    'a?[2Jb'
    """
    return "".join(letter if letter.isprintable() else "?" for letter in text)


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


def clock_text(seconds: float) -> str:
    """Return a duration, s, as ``m:ss``, or ``h:mm:ss`` from one hour on; a negative one counts as zero.

    >>> clock_text(75), clock_text(4.2), clock_text(7322)
    ('1:15', '0:04', '2:02:02')
    """
    whole = max(0, round(seconds))
    hours, rest = divmod(whole, 3600)
    minutes, seconds_left = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{seconds_left:02d}" if hours else f"{minutes}:{seconds_left:02d}"


def plain_number(value: float, digits: int) -> str:
    """Return a number as a person writes it into a file: at most ``digits`` after the point, no needless zeros.

    >>> plain_number(2.50, 4), plain_number(-0.00001, 4), plain_number(10, 2)
    ('2.5', '0', '10')
    """
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural with "s" unless the number is 1.

    >>> counted(1, "recording"), counted(3, "pose"), counted(0, "run")
    ('1 recording', '3 poses', '0 runs')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def size_text(size_bytes: float) -> str:
    """Write a size in MB or GB (powers of 10).

    >>> size_text(17_650_000), size_text(2.5e9)
    ('18 MB', '2.5 GB')
    """
    if size_bytes < 1e9:
        return f"{size_bytes / 1e6:.0f} MB"
    return f"{size_bytes / 1e9:.1f} GB"


def times(number: int) -> str:
    """Return how often something was done.

    >>> times(1), times(2), times(5)
    ('once', 'twice', '5 times')
    """
    return _TIMES.get(number, f"{number} times")
