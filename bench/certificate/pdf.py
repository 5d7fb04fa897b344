"""The certificate as PDF/A-3a, made by typst (extra ``certificate``). The same input gives the same bytes.

All text reaches typst as data, never as markup. The date of the document is the date of issue, and the clock and the
fonts of the computer are not used.

A certificate never shows an empty box for a character. What the laboratory wrote must be printable: else the
certificate is refused, with the field and the characters. What comes from the sealed run cannot be changed any more:
there a character that is missing is printed as its code, such as ``[U+5C71]``, and a note says so. The fonts are DejaVu
Sans and DejaVu Sans Bold; Matplotlib brings them. They have Latin, Greek, Cyrillic, Armenian, Georgian, Hebrew and
Arabic letters and mathematical signs, but no Chinese, Japanese, Korean, Indian or Thai letters.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from functools import cache
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import shorten
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

from bench import __version__
from bench.base.errors import BenchError, UsageError
from bench.certificate.pdf_blocks import Picture, draw_plots, pictures
from bench.certificate.pdf_sections import opening, sections, subject
from bench.records.results import Results
from bench.report.text import words_of

if TYPE_CHECKING:
    from bench.certificate.certificate_data import Certificate


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


PDF = "certificate.pdf"
STANDARDS: tuple[Literal["a-3a"], Literal["ua-1"]] = ("a-3a", "ua-1")
"""PDF/A-3a (ISO 19005-3) for the archive, and PDF/UA-1 (ISO 14289-1) for screen readers."""
_KINDS = {
    "dcc.xml": (
        "application/xml",
        "alternative",
        "This certificate as a digital calibration certificate (DCC)",
    ),
    "certificate.json": ("application/json", "source", "All values of this certificate"),
    "results.json": ("application/json", "source", "Results of the sealed run"),
}
_HEADER = 120
"""Most characters of the laboratory's name in the head of a page."""
_OTHER = ("application/octet-stream", "supplement", "Supplement to this certificate")


def render_pdf(
    certificate: Certificate,
    results: Results,
    attachments: Mapping[str, bytes],
    plots: Mapping[str, str] | None = None,
) -> bytes:
    """Render a certificate as PDF/A-3a with its files attached.

    results: Content of the run's results.json.
    attachments: Files to attach, by name: ``dcc.xml`` and ``results.json``.
    plots: SVG by name, from `bench.certificate.pdf_blocks.plots_of_run`; None to draw what follows from
      ``results`` alone.
    Raises UsageError: When typst is not installed, or the laboratory wrote characters that the fonts do not
      have.
    Raises BenchError: When typst refuses the document.
    """
    _typst()
    content = json.loads(certificate.to_json())
    refuse_missing(content)
    shown = pictures(certificate, draw_plots(results) if plots is None else plots, words_of(results))
    files = {one.file: one.svg for one in shown}
    return _compiled(_document(certificate, shown, attachments), files, attachments)


def _keywords(certificate: Certificate) -> list[str]:
    return [certificate.number, certificate.item.camera.serial, "calibration", "ISO/IEC 17025"]


def _programs() -> str:
    return "; ".join(
        [f"Starbench {__version__}", *(f"{name} {version(name)}" for name in ("typst", "matplotlib"))]
    )


def _document(
    certificate: Certificate, shown: list[Picture], attachments: Mapping[str, bytes]
) -> dict[str, Any]:
    """Return the document as data for the layout; every text in it can be printed."""
    issued = datetime.fromisoformat(certificate.issued_utc)
    found: dict[str, Any] = {
        "title": f"{certificate.title} {certificate.number}",
        "heading": certificate.title,
        "subject": subject(certificate),
        "author": certificate.laboratory.name,
        "keywords": [*_keywords(certificate), f"rendered by {_programs()}"],
        "language": certificate.language,
        "number": certificate.number,
        "simulated": certificate.simulated,
        "laboratory": shorten(certificate.laboratory.name, _HEADER, placeholder=" …"),
        "date": [issued.year, issued.month, issued.day, issued.hour, issued.minute, issued.second],
        "footer": f"Certificate {certificate.number}. SEALED; not a certificate until authorised, see “Authorisation”.",
        "end_mark": f"END OF CERTIFICATE {certificate.number}",
        "attachments": [_attachment(name, data) for name, data in sorted(attachments.items())],
        "opening": opening(certificate),
        "sections": sections(certificate, shown, attachments),
    }
    coded = _with_codes(found)
    if "[U+" in json.dumps(coded):
        coded["sections"][-1]["blocks"].append({"kind": "paragraph", "tone": "note", "text": CODE_NOTE})
    return dict(coded)


def _attachment(name: str, data: bytes) -> dict[str, Any]:
    mime_type, relationship, description = _KINDS.get(name, _OTHER)
    return {
        "name": name,
        "file": f"attached/{name}",
        "encoded": not _is_text(data),
        "mime_type": mime_type,
        "relationship": relationship,
        "description": description,
    }


def _is_text(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


def _with_codes(found: Any) -> Any:
    """Replace every character that cannot be printed by its code."""
    if isinstance(found, str):
        return with_codes(found)
    if isinstance(found, dict):
        return {name: _with_codes(value) for name, value in found.items()}
    if isinstance(found, list | tuple):
        return [_with_codes(value) for value in found]
    return found


def _typst() -> ModuleType:
    try:
        import typst
    except ImportError as error:
        raise UsageError(
            "A certificate as PDF needs typst, which is not installed.",
            remedy="Install it: pip install 'starbench[certificate]'.",
        ) from error
    return typst


def _compiled(document: Mapping[str, Any], svg: Mapping[str, str], attachments: Mapping[str, bytes]) -> bytes:
    files: dict[str, bytes] = {
        "main.typ": resources.files("bench.certificate").joinpath("certificate.typ").read_bytes(),
        "document.json": json.dumps(document, ensure_ascii=False).encode(),
        **{name: with_codes(text).encode() for name, text in svg.items()},
        **{
            f"attached/{name}": data if _is_text(data) else json.dumps(list(data)).encode()
            for name, data in attachments.items()
        },
    }
    try:
        make = _typst().Compiler
        with (
            TemporaryDirectory() as empty
        ):  # without a root, a plot could name a file of the working directory
            compiler = make(files, root=empty, font_paths=[font_folder()], ignore_system_fonts=True)
            found = compiler.compile(format="pdf", pdf_standards=list(STANDARDS))
    except RuntimeError as error:
        raise BenchError(
            f"typst could not make the certificate: {str(error).splitlines()[0]}",
            where=PDF,
            remedy="This is a fault of Starbench or another version of typst. Report it with certificate.json.",
        ) from error
    assert isinstance(found, bytes)
    return found
