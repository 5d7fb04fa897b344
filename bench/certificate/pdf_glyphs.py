"""Which characters the fonts of the certificate can print, and what happens to the others.

A certificate never shows an empty box for a character. What the laboratory wrote must be printable: else the
certificate is refused, with the field and the characters. What comes from the sealed run cannot be changed any more:
there a character that is missing is printed as its code, such as ``[U+5C71]``, and a note says so.

The fonts are DejaVu Sans and DejaVu Sans Bold; Matplotlib brings them. They have Latin, Greek, Cyrillic, Armenian,
Georgian, Hebrew and Arabic letters and mathematical signs, but no Chinese, Japanese, Korean, Indian or Thai letters.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from bench.base.errors import UsageError

_FONTS = ("DejaVuSans.ttf", "DejaVuSans-Bold.ttf")
_JOINERS = frozenset("\N{ZERO WIDTH NON-JOINER}\N{ZERO WIDTH JOINER}")
_UNPRINTABLE = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""Control, format (which can turn the order of digits round), private and unassigned characters."""
_FROM_RUN = re.compile(r"run\.|results\[|covariance\.|further\[|budgets\[|item\.camera\.|amends\.changes\[")
_ENTRY = re.compile(r"(deviations|conditions|statements)\[(\d+)\]")
_OF_LABORATORY = frozenset({"traceability", "recalibration", "also"})
"""Statements that the laboratory words."""
_MOST_SHOWN = 8
CODE_NOTE = (
    "A code in square brackets, such as [U+5C71], stands for a character that the fonts of this document do not have."
    " The exact text is in certificate.json."
)


def font_folder() -> Path:
    """Return the folder of the fonts."""
    from matplotlib import get_data_path

    return Path(get_data_path()) / "fonts" / "ttf"


@cache
def printable() -> frozenset[int]:
    """Return the characters that every font of the certificate has."""
    from matplotlib.ft2font import FT2Font

    found = [set(FT2Font(str(font_folder() / name)).get_charmap()) for name in _FONTS]
    return frozenset(set.intersection(*found))


def missing(text: str) -> list[str]:
    """Return the characters of a text that cannot be printed.

    Returns: The characters, each once, in the order of the text.
    """
    return list(dict.fromkeys(one for one in text if not _is_printable(one)))


def _is_printable(one: str) -> bool:
    if one == "\n" or one in _JOINERS:
        return True
    return ord(one) in printable() and unicodedata.category(one) not in _UNPRINTABLE


def with_codes(text: str) -> str:
    """Return a text with the code of each character that cannot be printed in its place.

    Returns: The text; it has only characters that can be printed.

    Examples
    --------
    >>> with_codes("pose 山 1")
    'pose [U+5C71] 1'
    """
    return "".join(one if _is_printable(one) else f"[U+{ord(one):04X}]" for one in text)


def faults(certificate: Mapping[str, Any]) -> list[str]:
    """Return what the laboratory must write in other letters.

    certificate: The certificate as `certificate.json` holds it.
    Returns: A line for each field, such as ``customer.name has 山 (U+5C71)``.
    """
    return [
        f"{path} has {_named(found)}"
        for path, text in _texts(certificate, "")
        if not _is_from_run(certificate, path) and (found := missing(text))
    ]


def _is_from_run(certificate: Mapping[str, Any], path: str) -> bool:
    if entry := _ENTRY.match(path):  # both the run and the laboratory write these
        found = certificate[entry[1]][int(entry[2])]
        return bool(found["id"] not in _OF_LABORATORY if "id" in found else found["source"] == "run")
    return bool(_FROM_RUN.match(path))


def refuse_missing(certificate: Mapping[str, Any]) -> None:
    """Refuse a certificate in which the laboratory wrote characters that cannot be printed.

    certificate: The certificate as `certificate.json` holds it.
    """
    if found := faults(certificate):
        raise UsageError(
            f"The fonts of the certificate cannot print these characters: {'; '.join(found)}.",
            remedy="Write the text in Latin, Greek, Cyrillic, Armenian, Georgian, Hebrew or Arabic letters, without"
            " control characters.",
        )


def _named(characters: Sequence[str]) -> str:
    shown = [
        f"{one} (U+{ord(one):04X})" if unicodedata.category(one) not in _UNPRINTABLE else f"U+{ord(one):04X}"
        for one in characters[:_MOST_SHOWN]
    ]
    more = len(characters) - _MOST_SHOWN
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


def _texts(found: Any, path: str) -> Iterator[tuple[str, str]]:
    if isinstance(found, str):
        yield path, found
    elif isinstance(found, Mapping):
        for name, value in found.items():
            yield from _texts(value, f"{path}.{name}" if path else name)
    elif isinstance(found, Sequence):
        for number, value in enumerate(found):
            yield from _texts(value, f"{path}[{number}]")
