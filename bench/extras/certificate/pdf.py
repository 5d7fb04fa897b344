"""The certificate as PDF/A-3a, made by typst (extra ``certificate``). The same input gives the same bytes.

Text reaches typst as data, never as markup; clock and fonts of the computer are not used. Fonts are those that typst
carries, without Chinese, Japanese, Korean, Indian and Thai letters: the laboratory's texts must be printable, or the
certificate is refused; a character of the sealed run is printed as its code, ``[U+5C71]``.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import cache
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import shorten
from typing import TYPE_CHECKING, Any, Literal

from bench import __version__
from bench.base.bounded_json import leaves, mapped
from bench.base.errors import BenchError, UsageError
from bench.evidence.seal import AUTHORISATION
from bench.extras.certificate.certificate_data import DCC, PDF, Certificate
from bench.extras.certificate.dcc_xml import library
from bench.record.coverage import coverage_factor
from bench.record.results import Results
from bench.record.run_folder import CERTIFICATE, RESULTS
from bench.wording.numbers import MINUS, NOTHING, moment, number
from sequences.tree import path_text

if TYPE_CHECKING:
    from bench.extras.certificate.certificate_data import Certificate, Covariance
    from bench.measure.view_picture import ViewPicture

_FONTS = ("Libertinus Serif", "DejaVu Sans Mono", "New Computer Modern")
"""The first has most letters; each of the others has letters that those before it do not have."""
_JOINERS = frozenset("\N{ZERO WIDTH NON-JOINER}\N{ZERO WIDTH JOINER}")
_UNPRINTABLE = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""Control, format (which can turn the order of digits round), private and unassigned characters."""
_FROM_RUN = re.compile(r"run\.|results\[|covariance\.|further\[|budgets\[|item\.camera\.|amends\.changes\[")
_ENTRY = re.compile(r"(deviations|conditions|statements)\[(\d+)\]")
_OF_LABORATORY = frozenset({"traceability", "recalibration", "also", "limits_reason"})
"""Statements that the laboratory words."""
_MOST_SHOWN = 8  # Characters named in a message; the others are counted
CODE_NOTE = (
    "A code in square brackets, such as [U+5C71], stands for a character that the fonts of this document do not have."
    " The exact text is in certificate.json."
)
STANDARDS: tuple[Literal["a-3a"], Literal["ua-1"]] = ("a-3a", "ua-1")
"""PDF/A-3a (ISO 19005-3) for the archive, and PDF/UA-1 (ISO 14289-1) for screen readers."""
_KINDS = {
    DCC: (
        "application/xml",
        "alternative",
        "This certificate as a digital calibration certificate (DCC)",
    ),
    CERTIFICATE: ("application/json", "source", "All values of this certificate"),
    RESULTS: ("application/json", "source", "Results of the sealed run"),
}
_HEADER = 120
"""Most characters of the laboratory's name in the head of a page."""
_PLAIN_FROM, _PLAIN_TO = 1e-4, 1e7  # Outside, zeros are counted more easily as a power of ten
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_OTHER = ("application/octet-stream", "supplement", "Supplement to this certificate")

PLOTS = ("uncertainty", "direction", "coverage", "vectors", "regions", "distortion")
"""Names of the plots, in their order; the directions only of a wide lens."""
_WIDE = frozenset({"vectors"})
_CAPTIONS = {
    "uncertainty": "Expanded uncertainty U of an image point over the sensor.",
    "direction": "Expanded uncertainty U of the direction that belongs to a pixel.",
    "coverage": "Stars of all poses on the sensor. The results are extrapolated where no star supports them.",
    "vectors": "Residual of each star at its place on the sensor, magnified.",
    "regions": "RMS residual and number of stars for each region of the sensor.",
    "distortion": "Radial displacement by the lens against the field angle, with its expanded uncertainty.",
}


