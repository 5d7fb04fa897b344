"""Issue, amend, list and show certificates from the command line, and print what was done."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.bounded_json import parse_json
from bench.base.errors import EvidenceError, UsageError
from bench.base.home import home_folder
from bench.commands.evidence_output import ask_passphrase
from bench.commands.output import print_json
from bench.records.reading import read_bounded
from bench.records.storage import storage_errors, write_atomic

if TYPE_CHECKING:
    from bench.certificate.certificate_data import Certificate
    from bench.certificate.issue import Issued, Laboratory
    from bench.certificate.series_numbers import Numbered
    from bench.evidence.findings import Verification
    from bench.evidence.key_trust import Trust
    from bench.records.ledger import Ledger

DccKey = tuple[Path, Path] | None
"""Files of the key and of the certificates for the signature in the DCC; None for none."""
NOT_FOUND = "NOT FOUND"
"""State of a certificate that was issued, and that is not in its folder."""


def write_example(path: Path) -> int:
    """Write the example of lab.yaml.

    Returns: Exit status, 0.
    Raises StorageError: If it cannot be written.
    """
    from bench.certificate.lab_config import EXAMPLE

    with storage_errors(path):
        write_atomic(path, EXAMPLE.read_bytes())
    click.echo(
        f"Wrote {path}. Replace every REPLACE in it; then: starbench certificate issue RUN -c {path} -o FOLDER"
    )
    return 0


def issue_certificate(
    run: Path, lab_file: Path, folder: Path, *, also: str, dcc_key: DccKey, as_json: bool
) -> int:
    """Issue a certificate, and print its number and results.

    also: Why a further certificate of the run is issued; empty if it is the first one.
    dcc_key: Files of the key and of the certificates that sign the DCC; None for a DCC without a signature.
    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    """
    from bench.certificate.issue import issue

    return _show_issued(
        issue(run, lab_file, folder, _laboratory(dcc_key), also=also.strip()), as_json=as_json
    )


def amend_certificate(
    old: Path, lab_file: Path, folder: Path, *, reason: str, dcc_key: DccKey, as_json: bool
) -> int:
    """Amend a certificate, and print what changed.

    dcc_key: Files of the key and of the certificates that sign the DCC; None for a DCC without a signature.
    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    Raises UsageError: If there is no reason.
    """
    from bench.certificate.amend import amend

    _require_reason(reason)
    return _show_issued(
        amend(old, lab_file, folder, _laboratory(dcc_key), reason=reason.strip()), as_json=as_json
    )


def void_number(number: str, *, reason: str, by: str | None, as_json: bool) -> int:
    """Declare a number void.

    reason, by: Why, and who says so; user@host where None.
    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    Raises UsageError: If there is no reason.
    Raises EvidenceError: If there is no such number, or it is issued or void.
    """
    import getpass
    import socket

    from bench.certificate.issue import complete_open
    from bench.certificate.series import declare_void, one_at_a_time

    _require_reason(reason)
    ledger = _ledger()
    with one_at_a_time(ledger.home):
        done = complete_open(ledger)  # the certificate of this number may lie sealed in its folder
        who = by or f"{getpass.getuser()}@{socket.gethostname()}"
        if number in done:
            raise EvidenceError(
                f"{number} is issued: its certificate was complete, and only its line in the ledger was missing."
                " The line is entered now.",
                where=str(ledger.path),
                remedy="To replace it: `starbench certificate amend`.",
            )
        one = declare_void(ledger, number, reason=reason.strip(), by=who)
    if as_json:
        print_json({"number": one.number, "state": "VOID", "reason": one.reason})
    else:
        click.echo(f"{one.number} is void: {one.reason}")
    return 0


def list_certificates(*, as_json: bool) -> int:
    """List the numbers of the ledger.

    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    """
    from bench.certificate.series_numbers import numbers

    trust, now = _trust(), datetime.now(UTC)
    rows = [
        {
            "number": one.number,
            "state": _listed_state(one, trust, now),
            "camera": one.serial,
            "customer": one.customer,
            "issued_utc": one.issued_utc,
            "run": one.run_id,
            "amends": one.amends,
            "superseded_by": one.superseded_by,
            "folder": one.folder,
            "reason": one.reason,
        }
        for one in numbers(_ledger().entries()).values()
    ]
    if as_json:
        print_json({"schema": "starbench/certificates/1", "certificates": rows})
        return 0
    if not rows:
        click.echo("The ledger of this bench has no certificates.")
        return 0
    names = ("number", "state", "camera", "customer")
    widths = [max(len(name), *(len(row[name]) for row in rows)) for name in names]
    click.echo("  ".join(name.ljust(width) for name, width in zip(names, widths, strict=True)) + "  date")
    for row in rows:
        cells = [row[name].ljust(width) for name, width in zip(names, widths, strict=True)]
        more = f"  replaced by {row['superseded_by']}" if row["superseded_by"] else ""
        more = more or (f"  {row['reason']}" if row["reason"] else "")
        click.echo("  ".join(cells) + f"  {row['issued_utc'][:10]}{more}")
    return 0


def show_certificate(folder: Path, *, as_json: bool) -> int:
    """Show a certificate.

    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    Raises UsageError: If the folder holds no certificate.
    Raises EvidenceError: If certificate.json is not of the expected form.
    """
    from bench.certificate.certificate_data import CERTIFICATE, Certificate
    from bench.certificate.series_numbers import numbers
    from bench.evidence.states import standing_of

    path = folder / CERTIFICATE
    if not path.is_file():
        raise UsageError(
            "This folder holds no certificate.",
            where=str(folder),
            remedy=f"Name the folder of a {CERTIFICATE}.",
        )
    data = read_bounded(path)
    certificate = Certificate.from_json(data, str(path))
    state = str(standing_of(folder, _trust(), datetime.now(UTC)).state.value)
    known = numbers(_ledger().entries()).get(certificate.number)
    if known is not None and known.superseded_by:
        state = f"SUPERSEDED by {known.superseded_by}"
    elif known is not None and known.how == "void":
        state = "VOID"
    if as_json:
        print_json({"state": state, "certificate": parse_json(data)})
    else:
        for line in _summary(certificate, state):
            click.echo(line)
    return 0


def _summary(certificate: Certificate, state: str) -> list[str]:
    item, by = certificate.item, certificate.authorised_by
    camera = f"{item.camera.maker} {item.camera.model}, {item.camera.serial}"
    lens = f"{item.lens.maker} {item.lens.model}, {item.lens.serial or 'without number'}"
    lines = [
        f"{certificate.title} {certificate.number}",
        f"State:      {state}",
        f"Laboratory: {certificate.laboratory.name}",
        f"Customer:   {certificate.customer.name}",
        f"Item:       {camera}; lens {lens}",
        f"Calibrated: {certificate.begun_utc[:10]}; issued {certificate.issued_utc[:10]}; run {certificate.run.id}",
        f"To be authorised by {by.name}, {by.role} ({by.key_fingerprint})",
        "",
        *(f"  {one.symbol:<4} {one.text}  (k = {one.k:.2f})" for one in certificate.results),
        *(f"  {one.name}: {one.text}" for one in certificate.further),
    ]
    lines += [
        f"  Conformity of {one.symbol}, {one.specification}: {one.verdict}" for one in certificate.conformity
    ]
    if certificate.amends:
        lines.append(f"Replaces {certificate.amends.number}: {certificate.amends.reason}")
        lines += [f"  {one.field}: {one.before!r} -> {one.after!r}" for one in certificate.amends.changes]
    return lines


def _show_issued(issued: Issued, *, as_json: bool) -> int:
    certificate = issued.certificate
    if as_json:
        facts: Mapping[str, Any] = {
            "schema": "starbench/issued/1",
            "number": certificate.number,
            "state": "SEALED",
            "folder": str(issued.folder),
            "seal": issued.seal,
            "completed": list(issued.completed),
            "certificate": json.loads(certificate.to_json()),
        }
        print_json(facts)
        return 0
    for number in issued.completed:
        click.echo(f"{number} was complete, but not in the ledger; entered now.")
    for line in _summary(certificate, "SEALED"):
        click.echo(line)
    click.echo(f"\nFolder: {issued.folder}")
    click.echo(
        f"SEALED, not authorised. {certificate.authorised_by.name} authorises it:"
        f" starbench certificate authorise {issued.folder}"
    )
    return 0


def _listed_state(one: Numbered, trust: Trust, now: datetime) -> str:
    from bench.evidence.states import standing_of
    from bench.records.run_folder import MANIFEST
    from bench.records.storage import sha256_of

    if one.how != "issued":
        return {"reserved": "DRAFT", "void": "VOID", "lost": "LOST"}[one.how]
    if one.superseded_by:
        return "SUPERSEDED"
    try:
        if sha256_of(Path(one.folder) / MANIFEST) != one.seal:
            return NOT_FOUND
        return str(standing_of(Path(one.folder), trust, now).state.value)
    except OSError:
        return NOT_FOUND


def _laboratory(dcc_key: DccKey) -> Laboratory:
    from bench.certificate.issue import Laboratory
    from bench.evidence.keys import BenchKey, ensure_key, require_usable

    def key() -> BenchKey:
        found = ensure_key(home_folder(), ask_passphrase=ask_passphrase)
        require_usable(home_folder(), found, datetime.now(UTC))
        return found

    sign = None
    if dcc_key is not None:
        from bench.certificate.dcc_signature import signer_of_files

        sign = signer_of_files(*dcc_key, ask_passphrase=ask_passphrase)
    return Laboratory(_ledger(), key, lambda: datetime.now(UTC), _verify, sign)


def _verify(folder: Path) -> Verification:
    """Verify a folder as the command `verify` does."""
    from bench.commands.verify_command import derivations
    from bench.evidence.verify import verify_folder

    return verify_folder(folder, _trust(), derivations=derivations(again=False))


def _trust() -> Trust:
    from bench.evidence.key_trust import read_trust

    return read_trust(home_folder())


def _ledger() -> Ledger:
    from bench.results.previous_calibration import bench_ledger

    return bench_ledger()


def _require_reason(reason: str) -> None:
    if not reason.strip():
        raise UsageError("The reason is empty.", remedy="Say why, with --reason TEXT.")
