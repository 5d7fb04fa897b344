"""The sections of the certificate in the order of an assessor, as data for the layout.

Turns a certificate into blocks of text; touches no files and computes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.certificate import pdf_results
from bench.certificate.certificate_data import Certificate, Condition, Traceability
from bench.certificate.pdf_blocks import (
    NU,
    Block,
    Cell,
    bullets,
    heading,
    mono,
    pairs,
    paragraph,
    stated,
    table,
    together,
    with_index,
    with_note,
    with_unit,
)
from bench.certificate.pdf_budgets import budgets
from bench.certificate.pdf_evidence import authorisation, verification
from bench.certificate.pdf_plots import Picture

Section = dict[str, object]

_PLACED = frozenset({"simulated", "uncertainty", "model", "traceability", "adjustment", "accreditation"})
"""Fixed texts that stand elsewhere than in the section of the statements."""
_MEASURED = {"run": "recorded by the run", "laboratory": "stated by the laboratory"}
_SHORT = 8
"""A table with no more rows stays on one page."""
_SYMBOLS: tuple[tuple[Cell, Cell], ...] = (
    ("fx, fy", "focal length in pixels, along rows and along columns of the image"),
    (
        "cx, cy",
        "principal point in the image; pixel centres are at whole numbers, from 0",
    ),
    ("k1 to k6, p1, p2", "coefficients of the lens: radial and tangential distortion"),
    ("u", "standard uncertainty (JCGM 100, 2.3.1)"),
    (with_index("u", "i"), "standard uncertainty of the result by one source"),
    ("U", "expanded uncertainty, U = k u"),
    (
        "k",
        "coverage factor; it follows from Student's t distribution where the effective degrees of freedom are few",
    ),
    ("p", "probability of coverage of the interval value ± U"),
    (with_index(NU, "eff"), "effective degrees of freedom (JCGM 100, G.4); ∞ where they are unlimited"),
    ("w", "guard band of a statement of conformity"),
    ("px, arcsec", "pixel; second of arc"),
)


def sections(
    certificate: Certificate, pictures: Sequence[Picture], attachments: Mapping[str, bytes]
) -> list[Section]:
    """Return the sections of the certificate, in their order; a section without content is left out.

    Returns: Title and blocks of each.
    """
    maps = [one for one in pictures if one.name in ("uncertainty", "direction", "coverage")]
    others = [one for one in pictures if one not in maps]
    if sum(not one.wide for one in others) % 2:  # they stand in pairs
        others = [one for one in others if one.name != "radial"]
    found: list[tuple[str, list[Block]]] = [
        ("Results", pdf_results.results(certificate)),
        ("Statement of conformity", pdf_results.conformity(certificate)),
        ("Uncertainty of an image point", [*pdf_results.projection(certificate), *_pictures(maps)]),
        ("Conditions", _conditions(certificate.conditions)),
        ("Method and deviations", _method(certificate)),
        ("Metrological traceability", _traceability(certificate)),
        ("Uncertainty budgets", budgets(certificate)),
        ("Covariance and correlation of the results", pdf_results.covariance(certificate)),
        ("Results before adjustment", _before(certificate)),
        ("Amendments", _amendments(certificate)),
        ("Residuals and lens distortion", _pictures(others)),
        ("Opinions and interpretations", [bullets(certificate.opinions)] if certificate.opinions else []),
        ("Statements", _statements(certificate)),
        ("Authorisation", authorisation(certificate)),
        ("How to verify this certificate", verification(certificate, attachments)),
        ("Symbols", [pairs(_SYMBOLS, label_mm=22, columns=2, size=7.2)]),
    ]
    return [{"title": title, "blocks": blocks} for title, blocks in found if blocks]


def _pictures(pictures: Sequence[Picture]) -> list[Block]:
    """Return wide plots alone and the others in pairs."""
    blocks: list[Block] = []
    for wide in (True, False):
        shown = [
            {"file": one.file, "alt": one.alt, "caption": one.caption} for one in pictures if one.wide == wide
        ]
        if shown:
            size = {"columns": 1, "width": 86} if wide else {"columns": 2, "width": 100}
            blocks.append({"kind": "pictures", "pictures": shown, **size})
    return blocks


def _conditions(found: Sequence[Condition]) -> list[Block]:
    if not found:
        return [paragraph("No condition is stated.")]
    rows: list[list[Cell]] = [
        [
            one.name[:1].upper() + one.name[1:],
            one.text if one.value is None else with_unit(stated(one.value), one.unit),
            with_unit(stated(one.U), one.unit),
            stated(one.k),
            _MEASURED.get(one.source, one.source),
        ]
        for one in found
    ]
    head = ["Condition", "Value", "U", "k", "Measured by"]
    shown = table(head, rows, [1.1, 1.1, "auto", "auto", 1.4])
    return [together(shown)] if len(rows) <= _SHORT else [shown]


def _method(certificate: Certificate) -> list[Block]:
    method = certificate.method
    blocks: list[Block] = [
        together(
            pairs([("Procedure", f"{method.id}, version {method.version}"), ("Principle", method.text)])
        ),
        heading("Deviations, additions and exclusions"),
    ]
    if certificate.deviations:
        said = {"run": "stated by the sealed run", "laboratory": "stated by the laboratory"}
        blocks.append(bullets([f"{one.text} ({said[one.source]})" for one in certificate.deviations]))
    else:
        blocks.append(paragraph("None."))
    if certificate.customer_supplied:
        blocks.append(together(heading("Supplied by the customer"), bullets(certificate.customer_supplied)))
    if certificate.external:
        blocks.append(together(heading("Supplied by external providers"), bullets(certificate.external)))
    return blocks


def _traceability(certificate: Certificate) -> list[Block]:
    blocks: list[Block] = []
    if text := certificate.statement("traceability"):
        blocks.append(paragraph(text))
    if not certificate.traceability:
        return blocks or [paragraph("No reference is stated. The results are not shown to be traceable.")]
    rows: list[list[Cell]] = [
        [
            with_note(one.what[:1].upper() + one.what[1:], one.statement),
            with_unit(stated(one.value), one.unit),
            with_unit(stated(one.U), one.unit),
            stated(one.k),
            with_note(_certificate_of(one), f"SHA-256 {one.sha256}" if one.sha256 else ""),
        ]
        for one in certificate.traceability
    ]
    head = ["Reference", "Value", "U", "k", "Certificate"]
    return [*blocks, table(head, rows, [1.2, "auto", "auto", "auto", 1.5])]


def _certificate_of(one: Traceability) -> str:
    return ", ".join(filter(None, (one.number, one.issuer, one.date))) or "no certificate"


def _before(certificate: Certificate) -> list[Block]:
    blocks = pdf_results.before_adjustment(certificate)
    if text := certificate.statement("adjustment"):
        blocks = [paragraph(text), *blocks]
    return blocks


def _amendments(certificate: Certificate) -> list[Block]:
    amends = certificate.amends
    if amends is None:
        return []
    rows: list[list[Cell]] = [[mono(one.field), one.before, one.after] for one in amends.changes]
    changed = (
        [table(["Field", "Before", "Now"], rows, [1, 1, 1], size=7.6)]
        if rows
        else [paragraph("No field of the certificate differs from the replaced one.")]
    )
    return [
        pairs(
            [
                ("Replaces certificate", {"text": amends.number, "bold": True}),
                ("SHA-256 of its SHA256SUMS", mono(amends.sha256)),
                ("Reason", amends.reason),
            ],
            label_mm=48,
        ),
        *changed,
    ]


def _statements(certificate: Certificate) -> list[Block]:
    texts: list[Cell] = [one.text for one in certificate.statements if one.id not in _PLACED]
    if accredited := certificate.statement("accreditation"):
        texts.append(accredited)
    return [bullets(texts)] if texts else []
