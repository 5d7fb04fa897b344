"""What stands above the first section of the certificate: item, state, parties, dates. Text only; touches no files."""

from __future__ import annotations

from collections.abc import Sequence

from bench.certificate.certificate_data import Certificate, Contact
from bench.certificate.pdf_blocks import Block, Cell, filled, notice, paragraph
from bench.certificate.pdf_evidence import state
from bench.report.text import moment


def opening(certificate: Certificate) -> list[Block]:
    """Return what stands above the first section: item, state, parties, dates.

    Returns: The blocks.
    """
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
