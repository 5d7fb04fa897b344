"""The certificate as PDF/A-3a, made by typst (extra ``certificate``). The same input gives the same bytes.

All text reaches typst as data, never as markup. The fonts are fixed (`bench.certificate.pdf_glyphs`), the date of the
document is the date of issue, and the clock and the fonts of the computer are not used.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from importlib import resources
from importlib.metadata import version
from tempfile import TemporaryDirectory
from textwrap import shorten
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

from bench import __version__
from bench.base.errors import BenchError, UsageError
from bench.certificate import pdf_glyphs
from bench.certificate.pdf_opening import opening, subject
from bench.certificate.pdf_plots import Picture, draw_plots, pictures
from bench.certificate.pdf_sections import sections
from bench.records.results import Results
from bench.report.target_words import words_of

if TYPE_CHECKING:
    from bench.certificate.certificate_data import Certificate

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
    plots: SVG by name, from `bench.certificate.pdf_plots.plots_of_run`; None to draw what follows from
      ``results`` alone.
    Raises UsageError: When typst is not installed, or the laboratory wrote characters that the fonts do not
      have.
    Raises BenchError: When typst refuses the document.
    """
    _typst()
    content = json.loads(certificate.to_json())
    pdf_glyphs.refuse_missing(content)
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
        coded["sections"][-1]["blocks"].append(
            {"kind": "paragraph", "tone": "note", "text": pdf_glyphs.CODE_NOTE}
        )
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
        return pdf_glyphs.with_codes(found)
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
        **{name: pdf_glyphs.with_codes(text).encode() for name, text in svg.items()},
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
            compiler = make(
                files, root=empty, font_paths=[pdf_glyphs.font_folder()], ignore_system_fonts=True
            )
            found = compiler.compile(format="pdf", pdf_standards=list(STANDARDS))
    except RuntimeError as error:
        raise BenchError(
            f"typst could not make the certificate: {str(error).splitlines()[0]}",
            where=PDF,
            remedy="This is a fault of Starbench or another version of typst. Report it with certificate.json.",
        ) from error
    assert isinstance(found, bytes)
    return found