@cache
def _has_glyph(letter: str) -> bool:
    """Return whether the fonts have a character, regular and bold: without it typst makes no PDF/A."""
    page = (
        '#let d = json("letter.json")\n#set document(title: "-")\n'
        "#set text(font: d.fonts, fallback: false)\n#d.letter *#d.letter*"
    )
    files = {
        "main.typ": page.encode(),
        "letter.json": json.dumps({"fonts": _FONTS, "letter": letter}).encode(),
    }
    try:
        _pdf_of(files)
    except RuntimeError:
        return False
    return True


def missing(text: str) -> list[str]:
    """Return the characters of a text that cannot be printed, each once, in the order of the text."""
    return list(dict.fromkeys(letter for letter in text if not _is_printable(letter)))


def _is_printable(letter: str) -> bool:
    if letter == "\n" or letter in _JOINERS:
        return True
    return unicodedata.category(letter) not in _UNPRINTABLE and (letter.isascii() or _has_glyph(letter))


def with_codes(text: str) -> str:
    """Return a text with the code of each character that cannot be printed in its place.

    >>> with_codes("pose 山 1")
    'pose [U+5C71] 1'
    """
    return "".join(letter if _is_printable(letter) else f"[U+{ord(letter):04X}]" for letter in text)


def faults(certificate: Mapping[str, Any]) -> list[str]:
    """Return a line for each field with letters that cannot be printed, as ``customer.name has 山 (U+5C71)``."""
    return [
        f"{path} has {_named(letters)}"
        for place, text in leaves(certificate)
        if isinstance(text, str)
        and not _is_from_run(certificate, path := path_text(place))
        and (letters := missing(text))
    ]


def _is_from_run(certificate: Mapping[str, Any], path: str) -> bool:
    if entry := _ENTRY.match(path):  # both the run and the laboratory write these
        part = certificate[entry[1]][int(entry[2])]
        return bool(part["id"] not in _OF_LABORATORY if "id" in part else part["source"] == "run")
    return bool(_FROM_RUN.match(path))


def refuse_missing(certificate: Mapping[str, Any]) -> None:
    """Refuse a certificate in which the laboratory wrote characters that cannot be printed."""
    if unprintable := faults(certificate):
        raise UsageError(
            f"The fonts of the certificate cannot print these characters: {'; '.join(unprintable)}.",
            remedy="Write the text in Latin, Greek, Cyrillic, Armenian, Georgian, Hebrew or Arabic letters, without"
            " control characters.",
        )


def _named(characters: Sequence[str]) -> str:
    shown = [
        f"{character} (U+{ord(character):04X})"
        if unicodedata.category(character) not in _UNPRINTABLE
        else f"U+{ord(character):04X}"
        for character in characters[:_MOST_SHOWN]
    ]
    more = len(characters) - _MOST_SHOWN
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


def render_pdf(
    certificate: Certificate,
    results: Results,
    attachments: Mapping[str, bytes],
    plots: Mapping[str, str] | None = None,
) -> bytes:
    """Render a certificate with its attachments; ``plots`` None draws what ``results`` alone gives."""
    library("typst")
    refuse_missing(json.loads(certificate.to_json()))
    drawn = draw_plots(results) if plots is None else plots
    shown = pictures(certificate, drawn)
    files = {picture["file"]: drawn[picture["name"]] for picture in shown}
    return _compiled(document(certificate, shown, attachments), files, attachments)


def document(
    certificate: Certificate, shown: Sequence[Mapping[str, Any]], attachments: Mapping[str, bytes]
) -> dict[str, Any]:
    """Return the document as data for the layout; every text in it can be printed."""
    issued = datetime.fromisoformat(certificate.issued_utc)
    content = json.loads(certificate.to_json())
    del content["covariance"]  # its digits are others
    layout = mapped(
        {
            "title": f"{certificate.title} {certificate.number}",
            "subject": _subject(certificate),
            "keywords": [
                certificate.number,
                certificate.item.camera.serial,
                "calibration",
                "ISO/IEC 17025",
                f"rendered by Starbench {__version__}; typst {version('typst')}",
            ],
            "fonts": _FONTS,
            "laboratory": shorten(certificate.laboratory.name, _HEADER, placeholder=" …"),
            "date": [issued.year, issued.month, issued.day, issued.hour, issued.minute, issued.second],
            "begun": moment(certificate.begun_utc),
            "ended": moment(certificate.ended_utc),
            "issued": moment(certificate.issued_utc),
            "state": _state(certificate),
            "statements": {statement.id: statement.text for statement in reversed(certificate.statements)},
            "covariance": _printed_covariance(certificate.covariance),
            "pictures": list(shown),
            "attachments": [_attachment(name, data) for name, data in sorted(attachments.items())],
            "certificate": content,
        },
        _printable,
    )
    return {**layout, "note": CODE_NOTE if "[U+" in json.dumps(layout) else ""}


