"""The administrative part of a digital calibration certificate: items, laboratory, people, customer, statements."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.certificate.certificate_data import Address, Certificate, Conformity, Contact
from bench.certificate.dcc_words import (
    LIMIT,
    SIMULATED,
    SIMULATED_TYPE,
    add_number,
    add_text,
    identifications,
    joined,
    token,
)
from bench.certificate.dcc_xml import add

if TYPE_CHECKING:
    from lxml.etree import _Element

CAMERA_ID = "item-camera"
LENS_ID = "item-lens"
NO_NUMBER = "not stated"
PIXEL_ID = "statement-pixel"
SUPPLIED_ID = "statement-customer-data"
PIXEL = (
    "One pixel is the distance between the centres of neighbouring pixels of the calibrated camera, along a row for x"
    " and along a column for y. The centre of the first pixel has the coordinates (0, 0). D-SI has no pixel, so"
    " numbers in pixels are stated with the unit one."
)
_STATEMENT_NAMES = {
    "simulated": "Simulated devices",
    "authorisation": "Authorisation",
    "items": "Validity",
    "reproduction": "Reproduction",
    "uncertainty": "Measurement uncertainty",
    "traceability": "Metrological traceability",
    "model": "Model of the camera",
    "verification": "Verification of the run",
    "adjustment": "Adjustment",
    "accreditation": "Accreditation",
    "customer_data": "Data of the customer",
    "recalibration": "Recalibration",
    "also": "Further information",
    "notes": "Notes on the results",
    "not_included": "Not included in the uncertainty",
}


def result_id(symbol: str) -> str:
    """Return the id of a result."""
    return f"result-{symbol}"


def add_items(parent: _Element, certificate: Certificate) -> None:
    """Add the calibrated item: the camera, and the lens that is calibrated with it."""
    item, camera, lens = certificate.item, certificate.item.camera, certificate.item.lens
    mark = f"{SIMULATED}: " if certificate.simulated else ""
    items = add(parent, "dcc:items")
    add_text(items, "dcc:name", f"{mark}Camera with lens, calibrated as one")
    add_text(items, "dcc:description", f"Condition on receipt: {item.condition}")
    one = add(items, "dcc:item", id=CAMERA_ID)
    add_text(one, "dcc:name", f"{mark}{camera.maker} {camera.model}")
    stated = [f"Sensor {camera.sensor}"] if camera.sensor else []
    stated += [f"{' x '.join(map(str, camera.image_size))} pixels"] if camera.image_size else []
    stated += ["Biases: " + ", ".join(camera.biases)] if camera.biases else []
    if stated:
        add_text(one, "dcc:description", joined(*stated))
    _add_maker(one, camera.maker)
    _add_model(one, camera.model)
    identifications(
        one,
        ("manufacturer", camera.serial.strip() or NO_NUMBER, "Serial number"),
        ("manufacturer", camera.firmware, "Firmware"),
        ("customer", item.customer_id, "Customer's number"),
        ("calibrationLaboratory", camera.biases_sha256, "SHA-256 of the biases"),
    )
    one = add(items, "dcc:item", id=LENS_ID)
    add_text(one, "dcc:name", f"Lens {lens.maker} {lens.model}")
    locks = {True: "locked", False: "not locked"}
    add_text(
        one,
        "dcc:description",
        f"Focus: {lens.focus}, {locks[lens.focus_locked]}; aperture: {lens.aperture}, {locks[lens.aperture_locked]}",
    )
    _add_maker(one, lens.maker)
    _add_model(one, lens.model)
    identifications(one, ("manufacturer", lens.serial.strip() or NO_NUMBER, "Serial number"))


def add_laboratory(parent: _Element, certificate: Certificate) -> None:
    """Add the calibration laboratory."""
    laboratory = certificate.laboratory
    one = add(parent, "dcc:calibrationLaboratory")
    if laboratory.accreditation is not None:
        add(one, "dcc:calibrationLaboratoryCode", token(laboratory.accreditation.number))
    further = f"Place of the calibration: {laboratory.place}" if laboratory.place else ""
    _add_contact(add(one, "dcc:contact"), laboratory.name, laboratory.contact, laboratory.address, further)


def add_people(parent: _Element, certificate: Certificate) -> None:
    """Add the person who authorises the certificate, and the customer."""
    person = certificate.authorised_by
    one = add(add(parent, "dcc:respPersons"), "dcc:respPerson")
    add_text(add(one, "dcc:person"), "dcc:name", person.name)
    if person.key_fingerprint:
        add_text(
            one,
            "dcc:description",
            f"Authorises the certificate with the key {person.key_fingerprint}. The signature lies beside the seal:"
            " SHA256SUMS.authorised.sig.",
        )
    add(one, "dcc:role", token(person.role))
    add(one, "dcc:mainSigner", "true")
    customer = certificate.customer
    _add_contact(add(parent, "dcc:customer"), customer.name, customer.contact, customer.address, "")


def add_statements(parent: _Element, certificate: Certificate) -> None:
    """Add the statements: simulated devices, fixed texts, pixel, deviations, conformity, data of others, opinions."""
    several = add(parent, "dcc:statements")
    fixed = {one.id: one.text for one in certificate.statements}
    if certificate.simulated:
        _add_declaration(
            several,
            _STATEMENT_NAMES["simulated"],
            fixed.get("simulated")
            or f"{SIMULATED}: devices were simulated. This is no certificate of a real camera.",
            refType=SIMULATED_TYPE,
        )
    for name, text in fixed.items():
        if name != "simulated":
            _add_declaration(several, _STATEMENT_NAMES.get(name, name), text)
    pixel = add(several, "dcc:statement", id=PIXEL_ID)
    add_text(pixel, "dcc:name", "Definition of the pixel")
    add(pixel, "dcc:nonSIDefinition", PIXEL)
    add(pixel, "dcc:nonSIUnit", "pixel")
    accreditation = certificate.laboratory.accreditation
    if accreditation is not None:
        one = add(several, "dcc:statement")
        add_text(one, "dcc:name", "Scope of the accreditation")
        add(one, "dcc:reference", token(f"{accreditation.body} {accreditation.number}"))
        add_text(one, "dcc:declaration", accreditation.scope)
    for deviation in certificate.deviations:
        _add_declaration(
            several, f"Deviation from the method, stated by the {deviation.source}", deviation.text
        )
    if certificate.customer_supplied or any(one.customer_supplied for one in certificate.results):
        used = any(one.customer_supplied for one in certificate.results)
        text = (
            "\n".join(certificate.customer_supplied)
            or "Some results depend on data that the customer supplied."
        )
        _add_declaration(several, "Data supplied by the customer", text, id=SUPPLIED_ID if used else None)
    for text in certificate.external:
        _add_declaration(several, "Result of an external provider", text)
    for text in certificate.opinions:
        _add_declaration(several, "Opinion or interpretation", text)
    if certificate.amends is not None:
        changed = "; ".join(f"{one.field}: {one.before} -> {one.after}" for one in certificate.amends.changes)
        _add_declaration(several, "Changes against the replaced certificate", changed or "None in the data.")
    for conformity in certificate.conformity:
        _add_conformity(several, conformity)


def _add_conformity(parent: _Element, conformity: Conformity) -> None:
    """Add a statement of conformity with its limits and its decision rule (ISO/IEC 17025, 7.8.6)."""
    one = add(parent, "dcc:statement", refId=result_id(conformity.symbol), refType="basic_conformity")
    add_text(one, "dcc:name", f"Conformity of {conformity.symbol}")
    add_text(one, "dcc:description", f"Specification: {conformity.specification}")
    add(one, "dcc:convention", token(conformity.rule))
    add(one, "dcc:conformity", conformity.verdict)
    data = add(one, "dcc:data")
    for name, value in (
        ("lower limit", conformity.lower),
        ("upper limit", conformity.upper),
        ("guard band w", conformity.guard_band),
    ):
        if value is not None:
            add_number(data, name, value, conformity.unit, LIMIT)


def _add_declaration(parent: _Element, name: str, text: str, /, **attributes: str | None) -> None:
    one = add(parent, "dcc:statement", **attributes)
    add_text(one, "dcc:name", name)
    add_text(one, "dcc:declaration", text)


def _add_maker(parent: _Element, maker: str) -> None:
    if maker.strip():
        add_text(add(parent, "dcc:manufacturer"), "dcc:name", maker)


def _add_model(parent: _Element, model: str) -> None:
    if model.strip():
        add(parent, "dcc:model", token(model))


def _add_contact(parent: _Element, name: str, contact: Contact, address: Address, further: str) -> None:
    """Add a name with mail address, telephone number and postal address."""
    add_text(parent, "dcc:name", name)
    for tag, value in (("eMail", contact.email), ("phone", contact.phone)):
        if value.strip():
            add(parent, f"dcc:{tag}", token(value))
    place = add(parent, "dcc:location")
    for tag, value in (
        ("street", address.street),
        ("postCode", address.post_code),
        ("city", address.city),
        ("countryCode", address.country),
    ):
        if value.strip():
            add(place, f"dcc:{tag}", token(value))
    words = [f"Contact: {contact.name}"] if contact.name and contact.name != name else []
    words += [further] if further else []
    if words:
        add_text(place, "dcc:further", "; ".join(words))
