"""The sections of the certificate in the order of an assessor, as data for the layout.

Turns a certificate into blocks of text; touches no files and computes nothing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence

from bench.certificate import pdf_results
from bench.certificate.certificate_data import Certificate, Condition, Contact, Traceability
from bench.certificate.pdf_blocks import (
    NU,
    Block,
    Cell,
    Picture,
    bullets,
    filled,
    heading,
    mono,
    notice,
    pairs,
    paragraph,
    stated,
    table,
    together,
    with_index,
    with_note,
    with_unit,
)
from bench.report.text import moment

_AUTHORISATION = "SHA256SUMS.authorised.sig"


def state(certificate: Certificate) -> str:
    """Return the state of the document, and what makes it a certificate (ISO/IEC 17025, 7.8.2.1 o)."""
    person = certificate.authorised_by
    return (
        f"SEALED; not a certificate until authorised by {person.name}, {person.role} (key {person.key_fingerprint})"
        f" \N{EN DASH} see {_AUTHORISATION}."
    )


def authorisation(certificate: Certificate) -> list[Block]:
    """Return who authorises the certificate, and where the signature is (ISO/IEC 17025, 7.8.2.1 o)."""
    person = certificate.authorised_by
    rows: list[tuple[Cell, Cell]] = [
        ("Authorised by", {"text": person.name, "bold": True}),
        ("Role", person.role),
        ("Key", mono(person.key_fingerprint)),
        ("Signature", mono(_AUTHORISATION)),
    ]
    text = (
        f"The signature of {person.name} is the file {_AUTHORISATION} beside this document. It is made with the key"
        " above over the seal, and so over every file of the certificate. Without it this document is sealed by the"
        " bench, but no person has authorised it."
    )
    return [{"kind": "signature", "rows": filled(rows), "lines": [state(certificate), text]}]


def verification(certificate: Certificate, attachments: Mapping[str, bytes]) -> list[Block]:
    """Return the commands that verify the certificate, the sealed run, and the attached files."""
    run, person = certificate.run, certificate.authorised_by
    steps = [
        {
            "text": "The bench sealed the list of files. The answer begins with “Good” and names a key of the bench.",
            "command": _check("starbench-report@v1", "SHA256SUMS.sig", "SHA256SUMS"),
        },
        {
            "text": "The files are those of the list. Every line must end with “OK”.",
            "command": "sha256sum --strict -c SHA256SUMS",
        },
        {
            "text": f"A person authorised the seal. The answer begins with “Good” and names the key of {person.name}.",
            "command": _check("starbench-authorisation@v1", _AUTHORISATION, "SHA256SUMS.sig"),
        },
    ]
    sealed: list[tuple[Cell, Cell]] = [
        ("Key that sealed the run", mono(f"{run.signer_fingerprint} {run.signer}")),
        ("Key of the person", mono(f"{person.key_fingerprint} {person.name}")),
    ]
    made_from: list[tuple[Cell, Cell]] = [
        ("Run", run.id),
        ("Sequence, station", f"{run.sequence}; {run.station}"),
        ("Number in the ledger", "not in a ledger" if run.ledger_number is None else str(run.ledger_number)),
        ("Head of the ledger", mono(run.ledger_head)),
        ("Head of the journal", mono(run.journal_head)),
        ("SHA-256 of SHA256SUMS", mono(run.seal_sha256)),
        ("SHA-256 of results.json", mono(run.results_sha256)),
        ("SHA-256 of the biases", mono(certificate.item.camera.biases_sha256)),
        ("Software", ", ".join(f"{one.name} {one.version}" for one in run.software)),
    ]
    blocks: list[Block] = [
        paragraph(
            "You need OpenSSH (8.1 or newer) and sha256sum, nothing else. In the folder of this certificate:",
            sticky=True,
        ),
        {"kind": "steps", "steps": steps},
        paragraph(
            "allowed_signers is the list of keys that you trust. Get it from the laboratory in another way than this"
            " certificate, and compare the fingerprints:",
            sticky=True,
        ),
        pairs(sealed, label_mm=40),
        together(heading("The sealed run that this certificate is made from"), pairs(made_from)),
    ]
    if attachments:
        rows: list[list[Cell]] = [
            [mono(name), str(len(data)), mono(hashlib.sha256(data).hexdigest())]
            for name, data in sorted(attachments.items())
        ]
        head: list[Cell] = ["File", "Bytes", "SHA-256"]
        blocks.append(
            together(
                heading("Files attached to this document"),
                table(head, rows, ["auto", "auto", 1], ["left", "right", "left"], size=7.2, **{"break": 60}),
            )
        )
    return blocks


def _check(namespace: str, signature: str, signed: str) -> str:
    """Return a command that checks a signature by any key of the list; OpenSSH finds the name of the signer."""
    return (
        f"ssh-keygen -Y verify -f allowed_signers -n {namespace} -s {signature} \\\n"
        f'  -I "$(ssh-keygen -Y find-principals -f allowed_signers -s {signature})" < {signed}'
    )


def opening(certificate: Certificate) -> list[Block]:
    """Return what stands above the first section: item, state, parties, dates."""
    blocks = [paragraph(subject(certificate), "lead")]
    if certificate.simulated:
        text = certificate.statement("simulated") or "The devices of this run were simulated."
        text = text.removeprefix("SIMULATED: ")
        blocks.append(notice("SIMULATED:", [text[:1].upper() + text[1:]], warning=True))
    if certificate.amends:
        line = f"It replaces certificate {certificate.amends.number}: {certificate.amends.reason}"
        blocks.append(notice("Amended certificate", [line]))
    blocks.append(notice("", [state(certificate)]))
    blocks.append({"kind": "cards", "columns": 2, "cards": _cards(certificate)})
    return blocks


def subject(certificate: Certificate) -> str:
    """Return the calibrated item in one line."""
    camera, lens = certificate.item.camera, certificate.item.lens
    parts = [f"{camera.maker} {camera.model}".strip() or "Camera", f"serial {camera.serial}"]
    named = f"{lens.maker} {lens.model}".strip()
    text = ", ".join(parts)
    if named or lens.serial:
        text += f", with lens {named}".rstrip()
        text += f", serial {lens.serial}" if lens.serial else ""
    return text


def _cards(certificate: Certificate) -> list[dict[str, object]]:
    laboratory, customer, item = certificate.laboratory, certificate.customer, certificate.item
    camera, lens, accreditation = item.camera, item.lens, certificate.laboratory.accreditation
    accredited = "none for this calibration"
    if accreditation:
        accredited = f"{accreditation.body}, {accreditation.number}: {accreditation.scope}"
    calibrated: list[tuple[Cell, Cell]] = [
        ("Camera", f"{camera.maker} {camera.model}".strip()),
        ("Serial", {"text": camera.serial, "bold": True} if camera.serial else ""),
        ("Sensor", _with_size(camera.sensor, camera.image_size)),
        ("Firmware", camera.firmware),
        ("Lens", f"{lens.maker} {lens.model}".strip()),
        ("Lens serial", {"text": lens.serial, "bold": True} if lens.serial else ""),
        ("Focus", _locked(lens.focus, lens.focus_locked)),
        ("Aperture", _locked(lens.aperture, lens.aperture_locked)),
        ("Customer's id", item.customer_id),
        ("Condition", item.condition),
    ]
    dates: list[tuple[Cell, Cell]] = [
        ("Received", certificate.received),
        ("Calibrated", f"{moment(certificate.begun_utc)} to\n{moment(certificate.ended_utc)}"),
        ("Issued", {"text": moment(certificate.issued_utc), "bold": True}),
        ("Place", laboratory.place),
        ("Method", f"{certificate.method.id}, version {certificate.method.version}"),
    ]
    if camera.biases:
        dates += [("Biases", ", ".join(camera.biases))]
    return [
        _card(
            "Laboratory",
            [
                ("Name", {"text": laboratory.name, "bold": True}),
                ("Address", "\n".join(laboratory.address.lines)),
                ("Contact", _contact(laboratory.contact)),
                ("Accreditation", accredited),
            ],
        ),
        _card(
            "Customer",
            [
                ("Name", {"text": customer.name, "bold": True}),
                ("Address", "\n".join(customer.address.lines)),
                ("Contact", _contact(customer.contact)),
            ],
        ),
        _card("Calibrated item", calibrated),
        _card("Calibration", dates),
    ]


def _card(title: str, rows: Sequence[tuple[Cell, Cell]]) -> dict[str, object]:
    return {"title": title, "rows": filled(rows), "label_mm": 22}


def _contact(contact: Contact) -> str:
    return "\n".join(filter(None, (contact.name, contact.email, contact.phone)))


def _with_size(sensor: str, size: Sequence[int]) -> str:
    return ", ".join(
        filter(None, (sensor, " \N{MULTIPLICATION SIGN} ".join(map(str, size)) + " px" if size else ""))
    )


def _locked(setting: str, locked: bool) -> str:
    return (
        f"{setting}, {'locked' if locked else 'not locked'}"
        if setting
        else ("locked" if locked else "not locked")
    )


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
        ("Uncertainty budgets", pdf_results.budgets(certificate)),
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