def _printable(value: Any) -> Any:
    """Replace characters that cannot be printed by their codes, and a number by its printed forms."""
    if isinstance(value, str):
        return with_codes(value)
    return _forms(value) if isinstance(value, float) else value


def _forms(value: float) -> dict[str, str]:
    """Return the forms in which a number is printed: with some digits, as stated, and a share in percent."""
    return {
        "two": compact(value, 2),
        "three": compact(value),
        "four": compact(value, 4),
        "stated": stated(value),
        "stated_five": stated(value, 5),
        "percent": percent(value),
        "share": f"{100 * value:.2f}",
    }


def _subject(certificate: Certificate) -> str:
    """Return the calibrated item in one line."""
    camera, lens = certificate.item.camera, certificate.item.lens
    text = f"{f'{camera.maker} {camera.model}'.strip() or 'Camera'}, serial {camera.serial}"
    named = f"{lens.maker} {lens.model}".strip()
    if named or lens.serial:
        text += f", with lens {named}".rstrip()
        text += f", serial {lens.serial}" if lens.serial else ""
    return text


def _state(certificate: Certificate) -> str:
    """Return the state of the document, and what makes it a certificate (ISO/IEC 17025, 7.8.2.1 o)."""
    person = certificate.authorised_by
    return (
        f"SEALED; not a certificate until authorised by {person.name}, {person.role} (key {person.key})"
        f" \N{EN DASH} see {AUTHORISATION}."
    )


def _printed_covariance(covariance: Covariance) -> list[Any]:
    """Return names, units, and the printed matrices of covariance and correlation."""
    sigma = [math.sqrt(max(row[at], 0.0)) for at, row in enumerate(covariance.matrix)]
    covariances = [[_short_exponent(f"{value:.5e}") for value in row] for row in covariance.matrix]
    correlations = [
        [
            _printed(f"{value / (sigma[i] * sigma[j]) + 0.0:.4f}") if sigma[i] and sigma[j] else NOTHING
            for j, value in enumerate(row)
        ]
        for i, row in enumerate(covariance.matrix)
    ]
    return [covariance.names, covariance.units, covariances, correlations]


def _short_exponent(text: str) -> str:
    """Shorten the exponent of a number, so that it can still be copied into a program."""
    mantissa, _, power = text.partition("e")
    return f"{mantissa}e{int(power)}"


