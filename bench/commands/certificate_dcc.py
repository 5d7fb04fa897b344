"""`certificate check` and `certificate from-dcc`: a digital calibration certificate is checked, or read."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from bench.base.errors import EvidenceError, UsageError
from bench.certificate.dcc_signature import DccSignature, load_certificates, verify_signature
from bench.certificate.dcc_xml import (
    DCC_VERSION,
    MOST_BYTES,
    NAMESPACES,
    SCHEMAS_VARIABLE,
    SI_VERSION,
    read_dcc,
    schema_faults,
    schema_folder,
)
from bench.commands.options import TRUSTED, ExistingFile, ExistingPath, command
from bench.commands.output import JSON, show, wants_json
from bench.records.storage import storage_errors

DCC_FILE = "dcc.xml"


@dataclass
class _Found:
    """What the checks of a DCC found."""

    file: Path
    number: str
    schema: list[str] | None  # Faults by the schema; None if there was none at hand
    signature: DccSignature | None  # The valid signature; None if there is none or it is not valid
    signature_fault: str  # Why the signature is not valid; empty if it is, or there is none

    @property
    def faults(self) -> list[str]:
        """All faults, each with what found it."""
        return [
            *(f"schema, {fault}" for fault in self.schema or []),
            *([f"signature: {self.signature_fault}"] if self.signature_fault else []),
            *([] if self.number else ["content: the certificate has no number (dcc:uniqueIdentifier)"]),
        ]


@command("starbench certificate check certificates/2026-0042")
@click.argument("path", metavar="FILE", type=ExistingPath())
@click.option(
    "--schemas",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder with PTB's schemas dcc.xsd and SI_Format.xsd.  [default: $STARBENCH_DCC_SCHEMAS]",
)
@TRUSTED
@JSON
def check(path: Path, schemas: Path | None, trusted: Path | None) -> int:
    """Check a digital calibration certificate: an XML FILE, or the folder of a certificate.

    Its form is checked against PTB's schemas if you have them, and its signature if it has one. For a certificate of
    Starbench, `starbench verify` compares its content with the results. Exit status 0: no fault; 1: faults.
    """
    found = _check(path, schemas, trusted)
    if found.faults:
        show(lambda: _object(found), _fault_lines(found), err=True)
        if not wants_json():
            for line in _unchecked_lines(found, None):
                click.echo(line)
        return 1
    show(lambda: _object(found), _valid_lines(found, trusted))
    return 0


def _check(path: Path, schemas: Path | None, trusted: Path | None) -> _Found:
    file = path / DCC_FILE if path.is_dir() else path
    if not file.is_file():
        raise UsageError(f"The folder has no {DCC_FILE}.", where=str(path), remedy="Name the XML file.")
    data = _read(file)
    where = str(file)
    root = read_dcc(data, where)
    anchors = () if trusted is None else load_certificates(trusted)
    folder = schema_folder(schemas)
    signature, signature_fault = None, ""
    try:
        signature = verify_signature(data, where, trusted=anchors)
        if signature is None and anchors:
            signature_fault = "the file has none, but you named a certificate that you trust"
    except EvidenceError as error:
        signature_fault = error.what
    number = root.findtext("dcc:administrativeData/dcc:coreData/dcc:uniqueIdentifier", "", NAMESPACES)
    return _Found(
        file=file,
        number=number.strip(),
        schema=None if folder is None else schema_faults(data, folder, where),
        signature=signature,
        signature_fault=signature_fault,
    )


def _read(file: Path) -> bytes:
    """Return the bytes of a file, at most one more than a DCC may have."""
    with storage_errors(file), file.open("rb") as stream:
        return stream.read(MOST_BYTES + 1)


@command("starbench certificate from-dcc collimator.xml", name="from-dcc")
@click.argument("path", metavar="FILE", type=ExistingFile())
@click.option(
    "--quantity", metavar="NAME", default="", help="Id, label or name of the length.  [default: focal length]"
)
@TRUSTED
@JSON
def from_dcc(path: Path, quantity: str, trusted: Path | None) -> int:
    """Read the focal length of a collimator from its digital calibration certificate, an XML FILE.

    Prints the lines for the station file and for lab.yaml: value, uncertainty, number, date and hash of the
    certificate. Nothing is written.
    """
    from bench.certificate.dcc import read_reference

    data = _read(path)
    anchors = () if trusted is None else load_certificates(trusted)
    found = read_reference(data, str(path), wanted=quantity)
    signature = verify_signature(data, str(path), trusted=anchors)
    if signature is None and anchors:
        raise EvidenceError(
            "The file has no signature, but you named a certificate that you trust.",
            where=str(path),
            remedy="Ask the issuer for the signed file.",
        )
    length, temperature = found.length, found.temperature_c
    values: dict[str, str | float] = {
        "r_mm": length.value_mm,
        "uncertainty_mm": length.uncertainty_mm,
        "k": length.k,
        "number": found.number,
        **({"date": found.date} if found.date else {}),
        **({} if temperature is None else {"temperature_c": temperature}),
    }
    source = {"row": "passport of the collimator", "issuer": found.issuer, "sha256": found.sha256}
    signer = None if signature is None else signature.signer
    if signer is None:
        stated = "no signature"
    else:
        stated = f"signed by {signer}" + ("" if anchors else " (not checked against --trusted)")
    show(
        {"certificate": values, "source": source, "signer": signer, "trusted": bool(anchors)},
        [
            f"# From {path}: {length.called}; {stated}.",
            "# Station file:\ncollimator:\n  certificate:",
            *(f"    {name}: {_yaml(value) if name != 'date' else value}" for name, value in values.items()),
            "# lab.yaml:\nsources:",
            "  - {" + ", ".join(f"{name}: {_yaml(value)}" for name, value in source.items()) + "}",
        ],
    )
    return 0


def _yaml(value: str | float) -> str:
    """Return a value as YAML: numbers as they are, texts in double quotes."""
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else f"{value:.10g}"


def _fault_lines(found: _Found) -> Iterator[str]:
    count = len(found.faults)
    yield f"{found.file}: {count} fault{'s' if count > 1 else ''}:"
    for fault in found.faults:
        yield f"  {fault}"


def _valid_lines(found: _Found, trusted: Path | None) -> Iterator[str]:
    yield f"Certificate {found.number}: DCC {DCC_VERSION} with D-SI {SI_VERSION}."
    if found.schema is not None:
        yield "Schema: valid."
    if found.signature is not None:
        one = found.signature
        yield (
            f"Signature: valid, by {one.signer} (issued by {one.issuer}), who states"
            f" {one.stated_utc:%Y-%m-%d %H:%M:%S} UTC as its time."
        )
    else:
        yield "Signature: none."
    yield from _unchecked_lines(found, trusted)


def _unchecked_lines(found: _Found, trusted: Path | None) -> Iterator[str]:
    if found.schema is None:
        yield (
            "Not checked: the form. Name the folder of PTB's schemas with --schemas or in"
            f" {SCHEMAS_VARIABLE} to check it."
        )
    if found.signature is not None and trusted is None:
        yield "Not checked: who signed. Name certificates that you trust with --trusted."


def _object(found: _Found) -> dict[str, Any]:
    one = found.signature
    return {
        "file": str(found.file),
        "number": found.number,
        "dcc_version": DCC_VERSION,
        "si_version": SI_VERSION,
        "ok": not found.faults,
        "schema": found.schema,
        "signature": None
        if one is None
        else {
            "signer": one.signer,
            "issuer": one.issuer,
            "serial": str(one.serial),
            "fingerprint_sha256": one.fingerprint,
            "stated_utc": f"{one.stated_utc:%Y-%m-%dT%H:%M:%SZ}",
            "trusted": one.trusted,
        },
        "signature_fault": found.signature_fault or None,
    }
