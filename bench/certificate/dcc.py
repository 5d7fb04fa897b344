r"""A certificate as a digital calibration certificate (DCC): PTB's DCC 3.2.1 with D-SI 2.1.0.

`render_dcc` writes what the certificate states and nothing else: the same certificate gives the same bytes. It touches
no file, no clock and no schema. The parts stand in `dcc_parties` (who, what, for whom, statements) and `dcc_results`
(methods, conditions, numbers).

Structure and order of the elements follow the schema https://ptb.de/dcc/v3.2.1/dcc.xsd; its content follows ISO/IEC
17025:2017, 7.8. Lengths in the image have the unit ``\one``, because D-SI has no pixel; a
statement defines the pixel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.certificate.certificate_data import Certificate
from bench.certificate.dcc_parties import add_items, add_laboratory, add_people, add_statements
from bench.certificate.dcc_results import add_measurement
from bench.certificate.dcc_words import REF_TYPES, add_software, add_text, identifications, software_of, token
from bench.certificate.dcc_xml import (
    DCC,
    LANGUAGE,
    NAMESPACES,
    ROOT,
    STARBENCH,
    VERSIONS,
    Versions,
    add,
    library,
    to_bytes,
)

if TYPE_CHECKING:
    from lxml.etree import _Element


def render_dcc(certificate: Certificate, versions: Versions = VERSIONS[0]) -> bytes:
    """Return a certificate as a digital calibration certificate, not signed.

    versions: Version of the DCC and of D-SI, one of `dcc_xml.VERSIONS`.
    Raises UsageError: When lxml is not installed.
    Raises ValueError: When the pair of versions is not one of `dcc_xml.VERSIONS`.
    """
    if versions not in VERSIONS:
        raise ValueError(f"DCC {versions.dcc} with D-SI {versions.si} cannot be written")
    etree = library("lxml.etree")
    root: _Element = etree.Element(
        ROOT,
        {
            f"{{{NAMESPACES['xsi']}}}schemaLocation": f"{DCC} {DCC}/v{versions.dcc}/dcc.xsd",
            "schemaVersion": versions.dcc,
        },
        nsmap={prefix: NAMESPACES[prefix] for prefix in ("dcc", "si", "xsi")},
    )
    administrative = add(root, "dcc:administrativeData")
    used, writers = software_of(certificate)
    starbench = [one for one in used if one.name == "starbench"]
    add_software(add(administrative, "dcc:dccSoftware"), [*starbench, *writers] or used)
    _add_ref_types(administrative)
    _add_core_data(administrative, certificate)
    add_items(administrative, certificate)
    add_laboratory(administrative, certificate)
    add_people(administrative, certificate)
    add_statements(administrative, certificate)
    add_measurement(add(root, "dcc:measurementResults"), certificate)
    _add_comment(root, certificate)
    etree.indent(root, space=" ")
    return to_bytes(root)


def _add_ref_types(parent: _Element) -> None:
    """Add what the refTypes of Starbench mean."""
    definitions = add(parent, "dcc:refTypeDefinitions")
    for name, meaning in REF_TYPES.items():
        one = add(definitions, "dcc:refTypeDefinition", refType=name)
        add_text(one, "dcc:name", name)
        add_text(one, "dcc:description", meaning)
        add(one, "dcc:namespace", "starbench")
        add(one, "dcc:link", STARBENCH)


def _add_core_data(parent: _Element, certificate: Certificate) -> None:
    """Add numbers, dates and place; for an amendment the certificate that it replaces."""
    core, run, amends = add(parent, "dcc:coreData"), certificate.run, certificate.amends
    add(core, "dcc:countryCodeISO3166_1", certificate.laboratory.address.country)
    add(core, "dcc:usedLangCodeISO639_1", LANGUAGE)
    add(core, "dcc:mandatoryLangCodeISO639_1", LANGUAGE)
    add(core, "dcc:uniqueIdentifier", token(certificate.number))
    ledger = "" if run.ledger_number is None else str(run.ledger_number)
    identifications(
        core,
        ("calibrationLaboratory", run.id, "Name of the run"),
        ("calibrationLaboratory", ledger, "Number of the run in the laboratory's ledger"),
    )
    if certificate.received:
        add(core, "dcc:receiptDate", certificate.received[:10])
    add(core, "dcc:beginPerformanceDate", certificate.begun_utc[:10])
    add(core, "dcc:endPerformanceDate", certificate.ended_utc[:10])
    add(core, "dcc:performanceLocation", certificate.laboratory.place_kind)
    add(core, "dcc:issueDate", certificate.issued_utc[:10])
    if amends is not None:
        replaced = add(core, "dcc:reportAmendedSubstituted")
        add(replaced, "dcc:typeOfChange", "amended")
        add(replaced, "dcc:replacedUniqueIdentifier", token(amends.number))
        previous = add(core, "dcc:previousReport")
        add_text(previous, "dcc:referral", "SHA256SUMS of the certificate that this one replaces")
        add(previous, "dcc:referralID", token(amends.number))
        add(previous, "dcc:procedure", "SHA-256")
        add(previous, "dcc:value", token(amends.sha256))
        add_text(previous, "dcc:description", f"Reason of the amendment: {amends.reason}")


def _add_comment(parent: _Element, certificate: Certificate) -> None:
    """Add the sealed run that the certificate comes from, for programs."""
    run = certificate.run
    comment = add(parent, "dcc:comment")
    etree = library("lxml.etree")
    provenance: _Element = etree.SubElement(comment, f"{{{STARBENCH}}}run", nsmap={"starbench": STARBENCH})
    provenance.set("simulated", "true" if certificate.simulated else "false")
    for name, value in (
        ("id", run.id),
        ("ledgerNumber", "" if run.ledger_number is None else str(run.ledger_number)),
        ("ledgerHead", run.ledger_head),
        ("journalHead", run.journal_head),
        ("sealSHA256", run.seal_sha256),
        ("resultsSHA256", run.results_sha256),
        ("signer", run.signer),
        ("signerFingerprint", run.signer_fingerprint),
        ("begun", certificate.begun_utc),
        ("ended", certificate.ended_utc),
        ("issued", certificate.issued_utc),
        ("authorisingKey", certificate.authorised_by.key_fingerprint),
    ):
        if value:
            add(provenance, f"starbench:{name}", value)