def _attachment(name: str, data: bytes) -> dict[str, Any]:
    mime_type, relationship, description = _KINDS.get(name, _OTHER)
    return {
        "name": name,
        "file": f"attached/{name}",
        "encoded": not _is_text(data),
        "bytes": str(len(data)),
        "sha256": hashlib.sha256(data).hexdigest(),
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


def _compiled(content: Mapping[str, Any], svg: Mapping[str, str], attachments: Mapping[str, bytes]) -> bytes:
    folder = resources.files("bench.extras.certificate")
    files: dict[str, bytes] = {
        "main.typ": b'#include "certificate.typ"',
        **{
            template.name: template.read_bytes()
            for template in folder.iterdir()
            if template.name.endswith(".typ")
        },
        "document.json": json.dumps(content, ensure_ascii=False).encode(),
        **{name: with_codes(text).encode() for name, text in svg.items()},
        **{
            f"attached/{name}": data if _is_text(data) else json.dumps(list(data)).encode()
            for name, data in attachments.items()
        },
    }
    try:
        return _pdf_of(files)
    except RuntimeError as error:
        raise BenchError(
            f"typst could not make the certificate: {str(error).splitlines()[0]}",
            where=PDF,
            remedy="This is a fault of Starbench or another version of typst. Report it with certificate.json.",
        ) from error


def _pdf_of(files: dict[str, bytes]) -> bytes:
    """Return what typst makes of ``main.typ``, with the fonts that it carries; RuntimeError if it cannot."""
    make = library("typst").Compiler
    with TemporaryDirectory() as empty:  # without a root, a plot could name a file of the working directory
        pdf = make(files, root=empty, ignore_system_fonts=True).compile(
            format="pdf", pdf_standards=list(STANDARDS)
        )
    assert isinstance(pdf, bytes)
    return pdf


def _printed(text: str) -> str:
    """Return a printed number with a true minus sign."""
    return MINUS + text[1:] if text.startswith("-") else text


def compact(value: float | None, digits: int = 3) -> str:
    """Print a computed number with a true minus sign and significant digits, as a power of ten if very small or large.

    None is printed as a dash.

    >>> compact(0.4149821), compact(-1.2345e-7), compact(0.0), compact(None)
    ('0.415', '−1.23·10⁻⁷', '0', '–')
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    if value == 0 or _PLAIN_FROM <= abs(value) < _PLAIN_TO:
        return number(float(value), digits)
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    return f"{_printed(mantissa)}·10{str(int(power)).translate(_SUPERSCRIPTS)}"


def stated(value: float | None, digits: int = 9) -> str:
    """Print a number that somebody stated, with all its digits and a true minus sign; None as a dash.

    >>> stated(255.0), stated(4.5e-06), stated(-0.5)
    ('255', '4.5·10⁻⁶', '−0.5')
    """
    if value is None:
        return NOTHING
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    if not power:
        return mantissa.replace("-", MINUS)
    return f"{_printed(mantissa)}·10{str(int(power)).translate(_SUPERSCRIPTS)}"


def percent(share: float) -> str:
    """Print a share, 0 to 1, in percent with one decimal; below 0.05 % as ``< 0.1``.

    >>> percent(0.3731), percent(1e-7), percent(0.0), percent(1.0)
    ('37.3', '< 0.1', '0', '100.0')
    """
    if share == 0:
        return "0"
    return f"{100 * share:.1f}" if share >= 0.0005 else "< 0.1"


def plots_of_run(run: Path, results: Results) -> dict[str, str]:
    """Draw the plots of a certificate from a run's folder: SVG by name. Those of stars need `views.h5`."""
    from bench.measure.views_file import VIEWS, read_views

    stored = read_views(run / VIEWS) if (run / VIEWS).exists() else []
    return draw_plots(results, [stored_view.shown() for stored_view in stored])


def draw_plots(results: Results, views: Sequence[ViewPicture] = ()) -> dict[str, str]:
    """Draw the plots of a certificate: SVG by name. A plot without data, or without ``views``, is missing."""
    from bench.report.plots import camera_plots, star_plots

    seen = [view for view in views if len(view.detected)]
    k = coverage_factor(results["calibration"])
    drawn = camera_plots(results, [view.detected for view in seen], k, certificate=True)
    drawn |= star_plots(results, seen) if seen else {}
    return {name: drawn[name] for name in PLOTS if name in drawn}


def pictures(certificate: Certificate, plots: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return the plots for the layout, in the order of `PLOTS`; ``alt`` describes one to who does not see it."""
    numbers = "; ".join(
        f"{result.name}: {result.text}"
        for result in certificate.further
        if result.id.startswith("projection")
    )
    return [
        {
            "name": name,
            "file": f"{name}.svg",
            "alt": f"Plot. {caption} {numbers}.".strip(),
            "caption": caption,
            "wide": name in _WIDE,  # it takes the width of the page
        }
        for name, caption in _CAPTIONS.items()
        if name in plots
    ]
